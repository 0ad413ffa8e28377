"""Rows of a table of drops that somebody wrote down wrongly: slips, repeated and exchanged rows.

A reading is compared with what the other drops make of its height, by the baseline's prediction
times a smooth function that is fitted robustly to all drops, so no effect need be known. A row is a
slip where that is likelier than noise by Bayes' rule, outliers among the noise.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.special import log_softmax, logsumexp

from .....solver.arrays import Array
from ...noise import DECLARED, SHAPES, log_density_at
from ...problem import Entry
from ...slips import ANYTHING, FEWEST, REACH, SLIP, SURE, are_too_many

# Slips in a pattern of a smaller chance are a shape.
PATTERN = 0.01
# Coincidences that are expected: below it a row that comes twice was written twice.
COINCIDENT = 0.01
DEGREE, DECIMALS = 3, 6
# The core scale at which each noise that `noise` declares is looked at. What is no other is normal.
CORES = {"gaussian": 1.0, "t5": 0.78, "t3": 0.65, "outliers": 1.0}
OTHERS = {name: DECLARED[name][0] for name in CORES if name != "gaussian"}
PRIOR = {"gaussian": 1.0 - sum(OTHERS.values()), **OTHERS}
# Of slips: a displaced point, a missing or doubled digit, two exchanged ones, exchanged columns.
KINDS = 5
# Standard deviations from which on a row is looked at.
SUSPECT = 4.0
# At least this share of the heights has no slip.
USUAL = 0.9
# Heights that were meant are within this factor of all others.
BEYOND = 1.2


@dataclass(frozen=True)
class Table:
    """Drops as they were written: ``number``, ``y0_m`` (drops,), ``values`` (drops, q) in SI, with
    NaN where nothing was read, their ``sigma`` (drops, q) for a height as it was read, and that of
    the height itself. ``columns`` name them, ``unit`` takes each to what the table has.

    ``predict`` gives the baseline's values (drops, q) from other heights (drops,).
    """

    number: NDArray[np.int64]
    y0_m: Array
    values: Array
    sigma: Array
    sigma_y0_m: float
    columns: tuple[str, ...]
    unit: tuple[float, ...]
    predict: Callable[[Array], Array]

    @cached_property
    def tenfold(self) -> NDArray[np.bool_]:
        """Which drops (drops,) have a height that seems ten times too large: it lies far above the
        others, and a tenth of it suits the readings better. They would bend a fitted course."""
        above = self.y0_m > float(np.quantile(self.y0_m, USUAL, method="lower")) * math.sqrt(10.0)

        def far(y0_m: Array) -> Array:
            ratio = np.abs(self.values) / self.predict(y0_m)
            return np.nanmedian(np.abs(np.log(np.maximum(ratio, 1e-9))), axis=1)

        if not above.any():
            return above
        return np.asarray(above & (far(0.1 * self.y0_m) < far(self.y0_m)))


def misread(table: Table, before: float = 0) -> tuple[list[Entry], bool]:
    """What the table has wrong, by row, and whether there are too many slips to be slips: then none
    is returned. Of repeated rows the first is as it should be. ``before`` is how many numbers were
    wrong in rows that were set aside before."""
    if len(table.y0_m) < FEWEST:
        return [], False
    found = _repeated(table)
    again = [drop for entry in found for drop in entry.drops[1:]]
    smooth = Smooth.of(table)
    z = smooth.off(np.arange(len(table.y0_m)), table.y0_m, table.values)
    noise = _noise(smooth, z)
    suspects = [
        int(row)
        for row in np.flatnonzero((np.abs(z) > SUSPECT).any(axis=1))
        if table.number[row] not in again
    ]
    pairs = _exchanged(smooth, noise, suspects)
    alone = [row for row in suspects if row not in itertools.chain(*pairs)]
    number = [int(each) for each in table.number]
    slips = [
        Entry("exchanged", (number[i], number[j]), "their y1_mm would fit each other's y0_mm")
        for i, j in pairs
    ]
    rows = [*itertools.chain(*pairs)]
    for row in alone:
        if slip := _slip(smooth, z, noise, row):
            rows.append(row)
            slips.append(Entry("slip", (number[row],), *slip))
    wrong = before + sum(each.slips for each in slips)
    if are_too_many(wrong, int(np.isfinite(table.values).sum())):
        return found, True
    return (found, False) if _in_a_pattern(table, rows) else (found + slips, False)


def _in_a_pattern(table: Table, rows: list[int]) -> bool:
    """Whether rows lie close together in the order or in the heights, or come at even distances in
    the order, as few would by chance."""
    n, count = len(table.y0_m), len(rows)
    if count < 2:
        return False
    heights = np.where(table.tenfold, 0.1 * table.y0_m, table.y0_m)
    ranks = (np.arange(n), np.argsort(np.argsort(heights, kind="stable")))
    width = 1 + min(int(np.ptp(rank[rows])) for rank in ranks)
    # ways to choose as many rows within the width, in the order or in the heights
    several, fewer = math.comb(width, count), math.comb(width - 1, count)
    ways = 2 * ((n - width + 1) * several - (n - width) * fewer)
    if np.ptp(np.diff(np.sort(rows))) == 0:
        # a first row, and a distance that the last one allows
        ways = min(ways, n * n // (2 * (count - 1)))
    return ways / math.comb(n, count) < PATTERN


def _repeated(table: Table) -> list[Entry]:
    """Rows that hold what another one does, to the last digit."""
    every = np.column_stack([1e3 * table.y0_m, table.values * table.unit])
    read: dict[bytes, list[int]] = {}
    for row in np.flatnonzero(np.isfinite(every).sum(axis=1) > 1):
        read.setdefault(np.round(every[row], DECIMALS).tobytes(), []).append(int(row))
    n, near = len(every), 5.0 * table.sigma_y0_m
    heights = np.sort(table.y0_m)
    pairs = np.sum(np.searchsorted(heights, heights + near) - np.arange(1, n + 1))
    chance = _quantum(every[:, 0]) * 1e-3 * pairs / (2.0 * near)
    for q, unit in enumerate(table.unit):
        wide = 2.0 * math.sqrt(math.pi) * float(np.median(table.sigma[:, q]) * unit)
        chance *= min(_quantum(every[:, 1 + q]) / wide, 1.0)
    if chance > COINCIDENT:
        return []
    return [
        Entry(
            "repeated",
            tuple(int(table.number[row]) for row in rows),
            "these rows hold the same numbers, to the last digit; the first is kept",
        )
        for rows in read.values()
        if len(rows) > 1
    ]


def _quantum(values: Array) -> float:
    """The last decimal that a column has, in its unit."""
    finite = values[np.isfinite(values)]
    for digits in range(DECIMALS):
        if np.allclose(finite, np.round(finite, digits), rtol=0.0, atol=10.0 ** -(DECIMALS + 1)):
            return float(10.0**-digits)
    return float(10.0**-DECIMALS)


@dataclass(frozen=True)
class Smooth:
    """What the drops together make of each reading: the baseline times ``factors`` (terms, q) of
    polynomials of the height and the order. ``width`` (q,) multiplies the table's sigma."""

    table: Table
    factors: Array
    width: Array

    @classmethod
    def of(cls, table: Table) -> Smooth:
        """The robust fit: Tukey's bisquare, from the medians (statsmodels' RLM)."""
        import statsmodels.api as sm  # slow to import: not before there is a table

        every = np.arange(len(table.y0_m))
        predicted, terms = table.predict(table.y0_m), _terms(table, every, table.y0_m)
        found = cls(
            table, np.zeros((terms.shape[1], predicted.shape[1])), np.ones(predicted.shape[1])
        )
        for q, sigma in enumerate(table.sigma.T):
            there = np.isfinite(table.values[:, q]) & ~table.tenfold
            design = terms[there] * (predicted[:, q] / sigma)[there, None]
            seen = (table.values[:, q] / sigma)[there]
            if seen.size <= 2 * terms.shape[1]:
                found.factors[0, q] = float(np.median(seen / design[:, 0]))
                continue
            with warnings.catch_warnings():  # of values that are all the same
                warnings.simplefilter("ignore")
                fit = sm.RLM(seen, design, M=sm.robust.norms.TukeyBiweight()).fit()
            found.factors[:, q] = fit.params
            spread = float(np.median(np.abs(seen - design @ fit.params)))
            found.width[q] = max(1.4826 * spread, 1.0)
        return found

    def off(self, rows: NDArray[np.int64], y0_m: Array, values: Array) -> Array:
        """Residuals (n, q), in standard deviations, of ``values`` (n, q) from heights (n,) that
        stand in ``rows`` (n,)."""
        terms = _terms(self.table, rows, y0_m)
        expected = self.table.predict(y0_m) * (terms @ self.factors)
        return np.asarray((values - expected) / (self.width * self.table.sigma[rows]))

    @property
    def anywhere(self) -> Array:
        """Log density (drops, q) of what could be anything, over a standard deviation."""
        reach = REACH * np.nanmax(np.abs(self.table.values), axis=0)
        return np.asarray(np.log(self.width * self.table.sigma / reach))


def _terms(table: Table, rows: NDArray[np.int64], y0_m: Array) -> Array:
    """Polynomials (n, terms) of the height and of the logarithm of the order."""
    fitted = table.y0_m[~table.tenfold]
    low, high = fitted.min(), fitted.max()
    spread = high - low > 5.0 * table.sigma_y0_m
    heights = np.clip(2.0 * (y0_m - low) / max(high - low, 1e-9) - 1.0, -1.0, 1.0)
    degree = min(DEGREE, len(table.y0_m) // 8) if spread else 0
    order = np.log1p(np.arange(len(table.y0_m)))
    return np.column_stack(
        [legvander(heights, degree), ((order - order.mean()) / order.std())[rows]]
    )


def _noise(smooth: Smooth, z: Array) -> Array:
    """Log densities (drops, q) of residuals under noise of the shape that all others have."""
    there = np.isfinite(z)
    shapes = np.array(
        [
            log_density_at(np.where(there, z, 0.0) / core, SHAPES.index(name)) - math.log(core)
            for name, core in CORES.items()
        ]
    )
    each = np.where(there, np.logaddexp(shapes, math.log(SLIP + ANYTHING) + smooth.anywhere), 0.0)
    others = each.sum(axis=(1, 2), keepdims=True) - each
    prior = np.log([PRIOR[name] for name in CORES])[:, None, None]
    weight = log_softmax(others + prior, axis=0)
    return np.where(there, logsumexp(shapes + weight, axis=0), 0.0)


def _slip(smooth: Smooth, z: Array, noise: Array, row: int) -> tuple[str, int] | None:
    """Why a row is taken for a slip, and how many of its numbers are wrong: one, and those that are
    still far off without it. None if it is no slip."""
    table, usual = smooth.table, float(noise[row].sum())
    y0_m, own = table.y0_m[row], table.values[row]
    told = [(usual + math.log1p(-SLIP - ANYTHING), "", 0)]

    def far_off(residuals: Array) -> int:
        return int(np.sum(np.abs(residuals) > SUSPECT))

    def add(words: str, others: float, share: Array, off: Array, also: int) -> None:
        logs = others + _normal(off) + np.log(SLIP * share / KINDS)
        told.append((float(logsumexp(logs)), words, also))

    for q in np.flatnonzero(np.isfinite(own)):
        also = far_off(np.delete(z[row], q))
        shown = f"{table.columns[q]} of {own[q] * table.unit[q]:.6g}"
        others = usual - float(noise[row, q])
        size = f"{shown} is {abs(z[row, q]):.2g} standard deviations off"
        anything = others + math.log(ANYTHING) + float(smooth.anywhere[row, q])
        told.append((anything, size, also))
        written, share, how = meant(float(own[q] * table.unit[q]))
        values = np.tile(own, (written.size, 1))
        values[:, q] = written / table.unit[q]
        off = smooth.off(np.full(written.size, row), np.full(written.size, y0_m), values)[:, [q]]
        best = int(np.argmax(_normal(off) + np.log(share)))
        add(f"{shown}: {how[best]}, {written[best]:.6g} would fit", others, share, off, also)
    written, share, how = meant(1e3 * float(y0_m))
    others_m = np.delete(table.y0_m, row)
    meant_m = 1e-3 * written
    there = (meant_m > others_m.min() / BEYOND) & (meant_m < others_m.max() * BEYOND)
    if there.any():  # heights were chosen, and no drop is from far beside the others
        rows, every = np.full(written.size, row), np.tile(own, (written.size, 1))
        off = smooth.off(rows, meant_m, every)
        logs = np.where(there, _normal(off) + np.log(share), -np.inf)
        best = int(np.argmax(logs))
        words = f"y0_mm of {1e3 * y0_m:.6g}: {how[best]}, {written[best]:.6g} would fit"
        add(words, 0.0, share[there], off[there], far_off(off[best]))
    if own[0] > 0.0:
        exchanged = np.concatenate([[y0_m], own[1:]])[None]
        off = smooth.off(np.array([row]), own[:1], exchanged)
        add("y0_mm and y1_mm have changed places", 0.0, np.ones(1), off, far_off(off))
    logs = log_softmax([log for log, *_ in told])
    _, words, also = told[1 + int(np.argmax(logs[1:]))]
    if -math.expm1(logs[0]) <= SURE:
        return None
    if also:
        words += ", and other numbers of this drop are far off as well"
    return words, 1 + also


def _exchanged(smooth: Smooth, noise: Array, suspects: list[int]) -> list[tuple[int, int]]:
    """Pairs of rows whose heights after have changed places."""
    table, found = smooth.table, list[tuple[int, int]]()
    for i, j in itertools.combinations(suspects, 2):
        if {i, j} & set(itertools.chain(*found)):
            continue
        rows, values = np.array([i, j]), table.values[[i, j]]
        values[:, 0] = values[::-1, 0]
        swapped = float(_normal(smooth.off(rows, table.y0_m[rows], values)[:, :1]).sum())
        slips = 2.0 * math.log(SLIP) + float(smooth.anywhere[rows, 0].sum())
        usual = max(float(noise[rows, 0].sum()), slips)
        if swapped + math.log(SLIP / len(noise)) - usual > math.log(SURE / (1.0 - SURE)):
            found.append((i, j))
    return found


def meant(value: float) -> tuple[Array, Array, list[str]]:
    """Numbers (n,) that may have been meant by one that is written, which share (n,) of the slips
    of its kind turns each of them into it, and what happened."""
    text = f"{value:.{DECIMALS}f}".rstrip("0").rstrip(".")
    places = [i for i, letter in enumerate(text) if letter.isdigit()]
    one = 1.0 / len(places)
    found = [(value * factor, 0.5, "the point is displaced") for factor in (10.0, 0.1)]
    for i in range(places[0], len(text) + 1):
        more = (float(text[:i] + digit + text[i:]) for digit in "0123456789")
        found += [(each, one, "a digit is missing") for each in more]
    for i, j in itertools.pairwise(places):
        less = text[:i] + text[i + 1 :]
        if text[i] == text[j]:
            found.append((float(less), 1.0, "a digit is doubled"))
        elif j == i + 1:
            turned = text[:i] + text[j] + text[i] + text[j + 1 :]
            found.append((float(turned), one, "two digits have changed places"))
    written, share, how = zip(*found, strict=True)
    return np.array(written), np.array(share), list(how)


def _normal(z: Array) -> Array:
    """Log densities (n,) of residuals (n, q) under the noise that was declared."""
    there = np.isfinite(z)
    each = -0.5 * np.where(there, z, 0.0) ** 2 - 0.5 * math.log(2.0 * math.pi) * there
    return np.asarray(each.sum(axis=-1))
