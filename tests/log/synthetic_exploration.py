"""A made-up exploration: a table with two foams, eight touches, maps that get surer, all on one clock."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from deformscope.arrays import FloatArray
from deformscope.stages.map import exploration

CELL_M = 0.005
ROWS, COLUMNS = 80, 120
FOAM_M = 0.05
TIP_M = 0.01
SOFT, FIRM = 0.62, 1.35  # N/mm
TOUCH_S = 6.0
CONTACTS_M = np.array(
    [*((0.15, 0.1), (0.45, 0.3), (0.45, 0.1), (0.15, 0.3)), *((0.3, 0.2), (0.26, 0.34), (0.33, 0.06), (0.31, 0.29))]
)

MISSED = exploration.DetectionLimit(
    0.13, np.array([0.13, 0.2]), np.array([0.03, 0.06]), np.array([0.46, 0.31]), 2.0, 0.5
)
Y, X = (np.mgrid[:ROWS, :COLUMNS] + 0.5) * CELL_M
EDGE_M = 0.3 - 0.15 * (Y - 0.2)
TRUTH = (EDGE_M < X).astype(np.int64)


def lumps(*found: tuple[float, float, float], truth: bool = True) -> exploration.InclusionsResult:
    """Lumps at x, y of a radius [m] after eight touches."""
    each, none = np.array(found).reshape(-1, 3), np.zeros(len(found))
    above = [np.hypot(X - x, Y - y) < radius for x, y, radius in each]
    return exploration.InclusionsResult(
        centre_m=each[:, :2],
        within_m=none + 0.01,
        radius_m=each[:, 2],
        radius_interval_m=each[:, 2:] * [0.8, 1.3],
        stiff=np.arange(len(found)) % 2 == 0,
        probability=none + 0.98,
        depth=("deep", "")[: len(found)],
        covered=np.maximum(0.02, np.any(above, axis=0)) if above else np.full((ROWS, COLUMNS), 0.02),
        cell_m=CELL_M,
        size_m=np.array([0.01, 0.02, 0.03]),
        missed=np.array([0.4, 0.03, 0.01]),
        smallest_m=0.02,
        missed_smallest=0.03,
        prior=0.5,
        contrast=4.0,
        deepest_m=0.02,
        deep_m=0.0125,
        scatter=0.005,
        contacts_m=CONTACTS_M,
        truth_m=np.array([[0.2, 0.1, 0.02, 0.015]]) if truth else None,
    )


def height(dents: int) -> FloatArray:
    """(rows, columns) the foam's top with the dents that have not come back yet [m]."""
    top = FOAM_M + 0.002 * np.sin(9 * X) * np.cos(7 * Y)
    for x, y in CONTACTS_M[max(0, dents - 1) : dents]:
        top -= 0.0045 * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / 0.018**2)
    return top


def surface(dents: int, points: int = 4000) -> exploration.SurfaceEstimate:
    rng = np.random.default_rng(dents)
    x, y = rng.uniform(0, 0.6, points), rng.uniform(0, 0.4, points)
    seen = ~((x - 0.42) ** 2 + (y - 0.33) ** 2 < 0.03**2)
    x, y = x[seen], y[seen]
    z = height(dents)[(y / CELL_M).astype(int), (x / CELL_M).astype(int)] + rng.normal(0, 0.001, len(x))
    deviation = 0.0003 + 0.002 * np.exp(-((X - 0.42) ** 2 + (Y - 0.33) ** 2) / 0.03**2)
    return exploration.SurfaceEstimate(np.stack([x, y, z], axis=1), height(dents), deviation, CELL_M)


def touch(number: int) -> exploration.TouchEstimate:
    rng = np.random.default_rng(1000 + number)
    x, y = CONTACTS_M[number]
    stiffness = FIRM if TRUTH[int(y / CELL_M), int(x / CELL_M)] else SOFT
    way = np.linspace(0.0, 0.012, 120)
    contact_m = 0.012 - 3.0 / stiffness / 1000
    pressed = np.clip(way - contact_m, 0.0, None)
    fitted = 3.0 * (pressed / pressed.max()) ** 1.4
    z = height(0)[int(y / CELL_M), int(x / CELL_M)]
    depth_m = 3.0 / stiffness / 1000
    angle, away = rng.uniform(0, 2 * np.pi, 700), 0.06 * np.sqrt(rng.uniform(0, 1, 700))
    dent = -depth_m * np.exp(-((away / 0.018) ** 2))
    observed = np.stack([x + away * np.cos(angle), y + away * np.sin(angle), z + dent], axis=1)
    observed[:, 2] += rng.normal(0, 0.0004, 700)
    observed = observed[away > 0.008]
    grid = np.arange(-5, 6) * 0.01
    u, v = (one.ravel() for one in np.meshgrid(grid, grid))
    simulated = [
        np.stack(
            [x + u, y + v, z - 0.01 * layer - depth_m * 0.8**layer * np.exp(-((np.hypot(u, v) / 0.02) ** 2))], axis=1
        )
        for layer in range(3)
    ]
    return exploration.TouchEstimate(
        number=number + 1,
        xyz_m=np.array([x, y, z]),
        normal=np.array([0.05, -0.03, 0.998]) / np.linalg.norm([0.05, -0.03, 0.998]),
        approach_m=way,
        approach_n=fitted + rng.normal(0, 0.03, 120),
        fitted_n=fitted,
        contact_m=contact_m,
        stiffness_n_per_mm=stiffness * 1.01,
        stiffness_interval=(stiffness * 0.97, stiffness * 1.05),
        rigid=False,
        modulus_pa=None if number == 3 else 37_000.0 * stiffness / SOFT,
        depth_m=depth_m,
        peak_force_n=3.02,
        peak_rate_n_per_s=None if number == 3 else 6.0,
        peak_rate_interval_n_per_s=None if number == 3 else (5.5, 6.5),
        beta=None if number == 0 else 0.12 + 0.03 * number,
        beta_interval=None if number == 0 else (0.0, 0.3),
        beta_verdict="" if number == 0 else "at-bound",
        observed_m=observed,
        simulated_m=np.concatenate(simulated),
        speed_m_s=0.0098,
    )


def _nearest_m(touches: int) -> FloatArray:
    return np.min([np.hypot(X - x, Y - y) for x, y in CONTACTS_M[:touches]], axis=0)


def maps(touches: int, truth: bool = True) -> exploration.MapEstimate:
    log_sd = 0.7 - 0.6 * np.exp(-((_nearest_m(touches) / 0.09) ** 2))
    found = touches >= 2
    edge = EDGE_M + 0.12 / touches * np.sin(13 * Y)
    labels = (edge < X).astype(np.int64) if found else np.zeros_like(TRUTH)
    share = 1 / (1 + np.exp(-(X - edge) / (0.16 / touches)))
    log_stiffness = np.log(SOFT) + np.log(FIRM / SOFT) * (share if found else 0 * share)
    count = 1 + found
    levels = np.array([SOFT, FIRM])[:count]
    both = [((labels == label), np.equal(TRUTH, label)) for label in (0, 1)]
    values = [np.mean(one & other) / np.mean(one | other) for one, other in both]
    return exploration.MapEstimate(
        touches=touches,
        cell_m=CELL_M,
        stiffness_n_per_mm=np.exp(log_stiffness),
        stiffness_log_sd=log_sd,
        beta=0.2 + 0.15 * np.sin(5 * X) * log_sd if found else None,
        beta_sd=0.3 * log_sd if found else None,
        labels=labels,
        label_probability=np.maximum(share, 1 - share) if found else np.ones_like(share),
        region_count=count,
        verdict="regions",
        probability=0.93,
        level_n_per_mm=levels,
        level_interval_n_per_mm=levels[:, None] * [0.9, 1.1],
        level_rigid=np.zeros(count, dtype=bool),
        contacts_m=CONTACTS_M[:touches].copy(),
        tip_radius_m=TIP_M,
        travel_m=0.31 * touches,
        truth_labels=TRUTH if truth else None,
        iou=float(np.mean(values)) if truth else None,
        boundary_m=0.012 if truth and found else None,
    )


def gradual(touches: int) -> exploration.MapEstimate:
    """A map without regions."""
    known = maps(touches, truth=False)
    none = np.zeros(0)
    return dataclasses.replace(
        known,
        labels=np.full_like(known.labels, -1),
        region_count=0,
        verdict="gradual",
        level_n_per_mm=none,
        level_interval_n_per_mm=np.zeros((0, 2)),
        level_rigid=none.astype(bool),
    )


def plan(touches: int) -> exploration.PlannedTouch:
    x, y = CONTACTS_M[touches - 1] if touches else (0.3, 0.0)
    excluded = (X < 0.02) | (X > 0.58) | (Y < 0.02) | (Y > 0.38) | (np.hypot(X - 0.6, Y - 0.4) < 0.12)
    cost_s = 6.0 + np.hypot(X - x, Y - y) / 0.1
    if touches == 0:
        return exploration.PlannedTouch(
            CONTACTS_M[0].copy(), None, None, excluded, "first touches spread over the surface", missed=MISSED
        )
    gain = (0.05 + 0.6 * np.exp(-(((X - EDGE_M) / 0.06) ** 2))) * (1 - np.exp(-((_nearest_m(touches) / 0.06) ** 2)))
    if touches == len(CONTACTS_M):
        stop = "the regions are sure: no cell is expected to tell 0.02 or more"
        return exploration.PlannedTouch(None, 0.03 * gain, cost_s, excluded, "", stop)
    reason = "here the regions are the least sure for the time it takes: expected gain 0.41 in 7.3 s"
    return exploration.PlannedTouch(CONTACTS_M[touches].copy(), gain, cost_s, excluded, reason)


def story() -> Iterator[tuple[float, int, object]]:
    """(time [s], touch, result) of the whole exploration, in order."""
    yield 0.0, 0, exploration.PhaseStart("look", 0)
    yield 1.0, 0, surface(0)
    yield 1.1, 0, exploration.PhaseStart("plan", 0)
    yield 1.4, 0, plan(0)
    for number in range(len(CONTACTS_M)):
        start, k = 1.5 + TOUCH_S * number, number + 1
        for after, phase in ((0.0, "travel"), (1.5, "approach"), (2.3, "press"), (3.0, "dwell"), (4.0, "look")):
            yield start + after, k, exploration.PhaseStart(phase, number)
        yield start + 4.3, k, exploration.PhaseStart("retreat", number)
        yield start + 5.0, k, surface(k)
        yield start + 5.1, k, exploration.PhaseStart("plan", number)
        yield start + 5.2, k, touch(number)
        yield start + 5.5, k, maps(k)
        yield start + 5.7, k, plan(k)
    yield 1.5 + TOUCH_S * len(CONTACTS_M), len(CONTACTS_M), exploration.PhaseStart("stopped", len(CONTACTS_M) - 1)


def rigid_touch(number: int) -> exploration.TouchEstimate:
    return dataclasses.replace(touch(number), rigid=True, modulus_pa=None, stiffness_interval=(21.0, np.inf))


def unusable_touch(number: int) -> exploration.TouchEstimate:
    """Its contact could not be fitted."""
    nan = float("nan")
    told = dataclasses.replace(touch(number), contact_m=nan, stiffness_n_per_mm=nan, stiffness_interval=(nan, nan))
    unfitted = np.full_like(told.fitted_n, nan)
    return dataclasses.replace(told, depth_m=nan, modulus_pa=None, beta=None, beta_interval=None, fitted_n=unfitted)


def bare_touch() -> exploration.TouchEstimate:
    """A touch to which no beta was fitted, with nothing seen around its dent."""
    way, nothing = np.linspace(0.0, 0.01, 5), np.zeros((0, 3))
    return exploration.TouchEstimate(
        number=1,
        xyz_m=np.zeros(3),
        normal=np.array([0.0, 0.0, 1.0]),
        approach_m=way,
        approach_n=way,
        fitted_n=way,
        contact_m=0.0,
        stiffness_n_per_mm=1.0,
        stiffness_interval=(0.9, 1.1),
        rigid=False,
        modulus_pa=None,
        depth_m=0.01,
        peak_force_n=3.0,
        beta=None,
        beta_interval=None,
        beta_verdict="",
        observed_m=nothing,
        simulated_m=nothing,
    )


def small_results() -> tuple[object, ...]:
    """One of each kind."""
    field, at = np.ones((4, 6)), np.zeros(3)
    labels = np.zeros((4, 6), np.int64)
    labels[:, 3:] = 1
    cloud = np.ones((3, 3))
    touch = dataclasses.replace(bare_touch(), observed_m=cloud, simulated_m=cloud)
    levels, intervals, rigid = np.ones(2), np.ones((2, 2)), np.zeros(2, np.bool_)
    maps = exploration.MapEstimate(
        *(1, 0.005, field, field, field, field, labels, field, 2, "regions", 0.9, levels, intervals, rigid),
        *(at[None, :2], 0.01, 0.1, labels, 1.0),
    )
    plan = exploration.PlannedTouch(at[:2], field, field, labels == 1, "")
    seen, stop = (
        exploration.SurfaceEstimate(cloud, field, field, 0.005),
        exploration.ExplorationStop("", "", "", "stop", 0),
    )
    return seen, touch, maps, plan, exploration.StageFailure("", 1, "", ""), exploration.PhaseStart("look", 0), stop
