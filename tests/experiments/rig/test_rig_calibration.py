"""What is measured for a rig's set-up, without a rig: frames of an arm and a camera that are sent in as they are asked
for."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deformscope.errors import InputError
from deformscope.experiments.rig.rig_calibration import BoardViews, SetupRequest, view_board
from deformscope.frames import ArmFrame, DepthFrame, Item
from deformscope.session import RigExperiment, Step
from deformscope.stages.setup.board import CharucoSpec
from deformscope.stages.setup.hand_eye import LEAST_SPREAD_RAD, turned_about
from deformscope_drivers.clock import Stamp

VIEWS = 8


def shown(turns_deg: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> tuple[BoardViews, list[str]]:
    """The views of an arm that is turned so for each request (n, 3) [deg], and what was asked for."""
    monkeypatch.setattr(
        "deformscope.experiments.rig.rig_calibration.find_board", lambda *_: SimpleNamespace(number=np.arange(12))
    )
    asked: list[str] = []
    notes: list[str] = []

    def operator(request: SetupRequest) -> RigExperiment[None]:
        asked.append(request.words)
        yield Step()

    def now(time_ns: int) -> list[Item]:
        none = np.zeros(3)
        turn = np.radians(turns_deg[min(len(asked), len(turns_deg)) - 1])
        joints = np.full(6, 10.0 * len(asked))
        arm = ArmFrame(Stamp(time_ns), 0, joints, np.zeros(6), np.zeros(6), none, turn, none, none, none)
        return [arm, DepthFrame(Stamp(time_ns), 0, np.zeros((2, 2), np.uint16), 1e-3, np.zeros((2, 2, 3), np.uint8))]

    experiment = view_board(operator, "arm", "depth", CharucoSpec(5, 4, 0.05), VIEWS, notes.append)
    next(experiment)
    try:
        for k in range(10_000):
            experiment.send(now(k * 100_000_000))
    except StopIteration as end:
        return end.value, asked + notes
    raise AssertionError("it goes on for ever")


def test_views_turned_about_one_axis_alone_are_followed_by_more(monkeypatch: pytest.MonkeyPatch) -> None:
    about_x = np.linspace(-30.0, 30.0, VIEWS)[:, None] * [1.0, 0.0, 0.0]
    views, asked = shown(np.vstack([about_x, [[0.0, 30.0, 0.0], [0.0, -30.0, 0.0], [0.0, 30.0, 0.0]]]), monkeypatch)
    assert len(views.seen) > VIEWS
    assert turned_about(views.T_base_ee) >= LEAST_SPREAD_RAD
    assert any("about its own y axis" in words or "about its own z axis" in words for words in asked)
    assert any(words.strip().startswith("turned about one axis only") for words in asked)


def test_an_arm_that_is_never_turned_about_a_second_axis_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"about two axes.*try: from the middle of the poses turn"):
        shown(np.linspace(-30.0, 30.0, VIEWS)[:, None] * [1.0, 0.0, 0.0], monkeypatch)


def test_views_all_about_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = Rotation.from_rotvec(0.5 * np.random.default_rng(0).standard_normal((VIEWS, 3)))
    views, _ = shown(turns.as_euler("XYZ", degrees=True), monkeypatch)
    assert len(views.seen) == VIEWS
