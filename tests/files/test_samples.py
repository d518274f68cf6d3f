"""The samples that ship: each has its name wherever what it is can be given, and is what its tool makes."""

import io
import json
import runpy
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.file_io import ending_of, resolve, sample_names, sample_path
from deformscope.files.table_file import read_table
from deformscope.rig.rig_file import load_rig
from deformscope.stages.fit.calibrate import FitOptions, Model, calibrate
from studies.reproduce.pressed_cubes import thesis_cubes
from tests.cases import slow

ROOT = Path(__file__).resolve().parents[2]
PAIR = ["calibrate", "beta", "sample:pair", "--candidates", "5", "--json", "-"]


@pytest.mark.parametrize("name", sample_names())
def test_a_sample_is_small_and_says_what_it_is(name: str) -> None:
    folder = sample_path(name)
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 1_000_000
    about = tomllib.loads((folder / "sample.toml").read_text(encoding="utf-8"))
    assert about["title"]
    assert (folder / "NOTICE").exists() or about["made_by"] in ("hand", f"python tools/samples.py {name}")


def test_a_sample_is_its_file_or_the_folder_of_its_images() -> None:
    assert sample_names() == ["cube", "pair", "poke", "press", "rig", "sponge", "squeezes", "table", "tension", "video"]
    assert (ending_of("sample:table"), ending_of("sample:rig")) == (".csv", ".toml")
    assert ending_of("sample:pair") == ending_of("sample:poke") == ending_of("sample:squeezes") == ".npz"
    assert ending_of("sample:video") == ending_of("sample:sponge") == ".mp4"
    assert resolve("sample:sponge/force.csv") == sample_path("sponge") / "force.csv"
    assert resolve("sample:tension").is_dir()
    assert resolve("sample:tension/frame_152.png") == sample_path("tension") / "frame_152.png"
    with pytest.raises(ds.InputError, match="cube, pair, poke"):
        resolve("sample:nothing")


@pytest.mark.parametrize("name", [slow("pair"), "cube", slow("poke"), "press"])
def test_a_sample_is_what_its_tool_makes(name: str) -> None:
    tool: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "samples.py"))
    with np.load(io.BytesIO(tool["MAKE"][name][1]())) as made, np.load(resolve(f"sample:{name}")) as ships:
        assert set(made) == set(ships)
        for one in made:
            if made[one].dtype.kind == "f":
                np.testing.assert_allclose(ships[one], made[one], rtol=1e-6, atol=1e-9)
            else:
                np.testing.assert_array_equal(ships[one], made[one])


@pytest.mark.slow
def test_the_sponge_is_found_and_its_modulus_is_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    """With the flags of the tutorial, and no word of where it is."""
    truth = tomllib.loads((sample_path("sponge") / "sample.toml").read_text(encoding="utf-8"))["truth"]
    flags = ["--force", "sample:sponge/force.csv", "--scale-from", "280,446,678,444=100mm", "--thickness-m", "0.04"]
    fewer = ["--candidates", "5", "--json", "-"]
    assert main(["calibrate", "beta", "sample:sponge", *flags, *fewer]) == 0
    said = capsys.readouterr()
    assert "--held bottom,contact" in said.err
    found = json.loads(said.out)
    assert found["modulus_verdict"] == "identified"
    for name in ("modulus_pa", "contact_stiffness_n_per_mm"):
        low, high = found[name]["interval"]
        assert low < truth[name] < high


@pytest.mark.slow
def test_the_sponge_is_the_finite_elements_of_its_truth() -> None:
    """Force, stiffness and scale, and each image up to what the compression takes."""
    tool: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "samples.py"))
    made = tool["sponge_seen"]()
    truth = tomllib.loads((sample_path("sponge") / "sample.toml").read_text(encoding="utf-8"))["truth"]
    for name in ("modulus_pa", "poisson", "thickness_m", "px_per_cm"):
        assert truth[name] == pytest.approx(getattr(made, name))
    assert truth["contact_stiffness_n_per_mm"] == pytest.approx(made.stiffness_n_per_mm, rel=1e-3)
    assert truth["force_offset_s"] == made.case.log.offset_s
    assert resolve("sample:sponge/force.csv").read_bytes() == tool["sponge_force"]()
    film = cv2.VideoCapture(str(resolve("sample:sponge")))
    for image in made.frames:
        read, shown = film.read()
        assert read
        assert np.abs(shown[..., ::-1].astype(float) - image).mean() < 5.0
    assert not film.read()[0]


def test_the_table_has_the_trials_of_the_squeezes() -> None:
    tool: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "samples.py"))
    table, squeezes = read_table(resolve("sample:table")), read_table(resolve("sample:squeezes"))
    assert resolve("sample:table").read_bytes() == tool["table"]()
    assert table.label.tolist() == squeezes.label.tolist()
    assert table.group.tolist() == squeezes.group.tolist()
    for name, features in table.modalities.items():
        np.testing.assert_allclose(features, squeezes.modalities[name], rtol=1e-4)


def test_the_rig_is_what_rig_new_writes_and_is_not_written_into(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["rig", "new", str(tmp_path / "rig.toml"), "--doubles"]) == 0
    assert (tmp_path / "rig.toml").read_text(encoding="utf-8") == resolve("sample:rig").read_text(encoding="utf-8")
    assert {one.double for one in load_rig("sample:rig").devices} == {True}
    assert main(["calibrate", "tip", "sample:rig"]) == 2
    assert "--no-write" in capsys.readouterr().err


def test_a_pair_by_its_name_is_a_pair(capsys: pytest.CaptureFixture[str]) -> None:
    """On the command line and in the library, fitted and poked."""
    assert main(PAIR) == 0
    found = json.loads(capsys.readouterr().out)
    fitted = ds.calibrate_beta("sample:pair", candidates=5)
    assert fitted.to_dict() == found
    assert fitted.model().stiffness
    assert ds.calibrate_beta(["sample:pair", "sample:pair"], candidates=5).name == "all pairs"
    assert main([*PAIR, "--roi", "1,2,3,4"]) == 2
    assert "no flags about images with pair files" in capsys.readouterr().err
    assert main(["calibrate", "beta", "sample:pair", "sample:tension"]) == 2
    assert "either pair files or images" in capsys.readouterr().err


def test_the_cube_identifies_theta() -> None:
    """The outside, seen with noise, has the theta of every particle of the same finite elements without noise."""
    (exact,), _ = thesis_cubes((0.25,), (6,), (0.01,))
    theta = calibrate([exact.seen], FitOptions(Model("theta", cluster_size=None, basis="quadratic", beta=0.99)))
    found = ds.calibrate_theta("sample:cube")
    assert found.verdict == "identified"
    assert found.interval[0] < theta.estimate.value < found.interval[1]


def test_the_video_has_particles_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "beta", "sample:video", "--stride", "5", "--candidates", "5", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["aee_px"] > 0.0


def test_squeezes_are_classified() -> None:
    given = ds.classify("sample:squeezes", splits=4, curve_splits=0)
    assert given.accuracy > 0.5
    assert set(given.entries()[0]["labels"]) == {"empty", "water", "yogurt", "flour", "rice"}
