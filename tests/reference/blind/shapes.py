"""Unlisted misfits: shapes over height, speed and order, drawn anew from wide families.

Each draws a function of the drops' height, speed and order, of largest size about one; `unlisted`
makes of it what is added to y1, in proportion to it or not. Impossible levels stand apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .body import Array


@dataclass(frozen=True)
class Drops:
    """Heights in m and the speeds that they give, in the order of the drops."""

    height_m: Array
    speed_m_s: Array

    @property
    def order(self) -> Array:
        return np.arange(len(self.height_m)) / max(len(self.height_m) - 1, 1)


Shape = Callable[[Drops, np.random.Generator], Array]


def _unit(values: Array) -> Array:
    """From zero to one over the range of ``values``."""
    return (values - values.min()) / max(float(np.ptp(values)), 1e-12)


def _covariate(drops: Drops, rng: np.random.Generator, *, order: bool = True) -> Array:
    choices = [drops.height_m, drops.speed_m_s, drops.order]
    return _unit(choices[int(rng.integers(3 if order else 2))])


def waves(drops: Drops, rng: np.random.Generator) -> Array:
    """A random Fourier series of a covariate."""
    x, total = _covariate(drops, rng), np.zeros(len(drops.height_m))
    for _ in range(int(rng.integers(1, 5))):
        total += rng.normal() * np.cos(2.0 * math.pi * (rng.uniform(0.4, 4.0) * x + rng.random()))
    return total


def smooth(drops: Drops, rng: np.random.Generator) -> Array:
    """A Gaussian process of random length, one covariate or two."""
    axes = [_covariate(drops, rng) for _ in range(int(rng.integers(1, 3)))]
    square = sum(((x[:, None] - x) / rng.uniform(0.1, 0.6)) ** 2 for x in axes)
    return rng.multivariate_normal(np.zeros(len(axes[0])), np.exp(-0.5 * np.asarray(square)))


def curved(drops: Drops, rng: np.random.Generator) -> Array:
    """A power of a covariate, convex or concave."""
    return _covariate(drops, rng) ** np.exp(rng.uniform(-1.5, 1.8)) * rng.choice([-1.0, 1.0])


def bands(drops: Drops, rng: np.random.Generator) -> Array:
    """One or two bands, sharp or soft."""
    x, total = _covariate(drops, rng), np.zeros(len(drops.height_m))
    power = rng.choice([2.0, 8.0])
    for _ in range(int(rng.integers(1, 3))):
        far = np.abs(x - rng.uniform(0.1, 0.9)) / rng.uniform(0.06, 0.2)
        total += rng.choice([-1.0, 1.0]) * np.exp(-0.5 * far**power)
    return total


def threshold(drops: Drops, rng: np.random.Generator) -> Array:
    """Nothing up to a place, then a step, a ramp, or a rise that saturates."""
    over = np.maximum(_covariate(drops, rng) - rng.uniform(0.2, 0.8), 0.0)
    kind = int(rng.integers(3))
    grown = (np.sign(over), over, np.tanh(over / rng.uniform(0.03, 0.2)))[kind]
    return np.asarray(grown) * rng.choice([-1.0, 1.0])


def changes(drops: Drops, rng: np.random.Generator) -> Array:
    """Sessions: another level, or another slope over height, from random places of the order."""
    n = len(drops.height_m)
    cuts = np.sort(rng.choice(np.arange(2, n - 1), int(rng.integers(1, 4)), replace=False))
    session = np.searchsorted(cuts, np.arange(n), side="right")
    level = rng.normal(size=len(cuts) + 1)[session]
    return level * (_unit(drops.height_m) if rng.random() < 0.3 else 1.0)


def periodic(drops: Drops, rng: np.random.Generator) -> Array:
    """Every k-th drop, from the second one to the ninth."""
    k = int(rng.integers(2, 10))
    hit = np.arange(len(drops.height_m)) % k == rng.integers(k)
    return rng.choice([-1.0, 1.0]) * hit.astype(float)


def subset(drops: Drops, rng: np.random.Generator) -> Array:
    """A random part of all drops, of the high ones or of the low ones, in a state of its own."""
    place, part = _unit(drops.height_m), rng.uniform(0.2, 0.6)
    allowed = (
        np.ones_like(place, dtype=bool),
        place > rng.uniform(0.2, 0.6),
        place < rng.uniform(0.4, 0.8),
    )[int(rng.integers(3))]
    return -1.0 * (allowed & (rng.random(len(place)) < part))


def walk(drops: Drops, rng: np.random.Generator) -> Array:
    """A random walk in the order."""
    return np.cumsum(rng.normal(size=len(drops.height_m)))


FAMILIES: dict[str, Shape] = {
    "waves": waves,
    "smooth": smooth,
    "curved": curved,
    "bands": bands,
    "threshold": threshold,
    "changes": changes,
    "periodic": periodic,
    "subset": subset,
    "walk": walk,
}


def unlisted(family: str, drops: Drops, y1_m: Array, rng: np.random.Generator) -> Array:
    """What to add to ``y1_m`` (drops,) per unit of strength, in m; not all zero.

    Two in three are in proportion to y1, the others are lengths.
    """
    relative = rng.random() < 2.0 / 3.0
    for _ in range(50):
        shape = FAMILIES[family](drops, rng)
        size = float(np.abs(shape).max())
        if size > 0.0 and np.count_nonzero(shape) >= 2:
            shape = shape / size
            return shape * (y1_m if relative else np.full_like(y1_m, y1_m.mean()))
    raise ValueError(f"{family} moves none of {len(y1_m)} drops")


def impossible(y0_m: Array, rng: np.random.Generator) -> tuple[str, Array]:
    """Heights after the impact that no contact gives: of a gain, or below a rigid plane's."""
    if rng.random() < 0.5:
        return "energy is gained", rng.uniform(1.06, 1.5) * y0_m
    return "less than a rigid plane leaves", rng.uniform(0.05, 0.25) * y0_m
