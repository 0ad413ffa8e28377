"""What would each effect do to these data, from too small to see up to its bounds?

From the fitted baseline, rays lead through an effect's box of parameters. At each point the
baseline's own parameters are refitted to the data that the baseline predicts, so what is left is
what no refit absorbs. Its size is d: the expected log likelihood ratio is d²/2. With scatter,
a drop's rows are taken as jointly normal, with mean μ and covariance I + C over the nodes, and
d² = |μ|² + tr C − log det(I + C): twice the Kullback-Leibler divergence from the baseline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver.bristle import Array
from .fit import Fitted, to_box, to_theta
from .noise import Ints
from .problem import Model
from .sample import Sample

LEVELS = np.array([1.0, 1.5, 2.2, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0, 30.0, 60.0, 120.0])
EXPLORED = np.concatenate([np.geomspace(3e-5, 0.7, 17), [1.0]])
REFITS = 3
MOST_VALUES = 70_000


@dataclass(frozen=True)
class Ladder:
    """Points of one candidate: ``u`` (points, p) with the baseline refitted, ``predicted``
    (points, nodes, rows), ``d`` (points,), ``ray`` (points,). ``way`` (rays, explored) is d along
    each ray and ``ends`` (rays, 2, q) where in the effect's unit box each ray begins and ends."""

    model: Model
    u: Array
    predicted: Array
    d: Array
    ray: Ints
    way: Array
    ends: Array

    @property
    def name(self) -> str:
        return self.model.effects[0]

    def mean(self) -> Array:
        """Mean predictions (points, rows)."""
        return np.einsum("j,kjr->kr", np.asarray(self.model.weights), self.predicted)


def ladder(data: Sample, base: Fitted, model: Model, levels: Array = LEVELS) -> Ladder:
    """The ladder of one candidate above the fitted baseline, with rungs at sizes ``levels``."""
    own = base.u.size
    ends = _rays(model, own)
    explored = EXPLORED if np.asarray(model.weights).size == 1 else EXPLORED[5::2]
    e = ends[:, None, 0] + explored[None, :, None] * (ends[:, 1] - ends[:, 0])[:, None, :]
    _, _, d = _refitted(data, base, model, e.reshape(-1, e.shape[-1]))
    way = np.maximum.accumulate(d.reshape(e.shape[:2]), axis=1)
    chosen, rays = [], []
    for ray in range(ends.shape[0]):
        begin, end = ends[ray, 0], ends[ray, 1]
        for where in _crossings(explored, way[ray], levels):
            chosen.append(begin + where * (end - begin))
            rays.append(ray)
    # Scatter costs as many predictions as it has nodes.
    cost = len(chosen) * np.asarray(model.weights).size * data.values.size
    stride = min(max(1, round(cost / MOST_VALUES)), 6)
    chosen, rays = chosen[::stride], rays[::stride]
    u, predicted, d = _refitted(data, base, model, np.array(chosen))
    return Ladder(model, u, predicted, d, np.array(rays, dtype=np.int64), way, ends)


def size_at(data: Sample, base: Fitted, model: Model, effect: Array) -> float:
    """d of an effect at one point (q,) of its unit box, the baseline refitted."""
    return float(_refitted(data, base, model, np.asarray(effect)[None])[2][0])


def explored_shares(found: Ladder) -> Array:
    """How far along their ray, from 0 to 1, the points of ``way`` lie."""
    return EXPLORED if found.way.shape[1] == EXPLORED.size else EXPLORED[5::2]


def _crossings(explored: Array, way: Array, levels: Array) -> list[float]:
    """Where along a ray the ``levels`` of d are crossed, and its end."""
    known = way > 1e-9
    if not known.any():
        return [1.0]
    levels = levels[way[-1] * 0.97 > levels]
    at = np.exp(np.interp(np.log(levels), np.log(way[known]), np.log(explored[known]), left=np.nan))
    # Below the first explored point: in proportion, exact enough to step from.
    low = np.isnan(at)
    at[low] = explored[known][0] * levels[low] / way[known][0]
    return [*at.tolist(), 1.0]


def _rays(model: Model, own: int) -> Array:
    """Begin and end of each ray (rays, 2, q) in the unit box of the effect's parameters."""
    several = model.parameters[own:]
    null = np.array([to_box(each, each.null) for each in several])
    usual = np.array([to_box(each, each.typical) for each in several])
    q = null.size
    pairs: list[tuple[Array, Array]] = []
    targets = np.array(np.meshgrid(*([[0.0, 0.5, 1.0]] * q), indexing="ij")).reshape(q, -1).T
    for target in targets if q > 1 else np.array([[0.0], [1.0]]):
        pairs.append((null, target))
    if q > 1:
        for i in range(q):
            for level in (0.1, 0.3, 0.6, 0.9, usual[i]):
                for j in range(q):
                    if j == i:
                        continue
                    begin = usual.copy()
                    begin[i], begin[j] = level, null[j]
                    for bound in (0.0, 1.0):
                        end = begin.copy()
                        end[j] = bound
                        pairs.append((begin, end))
    kept = [np.stack(pair) for pair in pairs if np.max(np.abs(pair[1] - pair[0])) > 1e-6]
    return np.unique(np.array(kept), axis=0)


def _refitted(
    data: Sample, base: Fitted, model: Model, effect: Array
) -> tuple[Array, Array, Array]:
    """Points (k, p), predictions (k, nodes, rows), d (k,) at ``effect`` (k, q), with the
    baseline's parameters refitted to the fitted baseline's own prediction."""
    own, count = base.u.size, effect.shape[0]
    weights = np.asarray(model.weights)
    target = base.mean
    u: Array = np.concatenate([np.repeat(base.u[None], count, axis=0), effect], axis=1)
    best_u = u.copy()
    best = np.asarray(np.full(count, np.inf))
    kept: Array | None = None
    step = np.clip(0.05 / np.sqrt(np.maximum(np.diag(base.information), 1e-12)), 1e-6, 1e-3)
    for turn in range(REFITS):
        last = turn == REFITS - 1
        points = np.repeat(u[:, None], 1 if last else own + 1, axis=1)
        signed = np.where(u[:, :own] + step > 1, -step, step)
        if not last:
            for i in range(own):
                points[:, i + 1, i] += signed[:, i]
        every = data.predict(model, to_theta(model.parameters, points))
        means = np.einsum("j,ksjr->ksr", weights, every)
        variance = np.einsum("j,kjr->kr", weights, (every[:, 0] - means[:, :1]) ** 2)
        left = means[:, 0] - target
        precision = 1 / (1 + variance)
        score = np.sum(left**2 * precision, axis=1)
        better = score <= best
        best = np.where(better, score, best)
        best_u = np.where(better[:, None], u, best_u)
        kept = every[:, 0] if kept is None else np.where(better[:, None, None], every[:, 0], kept)
        if last:
            break
        slopes = (means[:, 1:] - means[:, :1]) / signed[..., None]
        normal = np.einsum("kir,kjr,kr->kij", slopes, slopes, precision)
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(own) + 1e-12 * (
            np.eye(own)
        )
        wanted = np.einsum("kir,kr,kr->ki", slopes, left, precision)
        move = -np.linalg.solve(normal, wanted[..., None])[..., 0]
        u = u.copy()
        u[:, :own] = np.clip(u[:, :own] + move, 0, 1)
    assert kept is not None
    return best_u, kept, size(data, kept, weights, target)


def size(data: Sample, predicted: Array, weights: Array, target: Array) -> Array:
    """d (k,) of predictions (k, nodes, rows) against a target without scatter (rows,)."""
    mean = np.einsum("j,kjr->kr", weights, predicted)
    total = np.sum((mean - target) ** 2, axis=1)
    if weights.size > 1:
        for begin, end in zip(data.starts[:-1], data.starts[1:], strict=True):
            part = (predicted[..., begin:end] - mean[:, None, begin:end]) * np.sqrt(weights)[
                :, None
            ]
            if end - begin <= weights.size:
                gram = np.einsum("kjr,kjs->krs", part, part)
            else:
                gram = np.einsum("kjr,kir->kji", part, part)
            trace = np.trace(gram, axis1=1, axis2=2)
            total += trace - np.linalg.slogdet(np.eye(gram.shape[1]) + gram)[1]
    return np.sqrt(np.maximum(total, 0.0))
