"""Quantile residuals of a model: standard normal where it holds, whatever differs by chance.

Where nothing differs from group to group they are the whitened residuals. Else a row's place in
its predictive distribution, given the rows of its group before it, is brought to a normal deviate
(Dunn and Smyth, J. Comput. Graph. Stat. 5 (1996) 236; Rosenblatt, Ann. Math. Stat. 23 (1952) 470).
Nothing is bounded: a residual of 600 sigma is one of 600 sigma.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtri_exp

from ...solver.arrays import Array
from .noise import Ints


def quantile_residuals(values: Array, predicted: Array, weights: Array, starts: Ints) -> Array:
    """Deviates (rows,) of whitened ``values`` (rows,) under ``predicted`` (nodes, rows).

    ``weights`` (nodes,) of the nodes of chance, ``starts`` (groups + 1,) the groups' first rows.
    """
    residual = values - predicted
    if weights.size == 1:
        return np.asarray(residual[0])
    out = np.empty(values.size)
    sizes = np.diff(starts)
    shares = np.repeat(np.log(weights)[:, None], sizes.size, axis=1)
    for place in range(int(sizes.max())):
        there = np.flatnonzero(sizes > place)
        row = starts[there] + place
        e, log_share = residual[:, row], shares[:, there]
        below = logsumexp(log_share + log_ndtr(e), axis=0)
        above = logsumexp(log_share + log_ndtr(-e), axis=0)
        low = ndtri_exp(np.minimum(below, -1e-300))
        high = -ndtri_exp(np.minimum(above, -1e-300))
        out[row] = np.where(below < above, low, high)
        shares[:, there] = log_share - 0.5 * e**2
        shares[:, there] -= logsumexp(shares[:, there], axis=0)
    return out
