"""Messages between a page and its server for the settings of a fit; part of `deformscope.page.server.messages`."""

from typing import Annotated, Literal

import msgspec

MOST_CORNERS = 200
"""Most corners of an outline."""

Pixels = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Box = tuple[Pixels, Pixels, Pixels, Pixels]
HeldName = Literal["top", "bottom", "left", "right", "border", "contact"]
Points = tuple[tuple[float, float], ...]


class FitSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings on the page.

    roi, contact: x, y, width, height [px]; grid: rows, columns of particles; spacing_px: distance between particles,
    instead of their number; outline: corners of a polygon around the thing [px]; held: parts whose motion is prescribed
    cluster_size: particles along a side, None = one cluster; beta, theta: shares"""

    roi: Box | None = None
    grid: tuple[Annotated[int, msgspec.Meta(ge=2, le=1000)], Annotated[int, msgspec.Meta(ge=2, le=1000)]] | None = None
    spacing_px: Annotated[float, msgspec.Meta(gt=0.0, le=1e5)] | None = None
    outline: Annotated[tuple[tuple[Pixels, Pixels], ...], msgspec.Meta(max_length=MOST_CORNERS)] = ()
    held: tuple[HeldName, ...] = ()
    contact: Box | None = None
    cluster_size: Annotated[int, msgspec.Meta(ge=2, le=1000)] | None = 3
    beta: Share = 0.5
    theta: Share = 0.0


class FitResult(msgspec.Struct, frozen=True):
    """A whole fit. command: the command line of the result; value, low, high: value, lower end and upper end of the
    parameter, at this level; aee_free: average error of the free particles at the result; verdict, force: the verdict
    and what the force gives, in words"""

    command: str
    value: float
    low: float
    high: float
    level: float
    aee_free: float
    verdict: str
    force: str = ""


class FitState(msgspec.Struct, frozen=True):
    """A fit that is set on the page.

    kind: kind of its subject; parameter: name of the fitted parameter; size_px: size of the picture [px]; pictures:
    file names, rest and deformed; settings: the shown settings; number: number of their `SetFit`, 0 = none yet;
    command: command that gives the same numbers
    problem: why the settings cannot be simulated, as text; the other fields then belong to the earlier settings
    grid: rows, columns; spacing_px: distance between neighbours [px]
    rest, observed, simulated: where particles are in the picture [px]; seen: whether `observed` was measured; held:
    which particles are held; aee_free: average error of the free particles [unit]; the average of all that were seen is
    `aee`; values, errors: simulated values of the parameter, and the average error of all seen particles at each [unit]
    busy: the present computation, as text; found: the last whole fit; picture: file that shows the fit, empty = none
    scale: x, y of two places [px], and their distance [m]"""

    kind: Literal["images", "pair"]
    parameter: Literal["beta", "theta"]
    settings: FitSettings
    bounds: tuple[float, float] = (0.0, 1.0)
    size_px: tuple[float, float] = (1.0, 1.0)
    pictures: tuple[str, ...] = ()
    number: int = 0
    command: str = ""
    problem: str = ""
    grid: tuple[int, int] | None = None
    spacing_px: float | None = None
    rest: Points = ()
    observed: Points = ()
    simulated: Points = ()
    seen: tuple[bool, ...] = ()
    held: tuple[int, ...] = ()
    unit: str = ""
    aee: float | None = None
    aee_free: float | None = None
    values: tuple[float, ...] = ()
    errors: tuple[float | None, ...] = ()
    busy: str = ""
    found: FitResult | None = None
    picture: str = ""
    scale: tuple[float, ...] | None = None
