"""Devices and recordings of them: `deformscope devices`, `doctor`, `record`, `live`, `explore`, `replay`..."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction, arg

from deformscope.config import flags
from deformscope.config.explore import Detail
from deformscope.config.images import ParticleFlags
from deformscope.config.options import CommandOptions, OutputOptions, RecordedOptions, ViewOptions
from deformscope.errors import InputError

WatchedStage = Literal["flow", "particles", "beta", "theta", "field", "surface", "tactile", "contact"]
ExportFormat = Literal["csv", "parquet", "mcap", "video", "npz", "images"]
StageWord = WatchedStage | Literal["tracking", "depth-change", "posterior"]
"""Stages of a rig; the last three belong to a squeeze, and are refused with that reason."""


@dataclass(frozen=True, slots=True)
class DevicesConfig(CommandOptions):
    """List what is plugged into this machine: port, serial number, firmware, health. Devices that are known by their
    USB identity, and doubles that run, are opened for a moment and asked: nothing moves, but an OptoForce is set to its
    driver's default rate and filter, and forgets its zero."""

    probe: bool = True
    """Open what is known and ask it; --no-probe lists only what the system knows."""
    json: flags.JsonFlag = None
    """Write the list as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DoctorConfig(CommandOptions):
    """Try a rig: its file, every device of it for a few seconds, the disk; say what is wrong and what to do, and which
    command comes next on the way to an exploration. Nothing moves."""

    rig: flags.RigFlag = ""
    """A rig file (.toml), or lab:NAME."""
    example: bool = False
    """Print a rig file to start from, and do nothing else."""
    doubles: bool = False
    """With --example: one of doubles over a simulated table, to try everything on."""
    seconds: Annotated[float, flags.one_word("NUMBER", flags.positive)] = 2.0
    """How long every device is listened to [s]."""
    trust_rig: flags.TrustFlag = False
    json: flags.JsonFlag = None
    """Write what was found as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.rig and not self.example:
            raise InputError("a rig file, or lab:NAME", "none", "deformscope doctor --example > rig.toml")


@dataclass(frozen=True, slots=True)
class StageOptions(ParticleFlags):
    """Stages that are computed while the devices run, always on the newest frame: those passed over are counted. Images
    are as for `calibrate beta`; without --grid and --spacing-px, 9 particles stand along the region's longer side."""

    stage: Annotated[
        UseAppendAction[tuple[StageWord, ...]],
        arg(help_behavior_hint="(repeatable)"),
    ] = ()
    """flow: optical flow between the images used; particles: those of the first image, which shows the thing at rest,
    followed to the newest; beta, theta: the fit of that pose with its verdict; field: how stiff each place is against
    the others; surface: a depth camera's surface as a Gaussian
    process, with its deviation; tactile: centre of pressure, contact area and force of each pad; contact: stiffness by
    arm and force sensor, after each approach; tracking, depth-change, posterior: of a squeeze alone
    (`deformscope squeeze`). A stage that gives nothing says why at once."""
    camera: flags.CameraFlag = None
    """Colour camera of flow, particles, beta, theta and field; default: the rig's first."""
    cluster_size: flags.ClusterFlag = 3
    """Particles a side of the overlapping clusters."""
    longest_px: Annotated[int, flags.least(32)] = 160
    """The region is reduced until its longer side has so many pixels: twice as many take four times as long [px]."""

    @property
    def names(self) -> tuple[StageWord, ...]:
        """Each stage once, in the order asked for."""
        return tuple(dict.fromkeys(self.stage))


@dataclass(frozen=True, slots=True)
class RigRunOptions(RecordedOptions):
    """A rig that is recorded or watched until its time is over, or until Ctrl-C."""

    rig: flags.RigFlag
    """A rig file (.toml), or lab:NAME."""
    seconds: flags.PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""
    label: str = ""
    """What is being recorded, in your words; kept in the recording."""
    trust_rig: flags.TrustFlag = False
    keep_last: flags.PositiveFlag = None
    """Hold the last seconds in memory [s], a quarter of the machine's at most: `record` writes those before its end and
    no others; on a page a button writes them, there 30 s in 256 MiB are held without this option."""
    stages: OmitArgPrefixes[StageOptions] = field(default_factory=StageOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if self.keep_last is not None and self.stages.names:
            raise InputError("one of --keep-last and --stage", "both", "stages are recorded from the first frame on")


@dataclass(frozen=True, slots=True)
class RecordConfig(RigRunOptions):
    """Record all devices of a rig, with every byte of their wires and what was lost. Without --record the file is
    runs/NAME-<stamp>.rrd. Ctrl-C ends it cleanly. No viewer, unless --viewer asks for one. --stage computes while it
    records; `deformscope replay` computes the same again from the recorded frames. --keep-last 30 records the last 30 s
    before the end alone."""


@dataclass(frozen=True, slots=True)
class LiveConfig(RigRunOptions):
    """Watch all devices of a rig in rerun's window, and what --stage computes from them; with --record, record it all
    as well."""

    def check(self) -> None:
        RigRunOptions.check(self)
        if self.keep_last is not None and self.output.viewer != "page":
            raise InputError("--keep-last with --viewer page", self.output.viewer, "record --keep-last needs no page")


@dataclass(frozen=True, slots=True)
class VerifyConfig(CommandOptions):
    """Say whether a recording is whole: its bytes against its ledger, its structure, and what it counted as lost."""

    recording: flags.RecordingFlag
    """The recording."""
    stages: bool = False
    """List every stage of computation, by chapter of the thesis: where it is in the recording, how many rows, what it
    cost, whether it was live; and what is missing."""
    privacy: bool = False
    """List what it says of people and machines, as commands, paths, words, serial numbers: what `export --anonymous`
    leaves out."""
    json: flags.JsonFlag = None
    """Write the findings as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class ReportConfig(CommandOptions):
    """Draw the figures of a recording, from what it holds alone, as one HTML page: of an exploration map, surface,
    touches and fields (Thesis chapter 4), of a squeeze forces, pose, posterior and features over time (chapter 2), of a
    rig its stages, of a fit error and posterior. It says which stages the recording lacks."""

    recording: flags.RecordingFlag
    """The recording."""
    out: flags.ReportFlag = None
    """The page; default: NAME.html beside the recording. An existing file is replaced."""
    json: flags.JsonFlag = None
    """Write what was drawn, and what is missing, as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class RecoverConfig(CommandOptions):
    """Make a whole recording, with its ledger, of one whose run was killed or that was cut off: all that can be read of
    it. The original is only read."""

    recording: flags.RecordingFlag
    """The unfinished recording (NAME.part.rrd), or one that was cut off."""
    out: flags.NewRecordingFlag = None
    """The new recording; default: NAME.recovered.rrd beside it. An existing file is refused."""
    json: flags.JsonFlag = None
    """Write what there is as JSON; with -, stdout is the JSON alone."""


@dataclass(frozen=True, slots=True)
class DiscardRecordingConfig(CommandOptions):
    """Mark a recording, or one of its episodes, as not to be used, with the reason, in its ledger. Nothing is deleted:
    whoever reads it is reminded."""

    recording: flags.RecordingFlag
    """The recording."""
    reason: str
    """Why, in your words."""
    episode: Annotated[int, flags.least(0)] = 0
    """Number of the episode, from 1; 0 = all of the recording."""
    json: flags.JsonFlag = None
    """Write what the recording is, and what of it is discarded, as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if not self.reason.strip():
            raise InputError("a reason", "none", "--reason WORDS")


@dataclass(frozen=True, slots=True)
class ExportConfig(CommandOptions):
    """Write a recording in a format of others: its streams as CSV, Parquet or NumPy files, all of it as MCAP with ROS 2
    messages, its images as files (byte for byte as they were recorded) or videos. Units stand in the names of columns
    and in their metadata; `export.json` lists what was written."""

    recording: flags.RecordingFlag
    """The recording."""
    to: ExportFormat | None = None
    """The format. mcap needs `pip install 'deformscope[mcap]'`."""
    out: Annotated[Path | None, flags.one_word("FOLDER", Path), flags.unset] = None
    """Where it goes: a new folder, or an empty one. It is there once all is written."""
    images: Annotated[Path | None, flags.one_word("FOLDER", Path), flags.unset] = None
    """Short for --to images --out FOLDER, without `export.json`; several cameras get a folder each in it. Names are
    places in the camera's stream, distances 16 bit PNG in the camera's unit."""
    only: Annotated[tuple[str, ...], arg(metavar="ENTITY...", help_behavior_hint="")] = ()
    """Entities (wrench/tip), all below one (exploration), or devices (tip); default: all."""
    camera: flags.CameraFlag = None
    """Images of this camera alone."""
    anonymous: bool = False
    """Leave out what may name a person, a machine or a path: commands, notes and other words, serial numbers, raw bytes
    of devices, input files."""
    license: str = ""
    """Of the data, as an SPDX identifier (CC-BY-4.0); goes along into every format."""
    author: Annotated[tuple[str, ...], arg(metavar="NAME...", help_behavior_hint="")] = ()
    """Who made the data; goes along too, also where the rest is anonymous."""
    citation: str = ""
    """How the data are cited; goes along too."""
    overwrite: bool = False
    """Replace the files of an earlier export. Without it, a folder that holds something is refused."""
    json: flags.JsonFlag = None
    """Write what was written as JSON; with -, stdout is the JSON alone."""

    def check(self) -> None:
        if (self.to is None) == (self.images is None) or (self.to is None) != (self.out is None):
            raise InputError("a format and a folder", "none, or more than one", "--to parquet --out FOLDER")
        if self.camera is not None and self.format not in ("images", "video"):
            raise InputError("--camera with images or video", self.format, f"--only {self.camera}")

    @property
    def format(self) -> ExportFormat:
        """The format, also where it is asked for by --images."""
        return self.to or "images"

    @property
    def folder(self) -> Path:
        """Where it goes."""
        return self.out or self.images or Path()


@dataclass(frozen=True, slots=True)
class ImportConfig(RecordedOptions):
    """Make a recording of data of others: bags of ROS 1 and 2, MCAP, CSV and Parquet tables, folders of them, our own
    exports among these. A map says what becomes of what: --inspect proposes one, in which `"?"` stands for what
    the source does not say. Bags need `pip install 'deformscope[import]'`. --stage computes five times a second of the
    source's time, --stage contact of every approach; `deformscope explore RUN.rrd` maps what the recording touched."""

    source: Annotated[Path, Positional, arg(metavar="SOURCE"), flags.Reads()]
    """A bag, a table, or a folder."""
    map: Annotated[Path | None, flags.one_word("FILE.toml", Path), flags.unset, flags.Reads()] = None
    """The map."""
    inspect: bool = False
    """List topics with types, rates, gaps and clocks, and a map, all of which is TOML; import nothing."""
    pairs: Annotated[Path | None, flags.one_word("FOLDER", Path), flags.unset] = None
    """Of a folder of meshes with forces (PokeFlex): write pair files and a motion file, into a new folder."""
    unseen: Annotated[int, flags.least(2)] = 4
    """With --pairs: every so many frames are kept apart, and not seen in the motion."""
    particles: Annotated[int, flags.least(8)] = 300
    """With --pairs: so many of the meshes' vertices at most, spread evenly."""
    stages: OmitArgPrefixes[StageOptions] = field(default_factory=StageOptions)
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        asked = [self.inspect, self.output.record is not None, self.pairs is not None]
        if sum(asked) != 1:
            came = "several" if any(asked) else "neither"
            raise InputError("--record FILE.rrd with --map FILE.toml, --inspect, or --pairs FOLDER", came)


@dataclass(frozen=True, slots=True)
class DoubleConfig(CommandOptions):
    """Run simulated devices that speak the real bytes at the real pace, until Ctrl-C; prints the rig file that reaches
    them from another terminal."""

    what: Annotated[tuple[str, ...], Positional, arg(metavar="DRIVER|RIG")]
    """Drivers (optoforce, dsa, sdh), or a rig file or lab:NAME whose byte-stream devices are to be doubled."""
    seconds: flags.PositiveFlag = None
    """How long [s]; default: until Ctrl-C."""


@dataclass(frozen=True, slots=True)
class ArmConfig(RecordedOptions):
    """Measure the compliance of the arm, by touching something rigid that stands firmly on the surface, and write it
    into the rig file. The arm moves, after a table of checks and a question."""

    rig: flags.SceneFlag
    """A rig file (.toml), or a simulated scene (lab:homogeneous-rigid)."""
    at: flags.PlaceFlag = None
    """Where to touch, in the surface frame [m]; default: the middle."""
    touches: flags.ManyFlag = 3
    """How often."""
    set_force: flags.ForceFlag = None
    """Force to press with [N], 5 N at most, and 5/3 of it (5 N at most) since nothing gives; default: the rig file's
    target_force_n."""
    write: bool = True
    """Write what was found and the date into the rig file; --no-write prints the lines alone."""
    yes: bool = False
    """Let a real arm move, once the checks have passed, without asking."""
    trust_rig: flags.TrustFlag = False
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """The main job on what is built in: a simulated arm maps the stiffness of a table with three materials, by looking
    and touching. Leaves runs/demo-<stamp>.rrd, or what --record names."""

    images: bool = False
    """Measure the images that ship instead: a specimen under tension, filmed."""
    detail: Detail = "full"
    """As of explore."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare with the numbers that it holds."""

    recording: flags.RecordingFlag
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """As fast as possible, as it was recorded, or frame by frame at each Enter."""
    set: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE", help_behavior_hint="(repeatable)")] = ()
    """Another setting than the recorded one, of an exploration: what comes of it is printed beside what was recorded,
    and not compared to the bit. Several: --set beta_model=none --set threshold=0.1"""
    beside: flags.BesideFlag = None
    """With --viewer page: what this other recording's devices measured, in the same plots, both from their first
    contact on. Nothing is computed again."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)
