"""Directions among a model's parameters that the data determine, and those that they do not.

Sensitivities of all fitted rows to the parameters, each over its bounds, are taken apart into
orthogonal directions. Along one that the data see, they tell more than the bounds do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...solver.arrays import Array
from ..loop.fit import BOX_PRECISION, to_box, to_theta
from ..loop.noise import Ints
from ..loop.problem import Model

STEP = 1e-4
SHARE = 0.3


@dataclass(frozen=True)
class Direction:
    """A direction (p,) in the unit box of the bounds, and the standard deviation along it."""

    parts: tuple[float, ...]
    deviation: float
    seen: bool

    def words(self, names: Sequence[str]) -> str:
        """The parameters that it is made of, the greatest share first."""
        order = np.argsort(-np.abs(self.parts), kind="stable")
        chosen = [i for i in order if abs(self.parts[i]) > SHARE]
        lead = np.sign(self.parts[chosen[0]])
        words = [f"{lead * self.parts[i]:+.2f} {names[i]}" for i in chosen]
        return " ".join(words).lstrip("+").replace("-", "−")


def directions(model: Model, theta: Sequence[float], rows: Ints, unit: Array) -> list[Direction]:
    """All directions (p of them), the best seen first.

    ``rows`` (n,) are those fitted, ``unit`` (rows of the problem,) takes whitened values to
    standard deviations. Where a parameter is scattered over chance, its mean is what is seen.
    """
    parameters = model.parameters
    u = np.array([to_box(each, x) for each, x in zip(parameters, theta, strict=True)])
    signed = np.where(u + STEP > 1.0, -STEP, STEP)
    points = np.concatenate([u[None], u + np.diag(signed)])
    predicted = np.asarray(model.predict(to_theta(parameters, points)))
    weights = np.asarray(model.weights)
    mean = np.einsum("j,sjr->sr", weights, predicted)[:, rows] * unit[rows]
    slopes = (mean[1:] - mean[0]) / signed[:, None]
    precision, vectors = np.linalg.eigh(slopes @ slopes.T)
    # a uniform parameter on the unit box has BOX_PRECISION by itself
    return [
        Direction(
            tuple(float(x) for x in vectors[:, k]),
            float(1.0 / np.sqrt(max(precision[k], 0.0) + BOX_PRECISION)),
            bool(precision[k] >= BOX_PRECISION),
        )
        for k in reversed(range(len(u)))
    ]
