"""Noise hypotheses: densities, lag-one correlation, and the likelihood of rows under them.

A dataset declares a standard deviation and no more. Tails, outliers, correlation and a sigma that
was declared somewhat wrong are hypotheses of their own, a grid of noises that every model may
choose from. The grid is bounded on purpose: a core of at most `MOST_SCALE` declared standard
deviations, and correlation only of normal noise of the declared size. Noise may be odd or it may be
large, but what is both is something that the model lacks.

Every density is tabulated once, so the compiled kernel costs one look-up a row, whatever the shape.
Scale mixtures against outliers: Huber and Ronchetti, Robust Statistics (2009), §4; Student's t:
Lange, Little and Taylor, J. Am. Stat. Assoc. 84 (1989) 881.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from ...solver.arrays import Array
from ...solver.compiled import njit

Ints = NDArray[np.int64]

STEP = 0.01
REACH = 60.0
SHAPES = ("gaussian", "t5", "t3", "outliers")
OUTLIER_SHARE, OUTLIER_WIDTH = 0.06, 6.0
MOST_SCALE = 1.3
# By shape: its prior weight, and core scales in declared standard deviations.
DECLARED: dict[str, tuple[float, tuple[float, ...]]] = {
    "gaussian": (0.22, (0.7, 0.85, 1.1, 1.2, MOST_SCALE)),
    "t5": (0.06, (0.65, 0.78, 0.9, 1.0)),
    "t3": (0.06, (0.52, 0.65, 0.8)),
    "outliers": (0.06, (0.85, 1.0, 1.15)),
}
FREE = tuple(float(s) for s in np.geomspace(0.3, 2.5, 14))
CORRELATIONS = (-0.5, -0.25, 0.25, 0.45, 0.65)
UNCORRELATED = 0.8
# Correlated noise is believed up to this size.
MOST_CORRELATED = 1.1
LEAST_LINKED = 12
# Least curvature of minus a log density that fitting takes, over a normal one's.
LEAST_CURVE = 0.05


@cache
def log_density() -> Array:
    """Log density of each shape at its unit core scale, (shapes, points), at multiples of STEP."""
    x = np.arange(0.0, REACH + 2 * STEP, STEP)
    gauss, wide = norm.logpdf(x), norm.logpdf(x, scale=OUTLIER_WIDTH)
    mixture = np.logaddexp(np.log1p(-OUTLIER_SHARE) + gauss, np.log(OUTLIER_SHARE) + wide)
    return np.stack([gauss, t.logpdf(x, 5), t.logpdf(x, 3), mixture])


@cache
def score_table() -> tuple[Array, Array]:
    """Influence −d log p/dx (shapes, points) and its Fisher information (shapes,)."""
    table = log_density()
    psi = -np.gradient(table, STEP, axis=1)
    psi[:, 0] = 0.0
    mass = np.exp(table) * 2 * STEP
    mass[:, 0] /= 2
    return psi, np.sum(psi**2 * mass, axis=1)


def influence(x: Array, shape: int) -> Array:
    """Minus the slope of the log density at x (any shape) in core scales; it serves fitting."""
    psi = score_table()[0][shape]
    at = np.minimum(np.abs(x) / STEP, psi.size - 1.001)
    low = at.astype(np.int64)
    share = at - low
    return np.sign(x) * (psi[low] * (1 - share) + psi[low + 1] * share)


def log_density_at(x: Array, shape: int) -> Array:
    """Log density at x (any shape) in core scales, as `log_likelihoods` takes it from the table."""
    table = log_density()[shape]
    at = np.abs(x) / STEP
    low = np.minimum(at, table.size - 2).astype(np.int64)
    return np.asarray(table[low] + (at - low) * (table[low + 1] - table[low]))


class Chain(NamedTuple):
    """Which row came before (rows,), -1 where none, and how many steps ago."""

    previous: Ints
    gap: Array


class Noises(NamedTuple):
    """The noises considered (noises,): shape's number, core scale, correlation, log prior.

    ``before`` (noises, rows) is the share of the previous row's residual that is expected again,
    ``stretch`` (noises, rows) divides what is left to its own standard deviation, ``constant``
    (noises,) is the log determinant of both. The first noise is the one that was declared.
    """

    shape: Ints
    scale: Array
    correlation: Array
    prior: Array
    previous: Ints
    before: Array
    stretch: Array
    constant: Array
    declared: bool

    def describe(self, which: int) -> dict[str, float | str]:
        """Shape, core scale in declared standard deviations, and lag-one correlation."""
        return {
            "shape": SHAPES[self.shape[which]],
            "scale": float(self.scale[which]),
            "correlation": float(self.correlation[which]),
        }

    def peak(self) -> Array:
        """Log density (noises,) of no residual, in declared standard deviations."""
        return np.asarray(log_density()[self.shape, 0] - np.log(self.scale))

    def robust(self) -> int:
        """The noise that first fits are made under: Student's t, uncorrelated, of middling size."""
        suits = np.flatnonzero((self.shape == 1) & (self.correlation == 0))
        return int(suits[np.argmin(np.abs(self.scale[suits] - 0.9))])

    def alike(self, which: int, others: Noises) -> int:
        """The uncorrelated noise among ``others`` of this one's shape and nearest core scale.

        A normal one that is smaller than declared is taken as declared: what is to come is not
        foretold more sharply than the sensor was said to be.
        """
        suits = np.flatnonzero((others.shape == self.shape[which]) & (others.correlation == 0))
        scale = self.scale[which]
        if self.declared and self.shape[which] == 0:
            scale = max(scale, 1.0)
        return int(suits[np.argmin(np.abs(others.scale[suits] - scale))])

    def filtered(self, residual: Array, centre: Array, which: int) -> Array:
        """Residuals (..., rows) in units of core scale, freed of what the previous row told.

        ``centre`` broadcasts against them: residuals of the mean over nodes.
        """
        if self.correlation[which] == 0.0:
            return np.asarray(residual * self.stretch[which])
        carried = np.where(self.previous >= 0, centre[..., self.previous], 0.0)
        return (residual - self.before[which] * carried) * self.stretch[which]

    def draw(self, which: Ints, rng: np.random.Generator) -> Array:
        """Noise (draws, rows), one row of numbers for each entry of ``which`` (draws,)."""
        rows = self.previous.size
        fresh = rng.standard_normal((which.size, rows))
        for shape, degrees in ((1, 5), (2, 3)):
            squares = rng.chisquare(degrees, fresh.shape)
            for draw in np.flatnonzero(self.shape[which] == shape):
                fresh[draw] *= (squares[draw] / degrees) ** -0.5
        far = rng.random(fresh.shape) < OUTLIER_SHARE
        for draw in np.flatnonzero(self.shape[which] == 3):
            fresh[draw, far[draw]] *= OUTLIER_WIDTH
        fresh /= self.stretch[which]
        if not self.correlation[which].any():
            return fresh
        for row in _forward(self.previous):
            if self.previous[row] >= 0:
                fresh[:, row] += self.before[which, row] * fresh[:, self.previous[row]]
        return fresh


def _forward(previous: Ints) -> list[int]:
    """Rows in an order in which each comes after the one before it."""
    after: dict[int, int] = {int(p): r for r, p in enumerate(previous) if p >= 0}
    order: list[int] = []
    for row in np.flatnonzero(previous < 0):
        at: int | None = int(row)
        while at is not None:
            order.append(at)
            at = after.get(at)
    return order


def noises(sequence: Chain, declared: bool) -> Noises:
    """The grid for rows in this sequence; with sigma not declared, every scale is as likely."""
    grid: list[tuple[int, float, float, float]] = []
    if declared:
        grid.append((0, 1.0, 0.0, 1.0 - sum(weight for weight, _ in DECLARED.values())))
        grid += [
            (SHAPES.index(name), scale, 0.0, weight / len(scales))
            for name, (weight, scales) in DECLARED.items()
            for scale in scales
        ]
    else:
        grid += [
            (shape, scale, 0.0, weight / len(FREE))
            for shape, weight in enumerate((0.7, 0.1, 0.1, 0.1))
            for scale in FREE
        ]
        grid.sort(key=lambda each: abs(np.log(each[1])) + 10 * each[0])
    if np.sum(sequence.previous >= 0) >= LEAST_LINKED:
        plain = [each for each in grid if each[0] == 0]
        plain = [each for each in plain if not declared or each[1] <= MOST_CORRELATED]
        grid = [(s, x, r, UNCORRELATED * p) for s, x, r, p in grid]
        share = (1 - UNCORRELATED) / len(CORRELATIONS)
        grid += [(s, x, rho, share * p) for rho in CORRELATIONS for s, x, _, p in plain]
    shape, scale, rho, prior = (np.array(column) for column in zip(*grid, strict=True))
    linked = sequence.previous[None, :] >= 0
    before = np.where(linked, np.sign(rho)[:, None] * np.abs(rho)[:, None] ** sequence.gap, 0.0)
    stretch = 1 / (np.sqrt(1 - before**2) * scale[:, None])
    return Noises(
        shape=shape.astype(np.int64),
        scale=scale,
        correlation=rho,
        prior=np.log(prior),
        previous=sequence.previous,
        before=before,
        stretch=stretch,
        constant=np.sum(np.log(stretch), axis=1),
        declared=declared,
    )


@njit
def log_likelihoods(
    values: Array,
    predicted: Array,
    weights: Array,
    starts: Ints,
    grid: Noises,
    table: Array,
    at_value: Ints,
    at_prediction: Ints,
    at_noise: Ints,
) -> Array:
    """See `sample.Sample.log_likelihood`; ``table`` is `log_density`, all else one by one."""
    nodes, rows = predicted.shape[1], predicted.shape[2]
    groups, previous, last = starts.size - 1, grid.previous, float(table.shape[1] - 2)
    out = np.empty(at_value.size)
    centre, carried, each = np.empty(rows), np.empty(rows), np.empty(rows)
    summed, best, mass = np.empty((nodes, groups)), np.empty(groups), np.empty(groups)
    logs = np.log(weights) if nodes > 1 else np.zeros(1)
    for case in range(at_value.size):
        y, n = values[at_value[case]], at_noise[case]
        density, stretch = table[grid.shape[n]], grid.stretch[n]
        carried[:] = 0.0
        if grid.correlation[n] != 0.0:
            centre[:] = y
            for node in range(nodes):
                centre -= weights[node] * predicted[at_prediction[case], node]
            for row in range(rows):
                if previous[row] >= 0:
                    carried[row] = grid.before[n, row] * centre[previous[row]]
        best[:] = -1e300
        for node in range(nodes):
            m = predicted[at_prediction[case], node]
            for row in range(rows):  # without branches or signed indices, so that it is vectorised
                x = abs((y[row] - m[row] - carried[row]) * stretch[row]) * (1.0 / STEP)
                low = np.uint32(min(last, x))  # in this order NaN gives `last`
                each[row] = density[low] + (x - low) * (density[low + 1] - density[low])
            for group in range(groups):
                total = logs[node]
                for row in range(starts[group], starts[group + 1]):
                    total += each[row]
                total = max(-1e300, total)  # in this order NaN gives -1e300
                summed[node, group] = total
                best[group] = max(best[group], total)
        out[case] = grid.constant[n] + best.sum()
        if nodes > 1:
            mass[:] = 0.0
            for node in range(nodes):
                for group in range(groups):
                    mass[group] += np.exp(summed[node, group] - best[group])
            out[case] += np.log(mass).sum()
    return out


@njit
def over_nodes(
    e: Array, tangent: Array, share: Array, starts: Ints, psi: Array
) -> tuple[Array, Array]:
    """Mean scores (n, groups, p) over the nodes, and the curvature (n, p, p) of minus the complete
    data's log likelihood less the scores' mean products.

    ``e`` (n, nodes, rows) are filtered residuals, ``tangent`` (p, n, nodes, rows) filtered slopes,
    ``share`` (n, nodes, groups) probabilities of nodes, ``psi`` the influence of a shape.
    """
    p, groups, last = len(tangent), starts.size - 1, psi.size - 1.001
    mean, exact = np.zeros((len(e), groups, p)), np.zeros((len(e), p, p))
    score = np.empty(p)
    for i in range(len(e)):
        for node in range(share.shape[1]):
            for group in range(groups):
                weight = share[i, node, group]
                score[:] = 0.0
                for row in range(starts[group], starts[group + 1]):
                    x = abs(e[i, node, row])
                    at = min(last, x * (1.0 / STEP))
                    low = np.uint32(at)
                    slope = psi[low] + (at - low) * (psi[low + 1] - psi[low])
                    curve = weight * max(slope / x, LEAST_CURVE) if x > 1e-6 else weight
                    slope = math.copysign(slope, e[i, node, row])
                    for a in range(p):
                        t = tangent[a, i, node, row]
                        score[a] += slope * t
                        for b in range(a + 1):
                            exact[i, a, b] += curve * t * tangent[b, i, node, row]
                for a in range(p):
                    mean[i, group, a] += weight * score[a]
                    for b in range(a + 1):
                        exact[i, a, b] -= weight * score[a] * score[b]
        for a in range(p):
            exact[i, :a, a] = exact[i, a, :a]
    return mean, exact
