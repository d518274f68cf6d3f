"""`deformscope squeeze` and `deformscope dataset`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, either
from deformscope.errors import InputError

FolderFlag = Annotated[Path | None, flags.one_word("FOLDER", Path), flags.unset]
NAME = flags.Rule(
    lambda name: not name or (len(name) <= 64 and all(letter.isalnum() or letter in "-_." for letter in name)),
    "a name of letters, digits, -, _ and . after {flag}",
    show=repr,
)
"""What becomes part of a file's name."""
NameFlag = Annotated[str, NAME]
DatasetFolder = Annotated[Path, Positional, arg(metavar="FOLDER")]
Trials = Annotated[tuple[str, ...], Positional, arg(metavar="TRIAL...")]


@dataclass(frozen=True, slots=True)
class SqueezeConfig(RecordedOptions):
    """Squeeze a container once with the SDH hand, under a low motor current, and take what fingertips and depth camera
    give at first contact and steady state: one trial of a data set, or, with --model, the name of the content. The
    hand is brought to where the grasp was drawn by a person, or by the arm that carries it (--place), and a real one
    closes after a question. lab:containers is a simulated container, squeezed through the real drivers on doubles; one
    stands between the doubles of a rig file too.
    """

    rig: Annotated[str, Positional, arg(metavar="RIG|lab:containers"), flags.Reads()]
    """A rig file (.toml) with [hand], [container] and [squeeze], or the laboratory."""
    content: NameFlag = ""
    """What is in the container: empty, water, yogurt, flour, rice, or any word. Left out with --model."""
    container: NameFlag = ""
    """Which container it is, such as box-07: trials of one container never stand on both sides of a split. In the
    laboratory its name begins with box or cylinder."""
    dataset: FolderFlag = None
    """Add the trial to this data set, with its recording unless --keep says otherwise."""
    keep: Literal["trial", "features"] = "trial"
    """What a data set keeps of a trial: its whole recording and its features, or these alone."""
    model: Annotated[Path | None, flags.one_word("MODEL.npz", Path), flags.unset, flags.Reads()] = None
    """Name the content by this classifier (`deformscope classify --save`), with probabilities while it is squeezed."""
    fill: Annotated[float, flags.SHARE] = 0.9
    """How full the container is, as a share of its height."""
    session: NameFlag = ""
    """Name of the session; default: today's date, in the laboratory lab-0."""
    operator: NameFlag = ""
    """Who does it; kept with the trial."""
    place: Literal["person", "jaco", "kuka"] = "person"
    """Who places the hand at the container: a person, or the arm that carries it, of this kind. An arm finds the
    container in the depth image, draws a grasp that it reaches from --seed, approaches on a way that was checked, and
    withdraws after the squeeze. The laboratory has either arm; a rig file needs [hand] T_arm_hand, [camera]
    T_arm_camera, [surface] T_arm_surface and the box of [workspace]."""
    grasp: Annotated[
        tuple[float, float, float] | None,
        flags.one_word("MM,DEG,DEG", flags.numbers("along in mm,tilt,turn in degrees", "5,0,180"), flags.joined(",")),
        flags.unset,
    ] = None
    """With --place jaco or kuka: grasp there instead of drawing: so far above the middle of the longest edge [mm],
    tilted about the axis of closing, and turned about the upright by so much [deg]."""
    yes: bool = False
    """Let a real hand close, and a real arm place it, without asking."""
    paused: bool = False
    """With --viewer page: squeeze in the laboratory, too, once somebody says so on the page."""
    page_timeout: flags.TimeoutFlag = 0.3
    """Stop a hand whose motion was confirmed on the page where the page is not heard of for so long [s]."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.paused and self.output.viewer != "page":
            raise InputError("--paused with --viewer page", f"--viewer {self.output.viewer}", "--viewer page")
        if self.grasp is not None and self.place == "person":
            raise InputError("--grasp with --place jaco or kuka", "--place person", "--place jaco")
        if not self.model and not self.content:
            raise InputError("--content NAME, or --model MODEL to name it", "neither")
        if self.dataset is not None and not (self.content and self.container):
            raise InputError("--content and --container with --dataset", "without", "--container box-01")


@dataclass(frozen=True, slots=True)
class DatasetConfig(CommandOptions):
    """Look at a data set of squeezes: its trials by content and container, and those that are left out."""

    folder: DatasetFolder
    """The data set."""
    trials: bool = False
    """Name every trial."""
    json: flags.JsonFlag = None
    """Write the index as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RelabelConfig(CommandOptions):
    """Correct what the index says of trials: content, container, its type, or the session."""

    folder: DatasetFolder
    """The data set."""
    trial: Trials
    """Names of trials."""
    content: NameFlag = ""
    container: NameFlag = ""
    container_type: NameFlag = ""
    session: NameFlag = ""
    json: flags.JsonFlag = None

    def check(self) -> None:
        if not self.changes():
            raise InputError("--content, --container, --container-type or --session", "none of them")

    def changes(self) -> dict[str, str]:
        """What is to be set."""
        named = ("content", "container", "container_type", "session")
        return {name: getattr(self, name) for name in named if getattr(self, name)}


@dataclass(frozen=True, slots=True)
class DiscardConfig(CommandOptions):
    """Leave trials out of all that is learned, with the reason, or take them back. They stay in the folder."""

    folder: DatasetFolder
    """The data set."""
    trial: Trials
    """Names of trials."""
    reason: str = ""
    """Why."""
    restore: bool = False
    """Take them back."""
    json: flags.JsonFlag = None

    def check(self) -> None:
        either("--reason", "--restore", self.reason, self.restore)
        if not (self.reason or self.restore):
            raise InputError("--reason WHY, or --restore", "neither")


@dataclass(frozen=True, slots=True)
class MergeConfig(CommandOptions):
    """Take the trials of other data sets over into one, with their recordings; those that are there already, the same
    in all, are passed over."""

    folder: DatasetFolder
    """The data set that grows; made where there is none."""
    sources: Annotated[tuple[Path, ...], Positional, arg(metavar="SOURCE..."), flags.Reads()]
    """The others."""
    json: flags.JsonFlag = None


@dataclass(frozen=True, slots=True)
class RepairConfig(CommandOptions):
    """Take in the recordings in a data set's folder that its index lacks, as after a run that was cut short: their
    features are computed again from the raw frames."""

    folder: DatasetFolder
    """The data set."""
    json: flags.JsonFlag = None
