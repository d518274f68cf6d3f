"""`calibrate beta --thickness-m --save` and `predict`, as a user runs them."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from deformscope.cli import main
from deformscope.config import parse_poke, parse_pokes
from deformscope.lab import slab
from tests.cases import Capture, Patch
from tests.stages.pokes import SPACING, STIFFNESS, THICKNESS, poked


def write_pair(path: Path, **options: object) -> Path:
    seen = poked(**options)  # type: ignore[arg-type]
    np.savez(path, rest=seen.rest, deformed=seen.deformed, held=seen.held, contact=seen.contact, force_n=seen.force_n)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair, a model fitted to it, and its JSON."""
    made = tmp_path_factory.mktemp("pokes")
    write_pair(made / "poke.npz", at=(0.09, 0.08))
    write_pair(made / "unseen.npz", at=(0.11, 0.07), side=0.04, depth=0.001)
    flags = ["--thickness-m", str(THICKNESS), "--spacing-m", str(SPACING), "--cluster-size", "3", "--viewer", "none"]
    args = ["calibrate", "beta", str(made / "poke.npz"), *flags, "--save", str(made / "model.npz")]
    assert main([*args, "--record", str(made / "run.rrd"), "--json", str(made / "fit.json")]) == 0
    return made


def test_the_estimate_is_the_public_one_with_the_pokes_beside(folder: Path) -> None:
    told = json.loads((folder / "fit.json").read_text())
    assert told["parameter"] == "beta"
    assert told["interval"][0] <= told["value"] <= told["interval"][1]
    assert told["stiffness_n_per_m"]["value"] == pytest.approx(STIFFNESS, rel=0.02)
    assert told["model"] == str(folder / "model.npz")
    (poke,) = told["pokes"]
    assert poke["xy_m"] == pytest.approx([0.09, 0.08])
    assert poke["surface_error"] < 0.01
    assert [one["cluster_size"] for one in told["tried"]] == [3]


def test_a_poke_is_predicted_with_particles_and_force(folder: Path, capsys: Capture) -> None:
    out, picture = folder / "out.npz", folder / "dents.png"
    poke = "at=0.1,0.08 tip=flat size=0.04x0.02 force=1; at=0.08,0.08 depth=0.001"
    flags = ["--poke", poke, "--out", str(out), "--picture", str(picture), "--json", "-"]
    assert main(["predict", str(folder / "model.npz"), *flags]) == 0
    first, second = json.loads(capsys.readouterr().out)["predictions"]
    assert first["force_n"] == pytest.approx(1.0, rel=5e-3)
    assert first["force_interval_n"][0] < 1.0 < first["force_interval_n"][1]
    assert first["poke"]["size_m"] == [0.04, 0.02]
    assert second["depth_m"] == 0.001
    assert second["poke"]["tip"] == "flat"
    rest, deformed = (np.array(first["surface"][name]) for name in ("rest", "deformed"))
    assert deformed[:, 2].min() == pytest.approx(THICKNESS - first["depth_m"], abs=1e-6)
    assert rest.shape == deformed.shape
    with np.load(out) as file:
        np.testing.assert_allclose(file["rest_0"][file["surface_0"]], rest)
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_nonsense_is_refused_and_what_is_beyond_the_fit_is_said(folder: Path, capsys: Capture) -> None:
    model = str(folder / "model.npz")
    for poke, said in (
        ("at=0.09,0.08 depth=3", "try: depths are in metres"),
        ("at=0.09,0.08 force=500", "got 500 N, which would press the tip through"),
        ("at=0.09,0.08 tip=flat size=30x30 depth=0.002", "a tip in metres"),
    ):
        assert main(["predict", model, "--poke", poke]) == 2
        refusal = capsys.readouterr().err
        assert said in refusal
        assert len(refusal.splitlines()) == 1
    assert main(["predict", model, "--poke", "at=0.09,0.08 depth=0.004"]) == 0
    assert "BEYOND what was fitted: 4 mm deep, fitted to 2 mm" in capsys.readouterr().out
    assert main(["predict", model, "--poke", "at=0.09,0.08 depth=0.002", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["predictions"][0]["extrapolated"] == []


def test_a_range_that_ends_close_above_beta_is_fitted(folder: Path, capsys: Capture) -> None:
    """The ends of the range are next to the best value on both sides."""
    flags = ["--thickness-m", str(THICKNESS), "--spacing-m", str(SPACING), "--cluster-size", "3", "--viewer", "none"]
    args = ["calibrate", "beta", str(folder / "poke.npz"), *flags, "--theta", "0.7", "--json", "-"]
    assert main([*args, "--beta-range", "0.3,0.5"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["value"] == pytest.approx(0.45, abs=0.03)
    assert told["bounds"] == [0.3, 0.5]
    assert told["explained"] > 0.99


def test_pokes_in_other_units_are_refused(folder: Path, capsys: Capture) -> None:
    with np.load(folder / "poke.npz") as file:
        found = dict(file)
    flags = ["--viewer", "none"]
    for name, change, said in (
        ("mm", {"rest": 1e3 * found["rest"], "deformed": 1e3 * found["deformed"]}, "expected positions in metres"),
        ("mixed", {"deformed": 1e3 * found["deformed"]}, "in the unit of rest"),
    ):
        np.savez(folder / f"{name}.npz", **(found | change))
        assert main(["calibrate", "beta", str(folder / f"{name}.npz"), "--thickness-m", "0.03", *flags]) == 2
        assert said in capsys.readouterr().err
    assert main(["calibrate", "beta", str(folder / "poke.npz"), "--thickness-m", "30", *flags]) == 2
    assert "a --thickness-m below 1 m; got 30" in capsys.readouterr().err
    assert main(["calibrate", "beta", str(folder / "poke.npz"), "--thickness-m", "0.001", *flags]) == 2
    assert "less deep than the 1 mm" in capsys.readouterr().err


def test_points_of_the_users_own_are_told_too(folder: Path, capsys: Capture) -> None:
    points = np.array([[0.09, 0.08, THICKNESS], [0.123, 0.081, THICKNESS]])
    np.savez(folder / "points.npz", points=points)
    flags = ["--poke", "at=0.09,0.08 depth=0.002", "--points", str(folder / "points.npz"), "--json", "-"]
    assert main(["predict", str(folder / "model.npz"), *flags]) == 0
    told = json.loads(capsys.readouterr().out)["predictions"][0]["points"]
    np.testing.assert_allclose(told["rest"], points)
    assert told["deformed"][0][2] == pytest.approx(THICKNESS - 0.002, abs=1e-6)
    assert 0.0 < THICKNESS - told["deformed"][1][2] < 0.001


@pytest.mark.parametrize("finest_m", [0.01, pytest.param(None, marks=pytest.mark.slow)])
def test_an_unseen_poke_is_compared_with_what_else_one_might_take(
    finest_m: float | None, folder: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    """finest_m: of the finite elements' mesh, None = as users get it"""
    monkeypatch.setattr("deformscope.runs.prediction.press", partial(slab.press, finest=finest_m))
    unseen = str(folder / "unseen.npz")
    assert main(["predict", str(folder / "model.npz"), "--against", unseen, unseen, "--json", "-"]) == 0
    printed = capsys.readouterr()
    told, again = json.loads(printed.out)["against"]
    assert told == again
    scores = {one["method"]: one for one in told["scores"]}
    assert list(scores) == ["MSM", "rigid", "half-space", "finite elements"]
    assert scores["MSM"]["surface_error"] < 0.02
    assert abs(scores["MSM"]["force_error"]) < 0.03
    assert scores["rigid"]["force"] is None
    assert scores["rigid"]["surface_error"] > 0.3
    low, high = told["force_interval_n"]
    assert json.loads(printed.out)["against_together"] == {
        "pokes": 2,
        "surface_error": pytest.approx(scores["MSM"]["surface_error"]),
        "forces": 2,
        "force_error": pytest.approx(abs(scores["MSM"]["force_error"])),
        "held": 2,
        "width": pytest.approx((high - low) / told["force_n"]),
    }


def test_a_recording_of_pokes_replays_to_the_same_numbers(folder: Path, capsys: Capture) -> None:
    assert main(["replay", str(folder / "run.rrd"), "--viewer", "none"]) == 0
    assert "replay: " in capsys.readouterr().err


def test_an_existing_model_is_kept_unless_told(folder: Path, capsys: Capture) -> None:
    before = (folder / "model.npz").read_bytes()
    flags = ["--thickness-m", str(THICKNESS), "--save", str(folder / "model.npz"), "--viewer", "none"]
    assert main(["calibrate", "beta", str(folder / "poke.npz"), *flags]) != 0
    assert "--overwrite" in capsys.readouterr().err
    assert (folder / "model.npz").read_bytes() == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("at=0.1", "one of depth= and force="),
        ("at=0.1,0.2 depth=0.1 force=1", "one of depth= and force="),
        ("at=0.1,0.2 depth=-1", "above 0"),
        ("at=0.1,x depth=1", "for example"),
        ("place=0.1,0.2 depth=1", "expected a poke"),
        ("at=0.1,0.2 tip=cone size=0.1 depth=1", "tip=sphere"),
        ("at=0.1,0.2 tip=disc depth=1", "size= with tip"),
        ("at=0.1,0.2 at=0.1,0.2 depth=1", "expected a poke"),
    ],
)
def test_a_poke_that_cannot_be_read_says_how_one_looks(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_poke(text)


def test_several_pokes_stand_behind_one_flag() -> None:
    first, second = parse_pokes("at=0.1,0.2 depth=0.01; at=0.3,0.2 tip=sphere size=0.02 force=3")
    assert first.at == (0.1, 0.2)
    assert (second.tip, second.size, second.force) == ("sphere", (0.02,), 3.0)
    assert parse_pokes(str(second)) == (second,)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["MODEL"], "a --poke or pokes"),
        (["MODEL", "--poke", "at=0.1 depth=0.1"], "at= with 2 or 3 coordinates"),
        (["MODEL", "--poke", "at=5,5 depth=0.001"], "a place within"),
        (["PAIR", "--poke", "at=0.1,0.1 depth=0.001"], "a pair file"),
        (["MODEL", "--against", "NOTHING"], "a pair file (.npz)"),
    ],
)
def test_mistakes_are_told_in_one_line(folder: Path, capsys: Capture, args: list[str], said: str) -> None:
    names = {"MODEL": folder / "model.npz", "PAIR": folder / "poke.npz", "NOTHING": folder / "nothing.npz"}
    assert main(["predict", *[str(names.get(one, one)) for one in args]]) != 0
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error
