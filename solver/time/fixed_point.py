"""Anderson's acceleration of a fixed point that is sought in every step of a march.

What is sought is a value x with G(x) = x. Every move of x and the change of the residual
r = G(x) - x is a secant of the map; the next move is the one after which, by these secants, the
residual would be least (Walker and Ni, SIAM J. Numer. Anal. 49, 2011). Secants of the steps before
serve too, since the map changes little (Degroote, Bathe and Vierendeels, Comput. Struct. 87, 2009).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..compiled import njit

MOST_SECANTS = 16
# A secant of which no more than this share, squared, is not seen in others tells rounding.
NEW_SHARE = 1e-8


class Secants(NamedTuple):
    """The latest moves (MOST_SECANTS, n), by how much each changed the residual, the products of
    these changes under ``weights`` (n,), and how many there have been, (1,)."""

    moves: Array
    changes: Array
    products: Array
    weights: Array
    total: NDArray[np.int64]


@njit
def new_secants(weights: Array) -> Secants:
    """None yet; a residual is measured by the sum of its squares times ``weights`` (n,)."""
    return Secants(
        moves=np.zeros((MOST_SECANTS, len(weights))),
        changes=np.zeros((MOST_SECANTS, len(weights))),
        products=np.zeros((MOST_SECANTS, MOST_SECANTS)),
        weights=weights,
        total=np.zeros(1, dtype=np.int64),
    )


@njit
def remember(secants: Secants, move: Array, change: Array) -> None:
    """Keep that ``move`` (n,) changed the residual by ``change`` (n,), in place of the oldest."""
    at = secants.total[0] % MOST_SECANTS
    secants.total[0] += 1
    secants.moves[at] = move
    secants.changes[at] = change
    products = secants.changes @ (secants.weights * change)
    secants.products[at, :] = products
    secants.products[:, at] = products


@njit
def next_move(secants: Secants, residual: Array) -> Array:
    """The move (n,) of x at a ``residual`` (n,): least squares by the normal equations."""
    n = min(secants.total[0], MOST_SECANTS)
    if n == 0:
        return residual.copy()
    changes, products = secants.changes[:n], secants.products[:n, :n]
    size = np.sqrt(np.diag(products))
    size[size == 0.0] = 1.0
    alike = products / np.outer(size, size) + NEW_SHARE * np.eye(n)
    share = np.linalg.solve(alike, changes @ (secants.weights * residual) / size) / size
    return residual - share @ (secants.moves[:n] + changes)
