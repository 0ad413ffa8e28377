"""Each tip shape stands back from its lowest place as its closed form says."""

import math

import numpy as np
import pytest

from bristle.meshes.section import Circle, Rectangle
from bristle.meshes.tip_shape import (
    Chamfer,
    Flat,
    Rounded,
    Worn,
    edge_distance_m,
    parse_tip_shape,
)

pytestmark = pytest.mark.serial

FLAT_WIRE, WIRE = Rectangle(0.5e-3, 2.08e-3), Circle(0.8e-3)
SHAPES = [
    Flat(),
    Chamfer(5e-5, 45.0),
    Chamfer(2.5e-4, 20.0),
    Rounded(1e-4),
    Rounded(2.5e-4),
    Worn(0.0),
    Worn(5.0, 0.0),
    Worn(12.0, 250.0),
]


def grid(section, n=81):
    """Points over the section, its edge included."""
    s = np.linspace(-1, 1, n)
    u, v = (a.ravel() for a in np.meshgrid(s, s))
    if isinstance(section, Circle):
        radius, angle = (1 + u) / 2 * section.diameter_m / 2, math.pi * v
        return radius * np.cos(angle), radius * np.sin(angle)
    return u * section.thickness_m / 2, v * section.width_m / 2


@pytest.mark.parametrize("section", [FLAT_WIRE, WIRE], ids=["rectangle", "wire"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_lowest_place_is_at_nought_and_nothing_is_below(shape, section):
    offset = shape.offset_m(*grid(section), section)
    assert offset.shape == (81 * 81,)
    assert offset.min() >= 0.0
    # The lowest edge of a wire worn toward 250° falls between two points of the grid.
    assert offset.min() == pytest.approx(0.0, abs=2e-7)
    assert np.isfinite(offset).all()


@pytest.mark.parametrize("section", [FLAT_WIRE, WIRE], ids=["rectangle", "wire"])
@pytest.mark.parametrize("shape", [s for s in SHAPES if not isinstance(s, Worn)], ids=str)
def test_edges_stand_back_more_the_nearer_they_are(shape, section):
    x, y = grid(section)
    inward = np.argsort(edge_distance_m(x, y, section))
    offset = shape.offset_m(x, y, section)[inward]
    assert (np.diff(offset) <= 1e-18).all()


def test_edge_distance_is_the_nearest_of_all_edges():
    assert edge_distance_m([0.0, 0.2e-3, 0.0], [0.0, 0.0, 1e-3], FLAT_WIRE) == pytest.approx(
        [0.25e-3, 0.05e-3, 0.04e-3]
    )
    assert edge_distance_m([0.3e-3], [0.0], WIRE) == pytest.approx([0.1e-3])


def test_closed_forms():
    x, y = np.array([0.0, 0.21e-3, 0.25e-3]), np.zeros(3)
    chamfer = Chamfer(50e-6, 30.0).offset_m(x, y, FLAT_WIRE)
    assert chamfer == pytest.approx(np.array([0.0, 10e-6, 50e-6]) * math.tan(math.pi / 6))
    rounded = Rounded(50e-6).offset_m(x, y, FLAT_WIRE)
    assert rounded == pytest.approx([0.0, 50e-6 - math.sqrt(50e-6**2 - 10e-6**2), 50e-6])
    # A wire rounded by its radius is a half sphere.
    x, y = grid(WIRE)
    sphere = 0.4e-3 - np.sqrt(np.maximum(0.4e-3**2 - x**2 - y**2, 0.0))
    assert Rounded(0.4e-3).offset_m(x, y, WIRE) == pytest.approx(sphere, abs=1e-11)
    # A chamfer of the whole radius is a cone.
    cone = Chamfer(0.4e-3, 60.0).offset_m(x, y, WIRE)
    assert cone == pytest.approx(np.hypot(x, y) * math.tan(math.pi / 3), abs=1e-15)


@pytest.mark.parametrize("section", [FLAT_WIRE, WIRE], ids=["rectangle", "wire"])
@pytest.mark.parametrize("direction", [0.0, 90.0, 137.0, -45.0])
def test_worn_face_is_a_plane_of_its_slope_and_direction(section, direction):
    x, y = grid(section)
    offset = Worn(7.0, direction).offset_m(x, y, section)
    terms = np.column_stack([np.ones_like(x), x, y])
    plane, residual, *_ = np.linalg.lstsq(terms, offset, rcond=None)
    assert residual == pytest.approx(0.0, abs=1e-20)
    angle = math.radians(direction)
    slope = math.tan(math.radians(7.0))
    assert plane[1:] == pytest.approx([slope * math.cos(angle), slope * math.sin(angle)])
    assert offset.max() == pytest.approx(2 * plane[0], rel=1e-3)  # as high above the axis as below


def test_worn_toward_x_is_lowest_on_the_whole_opposite_edge():
    edge = Worn(5.0).offset_m(np.full(3, -0.25e-3), [-1.04e-3, 0.0, 1.04e-3], FLAT_WIRE)
    assert edge == pytest.approx(np.zeros(3), abs=1e-18)
    assert Worn(5.0).offset_m([0.25e-3], [0.0], FLAT_WIRE) == pytest.approx(
        [0.5e-3 * math.tan(math.radians(5.0))]
    )


@pytest.mark.parametrize(
    ("text", "shape"),
    [
        ("flat", Flat()),
        ("chamfer:width=5e-5,angle=30", Chamfer(5e-5, 30.0)),
        (" chamfer: width = 5e-5 ", Chamfer(5e-5, 45.0)),
        ("rounded:radius=1e-4", Rounded(1e-4)),
        ("worn:direction=-90,angle=5", Worn(5.0, -90.0)),
        ("worn:angle=5", Worn(5.0, 0.0)),
    ],
)
def test_shapes_are_read_from_words(text, shape):
    assert parse_tip_shape(text) == shape


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "tip shape '' is not known; there are flat, chamfer, rounded, worn"),
        ("round:radius=1", "tip shape 'round' is not known"),
        ("flat:angle=1", "flat has no 'angle', it has none"),
        ("chamfer", "width is missing"),
        ("chamfer:", "'' is not parameter=value"),
        ("chamfer:angle=45", "width is missing"),
        ("chamfer:width=5e-5,depth=1", "chamfer has no 'depth', it has width, angle"),
        ("chamfer:width_m=5e-5", "chamfer has no 'width_m'"),
        ("chamfer:width=5e-5,width=6e-5", "width is given twice"),
        ("chamfer:width=50um", "width = '50um' is not a number"),
        ("chamfer:width=-1", "width_m must be positive"),
        ("chamfer:width=1e-5,angle=90", "angle_deg of a chamfer must be below 90"),
        ("rounded:radius=nan", "radius_m must be positive and finite"),
        ("worn:angle=90", "angle_deg of a worn tip must be below 90"),
        ("worn:angle=-1", "angle_deg must be positive"),
        ("worn:angle=1,direction=inf", "direction_deg must be a number"),
    ],
)
def test_words_that_are_wrong_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_tip_shape(text)


@pytest.mark.parametrize(
    ("shape", "place", "section", "message"),
    [
        (Chamfer(0.3e-3), (0.0, 0.0), FLAT_WIRE, "width_m 0.0003 is more than half the section"),
        (Rounded(0.5e-3), (0.0, 0.0), WIRE, "radius_m 0.0005 is more than half the section"),
        (Flat(), (0.26e-3, 0.0), FLAT_WIRE, "a place of the tip is 1e-05 m outside"),
        (Worn(1.0), (0.3e-3, 0.3e-3), WIRE, "outside its section"),
        (Flat(), (0.0, math.nan), WIRE, "outside its section"),
    ],
)
def test_places_and_sections_that_do_not_fit_are_refused(shape, place, section, message):
    with pytest.raises(ValueError, match=message):
        shape.offset_m([place[0]], [place[1]], section)
