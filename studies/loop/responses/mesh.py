"""Few drops, from which what is predicted of many is interpolated.

A prediction is smooth in the height and, where drops wear, in their order. So thousands of drops
need no more of a table, or of a simulation, than a mesh of both.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse import csr_array

from ....solver.arrays import Array
from ..noise import Ints

# Cubic interpolation between so many heights is off by 1e-6 of a height: tables are smooth, and
# themselves cubic. Half as many would be off by a hundred-thousandth; twice as many cost twice the
# time.
HEIGHTS = 48
# Of what wears only corrections are taken from so many heights and places in the order: they are
# hundredths of an effect, and so may be off by a tenth.
WORN = (32, 8)
# Of fewer drops a mesh saves little.
SMALLER = 6


@dataclass(frozen=True)
class Mesh:
    """Where drops are predicted, ``y0_m``, ``order`` and ``session`` (points,), and the shares
    (drops, points) of these in each drop; ``over_y0_1_m`` (heights, heights) takes values at the
    heights, the first axis of the mesh, to their slopes."""

    y0_m: Array
    order: Array
    session: Array
    shares: csr_array
    over_y0_1_m: Array

    @cached_property
    def about(self) -> tuple[Ints, Array]:
        """Numbers (drops, k) of the points that share in each drop, and their shares."""
        drops = self.shares.shape[0]
        place = self.shares.indices.astype(np.int64)
        return place.reshape(drops, -1), self.shares.data.reshape(drops, -1)

    def of(self, which: Ints) -> Mesh:
        """The same for the drops numbered ``which``."""
        return replace(self, shares=self.shares[which])

    def spread(self, found: Array) -> Array:
        """Of values (..., points, q) at the mesh those at the drops (..., drops, q)."""
        last = np.moveaxis(found, -2, 0)
        every = self.shares @ last.reshape(len(last), -1)
        return np.moveaxis(every.reshape(-1, *last.shape[1:]), 0, -2)

    def slopes(self, found: Array) -> Array:
        """Of values (..., points, q) at the mesh their slopes over the height there."""
        heights = len(self.over_y0_1_m)
        split = found.reshape(*found.shape[:-2], heights, -1)
        return np.asarray((self.over_y0_1_m @ split).reshape(found.shape))


def mesh_of(y0_m: Array, order: Array | None, session: Array | None) -> Mesh | None:
    """The mesh of drops (drops,), over their order and session where these are given; None where
    it would not be `SMALLER` than they are."""
    drops = len(y0_m)
    nodes, place, share = _cubic(np.sqrt(y0_m), HEIGHTS if order is None else WORN[0])
    axes = [(np.asarray(nodes**2), place, share)]
    if order is not None:
        axes.append(_cubic(order, WORN[1]))
    if session is not None:
        levels, which = np.unique(session, return_inverse=True)
        axes.append((levels, which[:, None].astype(np.int64), np.ones((drops, 1))))
    sizes = [len(each[0]) for each in axes]
    if SMALLER * np.prod(sizes) > drops:
        return None
    column, share = np.zeros((drops, 1), dtype=np.int64), np.ones((drops, 1))
    for (_, place, weight), size in zip(axes, sizes, strict=True):
        column = (column[:, :, None] * size + place[:, None, :]).reshape(drops, -1)
        share = (share[:, :, None] * weight[:, None, :]).reshape(drops, -1)
    row = np.repeat(np.arange(drops), column.shape[1])
    shares = csr_array((share.ravel(), (row, column.ravel())), shape=(drops, int(np.prod(sizes))))
    points = np.array(list(itertools.product(*(each[0] for each in axes))))
    named = iter(points.T[1:])
    return Mesh(
        y0_m=points[:, 0],
        order=next(named) if order is not None else np.zeros(len(points)),
        session=next(named) if session is not None else np.zeros(len(points)),
        shares=shares,
        over_y0_1_m=CubicSpline(nodes, np.eye(len(nodes)))(nodes, 1) / (2.0 * nodes[:, None]),
    )


def _cubic(x: Array, count: int) -> tuple[Array, Ints, Array]:
    """``count`` equally spaced nodes over x (n,), the numbers (n, 4) of those about each, and their
    shares (n, 4) in it (Lagrange)."""
    low, high = float(x.min()), float(x.max())
    high = high if high > low else 1.01 * low + 1e-6
    nodes = np.linspace(low, high, count)
    at = (x - low) / (high - low) * (count - 1)
    first = np.clip(np.floor(at).astype(np.int64) - 1, 0, count - 4)
    t = at - first
    shares = np.stack(
        [
            -(t - 1) * (t - 2) * (t - 3) / 6,
            t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2,
            t * (t - 1) * (t - 2) / 6,
        ],
        axis=1,
    )
    return nodes, first[:, None] + np.arange(4), shares
