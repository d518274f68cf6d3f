"""`python -m studies reproduce cubes`: files, JSON and errors; what it finds is tested with the experiment."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import EXIT_INPUT
from studies.__main__ import main
from studies.reproduce import pressed_cubes as cubes
from tests.cases import Capture, Patch, one_line
from tests.cli.recorded import assert_shows

TOP = {
    *("cubes", "theta_rises", "theta_rises_to_bound", "aee_m_most", "over_grid_most", "ratio_most"),
    *("sem", "table_3_2", "seconds"),
}
FIGURES = {"figure-3.10.png", "figure-3.11.png", "resolution.png", "clusters.png"}
TABLES = {"cubes.csv", "sem.csv", "table-3.2.csv", "searches.csv"}


@pytest.fixture
def pairs(tmp_path: Path) -> list[str]:
    """Three pair files of small cubes."""
    made, _ = cubes.thesis_cubes((0.0, 0.2, 0.4), (4,), (0.02,))
    paths = []
    for cube in made:
        path = tmp_path / f"cube_nu{cube.poisson:g}.npz"
        np.savez(path, rest=cube.seen.rest, deformed=cube.seen.deformed, held=cube.seen.held, nu=cube.poisson)
        paths.append(str(path))
    return paths


@pytest.mark.slow  # kernels of quadratic clusters as lists; reproduce/test_cubes proves the numbers
def test_pairs_give_figures_tables_and_json(pairs: list[str], tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "new" / "out"
    flags = ["--out", str(out), "--jobs", "1", "--record", str(tmp_path / "r.rrd"), "--json", "-"]
    assert main(["reproduce", "cubes", "--pairs", *pairs[::-1], *flags]) == 0
    told = json.loads(capsys.readouterr().out)
    assert_shows(tmp_path / "r.rrd", pictures=3, says="theta rises with nu")
    assert told.keys() == TOP
    assert {path.name for path in out.iterdir()} == (FIGURES | TABLES) - {"resolution.png"}
    assert [cube["poisson"] for cube in told["cubes"]] == [0.0, 0.2, 0.4]
    assert told["theta_rises"] is True
    first = told["cubes"][1]
    assert first["theta"]["parameter"] == "theta"
    assert first["theta"]["settings"]["mode"] == "quadratic"
    assert first["theta"]["interval"][0] <= first["theta"]["value"] <= first["theta"]["interval"][1]
    assert first["overlapping_clusters"]["aee_m"] == pytest.approx(first["ratio"] * first["theta"]["aee_m"])
    with (out / "cubes.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["theta"]) for row in rows] == pytest.approx(
        [c["theta"]["value"] for c in told["cubes"]], rel=1e-5
    )


@pytest.mark.slow
def test_the_thesis_s_cubes_are_made_and_the_table_told(tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.setattr(cubes, "SIDES", (3, 4))
    monkeypatch.setattr(cubes, "POISSON", (0.3,))
    assert main(["reproduce", "cubes", "--out", str(tmp_path), "--jobs", "1", "--compare", "all"]) == 0
    out = capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == FIGURES | TABLES
    assert out.startswith("6 cubes\n")
    assert "theta at nu 0.3" in out
    assert "finite elements" in out


def test_none_to_compare_draws_no_clusters(pairs: list[str], tmp_path: Path) -> None:
    out, kept = tmp_path / "out", ["--json", str(tmp_path / "c.json"), "--resume", str(tmp_path / "kept.jsonl")]
    flags = ["--pairs", pairs[1], "--out", str(out), "--jobs", "1", "--compare", "none", *kept]
    assert main(["reproduce", "cubes", *flags]) == 0
    found = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))
    assert not (out / "clusters.png").exists()
    assert found["ratio_most"] is None
    assert main(["reproduce", "cubes", *flags]) == 0  # from what was kept
    assert json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["cubes"] == found["cubes"]


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--pairs", "none.npz"], "pair file"),
        (["--pairs", "none.npz", "--quick"], "--pairs or --quick"),
        (["--cluster-size", "1"], "--cluster-size of 2 or more"),
        (["--level", "1.5"], "--level between 0 and 1"),
        (["--jobs", "0"], "--jobs of 1 or more"),
        (["--out", "{file}"], "a folder that can be written to; got file exists"),
    ],
)
def test_what_cannot_be_done_is_told_in_a_line(
    flags: list[str], words: str, tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    assert main(["reproduce", "cubes", *(flag.format(file=tmp_path / "file") for flag in flags)]) == EXIT_INPUT
    assert words in one_line(capsys)
