"""Particles: seeding, held groups, and tracking on flows that are known."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deformscope.errors import InputError
from deformscope.stages.see import particles
from deformscope.stages.see.flow import FlowField, dense_flow
from tests.cases import slow

Array = npt.NDArray[np.float64]
IMAGE = (120, 200)


def analytic_flow(flow: Callable[[Array, Array], tuple[Array, Array]], shape: tuple[int, int] = IMAGE) -> FlowField:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return FlowField(np.stack(np.broadcast_arrays(*flow(x, y)), axis=-1).astype(np.float32))


def constant(dx: float, dy: float, shape: tuple[int, int] = IMAGE) -> FlowField:
    return analytic_flow(lambda x, y: (0 * x + dx, 0 * y + dy), shape)


def test_rect_contains_its_edge() -> None:
    xy = np.array([[10.0, 5.0], [30.0, 9.0], [30.1, 9.0], [20.0, 4.9]])
    np.testing.assert_array_equal(particles.Rect(10, 5, 20, 4).contains(xy), [True, True, False, False])


def test_clean_mask_closes_pin_holes_only() -> None:
    image = np.full((60, 80), 90, dtype=np.uint8)
    image[:, :10] = 0  # beside the object
    image[20:40, 30:50] = 0  # a real hole
    speckled = image.copy()
    speckled[5:8, 60:63] = 0
    speckled[0, 70] = 0
    speckled[50, 20] = 0
    closed = particles.clean_mask(speckled)
    assert closed[image > 0].all()
    assert not closed[:, :10].any()
    assert not closed[23:37, 33:47].any()
    assert (closed != (image > 0)).sum() <= 16  # the hole's corners are rounded
    np.testing.assert_array_equal(particles.clean_mask(np.dstack([speckled] * 3)), closed)


def test_seeds_rows_and_columns_evenly() -> None:
    grid = particles.seed_grid(IMAGE, particles.Rect(20, 10, 100, 60), shape=(3, 5))
    assert grid.shape == (3, 5)
    np.testing.assert_allclose(grid.spacing_px, [20, 20])
    np.testing.assert_array_equal(grid.cell, np.arange(15))
    np.testing.assert_allclose(grid.rest_px[:6], [[30, 20], [50, 20], [70, 20], [90, 20], [110, 20], [30, 40]])


def test_seeds_by_spacing_centred() -> None:
    grid = particles.seed_grid(IMAGE, particles.Rect(20, 10, 105, 60), spacing_px=20)
    assert grid.shape == (3, 5)
    np.testing.assert_allclose(grid.rest_px.mean(axis=0), [72.5, 40])


def test_seeds_the_whole_image_by_default() -> None:
    grid = particles.seed_grid((150, 300))
    assert grid.shape == (8, 15)
    np.testing.assert_allclose(grid.spacing_px, [20, 18.75])


@given(sides=st.tuples(st.integers(40, 400), st.integers(40, 400)))
def test_cells_fill_the_region_by_default(sides: tuple[int, int]) -> None:
    """No rest is left at its border, so that the cells are the body; none is less close than 1.5 times another."""
    grid = particles.seed_grid((500, 500), particles.Rect(7, 11, *sides))
    np.testing.assert_allclose(grid.spacing_px * grid.shape[::-1], sides)
    np.testing.assert_allclose(grid.rest_px[0], [7, 11] + 0.5 * grid.spacing_px)
    assert grid.spacing_px.max() <= 1.5 * grid.spacing_px.min()


def test_seeds_the_masks_box_without_its_holes() -> None:
    mask = np.zeros(IMAGE, dtype=bool)
    mask[20:100, 40:120] = True
    mask[50:70, 70:90] = False
    grid = particles.seed_grid(IMAGE, shape=(8, 8), mask=mask)
    np.testing.assert_allclose(grid.rest_px[0], [45, 25])
    assert set(range(64)) - set(grid.cell.tolist()) == {27, 28, 35, 36}
    assert len(grid.rest_px) == 60


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"roi": particles.Rect(150, 10, 60, 60)}, "inside"),
        ({"roi": particles.Rect(-1, 10, 60, 60)}, "inside"),
        ({"roi": particles.Rect(10, 10, 0, 60)}, "inside"),
        ({"roi": particles.Rect(10, 10, float("nan"), 60)}, "inside"),
        ({"shape": (1, 5)}, "2 rows"),
        ({"shape": (5, 0)}, "2 rows"),
        ({"shape": (100, 5)}, "spacing of at least 2"),
        ({"spacing_px": 1.5}, "spacing of at least 2"),
        ({"spacing_px": float("nan")}, "spacing of at least 2"),
        ({"spacing_px": 90.0}, "2 rows"),
        ({"shape": (3, 3), "spacing_px": 10.0}, "both"),
        ({"mask": np.ones((10, 10), dtype=bool)}, "image's size"),
        ({"mask": np.zeros(IMAGE, dtype=bool)}, "material"),
        ({"roi": particles.Rect(0, 0, 50, 50), "mask": np.tri(*IMAGE, k=-90, dtype=bool)}, "4 particles"),
    ],
)
def test_refuses_to_seed(settings: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        particles.seed_grid(IMAGE, **settings)  # type: ignore[arg-type]


@pytest.fixture
def grid() -> particles.ParticleGrid:
    """Four rows of five, 10 px apart, the first at (5, 5)."""
    return particles.seed_grid(IMAGE, particles.Rect(0, 0, 50, 40), shape=(4, 5))


@pytest.mark.parametrize(
    ("groups", "held"),
    [
        (["top"], [0, 1, 2, 3, 4]),
        (["bottom"], [15, 16, 17, 18, 19]),
        (["left"], [0, 5, 10, 15]),
        (["right"], [4, 9, 14, 19]),
        (["left", "top"], [0, 1, 2, 3, 4, 5, 10, 15]),
        (["border"], [0, 1, 2, 3, 4, 5, 9, 10, 14, 15, 16, 17, 18, 19]),
        (["contact"], [6, 7, 11, 12]),
        (["bottom", "contact"], [6, 7, 11, 12, 15, 16, 17, 18, 19]),
    ],
)
def test_selects_held_groups(grid: particles.ParticleGrid, groups: list[str], held: list[int]) -> None:
    np.testing.assert_array_equal(particles.select_held(grid, groups, particles.Rect(12, 12, 16, 16)), held)


def test_sides_are_the_outermost_that_exist() -> None:
    mask = np.ones(IMAGE, dtype=bool)
    mask[:10] = False  # no particle in row 0
    mask[:, 40:] = False  # none in the last column
    holed = particles.seed_grid(IMAGE, particles.Rect(0, 0, 50, 40), shape=(4, 5), mask=mask)
    assert holed.cell.min() == 5
    np.testing.assert_array_equal(holed.cell[particles.select_held(holed, ["top"])], [5, 6, 7, 8])
    np.testing.assert_array_equal(holed.cell[particles.select_held(holed, ["right"])], [8, 13, 18])


@pytest.mark.parametrize(
    ("groups", "contact", "said"),
    [
        (["middle"], None, "groups out of top"),
        ([], None, "at least one held"),
        (["contact"], None, "a contact rectangle"),
        (["contact"], particles.Rect(100, 100, 5, 5), "inside the contact"),
        (["contact"], particles.Rect(0, 0, 60, 60), "free particle"),
    ],
)
def test_refuses_to_hold(
    grid: particles.ParticleGrid, groups: list[str], contact: particles.Rect | None, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        particles.select_held(grid, groups, contact)


def test_samples_a_plane_exactly_and_nothing_outside() -> None:
    field = analytic_flow(lambda x, y: (0.1 * x - 0.2 * y, 3 + 0 * x)).flow_px
    values = particles.sample(
        field, np.array([[10.123, 20.456], [0, 0], [199, 119], [199.01, 5], [5, -0.01], [np.nan, 5]])
    )
    np.testing.assert_allclose(values[0], [0.1 * 10.123 - 0.2 * 20.456, 3], rtol=1e-5)
    assert np.isfinite(values[:3]).all()
    assert np.isnan(values[3:]).all()


def test_start_is_the_grid(grid: particles.ParticleGrid) -> None:
    tracked = particles.start(grid)
    np.testing.assert_array_equal(tracked.position_px, grid.rest_px)
    assert tracked.seen.all()
    assert not tracked.noise_px.any()


def test_advects_over_several_steps() -> None:
    # A turn by 2 degrees about the centre, known in closed form; eq. 3.20 applied five times.
    centre, angle = np.array([100.0, 60.0]), np.radians(2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def towards(matrix: Array) -> FlowField:
        a = matrix - np.eye(2)
        return analytic_flow(
            lambda x, y: (a[0, 0] * (x - 100) + a[0, 1] * (y - 60), a[1, 0] * (x - 100) + a[1, 1] * (y - 60))
        )

    grid = particles.seed_grid(IMAGE, particles.Rect(60, 30, 80, 60), shape=(6, 8))
    tracked = particles.start(grid)
    for _ in range(5):
        tracked = particles.advance(tracked, towards(turn), towards(turn.T))
    truth = (grid.rest_px - centre) @ np.linalg.matrix_power(turn, 5).T + centre
    np.testing.assert_allclose(tracked.position_px, truth, atol=1e-4)
    assert tracked.seen.all()
    assert tracked.forward_backward_px.max() < 1e-4
    assert tracked.noise_px.max() < 0.01


def test_what_leaves_the_image_is_lost_for_good(grid: particles.ParticleGrid) -> None:
    tracked = particles.advance(particles.start(grid), constant(-8, 0), constant(8, 0))
    gone = grid.rest_px[:, 0] < 8
    np.testing.assert_array_equal(tracked.seen, ~gone)
    np.testing.assert_array_equal(tracked.position_px[gone], grid.rest_px[gone])
    later = particles.advance(tracked, constant(8, 0), constant(-8, 0))
    np.testing.assert_array_equal(later.seen, ~gone)
    np.testing.assert_array_equal(later.position_px[gone], grid.rest_px[gone])
    np.testing.assert_array_equal(later.noise_px[gone], tracked.noise_px[gone])
    np.testing.assert_allclose(later.position_px[~gone], grid.rest_px[~gone])
    assert np.isnan(later.forward_backward_px[gone]).all()


def test_what_has_no_flow_is_lost(grid: particles.ParticleGrid) -> None:
    flow = constant(1, 1)
    flow.flow_px[:12] = np.nan
    tracked = particles.advance(particles.start(grid), flow, constant(-1, -1))
    np.testing.assert_array_equal(tracked.seen, grid.rest_px[:, 1] > 12)
    assert np.isfinite(tracked.position_px).all()
    assert np.isfinite(tracked.noise_px).all()


def test_what_does_not_come_home_is_lost(grid: particles.ParticleGrid) -> None:
    back = constant(-1, -1)
    back.flow_px[:17, :17] += 2.0
    tracked = particles.advance(particles.start(grid), constant(1, 1), back)
    np.testing.assert_array_equal(np.flatnonzero(~tracked.seen), [0, 1, 5, 6])
    np.testing.assert_allclose(tracked.forward_backward_px[0], np.sqrt(8), rtol=1e-6)


def test_noise_is_read_from_residuals_and_adds_in_quadrature() -> None:
    grid = particles.seed_grid((300, 300), particles.Rect(50, 50, 200, 200), shape=(20, 20))
    rng = np.random.default_rng(0)

    def step(tracked: particles.Tracked) -> particles.Tracked:
        def noisy(d: float) -> FlowField:
            return FlowField((constant(d, 0, (300, 300)).flow_px + rng.normal(0, 0.05, (300, 300, 2))).astype("f4"))

        return particles.advance(tracked, noisy(2.0), noisy(-2.0))

    # Bilinear sampling of independent pixels leaves 4/9 of the variance on average, 1/4 to 1 of it at one place.
    one = step(particles.start(grid))
    assert 0.025 < np.median(one.noise_px) < 0.05
    assert np.median(step(step(step(one))).noise_px) == pytest.approx(2 * np.median(one.noise_px), rel=0.15)


def test_refuses_flows_of_two_sizes(grid: particles.ParticleGrid) -> None:
    with pytest.raises(InputError, match="one size"):
        particles.advance(particles.start(grid), constant(0, 0), constant(0, 0, (50, 50)))


def texture(x: Array, y: Array, seed: int = 0) -> Array:
    """A sum of random cosines of 7 to 40 px around 128, standard deviation 40."""
    rng = np.random.default_rng(seed)
    wave, angle, phase = 2 * np.pi / rng.uniform(7, 40, 90), rng.uniform(0, np.pi, 90), rng.uniform(0, 2 * np.pi, 90)
    out = np.zeros_like(x)
    for kx, ky, p in zip(wave * np.cos(angle), wave * np.sin(angle), phase, strict=True):
        out += np.cos(kx * x + ky * y + p)
    return 128 + 40 * out / np.sqrt(45)


def film(stretch: float, noise: float, seed: int) -> npt.NDArray[np.uint8]:
    """The texture stretched along x by 1 + stretch about x = 110, exact."""
    y, x = np.mgrid[:220, :220].astype(float)
    image = texture((x - 110) / (1 + stretch) + 110, y)
    return np.clip(np.rint(image + np.random.default_rng(seed).normal(0, noise, x.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [1.0, 6.0])
@pytest.mark.parametrize("steps", [(0.002,), slow((0.03, 0.06, 0.09))])
def test_noise_is_honest_on_images(noise: float, steps: tuple[float, ...]) -> None:
    grid = particles.seed_grid((220, 220), particles.Rect(35, 35, 150, 150), shape=(10, 10))
    tracked, last = particles.start(grid), film(0, noise, 0)
    for index, stretch in enumerate(steps):
        image = film(stretch, noise, index + 1)
        tracked, last = particles.advance(tracked, dense_flow(last, image), dense_flow(image, last)), image
    truth = grid.rest_px + np.column_stack([steps[-1] * (grid.rest_px[:, 0] - 110), np.zeros(100)])
    error = np.sqrt(((tracked.position_px - truth) ** 2).mean())
    assert tracked.seen.all()
    assert error < 0.02 * noise**0.5 * len(steps)
    assert 0.4 < error / np.sqrt((tracked.noise_px**2).mean()) < 2.0


@pytest.mark.parametrize("cover", ["noise", "another texture"])
def test_a_covered_patch_is_lost_and_the_rest_is_not(cover: str) -> None:
    before, after = film(0, 2, 0), film(0.02, 2, 1)
    rng = np.random.default_rng(2)
    if cover == "noise":
        after[80:150, 80:150] = rng.integers(0, 256, (70, 70))
    else:
        y, x = np.mgrid[:70, :70].astype(float)
        after[80:150, 80:150] = np.clip(texture(x, y, seed=9), 0, 255).astype(np.uint8)
    grid = particles.seed_grid((220, 220), particles.Rect(20, 20, 180, 180), spacing_px=10)
    tracked = particles.advance(particles.start(grid), dense_flow(before, after), dense_flow(after, before))
    depth = np.abs(grid.rest_px - 114.5).max(axis=1) - 35  # below 0: covered
    assert tracked.seen[depth < -8].mean() < 0.2  # chance likeness: some of another texture fits
    assert tracked.seen[depth > 12].all()
