"""`python -m studies reproduce foams` from the command line to its figures."""

import csv
import json
from pathlib import Path

import pytest

from deformscope.cli import main as deformscope_main
from studies.__main__ import main

FIGURES = ("figure-3.14.png", "figure-3.14-clamp-held.png", "stiffness.png", "particles.png")


def test_what_it_cannot_use_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["reproduce", "foams", "--out", str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.startswith("deformscope: error: expected a folder that can be written to")
    assert main(["reproduce", "foams", "--seed", "-1"]) == 2
    assert "--seed of 0 or more" in capsys.readouterr().err


def read_png(path: Path) -> tuple[int, int]:
    import cv2

    shape: tuple[int, ...] = cv2.imread(str(path)).shape
    return shape[0], shape[1]


def run(tmp_path: Path, *flags: str) -> dict:
    out, target = tmp_path / "new" / "foams", tmp_path / "foams.json"
    assert main(["reproduce", "foams", "--out", str(out), "--json", str(target), *flags]) == 0
    told = json.loads(target.read_text())
    rows = list(csv.DictReader((out / "foams.csv").read_text().splitlines()))
    fits = [(foam["name"], fit) for foam in told["foams"] for fit in foam["fits"]]
    assert len(rows) == len(fits)
    for row, (name, fit) in zip(rows, fits, strict=True):
        assert f"{float(row['density_kg_m3']):g}/{float(row['hardness_n']):g}" == name
        assert float(row["beta"]) == pytest.approx(fit["value"], abs=1e-5)
        assert float(row["aee_mm"]) == pytest.approx(1e3 * fit["aee_m"], abs=1e-4)
        assert float(row["k_n_per_m"]) == pytest.approx(fit["stiffness_n_per_m"]["value"], rel=1e-4)
        assert fit["interval"][0] <= fit["value"] <= fit["interval"][1]
        assert fit["converged"]
    assert sorted(map(str, told["figures"])) == sorted(str(path) for path in out.glob("*.png"))
    assert all(min(read_png(Path(path))) > 300 for path in told["figures"])
    return told


@pytest.mark.slow
def test_quick_run_draws_and_tells_two_foams(tmp_path: Path) -> None:
    told = run(tmp_path, "--quick", "--keep-images")
    assert [foam["name"] for foam in told["foams"]] == ["24/80", "50/230"]
    assert {Path(path).name for path in told["figures"]} == set(FIGURES)
    # what a user gets from the images with the ordinary command
    images, target = tmp_path / "new" / "foams" / "images" / "50-230", tmp_path / "again.json"
    flags = "--roi 30,50,750,350 --grid 7x15 --contact 330,50,150,50 --px-per-cm 50 --cluster-size 2 --viewer none"
    assert deformscope_main(["calibrate", "beta", str(images), *flags.split(), "--json", str(target)]) == 0
    again = json.loads(target.read_text())
    wanted = ("flow", "clamp", 2)
    fit = next(f for f in told["foams"][1]["fits"] if (f["source"], f["held"], f["cluster_size"]) == wanted)
    assert (again["value"], again["interval"]) == (fit["value"], fit["interval"])


@pytest.mark.slow
def test_whole_experiment_tells_stiffness_by_force_alone(tmp_path: Path) -> None:
    told = run(tmp_path)
    assert {Path(path).name for path in told["figures"]} == {*FIGURES, "one-change.png"}
    assert len(told["trends"]) == 12
    assert all(foam["lost"] == 0 for foam in told["foams"])
    by_name = {f"{one['changed']} {one['foam'].get(one['changed'])}": one for one in told["one_change"]}
    soft, firm = by_name["hardness 80.0"], by_name["hardness 230.0"]
    assert firm["force_n"] / soft["force_n"] == pytest.approx(230 / 80, rel=1e-4)
    for one, two in zip(soft["fits"], firm["fits"], strict=True):
        assert one["value"] == pytest.approx(two["value"], abs=1e-3)
    # k goes as the force does: the ratios to the softest foam agree though its beta is loose
    for size in (2, 4, 5):
        k = [
            fit["stiffness_n_per_m"]["value"]
            for foam in told["foams"]
            for fit in foam["fits"]
            if (fit["source"], fit["held"], fit["cluster_size"]) == ("flow", "clamp", size)
        ]
        force = [foam["force_n"][-1] for foam in told["foams"]]
        assert [v / k[0] for v in k] == pytest.approx([v / force[0] for v in force], rel=0.15)
