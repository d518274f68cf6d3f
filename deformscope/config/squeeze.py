"""`deformscope squeeze` and `deformscope dataset`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config.flags import JsonFlag, ModelFlag, TrustFlag, one_word, unset
from deformscope.config.options import JsonOptions, OutputOptions, RecordedOptions
from deformscope.errors import InputError

FolderFlag = Annotated[Path | None, one_word("FOLDER", Path), unset]
NAME_LETTERS = "letters, digits, -, _ and ."


def check_name(flag: str, name: str) -> None:
    if name and not (name.replace("-", "").replace("_", "").replace(".", "").isalnum() and len(name) <= 64):
        raise InputError(f"a name of {NAME_LETTERS} after {flag}", repr(name))


@dataclass(frozen=True, slots=True)
class SqueezeConfig(RecordedOptions):
    """Squeeze a container once with the SDH hand, under a low motor current, and take what fingertips and depth camera
    give at first contact and steady state: one trial of a data set, or, with --model, the name of the content. A real
    hand closes after a question. lab:containers is a simulated container, squeezed through the real drivers on doubles.
    """

    rig: Annotated[str, Positional, arg(metavar="RIG|lab:containers")]
    """A rig file (.toml) with [hand], [container] and [squeeze], or the laboratory."""
    content: str = ""
    """What is in the container: empty, water, yogurt, flour, rice, or any word. Left out with --model."""
    container: str = ""
    """Which container it is, such as box-07: trials of one container never stand on both sides of a split. In the
    laboratory its name begins with box or cylinder."""
    dataset: FolderFlag = None
    """Add the trial to this data set, with its recording unless --keep says otherwise."""
    keep: Literal["trial", "features"] = "trial"
    """What a data set keeps of a trial: its whole recording and its features, or these alone."""
    model: ModelFlag = None
    """Name the content by this classifier (`deformscope classify --save`), with probabilities while it is squeezed."""
    place: Literal["operator", "jaco"] = "operator"
    """Who puts the hand on the container: a person, after a prompt; or a Jaco arm, moved by its joystick to where the
    grasp was drawn, while the distance left is shown."""
    fill: float = 0.9
    """How full the container is, as a share of its height."""
    session: str = ""
    """Name of the session; default: today's date, in the laboratory lab-0."""
    operator: str = ""
    """Who does it; kept with the trial."""
    yes: bool = False
    """Let a real hand close without asking."""
    trust_rig: TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        if not self.model and not self.content:
            raise InputError("--content NAME, or --model MODEL to name it", "neither")
        if not self.container and self.dataset is not None:
            raise InputError("--container NAME with --dataset", "none", "--container box-01")
        if self.dataset is not None and not self.content:
            raise InputError("--content NAME with --dataset", "none")
        if not 0 <= self.fill <= 1:
            raise InputError("a --fill between 0 and 1", str(self.fill))
        for flag in ("content", "container", "session", "operator"):
            check_name(f"--{flag}", getattr(self, flag))

    def reads(self) -> tuple[str, ...]:
        return (self.rig,) if self.model is None else (self.rig, str(self.model))


@dataclass(frozen=True, slots=True)
class DatasetConfig(JsonOptions):
    """Look at a data set of squeezes: its trials by content and container, and those that are left out."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """The data set."""
    trials: bool = False
    """Name every trial."""
    json: JsonFlag = None
    """Write the index as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RelabelConfig(JsonOptions):
    """Correct what the index says of trials: content, container, its type, or the session."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """The data set."""
    trial: Annotated[tuple[str, ...], Positional, arg(metavar="TRIAL...")]
    """Names of trials."""
    content: str = ""
    container: str = ""
    container_type: str = ""
    session: str = ""
    json: JsonFlag = None

    def __post_init__(self) -> None:
        if not self.changes():
            raise InputError("--content, --container, --container-type or --session", "none of them")

    def changes(self) -> dict[str, str]:
        """What is to be set."""
        named = ("content", "container", "container_type", "session")
        return {name: getattr(self, name) for name in named if getattr(self, name)}


@dataclass(frozen=True, slots=True)
class DiscardConfig(JsonOptions):
    """Leave trials out of all that is learned, with the reason, or take them back. They stay in the folder."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """The data set."""
    trial: Annotated[tuple[str, ...], Positional, arg(metavar="TRIAL...")]
    """Names of trials."""
    reason: str = ""
    """Why."""
    restore: bool = False
    """Take them back."""
    json: JsonFlag = None

    def __post_init__(self) -> None:
        if bool(self.reason) == self.restore:
            raise InputError("--reason WHY, or --restore", "both" if self.restore else "neither")


@dataclass(frozen=True, slots=True)
class MergeConfig(JsonOptions):
    """Take the trials of other data sets over into one, with their recordings; those that are there already, the same
    in all, are passed over."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """The data set that grows; made where there is none."""
    sources: Annotated[tuple[Path, ...], Positional, arg(metavar="SOURCE...")]
    """The others."""
    json: JsonFlag = None

    def reads(self) -> tuple[str, ...]:
        return tuple(map(str, self.sources))


@dataclass(frozen=True, slots=True)
class RepairConfig(JsonOptions):
    """Take in the recordings in a data set's folder that its index lacks, as after a run that was cut short: their
    features are computed again from the raw frames."""

    folder: Annotated[Path, Positional, arg(metavar="FOLDER")]
    """The data set."""
    json: JsonFlag = None
