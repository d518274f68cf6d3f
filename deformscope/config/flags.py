"""What one value looks like on the command line, and what a flag with such a value is declared as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast

from tyro.conf import Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from deformscope.bench.timing import CASES, Case

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


def parse_rectangle(text: str) -> Rectangle:
    """`x,y,width,height` [px] with a width and a height above 0."""
    try:
        x, y, width, height = (finite(part) for part in text.split(","))
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
        lowest, highest = (finite(part) for part in text.split(","))
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


def one_word(metavar: str, parse: Callable[[str], T], show: Callable[[Any], str] = str) -> PrimitiveConstructorSpec[T]:
    """One word on the command line; None, which cannot be typed there, stands for a flag that was left out."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: True,
        str_from_instance=lambda value: ["none" if value is None else show(value)],
    )


def joined(separator: str) -> Callable[[Any], str]:
    return lambda parts: separator.join(str(part) for part in parts)


unset = arg(help_behavior_hint="")
"""No "(default: none)" in the help of a flag that may be left out."""

RectangleFlag = Annotated[Rectangle | None, one_word("X,Y,WIDTH,HEIGHT", parse_rectangle, joined(",")), unset]
GridFlag = Annotated[GridShape | None, one_word("ROWSxCOLS", parse_grid, joined("x")), unset]
HeldFlag = Annotated[tuple[HeldPart, ...] | None, one_word("PART,PART...", parse_held, joined(",")), unset]
SelectFlag = Annotated[tuple[Selectable, ...] | None, one_word("WHAT,WHAT...", parse_selectable, joined(",")), unset]
SpanFlag = Annotated[Span, one_word("LOWEST,HIGHEST", parse_span, joined(","))]
PositiveFlag = Annotated[float | None, one_word("NUMBER", positive), unset]
SizesFlag = Annotated[tuple[int, ...] | None, one_word("N,N...", parse_sizes, joined(",")), unset]
CasesFlag = Annotated[tuple[Case, ...] | None, one_word("CASE,CASE...", parse_cases, joined(",")), unset]
CountFlag = Annotated[int | None, one_word("INT", int), unset]
CameraFlag = Annotated[str | None, one_word("NAME", str), unset]
FileFlag = Annotated[Path | None, one_word("FILE", Path), unset]
ModelFlag = Annotated[Path | None, one_word("MODEL.npz", Path), unset]
ShareFlag = Annotated[float | None, one_word("NUMBER", float), unset]
PokesFlag = Annotated[tuple[PokeText, ...], one_word("POKE", lambda text: parse_pokes(text), joined("; "))]
PictureFlag = Annotated[Path | None, one_word("FILE.png", Path), unset]
ReportFlag = Annotated[Path | None, one_word("FILE.html", Path), unset]
TrustFlag = Annotated[
    bool,
    arg(
        help="Load the vendors' libraries that RIG names from wherever they are; without it, from the system's folders "
        "alone. They run as you do."
    ),
]
JsonFlag = Annotated[str | None, one_word("FILE|-", str), unset]
Sources = Annotated[tuple[str, ...], Positional, arg(metavar="SOURCE...", help_behavior_hint="")]
