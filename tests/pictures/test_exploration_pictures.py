"""Maps as pictures: crisp, in the right place, and with words where there is nothing to draw."""

import dataclasses
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from deformscope.arrays import ImageArray
from deformscope.images import decode_image
from deformscope.pictures import exploration as pictures
from deformscope.pictures.figures import canvas
from deformscope.stages.map.exploration import MapEstimate
from tests.log import synthetic_exploration as synthetic

MAPS = synthetic.maps(6)
COLOR_MAPS = dict(
    zip(pictures.FIELDS, (pictures.STIFFNESS, pictures.DEVIATION, pictures.BETA, pictures.DEVIATION), strict=True)
)


def decoded(png: bytes) -> ImageArray:
    return decode_image(png, "picture")


def share_of(color: str, image: ImageArray) -> float:
    """Of the picture's pixels: those of this colour."""
    wanted = np.rint(np.array(to_rgb(color)) * 255)
    return float((np.abs(image.astype(float) - wanted).max(axis=2) <= 2).mean())


def map_png(quantity: str, maps: MapEstimate) -> bytes:
    return pictures.draw_map(quantity, maps).png


@pytest.mark.parametrize("quantity", pictures.FIELDS)
def test_a_map_has_the_values_and_the_colours_of_its_picture(quantity: str) -> None:
    """Each cell's colour is in the picture, and is the one of its value on the colour bar's scale."""
    drawn = pictures.draw_map(quantity, dataclasses.replace(MAPS, contacts_m=np.zeros((0, 2))))
    expected = {
        "stiffness": MAPS.stiffness_n_per_mm,
        "stiffness_deviation": 100.0 * np.expm1(MAPS.stiffness_log_sd),
        "beta": MAPS.beta,
        "beta_deviation": MAPS.beta_sd,
    }[quantity]
    assert expected is not None
    np.testing.assert_array_equal(drawn.values, expected)
    every = {tuple(one) for one in decoded(drawn.png).reshape(-1, 3).tolist()}
    assert {tuple(one) for one in drawn.colors.reshape(-1, 3).tolist()} <= every
    order = np.argsort(drawn.values, axis=None)
    scale = [mpl.colormaps[COLOR_MAPS[quantity]](index, bytes=True)[:3] for index in range(256)]
    place = [
        next(i for i, one in enumerate(scale) if one == tuple(c)) for c in drawn.colors.reshape(-1, 3)[order[::97]]
    ]
    assert place == sorted(place)
    assert place[-1] > place[0]


def test_what_is_no_field_has_no_values() -> None:
    assert not pictures.draw_map("regions", MAPS).values.size
    assert not pictures.draw_map("beta", dataclasses.replace(MAPS, beta=None)).values.size


def test_cells_are_crisp() -> None:
    """A map of two values has two colours and none between them: its cells are not blurred."""
    bare = dataclasses.replace(MAPS, contacts_m=np.zeros((0, 2)))
    checks = np.where((np.indices(MAPS.labels.shape) // 10).sum(axis=0) % 2, 0.5, 1.0)
    image = decoded(map_png("stiffness", dataclasses.replace(bare, stiffness_n_per_mm=checks)))
    height, width = image.shape[:2]
    inside = image[height * 2 // 5 : height * 3 // 5, width // 4 : width // 2].reshape(-1, 3)
    assert len(np.unique(inside, axis=0)) == 2


def test_up_is_up_and_right_is_right() -> None:
    """Stiff where x and y are large: bright in the picture's upper right corner of the map."""
    bare = dataclasses.replace(MAPS, contacts_m=np.zeros((0, 2)))
    corner = np.where((synthetic.X > 0.4) & (synthetic.Y > 0.3), 1.0, 0.5)
    image = decoded(map_png("stiffness", dataclasses.replace(bare, stiffness_n_per_mm=corner))).astype(int)
    height, width = image.shape[:2]
    left, bottom, wide, high = pictures.PLACE
    columns = [round(width * (left + share * wide)) for share in (0.05, 0.95)]
    rows = [round(height * (1 - bottom - share * high)) for share in (0.15, 0.85)]
    seen = [[image[row, column].sum() for column in columns] for row in rows]
    assert seen[1][1] > 1.3 * max(seen[0][0], seen[0][1], seen[1][0])


def test_the_truth_has_the_colours_of_the_regions_that_it_is_compared_with() -> None:
    """Labels are names: renaming the truth's changes nothing, and a region that was missed has its own colour."""
    png = map_png("truth", MAPS)
    assert map_png("truth", dataclasses.replace(MAPS, truth_labels=7 - 3 * synthetic.TRUTH)) == png
    missed = synthetic.TRUTH.copy()
    missed[:20, :20] = 2
    found = decoded(map_png("truth", dataclasses.replace(MAPS, truth_labels=missed)))
    shares = [share_of(color, found) for color in pictures.REGIONS[:4]]
    assert min(shares[:3]) > 0.01
    assert shares[3] == 0.0


def test_unsure_cells_are_pale() -> None:
    sure = decoded(map_png("regions", dataclasses.replace(MAPS, label_probability=np.ones(MAPS.labels.shape))))
    unsure = decoded(map_png("regions", dataclasses.replace(MAPS, label_probability=np.full(MAPS.labels.shape, 0.5))))
    assert share_of(pictures.REGIONS[0], sure) > 0.1
    assert share_of(pictures.REGIONS[0], unsure) < 0.001
    assert unsure.mean() > sure.mean()


@pytest.mark.parametrize("corner", [(0, 0), (-1, -1)])
def test_regions_have_the_numbers_of_the_terminal_within_the_map(corner: tuple[int, int]) -> None:
    maps = synthetic.maps(2)
    labels = np.zeros_like(maps.labels)
    rows, columns = (slice(None, 3) if end == 0 else slice(-3, None) for end in corner)
    labels[rows, columns] = 1
    axes = canvas(4.4, 3.3).add_axes((0.12, 0.12, 0.7, 0.69))
    pictures.draw_regions(axes, dataclasses.replace(maps, labels=labels))
    shown = [text for text in axes.texts if text.get_text().startswith("region")]
    assert [text.get_text().split("\n")[0] for text in shown] == ["region 1", "region 2"]
    around = axes.get_window_extent()
    for text in shown:
        drawn = text.get_window_extent()
        assert (drawn.min >= around.min - 1.0).all()
        assert (drawn.max <= around.max + 1.0).all()


@pytest.mark.parametrize("seed", range(6))
def test_labels_of_regions_leave_the_numbers_of_touches_free(seed: int) -> None:
    maps = synthetic.maps(2)
    size = maps.cell_m * np.array(maps.labels.shape)[::-1]
    contacts = np.random.default_rng(seed).uniform(0.1, 0.9, (14, 2)) * size
    axes = canvas(4.4, 3.3).add_axes((0.12, 0.12, 0.7, 0.69))
    pictures.draw_regions(axes, dataclasses.replace(maps, contacts_m=contacts))
    boxes = {one.get_text(): one.get_window_extent() for one in axes.texts}
    labels = [box for words, box in boxes.items() if words.startswith("region ")]
    numbers = [box for words, box in boxes.items() if words.isdigit()]
    assert len(labels) == maps.region_count
    assert len(numbers) == len(contacts)
    assert [1 for one in labels for other in (*numbers, *labels) if other is not one and one.overlaps(other)] == []


def test_cells_that_may_not_be_touched_are_grey_and_the_target_red() -> None:
    plan = synthetic.plan(3)
    image = decoded(pictures.gain_png(plan, synthetic.CELL_M, synthetic.CONTACTS_M[:3]))
    free = dataclasses.replace(plan, excluded=np.zeros_like(plan.excluded))
    assert share_of(pictures.EXCLUDED, image) > 0.02
    assert share_of(pictures.EXCLUDED, decoded(pictures.gain_png(free, synthetic.CELL_M))) < 0.001
    assert share_of(pictures.TARGET, image) > 0.0005
    assert share_of(pictures.TARGET, decoded(pictures.gain_png(synthetic.plan(8), synthetic.CELL_M))) == 0.0


def test_every_picture_is_drawn_whatever_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Warnings are errors, so that what cannot be drawn is noticed."""
    monkeypatch.setattr(pictures, "DPI", 50)
    first = synthetic.maps(1, truth=False)
    empty = dataclasses.replace(first, contacts_m=np.zeros((0, 2)), touches=0)
    flat = dataclasses.replace(first, stiffness_n_per_mm=np.full(first.labels.shape, 2.0))
    holed = dataclasses.replace(MAPS, stiffness_n_per_mm=np.full(first.labels.shape, np.nan))
    gradual = synthetic.gradual(6)
    assert decoded(pictures.result_png(first, "made up")).std() > 10
    for maps in (empty, flat, holed, gradual):
        for quantity in ("stiffness", "regions", "truth"):
            assert decoded(map_png(quantity, maps)).std() > 10
    for number, touch in enumerate((synthetic.touch(0), synthetic.rigid_touch(1), synthetic.unusable_touch(2))):
        assert decoded(pictures.force_png(touch)).std() > 10, number
        assert decoded(pictures.section_png(touch)).std() > 10, number
    none = np.zeros((0, 3))
    unseen = dataclasses.replace(synthetic.unusable_touch(2), observed_m=none, simulated_m=none)
    assert decoded(pictures.section_png(unseen)).std() > 5
    assert share_of(pictures.REGIONS[0], decoded(map_png("regions", gradual))) == 0.0
    nowhere = dataclasses.replace(synthetic.plan(2), excluded=np.ones_like(synthetic.plan(2).excluded))
    flat_gain = dataclasses.replace(synthetic.plan(2), gain=np.zeros_like(nowhere.excluded, dtype=np.float64))
    for plan in (synthetic.plan(0), nowhere, flat_gain):
        assert decoded(pictures.gain_png(plan, synthetic.CELL_M)).std() > 10
    assert decoded(pictures.height_png(synthetic.surface(1))).std() > 10


@pytest.mark.parametrize("ends", [(0.62, 1.35), (0.011, 25.0), (2.0, 2.0), (1.0, 10.0), (0.999, 1.001)])
def test_a_scale_holds_its_values_and_ends_at_round_ones(ends: tuple[float, float]) -> None:
    low, high = pictures.stiffness_range(np.array([ends]))
    assert low <= ends[0] <= ends[1] <= high
    assert low < high
    for end in (low, high):
        digits = end / 10 ** np.floor(np.log10(end) + 1e-9)
        assert min(abs(digits - step) for step in pictures.STEPS) < 1e-9


def test_lumps_are_drawn_where_they_are_and_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "DPI", 50)
    none, two = synthetic.lumps(truth=False), synthetic.lumps((0.2, 0.1, 0.02), (0.45, 0.3, 0.03))
    plain, shown, missed = map(
        decoded, (pictures.inclusions_png(none), pictures.inclusions_png(two), pictures.miss_probability_png(two))
    )
    assert not np.array_equal(plain, shown)
    assert missed.std() > 10
    assert decoded(pictures.result_png(MAPS, "Lumps", two)).std() > 10
    words = dict(two.rows)
    assert words["inclusion 1"].startswith("stiff, its middle at (20.0, 10.0) cm")
    assert "deeper than 1.25 cm" in words["inclusion 1"]
    assert words["inclusion 2"].startswith("soft")
    assert "cannot be determined" in words["inclusion 2"]
    assert "found, 0.0 cm off" in words["true inclusion"]
    assert "0.5 before any touch" in dict(none.rows)["an inclusion missed"]


def test_a_result_says_its_touches_and_its_travel(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(pictures, "png_of", lambda figure, _: said.extend(one.get_text() for one in figure.texts))
    pictures.result_png(MAPS, "Two foams")
    assert said[0] == "Two foams"
    assert said[1].startswith("6 touches, ")
    assert said[1].endswith(f"travel {MAPS.travel_m:.2f} m over the surface")


def test_a_result_is_one_picture_the_same_each_time(tmp_path: Path) -> None:
    png = pictures.result_png(MAPS, "Two foams")
    assert png == pictures.result_png(MAPS, "Two foams")
    image = decoded(png)
    assert image.shape[1] > 1.5 * image.shape[0]
