"""Moving an arm to a pose or by keys: `deformscope arm where`, `files`, `home`, `go` and `jog`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes

from deformscope.config import flags
from deformscope.config.options import CommandOptions, RecordedOptions, ViewOptions


@dataclass(frozen=True, slots=True)
class WhereConfig(CommandOptions):
    """Print the pose of the arm: its joints with their distance from the limits, its end, and the tip. Nothing
    moves."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    trust_rig: flags.TrustFlag = False
    json: flags.JsonFlag = None
    """Write it as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class FilesConfig(CommandOptions):
    """Write the files that set up an arm's controller for a rig, where its driver has any: program, signals, network.
    They hold the rig file's address, port, cycle and speed limit. Nothing is opened, nothing moves."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    out: flags.Folder = Path("controller")
    """Folder for the files; files of the same name are replaced."""
    trust_rig: flags.TrustFlag = False


@dataclass(frozen=True, slots=True)
class HomeConfig(CommandOptions):
    """Send the arm to its home pose, on its own path and at its own speed: once after it was switched on. No supervisor
    checks this motion: keep the way free."""

    rig: flags.RigFlag
    """A rig file (.toml)."""
    yes: bool = False
    """Move without asking for permission."""
    trust_rig: flags.TrustFlag = False


@dataclass(frozen=True, slots=True)
class MovingOptions(RecordedOptions):
    """Options that `go` and `jog` share."""

    rig: flags.RigFlag
    """A rig file (.toml) with arm, force sensor and depth camera."""
    yes: bool = False
    """Let a real arm move without asking, once the checks have passed."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)


@dataclass(frozen=True, slots=True)
class GoConfig(MovingOptions):
    """Bring the tip over a place of the surface, stick down. The supervisor of explorations checks the motion."""

    above: flags.PlaceFlag = None
    """Target in the surface frame [m]; default: its middle."""
    height: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 0.1
    """Height of the tip's lowest point above the surface [m]."""


@dataclass(frozen=True, slots=True)
class JogConfig(MovingOptions):
    """Move the tip by keys in small steps; the supervisor of explorations checks the motion. One press is one step, a
    key held down repeats it, and the tip rests while no key is held."""
