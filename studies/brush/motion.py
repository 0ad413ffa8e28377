"""Motions of a brush's hub: a stroke down that slides or rotates, or a path from a file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ...solver.errors import InputError
from ...solver.rods.hub import FASTEST_M_S, FASTEST_RAD_S, ORDER, HubPath
from ..data.tables import check_order, column, read_table

COLUMNS = ("t_s", "x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
X, Z, ABOUT_Z = 0, 2, 5
# Turn between two rows beyond which nobody knows which way round it goes.
WIDEST_RAD = math.pi * (1.0 + 1e-9)


def stroke(
    height_m: float, depth_m: float, start_s: float, speed_m_s: float, spin_rad_s: float
) -> HubPath:
    """The hub starts from rest at ``height_m``. Within ``start_s`` it comes down by ``depth_m``
    and reaches its speed along x and its rate of turning about the vertical; both then stay.

    With τ = t / start it sinks by 10 τ³ - 15 τ⁴ + 6 τ⁵ of the depth, and its speed grows as
    3 τ² - 2 τ³. Sinking and sliding begin alike, so that a bristle that stands upright on the
    surface is pushed aside from the first touch on.
    """
    path = np.zeros((ORDER, 2, 6))  # of falling powers of the time since a segment's begin
    path[-1, :, Z] = height_m, height_m - depth_m
    for power, factor in ((5, -6.0), (4, 15.0), (3, -10.0)):
        path[ORDER - 1 - power, 0, Z] = factor * depth_m / start_s**power
    for coordinate, rate in ((X, speed_m_s), (ABOUT_Z, spin_rad_s)):
        path[ORDER - 5, 0, coordinate] = -0.5 * rate / start_s**3
        path[ORDER - 4, 0, coordinate] = rate / start_s**2
        path[-2:, 1, coordinate] = rate, 0.5 * rate * start_s
    return HubPath(np.array([0.0, start_s, start_s + 1.0]), path)


def read_path(path: Path) -> HubPath:
    """A path from a CSV file with `COLUMNS`, as `HubPath.table` has it.

    Raises InputError, with the line, where it cannot be read, times do not grow, or the hub jumps
    from one row to the next.
    """
    rows = read_table(path, COLUMNS)
    t, *places = (column(path, rows, name) for name in COLUMNS)
    check_order(path, rows, "t_s", t)
    if len(t) < 2 or t[0] != 0.0:
        raise InputError(f"{path}: a path needs two rows or more, the first at t_s = 0")
    table = np.column_stack(places)
    moved = np.diff(table, axis=0)
    speed = np.linalg.norm(moved[:, :3], axis=1) / np.diff(t)
    turned = np.linalg.norm(moved[:, 3:], axis=1)
    rate = turned / np.diff(t)
    for i in np.flatnonzero((speed > FASTEST_M_S) | (turned > WIDEST_RAD) | (rate > FASTEST_RAD_S)):
        where = f"{path}:{rows[i + 1][0]}: the hub jumps"
        for value, most, unit in (
            (speed[i], FASTEST_M_S, "m/s"),
            (rate[i], FASTEST_RAD_S, "rad/s"),
        ):
            if value > most:
                raise InputError(
                    f"{where}: {value:.3g} {unit} from the row before; {most:g} is the most"
                )
        raise InputError(
            f"{where}: it turns by {turned[i]:.3g} rad from the row before; half a turn is the "
            "most, and a rotation vector may grow beyond 2 pi"
        )
    return HubPath.table(t, table)
