"""`deformscope calibrate ...` and `deformscope predict`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.images import ImageOptions
from deformscope.config.options import Flags, OutputOptions, RecordedOptions, ViewOptions, either
from deformscope.config.simulate import PythonFlag, Target
from deformscope.errors import InputError
from deformscope.file_io import ending_of

AlphaFlag = Annotated[float, flags.Rule(lambda alpha: 0 < alpha <= 1, "an {flag} above 0 and at most 1")]


@dataclass(frozen=True, slots=True)
class SearchOptions(Flags):
    """How the parameter is searched, and with which confidence level."""

    method: Literal["sweep", "gradient"] = "sweep"
    """Try --candidates values over the range (Thesis Algorithm 3), or follow the error downhill (Algorithm 2)."""
    candidates: Annotated[int, flags.least(3)] = 100
    """Number of values that the sweep tries."""
    level: flags.LevelFlag = 0.9
    """Confidence level of the interval."""
    noise_px: flags.PositiveFlag = None
    """Standard deviation of a measured position [px]; default: measured in the images."""
    noise_m: flags.PositiveFlag = None
    """Standard deviation of a measured position [m]; default: the pair file's."""
    joint: bool = False
    """Fit one value to all pairs together."""
    fine: bool = False
    """Use every frame of a long sequence, and the finest lattice below a surface. Default: limits both, and
    reports the limit; short sequences and small lattices do not change."""
    volume: Literal["scale", "project"] = "scale"
    """How theta conserves volume: as Thesis eq. 3.17, or by a projection that stays stable in overlapping clusters."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""

    def check(self) -> None:
        either("--noise-px", "--noise-m", self.noise_px, self.noise_m)


@dataclass(frozen=True, slots=True)
class ModelOptions(Flags):
    """The fitted model as a file, for predictions."""

    save: flags.ModelFlag = None
    """Write the fitted model for `deformscope predict` (.npz, no pickle)."""
    save_pair: flags.ArraysFlag = None
    """Images with a scale: write the fitted frame as a pair file: particles at rest and seen, held ones, force. An
    existing file is replaced."""


@dataclass(frozen=True, slots=True)
class SummaryOptions(Flags):
    """The result as a picture and as a page, without a viewer."""

    picture: flags.PictureFlag = None
    """Draw particles, the model's error at each, error curve and posterior in one picture. An existing file is
    replaced."""
    setup_picture: flags.PictureFlag = None
    """Draw region, held parts and contact, the given or the found ones, on the first image. An existing file is
    replaced."""
    report: flags.ReportFlag = None
    """Write the whole result, with pictures, settings and provenance, as one HTML page without other files. An existing
    file is replaced."""


@dataclass(frozen=True, slots=True)
class PushFlags(Flags):
    """The force on the contact of a video. With the picture's scale it gives the stiffness at the contact, with the
    body's thickness Young's modulus and Poisson's ratio. Each uncertainty is a standard deviation, in all intervals."""

    force: flags.PushForceFlag = None
    """Force at the fitted frame with its unit (3N, or 300g on a kitchen scale), or a log of it: a table (CSV, Parquet),
    a recording or a bag."""
    force_frame: flags.SomeFlag = None
    """Frame at which the force acted, counted from 0 after --stride; it is fitted, and later ones are not used.
    Default: the last one."""
    force_column: flags.CameraFlag = None
    """Column of a log's table that has the force; default: the only one in newtons, grams-force or the like."""
    force_unit: flags.CameraFlag = None
    """Unit of that column (N, mN, gf, kgf, g, kg); default: the one in its name."""
    force_sensor: flags.CameraFlag = None
    """For a recording with several force sensors: the sensor on the tool."""
    force_offset_s: Annotated[float | None, flags.one_word("NUMBER", flags.finite), flags.unset] = None
    """Time of a log at the video's first frame [s]; default: found by the rise of the force against that of the
    motion, and for a recording of ours the same clock."""
    force_sd: flags.ForceSdFlag = None
    """Uncertainty of the force, such as 2g or 0.05N. Default: 2 % of it and a kitchen scale's 1 g."""
    scale_sd: Annotated[float, flags.SHARE] = 0.01
    """Uncertainty of the picture's scale, as a share; 0.01 is 1 mm in 10 cm."""
    thickness_m: flags.LengthFlag = None
    """Images with a force: thickness of the body along the camera's view [m]. Pokes of a surface (pair files): that of
    the material below it, which rests on the ground; all pokes are then fitted together with layers of it."""
    thickness_sd: Annotated[float, flags.SHARE] = 0.02
    """Uncertainty of the thickness of images, as a share."""
    plane_strain: bool = False
    """The body cannot bulge along the camera's view, as between two panes; default: it is free to (plane stress)."""

    def check(self) -> None:
        named: dict[str, object] = {"--force-frame": self.force_frame, "--force-sd": self.force_sd}
        named |= {"--plane-strain": self.plane_strain or None}
        log: dict[str, object] = {"--force-column": self.force_column, "--force-unit": self.force_unit}
        log |= {"--force-sensor": self.force_sensor, "--force-offset-s": self.force_offset_s}
        for flag, value in (named | log).items():
            if value is not None and self.force is None:
                raise InputError(f"--force with {flag}", "no --force", "--force 3N")
            if value is not None and flag in log and flags.force_n(self.force or "") is not None:
                raise InputError(f"a log of the force with {flag}", f"--force {self.force}", f"leave out {flag}")
        if self.plane_strain and self.thickness_m is None:
            raise InputError("--thickness-m with --plane-strain", "none", "--thickness-m 0.05")


@dataclass(frozen=True, slots=True)
class LayersFlags(Flags):
    """Pokes of a surface: pair files of surface points, z up, whose held points were pressed down."""

    spacing_m: flags.PositiveFlag = None
    """Spacing of the layers' lattice [m]; default: a quarter of the tip's width."""


@dataclass(frozen=True, slots=True)
class MotionFlags(Flags):
    """All frames of a sequence in one fit."""

    whole_motion: bool = False
    """Fit all frames together instead of the last one; the interval accounts for the errors that frames share."""
    select: flags.SelectFlag = None
    """Options to select by the error on particles left out: cluster-size, held, alpha and dt. Static states do not
    depend on alpha and dt; only time steps through fast motion determine them."""

    def check(self) -> None:
        if self.select is not None and not self.whole_motion:
            raise InputError("--whole-motion with --select", "no --whole-motion", "add --whole-motion")


def check_arrays(
    sources: tuple[str, ...], images: ImageOptions, noise_px: float | None, called: str, push: PushFlags | None = None
) -> None:
    """Raises InputError for .npz files among images, and for flags about images with .npz files. called: the source's
    description in the message; push: with the force on images"""
    files = [source for source in sources if ending_of(source) == ".npz"]
    if files and len(files) != len(sources):
        other = next(source for source in sources if source not in files)
        raise InputError(f"either {called} or images", "both", "name them in two commands", other)
    if files and images != ImageOptions():
        came = "flags about images (--roi, --grid, --held...)"
        raise InputError(f"no flags about images with {called}", came, "leave them out")
    if files and push is not None and push.force is not None:
        raise InputError(
            f"force_n in {called}", f"--force {push.force}", "force_n, contact and force_noise_n in the file"
        )
    if files and noise_px is not None:
        raise InputError(f"--noise-m for {called}", "--noise-px", "give the noise in metres")


@dataclass(frozen=True, slots=True)
class CalibrateOptions(RecordedOptions):
    """Options that `calibrate beta` and `calibrate theta` share."""

    sources: flags.Sources
    """A video, a folder of frames, images in the given order, pair files (.npz), or a recording (.rrd). In images
    without --roi, --mask, --outline, --held and --contact the body, what holds it and what pushes it are found."""
    alpha: AlphaFlag = field(default=1.0, kw_only=True)
    """Stiffness of the pull to the goal positions."""
    at: flags.ShareFlag = field(default=None, kw_only=True)
    """Report the error at this value as well (`settings.at`)."""
    search: OmitArgPrefixes[SearchOptions] = field(default_factory=SearchOptions, kw_only=True)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions, kw_only=True)
    push: OmitArgPrefixes[PushFlags] = field(default_factory=PushFlags, kw_only=True)
    model: OmitArgPrefixes[ModelOptions] = field(default_factory=ModelOptions, kw_only=True)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions, kw_only=True)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions, kw_only=True)

    def check(self) -> None:
        for rig in self.sources:
            if rig.startswith("lab:") or Path(rig).suffix.lower() == ".toml":
                raise InputError(
                    "files", "a rig", f"deformscope live {rig} --stage beta; or fit a recording of it", rig
                )


@dataclass(frozen=True, slots=True)
class BetaConfig(CalibrateOptions):
    """Find beta, the share of linear deformation, from images or from pairs of rest and deformed positions."""

    cluster_size: Annotated[flags.CountFlag, flags.least(2)] = None
    """Particles along each side of a cluster; default: 3, and with --thickness-m the one with the least error on pokes
    left out."""
    mode: Literal["linear", "quadratic"] = "linear"
    """How a cluster may deform."""
    theta: flags.ShareFlag = None
    """Volume conservation, a fixed value; default: 0; with --thickness-m it is fitted too."""
    beta_range: flags.BetaSpanFlag = (0.0, 0.99)
    """Range in which beta is searched."""
    layers: OmitArgPrefixes[LayersFlags] = field(default_factory=LayersFlags)
    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)

    def check(self) -> None:
        CalibrateOptions.check(self)
        if self.layers.spacing_m is not None and self.push.thickness_m is None:
            raise InputError("--thickness-m with --spacing-m", "none", "--thickness-m 0.05")
        if self.has_layers and self.mode != "linear":
            raise InputError("--mode linear with --thickness-m", self.mode)
        if self.at is not None and (self.has_layers or self.motion.whole_motion):
            raise InputError("no --at with --thickness-m or --whole-motion", f"{self.at:g}", "leave out --at")
        if self.push.force is not None and self.motion.whole_motion:
            raise InputError(
                "--force without --whole-motion", "both", "leave out --whole-motion: one frame has a force"
            )
        if self.at is not None and self.at > flags.BETA_LIMIT:
            raise InputError(f"a --at of at most {flags.BETA_LIMIT:g}", f"{self.at:g}")

    @property
    def has_layers(self) -> bool:
        """Whether the material below a surface is fitted: pokes in pairs, with its thickness; images have a --force."""
        return self.push.thickness_m is not None and self.push.force is None

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
    """Share of linear deformation, a fixed value."""
    theta_range: flags.SpanFlag = (0.0, 1.0)
    """Range in which theta is searched."""


@dataclass(frozen=True, slots=True)
class FitFlags(Flags):
    """Options that all fits to pairs and motions share."""

    level: flags.LevelFlag = 0.9
    """Confidence level of the intervals."""
    noise_m: flags.PositiveFlag = None
    """Standard deviation of a measured position [m]; default: the files' value, else estimated from the residuals."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""


# deformscope predict -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PredictConfig(RecordedOptions):
    """Predict a poke that was not fitted, at another place, depth, force or tip: deformed particles, depth and
    force."""

    source: Annotated[Path, Positional, arg(metavar="MODEL.npz"), flags.Reads()]
    """A model file that `deformscope calibrate ... --save` wrote."""
    poke: flags.PokesFlag = ()
    """The poke, such as 'at=0.28,0.2 tip=flat size=0.03x0.03 force=5' in metres and newtons; ; separates several. The
    tip is flat (sides), disc or sphere (diameter), by default the tip of the fit. Give a depth or a force."""
    against: Annotated[tuple[Path, ...], arg(metavar="PAIR.npz..."), flags.Reads()] = ()
    """Measured pokes that were not fitted. Each is predicted from its place, tip and depth, and compared with the
    measurement. A rigid body, a half-space in closed form and linear finite elements are compared too."""
    target: Annotated[Target | None, arg(name="in")] = None
    """Predict --poke in this simulator too, after its parameters were fitted to the pokes of --against, as `deformscope
    simulate` does."""
    python: PythonFlag = None
    """The Python interpreter with the simulator; default: this one."""
    points: flags.FileFlag = None
    """Points of the surface (.npz with `points (n, 3)`) whose deformed positions are predicted too."""
    out: flags.ArraysFlag = None
    """Write every particle of every poke: rest_0, deformed_0, rest_1... An existing file is replaced."""
    picture: flags.PictureFlag = None
    """Draw the dents and, with --against, measured and predicted surfaces. An existing file is replaced."""
    device: flags.Device = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        if not self.poke and not self.against:
            raise InputError("a --poke or pokes to compare with --against", "neither", f"--poke {flags.POKE_EXAMPLE}")
        if self.target is not None and not (self.poke and self.against):
            raise InputError("--poke, and --against: measured pokes to fit the simulator to", "--in without both")


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
    flags.PositiveFlag, flags.Rule(lambda beta: beta <= flags.BETA_LIMIT, f"a {{flag}} of at most {flags.BETA_LIMIT:g}")
]
CreepFlag = Annotated[float | str, flags.one_word("none|fit|RATE", parse_creep)]


FramesFlag = Annotated[
    tuple[int, int] | None, flags.one_word("LOADED,UNLOADED", parse_frames, flags.joined(",")), flags.unset
]


@dataclass(frozen=True, slots=True)
class MotionFitFlags(FitFlags):
    """Options that all fits to a material's motion share."""

    noise_px: flags.PositiveFlag = None
    """Standard deviation of a measured position [px]; default: measured in the images."""

    def check(self) -> None:
        either("--noise-px", "--noise-m", self.noise_px, self.noise_m)


@dataclass(frozen=True, slots=True)
class UnloadingFlags(Flags):
    """How a camera's motion shows the release of a pressed body."""

    at: FramesFlag = None
    """The last frame at the greatest depth and the first unloaded frame, counted from 0 after --stride; default: found
    from the force if the recording has one, else from the motion."""
    released: flags.HeldFlag = None
    """The held parts that are released at the end; default: contact."""
    force: flags.CameraFlag = None
    """For a recording with several force sensors: the sensor on the tool."""

    def check(self) -> None:
        if self.at is not None and self.force is not None:
            raise InputError("--at or --force", "both", "leave one out")


@dataclass(frozen=True, slots=True)
class MaterialOptions(RecordedOptions):
    """Options that `calibrate axes`, `field`, `yield` and `viscous` share."""

    sources: flags.Sources
    """A video, a folder of frames, images in the given order, a recording (.rrd), or .npz files."""
    fit: OmitArgPrefixes[MotionFitFlags] = field(default_factory=MotionFitFlags, kw_only=True)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions, kw_only=True)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions, kw_only=True)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions, kw_only=True)

    def check(self) -> None:
        check_arrays(self.sources, self.images, self.fit.noise_px, ".npz files")


@dataclass(frozen=True, slots=True)
class AxesConfig(MaterialOptions):
    """Find a beta along each axis of a material from images, or from pairs of rest and deformed positions (one fit to
    all pairs)."""

    turn_deg: float = 0.0
    """Angle of the material's first axis to x, in the plane of x and y [degrees]; in images y points down."""
    frame: Annotated[flags.SomeFlag, arg(name="at")] = None
    """For images: the frame to fit, counted from 0 after --stride; default: the last one."""
    cluster_size: flags.ClusterFlag = 3
    """Particles along each side of a cluster."""


@dataclass(frozen=True, slots=True)
class FieldConfig(MaterialOptions):
    """Find the relative stiffness of each place of a body from one deformation, by images or one pair file. The field
    is smooth or of a few materials, with a beta for each place; a force gives stiffness in N/m."""

    frame: Annotated[flags.SomeFlag, arg(name="at")] = None
    """For images: the frame to fit, counted from 0 after --stride; default: the last one."""
    force_n: flags.PositiveFlag = None
    """Magnitude of the net force on the moved held particles, in that frame [N]; default: the pair file's."""


@dataclass(frozen=True, slots=True)
class YieldConfig(MaterialOptions):
    """Find a body's yield strain from its motion under load and after release. A motion file (.npz) has rest (K, d),
    motion (T, K, d) [m], held (n,) or (T, K), and dt [s] for creep."""

    beta: ElasticFlag = None
    """Share of linear deformation; default: fitted together with the yield strain."""
    creep: CreepFlag = "none"
    """Rate of plastic flow [1/s]. none: each frame reaches equilibrium; fit: the rate is fitted too; or a number."""
    maximum: flags.PositiveFlag = None
    """Largest plastic strain; default: no bound."""
    theta: Annotated[float, flags.SHARE] = 0.0
    """Volume conservation (by projection), a fixed value."""
    cluster_size: flags.ClusterFlag = 3
    """Particles along each side of a cluster."""
    unloading: OmitArgPrefixes[UnloadingFlags] = field(default_factory=UnloadingFlags)


@dataclass(frozen=True, slots=True)
class ViscousConfig(MaterialOptions):
    """Find the relaxing and the permanent share of a body's modulus and the relaxation time, from its recovery after
    release. A force in the recording adds the relaxation under load, and the instantaneous and the relaxed
    stiffness."""

    unloading: OmitArgPrefixes[UnloadingFlags] = field(default_factory=UnloadingFlags)
