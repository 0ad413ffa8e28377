"""Anderson's acceleration against what theory says of linear maps."""

from __future__ import annotations

import numpy as np
import pytest

from bristle.solver.time.fixed_point import MOST_SECANTS, new_secants, next_move, remember


def turns(secants, matrix, constant, x, limit=60):
    """How often G(x) = matrix @ x + constant is asked for until x is its fixed point."""
    before = move = None
    for turn in range(1, limit + 1):
        left = matrix @ x + constant - x
        if np.abs(left).max() < 1e-10 * np.abs(constant).max():
            return turn, x
        if before is not None:
            remember(secants, move, left - before)
        before, move = left, next_move(secants, left)
        x = x + move
    return limit, x


def linear_map(rng, size, rank, largest):
    """A symmetric map of that rank, its eigenvalues of both signs up to the ``largest``."""
    basis = np.linalg.qr(rng.standard_normal((size, rank)))[0]
    values = largest * np.linspace(-1.0, 1.0, rank)
    return (basis * values) @ basis.T, rng.standard_normal(size)


@pytest.mark.parametrize("largest", [0.5, 0.95, 20.0])
def test_a_linear_map_is_solved_in_its_rank(largest, rng):
    """Equivalent to GMRES (Walker and Ni, Theorem 2.2): ends after rank + 1 products, whether or
    not the map contracts; one turn begins, one sees that it has ended."""
    matrix, constant = linear_map(rng, 40, 5, largest)
    weights = rng.uniform(0.5, 2.0, 40)
    count, x = turns(new_secants(weights), matrix, constant, np.zeros(40))
    assert count <= 5 + 3
    exact = np.linalg.solve(np.eye(40) - matrix, constant)
    assert x == pytest.approx(exact, rel=1e-7, abs=1e-8)


def test_secants_of_the_step_before_serve(rng):
    """A second problem with the same map and another constant is done at once."""
    matrix, constant = linear_map(rng, 40, 5, 0.9)
    secants = new_secants(np.ones(40))
    first = turns(secants, matrix, constant, np.zeros(40))[0]
    later = turns(secants, matrix, matrix @ rng.standard_normal(40), np.zeros(40))[0]
    assert later <= 3 < first


def test_more_secants_than_are_kept(rng):
    """The oldest are forgotten, and what is left is still as well reduced as by plain turns."""
    matrix, constant = linear_map(rng, 60, 40, 0.7)
    secants = new_secants(np.ones(60))
    count, x = turns(secants, matrix, constant, np.zeros(60))
    assert secants.total[0] > MOST_SECANTS
    assert count < np.log(1e-10) / np.log(0.7)
    assert x == pytest.approx(np.linalg.solve(np.eye(60) - matrix, constant), rel=1e-6, abs=1e-7)


def test_a_move_that_changed_nothing_is_no_secant():
    secants = new_secants(np.ones(3))
    remember(secants, np.ones(3), np.zeros(3))
    assert next_move(secants, np.array([1.0, 2.0, 3.0])).tolist() == [1.0, 2.0, 3.0]
