"""How large a misfit is: its norm in sigma after the best refit of Kn within its bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from .body import Array, Body
from .upright import GRAVITY_M_S2, LINEAR, Law, impact

LOG_KN = (4.0, 8.0)
GRID = 49
SPEEDS_M_S = (0.15, 1.0, 5.0)


@lru_cache(maxsize=8)
def _upright(body: Body) -> CubicSpline:
    """y1 over y0, contact time, and peak force over speed, at each of ``SPEEDS_M_S``, of log10 Kn.

    They hardly depend on the speed: gravity during contact is all that makes them.
    """
    grid = np.linspace(*LOG_KN, GRID)
    table = np.empty((GRID, len(SPEEDS_M_S), 3))
    for i, decade in enumerate(grid):
        for j, speed in enumerate(SPEEDS_M_S):
            done = impact(body, Law(LINEAR, 10.0**decade), speed)
            top = done.lift_m + done.speed_m_s**2 / (2.0 * GRAVITY_M_S2)
            share = top / (speed**2 / (2.0 * GRAVITY_M_S2))
            table[i, j] = share, done.contact_time_s, done.peak_force_N / speed
    return CubicSpline(grid, table, axis=0)


def plain(body: Body, log_kn: float, y0_m: Array) -> Array:
    """(drops, 3): height after, contact time and peak force of an upright bristle on a spring."""
    table = _upright(body)(log_kn)
    speed = np.sqrt(2.0 * GRAVITY_M_S2 * np.maximum(y0_m, 1e-6))
    # what gravity changes goes with the inverse of the speed
    places = 1.0 / np.array(SPEEDS_M_S)
    order = np.argsort(places)
    found = np.stack(
        [np.interp(1.0 / speed, places[order], table[order, k]) for k in range(3)], axis=1
    )
    return found * np.stack([y0_m, np.ones_like(y0_m), speed], axis=1)


@dataclass(frozen=True)
class Gauge:
    """What is measured of drops: columns of y1, contact time and peak force, and sigmas of these.

    ``sigma_y_m`` is that of the height before, too. ``kn_N_m`` where it is declared.
    """

    body: Body
    columns: tuple[int, ...]
    sigma_y_m: float
    sigma_t_s: float
    sigma_force_N: float
    kn_N_m: float | None = None

    @property
    def sigmas(self) -> Array:
        every = np.array([self.sigma_y_m, self.sigma_t_s, self.sigma_force_N])
        return every[list(self.columns)]


def size(gauge: Gauge, seen: Array) -> float:
    """Norm of the whitened rest of ``seen`` (drops, 4), without noise, after the best refit."""
    if gauge.kn_N_m is not None:
        return _norm(gauge, seen)(math.log10(gauge.kn_N_m))
    norm = _norm(gauge, seen)
    grid = np.linspace(*LOG_KN, 4 * GRID)
    rough = [norm(each) for each in grid]
    best = int(np.argmin(rough))
    near = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    found = minimize_scalar(norm, bounds=near, method="bounded", options={"xatol": 1e-7})
    return float(min(found.fun, rough[best]))


def _norm(gauge: Gauge, seen: Array) -> Callable[[float], float]:
    """The whitened norm as a function of log10 Kn. The error of the height before is carried into
    all columns through the slopes that the data themselves have."""
    columns, y0 = list(gauge.columns), seen[:, 0]
    values = seen[:, [1 + c for c in columns]]
    whiten = _whitening(gauge, seen)[0]

    def norm(log_kn: float) -> float:
        left = values - plain(gauge.body, log_kn, y0)[:, columns]
        return float(np.linalg.norm(np.einsum("dij,dj->di", whiten, left)))

    return norm


def _whitening(gauge: Gauge, seen: Array) -> tuple[Array, Array]:
    """Inverse Cholesky factors (drops, columns, columns), and slopes (drops, columns) over the
    height, which the data themselves have."""
    columns, y0 = list(gauge.columns), seen[:, 0]
    slopes = np.stack([seen[:, 1] / y0, np.zeros_like(y0), 0.5 * seen[:, 3] / y0], axis=1)
    slopes = slopes[:, columns]
    moved = slopes * gauge.sigma_y_m
    covariance = np.diag(gauge.sigmas**2) + moved[:, :, None] * moved[:, None, :]
    return np.linalg.inv(np.linalg.cholesky(covariance)), slopes


def whitened(gauge: Gauge, seen: Array, moves: Sequence[Array]) -> list[Array]:
    """Small ``moves`` (drops, 4) of what is seen, each in sigma; a move of the height before is one
    of the values beside it, along their slopes."""
    whiten, slopes = _whitening(gauge, seen)
    columns = [1 + c for c in gauge.columns]
    beside = [each[:, columns] - slopes * each[:, :1] for each in moves]
    return [np.einsum("dij,dj->di", whiten, each).ravel() for each in beside]
