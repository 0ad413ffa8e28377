"""Errors of reading: of unit variance where not said otherwise, drawn by shape.

Apart from the Gaussian none is of a family at parameters that a fit would hold ready: numbers of
freedom, shares, widths and coefficients are drawn anew for every dataset.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .body import Array

Draw = Callable[[tuple[int, int], np.random.Generator], Array]
ROUNDED = "rounded"


def gaussian(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    return rng.normal(size=shape)


def laplace(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    return rng.laplace(scale=math.sqrt(0.5), size=shape)


def uniform(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    return rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), size=shape)


def skewed(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """A gamma distribution of random shape, to either side."""
    k = rng.uniform(1.5, 8.0)
    return rng.choice([-1.0, 1.0]) * (rng.gamma(k, size=shape) - k) / math.sqrt(k)


def student(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    nu = rng.uniform(2.5, 8.0)
    return rng.standard_t(nu, size=shape) * math.sqrt((nu - 2.0) / nu)


def contaminated(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """A share of errors is wider; either the bulk or the whole has unit variance."""
    share, width = rng.uniform(0.02, 0.15), rng.uniform(3.0, 8.0)
    errors = rng.normal(size=shape) * np.where(rng.random(shape) < share, width, 1.0)
    whole = math.sqrt(1.0 + share * (width**2 - 1.0))
    return errors / (whole if rng.random() < 0.5 else 1.0)


def drifting(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Errors that grow or shrink mildly from the first drop to the last."""
    grow = np.exp(np.linspace(-0.5, 0.5, shape[0]) * rng.uniform(-0.6, 0.6))
    return rng.normal(size=shape) * (grow / math.sqrt(np.mean(grow**2)))[:, None]


def autoregressive(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """AR(1) or AR(2), its coefficients drawn as partial correlations."""
    partial = rng.uniform(-0.6, 0.6, size=int(rng.integers(1, 3)))
    a = np.append(partial[:1] * (1.0 - partial[1:].sum()), partial[1:])
    errors, early = rng.normal(size=(shape[0] + 200, shape[1])), len(a)
    for i in range(early, len(errors)):
        errors[i] += sum(a[k] * errors[i - 1 - k] for k in range(early))
    return errors[200:] * math.sqrt(float(np.prod(1.0 - partial**2)))


def moving_average(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    b = np.append(1.0, rng.uniform(-0.8, 0.8, size=int(rng.integers(1, 5))))
    white = rng.normal(size=(shape[0] + len(b), shape[1]))
    errors = sum(b[k] * white[len(b) - k : len(b) - k + shape[0]] for k in range(len(b)))
    return np.asarray(errors) / math.sqrt(float(b @ b))


def misdeclared(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Gaussian, of a standard deviation up to a quarter larger or smaller than declared."""
    return rng.uniform(0.75, 1.25) * rng.normal(size=shape)


UNKNOWN: dict[str, Draw] = {
    "laplace": laplace,
    "uniform": uniform,
    "skewed": skewed,
    ROUNDED: gaussian,
    "student": student,
    "contaminated": contaminated,
    "drifting": drifting,
    "autoregressive": autoregressive,
    "moving average": moving_average,
    "misdeclared": misdeclared,
}


def rounded(values: Array, step: float) -> Array:
    """``values`` as read off a scale with marks ``step`` apart."""
    return step * np.round(values / step)
