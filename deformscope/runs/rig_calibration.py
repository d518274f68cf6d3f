"""`deformscope calibrate tip`, `place`, `camera`, `force`, `tool` and `time`: measure, solve, write."""

import dataclasses
import datetime
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy.typing as npt

from deformscope.errors import InputError
from deformscope.experiments.rig.rig_calibration import Assistant, SetupRequest
from deformscope.file_io import read_file, replacing
from deformscope.files.arrays_file import read_arrays
from deformscope.frames import InputFile
from deformscope.lab.rig_members import member_of
from deformscope.log.findings import RigFindings
from deformscope.pictures.report import Figure, Findings, Table
from deformscope.rig.rig_edit import Values, edited, lines_of
from deformscope.rig.rig_file import Rig, load_rig
from deformscope.robot.setup import ROLES, RigParts, only_device, open_rig
from deformscope.runs.opened_devices import table_of
from deformscope.runs.skeleton import RunOperator, at_terminal, open_rig_run
from deformscope.session import RigExperiment, Step, run
from deformscope.terminal import Interruption, say, until_interrupted

if TYPE_CHECKING:
    from deformscope.config import SetupOptions
    from deformscope.lab.randomized_rig import SimulatedHand
    from deformscope.recording.recorder import Recorder
    from deformscope.rig.source import RigSource

M = TypeVar("M")
Arrays = Mapping[str, npt.NDArray[Any]]
TAPS_S = (0.9, 1.3, 0.7, 1.6, 1.0)
"""Times between the taps of a simulated person: uneven."""


@dataclass(frozen=True, slots=True)
class RigCalibrationResult:
    """Result of a rig calibration.

    kind: place, tip, camera, force, tool or time; values: values for the rig file; rows: names and values of the table;
    figure: how far each measurement is off; found: results for JSON; kept: what its recording has for a replay"""

    kind: str
    values: Values
    rows: tuple[tuple[str, str], ...]
    figure: Figure
    found: Mapping[str, Any] = field(default_factory=dict)
    kept: Sequence[InputFile | Step] = ()

    @property
    def dated(self) -> Values:
        """The values, with the date."""
        section = f"calibrated.{self.kind}"
        return {**self.values, section: {"date": today(), **self.values.get(section, {})}}

    def findings(self, where: str) -> Findings:
        """Table and picture of a calibration. where: the rig's name"""
        return Findings((Table(self.rows, caption=f"{self.kind} of {where}"),), (self.figure,))


def today() -> datetime.date:
    """Today by this computer's clock, in UTC, from which ages are counted."""
    return datetime.datetime.now(tz=datetime.UTC).date()


@dataclass(frozen=True, slots=True)
class Station:
    """The participants. arm, wrench, camera: names of devices, empty if the rig has none; operator: the person, real or
    simulated, who moves things"""

    arm: str
    wrench: str
    camera: str
    operator: Assistant


@dataclass(frozen=True, slots=True)
class SetupTask(Generic[M]):
    """One of the commands that calibrate a set-up.

    kind: its kind; needs: kinds of devices; measure: the experiment; arrays: measurements from a file of arrays; solve:
    its solution; recorded: measurements from a recording"""

    kind: str
    needs: tuple[str, ...]
    measure: Callable[[Station], RigExperiment[M]]
    arrays: Callable[[Arrays], M]
    solve: Callable[[Rig, M], RigCalibrationResult]
    recorded: Callable[[Path], M] | None = None


def set_up(config: "SetupOptions", task: SetupTask[M], recorder: "Recorder") -> RigCalibrationResult:
    """Measure, or read an earlier measurement; solve; write into the rig file unless --no-write is given."""
    rig = load_rig(config.rig, trusted=config.trust_rig)
    if config.measured is not None:
        if config.measured.suffix == ".rrd" and task.recorded is not None:
            made = task.recorded(config.measured)
        else:
            expected = "a file of arrays (.npz)"
            made = task.arrays(read_arrays(read_file(config.measured, expected), expected, config.measured))
        found = task.solve(rig, made)
        recorder.write(Step((found.findings(rig.name),)))
    else:
        with until_interrupted() as asked:
            devices, station = _devices(rig, task, asked)
            with open_rig_run(devices, recorder) as opened:
                made = run(opened.source, task.measure(station), recorder)
                found = task.solve(rig, made)
                recorder.write(Step((RigFindings(found.findings(rig.name), tuple(opened.source.streams)),)))
    if config.write:
        write_values(Path(config.rig), found.dated)
    return found


def write_values(path: Path, values: Values) -> None:
    """Write into the rig file; a failure leaves it unchanged."""
    from deformscope.rig.rig_file import parse_rig

    text = edited(path.read_text(encoding="utf-8"), values)
    parse_rig(text, str(path), trusted=True)
    with replacing(path) as file:
        file.write(text.encode())
    say(f"written into {path}: {', '.join(f'[{section}]' for section in values)}")


def written_lines(found: RigCalibrationResult) -> str:
    """New lines of a rig file."""
    return lines_of(found.dated)


# Devices and the person at them ---------------------------------------------------------------------------------------


def _devices(
    rig: Rig, task: SetupTask[Any], asked: Interruption
) -> "tuple[AbstractContextManager[RigSource], Station]":
    """The devices, not opened, and the operator: a person at a terminal, or the laboratory's."""
    if not rig.surface.scene:
        devices = {kind: only_device(rig, kind, "to measure with") for kind in task.needs}
        arm, wrench, camera = (devices[kind].name if kind in devices else "" for kind in ROLES)
        measured = dataclasses.replace(rig, devices=tuple(devices.values()))
        return open_rig(measured, member_of, None, ()), Station(arm, wrench, camera, _at_terminal(asked))
    from deformscope.lab.randomized_rig import SimulatedHand

    parts = RigParts.of(rig)
    table, randomized = table_of(parts)
    assert table is not None
    if randomized is None:
        came = "doubles are at the poses of the file"
        raise InputError(
            "a calibration that is still missing",
            came,
            "hidden = 1 in [surface]: random poses, for calibration",
            rig.name,
        )
    arm, wrench, camera = (entry.name for entry in parts.devices)
    hand = _simulated(SimulatedHand(randomized, table, table.size_m), asked)
    return open_rig(rig, member_of, table, parts.devices), Station(arm, wrench, camera, hand)


def _at_terminal(asked: Interruption) -> Assistant:
    """A person who reads the requests, carries them out, and presses Enter."""
    if not at_terminal():
        raise InputError("a person who follows the requests", "no terminal for questions", "--measured FILE.npz")

    def does(request: SetupRequest) -> RigExperiment[None]:
        say(f"{request.words}; then Enter")
        yield from RunOperator(asked).line("")
        _go_on(asked)

    return does


def _go_on(asked: Interruption) -> None:
    """Raises InputError if a person has requested the end."""
    if asked.is_set():
        raise InputError("an answer to each request", "Ctrl-C: nothing was written", "begin again")


def _simulated(hand: "SimulatedHand", asked: Interruption) -> Assistant:
    """The laboratory's person, who releases and taps while frames pass."""

    def does(request: SetupRequest) -> RigExperiment[None]:
        _go_on(asked)
        does_so = "holds it in its own way" if request.kind == "view" else "does so"
        say(f"{request.words} (a simulated person {does_so})")
        hand.do(request.kind, request.number, request.axis)
        if request.kind == "tap":
            from deformscope.lab.randomized_rig import TAP_S

            for pause_s in TAPS_S:
                yield Step(batch_s=pause_s)
                hand.tap()
                yield Step(batch_s=TAP_S)
                hand.let_go()
        yield Step(batch_s=0.3)

    return does
