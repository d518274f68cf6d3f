"""The depth camera: known planes to the pixel, steps, noise, what is missing, and what a robot hides."""

import numpy as np
import open3d as o3d
import pytest

from deformscope.arrays import BoolArray, FloatArray
from deformscope.errors import InputError
from deformscope.lab.depth_view import DepthView
from deformscope.lab.ray_camera import FOAM, NOTHING, ROBOT, TABLE, DepthViewConfig
from deformscope.lab.scenes import built_in
from deformscope.lab.slab import RigidTip
from deformscope.lab.slab_world import SlabWorld
from deformscope.solid import Capsule, PosedSolid, Solid

SMALL = DepthViewConfig(width=320, height=240)
FLAT = built_in("two-60-150", 1)


@pytest.fixture(scope="module")
def view() -> DepthView:
    return DepthView(FLAT, SMALL)


def meets(capsule: Capsule, eye: FloatArray, rays: FloatArray) -> BoolArray:
    """(...,) which rays come within the radius of a segment. Squared distance to a ray is a parabola along it."""
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    start, axis = capsule.start_m - eye, capsule.end_m - capsule.start_m
    aside = [one - (unit @ one)[..., None] * unit for one in (start, axis)]
    steep = np.maximum((aside[1] ** 2).sum(axis=-1), 1e-30)
    share = np.clip(-(aside[0] * aside[1]).sum(axis=-1) / steep, 0.0, 1.0)
    return np.asarray(((aside[0] + share[..., None] * aside[1]) ** 2).sum(axis=-1) < capsule.radius_m**2)


def test_planes_are_where_they_are(view: DepthView) -> None:
    """Every pixel of foam seen from above lies on the slab's upper side or its walls, every one of the table at 0."""
    exact = view.render()
    place = view.points_m(exact.depth_m)
    np.testing.assert_allclose(place[exact.seen == TABLE][:, 2], 0.0, atol=2e-6)
    foam = place[exact.seen == FOAM]
    upper = foam[:, 2] > 0.0499
    np.testing.assert_allclose(foam[upper][:, 2], 0.05, atol=2e-6)
    np.testing.assert_allclose(foam[~upper][:, 1], 0.4, atol=2e-6)
    assert ((foam > -1e-5) & (foam < [0.60001, 0.40001, 0.05001])).all()
    assert np.isnan(exact.depth_m[exact.seen == NOTHING]).all()


def test_it_looks_at_the_middle_from_80_cm_at_45_degrees(view: DepthView) -> None:
    middle = np.array([0.3, 0.2, 0.05])
    eye = view.T_world_camera[:3, 3]
    assert np.linalg.norm(eye - middle) == pytest.approx(0.8)
    assert eye[2] - 0.05 == pytest.approx(0.8 * np.sin(np.pi / 4))
    np.testing.assert_allclose(view.pixels(middle[None]), [[159.5, 119.5]])
    assert view.intrinsics.fx_px == 285.0
    turn = view.T_world_camera[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert turn[2, 1] < 0.0, "y is down in the image"


def test_corners_appear_where_they_project(view: DepthView) -> None:
    """The upper side's pixels are those inside the four corners' quadrilateral, to a pixel."""
    exact = view.render()
    corner = view.pixels(np.array([[0, 0, 0.05], [0.6, 0, 0.05], [0.6, 0.4, 0.05], [0, 0.4, 0.05]]))
    row, column = np.mgrid[0:240, 0:320]
    inside = np.full(row.shape, np.inf)
    for a, b in zip(corner, np.roll(corner, 1, axis=0), strict=True):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
        inside = np.minimum(inside, (column - a[0]) * normal[0] + (row - a[1]) * normal[1])
    assert (inside > 1.0).sum() > 10_000
    upper = (exact.seen == FOAM) & (np.nan_to_num(view.points_m(exact.depth_m)[..., 2]) > 0.0499)
    assert upper[inside > 1.0].all()
    assert not upper[inside < -1.0].any()


def test_pixels_and_points_are_inverse(view: DepthView) -> None:
    exact = view.render()
    row, column = np.array([40, 120, 200]), np.array([300, 160, 20])
    place = view.points_m(exact.depth_m)[row, column]
    np.testing.assert_allclose(view.pixels(place), np.column_stack([column, row]), atol=1e-6)


def test_a_dent_is_seen_as_deep_as_it_is(view: DepthView) -> None:
    world = SlabWorld(FLAT)
    contact = world.press(RigidTip(radius=0.01), np.array([0.31, 0.22, 0.06 - 0.006]))
    exact = view.render(world.displaced_m(contact, view.places_m))
    foam = exact.seen == FOAM
    place = view.points_m(exact.depth_m)[foam]
    place = place[place[:, 1] < 0.399]
    assert place[:, 2].min() == pytest.approx(0.044, abs=3e-4)
    aside = np.linalg.norm(place[:, :2] - contact.center_m[:2], axis=1)
    ring = (aside > 0.019) & (aside < 0.021)
    around = contact.center_m[:2] + 0.02 * np.column_stack([np.cos(np.arange(9.0)), np.sin(np.arange(9.0))])
    expected = world.displaced_m(contact, around)[:, 2].mean()
    assert (place[ring, 2] - 0.05).mean() == pytest.approx(expected, rel=0.1)
    still = view.render()
    assert view.points_m(still.depth_m)[still.seen == FOAM][:, 2].min() >= 0.0
    np.testing.assert_array_equal(exact.depth_m[exact.seen == TABLE], still.depth_m[exact.seen == TABLE])


def test_what_has_not_moved_need_not_be_cast_again(view: DepthView) -> None:
    """A dent cast by itself into the picture at rest is the picture of the whole dented slab."""
    world = SlabWorld(FLAT)
    contact = world.press(RigidTip(radius=0.01), np.array([0.25, 0.2, 0.06 - 0.008]))
    displaced = world.displaced_m(contact, view.places_m)
    part, whole = view.render(displaced), view._all(view._rest + displaced)
    np.testing.assert_array_equal(part.seen, whole.seen)
    np.testing.assert_allclose(part.depth_m, whole.depth_m, atol=1.5e-5)
    assert np.nanmax(np.abs(part.depth_m - view.render().depth_m)) > 0.005


def test_a_dent_at_the_slabs_edge_moves_its_wall(view: DepthView) -> None:
    world = SlabWorld(FLAT)
    contact = world.press(RigidTip(radius=0.01), np.array([0.3, 0.395, 0.06 - 0.006]))
    still, dented = view.render(), view.render(world.displaced_m(contact, view.places_m))
    np.testing.assert_array_equal(dented.seen, still.seen)
    assert view.points_m(still.depth_m)[still.seen == FOAM][:, 1].max() < 0.40001
    assert view.points_m(dented.depth_m)[still.seen == FOAM][:, 1].max() > 0.4001


CAPSULES = [
    Capsule(np.array([0.3, 0.2, 0.06]), np.array([0.3, 0.2, 0.16]), 0.008),
    Capsule(np.array([0.1, 0.3, 0.2]), np.array([0.45, -0.1, 0.4]), 0.04),
    Capsule(np.array([0.2, 0.25, 0.1]), np.array([0.2, 0.25, 0.1]), 0.03),
    Capsule(np.array([-0.3, 0.5, 0.5]), np.array([0.2, 0.6, 0.3]), 0.03),
]


@pytest.mark.parametrize("capsule", CAPSULES, ids=["stick", "link", "ball", "past the picture's edge"])
def test_a_capsule_hides_exactly_what_is_behind_it(view: DepthView, capsule: Capsule) -> None:
    still, hidden = view.render(), view.render(None, [capsule])
    eye = view.T_world_camera[:3, 3]
    rays = view.points_m(np.ones((240, 320))) - eye
    expected = meets(capsule, eye, rays)
    assert 20 < expected.sum() < 40_000
    np.testing.assert_array_equal(hidden.seen == ROBOT, expected)
    np.testing.assert_array_equal(hidden.depth_m[~expected], still.depth_m[~expected])
    surface = view.points_m(hidden.depth_m)[expected]
    share = (surface - capsule.start_m) @ (capsule.end_m - capsule.start_m)
    share = np.clip(share / max(float(((capsule.end_m - capsule.start_m) ** 2).sum()), 1e-12), 0.0, 1.0)
    middle = capsule.start_m + share[:, None] * (capsule.end_m - capsule.start_m)
    np.testing.assert_allclose(np.linalg.norm(surface - middle, axis=1), capsule.radius_m, rtol=1e-9)


def test_what_is_below_the_table_hides_nothing(view: DepthView) -> None:
    below = Capsule(np.array([0.2, 0.2, -0.1]), np.array([0.4, 0.2, -0.1]), 0.05)
    np.testing.assert_array_equal(view.render(None, [below]).depth_m, view.render().depth_m)


def test_the_nearer_of_two_is_seen(view: DepthView) -> None:
    both = view.render(None, CAPSULES[:2]).depth_m
    one, other = (view.render(None, [capsule]).depth_m for capsule in CAPSULES[:2])
    np.testing.assert_array_equal(both, np.fmin(one, other))


def test_colour_gives_no_region_away(view: DepthView) -> None:
    """The two foams' upper sides look alike."""
    exact = view.render()
    place = view.points_m(exact.depth_m)
    upper = (exact.seen == FOAM) & (place[..., 2] > 0.0499)
    column = np.flatnonzero(upper[120])
    assert set(FLAT.label(place[120, column, :2])) == {0, 1}
    row = exact.color[120, column].astype(int)
    assert np.abs(np.diff(row, axis=0)).max() <= 1
    assert (np.abs(exact.color[~upper].astype(int) - row[0]).max(axis=-1) > 20).mean() > 0.9


def test_displacements_of_another_grid_are_refused(view: DepthView) -> None:
    with pytest.raises(InputError, match="places_m"):
        view.render(np.zeros((3, 3)))


def test_solids_are_seen_where_they_are_nearer(view: DepthView) -> None:
    """A box that stands on the slab: its top is seen as far as it is high."""
    made = o3d.geometry.TriangleMesh.create_box(0.1, 0.1, 0.04)
    box = Solid(np.asarray(made.vertices), np.asarray(made.triangles))
    corner = np.eye(4)
    corner[:3, 3] = (0.25, 0.15, FLAT.thickness_m)
    still, hidden = view.render(), view.render(None, (), [PosedSolid(corner, box)])
    there = hidden.seen == ROBOT
    np.testing.assert_array_equal(hidden.depth_m[~there], still.depth_m[~there])
    places = view.points_m(hidden.depth_m)[there] - corner[:3, 3]
    top, front = np.abs(places[:, 2] - 0.04) < 1e-6, np.abs(places[:, 1] - 0.1) < 1e-6  # the camera stands at +y
    assert (top | front).all()
    assert top.any()
    assert front.any()
    assert (places[:, :2] > -1e-6).all()
    assert (places[:, :2] < 0.1 + 1e-6).all()
