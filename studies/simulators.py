"""`python -m studies simulators`: finite element slabs in other simulators, before and after `deformscope simulate`.

python -m studies simulators --python with-mujoco/bin/python --surprises
python -m studies simulators --python with-mujoco/bin/python --cases 1 --vertices 750 1500 3000 --timestep-s 0.005 0.01
python -m studies simulators --python with-mujoco/bin/python --two-materials --vertices 3000

A linear slab of 30 mm, glued to the ground, is pressed by a flat tip of 30 mm to .5, 1 and 1.5 mm. Two of these pokes
are fitted, the third is the test. One more presses elsewhere, where the mesh lies otherwise under the tip.

A slab of two materials is pressed at six places, three on each. It is simulated with the regions of its map, and with
one material in their place; of each region a poke is the test.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

import deformscope as ds
from deformscope.arrays import FloatArray
from deformscope.config import flags
from deformscope.config.simulate import Target
from deformscope.errors import InputError
from deformscope.files.model_file import save_model
from deformscope.lab.elasticity import ElasticBox
from deformscope.lab.slab import GROWTH, RigidTip, Slab, downward, press
from deformscope.log.layout import EXPLORATION, ExplorationLayout
from deformscope.pictures.report import Table
from deformscope.recording.items import read_results
from deformscope.recording.recorder import Recorder
from deformscope.session import Moment, Step
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate, TouchEstimate
from deformscope.stages.msm.poke import Law, Tip
from deformscope.stages.poke.fitted import NEAR_M, FittedModel
from deformscope.stages.simulate.slab_mesh import REACH_SHARE, REACH_TIPS
from deformscope.terminal import say
from studies.runner import Study, StudyOptions, StudyReport, Trials

CASES = (
    *((50e3, 0.3), (5e3, 0.2), (200e3, 0.45), (20e3, 0.45), (100e3, 0.2), (50e3, 0.45)),
    *((5e3, 0.45), (200e3, 0.2), (20e3, 0.3), (100e3, 0.4), (10e3, 0.3), (150e3, 0.35)),
)
"""Young's modulus [Pa] and Poisson's ratio of each slab."""
SIDE, THICKNESS, HALF = 0.14, 0.03, 0.015
DEPTHS = (0.0005, 0.001, 0.0015)
"""At most 5 % of the thickness: the slab is linear, and MuJoCo's cells soften by 7 % from 1 to 3 mm."""
FINEST = 0.003
"""Elements at the tip [m]: with finer ones the force falls by .7 %, and the surface moves by .2 % of the depth."""
HERE, ELSEWHERE = (0.07, 0.07), (0.073, 0.066)
TWO, EDGE, WIDE = (20e3, 60e3), 0.10, 0.20
"""Young's moduli of the two materials [Pa], where the first ends along x, and the side of their slab [m]."""
PRESSED = ((0.080, 0.100), (0.075, 0.103), (0.070, 0.097), (0.120, 0.100), (0.125, 0.097), (0.130, 0.103))
"""Places of the pokes on it [m]."""
EXAMPLE = Path(__file__).parents[1] / "recordings" / "explore.rrd"
"""A recorded exploration, whose items the made one has but for places, forces, dents and regions."""


@dataclass(frozen=True, slots=True)
class SlabCase:
    """One slab, and how it is simulated. limit_s: after which its fit ends with the best so far"""

    young: float
    poisson: float
    vertices: int
    timestep_s: float | None
    python: str | None
    target: Target = "mujoco"
    limit_s: float = 1800.0
    reach_m: float | None = None


@dataclass(frozen=True, slots=True)
class SlabOutcome:
    """found: the JSON of the command; elsewhere: relative error of the force at the other place, with the fitted
    parameters"""

    case: SlabCase
    found: dict[str, object]
    elsewhere: float


def _pair(path: Path, dent: FloatArray, points: FloatArray, force: float, at: tuple[float, float]) -> Path:
    held = np.flatnonzero((np.abs(points[:, :2] - at) <= HALF + 1e-9).all(axis=1))
    tip = {"tip": "flat", "tip_size_m": [2 * HALF] * 2, "tip_at_m": [*at, THICKNESS]}
    arrays = {name: np.asarray(value) for name, value in tip.items()}
    np.savez(path, rest=points, deformed=points + dent, held=held, contact=held, force_n=np.array(force), **arrays)  # type: ignore[arg-type]  # numpy's stub
    return path


def try_slab(case: SlabCase) -> SlabOutcome:
    """Press a slab of finite elements, and repeat that in another simulator."""
    slab, tip = Slab((SIDE, SIDE, THICKNESS), case.young, case.poisson), RigidTip((HALF, HALF))
    points = slab.grid(0.01)
    with tempfile.TemporaryDirectory() as name:
        folder, pairs = Path(name), list[Path]()
        for place in (HERE, ELSEWHERE):
            unit = press(slab, place, tip, points, depth=1e-3, finest=FINEST)
            for depth in DEPTHS if place is HERE else DEPTHS[1:2]:
                path = folder / f"{len(pairs)}.npz"
                share = depth / 1e-3
                pairs.append(_pair(path, share * unit.displaced, points, share * unit.force, place))
        model = FittedModel(
            body="layers",
            rest=points,
            law=Law(0.5),
            spacing=0.01,
            toward=np.array([0.0, 0.0, -1.0]),
            tip=Tip("flat", (2 * HALF, 2 * HALF)),
            thickness=THICKNESS,
        )
        save_model(model, folder / "model.npz")
        found = ds.simulate(
            folder / "model.npz",
            out=folder / "body",
            against=pairs,
            held_out=2,
            target=case.target,
            python=case.python,
            vertices=case.vertices,
            timestep_s=case.timestep_s,
            limit_s=case.limit_s,
            reach_m=case.reach_m,
        )
        told = found.to_dict()
        assert isinstance(told["pokes"], list)
        elsewhere = next(one for one in told["pokes"] if one["name"] == str(pairs[-1]))
    outcome = SlabOutcome(case, told, float(elsewhere["force_error"]))
    say(" | ".join(_row(outcome)))  # known before the other cases end
    return outcome


@dataclass(frozen=True, slots=True)
class RegionsCase(SlabCase):
    """The slab of two materials. regions: number of regions of the simulated map, 1 or 2"""

    regions: int = 2


def two_materials(at: tuple[float, float], fine: float = FINEST) -> ElasticBox:
    """The slab with elements of this size [m] at a tip, and a plane of them where the materials meet."""
    axes = []
    for middle in at:
        tip = HALF * np.sin(0.5 * np.pi * np.linspace(-1.0, 1.0, 2 * round(HALF / fine) + 1))  # closer at its edges
        beside = HALF + (tip[-1] - tip[-2]) * np.cumsum(GROWTH ** np.arange(12))
        beside = np.append(beside[beside < 0.08], 0.09)
        axes.append(middle + np.concatenate([-beside[::-1], tip, beside]))
    (axis := axes[0])[np.abs(axis - EDGE).argmin()] = EDGE
    deep = downward(THICKNESS, 0.7 * fine, GROWTH)
    x, y = axes
    return ElasticBox(x, y, deep, young=lambda places: np.where(places[:, 0] < EDGE, *TWO), poisson=0.3)


def touch_of(template: TouchEstimate, number: int, fine: float = FINEST) -> TouchEstimate:
    """A touch of this slab, at one of `PRESSED`: force and surface of finite elements."""
    at, depth = PRESSED[number - 1], DEPTHS[number % len(DEPTHS)]
    box = two_materials(at, fine)
    under = box.plane(2, THICKNESS) & (np.abs(box.nodes[:, :2] - at) <= HALF + box.tolerance).all(axis=1)
    held = np.zeros(box.nodes.shape, bool)
    held[box.plane(2, 0.0)], held[under, 2] = True, True
    found = box.hold(held).solve(np.where(under[:, None], [0.0, 0.0, -depth], 0.0))
    around = np.linspace(-0.035, 0.035, 29)
    points = np.stack(np.meshgrid(at[0] + around, at[1] + around, [THICKNESS], indexing="ij"), -1).reshape(-1, 3)
    sunk = np.linspace(0.0, 1.0, 50)
    force = -float(found.force[under, 2].sum())
    return replace(
        template,
        number=number,
        xyz_m=np.array([*at, THICKNESS]),
        normal=np.array([0.0, 0.0, 1.0]),
        approach_m=depth * sunk,
        approach_n=force * sunk,
        fitted_n=force * sunk,
        contact_m=0.0,
        depth_m=depth,
        peak_force_n=force,
        observed_m=points + box.sample(found.displacement, points),
    )


def record_regions(path: Path, regions: int) -> None:
    """The exploration of the slab, whose map has one region or two."""
    found = [row.item for row in read_results(EXAMPLE, (TouchEstimate, MapEstimate, SurfaceEstimate))]
    touch, surface, known = (
        next(one for one in found[::-1] if isinstance(one, kind))
        for kind in (TouchEstimate, SurfaceEstimate, MapEstimate)
    )
    assert isinstance(touch, TouchEstimate)
    assert isinstance(known, MapEstimate)
    labels = np.zeros_like(known.labels)
    labels[:, round(EDGE / known.cell_m) :] = regions - 1
    each = [0] * regions
    level, interval = known.level_n_per_mm[each], known.level_interval_n_per_mm[each]
    known = replace(known, labels=labels, region_count=regions, level_modulus_pa=None, level_n_per_mm=level)
    known = replace(known, level_rigid=known.level_rigid[each], level_interval_n_per_mm=interval)
    touches = [touch_of(touch, number) for number in range(1, len(PRESSED) + 1)]
    with Recorder(path, "none", {}, application=EXPLORATION) as recorder:
        recorder.start(ExplorationLayout((), (WIDE, WIDE), np.eye(4), truth=False), 0)
        recorder.write(Step((surface,), moment=Moment(1, cell_m=known.cell_m)))
        for at, one in enumerate((*touches, known), start=2):
            recorder.write(Step((one,), moment=Moment(at, 1, at, known.cell_m)))


def try_regions(case: SlabCase) -> SlabOutcome:
    """Simulate the slab of two materials."""
    assert isinstance(case, RegionsCase)
    with tempfile.TemporaryDirectory() as name:
        record = Path(name) / "touched.rrd"
        record_regions(record, case.regions)
        found = ds.simulate(
            record,
            out=Path(name) / "body",
            target=case.target,
            python=case.python,
            tip=f"flat:{2 * HALF}x{2 * HALF}",
            thickness_m=THICKNESS,
            vertices=case.vertices,
            timestep_s=case.timestep_s,
            limit_s=case.limit_s,
            reach_m=case.reach_m,
        )
    outcome = SlabOutcome(case, found.to_dict(), float("nan"))
    say(" | ".join(_regions_row(outcome)))
    return outcome


@dataclass(frozen=True, slots=True)
class SimulatorsConfig(StudyOptions):
    """Fit a simulator to slabs of finite elements whose modulus is known."""

    target: Annotated[Target, arg(name="in")] = "mujoco"
    """The simulator."""
    cases: Annotated[int, flags.least(1)] = 12
    """Slabs, each a minute or more for each setting: the first so many, without --only."""
    only: Annotated[tuple[int, ...], arg(metavar="INT...")] = ()
    """Numbers of slabs, from 1 to 12, in place of --cases."""
    vertices: Annotated[tuple[int, ...], arg(metavar="INT...")] = (2400,)
    """About how many vertices the body has."""
    reach_m: flags.PositiveFlag = None
    """How far the body goes beyond the tip [m]; default: as `deformscope simulate` has it."""
    timestep_s: Annotated[tuple[float, ...], arg(metavar="SECONDS...")] = ()
    """Time steps; default: the simulator's."""
    python: Annotated[Path | None, flags.one_word("PYTHON", Path), flags.unset] = None
    """The interpreter with it; default: this one."""
    limit_s: float = 1800.0
    """Time limit of each fit [s], after which it ends with the best so far."""
    two_materials: bool = False
    """A slab of two materials in place of the twelve."""
    regions: Annotated[tuple[int, ...], arg(metavar="INT...")] = (1, 2)
    """Regions of its map that are simulated."""
    surprises: bool = False
    """Show too what one would not guess of the simulator."""
    ends: bool = False
    """Show too what it costs that the body ends near the tip."""


def trials(options: SimulatorsConfig) -> list[Trials[SlabCase, SlabOutcome]]:
    python = None if options.python is None else str(options.python)
    if options.two_materials:
        two = [
            RegionsCase(TWO[0], 0.3, vertices, step, python, options.target, options.limit_s, options.reach_m, regions)
            for vertices in options.vertices
            for step in options.timestep_s or (None,)
            for regions in options.regions
        ]
        return [Trials("bodies", try_regions, two)]
    cases = [
        SlabCase(young, poisson, vertices, step, python, options.target, options.limit_s, options.reach_m)
        for young, poisson in ([CASES[number - 1] for number in options.only] or CASES[: options.cases])
        for vertices in options.vertices
        for step in options.timestep_s or (None,)
    ]
    return [Trials("slabs", try_slab, cases)]


SLABS = (
    *("E [kPa]", "nu", "vertices", "step [ms]", "E needed [kPa]", "nu fitted", "determined", "force typed in"),
    *("force fitted", "unseen depth", "elsewhere", "dent of the depth", "off the edge", "ms a step", "s", "converged"),
)
REGIONS = (
    *("materials", "vertices", "E typed in [kPa]", "E needed [kPa]", "nu fitted", "determined", "force typed in"),
    *("force fitted", "unseen places", "dent there", "off the edge", "s", "converged"),
)


def report(options: SimulatorsConfig, seconds: float, outcomes: Sequence[SlabOutcome]) -> StudyReport:
    names, row = (REGIONS, _regions_row) if options.two_materials else (SLABS, _row)
    rows = [row(one) for one in outcomes]
    version = outcomes[0].found["version"] if outcomes else ""
    tables = [Table(rows, names, f"{options.target} {version}, {seconds:.0f} s")]
    guesses = surprises(options.python, options.target) if options.surprises else ()
    if guesses:
        tables.append(Table(guesses, ("what", "one would guess", "seen"), f"{options.target} {version}"))
    if options.ends:
        tables.append(
            Table(ends(), ("nu", "ends beyond the tip [mm]", "force", "dent of the depth"), "finite elements")
        )
    return StudyReport(tables, {"slabs": outcomes, "surprises": guesses})


def ends(ratios: Sequence[float] = (0.2, 0.3, 0.4, 0.45)) -> list[tuple[str, ...]]:
    """What a free end does to force and dent in finite elements: where a simulator's body ends, and farther out."""
    rows, tip, near = list[tuple[str, ...]](), RigidTip((HALF, HALF)), REACH_SHARE * THICKNESS + REACH_TIPS * 2 * HALF
    for poisson in ratios:
        whole = Slab((SIDE, SIDE, THICKNESS), 1.0, poisson)
        points = whole.grid(0.005)
        aside = np.linalg.norm(np.maximum(np.abs(points[:, :2] - HERE) - HALF, 0.0), axis=1)
        for beyond in (0.6 * near, near):
            side = 2.0 * (HALF + beyond)
            shift = np.array([*HERE, 0.0]) - [0.5 * side, 0.5 * side, 0.0]
            seen = points[(aside <= NEAR_M) & (np.abs(points[:, :2] - HERE) <= 0.5 * side).all(axis=1)]
            part = Slab((side, side, THICKNESS), 1.0, poisson)
            cut = press(part, (0.5 * side, 0.5 * side), tip, seen - shift, depth=1.0, finest=FINEST)
            full = press(whole, HERE, tip, seen, depth=1.0, finest=FINEST)
            off = float(np.sqrt(np.mean(np.sum((cut.displaced - full.displaced) ** 2, axis=1))))
            rows.append((f"{poisson:g}", f"{1e3 * beyond:.0f}", f"{cut.force / full.force - 1.0:+.1%}", f"{off:.1%}"))
    return rows


def surprises(python: Path | None, target: Target = "mujoco") -> list[tuple[str, ...]]:
    """What one would not guess of a simulator, what one would guess, and what was seen."""
    script = Path(__file__).with_name(f"{target}_surprises.py")
    found = subprocess.run([python or sys.executable, "-I", script], capture_output=True, text=True, check=False)
    if found.returncode:
        said = (found.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError(f"{target} to answer", said, f"--python with {target}", where=python)
    return [tuple(row) for row in json.loads(found.stdout.strip().splitlines()[-1])]


def _row(one: SlabOutcome) -> tuple[str, ...]:
    found: dict[str, object] = one.found
    pokes, needed = found["pokes"], found["needed"]
    assert isinstance(pokes, list)
    assert isinstance(needed, dict)
    here = pokes[:3]
    fitted, unseen = ([one for one in here if one["held_out"] == held] for held in (False, True))
    return (
        f"{one.case.young / 1e3:g}",
        f"{one.case.poisson:g}",
        f"{found['vertices']}",
        f"{1e3 * float(str(found['timestep_s'])):g}",
        f"{needed['young_pa'] / 1e3:.3g}",
        f"{needed['poisson']:.2f}",
        _determined(found),
        f"{np.mean([one['force_error_before'] for one in here]):+.0%}",
        f"{_rms([one['force_error'] for one in fitted]):.1%}",
        f"{_rms([one['force_error'] for one in unseen]):.1%}" if unseen else "",
        f"{one.elsewhere:+.0%}",
        f"{_rms([one['dent_error'] for one in here]):.0%}",
        f"{_rms([one['dent_error_beyond_edge'] for one in here]):.0%}",
        f"{1e3 * float(str(found['seconds_per_step'])):.0f}",
        f"{float(str(found['seconds'])):.0f}",
        "yes" if found["converged"] else "no",
    )


def _regions_row(one: SlabOutcome) -> tuple[str, ...]:
    found: dict[str, Any] = one.found
    fitted, unseen = ([poke for poke in found["pokes"] if poke["held_out"] == held] for held in (False, True))
    return (
        f"{len(found['materials'])}",
        f"{found['vertices']}",
        ", ".join(f"{of['measured_young_pa'] / 1e3:.3g}" for of in found["materials"]),
        ", ".join(f"{of['young_pa'] / 1e3:.3g}" for of in found["materials"]),
        f"{found['needed']['poisson']:.2f}",
        _determined(found),
        f"{_rms([poke['force_error_before'] for poke in unseen]):.1%}",
        f"{_rms([poke['force_error'] for poke in fitted]):.1%}",
        f"{_rms([poke['force_error'] for poke in unseen]):.1%}",
        f"{_rms([poke['dent_error'] for poke in unseen]):.0%}",
        f"{_rms([poke['dent_error_beyond_edge'] for poke in unseen]):.0%}",
        f"{found['seconds']:.0f}",
        "yes" if found["converged"] else "no",
    )


def _determined(found: dict[str, Any]) -> str:
    return " ".join(name for name, known in found["determined"].items() if known) or "none"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


STUDY = Study(SimulatorsConfig, trials, report)
