"""What does a film show of a drop: how are the heights on it, and their summaries, made?

The same for every account of the loss, so that accounts differ in mechanics alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...solver import paper
from ...solver.bristle import Array, positive
from ...solver.errors import InputError

DRAWS = 5


@dataclass(frozen=True)
class Film:
    """A film of ``frames_per_s`` whose phase is unknown, read with error ``sigma_m``.

    The apex falls anywhere between two frames, so the nearest one shows it too low by g dt²/2, dt
    uniform in plus and minus half a frame. Heights before and after are both read, each with an
    independent normal error; 0.5 mm is an assumption from the size of a pixel. The fall itself is
    from the nominal height.
    """

    frames_per_s: float = paper.FRAMES_PER_S
    sigma_m: float = 0.5e-3
    gravity_m_s2: float = paper.GRAVITY_M_S2

    def __post_init__(self) -> None:
        positive("frame rate", self.frames_per_s)
        if not (math.isfinite(self.sigma_m) and self.sigma_m >= 0.0):
            raise InputError(f"the reading error must be zero or more, not {self.sigma_m}")

    def read(self, y0_m: Array, y1_m: Array, chance: Array) -> tuple[Array, Array]:
        """Heights before and after as read, of the shape of ``y1_m``.

        ``chance`` (3, …) holds standard normal numbers: phase, error before, error after.
        """
        phase = np.clip(_uniform(chance[0]), 0.0, 1.0) - 0.5
        low = 0.5 * self.gravity_m_s2 * (phase / self.frames_per_s) ** 2
        seen = np.maximum(y1_m - low, 0.0)
        return y0_m + self.sigma_m * chance[1], seen + self.sigma_m * chance[2]

    @property
    def mean_low_m(self) -> float:
        """By how much the apex is read too low on the average: g T²/24."""
        return self.gravity_m_s2 / (24.0 * self.frames_per_s**2)

    @property
    def spread_low_m(self) -> float:
        """Standard deviation of that: (g T²/8) √(1/5 - 1/9)."""
        return self.gravity_m_s2 / (8.0 * self.frames_per_s**2) * math.sqrt(1.0 / 5.0 - 1.0 / 9.0)


def _uniform(normal: Array) -> Array:
    """Uniform numbers of the same rank as standard normal ones."""
    from scipy.special import ndtr

    return ndtr(normal)


def planned_heights_m(n: int = paper.N_DROPS) -> Array:
    """The nominal heights (n,), as evenly over the paper's five as ``n`` allows.

    How many drops were made from which height is not published. What is left over is taken from
    the middle height outward.
    """
    heights = np.array(paper.HEIGHTS_M)
    order = np.argsort(np.abs(np.arange(len(heights)) - len(heights) // 2), kind="stable")
    each, over = divmod(n, len(heights))
    counts = np.full(len(heights), each)
    counts[order[:over]] += 1
    return np.repeat(heights, counts)


class Moments(NamedTuple):
    """What is published of a set of drops, arrays of one entry a set, or numbers.

    ``share`` is that of drops with y1/y0 in the paper's band.
    """

    mean: Array
    std: Array
    slope: Array
    r2_linear: Array
    r2_quadratic: Array
    share: Array


# The band's ends are mean ± 1.645 standard deviations to two decimals: 0.90 is the normal's own.
PUBLISHED = Moments(
    mean=np.array(paper.RATIO_MEAN),
    std=np.array(paper.RATIO_STD),
    slope=np.array(paper.RATIO_MEAN),
    r2_linear=np.array(paper.R2_LINEAR),
    r2_quadratic=np.array(paper.R2_QUADRATIC),
    share=np.array(0.90),
)
FITTED = ("mean", "log std", "slope", "log(1 - R²)", "cube root of the quadratic's share")
# What printing leaves open: a uniform error as wide as one unit of the last digit.
_UNITS = (0.01, 0.01 / paper.RATIO_STD, 0.01, 1e-4 / (1.0 - paper.R2_LINEAR), 0.0)
ROUNDING = np.array(_UNITS) / math.sqrt(12.0)


def moments(y0_m: Array, y1_m: Array) -> Moments:
    """The published summaries of sets of drops (…, n): R² about the mean, curves through zero."""
    ratio = y1_m / y0_m
    low, high = paper.RATIO_BAND_90
    linear, quadratic = through_origin(y0_m, y1_m)
    left = np.sum((y1_m - linear[..., 0, None] * y0_m) ** 2, axis=-1)
    bent = quadratic[..., 0, None] * y0_m + quadratic[..., 1, None] * y0_m**2
    about = np.sum((y1_m - y1_m.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    return Moments(
        ratio.mean(axis=-1),
        ratio.std(axis=-1, ddof=1),
        linear[..., 0],
        1.0 - left / about,
        1.0 - np.sum((y1_m - bent) ** 2, axis=-1) / about,
        np.mean((ratio >= low) & (ratio <= high), axis=-1),
    )


def through_origin(y0_m: Array, y1_m: Array) -> tuple[Array, Array]:
    """Least-squares coefficients (…, 1) of y1 = a y0 and (…, 2) of y1 = a y0 + b y0²."""
    s2, s3, s4 = (np.sum(y0_m**k, axis=-1) for k in (2, 3, 4))
    t1, t2 = (np.sum(y1_m * y0_m**k, axis=-1) for k in (1, 2))
    determinant = s2 * s4 - s3 * s3
    a, b = (t1 * s4 - t2 * s3) / determinant, (s2 * t2 - s3 * t1) / determinant
    return (t1 / s2)[..., None], np.stack([a, b], axis=-1)


def vector(of: Moments) -> Array:
    """The summaries as the fit sees them (…, 5), made nearly normal, named in ``FITTED``.

    The share in the band is left out: the published band is the normal's own (0.65 ± 1.645 × 0.21),
    so it says nothing that mean and standard deviation do not. The quadratic's share is what of the
    line's residual the second term takes away.
    """
    gain = np.maximum(of.r2_quadratic - of.r2_linear, 0.0) / (1.0 - of.r2_linear)
    parts = (of.mean, np.log(of.std), of.slope, np.log(1.0 - of.r2_linear), np.cbrt(gain))
    return np.stack([np.asarray(part, float) for part in parts], axis=-1)


class R2Definition(NamedTuple):
    """A way to take R² of both fits, and what sets of 26 drops would give under it.

    ``low`` and ``high`` bound 90 % of the sets for R² of the line; ``tail`` and ``gain_tail`` are
    two-sided p-values of the published R² and of its gain by the quadratic.
    """

    about: str
    quadratic: str
    low: float
    high: float
    tail: float
    gain: float
    gain_tail: float


def r2_definitions(film: Film, sets: int = 4000, seed: int = 7326) -> list[R2Definition]:
    """Which definition fits the published pair: drops with normal y1/y0, 0.65 ± 0.21, on film.

    The film is part of the published 0.21, so the ratios themselves are drawn a little narrower.
    """
    random = np.random.default_rng(seed)
    y0 = planned_heights_m()
    chance = random.standard_normal((4, sets, len(y0)))
    blur = np.mean((film.spread_low_m**2 + film.sigma_m**2 * (1.0 + paper.RATIO_MEAN**2)) / y0**2)
    own = math.sqrt(max(paper.RATIO_STD**2 - blur, 0.0))
    ratio = paper.RATIO_MEAN + np.mean(film.mean_low_m / y0) + own * chance[3]
    x, y = film.read(y0, np.maximum(ratio, 0.0) * y0, chance[:3])
    found = []
    for about in ("the mean of y1", "zero"):
        base = y.mean(axis=-1, keepdims=True) if about != "zero" else 0.0
        total = np.sum((y - base) ** 2, axis=-1)
        linear = 1.0 - _left(x, y, (1,)) / total
        low, high = np.percentile(linear, (5.0, 95.0))
        for name, powers in (("a y0 + b y0²", (1, 2)), ("a + b y0 + c y0²", (0, 1, 2))):
            gain = 1.0 - _left(x, y, powers) / total - linear
            found.append(
                R2Definition(
                    about,
                    name,
                    float(low),
                    float(high),
                    two_sided(linear, paper.R2_LINEAR),
                    float(np.median(gain)),
                    two_sided(gain, paper.R2_QUADRATIC - paper.R2_LINEAR),
                )
            )
    return found


def _left(x: Array, y: Array, powers: tuple[int, ...]) -> Array:
    """Residual sum of squares (sets,) of fits with these powers of x."""
    scaled = x / x.max()
    columns = np.stack([scaled**p for p in powers], axis=-1)
    normal = np.swapaxes(columns, -1, -2) @ columns
    best = np.linalg.solve(normal, np.swapaxes(columns, -1, -2) @ y[..., None])
    return np.sum((y - (columns @ best)[..., 0]) ** 2, axis=-1)


def two_sided(drawn: Array, value: float) -> float:
    """Twice the smaller tail of ``drawn`` (n,) beyond ``value``, at most one."""
    n = len(drawn)
    below = (1 + np.count_nonzero(drawn <= value)) / (n + 1)
    above = (1 + np.count_nonzero(drawn >= value)) / (n + 1)
    return float(min(2.0 * min(below, above), 1.0))
