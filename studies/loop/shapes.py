"""Shapes that residuals may have: over a covariate, in the order of groups, within a group.

Each is an array over the rows, for shifts of the residuals or for their scatter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations, pairwise

import numpy as np

from ...solver.arrays import Array
from .fit import Fitted
from .noise import Ints
from .sample import Sample, counted

DEGREES = 5
MOST_EDGES = 32
LEAST_BAND = 3
MOST_PERIOD = 9
SETTLINGS = 5
# Faster waves, of which many data could show more, are left to bands and to one in several.
MOST_WAVES = 48
# Rows of longer groups are a record in time: what they share shows in runs.
MOST_SHARED = 6
# Values of a covariate nearer than this share of its range are meant to be the same.
NEAR = 0.04
# A direction of which a refit absorbs more than this is not looked at.
ABSORBED = 0.97


def distinct(covariates: Mapping[str, Array]) -> dict[str, Array]:
    """Covariates that order the rows differently."""
    out: dict[str, Array] = {}
    ranks: list[Ints] = []
    for name, x in covariates.items():
        rank = np.argsort(np.argsort(x, kind="stable"))
        if np.ptp(x) > 0 and all(abs(np.corrcoef(rank, o)[0, 1]) < 0.98 for o in ranks):
            out[name] = x
            ranks.append(rank)
    return out


def patterns_of(data: Sample, fitted: Fitted) -> list[Array]:
    """Sizes that a shift may have at each row: alike at all, or in proportion to what is
    predicted where that has one sign."""
    alike = np.ones(data.values.size)
    mean = fitted.mean
    proportional = np.empty_like(mean)
    for kind in np.unique(data.kind):
        mine = data.kind == kind
        size = np.sqrt(np.mean(mean[mine] ** 2))
        if size <= 0 or np.min(mean[mine]) * np.max(mean[mine]) <= 0:
            return [alike]
        proportional[mine] = np.abs(mean[mine]) / size
    return [alike] if np.ptp(proportional) < 0.2 else [alike, proportional]


def unit_shapes(shapes: Array, free_of_refit: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Unit shapes (k, rows) freed of what a refit absorbs, and which of them are kept."""
    before = np.linalg.norm(shapes, axis=1)
    free = free_of_refit(shapes)
    size = np.linalg.norm(free, axis=1)
    independent = (size > np.sqrt(1 - ABSORBED**2) * before) & (before > 0)
    return free[independent] / size[independent, None], independent


def centred_shapes(shapes: Array) -> Array:
    """Unit shapes (k, rows) of mean zero, of those that are not constant."""
    centred = shapes - shapes.mean(axis=1, keepdims=True)
    size = np.linalg.norm(centred, axis=1, keepdims=True)
    return np.asarray(centred[size[:, 0] > 0] / size[size[:, 0] > 0])


def polynomials(x: Array, kind: Ints) -> tuple[Array, Array]:
    """Orthonormal polynomials of the covariate's levels, each quantity's own (shapes, rows), and
    their degrees (shapes,)."""
    shapes: list[Array] = []
    degrees: list[int] = []
    for each in np.unique(kind):
        mine = np.flatnonzero(kind == each)
        rank = levels(x[mine])
        most = min(DEGREES, int(rank.max(initial=0)), mine.size - 2)
        if most < 1 or mine.size < 4:
            continue
        t = rank / rank.max() * 2 - 1
        q, _ = np.linalg.qr(np.vander(t, most + 1, increasing=True))
        for degree in range(1, most + 1):
            shape = np.zeros(x.size)
            # toward the same side in every quantity, so that scatter adds up
            shape[mine] = q[:, degree] * np.sign(q[np.argmax(t), degree])
            shapes.append(shape)
            degrees.append(degree)
    return np.array(shapes).reshape(-1, x.size), np.array(degrees, dtype=np.int64)


def levels(x: Array) -> Ints:
    """Ranks (rows,) of values, those as good as repeated counted as one where all fall into such
    levels: ranks within a level would bend a function of the covariate where it is flat."""
    values, rank = np.unique(x, return_inverse=True)
    near = NEAR * (values[-1] - values[0])
    level = np.concatenate([[0], np.cumsum(np.diff(values) > near)])
    spans = [np.ptp(values[level == k]) for k in np.unique(level)]
    repeated = level[-1] >= 2 and max(spans) <= 2 * near
    return np.asarray(level[rank] if repeated else rank)


def bands_of(x: Array) -> Array:
    """Indicators (bands, rows) of all intervals of a covariate, thresholds among them."""
    rank = levels(x)
    count = int(rank.max()) + 1
    edges = np.unique(np.linspace(0, count, min(count, MOST_EDGES) + 1).astype(int))
    out = [
        ((rank >= low) & (rank < high)).astype(float)
        for i, low in enumerate(edges[:-1])
        for high in edges[i + 1 :]
        if high - low < count
    ]
    large = [band for band in out if LEAST_BAND <= band.sum() <= x.size - 1]
    return np.array(large).reshape(-1, x.size)


def residue_classes(order: Array) -> Array:
    """Indicators (classes, rows) of every k-th of the order."""
    place = counted(order)
    most = min(MOST_PERIOD, np.unique(place).size // 3)
    out = [(place % k == j).astype(float) for k in range(2, most + 1) for j in range(k)]
    return np.array([each for each in out if 0 < each.sum() < order.size]).reshape(-1, order.size)


def settlings_of(order: Array) -> Array:
    """Shapes (shapes, rows) of what differs at first and then settles, exponentially, sooner or
    later in the order."""
    place = counted(order).astype(float)
    count = np.unique(place).size
    scales = np.geomspace(LEAST_BAND, max(count / 2.0, LEAST_BAND), SETTLINGS)
    return np.exp(-place / np.unique(scales)[:, None])


def waves_of(x: Array) -> list[Array]:
    """Cosine and sine (2, rows) of each frequency, from half a wave in all to half a wave each, or
    to `MOST_WAVES` in all."""
    if np.ptp(x) <= 0.0:
        return []
    t = (x - x.min()) / np.ptp(x)
    most = min((int(levels(x).max()) + 1) // 2, MOST_WAVES)
    return [
        np.stack([np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)])
        for f in np.arange(0.5, most + 0.25, 0.5)
    ]


def shared_pairs(data: Sample) -> tuple[Ints, Ints]:
    """Pairs of rows of different quantities within a group."""
    pairs = [
        (i, j)
        for begin, end in pairwise(data.starts)
        if end - begin <= MOST_SHARED
        for i, j in combinations(range(begin, end), 2)
        if data.kind[i] != data.kind[j]
    ]
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return first, second
