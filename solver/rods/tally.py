"""Means over time windows: force and torque of rods on their hub, and shares of rods in contact.

A window is a short span of time, the same for all rods. Each rod has time steps of its own and adds
the integral over its steps, with forces linear within a step. The integral over a window, divided
by its width, is the mean. Means of single rods add up to that of all. Forces at an instant would
not do: between two instants a tip may bounce.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import njit
from .hub import hub_coordinates
from .motion import TIME, Hub, Motion
from .observe import meet
from .rotation import cross

# Columns of a tally: force, torque, then one each for rods that touch, stick, slip.
COLUMNS, STATE = 9, 6


@dataclass(frozen=True)
class Means:
    """Means over consecutive windows of time, the first from ``begin_s`` on.

    Parameters
    ----------
    begin_s, end_s : (w,), begin and end of each window
    force_N, torque_Nm : (w, 3), of the bristles on the hub; the torque is about the hub's origin
    share : (w, 3), of bristles that touch the surface, stick, slip; over time and bristles
    """

    begin_s: Array
    end_s: Array
    force_N: Array
    torque_Nm: Array
    share: Array

    @classmethod
    def of(cls, begin_s: float, end_s: float, sums: Array, rods: int) -> Means:
        """Means from the ``sums`` (w, `COLUMNS`) that `add_step` gathered over this many rods."""
        ends = np.linspace(begin_s, end_s, len(sums) + 1)
        mean = sums / np.diff(ends)[:, None]
        return cls(ends[:-1], ends[1:], mean[:, :3], mean[:, 3:STATE], mean[:, STATE:] / rods)

    @classmethod
    def none(cls) -> Means:
        """Means over no window."""
        return cls.of(0.0, 0.0, np.zeros((0, COLUMNS)), 1)


@njit
def _write_row(hub: Hub, now: Motion, row: Array) -> None:
    """Write a rod's contribution at one instant to the columns of a tally."""
    pose, met = np.empty((2, 6)), np.zeros(3)
    hub_coordinates(hub.breaks, hub.coefficients, now.totals[TIME], pose)
    for c in range(6):
        row[c] = -now.reaction[c]
    arm = now.x[0, 0] - pose[0, 0], now.x[0, 1] - pose[0, 1], now.x[0, 2] - pose[0, 2]
    turn = cross(arm, row)
    for c in range(3):
        row[3 + c] += turn[c]
    meet(now, met)
    row[STATE] = 1.0 if met[2] > 0.0 else 0.0
    row[STATE + 1] = 1.0 if met[2] == 1.0 else 0.0
    row[STATE + 2] = 1.0 if met[2] == 2.0 else 0.0


class Windows(NamedTuple):
    """Windows of means: the first one's begin, their width in s, and sums (rods, w, `COLUMNS`)."""

    begin_s: float
    width_s: float
    sums: Array


@njit
def add_step(hub: Hub, old: Motion, new: Motion, windows: Windows, i: int) -> None:
    """Add the step of rod ``i`` from ``old`` to ``new`` to its sums: integrals over time by the
    trapezoidal rule."""
    begin_s, width_s, sums = windows.begin_s, windows.width_s, windows.sums[i]
    first, last = np.empty(COLUMNS), np.empty(COLUMNS)
    _write_row(hub, old, first)
    _write_row(hub, new, last)
    start, h = old.totals[TIME], new.totals[TIME] - old.totals[TIME]
    done = 0.0
    while done < 1.0:
        k = int((start + done * h - begin_s) / width_s + 1e-9)
        k = min(max(k, 0), len(sums) - 1)
        upto = 1.0
        if k < len(sums) - 1:
            upto = min(max((begin_s + (k + 1) * width_s - start) / h, done + 1e-12), 1.0)
        middle = 0.5 * (done + upto)
        for c in range(COLUMNS):
            sums[k, c] += (upto - done) * h * ((1.0 - middle) * first[c] + middle * last[c])
        done = upto
