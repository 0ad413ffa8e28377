"""How a bristle stands to the surface."""

from __future__ import annotations

import math

import numpy as np

from ...meshes.section import Rectangle, Section
from ...meshes.tip_shape import TipShape
from ...solver.arrays import Array
from ...solver.bristle import Bristle
from ...solver.rigid import leaning, matrix_of, slope_normal
from .fields import PlaceFields
from .flags import refuse

ANGLES = ("tilt_deg", "tilt_wide_deg", "slope_deg", "slope_wide_deg")
# Bristle against the surface's normal; beyond it the side touches before the end face.
LEAN_DEG = 80.0
# Lean in degrees up to which small strain and rotation in contact are taken to be enough.
LINEAR_LEAN_DEG = 10.0
# First root of cos x cosh x = 1: the slowest bending of a free bar.
FREE_BENDING = 4.730040744862704


def surface_normal(inputs: PlaceFields) -> Array:
    """The surface's normal (3,) along the bristle's own axes."""
    attitude = matrix_of(leaning(inputs.tilt_deg, inputs.tilt_wide_deg))
    return np.asarray(attitude.T @ slope_normal(inputs.slope_deg, inputs.slope_wide_deg))


def lean_deg(inputs: PlaceFields) -> float:
    """Angle between the bristle and the surface's normal."""
    normal = surface_normal(inputs)
    return math.degrees(math.atan2(math.hypot(normal[0], normal[1]), normal[2]))


def check_lean(inputs: PlaceFields) -> None:
    """Refuse a bristle that would land on its side."""
    lean = lean_deg(inputs)
    if lean > LEAN_DEG * (1.0 + 1e-9):
        blame = next(name for name in ANGLES if getattr(inputs, name))
        refuse(
            blame,
            f"tilt and slope together lean the bristle by {lean:.3g} degrees against the surface's "
            f"normal; from {LEAN_DEG:g} on it lands on its side, which cannot touch here",
        )


def face_offsets_m(shape: TipShape, section: Section, xy_m: Array) -> Array:
    """How far the end face stands back at places (n, 2) of the section.

    Places that rounding, or a mesh with cells not quite round, puts outside are taken to the edge.
    """
    if isinstance(section, Rectangle):
        half = 0.5 * np.array([section.thickness_m, section.width_m])
        inside = np.clip(xy_m, -half, half)
    else:
        radius = 0.5 * section.diameter_m
        inside = xy_m / np.maximum(np.hypot(*xy_m.T) / radius, 1.0)[:, None]
    return np.asarray(shape.offset_m(inside[:, 0], inside[:, 1], section))


def slowest_bending_1_s(bristle: Bristle) -> float:
    """Lowest elastic angular frequency of a thin free bar (Euler and Bernoulli)."""
    section, material = bristle.section, bristle.material
    second_moment = min(section.second_moment_x_m4, section.second_moment_y_m4)
    gyration = math.sqrt(second_moment / section.area_m2)
    return (FREE_BENDING / bristle.length_m) ** 2 * material.bar_speed_m_s * gyration
