"""Which effects explain the data, how probably, and which can these data never tell apart?

Every candidate is refitted in full from the best points of its ladder, under the noise that suits
it; posterior weights follow from evidence on an equal footing. Effects whose predictions another
can imitate, refit included, to less than `APART` are one class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ...solver.bristle import Array
from .fit import Fitted, settle
from .ladder import Ladder
from .noise import Ints
from .posterior import Posterior, posterior
from .sample import Sample

CREDIBLE = 0.95
STARTS = 3
# Two effects of size REFERENCE_D that differ by less than APART, in expected sigma after refit,
# differ by less than two nats.
REFERENCE_D, APART = 8.0, 2.0
# Rows of a group that joint covariances take; records in time have many that say the same.
LONG = 12


def candidate(
    data: Sample, base: Fitted, rungs: Ladder, likely: Ints, rng: np.random.Generator
) -> Posterior:
    """Full refit and evidence of one candidate; ``likely`` are noises worth trying first."""
    shares = np.asarray(rungs.model.weights)
    logs = data.heights(data.values[None], rungs.predicted, shares, likely)
    best = logs.max(axis=1)
    order: list[int] = []
    for point in np.argsort(-best):
        if all(rungs.ray[point] != rungs.ray[other] for other in order):
            order.append(int(point))
        if len(order) == STARTS:
            break
    noise = int(likely[np.argmax(logs[order[0]])])
    fitted, shares = settle(data, rungs.model, rungs.u[order], noise)
    return posterior(data, base, fitted, shares, rng)


def weights(posteriors: Sequence[Posterior]) -> Array:
    """Posterior probabilities (models,) with equal priors."""
    return weights_of(np.array([each.log_evidence for each in posteriors]))


def weights_of(logs: Array) -> Array:
    """Probabilities (models,) from log evidences, with equal priors."""
    mass = np.exp(logs - logs.max())
    return np.asarray(mass / mass.sum())


def credible(shares: Array, level: float = CREDIBLE) -> list[int]:
    """The smallest set of models with at least this probability, likeliest first."""
    order = np.argsort(-shares)
    enough = int(np.searchsorted(np.cumsum(shares[order]), level - 1e-12)) + 1
    return [int(i) for i in order[:enough]]


def classes(data: Sample, base: Fitted, ladders: Sequence[Ladder]) -> list[tuple[str, ...]]:
    """Groups of candidates that these data cannot tell apart at `REFERENCE_D` (or as far as their
    bounds let them go), by complete linkage: every two of a group are alike, both ways."""
    seen = [each for each in ladders if each.d.max() > APART]
    if len(seen) < 2:
        return []
    known = {each.name: moments(data, each) for each in seen}
    apart = np.zeros((len(seen), len(seen)))
    for i, one in enumerate(seen):
        for j, two in enumerate(seen):
            if i != j:
                apart[i, j] = _imitated(data, base, one, two, known)
    both = np.maximum(apart, apart.T)
    label = fcluster(linkage(squareform(both, checks=False), "complete"), APART, "distance")
    groups = [
        tuple(seen[k].name for k in np.flatnonzero(label == each)) for each in np.unique(label)
    ]
    return sorted(group for group in groups if len(group) > 1)


@dataclass(frozen=True)
class Moments:
    """Jointly normal rows of each group: ``mean`` (points, rows), and for groups of one size
    ``covariance`` and ``inverse`` (points, groups, size, size); ``log_det`` (points,)."""

    mean: Array
    covariance: tuple[Array, ...]
    inverse: tuple[Array, ...]
    log_det: Array


def blocks(data: Sample) -> list[Ints]:
    """Row numbers (groups, size) of all groups of each size; long ones are thinned to `LONG`."""
    sizes = np.diff(data.starts)
    return [
        data.starts[:-1][sizes == size][:, None]
        + np.unique(np.linspace(0, size - 1, min(size, LONG)).astype(np.int64))[None]
        for size in np.unique(sizes)
    ]


def thinning(data: Sample) -> list[float]:
    """How many rows each kept row of `blocks` stands for."""
    sizes = np.unique(np.diff(data.starts))
    return [float(size / min(size, LONG)) for size in sizes]


def moments(data: Sample, rungs: Ladder) -> Moments:
    """Moments of a ladder's predictions with unit noise added."""
    w = np.asarray(rungs.model.weights)
    mean = rungs.mean()
    covariance, inverse = [], []
    log_det = np.zeros(mean.shape[0])
    stood_for = thinning(data)
    for i, rows in enumerate(blocks(data)):
        part = (rungs.predicted - mean[:, None])[:, :, rows] * np.sqrt(w)[:, None, None]
        part *= np.sqrt(stood_for[i])
        cov = np.einsum("kjgr,kjgs->kgrs", part, part) + np.eye(rows.shape[1])
        covariance.append(cov)
        inverse.append(np.linalg.inv(cov))
        log_det += np.linalg.slogdet(cov)[1].sum(axis=1)
    return Moments(mean, tuple(covariance), tuple(inverse), log_det)


def _imitated(
    data: Sample, base: Fitted, one: Ladder, two: Ladder, known: Mapping[str, Moments]
) -> float:
    """The largest distance, over rays of the first effect at the reference size, at which the
    second effect stays from it at best."""
    worst = 0.0
    slopes = base.mean_slopes
    project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
    plain = np.asarray(one.model.weights).size == 1 and np.asarray(two.model.weights).size == 1
    for ray in np.unique(one.ray):
        mine = np.flatnonzero(one.ray == ray)
        point = mine[np.argmin(np.abs(one.d[mine] - REFERENCE_D))]
        if one.d[point] < APART:
            continue
        if plain:
            target = project @ (one.mean()[point] - base.mean)
            nearest = _nearest(target, (two.mean() - base.mean) @ project)
        else:
            nearest = _nearest_scatter(data, known[one.name], int(point), known[two.name])
        worst = max(worst, nearest)
    return worst


def _nearest(target: Array, others: Array) -> float:
    """Distance from a target (rows,) to scaled others (points, rows): steps of a ladder are wide,
    so each point also stands for its neighbourhood of sizes."""
    size = np.maximum(np.sum(others**2, axis=1), 1e-12)
    amount = np.clip(others @ target / size, 0.6, 1.6)
    return float(np.sqrt(np.min(np.sum((target - amount[:, None] * others) ** 2, axis=1))))


def _nearest_scatter(data: Sample, one: Moments, point: int, two: Moments) -> float:
    """Square root of twice the least divergence of jointly normal predictions."""
    twice = two.log_det - one.log_det[point]
    shift = two.mean - one.mean[point]
    each = zip(blocks(data), thinning(data), one.covariance, two.inverse, strict=True)
    for rows, stood_for, cov, inverse in each:
        twice = twice + np.einsum("kgrs,gsr->k", inverse, cov[point]) - rows.size
        part = shift[:, rows] * np.sqrt(stood_for)
        twice += np.einsum("kgr,kgrs,kgs->k", part, inverse, part, optimize=True)
    return float(np.sqrt(max(twice.min(), 0.0)))
