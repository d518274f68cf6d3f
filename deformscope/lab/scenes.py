"""The laboratory's scenes: slabs of foam on a table, glued together from pieces whose places a seed draws.

    scene = built_in("two-60-150", seed=3)
    scene.modulus_pa(xy_m), scene.label(xy_m), scene.height_m(xy_m)      # anywhere on the slab
    scene.truth()                                                        # the labels of the map's cells

Everything is in the *surface frame*: x and y along the table's edges, z up, the table's top at z = 0, the slab's corner
at the origin. `robot.setup.T_BASE_SURFACE` is the arm's pose. Pieces reach from top to bottom, with sharp borders.

**Hardness** is the force that presses a plate of 324 cm2 into the foam by 40 % (ISO 2439). A fingertip at 3 N strains
foam less, below its plateau, so that it measures the *initial* modulus. The plate's stress at 40 % is assumed to be the
plateau's, and the plateau 5 % of the initial modulus (Gibson and Ashby 1997, chapter 5). 60, 110 and 150 N are then 37,
68 and 93 kPa. (The secant modulus, 4.6, 8.5 and 11.6 kPa, would let 3 N sink by more than 17 mm.)
**Rigid** pieces have RIGID_PA, 1000 times the foam of 60 N. **Poisson's ratio** is 0.2 everywhere.

`DRAWN` has the random quantities of each scene, each uniform between two values. Other hardnesses come by name:
`homogeneous-A`, `two-A-B`, `three-A-B-C`, `disc-A-B` (A around, B the disc), and so on. So do `soft-spot`, `corner`,
`strip`, `patches`, `wavy`, `zigzag`, `ring`, `bumpy`, `thin-thick`, with one `wedge`, `step`, `egg-crate`, and with a
third for the lump `lump`. A letter is a number of newtons or `rigid`. `60c30` is foam of 60 N that creeps: 30 % of its
modulus relaxes, with a time constant of 1 s; in `60p20` and `60c30p20` 20 % of each dent is permanent. `60y20`
yields: its stress tends to a plateau near a twentieth of its modulus (Ogden's law, `deformscope.lab.plateau_world`).

`buried-A-B` is a foam of A with a ball of B glued into it, which does not reach the surface, and `empty-A` the same
foam without it: smaller and thicker slabs (`BURIED`). `block-162` is a block of 100 kPa, known within 2 %, to certify
rigs on (`deformscope certify`).
"""

import difflib
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError

PLATE_M2 = 0.0324
"""Area of the hardness test's plate (ISO 2439: 203 mm across)."""

PLATEAU_SHARE = 0.05
"""Plateau stress over initial modulus of conventional foam (Gibson and Ashby)."""

POISSON = 0.2
CELL_M = 0.005
"""Side of the map's cells."""

SIZE_M = (0.6, 0.4)
THICKNESS_M = 0.05
BURIED_SIZE_M, BURIED_THICKNESS_M = (0.2, 0.2), 0.07
UNEVEN_M, RISE_M, RAMP_M = 0.035, 0.015, 0.06
"""Mean thickness of wedges and steps, how much thinner and thicker they are, and how wide a step is."""
CRATE_M, CRATE_WAVE_M = 0.005, 0.06
"""Height of an egg-crate's waves over their mean, and their length."""


def initial_modulus_pa(hardness_n: float) -> float:
    """The modulus in a light touch of foam of an ISO 2439 hardness [N]."""
    return hardness_n / PLATE_M2 / PLATEAU_SHARE


RIGID_PA = 1000.0 * initial_modulus_pa(60.0)


@dataclass(frozen=True, slots=True)
class Range:
    """Random quantity of a scene, uniform from `low` to `high`."""

    what: str
    low: float
    high: float
    unit: str


_BORDER = (Range("border x", 0.22, 0.38, "m"), Range("border tilt", -15.0, 15.0, "deg"), Range("turned", 0, 2, "half"))
_STRIPES_OR_T = (
    Range("pattern", 0, 2, "stripes below 1, else T"),
    Range("first border x", 0.17, 0.23, "m"),
    Range("second border x", 0.37, 0.43, "m"),
    Range("first border tilt", -12.0, 12.0, "deg"),
    Range("second border tilt", -12.0, 12.0, "deg"),
    Range("stem x", 0.22, 0.38, "m"),
    Range("stem tilt", -15.0, 15.0, "deg"),
    Range("bar y", 0.16, 0.24, "m"),
    Range("bar tilt", -15.0, 15.0, "deg"),
    Range("turned", 0, 2, "half"),
    Range("order", 0, 6, "permutation of the pieces"),
)
_INSIDE_OUT = Range("inside out", 0, 2, "half")
_HARDNESS = Range("hardness", 0.9, 1.1, "of the nominal one")
_KNOWN = Range("hardness", 0.98, 1.02, "of the nominal one")


def _metres(**drawn: tuple[float, float]) -> tuple[Range, ...]:
    """From and to [m], of a random quantity."""
    return tuple(Range(what.replace("_", " "), *ends, "m") for what, ends in drawn.items())


def _degrees(what: str, most: float) -> Range:
    return Range(what, 0.0, most, "deg")


_SPOT = _metres(centre_x=(0.08, 0.52), centre_y=(0.08, 0.32))
DRAWN: dict[str, tuple[Range, ...]] = {
    "homogeneous": (_HARDNESS,),
    "block": (_KNOWN,),
    "two": _BORDER,
    "three": _STRIPES_OR_T,
    "disc": (*_metres(centre_x=(0.17, 0.43), centre_y=(0.14, 0.26), radius=(0.08, 0.10)), _INSIDE_OUT),
    "gradient": (_degrees("direction", 360.0), Range("softest", 45.0, 65.0, "N"), Range("firmest", 140.0, 180.0, "N")),
    "bumpy": (
        *_BORDER,
        *(Range(f"wave {i} height", 0.002, 0.004, "m") for i in (1, 2, 3)),
        *(Range(f"wave {i} length", 0.16, 0.30, "m") for i in (1, 2, 3)),
        *(_degrees(f"wave {i} direction", 180.0) for i in (1, 2, 3)),
        *(_degrees(f"wave {i} phase", 360.0) for i in (1, 2, 3)),
    ),
    "soft-spot": (*_SPOT, *_metres(radius=(0.05, 0.06))),
    "wavy": (*_BORDER, *_metres(wave_height=(0.02, 0.04), wave_length=(0.18, 0.30)), _degrees("wave phase", 360.0)),
    "corner": (
        *_metres(reach_x=(0.24, 0.39), reach_y=(0.20, 0.28)),
        Range("which corner", 0, 4, "from the origin, along x first"),
        _INSIDE_OUT,
    ),
    "strip": (*_BORDER[:2], *_metres(width=(0.12, 0.18)), _INSIDE_OUT),
    "patches": (
        *(Range(f"centre x {i}", low, low + 0.06, "m") for i, low in ((1, 0.12), (2, 0.42))),
        *(Range(f"centre y {i}", 0.14, 0.26, "m") for i in (1, 2)),
        *(Range(f"radius {i}", 0.07, 0.09, "m") for i in (1, 2)),
        _INSIDE_OUT,
    ),
    "ring": (
        *_metres(centre_x=(0.20, 0.40), centre_y=(0.17, 0.23), radius=(0.13, 0.16), width=(0.06, 0.08)),
        _INSIDE_OUT,
    ),
    "zigzag": (*_BORDER, *_metres(wave_height=(0.03, 0.05), wave_length=(0.16, 0.26)), _degrees("wave phase", 360.0)),
    "wedge": (_HARDNESS, _degrees("direction", 360.0)),
    "step": (_HARDNESS, *_BORDER),
    "egg-crate": (_HARDNESS, _degrees("direction", 90.0), _degrees("phase", 360.0)),
    "thin-thick": _BORDER,
    "lump": (*_BORDER, *_SPOT, *_metres(radius=(0.06, 0.06))),
    "buried": (
        _HARDNESS,
        *_metres(centre_x=(0.02, 0.18), centre_y=(0.02, 0.18), radius=(0.02, 0.02)),
        Range("depth", 0.01, 0.02, "m from the surface to the ball"),
    ),
    "empty": (_HARDNESS,),
}
"""Random quantities of each kind of scene. "turned" below 1 leaves the pieces' order as named from the left, else
reverses it."""

Places = Callable[[FloatArray], FloatArray]
Labels = Callable[[FloatArray], IntArray]


@dataclass(frozen=True, slots=True)
class Piece:
    """One material. name: hardness in N, or "rigid"; modulus_pa: its Young's modulus [Pa] before it relaxes; relaxes:
    share of the modulus that relaxes; keeps: share of each dent that stays; plateau_exponent: Ogden's exponent, about
    modulus over plateau, 0 = it stays linear"""

    name: str
    modulus_pa: float
    rigid: bool = False
    relaxes: float = 0.0
    keeps: float = 0.0
    plateau_exponent: int = 0

    @classmethod
    def named(cls, name: str, times: float = 1.0) -> "Piece":
        """The piece of a hardness in N ("110", "110c30p20" where 30 % relaxes and 20 % of each dent stays, or "110y20"
        that yields), times a factor, or "rigid"."""
        if name == "rigid":
            return cls(name, RIGID_PA, rigid=True)
        linear, _, plateau_exponent = name.partition("y")
        creeping, _, keeps = linear.partition("p")
        hardness, _, relaxes = creeping.partition("c")
        modulus_pa = times * initial_modulus_pa(float(hardness))
        return cls(
            name, modulus_pa, False, 0.01 * float(relaxes or 0), 0.01 * float(keeps or 0), int(plateau_exponent or 0)
        )


@dataclass(frozen=True, slots=True)
class BuriedBall:
    """A ball of another material, glued into a slab. centre_m: (x, y) [m]; depth_m: depth of its uppermost point below
    the surface; modulus_pa: Young's modulus [Pa]"""

    centre_m: tuple[float, float]
    radius_m: float
    depth_m: float
    modulus_pa: float


@dataclass(frozen=True, slots=True)
class Scene:
    """A slab on the table.

    pieces: the materials, by label; empty where the modulus varies everywhere (`gradient`)
    size_m: (x, y) [m]; thickness_m: before any bumps [m]; poisson: Poisson's ratio; drawn: the seed's values, by name;
    buried: the ball inside the foam. The places above it have its label; the modulus of a place is without it"""

    name: str
    seed: int
    pieces: tuple[Piece, ...]
    drawn: dict[str, float]
    size_m: tuple[float, float] = SIZE_M
    thickness_m: float = THICKNESS_M
    poisson: float = POISSON
    buried: BuriedBall | None = None
    _label: Labels | None = None
    _modulus: Places | None = None
    _bumps: Places | None = None

    @property
    def region_count(self) -> int:
        """How many regions there are; 0 where there are none, because the modulus varies everywhere."""
        return len(self.pieces)

    @property
    def rigid(self) -> tuple[int, ...]:
        """Labels of the rigid regions."""
        return tuple(label for label, piece in enumerate(self.pieces) if piece.rigid)

    def label(self, xy_m: FloatArray) -> IntArray:
        """Region (...,) of each place (..., 2); -1 outside the slab, and everywhere without regions."""
        xy_m = np.asarray(xy_m, dtype=np.float64)
        outside = ((xy_m < 0.0) | (xy_m > self.size_m)).any(axis=-1)
        if not self.pieces:
            return np.full(outside.shape, -1)
        found = np.zeros(outside.shape, dtype=np.int64) if self._label is None else self._label(xy_m)
        return np.where(outside, -1, found)

    def modulus_pa(self, xy_m: FloatArray) -> FloatArray:
        """(...,) Young's modulus at places (..., 2) [Pa]; outside the slab, that of its nearest edge."""
        xy_m = np.clip(np.asarray(xy_m, dtype=np.float64), 0.0, self.size_m)
        if self._modulus is not None:
            return self._modulus(xy_m)
        return np.array([piece.modulus_pa for piece in self.pieces])[self.label(xy_m)]

    def height_m(self, xy_m: FloatArray) -> FloatArray:
        """(...,) height of the rest surface over the table [m]; 0 outside the slab."""
        xy_m = np.asarray(xy_m, dtype=np.float64)
        outside = ((xy_m < 0.0) | (xy_m > self.size_m)).any(axis=-1)
        return np.where(outside, 0.0, self.foam_height_m(xy_m))

    def foam_height_m(self, xy_m: FloatArray) -> FloatArray:
        """Height (...,) at places (..., 2) [m] as `height_m`, with the slab continued beyond its edges."""
        xy_m = np.asarray(xy_m, dtype=np.float64)
        bumps = 0.0 if self._bumps is None else self._bumps(xy_m)
        return np.broadcast_to(self.thickness_m + bumps, xy_m.shape[:-1])

    def normal(self, xy_m: FloatArray) -> FloatArray:
        """(..., 3) unit normal of the rest surface, upwards."""
        xy_m = np.asarray(xy_m, dtype=np.float64)
        if self._bumps is None:
            return np.broadcast_to([0.0, 0.0, 1.0], (*xy_m.shape[:-1], 3))
        around = self.foam_height_m(xy_m[..., None, None, :] + 1e-4 * np.array([1.0, -1.0])[:, None, None] * np.eye(2))
        slope = (around[..., 0, :] - around[..., 1, :]) / 2e-4
        upward = np.concatenate([-slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
        return np.asarray(upward / np.linalg.norm(upward, axis=-1, keepdims=True))

    def cells_m(self) -> FloatArray:
        """(rows, columns, 2) centres of the map's cells [m]; rows along y, columns along x."""
        x, y = (CELL_M * (np.arange(round(side / CELL_M)) + 0.5) for side in self.size_m)
        return np.stack(np.meshgrid(x, y), axis=-1)

    @property
    def inclusions_m(self) -> FloatArray:
        """(n, 4) buried balls: x and y of each one's middle, its radius, and the depth of its uppermost point [m]."""
        ball = self.buried
        return np.zeros((0, 4)) if ball is None else np.array([[*ball.centre_m, ball.radius_m, ball.depth_m]])

    @property
    def regions(self) -> IntArray | None:
        """Labels (rows, columns) as `truth`; None if the modulus changes smoothly."""
        return self.truth() if self.pieces else None

    def truth(self) -> IntArray:
        """(rows, columns) the label of each cell's centre."""
        return self.label(self.cells_m())


class OwnScene(Protocol):
    """A simulated table that a script defines, for `deformscope.explore(scene)`: foams of `THICKNESS_M` next to each
    other.

    name: its name in recordings; hardnesses: hardnesses of each foam in N, as in the names of scenes: "60",
    "110c30p20", "rigid"
    """

    name: str
    hardnesses: Sequence[str]

    def label(self, xy_m: FloatArray) -> IntArray:
        """(n,) index of the foam at places (n, 2) [m], from 0 to `SIZE_M`."""


def scene_of(own: OwnScene, seed: int = 0) -> Scene:
    """The scene for explorations. Raises InputError for labels without a foam."""
    scene = Scene(own.name, seed, tuple(map(Piece.named, own.hardnesses)), {}, _label=partial(_own_label, own))
    found, last = np.unique(scene.truth()), len(own.hardnesses) - 1
    if found.min() < 0 or found.max() > last:
        raise InputError(f"labels from 0 to {last}", str(found.tolist()), "a hardness for each label")
    return scene


def _own_label(own: OwnScene, xy_m: FloatArray) -> IntArray:
    return np.asarray(own.label(xy_m.reshape(-1, 2)), np.int64).reshape(xy_m.shape[:-1])


BUILT_IN = {
    "homogeneous-60": "one foam of 60 N",
    "homogeneous-110": "one foam of 110 N",
    "two-60-150": "two foams, 60 and 150 N, with a border along a tilted line",
    "two-110-150": "two foams, 110 and 150 N, with a border along a tilted line",
    "two-150-rigid": "a foam of 150 N next to a rigid part",
    "three-60-110-rigid": "foams of 60 and 110 N and something rigid, as stripes or as a T",
    "disc": "a disc of 16 to 20 cm in another foam, 30 and 200 N, either being the softer",
    "gradient": "foam whose modulus rises evenly from corner to corner, without regions",
    "bumpy": "two foams, 60 and 150 N, under a surface that is not flat",
    "soft-spot": "a spot of 10 to 12 cm and 60 N in a foam of 150 N",
    "wavy": "two foams, 60 and 150 N, with a border along a wave",
    "corner": "a rectangle in a corner of another foam, 60 and 150 N, either being the softer",
    "strip": "a strip of 12 to 18 cm across another foam, 60 and 150 N, either being the softer",
    "patches": "two discs of 14 to 18 cm in another foam, 60 and 150 N, either being the softer",
    "ring": "a ring 6 to 8 cm wide, 26 to 32 cm across, in another foam, 60 and 150 N, either being the softer",
    "zigzag": "two foams, 60 and 150 N, with a border along a zigzag",
    "wedge": "one foam of 110 N, 5 cm thick at one corner and 2 at the other",
    "step": "one foam of 110 N, 2 cm thick on one side of a tilted line and 5 on the other, a ramp of 6 cm between",
    "egg-crate": "one foam of 110 N, 5 cm thick, with crests and hollows 1 cm apart in height and 6 cm in waves",
    "thin-thick": "a foam of 60 N, 2 cm thick, next to one of 75 N, 5 cm thick, with the same apparent stiffness",
    "lump": (
        "two foams, 60 and 150 N, with a border along a tilted line, and a rigid part 12 cm wide somewhere in them"
    ),
}
"""Scenes by name, with their descriptions: thesis table 4.1's six, and others."""

BURIED = {
    "buried": "a foam of 60 N, 20 by 20 cm and 7 cm thick, with a ball of 600 N in it, 4 cm across, 1 to 2 cm deep",
    "empty": "the same foam with nothing in it",
    "block-162": "a block of 100 kPa, known within 2 %, for `deformscope certify`",
}
"""Scenes that no table explores: with inclusions that the surface does not show, and to certify rigs on."""

PIECES = {
    "disc": ("30", "200"),
    "thin-thick": ("60", "75"),
    "soft-spot": ("150", "60"),
    "lump": ("60", "150", "rigid"),
    "buried": ("60", "600"),
    "empty": ("60",),
}
PIECES |= dict.fromkeys(("bumpy", "wavy", "corner", "strip", "patches", "ring", "zigzag"), ("60", "150"))
PIECES |= dict.fromkeys(("wedge", "step", "egg-crate"), ("110",))
"""Hardness [N] of the pieces where the name does not say; 30 and 200 N are 19 and 123 kPa."""

COUNT = {"homogeneous": 1, "block": 1, "two": 2, "three": 3} | {kind: len(pieces) for kind, pieces in PIECES.items()}


def built_in(name: str, seed: int = 0) -> Scene:
    """The scene of a name (`BUILT_IN`, or one with other hardnesses), laid out by a seed."""
    # kind of scene, and the names of its pieces
    kind, piece = "|".join(sorted(DRAWN)), r"(?:rigid|[1-9]\d{0,3}(?:y[1-9]\d?|(?:c[1-9]\d?)?(?:p[1-9]\d?)?))"
    found = re.fullmatch(rf"({kind})((?:-{piece})*)", name)
    expected = f"a scene: {', '.join(BUILT_IN | BURIED)}, or one with other hardnesses"
    if found is None:
        near = difflib.get_close_matches(name, BUILT_IN | BURIED, n=1)
        raise InputError(expected, repr(name), near[0] if near else "two-80-200, three-60-110-rigid")
    pieces = tuple(found[2].split("-")[1:]) or PIECES.get(found[1], ())
    if len(pieces) != COUNT.get(found[1], 0):
        raise InputError(f"{COUNT.get(found[1], 0)} hardnesses in {found[1]}", repr(name), "two-80-200")
    kind, pieces = found[1], pieces
    # each name has its own stream, so that equal seeds of two scenes are not the same layout
    random = np.random.default_rng([seed, zlib.crc32(name.encode())])
    drawn = {one.what: float(random.uniform(one.low, one.high)) for one in DRAWN[kind]}
    if kind in BURIED:
        return _buried(name, seed, pieces, drawn)
    if kind == "gradient":
        # The logarithm of the modulus rises evenly along a direction, from corner to corner.
        share = _along(drawn["direction"])
        low, high = np.log(initial_modulus_pa(drawn["softest"])), np.log(initial_modulus_pa(drawn["firmest"]))
        return Scene(name, seed, (), drawn, _modulus=lambda xy: np.exp(low + (high - low) * 0.5 * (1.0 + share(xy))))
    times = drawn.get("hardness", 1.0)
    materials = tuple(Piece.named(piece, times) for piece in pieces)
    thickness_m = UNEVEN_M if kind in ("wedge", "step", "thin-thick") else THICKNESS_M
    label, bumps = _layout(kind, drawn), _relief(kind, drawn)
    return Scene(name, seed, materials, drawn, thickness_m=thickness_m, _label=label, _bumps=bumps)


def _buried(name: str, seed: int, pieces: tuple[str, ...], drawn: dict[str, float]) -> Scene:
    """A foam whose surface shows nothing, with a ball in it or not."""
    foam, *balls = (Piece.named(piece, drawn["hardness"]) for piece in pieces)
    if foam.plateau_exponent or any(ball.plateau_exponent for ball in balls):
        raise InputError("foam with a ball in it that does not yield", repr(name), "homogeneous-60y20, buried-60-600")
    even: Places = lambda xy: np.full(np.shape(xy)[:-1], foam.modulus_pa)  # noqa: E731
    level = Scene(name, seed, (foam,), drawn, BURIED_SIZE_M, BURIED_THICKNESS_M, _modulus=even)
    if not balls:
        return level
    centre = drawn["centre x"], drawn["centre y"]
    ball = BuriedBall(centre, drawn["radius"], drawn["depth"], balls[0].modulus_pa)
    return replace(level, pieces=(foam, *balls), buried=ball, _label=_layout("disc", drawn))


def _layout(kind: str, drawn: dict[str, float]) -> Labels:
    """Which piece is where: the first named is left of a border, or around a disc, unless turned."""
    if COUNT[kind] == 1:
        return lambda xy: np.zeros(np.shape(xy)[:-1], dtype=np.int64)
    if kind == "three":
        return _three(drawn)
    swapped = drawn.get("turned", drawn.get("inside out", 0.0)) >= 1.0
    if kind in ("disc", "soft-spot"):
        centre, radius = np.array([drawn["centre x"], drawn["centre y"]]), drawn["radius"]
        return lambda xy: ((np.linalg.norm(xy - centre, axis=-1) < radius) ^ swapped).astype(np.int64)
    if kind == "ring":
        middle, outer = np.array([drawn["centre x"], drawn["centre y"]]), drawn["radius"]
        half = drawn["width"] / 2
        return lambda xy: ((np.abs(np.linalg.norm(xy - middle, axis=-1) - outer + half) < half) ^ swapped).astype(
            np.int64
        )
    if kind == "corner":
        corner = min(int(drawn["which corner"]), 3)
        far, reach = np.array([corner in (1, 2), corner in (2, 3)]), np.array([drawn["reach x"], drawn["reach y"]])
        size = np.array(SIZE_M)
        return lambda xy: np.asarray((np.where(far, size - xy, xy) < reach).all(axis=-1) ^ swapped).astype(np.int64)
    if kind == "strip":
        across, half = _border(drawn["border x"], SIZE_M[1] / 2, drawn["border tilt"]), drawn["width"] / 2
        return lambda xy: ((np.abs(across(xy)) < half) ^ swapped).astype(np.int64)
    if kind == "patches":
        middle = np.array([[drawn[f"centre x {i}"], drawn[f"centre y {i}"]] for i in (1, 2)])
        radii = np.array([drawn[f"radius {i}"] for i in (1, 2)])

        def patched(xy: FloatArray) -> IntArray:
            away = np.linalg.norm(np.asarray(xy)[..., None, :] - middle, axis=-1)
            return np.where((away < radii).any(axis=-1), not swapped, swapped).astype(np.int64)

        return patched
    wave = (drawn.get("wave height", 0.0), drawn.get("wave length", 1.0), drawn.get("wave phase", 0.0))
    beyond = _border(drawn["border x"], SIZE_M[1] / 2, drawn["border tilt"], wave, pointed=kind == "zigzag")
    if kind == "lump":
        inside = _layout("disc", {name: drawn[name] for name in ("centre x", "centre y", "radius")})
        return lambda xy: np.where(inside(xy), 2, (beyond(xy) > 0.0) ^ swapped).astype(np.int64)
    return lambda xy: ((beyond(xy) > 0.0) ^ swapped).astype(np.int64)


def _three(drawn: dict[str, float]) -> Labels:
    """Three stripes, or one piece next to two that share the rest."""
    order = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)][min(int(drawn["order"]), 5)]
    turned, middle = drawn["turned"] >= 1.0, SIZE_M[1] / 2
    if drawn["pattern"] < 1.0:
        first = _border(drawn["first border x"], middle, drawn["first border tilt"])
        second = _border(drawn["second border x"], middle, drawn["second border tilt"])
        return lambda xy: np.array(order)[(first(xy) > 0.0).astype(np.int64) + (second(xy) > 0.0)]
    stem = _border(drawn["stem x"], middle, drawn["stem tilt"])
    bar = _border(SIZE_M[0] / 2, drawn["bar y"], 90.0 + drawn["bar tilt"])

    def label(xy: FloatArray) -> IntArray:
        whole = (stem(xy) > 0.0) == turned
        return np.array(order)[np.where(whole, 0, np.where(bar(xy) > 0.0, 1, 2))]

    return label


def _border(
    x_m: float, y_m: float, tilt_deg: float, wave: tuple[float, float, float] = (0.0, 1.0, 0.0), pointed: bool = False
) -> Places:
    """Distance of places to the right of a line through (x, y), tilted from the y axis; or of a wave along it, which
    may be pointed."""
    tilt = np.deg2rad(tilt_deg)
    along, across = np.array([-np.sin(tilt), np.cos(tilt)]), np.array([np.cos(tilt), np.sin(tilt)])
    height, length, phase = wave[0], wave[1], np.deg2rad(wave[2])

    def beyond(xy: FloatArray) -> FloatArray:
        aside = np.asarray(xy) - (x_m, y_m)
        sine = np.sin(2.0 * np.pi * (aside @ along) / length + phase)
        return np.asarray(aside @ across - height * (2.0 / np.pi * np.arcsin(sine) if pointed else sine))

    return beyond


def _relief(kind: str, drawn: dict[str, float]) -> Places | None:
    """How much higher than its thickness the slab is [m]; None where it is level."""
    if kind == "bumpy":
        return _bumps(drawn)
    if kind == "wedge":
        share = _along(drawn["direction"])
        return lambda xy: RISE_M * share(xy)
    if kind in ("step", "thin-thick"):
        beyond = _border(drawn["border x"], SIZE_M[1] / 2, drawn["border tilt"])
        sign = -1.0 if drawn["turned"] >= 1.0 else 1.0

        def rise(xy: FloatArray) -> FloatArray:
            share = np.clip(2.0 * beyond(xy) / RAMP_M, -1.0, 1.0)
            return np.asarray(sign * RISE_M * np.sin(0.5 * np.pi * share))

        return rise
    if kind != "egg-crate":
        return None
    turn, phase = np.deg2rad(drawn["direction"]), np.deg2rad(drawn["phase"])
    axes = 2.0 * np.pi / CRATE_WAVE_M * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return lambda xy: CRATE_M * np.cos(xy @ axes[0] + phase) * np.cos(xy @ axes[1])


def _along(direction_deg: float) -> Places:
    """How far places are along a direction: -1 and 1 at the corners, 0 in the middle."""
    turn = np.deg2rad(direction_deg)
    direction, middle = np.array([np.cos(turn), np.sin(turn)]), np.array(SIZE_M) / 2
    reach = float(np.abs(direction) @ middle)
    return lambda xy: (xy - middle) @ direction / reach


def _bumps(drawn: dict[str, float]) -> Places:
    """Three waves added up [m]."""

    def rise(xy: FloatArray) -> FloatArray:
        total = np.zeros(np.shape(xy)[:-1])
        for i in (1, 2, 3):
            height, length, direction, phase = (
                drawn[f"wave {i} {what}"] for what in ("height", "length", "direction", "phase")
            )
            turn = np.deg2rad(direction)
            along = xy @ np.array([np.cos(turn), np.sin(turn)])
            total += height * np.sin(2.0 * np.pi * along / length + np.deg2rad(phase))
        return total

    return rise
