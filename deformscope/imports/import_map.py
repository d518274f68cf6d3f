"""The map of an import in TOML: it assigns topics and tables to devices.

It is read strictly, like a rig file. Values that a source does not contain (a unit, a pose, clock offsets) are keys of
the map; while one reads `"?"` the import is refused with its name."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec

from deformscope.errors import InputError
from deformscope.file_io import read_file
from deformscope.frames import Kind, PadLayout
from deformscope.rig.rig_edit import lines_of, toml_value
from deformscope.rig.rig_file import SECTIONS

ASKED: Final = "?"
"""The value of a key that the source does not decide."""
MOST_NS: Final = 1 << 62
"""Largest time [ns]: 146 years from 0."""
HOW = "deformscope import --inspect SOURCE > map.toml"


class MappedStream(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One device's frames.

    topics: its topics, tables or files; if there are several, messages with the same time make a frame
    columns: place of each column (named as in an export) in the source, if its type has no default
    units: units of the source's fields that do not say them themselves
    time: the column of its stamps. For messages it is `header`, or `log` for their recorded times; for files, a text
    file with a stamp in each line, after the file's name or in their order; time_unit: s, ms, us or ns; offset_s:
    offset that is added to its stamps, if it has another clock [s]; None = it has the others' clock, which is checked
    nan: `keep` accepts forces that are NaN, which are otherwise refused
    unit_m: step of distances [m]: needed for files and `mono16`; for real numbers the default is 1e-4
    axes: the axes of points that lead to the camera's right, down, and along its view
    rotation: form of the three or four numbers of a table's rotation: `vector`, `xyzw`, `wxyz`, or the order of Euler
    angles as in SciPy, as `xyz` about fixed and `XYZ` about turned axes
    pose: topic of the end's poses, for states of joints; parent, child: its frames where that is of transforms
    pose_age_s: how far in time the newest pose may be from a state of joints, which is left out otherwise
    joints: names of the joints, in their order; focal_px, center_px, size_px: focal length, centre and size of the
    camera that points are projected into; pads: layout of a tactile sensor; rate_hz: rate of rows without a time"""

    device: str
    kind: Kind
    topics: tuple[str, ...]
    columns: dict[str, str] = {}
    units: dict[str, str] = {}
    time: str = "header"
    time_unit: str = ""
    offset_s: Annotated[float, msgspec.Meta(ge=-1e10, le=1e10)] | Literal["?"] | None = None
    nan: Literal["refuse", "keep"] = "refuse"
    unit_m: Annotated[float, msgspec.Meta(ge=0.0, le=1e3)] | Literal["?"] = 0.0
    axes: str = "x, y, z"
    rotation: str = ""
    pose: str = ""
    parent: str = ""
    child: str = ""
    pose_age_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e10)] = 0.5
    joints: tuple[str, ...] = ()
    focal_px: tuple[float, float] | None = None
    center_px: tuple[float, float] | None = None
    size_px: tuple[int, int] | None = None
    pads: tuple[PadLayout, ...] = ()
    rate_hz: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 0.0

    @property
    def step_m(self) -> float:
        """Step of distances [m]; 0 = not said."""
        return 0.0 if self.unit_m == ASKED else float(self.unit_m)

    @property
    def offset_ns(self) -> int:
        """Offset of its stamps [ns]; 0 = not said."""
        return 0 if self.offset_s == ASKED else round(float(self.offset_s or 0.0) * 1e9)

    def moved_ns(self, ns: float) -> int:
        """A stamp of the source with its offset [ns]. Raises InputError for one that no recording has."""
        if not abs(moved := ns + self.offset_ns) < MOST_NS or not abs(ns) < MOST_NS:
            hint = "another time_unit, or offset_s"
            raise InputError(f"times of {self.device} below {MOST_NS} ns", f"{moved:.4g}", hint)
        return round(ns) + self.offset_ns

    def missing(self, key: str, expected: str, came: object = ASKED, typed: str = "") -> InputError:
        """The error that asks for a key. typed: an example of a line for the map"""
        hint = f"{typed} in the map" if typed else HOW
        return InputError(f"{key} of {self.device} in the map: {expected}", f"{came!r}" if came else "none", hint)


class ImportMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How foreign data become devices. start_ns: the stamp at which the recording begins [ns]; None = the first;
    skip_rows: lines of CSV tables before their header; rig: sections of a rig file, such as `tool` and `camera`"""

    streams: tuple[MappedStream, ...] = ()
    start_ns: Annotated[int, msgspec.Meta(ge=-MOST_NS, le=MOST_NS)] | None = None
    skip_rows: int = 0
    rig: dict[str, dict[str, Any]] = {}

    def to_toml(self) -> str:
        """The map as TOML, without default values."""
        usual = MappedStream(device="", kind="wrench", topics=())
        lines = [f"start_ns = {self.start_ns}"] if self.start_ns is not None else []
        lines += [f"skip_rows = {self.skip_rows}"] if self.skip_rows else []
        for stream in self.streams:
            lines += ["", "[[streams]]"]
            for name in stream.__struct_fields__:
                value = getattr(stream, name)
                if name in ("device", "kind", "topics") or value != getattr(usual, name):
                    lines.append(f"{name} = {toml_value(msgspec.to_builtins(value))}")
        return "\n".join(lines).lstrip() + "\n"

    def rig_text(self) -> str:
        """The poses and the tool as text of a rig file; empty without them."""
        return lines_of(self.rig, digits="")


def read_map(path: Path, *, is_draft: bool = False) -> ImportMap:
    """Read a map. is_draft: it may lack streams and values. Raises InputError if it is no map, and names the wrong
    key."""
    try:
        said = tomllib.loads(read_file(path, "a map (TOML)", HOW).decode())
        if "rig" in said:
            raise ValueError("unknown field `rig`: its sections are at the top level")
        rig = {name: said.pop(name) for name in SECTIONS if isinstance(said.get(name), dict)}
        found = msgspec.convert(said | {"rig": rig}, ImportMap)
    except (RecursionError, ValueError, msgspec.ValidationError) as error:
        raise InputError("a map (TOML)", " ".join(str(error).split()), HOW, path) from error
    names = [stream.device for stream in found.streams]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError("each device once in the map", f"{twice[0]!r} twice", where=path)
    if not names and not is_draft:
        raise InputError("a map with [[streams]]", "none", HOW, path)
    shape = rig.get("shape", {})
    if named := next((one for one in ("urdf", "gripper") if one in shape), ""):
        hint = "the map without it: it may be another's, and names no file of this machine"
        raise InputError(f"[shape] in the map without {named}", repr(shape[named]), hint, path)
    for stream in found.streams:
        if stream.offset_s == ASKED and not is_draft:
            raise stream.missing("offset_s", "seconds to add to its stamps, which are of another clock")
    return found
