"""`deformscope calibrate beta POKE.npz... --thickness-m T`: layers below a surface, fitted to pokes of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deformscope import __version__
from deformscope.cli.common import console, fit_progress, show_table, write_json

if TYPE_CHECKING:
    from deformscope.config import OutputOptions
    from deformscope.experiments.poke_files import LayersOptions
    from deformscope.recording.recorder import Recorder, RecordingSummary
    from deformscope.stages.fit.calibrate import FitOptions, Model, Observation
    from deformscope.stages.fit.estimate import Estimate
    from deformscope.stages.poke.poke_estimate import PokesFound


def fit_layers(
    seen: Sequence[Observation], names: Sequence[str], fit: FitOptions, layers: LayersOptions, recorder: Recorder
) -> PokesFound:
    """Fit and record."""
    from deformscope.experiments.poke_files import poke_files
    from deformscope.session import run

    provenance = {"deformscope": __version__, "sources": list(names), "layers": dataclasses.asdict(layers)}
    with fit_progress() as fitting:
        return run((), poke_files(seen, fit, layers, provenance=provenance, progress=fitting), recorder)


def tell_layers(
    found: PokesFound, names: Sequence[str], recording: RecordingSummary, output: OutputOptions, save: Path | None
) -> None:
    """Tell, save and write, once the recording is whole."""
    from deformscope.cli.calibrate import tell
    from deformscope.files.model_file import save_model

    tell(found.estimate, recording, names[0] if len(names) == 1 else f"{len(names)} pokes")
    _tell_pokes(found)
    if save is not None:
        save_model(found.model, save)
        console().print(f"model: {save}", markup=False, soft_wrap=True)
    told = found.estimate.as_json()
    told["pokes"] = found.rows()
    told["tried"] = found.tried_json()
    told["field"] = found.model.field_kind
    told["model"] = None if save is None else str(save)
    write_json(told, output.json)


def save_pair_model(seen: Observation, name: str, model: Model, estimate: Estimate, path: Path) -> None:
    """Save the very particles of one pair as a model."""
    from deformscope.files.model_file import save_model
    from deformscope.stages.msm.poke import Law
    from deformscope.stages.poke.fitted import from_pair

    beta, theta = (estimate.value, model.theta) if model.parameter == "beta" else (model.beta, estimate.value)
    law = Law(beta, theta, model.cluster_size, model.basis, model.volume)
    told = None if estimate.stiffness is None else estimate.stiffness[0]
    provenance = {"deformscope": __version__, "sources": [name]}
    save_model(from_pair(seen, law, told, estimate.aee_free * (estimate.metres_per_unit or 1.0), provenance), path)
    console().print(f"model: {path}", markup=False, soft_wrap=True)


def _tell_pokes(found: PokesFound) -> None:
    rows = []
    for row in found.rows():
        parts = [f"depth {1e3 * row.depth_m:.3g} mm"]
        if row.force_n is not None:
            parts.append(f"{row.force_n:.3g} N")
        if row.stiffness_n_per_m is not None:
            parts.append(f"k {row.stiffness_n_per_m:.4g} N/m")
        if row.surface_error is not None:
            parts.append(f"surface off by {row.surface_error:.1%} of the depth")
        if row.surface_error_held_out is not None:
            parts.append(f"{row.surface_error_held_out:.1%} when left out of the fit")
        if row.left_out_error is not None:
            parts.append(f"force predicted from the others off by {row.left_out_error:+.1%}")
        # of points: where between them the tip was, a pair file does not say
        rows.append((f"touched points around ({row.xy_m[0]:.3g}, {row.xy_m[1]:.3g}) m", ", ".join(parts)))
    show_table(f"Pokes (stiffness over the surface: {found.model.field_kind})", rows)
    sizes = [
        (
            f"{one['cluster_size']} a side",
            f"error {one['error']:.1%} of the depth, beta {one['beta']:.3g}, theta {one['theta']:.3g}",
        )
        for one in found.tried_json()
    ]
    show_table("Cluster sizes tried, the best first", sizes)
