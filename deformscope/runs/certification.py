"""`deformscope certify`: touch a sample of known modulus; the rig's bias by cause, for its file."""

import dataclasses
import json
import tomllib
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.experiments.explore.options import ExploreOptions
from deformscope.experiments.explore.robot_geometry import FromFrames
from deformscope.experiments.rig.arm_compliance import touch_places
from deformscope.file_io import nearest, read_file
from deformscope.lab.session_errors import LabErrors
from deformscope.pictures.report import Figure
from deformscope.runs.arm_calibration import touched_result
from deformscope.runs.indentation import curves_png, shown_rows
from deformscope.runs.opened_devices import LAB, Opening, setup_of
from deformscope.runs.rig_calibration import RigCalibrationResult, today, write_values
from deformscope.session import RigExperiment
from deformscope.stages.map.measured import TouchMeasurement
from deformscope.stages.poke.certificate import TOLERANCE, KnownSample, certify_rig
from deformscope.stages.poke.contact import Z_90
from deformscope.stages.poke.indentation import IndentCurve, IndentSample
from deformscope.stages.poke.tip_law import Ground, Indenter
from deformscope.terminal import say

if TYPE_CHECKING:
    from deformscope.config import CertifyConfig
    from deformscope.recording.recorder import Recorder

POISSON = (0.48, 0.5)
"""Range of Poisson's ratio of silicones [assumed: nearly incompressible]."""
RING_M, EDGE_RADII, SHALLOW, LEAST_N = 0.06, 4.0, 0.6, 0.1
"""Largest distance of touches from the sample's middle; least distance from its edge, in radii of the contact; force of
every second touch over that of the others; least force of a touch: ten times the sensor's noise."""


def opening_of(config: "CertifyConfig") -> Opening:
    """The devices, not opened, and the options of their touches. Raises the errors of `setup_of`."""
    options = ExploreOptions(budget=config.touches, beta_model="none", seed=config.output.seed, hold_s=0.5)
    return setup_of(config.rig, options, None, trusted=config.trust_rig, errors=LabErrors.uncertified())


def known_sample(config: "CertifyConfig", opening: Opening) -> KnownSample:
    """The sample of a name or a file, as it lies. Raises InputError."""
    setup, options, path = opening.setup, opening.options, Path(config.sample)
    if path.suffix.lower() == ".json":
        name, modulus_pa, sd, lies = _of_file(path)
    else:
        table = tomllib.loads((resources.files("deformscope") / "rig" / "silicones.toml").read_text(encoding="utf-8"))
        if (name := config.sample) not in table:
            near = nearest(name, table) or "the JSON of deformscope indent"
            raise InputError(f"a sample out of {', '.join(table)}, or a .json", repr(name), near)
        lies = {"poisson": POISSON, **table[name]}
        modulus_pa, sd = 1e3 * lies["kpa"][0], lies["kpa"][1] / lies["kpa"][0]
    stated_m = options.thickness_m if options.thickness_stated else None
    if (thickness_m := config.thickness_m or lies.get("thickness_m") or stated_m) is None:
        raise InputError("the sample's thickness", "none", "--thickness-m 0.02")
    ground: Ground = "sliding" if config.sliding or lies.get("sliding") else "bonded"
    give, tip = setup.compliance_m_per_n, Indenter("sphere", (2.0 * setup.placement.tool.radius_m,))
    sample = IndentSample(
        tip,
        thickness_m,
        ground,
        (float(lies["poisson"][0]), float(lies["poisson"][1])),
        width_m=min(setup.size_m),
        machine_n_per_mm=1e-3 / give if give > 0.0 else None,
        machine_sd=setup.compliance_sd / give if give > 0.0 else 0.0,
    )
    return KnownSample(name, modulus_pa, sd, sample)


def _of_file(path: Path) -> tuple[str, float, float, dict[str, Any]]:
    """Name, modulus [Pa], deviation of its log, and the settings of the result of `indent`."""
    expected = "the JSON of deformscope indent, with a modulus in its interval"
    try:
        given = json.loads(read_file(path, expected))
        found, lies = given["together"] or given["curves"][0], given["settings"]
        modulus_pa, (low, high) = found["modulus_pa"], found["modulus_interval_pa"]
        if 0.0 < low <= modulus_pa <= high < 1e12 and len(lies["poisson"]) == 2:
            return f"{path.name}, {modulus_pa / 1e3:.4g} kPa", modulus_pa, float(np.log(high / low)) / 2.0 / Z_90, lies
    except (ValueError, KeyError, TypeError, IndexError):
        pass
    raise InputError(expected, "another file", "deformscope indent ... --json FILE.json", path)


def plan_touches(known: KnownSample, touches: int, size_m: tuple[float, float], most_n: float) -> list[FloatArray]:
    """Places (n, 2) [m] on a ring about the middle, and forces (n,) [N]: to the end of the law of small strain, every
    second one less deep. Raises InputError for a sample that is too small for the tip, or too soft for the sensor."""
    sample, nu = known.lies, 0.5 * sum(known.lies.poisson)
    around_m = EDGE_RADII * sample.tip.contact_radius_m(sample.limit_m)
    if (ring_m := min(0.5 * min(size_m) - around_m, RING_M)) < 0.0:
        came = f"{1e3 * min(size_m):.3g} mm"
        raise InputError(f"a sample of {2e3 * around_m:.3g} mm or more for a {sample.tip}", came, "a smaller tip")
    full = float(sample.law(sample.limit_m, nu).response(sample.limit_m)) * known.modulus_pa / (1.0 - nu**2)
    if full < LEAST_N / SHALLOW:
        expected = f"a sample that presses back with {LEAST_N / SHALLOW:.2g} N at {1e3 * sample.limit_m:.2g} mm"
        raise InputError(expected, f"{full:.2g} N", "a firmer or a thicker one, or a larger tip")
    number = np.arange(touches)
    turn = 2.0 * np.pi * number / touches
    places_m = 0.5 * np.array(size_m) + ring_m * np.column_stack([np.cos(turn), np.sin(turn)])
    return [places_m, min(full, most_n) * np.where(number % 2 == 0, 1.0, SHALLOW)]


def certify(
    config: "CertifyConfig", opening: Opening, recording: "AbstractContextManager[Recorder]"
) -> RigCalibrationResult:
    """Touch the sample, and write the rig's certificate into its file where that is asked for."""
    setup, curves = opening.setup, list[IndentCurve]()
    known = known_sample(config, opening)
    places_m, forces_n = plan_touches(known, config.touches, setup.size_m, setup.workspace.target_force_n)
    opening = dataclasses.replace(opening, options=dataclasses.replace(opening.options, set_force_n=float(forces_n[0])))

    def touching(geometry: FromFrames, line: Callable[[str], None]) -> RigExperiment[None]:
        def touched(made: TouchMeasurement, height_m: float) -> None:
            name, normal = f"touch {len(curves) + 1}", made.normal / np.linalg.norm(made.normal)
            curves.append(IndentCurve(-(made.position_m @ normal), made.force_n @ normal, made.time_s, name))
            line("")
            say(f"{name} of {config.touches}: {curves[-1].force_n.max():.2f} N")

        return touch_places(geometry, places_m, touched, forces_n.tolist())

    def result() -> RigCalibrationResult:
        tool = setup.placement.tool
        given = tool.force_gain_sd, None, None, setup.compliance_sd, None
        found = certify_rig(curves, known, [one or usual for one, usual in zip(given, TOLERANCE, strict=True)])
        values: dict[str, Any] = {
            "date": today(),
            "sample": known.name,
            "tip": str(known.lies.tip),
            "bias": found.bias,
            "interval": found.bias_interval,
            "off": found.off_text,
            "conditions": f"{len(curves)} touches of up to {forces_n.max():.2g} N, scatter {found.scatter:.1%}",
            "causes": {name: one[:2] for name, one in found.causes.items()},
        }
        rows = [*shown_rows(found, ()), *((name, str(values[name])) for name in ("sample", "tip", "conditions"))]
        figure = Figure(curves_png(found.curves), "Force over depth of each touch, with the law")
        sections = {"certificate": values}
        if tool.compliance_m_per_n is None and not config.rig.startswith(LAB):  # a simulated arm's, which was certified
            give = {"compliance_m_per_n": setup.compliance_m_per_n, "compliance_sd": setup.compliance_sd}
            sections = {"tool": give, **sections}
        return RigCalibrationResult(
            "certificate", sections, tuple(rows), figure, {**found.as_json(), **values, "date": str(today())}
        )

    found = touched_result(config, opening, recording, setup.calibrated, places_m, touching, result)
    if config.save:
        write_values(Path(config.rig), found.values)
    return found
