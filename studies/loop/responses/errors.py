"""Errors of the readings of drops; that of the height before is in all that is read of a drop."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....solver.arrays import Array
from ....solver.compiled import njit
from ..noise import Ints
from .mesh import Mesh


@dataclass(frozen=True)
class Errors:
    """How readings of drops err: ``sigma`` (q,) of each quantity, ``sigma_y0_m`` of the height
    before, which all quantities of a drop share; ``present`` (drops, q) tells what was read.

    ``whiten`` (drops, q, q) takes residuals of a drop to independent ones of unit variance, for the
    slopes over the height that the data show; what was not read stays apart. Where ``values``
    (drops, q) are given, residuals are whitened by the slopes of the model itself: each height is
    then as the drop's readings together would have it, not as one of them has it (errors in
    variables: W. A. Fuller, Measurement Error Models (1987), §1.3). Where heights differ by little
    more than they err, a model would else gain from a slope that is too small.
    """

    sigma: Array
    sigma_y0_m: float
    present: NDArray[np.bool_]
    whiten: Array
    values: Array | None = None

    @classmethod
    def independent(
        cls, sigma: Array, present: NDArray[np.bool_], sigma_y0_m: float = 0.0
    ) -> Errors:
        """Of quantities (q,) whose errors have nothing in common yet."""
        return cls(sigma, sigma_y0_m, present, np.diag(1.0 / sigma)[None].repeat(len(present), 0))

    def only(self, which: Ints) -> Errors:
        """Those of the drops numbered ``which``."""
        values = None if self.values is None else self.values[which]
        present, whiten = self.present[which], self.whiten[which]
        return replace(self, present=present, whiten=whiten, values=values)

    def whitened(self, left: Array, slopes: Array) -> Array:
        """Residuals (..., drops, q) for slopes (..., drops, q) over the height: each quantity in
        turn is freed of what those before it say of the height's error."""
        drops, nothing = len(self.present), np.zeros(self.present.shape)
        return self._whitened(
            -left, slopes, nothing, np.arange(drops)[:, None], np.ones((drops, 1))
        )

    def whitened_on(self, mesh: Mesh, measured: Array) -> Array:
        """`whitened` residuals (..., drops, q) of the ``values`` from what is ``measured`` at the
        points of a mesh (..., points, q)."""
        assert self.values is not None
        return self._whitened(measured, mesh.slopes(measured), self.values, *mesh.about)

    def _whitened(
        self, measured: Array, slopes: Array, values: Array, place: Ints, share: Array
    ) -> Array:
        """`whitened` residuals of ``values`` (drops, q) from what is ``measured`` with its slopes
        (..., points, q), of which those numbered ``place`` (drops, k) share in each drop."""
        measured, slopes = np.broadcast_arrays(measured, slopes)
        first, second = (
            np.ascontiguousarray(each).reshape(-1, *each.shape[-2:]) for each in (measured, slopes)
        )
        own = self.present, self.sigma, self.sigma_y0_m
        found = whitened(first, second, values, place, share, *own)
        return found.reshape(*measured.shape[:-2], *values.shape)

    def factors(self, slopes: Array) -> Array:
        """The matrices (..., drops, q, q) that take residuals to `whitened` ones."""
        units = np.eye(len(self.sigma))
        return np.stack([self.whitened(each, slopes) for each in units], axis=-1)

    def rows(self, measured: Array) -> Array:
        """Whitened rows (..., rows) of quantities (..., drops, q), of those that were read."""
        known = np.where(self.present, measured, 0.0)
        # over so few columns a loop is several times faster than einsum
        out = sum(self.whiten[..., r] * known[..., r, None] for r in range(len(self.sigma)))
        return self.read(np.asarray(out))

    def read(self, each: Array) -> Array:
        """Rows (..., rows) of what stands for each quantity (..., drops, q)."""
        if self.present.all():
            return each.reshape(*each.shape[:-2], -1)
        return np.asarray(each[..., self.present])

    @cached_property
    def told(self) -> Array:
        """`rows` of the ``values``."""
        assert self.values is not None
        return self.rows(self.values)


@njit
def whitened(
    measured: Array,
    slopes: Array,
    values: Array,
    place: Ints,
    share: Array,
    present: NDArray[np.bool_],
    sigma: Array,
    sigma_y0_m: float,
) -> Array:
    """`Errors.whitened` (n, drops, q), see there."""
    drops, out = len(values), np.empty((len(measured), *values.shape))
    known, told, left, moved = np.empty(drops), np.empty(drops), np.empty(drops), np.empty(drops)
    for i in range(len(measured)):
        known[:], told[:] = 1.0, 0.0
        for q in range(len(sigma)):
            unit, there = 1.0 / sigma[q], present[:, q].copy()
            for drop in range(drops):
                value, slope = values[drop, q], 0.0
                for k in range(place.shape[1]):
                    value -= share[drop, k] * measured[i, place[drop, k], q]
                    slope += share[drop, k] * slopes[i, place[drop, k], q]
                left[drop], moved[drop] = value, unit * sigma_y0_m * slope
            # with a division that is not tested for zero, so that this is vectorised
            for drop in range(drops):
                value = unit * left[drop] if there[drop] else 0.0
                slope = moved[drop] if there[drop] else 0.0
                more = known[drop] + slope * slope
                own = value * known[drop] - slope * told[drop]
                own = np.divide(own, math.sqrt(known[drop] * more))
                left[drop] = own if there[drop] else left[drop]
                told[drop] += slope * value
                known[drop] = more
            out[i, :, q] = left
    return out
