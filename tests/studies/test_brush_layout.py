"""Bristles stand where a layout says, lean as told, and those that overlap are found."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from bristle.meshes.section import Circle, Rectangle
from bristle.solver.errors import InputError
from bristle.solver.rods.section import half_sides_m
from bristle.studies.brush.inputs import BrushInputs
from bristle.studies.brush.layout import directions, lowest_m, overlapping, stand
from bristle.studies.inputs.choices import Layout
from bristle.studies.inputs.sources import checked

pytestmark = pytest.mark.serial
WIRE = Rectangle()


def standing(layout, count, rows=1, tufts=1, radius_m=0.1, spacing_m=4e-3):
    return stand(layout, count, rows, tufts, radius_m, spacing_m)


def test_rows_lie_across_the_motion_one_behind_the_other():
    places = standing(Layout.ROW, 15, rows=3).place_m.reshape(3, 5, 2)
    np.testing.assert_allclose(np.diff(places[:, :, 1], axis=1), 4e-3)
    np.testing.assert_allclose(np.diff(places[:, :, 0], axis=0), 4e-3)
    np.testing.assert_allclose(places.mean(axis=(0, 1)), 0.0, atol=1e-15)


def test_a_row_that_turns_leans_along_the_circle_of_each_bristle():
    """Either side of the axis moves to the other, and what stands on it as a single one does."""
    stands = {"count": 3, "spacing_m": 0.02, "motion": "rotate:rpm=-10", "mount_angle_deg": 30.0}
    clamps = checked(BrushInputs, {"layout": "row", **stands}).clamps
    moves = np.cross([0.0, 0.0, -1.0], clamps.position_m / 0.02)
    np.testing.assert_allclose(moves, [[-1, 0, 0], [0, 0, 0], [1, 0, 0]], atol=1e-12)
    tips = clamps.rotation[:, :2, 2]
    np.testing.assert_allclose(tips, [[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0]], atol=1e-12)
    slid = checked(BrushInputs, {"layout": "row", **stands, "motion": "slide:speed=1"}).clamps
    np.testing.assert_allclose(slid.rotation[:, :2, 2], [[-0.5, 0.0]] * 3, atol=1e-12)


def test_rings_lie_inside_the_outermost_at_equal_angles():
    stood = standing(Layout.RING, 24, rows=2)
    radii = np.hypot(*stood.place_m.T)
    np.testing.assert_allclose(radii, np.repeat([0.1, 0.096], 12))
    np.testing.assert_allclose(stood.outward * radii[:, None], stood.place_m, atol=1e-15)
    first = stood.place_m[:12] @ [1.0, 1j]
    np.testing.assert_allclose(np.angle(np.roll(first, -1) / first), math.pi / 6.0)


def test_a_cup_has_tufts_alike_that_do_not_meet():
    """Each tuft of 7 is a grid, 3 wide, 3 deep, about its ring; rings stay apart."""
    stood = standing(Layout.CUP, 2 * 10 * 7, rows=2, tufts=10)
    tufts = stood.place_m.reshape(2, 10, 7, 2)
    for ring, radius in enumerate((0.1, 0.1 - 4 * 4e-3)):
        for j in range(10):
            turned = Rotation.from_euler("z", -36.0 * j, degrees=True).as_matrix()[:2, :2]
            local = (tufts[ring, j] @ turned.T - [radius, 0.0]) / 4e-3
            expected = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)][:7]
            np.testing.assert_allclose(local, expected, atol=1e-12)
    outer, inner = np.hypot(*tufts[0].reshape(-1, 2).T), np.hypot(*tufts[1].reshape(-1, 2).T)
    assert outer.min() - inner.max() > 4e-3


@pytest.mark.parametrize(
    ("layout", "values", "says"),
    [
        (Layout.SINGLE, {"count": 2}, "a single bristle is 1"),
        (Layout.ROW, {"count": 10, "rows": 3}, "shared out evenly over 3 rows"),
        (Layout.CUP, {"count": 10, "rows": 3, "tufts": 7}, "shared out evenly over 21 tufts"),
        (Layout.RING, {"count": 30, "rows": 30}, "30 of them, do not fit into a radius of 100 mm"),
        (Layout.RING, {"count": 10, "rows": 3}, "shared out evenly over 3 rings"),
    ],
)
def test_what_cannot_stand_is_refused(layout, values, says):
    with pytest.raises(ValueError, match=says):
        standing(layout, **values)


def one(lean_deg=(0.0, 0.0), flare_deg=0.0, twist_deg=0.0, outward=(0.0, 1.0), forward=(1.0, 0.0)):
    def row(pair):
        return np.array([pair], dtype=float)

    return directions(row(outward), row(forward), row(lean_deg), flare_deg, twist_deg)[0]


@pytest.mark.parametrize("angle", [-35.0, 0.0, 20.0, 60.0])
def test_a_clamp_that_leans_forward_has_its_tip_behind(angle):
    axes = one((angle, 0.0))
    s, c = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    np.testing.assert_allclose(axes[:, 2], [-s, 0.0, -c], atol=1e-15)
    # the thin side faces the motion, the wide side lies across it
    np.testing.assert_allclose(axes[:, 0], [c, 0.0, -s], atol=1e-15)
    np.testing.assert_allclose(axes[:, 1], [0.0, -1.0, 0.0], atol=1e-15)


def test_flare_leans_outward_and_twist_turns_about_the_axis():
    flared = one(flare_deg=25.0)
    assert flared[1, 2] == pytest.approx(math.sin(math.radians(25.0)))
    twisted = one((10.0, 5.0), 25.0, 30.0)
    turn = Rotation.from_matrix(one((10.0, 5.0), 25.0).T @ twisted).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, [0.0, 0.0, 30.0], atol=1e-12)
    np.testing.assert_allclose(twisted.T @ twisted, np.eye(3), atol=1e-14)
    assert np.linalg.det(twisted) == pytest.approx(1.0)


@pytest.mark.parametrize("section", [WIRE, Circle(1e-3)])
def test_the_lowest_point_is_that_of_the_whole_rim(section):
    rotation = Rotation.random(50, rng=2).as_matrix()
    roots, length = np.random.default_rng(3).normal(size=(50, 3)), np.linspace(0.1, 0.3, 50)
    angle = np.linspace(0.0, 2.0 * math.pi, 20_001)
    rim = half_sides_m(section) * np.column_stack([np.cos(angle), np.sin(angle)])
    if section is WIRE:  # from the ellipse to the rectangle around it
        rim = half_sides_m(section) * np.sign(rim)
    ends = roots + length[:, None] * rotation[:, :, 2]
    expected = (ends[:, None] + rim @ np.swapaxes(rotation[:, :, :2], 1, 2))[:, :, 2].min(axis=1)
    np.testing.assert_allclose(lowest_m(section, roots, rotation, length), expected, atol=1e-11)


def meet(section, roots, rotation, length):
    """Whether two boxes have a point in common, by linear programming."""
    rows, bounds = [], []
    for i in range(2):
        low = np.append(np.negative(half_sides_m(section)), 0.0)
        high = np.append(half_sides_m(section), length[i])
        rows += [rotation[i].T, -rotation[i].T]
        bounds += [high + rotation[i].T @ roots[i], -(low + rotation[i].T @ roots[i])]
    found = linprog(np.zeros(3), np.vstack(rows), np.concatenate(bounds), bounds=(None, None))
    return found.status == 0


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_boxes_that_overlap_are_those_with_a_point_in_common(seed):
    """Short thick boxes near each other: about half of them overlap."""
    random = np.random.default_rng(seed)
    section = Rectangle(0.02, 0.05)
    rotation = Rotation.random(2, rng=random).as_matrix()
    length, roots = random.uniform(0.05, 0.2, 2), 0.03 * random.normal(size=(2, 3))
    found = overlapping(section, roots, rotation, length)
    assert (found == (0, 1)) == meet(section, roots, rotation, length)


def test_parallel_bristles_overlap_from_their_width_on():
    axes, length = np.tile(np.diag([1.0, -1.0, -1.0]), (3, 1, 1)), np.full(3, 0.3)
    for apart, expected in ((2.07e-3, (0, 1)), (2.09e-3, None)):
        roots = np.array([[0.0, 0.0, 0.0], [0.0, apart, 0.0], [0.0, 2.0 * apart, 0.0]])
        assert overlapping(WIRE, roots, axes, length) == expected


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motion": "rotate:rpm=1e5"}, r"turns at 1\.05e\+04 rad/s; 10000 is the most"),
        ({"motion": "slide:speed=-101"}, "moves a clamp at 101 m/s; 100 is the most"),
        ({"motion": "rotate:rpm=1e4", "layout": "ring", "count": 3}, "moves a clamp at 105 m/s"),
    ],
)
def test_a_hub_that_moves_too_fast_is_refused(given, said):
    with pytest.raises(InputError, match=said):
        checked(BrushInputs, given)


def test_a_bristle_on_the_axis_may_turn_as_fast_as_none_on_a_ring():
    assert checked(BrushInputs, {"motion": "rotate:rpm=1e4"}).motion.rpm == 1e4
    near = {"layout": "row", "count": 2, "spacing_m": 4e-3}
    assert checked(BrushInputs, {**near, "motion": "rotate:rpm=-2e4"}).count == 2


def test_only_bristles_that_touch_may_not_overlap_at_the_start():
    """Leans of some degrees cross two neighbours of this length."""
    crossed = {"layout": "row", "count": 40, "angle_std_deg": 5.0}
    with pytest.raises(InputError, match="overlap at the start"):
        checked(BrushInputs, crossed)
    assert checked(BrushInputs, {**crossed, "touch_each_other": False}).count == 40
