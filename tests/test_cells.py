"""Is a product cell by cell that of the assembled matrix, and taken where it pays?"""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from bristle.solver.bodies.cells import LEAST, SAME, CellProduct, alike, cell_product
from bristle.solver.bodies.linear import TOLERANCE, Method, make_solver
from bristle.solver.bristle import Circle

COMM = MPI.COMM_WORLD
EFFECTIVE = (0.5, 1e-11)


@pytest.mark.parametrize(
    "body",
    [
        {"cells": (1, 2, 12), "order": 1},
        {"cells": (2, 3, 8), "order": 2},
        {"cells": (2, 1, 6), "order": 2, "section": Circle(2e-3), "geometry_order": 2},
    ],
)
def test_a_product_is_that_of_the_assembled_matrix(make_solid, body):
    solid = make_solid(**body)
    product = CellProduct(solid, *alike(solid.domain), *EFFECTIVE)
    matrix = solid.effective_matrix(*EFFECTIVE)
    x = np.random.default_rng(COMM.rank).standard_normal(solid.n_local)
    right, left = matrix.createVecs()
    right.array[:] = x
    matrix.mult(right, left)
    size = np.abs(left.array).max(initial=0.0)
    # what is the same to so much, with a margin for how a cell's matrix follows its shape
    close = {"rtol": 0.0, "atol": 100.0 * SAME * size}
    np.testing.assert_allclose(product.times(x), left.array, **close)
    np.testing.assert_allclose(product.times(2.0 * x), 2.0 * left.array, **close)
    matrix.destroy()


def test_cells_of_a_body_that_is_divided_evenly_are_alike(make_solid):
    first, kind = alike(make_solid(cells=(2, 3, 24)).domain)
    assert len(first) == 1
    assert not kind.any()


def test_cells_of_a_wire_are_of_as_many_kinds_as_its_section_has(make_solid):
    for length in (6, 12):
        solid = make_solid(cells=(2, 1, length), order=1, section=Circle(2e-3))
        sections = {tuple(map(tuple, each)) for each in np.round(_sections(solid), 9)}
        assert len(alike(solid.domain)[0]) == len(sections)


def _sections(solid) -> np.ndarray:
    """Places across the wire of the nodes of this rank's cells, from their first (cells, n, 2)."""
    domain = solid.domain
    owned = domain.topology.index_map(3).size_local
    x = domain.geometry.x[domain.geometry.dofmap[:owned]]
    return (x - x[:, :1])[..., :2]


def test_few_cells_stay_assembled_and_many_do_not(make_solid):
    few, many = make_solid(cells=(1, 1, 6)), make_solid(cells=(2, 3, 6 * LEAST))
    assert cell_product(few, *EFFECTIVE) is None
    assert cell_product(many, *EFFECTIVE) is not None


@pytest.mark.parametrize("shift", [1e15, 1e9])
def test_conjugate_gradients_by_cells_solve_the_equations(make_solid, shift):
    """With the diagonal, and with aggregation; the tolerance is of the energy norm, as the
    preconditioner sees it."""
    solid = make_solid(cells=(2, 2, 16 * LEAST), order=1)
    solver = make_solver(solid, Method.ITERATIVE, shift, 1.0)
    assert solver._operator is not None
    x = np.cos(np.arange(solid.n_local, dtype=float))

    def image(u):
        return shift * solid.mass(u) + solid.stiffness(u)

    error = solver.solve(image(x)) - x
    assert solid.dot(error, image(error)) < (100.0 * TOLERANCE) ** 2 * solid.dot(x, image(x))
    solver.close()
