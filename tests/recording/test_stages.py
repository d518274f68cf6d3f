"""Which stages a recording holds, by rerun's own reader: complete, with what each cost, and what is missing."""

import dataclasses
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deformscope.experiments.fit.whole_motion import ParticleOptions, foam_video
from deformscope.files.sources import open_source
from deformscope.frames import ColorFrame, StageCost
from deformscope.log.views import SOMETIMES, ShownStage, stages_of
from deformscope.processes import SPAWN
from deformscope.recording.ledger import write_ledger
from deformscope.recording.reader import Replay, read_rows
from deformscope.recording.recorder import Recorder
from deformscope.recording.stages import recorded_stages, registries
from deformscope.rows import ENTITIES
from deformscope.session import Compute, Moment, RigExperiment, Step, ask, measuring, run, with_costs
from deformscope.stages.fit.calibrate import FitOptions
from deformscope_drivers.clock import Stamp
from tests.test_session import Notes, Rig
from tests.verified import verify_here

SAMPLES = Path(__file__).resolve().parents[2] / "recordings"


def spin(seconds: float) -> int:
    """Use the processor for so long."""
    until = time.thread_time() + seconds
    count = 0
    while time.thread_time() < until:
        count += 1
    return count


def spin_in_two(outer: float, inner: float) -> int:
    with measuring("inner"):
        count = spin(inner)
    return count + spin(outer)


def test_no_view_is_registered_without_a_stage() -> None:
    for application, registry in registries().items():
        for kind in registry:
            stages = stages_of(kind, registry)
            assert stages, f"{kind.__name__} is of no stage in {application}"
            for stage in stages:
                assert stage.chapter in (0, 2, 3, 4), (application, kind, stage)
                assert stage.entity or kind in ENTITIES, (application, kind)
                if stage.field:  # it is one of the result, or of a result inside
                    assert stage.field.split(".")[0] in {one.name for one in dataclasses.fields(kind)}


def test_stages_of_one_application_have_names_of_their_own() -> None:
    """Costs are recorded by name: one stage's must not be taken for another's."""
    for application, registry in registries().items():
        found: dict[str, str] = {}
        for kind in registry:
            for stage in stages_of(kind, registry):
                place = f"{stage.entity or ENTITIES[kind].split('/')[0]}:{stage.field}"
                assert found.setdefault(stage.name, place) == place, (application, stage.name)


@pytest.mark.parametrize(
    ("when", "expected"),
    [
        ("", True),
        (SOMETIMES, False),
        ("explore.hold_s", False),
        ("explore.beta_model", False),
        ("explore.border_m", True),
        ("explore.goal=regions", True),
        ("explore.goal=inclusions", False),
        ("stages.names=beta", True),
        ("stages.names=flow", False),
        ("explore.goal=regions explore.hold_s", False),
        ("explore.goal=regions explore.border_m", True),
        ("squeezed.names.camera", False),
    ],
)
def test_settings_say_which_stages_are_expected(when: str, expected: bool) -> None:
    settings: dict[str, Any] = {
        "explore": {"hold_s": 0.0, "beta_model": "none", "border_m": 0.02, "goal": "regions"},
        "stages": {"names": ["beta", "tactile"]},
    }
    assert ShownStage("any", 2, "something", when=when).is_expected(settings) == expected


def test_what_is_measured_within_a_stage_counts_once() -> None:
    value, costs = with_costs("outer", spin_in_two, 0.03, 0.06)
    assert value > 0
    by_name = {one.stage: one for one in costs}
    assert by_name.keys() == {"outer", "inner"}
    assert by_name["inner"].cpu_ms >= 60.0
    assert 30.0 <= by_name["outer"].cpu_ms < 60.0 <= by_name["outer"].cpu_ms + by_name["inner"].cpu_ms
    assert all(one.wall_ms >= one.cpu_ms - 1.0 for one in costs)


@pytest.mark.parametrize("beside", [False, True])
def test_the_loop_records_what_was_computed_with_the_next_results(beside: bool) -> None:
    """Also of a computation in a process of its own, and none of it twice."""
    notes: list[Step] = []

    class Steps(Notes):
        def write(self, items: Any) -> None:
            if isinstance(items, Step):
                notes.append(items)

    def computing() -> RigExperiment[None]:
        yield from ask(Compute(spin_in_two, (0.01, 0.02), "outer"), ("began",), Moment(1))
        yield Step(moment=Moment(2))
        yield Step(("found",), moment=Moment(3))
        yield Step(("more",), moment=Moment(4))

    began = time.process_time()
    if beside:
        with ProcessPoolExecutor(1, SPAWN) as executor:
            run(Rig(), computing(), Steps(), executor=executor)
    else:
        run(Rig(), computing(), Steps())
    used_ms = (time.process_time() - began) * 1e3
    assert [(step.results, [one.stage for one in step.costs]) for step in notes] == [
        (("began",), []),
        (("found",), ["inner", "outer"]),
        (("more",), []),
    ]
    assert all(one.cpu_ms > 0.0 for one in notes[1].costs)
    assert beside or sum(one.cpu_ms for one in notes[1].costs) < used_ms


def test_a_computation_that_fails_raises_where_it_is_waited_for() -> None:
    def failing() -> RigExperiment[None]:
        with pytest.raises(ZeroDivisionError):
            yield from ask(Compute(lambda: 1 // 0, (), "wrong"))

    run(Rig(), failing(), Notes())


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A recording of a fit of images, and the processor's time of its session [ms]."""
    pytest.importorskip("warp")
    path = tmp_path_factory.mktemp("fit") / "fit.rrd"
    particles = ParticleOptions(grid=(6, 6))
    with open_source(["sample:tension"], stride=3) as source, Recorder(path, settings={"fit": 1}) as recorder:
        began = time.process_time()
        run(source, foam_video(particles, FitOptions(candidates=8)), recorder)
        used_ms = (time.process_time() - began) * 1e3
    return path, used_ms


def test_costs_of_a_fit_are_positive_and_less_than_the_sessions(fitted: tuple[Path, float]) -> None:
    path, used_ms = fitted
    costs = [row.item for row in read_rows(Replay(path), (StageCost,))]
    assert {one.stage for one in costs} >= {"flow", "particles", "estimate", "simulation"}
    assert all(one.wall_ms > 0.0 and one.cpu_ms > 0.0 for one in costs)
    assert sum(one.cpu_ms for one in costs) < used_ms


def test_the_stages_of_a_fit_are_all_there(fitted: tuple[Path, float]) -> None:
    found = {one.name: one for one in recorded_stages(fitted[0])}
    assert [name for name, one in found.items() if one.missing] == []
    frames = found["tracking"].rows
    assert (found["flow"].rows, found["simulation"].rows, found["estimate"].rows) == (frames - 1, frames, 1)
    assert found["flow"].timelines == ("frame", "session")
    assert found["flow"].computed == frames - 1
    assert found["estimate"].timelines == ("static",)
    assert found["flow"].live is None  # images of a file wait


def test_a_deterministic_recording_has_no_costs(tmp_path: Path) -> None:
    """They differ from run to run."""
    path = tmp_path / "same.rrd"
    frame = ColorFrame(Stamp(0), 0, np.zeros((8, 8), np.uint8))
    with Recorder(path, settings={}, deterministic=True) as recorder:
        recorder.write(frame)
        recorder.write(Step((), costs=(StageCost("flow", 1.0, 1.0),)))
    assert list(read_rows(Replay(path), (StageCost,))) == []


def without(path: Path, entity: str, target: Path) -> Path:
    """A copy that lacks an entity, and all below it."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    store = next(one for one in reader.recordings() if one.application_id.startswith("deformscope"))
    reader.stream(store=store).drop(content=f"/{entity}/**").write_rrd(
        target, application_id=store.application_id, recording_id=store.recording_id
    )
    return target


@pytest.mark.parametrize(
    ("entity", "name"), [("flow", "flow"), ("particles/simulated", "simulation"), ("calibration/estimate", "estimate")]
)
def test_a_stage_that_was_removed_is_named(
    entity: str, name: str, fitted: tuple[Path, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = without(fitted[0], entity, tmp_path / "less.rrd")
    assert verify_here(path, "--stages", "--json", str(tmp_path / "v.json")) == 3
    printed, said = capsys.readouterr()
    assert f"stages missing: {name}\n" in said
    (row,) = (line for line in printed.splitlines() if line.split()[:1] == [name])
    assert "MISSING" in row
    told = {one["name"]: one for one in json.loads((tmp_path / "v.json").read_text())["stages"]}
    assert [one["name"] for one in told.values() if one["missing"]] == [name]
    assert told[name]["rows"] == 0


def test_a_recording_without_costs_opens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = without(SAMPLES / "rig.rrd", "cost", tmp_path / "less.rrd")
    write_ledger(path)
    assert verify_here(path, "--stages") == 0
    printed, said = capsys.readouterr()
    assert "costs: not recorded" in said
    assert "stages missing: none" in said
    assert "- (stages.names=contact)" in printed


@pytest.mark.parametrize(
    ("name", "live", "chapters"),
    [
        ("explore", {"surface", "contact", "beta", "plan"}, {3, 4}),
        ("squeeze", set(), {2}),
        ("rig", {"tactile"}, {2, 3, 4}),
    ],
)
def test_each_sample_is_complete_with_what_it_cost(name: str, live: set[str], chapters: set[int]) -> None:
    stages = recorded_stages(SAMPLES / f"{name}.rrd")
    found = {one.name: one for one in stages}
    assert [one.name for one in stages if one.missing] == []
    assert {one.chapter for one in stages if one.rows} - {0} == chapters
    assert {one for one in live if found[one].live} == live
    assert all("session" in one.timelines for one in stages if one.rows)
    computed = [one for one in stages if one.computed]
    assert computed
    for one in computed:
        assert one.cpu_ms > 0.0
        assert one.wall_ms > 0.0
