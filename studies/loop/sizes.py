"""How large must an effect be for these data to show it with a given size d?

d is the noise-whitened norm of what an effect changes, after projecting out what fitting the
baseline absorbs; for an unlisted effect, what any listed one absorbs too (`d_beyond`); for two
effects together also what any single one explains of both (`values_beyond`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...solver.bristle import Array
from .fit import Fitted, fit, to_box, to_theta
from .heldout import split
from .ladder import explored_shares, ladder, size_at
from .problem import Model, Problem
from .sample import Sample, sample

GAUSSIAN = 0
# Halvings to a value of the wanted size, and how near is near enough.
BISECTIONS = 12
CLOSE = 0.02
# The same for two effects at once.
TURNS, NEAR = 8, 0.05


def clean(problem: Problem, theta: Array, seed: int) -> tuple[Sample, Fitted]:
    """The rows that are fitted, as the baseline at ``theta`` predicts them, and its fit."""
    groups, _ = split(problem, seed)
    values = np.asarray(problem.baseline.predict(theta))[0]
    data = sample(replace(problem, values=values, sigma_declared=True), groups)
    parameters = problem.baseline.parameters
    start = np.array([to_box(p, float(t)) for p, t in zip(parameters, theta, strict=True)])
    return data, fit(data, problem.baseline, start[None], GAUSSIAN)


def value_for(data: Sample, base: Fitted, model: Model, d: float, way: int) -> float | None:
    """The effect's parameter on its ray number ``way`` that gives ``d``; None where none does."""
    found = ladder(data, base, model)
    ray = way % len(found.way)
    sizes, shares = found.way[ray], explored_shares(found)
    if sizes[-1] < d:
        return None
    above = int(np.argmax(sizes >= d))
    low, high = (shares[above - 1] if above else 0.0), shares[above]
    begin, end = found.ends[ray]
    own = base.u.size
    for _ in range(BISECTIONS):
        share = 0.5 * (low + high)
        reached = size_at(data, base, model, begin + share * (end - begin))
        low, high = (share, high) if reached < d else (low, share)
        if abs(reached / d - 1.0) < CLOSE:
            break
    return float(to_theta(model.parameters[own:], begin + share * (end - begin))[0])


def values_beyond(
    problem: Problem,
    data: Sample,
    base: Fitted,
    names: tuple[str, str],
    values: tuple[float, float],
    d: float,
) -> tuple[float, float] | None:
    """Parameters of two effects that together show with ``d`` beyond every single one.

    Found along the way from absence of both through ``values``; None where it ends before.
    """
    own = base.u.size
    both = problem.combine(names)
    null = np.array([to_box(p, p.null) for p in both.parameters[own:]])
    way = np.array([to_box(p, v) for p, v in zip(both.parameters[own:], values, strict=True)])
    way -= null
    share = 1.0
    for _ in range(TURNS):
        u = null + share * way
        if (u < 0.0).any() or (u > 1.0).any():
            return None
        theta = to_theta(both.parameters, np.concatenate([base.u, u])[None])
        mean = np.asarray(both.weights) @ data.predict(both, theta)[0]
        seen = _left(problem, data, base, mean)
        if abs(seen / d - 1.0) < NEAR:
            return float(theta[0, own]), float(theta[0, own + 1])
        share *= float(np.clip(d / max(seen, 1e-9), 0.4, 2.5))
    return None


def d_beyond(problem: Problem, data: Sample, base: Fitted, change: Array) -> float:
    """What no listed effect absorbs of a ``change`` (rows of the problem,), whitened."""
    return _left(problem, data, base, base.mean + change[data.rows] * data.unit)


def _left(problem: Problem, data: Sample, base: Fitted, values: Array) -> float:
    """What no single listed effect explains of ``values`` (rows of the sample,)."""
    moved = replace(data, values=values)
    left = np.inf
    for model in (problem.baseline, *problem.candidates):
        fitted = fit(moved, model, _starts(model, base), GAUSSIAN)
        left = min(left, float(np.sum((values - fitted.mean) ** 2)))
    return float(np.sqrt(left))


def _starts(model: Model, base: Fitted) -> Array:
    """Small and middling amounts of each of the effect's parameters, both ways."""
    own = base.u.size
    rows = []
    for parameter in model.parameters[own:]:
        null = to_box(parameter, parameter.null)
        for share in (0.05, 0.4):
            rows += [np.append(base.u, null + share * (end - null)) for end in (0.0, 1.0)]
    return np.array(rows) if rows else base.u[None]
