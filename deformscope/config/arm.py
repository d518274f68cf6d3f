"""Moving an arm by itself or by keys: `deformscope arm where`, `files`, `home`, `go` and `jog`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes

from deformscope.config import flags
from deformscope.config.options import CommandOptions, RecordedOptions, ViewOptions


@dataclass(frozen=True, slots=True)
class WhereConfig(CommandOptions):
    """Say where the arm is: its joints and how far they are from their limits, its end, the tip. Nothing moves."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    trust_rig: flags.TrustFlag = False
    json: flags.JsonFlag = None
    """Write it as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class FilesConfig(CommandOptions):
    """Write the files that set up a KUKA's controller for a rig: program, signals, and what goes over the network, with
    the rig file's address, port, cycle and speed limit. Nothing is opened, nothing moves."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    out: flags.Folder = Path("controller")
    """Folder for the files; those of the same name are replaced."""
    trust_rig: flags.TrustFlag = False


@dataclass(frozen=True, slots=True)
class HomeConfig(CommandOptions):
    """Send the arm to its home pose, by its own path and at its own speed: once after it was switched on. Nothing
    watches the way: keep it free."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    yes: bool = False
    """Without asking."""
    trust_rig: flags.TrustFlag = False


@dataclass(frozen=True, slots=True)
class MovingOptions(RecordedOptions):
    """What `go` and `jog` share."""

    rig: flags.RigFlag
    """A rig file (.toml) with arm, force sensor and depth camera."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class GoConfig(MovingOptions):
    """Bring the tip over a place of the surface, stick down, watched by the same supervisor as an exploration."""

    above: flags.PlaceFlag = None
    """Where, in the surface frame [m]; default: its middle."""
    height: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 0.1
    """Of the tip's lowest point above the surface [m]."""


@dataclass(frozen=True, slots=True)
class JogConfig(MovingOptions):
    """Move the tip by keys in small steps, watched by the same supervisor as an exploration: a press is a step, a held
    key goes on, and nothing moves once no key is held."""
