"""Least squares of the rows of a loop's model whose parameters do not differ by chance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares


class ModelFit(NamedTuple):
    """Estimates, their standard deviations (of logarithms where parameters are logarithmic), and
    the sum of squares that is left."""

    theta: np.ndarray
    spread: np.ndarray
    left: float


def fit(model, values, chosen=slice(None)) -> ModelFit:
    """Within the parameters' bounds, from their typical values, to the rows that are ``chosen``."""
    log = np.array([p.logarithmic for p in model.parameters])
    low, high, usual = (
        np.array([getattr(p, k) for p in model.parameters]) for k in ("low", "high", "typical")
    )
    low, high, usual = (np.where(log, np.log(np.where(log, x, 1.0)), x) for x in (low, high, usual))

    def theta(u):
        x = low + (high - low) * u
        return np.where(log, np.exp(np.where(log, x, 0.0)), x)

    found = least_squares(
        lambda u: (model.predict(theta(u))[0] - values)[chosen],
        np.clip((usual - low) / (high - low), 0.01, 0.99),
        bounds=(0, 1),
        x_scale=0.01,
    )
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac))) * (high - low)
    return ModelFit(theta(found.x), spread, 2.0 * found.cost)
