"""The form of one value on the command line, its range, and declarations of flags with such values."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast, get_args

from tyro.conf import Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from deformscope.bench_cases import CASES, Case
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

Device = Literal["auto", "cpu", "cuda"]


def numbers(names: str, example: str) -> Callable[[str], Any]:
    """Parses a comma list of finite numbers, one for each name."""

    def parse(text: str) -> tuple[float, ...]:
        parts = text.split(",")
        try:
            found = tuple(finite(part) for part in parts)
        except ValueError:
            found = ()
        if len(found) != names.count(",") + 1:
            raise ValueError(f"expected {names}, such as {example}; got {text!r}")
        return found

    return parse


def parse_rectangle(text: str) -> Rectangle:
    """`x,y,width,height` [px] with a width and a height above 0."""
    found: Rectangle = numbers("x,y,width,height in pixels", "400,200,750,350")(text)
    if not min(found[2:]) > 0:
        raise ValueError(f"expected a width and a height above 0 in x,y,width,height; got {text!r}")
    return found


def parse_outline(text: str) -> tuple[float, ...]:
    """`x,y,x,y,...` [px], three corners or more."""
    try:
        found = tuple(finite(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) < 6 or len(found) % 2:
        raise ValueError(f"expected x,y,x,y,x,y,... of three corners or more, in pixels; got {text!r}")
    return found


def parse_grid(text: str) -> GridShape:
    """`ROWSxCOLS`, at least 2 each."""
    try:
        rows, columns = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise ValueError(f"expected ROWSxCOLS, such as 7x15; got {text!r}") from None
    if min(rows, columns) < 2:
        raise ValueError(f"expected at least 2 rows and 2 columns in ROWSxCOLS; got {text!r}")
    return rows, columns


def some_of(known: tuple[T, ...]) -> Callable[[str], tuple[T, ...]]:
    """Parses a comma list of the values in `known`, each once in the result."""

    def parse(text: str) -> tuple[T, ...]:
        named = [part.strip() for part in text.split(",")]
        if unknown := [part for part in named if part not in known]:
            came = ", ".join(map(repr, unknown))
            raise ValueError(f"expected a comma list of {', '.join(map(str, known))}; got {came}")
        return tuple(part for part in known if part in named)

    return parse


def parse_sizes(text: str) -> tuple[int, ...]:
    """A comma list of cubes n^3 with n from 4."""
    try:
        sizes = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"expected numbers of particles, such as 216,1331; got {text!r}") from None
    if odd := [size for size in sizes if size < 64 or round(size ** (1 / 3)) ** 3 != size]:
        raise ValueError(f"expected cubes of 4 or more, such as 216 or 1331; got {', '.join(map(str, odd))}")
    return tuple(sorted(set(sizes)))


@dataclass(frozen=True, slots=True)
class PokeText:
    """A poke as typed: at (2,) or (3,) [m]; tip and its size [m], None = the model's; depth [m] or force [N]."""

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
    parts: dict[str, str] = {}
    for part in text.split():
        name, equals, value = part.partition("=")
        if not equals or name not in ("at", "tip", "size", "depth", "force") or name in parts:
            raise ValueError(f"expected a poke such as {POKE_EXAMPLE} (metres, newtons); got {part!r} in {text!r}")
        parts[name] = value
    if "at" not in parts or ("depth" in parts) == ("force" in parts):
        raise ValueError(f"expected at=X,Y and one of depth= and force=, such as {POKE_EXAMPLE}; got {text!r}")
    tip = parts.get("tip")
    if tip not in (None, "flat", "disc", "sphere"):
        raise ValueError(f"expected tip=flat, tip=disc or tip=sphere; got {tip!r} in {text!r}")
    if tip is not None and "size" not in parts:
        raise ValueError(f"expected size= with tip={tip}, its sides or its diameter in metres; got {text!r}")
    try:
        return PokeText(
            at=tuple(finite(value) for value in parts["at"].split(",")),
            tip=cast("TipName | None", tip),
            size=tuple(positive(value) for value in parts["size"].split("x")) if "size" in parts else (),
            depth=positive(parts["depth"]) if "depth" in parts else None,
            force=positive(parts["force"]) if "force" in parts else None,
        )
    except ValueError as error:
        raise ValueError(f"{error} in {text!r}; for example {POKE_EXAMPLE}") from None


def parse_pokes(text: str) -> tuple[PokeText, ...]:
    """Pokes with `;` between them."""
    return tuple(parse_poke(part) for part in text.split(";") if part.strip())


def finite(text: str) -> float:
    value = float(text)
    if value - value != 0.0:  # inf and nan
        raise ValueError(f"expected a finite number; got {text!r}")
    return value


def positive(text: str) -> float:
    try:
        value = finite(text)
    except ValueError:
        value = 0.0
    if not value > 0:
        raise ValueError(f"expected a number above 0; got {text!r}")
    return value


FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "g": 9.80665e-3, "gf": 9.80665e-3, "kg": 9.80665, "kgf": 9.80665}
"""Newtons of units of force; a gram is its weight."""


def force_n(text: str) -> float | None:
    """The force of `3N` or `300g` [N]; None for the name of a log. Raises ValueError for a number without a unit."""
    found = re.fullmatch(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([a-zA-Zµ]*)\s*", text)
    if found is None or found[2] not in {"", *FORCE_UNITS}:
        return None
    if not found[2]:
        raise ValueError(f"expected a force with its unit, such as {found[1]}N or {found[1]}g; got {text!r}")
    if not (value := float(found[1]) * FORCE_UNITS[found[2]]) > 0:
        raise ValueError(f"expected a force above 0, its magnitude; got {text!r}")
    return value


def parse_push_force(text: str) -> str:
    """A force with its unit, or the name of a log."""
    force_n(text)
    return text


def parse_force_sd(text: str) -> str:
    """A force with its unit."""
    if force_n(text) is None:
        raise ValueError(f"expected a force with its unit, such as 2g or 0.05N; got {text!r}")
    return text


def parse_scale(text: str) -> tuple[float, ...]:
    """`X,Y,X,Y=10mm`: two places in the first image [px], and their distance; the last number is in metres."""
    ends, _, length = text.partition("=")
    found = re.fullmatch(r"\s*(.+?)\s*(mm|cm|m)\s*", length)
    try:
        places = numbers("x,y,x,y", "120,40,320,40")(ends)
        metres = positive(found[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[found[2]] if found else 0.0
    except ValueError:
        places, metres = (), 0.0
    if not metres or places[:2] == places[2:]:
        raise ValueError(f"expected X,Y,X,Y=LENGTH of two places in pixels, such as 120,40,320,40=50mm; got {text!r}")
    return (*places, metres)


def one_word(metavar: str, parse: Callable[[str], T], show: Callable[[Any], str] = str) -> PrimitiveConstructorSpec[T]:
    """One word on the command line; None, which cannot be typed, is an omitted flag."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: ["none" if value is None else show(value)],
    )


def joined(separator: str) -> Callable[[Any], str]:
    return lambda parts: separator.join(str(part) for part in parts)


# What a value may be, and what becomes of it --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule that a value must satisfy. says: the rule in words, with {flag} for the flag; hint: what to try, also with
    {flag}"""

    holds: Callable[[Any], bool]
    says: str
    hint: str = ""
    show: Callable[[Any], str] = str

    def check(self, flag: str, value: Any) -> None:
        """Raises InputError where the value breaks the rule."""
        if not self.holds(value):
            raise InputError(self.says.format(flag=flag), self.show(value), self.hint.format(flag=flag))


@dataclass(frozen=True, slots=True)
class Reads:
    """Files that are read and may not be overwritten."""


@dataclass(frozen=True, slots=True)
class Writes:
    """An output file. replace: an existing file is replaced without --overwrite"""

    replace: bool = True


@dataclass(frozen=True, slots=True)
class Makes:
    """An output folder."""


def least(number: int) -> Rule:
    return Rule(lambda value: value >= number, f"a {{flag}} of {number} or more")


def ends(*suffixes: str) -> Rule:
    says = f"a file that ends in {' or '.join(suffixes)} after {{flag}}"
    return Rule(lambda path: path.suffix in suffixes, says, show=lambda path: repr(str(path)))


def within(limit: float) -> Rule:
    """Whether a span lies in a range; neither end is NaN: `finite` checks that."""
    return Rule(lambda span: span[0] >= 0 and span[1] <= limit, f"a {{flag}} within 0,{limit:g}", show=joined_g)


def joined_g(span: Span) -> str:
    return ",".join(f"{value:g}" for value in span)


BETA_LIMIT = 0.9999
"""Highest beta that can be searched (`deformscope.stages.fit.calibrate.BETA_LIMIT`, which would import numpy here)."""

SHARE = Rule(lambda value: 0 <= value <= 1, "a {flag} between 0 and 1")
RISING = Rule(lambda span: span[0] < span[1], "a {flag} that rises", "the other way round", joined_g)

# Flags ---------------------------------------------------------------------------------------------------------------

unset = arg(help_behavior_hint="")
"""No "(default: none)" in the help of a flag that may be left out."""

RectangleFlag = Annotated[Rectangle | None, one_word("X,Y,WIDTH,HEIGHT", parse_rectangle, joined(",")), unset]
OutlineFlag = Annotated[tuple[float, ...] | None, one_word("X,Y,X,Y,X,Y...", parse_outline, joined(",")), unset]
GridFlag = Annotated[GridShape | None, one_word("ROWSxCOLS", parse_grid, joined("x")), unset]
HeldFlag = Annotated[
    tuple[HeldPart, ...] | None, one_word("PART,PART...", some_of(get_args(HeldPart)), joined(",")), unset
]
SelectFlag = Annotated[
    tuple[Selectable, ...] | None, one_word("WHAT,WHAT...", some_of(get_args(Selectable)), joined(",")), unset
]
PlaceFlag = Annotated[tuple[float, float] | None, one_word("X,Y", numbers("X,Y in metres", "0.30,0.20"))]
_span = one_word("LOWEST,HIGHEST", numbers("LOWEST,HIGHEST", "0,0.99"), joined(","))
SpanFlag = Annotated[Span, _span, RISING, within(1.0)]
BetaSpanFlag = Annotated[Span, _span, RISING, within(BETA_LIMIT)]
PositiveFlag = Annotated[float | None, one_word("NUMBER", positive), unset]
LengthFlag = Annotated[
    float | None, one_word("NUMBER", positive), unset, Rule(lambda m: m is None or m < 1.0, "a {flag} below 1 m")
]
SizesFlag = Annotated[tuple[int, ...] | None, one_word("N,N...", parse_sizes, joined(",")), unset]
CasesFlag = Annotated[tuple[Case, ...] | None, one_word("CASE,CASE...", some_of(CASES), joined(",")), unset]
CountFlag = Annotated[int | None, one_word("INT", int), unset]
SomeFlag = Annotated[int | None, one_word("INT", int), unset, least(1)]
ClusterFlag = Annotated[int, least(2)]
ManyFlag = Annotated[int, least(1)]
LevelFlag = Annotated[float, Rule(lambda value: 0 < value < 1, "a {flag} between 0 and 1", "--level 0.9")]
TimeoutFlag = Annotated[
    float, Rule(lambda value: 0.05 <= value <= 60.0, "a {flag} of 0.05 to 60 s", "--page-timeout 0.3")
]
PushForceFlag = Annotated[str | None, one_word("3N|300g|LOG", parse_push_force), unset, Reads()]
ForceSdFlag = Annotated[str | None, one_word("FORCE", parse_force_sd), unset]
ScaleFlag = Annotated[
    tuple[float, ...] | None,
    one_word("X,Y,X,Y=LENGTH", parse_scale, lambda one: f"{joined(',')(one[:4])}={one[4]}m"),
    unset,
]
SeedFlag = Annotated[int, least(0)]
CameraFlag = Annotated[str | None, one_word("NAME", str), unset]
FileFlag = Annotated[Path | None, one_word("FILE", Path), unset, Reads()]
ModelFlag = Annotated[Path | None, one_word("MODEL.npz", Path), unset, ends(".npz"), Writes(replace=False)]
ArraysFlag = Annotated[Path | None, one_word("FILE.npz", Path), unset, ends(".npz"), Writes()]
NewRecordingFlag = Annotated[Path | None, one_word("FILE.rrd", Path), unset, ends(".rrd"), Writes(replace=False)]
ShareFlag = Annotated[float | None, one_word("NUMBER", float), unset, SHARE]
PokesFlag = Annotated[tuple[PokeText, ...], one_word("POKE", lambda text: parse_pokes(text), joined("; "))]
PictureFlag = Annotated[Path | None, one_word("FILE.png", Path), unset, ends(".png"), Writes()]
ReportFlag = Annotated[Path | None, one_word("FILE.html", Path), unset, ends(".html"), Writes()]
_FORCE = Rule(lambda force: force <= 5.0, "{flag} up to 5 N", show="{:g}".format)
ForceFlag = Annotated[float | None, one_word("NUMBER", positive), unset, _FORCE]
TrustFlag = Annotated[
    bool,
    arg(
        help=(
            "Load the vendors' libraries that RIG names from any folder; without it, from the system's folders "
            "alone. These libraries run with your rights."
        )
    ),
]
JsonFlag = Annotated[str | None, one_word("FILE|-", str), unset, Writes()]
RigFlag = Annotated[str, Positional, arg(metavar="RIG"), Reads()]
SceneFlag = Annotated[str, Positional, arg(metavar="RIG|lab:NAME"), Reads()]
WrenchFlag = Annotated[Path | None, one_word("FILE.toml", Path), unset, ends(".toml"), Reads()]
RecordFlag = Annotated[Path | None, one_word("FILE", Path), unset, ends(".rrd"), Writes(replace=False)]
RecordingFlag = Annotated[Path, Positional, arg(metavar="FILE.rrd"), Reads()]
Folder = Annotated[Path, arg(metavar="DIR"), Makes()]
NewFolder = Annotated[Path | None, one_word("FOLDER", Path), unset, Makes()]


_MIXED = Rule(
    bool, "at least one SOURCE", "a video, a folder of frames, images, or pair files (.npz)", lambda _: "none"
)
Sources = Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE...", help_behavior_hint=""), Reads(), _MIXED]
