"""What takes long is limited unless the fine way is asked for, and says so."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

import deformscope as ds
from deformscope.arrays import ImageArray
from deformscope.cli import common, main
from deformscope.config import BetaConfig, SearchOptions
from deformscope.config.calibrate import PushFlags
from deformscope.experiments.fit import calibration_inputs
from deformscope.files.pairs import parse_pair
from deformscope.files.sources import open_source
from deformscope.runs import calibration
from deformscope.stages.poke.layers import MeasuredSurface
from deformscope.stages.poke.poke_fit import seen_poke, spacing_for
from tests.cases import Capture, Patch
from tests.cli.test_predict_command import THICKNESS, write_pair

COUNT, KEPT = 37, 16


def pressed(share: float) -> ImageArray:
    """(120, 100) a speckled block, stretched upwards by a share of its height."""
    speckle = cv2.GaussianBlur(np.random.default_rng(2).normal(128, 60, (120, 100)).astype(np.float32), (0, 0), 1.3)
    speckle = np.clip(128 + 2.5 * (speckle - 128), 0, 255).astype(np.float32)
    y, x = np.mgrid[:120, :100].astype(np.float32)
    moved = cv2.remap(speckle, x, (y + share * 110) / (1 + share), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return moved.clip(0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def images() -> list[ImageArray]:
    """A slow stretch in many small steps."""
    return [pressed(0.08 * index / (COUNT - 1)) for index in range(COUNT)]


@pytest.fixture
def slow(monkeypatch: Patch) -> None:
    """A machine on which nothing is quick: the fewest frames, and the coarsest lattice."""
    monkeypatch.setattr(calibration_inputs, "FLOW_S_PER_PX", 1e-2)
    monkeypatch.setattr(calibration, "MOST_PARTICLES", 1)


@pytest.fixture
def folder(tmp_path: Path, images: list[ImageArray]) -> Path:
    (tmp_path / "frames").mkdir()
    for index, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"frames/img{index}.png"), image)
    return tmp_path / "frames"


def test_thinned_frames_are_evenly_spread_from_the_first_to_the_last(folder: Path) -> None:
    with open_source([folder]) as source:
        every = list(source)
    for most in (2, 5, KEPT, COUNT, 99):
        with open_source([folder]) as source:
            source.thin(most)
            assert source.count == min(most, COUNT)
            found = list(source)
        assert [one.index for one in found] == list(range(min(most, COUNT)))
        places = [next(i for i, one in enumerate(every) if one.stamp == frame.stamp) for frame in found]
        assert (places[0], places[-1]) == (0, COUNT - 1)
        assert np.ptp(np.diff(places)) <= 1
        assert all((found[i].image == every[place].image).all() for i, place in enumerate(places))


def test_a_long_sequence_is_thinned_and_the_estimate_is_that_of_all_frames(
    images: list[ImageArray], slow: None, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[tuple[str, int, int]] = []
    options = {"grid": (8, 6), "candidates": 12, "progress": lambda *now: seen.append(now)}
    caplog.set_level(logging.INFO)
    quick = ds.calibrate_beta(images, **options)  # type: ignore[arg-type]
    words = caplog.text
    fine = ds.calibrate_beta(images, fine=True, **options)  # type: ignore[arg-type]
    assert f"{KEPT} of {COUNT} frames are tracked" in words
    assert "--fine tracks all" in words
    assert (quick.estimate.settings["frames"], quick.estimate.settings["frames_of"]) == (KEPT, COUNT)
    assert fine.estimate.settings["frames"] == COUNT
    assert "frames_of" not in fine.estimate.settings
    assert f"{COUNT} frames are tracked" in caplog.text.removeprefix(words)
    assert "in about" not in caplog.text  # how long that takes differs by machine: the progress says it
    assert [(done, total) for what, done, total in seen if what == "frames"] == [
        *((done, KEPT) for done in range(1, KEPT + 1)),
        *((done, COUNT) for done in range(1, COUNT + 1)),
    ]
    (low, high), (fine_low, fine_high) = quick.interval, fine.interval
    assert max(low, fine_low) <= min(high, fine_high)
    assert abs(quick.value - fine.value) < 0.5 * max(high - low, fine_high - fine_low)


def test_a_short_sequence_or_a_stride_of_ones_own_stays_whole(
    images: list[ImageArray], caplog: pytest.LogCaptureFixture, monkeypatch: Patch
) -> None:
    caplog.set_level(logging.INFO)
    assert ds.calibrate_beta(images[:KEPT], grid=(8, 6), candidates=12).estimate.settings["frames"] == KEPT
    assert "frames are tracked" not in caplog.text
    monkeypatch.setattr(calibration_inputs, "FLOW_S_PER_PX", 1e-2)
    own = ds.calibrate_beta(images, grid=(8, 6), candidates=12, stride=2)
    assert own.estimate.settings["frames"] == (COUNT + 1) // 2
    assert f"{(COUNT + 1) // 2} frames are tracked" in caplog.text


def test_what_was_thinned_replays_to_the_same_numbers(folder: Path, slow: None, capsys: Capture) -> None:
    record = folder.with_name("run.rrd")
    flags = ["--grid", "8x6", "--candidates", "12", "--viewer", "none"]
    assert main(["calibrate", "beta", str(folder), *flags, "--record", str(record)]) == 0
    said = capsys.readouterr()
    assert f"{KEPT} of {COUNT} frames are tracked" in said.out + said.err
    assert main(["replay", str(record), "--viewer", "none"]) == 0


def test_a_lattice_is_no_finer_than_asked_for_and_has_two_cells_across_the_tip(tmp_path: Path) -> None:
    seen = parse_pair(write_pair(tmp_path / "p.npz", at=(0.09, 0.08)).read_bytes(), "p")
    surface, pokes = MeasuredSurface(seen.rest, THICKNESS), [seen_poke(seen)]
    whole = spacing_for(surface, pokes, None, np.inf)
    assert whole[0] == whole[1]
    coarse = spacing_for(surface, pokes, None, 1)
    assert coarse[0] == pytest.approx(2.0 * whole[0])
    assert coarse[1] == whole[1]
    assert coarse[2] < whole[2] / 4
    assert spacing_for(surface, pokes, 0.004, np.inf)[:2] == (0.004, 0.004)
    between = spacing_for(surface, pokes, None, whole[2] - 1)
    assert whole[0] < between[0] < coarse[0]
    assert between[2] < whole[2]


def test_a_coarser_lattice_says_so_counts_its_steps_to_one_end_and_replays(
    tmp_path: Path, slow: None, capsys: Capture
) -> None:
    pair, seen = write_pair(tmp_path / "p.npz", at=(0.09, 0.08)), list[tuple[str, int, int]]()
    flags = ["--thickness-m", str(THICKNESS), "--cluster-size", "3", "--viewer", "none"]
    record = tmp_path / "run.rrd"
    assert main(["calibrate", "beta", str(pair), *flags, "--record", str(record)]) == 0
    said = capsys.readouterr()
    assert "10 mm apart; --fine spaces them 5 mm apart" in said.out + said.err
    assert main(["replay", str(record), "--viewer", "none"]) == 0
    with np.load(pair) as arrays:
        found = ds.calibrate_beta(
            dict(arrays),
            thickness_m=THICKNESS,
            progress=lambda *now: seen.append(now),  # type: ignore[arg-type]
        )
    assert main(["calibrate", "beta", str(pair), *flags, "--spacing-m", "0.01"]) == 0
    asked_for = capsys.readouterr()
    assert "--fine" not in asked_for.out + asked_for.err
    settings = found.estimate.settings
    assert settings["spacing_m"] == pytest.approx(2.0 * settings["finest_spacing_m"])  # type: ignore[operator]
    laws = [(done, total) for what, done, total in seen if what.startswith("laws")]
    assert len({total for _, total in laws}) == 1
    assert (np.diff([done for done, _ in laws]) >= 0).all()
    assert laws[-1][0] <= laws[-1][1]
    assert len(laws) > 10  # not only once for each cluster size


def test_the_finest_lattice_is_taken_where_it_is_asked_for() -> None:
    push = PushFlags(thickness_m=0.05)
    for fine, most in ((False, calibration.MOST_PARTICLES), (True, None)):
        options = calibration._layers(BetaConfig(("p.npz",), push=push, search=SearchOptions(fine=fine)))
        assert options.most_particles == most


def test_where_there_is_no_terminal_a_line_says_how_long_it_will_take(capsys: Capture, monkeypatch: Patch) -> None:
    now = iter(range(0, 10_000, 10))
    monkeypatch.setattr(common.time, "monotonic", lambda: float(next(now)))
    with common.fit_progress() as note:
        for done in range(1, 6):
            note("frames", done, 20)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("frames: ")]
    assert lines
    assert all("s left" in line for line in lines[1:])
