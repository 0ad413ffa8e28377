"""Rows of an impact's force record that do not depend on when it was triggered.

A record is samples of force on a clock of its own. It is laid over simulated histories until the
best of them, at its best time, leaves least. About that time the record is linear in the amounts of
a few shapes (`force_curves`), and moving it in time is two directions more, to second order, which
are projected out. What remains are rows: orthonormal combinations of samples, each with unit noise,
the shapes that carry most first. The sensor is taken to follow the force at once: a slow one is not
in this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array

BEST, BEST_COARSE = 6, 24
"""Histories that are tried at finer times, and how many where samples are too coarse to choose."""
LEAST_KNOWN = 0.5
"""A row is kept where its shape's usual amount is more than this share of its error."""
BEFORE = 0.1
FINE = 41
CLEARLY = 6.0
FULL = 4
"""Samples for every shape from which the shapes themselves say what moving a record does."""


@dataclass(frozen=True)
class Record:
    """Samples of one drop: ``t_s``, ``force_N`` (samples,), and their deviation in N."""

    t_s: Array
    force_N: Array
    sigma_N: float


@dataclass(frozen=True)
class Placed:
    """A record over a history: the touch's time, which history (of those tried), its size."""

    touch_s: float
    which: int
    size: float
    misfit: float


@dataclass(frozen=True)
class Rows:
    """``values`` (rows,) = ``weights`` (rows, shapes) @ amounts in N + unit noise.

    ``leading`` (rows,) numbers the shape that a row is about, ``known`` (rows,) is one over the
    error of its amount, in 1/N. ``left`` is the sum of squares of the ``freedom`` other
    combinations of samples, with what no shape holds.
    """

    values: Array
    weights: Array
    leading: NDArray[np.int64]
    known: Array
    left: float
    freedom: int


def at_times(curves: Array, cell_s: float, since_s: Array) -> Array:
    """Curves (..., cells) at times (n,) since the touch, (..., n); zero outside."""
    place = since_s / cell_s - 0.5
    low = np.floor(place).astype(np.int64)
    share = place - low
    cells = curves.shape[-1]
    padded = np.concatenate(
        [np.zeros((*curves.shape[:-1], 1)), curves, np.zeros((*curves.shape[:-1], 1))], axis=-1
    )
    first, second = np.clip(low + 1, 0, cells + 1), np.clip(low + 2, 0, cells + 1)
    inside = (low >= -1) & (low < cells)
    mixed = (1.0 - share) * padded[..., first] + share * padded[..., second]
    return np.asarray(np.where(inside, mixed, 0.0))


def place(record: Record, curves: Array, cell_s: float, plain: int) -> Placed:
    """Where the touch lies, by the best of ``curves`` (curves, cells), each of free size.

    The first ``plain`` of them are preferred to any other that is not clearly better: few samples
    can be met by odd histories at odd times.
    """
    best = _placed(record, curves[:plain], cell_s)
    if plain < len(curves):
        other = _placed(record, curves[plain:], cell_s)
        if other.misfit + CLEARLY * record.sigma_N**2 < best.misfit:
            return replace(other, which=other.which + plain)
    return best


def _placed(record: Record, curves: Array, cell_s: float) -> Placed:
    """The best of ``curves`` at its best time."""
    step = max(float(np.median(np.diff(record.t_s))), cell_s)
    begin, end = float(record.t_s[0]), float(record.t_s[-1])
    grid = np.arange(begin, end + step, step)
    sampled = np.interp(grid, record.t_s, record.force_N, left=0.0, right=0.0)
    length = curves.shape[1] * cell_s
    own = at_times(curves, cell_s, np.arange(0.5 * step, length, step))
    size = 1 << int(np.ceil(np.log2(len(grid) + 2 * own.shape[1])))
    spectrum = np.fft.rfft(sampled, size) * np.conj(np.fft.rfft(own, size, axis=1))
    together = np.fft.irfft(spectrum, size, axis=1)
    shifts = np.fft.fftfreq(size, 1.0 / size).round().astype(np.int64)
    allowed = (shifts > -0.2 * own.shape[1]) & (shifts < len(grid))
    gain = np.maximum(together, 0.0) ** 2 / np.maximum((own**2).sum(axis=1), 1e-300)[:, None]
    gain[:, ~allowed] = 0.0
    at = gain.argmax(axis=1)
    count = BEST if step < 4.0 * cell_s else BEST_COARSE
    order = np.argsort(-gain[np.arange(len(curves)), at])[:count]
    found = []
    for i in order:
        middle = begin + float(shifts[at[i]]) * step - 0.5 * step
        for width in (1.5 * step, 0.15 * step, 0.015 * step):
            trial = middle + np.linspace(-width, width, FINE)
            costs = [_cost(record, curves[i], cell_s, touch)[0] for touch in trial]
            middle = float(trial[int(np.argmin(costs))])
        misfit, amount = _cost(record, curves[i], cell_s, middle)
        found.append(Placed(middle, int(i), amount, misfit))
    return min(found, key=lambda each: each.misfit)


def _cost(record: Record, curve: Array, cell_s: float, touch_s: float) -> tuple[float, float]:
    """Sum of squares that a curve leaves, and its best size."""
    used = _window(record, touch_s, len(curve) * cell_s)
    force = record.force_N[used]
    shape = at_times(curve, cell_s, record.t_s[used] - touch_s)
    size = float(force @ shape) / max(float(shape @ shape), 1e-300)
    # samples before the touch count too: nothing presses then
    outside = record.force_N[~used & (record.t_s < touch_s)]
    return float(np.sum((force - size * shape) ** 2)) + float(outside @ outside), size


def _window(record: Record, touch_s: float, length_s: float) -> NDArray[np.bool_]:
    since = record.t_s - touch_s
    return (since > -BEFORE * length_s) & (since < length_s)


def rows(
    record: Record,
    placed: Placed,
    curve: Array,
    shapes: Array,
    cell_s: float,
    usual_N: Array,
    trusted: NDArray[np.bool_],
) -> Rows:
    """The rows of a record; ``usual_N`` (shapes,) are the shapes' usual amounts.

    Shapes that are not ``trusted`` (shapes,), since their tables are less sure than the records,
    are projected out like the touch's time.
    """
    used = _window(record, placed.touch_s, shapes.shape[1] * cell_s)
    since = record.t_s[used] - placed.touch_s
    force = record.force_N[used] / record.sigma_N
    columns = at_times(shapes, cell_s, since).T / record.sigma_N
    # moved in time, to second order: a history that is not quite the record's puts the touch off
    if len(since) > FULL * len(shapes):
        whole = np.linalg.lstsq(columns, force, rcond=1e-6)[0] @ shapes
    else:
        whole = placed.size * curve
    before, now, after = (
        at_times(whole, cell_s, since + shift * cell_s) for shift in (-1.0, 0.0, 1.0)
    )
    moved = np.column_stack([after - before, after - 2.0 * now + before])
    moved /= np.maximum(np.linalg.norm(moved, axis=0), 1e-300)
    away, _ = np.linalg.qr(np.column_stack([moved, columns[:, ~trusted]]))
    basis = list(away.T)
    leading, known = [], []
    for k in np.flatnonzero(trusted):
        column = columns[:, k]
        for _ in range(2):  # once more against rounding
            for each in basis:
                column = column - each * (each @ column)
        size = float(np.linalg.norm(column))
        if size * usual_N[k] > LEAST_KNOWN:
            basis.append(column / size)
            leading.append(k)
            known.append(size)
    directions, aside = np.array(basis), away.shape[1]
    amounts = directions @ force
    residual = force - directions.T @ amounts
    return Rows(
        values=amounts[aside:],
        weights=directions[aside:] @ columns,
        leading=np.array(leading, dtype=np.int64),
        known=np.array(known),
        left=float(residual @ residual),
        freedom=len(force) - len(directions),
    )
