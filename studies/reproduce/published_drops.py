"""Sets of 26 drops that have the summaries which the paper published of its drops.

The points themselves are not published. What a loop over drops finds counts only where it holds
over many sets that could have been them: multiple imputation (Rubin, Multiple Imputation for
Nonresponse in Surveys, Wiley 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import betaincinv, ndtr

from ...solver import paper
from ...solver.arrays import Array
from ...solver.bristle import Bristle
from ...solver.errors import ComputationError
from ..data.datasets import Drops, Manifest

# Mean and standard deviation of y1/y0, slope of y1 = a y0, R² of that and of y1 = a y0 + b y0².
PRINTED = np.array(
    (
        paper.RATIO_MEAN,
        paper.RATIO_STD,
        paper.RATIO_MEAN,
        paper.R2_LINEAR,
        paper.R2_QUADRATIC,
    )
)
DECIMALS = np.array((2, 2, 2, 4, 4))
BODY = ("length_m", "width_m", "thickness_m")


@dataclass(frozen=True)
class Film:
    """The paper's film, its phase unknown, heights on it read to ``reading_m``: a pixel's size, an
    assumption.

    An apex lies anywhere between two frames, so that the nearest one shows it too low by g dt²/2,
    dt uniform in plus and minus half of the time T from one to the next.
    """

    reading_m: float = 0.5e-3

    @property
    def mean_low_m(self) -> float:
        """By how much an apex is seen too low on the average: g T²/24."""
        return paper.GRAVITY_M_S2 / (24.0 * paper.FRAMES_PER_S**2)

    @property
    def spread_low_m(self) -> float:
        """Standard deviation of that: (g T²/8) √(1/5 - 1/9)."""
        return 3.0 * self.mean_low_m * math.sqrt(1.0 / 5.0 - 1.0 / 9.0)

    @property
    def sigma_m(self) -> float:
        """Standard deviation of an apex as read, about its mean."""
        return math.hypot(self.reading_m, self.spread_low_m)


def planned_heights_m() -> Array:
    """Heights of the paper's 26 drops, as evenly over its five as that allows: how many drops were
    made from which is not published. What is left over is taken from the middle height outward."""
    heights = np.array(paper.HEIGHTS_M)
    outward = np.argsort(np.abs(np.arange(len(heights)) - len(heights) // 2), kind="stable")
    return np.sort(heights[np.resize(outward, paper.N_DROPS)])


def summaries(y0_m: Array, y1_m: Array) -> Array:
    """What ``PRINTED`` holds, of drops (n,); R² about the mean of y1: about zero it
    would be above 0.9."""
    ratio, x = y1_m / y0_m, y0_m / y0_m.max()
    about = np.sum((y1_m - y1_m.mean()) ** 2)
    fits = [np.linalg.lstsq(x[:, None] ** np.arange(1, n), y1_m)[:2] for n in (2, 3)]
    r2 = [1.0 - float(left[0]) / about for _, left in fits]
    return np.array((ratio.mean(), ratio.std(ddof=1), fits[0][0][0] / y0_m.max(), *r2))


def draw(random: np.random.Generator) -> tuple[Array, Array]:
    """Heights before and after in m (n,), as read, in the order made: random, but with the
    published summaries and the published drop.

    Ratios are drawn from the beta distribution of the published mean and standard deviation, so
    that none rises higher than it fell, and moved by as little as does (least squares of their
    normal deviates) to summaries drawn within what their printed digits leave open. Raises
    ComputationError where no such set is found.
    """
    y0 = planned_heights_m()
    y0[-1], last = paper.KNOWN_DROP_M
    total = paper.RATIO_MEAN * (1.0 - paper.RATIO_MEAN) / paper.RATIO_STD**2 - 1.0
    shape = total * paper.RATIO_MEAN, total * (1.0 - paper.RATIO_MEAN)
    target = PRINTED + random.uniform(-0.49, 0.49, len(PRINTED)) * 10.0**-DECIMALS
    start = random.standard_normal(len(y0) - 1)

    def heights(deviates: Array) -> Array:
        return np.append(betaincinv(*shape, ndtr(deviates)) * y0[:-1], last)

    moved = minimize(
        lambda at: 0.5 * np.sum((at - start) ** 2),
        start,
        jac=lambda at: at - start,
        method="SLSQP",
        constraints={"type": "eq", "fun": lambda at: summaries(y0, heights(at)) - target},
        options={"maxiter": 500},
    )
    y1 = heights(moved.x)
    if not (np.abs(summaries(y0, y1) - PRINTED) <= 0.5 * 10.0**-DECIMALS).all():
        raise ComputationError(f"no drops with the published summaries: {moved.message}")
    order = random.permutation(len(y0))
    return y0[order], y1[order]


def dataset(title: str, y0_m: Array, y1_m: Array, *, damping: bool = False) -> Drops:
    """Drops (n,) as read, as a dataset of the paper's bristle, its β declared with ``damping``.

    Kn and friction are not declared. What an apex is seen too low by on the average is added to
    ``y1_m``; the declared uncertainty of all heights is that of an apex.
    """
    film = Film()
    manifest = Manifest(
        folder=Path(),
        title=title,
        kind="drops",
        source=f"drawn; summaries: {paper.CITATION}",
        licence="",
        body=Bristle(),
        declared=(*BODY, "damping_beta_s") if damping else BODY,
        kn_N_m=None,
        measurement={"sigma_y_mm": 1e3 * film.sigma_m, "fps": paper.FRAMES_PER_S},
    )
    return Drops(
        manifest=manifest,
        drop=1.0 + np.arange(len(y0_m)),
        y0_m=y0_m,
        y1_m=y1_m + film.mean_low_m,
        contact_time_s=None,
        peak_force_N=None,
        session=None,
        sigma_y_m=film.sigma_m,
    )
