"""Where a table and a tip are, found again from touches and turns; what data do not show is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from deformscope.arrays import FloatArray
from deformscope.errors import InputError
from deformscope.stages.setup.force import PIVOTED, pivot
from deformscope.stages.setup.place import CORNERS, TOUCHED, place
from deformscope.stages.setup.transform import ErrorPrior, TransformEstimate, deviation, moved, rigid
from tests.stages.setup.region import region_holds

DRAWS = 200
RADIUS_M = 0.01
SIZE_M = np.array([0.6, 0.4])
AT_LEAST, AT_MOST = (int(binom.ppf(share, DRAWS, 0.9)) for share in (1e-4, 1.0 - 1e-4))
"""Of the draws, so many intervals of 90 % may hold the truth."""


def drawn_sd(random: np.random.Generator, prior: ErrorPrior) -> float:
    """A deviation as the prior has it."""
    return float(prior.sd * np.sqrt(prior.weight / random.chisquare(prior.weight)))


def somewhere(random: np.random.Generator) -> FloatArray:
    """A table that is nearly level, turned anyhow."""
    turn = Rotation.from_euler("zx", [random.uniform(-180, 180), random.uniform(-3, 3)], degrees=True)
    return rigid(turn.as_matrix(), random.uniform(-0.5, 0.5, 3))


def touched(T: FloatArray, which: list[int], sd_m: float, random: np.random.Generator) -> FloatArray:
    """The tip's centre on corners."""
    on_it = np.column_stack([CORNERS[which] * SIZE_M, np.full(len(which), RADIUS_M)])
    return on_it @ T[:3, :3].T + T[:3, 3] + sd_m * random.standard_normal((len(which), 3))


def held(estimate: TransformEstimate, T: FloatArray) -> FloatArray:
    return np.abs(estimate.deviation(T)) <= estimate.half()


def test_moved_and_deviation_are_each_other_s_reverse() -> None:
    random = np.random.default_rng(1)
    T, off = somewhere(random), 0.3 * random.standard_normal(6)
    assert deviation(T, moved(T, off)) == pytest.approx(off)


def test_three_exact_corners_give_the_table() -> None:
    random = np.random.default_rng(0)
    T = somewhere(random)
    found = place(touched(T, [0, 1, 2], 0.0, random), [0, 1, 2], RADIUS_M)
    assert pytest.approx(T, abs=1e-9) == found.T_arm_surface.T
    assert found.size_m == pytest.approx(SIZE_M)
    inside = np.array([0.3, 0.2, 0.1]) @ T[:3, :3].T + T[:3, 3]
    assert (found.low_m < inside).all()
    assert (inside < found.high_m).all()


def test_the_intervals_of_a_table_hold_it_in_nine_of_ten() -> None:
    """Three corners leave one number over: what is believed of a touch carries the interval, as it should."""
    random = np.random.default_rng(2)
    hits, sizes, regions = np.zeros(6), np.zeros(2), 0
    for _ in range(DRAWS):
        T, which = somewhere(random), [0, 1, 2]
        found = place(touched(T, which, drawn_sd(random, TOUCHED), random), which, RADIUS_M)
        hits += held(found.T_arm_surface, T)
        sizes += np.abs(found.size_m - SIZE_M) <= found.size_half_m
        regions += region_holds(found.T_arm_surface, T)
    for count in (*hits, *sizes, regions):
        assert AT_LEAST <= count <= AT_MOST


def test_more_touches_make_it_sharper() -> None:
    random = np.random.default_rng(3)
    T = somewhere(random)
    few, many = (
        place(touched(T, which, 0.001, random), which, RADIUS_M).T_arm_surface.half()
        for which in ([0, 1, 2], [0, 1, 2, 3] * 4)
    )
    assert (many < 0.6 * few).all()


def test_corners_that_say_nothing_of_a_table_are_refused() -> None:
    random = np.random.default_rng(4)
    T = somewhere(random)
    good_m = touched(T, [0, 1, 2], 0.0, random)
    in_line_m = good_m.copy()
    in_line_m[2] = 2.0 * good_m[1] - good_m[0]
    askew_m = good_m.copy()
    askew_m[2] += 0.05 * T[:3, 0]
    with pytest.raises(InputError, match=r"one line.*try: touch the end of x"):
        place(in_line_m, [0, 1, 2], RADIUS_M)
    with pytest.raises(InputError, match=r"rectangle.*try: touch the corners again"):
        place(askew_m, [0, 1, 2], RADIUS_M)
    with pytest.raises(InputError, match="try: swap"):
        place(good_m[[0, 2, 1]], [0, 1, 2], RADIUS_M)
    with pytest.raises(InputError, match="no end of y"):
        place(good_m[:2], [0, 1], RADIUS_M)
    with pytest.raises(InputError, match="apart"):
        place(good_m[[0, 0, 2]], [0, 1, 2], RADIUS_M)


TIP_M = np.array([0.004, -0.003, 0.105])


def turned(count: int, tilt_deg: float, sd_m: float, random: np.random.Generator) -> FloatArray:
    """Poses (n, 4, 4) of an arm's end whose ball stays in a cone."""
    around = np.linspace(0.0, 360.0, count, endpoint=False) + random.uniform(0, 30)
    down = Rotation.from_euler("x", 180.0, degrees=True)
    tilts = [Rotation.from_euler("zxz", [a, tilt_deg, -a], degrees=True) * down for a in around]
    turns = np.array([tilt.as_matrix() for tilt in tilts])
    pivot_m = np.array([0.1, -0.4, 0.05]) + sd_m * random.standard_normal((count, 3))
    return rigid(turns, pivot_m - turns @ TIP_M)


def test_exact_turns_give_the_tip() -> None:
    found = pivot(turned(6, 20.0, 0.0, np.random.default_rng(0)))
    assert found.T_ee_center.T[:3, 3] == pytest.approx(TIP_M, abs=1e-9)
    assert found.T_ee_center.T[:3, 2] == pytest.approx(TIP_M / np.linalg.norm(TIP_M))
    assert found.pivot_m == pytest.approx([0.1, -0.4, 0.05])


def test_the_pivot_is_that_of_the_two_step_formulation() -> None:
    """Independent of ours: the place from differences of pairs (Yaniv 2015, 2.2: the algebraic two-step method)."""
    poses = turned(9, 25.0, 0.001, np.random.default_rng(1))
    pairs = [(i, j) for i in range(9) for j in range(i)]
    design = np.vstack([poses[i, :3, :3] - poses[j, :3, :3] for i, j in pairs])
    wanted = np.concatenate([poses[j, :3, 3] - poses[i, :3, 3] for i, j in pairs])
    tip_m = np.linalg.lstsq(design, wanted, rcond=None)[0]
    assert pivot(poses).T_ee_center.T[:3, 3] == pytest.approx(tip_m, abs=1e-9)


def test_the_intervals_of_a_tip_hold_it_in_nine_of_ten() -> None:
    random = np.random.default_rng(5)
    hits = np.zeros(3)
    for _ in range(DRAWS):
        sd_m = min(drawn_sd(random, PIVOTED), 0.003)  # a ball that is looser is refused
        found = pivot(turned(6, 20.0, sd_m, random)).T_ee_center
        hits += np.abs(found.T[:3, 3] - TIP_M) <= found.half()[:3]
    assert ((hits >= AT_LEAST) & (hits <= AT_MOST)).all()


def test_a_stick_that_is_tilted_or_mounted_off_the_middle_is_inside_the_interval() -> None:
    found = pivot(turned(8, 20.0, 0.0003, np.random.default_rng(6))).T_ee_center
    tilted = found.T
    straight = rigid(np.eye(3), TIP_M)
    for T in (tilted, straight):
        assert (np.abs(found.deviation(T)[3:5]) <= found.half()[3:5]).all()


def test_turns_that_say_nothing_of_a_tip_are_refused() -> None:
    random = np.random.default_rng(7)
    good = turned(6, 20.0, 0.0003, random)
    about_one_axis = good.copy()
    about_one_axis[:, :3, :3] = Rotation.from_rotvec(np.linspace(-0.4, 0.4, 6)[:, None] * [1.0, 0.0, 0.0]).as_matrix()
    slid = good.copy()
    slid[::2, :3, 3] += 0.02
    with pytest.raises(InputError, match=r"two axes.*try: tilt the stick"):
        pivot(about_one_axis)
    with pytest.raises(InputError, match=r"two axes.*try: tilt the stick"):
        pivot(turned(6, 3.0, 0.0003, random))
    with pytest.raises(InputError, match="stays in its place"):
        pivot(slid)
    with pytest.raises(InputError, match="4 poses"):
        pivot(good[:3])
