"""Profile of a candidate over its effect's size, the baseline refitted at each.

The size of an effect is d, the distance in sigma between the distributions that it and the fitted
baseline predict, the baseline's own parameters refitted within their bounds. Distances are those
of normal distributions: of the mean, and of the logarithm of the variance over √2 (Fisher's metric
at a common mean; C. Atkinson and A. F. S. Mitchell, Sankhyā A 43 (1981) 345).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ...solver.arrays import Array
from .adequacy import Direction
from .fit import STEP, Chosen, Fitted, differences, to_box, to_theta
from .problem import Model
from .sample import Sample

# Shares of the way from absence to a bound.
SHARES = np.geomspace(1e-3, 1.0, 13)
REFITS = 4
# Two effects of size REFERENCE_D that differ by less than APART, refits included, differ by less
# than two nats.
REFERENCE_D, APART, DIRECTION_D = 8.0, 2.0, 6.0
# An effect of less cannot be seen. Where the next point of a ray has more than `JUMP`, the way
# between them is halved so many times: a contact yields in no drop, and then in several.
HIDDEN, JUMP, HALVINGS = 0.5, 12.0, 6


@dataclass(frozen=True)
class Limit:
    """Where an effect begins to show in one direction: the ``value`` of its first parameter, and
    the ``size`` that is its distance from absence; ``least`` where no smaller one was tried, which
    may show as well."""

    value: float
    size: float
    upward: bool
    least: bool


@dataclass(frozen=True)
class Profile:
    """Points of an effect along rays from its absence to the bounds of its first parameter.

    ``u`` (points, p) in the unit box, ``ray`` (points,): zero downward, one upward, ``d``
    (points,), ``features`` (points, 2 rows of the data's `first`): mean and log variance over √2,
    as far apart as those of all rows; ``size`` (points,): distance of the first parameter from its
    absence ``absent``, in its unit.
    """

    model: Model
    u: Array
    ray: Array
    d: Array
    features: Array
    size: Array
    absent: float

    @property
    def name(self) -> str:
        return self.model.effects[0]

    def nearest(self, d: float, least: float) -> list[int]:
        """The point of each ray whose size is nearest to ``d``, of those of ``least`` or more."""
        out = []
        for ray in np.unique(self.ray):
            mine = np.flatnonzero((self.ray == ray) & (self.d >= least))
            if mine.size:
                out.append(int(mine[np.argmin(np.abs(self.d[mine] - d))]))
        return out

    def limits(self, d: float) -> tuple[Limit, ...]:
        """Where the effect has size ``d``, in each direction whose bounds allow it."""
        out = []
        for ray in np.unique(self.ray):
            mine = np.flatnonzero(self.ray == ray)
            way = np.maximum.accumulate(self.d[mine])
            visible = way > 1e-9
            if not visible.any() or way[-1] < d:
                continue
            sizes = np.log(self.size[mine][visible])
            size = float(np.exp(np.interp(np.log(d), np.log(way[visible]), sizes)))
            value = self.absent + size if ray else self.absent - size
            out.append(Limit(value, size, bool(ray), bool(way[0] > d)))
        return tuple(out)


def features(predicted: Array, weights: Array) -> Array:
    """Means, and log variances over √2, (..., 2 rows) of predictions (..., nodes, rows)."""
    mean = np.einsum("j,...jr->...r", weights, predicted)
    variance = np.einsum("j,...jr->...r", weights, (predicted - mean[..., None, :]) ** 2)
    return np.concatenate([mean, np.log1p(variance) / np.sqrt(2)], axis=-1)


def profile(data: Sample, base: Fitted, model: Model) -> Profile:
    """The profile of one candidate above the fitted baseline."""
    own = base.u.size
    several = model.parameters[own:]
    null = np.array([to_box(each, each.null) for each in several])
    typical = np.array([to_box(each, each.typical) for each in several])
    few, times = data.first, math.sqrt(data.times)
    mean = base.mean if few is data else few.predict(base.model, base.theta)[0]
    target = features(mean[None], np.ones(1))

    def look(ray: Array, share: Array) -> tuple[Array, Array]:
        effect = np.repeat(typical[None], share.size, axis=0)
        effect[:, 0] = null[0] + share * (ray - null[0])
        u = np.concatenate([np.repeat(base.u[None], share.size, axis=0), effect], axis=1)
        return _refitted(few, model, u, own, target)

    def sizes(found: Array) -> Array:
        return np.asarray(times * np.linalg.norm(found - target, axis=1))

    ends = [end for end in (0.0, 1.0) if abs(end - null[0]) >= 1e-9]
    ray, share = np.repeat(ends, SHARES.size), np.tile(SHARES, len(ends))
    u, found = look(ray, share)
    for _ in range(HALVINGS):
        d = sizes(found)
        jump = np.flatnonzero((ray[1:] == ray[:-1]) & (d[:-1] < HIDDEN) & (d[1:] > JUMP))
        if not jump.size:
            break
        ways, middle = ray[jump], (share[jump] + share[jump + 1]) / 2.0
        points, seen = look(ways, middle)
        ray, share = np.insert(ray, jump + 1, ways), np.insert(share, jump + 1, middle)
        u = np.insert(u, jump + 1, points, axis=0)
        found = np.insert(found, jump + 1, seen, axis=0)
    first = several[0]
    absent = 0.0 if np.isinf(first.null) else first.null
    value = to_theta(several, u[:, own:])[:, 0]
    return Profile(
        model=model,
        u=u,
        ray=ray,
        d=sizes(found),
        features=times * found,
        size=np.maximum(np.abs(value - absent), 1e-300),
        absent=absent,
    )


def _refitted(data: Sample, model: Model, u: Array, own: int, target: Array) -> tuple[Array, Array]:
    """Points (k, p) with their first ``own`` coordinates moved toward ``target`` (2 rows,) by
    damped Gauss-Newton steps within the box, and their features (k, 2 rows)."""
    weights = np.asarray(model.weights)

    def seen(points: Array) -> Array:
        return features(data.predict(model, to_theta(model.parameters, points)), weights)

    best_u: Array = u.copy()
    best: Array = np.full(len(u), np.inf)
    kept: Array = np.zeros((len(u), target.size))
    for turn in range(REFITS):
        # the last turn only looks at where the one before it has led
        steps = np.full((len(u), own if turn < REFITS - 1 else 0), STEP)
        now, slopes = differences(seen, u, steps)
        residual = now - target
        cost = np.sum(residual**2, axis=1)
        better = cost < best
        best = np.where(better, cost, best)
        best_u = np.where(better[:, None], u, best_u)
        kept = np.where(better[:, None], now, kept)
        if not steps.size:
            break
        normal = np.einsum("kir,kjr->kij", slopes, slopes)
        normal += np.eye(own) * (1e-9 * np.trace(normal, axis1=1, axis2=2) + 1e-9)[:, None, None]
        right = np.einsum("kir,kr->ki", slopes, residual)[..., None]
        move = -np.linalg.solve(normal, right)[..., 0]
        u = best_u.copy()
        u[:, :own] = np.clip(u[:, :own] + np.clip(move, -0.3, 0.3), 0, 1)
    return best_u, kept


def directions(data: Sample, base: Fitted, profiles: Sequence[Profile]) -> list[Direction]:
    """What each candidate does to the baseline's residuals at a moderate size, by ray."""
    out = []
    for each in profiles:
        chosen = isinstance(each.model, Chosen) and each.model.choices > 1
        for point in each.nearest(DIRECTION_D, HIDDEN):
            found = each.features[point]
            if data.first is not data:
                theta = to_theta(each.model.parameters, each.u[point])
                found = features(data.predict(each.model, theta), np.asarray(each.model.weights))
            mean, variance = np.split(found, 2)
            shift, scatter = mean - base.mean, np.expm1(np.sqrt(2) * variance)
            out.append(Direction(each.name, shift, scatter, chosen))
    return out


def classes(profiles: Sequence[Profile]) -> list[tuple[str, ...]]:
    """Groups of candidates that these data cannot tell apart at `REFERENCE_D` (or as far as their
    bounds let them go), by complete linkage: every two of a group are alike, both ways."""
    visible = [each for each in profiles if each.d.max() > APART]
    if len(visible) < 2:
        return []
    apart = np.array(
        [[_imitated(one, two) if one is not two else 0.0 for two in visible] for one in visible]
    )
    label = fcluster(
        linkage(squareform(np.maximum(apart, apart.T), checks=False), "complete"), APART, "distance"
    )
    groups = [
        tuple(visible[k].name for k in np.flatnonzero(label == each)) for each in np.unique(label)
    ]
    return sorted(group for group in groups if len(group) > 1)


def _imitated(one: Profile, two: Profile) -> float:
    """The largest distance, over rays of the first effect at the reference size, at which the
    second stays from it at best; points between those of a profile are on its chords."""
    worst = 0.0
    for point in one.nearest(REFERENCE_D, APART):
        target, nearest = one.features[point], np.inf
        for ray in np.unique(two.ray):
            path = two.features[two.ray == ray]
            begin, chord = path[:-1], np.diff(path, axis=0)
            length = np.maximum(np.sum(chord**2, axis=1), 1e-12)
            share = np.clip(np.sum((target - begin) * chord, axis=1) / length, 0, 1)
            away = np.sum((target - begin - share[:, None] * chord) ** 2, axis=1)
            nearest = min(nearest, float(np.sqrt(away.min())))
        worst = max(worst, nearest)
    return worst
