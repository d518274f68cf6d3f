"""The force over time that belongs to images: of their own recording, or of a log."""

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.config.calibrate import PushFlags
from deformscope.config.flags import FORCE_UNITS, force_n
from deformscope.errors import InputError
from deformscope.experiments.fit.push_force import PushOptions
from deformscope.file_io import resolve
from deformscope.frames import InputFile, WrenchFrame
from deformscope.imports.frame_builder import SI, TIME_NS
from deformscope.imports.import_map import ImportMap
from deformscope.imports.inspect import TIMES, inspect, propose
from deformscope.imports.readers import TABLE_TYPES, Reader, open_reader
from deformscope.imports.source import ImportSource
from deformscope.recording.reader import Replay, read_rows
from deformscope.runs.pair_calibration import arrays_bytes
from deformscope.stages.materials.press_cycle import PressForce

FORCE_FILE = "force"
"""Part of another recording's force sensor that a run uses, and its recording stores."""
FREE_SHARE = 0.05
"""Number of a force sensor's first readings that give its zero."""
UNITS = {name: factor for name, (of, factor) in SI.items() if of == "N"} | FORCE_UNITS


def push_of(flags: PushFlags) -> tuple[PushOptions | None, PressForce | None]:
    """The force of the options, and its log."""
    if flags.force is None:
        return None, None
    known = {one: force_n(text) for one, text in (("force_n", flags.force), ("force_sd_n", flags.force_sd)) if text}
    push = PushOptions(**flags.shared(PushOptions) | known)
    return push, read_force(flags) if push.force_n is None else None


def read_force(push: PushFlags) -> PressForce:
    """The log of `--force`, without its zero, on a clock of its own; of a recording, time since 1970 [s]."""
    path = resolve(str(push.force))
    if path.suffix.lower() == ".rrd":
        if (found := recorded_force(path, push.force_sensor, 0)) is None:
            raise InputError("a recording with a force", "one without", where=path)
        return found
    with open_reader(path) as reader:
        streams = [one for one in propose(reader, inspect(reader)).streams if one.kind == "wrench"]
        tables = [one for one in streams if reader.topics[one.topics[0]].type in TABLE_TYPES]
        tables = [one for one in tables if not reader.topics[one.topics[0]].kind]
        if len(tables) == 1 and len(streams) == 1:
            return _of_table(reader, tables[0].topics[0], push, path)
        names = [one.device for one in streams if one not in tables]
        chosen = [one for one in streams if one.device in ([push.force_sensor] if push.force_sensor else names)]
        if len(chosen) != 1:
            hint = f"--force-sensor {names[0]}" if names else ""
            raise InputError("a log with one force sensor", ", ".join(names) or "none", hint, path)
        with ImportSource(reader, ImportMap((chosen[0],))) as source:
            frames = [one for one in source.drain() if isinstance(one, WrenchFrame)]
    return _of_frames(frames, 0, path)


def _of_table(reader: Reader, topic: str, push: PushFlags, path: Path) -> PressForce:
    """The force in a column of a table, with the times in another."""
    named = {name: unit_of(name, unit) for name, unit in reader.topics[topic].units.items()}
    bare = {name: re.split(r"[\s\[(<#]|_(?:n|u|m)?s$", name)[0].lower() for name in named}
    time = next((name for known in TIMES for name, base in bare.items() if known in (base, name)), "")
    columns = [name for name, unit in named.items() if unit in UNITS and name != time]
    if push.force_column is not None:
        columns = [name for name in named if push.force_column in (name, name.partition(" ")[0])]
    elif push.force_unit is not None and not columns:
        columns = [name for name in named if name != time]
    if len(columns) != 1:
        hint = f"--force-column NAME out of {', '.join(name for name in named if name != time)}"
        came = ", ".join(columns) or push.force_column or "none whose name has a unit, such as force [N] or weight_g"
        raise InputError("one column with the force", came, hint, path)
    unit = push.force_unit or named[columns[0]]
    if unit not in UNITS:
        came, hint = unit or f"none in {columns[0]!r}", f"--force-unit {' or '.join(FORCE_UNITS)}"
        raise InputError("the unit of the force", came, hint, path)
    if not time or named[time] not in TIME_NS:
        came = f"{time!r} without a unit" if time else "none"
        raise InputError("a column with the time, such as time_s", came, "name it so in the table's header", path)
    rows = [(one.value[time], one.value[columns[0]]) for one in reader.messages([topic])]
    try:
        rows = [row for row in rows if None not in row]
        begin = rows[0][0] if rows and isinstance(rows[0][0], int) else 0  # a clock's nanoseconds
        table = np.array([(at - begin, value) for at, value in rows], dtype=np.float64).reshape(-1, 2)
    except (TypeError, ValueError):
        raise InputError(f"numbers in {time} and {columns[0]}", "texts", "--force-column NAME", path) from None
    return _zeroed(table[:, 0] * (TIME_NS[named[time]] / 1e9), UNITS[unit] * table[:, 1, None, None], path)


def unit_of(name: str, said: str) -> str:
    """The unit of a column: what the table says, else the end of its name (`time_s`, `depth_mm`, `force [N]`)."""
    ends = re.split(r"[_(\[]", name.partition("#")[0])[1:]
    end = ends[-1].strip(" )]") if ends else ""
    return said or next((one for one in (*UNITS, *SI, *TIME_NS) if end in (one, one.lower())), "")


def recorded_force(path: Path, sensor: str | None, began_ns: int, flag: str = "--force-sensor") -> PressForce | None:
    """The force in a recording of images, None without one.

    sensor: name of the sensor, needed if several were recorded; began_ns: time of the first frame. The first readings
    give the sensor's zero, as nothing touches it at the start. flag: the flag that names the sensor"""
    found: dict[str, list[WrenchFrame]] = {}
    for row in read_rows(Replay(path, trust=True), (WrenchFrame,)):
        if row.item.usable and np.isfinite(row.item.force_n).all():
            found.setdefault(row.item.device, []).append(row.item)
    if sensor is not None and sensor not in found:
        came = ", ".join(found) or "a recording without forces"
        raise InputError(f"a force sensor {sensor!r} in the recording", came, where=path)
    if not found:
        return None
    if sensor is None and len(found) > 1:
        raise InputError("one force sensor", ", ".join(found), f"{flag} {next(iter(found))}", path)
    return _of_frames(found[sensor or next(iter(found))], began_ns, path)


def _of_frames(frames: Sequence[WrenchFrame], began_ns: int, path: Path) -> PressForce:
    time_s = np.array([1e-9 * (one.stamp.host_ns - began_ns) for one in frames])
    return _zeroed(time_s, np.array([one.force_n for one in frames]), path)


def _zeroed(time_s: FloatArray, read: FloatArray, path: Path) -> PressForce:
    """The magnitude of forces (n, channels, axes) less their first ones."""
    good = np.isfinite(time_s) & np.isfinite(read).all(axis=(1, 2))
    good[good] &= np.append(True, np.diff(time_s[good]) > 0.0) if good.any() else False
    time_s, read = time_s[good], read[good]
    if len(time_s) < 5:
        raise InputError("a force log of 5 readings with rising times", str(len(time_s)), where=path)
    free = max(5, round(FREE_SHARE * len(read)))
    zeroed = read - np.median(read[:free], axis=0)
    force_n = np.linalg.norm(zeroed, axis=2).sum(axis=1)
    if zeroed.shape[1:] == (1, 1):  # its zero may change, and with it a sign
        force_n = zeroed[:, 0, 0] * np.sign(zeroed[np.abs(zeroed).argmax(), 0, 0])
    return PressForce(time_s, force_n, float(np.std(force_n[:free])))


def force_file(force: PressForce) -> InputFile:
    """The log for a recording, so that it can be replayed."""
    arrays = arrays_bytes(time_s=force.time_s, force_n=force.force_n, zero_sd_n=force.zero_sd_n)
    return InputFile(FORCE_FILE, arrays)


def kept_force(recording: Replay) -> PressForce | None:
    """The force from which a recorded run was computed."""
    raw = recording.read_inputs().get(FORCE_FILE)
    if raw is None:
        return None
    with np.load(io.BytesIO(raw), allow_pickle=False) as found:
        return PressForce(found["time_s"], found["force_n"], float(found["zero_sd_n"]))
