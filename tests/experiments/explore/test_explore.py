"""An exploration: the same twice, computed again from what was recorded of it, and right on simple tables."""

import dataclasses
from concurrent.futures import BrokenExecutor, Future
from typing import Any

import numpy as np
import pytest

from deformscope.arrays import BoolArray
from deformscope.errors import InputError
from deformscope.experiments.explore.explore import (
    AtOnce,
    Exploration,
    ExploringRobot,
    NextMove,
    RecordedRobot,
    RecordedSteering,
    Steering,
    TouchHeld,
    Unsteered,
    explore,
    within_loop,
)
from deformscope.experiments.explore.explorer import ExplorationStages, Explorer, UnseenSurface
from deformscope.experiments.explore.options import PLAN_CELL_M, ExploreOptions
from deformscope.experiments.explore.robot_geometry import AsMeasured, Touch
from deformscope.experiments.measured import off_the_border
from deformscope.lab.scenes import built_in
from deformscope.lab.session_errors import LabErrors
from deformscope.robot.setup import Truth
from deformscope.robot.travel import NotThere
from deformscope.rows import from_components, to_components
from deformscope.session import Compute, Moment, Step, run
from deformscope.stages.map.exploration import (
    ExplorationStop,
    MapEstimate,
    PhaseStart,
    PlannedTouch,
    StageFailure,
    SteeringDecision,
    SurfaceEstimate,
    TouchEstimate,
    TouchForecast,
)
from deformscope.stages.map.measured import SurfaceMeasurement, TouchMeasurement
from deformscope.stages.poke.contact import ArmCompliance
from deformscope.stages.regions.touches import MapGrid
from studies.reproduce.surface_robot import LabRobot
from tests.cli.quick_scene import CELL_M, use_coarse_maps


class Results:
    """A session's recorder. moments: of each portion of results"""

    def __init__(self) -> None:
        self.moments: list[tuple[Moment, tuple[object, ...]]] = []

    def write(self, items: object) -> None:
        if isinstance(items, Step) and items.results:
            assert items.moment is not None
            self.moments.append((items.moment, items.results))


def carried_out(
    robot: ExploringRobot,
    options: ExploreOptions,
    truth: Truth | None = None,
    arm: ArmCompliance | None = None,
    steering: Steering | None = None,
) -> tuple[ExplorationStages, Exploration, list[tuple[Moment, tuple[object, ...]]]]:
    """An exploration of a robot that is done at once: what computed it, what it found, and all results."""
    results, found, size_m = Results(), Exploration(), (0.6, 0.4)
    unseen = UnseenSurface(size_m, options, arm or ArmCompliance(), truth)
    stages = ExplorationStages(unseen, AsMeasured(size_m, getattr(robot, "reachable", None)))
    run([], explore(lambda: 0, within_loop(stages), found, steering=steering), results, AtOnce(robot))
    return stages, found, results.moments


Explored = tuple[Explorer, list[object]]


def explored(name: str, **changes: object) -> Explored:
    options = ExploreOptions(**{"budget": 3, "beta_model": "none", **changes})  # type: ignore[arg-type]
    robot = LabRobot(built_in(name, options.seed), options, sees=options.beta_model != "none")
    stages, found, moments = carried_out(robot, options, robot.truth, robot.arm)
    explorer = stages.explorer
    assert robot.most_force_n < 8.0
    assert found.travel_m == explorer.travel_m
    assert found.touches == explorer.touches
    assert found.maps is explorer.maps
    return explorer, [result for _, results in moments for result in results]


def of(kind: type, results: list[object]) -> list[object]:
    return [result for result in results if isinstance(result, kind)]


def same(first: object, second: object) -> bool:
    one, other = to_components(first), to_components(second)
    return one.keys() == other.keys() and all(
        np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f") for name in one
    )


@pytest.fixture(scope="module")
def two() -> Explored:
    return explored("two-60-150", budget=4)


def test_a_touch_tells_stiffness_and_the_map_its_place(two: Explored) -> None:
    _, moments = two
    told = of(TouchEstimate, moments)
    scene = built_in("two-60-150", 0)
    stiff = [one for one in told if scene.modulus_pa(one.xyz_m[:2]) > 60e3]  # type: ignore[attr-defined]
    soft = [one for one in told if one not in stiff]
    assert len(told) == 4
    assert stiff
    assert soft
    assert min(one.stiffness_n_per_mm for one in stiff) > 1.5 * max(one.stiffness_n_per_mm for one in soft)  # type: ignore[attr-defined]
    for one in told:
        low, high = one.stiffness_interval  # type: ignore[attr-defined]
        assert low < one.stiffness_n_per_mm < high  # type: ignore[attr-defined]
    maps = of(MapEstimate, moments)[-1]
    assert maps.region_count == 2  # type: ignore[attr-defined]
    assert maps.iou > 0.7  # type: ignore[attr-defined]
    assert maps.boundary_m is not None  # type: ignore[attr-defined]


def test_the_law_that_is_shown_is_the_one_that_was_felt(two: Explored) -> None:
    """Over the whole way of the tip, what the arm gives among it."""
    for told in of(TouchEstimate, two[1]):
        assert isinstance(told, TouchEstimate)
        pressing = told.approach_n > 2.0
        assert np.count_nonzero(pressing) > 5
        assert abs(float(np.mean((told.fitted_n - told.approach_n)[pressing]))) < 0.08


def test_a_dent_that_was_pressed_on_is_as_deep_as_at_its_last_force() -> None:
    force = np.concatenate([np.zeros(30), np.linspace(0.0, 5.0, 200)])
    depth = 0.0018 * (force / 3.0) ** (1.0 / 1.5)
    free = np.concatenate([np.linspace(0.01, 0.0, 30), np.zeros(200)])
    position = np.column_stack([np.full((230, 2), 0.2), 0.06 + free - depth])
    along = np.column_stack([np.zeros((230, 2)), force])
    scene = built_in("two-60-150", 0)
    unseen = UnseenSurface(scene.size_m, ExploreOptions(beta_model="none"), ArmCompliance())
    places = np.random.default_rng(0).uniform(size=(500, 2)) * scene.size_m
    explorer = unseen.look(SurfaceMeasurement(np.column_stack([places, np.full(500, 0.05)]), np.full(500, 1e-3)))
    up, none = np.array([0.0, 0.0, 1.0]), np.zeros((0, 3))
    touched = TouchMeasurement(np.array([0.2, 0.2]), up, np.arange(230) * 0.01, position, along, none, True)
    told, *_ = explorer.touch(touched)
    assert told.stiffness_n_per_mm == pytest.approx(3.0 / 1.8, rel=0.02)  # at the set force
    assert told.peak_force_n == pytest.approx(5.0, rel=0.01)
    assert told.depth_m == pytest.approx(0.0018 * (5.0 / 3.0) ** (1.0 / 1.5), rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"threshold": float("nan")}, "threshold"),
        ({"seed": -1}, "seed"),
        ({"tip_radius_m": 0.0}, "tip_radius_m above 0"),
        ({"cell_m": float("inf")}, "cell_m above 0"),
        ({"set_force_n": float("nan")}, "set force"),
    ],
)
def test_options_that_are_no_quantities_are_refused(wrong: dict[str, float], message: str) -> None:
    """As `replay --set` takes them."""
    with pytest.raises(InputError, match=message):
        ExploreOptions(**wrong)  # type: ignore[arg-type]


def test_touches_without_a_relaxed_stiffness_end_with_a_reason_where_that_is_mapped() -> None:
    """None was held, so that none failed either."""
    force = np.concatenate([np.zeros(30), np.linspace(0.0, 3.0, 100)])
    height = np.concatenate([np.linspace(0.07, 0.06, 30), 0.06 - 0.004 * (force[30:] / 3.0) ** (1.0 / 1.5)])
    options = ExploreOptions(beta_model="none", hold_s=8.0, feel="relaxed")
    scene = built_in("two-60-150", 0)
    unseen = UnseenSurface(scene.size_m, options, ArmCompliance())
    places = np.random.default_rng(0).uniform(size=(500, 2)) * scene.size_m
    stages = ExplorationStages(unseen, AsMeasured(scene.size_m))
    stages.look(SurfaceMeasurement(np.column_stack([places, np.full(500, 0.05)]), np.full(500, 1e-3)))
    up, none, along = np.array([0.0, 0.0, 1.0]), np.zeros((0, 3)), np.column_stack([np.zeros((130, 2)), force])
    position = np.column_stack([np.full((130, 2), 0.2), height])
    for _ in range(3):
        assert stages.plan().given_up == ""
        stages.touch(TouchMeasurement(np.array([0.2, 0.2]), up, np.arange(130) * 0.01, position, along, none, True))
    assert "3 touches in a row gave no map" in stages.plan().given_up


def test_a_surface_is_known_as_well_as_touches_met_it() -> None:
    scene, up, none = built_in("two-60-150", 0), np.array([0.0, 0.0, 1.0]), np.zeros((0, 3))
    places = np.random.default_rng(0).uniform(size=(500, 2)) * scene.size_m
    known_m, there = [], np.array([0.3, 0.2])
    force = np.concatenate([np.zeros(30), np.linspace(0.0, 3.0, 100)])
    height = np.concatenate([np.linspace(0.07, 0.06, 30), 0.06 - 0.004 * (force[30:] / 3.0) ** (1.0 / 1.5)])
    for higher_m in (0.0, 0.004):
        unseen = UnseenSurface(scene.size_m, ExploreOptions(beta_model="none"), ArmCompliance())
        explorer = unseen.look(SurfaceMeasurement(np.column_stack([places, np.full(500, 0.05)]), np.full(500, 1e-3)))
        assert explorer.known_m(there) is None
        position = np.column_stack([np.full((130, 2), 0.2), height + higher_m])
        along = np.column_stack([np.zeros((130, 2)), force])
        explorer.touch(TouchMeasurement(np.array([0.2, 0.2]), up, np.arange(130) * 0.01, position, along, none, True))
        known_m.append(explorer.known_m(there))
    assert 0.0 < known_m[0] < 0.003
    assert known_m[1] == pytest.approx(known_m[0] + 0.004, abs=5e-4)


@pytest.mark.slow
def test_results_of_a_touch_say_which_and_when_its_dent_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    use_coarse_maps(monkeypatch)

    class Once:
        inner = LabRobot(built_in("two-60-150", 0), ExploreOptions(beta_model="none"), sees=False)
        look = inner.look

        def touch(self, command: Touch) -> TouchMeasurement:
            return dataclasses.replace(self.inner.touch(command), seen_ns=40)

    _, found, moments = carried_out(Once(), ExploreOptions(budget=2, beta_model="none", cell_m=CELL_M))
    estimates = [moment for moment, results in moments if isinstance(results[0], TouchEstimate)]
    assert [(moment.touch, moment.seen_ns) for moment in estimates] == [(1, 40), (2, 40)]
    plans = [moment for moment, results in moments if isinstance(results[0], PlannedTouch)]
    assert [(moment.touch, moment.seen_ns) for moment in plans] == [(0, None), (1, None), (2, None)]
    assert found.stop_reason == "budget"


def test_the_surface_is_seen_where_it_is(two: Explored) -> None:
    (seen,) = of(SurfaceEstimate, two[1])
    scene = built_in("two-60-150", 0)
    assert np.abs(seen.height_m - scene.height_m(scene.cells_m())).max() < 5e-4  # type: ignore[attr-defined]


def test_it_stops_for_a_reason_and_says_why_it_goes_where(two: Explored) -> None:
    _, moments = two
    plans = of(PlannedTouch, moments)
    assert plans[-1].stop_reason == "budget"  # type: ignore[attr-defined]
    assert plans[-1].target_m is None  # type: ignore[attr-defined]
    assert all(plan.reason for plan in plans)  # type: ignore[attr-defined]
    for plan in plans[:-1]:
        column, row = (plan.target_m / PLAN_CELL_M).astype(int)  # type: ignore[attr-defined]
        assert not plan.excluded[row, column]  # type: ignore[attr-defined]


def test_what_was_recorded_gives_the_same_results_to_the_last_bit(two: Explored) -> None:
    """Plans among them, and from a row of a recording as from the robot."""
    before, moments = two
    given = [
        from_components(type(one), to_components(one))
        for one in moments
        if isinstance(one, SurfaceMeasurement | TouchMeasurement)
    ]
    scene = built_in("two-60-150", 0)
    robot = RecordedRobot(list(given))
    robot.reachable = LabRobot(scene, before.options).reachable  # type: ignore[attr-defined]
    _, _, made = carried_out(robot, before.options, Truth(scene.regions), before._arm)
    assert len(given) == 5
    kinds = (SurfaceEstimate, PlannedTouch, TouchEstimate, MapEstimate)
    first = [one for one in moments if isinstance(one, kinds)]
    again = [one for _, results in made for one in results if isinstance(one, kinds)]
    assert len(first) == 1 + 5 + 4 + 4
    assert all(same(a, b) for a, b in zip(first, again, strict=True))


def test_a_place_without_a_way_is_left_out_before_it_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the reason, and the touches go elsewhere; from another place there may be a way."""
    approach = AsMeasured.approach
    tried: list[tuple[float, bool]] = []

    def no_way_at_first(self: AsMeasured, xy_m: np.ndarray, *others: object) -> Touch:
        refused = len(tried) < 2
        tried.append((float(xy_m[0]), refused))
        if refused:
            raise NotThere("a path that the arm can follow", "one out of the box", "another place")
        return approach(self, xy_m, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(AsMeasured, "approach", no_way_at_first)
    _, results = explored("two-60-150", budget=1)
    left_out = [one for one in of(StageFailure, results) if isinstance(one, StageFailure)]
    assert [(one.stage, one.touch) for one in left_out] == [("way", 0), ("way", 0)]
    assert all("left out: expected a path" in one.reason and "out of the box" in one.reason for one in left_out)
    assert len(of(TouchEstimate, results)) == 1
    assert len({x_m for x_m, _ in tried}) > 1, "the same place again"


def test_a_recording_that_ends_early_ends_it_in_order(two: Explored) -> None:
    looked = next(one for one in two[1] if isinstance(one, SurfaceMeasurement))
    _, found, moments = carried_out(RecordedRobot([looked]), ExploreOptions(beta_model="none"))
    assert found.stop.kind == "recording at its end"
    *_, (_, (phase, stop)) = moments
    assert isinstance(phase, PhaseStart)
    assert isinstance(stop, ExplorationStop)
    _, found, _ = carried_out(RecordedRobot([]), ExploreOptions())
    assert found.stop is not None  # it was stopped before it had looked


def test_a_process_that_ends_is_a_reason_to_stop() -> None:
    def broken(name: str, *inputs: object) -> Compute:
        raise BrokenExecutor("killed")

    robot, found = LabRobot(built_in("two-60-150", 0), ExploreOptions()), Exploration()
    stage = lambda name, *inputs: Compute(broken, (name, *inputs))  # noqa: E731
    run([], explore(lambda: 9, stage, found), Results(), AtOnce(robot))
    assert "the process that computes has ended" in found.stop.reason
    assert found.stop_ns == 9


def test_beta_comes_with_a_verdict_and_the_maps_with_its_field() -> None:
    _, moments = explored("homogeneous-60", budget=1, beta_model="volume")
    told = of(TouchEstimate, moments)
    assert all(one.beta_verdict for one in told)  # type: ignore[attr-defined]
    fitted = [one for one in told if one.beta is not None]  # type: ignore[attr-defined]
    assert fitted
    for one in fitted:
        low, high = one.beta_interval  # type: ignore[attr-defined]
        assert 0.0 <= low <= one.beta <= high < 1.0  # type: ignore[attr-defined]


@pytest.mark.slow  # several whole touches
def test_it_goes_on_where_it_is_told_to() -> None:
    """A gradient is soon known where only large inclusions are sought; the plan still says that it would stop."""
    _, moments = explored("gradient", budget=6, go_on=True, inclusion_m=0.15)
    plans = of(PlannedTouch, moments)
    assert len(of(TouchEstimate, moments)) == 6
    assert plans[-1].stop_reason == "budget"  # type: ignore[attr-defined]
    assert any(plan.stop_reason and plan.target_m is not None for plan in plans)  # type: ignore[attr-defined]


@pytest.mark.slow  # a second touch, for its way
def test_the_way_to_the_next_touch_is_as_high_as_what_it_leads_over() -> None:
    explorer, _ = explored("bumpy", budget=2)
    scene = built_in("bumpy", 0)
    start, goal = explorer.touches[-1].xyz_m[:2], np.array([0.1, 0.3])
    way = start + np.linspace(0.0, 1.0, 200)[:, None] * (goal - start)
    highest_m = float(scene.height_m(way).max())
    over_m = explorer.over_m(goal)
    assert highest_m < over_m < highest_m + 0.006
    assert explorer.over_m(start) < over_m


def test_before_the_first_touch_nobody_knows_what_the_way_leads_over() -> None:
    robot = LabRobot(built_in("homogeneous-60", 0), ExploreOptions(), sees=False)
    explorer = UnseenSurface((0.6, 0.4), ExploreOptions(), robot.arm).look(robot.look())
    assert explorer.over_m(np.array([0.1, 0.1])) is None


def test_narrower_border_lets_places_1_cm_from_each_edge_and_the_usual_one_stays() -> None:
    grid = MapGrid((0.6, 0.4), 0.005)
    usual, narrow = off_the_border(grid, 0.02), off_the_border(grid, 0.01)
    assert usual.sum() == (120 - 8) * (80 - 8)
    for place in ((0.01, 0.2), (0.59, 0.2), (0.3, 0.01), (0.3, 0.39)):
        cell = tuple((np.array(place)[::-1] / grid.cell_m).astype(int))
        assert narrow[cell]
        assert not usual[cell]
    assert not narrow[:, 0].any()


def test_forces_that_are_too_large_are_refused() -> None:
    with pytest.raises(InputError, match="up to 5 N"):
        ExploreOptions(set_force_n=6.0)
    with pytest.raises(InputError, match="a border"):
        ExploreOptions(border_m=0.005)
    with pytest.raises(InputError, match="a stated thickness"):
        ExploreOptions(border_m=0.01, thickness_stated=False)


@pytest.mark.parametrize(("set_n", "second_n"), [(3.0, 5.0), (1.0, 5.0 / 3.0), (4.0, 5.0), (5.0, 5.0)])
def test_what_is_stiff_is_pressed_harder_in_proportion(set_n: float, second_n: float) -> None:
    assert ExploreOptions(set_force_n=set_n).second_force_n == pytest.approx(second_n)


class Person(Unsteered):
    """Decides as it is written down: about each choice, and each forecast."""

    def __init__(self, choices: list[NextMove], confirms: list[bool]) -> None:
        self.choices, self.confirms = choices, confirms
        self.refusals: list[str] = []
        self.plans: list[PlannedTouch | None] = []

    def choose(self, plan: PlannedTouch | None, touches: int) -> Future[NextMove]:
        self.plans.append(plan)
        return later(self.choices.pop(0) if self.choices else NextMove())

    def confirm(self, forecast: TouchForecast) -> Future[bool]:
        return later(self.confirms.pop(0))

    def refuse(self, reason: str) -> None:
        self.refusals.append(reason)


def later(value: Any) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_result(value)
    return future


class HeldAtFirst:
    """A robot whose first touch is broken off."""

    def __init__(self, robot: LabRobot) -> None:
        self._robot, self._touched = robot, False
        self.places: list[list[float]] = []
        self.reachable = robot.reachable

    def look(self) -> SurfaceMeasurement:
        return self._robot.look()

    def touch(self, command: Touch) -> TouchMeasurement:
        if not self._touched:
            self._touched = True
            raise TouchHeld("the page is hidden")
        self.places.append(command.xy_m.tolist())
        return self._robot.touch(command)


def test_a_person_decides_and_a_replay_decides_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    use_coarse_maps(monkeypatch)
    options = ExploreOptions(budget=2, beta_model="none", cell_m=CELL_M)
    robot = HeldAtFirst(LabRobot(built_in("two-60-150", options.seed), options, sees=False))
    at = np.array([0.45, 0.3])
    beside, edge = np.array([0.7, 0.2]), np.array([0.3, 0.395])
    person = Person(
        [
            NextMove("touch", beside),
            NextMove("touch", edge),
            NextMove("touch", at),  # not confirmed
            NextMove("touch", at),  # confirmed, and broken off
            NextMove("veto", np.array([0.15, 0.15])),
            NextMove("touch", at),
        ],
        [False, True, True],
    )
    _, found, moments = carried_out(robot, options, steering=person)
    results = [result for _, some in moments for result in some]

    assert person.refusals == [
        "it is outside the surface, which has 60 by 40 cm",
        "it is within 2 cm of the surface's edge",
    ]
    assert [one.kind for one in results if isinstance(one, SteeringDecision)] == ["touch", "held", "veto", "touch"]
    assert robot.places[0] == at.tolist()
    assert len(robot.places) == len(found.touches) == found.started == 2
    assert found.asked == [1]
    before, after = (one.target_m for one in of(PlannedTouch, results)[1:3])  # type: ignore[attr-defined]
    assert np.linalg.norm(after - [0.15, 0.15]) > 0.025 > np.linalg.norm(before - [0.15, 0.15])
    forecast, felt = of(TouchForecast, results)[-1], found.touches[0]
    assert isinstance(forecast, TouchForecast)
    assert forecast.xyz_m == pytest.approx(felt.xyz_m, abs=1e-9)
    low, high = forecast.stiffness_interval
    assert low < felt.stiffness_n_per_mm < high
    np.testing.assert_allclose(forecast.depth_m[-1], 1e-3 * options.set_force_n / forecast.stiffness_n_per_mm)
    assert (forecast.depth_low_m <= forecast.depth_m).all()
    assert (forecast.depth_m <= forecast.depth_high_m).all()

    given = of(SurfaceMeasurement, results) + of(TouchMeasurement, results)
    decisions = [one for one in results if isinstance(one, SteeringDecision)]
    steering = RecordedSteering(decisions)
    _, _, again = carried_out(RecordedRobot(given), options, steering=steering)
    for kind in (SurfaceEstimate, PlannedTouch, TouchEstimate, MapEstimate):
        first, second = of(kind, results), of(kind, [result for _, some in again for result in some])
        assert len(first) == len(second) > 0
        assert all(same(one, other) for one, other in zip(first, second, strict=True))


def test_a_replay_without_decisions_goes_as_planned() -> None:
    assert RecordedSteering([]).choose(None, 0).result(0).kind == "go on"
    at, held = np.array([0.1, 0.2]), SteeringDecision("held", np.array([0.1, 0.2]), 1)
    steering = RecordedSteering([SteeringDecision("touch", at, 1), held, SteeringDecision("touch", at, 1)])
    assert [steering.choose(None, touches).result(0).kind for touches in (0, 1, 1, 2)] == [
        "go on",
        "replan",
        "touch",
        "go on",
    ]


def test_what_the_camera_has_not_seen_is_not_touched() -> None:
    options = ExploreOptions(budget=1, beta_model="none")
    stages = ExplorationStages(UnseenSurface((0.6, 0.4), options, ArmCompliance()), AsMeasured((0.6, 0.4), grid_left))
    places = np.random.default_rng(0).uniform((0.0, 0.0), (0.4, 0.4), (2000, 2))
    stages.look(SurfaceMeasurement(np.column_stack([places, np.full(2000, 0.05)]), np.full(2000, 1e-3)))
    for place, reason in (((0.5, 0.2), "measured no surface"), ((0.35, 0.2), "cannot reach it")):
        refused = stages.aim(np.array(place))
        assert reason in refused.refused
        assert refused.touch is None
        assert refused.results == ()
    taken = stages.aim(np.array([0.2, 0.2]))
    assert taken.refused == ""
    assert taken.touch.height_m == pytest.approx(0.05, abs=1e-3)


def grid_left(grid: MapGrid) -> BoolArray:
    return np.asarray(grid.centres_m[:, 0] < 0.3).reshape(grid.shape)


@pytest.mark.slow  # several whole touches
def test_an_egg_crate_of_one_foam_is_one_region_and_its_touches_agree() -> None:
    _, moments = explored("egg-crate", budget=5, seed=1000)
    touches = [one for one in moments if isinstance(one, TouchEstimate)]
    last = [one for one in moments if isinstance(one, MapEstimate)][-1]
    apparent = np.log([one.stiffness_n_per_mm for one in touches])
    level = np.log([one.level_n_per_mm or np.nan for one in touches])
    assert np.ptp(apparent) > 2.0 * np.ptp(level)
    assert all(one.thickness_m is not None and 0.04 < one.thickness_m < 0.06 for one in touches)
    assert last.region_count == 1
    foam_pa = built_in("egg-crate", 1000).pieces[0].modulus_pa
    assert last.level_modulus_pa[0] == pytest.approx(foam_pa, rel=0.15)  # small strain, at a dent of half a radius


@pytest.mark.slow  # whole touches
def test_a_touch_of_a_level_surface_has_no_other_stiffness_on_a_level_layer() -> None:
    _, seen = explored("homogeneous-60", budget=2)
    assert [one.level_n_per_mm for one in of(TouchEstimate, seen)] == [None, None]  # type: ignore[attr-defined]


@pytest.mark.slow  # 160 touches
def test_touches_1_cm_from_the_edge_make_no_regions(capsys: pytest.CaptureFixture[str]) -> None:
    """Four at the edges and four inside, of one foam, with all errors of the laboratory. Prints how far apart the two
    are, with the edge's law and without."""
    ones, apart = [], []
    for seed in range(20):
        scene = built_in("homogeneous-60", seed)
        at_m = np.random.default_rng(seed).uniform(0.1, 0.9, 4) * np.tile(scene.size_m[::-1], 2)[[0, 0, 1, 1]]
        (width, depth), (a, b, c, d) = scene.size_m, at_m
        edges_m = [(0.01, a), (width - 0.01, b), (c, 0.01), (d, depth - 0.01)]
        places = [np.array(one) for one in (*edges_m, (0.15, 0.12), (0.45, 0.28), (0.3, 0.2), (0.15, 0.3))]
        options = ExploreOptions(beta_model="none", border_m=0.01, seed=seed)
        robot = LabRobot(scene, options, sees=False, errors=LabErrors())
        explorer = UnseenSurface(scene.size_m, options, robot.arm).look(robot.look())
        geometry = AsMeasured(scene.size_m)
        touches = [explorer.touch(robot.touch(explorer.approached(one, geometry)))[0] for one in places]
        felt = np.log([one.stiffness_n_per_mm for one in touches])
        level = np.log([one.level_n_per_mm or np.nan for one in touches])
        apart.append([one[:4].mean() - one[4:].mean() for one in (level, felt)])
        ones.append(explorer.region_map.region_count == 1)
    with capsys.disabled():
        print(f"one region in {sum(ones)} of 20; apart {np.mean(apart, axis=0)}, sd {np.std(apart, axis=0)}")
    assert sum(ones) >= 19
