"""How large must an effect be for these data to show it with a given size d?

d is the noise-whitened norm of what an effect changes, after projecting out what fitting the
baseline absorbs; for an unlisted effect, what any listed one absorbs too (`d_beyond`).
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


def d_beyond(problem: Problem, data: Sample, base: Fitted, change: Array) -> float:
    """What no listed effect absorbs of a ``change`` (rows of the problem,), whitened."""
    values = base.mean + change[data.rows] * data.unit
    moved = replace(data, values=values)
    left = np.inf
    for model in (problem.baseline, *problem.candidates):
        starts = _starts(model, base)
        fitted = fit(moved, model, starts, GAUSSIAN)
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
