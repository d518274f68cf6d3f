"""`deformscope calibrate ...` and `deformscope predict`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.images import ImageOptions
from deformscope.config.options import Flags, OutputOptions, RecordedOptions, ViewOptions, either
from deformscope.errors import InputError
from deformscope.file_io import ending_of

AlphaFlag = Annotated[float, flags.Rule(lambda alpha: 0 < alpha <= 1, "an {flag} above 0 and at most 1")]


@dataclass(frozen=True, slots=True)
class SearchOptions(Flags):
    """How the parameter is searched, and how sure of it to be."""

    method: Literal["sweep", "gradient"] = "sweep"
    """Try --candidates values over the range (Thesis Algorithm 3), or follow the error downhill (Algorithm 2)."""
    candidates: Annotated[int, flags.least(3)] = 100
    """Values that the sweep tries."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the interval."""
    noise_px: flags.PositiveFlag = None
    """Standard deviation of a measured position [px]; default: measured in the images."""
    noise_m: flags.PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the pair file says."""
    joint: bool = False
    """Fit one value to all pairs together."""
    fine: bool = False
    """Follow every frame of a long sequence, and take the finest lattice below a surface. Default: what takes about a
    minute on two cores, which is stated; short sequences and small lattices are the same either way."""
    volume: Literal["scale", "project"] = "scale"
    """How theta conserves volume: as Thesis eq. 3.17, or by a projection that stays stable in overlapping clusters."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""

    def check(self) -> None:
        either("--noise-px", "--noise-m", self.noise_px, self.noise_m)


@dataclass(frozen=True, slots=True)
class ModelOptions(Flags):
    """What is left for predictions."""

    save: flags.ModelFlag = None
    """Write the fitted model, which `deformscope predict` can poke (.npz, no pickle)."""


@dataclass(frozen=True, slots=True)
class SummaryOptions(Flags):
    """The result to look at and to pass on, without a viewer."""

    picture: flags.PictureFlag = None
    """Draw particles, where the model is wrong, error curve and posterior in one picture. An existing file is
    replaced."""
    report: flags.ReportFlag = None
    """Write all that was found, with pictures, settings and provenance, as one HTML page that needs nothing else. An
    existing file is replaced."""


@dataclass(frozen=True, slots=True)
class LayersFlags(Flags):
    """Pokes of a surface: pair files of surface points, z up, whose held points were pressed down."""

    thickness_m: flags.PositiveFlag = None
    """Thickness of the material below the surface, which rests on the ground [m]. With it a lattice of layers is fitted
    to all pokes together; without, the points themselves are the particles."""
    spacing_m: flags.PositiveFlag = None
    """Spacing of that lattice [m]; default: a quarter of the tip's width."""

    def check(self) -> None:
        if self.spacing_m is not None and self.thickness_m is None:
            raise InputError("--thickness-m with --spacing-m", "none", "--thickness-m 0.05")


@dataclass(frozen=True, slots=True)
class MotionFlags(Flags):
    """All frames of a sequence in one fit."""

    whole_motion: bool = False
    """Fit all frames together instead of the last one; the interval knows that frames share their errors."""
    select: flags.SelectFlag = None
    """What to choose by the error on particles left out, of cluster-size, held, alpha and dt. alpha and dt leave static
    states as they are: time stepping through the frames determines them, if the motion was fast."""

    def check(self) -> None:
        if self.select is not None and not self.whole_motion:
            raise InputError("--whole-motion with --select", "no --whole-motion", "add --whole-motion")


def check_arrays(sources: tuple[str, ...], images: ImageOptions, noise_px: float | None, called: str) -> None:
    """Raises InputError for .npz files among images, and for flags about images with .npz files. called: so in words"""
    files = [source for source in sources if ending_of(source) == ".npz"]
    if files and len(files) != len(sources):
        other = next(source for source in sources if source not in files)
        raise InputError(f"either {called} or images", "both", "name them in two commands", other)
    if files and images != ImageOptions():
        came = "some (--roi, --grid, --held...)"
        raise InputError(f"no flags about images with {called}", came, "leave them out")
    if files and noise_px is not None:
        raise InputError(f"--noise-m for {called}", "--noise-px", "give the noise in metres")


def _names_rig(source: str) -> bool:
    return source.startswith("lab:") or Path(source).suffix.lower() == ".toml"


@dataclass(frozen=True, slots=True)
class CalibrateOptions(RecordedOptions):
    """What `calibrate beta` and `calibrate theta` share."""

    sources: flags.Sources
    """A video, a folder of frames, images in the order given, pair files (.npz), a recording (.rrd), or with --viewer
    page a rig (.toml, lab:NAME), whose camera is followed."""
    alpha: AlphaFlag = field(default=1.0, kw_only=True)
    """Stiffness of the pull to the goal positions."""
    at: flags.ShareFlag = field(default=None, kw_only=True)
    """Report the error at this value as well (`settings.at`)."""
    adjust: bool = field(default=False, kw_only=True)
    """With --viewer page: set region, particles and model on the page, and fit then. At a terminal a page does so by
    itself."""
    trust_rig: flags.TrustFlag = field(default=False, kw_only=True)
    search: OmitArgPrefixes[SearchOptions] = field(default_factory=SearchOptions, kw_only=True)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions, kw_only=True)
    model: OmitArgPrefixes[ModelOptions] = field(default_factory=ModelOptions, kw_only=True)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions, kw_only=True)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions, kw_only=True)

    @property
    def from_rig(self) -> bool:
        """Whether the images are those that a rig's camera gives now."""
        return any(map(_names_rig, self.sources))

    def check(self) -> None:
        if self.adjust and self.output.viewer != "page":
            raise InputError("--viewer page with --adjust", self.output.viewer)
        if not self.from_rig:
            return
        rig = next(filter(_names_rig, self.sources))
        if len(self.sources) > 1:
            raise InputError("a rig alone, or files", "both", where=rig)
        if self.images.stride != 1:
            raise InputError("no --stride with a rig", f"{self.images.stride}", "leave it out", rig)


@dataclass(frozen=True, slots=True)
class BetaConfig(CalibrateOptions):
    """Find beta, the share of linear deformation, from images or from pairs of rest and deformed positions."""

    cluster_size: Annotated[flags.CountFlag, flags.least(2)] = None
    """Particles along each side of a cluster; default: 3, and with --thickness-m the one with the least error on pokes
    left out."""
    mode: Literal["linear", "quadratic"] = "linear"
    """How a cluster may deform."""
    theta: flags.ShareFlag = None
    """Volume conservation, which stays as it is; default: 0, and with --thickness-m it is fitted too."""
    beta_range: flags.BetaSpanFlag = (0.0, 0.99)
    """Range in which beta is searched."""
    layers: OmitArgPrefixes[LayersFlags] = field(default_factory=LayersFlags)
    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)

    def check(self) -> None:
        CalibrateOptions.check(self)
        if self.layers.thickness_m is not None and self.mode != "linear":
            raise InputError("--mode linear with --thickness-m", self.mode)
        if self.at is not None and (self.layers.thickness_m is not None or self.motion.whole_motion):
            raise InputError("no --at with --thickness-m or --whole-motion", f"{self.at:g}", "leave out --at")
        if self.at is not None and self.at > flags.BETA_LIMIT:
            raise InputError(f"a --at of at most {flags.BETA_LIMIT:g}", f"{self.at:g}")

    @property
    def fitted_cluster_size(self) -> int:
        """Particles along each side of a cluster where no layers are fitted."""
        return 3 if self.cluster_size is None else self.cluster_size

    @property
    def fitted_theta(self) -> float:
        """Volume conservation where no layers are fitted."""
        return 0.0 if self.theta is None else self.theta


@dataclass(frozen=True, slots=True)
class ThetaConfig(CalibrateOptions):
    """Find theta, how strongly volume is conserved, from images or from pairs of rest and deformed positions."""

    cluster_size: Annotated[flags.CountFlag, flags.least(2)] = None
    """Particles along each side of a cluster; default: one cluster holds all particles (Thesis 5.1)."""
    mode: Literal["linear", "quadratic"] = "quadratic"
    """How a cluster may deform."""
    beta: Annotated[float, flags.SHARE] = 0.99
    """Share of deformation, which stays as it is."""
    theta_range: flags.SpanFlag = (0.0, 1.0)
    """Range in which theta is searched."""


@dataclass(frozen=True, slots=True)
class FitFlags(Flags):
    """What every fit to pairs and motions shares."""

    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    noise_m: flags.PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the files say, else the residuals."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""


@dataclass(frozen=True, slots=True)
class BothConfig(RecordedOptions):
    """Find beta and theta together from pairs of rest and deformed positions: their joint posterior. Volume is
    conserved by projection, which stays stable in overlapping clusters."""

    sources: flags.PairSources
    """Pair files."""
    cluster_size: Annotated[
        flags.CountFlag, flags.Rule(lambda size: size == 0 or size >= 2, "a {flag} of 2 or more, or 0")
    ] = 3
    """Particles along each side of a cluster; 0: one cluster holds all particles."""
    mode: Literal["linear", "quadratic"] = "linear"
    """How a cluster may deform."""
    beta_range: flags.BetaSpanFlag = (0.0, 0.99)
    """Range in which beta is searched."""
    theta_range: flags.SpanFlag = (0.0, 1.0)
    """Range in which theta is searched."""
    joint: bool = False
    """Fit one beta and one theta to all pairs together."""
    picture: flags.PictureFlag = None
    """Draw the joint posterior (of several pairs, that of the first). An existing file is replaced."""
    fit: OmitArgPrefixes[FitFlags] = field(default_factory=FitFlags)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def check(self) -> None:
        if other := next((source for source in self.sources if ending_of(source) != ".npz"), None):
            raise InputError("pair files (.npz)", repr(other), "calibrate beta or theta for images")


# deformscope predict -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PredictConfig(RecordedOptions):
    """Poke a fitted model where, how hard and with what it was not poked: deformed particles, depth and force."""

    source: Annotated[Path, Positional, arg(metavar="MODEL.npz"), flags.Reads()]
    """A model that `deformscope calibrate ... --save` has written."""
    poke: flags.PokesFlag = ()
    """What to do, such as 'at=0.28,0.2 tip=flat size=0.03x0.03 force=5' in metres and newtons; several with ; between
    them. tip is flat (sides), disc or sphere (diameter), by default the one of the fit; give a depth or a force."""
    against: Annotated[tuple[Path, ...], arg(metavar="PAIR.npz..."), flags.Reads()] = ()
    """Pokes that were measured but not fitted: each is predicted from its place, tip and depth, and compared, beside a
    rigid body, a half-space in closed form and linear finite elements."""
    points: flags.FileFlag = None
    """Points of the surface (.npz with `points (n, 3)`) whose deformed positions are wanted too."""
    out: flags.ArraysFlag = None
    """Every particle of every poke: rest_0, deformed_0, rest_1... An existing file is replaced."""
    picture: flags.PictureFlag = None
    """Draw the dents and, with --against, measured beside predicted. An existing file is replaced."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        if not self.poke and not self.against:
            raise InputError("a --poke or pokes to compare with --against", "neither", f"--poke {flags.POKE_EXAMPLE}")


# deformscope calibrate axes, field, yield and viscous -----------------------------------------------------------------


def parse_creep(text: str) -> float | str:
    """`none`, `fit`, or a rate above 0 [1/s]."""
    if text in ("none", "fit"):
        return text
    try:
        return flags.positive(text)
    except ValueError:
        raise ValueError(f"expected none, fit or a rate above 0 in 1/s; got {text!r}") from None


def parse_frames(text: str) -> tuple[int, int]:
    """LOADED,UNLOADED: two frames."""
    try:
        loaded, unloaded = map(int, text.split(","))
    except ValueError:
        raise ValueError(f"expected LOADED,UNLOADED such as 40,95; got {text!r}") from None
    return loaded, unloaded


ElasticFlag = Annotated[
    flags.PositiveFlag,
    flags.Rule(lambda beta: beta <= flags.BETA_LIMIT, f"a {{flag}} of at most {flags.BETA_LIMIT:g}"),
]
CreepFlag = Annotated[float | str, flags.one_word("none|fit|RATE", parse_creep)]


FramesFlag = Annotated[
    tuple[int, int] | None, flags.one_word("LOADED,UNLOADED", parse_frames, flags.joined(",")), flags.unset
]


@dataclass(frozen=True, slots=True)
class MotionFitFlags(FitFlags):
    """What every fit to a material's motion shares."""

    noise_px: flags.PositiveFlag = None
    """Standard deviation of a measured position [px]; default: measured in the images."""

    def check(self) -> None:
        either("--noise-px", "--noise-m", self.noise_px, self.noise_m)


@dataclass(frozen=True, slots=True)
class UnloadingFlags(Flags):
    """How a camera's motion shows when what was pressed is let go."""

    at: FramesFlag = None
    """The last frame at the deepest, and the first one that nothing loads, counted from 0 after --stride; default:
    found by the force where the recording has one, else where what was pressed rests again."""
    released: flags.HeldFlag = None
    """Of the held parts, those that let go at the end; default: contact."""
    force: flags.CameraFlag = None
    """Of a recording with several force sensors: the one on the tool."""

    def check(self) -> None:
        if self.at is not None and self.force is not None:
            raise InputError("--at or --force", "both", "leave one out")


@dataclass(frozen=True, slots=True)
class MaterialOptions(RecordedOptions):
    """What `calibrate axes`, `field`, `yield` and `viscous` share."""

    sources: flags.Sources
    """A video, a folder of frames, images in the order given, a recording (.rrd), or .npz files."""
    fit: OmitArgPrefixes[MotionFitFlags] = field(default_factory=MotionFitFlags, kw_only=True)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions, kw_only=True)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions, kw_only=True)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions, kw_only=True)

    def check(self) -> None:
        check_arrays(self.sources, self.images, self.fit.noise_px, ".npz files")


@dataclass(frozen=True, slots=True)
class AxesConfig(MaterialOptions):
    """Find a beta along each axis of a material from images, or from pairs of rest and deformed positions (one fit to
    all of them)."""

    turn_deg: float = 0.0
    """Angle of the material's first axis to x, in the plane of x and y [degrees]; in images y goes down."""
    frame: Annotated[flags.SomeFlag, arg(name="at")] = None
    """Of images: the frame that is fitted, counted from 0 after --stride; default: the last one."""
    cluster_size: flags.ClusterFlag = 3
    """Particles along each side of a cluster."""


@dataclass(frozen=True, slots=True)
class FieldConfig(MaterialOptions):
    """Find how stiff each place of a thing is against the others from one deformation, by images or one pair file:
    smooth or of a few materials, with a beta for each place; with a force, stiffness in N/m."""

    frame: Annotated[flags.SomeFlag, arg(name="at")] = None
    """Of images: the frame that is fitted, counted from 0 after --stride; default: the last one."""
    force_n: flags.PositiveFlag = None
    """Size of the net force on the held particles that were moved, in that frame [N]; default: the pair file's."""


@dataclass(frozen=True, slots=True)
class YieldConfig(MaterialOptions):
    """Find the strain at which a thing yields from its motion: loaded, and let go. A motion file (.npz) has
    rest (K, d), motion (T, K, d) [m], held (n,) or (T, K), and dt [s] for creep."""

    beta: ElasticFlag = None
    """Share of linear deformation; default: found along with the yield strain."""
    creep: CreepFlag = "none"
    """How fast it flows [1/s]: none, as long as it takes in every frame; fit, found too; or a rate."""
    maximum: flags.PositiveFlag = None
    """Largest plastic strain; default: no bound."""
    theta: Annotated[float, flags.SHARE] = 0.0
    """Volume conservation (by projection), which stays as it is."""
    cluster_size: flags.ClusterFlag = 3
    """Particles along each side of a cluster."""
    unloading: OmitArgPrefixes[UnloadingFlags] = field(default_factory=UnloadingFlags)


@dataclass(frozen=True, slots=True)
class ViscousConfig(MaterialOptions):
    """Find what share of a thing's modulus relaxes, how fast, and what it keeps for good, from how it recovers once it
    is let go; with a force in the recording from its relaxation too, and stiffness at once and relaxed."""

    unloading: OmitArgPrefixes[UnloadingFlags] = field(default_factory=UnloadingFlags)
