"""A rough surface under rods: its heights, the forces of a section on it, and what is refused."""

import math

import numpy as np
import pytest
from rod_helpers import SLENDER, along

from bristle.solver.errors import InputError
from bristle.solver.rods.chain import new_system
from bristle.solver.rods.contact import (
    SectionPose,
    TouchStep,
    no_touch,
    obstacle_of,
    place_gap,
    touch_section,
)
from bristle.solver.rods.ground import Ground
from bristle.solver.rods.relief import RoughPlane, highest_m, look
from bristle.studies.surface.ground import tile_m
from bristle.studies.surface.phases import Composite
from bristle.studies.surface.rough import Roughness, make_surface

KN = 2e6


@pytest.fixture(scope="module")
def drawn():
    """A surface of concrete, and it as rods take it."""
    roughness, composite = Roughness(5e-5, 5e-3), Composite()
    surface = make_surface(roughness, composite, *tile_m(roughness, composite), 3)
    factor = surface.stiffness_factors(207e9, 0.28)[surface.phase]
    return surface, RoughPlane(surface.heights_m, surface.spacing_m, factor)


def held_and_force(surface, place, turned):
    """What a section holds in J that lies at a place, without friction, and its force (3,)."""
    touch, system = [no_touch(1, len(surface.rim)) for _ in range(2)], new_system(1)
    section, step = SectionPose(place, turned), TouchStep(*touch, 0.0, False)
    lost, held = touch_section(surface, 0, section, section, step, system)
    assert lost == 0.0
    return held, -system.residual[0, :3]


def test_heights_and_normals_are_those_of_another_evaluation_of_the_spline(drawn):
    surface, rough = drawn
    relief = rough.compiled()
    places = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 2))
    patch = surface.patch(*places.T)
    normal, grows, step = np.empty(3), np.empty(3), 1e-3 * rough.spacing_m
    for place, height, expected in zip(places, patch.heights_m, patch.normals, strict=True):
        found, factor = look(relief, *place, normal, grows)
        assert found == pytest.approx(height, abs=1e-14)
        assert normal == pytest.approx(expected, abs=1e-9)
        assert found <= highest_m(relief)
        assert rough.factor.min() <= factor <= rough.factor.max()
        for c in range(2):
            # linear in each direction between two lines of the grid
            ends = [
                look(relief, *(place + s * np.eye(2)[c]), normal, np.empty(3))[1]
                for s in (-step, step)
            ]
            cell = np.floor((place[c] + np.array([-step, step])) / rough.spacing_m)
            if cell[0] == cell[1]:
                assert (ends[1] - ends[0]) / (2.0 * step) == pytest.approx(grows[c], abs=1e-3)


def test_forces_are_the_slope_of_the_energy(drawn):
    """By the heights' slope, and by the slope of the stiffness where stone borders on cement. What
    is left out is the depth over the radius of the relief's curvature."""
    _, rough = drawn
    surface = obstacle_of(Ground(KN, 0.0, 0.0, rough=rough), SLENDER)
    turned, rng, normal, grows = (
        along([0.0, 0.0, -1.0]),
        np.random.default_rng(5),
        *np.empty((2, 3)),
    )
    softened = 0
    for _ in range(40):
        place = np.append(rng.uniform(0.0, 0.1, 2), 0.0)
        place[2] = look(surface.relief, *place[:2], normal, grows)[0] - 5e-6
        _, force = held_and_force(surface, place, turned)
        softened += np.abs(grows).max() > 0.0
        for c in range(3):
            step = 1e-9 * np.eye(3)[c]
            ends = [held_and_force(surface, place + s * step, turned)[0] for s in (-1.0, 1.0)]
            expected = -(ends[1] - ends[0]) / 2e-9
            assert force[c] == pytest.approx(expected, abs=2e-3 * np.linalg.norm(force))
    assert softened > 10


def test_a_rough_plane_without_heights_is_the_plane():
    even = RoughPlane(np.zeros((5, 6)), 1e-3, np.ones((5, 6)))
    place, turned = np.array([0.1, 0.2, -1e-6]), along([0.0, 0.3, -1.0])
    found = [
        held_and_force(obstacle_of(Ground(KN, 0.0, 0.0, rough=rough), SLENDER), place, turned)
        for rough in (even, None)
    ]
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-12)
    assert found[0][0] > 0.0
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-12)
    # below a plane of slope 1 the nearest point of it is half a diagonal away
    slope = RoughPlane(
        np.add.outer(np.zeros(64), np.r_[0:33, 31:0:-1] * 1e-3), 1e-3, np.ones((64, 64))
    )
    surface = obstacle_of(Ground(KN, rough=slope), SLENDER)
    gap, _ = place_gap(surface, np.array([16e-3, 0.0, 14e-3]), np.empty(3), np.empty(3))
    assert gap == pytest.approx(-math.sqrt(2.0) * 1e-3, rel=1e-6)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"heights_m": np.zeros((3, 9))}, "two equal grids"),
        ({"factor": np.zeros((4, 4))}, "must be positive"),
        ({"spacing_m": math.inf}, "must be positive"),
        ({"heights_m": np.full((4, 4), np.nan)}, "must be finite"),
    ],
)
def test_impossible_rough_planes_are_refused(wrong, said):
    good = {"heights_m": np.zeros((4, 4)), "spacing_m": 1e-3, "factor": np.ones((4, 4))}
    with pytest.raises(InputError, match=said):
        RoughPlane(**(good | wrong))
    with pytest.raises(InputError, match="normal along z"):
        Ground(normal=(0.0, 0.1, 1.0), rough=RoughPlane(**good))
