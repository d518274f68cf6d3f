"""What is plugged in: `deformscope devices`, `doctor`, `record`, `live`, `verify` and `double`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config.flags import JsonFlag, PictureFlag, PositiveFlag, TrustFlag, finite, one_word, positive, unset
from deformscope.config.options import (
    CommandOptions,
    JsonOptions,
    OutputOptions,
    RecordedOptions,
    Written,
    check_suffix,
    written_json,
)
from deformscope.errors import InputError


@dataclass(frozen=True, slots=True)
class DevicesConfig(JsonOptions):
    """List what is plugged into this machine: port, serial number, firmware, health. Devices that are known by their
    USB identity, and doubles that run, are opened for a moment and asked: nothing moves, but an OptoForce is set to its
    driver's default rate and filter, and forgets its zero."""

    probe: bool = True
    """Open what is known and ask it; --no-probe lists only what the system knows."""
    json: JsonFlag = None
    """Write the list as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DoctorConfig(JsonOptions):
    """Try a rig: its file, every device of it for a few seconds, the disk; say what is wrong and what to do. Nothing
    moves."""

    rig: Annotated[str, Positional, arg(metavar="RIG")] = ""
    """A rig file (.toml), or lab:NAME."""
    example: bool = False
    """Print a rig file to start from, and do nothing else."""
    seconds: Annotated[float, one_word("NUMBER", positive)] = 2.0
    """How long every device is listened to [s]."""
    trust_rig: TrustFlag = False
    json: JsonFlag = None
    """Write what was found as JSON; with -, stdout is the JSON alone."""

    def __post_init__(self) -> None:
        if not self.rig and not self.example:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope doctor --example > rig.toml")

    def reads(self) -> tuple[str, ...]:
        return (self.rig,) if self.rig else ()


@dataclass(frozen=True, slots=True)
class RigRunOptions(RecordedOptions):
    """A rig that is recorded or watched until its time is over, or until Ctrl-C."""

    rig: Annotated[str, Positional, arg(metavar="RIG")]
    """A rig file (.toml), or lab:NAME."""
    seconds: PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""
    label: str = ""
    """What is being recorded, in your words; kept in the recording."""
    trust_rig: TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def reads(self) -> tuple[str, ...]:
        return (self.rig,)


@dataclass(frozen=True, slots=True)
class RecordConfig(RigRunOptions):
    """Record all devices of a rig, with every byte of their wires and what was lost. Without --record the file is
    runs/NAME-<stamp>.rrd. Ctrl-C ends it cleanly. No viewer, unless --viewer asks for one."""


@dataclass(frozen=True, slots=True)
class LiveConfig(RigRunOptions):
    """Watch all devices of a rig in rerun's window; with --record, record them as well."""


@dataclass(frozen=True, slots=True)
class VerifyConfig(JsonOptions):
    """Say whether a recording is whole: its bytes against its ledger, its structure, and what it counted as lost."""

    recording: Annotated[Path, Positional, arg(metavar="FILE.rrd")]
    """The recording."""
    json: JsonFlag = None
    """Write the findings as JSON; with -, stdout is the JSON alone."""

    def reads(self) -> tuple[str, ...]:
        return (str(self.recording),)


@dataclass(frozen=True, slots=True)
class RecoverConfig(JsonOptions):
    """Make a whole recording, with its ledger, of one whose run was killed or that was cut off: all that can be read of
    it. The original is only read."""

    recording: Annotated[Path, Positional, arg(metavar="FILE.rrd")]
    """The unfinished recording (NAME.part.rrd), or one that was cut off."""
    out: Annotated[Path | None, one_word("FILE.rrd", Path), unset] = None
    """The new recording; default: NAME.recovered.rrd beside it. An existing file is refused."""
    json: JsonFlag = None
    """Write what there is as JSON; with -, stdout is the JSON alone."""

    def __post_init__(self) -> None:
        check_suffix("--out", self.out, ".rrd")

    def reads(self) -> tuple[str, ...]:
        return (str(self.recording),)

    def writes(self) -> tuple[Written, ...]:
        out = () if self.out is None else (Written("--out", self.out, replace=False),)
        return (*out, *written_json(self.json))


@dataclass(frozen=True, slots=True)
class DoubleConfig(CommandOptions):
    """Run simulated devices that speak the real bytes at the real pace, until Ctrl-C; prints the rig file that reaches
    them from another terminal."""

    what: Annotated[tuple[str, ...], Positional, arg(metavar="DRIVER|RIG")]
    """Drivers (optoforce, dsa, sdh), or a rig file or lab:NAME whose byte-stream devices are to be doubled."""
    seconds: PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""


@dataclass(frozen=True, slots=True)
class ExploreConfig(RecordedOptions):
    """Map how soft a surface is, and where: look, touch where it adds most to the map, map, again; regions in the end.
    RIG is a rig file with an arm, a force sensor and a depth camera: the arm moves, after a table of checks and a
    question. lab:NAME is a simulated table, explored through the real drivers on byte-exact doubles."""

    rig: Annotated[str, Positional, arg(metavar="RIG|lab:NAME")] = ""
    """A rig file (.toml), or a simulated scene; --list-scenarios names these."""
    list_scenarios: bool = False
    """Name the simulated scenes, what their seeds draw, and what can go wrong in them; do nothing else."""
    touches: int = 8
    """Touches at most."""
    planner: Literal["regions", "integrated-variance", "max-variance", "random-above"] = "regions"
    """Where to touch next: where the map of regions gains most a second (default), two rules by the field's
    variance, or the thesis's (any place above --threshold)."""
    threshold: float = 0.06
    """Variance, as a share of that before any touch, below which a place needs no touch (Th of the thesis)."""
    set_force: PositiveFlag = None
    """Force to press with [N], 5 N at most; default: the rig file's target_force_n, which is 3 N unless it says. Where
    it makes a dent below 2 mm, 5/3 of it (5 N at most) is pressed with."""
    beta_model: Literal["volume", "thesis", "none"] = "volume"
    """What beta is fitted with: layers below the surface, the thesis's single layer with one held particle, or none."""
    fault: Annotated[
        UseAppendAction[tuple[str, ...]], arg(metavar="KIND@TOUCH", help_behavior_hint="(repeatable)")
    ] = ()
    """Let something go wrong in a simulated touch, counted from 1, such as force-silent@2, at a moment drawn from the
    seed; --list-scenarios names the kinds."""
    picture: PictureFlag = None
    """Draw the maps to a PNG."""
    map: Annotated[Path | None, one_word("FILE.npz", Path), unset] = None
    """Write the maps as arrays: stiffness [N/mm], its deviation (of its log), regions, their probability, beta."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if not self.rig and not self.list_scenarios:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope explore --list-scenarios")
        if self.touches < 1:
            raise InputError("--touches of 1 or more", str(self.touches))
        if self.set_force is not None and self.set_force > 5.0:
            raise InputError("--set-force up to 5 N", f"{self.set_force:g}")
        check_suffix("--picture", self.picture, ".png")
        check_suffix("--map", self.map, ".npz")

    def reads(self) -> tuple[str, ...]:
        return (self.rig,) if self.rig else ()

    def own_files(self) -> tuple[tuple[str, Path | None], ...]:
        return ("--picture", self.picture), ("--map", self.map)


def parse_place(text: str) -> tuple[float, float]:
    """`X,Y` [m]."""
    try:
        x, y = (finite(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected X,Y in metres, such as 0.30,0.20; got {text!r}") from None
    return x, y


@dataclass(frozen=True, slots=True)
class ArmConfig(RecordedOptions):
    """Measure the compliance of the arm, by touching something rigid that stands firmly on the surface: what
    [tool] of the rig file wants. The arm moves, after a table of checks and a question."""

    rig: Annotated[str, Positional, arg(metavar="RIG|lab:NAME")]
    """A rig file (.toml), or a simulated scene (lab:homogeneous-rigid)."""
    at: Annotated[tuple[float, float] | None, one_word("X,Y", parse_place)] = None
    """Where to touch, in the surface frame [m]; default: the middle."""
    touches: int = 3
    """How often."""
    set_force: PositiveFlag = None
    """Force to press with [N], 5 N at most, and 5/3 of it (5 N at most) since nothing gives; default: the rig file's
    target_force_n."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if self.touches < 1:
            raise InputError("--touches of 1 or more", str(self.touches))
        if self.set_force is not None and self.set_force > 5.0:
            raise InputError("--set-force up to 5 N", f"{self.set_force:g}")

    def reads(self) -> tuple[str, ...]:
        return (self.rig,)
