"""`deformscope predict`: poke a fitted model where it was not poked.

deformscope predict slab.npz --poke 'at=0.28,0.2 tip=flat size=0.03x0.03 force=5' --json -
deformscope predict slab.npz --against poke2.npz poke3.npz --picture dents.png
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deformscope.cli.common import fit_progress, quiet_warp, read_file, replacing, show_table, write_json
from deformscope.config import PokeText, PredictConfig
from deformscope.errors import InputError

if TYPE_CHECKING:
    from deformscope.arrays import FloatArray
    from deformscope.stages.msm.poke import Poke
    from deformscope.stages.poke.fitted import FittedModel, Prediction
    from deformscope.studies.prediction import PokeComparison


def run(config: PredictConfig) -> None:
    """Predict, compare, tell and write."""
    import numpy as np

    from deformscope.files.model_file import load_model
    from deformscope.files.pairs import parse_pair
    from deformscope.stages.msm.solver import pick_device
    from deformscope.stages.poke.fitted import predict
    from deformscope.studies.prediction import compare

    model = load_model(config.source)
    asked = [_poke(text, model) for text in config.poke]
    points = None if config.points is None else _points(config.points)
    seen = [parse_pair(read_file(path, "a pair file (.npz)"), path) for path in config.against]
    quiet_warp()
    device = pick_device(config.device)
    with fit_progress() as progress:
        found = []
        for index, poke in enumerate(asked):
            progress("predicting", index, len(asked))
            found.append(predict(model, poke, device=device))
        compared = compare(model, seen, device=device, progress=progress) if seen else []
    for one in found:
        _tell(one)
    for path, measured in zip(config.against, compared, strict=True):
        _tell_comparison(str(path), measured)
    every = [*found, *(one.prediction for one in compared)]
    if config.out is not None:
        arrays: dict[str, Any] = {}
        for index, one in enumerate(every):
            arrays[f"rest_{index}"], arrays[f"deformed_{index}"] = one.rest, one.position
            arrays[f"surface_{index}"], arrays[f"touched_{index}"] = one.surface, one.touched
        with replacing(config.out) as file:
            np.savez_compressed(file, **arrays)
    if config.picture is not None:
        from deformscope.studies.dents_figure import draw_dents

        with replacing(config.picture) as file:
            draw_dents(every, compared, file)
    write_json(
        {
            "model": str(config.source),
            "provenance": model.provenance,
            "predictions": [_told(one, points) for one in found],
            "against": [
                {"pair": str(path), **_told(one.prediction, None), "scores": one.scores}
                for path, one in zip(config.against, compared, strict=True)
            ],
        },
        config.json,
    )


def _points(path: Path) -> FloatArray:
    import numpy as np

    from deformscope.files.arrays_file import numbers, read_arrays

    expected = "an .npz with `points (n, 3)`"
    found = read_arrays(read_file(path, expected), expected, path)
    if "points" not in found:
        raise InputError(expected, ", ".join(sorted(found)) or "nothing in it", where=path)
    points = numbers(found, "points")
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError("finite points (n, 3)", f"shape {points.shape}", where=path)
    return points


def _poke(text: PokeText, model: FittedModel) -> Poke:
    """A typed poke with what it left out taken from the model."""
    import numpy as np

    from deformscope.stages.msm.poke import Poke, Tip

    if text.tip is None and model.tip is None:
        raise InputError("a tip, since the model knows none", "none", "tip=flat size=0.02x0.02")
    slips = model.tip.slips if model.tip is not None else True
    if text.tip is not None:
        tip = Tip(text.tip, text.size, slips)
    else:
        assert model.tip is not None
        tip = dataclasses.replace(model.tip, size=text.size or model.tip.size)
    at = np.array(text.at)
    if model.dim == 3 and at.size == 2:
        at = np.append(at, model.rest[:, 2].max())
    if at.size != model.dim:
        raise InputError(f"at= with {2 if model.dim == 2 else '2 or 3'} coordinates", f"{at.size}", "at=0.28,0.2")
    return Poke(at, tip, text.depth, text.force)


def _tell(found: Prediction) -> None:
    rows = [("depth", f"{1e3 * found.depth:.4g} mm")]
    if found.force is None or found.force_interval is None:
        rows.append(("force", "not known: the model was fitted without a force (force_n in a pair file)"))
    else:
        low, high = found.force_interval
        rows.append(("force", f"{found.force:.4g} N, 90 % interval {low:.4g} to {high:.4g}"))
    rows.append(("surface", f"off by {1e3 * found.surface_error:.3g} mm near the tip (rms, as in the fit)"))
    rows.append(("touched", f"{len(found.touched)} particles"))
    if found.extrapolated:
        rows.append(("extrapolated", f"BEYOND what was fitted: {'; '.join(found.extrapolated)}"))
    rows.append(("converged", "yes" if found.converged else "NO: do not rely on it"))
    show_table(f"Poke {_words(found.poke)}", rows)


def _words(poke: Poke) -> str:
    place = ", ".join(f"{v:.3g}" for v in poke.at)
    size = " x ".join(f"{1e3 * side:.3g}" for side in poke.tip.size)
    return f"at ({place}) m with a {poke.tip.shape} tip of {size} mm"


def _tell_comparison(name: str, found: PokeComparison) -> None:
    rows = []
    for one in found.scores:
        force = "no force" if one.force is None else f"force {one.force:.3g} N"
        off = "" if one.force_error is None else f" ({one.force_error:+.1%})"
        rows.append((one.method, f"surface off by {one.surface_error:.1%} of the depth, {force}{off}"))
    if found.prediction.extrapolated:
        rows.append(("extrapolated", f"BEYOND what was fitted: {'; '.join(found.prediction.extrapolated)}"))
    if found.poke.force is not None:
        rows.append(("measured", f"force {found.poke.force:.3g} N at {1e3 * found.poke.depth:.3g} mm"))
    show_table(f"Against {name}", rows)


def _told(found: Prediction, points: FloatArray | None) -> dict[str, Any]:
    """One prediction as it goes into the JSON."""
    told: dict[str, Any] = {
        "poke": {
            "at_m": found.poke.at,
            "tip": found.poke.tip.shape,
            "size_m": found.poke.tip.size,
            "slips": found.poke.tip.slips,
            "depth_m": found.poke.depth,
            "force_n": found.poke.force,
        },
        "depth_m": found.depth,
        "force_n": found.force,
        "force_interval_n": found.force_interval,
        "stiffness_n_per_m": found.stiffness,
        "surface_error_m": found.surface_error,
        "extrapolated": found.extrapolated,
        "converged": found.converged,
        "surface": {"rest": found.rest[found.surface], "deformed": found.position[found.surface]},
        "touched": found.touched,
    }
    if points is not None:
        told["points"] = {"rest": points, "deformed": found.at(points)}
    return told
