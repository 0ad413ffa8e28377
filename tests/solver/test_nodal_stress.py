"""The stress at the nodes is that of the displacement."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from field_files import solid_of
from mpi4py import MPI

from bristle.meshes.section import Circle
from bristle.solver.forms import Elasticity
from bristle.solver.nodal_stress import NodalStress, von_mises

LINEAR = np.array([[1.0, 0.3, -0.2], [0.4, -0.7, 0.5], [0.1, 0.6, -0.9]])


def quadratic(x):
    x = x * 1e2
    squares = np.stack(
        [x[0] * x[2] - x[1] ** 2, 0.5 * x[2] ** 2 + x[0] ** 2, x[2] * x[1] - x[2] ** 2]
    )
    return 1e-6 * (LINEAR @ x + squares)


@pytest.mark.parametrize(
    "spec",
    [{}, {"grading": 6.0}, {"section": Circle(1e-3), "cells": (2, 1, 6)}],
    ids=["even", "graded", "wire"],
)
def test_stress_of_a_quadratic_displacement_is_exact(spec):
    solid = solid_of(2, **spec)
    u = fem.Function(solid.space)
    u.interpolate(quadratic)
    found = NodalStress(u, solid.material)()
    x = ufl.SpatialCoordinate(solid.domain) * 1e2
    squares = ufl.as_vector(
        [x[0] * x[2] - x[1] ** 2, 0.5 * x[2] ** 2 + x[0] ** 2, x[2] * x[1] - x[2] ** 2]
    )
    matrix = ufl.as_matrix(LINEAR.tolist())
    hooke = Elasticity.of(solid.material, solid.domain)
    sigma = hooke.stress(hooke.strain(1e-6 * (ufl.dot(matrix, x) + squares)))
    exact = fem.Function(fem.functionspace(solid.domain, ("Lagrange", 2, (6,))))
    pairs = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
    points = exact.function_space.element.interpolation_points()
    exact.interpolate(fem.Expression(ufl.as_vector([sigma[i, j] for i, j in pairs]), points))
    expected = exact.x.array.reshape(-1, 6)
    assert found == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())
    solid.close()


def test_stress_of_a_wave_converges_at_the_nodes():
    """At second order, the tip and the top included."""
    errors = []
    for n in (8, 16, 32):
        solid = solid_of(2, cells=(1, 1, n))
        u = fem.Function(solid.space)
        u.interpolate(lambda x: np.stack([0 * x[0], 0 * x[0], 1e-6 * np.sin(200.0 * x[2])]))
        found = NodalStress(u, solid.material)()[:, 2]
        lam, mu = solid.material.lame_Pa
        z = solid.space.tabulate_dof_coordinates()[:, 2]
        wrong = np.abs(found - (lam + 2 * mu) * 2e-4 * np.cos(200.0 * z))
        errors.append(solid.comm.allreduce(wrong.max(initial=0.0), MPI.MAX))
        solid.close()
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert rates.min() > 1.9


def test_von_mises_of_plain_states():
    uniaxial, shear = [0, 0, -5.0, 0, 0, 0], [0, 0, 0, 2.0, 0, 0]
    pressure = [7.0, 7.0, 7.0, 0, 0, 0]
    expected = [5.0, 2.0 * np.sqrt(3.0), 0.0]
    assert von_mises(np.array([uniaxial, shear, pressure])) == pytest.approx(expected)
