"""What each command can be told: one frozen dataclass a command, whose fields are its flags.

A field's docstring is the flag's help. What one value must look like is checked where it is parsed (`ValueError`, which
the command line reports with the flag's name), what values must satisfy together where the dataclass is made
(`InputError`). Nothing heavy is imported here: `--help` shows these classes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast

from tyro.conf import OmitArgPrefixes, Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from deformscope.bench.timing import CASES, Case
from deformscope.errors import InputError

T = TypeVar("T")

Rectangle = tuple[float, float, float, float]
"""x, y of the upper left corner, width, height [px]."""
GridShape = tuple[int, int]
"""Rows, columns."""
Span = tuple[float, float]
"""Lowest, highest."""
HeldPart = Literal["top", "bottom", "left", "right", "border", "contact"]

TipName = Literal["flat", "disc", "sphere"]

Selectable = Literal["cluster-size", "held", "alpha", "dt"]

SELECTABLE: tuple[Selectable, ...] = ("cluster-size", "held", "alpha", "dt")

HELD_PARTS: tuple[HeldPart, ...] = ("top", "bottom", "left", "right", "border", "contact")


# What one value looks like -------------------------------------------------------------------------------------------


def parse_rectangle(text: str) -> Rectangle:
    """`x,y,width,height` [px] with a width and a height above 0."""
    try:
        x, y, width, height = (_finite(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected x,y,width,height in pixels, such as 400,200,750,350; got {text!r}") from None
    if not (width > 0 and height > 0):
        raise ValueError(f"expected a width and a height above 0 in x,y,width,height; got {text!r}")
    return x, y, width, height


def parse_grid(text: str) -> GridShape:
    """`ROWSxCOLS`, at least 2 each."""
    try:
        rows, columns = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"expected ROWSxCOLS, such as 7x15; got {text!r}") from None
    if min(rows, columns) < 2:
        raise ValueError(f"expected at least 2 rows and 2 columns in ROWSxCOLS; got {text!r}")
    return rows, columns


def parse_held(text: str) -> tuple[HeldPart, ...]:
    """A comma list of parts of the lattice, each named once in the result."""
    named = [part.strip() for part in text.split(",")]
    unknown = [part for part in named if part not in HELD_PARTS]
    if unknown:
        raise ValueError(f"expected a comma list of {', '.join(HELD_PARTS)}; got {', '.join(map(repr, unknown))}")
    return tuple(part for part in HELD_PARTS if part in named)


def parse_selectable(text: str) -> tuple[Selectable, ...]:
    """A comma list of what held-out error can choose, each named once in the result."""
    named = [part.strip() for part in text.split(",")]
    if unknown := [part for part in named if part not in SELECTABLE]:
        raise ValueError(f"expected a comma list of {', '.join(SELECTABLE)}; got {', '.join(map(repr, unknown))}")
    return tuple(part for part in SELECTABLE if part in named)


def parse_span(text: str) -> Span:
    """`LOWEST,HIGHEST`, rising."""
    try:
        lowest, highest = (_finite(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected LOWEST,HIGHEST, such as 0,0.99; got {text!r}") from None
    return lowest, highest


def parse_sizes(text: str) -> tuple[int, ...]:
    """A comma list of cubes n^3 with n from 4."""
    try:
        sizes = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers of particles, such as 216,1331; got {text!r}") from None
    if odd := [size for size in sizes if size < 64 or round(size ** (1 / 3)) ** 3 != size]:
        raise ValueError(f"expected cubes of 4 or more, such as 216 or 1331; got {', '.join(map(str, odd))}")
    return tuple(sorted(set(sizes)))


def parse_cases(text: str) -> tuple[Case, ...]:
    """A comma list of what is measured, each named once in the result."""
    named = [part.strip() for part in text.split(",")]
    if unknown := [part for part in named if part not in CASES]:
        raise ValueError(f"expected a comma list of {', '.join(CASES)}; got {', '.join(map(repr, unknown))}")
    return tuple(case for case in CASES if case in named)


@dataclass(frozen=True, slots=True)
class PokeText:
    """A poke as it is typed: at (2,) or (3,) [m]; tip and its size [m], None = the model's; depth [m] or force [N]."""

    at: tuple[float, ...]
    tip: TipName | None = None
    size: tuple[float, ...] = ()
    depth: float | None = None
    force: float | None = None

    def __str__(self) -> str:
        parts = [f"at={','.join(f'{v:g}' for v in self.at)}"]
        if self.tip is not None:
            parts.append(f"tip={self.tip}")
        if self.size:
            parts.append(f"size={'x'.join(f'{v:g}' for v in self.size)}")
        parts.append(f"depth={self.depth:g}" if self.depth is not None else f"force={self.force:g}")
        return " ".join(parts)


POKE_EXAMPLE = "'at=0.28,0.2 tip=flat size=0.03x0.03 force=5'"


def parse_poke(text: str) -> PokeText:
    """`at=X,Y tip=flat|disc|sphere size=WIDTHxDEPTH depth=D` or `force=F`, in metres and newtons."""
    told: dict[str, str] = {}
    for part in text.split():
        name, equals, value = part.partition("=")
        if not equals or name not in ("at", "tip", "size", "depth", "force") or name in told:
            raise ValueError(f"expected a poke such as {POKE_EXAMPLE} (metres, newtons); got {part!r} in {text!r}")
        told[name] = value
    if "at" not in told or ("depth" in told) == ("force" in told):
        raise ValueError(f"expected at=X,Y and one of depth= and force=, such as {POKE_EXAMPLE}; got {text!r}")
    tip = told.get("tip")
    if tip not in (None, "flat", "disc", "sphere"):
        raise ValueError(f"expected tip=flat, tip=disc or tip=sphere; got {tip!r} in {text!r}")
    if tip is not None and "size" not in told:
        raise ValueError(f"expected size= with tip={tip}, its sides or its diameter in metres; got {text!r}")
    try:
        return PokeText(
            at=tuple(_finite(value) for value in told["at"].split(",")),
            tip=cast("TipName | None", tip),
            size=tuple(_positive(value) for value in told["size"].split("x")) if "size" in told else (),
            depth=_positive(told["depth"]) if "depth" in told else None,
            force=_positive(told["force"]) if "force" in told else None,
        )
    except ValueError as error:
        raise ValueError(f"{error} in {text!r}; for example {POKE_EXAMPLE}") from None


def parse_pokes(text: str) -> tuple[PokeText, ...]:
    """Pokes with `;` between them."""
    return tuple(parse_poke(part) for part in text.split(";") if part.strip())


def _finite(text: str) -> float:
    value = float(text)
    if value - value != 0.0:  # inf and nan
        raise ValueError(f"expected a finite number; got {text!r}")
    return value


def _positive(text: str) -> float:
    try:
        value = _finite(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise ValueError(f"expected a number above 0; got {text!r}")
    return value


def _value(metavar: str, parse: Callable[[str], T], show: Callable[[Any], str] = str) -> PrimitiveConstructorSpec[T]:
    """One word on the command line; None, which cannot be typed there, stands for a flag that was left out."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: ["none" if value is None else show(value)],
    )


def _joined(separator: str) -> Callable[[Any], str]:
    return lambda parts: separator.join(str(part) for part in parts)


_unset = arg(help_behavior_hint="")
"""No "(default: none)" in the help of a flag that may be left out."""

RectangleFlag = Annotated[Rectangle | None, _value("X,Y,WIDTH,HEIGHT", parse_rectangle, _joined(",")), _unset]
GridFlag = Annotated[GridShape | None, _value("ROWSxCOLS", parse_grid, _joined("x")), _unset]
HeldFlag = Annotated[tuple[HeldPart, ...] | None, _value("PART,PART...", parse_held, _joined(",")), _unset]
SelectFlag = Annotated[tuple[Selectable, ...] | None, _value("WHAT,WHAT...", parse_selectable, _joined(",")), _unset]
SpanFlag = Annotated[Span, _value("LOWEST,HIGHEST", parse_span, _joined(","))]
PositiveFlag = Annotated[float | None, _value("NUMBER", _positive), _unset]
SizesFlag = Annotated[tuple[int, ...] | None, _value("N,N...", parse_sizes, _joined(",")), _unset]
CasesFlag = Annotated[tuple[Case, ...] | None, _value("CASE,CASE...", parse_cases, _joined(",")), _unset]
CountFlag = Annotated[int | None, _value("INT", int), _unset]
FileFlag = Annotated[Path | None, _value("FILE", Path), _unset]
ModelFlag = Annotated[Path | None, _value("MODEL.npz", Path), _unset]
ShareFlag = Annotated[float | None, _value("NUMBER", float), _unset]
PokesFlag = Annotated[tuple["PokeText", ...], _value("POKE", lambda text: parse_pokes(text), _joined("; "))]
PictureFlag = Annotated[Path | None, _value("FILE.png", Path), _unset]
ReportFlag = Annotated[Path | None, _value("FILE.html", Path), _unset]
JsonFlag = Annotated[str | None, _value("FILE|-", str), _unset]
Sources = Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE...", help_behavior_hint="")]


# What several commands check -----------------------------------------------------------------------------------------


def _check_sources(sources: tuple[str, ...]) -> None:
    if not sources:
        raise InputError("at least one SOURCE", "none", "a video, a folder of frames, images, or pair files (.npz)")


def _check_unit(flag: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise InputError(f"a {flag} between 0 and 1", str(value))


BETA_LIMIT = 0.9999
"""Highest beta that can be searched (`deformscope.stages.calibrate.BETA_LIMIT`, which would import numpy here)."""


def _check_span(flag: str, span: Span, limit: float = 1.0) -> None:
    lowest, highest = span
    if not lowest < highest:
        raise InputError(f"a {flag} that rises", f"{lowest:g},{highest:g}", f"{flag} {highest:g},{lowest:g}")
    if lowest < 0 or highest > limit:  # neither is NaN: `_finite` has seen to that
        raise InputError(f"a {flag} within 0,{limit:g}", f"{lowest:g},{highest:g}")


def _check_alpha(alpha: float) -> None:
    if not 0 < alpha <= 1:
        raise InputError("an --alpha above 0 and at most 1", str(alpha))


def _check_cluster_size(size: int | None) -> None:
    if size is not None and size < 2:
        raise InputError("a --cluster-size of 2 or more", str(size))


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise InputError("a --level between 0 and 1", str(level), "--level 0.9")


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise InputError("a --seed of 0 or more", str(seed))


def _check_suffix(flag: str, path: Path | None, suffix: str) -> None:
    if path is not None and path.suffix != suffix:
        raise InputError(f"a file that ends in {suffix} after {flag}", repr(str(path)))


# What every command's options can be asked ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Written:
    """A file that a command will write.

    flag: the flag that names it; replace: whether a file that is there already may go
    """

    flag: str
    path: Path
    replace: bool = True


class CommandOptions:
    """What the command line asks of any command's options before it runs the command."""

    __slots__ = ()

    def reads(self) -> tuple[str, ...]:
        """The sources, none of which may be written over."""
        return ()

    def writes(self) -> tuple[Written, ...]:
        """The files to come; all are checked before any heavy work."""
        return ()

    def json_target(self) -> str | None:
        """Where the JSON goes: a path, `-` for stdout, None for nowhere."""
        return None


@dataclass(frozen=True, slots=True)
class OutputOptions:
    """What is left behind and what is shown."""

    json: JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""
    record: FileFlag = None
    """Write a rerun recording (.rrd). Without it nothing is recorded."""
    viewer: Literal["auto", "native", "page", "none"] = "auto"
    """Show every stage live: in rerun's window, on a web page, or not at all; auto: the window where there is a
    display."""
    overwrite: bool = False
    """Replace a recording that exists; without it an existing one is refused."""
    seed: int = 0
    """Seed of every random number."""

    def __post_init__(self) -> None:
        _check_suffix("--record", self.record, ".rrd")
        _check_seed(self.seed)

    def writes(self) -> tuple[Written, ...]:
        record = () if self.record is None else (Written("--record", self.record, replace=self.overwrite),)
        return (*record, *_written_json(self.json))


class RecordedOptions(CommandOptions):
    """A command whose outputs are its `OutputOptions`."""

    __slots__ = ()
    output: OutputOptions

    def writes(self) -> tuple[Written, ...]:
        return self.output.writes()

    def json_target(self) -> str | None:
        return self.output.json


def _written_json(target: str | None) -> tuple[Written, ...]:
    return () if target is None or target == "-" else (Written("--json", Path(target)),)


# Images --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """How images become particles. Pair files need none of these."""

    roi: RectangleFlag = None
    """Region of the image that holds the thing [px]; default: all of it."""
    grid: GridFlag = None
    """Rows and columns of particles over the region, such as 7x15."""
    spacing_px: PositiveFlag = None
    """Distance of neighbouring particles [px], instead of --grid."""
    mask: FileFlag = None
    """Image that is not black where the thing is; particles stand there alone. It is left out of a sequence that holds
    it."""
    px_per_cm: PositiveFlag = None
    """Scale of the image [px/cm]; with it lengths are told in metres too."""
    stride: int = 1
    """Take every n-th frame."""
    fps: PositiveFlag = None
    """Frames a second of images that do not say; default: what the video says."""
    flow: Literal["dis", "farneback"] = "dis"
    """Method of the dense optical flow."""
    held: HeldFlag = None
    """Particles whose motion is taken from the images and prescribed, out of top, bottom, left, right, border and
    contact. Default: bottom,contact where --contact is given, else top,bottom."""
    contact: RectangleFlag = None
    """Footprint of the tool in the first image [px]; the particles inside are `contact`."""

    def __post_init__(self) -> None:
        if self.grid is not None and self.spacing_px is not None:
            raise InputError("--grid or --spacing-px", "both", "leave one out")
        if self.stride < 1:
            raise InputError("a --stride of 1 or more", str(self.stride))
        if self.held is not None and "contact" in self.held and self.contact is None:
            raise InputError("--contact X,Y,WIDTH,HEIGHT with --held contact", "no --contact")
        if self.held is not None and "contact" not in self.held and self.contact is not None:
            held = ",".join((*self.held, "contact"))
            raise InputError("contact among --held with --contact", f"--held {','.join(self.held)}", f"--held {held}")

    def held_parts(self) -> tuple[HeldPart, ...]:
        """The parts to hold: those asked for, else what stands still and what pushes."""
        if self.held is not None:
            return self.held
        return ("bottom", "contact") if self.contact is not None else ("top", "bottom")


# deformscope flow ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FlowConfig(CommandOptions):
    """Dense optical flow of two images: where each pixel of BEFORE has gone in AFTER."""

    before: Annotated[Path, Positional, arg(metavar="BEFORE")]
    """The first image."""
    after: Annotated[Path, Positional, arg(metavar="AFTER")]
    """The second image, of the same size."""
    out: Annotated[Path, arg(metavar="FILE.npz")]
    """Where `flow_px (height, width, 2)` in (x, y) [px] goes. An existing file is replaced."""
    method: Literal["dis", "farneback"] = "dis"
    """Dense inverse search, or Farneback's polynomials."""
    backward: bool = False
    """Write `backward_px`, the flow from AFTER to BEFORE, as well."""
    picture: PictureFlag = None
    """Draw the flow as arrows and colour. An existing file is replaced."""
    json: JsonFlag = None
    """Write the numbers of the table as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        _check_suffix("--out", self.out, ".npz")
        _check_suffix("--picture", self.picture, ".png")

    def reads(self) -> tuple[str, ...]:
        return str(self.before), str(self.after)

    def writes(self) -> tuple[Written, ...]:
        picture = () if self.picture is None else (Written("--picture", self.picture),)
        return (Written("--out", self.out), *picture, *_written_json(self.json))

    def json_target(self) -> str | None:
        return self.json


# deformscope calibrate -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SearchOptions:
    """How the parameter is searched, and how sure of it to be."""

    method: Literal["sweep", "gradient"] = "sweep"
    """Try --candidates values over the range (Thesis Algorithm 3), or follow the error downhill (Algorithm 2)."""
    candidates: int = 100
    """Values that the sweep tries."""
    level: float = 0.9
    """Confidence level of the interval."""
    noise_px: PositiveFlag = None
    """Standard deviation of a measured position [px]; default: measured in the images."""
    noise_m: PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the pair file says."""
    joint: bool = False
    """Fit one value to all pairs together."""
    volume: Literal["scale", "project"] = "scale"
    """How theta conserves volume: as Thesis eq. 3.17, or by a projection that stays stable in overlapping clusters."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""

    def __post_init__(self) -> None:
        if self.candidates < 3:
            raise InputError("at least 3 --candidates", str(self.candidates))
        _check_level(self.level)
        if self.noise_px is not None and self.noise_m is not None:
            raise InputError("--noise-px or --noise-m", "both", "leave one out")


@dataclass(frozen=True, slots=True)
class ModelOptions:
    """What is left for predictions."""

    save: ModelFlag = None
    """Write the fitted model, which `deformscope predict` can poke (.npz, no pickle)."""

    def __post_init__(self) -> None:
        _check_suffix("--save", self.save, ".npz")


@dataclass(frozen=True, slots=True)
class SummaryOptions:
    """The result to look at and to pass on, without a viewer."""

    picture: PictureFlag = None
    """Draw particles, where the model is wrong, error curve and posterior in one picture. An existing file is
    replaced."""
    report: ReportFlag = None
    """Write all that was found, with pictures, settings and provenance, as one HTML page that needs nothing else. An
    existing file is replaced."""

    def __post_init__(self) -> None:
        _check_suffix("--picture", self.picture, ".png")
        _check_suffix("--report", self.report, ".html")

    @property
    def wanted(self) -> bool:
        """Whether there is anything to write."""
        return self.picture is not None or self.report is not None

    def writes(self) -> tuple[Written, ...]:
        named = (("--picture", self.picture), ("--report", self.report))
        return tuple(Written(flag, path) for flag, path in named if path is not None)


@dataclass(frozen=True, slots=True)
class LayersFlags:
    """Pokes of a surface: pair files of surface points, z up, whose held points were pressed down."""

    thickness_m: PositiveFlag = None
    """Thickness of the material below the surface, which rests on the ground [m]. With it a lattice of layers is fitted
    to all pokes together; without, the points themselves are the particles."""
    spacing_m: PositiveFlag = None
    """Spacing of that lattice [m]; default: a quarter of the tip's width."""

    def __post_init__(self) -> None:
        if self.spacing_m is not None and self.thickness_m is None:
            raise InputError("--thickness-m with --spacing-m", "none", "--thickness-m 0.05")


@dataclass(frozen=True, slots=True)
class MotionFlags:
    """All frames of a sequence in one fit."""

    whole_motion: bool = False
    """Fit all frames together instead of the last one; the interval knows that frames share their errors."""
    select: SelectFlag = None
    """What to choose by the error on particles left out, of cluster-size, held, alpha and dt. alpha and dt leave static
    states as they are: time stepping through the frames tells them, if the motion was fast."""

    def __post_init__(self) -> None:
        if self.select is not None and not self.whole_motion:
            raise InputError("--whole-motion with --select", "no --whole-motion", "add --whole-motion")


class CalibrateOptions(RecordedOptions):
    """What `calibrate beta` and `calibrate theta` read and write."""

    __slots__ = ()
    sources: tuple[str, ...]
    images: ImageOptions
    model: ModelOptions
    summary: SummaryOptions

    def writes(self) -> tuple[Written, ...]:
        save = self.model.save
        model = () if save is None else (Written("--save", save, replace=self.output.overwrite),)
        return (*model, *self.summary.writes(), *self.output.writes())

    def reads(self) -> tuple[str, ...]:
        return self.sources if self.images.mask is None else (*self.sources, str(self.images.mask))


@dataclass(frozen=True, slots=True)
class BetaConfig(CalibrateOptions):
    """Find beta, the share of linear deformation, from images or from pairs of rest and deformed positions."""

    sources: Sources
    """A video, a folder of frames, images in the order given, pair files (.npz), or a recording (.rrd)."""
    cluster_size: CountFlag = None
    """Particles along each side of a cluster; default: 3, and with --thickness-m the one with the least error on pokes
    left out."""
    mode: Literal["linear", "quadratic"] = "linear"
    """How a cluster may deform."""
    alpha: float = 1.0
    """Stiffness of the pull to the goal positions."""
    theta: ShareFlag = None
    """Volume conservation, which stays as it is; default: 0, and with --thickness-m it is fitted too."""
    beta_range: SpanFlag = (0.0, 0.99)
    """Range in which beta is searched."""
    search: OmitArgPrefixes[SearchOptions] = field(default_factory=SearchOptions)
    layers: OmitArgPrefixes[LayersFlags] = field(default_factory=LayersFlags)
    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions)
    model: OmitArgPrefixes[ModelOptions] = field(default_factory=ModelOptions)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        _check_sources(self.sources)
        _check_cluster_size(self.cluster_size)
        _check_alpha(self.alpha)
        if self.theta is not None:
            _check_unit("--theta", self.theta)
        if self.layers.thickness_m is not None and self.mode != "linear":
            raise InputError("--mode linear with --thickness-m", self.mode)
        _check_span("--beta-range", self.beta_range, BETA_LIMIT)

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

    sources: Sources
    """A video, a folder of frames, images in the order given, pair files (.npz), or a recording (.rrd)."""
    cluster_size: CountFlag = None
    """Particles along each side of a cluster; default: one cluster holds all particles (Thesis 5.1)."""
    mode: Literal["linear", "quadratic"] = "quadratic"
    """How a cluster may deform."""
    alpha: float = 1.0
    """Stiffness of the pull to the goal positions."""
    beta: float = 0.99
    """Share of deformation, which stays as it is."""
    theta_range: SpanFlag = (0.0, 1.0)
    """Range in which theta is searched."""
    search: OmitArgPrefixes[SearchOptions] = field(default_factory=SearchOptions)
    images: OmitArgPrefixes[ImageOptions] = field(default_factory=ImageOptions)
    model: OmitArgPrefixes[ModelOptions] = field(default_factory=ModelOptions)
    summary: OmitArgPrefixes[SummaryOptions] = field(default_factory=SummaryOptions)
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def __post_init__(self) -> None:
        _check_sources(self.sources)
        _check_cluster_size(self.cluster_size)
        _check_alpha(self.alpha)
        _check_unit("--beta", self.beta)
        _check_span("--theta-range", self.theta_range)

    @property
    def single_cluster(self) -> bool:
        """Whether one cluster holds all particles."""
        return self.cluster_size is None


@dataclass(frozen=True, slots=True)
class BothConfig(CommandOptions):
    """Find beta and theta together from pairs of rest and deformed positions: their joint posterior. Volume is
    conserved by projection, which stays stable in overlapping clusters."""

    sources: Annotated[tuple[str, ...], Positional, arg(metavar="PAIR.npz...", help_behavior_hint="")]
    """Pair files."""
    cluster_size: CountFlag = 3
    """Particles along each side of a cluster; 0: one cluster holds all particles."""
    mode: Literal["linear", "quadratic"] = "linear"
    """How a cluster may deform."""
    beta_range: SpanFlag = (0.0, 0.99)
    """Range in which beta is searched."""
    theta_range: SpanFlag = (0.0, 1.0)
    """Range in which theta is searched."""
    level: float = 0.9
    """Confidence level of the intervals."""
    noise_m: PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the pair file says."""
    joint: bool = False
    """Fit one beta and one theta to all pairs together."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    seed: int = 0
    """Seed of every random number."""
    picture: PictureFlag = None
    """Draw the joint posterior (of several pairs, that of the first). An existing file is replaced."""
    json: JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        _check_sources(self.sources)
        if other := next((source for source in self.sources if Path(source).suffix.lower() != ".npz"), None):
            raise InputError("pair files (.npz)", repr(other), "calibrate beta or theta for images")
        if self.cluster_size not in (0, None) and (self.cluster_size or 0) < 2:
            raise InputError("a --cluster-size of 2 or more, or 0", str(self.cluster_size))
        _check_level(self.level)
        _check_seed(self.seed)
        _check_suffix("--picture", self.picture, ".png")
        _check_span("--beta-range", self.beta_range, BETA_LIMIT)
        _check_span("--theta-range", self.theta_range)

    def reads(self) -> tuple[str, ...]:
        return self.sources

    def writes(self) -> tuple[Written, ...]:
        picture = () if self.picture is None else (Written("--picture", self.picture),)
        return (*picture, *_written_json(self.json))

    def json_target(self) -> str | None:
        return self.json


# deformscope predict -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PredictConfig(CommandOptions):
    """Poke a fitted model where, how hard and with what it was not poked: deformed particles, depth and force."""

    source: Annotated[Path, Positional, arg(metavar="MODEL.npz")]
    """A model that `deformscope calibrate ... --save` has written."""
    poke: PokesFlag = ()
    """What to do, such as 'at=0.28,0.2 tip=flat size=0.03x0.03 force=5' in metres and newtons; several with ; between
    them. tip is flat (sides), disc or sphere (diameter), by default the one of the fit; give a depth or a force."""
    against: Annotated[tuple[Path, ...], arg(metavar="PAIR.npz...")] = ()
    """Pokes that were measured but not fitted: each is predicted from its place, tip and depth, and compared, beside a
    rigid body, a half-space in closed form and linear finite elements."""
    points: FileFlag = None
    """Points of the surface (.npz with `points (n, 3)`) whose deformed positions are wanted too."""
    out: Annotated[Path | None, _value("FILE.npz", Path), _unset] = None
    """Every particle of every poke: rest_0, deformed_0, rest_1... An existing file is replaced."""
    picture: PictureFlag = None
    """Draw the dents and, with --against, measured beside predicted. An existing file is replaced."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: JsonFlag = None
    """Write the predictions as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if not self.poke and not self.against:
            raise InputError("a --poke or pokes to compare with --against", "neither", f"--poke {POKE_EXAMPLE}")
        _check_suffix("--out", self.out, ".npz")
        _check_suffix("--picture", self.picture, ".png")

    def reads(self) -> tuple[str, ...]:
        return (str(self.source), *(str(path) for path in self.against))

    def writes(self) -> tuple[Written, ...]:
        out = () if self.out is None else (Written("--out", self.out),)
        picture = () if self.picture is None else (Written("--picture", self.picture),)
        return (*out, *picture, *_written_json(self.json))

    def json_target(self) -> str | None:
        return self.json


# deformscope calibrate axes and yield --------------------------------------------------------------------------------


def parse_creep(text: str) -> float | str:
    """`none`, `fit`, or a rate above 0 [1/s]."""
    if text in ("none", "fit"):
        return text
    try:
        return _positive(text)
    except ValueError:
        raise ValueError(f"expected none, fit or a rate above 0 in 1/s; got {text!r}") from None


CreepFlag = Annotated[float | str, _value("none|fit|RATE", parse_creep)]


@dataclass(frozen=True, slots=True)
class AxesConfig(CommandOptions):
    """Find a beta along each axis of a material from pairs of rest and deformed positions: one fit to all of them."""

    sources: Annotated[tuple[str, ...], Positional, arg(metavar="PAIR.npz...", help_behavior_hint="")]
    """Pair files."""
    turn_deg: float = 0.0
    """Angle of the material's first axis to x, in the plane of x and y [degrees]."""
    cluster_size: int = 3
    """Particles along each side of a cluster."""
    level: float = 0.9
    """Confidence level of the intervals."""
    noise_m: PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the pair files say."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    seed: int = 0
    """Seed of every random number."""
    json: JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if not self.sources:
            raise InputError("at least one PAIR.npz", "none", "a pair file with rest, deformed and held")
        _check_cluster_size(self.cluster_size)
        _check_level(self.level)
        _check_seed(self.seed)

    def reads(self) -> tuple[str, ...]:
        return self.sources

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


@dataclass(frozen=True, slots=True)
class YieldConfig(CommandOptions):
    """Find the strain at which a thing yields from its motion: loaded, and let go."""

    source: Annotated[Path, Positional, arg(metavar="MOTION.npz")]
    """rest (K, d), motion (T, K, d) [m], held (n,) or (T, K), and dt [s] for creep."""
    beta: PositiveFlag = None
    """Share of linear deformation; default: found along with the yield strain."""
    creep: CreepFlag = "none"
    """How fast it flows [1/s]: none, as long as it takes in every frame; fit, found too; or a rate."""
    maximum: PositiveFlag = None
    """Largest plastic strain; default: no bound."""
    theta: float = 0.0
    """Volume conservation (by projection), which stays as it is."""
    cluster_size: int = 3
    """Particles along each side of a cluster."""
    level: float = 0.9
    """Confidence level of the intervals."""
    noise_m: PositiveFlag = None
    """Standard deviation of a measured position [m]; default: what the file says, else the residuals."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    seed: int = 0
    """Seed of every random number."""
    picture: PictureFlag = None
    """Draw the error over the yield strain, and the residuals of the frames. An existing file is replaced."""
    json: JsonFlag = None
    """Write the result as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if self.beta is not None and self.beta > BETA_LIMIT:
            raise InputError(f"a --beta of at most {BETA_LIMIT:g}", str(self.beta))
        _check_suffix("--picture", self.picture, ".png")
        _check_unit("--theta", self.theta)
        _check_cluster_size(self.cluster_size)
        _check_level(self.level)
        _check_seed(self.seed)

    def reads(self) -> tuple[str, ...]:
        return (str(self.source),)

    def writes(self) -> tuple[Written, ...]:
        picture = () if self.picture is None else (Written("--picture", self.picture),)
        return (*picture, *_written_json(self.json))

    def json_target(self) -> str | None:
        return self.json


# deformscope demo and replay -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DemoConfig(RecordedOptions):
    """Measure the sample that ships: real images of a specimen under tension. Leaves runs/demo-<stamp>.rrd, or what
    --record names."""

    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)


@dataclass(frozen=True, slots=True)
class ReplayConfig(RecordedOptions):
    """Run the same stages on a recording's inputs, and compare with the numbers that it holds."""

    recording: Annotated[Path, Positional, arg(metavar="FILE.rrd")]
    """The recording."""
    pace: Literal["fast", "real", "step"] = "fast"
    """As fast as possible, as it was recorded, or frame by frame at each Enter."""
    output: OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def reads(self) -> tuple[str, ...]:
        return (str(self.recording),)


# deformscope reproduce -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CubesConfig(CommandOptions):
    """The thesis's experiment 3.A: theta of cubes of known Poisson's ratio, with figures 3.10 and 3.11, table 3.2, and
    overlapping clusters beside one cluster."""

    pairs: Annotated[tuple[Path, ...], arg(metavar="FILE...", help_behavior_hint="")] = ()
    """Cubes from pair files (.npz) with `nu`, instead of the thesis's 45 made with finite elements."""
    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/cubes")
    """Folder for the figures (PNG), tables (CSV) and cubes.json; files there are replaced."""
    quick: bool = False
    """The 15 cubes of 6^3 particles alone."""
    method: Literal["sweep", "gradient"] = "sweep"
    """How theta is searched: all values at once (Thesis Algorithm 3), or downhill (Algorithm 2)."""
    cluster_size: int = 2
    """Particles along each side of the overlapping clusters."""
    compare: Literal["deepest", "all", "none"] = "deepest"
    """Cubes that overlapping clusters are fitted to: the deepest pressed of each kind, all, or none."""
    level: float = 0.9
    """Confidence level of the intervals."""
    workers: CountFlag = None
    """Processes; default: one a core."""
    seed: int = 0
    """Seed of every random number."""
    json: JsonFlag = None
    """Write cubes.json here too; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if self.pairs and self.quick:
            raise InputError("--pairs or --quick", "both", "leave one out")
        _check_cluster_size(self.cluster_size)
        _check_level(self.level)
        if self.workers is not None and self.workers < 1:
            raise InputError("--workers of 1 or more", str(self.workers))
        _check_seed(self.seed)

    def reads(self) -> tuple[str, ...]:
        return tuple(str(path) for path in self.pairs)

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


# deformscope bench ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BenchConfig(CommandOptions):
    """Measure what MSM costs on this machine, beside NumPy. Ctrl-C ends it and shows what has been measured."""

    peers: bool = False
    """Run other engines too: pypbd, and mujoco and newton where they are installed (deformscope[peers])."""
    quick: bool = False
    """Less of everything, in some 20 s."""
    only: CasesFlag = None
    """Measure these alone, out of step, memory, relax, sweep, theta, gradient, fit and cold."""
    sizes: SizesFlag = None
    """Particles of the cubes that are stepped and relaxed; default: 216 to a million, on a GPU to ten."""
    repeats: CountFlag = None
    """Rounds of every comparison; default: what fits into a few seconds, 9 at most."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the simulation runs; auto: on the GPU where there is one."""
    json: JsonFlag = None
    """Write all of it as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if self.repeats is not None and self.repeats < 1:
            raise InputError("--repeats of 1 or more", str(self.repeats))

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


# deformscope coverage ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CoverageConfig(CommandOptions):
    """Count how often the intervals hold the truth: random objects under each kind of noise, data that tell nothing,
    and unseen pokes of finite element bodies."""

    objects: int = 1000
    """Random objects for each kind of noise; a fifth as many with beta = 0, near 1, and of finite elements."""
    quick: bool = False
    """15 objects each: what it looks like, in a minute."""
    level: float = 0.9
    """Confidence level of the intervals."""
    jobs: int = 2
    """Processes that share the work."""
    seed: int = 0
    """Seed of every random number."""
    out: Annotated[Path | None, _value("DIR", Path), _unset] = None
    """Folder for the rank histogram (coverage.png); made where there is none."""
    json: JsonFlag = None
    """Write the tables as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        if self.objects < 5:
            raise InputError("5 --objects or more", str(self.objects))
        _check_level(self.level)
        if self.jobs < 1:
            raise InputError("--jobs of 1 or more", str(self.jobs))
        _check_seed(self.seed)
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError("a folder after --out", "a file", where=self.out)

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


# deformscope reproduce pokes -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PokesConfig(CommandOptions):
    """Pokes of finite element slabs that were not fitted, predicted and compared with a rigid body, a half-space and
    linear finite elements."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/pokes")
    """Folder of dents.png and pokes.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The slab of one modulus alone."""
    json: JsonFlag = None
    """Write all of it as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json


# deformscope reproduce foams -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoamsConfig(CommandOptions):
    """Experiment 3.B: beta of five virtual foams from images of a push, with figure 3.14 and the force. Some 3 minutes
    on one core."""

    out: Annotated[Path, arg(metavar="DIR")] = Path("runs/foams")
    """Folder of the figures and of foams.csv; made where it is not there. What it holds of these is replaced."""
    quick: bool = False
    """The softest and the firmest foam alone, fewer images, in some 30 s."""
    keep_images: bool = False
    """Keep the images in DIR/images, a folder a foam, as `calibrate beta` takes them."""
    seed: int = 0
    """Seed of the speckles, of the camera's noise and of the intervals."""
    json: JsonFlag = None
    """Write all of it as JSON; with -, stdout is the JSON alone. An existing file is replaced."""

    def __post_init__(self) -> None:
        _check_seed(self.seed)

    def writes(self) -> tuple[Written, ...]:
        return _written_json(self.json)

    def json_target(self) -> str | None:
        return self.json
