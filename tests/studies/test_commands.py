"""`python -m studies` as one types it."""

import importlib
import json
import re
from pathlib import Path
from types import UnionType
from typing import get_args, get_type_hints

import msgspec
import numpy as np
import pytest

from deformscope.stages.poke import stiffness_field
from studies import coverage, doubt_rates, force, random_bodies, runner
from studies.__main__ import main, summaries
from studies.random_bodies import RandomBody, random_body
from tests.cases import Capture, Patch
from tests.cli.recorded import assert_shows

ROOT = Path(__file__).resolve().parents[2]


def small_body(rng: np.random.Generator, dim: int) -> RandomBody:
    while len((body := random_body(rng, dim)).rest) > 36:
        pass
    return body


@pytest.mark.slow
def test_coverage_tells_three_tables(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    monkeypatch.setattr(random_bodies, "CONDITIONS", random_bodies.CONDITIONS[-1:])
    monkeypatch.setattr(random_bodies, "NOTHING_CASES", 1)
    monkeypatch.setattr(random_bodies, "CANDIDATES", 12)
    for study in (random_bodies, doubt_rates):
        monkeypatch.setattr(study, "random_body", small_body)
    every = coverage.doubt_plan
    monkeypatch.setattr(
        coverage, "doubt_plan", lambda count, seed: [one for one in every(count, seed) if "two" in one.data]
    )
    target = tmp_path / "found.json"
    flags = ["--objects", "5", "--jobs", "1", "--json", str(target), "--out", str(tmp_path / "new")]
    flags += ["--record", str(tmp_path / "r.rrd")]
    assert main(["coverage", *flags]) == 0
    said = capsys.readouterr().out
    tables = ("hold the truth", "without information", "unseen poke", "Reasons to doubt")
    for words in (*tables, "wrong noise level", "shuffled labels"):
        assert words in said
    found = json.loads(target.read_text())
    assert {row["group"] for row in found["coverage"]} >= {"all", "2D", "beta = 0", "beta > 0.97"}
    assert all(row["cases"] == 1 for row in found["no_information"])
    assert {row["data"]: row["expected"] for row in found["reasons"]}["two betas, halves"] == "two-materials"
    assert all(row["identified"]["cases"] == 1 for row in found["reasons"])
    assert found["unseen_pokes"][0]["pokes"] == 1
    assert (tmp_path / "new" / "coverage.png").is_file()
    assert_shows(tmp_path / "r.rrd", pictures=1, says="intervals for beta")


@pytest.mark.slow
def test_coverage_of_forces_counts_what_random_slabs_say(tmp_path: Path, capsys: Capture, monkeypatch: Patch) -> None:
    monkeypatch.setattr(force, "KINDS", ("one material",))
    monkeypatch.setattr(stiffness_field, "PARTICLES", 300)
    target = tmp_path / "found.json"
    flags = ["--slabs", "1", "--scatter", "0.05", "--jobs", "1", "--json", str(target)]
    assert main(["force", *flags, "--record", str(tmp_path / "r.rrd")]) == 0
    assert "one material" in capsys.readouterr().out
    found = json.loads(target.read_text())
    assert {row["slab"] for row in found["rows"]} == {"all", "one material"}
    assert found["rows"][0]["held"]["cases"] == 12
    assert found["slabs"][0]["case"] == {
        "kind": "one material",
        "seed": 0,
        "scatter": 0.05,
        "full": False,
        "level": 0.9,
        "split": "alternate",
        "condition": "as given",
        "device": "cpu",
    }
    assert found["slabs"][0]["field"] == "uniform"
    assert_shows(tmp_path / "r.rrd", pictures=0, says="intervals of predicted forces")


@pytest.mark.parametrize("flags", [["--scatter", "1"], ["--slabs", "0"], ["--seed", "995"]])
def test_coverage_of_forces_refuses_what_cannot_be(flags: list[str], capsys: Capture) -> None:
    assert main(["force", *flags]) == 2
    assert "expected" in capsys.readouterr().err


@pytest.mark.parametrize("flags", [["--objects", "2"], ["--level", "1"], ["--jobs", "0"], ["--seed", "-1"]])
def test_coverage_refuses_what_cannot_be(flags: list[str], capsys: Capture) -> None:
    assert main(["coverage", *flags]) == 2
    assert "expected" in capsys.readouterr().err


def test_every_study_has_a_line_and_help(capsys: Capture) -> None:
    assert main([]) == 0
    listed = capsys.readouterr().out
    for name, said in summaries().items():
        assert f"  {name} " in listed
        assert len(said) > 10
        assert main([*name.split(), "--help"]) == 0
        assert f"python -m studies {name}" in capsys.readouterr().out
    assert main(["creeps"]) == 2
    assert "try: python -m studies creep" in capsys.readouterr().err


def test_every_outcome_can_be_kept_and_read_again() -> None:
    """msgspec refuses a type that it cannot read."""
    for name in summaries():
        study = importlib.import_module(f"studies.{name.replace(' ', '.')}").STUDY
        for trials in study.trials(study.options()):
            assert len(trials.cases) > 0
            json.dumps(runner._plain(trials.cases[0]))
            returned = get_type_hints(trials.try_one)["return"]
            for kind in get_args(returned) if isinstance(returned, UnionType) else (returned,):
                msgspec.inspect.type_info(kind)


def test_the_documentation_names_studies_that_exist() -> None:
    pages = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    named = {
        name
        for page in pages
        for name in re.findall(r"-m studies ((?:reproduce )?\w+)", page.read_text(encoding="utf-8"))
    }
    assert named - {"NAME", "reproduce NAME", "reproduce"} <= set(summaries())
    assert sorted(set(summaries()) - named) == []


def test_coverage_of_regions_prints_levels_and_bins(tmp_path: Path, capsys: Capture) -> None:
    target = tmp_path / "found.json"
    flags = ["--objects", "5", "--touches", "1", "--jobs", "1", "--scatter", "0.08", "--only", "scatter 8 %"]
    assert main(["regions", *flags, "--json", str(target)]) == 0
    said = capsys.readouterr().out
    assert "Levels in 90 % intervals" in said
    assert "holds the claim" in said
    found = json.loads(target.read_text())
    (row,) = found["conditions"]
    assert (row["condition"], row["objects"], len(found["explorations"])) == ("scatter 8 %", 5, 5)
    assert sum(one["cases"] for one in row["reliability"]) == 5
    assert row["levels"]["cases"] == sum(one["levels"] for one in found["explorations"])


@pytest.mark.parametrize("flags", [["--scatter", "0"], ["--only", "halves"], ["--seed", "990", "--objects", "20"]])
def test_coverage_of_regions_refuses_what_cannot_be(flags: list[str], capsys: Capture) -> None:
    assert main(["regions", *flags]) == 2
    assert "expected" in capsys.readouterr().err
