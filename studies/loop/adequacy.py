"""Absolute goodness of fit: what a model leaves, against the noise that was declared.

One family of statistics, declared here and nowhere else, looks at the quantile residuals of a
fitted model: their size; each quantity's level; against every covariate smooth shapes, bands and
thresholds, for the residuals and for their scatter; in the order of the groups every residue
class, runs and what settles, there and in height waves; two states; what rows of one group share;
and the directions of known effects. Shifts are looked for alike at all rows and in proportion to
the prediction.

Nothing here forgives a large residual: statistics grow with the residuals themselves (their
logarithm beyond `KNEE`), after the full fit within its bounds, and what they are held against is
noise of bounded size (`noise`), drawn and refitted along the parameters that are not on a bound,
as far as their bounds are wide.
The least p-value is corrected by the same draws (Westfall and Young, Resampling-Based Multiple
Testing (1993), §2.5). Smooth tests: Rayner, Thas and Best, Smooth Tests of Goodness of Fit (2009);
scans: Walther and Perry, J. R. Stat. Soc. B 84 (2022) 1608.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy.sparse import csr_array
from scipy.stats import norm

from ...solver.arrays import Array
from ...solver.compiled import njit
from .fit import Fitted
from .noise import Ints
from .residuals import quantile_residuals
from .sample import BETWEEN, HEIGHT, WITHIN, Sample, first_of
from .shapes import (
    LEAST_BAND,
    Refit,
    Shapes,
    UnitShapes,
    bands_of,
    distinct,
    levels,
    patterns_of,
    polynomials,
    residue_classes,
    settlings_of,
    shared_pairs,
    waves_of,
)

SETS = 599
# Draws of where outliers lie, and of how many rows in all: few draws of many rows tell one chance
# in a hundred as well.
JOIN_SETS, MOST_JOINED = 9999, 6_000_000
# Places along a covariate that has no levels within which two outliers are neighbours.
SIDE_BY_SIDE = 2
KNEE = 3.0
LEAST_ORDERED = 8
STATE_SHARES = np.array([0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9])
STATE_SHIFTS = np.array([2.0, 3.0, 4.0, 6.0, 9.0, 14.0])
STATES_TRIED = 24
# Between its nodes log(1 + e^x) is off by 3e-6, and beyond its ends by 1e-13.
ODDS, ODDS_STEP = 30.0, 0.01
# Of what is neither one wave nor a polynomial: so many waves together.
SEVERAL_WAVES = (4, 8, 16)
WIDER = np.geomspace(1.3, 40.0, 14)
WIDER_NOISE = "noise some"
STATE_SPREADS = np.array([0.7, 0.85, 1.0, 1.2, 1.45, 1.75, 2.2, 3.0, 4.5])


@dataclass(frozen=True)
class Test:
    """One test of the family: its value and its p-value alone."""

    name: str
    value: float
    p_value: float


@dataclass(frozen=True)
class Adequacy:
    """Whether a fit leaves noise alone.

    ``p_value`` is corrected for all tests, ``statistic`` names the least; ``residual`` (rows,) are
    quantile residuals, ``noise`` the likeliest noise of them. ``needed`` by known effect: the size
    d that would be noticed nine times in ten. ``unlisted`` is the log evidence of the best of the
    family's own shapes, ``shape`` its name: an effect that explains less than a band or a step
    would is not the explanation. Where that was not asked, it is minus infinity.
    """

    p_value: float
    statistic: str
    table: tuple[Test, ...]
    residual: Array
    noise: int
    needed: dict[str, float]
    unlisted: float
    shape: str


@dataclass(frozen=True)
class Direction:
    """What a known effect does to residuals: it moves them by ``shift`` (rows,) in its one sense,
    or widens them by ``scatter`` (rows,), a variance. One that was ``chosen`` by the data among
    several has no test: what it would be held against is not chosen."""

    name: str
    shift: Array
    scatter: Array
    chosen: bool = False


Statistic = Callable[[Array], Array]
# What one amount costs that the data determine, in nats (Kass and Wasserman, J. Am. Stat. Assoc. 90
# (1995) 928: unit information, here of some hundred rows).
OCCAM = 2.5


# Shapes of which one may be what is missing or, where numbers of some are given, these together.
Listed = tuple[str, UnitShapes, Ints | None]


def assess(
    data: Sample,
    fitted: Fitted,
    directions: list[Direction],
    rng: np.random.Generator,
    sets: int = SETS,
    *,
    unlisted: bool = True,
) -> Adequacy:
    """Test what a fitted model leaves of the rows that it was fitted to; where ``unlisted``, also
    which shape that no effect has explains it best."""
    weights = np.asarray(fitted.model.weights)
    z = quantile_residuals(data.values, fitted.predicted, weights, data.starts)
    tangent = fitted.mean_slopes[:, fitted.loose] / np.sqrt(1 + fitted.spread**2)[:, None]
    noise = likeliest_noise(data, z, correlated=weights.size == 1)
    free = Refit(tangent)
    both = np.concatenate([z[None], free(data.noises.draw(np.full(sets, noise), rng))])
    both = _soft(both)
    patterns = patterns_of(data, fitted)
    # each quantity's own, since what moves one may leave the others
    own = [pattern * (data.kind == k) for pattern in patterns for k in np.unique(data.kind)]
    statistics, shapes = _family(data, own, free, directions)
    names = list(statistics)
    values = np.stack([statistics[name](both) for name in names], axis=1)
    single, simulated = p_values(values[0], values[1:])
    p_value, least = corrected(single, simulated)
    threshold = float(np.quantile(least, 0.02))
    needed = {name: _needed(values[1:, i], threshold) for i, name in enumerate(names)}
    by_shapes: dict[str, float] = {}
    for each in (each for each in directions if each.chosen):
        there = _needed_by_shapes(free(each.shift), shapes, needed)
        by_shapes[each.name] = max(there, by_shapes.get(each.name, 0.0))
    best = (-np.inf, "")
    if unlisted:
        best = max(
            _best_shape(data, z, free(z), shapes),
            (_log_two_states(data, z, own), "two states"),
            _wider(data, z),
        )
    return Adequacy(
        p_value=p_value,
        statistic=names[int(np.argmin(single))],
        table=tuple(
            Test(name, float(v), float(p))
            for name, v, p in zip(names, values[0], single, strict=True)
        ),
        residual=z,
        noise=noise,
        needed={each.name: needed[each.name] for each in directions if each.name in names}
        | by_shapes,
        unlisted=best[0],
        shape=best[1],
    )


def outliers_together(data: Sample, z: Array, rng: np.random.Generator) -> float:
    """The chance that outliers of one sign among residuals (rows,) lie as much side by side along
    a covariate, whatever the noise is; one where groups are records in time.

    Counts of neighbours that are both outliers (join counts: A. D. Cliff and J. K. Ord, Spatial
    Processes (1981), §1), against outliers anywhere and of any sign.
    """
    outliers = np.abs(z) > KNEE
    if np.sum(outliers) < LEAST_BAND or first_of(data.covariates, WITHIN) is not None:
        return 1.0
    sets = min(JOIN_SETS, MOST_JOINED // z.size)
    signs = np.tile((np.sign(z) * outliers).astype(np.int8), (sets + 1, 1))
    for kind in np.unique(data.kind):
        mine = np.flatnonzero(data.kind == kind)
        signs[1:, mine] = rng.permuted(signs[1:, mine], axis=1)
    signs[1:] *= rng.choice(np.array([-1, 1], dtype=np.int8), signs[1:].shape)
    ranks = []
    for x in distinct(data.covariates).values():
        level = levels(x)
        count = int(level.max()) + 1
        reach = SIDE_BY_SIDE if 2 * count > z.size else 0
        # levels of each quantity, with a gap between that nothing reaches over
        place = level + data.kind * (count + reach)
        cells = csr_array((np.ones(z.size, dtype=np.int32), (np.arange(z.size), place)))
        joins = np.zeros(len(signs), dtype=np.int64)
        for side in (signs > 0, signs < 0):
            number = side @ cells
            joins += np.sum(number * (number - 1) // 2, axis=1)
            for away in range(1, reach + 1):
                joins += np.sum(number[:, away:] * number[:, :-away], axis=1)
        ranks.append(np.searchsorted(np.sort(-joins), -joins, side="right"))
    least = np.min(ranks, axis=0)
    return float(np.mean(least <= least[0]))


def likeliest_noise(data: Sample, z: Array, correlated: bool) -> int:
    """The likeliest noise, of bounded size, of residuals (rows,).

    Where chance from group to group widens what is predicted, correlation is none of the noise's:
    residuals are then as large as they are because of that chance, which has no memory.
    """
    grid = data.noises
    among = np.flatnonzero((grid.correlation == 0) | correlated)
    logs = data.heights_of_noise(z[None], among)
    return int(among[np.argmax(logs[0])])


def _soft(z: Array) -> Array:
    """Residuals, beyond `KNEE` by their logarithm: one outlier does not decide, a thousand do."""
    out, far = z.copy(), np.abs(z) > KNEE
    out[far] = np.sign(z[far]) * (KNEE + np.log1p(np.abs(z[far]) - KNEE))
    return out


def _family(
    data: Sample, patterns: list[Array], free: Refit, directions: list[Direction]
) -> tuple[dict[str, Statistic], list[Listed]]:
    """All statistics by name, each takes residuals (sets, rows) to numbers (sets,); and the shapes
    of those that look for a shift."""
    out: dict[str, Statistic] = {"size": lambda z: np.sum(z**2, axis=1)}
    listed: list[Listed] = []
    level = np.stack([(data.kind == k).astype(float) for k in np.unique(data.kind)])
    even = np.ones((1, data.kind.size))
    every = np.array(patterns)

    def one(name: str, parts: Array, mix: Array | None = None) -> None:
        units = UnitShapes.of(Shapes(parts, every, mix), free)
        if len(units):
            listed.append((name, units, None))
            out[name] = lambda z: np.max(units.loads(z) ** 2, axis=1)

    def together(name: str, parts: Array, degree: Array) -> None:
        units = UnitShapes.of(Shapes(parts, even), free)
        if len(units):
            listed.append((name, units, np.arange(len(units))))
            share = 1.0 / degree[units.which] ** 2
            out[name] = lambda z: units.loads(z) ** 2 @ share

    def wavy(name: str, x: Array) -> None:
        waves = waves_of(x)
        units = UnitShapes.of(Shapes(waves, every), free)
        if not len(units):
            return
        # a cosine and a sine each, of one size
        wave = units.which // 2
        several = [np.flatnonzero(wave == each) for each in np.unique(wave)]
        listed.extend((f"wave in {name}", units, each) for each in several)
        size, turns = np.divmod(wave, len(waves) // 2)
        for own, most in itertools.product(np.unique(size), SEVERAL_WAVES):
            # each frequency has two functions, and as many as there are levels fit any values:
            # these are three quarters of them at most, so that the rest tells what noise there is
            if 8 * most <= 3 * (len(waves) // 2):
                slow = np.flatnonzero((size == own) & (turns < most))
                listed.append((f"waves in {name}", units, slow))
        mean = np.stack([(wave == wave[each[0]]) / each.size for each in several], axis=1)
        out[f"wave in {name}"] = lambda z: np.max(units.loads(z) ** 2 @ mean, axis=1)

    def scattered(name: str, parts: Array, mix: Array | None = None) -> None:
        shapes = Shapes(parts, even, mix)
        rows = shapes.loads(even)[0]
        share = rows / even.size
        if rows.size:
            out[name] = lambda z: np.max(
                np.abs(shapes.loads(np.abs(z)) - np.abs(z).sum(axis=1, keepdims=True) * share)
                / np.sqrt(rows * (1.0 - share)),
                axis=1,
            )

    def spreading(name: str, trend: Array) -> None:
        out[f"scatter with {name}"] = lambda z: np.abs((np.abs(z) - 0.8) @ trend)

    together("level", level, np.ones(len(level)))
    for name, x in distinct(data.covariates).items():
        shapes, degree = polynomials(x, data.kind)
        if not degree.size:
            continue
        together(f"trend with {name}", shapes[degree == 1], degree[degree == 1])
        if degree.max() > 1:
            together(f"smooth in {name}", shapes[degree > 1], degree[degree > 1])
            units = UnitShapes.of(Shapes(shapes, even), free)
            whose = data.kind[np.argmax(np.abs(shapes[units.which]), axis=1)]
            for own in np.unique(whose):
                listed.append((f"any function of {name}", units, np.flatnonzero(whose == own)))
            if np.unique(whose).size > 1:
                listed.append((f"any function of {name}", units, np.arange(len(units))))
        bands = bands_of(x)
        one(f"band of {name}", *bands)
        spreading(name, shapes[degree == 1].sum(axis=0))
        scattered(f"scatter in a band of {name}", *bands)
        if name in HEIGHT:
            wavy(name, x)
    order = first_of(data.covariates, BETWEEN)
    if order is not None and np.unique(order).size >= LEAST_ORDERED:
        classes = residue_classes(order)
        one("one in several of the order", classes)
        one("settling in the order", settlings_of(order))
        wavy("the order", order)
        scattered("scatter of one in several", classes)
    linked = np.flatnonzero(data.noises.previous >= 0)
    if linked.size >= LEAST_ORDERED:
        before = data.noises.previous[linked]
        out["runs"] = lambda z: np.abs(np.sum(z[:, linked] * z[:, before], axis=1))
    if data.values.size >= LEAST_ORDERED:
        out["two states"] = lambda z: _two_states(z, patterns)
    shared = shared_pairs(data)
    if shared[0].size:
        out["shared within a group"] = lambda z: np.abs(
            np.sum(z[:, shared[0]] * z[:, shared[1]], axis=1)
        )

    senses: dict[str, list[Statistic]] = {}
    for direction in (each for each in directions if not each.chosen):
        one_sided = _one_sided(direction, free)
        if one_sided is not None:
            senses.setdefault(direction.name, []).append(one_sided)
    for name, several in senses.items():
        out[name] = partial(_greatest, several)
    return out, listed


def _best_shape(data: Sample, z: Array, free: Array, listed: Sequence[Listed]) -> tuple[float, str]:
    """Log evidence and name of the shape that explains residuals best by itself, with the noise
    that suits what it leaves.

    ``z`` (rows,) are the residuals, ``free`` (rows,) those after a refit by least squares, which is
    what a shape is fitted beside: a robust fit follows most of the rows and leaves the others.
    """
    residuals, costs, taken = [z], [0.0], [0]
    waves = sum(name.startswith("wave ") for name, *_ in listed)
    for name, units, together in listed:
        if together is not None:
            basis, _ = np.linalg.qr(units[together].T)
            amounts = basis.T @ free
            residuals.append(free - basis @ amounts)
            costs.append(_cost_of(amounts))
            taken.append(amounts.size)
        else:
            loads = units.loads(free[None])[0]
            best = np.argmax(np.abs(loads), keepdims=True)
            residuals.append(free - loads[best] @ units[best])
            costs.append(OCCAM + float(np.log(len(loads))))
            taken.append(1)
        if name.startswith("wave "):
            costs[-1] += float(np.log(waves))
    heights = data.heights_of_noise(np.array(residuals))
    # an amount that is taken out is no residual of zero, which would make small noise likely
    heights -= np.array(taken)[:, None] * (data.noises.peak() - norm.logpdf(0.0))
    logs = heights.max(axis=1) - np.array(costs)
    best = int(np.argmax(logs))
    return float(logs[best]), ["nothing", *(name for name, *_ in listed)][best]


def _cost_of(amounts: Array) -> float:
    """Cost in nats of amounts (k,), in standard deviations, that are fitted together.

    Each costs `OCCAM`, or more if they are large: the log density of normal amounts of this size,
    below that of a residual of zero. As many amounts as rows then explain no more than wider noise.
    """
    square = max(float(np.mean(amounts**2)), 1.0)
    return amounts.size * max(OCCAM, 0.5 * (1.0 + math.log(square)))


def _greatest(several: Sequence[Statistic], z: Array) -> Array:
    return np.asarray(np.max([each(z) for each in several], axis=0))


def _one_sided(direction: Direction, free: Refit) -> Statistic | None:
    """The statistic of an effect in one sense; None where a refit absorbs it."""
    shift = free(direction.shift)
    size, wide = float(np.linalg.norm(shift)), float(np.linalg.norm(direction.scatter))
    if wide > size:
        scatter = direction.scatter / wide
        return lambda z: np.maximum((np.abs(z) - 0.8) @ scatter, 0.0) ** 2
    if size < 0.3:
        return None
    unit = shift / size
    return lambda z: np.maximum(z @ unit, 0.0) ** 2


def _two_states(z: Array, patterns: list[Array]) -> Array:
    """Log likelihood (sets,) that a mixture of two states, each with the declared noise, gains
    over one normal distribution of any width, in the rows that a pattern moves."""
    best = np.full(z.shape[0], -np.inf)
    for whole in patterns:
        there = np.flatnonzero(whole)
        own, pattern, rows = np.ascontiguousarray(z[:, there]), whole[there], there.size
        square = np.sum(own**2, axis=1)
        single = np.max(
            -0.5 * square[:, None] / STATE_SPREADS**2 - rows * np.log(STATE_SPREADS), axis=1
        )
        load, size = own @ pattern, float(pattern @ pattern)
        for shift, share in itertools.product(STATE_SHIFTS, STATE_SHARES):
            # log(1 + e^x) of the odds x of the other state, beside a square that needs no look
            middle = share * shift
            odds = (
                np.log(share / (1.0 - share)) - 0.5 * (1.0 - 2.0 * share) * (shift * pattern) ** 2
            )
            other = float(np.log1p(-share))
            way = middle * pattern, other, best + single
            found = _softplus(own, shift * pattern, odds, softplus_table(), *way)
            plain = rows * other - single
            plain = plain - 0.5 * (square + 2.0 * middle * load + middle**2 * size)
            best = np.maximum(best, plain + found)
    return best


@cache
def softplus_table() -> Array:
    """log(1 + e^x) at multiples of `ODDS_STEP` from minus to plus `ODDS`."""
    return np.asarray(np.logaddexp(0.0, np.arange(-ODDS, ODDS + 1.5 * ODDS_STEP, ODDS_STEP)))


@njit
def _softplus(
    z: Array, slope: Array, level: Array, table: Array, middle: Array, other: float, least: Array
) -> Array:
    """Sums (sets,) over rows of log(1 + e^x), x being slope z + level (rows,), from its table.

    Minus infinity where these, with ``other`` and less half the square of z + ``middle`` (rows,),
    which is the log likelihood of a row and never above zero, sum to less than ``least`` (sets,):
    the rows that are left need not be looked at then.
    """
    out = np.full(z.shape[0], -np.inf)
    for k in range(z.shape[0]):
        total, apart = 0.0, 0.0
        for row in range(z.shape[1]):
            x = slope[row] * z[k, row] + level[row]
            if x > ODDS:
                total += x
            elif x > -ODDS:
                at = (x + ODDS) / ODDS_STEP
                low = int(at)
                total += table[low] + (at - low) * (table[low + 1] - table[low])
            apart += 0.5 * (z[k, row] + middle[row]) ** 2 - other
            if total - apart < least[k]:
                break
        else:
            out[k] = total
    return out


def _log_two_states(data: Sample, z: Array, patterns: list[Array]) -> float:
    """Log evidence that some groups' rows are all off by one amount, and the others not at all or,
    where a fit lies between the two, by another."""
    grid = data.noises
    among = np.flatnonzero(grid.correlation == 0)
    best = -np.inf
    for pattern in patterns:
        there = pattern != 0.0
        off = np.sort(z[there] / pattern[there])
        one = np.quantile(off, np.linspace(0.0, 1.0, STATES_TRIED))
        states = np.stack([np.zeros(STATES_TRIED), one], axis=1)
        cost: Array = np.full(STATES_TRIED, 2.0 * OCCAM)
        if off.size > 1:
            low, high = _halves(off)
            states, cost = np.vstack([states, [low, high]]), np.append(cost, 3.0 * OCCAM)
        predicted = states[:, :, None] * pattern
        values = np.repeat(z[None], len(states), axis=0)
        for share in STATE_SHARES:
            weights = np.array([1.0 - share, share])
            logs = data.heights(values, predicted, weights, among).max(axis=1)
            best = max(best, float(np.max(logs - cost)))
    return best - float(np.log(len(patterns)))


def _halves(x: Array) -> tuple[float, float]:
    """The means of two groups of sorted values (n,), parted where they are nearest to them."""
    count = np.arange(1, x.size)
    total = np.cumsum(x)
    low, high = total[:-1] / count, (total[-1] - total[:-1]) / (x.size - count)
    best = int(np.argmax(count * (x.size - count) * (high - low) ** 2))
    return float(low[best]), float(high[best])


def _wider(data: Sample, z: Array) -> tuple[float, str]:
    """Log evidence, and words, of noise that is wider than any that the declared one may be."""
    logs = data.heights_of_noise(z / WIDER[:, None]).max(axis=1) - z.size * np.log(WIDER)
    best = int(np.argmax(logs))
    return float(
        logs[best]
    ) - OCCAM, f"{WIDER_NOISE} {WIDER[best]:.2g} times as wide as is declared"


def p_values(observed: Array, simulated: Array) -> tuple[Array, Array]:
    """Single p-values of observed (statistics,) and simulated (sets, statistics) values.

    Ranks up to the 90th percentile; beyond it an exponential tail with the mean excess, which is
    what squares of normal numbers have and what gives p-values below one over the number of sets.
    """
    count = simulated.shape[0]
    both = np.concatenate([observed[None], simulated])
    out = np.empty_like(both)
    for k in range(both.shape[1]):
        values, ordered = both[:, k], np.sort(simulated[:, k])
        edge = float(ordered[int(0.9 * count)])
        out[:, k] = (count - np.searchsorted(ordered, values, side="left") + 1.0) / (count + 1.0)
        beyond = ordered[ordered > edge] - edge
        if beyond.size >= 5:
            tail = values > edge
            out[tail, k] = beyond.size / count * np.exp(-(values[tail] - edge) / beyond.mean())
    return out[0], out[1:]


def corrected(observed: Array, simulated: Array) -> tuple[float, Array]:
    """The smallest p-value corrected for all tests made, and the smallest of every set.

    Below what the sets can count, Bonferroni's bound on as many tests as the sets behave like.
    """
    least = simulated.min(axis=1)
    smallest = float(observed.min())
    counted = (int(np.sum(least <= smallest)) + 1.0) / (least.size + 1.0)
    edge = float(np.quantile(least, 0.05))
    beyond = 0.05 * smallest / edge
    return float(min(counted, max(beyond, 1e-300)) if smallest < edge else counted), least


def _needed(simulated: Array, threshold: float) -> float:
    """The d whose load, (d + normal)², passes the threshold in nine of ten sets."""
    edge = float(np.quantile(simulated, 0.9))
    beyond = simulated[simulated > edge] - edge
    load = edge + (beyond.mean() if beyond.size else 1.0) * np.log(max(0.1 / threshold, 1.0))
    return float(np.sqrt(max(load, 0.0)) + 1.2815515655446004)


def _needed_by_shapes(shift: Array, listed: Sequence[Listed], needed: Mapping[str, float]) -> float:
    """The d of a ``shift`` (rows,) that the tests of single shapes show, ``needed`` by their names:
    each sees the part of it that lies along one of its shapes."""
    unit = shift / max(float(np.linalg.norm(shift)), 1e-300)
    return min(
        (
            needed[name] / max(float(np.abs(units.loads(unit[None])).max()), 1e-300)
            for name, units, together in listed
            if together is None
        ),
        default=np.inf,
    )
