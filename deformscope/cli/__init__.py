"""The `deformscope` command: finds the requested command, reads its flags, runs it, and reports errors in one line.

    deformscope --help
    deformscope flow before.png after.png --out flow.npz

To add a command: a frozen dataclass of its flags in `deformscope/config/`, a file here with `run(config)`, and a line
in `COMMANDS`. `run` imports heavy modules inside, and returns an exit status if it is not always 0.
"""

import atexit
import contextlib
import gc
import importlib
import io
import os
import re
import select
import signal
import sys
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any

from deformscope.cli.examples import EXAMPLES
from deformscope.errors import InputError, printable, show_remarks
from deformscope.version import __version__

if TYPE_CHECKING:
    from deformscope.config import CommandOptions


@dataclass(frozen=True, slots=True)
class Command:
    """One command.

    summary: its line in `deformscope --help`; config: its class in `deformscope.config`; module: where it lives;
    function: runs it, called with the config"""

    summary: str
    config: str
    module: str
    function: str = "run"


def _command(summary: str, config: str, module: str, function: str = "run") -> Command:
    return Command(summary, config, f"deformscope.cli.{module}", function)


COMMANDS: dict[str, Command] = {
    "demo": _command("map a simulated table, without hardware", "DemoConfig", "demo"),
    "explore": _command("map the stiffness of a surface by touching it", "ExploreConfig", "explore"),
    "calibrate beta": _command("find beta from images or pair files", "BetaConfig", "calibrate"),
    "calibrate theta": _command("find theta from images or pair files", "ThetaConfig", "calibrate"),
    "calibrate axes": _command("find a beta along each axis from images or pair files", "AxesConfig", "materials"),
    "calibrate field": _command("relative stiffness of each place, from one deformation", "FieldConfig", "materials"),
    "calibrate yield": _command("yield strain, from a motion under load and release", "YieldConfig", "materials"),
    "calibrate viscous": _command(
        "relaxing share, relaxation time and permanent share, from a push and its release", "ViscousConfig", "materials"
    ),
    "predict": _command("predict pokes that were not fitted", "PredictConfig", "predict"),
    "simulate": _command("a measured slab in another simulator, fitted there", "SimulateConfig", "simulate"),
    "indent": _command("find Young's modulus from force over depth", "IndentConfig", "indent"),
    "squeeze": _command(
        "squeeze a container: one trial, or the name of its content", "SqueezeConfig", "explore", "squeeze"
    ),
    "classify": _command("evaluate classifiers of contents from squeezes", "ClassifyConfig", "classify"),
    "flow": _command("dense optical flow of two images", "FlowConfig", "flow"),
    "rig new": _command("write a rig file for what is plugged in", "NewRigConfig", "rig", "new"),
    "doctor": _command("check a rig, and name remedies", "DoctorConfig", "doctor"),
    "devices": _command("connected devices and their health", "DevicesConfig", "devices"),
    "calibrate tip": _command("find the tip's position on the arm, by tilting it", "TipConfig", "calibrate_setup"),
    "calibrate place": _command("find the surface's pose, by touching its corners", "PlaceConfig", "calibrate_setup"),
    "calibrate camera": _command("find the camera's pose, by a board on the arm", "CameraConfig", "calibrate_setup"),
    "calibrate force": _command(
        "find the force sensor's orientation, by pushing the tip", "ForceConfig", "calibrate_setup"
    ),
    "calibrate tool": _command("weigh the tool on the force sensor, by tilting it", "ToolConfig", "calibrate_setup"),
    "calibrate time": _command("find clock offsets, by tapping the tip", "TimeConfig", "calibrate_setup"),
    "calibrate arm": _command(
        "measure the arm's compliance, on something rigid", "ArmConfig", "calibrate_setup", "arm"
    ),
    "calibrate wrench": _command(
        "find what an arm's own force is worth, without contact", "WrenchConfig", "calibrate_setup", "arm"
    ),
    "certify": _command("find a rig's bias on a sample of known modulus", "CertifyConfig", "calibrate_setup", "arm"),
    "arm where": _command("the arm's pose: joints, end and tip", "WhereConfig", "arm", "where"),
    "arm files": _command("write the files for an arm's controller", "FilesConfig", "arm", "files"),
    "arm home": _command("send the arm to its home pose", "HomeConfig", "arm", "home"),
    "arm go": _command("bring the tip over a place of the surface", "GoConfig", "arm", "go"),
    "arm jog": _command("move the tip by keys, in small steps", "JogConfig", "arm", "jog"),
    "record": _command("record all devices of a rig", "RecordConfig", "recordings", "record"),
    "live": _command("show all devices of a rig", "LiveConfig", "recordings", "live"),
    "new-device": _command("write a package for a device of your own", "NewDeviceConfig", "new_device"),
    "double": _command("run simulated devices on real transports", "DoubleConfig", "double"),
    "replay": _command("run the same stages on recorded inputs, and compare", "ReplayConfig", "recordings", "replay"),
    "verify": _command("check whether a recording is complete", "VerifyConfig", "recordings", "verify"),
    "report": _command("the figures of a recording, as a page", "ReportConfig", "recordings", "report"),
    "catalog": _command("list and filter the recordings of a folder", "CatalogConfig", "recordings", "catalog"),
    "catalog compare": _command("compare two recordings", "CompareConfig", "recordings", "compare"),
    "sweep": _command("run a command on every file of a folder", "SweepConfig", "sweep"),
    "export": _command("write a recording in other formats", "ExportConfig", "recordings", "export"),
    "import": _command("make a recording from data of other robots", "ImportConfig", "recordings", "import_"),
    "recover": _command("make a complete recording from a truncated one", "RecoverConfig", "recordings", "recover"),
    "discard": _command(
        "mark a recording, or an episode of it, as unusable", "DiscardRecordingConfig", "recordings", "discard"
    ),
    "dataset list": _command("the trials of a data set of squeezes", "DatasetConfig", "dataset", "listing"),
    "dataset relabel": _command("correct labels of trials in the index", "RelabelConfig", "dataset", "relabel"),
    "dataset discard": _command("discard trials, with the reason", "DiscardConfig", "dataset", "discard"),
    "dataset merge": _command("copy trials of other data sets", "MergeConfig", "dataset", "merge"),
    "dataset repair": _command("add recordings that the index lacks", "RepairConfig", "dataset", "repair"),
    "bench": _command("cost of MSM on this machine", "BenchConfig", "bench"),
}
"""The commands by name; a name of two words (`calibrate beta`) makes a group."""

HEADINGS = {
    "demo": "Measure",
    "rig new": "Rig and robot",
    "replay": "Recordings and data sets",
    "bench": "This machine",
}
"""Text of `deformscope --help` above a command."""

BEGIN = (
    "deformscope: how soft a thing is, and where.\n\nFor a first run, map a simulated foam: open the printed "
    "address and press Explore.\n\n  deformscope explore lab:two-60-150 --paused --viewer page\n\ndeformscope "
    "--help   all commands"
)
"""Message of a call without arguments."""
TRACEBACK = "DEFORMSCOPE_TRACEBACK"
EXIT_INPUT, EXIT_UNEXPECTED, EXIT_INTERRUPTED, EXIT_PIPE = 2, 1, 130, 141
EXIT_SIGNALLED = 128
"""Exit status of a command that a signal ended: this plus the signal's number."""
COLLECT = (50_000, 20, 50)
"""Python's garbage collector looks at young objects less often than by default: a fifteenth of an exploration."""
FIRST = (400_000, *COLLECT[1:])
"""The same before its first look: modules take some 250 000 objects, which stay."""
atexit.register(gc.freeze)  # a last look through every object, which the system frees anyway, takes half a second

PACKAGES = {
    "libusb-1.0": "libusb-1.0-0",
    "libGL": "libgl1",
    "libEGL": "libegl1",
    "libX11": "libx11-6",
    "libudev": "libudev1",
    "libidn2": "libidn2-0",
    "libgomp": "libgomp1",
    "libOpenNI2": "libopenni2-0",
    "libvulkan": "libvulkan1",
}
"""Debian's package of each library that a dependency loads and that a plain system may lack."""


def main(args: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status; nothing is raised, and a traceback is shown only on request.

    0 done; 1 unexpected; 2 refused, in one line; 3 done with losses, which are named (`common.EXIT_LOSSES`);
    128 + its number: ended by a signal"""
    return guarded(_dispatch, list(sys.argv[1:] if args is None else args))


def _collect(phase: str, found: object) -> None:
    gc.callbacks.remove(_collect)
    gc.set_threshold(*COLLECT)


def guarded(dispatch: Callable[[list[str]], int], args: list[str]) -> int:
    """The exit status of a dispatcher of command lines, as in `main`."""
    show_remarks()
    gc.set_threshold(*FIRST)
    gc.callbacks.append(_collect)
    with _ended_by_signals() as signals:
        status = _status(dispatch, args, signals)
        if "deformscope.page.server.page_server" in sys.modules and status < EXIT_SIGNALLED:
            from deformscope.cli.common import keep_page

            keep_page()
    return EXIT_SIGNALLED + signals[0] if signals else status


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[list[int]]:
    """A request to end, and a terminal that is closed, interrupt like Ctrl-C, once; yields which did. Ignored signals,
    as by nohup, stay ignored; a command that moves or records something handles them itself."""
    came: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(number, signal.SIG_DFL)  # the next one ends it at once
        raise KeyboardInterrupt

    main_thread = threading.current_thread() is threading.main_thread()
    numbers = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    try:
        for number in numbers if main_thread else ():
            signal.signal(number, end)
        yield came
    finally:
        for number in numbers if main_thread else ():
            signal.signal(number, signal.SIG_DFL)


def quiet_libraries() -> None:
    """Silence libraries whose messages on stderr would hide the one line of an error."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("RUST_LOG", "off")  # rerun reads it as it is imported; recorder and viewer report for it


def _status(dispatch: Callable[[list[str]], int], args: list[str], signals: Sequence[int]) -> int:
    quiet_libraries()
    try:
        status = dispatch(args)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        how = f"ended by {signal.Signals(signals[0]).name}" if signals else "interrupted"
        print(f"deformscope: {how}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError as error:
        return _pipe_closed(error)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except InputError as error:
        return _fail(str(error), EXIT_INPUT)
    except Exception as error:
        refused = isinstance(error, OSError) and error.strerror and not _missing_library(error)
        return _fail(_explain(error), EXIT_INPUT if refused else EXIT_UNEXPECTED)


# Finding the command -------------------------------------------------------------------------------------------------


def _dispatch(args: list[str]) -> int:
    if not args or args[0] in ("-h", "--help"):
        print(_help() if args else BEGIN)
        return 0
    if args[0] == "--version":
        print(f"deformscope {__version__}")
        return 0
    name, rest = find_command(args)
    if name not in COMMANDS:
        print(_help(name))
        return 0
    command = COMMANDS[name]
    from deformscope import config

    return with_flags(
        getattr(config, command.config),
        lambda options: getattr(importlib.import_module(command.module), command.function)(options),
        rest,
        f"deformscope {name}",
    )


def with_flags(kind: type, run: Callable[[Any], object], args: Sequence[str], prog: str) -> int:
    """Read a command's flags into its options, check its files, and run it. prog: the command as typed"""
    options: CommandOptions = parse(kind, args, prog)
    return run_options(options, run)


def run_options(options: "CommandOptions", run: Callable[[Any], object]) -> int:
    """Check the files of a command's options, run it, and list what it wrote."""
    from deformscope.cli.common import check_writable, json_alone, list_written

    # no output may be out of reach, be another's output too, or replace an input
    inputs = {os.path.realpath(source) for source in options.reads()}
    flags: dict[str, str] = {}
    for file in options.writes():
        path = os.path.realpath(file.path)
        if path in inputs:
            raise InputError(f"a file after {file.flag} that is no input", "an input", "another name", file.path)
        if path in flags and not file.path.is_char_device():
            raise InputError(f"different files after {flags[path]} and {file.flag}", "the same twice", where=file.path)
        flags[path] = file.flag
        check_writable(file.path, file.flag, replace=file.replace)
    with json_alone(options.json_target()), list_written(options):
        status = run(options)
    return status if isinstance(status, int) else 0


def find_command(args: list[str]) -> tuple[str, list[str]]:
    """The command's full name, or a group's for its help, and the remaining arguments."""
    first, both = args[0], " ".join(args[:2])
    if both in COMMANDS:
        return both, args[2:]
    if first in COMMANDS:
        return first, args[1:]
    from deformscope.file_io import nearest

    groups = {name.split()[0] for name in COMMANDS if " " in name}
    if first not in groups:
        known = sorted({name.split()[0] for name in COMMANDS})
        near = nearest(first, known, like=0.6)
        kind = "a flag before any command" if first.startswith("-") else f"{first!r}"
        raise InputError(f"a command out of {', '.join(known)}", kind, f"deformscope {near or '--help'}")
    members = [name.split()[1] for name in COMMANDS if name.startswith(f"{first} ")]
    if len(args) > 1 and args[1] in ("-h", "--help"):
        return first, []
    if len(args) > 1 and args[1] in members:
        return f"{first} {args[1]}", args[2:]
    came = repr(args[1]) if len(args) > 1 else "nothing"
    near = nearest(args[1], members, like=0.6) if len(args) > 1 else ""
    raise InputError(f"{' or '.join(members)} after {first}", came, f"deformscope {first} {near or '--help'}")


def _help(group: str = "") -> str:
    shown = {name: command for name, command in COMMANDS.items() if not group or name.startswith(f"{group} ")}
    width = max(map(len, shown))
    lines = []
    for name, command in shown.items():
        lines += ["", f"{HEADINGS[name]}:"] if name in HEADINGS and not group else []
        lines.append(f"  {name:<{width}}  {command.summary}")
    return "\n".join(
        [
            f"usage: deformscope {group + ' ' if group else ''}COMMAND ...",
            "",
            "How soft a thing is, and where: watch it deform, fit a shape-matching model, see every stage.",
            *([""] if group else []),
            *lines,
            "",
            "deformscope COMMAND --help   its flags",
            "deformscope --version",
        ]
    )


# Reading the flags ---------------------------------------------------------------------------------------------------


class _UsageError(InputError):
    """A flag that cannot be read, with the parser's own text."""

    def __init__(self, words: str, try_this: str) -> None:
        Exception.__init__(self, f"{words} | try: {try_this}")


def parse(config: Any, args: Sequence[str], prog: str = "deformscope") -> Any:
    """Read a command's flags; every mistake is an InputError. Help goes to stdout and ends in SystemExit(0)."""
    import tyro

    with contextlib.ExitStack() as stack:
        said = stack.enter_context(contextlib.redirect_stderr(io.StringIO()))
        if "-h" not in args and "--help" not in args:
            stack.enter_context(_plain_terminal())
        try:
            return tyro.cli(config, args=list(args), prog=prog, config=(tyro.conf.FlagCreatePairsOff,))
        except SystemExit as stop:
            if stop.code in (0, None):
                if example := EXAMPLES.get(prog.removeprefix("deformscope ")):
                    print(f"example:\n{textwrap.indent(example, '  ')}")
                raise
    raise _usage_error(said.getvalue(), prog)


@contextlib.contextmanager
def _plain_terminal() -> Iterator[None]:
    """Make tyro draw its errors in one way on any terminal. It has no public access to their parts, puts them into
    boxes of many lines, and would break a line within the user's words."""
    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "4000"
    try:
        with contextlib.redirect_stdout(io.TextIOWrapper(io.BytesIO(), "utf-8", "backslashreplace")):
            yield
    finally:
        if columns is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = columns


_FRAME = re.compile(r"^[│╭╰] ?|\s*[│╮╯]$")

_CONVERSIONS = (
    (re.compile(r"invalid literal for int\(\) with base 10: (.*)"), r"expected a whole number; got \1"),
    (re.compile(r"could not convert string to float: (.*)"), r"expected a number; got \1"),
)


def _usage_error(boxed: str, prog: str) -> InputError:
    """One line out of tyro's box, whose sections are separated by rules: title, error, hints."""
    lines = [_FRAME.sub("", line) for line in boxed.splitlines()]
    body = [line for line in lines[1:-1] if line.strip()]
    rules = [index for index, line in enumerate(body) if set(line.strip()) == {"─"}]
    wrong = body[: rules[0]] if rules else body
    text = " ".join(" ".join(wrong).split())
    help_hint = f"{prog} --help"

    if text.startswith("Missing from"):
        # An argument stands four columns in, its help eight.
        missing = [line.strip() for line in wrong[1:] if line.startswith("    ") and not line.startswith("     ")]
        return InputError(" and ".join(missing) or "more arguments", "none", help_hint)
    if found := re.match(r"Error parsing (\S+): (.*)", text):
        problem = found[2]
        for theirs, ours in _CONVERSIONS:
            problem = theirs.sub(ours, problem)
        return _UsageError(f"{found[1]}: {problem}", help_hint)
    if found := re.match(r"invalid choice (.*) for argument '(.*)'\. Expected one of \((.*)\)\.", text):
        return _UsageError(f"{found[2]}: expected one of {found[3].rstrip(',')}; got {found[1]}", help_hint)
    if found := re.match(r"Missing value for argument '(.*)'", text):
        return InputError(f"a value after {found[1]}", "none", help_hint)
    if found := re.match(r"Unrecognized options: (.*)", text):
        meant = re.search(r"Perhaps you meant:\s+(--[\w-]+)", " ".join(body))
        unknown = found[1].replace(", ", " ")
        return InputError(f"only known flags for {prog}", unknown, meant[1] if meant else help_hint)
    return _UsageError(text or "the command line was not understood", help_hint)


# Reporting errors -----------------------------------------------------------------------------------------------------


def _fail(message: str, status: int) -> int:
    if os.environ.get(TRACEBACK):
        traceback.print_exc()
    print(f"deformscope: error: {printable(' '.join(message.split())[:2000])}", file=sys.stderr)
    return status


def _explain(error: Exception) -> str:
    """One line on an error that no command foresaw."""
    if library := _missing_library(error):
        package = next((PACKAGES[name] for name in PACKAGES if library.startswith(f"{name}.")), "")
        hint = f"sudo apt-get install -y {package}" if package else "install it with the system's package manager"
        return f"expected the system library {library}; got none on this machine | try: {hint}"
    if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith("deformscope"):
        return (
            f"expected the Python package {error.name}; got none here | try: pip install --force-reinstall deformscope"
        )
    if isinstance(error, OSError) and error.strerror:
        where = "" if error.filename is None else f" | {error.filename}"
        return f"the system refused: {error.strerror}{where}"
    if isinstance(error, MemoryError):
        return "expected enough memory; got too little | try: fewer particles, candidates or smaller images"
    words = " ".join(str(error).split())[:500]
    return f"unexpected {type(error).__name__}: {words} | set {TRACEBACK}=1 for the traceback"


def _missing_library(error: BaseException) -> str:
    """The shared object that the loader did not find, from the error or its cause."""
    cause: BaseException | None = error
    seen = set[int]()  # a chain may lead back to where it began
    while cause is not None and id(cause) not in seen:
        seen.add(id(cause))
        if isinstance(cause, ImportError | OSError):
            found = re.search(r"(lib[\w.+-]*?\.so[\w.]*): cannot open shared object", str(cause))
            if found:
                return found[1]
        cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)
    return ""


def _pipe_closed(error: BrokenPipeError) -> int:
    """Quiet if the reader of stdout has gone (`| head`); a device's pipe that broke is an error like any other."""
    try:
        descriptor = sys.stdout.fileno()
        poll = select.poll()
        poll.register(descriptor, select.POLLOUT)
        gone = any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except (OSError, AttributeError):
        return _fail(_explain(error), EXIT_UNEXPECTED)
    if not gone:
        return _fail(_explain(error), EXIT_UNEXPECTED)
    # Python flushes stdout once more as it ends, and would complain there.
    os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
    return EXIT_PIPE
