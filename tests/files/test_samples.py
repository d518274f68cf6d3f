"""The samples that ship: each has its name wherever what it is can be given, and is what its tool makes."""

from __future__ import annotations

import io
import json
import runpy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.file_io import ending_of, resolve, sample_names, sample_path

ROOT = Path(__file__).resolve().parents[2]
PAIR = ["calibrate", "beta", "sample:pair", "--candidates", "5", "--json", "-"]


@pytest.mark.parametrize("name", sample_names())
def test_a_sample_is_small_and_says_what_it_is(name: str) -> None:
    folder = sample_path(name)

    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 1_000_000
    about = tomllib.loads((folder / "sample.toml").read_text(encoding="utf-8"))
    assert about["title"]
    assert (folder / "NOTICE").exists() or about["made_by"] == f"python tools/samples.py {name}"


def test_a_sample_is_its_file_or_the_folder_of_its_images() -> None:
    assert {"pair", "poke", "squeezes", "tension", "video"} <= set(sample_names())
    assert ending_of("sample:pair") == ending_of("sample:poke") == ending_of("sample:squeezes") == ".npz"
    assert ending_of("sample:video") == ".mp4"
    assert resolve("sample:tension").is_dir()
    with pytest.raises(ds.InputError, match="one of pair, poke"):
        resolve("sample:nothing")


@pytest.mark.parametrize("name", ["pair", "poke"])
def test_a_sample_is_what_its_tool_makes(name: str) -> None:
    tool: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "samples.py"))
    with np.load(io.BytesIO(tool[name]())) as made, np.load(resolve(f"sample:{name}")) as ships:
        assert set(made) == set(ships)
        for one in made:
            if made[one].dtype.kind == "f":
                np.testing.assert_allclose(ships[one], made[one], rtol=1e-6, atol=1e-9)
            else:
                np.testing.assert_array_equal(ships[one], made[one])


def test_a_pair_by_its_name_is_a_pair(capsys: pytest.CaptureFixture[str]) -> None:
    """On the command line and in the library, fitted and poked."""
    assert main(PAIR) == 0
    found = json.loads(capsys.readouterr().out)
    fitted = ds.calibrate_beta("sample:pair", candidates=5)

    assert fitted.to_dict() == found
    assert fitted.model().stiffness
    together = ds.calibrate_beta(["sample:pair", "sample:pair"], candidates=5)
    assert together.name == "all pairs"
    assert main([*PAIR, "--roi", "1,2,3,4"]) == 2
    assert "no flags about images with pair files" in capsys.readouterr().err
    assert main(["calibrate", "beta", "sample:pair", "sample:tension"]) == 2
    assert "either pair files or images" in capsys.readouterr().err


def test_the_video_has_particles_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "beta", "sample:video", "--stride", "5", "--candidates", "5", "--json", "-"]) == 0

    assert json.loads(capsys.readouterr().out)["aee_px"] > 0.0


def test_squeezes_are_classified() -> None:
    given = ds.classify("sample:squeezes", splits=4, costly_splits=0, curve_splits=0)

    assert given.accuracy > 0.5
    assert set(given.entries()[0]["labels"]) == {"empty", "water", "yogurt", "flour", "rice"}
