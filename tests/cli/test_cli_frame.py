"""The frame around every command: flags, files, errors, exit statuses, and what goes to which stream."""

import dataclasses
import json
import math
import os
import re
import subprocess
import sys
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from deformscope import cli, config
from deformscope.cli import common
from deformscope.errors import InputError
from deformscope.runs.result import resolve_viewer
from tests.cases import Capture, Patch, one_line
from tests.patience import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]
SYSTEM_LIBRARIES = ROOT / ".ci" / "system-libraries"


def run_python(*args: str, stdout: int = subprocess.PIPE, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *args],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | environment,
    )


@pytest.fixture
def command(monkeypatch: Patch) -> Callable[[Callable[[config.FlowConfig], None]], list[str]]:
    """Make a function a command; returns the arguments that run it."""

    def register(function: Callable[[config.FlowConfig], None]) -> list[str]:
        module = types.ModuleType("a_test_command")
        module.run = function  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "a_test_command", module)
        monkeypatch.setitem(cli.COMMANDS, "act", cli.Command("act", "FlowConfig", "a_test_command"))
        return ["act", "a.png", "b.png", "--out", "f.npz"]

    return register


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(cli.TRACEBACK, raising=False)


# Help and finding a command


def test_help_lists_every_command(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    told = capsys.readouterr().out
    assert all(f"  {name}" in told for name in cli.COMMANDS)


def test_without_arguments_it_says_one_command(capsys: Capture) -> None:
    assert cli.main([]) == 0
    (command,) = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("  deformscope ")]
    options = cli.parse(config.ExploreConfig, command[2:])
    assert command[1] == "explore"
    assert options.output.viewer == "page"


def test_a_flag_has_the_name_and_unit_that_is_typed() -> None:
    typed = "lab:buried --goal inclusions --smallest-inclusion 0.03 --set-force 2"
    options = cli.parse(config.ExploreConfig, typed.split())
    assert (options.smallest_inclusion_m, options.set_force_n) == (pytest.approx(0.03), 2.0)
    assert (options.budget, options.beta_model) == (30, "none")


def test_every_command_exists_and_has_help(capsys: Capture) -> None:
    for name, command in cli.COMMANDS.items():
        assert cli.main([*name.split(), "--help"]) == 0
        assert capsys.readouterr().out.startswith(f"usage: deformscope {name} ")
        assert issubclass(getattr(config, command.config), config.CommandOptions)
        assert callable(getattr(__import__(command.module, fromlist=["_"]), command.function))


DATASET = {f"dataset {what}" for what in ("list", "relabel", "discard", "merge", "repair")}
BY_ITSELF = {"arm where", "arm home", "arm files", "rig new"}
ONLY_LOOK = (
    {"devices", "doctor", "verify", "recover", "double", "bench", "export", "discard", "report", "catalog"}
    | {"new-device", "catalog compare", "sweep"}
    | DATASET
    | BY_ITSELF
)
"""Commands that compute nothing of a thing: they list, check, convert, write a package, keep a data set, measure this
machine, or ask an arm where it is or to go home by its own way, or write the files for its controller."""


def test_every_command_that_computes_records_and_shows() -> None:
    for name in set(cli.COMMANDS) - ONLY_LOOK:
        options = getattr(config, cli.COMMANDS[name].config)
        assert issubclass(options, config.RecordedOptions), name
        output = typing.get_type_hints(options)["output"]
        assert {"record", "viewer", "json", "overwrite"} <= {field.name for field in dataclasses.fields(output)}, name


@pytest.mark.parametrize("name", sorted(set(cli.COMMANDS) - ONLY_LOOK))
def test_an_existing_recording_is_not_written_over(name: str, tmp_path: Path, capsys: Capture) -> None:
    kept = tmp_path / "kept.rrd"
    kept.write_bytes(b"kept")
    needed = {
        "certify": ["x.toml", "--sample", "lab-block"],
        "flow": ["a.png", "b.png", "--out", "f.npz"],
        "indent": ["x.csv", "--tip", "sphere:0.02"],
        "predict": ["m.npz", "--poke", "at=0,0 depth=0.001"],
        "simulate": ["m.npz", "--in", "mujoco", "--out", "o", "--poke", "at=0,0 depth=0.001"],
        "squeeze": ["lab:containers", "--content", "rice"],
    }
    positional = [] if name == "demo" else ["x.npz"]
    assert cli.main([*name.split(), *needed.get(name, positional), "--viewer", "none", "--record", str(kept)]) == 2
    assert "a new file after --record; got one that exists" in one_line(capsys)
    assert kept.read_bytes() == b"kept"


def test_version(capsys: Capture) -> None:
    assert cli.main(["--version"]) == 0
    assert re.fullmatch(r"deformscope \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_the_end_of_a_command_searches_no_objects() -> None:
    searches = "gc.callbacks.append(lambda when, found: print(when, len(gc.get_objects()) < 1000))"
    run = run_python("-c", f"import gc; from deformscope import cli; cli.main(['--version']); {searches}")
    assert set(run.stdout.splitlines()[1:]) <= {"start True", "stop True"}, run.stdout
    assert not run.stderr


@pytest.mark.parametrize(
    ("line", "unused"),
    [
        ("verify recordings/rig.rrd", "warp scipy.interpolate"),
        ("export recordings/rig.rrd --to parquet --out {tmp_path}/out", "warp scipy.spatial scipy.sparse"),
        ("calibrate beta sample:pair --viewer none", "pyarrow rich scipy.interpolate scipy.ndimage"),
    ],
)
def test_a_command_imports_nothing_large_that_it_does_not_use(line: str, unused: str, tmp_path: Path) -> None:
    imported, args = f"set({unused.split()}) & set(sys.modules)", line.format(tmp_path=tmp_path).split()
    run = run_python("-c", f"import sys; from deformscope import cli; cli.main({args}); print({imported})")
    assert run.stdout.splitlines()[-1] == "set()", run.stderr


def test_runs_as_a_module() -> None:
    shown = run_python("-m", "deformscope", "--version")
    assert (shown.returncode, shown.stderr) == (0, "")


@pytest.fixture
def groups(monkeypatch: Patch) -> None:
    monkeypatch.setitem(cli.COMMANDS, "measure beta", cli.Command("of beta", "BetaConfig", "nowhere"))
    monkeypatch.setitem(cli.COMMANDS, "measure theta", cli.Command("of theta", "ThetaConfig", "nowhere"))


@pytest.mark.usefixtures("groups")
def test_a_group_has_help_and_members(capsys: Capture) -> None:
    assert cli.main(["measure", "--help"]) == 0
    told = capsys.readouterr().out
    assert "measure beta" in told
    assert "flow" not in told
    assert cli.main(["measure", "theta", "--help"]) == 0
    assert "--theta-range" in capsys.readouterr().out


@pytest.mark.usefixtures("groups")
@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["flwo"], "got 'flwo' | try: deformscope flow"),
        (["--grid", "3x3"], "got a flag before any command | try: deformscope --help"),
        (["measure"], "expected beta or theta after measure; got nothing | try: deformscope measure --help"),
        (["measure", "betta"], "got 'betta' | try: deformscope measure beta"),
    ],
)
def test_an_unknown_command_is_answered_with_the_nearest(args: list[str], says: str, capsys: Capture) -> None:
    assert cli.main(args) == 2
    assert one_line(capsys).endswith(says)


# Flags


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ("", "expected BEFORE and AFTER and --out FILE.npz; got none | try: deformscope flow --help"),
        ("a b", "expected --out FILE.npz; got none | try: deformscope flow --help"),
        ("a b c --out f.npz", "expected only known flags for deformscope flow; got c | try: deformscope flow --help"),
        ("a b --out f.npz --pitcure f.png", "got --pitcure f.png | try: --picture"),
        ("a b --out f.npz --viewer x", "--viewer: expected one of 'auto', 'native', 'page', 'none'; got 'x'"),
        ("a b --out", "expected a value after --out; got none"),
        ("a b --out f.txt", "expected a file that ends in .npz after --out; got 'f.txt'"),
        ("a b --out f.npz --picture f.gif", "expected a file that ends in .png after --picture; got 'f.gif'"),
    ],
)
def test_a_wrong_flag_is_one_line(args: str, says: str, capsys: Capture) -> None:
    assert cli.main(["flow", *args.split()]) == 2
    assert says in one_line(capsys)


def test_a_narrow_terminal_breaks_no_word(capsys: Capture, monkeypatch: Patch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    flag = "--no-flag-of-this-length-has-ever-been-seen-by-anybody"
    assert cli.main(["flow", "a", "b", "--out", "f.npz", flag]) == 2
    assert f"got {flag} |" in one_line(capsys)
    assert os.environ["COLUMNS"] == "40"


def test_values_of_one_word() -> None:
    flags = (
        "--roi 400,200,750,350 --contact 500,190,120.5,30 --grid 7x15 --held contact,bottom,bottom --noise-px 0.3 "
        "--beta-range 0.1,0.9 --json - --record r.rrd --viewer none --overwrite --seed 4"
    )
    parsed = cli.parse(config.BetaConfig, ["a.png", "b.png", *flags.split()])
    assert parsed.sources == ("a.png", "b.png")
    assert parsed.images.roi == (400, 200, 750, 350)
    assert parsed.images.contact == (500, 190, 120.5, 30)
    assert parsed.images.grid == (7, 15)
    assert parsed.images.held == ("bottom", "contact")
    assert parsed.beta_range == (0.1, 0.9)
    assert parsed.search.noise_px == 0.3
    assert parsed.output == config.OutputOptions("-", Path("r.rrd"), "none", overwrite=True, seed=4)
    assert parsed.json_target() == "-"


def test_defaults_are_the_thesis() -> None:
    beta = cli.parse(config.BetaConfig, ["v.mp4"])
    theta = cli.parse(config.ThetaConfig, ["v.mp4"])
    assert (beta.mode, beta.alpha, beta.beta_range) == ("linear", 1, (0, 0.99))
    assert (beta.fitted_cluster_size, beta.fitted_theta) == (3, 0.0)
    assert (theta.mode, theta.cluster_size, theta.alpha, theta.beta, theta.theta_range) == (
        "quadratic",
        None,
        1,
        0.99,
        (0, 1),
    )
    assert cli.parse(config.ThetaConfig, ["v.mp4", "--cluster-size", "4"]).cluster_size == 4
    assert (beta.search.candidates, beta.search.level) == (100, 0.9)
    assert beta.images.held_parts() == ("top", "bottom")
    assert cli.parse(config.BetaConfig, ["v.mp4", "--contact", "1,2,3,4"]).images.held_parts() == ("bottom", "contact")


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ("", "expected at least one SOURCE; got none"),
        ("v --beta-range 0.9,0.1", "expected a --beta-range that rises; got 0.9,0.1 | try: the other way round"),
        ("v --beta-range 0.5,0.5", "that rises"),
        ("v --beta-range -0.1,0.5", "expected a --beta-range within 0,0.9999; got -0.1,0.5"),
        ("v --beta-range 0,1.5", "within 0,0.9999"),
        ("v --beta-range 0", "--beta-range: expected LOWEST,HIGHEST, such as 0,0.99; got '0'"),
        ("v --beta-range 0,nan", "--beta-range: expected LOWEST,HIGHEST"),
        ("v --theta 1.5", "expected a --theta between 0 and 1; got 1.5"),
        ("v --theta nan", "got nan"),
        ("v --alpha 0", "expected an --alpha above 0 and at most 1; got 0.0"),
        ("v --alpha much", "--alpha: expected a number; got 'much'"),
        ("v --level 1", "expected a --level between 0 and 1; got 1.0 | try: --level 0.9"),
        ("v --level 90", "between 0 and 1"),
        ("v --candidates 2", "expected a --candidates of 3 or more; got 2"),
        ("v --candidates few", "--candidates: expected a whole number; got 'few'"),
        ("v --cluster-size 1", "expected a --cluster-size of 2 or more; got 1"),
        ("v --grid 7x15 --spacing-px 50", "expected --grid or --spacing-px; got both"),
        ("v --grid 7", "--grid: expected ROWSxCOLS, such as 7x15; got '7'"),
        ("v --grid 1x5", "at least 2 rows and 2 columns"),
        ("v --roi 1,2,3", "--roi: expected x,y,width,height in pixels, such as 400,200,750,350; got '1,2,3'"),
        ("v --roi 1,2,0,4", "expected a width and a height above 0"),
        ("v --outline 1,2,3,4", "three corners or more, in pixels; got '1,2,3,4'"),
        ("v --outline 1,2,3,4,5,6,7", "of three corners or more"),
        ("v --at 1", "expected a --at of at most 0.9999; got 1"),
        ("v --at 0.5 --whole-motion", "expected no --at with --thickness-m or --whole-motion"),
        ("v --held bottom,side", "--held: expected a comma list of top, bottom, left, right, border, contact"),
        ("v --held contact", "expected --contact X,Y,WIDTH,HEIGHT with --held contact; got no --contact"),
        ("v --held bottom --contact 1,2,3,4", "got --held bottom | try: --held bottom,contact"),
        ("v --noise-px 1 --noise-m 1", "expected --noise-px or --noise-m; got both"),
        ("v --noise-px 0", "--noise-px: expected a number above 0; got '0'"),
        ("v --stride 0", "expected a --stride of 1 or more; got 0"),
        ("v --fps inf", "--fps: expected a number above 0; got 'inf'"),
        ("v --record r.mp4", "expected a file that ends in .rrd after --record; got 'r.mp4'"),
        ("v --seed -1", "expected a --seed of 0 or more; got -1"),
        ("v --device tpu", "--device: expected one of 'auto', 'cpu', 'cuda'; got 'tpu'"),
    ],
)
def test_options_that_cannot_be_are_refused(args: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        cli.parse(config.BetaConfig, args.split(), "deformscope calibrate beta")
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_theta_refuses_its_own_range() -> None:
    with pytest.raises(InputError, match="--theta-range that rises"):
        config.ThetaConfig(("v",), theta_range=(1.0, 0.0))
    with pytest.raises(InputError, match="--cluster-size"):
        config.ThetaConfig(("v",), cluster_size=1)
    with pytest.raises(InputError, match="--beta "):
        config.ThetaConfig(("v",), beta=math.nan)


# Errors and exit statuses


def raising(error: BaseException) -> Callable[[config.FlowConfig], None]:
    def run(_: config.FlowConfig) -> None:
        raise error

    return run


def fail(error: BaseException, command: Callable[..., list[str]], capsys: Capture) -> tuple[int, str]:
    return cli.main(command(raising(error))), one_line(capsys).removeprefix("deformscope: error: ")


def test_an_input_error_is_status_2(command: Callable[..., list[str]], capsys: Capture) -> None:
    assert fail(InputError("a", "b\nc", "d", "e.png"), command, capsys) == (2, "expected a; got b c | try: d | e.png")


def test_an_unexpected_error_is_named(command: Callable[..., list[str]], capsys: Capture) -> None:
    status, told = fail(ZeroDivisionError("a\nb"), command, capsys)
    assert (status, told) == (1, "unexpected ZeroDivisionError: a b | set DEFORMSCOPE_TRACEBACK=1 for the traceback")
    status, told = fail(RuntimeError("x" * 9999), command, capsys)
    assert (status, len(told) < 700) == (1, True)


def test_the_traceback_is_shown_when_asked_for(
    command: Callable[..., list[str]], capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.setenv(cli.TRACEBACK, "1")
    assert cli.main(command(raising(KeyError("k")))) == 1
    told = capsys.readouterr().err
    assert "Traceback" in told
    assert "unexpected KeyError" in told.splitlines()[-1]


@pytest.mark.parametrize("package", ["ImportError", "OSError"])
def test_a_missing_library_is_named_with_its_package(
    package: str, command: Callable[..., list[str]], capsys: Capture
) -> None:
    kind = {"ImportError": ImportError, "OSError": OSError}[package]
    error = kind("libusb-1.0.so.0: cannot open shared object file: No such file or directory")
    assert fail(error, command, capsys) == (
        1,
        "expected the system library libusb-1.0.so.0; got none on this machine"
        " | try: sudo apt-get install -y libusb-1.0-0",
    )


def test_a_library_missing_underneath_is_found(command: Callable[..., list[str]], capsys: Capture) -> None:
    error = RuntimeError("no depth")
    error.__cause__ = ImportError("libodd.so.3: cannot open shared object file: No such file or directory")
    status, told = fail(error, command, capsys)
    assert (status, "libodd.so.3" in told, "package manager" in told) == (1, True, True)


def test_causes_that_lead_back_to_the_error_end(command: Callable[..., list[str]], capsys: Capture) -> None:
    error, cause = RuntimeError("no depth"), ValueError("none")
    error.__cause__, cause.__cause__ = cause, error
    assert fail(error, command, capsys)[0] == 1


def test_a_missing_package_and_a_refusing_system(command: Callable[..., list[str]], capsys: Capture) -> None:
    assert "expected the Python package rerun" in fail(ModuleNotFoundError("no", name="rerun"), command, capsys)[1]
    error = OSError(28, "No space left on device", "/data/run.npz")
    assert fail(error, command, capsys) == (2, "the system refused: No space left on device | /data/run.npz")
    assert "enough memory" in fail(MemoryError(), command, capsys)[1]


def test_an_interrupt_is_quiet(command: Callable[..., list[str]], capsys: Capture) -> None:
    assert cli.main(command(raising(KeyboardInterrupt()))) == 130
    assert one_line(capsys) == "deformscope: interrupted"


TALK = """
import sys, types
from deformscope import cli
from deformscope.cli.common import show_table
module = sys.modules["talk"] = types.ModuleType("talk")
module.run = lambda config: show_table("Result", [("beta", "0.5")])
cli.COMMANDS["talk"] = cli.Command("talk", "FlowConfig", "talk")
sys.exit(cli.main(["talk", "a.png", "b.png", "--out", "f.npz"]))
"""


def test_a_reader_that_goes_away_is_quiet() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        told = run_python("-m", "deformscope", "--help", stdout=writer)
        flags = run_python("-m", "deformscope", "flow", "--help", stdout=writer)
        result = run_python("-c", TALK, stdout=writer)
    finally:
        os.close(writer)
    assert (told.returncode, told.stderr) == (141, "")
    assert (flags.returncode, flags.stderr) == (141, "")
    assert (result.returncode, result.stderr) == (141, "")


def test_another_pipe_that_breaks_is_no_silence(command: Callable[..., list[str]], capfd: Capture) -> None:
    assert cli.main(command(raising(BrokenPipeError(32, "Broken pipe")))) == 1
    assert "Broken pipe" in capfd.readouterr().err


def test_each_library_to_install_is_known_to_the_errors() -> None:
    needed = dict(
        re.findall(r"^need (\S+)\.so\.\d+ (\S+)$", SYSTEM_LIBRARIES.read_text(encoding="utf-8"), re.MULTILINE)
    )
    assert needed == cli.PACKAGES


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """A root's machine without the libraries, whose apt-get writes down what it is asked for."""
    programs = {
        "ldconfig": "exit 0",
        "id": "echo 0",
        "timeout": 'shift; exec "$@"',
        "apt-get": f'echo "$*" >> {tmp_path}/asked\ncase "$*" in *assume-no*) echo "Need to get 9 MB";; esac',
    }
    (tmp_path / "bin").mkdir()
    for name, body in programs.items():
        (tmp_path / "bin" / name).write_text(f"#!/bin/sh\n{body}\n")
        (tmp_path / "bin" / name).chmod(0o755)
    return os.environ | {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "CHROMIUM": "/none"}


def installs(tmp_path: Path) -> int:
    asked = (tmp_path / "asked").read_text().splitlines()
    return sum("assume-no" not in line and " install " in line for line in asked)


@pytest.mark.parametrize(("answer", "installed"), [("n", 0), ("y", 1), ("", 1)])
def test_at_a_terminal_system_libraries_are_installed_after_a_yes(
    answer: str, installed: int, bare: dict[str, str], tmp_path: Path
) -> None:
    ours, its = os.openpty()
    os.write(ours, f"{answer}\n".encode())
    command = ["sh", str(SYSTEM_LIBRARIES)]
    run = subprocess.run(command, stdin=its, capture_output=True, text=True, env=bare, timeout=PATIENCE_S, check=True)
    os.close(its)
    os.close(ours)
    assert "apt-get installs libusb-1.0-0 libgl1" in run.stdout
    assert "Need to get 9 MB" in run.stdout
    assert "install them? [Y/n]" in run.stdout
    assert installs(tmp_path) == installed
    assert ("sudo apt-get install -y libusb-1.0-0" in run.stdout) == (not installed)


def test_without_a_terminal_what_apt_installs_is_said_before(bare: dict[str, str], tmp_path: Path) -> None:
    run = subprocess.run(
        ["sh", str(SYSTEM_LIBRARIES)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=bare,
        timeout=PATIENCE_S,
        check=True,
    )
    assert run.stdout.startswith("system libraries: apt-get installs libusb-1.0-0 libgl1")
    assert "[Y/n]" not in run.stdout
    assert installs(tmp_path) == 1


# Files


def nothing(_: config.FlowConfig) -> None:
    pass


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--out", "nowhere/f.npz"], "expected a folder for the file of --out; got none | try: mkdir -p "),
        (["--out", "taken.npz/f.npz"], "got something else"),
        (["--out", "folder.npz"], "expected a file after --out; got a folder | folder.npz"),
        (["--out", "f.npz", "--json", "nowhere/f.json"], "expected a folder for the file of --json"),
        (["--out", "f.npz", "--json", "./f.npz"], "expected different files after --out and --json"),
        (["--out", "f.npz", "--picture", "a.png"], "expected a file after --picture that is no input"),
    ],
)
def test_an_output_out_of_reach_is_found_before_the_work(
    flags: list[str], says: str, command: Callable[..., list[str]], capsys: Capture
) -> None:
    Path("taken.npz").touch()
    Path("folder.npz").mkdir()
    assert cli.main([*command(raising(AssertionError("ran")))[:3], *flags]) == 2
    assert says in one_line(capsys)


def test_a_folder_that_refuses_is_found(monkeypatch: Patch, tmp_path: Path) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match="a writable file after --json; got Permission denied"):
        common.check_writable(tmp_path / "x.json", "--json")


def test_looking_whether_a_file_can_be_written_leaves_all_as_it_was(tmp_path: Path) -> None:
    kept = tmp_path / "kept.json"
    kept.write_text("kept")
    common.check_writable(kept, "--json")
    common.check_writable(tmp_path / "new.json", "--json")
    common.check_writable(Path(os.devnull), "--json")
    assert [path.name for path in tmp_path.iterdir()] == ["kept.json"]
    assert kept.read_text() == "kept"


def test_a_recording_is_kept_unless_it_may_go(tmp_path: Path) -> None:
    kept = tmp_path / "kept.rrd"
    kept.touch()
    (written,) = config.OutputOptions(record=kept).writes()
    with pytest.raises(InputError, match="expected a new file after --record; got one that exists"):
        common.check_writable(written.path, written.flag, replace=written.replace)
    (written,) = config.OutputOptions(record=kept, overwrite=True).writes()
    common.check_writable(written.path, written.flag, replace=written.replace)


def test_a_file_is_replaced_when_whole(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    target.write_bytes(b"old")
    link.symlink_to(target)
    with common.replacing(link) as file:
        file.write(b"new")
        assert target.read_bytes() == b"old"
    assert link.is_symlink()
    assert target.read_bytes() == b"new"

    def break_off() -> None:
        with common.replacing(target) as file:
            file.write(b"half")
            raise EOFError

    with pytest.raises(EOFError):
        break_off()
    assert target.read_bytes() == b"new"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "target"]


def test_a_device_is_written_to_not_replaced() -> None:
    with common.replacing(Path(os.devnull)) as file:
        file.write(b"gone")
    assert Path(os.devnull).is_char_device()


# JSON and streams


@dataclass(frozen=True)
class Result:
    value: float
    curve: object
    where: Path


def test_json_is_plain(tmp_path: Path) -> None:
    result = Result(math.nan, {"aee": np.array([1.0, math.inf]), "n": np.int64(3), "ok": np.bool_(True)}, Path("a"))
    common.write_json([result, (np.float32(0.5), np.float64(math.inf))], str(tmp_path / "r.json"))
    text = (tmp_path / "r.json").read_text()
    assert text.endswith("\n")
    assert json.loads(text) == [
        {"value": None, "curve": {"aee": [1.0, None], "n": 3, "ok": True}, "where": "a"},
        [0.5, None],
    ]
    with pytest.raises(TypeError, match="no JSON for object"):
        common.plain(object())


def talk(config_: config.FlowConfig) -> None:
    print("a library talks")
    common.show_table("Result", [("beta", "[0.5]")])
    with common.fit_progress() as note:
        note("work", 2, 2)
    common.write_json({"beta": 0.5}, config_.output.json)


def test_stdout_is_the_json_alone(command: Callable[..., list[str]], capsys: Capture) -> None:
    assert cli.main([*command(talk), "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"beta": 0.5}
    assert out.endswith("}\n")
    assert "a library talks" in err
    assert "[0.5]" in err


def test_the_table_is_on_stdout_otherwise(command: Callable[..., list[str]], capsys: Capture) -> None:
    assert cli.main([*command(talk), "--json", "r.json"]) == 0
    out, err = capsys.readouterr()
    assert "[0.5]" in out
    assert err == "JSON: r.json; open it with: python -m json.tool r.json\n"
    assert json.loads(Path("r.json").read_text()) == {"beta": 0.5}


def test_what_is_printed_below_python_is_kept_off_stdout() -> None:
    script = """
import os, sys
from deformscope.cli.common import json_alone, write_json
with json_alone("-"):
    print("python")
    os.write(1, b"below\\n")
    write_json({"beta": 0.5}, "-")
print("after")
"""
    told = run_python("-c", script)
    assert told.stdout == '{\n  "beta": 0.5\n}\nafter\n'
    assert sorted(told.stderr.split()) == ["below", "python"]


def test_the_viewer_goes_with_the_display(monkeypatch: Patch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert resolve_viewer("auto") == "none"
    assert resolve_viewer("page") == "page"
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert resolve_viewer("auto") == "native"


# The first start


@pytest.mark.parametrize(("compiled", "watched"), [(False, True), (True, True), (False, False)])
def test_a_first_start_says_that_it_compiles(
    compiled: bool, watched: bool, tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    warp = pytest.importorskip("warp")
    common.quiet_warp()
    capsys.readouterr()
    monkeypatch.setattr(warp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(common, "is_watched", lambda: watched)
    if compiled:
        (tmp_path / "wp_deformscope_lattice_3d_float64_8_0_0123456").mkdir()
    common.quiet_warp()
    assert ("compiling kernels once" in capsys.readouterr().err) == (watched and not compiled)
