"""`deformscope simulate`, as a user runs it: with a stand-in for the simulator, and with MuJoCo where there is one."""

import json
import os
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from scipy.spatial import cKDTree

import deformscope as ds
from deformscope.arrays import FloatArray
from deformscope.cli import main
from deformscope.files.model_file import load_model
from deformscope.files.pairs import parse_pair
from deformscope.lab.elasticity import ElasticBox
from deformscope.log.layout import EXPLORATION, ExplorationLayout
from deformscope.plain import Json
from deformscope.recording.items import read_results
from deformscope.recording.recorder import Recorder
from deformscope.runs.simulation import SimulationResult
from deformscope.session import Moment, Step
from deformscope.simulators.body_files import write_body
from deformscope.simulators.target_process import target_process
from deformscope.stages.map.exploration import MapEstimate, SurfaceEstimate, TouchEstimate
from deformscope.stages.poke.fitted import predict_seen
from deformscope.stages.poke.poke_fit import seen_poke
from deformscope.stages.simulate.slab_mesh import slab_mesh
from deformscope.stages.simulate.target_fit import TargetParameters
from tests.cases import Capture, Patch
from tests.log.test_log import values
from tests.stages.pokes import SPACING, THICKNESS, poked

STAND_IN = Path(__file__).with_name("fake_target.py")
WITH_TARGETS = os.environ.get("DEFORMSCOPE_TARGETS_PYTHON", sys.executable)
"""An interpreter that may have MuJoCo."""
SHIPPED = Path(__file__).resolve().parents[2] / "recordings" / "explore.rrd"
QUIET = ("--viewer", "none")


def has(name: str) -> bool:
    return not subprocess.run([WITH_TARGETS, "-c", f"import {name}"], capture_output=True, check=False).returncode


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four pokes, a model fitted to the first, and an interpreter that runs the stand-in."""
    made = tmp_path_factory.mktemp("simulated")
    for number, (at, depth) in enumerate((((0.09, 0.08), 2e-3), ((0.10, 0.08), 1e-3), ((0.08, 0.07), 3e-3))):
        seen = poked(at=at, depth=depth)
        arrays = {"rest": seen.rest, "deformed": seen.deformed, "held": seen.held, "contact": seen.contact}
        np.savez(made / f"poke{number}.npz", **arrays, force_n=seen.force_n)  # type: ignore[arg-type]
        np.savez(made / f"noforce{number}.npz", **arrays)  # type: ignore[arg-type]
    flags = ["--thickness-m", str(THICKNESS), "--spacing-m", str(SPACING), "--cluster-size", "3", *QUIET]
    assert main(["calibrate", "beta", str(made / "poke0.npz"), *flags, "--save", str(made / "model.npz")]) == 0
    script = made / "python"
    script.write_text(f"#!/bin/sh\nexec {shlex.quote(sys.executable)} {shlex.quote(str(STAND_IN))}\n")
    script.chmod(0o755)
    return made


def command(folder: Path, *more: str, out: str = "body", target: str = "mujoco") -> list[str]:
    pokes = [str(folder / f"poke{number}.npz") for number in range(3)]
    flags = ["--in", target, "--python", str(folder / "python"), "--vertices", "400", *QUIET]
    return ["simulate", str(folder / "model.npz"), *flags, "--out", str(folder / out), "--against", *pokes, *more]


def test_the_needed_modulus_is_fitted_and_pokes_are_held_out(folder: Path, capsys: Capture) -> None:
    """The stand-in answers with .8 of a column's stiffness: the fit must find force_n of the fitted pokes."""
    record = folder / "run.rrd"
    assert main(command(folder, "--json", "-", "--record", str(record))) == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["version"] == "0.0.1"
    assert "0.0.1 was not tried" in said.err
    fitted = [one for one in told["pokes"] if not one["held_out"]]
    assert len(fitted) == 2
    area = fitted[0]["size_m"][0] * fitted[0]["size_m"][1]
    stiffness = [one["force_n"][0] / one["depth_m"][0] for one in fitted]
    needed = np.sqrt(np.prod(stiffness)) * 0.03 / area / 0.8
    assert told["needed"]["young_pa"] == pytest.approx(needed, rel=0.05)
    assert told["determined"] == {"young": True, "poisson": False, "contact": False}
    assert abs(told["held_out"]["force_error"]) < 0.2
    assert ds.verify(record).ok
    body = ET.parse(folder / "body" / "slab.xml").getroot()
    elasticity = body.find("deformable/flex/elasticity")
    assert elasticity is not None
    assert float(elasticity.attrib["young"]) == pytest.approx(told["needed"]["young_pa"], rel=1e-5)


def test_measured_msm_and_target_lie_in_one_view(folder: Path) -> None:
    """In their colours, for each poke at the points that were measured; the stand-in moves vertices near the tip's axis
    straight down, by the depth."""
    record = folder / "surfaces.rrd"
    assert main(command(folder, "--record", str(record), "--overwrite")) == 0
    fitted = load_model(folder / "model.npz")
    for frame in range(3):
        seen = seen_poke(parse_pair((folder / f"poke{frame}.npz").read_bytes(), folder / f"poke{frame}.npz"))
        found, tint = {}, {}
        for name in ("measured", "MSM", "mujoco"):
            entity = f"/found/body/1/{name}"
            found[name] = np.array(values(record, entity, "Points3D:positions", frame))
            tint[name] = values(record, entity, "Points3D:colors", frame)
            scale = np.array(values(record, entity, "Transform3D:scale", frame)[0])
            assert scale[:2].tolist() == [1.0, 1.0]
        assert [tint[name][0] >> 8 for name in found] == [0x286EFF, 0xEB2D2D, 0x2A9D4A]
        away, row = cKDTree(seen.points + seen.moved).query(found["measured"])
        assert away.max() < 1e-6
        assert len(row) > 20
        points = seen.points[row]
        np.testing.assert_allclose(found["MSM"], points + predict_seen(fitted, seen)[1][row], atol=1e-6)
        np.testing.assert_allclose(found["mujoco"][:, :2], points[:, :2], atol=1e-6)
        vertices = np.array(values(record, "/found/body/0", "Points3D:positions", frame))
        across = np.unique(vertices[:, 0])
        tops = np.array([vertices[vertices[:, 0] == x, 2].max() for x in across])
        sinks = tops.max() - tops
        assert sinks.max() == pytest.approx(seen.depth, rel=1e-4)
        sunk = points[:, 2] - found["mujoco"][:, 2]
        np.testing.assert_allclose(sunk, np.interp(points[:, 0], across, sinks), atol=1e-6)
        said = values(record, "/found/body/1/legend/label", "Points3D:labels", frame)
        assert said == ["measured", "MSM", "mujoco"]
        drawn = values(record, "/found/body/1/legend/heights/label", "Points3D:labels", frame)
        assert drawn == [f"heights drawn {scale[2]:g} times"]


def test_the_meshes_for_others_hold_the_body_and_its_fields(folder: Path) -> None:
    found = ds.simulate(
        folder / "model.npz",
        out=folder / "python-body",
        target="mujoco",
        python=folder / "python",
        vertices=400,
        held_out=1,
        against=[folder / f"poke{number}.npz" for number in range(3)],
    )
    assert isinstance(found, SimulationResult)
    assert found.modulus_pa > 0.0
    assert "modulus needed" in str(found)
    piece = ET.parse(folder / "python-body" / "slab.vtu").getroot().find("UnstructuredGrid/Piece")
    assert piece is not None
    arrays = {one.attrib["Name"]: np.array((one.text or "").split(), np.float64) for one in piece.iter("DataArray")}
    count = int(piece.attrib["NumberOfPoints"])
    np.testing.assert_allclose(arrays["points"].reshape(-1, 3), found.mesh.vertices, rtol=1e-6)
    assert len(arrays["displacement_m"]) == 3 * count
    assert len(arrays["connectivity"]) == 4 * int(piece.attrib["NumberOfCells"])
    np.testing.assert_allclose(arrays["young_pa"], found.modulus_pa, rtol=1e-6)
    lines = (folder / "python-body" / "slab.obj").read_text().splitlines()
    assert sum(one.startswith("v ") for one in lines) == count
    corners = [[int(one) for one in line.split()[1:]] for line in lines if line.startswith("f ")]
    assert np.min(corners) == 1


def test_a_recording_has_its_own_pokes(folder: Path, capsys: Capture) -> None:
    """Each touch at three depths, and the surface around it in heights alone."""
    flags = ["--in", "mujoco", "--python", str(folder / "python"), "--tip", "sphere:0.02", *QUIET]
    args = ["simulate", str(SHIPPED), *flags, "--out", str(folder / "touched"), "--json", "-"]
    assert main([*args, "--vertices", "400"]) == 2
    assert "0.7 of the tip's width" in capsys.readouterr().err
    assert main(args) == 0
    told = json.loads(capsys.readouterr().out)
    touches = [row.item for row in read_results(SHIPPED, (TouchEstimate,))]
    assert [one["name"] for one in told["pokes"]] == [f"touch {one.number}" for one in touches]
    for poke, touch in zip(told["pokes"], touches, strict=True):
        assert poke["depth_m"][-1] == pytest.approx(touch.depth_m)
        assert poke["force_n"][-1] == pytest.approx(touch.peak_force_n, rel=0.02)
        assert poke["msm_force_error"] is None
    assert told["measured"]["young_pa"] == pytest.approx(np.mean([one.modulus_pa for one in touches]), rel=0.1)


@pytest.mark.parametrize("tip", [[], ["--tip", "sphere:0.02"]])
def test_the_recording_of_a_sheet_is_refused_in_one_line(folder: Path, tip: list[str], capsys: Capture) -> None:
    """Whether in the plane or of a poke of a surface, and before a flag is missed: a layer has no thickness."""
    sheet = np.stack(np.meshgrid(np.linspace(0.0, 0.1, 9), np.linspace(0.0, 0.05, 5)), -1).reshape(-1, 2)
    ends = np.flatnonzero(np.isin(sheet[:, 0], (0.0, 0.1)))
    np.savez(folder / "sheet.npz", rest=sheet, deformed=sheet * (1.05, 1.0), held=ends)
    slab = ["--thickness-m", str(THICKNESS), "--spacing-m", str(SPACING), "--cluster-size", "3"]
    for pair, flags in (("sheet", []), ("poke0", slab)):
        record = folder / f"{pair}-recorded.rrd"
        fit = ["calibrate", "beta", str(folder / f"{pair}.npz"), *flags, *QUIET, "--record", str(record), "--overwrite"]
        assert main(fit) == 0
        capsys.readouterr()
        assert main(["simulate", str(record), "--in", "mujoco", "--out", str(folder / "refused"), *tip, *QUIET]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert (
            "got a sheet, whose force shows modulus times thickness, not each | try: a block's pair; of pokes" in line
        )
    assert main(["simulate", str(SHIPPED), "--in", "mujoco", "--out", str(folder / "refused"), *QUIET]) == 2
    assert "--tip with a recording" in capsys.readouterr().err


def recorded_block(path: Path, rest: FloatArray, deformed: FloatArray, force_n: float | None) -> Path:
    """The recording of a fit to a block's pair, whose lowest and highest particles are held."""
    shape = [len(np.unique(rest[:, at].round(6))) for at in range(3)]
    held = np.flatnonzero(np.isin(rest[:, 2], (rest[:, 2].min(), rest[:, 2].max())))
    upper = np.flatnonzero(rest[:, 2] == rest[:, 2].max())
    force = {} if force_n is None else {"force_n": force_n, "contact": upper}
    arrays = {"rest": rest, "deformed": deformed, "held": held, "shape": np.array(shape), **force}
    np.savez(path.with_suffix(".npz"), **arrays)  # type: ignore[arg-type]  # numpy's stub
    record = path.with_suffix(".rrd")
    fit = ["calibrate", "beta", str(path.with_suffix(".npz")), *QUIET, "--record", str(record), "--overwrite"]
    assert main(fit) == 0
    return record


def block(shape: tuple[int, int, int] = (4, 3, 5)) -> FloatArray:
    return np.stack(np.meshgrid(*(0.01 * np.arange(one) for one in shape), indexing="ij"), -1).reshape(-1, 3)


@pytest.mark.parametrize("force_n", [3.0, None])
def test_the_block_of_a_recorded_pair_is_held_as_it_was(
    folder: Path, force_n: float | None, tmp_path: Path, capsys: Capture
) -> None:
    """The stand-in raises free particles by Poisson's ratio, and resists by the modulus: those of the pair are found.
    Without a force there is no modulus, and no scene."""
    rest = block()
    moved = np.zeros_like(rest)
    upper = rest[:, 2] == rest[:, 2].max()
    moved[upper] = 0.001, 0.0, 0.002
    moved[(rest[:, 2] > 0.0) & ~upper, 2] = 0.01 * 0.2
    record, out = recorded_block(tmp_path / "block", rest, rest + moved, force_n), tmp_path / "out"
    capsys.readouterr()
    flags = ["--python", str(folder / "python"), "--out", str(out), *QUIET, "--record", str(tmp_path / "held.rrd")]
    assert main(["simulate", str(record), "--in", "mujoco", *flags, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["needed"]["poisson"] == pytest.approx(0.2, abs=0.01)
    assert told["distance_m"] < 2e-4
    assert told["msm_distance_m"][0] > 0.0
    points = np.array(values(tmp_path / "held.rrd", "/found/body/0", "Points3D:positions", 0))
    np.testing.assert_allclose(points[upper], (rest + moved)[upper], atol=1e-6)
    fields = {one.attrib["Name"]: one.text or "" for one in ET.parse(out / "slab.vtu").getroot().iter("DataArray")}
    if force_n is None:
        assert told["needed"]["young_pa"] is None
        assert "young_pa" not in fields
        assert not (out / "slab.xml").exists()
        assert (out / "slab.obj").exists()
        return
    needed = force_n / (1e-3 * np.linalg.norm(moved[upper].sum(axis=0)))
    assert told["needed"]["young_pa"] == pytest.approx(needed, rel=1e-6)
    assert float(fields["young_pa"].split()[0]) == pytest.approx(needed, rel=1e-6)
    scene = ET.parse(out / "slab.xml").getroot()
    elasticity = scene.find("deformable/flex/elasticity")
    assert elasticity is not None
    assert float(elasticity.attrib["young"]) == pytest.approx(needed, rel=1e-5)
    assert float(elasticity.attrib["poisson"]) == pytest.approx(told["needed"]["poisson"], rel=1e-5)
    pinned = [bool(one.attrib.get("mocap")) for one in scene.findall("worldbody/body")]
    assert pinned == (upper | (rest[:, 2] == 0.0)).tolist()


def test_a_block_for_newton_is_refused_in_one_line(tmp_path: Path, capsys: Capture) -> None:
    rest = block()
    deformed = rest * (1.0, 1.0, 1.02)
    record = recorded_block(tmp_path / "block", rest, deformed, 1.0)
    capsys.readouterr()
    assert main(["simulate", str(record), "--in", "newton", "--out", str(tmp_path / "out"), *QUIET]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "Newton's solver has no force of held vertices" in line


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
@pytest.mark.parametrize(("poisson", "way"), [(0.1, (0.0, 0.0, 4e-4)), (0.4, (3e-4, 0.0, -4e-4))])
def test_mujoco_needs_the_modulus_of_a_block_of_finite_elements(
    poisson: float, way: tuple[float, float, float], tmp_path: Path, capsys: Capture
) -> None:
    """Pulled, and pressed aside, at 1 % of its height: of trilinear elements, as the flex's cells are, both parameters
    are the known ones."""
    rest, young = block(), 30e3
    axes = [np.unique(rest[:, at]) for at in range(3)]
    box = ElasticBox(*axes, young=young, poisson=poisson, element="trilinear")  # type: ignore[misc]
    held, to = np.zeros(box.nodes.shape, bool), np.zeros(box.nodes.shape)
    upper = box.plane(2, axes[2][-1])
    held[box.plane(2, 0.0) | upper] = True
    to[upper] = way
    found = box.hold(held).solve(to)
    force = float(np.linalg.norm(found.force[upper].sum(axis=0)))
    record = recorded_block(tmp_path / "block", rest, rest + found.displacement[box.corners], force)
    capsys.readouterr()
    flags = ["--python", WITH_TARGETS, "--out", str(tmp_path / "out"), *QUIET, "--json", "-"]
    assert main(["simulate", str(record), "--in", "mujoco", *flags]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["needed"]["poisson"] == pytest.approx(poisson, abs=0.01)
    assert told["needed"]["young_pa"] == pytest.approx(young, rel=0.02)
    load = "import mujoco, sys; m = mujoco.MjModel.from_xml_path(sys.argv[1]); print(m.nflexvert, m.nmocap)"
    alone = [WITH_TARGETS, "-I", "-c", load, str(tmp_path / "out" / "slab.xml")]
    loaded = subprocess.run(alone, capture_output=True, text=True, check=True, cwd="/")
    assert loaded.stdout.split() == [str(len(rest)), str(2 * 4 * 3)]


def test_predict_sets_the_simulator_beside_the_model(folder: Path, tmp_path: Path, capsys: Capture) -> None:
    """The stand-in is fitted to one measured poke, and answers as a column; the model's force is that without --in."""
    model, poke = str(folder / "model.npz"), ["--poke", "at=0.09,0.08 depth=0.001", *QUIET, "--json", "-"]
    assert main(["predict", model, *poke]) == 0
    alone = json.loads(capsys.readouterr().out)["predictions"][0]
    beside = ["--in", "mujoco", "--python", str(folder / "python"), "--against", str(folder / "poke0.npz")]
    assert main(["predict", model, *poke[:2], *beside, *QUIET]) == 0
    assert "force by the model" in capsys.readouterr().out
    assert main(["predict", model, *poke, *beside]) == 0
    told = json.loads(capsys.readouterr().out)
    measured, (predicted,) = [[one for one in told["in"]["pokes"] if one["held_out"] is held] for held in (False, True)]
    assert predicted["force_n"][0] == pytest.approx(alone["force_n"])
    assert predicted["target_force_n"][0] == pytest.approx(0.5 * measured[0]["force_n"][0], rel=0.02)
    assert main(["predict", model, *poke, "--in", "mujoco"]) == 2
    assert "measured pokes to fit the simulator to" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("poked", [True, False])
def test_each_region_of_a_recording_is_a_material(folder: Path, poked: bool, tmp_path: Path, capsys: Capture) -> None:
    """Beyond x = .11 m the foam is 3 times as firm. Touched there, it is fitted; not touched, it has the share that the
    map has it."""
    soft, _ = [cast("TouchEstimate", row.item) for row in read_results(SHIPPED, (TouchEstimate,))]
    sunk = soft.approach_m - soft.contact_m
    soft = replace(soft, fitted_n=soft.peak_force_n * np.clip(sunk / sunk.max(), 0.0, 1.0))  # as the stand-in's
    maps = [cast("MapEstimate", row.item) for row in read_results(SHIPPED, (MapEstimate,))][-1]
    (surface,) = [row.item for row in read_results(SHIPPED, (SurfaceEstimate,))][-1:]
    labels = np.zeros_like(maps.labels)
    labels[:, round(0.11 / maps.cell_m) :] = 1
    level = maps.level_n_per_mm[[0, 0]] * [1.0, 2.0]
    maps = replace(maps, labels=labels, region_count=2, level_n_per_mm=level, level_rigid=maps.level_rigid[[0, 0]])
    maps = replace(maps, level_interval_n_per_mm=maps.level_interval_n_per_mm[[0, 0]], level_modulus_pa=None)
    touches = []
    for number, (x, y) in enumerate(((0.0, 0.0), (0.04, 0.03), (0.0, 0.03), (0.04, 0.0)), start=1):
        by, more = np.array([x, y, 0.0]), 3.0 if x else 1.0
        moved = replace(soft, number=number, xyz_m=soft.xyz_m + by, observed_m=soft.observed_m + by)
        if poked or not x:
            touches.append(replace(moved, fitted_n=more * soft.fitted_n, peak_force_n=more * soft.peak_force_n))
    record = tmp_path / "two.rrd"
    with Recorder(record, "none", {}, application=EXPLORATION) as recorder:
        recorder.start(ExplorationLayout((), (0.2, 0.2), np.eye(4), truth=False), 0)
        recorder.write(Step((surface,), moment=Moment(1, cell_m=maps.cell_m)))
        for at, one in enumerate((*touches, maps), start=2):
            recorder.write(Step((one,), moment=Moment(at, 1, at, maps.cell_m)))
    flags = ["--in", "mujoco", "--python", str(folder / "python"), "--tip", "sphere:0.02", *QUIET]
    shown = tmp_path / "shown.rrd"
    flags += ["--out", str(tmp_path / "two"), "--json", "-", "--record", str(shown)]
    assert main(["simulate", str(record), *flags]) == 0
    told = json.loads(capsys.readouterr().out)
    first, second = told["materials"]
    assert second["young_pa"] / first["young_pa"] == pytest.approx(3.0 if poked else 2.0, rel=0.05)
    assert [one["fitted_pokes"] for one in told["materials"]] == ([2, 1] if poked else [2, 0])
    assert told["determined"]["ratio 1"] is poked
    at = np.array(values(shown, "/found/body/1", "Points3D:positions", 0))
    modulus = np.array(values(shown, "/found/body/1", "value", 0))
    needed = 1e-3 * np.array([first["young_pa"], second["young_pa"]])
    far = np.abs(at[:, 0] - 0.11) > 0.011  # a cell holds the line
    np.testing.assert_allclose(modulus[far], needed[(at[far, 0] > 0.11).astype(int)], rtol=1e-6)
    assert (at[far, 0] > 0.11).any()
    tints = np.array(values(shown, "/found/body/1", "Points3D:colors", 0))
    assert len(np.unique(tints)) == 2
    assert len(np.unique(tints[far & (at[:, 0] > 0.11)])) == 1
    names = values(shown, "/found/body/2/legend/label", "Points3D:labels", 0)
    assert names == ["measured", "mujoco"]
    body = ET.parse(tmp_path / "two" / "slab.xml").getroot()
    for flex in body.iter("flex"):
        needed = told["materials"][int(flex.attrib["name"].removeprefix("material").partition("_")[0])]["young_pa"]
        elasticity = flex.find("elasticity")
        assert elasticity is not None
        assert float(elasticity.attrib["young"]) == pytest.approx(needed, rel=1e-5)
        beyond = np.array(flex.attrib["vertex"].split(), np.float64)[::3].mean() > 0.11
        assert beyond == flex.attrib["name"].startswith("material1")


@pytest.mark.parametrize("target", ["mujoco", "newton"])
@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("missing", "expected {} in"),
        ("crash", "{} 0.0.1: ended with status 7: it ran out of memory"),
        ("garbage", "{} 0.0.1: no JSON: not JSON"),
        ("error", "{} 0.0.1: ValueError: unknown attribute 'dof'"),
    ],
)
def test_errors_of_the_target_are_one_line(
    folder: Path, how: str, said: str, target: str, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.setenv("FAKE_TARGET", how)
    assert main(command(folder, target=target)) == 2
    (*_, last) = capsys.readouterr().err.splitlines()
    assert said.format(target) in last
    assert "try:" in last


def test_for_newton_the_body_is_a_usd_and_its_contact_a_stiffness_of_vertices(folder: Path, capsys: Capture) -> None:
    """The stand-in answers the same, so that the same modulus is needed; its static state took 7 steps at most."""
    assert main(command(folder, "--json", "-", target="newton", out="usd")) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["timestep_s"] == 0.001
    assert told["static_state"] == {"steps": 7}
    assert told["needed"]["contact_unit"] == "N/m a vertex"
    text = (folder / "usd" / "slab.usda").read_text()
    modulus = float(text.split("physics:youngsModulus = ")[1].split()[0])
    assert modulus == pytest.approx(told["needed"]["young_pa"], rel=1e-5)
    points = text.split("points = [")[1].split("]")[0].count("(")
    assert points == told["vertices"]
    assert main(command(folder, "--json", "-")) == 0
    other = json.loads(capsys.readouterr().out)
    assert told["needed"]["young_pa"] == pytest.approx(other["needed"]["young_pa"], rel=0.02)


def test_a_target_that_hangs_is_ended_by_the_time_limit(folder: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.setenv("FAKE_TARGET", "hang")
    assert main(command(folder, "--limit-s", "1")) == 2
    assert "--limit-s" in capsys.readouterr().err


@pytest.mark.parametrize(("pace", "limit_s"), [("slow", "4"), ("", "0.001"), ("paced", "1.5")])
def test_the_time_limit_leaves_the_best_fit_so_far(
    pace: str, limit_s: str, folder: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    """A slow run takes .7 s, a paced one that for each poke: a target that goes on answering does not hang. All pokes
    are pressed once more with what was fitted until then, which may be nothing."""
    monkeypatch.setenv("FAKE_TARGET", pace)
    assert main(command(folder, "--limit-s", limit_s, "--json", "-")) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["converged"] is False
    assert told["stable_timestep_s"] is None
    assert all(one["target_force_n"] for one in told["pokes"])


def test_ctrl_c_leaves_the_best_fit_so_far(folder: Path, monkeypatch: Patch, capsys: Capture) -> None:
    """Pressed in the fifth run, that of the first step: the body and the errors are those of the start."""
    monkeypatch.setenv("FAKE_TARGET", "interrupt")
    assert main(command(folder, "--json", "-", out="interrupted")) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["converged"] is False
    assert told["stable_timestep_s"] is None
    body = ET.parse(folder / "interrupted" / "slab.xml").getroot().find("deformable/flex/elasticity")
    assert body is not None
    assert float(body.attrib["young"]) == pytest.approx(told["needed"]["young_pa"], rel=1e-5)


def test_a_hole_below_the_pokes_is_refused(folder: Path, capsys: Capture) -> None:
    with np.load(folder / "model.npz") as found:
        arrays = dict(found)
    rest = arrays["rest"]
    far = np.linalg.norm(rest[:, :2] - (0.09, 0.045), axis=1) > 0.035
    assert not far.all()
    np.savez(
        folder / "holed.npz", **{k: v[far] if len(v.shape) and len(v) == len(rest) else v for k, v in arrays.items()}
    )
    args = command(folder)
    args[1] = str(folder / "holed.npz")
    assert main(args) == 2
    assert "a surface without a hole around the pokes" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["mujoco", "newton"])
def test_bad_input_is_one_line(folder: Path, target: str, capsys: Capture) -> None:
    model, out = str(folder / "model.npz"), ["--in", target, "--out", str(folder / "bad"), *QUIET]
    pair = str(folder / "poke0.npz")
    for args, said in (
        ([*out], "--against PAIR.npz..., or --poke"),
        ([*out, "--against", pair, "--python", "/no/such/python"], "a Python interpreter after --python"),
        ([*out, "--against", str(folder / "noforce0.npz")], "pokes with their force"),
        ([*out, "--against", pair, "--poke", "at=0.1,0.1 depth=0.001", "--held-out", "1"], "--against with --poke"),
        ([*out, "--against", pair, "--held-out", "1"], "a poke to fit next to those held out"),
        ([*out, "--poke", "at=0.175,0.08 depth=0.001"], "pokes on the surface"),
        ([*out, "--against", pair, "--tip", "sphere:0.02"], "--tip with a recording"),
    ):
        assert main(["simulate", model, *args]) == 2
        lines = capsys.readouterr().err.splitlines()
        assert said in lines[-1]
        assert len(lines) <= 5


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_mujoco_repeats_the_pokes_and_loads_the_body_alone(folder: Path, capsys: Capture) -> None:
    args = command(folder, "--json", "-", "--python", WITH_TARGETS, out="mujoco")
    assert main(args) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["errors_by_run"][-1] < 0.7 * told["errors_by_run"][0]
    assert told["fitted"]["force_error"] < 0.15
    assert told["stable_timestep_s"] >= told["timestep_s"]
    load = "import mujoco, sys; m = mujoco.MjModel.from_xml_path(sys.argv[1]); print(m.nflexvert)"
    alone = [WITH_TARGETS, "-I", "-c", load, str(folder / "mujoco" / "slab.xml")]
    found = subprocess.run(alone, capture_output=True, text=True, check=True, cwd="/")
    assert int(found.stdout) == told["vertices"]


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_mujoco_touches_a_soft_slab_at_its_surface(tmp_path: Path) -> None:
    """Of 5 kPa it sags, and vertices below each other move sideways; pressed as far, it pushes a tenth as hard."""
    across = np.linspace(0.0, 0.08, 11)
    mesh = slab_mesh((across, across, np.linspace(0.0, 0.03, 4)))
    poke = {"at_m": [0.026, 0.023], "tip": "flat", "size_m": [0.03, 0.03], "slips": True, "depth_m": [0.001]}
    forces = []
    with target_process("mujoco", Path(WITH_TARGETS)) as target:
        for young in (50e3, 5e3):
            parameters = {"young": [young], "poisson": 0.2, "contact": 2.0 * young}
            body = write_body("mujoco", tmp_path, mesh, TargetParameters(young, 0.2, 2.0 * young), 100.0, 0.005)
            asked = {"do": "press", "asset": str(body), "parameters": parameters, "timestep_s": 0.005, "pokes": [poke]}
            (answer,) = target.ask(asked)
            forces.append(answer["force_n"][0])
    assert forces[1] == pytest.approx(0.1 * forces[0], rel=0.05)


@pytest.mark.slow
@pytest.mark.skipif(not has("mujoco"), reason="needs mujoco, or DEFORMSCOPE_TARGETS_PYTHON with it")
def test_mujoco_presses_a_column_as_hard_with_a_tip_that_sticks(tmp_path: Path) -> None:
    """Without Poisson's ratio nothing moves sideways: friction changes nothing, and the force is E * area * strain."""
    across, young = np.linspace(0.0, 0.04, 6), 50e3
    mesh, found = slab_mesh((across, across, np.linspace(0.0, 0.03, 4))), TargetParameters(young, 0.0, 1e6)
    body = write_body("mujoco", tmp_path, mesh, found, 100.0, 0.005)
    poke: Json = {"at_m": [0.02, 0.02], "tip": "flat", "size_m": [0.05, 0.05], "depth_m": [0.001]}
    asked: Json = {"do": "press", "asset": str(body), "timestep_s": 0.005}
    asked["parameters"] = {"young": [young], "poisson": 0.0, "contact": 1e6}
    with target_process("mujoco", Path(WITH_TARGETS)) as target:
        answers = list(target.ask(asked | {"pokes": [poke | {"slips": slips} for slips in (True, False)]}))
    for answer in answers:
        sunk = 0.001 - answer["penetration_m"][0]
        assert sunk > 0.0009
        assert answer["force_n"][0] == pytest.approx(young * 0.04**2 * sunk / 0.03, rel=0.05)
