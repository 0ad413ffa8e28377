"""The next measurement: what would separate the models that these data leave tied.

For each experiment and each ordered pair of tied models, the second is refitted to what the first
predicts there, held by what the present data say of its parameters (its information at the fit).
Half the squared distance that remains, averaged over pairs, is the expected gain in nats
(Box and Hill, Technometrics 9 (1967) 57, for normal noise).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...solver.arrays import Array
from .finding import Proposal
from .fit import to_theta
from .posterior import Posterior
from .problem import Experiment, Model, Problem

TURNS = 8
MOST_TIED = 4


def next_experiment(problem: Problem, tied: Sequence[Posterior]) -> Proposal | None:
    """The experiment of greatest expected gain, or None where nothing is tied or none is known."""
    if len(tied) < 2 or not problem.experiments:
        return None
    several = list(tied[:MOST_TIED])
    gains = [_gain(experiment, several) for experiment in problem.experiments]
    best = int(np.argmax(gains))
    names = tuple(dict.fromkeys(n for each in several for n in each.fitted.effects))
    return Proposal(problem.experiments[best].change, names, float(gains[best]))


def _gain(experiment: Experiment, tied: Sequence[Posterior]) -> float:
    models = [experiment.models(each.fitted.effects) for each in tied]
    gains = []
    for i, truth in enumerate(tied):
        target = _mean(models[i], truth.fitted.theta)
        for j, other in enumerate(tied):
            if i != j:
                gains.append(_distance(models[j], other, target) / 2)
    return float(np.mean(gains))


def _mean(model: Model, theta: Array) -> Array:
    """Mean predictions (..., rows), with their spread as further rows where chance plays."""
    weights = np.asarray(model.weights)
    every = np.asarray(model.predict(theta))
    mean = np.einsum("j,...jr->...r", weights, every)
    if weights.size == 1:
        return mean
    spread = np.einsum("j,...jr->...r", weights, (every - mean[..., None, :]) ** 2)
    return np.concatenate([mean, np.log1p(spread) / 2], axis=-1)


def _distance(model: Model, other: Posterior, target: Array) -> float:
    """Least squared distance to the target plus what leaving its present fit costs."""
    fitted = other.fitted
    u0 = fitted.u
    hold = fitted.information + 12.0 * np.eye(u0.size)
    step = 1e-4
    u = u0.copy()
    best = np.inf
    for _ in range(TURNS):
        points = np.repeat(u[None], u.size + 1, axis=0)
        signed = np.where(u + step > 1, -step, step)
        points[1:] += np.diag(signed)
        every = _matched(_mean(model, to_theta(model.parameters, points)), target)
        residual = every[0] - _matched(target, every[0])
        cost = float(residual @ residual + (u - u0) @ hold @ (u - u0))
        best = min(best, cost)
        slopes = ((every[1:] - every[0]) / signed[:, None]).T
        move = np.linalg.solve(slopes.T @ slopes + hold, slopes.T @ residual + hold @ (u - u0))
        u = np.clip(u - move, 0, 1)
    return best


def _matched(values: Array, like: Array) -> Array:
    """Pad with zeros: a model without chance has no spread."""
    short = like.shape[-1] - values.shape[-1]
    if short <= 0:
        return values
    width = [(0, 0)] * (values.ndim - 1) + [(0, short)]
    return np.pad(values, width)
