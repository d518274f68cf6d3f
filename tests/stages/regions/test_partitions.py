"""Random maps: what they may look like, that blur is blur, that moves leave the prior alone."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from deformscope.stages.regions import partitions
from deformscope.stages.regions.touches import MapGrid
from tests.cases import slow_but

SIZE = (0.6, 0.4)


@pytest.mark.parametrize("regions", [2, 3])
def test_every_region_of_a_prior_map_is_large_enough_to_be_touched(regions: int) -> None:
    maps = partitions.draw(np.random.default_rng(0), regions, SIZE, 300)
    grid = MapGrid(SIZE)
    labels = maps.labels(grid.centres_m)
    assert len(maps) == 300
    areas = np.stack([(labels == region).sum(axis=1) for region in range(regions)]) * grid.cell_m**2
    assert areas.sum(axis=0) == pytest.approx(SIZE[0] * SIZE[1])
    assert areas.min() > 0.5 * partitions.LEAST_AREA_M2  # counted in coarse cells


def test_the_same_seed_gives_the_same_maps() -> None:
    first, again = (partitions.draw(np.random.default_rng(5), 3, SIZE, 50) for _ in range(2))
    np.testing.assert_array_equal(first.latent, again.latent)
    np.testing.assert_array_equal(first.family, again.family)


@pytest.mark.parametrize("regions", slow_but([2], [2, 3, 4, 5]))
def test_a_contact_s_shares_are_the_map_blurred(regions: int) -> None:
    """Against a Gaussian filter of the labels; the shares take each curve as straight within the blur."""
    maps = partitions.draw(np.random.default_rng(1), regions, SIZE, 200)
    grid, blur = MapGrid(SIZE, 0.0025), 0.012
    labels = maps.labels(grid.centres_m).reshape(-1, *grid.shape)
    rows, columns = np.meshgrid(np.arange(16, 145, 16), np.arange(16, 225, 16), indexing="ij")
    places = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * grid.cell_m
    shares = maps.shares(places, blur)
    assert shares.sum(axis=-1) == pytest.approx(1.0)
    off = []
    for number, one in enumerate(labels):
        for region in range(regions):
            felt = gaussian_filter((one == region).astype(float), blur / grid.cell_m, mode="nearest")
            off.append(np.abs(shares[number, :, region] - felt[rows.ravel(), columns.ravel()]))
    assert np.mean(off) < 0.01
    assert np.quantile(off, 0.98) < 0.15


@pytest.mark.parametrize("family", list(partitions.Family))
def test_distance_is_zero_where_the_label_changes_and_has_its_length_near_by(family: partitions.Family) -> None:
    latent = np.random.default_rng(2).standard_normal((40, 2, partitions.LATENTS))
    maps = partitions.Partitions(
        2, SIZE, np.full((40, 2), family), latent, np.zeros(40, dtype=bool), np.tile([0, 1], (40, 1))
    )
    maps = maps.take(maps.admissible())
    y = np.full(2401, 0.21)
    line = np.column_stack([np.linspace(0.0, 0.6, 2401), y])
    first = maps.labels(line) == 0
    distance = maps._distance(0, line)
    np.testing.assert_array_equal(distance > 0.0, first)
    at_change = (np.diff(first, axis=1) != 0) & (np.abs(distance[:, 1:]) < 0.05)
    # one grid step from a change the distance is not more than about a step (rays of blobs are longer than normals)
    assert np.quantile(np.abs(distance[:, 1:])[at_change], 0.95) < 6e-4


@pytest.mark.parametrize("regions", slow_but([2], [2, 4]))
def test_moves_leave_the_prior_as_it_is(regions: int) -> None:
    rng = np.random.default_rng(3)
    maps = partitions.draw(rng, regions, SIZE, 3000)
    area = (maps.labels(MapGrid(SIZE, 0.02).centres_m) == 0).mean(axis=1)
    for _ in range(12):
        proposed = partitions.propose(rng, maps)
        maps = maps.instead(proposed.admissible(), proposed)
    moved = (maps.labels(MapGrid(SIZE, 0.02).centres_m) == 0).mean(axis=1)
    shares = np.bincount(maps.family[:, 0], minlength=len(partitions.Family)) / 3000
    fresh = np.bincount(partitions.draw(rng, regions, SIZE, 6000).family[:, 0], minlength=len(partitions.Family)) / 6000
    np.testing.assert_allclose(shares, fresh, atol=0.04)
    np.testing.assert_allclose(np.quantile(moved, [0.1, 0.5, 0.9]), np.quantile(area, [0.1, 0.5, 0.9]), atol=0.05)
    assert np.mean(np.abs(moved - area) > 1e-3) > 0.7  # and they do move


def test_a_ring_has_its_blob_s_border_and_a_hole() -> None:
    """The same numbers as another family: the blob less its middle."""
    latent = np.random.default_rng(4).standard_normal((40, 2, partitions.LATENTS))
    grid = MapGrid(SIZE, 0.005)
    blob, ring = (
        partitions.Partitions(
            2, SIZE, np.full((40, 2), family), latent, np.zeros(40, dtype=bool), np.tile([0, 1], (40, 1))
        ).labels(grid.centres_m)
        == 0
        for family in (partitions.Family.BLOB, partitions.Family.RING)
    )
    assert (blob | ~ring).all()
    middle = ndtr(latent[:, 0, :2]) * SIZE
    here = np.hypot(*(grid.centres_m - middle[:, None]).transpose(2, 0, 1)).argmin(axis=1)
    assert not ring[np.arange(40), here].any()
    shares = ring.sum(axis=1) / blob.sum(axis=1)
    whole = (np.minimum(middle, np.asarray(SIZE) - middle) > 0.1).all(axis=1) & (latent[:, 0, 2] < 0.0)
    # what is left of a disc whose radius shrinks by a quarter to three quarters
    assert shares[whole].min() > 1.0 - 0.76**2
    assert shares[whole].max() < 1.0 - 0.24**2


def test_a_zigzag_turns_at_its_points() -> None:
    """Along its line the border runs straight, up and down, by two amplitudes within half a wave."""
    latent = np.zeros((1, 2, partitions.LATENTS))
    latent[0, 0, 1] = 1.0  # the line runs along y, through the middle
    zigzag = partitions.Partitions(
        2, SIZE, np.full((1, 2), partitions.Family.ZIGZAG), latent, np.zeros(1, dtype=bool), np.array([[0, 1]])
    )
    grid = MapGrid(SIZE, 0.002)
    border = (zigzag.labels(grid.centres_m)[0].reshape(grid.shape) == 1).sum(axis=1) * grid.cell_m
    height, length = np.sqrt(np.prod(partitions.ZIGZAG_M)), np.sqrt(np.prod(partitions.ZIGZAG_LENGTH_M))
    assert np.ptp(border) == pytest.approx(2.0 * height, abs=0.004)
    rise = np.abs(border[10:] - border[:-10]) / 0.02
    assert np.median(rise) == pytest.approx(4.0 * height / length, rel=0.1)
