"""The next measurement: what would separate the models that these data leave tied.

For each experiment and each ordered pair of tied models, the second is refitted to what the first
predicts there, held by what the present data say of its parameters (its information at the fit).
Half the squared distance that remains (`profile.features`), averaged over pairs, is the expected
gain in nats (Box and Hill, Technometrics 9 (1967) 57, for normal noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import permutations

import numpy as np

from ...solver.arrays import Array
from .finding import Proposal
from .fit import BOX_PRECISION, STEP, differences, to_theta
from .posterior import Posterior
from .problem import Experiment, Model, Problem, refined_as
from .profile import features

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
    models = [refined_as(experiment.models(each.fitted.model), each.fitted.u.size) for each in tied]
    gains = [
        _distance(model, other, _seen(made, truth.fitted.u)) / 2
        for (truth, made), (other, model) in permutations(zip(tied, models, strict=True), 2)
    ]
    return float(np.mean(gains))


def _seen(model: Model, u: Array) -> Array:
    """Features (..., 2 rows) of what a model predicts at points (..., p) of the unit box."""
    return features(model.predict(to_theta(model.parameters, u)), np.asarray(model.weights))


def _distance(model: Model, other: Posterior, target: Array) -> float:
    """Least squared distance to the target plus what leaving its present fit costs."""
    u0 = other.fitted.u
    hold = other.fitted.information + BOX_PRECISION * np.eye(u0.size)
    u, best = u0.copy(), np.inf
    for _ in range(TURNS):
        now, slopes = (
            each[0]
            for each in differences(partial(_seen, model), u[None], np.full((1, u.size), STEP))
        )
        residual = now - target
        best = min(best, float(residual @ residual + (u - u0) @ hold @ (u - u0)))
        move = np.linalg.solve(slopes @ slopes.T + hold, slopes @ residual + hold @ (u - u0))
        u = np.clip(u - move, 0, 1)
    return best
