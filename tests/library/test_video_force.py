"""A force with a video: stiffness at the contact and modulus of a block whose truth is known."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deformscope as ds
from deformscope.arrays import FloatArray, ImageArray
from deformscope.runs.calibration_report import calibration_page
from tests.experiments.speckle_video import speckle_images
from tests.stages.materials.test_plane_modulus import uniaxial

WIDE, HIGH = 180, 100
ROWS, COLUMNS = 7, 13
PX_PER_CM, THICKNESS_M, MODULUS_PA, RATIO = 20.0, 0.04, 30e3, 0.3
DEPTHS = (0.03, 0.06, 0.09, 0.12)
FITTED: dict[str, Any] = {
    "roi": (0, 0, WIDE, HIGH), "grid": (5, 9), "held": ("top", "bottom"), "candidates": 12, "progress": False,
}  # fmt: skip


def force_n(depth: float) -> float:
    """Force of an even compression by a share of the height, in closed form."""
    return -uniaxial(1.0 - depth, RATIO, "stress")[1] * MODULUS_PA * THICKNESS_M * 0.01 * WIDE / PX_PER_CM


@cache
def video(depths: tuple[float, ...] = DEPTHS, shift_px: float = 0.0) -> list[ImageArray]:
    """A block, pressed evenly by shares of its height from above, its bottom on the lower edge. shift_px: of a camera
    that falls by this in each frame"""
    x, y = np.meshgrid(np.linspace(0.0, WIDE, COLUMNS), np.linspace(0.0, HIGH, ROWS))
    rest = np.column_stack([x.ravel(), y.ravel()])

    def pose(depth: float, index: int) -> FloatArray:
        across = uniaxial(1.0 - depth, RATIO, "stress")[0]
        middle = 0.5 * WIDE
        place = [middle + across * (rest[:, 0] - middle), HIGH - (1.0 - depth) * (HIGH - rest[:, 1]) - index * shift_px]
        return np.column_stack(place)

    return list(speckle_images(rest, (ROWS, COLUMNS), [pose(one, index) for index, one in enumerate(depths, 1)]))


def fit(images: Sequence[ImageArray] | None = None, **more: Any) -> ds.CalibrationResult:
    return ds.calibrate_beta(video() if images is None else images, **FITTED | more)


def scaled(**more: Any) -> dict[str, Any]:
    return {"force": f"{force_n(DEPTHS[-1]):.6g}N", "px_per_cm": PX_PER_CM, "thickness_m": THICKNESS_M} | more


@pytest.fixture(scope="module")
def found() -> ds.CalibrationResult:
    return fit(**scaled())


def test_stiffness_and_modulus_are_those_of_the_closed_form(found: ds.CalibrationResult) -> None:
    shown = found.to_dict()
    stiffness = 1e-3 * force_n(0.12) / (0.12 * 0.01 * HIGH / PX_PER_CM)
    for key, truth, share in (
        ("contact_stiffness_n_per_mm", stiffness, 0.02),
        ("modulus_pa", MODULUS_PA, 0.03),
        ("poisson", RATIO, 0.1),
    ):
        low, high = shown[key]["interval"]
        assert shown[key]["value"] == pytest.approx(truth, rel=share)
        assert low < truth < high
    assert (shown["plane"], shown["modulus_verdict"]) == ("stress", "identified")
    assert shown["force_n"]["value"] == pytest.approx(force_n(0.12), rel=1e-4)
    rows = dict(found.tables()[0].rows)
    assert rows["stiffness at the contact"].startswith("identified: ")
    assert rows["modulus"].startswith("identified: ")
    assert rows["modulus"].endswith(" in plane stress")
    assert "position alone" not in str(found)


def test_a_weight_in_grams_and_a_known_length_give_the_same(found: ds.CalibrationResult) -> None:
    grams = force_n(0.12) / 9.80665e-3
    same = fit(**scaled(force=f"{grams:.6g}g", px_per_cm=None, scale_from="20,50,120,50=50mm"))
    assert same.to_dict()["modulus_pa"]["value"] == pytest.approx(found.to_dict()["modulus_pa"]["value"], rel=1e-3)


def test_a_camera_that_moves_changes_no_stiffness(found: ds.CalibrationResult) -> None:
    moved = fit(video(shift_px=1.5), **scaled())
    for key in ("contact_stiffness_n_per_mm", "modulus_pa"):
        assert moved.to_dict()[key]["value"] == pytest.approx(found.to_dict()[key]["value"], rel=0.02)


def test_the_frame_of_the_force_is_fitted_and_later_ones_are_not_used() -> None:
    early = fit(**scaled(force=f"{force_n(DEPTHS[1]):.6g}N", force_frame=2))
    assert early.to_dict()["modulus_pa"]["value"] == pytest.approx(MODULUS_PA, rel=0.05)
    assert early.estimate.settings["frames"] == 3
    with pytest.raises(ds.InputError, match="force_frame"):
        fit(**scaled(force_frame=9))


@pytest.mark.parametrize(
    ("left_out", "said"),
    [("px_per_cm", "no scale: give --px-per-cm or --scale-from"), ("thickness_m", "modulus give --thickness-m")],
)
def test_what_is_missing_is_named(left_out: str, said: str) -> None:
    one = fit(**scaled(**{left_out: None}))
    assert said in one.estimate.stiffness_text()
    assert one.estimate.modulus is None


def test_more_uncertainty_is_a_wider_interval(found: ds.CalibrationResult) -> None:
    def width(one: ds.CalibrationResult, key: str) -> float:
        low, high = one.to_dict()[key]["interval"]
        return float(np.log(high / low))

    for key, doubtful in (("modulus_pa", {"thickness_sd": 0.1}), ("contact_stiffness_n_per_mm", {"force_sd": "1N"})):
        assert width(fit(**scaled(**doubtful)), key) > 1.3 * width(found, key)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"force": "3"}, "with its unit, such as 3N or 3g"),
        ({"force": "-3N"}, "a force above 0"),
        ({"force": "nothing.csv"}, "nothing there"),
        ({"force": "3N", "force_column": "load"}, "a log of the force"),
        ({"force": "3N", "whole_motion": True}, "whole_motion"),
        ({"force": None, "force_frame": 2}, "no force"),
        ({"px_per_cm": 20.0, "scale_from": "0,0,10,0=1mm"}, "leave one out"),
        ({"scale_from": "0,0,0,0=1mm", "px_per_cm": None}, "two places in pixels"),
        ({"thickness_m": 0.04, "force": None}, "force"),
        ({"plane_strain": True, "thickness_m": None}, "thickness_m"),
    ],
)
def test_what_contradicts_itself_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ds.InputError, match=said):
        fit(**scaled(**given))


def test_grams_or_kilograms_given_as_newtons_and_a_scale_wrong_by_ten_are_doubted() -> None:
    grams = fit(**scaled(force=f"{force_n(0.12) / 9.80665e-3:.6g}N"))
    assert any("grams" in one.text for one in grams.reasons)
    kilograms = fit(**scaled(force=f"{force_n(0.12) / 20.0:.6g}N"))
    assert any("kilograms" in one.text for one in kilograms.reasons)
    wrong = fit(**scaled(px_per_cm=10.0 * PX_PER_CM))
    assert any(one.code == "units" for one in wrong.reasons)


def test_a_video_without_motion_has_no_stiffness() -> None:
    still = fit(video((0.0, 0.0)), **scaled())
    shown = still.to_dict()
    assert {shown["verdict"], shown["stiffness_verdict"], shown["modulus_verdict"]} == {"unidentified"}


def test_without_a_part_that_stands_the_fit_is_there_and_says_why_no_modulus_is() -> None:
    alone = fit(held=("top",), **scaled())
    assert (alone.to_dict()["modulus_verdict"], alone.estimate.modulus) == ("unidentified", None)
    assert any("a still part among --held" in one.text for one in alone.reasons)


def write_log(path: Path, offset_s: float, rate_hz: float, seconds: float = 8.0, unit: str = "N") -> FloatArray:
    """A log of the press at a rate, whose clock shows offset_s at the first frame. Returns depth over the frames."""
    time_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    depth = 0.12 * np.clip((time_s - offset_s - 0.5) / 1.0, 0.0, 1.0)
    factor = {"N": 1.0, "g": 1.0 / 9.80665e-3}[unit]
    rows = [
        f"{t:.4f},{factor * (force_n(d) + 0.002 * (i % 3 - 1)) + 5.0:.5f}"
        for i, (t, d) in enumerate(zip(time_s, depth, strict=True))
    ]
    path.write_text(f"time [s],weight [{unit}]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return depth


FPS = 10.0


def ramp() -> list[ImageArray]:
    return video(tuple(0.12 * float(np.clip((t - 0.5) / 1.0, 0.0, 1.0)) for t in np.arange(1, 19) / FPS))


def assert_offset_is_found(one: ds.CalibrationResult, offset_s: float, rate_hz: float) -> None:
    shown = one.to_dict()
    low, high = shown["force_offset_s"]["interval"]
    assert shown["force_offset_s"]["value"] == pytest.approx(offset_s, abs=0.5 / FPS)
    assert low - 1.0 / rate_hz <= offset_s <= high + 1.0 / rate_hz
    assert shown["modulus_pa"]["value"] == pytest.approx(MODULUS_PA, rel=0.05)
    curve = shown["force_curve"]
    assert len(curve["depth_m"]) == len(curve["force_n"]) > 10
    assert curve["force_n"][-1] == pytest.approx(force_n(0.12), rel=0.05)


def test_a_log_of_the_same_clock_has_no_offset(tmp_path: Path) -> None:
    write_log(tmp_path / "scale.csv", 0.0, 50.0)
    one = fit(ramp(), **scaled(force=str(tmp_path / "scale.csv"), fps=FPS))
    assert_offset_is_found(one, 0.0, 50.0)
    page = calibration_page([one.shown], seed=0, settings=one.settings)
    assert "the force over the depth of the contact" in page


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"force_offset_s": 30.0}, "has the fitted frame"),
        ({"force_column": "mass"}, "one column with the force"),
        ({"force_unit": "lb"}, "the unit of the force"),
    ],
)
def test_a_log_that_does_not_fit_is_refused(tmp_path: Path, more: dict[str, Any], said: str) -> None:
    write_log(tmp_path / "scale.csv", 0.0, 50.0)
    with pytest.raises(ds.InputError, match=said):
        fit(ramp()[:8], **scaled(force=str(tmp_path / "scale.csv"), fps=FPS, **more))


@pytest.mark.parametrize("log", ["later", "constant"])
def test_a_log_without_the_push_is_refused(tmp_path: Path, log: str) -> None:
    write_log(tmp_path / "later.csv", 20.0, 50.0)
    rows = [f"{0.1 * index:.1f},5.0" for index in range(30)]
    (tmp_path / "constant.csv").write_text("\n".join(["time [s],weight [g]", *rows]) + "\n")
    with pytest.raises(ds.InputError, match="force log"):
        fit(ramp()[:8], **scaled(force=str(tmp_path / f"{log}.csv"), fps=FPS))


def test_a_log_in_grams_finds_its_offset_and_the_replay_of_its_recording_has_the_same_numbers(tmp_path: Path) -> None:
    write_log(tmp_path / "scale.csv", 3.3, 23.0, unit="g")
    path = tmp_path / "run.rrd"
    first = fit(ramp(), **scaled(force=str(tmp_path / "scale.csv"), fps=FPS, record=path))
    assert_offset_is_found(first, 3.3, 23.0)
    again = ds.replay(path)
    assert "identical" in again.verdict
    assert again.to_dict()["modulus_pa"] == first.to_dict()["modulus_pa"]


def test_the_particles_are_there_as_a_pair_and_predict_takes_the_model(
    found: ds.CalibrationResult, tmp_path: Path
) -> None:
    assert found.pair is not None
    seen, model = found.pair
    assert seen.rest.shape == seen.deformed.shape == (45, 2)
    assert (seen.unit, model.parameter) == ("px", "beta")
    found.save(tmp_path / "block.npz")
    depth_m = 0.06 * 0.01 * HIGH / PX_PER_CM
    poked = ds.predict(
        tmp_path / "block.npz", at=(0.5 * 0.01 * WIDE / PX_PER_CM, 0.0), depth_m=depth_m, tip="flat", size_m=(0.03,)
    )
    assert poked.to_dict()["force_n"] > 0.0


def test_the_fitted_particles_are_a_pair_file(found: ds.CalibrationResult, tmp_path: Path) -> None:
    found.save_pair(tmp_path / "pair.npz")
    again = ds.calibrate_beta(tmp_path / "pair.npz", candidates=12, progress=False)
    assert again.value == pytest.approx(found.value, abs=0.02)
    stiffness = again.to_dict()["contact_stiffness_n_per_mm"]["value"]
    assert stiffness > found.to_dict()["contact_stiffness_n_per_mm"]["value"]  # the particles' depth, not the faces'
    with pytest.raises(ds.InputError, match="scale for a pair file"):
        fit(**scaled(px_per_cm=None)).save_pair(tmp_path / "none.npz")


def test_every_particle_of_every_frame_is_in_a_table(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    one = fit(**scaled(record=path))
    table = ds.open_recording(path).table("particles/observed")
    assert table.num_rows == 5
    last = table.slice(4).to_pylist()[0]
    rest, observed, simulated, residual = (
        np.reshape(last[name], (45, 2)) for name in ("rest", "observed", "simulated", "residual")
    )
    assert one.pair is not None
    np.testing.assert_allclose(rest, one.pair[0].rest)
    np.testing.assert_allclose(observed, one.pair[0].deformed)
    np.testing.assert_allclose(observed - simulated, residual)
    strain = np.reshape(last["strain"], (45, 2, 2))
    across = uniaxial(0.88, RATIO, "stress")[0]
    np.testing.assert_allclose(np.median(strain[:, 1, 1]), 0.5 * (0.88**2 - 1.0), atol=2e-3)
    np.testing.assert_allclose(np.median(strain[:, 0, 0]), 0.5 * (across**2 - 1.0), atol=2e-3)
    assert sum(last["held"]) == 18
    assert last["unit"] == "px"
    exported = ds.export(path, to="csv", out=tmp_path / "tables")
    assert any("particles" in str(name) for name in (tmp_path / "tables").rglob("*.csv")), exported
