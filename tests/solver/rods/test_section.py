"""A rod's section, from the bristle's own section and material."""

import math

import numpy as np
import pytest

from bristle.meshes.section import Circle
from bristle.solver.bristle import Bristle
from bristle.solver.errors import InputError
from bristle.solver.rods.ground import Ground
from bristle.solver.rods.section import RodSection

# one rod, which no rank shares
pytestmark = pytest.mark.serial


def test_the_weak_axis_is_the_wide_side(bristle):
    section = RodSection.of(bristle)
    e, width, thickness = 207e9, 2.08e-3, 0.5e-3
    assert section.EI2_Nm2 == pytest.approx(e * width * thickness**3 / 12.0)
    assert section.EI1_Nm2 == pytest.approx(e * thickness * width**3 / 12.0)
    assert section.rhoA_kg_m * bristle.length_m == pytest.approx(bristle.mass_kg)
    # Roark's approximate formula for the torsion of a rectangle is good to 4 digits
    a, b = 0.5 * width, 0.5 * thickness
    roark = a * b**3 * (16 / 3 - 3.36 * b / a * (1 - b**4 / (12 * a**4)))
    shear = e / 2.56
    assert section.GJ_Nm2 == pytest.approx(shear * roark, rel=1e-3)


def test_stress_of_a_pure_moment(bristle):
    """M c / I about either axis; both at once meet in a corner of the rectangle only."""
    flat, wire = RodSection.of(bristle), RodSection.of(Bristle(section=Circle(1e-3)))
    moments = np.array([[0.01, 0.0, 5.0], [0.0, -0.02, 0.0], [0.03, 0.04, 0.0]])
    about_1, about_2 = 6.0 / (0.5e-3 * 2.08e-3**2), 6.0 / (2.08e-3 * 0.5e-3**2)
    expected = np.abs(moments[:, 0]) * about_1 + np.abs(moments[:, 1]) * about_2
    assert flat.bending_stress_Pa(moments) == pytest.approx(expected)
    round_modulus = math.pi * 1e-9 / 32.0
    assert wire.bending_stress_Pa(moments)[2] == pytest.approx(0.05 / round_modulus)


def test_points_that_can_touch(bristle):
    corners = RodSection.of(bristle).rim_m
    assert sorted(map(tuple, np.abs(corners)))[0] == pytest.approx((0.25e-3, 1.04e-3))
    assert len({tuple(np.sign(each)) for each in corners}) == 4
    rim = RodSection.of(Bristle(section=Circle(1e-3))).rim_m
    assert np.hypot(*rim.T) == pytest.approx(0.5e-3)


def test_what_a_ground_refuses():
    with pytest.raises(InputError, match="static coefficient"):
        Ground(friction_static=0.2, friction_kinetic=0.3)
    with pytest.raises(InputError, match="Kn"):
        Ground(kn_N_m=0.0)
    with pytest.raises(InputError, match="normal"):
        Ground(normal=(0.0, 0.0, 0.0))
    tilted = Ground(point_m=(0.0, 0.0, 1.0), normal=(0.0, 3.0, 4.0))
    assert tilted.gaps_m(np.array([[5.0, 0.0, 2.0], [0.0, 4.0, -2.0]])) == pytest.approx([0.8, 0.0])
