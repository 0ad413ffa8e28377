"""How small could the set of effects be, at best, for data with a known effect in them?

An ideal reader knows the noise and how every effect acts. Datasets are drawn from the truth; each
time, effects are weighted by their likelihoods at their best, and the smallest set is taken that
holds 95 % of the weight. Two effects whose predictions differ by δ sigma, refit included, are told
apart with odds whose logarithm is normal with mean δ²/2 and variance δ²: from 2 to 3 sigma on
that often takes both.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...solver.bristle import Array
from ..loop.attribute import credible, weights_of
from ..loop.detect import ratios, refit, simulate
from ..loop.fit import Fitted
from ..loop.ladder import LEVELS, ladder
from ..loop.problem import Model, Problem
from ..loop.sample import Sample
from ..loop.sizes import GAUSSIAN

SETS = 300
# How far an effect's size may come out from the truth's, and the steps between, in sigma.
SPREAD, STEP = 4.0, 0.4


class Ideal(NamedTuple):
    """The mean ``size`` of the ideal reader's sets, and the share of them that hold the truth."""

    size: float
    hit: float


def ideal_set(
    problem: Problem, data: Sample, base: Fitted, truth: Model, theta: Array, d: float, seed: int
) -> Ideal:
    """The ideal reader's sets for data from ``truth`` at ``theta`` (p,), of size ``d``.

    ``data`` and ``base`` are those of `sizes.clean`.
    """
    fine = np.arange(max(d - SPREAD, STEP), d + SPREAD, STEP)
    levels = np.union1d(LEVELS, fine)
    known = np.array([GAUSSIAN])
    shares = np.zeros(data.noises.scale.size)
    shares[GAUSSIAN] = 1.0
    true = replace(base, model=truth, predicted=data.predict(truth, theta[None])[0])
    drawn = simulate(data, true, shares, known, SETS, np.random.default_rng([seed, 9]))
    found = refit(data, drawn - base.mean, base.mean_slopes, known)
    names = [model.effects[0] for model in problem.candidates]
    logs = np.stack(
        [
            ratios(data, found, base.mean, ladder(data, base, model, levels), known)[0]
            for model in problem.candidates
        ],
        axis=1,
    )
    sets = [credible(weights_of(each)) for each in logs]
    held = [names.index(truth.effects[0]) in each for each in sets]
    return Ideal(float(np.mean([len(each) for each in sets])), float(np.mean(held)))
