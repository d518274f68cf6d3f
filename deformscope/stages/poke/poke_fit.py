"""Fit a volume lattice to pokes of a surface: cluster size, beta, theta, and where force was measured the stiffness.

The static state under each poke is compared with the surface around it, between the lattice's columns. Beta and theta
are those of the least squared error (`scipy.optimize.least_squares`); the cluster size is the one with the smallest
error; its error on pokes left out is reported.

A lattice of clusters has systematic errors: with any law, the surface around a tip moves inwards too far and rounds off
too little. It is similar at all pokes of a surface, so that it improves predictions of unseen ones: the model's
discrepancy, estimated together with its parameters (Kennedy and O'Hagan 2001)."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError

from deformscope.arrays import FloatArray, IntArray
from deformscope.errors import InputError
from deformscope.stages.fit.model import Observation
from deformscope.stages.fit.search import Progress
from deformscope.stages.msm import clusters
from deformscope.stages.msm.clusters import spacing as median_spacing
from deformscope.stages.msm.poke import Law, PokedBody, PokeSetup, Tip, hold, settle
from deformscope.stages.msm.solver import Precision
from deformscope.stages.poke.layers import FlatEdge, Layers, MeasuredSurface, below

DISTANCES = np.array([0.0, 0.06, 0.12, 0.2, 0.3, 0.4, 0.6, 0.9])
"""Distances from the tip's edge, as shares of the thickness; the residual is linear between them, and 0 beyond the
last."""

PRIOR_SD = 0.05
"""Deviation of the residual, as a share of the depth, that is expected where nothing was seen."""


@dataclass(frozen=True, slots=True)
class SurfaceLeft:
    """A poke whose surface a model followed. middle: (2,) middle of the tip [m]; depth [m]; points: (n, 3) [m]; left:
    (n, 3) seen less simulated displacement [m]"""

    middle: FloatArray
    tip: Tip
    depth: float
    points: FloatArray
    left: FloatArray


@dataclass(frozen=True, slots=True)
class DentResidual:
    """Observed less simulated displacement around a tip, as a share of its depth, at `DISTANCES` of its edge: away from
    the tip's middle, and upwards (k,). thickness: [m]"""

    outward: FloatArray
    upward: FloatArray
    thickness: float

    def at(self, points: FloatArray, middle: FloatArray, tip: Tip, depth: float) -> FloatArray:
        """(n, 3) [m] at points of the surface (n, 3) around a tip at `middle` (2,)."""
        away, basis = _around(points, middle, tip, self.thickness)
        return depth * np.column_stack([away * (basis @ self.outward)[:, None], basis @ self.upward])


def residual_of(seen: Sequence[SurfaceLeft], thickness: float) -> DentResidual | None:
    """The residual that pokes have in common; None under a ball, whose edge moves as it sinks in. Least squares, drawn
    towards 0 by as much as points scatter: few points say little."""
    if any(one.tip.shape == "sphere" for one in seen):
        return None
    gram, right = np.zeros((len(DISTANCES),) * 2), np.zeros((len(DISTANCES), 2))
    square, count = 0.0, 0
    for one in seen:
        away, basis = _around(one.points, one.middle, one.tip, thickness)
        share = one.left / one.depth
        gram += basis.T @ basis
        right += basis.T @ np.column_stack([(share[:, :2] * away).sum(axis=1), share[:, 2]])
        square, count = square + float(np.sum(share**2)), count + share.size
    scatter = square / max(count, 1)
    found = np.linalg.solve(gram + (scatter / PRIOR_SD**2 + 1e-9) * np.eye(len(gram)), right)
    return DentResidual(found[:, 0], found[:, 1], thickness)


def _around(points: FloatArray, middle: FloatArray, tip: Tip, thickness: float) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (n, 2) away from the tip's middle, and the share (n, k) that each distance has of a point's."""
    aside = points[:, :2] - middle
    radius = np.linalg.norm(aside, axis=1)
    if tip.shape == "flat":
        distance = np.linalg.norm(np.maximum(np.abs(aside) - tip.half, 0.0), axis=1)
    else:
        distance = np.maximum(radius - 0.5 * tip.size[0], 0.0)
    share = distance / thickness
    basis = np.stack([np.interp(share, DISTANCES, row) for row in np.eye(len(DISTANCES))], axis=1)
    basis[share > DISTANCES[-1]] = 0.0
    return aside / np.maximum(radius, 1e-12)[:, None], basis


FIRST_SIZES, SIZES = (3, 4), (2, 7)
"""Default cluster sizes that are tried first, and the smallest and largest of all."""

CELLS_ACROSS_TIP = 4
"""Lattice cells across the tip by default, and at least for predictions of a narrower tip. Cells across a tip. With
fewer, the force of a wider or narrower tip has an error (2 cm to 4 cm on a layer of 5 cm: 11 % with two cells, 5 % with
four)."""

REACH_SHARE, REACH_TIPS = 1.1, 0.5
"""The lattice goes this many thicknesses, and tip widths, beyond the tip on each side: there the surface is quiet."""

NEAR_SHARE = 0.6
"""The surface within this many thicknesses of the tip is compared: beyond, it hardly moves."""

MOST_SHAPES = 2
"""Largest number of pokes, far apart, to which beta and theta are fitted; stiffness is computed at all pokes."""

SLIPPED = 0.02
"""A tip slips if the particles under it moved sideways among each other by more than this share of the depth."""

DOWN = np.array([0.0, 0.0, -1.0])
BETA_RANGE = (0.0, 0.99)
FARTHEST = np.array([-np.log1p(-BETA_RANGE[1]), 1.0])
"""The largest -log(1 - beta) and theta."""

MOST_LAWS = 15
"""Laws that are tried for each cluster size, and one more where a step is refused."""
SLOPE_STEP = 0.03
"""Step of -log(1 - beta) and of theta for the fit's slopes: well above the accuracy of contact."""


@dataclass(frozen=True, slots=True)
class SeenPoke:
    """One measured poke of a surface.

    at: (3,) the middle of the touched points, at rest [m]; depth: mean displacement of the touched points, downwards
    [m]; touched, touched_by: (m, 3) rest and displacement of the touched points; points, moved: (n, 3) all points seen,
    before and after; noise: (n,) [m] or None; force: [N] or None
    average_over: cells of this side, seen from above, whose mean displacement is compared in place of each point's [m]:
    white noise of many points falls, and the misfit remains; None: every point alone
    misfit_over: points nearer than this share the model's misfit [m], None: the tip's width; footprint: `at` and `tip`
    describe the tip, so that all points below it are touched; otherwise the area between the touched points is
    heights_only: `points` are places where a camera saw the surface afterwards, and of `moved` it measures the height
    alone, not the material point that is there"""

    at: FloatArray
    tip: Tip
    depth: float
    touched: FloatArray
    touched_by: FloatArray
    points: FloatArray
    moved: FloatArray
    noise: FloatArray | None
    force: float | None
    footprint: bool = False
    heights_only: bool = False
    average_over: float | None = None
    misfit_over: float | None = None

    @property
    def components(self) -> int:
        """Number of observed coordinates of each point's displacement."""
        return 1 if self.heights_only else 3


def seen_poke(seen: Observation) -> SeenPoke:
    """The poke in an observation of a surface: its contact, or the held particles that moved, are the touched points.
    Raises InputError for a flat (2D) observation, and where nothing was pressed down."""
    if seen.rest.shape[1] != 3:
        raise InputError("a surface in space, rest (K, 3), for a body with layers", "2D positions")
    if seen.metres_per_unit != 1.0:
        raise InputError("positions in metres", f"in {seen.unit}")
    move = seen.deformed - seen.rest
    touched = seen.touched
    if not len(touched):
        raise InputError("held particles that were pressed", "none that moved")
    depth = float(-move[touched, 2].mean())
    if depth <= 0.0:
        raise InputError("a poke that presses the surface down (-z)", f"one that moves it by {-depth:g} m along z")
    rest = seen.rest[touched]
    free = seen.observed
    sideways = move[touched, :2] - move[touched, :2].mean(axis=0)
    slips = bool(np.abs(sideways).max() > SLIPPED * depth)
    if seen.tip is not None and len(touched) < 2:
        slips = seen.tip.slips  # one point alone cannot show it
    low, high = rest[:, :2].min(axis=0), rest[:, :2].max(axis=0)
    size = np.maximum(high - low, 1e-3 * median_spacing(seen.rest))
    if (high - low).min() <= 0.0:
        size = np.maximum(high - low, median_spacing(seen.rest))
    tip = seen.tip or Tip("flat", (float(size[0]), float(size[1])))
    middle = 0.5 * (low + high) if seen.tip_at is None else seen.tip_at[:2]
    return SeenPoke(
        at=np.array([*middle, rest[:, 2].mean()]),
        tip=dataclasses.replace(tip, slips=slips),
        depth=depth,
        touched=rest,
        touched_by=move[touched],
        points=seen.rest[free],
        moved=move[free],
        noise=None if seen.noise is None else seen.noise[free],
        force=seen.force_n,
        footprint=seen.tip is not None and tip.shape != "sphere",
    )


def scene_below(
    surface: MeasuredSurface, at: FloatArray, tip: Tip, spacing: float, cluster_size: int
) -> tuple[PokeSetup, Layers]:
    """The layers around a place (2,) or (3,), so spaced that the tip spans a whole number of cells, ready to be poked.
    spacing: wished for [m]"""
    cells = max(1, round(tip.width / spacing))
    fine = tip.width / cells
    centre = np.asarray(at)[:2] + (0.5 * fine if cells % 2 else 0.0)
    reach = 0.5 * max(tip.size) + REACH_SHARE * surface.thickness + REACH_TIPS * tip.width
    layers = below(surface, spacing=fine, centre=centre, reach=reach)
    grouped = clusters.lattice(layers.rest, layers.shape, layers.cell, cluster_size)
    return PokeSetup(layers.rest, grouped, fixed=layers.bottom, open=layers.top, toward=DOWN, spacing=fine), layers


def flat_edge(at: FloatArray, tip: Tip) -> FlatEdge | None:
    """The edge of a flat tip at a place (2,) or (3,); other tips have none that the surface falls at."""
    if tip.shape != "flat":
        return None
    return FlatEdge(np.asarray(at)[:2], tip.half)


def default_spacing(surface: MeasuredSurface, tip: Tip) -> float:
    """A lattice spacing that resolves the tip without more than some 30 layers [m]."""
    return max(tip.width / CELLS_ACROSS_TIP, surface.thickness / 30.0)


def spacing_for(
    surface: MeasuredSurface, pokes: Sequence[SeenPoke], wished: float | None, most: float
) -> tuple[float, float, int]:
    """The spacing of the lattice [m] with at most this number of particles for all shapes, twice the finest at most;
    the finest: the requested one, or the default; the number of particles."""
    finest = wished or default_spacing(surface, min((poke.tip for poke in pokes), key=lambda one: one.width))

    def count(spacing: float) -> int:
        chosen = (pokes[place] for place in _spread(pokes))
        return sum(len(scene_below(surface, one.at, one.tip, spacing, FIRST_SIZES[0])[0].rest) for one in chosen)

    spacings = [finest * CELLS_ACROSS_TIP / cells for cells in range(CELLS_ACROSS_TIP, 1, -1)]
    spacing = next((one for one in spacings if count(one) <= most), spacings[-1])
    return spacing, finest, count(spacing)


class PosedPoke:
    """A measured poke on its lattice: the held particles with their places, and the places where the surface was
    seen."""

    def __init__(
        self, surface: MeasuredSurface, poke: SeenPoke, spacing: float, size: int, precision: Precision, device: str
    ):
        self.poke, self.size, self.thickness = poke, size, surface.thickness
        self.scene, layers = scene_below(surface, poke.at, poke.tip, spacing, size)
        upper = layers.rest[layers.top][:, :2]
        if poke.footprint:
            below = np.isfinite(poke.tip.rise(upper - poke.at[:2], self.scene.spacing))
        else:
            below = _covered(poke.touched[:, :2], upper, self.scene.spacing)
        self.touched = self.scene.open[below]
        law = Law(0.0, cluster_size=size)
        self.body = hold(self.scene, self.touched, law, precision, device, slips=poke.tip.slips)
        rest = self.scene.rest[self.touched]
        self.at = rest + _between(poke.touched[:, :2], poke.touched_by, rest[:, :2])
        weights, inside = layers.interpolation(poke.points[:, :2], flat_edge(poke.at, poke.tip))
        away = np.abs(poke.points[:, :2] - poke.at[:2]).max(axis=1) - 0.5 * max(poke.tip.size)
        self.near = np.flatnonzero(inside & (away <= NEAR_SHARE * surface.thickness))
        self.inside, self.weights, self._layers = inside, weights, layers
        if not len(self.near):
            raise InputError("surface points near the poke", "none within the lattice", "points around the contact")
        self._average = None if poke.average_over is None else _cells(poke.points[self.near], poke.average_over)
        self.places = self.compared(poke.points)
        self._share = np.ones(len(self.places))
        if self._average is not None:
            count = np.diff(self._average.indptr)
            self._share = np.sqrt(count / count.mean())
        self.state: PokedBody | None = None

    def settle(self, laws: Sequence[Law]) -> PokedBody:
        """The static states with these laws, computed together; they start from the first state of the previous
        call."""
        start, at = (None, self.at) if self.state is None else (self.state.position[:1], self.state.hold[0])
        slips = self.poke.tip.slips
        self.state = settle(self.scene, self.body, laws, self.touched, at, slips=slips, start=start)
        return self.state

    def residual(self, state: PokedBody) -> FloatArray:
        """Simulated less seen displacement near the poke, in units of its depth, (B, m, 3) at `places`."""
        return self.weighed(self.moved(state) - self.poke.moved)

    def weighed(self, displacement: FloatArray) -> FloatArray:
        """Displacements (..., n, 3) of all points as they are compared, (..., m, 3), in units of the depth; a cell
        counts by its points."""
        return np.asarray(self.compared(displacement) * self._share[:, None] / self.poke.depth)

    def compared(self, value: FloatArray) -> FloatArray:
        """Values (..., n, 3) of all points, reduced to what is compared near the poke: each point, or means over
        cells."""
        near = value[..., self.near, :]
        if self._average is None:
            return np.asarray(near)
        flat = np.moveaxis(near, -2, 0).reshape(len(self.near), -1)
        mean = np.asarray(self._average @ flat).reshape(-1, *near.shape[:-2], near.shape[-1])
        return np.moveaxis(mean, 0, -2)

    def moved(self, state: PokedBody) -> FloatArray:
        """Simulated displacement of every point of the surface, (B, n, 3) [m]; beyond the lattice it is still."""
        every = [self._seen(one - self.scene.rest) for one in state.position]
        return np.where(self.inside[:, None], np.stack(every), 0.0)

    def _seen(self, displacement: FloatArray) -> FloatArray:
        """Displacement (n, 3) at the points, by the particles' (K, 3); of heights alone, the present height there."""
        found = np.asarray(self.weights @ displacement)
        if not self.poke.heights_only:
            return found
        weights, still = self._layers.interpolation(self.poke.points[:, :2] - found[:, :2])
        height = np.where(still, weights @ displacement[:, 2], found[:, 2])
        return np.column_stack([np.zeros((len(found), 2)), height])

    def left(self, state: PokedBody) -> SurfaceLeft:
        """Residual of the first of these states on the surface near the poke."""
        poke, near = self.poke, self.near
        left = (poke.moved - self.moved(state)[0])[near]
        return SurfaceLeft(middle=poke.at[:2], tip=poke.tip, depth=poke.depth, points=poke.points[near], left=left)

    def reaction(self, state: PokedBody) -> FloatArray:
        """Net force on the tip along its direction per unit of stiffness k, (B,) [m]."""
        return np.asarray((state.pull @ DOWN).sum(axis=1))


def fit_shape(
    posed: Sequence[PosedPoke],
    *,
    beta_range: tuple[float, float] = BETA_RANGE,
    theta: float | None = None,
    start: tuple[float, float] = (0.3, 0.5),
    tick: Callable[[int], None] = lambda laws: None,
) -> tuple[Law, bool]:
    """The law of least squared error over pokes with beta in its range, and whether all its states converged.

    theta: fixed if given; tick: called with how many laws were tried, MOST_LAWS at most

    All pokes count equally, whatever their number of points. Slopes are differences, because slipping particles move
    with the law. A law and its neighbours are relaxed together."""
    from scipy.optimize import least_squares  # slow to import

    size = posed[0].size
    seen: dict[bytes, tuple[FloatArray, FloatArray, bool]] = {}

    def law(x: FloatArray) -> Law:
        return Law(float(-np.expm1(-x[0])), float(x[1]) if theta is None else theta, size)

    def around(x: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
        """Residuals (n,), their slopes (n, parameters), and whether the state itself converged."""
        if (key := x.tobytes()) not in seen:
            steps = np.where(x > 0.5 * FARTHEST[:free], -SLOPE_STEP, SLOPE_STEP)
            laws = [law(x), *(law(x + step) for step in np.diag(steps))]
            states = [one.settle(laws) for one in posed]
            pairs = zip(posed, states, strict=True)
            every = [one.residual(state).reshape(len(laws), -1) / np.sqrt(len(one.places)) for one, state in pairs]
            value = np.concatenate(every, axis=1)
            good = all(bool(state.converged[0]) for state in states)
            tick(len(seen))
            seen[key] = value[0], ((value[1:] - value[0]) / steps[:, None]).T, good
        return seen[key]

    free = 2 if theta is None else 1
    low, high = (np.array([-np.log1p(-beta_range[end]), float(end)])[:free] for end in (0, 1))
    inside = np.minimum(1e-3, 0.1 * (high - low))
    first = np.clip(np.array([-np.log1p(-start[0]), start[1]])[:free], low + inside, high - inside)
    slopes, ends = lambda x: around(x)[1], (low, high)
    found = least_squares(lambda x: around(x)[0], first, slopes, bounds=ends, xtol=1e-3, ftol=1e-4, max_nfev=MOST_LAWS)
    return law(found.x), around(found.x)[2]


def _covered(touched: FloatArray, places: FloatArray, spacing: float) -> IntArray:
    """Which of the places (m, 2) lie within what was touched (n, 2); the nearest one at least."""
    grace = 1e-3 * spacing
    try:
        hull = ConvexHull(touched)
        inside = (places @ hull.equations[:, :2].T + hull.equations[:, 2] <= grace).all(axis=1)
    except (QhullError, ValueError):
        inside = np.zeros(len(places), dtype=bool)
    if not inside.any():
        middle = 0.5 * (touched.min(axis=0) + touched.max(axis=0))
        half = np.maximum(0.5 * np.ptp(touched, axis=0), 0.5 * spacing) + grace
        inside = (np.abs(places - middle) <= half).all(axis=1)
    if not inside.any():
        inside[np.argmin(np.linalg.norm(places - touched.mean(axis=0), axis=1))] = True
    return np.flatnonzero(inside)


def _cells(points: FloatArray, side: float) -> csr_array:
    """(m, n) the mean over the points (n, 3) of each occupied cell, seen from above."""
    cell = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / side).astype(np.int64)
    _, place, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    return csr_array((1.0 / count[place], (place, np.arange(len(points)))), shape=(len(count), len(points)))


def _between(place: FloatArray, value: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (n, 3) at places (n, 2), interpolated and extrapolated at the places (m, 2)."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    nearest = NearestNDInterpolator(place, value)(wanted)
    try:
        inner = LinearNDInterpolator(place, value)(wanted)
    except (QhullError, ValueError):
        return np.asarray(nearest)
    return np.asarray(np.where(np.isnan(inner), nearest, inner))


# All pokes together ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ShapeFit:
    """Fit of clusters of one size to the pokes.

    law; surface_error: (q,) root mean square distance near each poke used, as a share of its depth; held_out: (q,)
    errors with beta and theta fitted to the other pokes, nan with one poke and for all sizes except the best
    reaction: (p,) reaction of every poke, per unit of k [m]; residual: error around the tip of every poke"""

    law: Law
    surface_error: FloatArray
    held_out: FloatArray
    reaction: FloatArray
    converged: bool
    residual: DentResidual | None = None

    @property
    def score(self) -> float:
        """Criterion of cluster sizes: the error over all pokes. All sizes have the same two parameters, so that none
        wins by fitting noise."""
        return float(np.sqrt(np.mean(self.surface_error**2)))


@dataclass(frozen=True, slots=True)
class PokesFit:
    """Layers fitted to pokes. spacing: spacing of the lattice [m]; tried: every cluster size, the best first; shaped:
    (q,) the pokes whose surface beta and theta were fitted to; posed: the pokes on the lattice of the best size;
    beta_range: range in which beta was sought; theta_fitted: False = it was given"""

    surface: MeasuredSurface
    pokes: tuple[SeenPoke, ...]
    spacing: float
    tried: tuple[ShapeFit, ...]
    shaped: IntArray
    posed: tuple[PosedPoke, ...]
    beta_range: tuple[float, float]
    theta_fitted: bool

    @property
    def best(self) -> ShapeFit:
        return self.tried[0]

    def stiffness(self, one: ShapeFit) -> tuple[IntArray, FloatArray]:
        """The pokes whose force was measured (f,), and k [N/m] at each."""
        measured = np.flatnonzero([poke.force is not None and poke.force > 0.0 for poke in self.pokes])
        force = np.array([float(self.pokes[i].force or 0.0) for i in measured])
        return measured, force / one.reaction[measured]


def fit_pokes(
    surface: MeasuredSurface,
    pokes: Sequence[SeenPoke],
    *,
    spacing: float | None = None,
    cluster_sizes: Sequence[int] | None = None,
    beta_range: tuple[float, float] = BETA_RANGE,
    theta: float | None = None,
    precision: Precision = "float32",
    device: str = "cpu",
    progress: Progress | None = None,
) -> PokesFit:
    """Fit the layers below a surface to one or several pokes of it.

    spacing: spacing of the lattice [m], default `default_spacing` of the narrowest tip; cluster_sizes: tried, default 3
    and 4 and then on in the direction that is better; beta_range: (low, high) range in which beta is sought; theta:
    fixed if given; progress: called with (what, done, all)"""
    narrow = min(pokes, key=lambda poke: poke.tip.width)
    fine = default_spacing(surface, narrow.tip) if spacing is None else spacing
    shaped = _spread(pokes)
    tried: dict[int, ShapeFit] = {}
    posed: dict[int, list[PosedPoke]] = {}
    waiting = list(cluster_sizes or FIRST_SIZES)
    steps = MOST_LAWS * (len(waiting) if cluster_sizes else SIZES[1] - FIRST_SIZES[0] + 1)
    settled: dict[int, PokedBody] = {}  # of each poke under the size before: where to start from
    while waiting:
        size = waiting.pop(0)

        def tick(laws: int, before: int = MOST_LAWS * len(tried)) -> None:
            if progress is not None:
                progress("laws tried, at most", before + min(laws, MOST_LAWS), steps)

        tick(0)

        def pose(place: int, size: int = size) -> PosedPoke:
            made = PosedPoke(surface, pokes[place], fine, size, precision, device)
            made.state = settled.get(place)
            return made

        posed[size] = [pose(int(i)) for i in shaped]
        tried[size] = _fit_size(pose, posed[size], shaped, len(pokes), fine, beta_range, theta, settled, tick)
        for other in [one for one in posed if tried[one].score > min(each.score for each in tried.values())]:
            del posed[other]
        if not waiting and cluster_sizes is None:
            best = min(tried, key=lambda one: tried[one].score)
            beyond = best + 1 if best == max(tried) else best - 1 if best == min(tried) else best
            if beyond not in tried and SIZES[0] <= beyond <= SIZES[1]:
                waiting.append(beyond)
    ranked = sorted(tried.values(), key=lambda one: one.score)
    best_posed = next(iter(posed.values()))
    ranked[0] = dataclasses.replace(ranked[0], held_out=_hold_out(best_posed, ranked[0].law, beta_range, theta))
    return PokesFit(
        surface=surface,
        pokes=tuple(pokes),
        spacing=fine,
        tried=tuple(ranked),
        shaped=shaped,
        posed=tuple(best_posed),
        beta_range=beta_range,
        theta_fitted=theta is None,
    )


def _fit_size(
    pose: Callable[[int], PosedPoke],
    posed: Sequence[PosedPoke],
    shaped: IntArray,
    count: int,
    spacing: float,
    beta_range: tuple[float, float],
    theta: float | None,
    settled: dict[int, PokedBody],
    tick: Callable[[int], None],
) -> ShapeFit:
    """shaped: (n,) pokes that are fitted; settled: takes in the state of every poke; tick: as `fit_shape` takes it"""
    law, good = fit_shape(posed, beta_range=beta_range, theta=theta, tick=tick)
    own = dict(zip(shaped.tolist(), posed, strict=True))
    reaction, error, left = np.empty(count), [], []
    for place in range(count):
        one = own.get(place) or pose(place)
        state = settled[place] = one.settle([law])
        good &= bool(state.converged[0])
        reaction[place] = one.reaction(state)[0] * (one.scene.spacing / spacing)
        if place in own:
            error.append(_rms(one.residual(state)[0]))
        if not one.poke.heights_only:
            left.append(one.left(state))
    residual = residual_of(left, posed[0].thickness) if len(left) == count else None
    return ShapeFit(law, np.array(error), np.full(len(posed), np.nan), reaction, good, residual)


def _hold_out(posed: Sequence[PosedPoke], law: Law, beta_range: tuple[float, float], theta: float | None) -> FloatArray:
    """(pokes,) surface error of each poke, as a share of its depth, with beta and theta fitted to the others; NaN of a
    single one."""
    error = np.full(len(posed), np.nan)
    if len(posed) > 1:
        for place, left in enumerate(posed):
            others = [one for one in posed if one is not left]
            elsewhere, _ = fit_shape(others, beta_range=beta_range, theta=theta, start=(law.beta, law.theta))
            error[place] = _rms(left.residual(left.settle([elsewhere]))[0])
    return error


def _rms(residual: FloatArray) -> float:
    """Root mean square length of residuals (n, 3), in their unit; NaN of none."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))) if len(residual) else float("nan")


def _spread(pokes: Sequence[SeenPoke]) -> IntArray:
    """Indices (n,) of at most `MOST_SHAPES` pokes, each as far from those before as can be; the deepest first."""
    chosen = [int(np.argmax([poke.depth for poke in pokes]))]
    place = np.array([poke.at for poke in pokes])
    while len(chosen) < min(MOST_SHAPES, len(pokes)):
        away = np.linalg.norm(place[:, None] - place[chosen], axis=2).min(axis=1)
        away[chosen] = -1.0
        chosen.append(int(np.argmax(away)))
    return np.array(sorted(chosen))
