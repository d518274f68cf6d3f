"""`deformscope squeeze` and `deformscope dataset`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, either
from deformscope.errors import InputError

NAME = flags.Rule(
    lambda name: not name or (len(name) <= 64 and all(letter.isalnum() or letter in "-_." for letter in name)),
    "a name of letters, digits, -, _ and . after {flag}",
    show=repr,
)
"""A part of a file's name."""
NameFlag = Annotated[str, NAME]
DatasetFolder = Annotated[Path, Positional, arg(metavar="FOLDER")]
Trials = Annotated[tuple[str, ...], Positional, arg(metavar="TRIAL...")]


@dataclass(frozen=True, slots=True)
class SqueezeConfig(RecordedOptions):
    """Squeeze a container once with the SDH hand, under a low motor current. Fingertips and depth camera are evaluated
    at first contact and steady state: one trial of a data set, or, with --model, the name of the content. A person
    brings the hand to the drawn grasp, or the arm that carries it does (--place); a real hand closes after a question.
    lab:containers is a simulated container, squeezed through the real drivers on doubles; the doubles of a rig file
    have one too."""

    rig: Annotated[str, Positional, arg(metavar="RIG|lab:containers"), flags.Reads()]
    """A rig file (.toml) with [hand], [container] and [squeeze], or the laboratory."""
    content: NameFlag = ""
    """Content of the container: empty, water, yogurt, flour, rice, or any word. Omit it with --model."""
    container: NameFlag = ""
    """Name of the container, such as box-07: trials of one container are never split between training and test. In the
    laboratory its name begins with box or cylinder."""
    dataset: flags.NewFolder = None
    """Add the trial to this data set, with its recording unless --keep says otherwise."""
    keep: Literal["trial", "features"] = "trial"
    """Stored part of a trial: its whole recording and its features, or only these."""
    model: Annotated[Path | None, flags.one_word("MODEL.npz", Path), flags.unset, flags.Reads()] = None
    """Classify the content by this classifier (`deformscope classify --save`), with probabilities during the
    squeeze."""
    fill: Annotated[float, flags.SHARE] = 0.9
    """Filling of the container, as a share of its height."""
    session: NameFlag = ""
    """Name of the session; default: today's date, in the laboratory lab-0."""
    operator: NameFlag = ""
    """Name of the operator; stored with the trial."""
    place: Annotated[NameFlag, arg(metavar="person|ARM")] = "person"
    """How the hand reaches the container: by a person, or by the arm of this driver that carries it. An arm finds the
    container in the depth image, draws a reachable grasp from --seed, approaches on a checked path, and withdraws after
    the squeeze. The laboratory has several arms; a rig file needs [hand] T_arm_hand, [camera] T_arm_camera, [surface]
    T_arm_surface and the box of [workspace]."""
    grasp: Annotated[
        tuple[float, float, float] | None,
        flags.one_word("MM,DEG,DEG", flags.numbers("along in mm,tilt,turn in degrees", "5,0,180"), flags.joined(",")),
        flags.unset,
    ] = None
    """With --place ARM: grasp at this place instead of a random one. Height above the middle of the longest
    edge [mm], tilt about the axis of closing, and turn about the upright [deg]."""
    yes: bool = False
    """Let a real hand close, and a real arm place it, without asking."""
    paused: bool = False
    """With --viewer page: squeeze after a confirmation on the page, in the laboratory too."""
    page_timeout: flags.TimeoutFlag = 0.3
    """Stop a hand whose motion the page confirmed after this time without a message from the page [s]."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.paused and self.output.viewer != "page":
            raise InputError("--paused with --viewer page", f"--viewer {self.output.viewer}", "--viewer page")
        if self.grasp is not None and self.place == "person":
            raise InputError("--grasp with the driver of an arm after --place", "--place person")
        if not self.model and not self.content:
            raise InputError("--content NAME, or --model MODEL to name it", "neither")
        if self.dataset is not None and not (self.content and self.container):
            raise InputError("--content and --container with --dataset", "without", "--container box-01")


@dataclass(frozen=True, slots=True)
class DatasetConfig(CommandOptions):
    """List a data set of squeezes: its trials by content and container, and discarded trials."""

    folder: DatasetFolder
    """The data set."""
    trials: bool = False
    """Name every trial."""
    json: flags.JsonFlag = None
    """Write the index as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RelabelConfig(CommandOptions):
    """Correct the index of trials: content, container, its type, or the session."""

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
        """The new values."""
        named = ("content", "container", "container_type", "session")
        return {name: getattr(self, name) for name in named if getattr(self, name)}


@dataclass(frozen=True, slots=True)
class DiscardConfig(CommandOptions):
    """Discard trials, with the reason, so that no classifier uses them, or restore them. They stay in the folder."""

    folder: DatasetFolder
    """The data set."""
    trial: Trials
    """Names of trials."""
    reason: str = ""
    """The reason."""
    restore: bool = False
    """Restore the trials."""
    json: flags.JsonFlag = None

    def check(self) -> None:
        either("--reason", "--restore", self.reason, self.restore)
        if not (self.reason or self.restore):
            raise InputError("--reason WHY, or --restore", "neither")


@dataclass(frozen=True, slots=True)
class MergeConfig(CommandOptions):
    """Copy the trials of other data sets into one, with their recordings; identical trials are skipped."""

    folder: DatasetFolder
    """The data set to extend; made if missing."""
    sources: Annotated[tuple[Path, ...], Positional, arg(metavar="SOURCE..."), flags.Reads()]
    """The other data sets."""
    json: flags.JsonFlag = None


@dataclass(frozen=True, slots=True)
class RepairConfig(CommandOptions):
    """Add recordings in a data set's folder that its index lacks, for example after an interrupted run: features are
    computed again from the raw frames."""

    folder: DatasetFolder
    """The data set."""
    json: flags.JsonFlag = None
