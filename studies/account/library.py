"""How do many drops under given conditions come out, computed or read from a table of drops?

A table is filled once, in chunks dealt out over the ranks; between its points it is interpolated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...solver import paper
from ...solver.batch import Drops, Outcome, drop_each
from ...solver.bodies.beam import beam_body
from ...solver.bristle import Array, Bristle, Material
from ...solver.contact import laws
from ...solver.contact.enforcement import ContactMethod
from ...solver.time.march import Marcher
from ...solver.time.scheme import TimeScheme
from ..calibration.curve import short_its_s
from ..running.parallel import share_out

POINTS = 5
# The budget closes to the ITS's error, some 10^-3; where energy is made it is off by far more.
CLOSURE = 0.02
CHUNK = 120


def no_tick() -> None:
    """Nothing to tell."""


def damped_law() -> Any:
    """The contact law with a dashpot, or None where the solver has none yet."""
    return getattr(laws, "Damped", None)


class Conditions(NamedTuple):
    """What a drop meets, arrays of one shape.

    ``side_deg`` is the direction of the lean: 0 toward the thin side, 90 toward the wide one.
    ``damping_N_s_m`` is that of the dashpot in the contact.
    """

    height_m: Array
    lean_deg: Array
    side_deg: Array
    mu: Array
    kn_N_m: Array
    damping_N_s_m: Array

    @classmethod
    def of(
        cls,
        height_m: Array | float,
        *,
        lean_deg: Array | float = 0.0,
        side_deg: Array | float = 0.0,
        mu: Array | float = paper.FRICTION,
        kn_N_m: Array | float = paper.KN_CHOSEN_N_M,
        damping_N_s_m: Array | float = 0.0,
    ) -> Conditions:
        """Conditions of one shape from arrays and numbers that broadcast."""
        values = (height_m, lean_deg, side_deg, mu, kn_N_m, damping_N_s_m)
        return cls(*(np.array(v, float) for v in np.broadcast_arrays(*values)))

    @property
    def tilts_deg(self) -> tuple[Array, Array]:
        """The lean toward the thin and the wide side, as the solver wants it."""
        steep, side = np.tan(np.radians(self.lean_deg)), np.radians(self.side_deg)
        tilt, wide = np.arctan(steep * np.cos(side)), np.arctan(steep * np.sin(side))
        return np.degrees(tilt), np.degrees(wide)

    def take(self, which: Any) -> Conditions:
        """Those of the drops ``which``, as flat arrays."""
        return Conditions(*(np.atleast_1d(value[which]) for value in self))


@lru_cache(maxsize=64)
def _marcher(bristle: Bristle, its_s: float, damping_N_s_m: float) -> Marcher:
    body = beam_body(bristle, paper.ELEMENTS, points=POINTS, second_order=True)
    law: Any = laws.Linear(paper.KN_CHOSEN_N_M)
    if damping_N_s_m > 0.0:
        law = laws.Damped(paper.KN_CHOSEN_N_M, damping_N_s_m)
    method = ContactMethod(law)
    return Marcher(body, method, TimeScheme.average(), its_s, paper.GRAVITY_M_S2)


@lru_cache(maxsize=8)
def bristle_of(beta_s: float, length_m: float = paper.LENGTH_M) -> Bristle:
    """The paper's bristle with this damping and length."""
    return Bristle(length_m=length_m, material=Material(beta_s=beta_s))


def drops_under(conditions: Conditions, bristle: Bristle) -> Outcome:
    """Every drop, ``conditions`` of shape (n,), by the beam to second order in its slope.

    The ITS is the paper's, or shorter where the contact is stiffer than the paper's choice or
    its forces do not converge. What fails all the same is not `sound`.
    """
    out = np.empty((len(Outcome._fields), len(conditions.height_m)))
    groups: dict[tuple[float, float], list[int]] = {}
    for i, (kn, c) in enumerate(zip(conditions.kn_N_m, conditions.damping_N_s_m, strict=True)):
        groups.setdefault((_its_s(bristle, float(kn)), float(c)), []).append(i)
    for (its_s, damping), members in groups.items():
        out[:, members] = _rows(conditions.take(members), bristle, its_s, damping)
    return Outcome(*out)


def _rows(at: Conditions, bristle: Bristle, its_s: float, damping_N_s_m: float) -> Array:
    """Rows of `Outcome` (fields, n) at one ITS, or at shorter ones for drops that fail.

    One that fails at all of them has NaN and an energy budget that does not close.
    """

    def marcher_at(its: float) -> Marcher:
        return _marcher(bristle, its, damping_N_s_m)

    tilt, wide = at.tilts_deg
    drops = Drops.on_plane(
        len(marcher_at(its_s).body.contact.weights),
        height_m=at.height_m,
        kn_N_m=at.kn_N_m,
        tilt_deg=tilt,
        tilt_wide_deg=wide,
        mu=at.mu,
    )
    found = drop_each(marcher_at, drops, its_s)
    closure = np.nan_to_num(found.closure_relative, nan=np.inf)
    return np.array(found._replace(closure_relative=closure))


def _its_s(bristle: Bristle, kn_N_m: float) -> float:
    """The paper's ITS up to its Kn, above it what the curve of y1/y0 over Kn is made with."""
    if kn_N_m <= paper.KN_CHOSEN_N_M:
        return paper.ITS_S
    step = short_its_s(bristle.mass_kg, kn_N_m) * 5.0
    return float(f"{min(max(step, 1e-7), paper.ITS_S):.0e}")


@dataclass(frozen=True)
class Grid:
    """Where a table has drops. ``slip`` is μ over the tangent of the lean: a tip slips below one.

    In these coordinates y1/y0 is smooth but for a kink at ``slip`` = 1. A ``mu`` that is given
    holds for all drops, and takes the place of ``slip``.
    """

    beta_s: float
    lean_deg: tuple[float, ...] = (0.0,)
    side_deg: tuple[float, ...] = (0.0,)
    slip: tuple[float, ...] = (0.0,)
    kn_N_m: tuple[float, ...] = (paper.KN_CHOSEN_N_M,)
    damping_N_s_m: tuple[float, ...] = (0.0,)
    height_m: tuple[float, ...] = (paper.HEIGHTS_M[-1],)
    mu: float | None = None

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        return (
            self.lean_deg,
            self.side_deg,
            self.slip,
            self.kn_N_m,
            self.damping_N_s_m,
            self.height_m,
        )

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(map(len, self.axes))

    def conditions(self) -> Conditions:
        """All drops of the table, (n,), the last axis running fastest."""
        lean, side, slip, kn, c, height = np.array(list(itertools.product(*self.axes))).T
        mu = slip * np.tan(np.radians(lean)) if self.mu is None else self.mu
        return Conditions.of(
            height, lean_deg=lean, side_deg=side, mu=mu, kn_N_m=kn, damping_N_s_m=c
        )

    def coordinates(self, at: Conditions) -> list[Array]:
        """Where on the axes ``at`` lies; Kn, damping and height by their logarithms."""
        slip = at.mu / np.maximum(np.tan(np.radians(at.lean_deg)), 1e-12)
        values = (at.lean_deg, at.side_deg, slip, at.kn_N_m, at.damping_N_s_m, at.height_m)
        return [np.asarray(value) for value in values]


LOGARITHMIC = (False, False, False, True, True, True)


def sound(outcome: Outcome) -> NDArray[np.bool_]:
    """Which drops have an energy budget that closes, (n,).

    Bristles that fall nearly flat without friction touch many times, and their march may gain
    energy; what it says of them is not to be used.
    """
    return np.asarray(outcome.closure_relative < CLOSURE)


@dataclass
class Library:
    """y1/y0 of the drops of a grid, interpolated linearly; constant beyond its ends.

    ``centre_ratio`` is the same read at the centre of mass. Drops that came out as NaN take the
    value of the next smaller lean; ``mended`` counts them.
    """

    grid: Grid
    ratio: Array
    centre_ratio: Array
    mended: int = field(init=False)
    _places: list[int] = field(init=False)

    def __post_init__(self) -> None:
        self._places = [i for i, n in enumerate(self.grid.shape) if n > 1]
        values = self.ratio.reshape(self.grid.shape).copy()
        self.mended = int(np.count_nonzero(np.isnan(values)))
        for i in range(1, len(values)):
            values[i] = np.where(np.isnan(values[i]), values[i - 1], values[i])
        self._values = np.ascontiguousarray(values.squeeze())

    def at(self, conditions: Conditions) -> Array:
        """y1/y0, of the shape of the conditions."""
        from scipy.ndimage import map_coordinates

        found = self.grid.coordinates(conditions)
        shape = conditions.height_m.shape
        index = [self._index(i, found[i]).ravel() for i in self._places]
        if not index:
            return np.full(shape, float(self._values))
        values = map_coordinates(self._values, index, order=1, mode="nearest", prefilter=False)
        return np.asarray(values).reshape(shape)

    def of_centre(self) -> Library:
        """The same drops read at the centre of mass."""
        return Library(self.grid, self.centre_ratio, self.centre_ratio)

    def _index(self, i: int, value: Array) -> Array:
        axis = np.array(self.grid.axes[i])
        if LOGARITHMIC[i]:
            axis, value = np.log(axis), np.log(np.maximum(value, 1e-300))
        return np.interp(value, axis, np.arange(len(axis)))


def fill(
    grids: list[Grid], comm: Any, tick: Callable[[], None] = no_tick, chunk: int = CHUNK
) -> dict[Grid, Library]:
    """The tables of ``grids``, the same on every rank and for every number of ranks. Collective."""
    jobs = [(grid, first) for grid in dict.fromkeys(grids) for first in _chunks(grid, chunk)]
    pieces: dict[int, Array] = {}

    def work(i: int) -> Array:
        grid, first = jobs[i]
        part = grid.conditions().take(slice(first, first + chunk))
        outcome = drops_under(part, bristle_of(grid.beta_s))
        tops = np.array([outcome.rebound_height_m, outcome.cm_rebound_height_m])
        return np.where(sound(outcome), tops / part.height_m, np.nan)

    def take(i: int, ratio: Array) -> None:
        pieces[i] = ratio
        tick()

    share_out(comm, len(jobs), work, take)
    pieces = comm.bcast(pieces)
    filled: dict[Grid, list[Array]] = {}
    for i, (grid, _) in enumerate(jobs):
        filled.setdefault(grid, []).append(pieces[i])
    return {grid: Library(grid, *np.concatenate(parts, axis=1)) for grid, parts in filled.items()}


def count_chunks(grids: list[Grid], chunk: int = CHUNK) -> int:
    """How often `fill` calls its ``tick``."""
    return sum(len(_chunks(grid, chunk)) for grid in dict.fromkeys(grids))


def _chunks(grid: Grid, chunk: int) -> range:
    return range(0, math.prod(grid.shape), chunk)
