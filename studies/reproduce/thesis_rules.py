"""Thesis chapter 4 in the laboratory: beta of foams for several held sets of a touch, and explorations by the thesis's
rules.

Figure 4.5: one touch of 3 N at the same place of each foam, and its beta with several held sets and cluster sizes of
the model. Figures 4.4, 4.6, 4.7 and table 4.1: the input of the sweep, the dents, and the fields of beta of the six
scenarios. Touches are pressed into finite elements and seen by the laboratory's camera, without wires."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from threadpoolctl import threadpool_limits

from deformscope.arrays import BoolArray, FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import Exploration
from deformscope.experiments.explore.explorer import ExplorationStages
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.lab.scenes import built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from deformscope.stages.gaussian_process import ProcessPrediction
from deformscope.stages.map.map_score import match_regions
from deformscope.stages.map.touch_beta import BallContact, fit_touch
from deformscope.stages.regions.touches import MapGrid
from studies.reproduce.foam_fits import format_order
from studies.reproduce.surface_robot import LabRobot, explore_at_once
from studies.reproduce.thesis_dent import COARSE_GRID_M, SIDE_M, SeenDent, dent_of
from studies.reproduce.thesis_map import (
    FIRST_SHARE,
    THESIS_STEP,
    ThesisExplorer,
    ThesisField,
    ThesisOptions,
    ThesisSurface,
    contoured,
    swept_betas,
    thesis_beta,
)

HARDNESSES_N = (30, 60, 110, 150, 300)
"""Hardnesses of figure 4.5: the thesis's 60, 110 and 150 N, one softer and one firmer."""

Hold = Literal[
    "single layer, one particle",
    "layers, one particle",
    "layers, one particle, exact surface",
    "layers, whole patch, raw points",
]
HOLDS: tuple[Hold, ...] = get_args(Hold)
"""Particles and held set of the model, and the surface with which it is compared, by default the thesis's Gaussian
process surface."""

CLUSTER_SIZES: tuple[int | None, ...] = (2, 3, 4, 5, None)
"""Particles along a cluster's side; None: one cluster that deforms quadratically (Thesis figure 4.5 (b), note 5)."""

SCENARIOS: dict[str, tuple[int, int]] = {
    "homogeneous-60": (3, 1),
    "homogeneous-110": (3, 1),
    "two-60-150": (4, 2),
    "two-110-150": (4, 2),
    "two-150-rigid": (4, 2),
    "three-60-110-rigid": (4, 3),
}
"""Table 4.1 of the thesis: number of interactions at Th = 0.06, and of regions."""

MOST_TOUCHES = 10
AROUND_M = 2.0 * SIDE_M
"""Width of the square of material points of the exact dent, which are 2.5 mm apart."""


OWN = ThesisOptions(beta_model="none")
"""The thesis's rules."""


@dataclass(frozen=True, slots=True)
class TouchedFoam:
    """A foam to touch. own: how it is touched and fitted"""

    hardness_n: int
    own: ThesisOptions = OWN
    cluster_sizes: tuple[int | None, ...] = CLUSTER_SIZES


@dataclass(frozen=True, slots=True)
class ScenarioCase:
    """A scene of the laboratory to explore."""

    scene: str
    seed: int
    own: ThesisOptions = OWN


@dataclass(frozen=True, slots=True)
class HeldBeta:
    """beta of one dent. cluster_size: particles along a cluster's side, None = no clusters; error_m: mean distance from
    simulated to observed points at this beta (eq. 4.6), None if it was fitted by squares"""

    hold: Hold
    cluster_size: int | None
    beta: float
    error_m: float | None


@dataclass(frozen=True, slots=True)
class FoamDent:
    """One touch of a foam. dent: the dent as estimated by the thesis's process; betas: betas of every hold and cluster
    size; seen_m: (n, 3) points of the camera around the touch during the press; ball: the tip, None = not stored"""

    hardness_n: float
    depth_m: float
    dent: SeenDent
    betas: tuple[HeldBeta, ...]
    seen_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    ball: BallContact | None = None


def press_foam(case: TouchedFoam) -> FoamDent:
    """Touch a foam in its middle, and fit beta in every way."""
    hardness_n, own = case.hardness_n, case.own
    with threadpool_limits(1):
        scene = built_in(f"homogeneous-{hardness_n}", 0)
        options = replace(own, thickness_m=scene.thickness_m)
        robot = LabRobot(scene, options)
        explorer = ThesisSurface(scene.size_m, options, robot.arm, robot.truth).look(robot.look())
        at = 0.5 * np.asarray(scene.size_m)
        touched = robot.touch(Touch(at, *explorer.surface.aim(at)))
        found, *_ = explorer.touch(touched)
        (dent,) = explorer.dents
        if dent is None:
            raise InputError("a foam that 3 N dents", f"{hardness_n} N", "a softer one")
        radius, thickness = options.tip_radius_m, scene.thickness_m
        level = thickness - found.depth_m
        ball = BallContact(np.append(at, level), radius, found.depth_m, found.peak_force_n)
        world = SlabWorld(robot.scene)
        exact = _exact(world, at, level + radius, radius, own.thesis.beta_grid_m)
        betas: list[HeldBeta] = []
        for size in case.cluster_sizes:
            for hold, seen, below in (
                (HOLDS[0], dent, None),
                (HOLDS[1], dent, thickness),
                (HOLDS[2], exact, thickness),
            ):
                swept = thesis_beta(seen, thickness_m=below, cluster_size=size, step=own.thesis.beta_step)
                betas.append(HeldBeta(hold, size, swept.beta, swept.error_m))
            if size is not None:
                ours = fit_touch(
                    explorer.surface.process, touched.after_m, ball, thickness_m=thickness, cluster_size=size
                )
                betas.append(HeldBeta(HOLDS[3], size, ours.estimate.value, None))
    near = (np.abs(touched.after_m[:, :2] - at) < 0.5 * SIDE_M).all(axis=1)
    return FoamDent(hardness_n, found.depth_m, dent, tuple(betas), touched.after_m[near], ball)


@dataclass(frozen=True, slots=True)
class Scenario:
    """An exploration by the thesis's rules.

    contacts_m: (n, 2) touches in their order; rigid: (n,); stop_reason: why no touch follows
    truth: (rows, columns) labels; hardness: hardness of each label, in words
    variance: (rows, columns) variance of the field, for any beta; fields: fields of each beta model"""

    scene: str
    seed: int
    contacts_m: FloatArray
    rigid: BoolArray
    stop_reason: str
    truth: IntArray
    hardness: tuple[str, ...]
    cell_m: float
    variance: FloatArray
    fields: "dict[str, BetaField]"


@dataclass(frozen=True, slots=True)
class BetaField:
    """touches: beta of each touch; mean: (rows, columns); isopleths: (k,); labels: (rows, columns); iou: IoU with the
    truth"""

    touches: tuple[float, ...]
    mean: FloatArray
    isopleths: FloatArray
    labels: IntArray
    regions: int
    iou: float


def explore_scenario(case: ScenarioCase) -> Scenario:
    """Explore a scene from a seed until its variance is below Th. The field is computed by a single layer, and by
    layers from the same dents: the places of touches do not depend on beta."""
    name, seed, own = case.scene, case.seed, case.own
    with threadpool_limits(1):
        scene = built_in(name, seed)
        if (truth := scene.regions) is None:
            raise InputError("a scene with regions", name, "two-60-150")
        x, y = np.multiply(FIRST_SHARE, scene.size_m).tolist()
        options = replace(own, budget=MOST_TOUCHES, seed=seed, thickness_m=scene.thickness_m, first_m=(x, y))
        robot = LabRobot(scene, options)
        unseen, found = ThesisSurface(scene.size_m, options, robot.arm, robot.truth), Exploration()
        stages = ExplorationStages(unseen, AsMeasured(scene.size_m, robot.reachable))
        explore_at_once(robot, stages, _Nowhere(), found)
        explorer = stages.explorer
        assert isinstance(explorer, ThesisExplorer)
        single = explorer.field
        counts = np.cumsum(single.dented)
        layers = ThesisField(width_m=own.thesis.sigma_w_m)
        for dent, places_m in zip(explorer.dents, np.split(single.places_m, counts[:-1]), strict=True):
            beta = 0.0
            if dent is not None:
                beta = thesis_beta(dent, thickness_m=scene.thickness_m, step=own.thesis.beta_step).beta
            layers = layers.with_touch(places_m, beta)
    fields = {"layers": _field(layers, truth), "single layer": _field(single, truth)}
    return Scenario(
        scene=name,
        seed=seed,
        contacts_m=np.array([one.xyz_m[:2] for one in explorer.touches]),
        rigid=np.array([one.rigid for one in explorer.touches], dtype=bool),
        stop_reason=found.stop_reason,
        truth=truth,
        hardness=tuple(piece.name for piece in scene.pieces),
        cell_m=explorer.grid.cell_m,
        variance=layers.on(explorer.grid).deviation ** 2,
        fields=fields,
    )


class _Nowhere:
    """A session's recorder that stores nothing."""

    def write(self, items: object) -> None: ...


def _field(found: ThesisField, truth: IntArray) -> BetaField:
    grid = MapGrid((truth.shape[1] * MapGrid().cell_m, truth.shape[0] * MapGrid().cell_m))
    on = found.on(grid)
    labels = contoured(on, found.isopleths).labels
    iou = match_regions(labels, truth)[0]
    return BetaField(found.touches, on.mean, found.isopleths, labels, int(labels.max()) + 1, iou)


class _Heights:
    """A surface of points (n, 3), linear between them."""

    def __init__(self, points_m: FloatArray) -> None:
        self._between = LinearNDInterpolator(points_m[:, :2], points_m[:, 2])

    def at(self, places_m: FloatArray) -> ProcessPrediction:
        return ProcessPrediction(np.asarray(self._between(places_m)), np.zeros(len(places_m)))


def _exact(world: SlabWorld, at: FloatArray, middle_m: float, radius_m: float, cell_m: float) -> SeenDent:
    """The exact dent of a ball whose middle is held at a height: the displacement of every point of the surface."""
    aside = MapGrid((AROUND_M, AROUND_M), 0.25 * COARSE_GRID_M).centres_m - 0.5 * AROUND_M
    rest = np.column_stack([at + aside, np.full(len(aside), world.scene.thickness_m)])
    contact = world.press(RigidTip(radius=radius_m), np.append(at, middle_m))
    moved = rest + world.displaced_m(contact, rest[:, :2])
    return dent_of(_Heights(rest), _Heights(moved), at, cell_m)


# In words ------------------------------------------------------------------------------------------------------------

SAME = 0.02
"""Largest difference at which the betas of two foams count as equal: two steps of the sweep (Algorithm 3)."""


def to_text(foams: Sequence[FoamDent], explored: Sequence[Scenario], step: float = THESIS_STEP) -> list[str]:
    """Results of figure 4.5 and the explorations, each sentence from their numbers. step: step of the sweep"""
    as_many = sum(len(one.contacts_m) == SCENARIOS[one.scene][0] for one in explored)
    made = f"As many touches as in the thesis in {as_many} of {len(explored)} explorations."
    return [*_trends(foams), made, *(_format_field(name, explored, swept_betas(step)) for name in explored[0].fields)]


def _trends(foams: Sequence[FoamDent]) -> list[str]:
    """How beta changes with hardness, by how the model is held."""
    if len(foams) < 2:
        return [f"Figure 4.5 has {len(foams)} foam: a trend of beta with hardness needs two."]
    betas: dict[Hold, list[FloatArray]] = {}
    for same in zip(*(one.betas for one in sorted(foams, key=lambda one: one.hardness_n)), strict=True):
        betas.setdefault(same[0].hold, []).append(np.array([one.beta for one in same]))
    words = []
    for hold, sizes in betas.items():
        changes = Counter(format_order(one, SAME) for one in sizes).most_common()
        said = ", ".join(f"{change} at {count} of {len(sizes)} cluster sizes" for change, count in changes)
        words.append(f"By {hold}, beta is {np.min(sizes):.2f} to {np.max(sizes):.2f}; it {said}.")
    return words


def _format_field(name: str, explored: Sequence[Scenario], swept: FloatArray) -> str:
    """For one way to model the dents: how many regions it finds, and between which of the swept betas (b,)."""
    fields = [(one.fields[name], int(one.truth.max()) + 1) for one in explored]
    right = sum(found.regions == count for found, count in fields)
    betas = [beta for found, _ in fields for beta in found.touches]
    words = f"With {name}, {right} of {len(fields)} explorations find the true number of regions"
    words += f"; beta is {min(betas):.2f} to {max(betas):.2f}"
    if max(betas) <= swept[0] or min(betas) >= swept[-1]:
        words += ", the end of the sweep for all touches: no isopleth divides them"
    return f"{words}."
