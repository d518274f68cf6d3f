"""What is shown of a squeeze, and that every result comes back as it was."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import Chunk

from deformscope.frames import PadLayout, Stream
from deformscope.log.layout import SQUEEZE, SqueezeLayout
from deformscope.log.squeeze.results import Fingertips, prepare_squeeze_results, squeeze_blueprint
from deformscope.pictures.figures import depth_change_png
from deformscope.recording.items import read_results
from deformscope.recording.recorder import Recorder
from deformscope.session import Moment, Step
from deformscope.stages.squeeze import trial
from deformscope.stages.squeeze.events import SqueezeEvents

PADS = tuple(
    PadLayout(f"finger_{finger}_{part}", 13, 6, (0.0034, 0.0034), 2 * finger + at, finger, at)
    for finger in range(3)
    for at, part in enumerate(("proximal", "distal"))
)
STREAM = Stream("pads", "tactile", "dsa", True, pads=PADS)
CHANGE = np.where(np.arange(3721).reshape(61, 61) % 7 == 0, np.nan, 0.004)
RESULTS = (
    trial.SqueezePhase("close"),
    SqueezeEvents(5, (1, 6), 9, (7, 12), np.array([5, 0]), 0.04, 0.02, 40.0),
    trial.FingertipPressure(
        3,
        np.array([[0.01, 0.02], [np.nan, np.nan]]),
        np.array([0.5, np.nan]),
        np.array([0.6, np.nan]),
        np.array([1.5, 0.0]),
        np.array([2e-4, 0.0]),
    ),
    trial.TrackedContainer(
        7, np.eye(4), False, "too few pixels", np.ones(6), 0.7, np.arange(8.0).reshape(2, 2, 2), 0.3
    ),
    trial.ContainerChange(
        7, 0.3, "", CHANGE.astype(np.float32), CHANGE[:11, :11], np.array([3.0, 4.0]), 0.11, 0.14, 2e-3
    ),
    trial.SqueezeFeatures(
        np.arange(72.0),
        np.r_[1.0, np.nan, np.arange(11.0)],
        np.arange(2.0),
        np.zeros((2, 72)),
        CHANGE,
        CHANGE[:11, :11],
        0.14,
        patch_px=np.array([30.0, 40.0]),
        patch_width_m=0.11,
    ),
    trial.ContentPosterior(0.4, "tactile", ("empty", "rice"), np.array([0.25, 0.75]), 12),
    trial.SqueezeStop("tactile array saturated", "a texel at 4095 counts", "a lower current", True, False),
)


def test_every_result_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    file = tmp_path / "r.rrd"
    with Recorder(file, "none", {"squeezed": {}}, application=SQUEEZE) as recorder:
        recorder.start(SqueezeLayout((STREAM,), "pads", (1, 5), ""), 1_000)
        recorder.write(Step(RESULTS, moment=Moment(2_000)))
    read = [one.item for one in read_results(file, tuple(map(type, RESULTS)))]
    assert len(read) == len(RESULTS)
    for before in RESULTS:
        after = next(one for one in read if type(one) is type(before))
        np.testing.assert_equal(dataclasses.asdict(after), dataclasses.asdict(before))


def test_what_is_no_result_of_a_squeeze_is_refused() -> None:
    with pytest.raises(TypeError, match=r"no twin in deformscope\.log shows a int"):
        prepare_squeeze_results((5,), 0, None)


def test_features_without_vision_are_shown_as_words() -> None:
    features = dataclasses.replace(RESULTS[5], vision=None, vision_small=None, reason="no camera")  # type: ignore[type-var]
    batch = prepare_squeeze_results((features,), 0, Fingertips(STREAM, (1, 5)))
    assert "display/squeeze/change/words" in [path for path, _ in batch.parts]


def test_the_model_before_stays_beside_the_one_after() -> None:
    rest = dataclasses.replace(RESULTS[3], since_s=-0.1, good=True)  # type: ignore[type-var]
    paths = [path for path, _ in prepare_squeeze_results((rest, RESULTS[3]), 0, None).parts]
    assert {"display/squeeze/container/before", "display/squeeze/container/after"} <= set(paths)


def test_what_was_measured_stands_in_a_table() -> None:
    batch = prepare_squeeze_results((RESULTS[1], RESULTS[5]), 0, None)
    (chunk,) = [part for path, part in batch.parts if path == "display/squeeze/measured" and isinstance(part, Chunk)]
    ((text,),) = chunk.to_record_batch()["TextDocument:text"].to_pylist()
    for words in ("within", "force of a finger | 1 N", "contact area | not measured", "86 % of 11.0 cm"):
        assert words in text


@pytest.mark.parametrize("named", [True, False])
def test_a_plot_of_contents_is_there_where_a_model_names_them(named: bool) -> None:
    views = squeeze_blueprint([STREAM], "pads", "camera", (0.0, 0.0, 10.0, 10.0), named=named)
    seen: list[str] = []

    def look(part: Any) -> None:
        seen.append(str(part.name))
        for inner in getattr(part, "contents", ()):
            if not isinstance(inner, str):
                look(inner)

    look(views.root_container)
    assert ("probability of each content, by touch and vision" in seen) == named
    assert any("model before" in name for name in seen)


def test_the_views_are_one_window_with_the_devices_behind() -> None:
    assert isinstance(squeeze_blueprint([STREAM], "pads", ""), rr.blueprint.Blueprint)


def test_a_depth_change_is_drawn_on_one_scale() -> None:
    import cv2

    picture = cv2.imdecode(np.frombuffer(depth_change_png(CHANGE, 0.11, 0.14), np.uint8), cv2.IMREAD_COLOR)
    dent, missing = picture[3, 9], picture[3, 3]  # blue, green, red
    assert dent[2] > dent[0]
    assert len(set(map(int, missing))) > 1 or int(missing[0]) < 120
