"""The bristle as a beam: three-node quadratic Timoshenko elements, as in BEAM189.

Unknowns of a node: displacements u_x, u_y, u_z and rotations θ_x, θ_y, θ_z; the axis is z.
Shear strains are u_x' - θ_y and u_y' + θ_x. Two Gauss points integrate the stiffness (a quadratic
Timoshenko element locks with three), three the consistent mass, rotary inertia included.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..bristle import CONTACT_POINTS, Bristle
from ..errors import InputError
from .axis import Axis
from .base import ContactPoints
from .modal import ModalBody, modal_form

NODE_UNKNOWNS = 6
UX, UY, UZ, RX, RY, RZ = range(NODE_UNKNOWNS)


def shape(xi: float) -> tuple[Array, Array]:
    """Quadratic Lagrange functions at ξ ∈ [-1, 1] and their ξ-derivatives, nodes -1, 0, 1."""
    value = np.array([0.5 * xi * (xi - 1.0), 1.0 - xi * xi, 0.5 * xi * (xi + 1.0)])
    return value, np.array([xi - 0.5, -2.0 * xi, xi + 0.5])


def beam_matrices(
    bristle: Bristle, n_elements: int, lateral_inertia: float = 0.0
) -> tuple[Array, Array]:
    """Mass and stiffness (n, n) of the free beam, n = 6 (2 ``n_elements`` + 1).

    ``lateral_inertia`` is the share of Love's correction: the kinetic energy ½ ρ ν² I_p ∫ u_z'² of
    a section that bulges as it is compressed (Love, Mathematical Theory of Elasticity, § 278).
    """
    if n_elements < 1:
        raise InputError(f"the beam needs at least one element, not {n_elements}")
    mat, sec = bristle.material, bristle.section
    e, g = mat.youngs_Pa, mat.shear_modulus_Pa
    area, iy, ix = sec.area_m2, sec.second_moment_y_m4, sec.second_moment_x_m4
    shear, polar = sec.shear_coefficient(mat.poisson) * g * area, ix + iy
    # strains: u_x' - θ_y, u_y' + θ_x, u_z', θ_x', θ_y', θ_z'
    rigidity = np.array([shear, shear, e * area, e * iy, e * ix, g * sec.torsion_m4])
    inertia = mat.density_kg_m3 * np.array([area, area, area, iy, ix, polar])
    bulging = lateral_inertia * mat.density_kg_m3 * mat.poisson**2 * polar
    half = 0.5 * bristle.length_m / n_elements

    element = 3 * NODE_UNKNOWNS
    k_element = np.zeros((element, element))
    for xi, weight in zip(*np.polynomial.legendre.leggauss(2), strict=True):
        value, slope = shape(xi)
        strain = np.kron(slope / half, np.eye(NODE_UNKNOWNS))
        strain[UX, RY::NODE_UNKNOWNS] -= value
        strain[UY, RX::NODE_UNKNOWNS] += value
        k_element += weight * half * strain.T @ (rigidity[:, None] * strain)
    m_element = np.zeros((element, element))
    for xi, weight in zip(*np.polynomial.legendre.leggauss(3), strict=True):
        value = np.kron(shape(xi)[0], np.eye(NODE_UNKNOWNS))
        m_element += weight * half * value.T @ (inertia[:, None] * value)
        bulge = np.kron(shape(xi)[1] / half, np.eye(NODE_UNKNOWNS)[UZ])
        m_element += weight * half * bulging * np.outer(bulge, bulge)

    n = NODE_UNKNOWNS * (2 * n_elements + 1)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for first in range(0, 2 * NODE_UNKNOWNS * n_elements, 2 * NODE_UNKNOWNS):
        span = slice(first, first + element)
        mass[span, span] += m_element
        stiffness[span, span] += k_element
    return mass, stiffness


def beam_contact(
    bristle: Bristle, n_elements: int, *, face: bool, points: int = CONTACT_POINTS
) -> ContactPoints:
    """Contact points of the end section: ``points`` across each side (``face``), or one, on the
    axis."""
    section, material = bristle.section, bristle.material
    if face:
        xy, weights = section.contact_points(points)
    else:
        xy, weights = np.zeros((1, 2)), np.ones(1)
    n = NODE_UNKNOWNS * (2 * n_elements + 1)
    x, y = xy.T
    # u_x - y θ_z, u_y + x θ_z, u_z - x θ_y + y θ_x
    shapes = np.zeros((len(xy), 3, NODE_UNKNOWNS))
    shapes[:, [0, 1, 2], [UX, UY, UZ]] = 1.0
    shapes[:, 0, RZ], shapes[:, 1, RZ] = -y, x
    shapes[:, 2, RY], shapes[:, 2, RX] = -x, y
    # stress from the tip's strains; that of torsion is distributed to give the right moment
    slope = shape(-1.0)[1] / (0.5 * bristle.length_m / n_elements)
    shear = section.shear_coefficient(material.poisson) * material.shear_modulus_Pa
    polar = section.second_moment_x_m4 + section.second_moment_y_m4
    twist = material.shear_modulus_Pa * section.torsion_m4 / polar
    stiffness = np.array([shear, shear, material.youngs_Pa])
    traction = np.zeros((len(xy), 3, n))
    for axis, unknown in ((0, UX), (0, RZ), (1, UY), (1, RZ), (2, UZ), (2, RY), (2, RX)):
        factor = shapes[:, axis, unknown] * (twist if unknown == RZ else stiffness[axis])
        columns = unknown + NODE_UNKNOWNS * np.arange(3)
        traction[:, axis, columns] -= section.area_m2 * np.outer(factor, slope)
    traction[:, 0, RY] += section.area_m2 * shear
    traction[:, 1, RX] -= section.area_m2 * shear
    return ContactPoints(
        coordinates=np.eye(NODE_UNKNOWNS, n),
        support=np.tile(np.arange(NODE_UNKNOWNS), (len(xy), 1)),
        shapes=shapes,
        traction=traction.reshape(-1, n),
        weights=weights,
        places_m=np.column_stack([xy, np.full(len(xy), -0.5 * bristle.length_m)]),
    )


def beam_axis(bristle: Bristle, n_elements: int) -> Axis:
    """Axial strain and slopes at the Gauss points that integrate the stiffness."""
    half = 0.5 * bristle.length_m / n_elements
    n, points = NODE_UNKNOWNS * (2 * n_elements + 1), np.polynomial.legendre.leggauss(2)
    rows = np.zeros((3, n_elements, len(points[0]), n))
    for e in range(n_elements):
        for k, xi in enumerate(points[0]):
            for which, unknown in enumerate((UZ, UX, UY)):
                columns = NODE_UNKNOWNS * (2 * e + np.arange(3)) + unknown
                rows[which, e, k, columns] = shape(xi)[1] / half
    strain, slope_x, slope_y = rows.reshape(3, -1, n)
    stretch = bristle.material.youngs_Pa * bristle.section.area_m2
    return Axis(strain, slope_x, slope_y, np.tile(points[1] * half * stretch, n_elements))


def beam_body(
    bristle: Bristle,
    n_elements: int,
    *,
    face: bool = True,
    points: int = CONTACT_POINTS,
    second_order: bool = False,
    lateral_inertia: float = 0.0,
) -> ModalBody:
    """The free beam of ``n_elements`` in all its modes (Vanegas-Useche et al. use sixteen).

    It touches with ``points`` across each side of its end section (``face``), or, as in the paper,
    with the node on the axis. See bodies.axis for ``second_order``, `beam_matrices` for the rest.
    """
    mass, stiffness = beam_matrices(bristle, n_elements, lateral_inertia)
    rigid = rigid_motions(bristle, n_elements)
    return modal_form(
        "beam",
        mass,
        stiffness,
        rigid,
        beam_contact(bristle, n_elements, face=face, points=points),
        bristle.material.alpha_1_s,
        bristle.material.beta_s,
        beam_axis(bristle, n_elements) if second_order else None,
    )


def rigid_motions(bristle: Bristle, n_elements: int) -> Array:
    """Translations along x, y, z and rotations about them through the middle (n, 6)."""
    z = np.linspace(-0.5, 0.5, 2 * n_elements + 1) * bristle.length_m
    motions = np.zeros((len(z), NODE_UNKNOWNS, NODE_UNKNOWNS))
    motions[:, range(NODE_UNKNOWNS), range(NODE_UNKNOWNS)] = 1.0
    motions[:, UY, RX] = -z
    motions[:, UX, RY] = z
    return motions.reshape(-1, NODE_UNKNOWNS)
