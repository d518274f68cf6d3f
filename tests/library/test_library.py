"""`import deformscope as ds`: what a script finds there, with files and with arrays, and what results can do."""

import ast
import dataclasses
import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import deformscope as ds
from deformscope.cli import main
from deformscope.config import BetaConfig, ExportConfig
from deformscope.stages.msm import reference
from tests.patience import PATIENCE_S
from tests.stages import reference_states
from tests.stages.bodies import pushed

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    """A pair of beta 0.6, as arrays."""
    body = pushed((5, 6), np.random.default_rng(1))
    spec = reference.build_rest(body.rest, body.clusters(3), body.held)
    deformed, _ = reference_states.relax(spec, body.held_position, beta=0.6)
    return {"rest": body.rest, "deformed": deformed, "held": body.held, "force_n": np.array(2.0)}


def test_everything_offered_is_there_typed_and_documented() -> None:
    for name in ds.__all__:
        offered = getattr(ds, name)
        assert offered.__doc__, name
        if inspect.isfunction(offered):
            assert set(inspect.signature(offered).parameters) < set(offered.__annotations__), name
    assert set(ds.__all__) <= set(dir(ds))
    typed = {
        one.asname: one.name
        for node in ast.walk(ast.parse(Path(ds.__file__).read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("deformscope.")
        for one in node.names
    }
    assert typed == {name: name for name in ds.__all__}  # what a type checker finds
    with pytest.raises(AttributeError, match="no attribute 'bata'"):
        ds.bata  # noqa: B018


def annotated(name: str, offered: Any) -> Iterator[tuple[str, Any]]:
    """A function, or a class with its public methods and properties; a dataclass's fields are its own hints."""
    yield name, offered
    for base in getattr(offered, "__mro__", ()):
        for key, value in vars(base).items() if base.__module__.startswith("deformscope") else ():
            found = getattr(value, "fget", None) or getattr(value, "func", None) or getattr(value, "__func__", value)
            made = key == "__init__" and not dataclasses.is_dataclass(base)
            if inspect.isfunction(found) and (made or not key.startswith("_")):
                yield f"{name}.{key}", found


def hints(one: Any) -> list[object]:
    """The types of its annotations, with what its modules import for type checkers alone."""
    names: dict[str, Any] = {}
    for each in reversed(getattr(one, "__mro__", (one,))):
        module = sys.modules[each.__module__]
        names |= vars(module)
        for node in ast.parse(inspect.getsource(module)).body if each.__module__.startswith("deformscope") else ():
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                exec(compile(ast.Module(node.body, []), each.__module__, "exec"), names)
    return list(get_type_hints(one, names).values())


def unknown(hint: object) -> bool:
    """Whether `Any` is in it; an array's shape and precision are numpy's to say."""
    inner = (one for each in get_args(hint) for one in (each if isinstance(each, list) else [each]))
    return hint is Any or (get_origin(hint) is not np.ndarray and any(map(unknown, inner)))


def test_every_type_that_is_offered_is_known() -> None:
    found = [
        where
        for name in ds.__all__
        for where, one in annotated(name, getattr(ds, name))
        if any(map(unknown, hints(one) if callable(one) else [one]))
    ]
    assert found == []
    assert unknown(dict[str, list[Any] | None])


def test_options_are_those_of_the_commands(arrays: dict[str, np.ndarray]) -> None:
    with pytest.raises(TypeError, match="unexpected options: qrid; near: grid"):
        ds.calibrate_beta(arrays, qrid=(3, 4))
    with pytest.raises(TypeError, match="unexpected options: picture; the result has"):
        ds.explore("lab:disc", picture="maps.png")
    with pytest.raises(TypeError, match="unexpected options: record; the result has"):
        ds.classify("sample:table", record="table.rrd")
    with pytest.raises(ds.InputError, match="touches of 1 or more; got 0"):
        ds.explore("lab:disc", touches=0)
    with pytest.raises(ds.InputError, match="a mode out of linear, quadratic; got 'cubic'"):
        ds.calibrate_beta(arrays, mode="cubic")
    with pytest.raises(ds.InputError, match="grid or spacing_px; got both"):
        ds.calibrate_beta("sample:tension", grid=[3, 4], spacing_px=4.0)
    with pytest.raises(ds.InputError, match="no flags about images with pair files"):
        ds.calibrate_beta("sample:pair", grid=[3, 4])
    with pytest.raises(ds.InputError, match="a goal out of regions, inclusions; got 'gold'"):
        ds.explore("lab:disc", goal="gold")


def test_the_text_of_the_command_line_is_taken_too() -> None:
    typed = BetaConfig.of(
        sources="a.mp4", roi="400,20,75,35", grid="7x15", held="top,left", beta_range="0.1,0.9", candidates="30"
    )
    given = BetaConfig.of(
        sources=["a.mp4"],
        roi=(400, 20, 75, 35),
        grid=[7, 15],
        held=["left", "top"],
        beta_range=(0.1, 0.9),
        candidates=30,
    )
    assert typed == given
    assert typed.images.held == ("top", "left")
    assert ExportConfig.of(recording="r.rrd", to="csv", out="a", only="tactile").only == ("tactile",)
    for options, says in (
        ({"roi": "400,20"}, "roi: expected x,y,width,height in pixels, such as 400,200,750,350; got '400,20'"),
        ({"roi": 5}, "roi: expected X,Y,WIDTH,HEIGHT; got 5"),
        ({"grid": (7,)}, "grid: expected ROWSxCOLS, such as 7x15; got '7'"),
        ({"candidates": "many"}, "candidates: expected int; got 'many'"),
    ):
        with pytest.raises(ds.InputError, match=re.escape(says)):
            ds.calibrate_beta("sample:tension", **options)
    with pytest.raises(ds.InputError, match="at as numbers, or as text with ',' between them"):
        ds.predict("none.npz", at="0.1;0.2", depth_m=0.001)
    with pytest.raises(ds.InputError, match="merge NAME=A,B, each NAME once; got 'water'"):
        ds.classify("sample:table", merge="water")
    with pytest.raises(ds.InputError, match="transfer TRAINED:TESTED; got 'box'"):
        ds.classify("sample:table", transfer="box")
    with pytest.raises(ds.InputError, match="vary as a dict"):
        ds.sweep(ds.calibrate_beta, [], out="none", vary="cluster_size=3")  # type: ignore[arg-type]


def test_importing_it_loads_nothing_else() -> None:
    script = "import sys; before = set(sys.modules); import deformscope; print(sorted(set(sys.modules) - before))"
    command = [sys.executable, "-c", f"import importlib, typing; {script}"]
    loaded = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, check=True, env={"PYTHONPATH": str(ROOT)}
    )
    assert loaded.stdout == "['deformscope']\n"


def test_a_pair_gives_the_json_of_the_command(
    arrays: dict[str, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "pair.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    assert main(["calibrate", "beta", str(path), "--candidates", "12", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    from_file = ds.calibrate_beta(path, candidates=12)
    from_arrays = ds.calibrate_beta(arrays, candidates=12, record=tmp_path / "r.rrd")
    assert from_file.to_dict() == told
    assert from_arrays.to_dict() == told
    assert from_arrays.value == pytest.approx(0.6, abs=0.02)
    assert repr(from_file).startswith(f"<beta {told['value']:.4g}, ")
    assert f"verdict                {told['verdict_text']}" in str(from_file)
    page = from_arrays._repr_html_()
    assert "data:image/png;base64," in page
    assert told["verdict_text"] in page
    assert capsys.readouterr() == ("", "")
    opened = ds.open_recording(tmp_path / "r.rrd")
    assert opened.kind == "pair"
    assert opened.estimates() == [told]
    assert main(["replay", str(tmp_path / "r.rrd")]) == 0  # arrays are recorded as a pair file would be


def test_several_pairs_share_one_value(arrays: dict[str, np.ndarray]) -> None:
    found = ds.calibrate_beta([arrays, arrays], candidates=12)
    assert found.name == "all pairs"
    assert len(found.shown.comparisons) == 2


def test_images_as_arrays_give_what_their_files_give(tmp_path: Path) -> None:
    from deformscope.file_io import sample_path
    from deformscope.files.sources import open_source
    from deformscope.images import encode_png

    with open_source(["sample:tension"]) as source:
        frames = [frame.image for frame in source][::4]
    paths = []
    for index, image in enumerate(frames):
        paths.append(tmp_path / f"{index}.png")
        paths[-1].write_bytes(encode_png(image))
    mask = next(sample_path("tension").glob("mask/*"))
    options = {"mask": mask, "spacing_px": 60.0, "held": ("top", "bottom"), "candidates": 8}
    from_arrays = ds.calibrate_beta(frames, **options)  # type: ignore[arg-type]
    from_files = ds.calibrate_beta(paths, **options)  # type: ignore[arg-type]
    assert from_arrays.to_dict() == from_files.to_dict()
    assert from_arrays.to_dict()["aee_px"] > 0.0


@pytest.mark.slow  # the command proves the same
def test_a_fitted_pair_can_be_poked(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    fitted = ds.calibrate_beta(arrays, candidates=12)
    fitted.save(tmp_path / "model.npz")
    depth_m = 0.5 * float(np.abs(arrays["deformed"] - arrays["rest"]).max())
    where = arrays["rest"][fitted.model().rest.shape[0] // 2]
    poke = {"at": tuple(where), "depth_m": depth_m, "tip": "flat", "size_m": (0.02,)}
    once, again = ds.predict(fitted, **poke), ds.predict(tmp_path / "model.npz", **poke)  # type: ignore[arg-type]
    assert once.depth_m == pytest.approx(depth_m, rel=1e-3)
    assert once.force_n is not None
    np.testing.assert_array_equal(once.deformed_m, again.deformed_m)
    assert once.to_dict()["poke"]["tip"] == "flat"
    assert "touched" in str(once)
    assert "<img" in once._repr_html_()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: ds.calibrate_beta("none.mp4"), "nothing there"),
        (lambda: ds.calibrate_beta("a.npz", noise_px=1.0, noise_m=1.0), "expected noise_px or noise_m; got both"),
        (lambda: ds.calibrate_theta("a.mp4", cluster_size=1), "a cluster_size of 2 or more; got 1"),
        (lambda: ds.calibrate_beta([np.zeros((9, 9))] * 2), "uint8 or uint16; got float64"),
        (lambda: ds.predict("none.npz", at=(0.0, 0.0)), "a depth or a force; got neither"),
        (lambda: ds.explore("lab:nowhere"), "nowhere"),
        (lambda: ds.open_recording("none.rrd"), "nothing there"),
    ],
)
def test_what_cannot_be_used_is_one_error_in_the_words_of_python(call: object, says: str) -> None:
    with pytest.raises(ds.InputError) as raised:
        call()  # type: ignore[operator]
    assert says in str(raised.value)
    assert "--" not in str(raised.value)
