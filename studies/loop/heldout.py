"""How well does a model predict groups that took no part, before and after the effect is added?

Where the problem names no groups to hold out, a quarter of them, at least two, are chosen by the
seed before anything is fitted: sorted by height, one of each four neighbours, so that every height
is tried. Whole groups, since rows of one drop share its chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver.bristle import Array
from .noise import Ints
from .posterior import Posterior
from .problem import Problem
from .sample import HEIGHT, Sample

RESAMPLED = 999
DRAWS = 400


@dataclass(frozen=True)
class HeldOut:
    """Errors in ``unit`` on held-out ``groups``; ``reduction`` is 1 − after / before, with its 90 %
    interval over groups. ``values``, ``before``, ``after``, ``low``, ``high`` (rows,) in ``unit``
    by held-out row of the main quantity."""

    groups: tuple[int, ...]
    unit: str
    rms_before: float
    rms_after: float
    reduction_low: float
    reduction_high: float
    coverage_90: float
    rows: Ints
    values: Array
    before: Array
    after: Array
    low: Array
    high: Array


def split(problem: Problem, seed: int) -> tuple[Ints, Ints]:
    """Groups for fitting and groups held out."""
    rng = np.random.default_rng([seed, 1])
    groups = np.unique(problem.group)
    if problem.held is not None:
        apart = np.isin(groups, problem.held)
        return groups[~apart], groups[apart]
    if groups.size < 4:
        return groups, groups[:0]
    height = next((problem.covariates[n] for n in HEIGHT if n in problem.covariates), None)
    key = np.zeros(groups.size)
    if height is not None:
        key = np.array([np.mean(height[problem.group == g]) for g in groups])
    order = np.lexsort((rng.random(groups.size), np.round(key, 12)))
    count = max(2, groups.size // 4)
    blocks = np.array_split(order, count)
    chosen = np.array([int(rng.choice(block)) for block in blocks])
    held = np.zeros(groups.size, dtype=bool)
    held[chosen] = True
    return groups[~held], groups[held]


def judge(
    problem: Problem,
    data: Sample,
    base: Posterior,
    final: Posterior,
    held: Sample,
    rng: np.random.Generator,
) -> HeldOut:
    """Errors of baseline and final model on the held-out rows of the main quantity."""
    main = str(problem.quantity[0])
    mine = np.flatnonzero(problem.quantity[held.rows] == main)
    if not mine.size:
        mine = np.arange(held.rows.size)
    rows = held.rows[mine]
    scale = problem.scale[rows] / held.unit[mine]
    values = held.values[mine] * scale
    before = _mean(held, base)[mine] * scale
    after = _mean(held, final)[mine] * scale
    drawn = _draws(data, held, final, rng)
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    inside = (held.values >= low) & (held.values <= high)
    group = held.group[mine]
    labels = np.unique(group)
    one = np.array([np.sum((values - before)[group == g] ** 2) for g in labels])
    two = np.array([np.sum((values - after)[group == g] ** 2) for g in labels])
    pick = rng.integers(labels.size, size=(RESAMPLED, max(labels.size, 1))) if labels.size else None
    ends = (0.0, 0.0)
    if pick is not None and not np.allclose(one, two):
        ratio = 1 - np.sqrt(two[pick].sum(axis=1) / np.maximum(one[pick].sum(axis=1), 1e-300))
        ends = (float(np.quantile(ratio, 0.05)), float(np.quantile(ratio, 0.95)))
    return HeldOut(
        groups=tuple(int(g) for g in np.unique(problem.group[held.rows])),
        unit=problem.unit,
        rms_before=float(np.sqrt(np.mean((values - before) ** 2))),
        rms_after=float(np.sqrt(np.mean((values - after) ** 2))),
        reduction_low=ends[0],
        reduction_high=ends[1],
        coverage_90=float(np.mean(inside)),
        rows=rows,
        values=values,
        before=before,
        after=after,
        low=low[mine] * scale,
        high=high[mine] * scale,
    )


def _mean(held: Sample, final: Posterior) -> Array:
    model = final.fitted.model
    return np.asarray(np.asarray(model.weights) @ held.predict(model, final.fitted.theta))


def _draws(data: Sample, held: Sample, final: Posterior, rng: np.random.Generator) -> Array:
    """Predictive draws (draws, rows): parameters, each group's chance, and noise."""
    del data
    model = final.fitted.model
    weights = np.asarray(model.weights)
    pick = rng.choice(final.weights.size, size=DRAWS, p=final.weights)
    distinct, where = np.unique(pick, return_inverse=True)
    predicted = held.predict(model, final.theta[distinct])
    node = rng.choice(weights.size, size=(DRAWS, held.starts.size - 1), p=weights / weights.sum())
    mean = predicted[where[:, None], node[:, held.group], np.arange(held.values.size)[None]]
    # Held-out sets may be too short for correlations to be among their noises.
    grid, own = final.shares, held.noises
    kinds = min(grid.size, own.scale.size)
    folded = grid.reshape(-1, kinds).sum(axis=0) if grid.size % kinds == 0 else grid[:kinds]
    noise = rng.choice(kinds, size=DRAWS, p=folded / folded.sum())
    return mean + own.draw(noise, rng)
