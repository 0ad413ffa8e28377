"""Anderson acceleration of a fixed-point problem that recurs in every time step.

The problem is G(x) = x. Every move of x, with the change of the residual r = G(x) - x, is a secant
of the map. The next move minimises the residual predicted by these secants (Walker and Ni, SIAM J.
Numer. Anal. 49, 2011). The map changes little between steps, so secants of earlier steps are kept
(Degroote, Bathe and Vierendeels, Comput. Struct. 87, 2009).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..compiled import fast, njit

MOST_SECANTS = 16
# A secant whose part outside later ones is below this share, squared, is mostly rounding.
NEW_SHARE = 1e-8


class Secants(NamedTuple):
    """The latest moves (MOST_SECANTS, n), the changes of the residual by them, the products of
    these changes under ``weights`` (n,), and the number of secants so far (1,)."""

    moves: Array
    changes: Array
    products: Array
    weights: Array
    total: NDArray[np.int64]


@njit
def new_secants(weights: Array) -> Secants:
    """No secants yet; the norm of a residual is the sum of its squares times ``weights`` (n,)."""
    return Secants(
        moves=np.zeros((MOST_SECANTS, len(weights))),
        changes=np.zeros((MOST_SECANTS, len(weights))),
        products=np.zeros((MOST_SECANTS, MOST_SECANTS)),
        weights=weights,
        total=np.zeros(1, dtype=np.int64),
    )


@fast
def _product(weights: Array, one: Array, other: Array) -> float:
    total = 0.0
    for j in range(len(weights)):
        total += weights[j] * one[j] * other[j]
    return total


@njit
def remember(secants: Secants, move: Array, change: Array) -> None:
    """Store that ``move`` (n,) changed the residual by ``change`` (n,), over the oldest secant."""
    at = secants.total[0] % MOST_SECANTS
    secants.total[0] += 1
    secants.moves[at] = move
    secants.changes[at] = change
    for k in range(min(secants.total[0], MOST_SECANTS)):
        product = _product(secants.weights, change, secants.changes[k])
        secants.products[at, k] = secants.products[k, at] = product


@njit
def next_move(secants: Secants, residual: Array) -> Array:
    """The move (n,) of x for a ``residual`` (n,).

    Least squares by Cholesky factorisation of the normal equations, from the latest secant on;
    linearly dependent ones are skipped.
    """
    n = min(secants.total[0], MOST_SECANTS)
    chosen = np.empty(n, dtype=np.int64)
    lower, share = np.zeros((n, n)), np.zeros(n)
    used = 0
    for age in range(n):
        at = (secants.total[0] - 1 - age) % MOST_SECANTS
        whole = secants.products[at, at]
        new = whole
        for i in range(used):
            entry = secants.products[at, chosen[i]]
            for k in range(i):
                entry -= lower[used, k] * lower[i, k]
            lower[used, i] = entry / lower[i, i]
            new -= lower[used, i] ** 2
        if new <= NEW_SHARE * whole:
            continue
        lower[used, used] = math.sqrt(new)
        share[used] = _product(secants.weights, secants.changes[at], residual)
        for k in range(used):
            share[used] -= lower[used, k] * share[k]
        share[used] /= lower[used, used]
        chosen[used] = at
        used += 1
    move = residual.copy()
    for i in range(used - 1, -1, -1):
        for k in range(i + 1, used):
            share[i] -= lower[k, i] * share[k]
        share[i] /= lower[i, i]
        move -= share[i] * (secants.moves[chosen[i]] + secants.changes[chosen[i]])
    return move
