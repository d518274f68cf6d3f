"""Options of `deformscope indent`."""

from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from deformscope.config import flags
from deformscope.config.options import RecordedOptions, ViewOptions, either
from deformscope.errors import InputError

TIP_EXAMPLE = "sphere:0.02, disc:0.01, flat:0.02x0.01 or cone:70"


@dataclass(frozen=True, slots=True)
class TipText:
    """A tip as typed: its kind, and diameter, sides [m] or half angle [deg]."""

    kind: str
    size: tuple[float, ...]

    def __str__(self) -> str:
        return f"{self.kind}:{'x'.join(f'{one:g}' for one in self.size)}"


def parse_tip(text: str) -> TipText:
    """`sphere:DIAMETER`, `disc:DIAMETER`, `flat:AxB` [m], `cone:HALF_ANGLE` [deg]."""
    kind, _, sizes = text.partition(":")
    try:
        size = tuple(flags.positive(one) for one in sizes.split("x"))
    except ValueError:
        size = ()
    most, count = (90.0, 1) if kind == "cone" else (1.0, 2 if kind == "flat" else 1)
    if kind not in ("sphere", "disc", "flat", "cone") or len(size) != count or max(size) >= most:
        raise ValueError(f"expected {TIP_EXAMPLE} (metres, degrees); got {text!r}")
    return TipText(kind, size)


def parse_poisson(text: str) -> flags.Span:
    """`NU` or `LOWEST,HIGHEST`."""
    try:
        found = tuple(flags.finite(one) for one in text.split(","))
    except ValueError:
        found = ()
    if len(found) not in (1, 2) or not -1.0 < found[0] <= found[-1] <= 0.5:
        raise ValueError(f"expected NU or LOWEST,HIGHEST above -1 and up to 0.5; got {text!r}")
    return found[0], found[-1]


CurveSources = Annotated[
    tuple[str, ...],
    Positional,
    arg(metavar="SOURCE...", help_behavior_hint=""),
    flags.Reads(),
    flags.Rule(bool, "at least one SOURCE", "a table of force and depth", lambda _: "none"),
]
_share = flags.Rule(lambda value: 0 <= value < 0.5, "a {flag} of 0 to 0.5")


@dataclass(frozen=True, slots=True)
class IndentConfig(RecordedOptions):
    """Find Young's modulus from force over depth of a rigid tip alone: of a test machine, a palpation rig, an AFM, or
    touches of a recording. Several sources are several places of one sample."""

    sources: CurveSources
    """Tables with a column of force and one of depth (.csv, .tsv, .txt, .dat, .parquet), recordings (.rrd), or, with
    --map, whatever `deformscope import` reads."""
    tip: Annotated[TipText, flags.one_word("KIND:SIZE", parse_tip)]
    """sphere:DIAMETER, disc:DIAMETER or flat:AxB in metres, or cone:HALF_ANGLE in degrees."""
    thickness_m: flags.LengthFlag = None
    """Thickness of the sample, which lies on rigid ground [m]; default: as thick as a half-space."""
    bonded: bool = False
    """The sample is fixed to its ground."""
    sliding: bool = False
    """The sample slides on its ground without friction."""
    poisson: Annotated[flags.Span, flags.one_word("NU|LOW,HIGH", parse_poisson, flags.joined(","))] = (0.0, 0.5)
    """Poisson's ratio, or its range: its share of the interval."""
    width_m: flags.LengthFlag = None
    """Smallest width of the sample [m]; default: its sides are far away."""
    machine_n_per_mm: flags.PositiveFlag = None
    """Stiffness of the machine, of an arm or a cantilever, which is taken out of the depth; default: rigid."""
    tip_tolerance: Annotated[float, _share] = 0.005
    """Standard deviation of the tip's size, as a share."""
    thickness_tolerance: Annotated[float, _share] = 0.02
    """Standard deviation of the thickness, as a share."""
    force_tolerance: Annotated[float, _share] = 0.01
    """Standard deviation of the force's gain, as a share."""
    machine_tolerance: Annotated[float, _share] = 0.05
    """Standard deviation of the machine's stiffness, as a share."""
    force_column: flags.CameraFlag = None
    """The column of force: NAME, NAME=UNIT where the table does not say its unit, -NAME for the other sign."""
    depth_column: flags.CameraFlag = None
    """The column of depth, in the same form."""
    time_column: flags.CameraFlag = None
    """The column of time, in the same form; default: one that is named so, if there is one."""
    map: flags.FileFlag = None
    """A map as in `deformscope import`, with a wrench and an arm."""
    picture: flags.PictureFlag = None
    """Draw the curves with the fitted law. An existing file is replaced."""
    report: flags.ReportFlag = None
    """Write the result as one HTML page. An existing file is replaced."""
    output: OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)

    def check(self) -> None:
        either("--bonded", "--sliding", self.bonded, self.sliding)
        if (self.thickness_m is not None) != (self.bonded or self.sliding):
            expected = "--thickness-m with --bonded or --sliding"
            raise InputError(expected, "one without the other", "--thickness-m 0.01 --bonded")
        either("--map", "--force-column and --depth-column", self.map, self.force_column or self.depth_column)
