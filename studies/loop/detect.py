"""Is anything missing that these data could show?

One pre-declared set of tests: a bounded likelihood ratio for every candidate, over its ladder, and
the family of residual statistics. All are brought to p-values by data simulated from the fitted
baseline with a noise drawn from its posterior; each simulated set refits the baseline and chooses
its own noise as the measured set did; the smallest p-value is corrected by the same sets.

The refit is along the baseline's tangent: over the width of the noise the baseline is straight, and
it is what makes hundreds of refits cost nothing. Davison and Hinkley, Bootstrap Methods (1997), §4;
bounded alternatives: Self and Liang, J. Am. Stat. Assoc. 82 (1987) 605.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ...solver.bristle import Array
from .family import corrected, family, p_values
from .fit import Fitted, filtered_slopes, to_theta
from .ladder import Ladder, explored_shares
from .noise import Ints, influence, score_table
from .sample import Sample
from .smooth import plain_heights, rival_heights, rival_names

SETS = 499
OCCAM = 2.5
MOST_NOISES = 12
# Noises under which unlisted rivals are looked at in every simulated set.
RIVAL_NOISES = 5
POWER_QUANTILE = 1.2815515655446004


@dataclass(frozen=True)
class Refitted:
    """Residuals (sets, rows) after refitting along a tangent; ``noise`` (sets,) chosen by each and
    ``height`` (sets,), its log likelihood with prior; ``standard`` (sets, rows): Winsorised."""

    residual: Array
    noise: Ints
    height: Array
    standard: Array


@dataclass(frozen=True)
class Detection:
    """``table``: (test, value, p-value alone) of every test; ``p_value`` is corrected for all.

    ``statistic`` names the smallest. ``residual`` (rows,) are the baseline's, in sigma.
    ``detectable``: by effect the parameter, its magnitude and unit, None where never.
    """

    statistic: str
    p_value: float
    table: tuple[tuple[str, float, float], ...]
    residual: Array
    noise: int
    detectable: dict[str, float | None]
    needed_d: dict[str, float]
    best_points: dict[str, Ints]


def kept_noises(data: Sample, shares: Array) -> Ints:
    """Noises that the data leave a chance, and always the declared one."""
    order = np.argsort(-shares, kind="stable")[:MOST_NOISES]
    return np.unique(np.concatenate([[0], order[shares[order] > 3e-3]]))


def shared_noise(data: Sample, base: Fitted, ladders: list[Ladder]) -> tuple[Array, float]:
    """Posterior weights of the noises (noises,) over all that may be there, and nothing; and the
    log evidence of something unlisted over nothing.

    A noise that fits only because it swallows an effect must not calibrate the tests that look for
    the effect. So each noise is weighted by the evidence that it has with nothing missing (half
    the prior), with each candidate at its best ladder point, and with each unlisted rival; what a
    parameter costs is `OCCAM`.
    """
    every = np.arange(data.noises.scale.size)
    slopes = base.mean_slopes
    tests = family(data)
    residual = np.concatenate(
        [
            refit(data, (data.values - base.mean)[None], slopes, every[n : n + 1]).residual
            for n in every
        ]
    )
    nothing = np.array(
        [plain_heights(data, residual[n : n + 1], every[n : n + 1])[0, 0] for n in every]
    )
    rival = rival_heights(data, tests, residual[:, None], slopes, every)[0]
    others = [rival - np.log(max(rival.shape[0], 1))]
    # Noises that differ little see the same points as best: those of a few noises are enough.
    few = every[:: max(every.size // 12, 1)]
    for each in ladders:
        weights = np.asarray(each.model.weights)
        shift = each.predicted - base.mean
        points = np.arange(each.d.size)
        coarse = data.log_likelihood(
            residual, shift, weights, (few[None], points[:, None], few[None])
        )
        order = np.argsort(-(coarse + data.noises.prior[few]).max(axis=0))
        best = np.unique(np.argmax(coarse, axis=0)[order[:4]])
        fine = data.log_likelihood(
            residual, shift, weights, (every[None], best[:, None], every[None])
        )
        cost = OCCAM * each.ends.shape[2]
        others.append((fine.max(axis=0) + data.noises.prior - cost)[None])
    stacked = np.concatenate(others)
    total = np.logaddexp(
        nothing, np.logaddexp.reduce(stacked, axis=0) - np.log(max(len(ladders) + 1, 1))
    )
    mass = np.exp(total - total.max())
    return np.asarray(mass / mass.sum()), _gain(rival, nothing)


def _gain(rival: Array, nothing: Array) -> float:
    if rival.shape[0] == 0:
        return -np.inf
    return float(logsumexp(rival) - np.log(rival.shape[0]) - logsumexp(nothing))


def refit(data: Sample, residual: Array, slopes: Array, among: Ints) -> Refitted:
    """Refit residuals (sets, rows) along slopes (rows, p), each set with its likeliest noise."""
    grid = data.noises
    along = np.linalg.pinv(slopes)
    left = residual - residual @ along.T @ slopes.T
    noise, _ = _choose(data, left, among)
    standard = np.empty_like(left)
    for each in np.unique(noise):
        mine = np.flatnonzero(noise == each)
        tangent = filtered_slopes(data, slopes, int(each))
        shape = int(grid.shape[each])
        for _ in range(3 if shape or grid.correlation[each] else 1):
            e = grid.filtered(left[mine], left[mine], int(each))
            weight = np.where(np.abs(e) > 1e-9, influence(e, shape) / np.where(e == 0, 1, e), 1.0)
            normal = np.einsum("sr,rp,rq->spq", weight, tangent, tangent, optimize=True)
            normal += 1e-10 * np.eye(slopes.shape[1]) * (np.trace(tangent.T @ tangent) + 1e-30)
            move = np.linalg.solve(normal, ((weight * e) @ tangent)[..., None])[..., 0]
            left[mine] -= move @ slopes.T
        e = grid.filtered(left[mine], left[mine], int(each))
        standard[mine] = influence(e, shape) / np.sqrt(score_table()[2][shape])
    noise, height = _choose(data, left, among)
    return Refitted(left, noise, height, standard)


def _choose(data: Sample, residual: Array, among: Ints) -> tuple[Ints, Array]:
    logs = plain_heights(data, residual, among)
    best = np.argmax(logs, axis=1)
    return among[best], logs[np.arange(best.size), best]


def ratios(
    data: Sample, found: Refitted, base: Array, candidate: Ladder, among: Ints
) -> tuple[Array, Ints]:
    """Log likelihood ratio (sets,) of a candidate over its ladder, and which point (sets,)."""
    shift = candidate.predicted - base
    weights = np.asarray(candidate.model.weights)
    sets = np.arange(found.noise.size)
    logs = data.log_likelihood(
        found.residual,
        shift,
        weights,
        (sets[:, None], np.arange(shift.shape[0])[None], found.noise[:, None]),
    )
    point = np.argmax(logs, axis=1)
    again = data.noises.prior[among] + data.log_likelihood(
        found.residual, shift, weights, (sets[:, None], point[:, None], among[None])
    )
    return np.maximum(again.max(axis=1) - found.height, 0.0), point


def simulate(
    data: Sample, fitted: Fitted, shares: Array, among: Ints, sets: int, rng: np.random.Generator
) -> Array:
    """Values (sets, rows) from a fitted model, with noises drawn by their posterior weights."""
    chance = shares[among] / shares[among].sum()
    values = data.noises.draw(rng.choice(among, size=sets, p=chance), rng)
    weights = np.asarray(fitted.model.weights)
    groups = data.starts.size - 1
    node = rng.choice(weights.size, size=(sets, groups), p=weights / weights.sum())
    return values + fitted.predicted[node[:, data.group], np.arange(data.values.size)[None]]


def detect(
    data: Sample,
    base: Fitted,
    shares: Array,
    ladders: list[Ladder],
    rng: np.random.Generator,
    alarm: float,
    sets: int = SETS,
) -> Detection:
    """Run all tests on the fitted baseline; ``alarm`` is the false-alarm rate over all of them."""
    among = kept_noises(data, shares)
    values = np.concatenate([data.values[None], simulate(data, base, shares, among, sets, rng)])
    slopes = base.mean_slopes
    found = refit(data, values - base.mean, slopes, among)
    tests = family(data)
    likeliest = np.sort(among[np.argsort(-shares[among], kind="stable")[:RIVAL_NOISES]])
    rival = rival_heights(data, tests, found.residual, slopes, likeliest).max(axis=2)
    columns = [tests(found.standard), rival - found.height[:, None]]
    points: dict[str, Ints] = {}
    for each in ladders:
        ratio, point = ratios(data, found, base.mean, each, among)
        columns.append(ratio[:, None])
        points[each.name] = point[:1]
    table = np.concatenate(columns, axis=1)
    unlisted = rival_names(data, tests)
    names = [*tests.names, *unlisted, *(each.name for each in ladders)]
    first = len(tests.names) + len(unlisted)
    single, simulated = p_values(table[0], table[1:])
    p_value, least = corrected(single, simulated)
    threshold = float(np.quantile(least, alarm))
    needed = {
        each.name: _needed_d(table[1:, first + i], threshold) for i, each in enumerate(ladders)
    }
    return Detection(
        statistic=names[int(np.argmin(single))],
        p_value=p_value,
        table=tuple(
            (name, float(v), float(p)) for name, v, p in zip(names, table[0], single, strict=True)
        ),
        residual=values[0] - base.mean,
        noise=int(found.noise[0]),
        detectable={each.name: _magnitude(each, needed[each.name]) for each in ladders},
        needed_d=needed,
        best_points=points,
    )


def _needed_d(simulated: Array, threshold: float) -> float:
    """The d whose likelihood ratio, (d + normal)² / 2, passes the threshold in 9 of 10 sets."""
    edge = float(np.quantile(simulated, 0.9))
    beyond = simulated[simulated > edge] - edge
    if beyond.size < 5 or edge <= 0:
        ratio = float(max(edge, -np.log(threshold)))
    else:
        ratio = float(
            edge + beyond.mean() * np.log(max(beyond.size / simulated.size / threshold, 1))
        )
    return float(np.sqrt(2 * ratio) + POWER_QUANTILE)


def _magnitude(candidate: Ladder, d: float) -> float | None:
    """Distance from absence, in the first parameter that varies, at which an effect has this d."""
    own = candidate.u.shape[1] - candidate.ends.shape[2]
    several = candidate.model.parameters[own:]
    shares = explored_shares(candidate)
    best: float | None = None
    for ray in range(candidate.ends.shape[0]):
        way, begin, end = candidate.way[ray], candidate.ends[ray, 0], candidate.ends[ray, 1]
        moving = np.flatnonzero(np.abs(end - begin) > 1e-9)
        if moving.size != 1 or way[-1] < d:
            continue
        i = int(moving[0])
        if i != 0 and candidate.ends.shape[2] > 1:
            continue
        known = way > 1e-9
        where = np.exp(np.interp(np.log(d), np.log(way[known]), np.log(shares[known])))
        value = to_theta(several, (begin + where * (end - begin))[None])[0, i]
        null = several[i].null
        size = abs(float(value) - null) if not np.isinf(null) else abs(float(value))
        best = size if best is None else min(best, size)
    return best
