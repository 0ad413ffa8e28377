"""Shapes that residuals may have: over a covariate, in the order of groups, within a group.

Each is an array over the rows, for shifts of the residuals or for their scatter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise

import numpy as np

from ...solver.arrays import Array
from .fit import BOX_PRECISION, Fitted
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


@dataclass(frozen=True)
class Refit:
    """What a refit along ``tangent`` (rows, p) leaves of residuals. The width of the unit box is
    its prior: a direction that the data do not see absorbs nothing."""

    tangent: Array

    @cached_property
    def follow(self) -> Array:
        """What residuals make of each parameter (p, rows)."""
        tangent = self.tangent
        normal = tangent.T @ tangent + BOX_PRECISION * np.eye(tangent.shape[1])
        return np.linalg.solve(normal, tangent.T)

    def __call__(self, residual: Array) -> Array:
        """Of residuals (..., rows)."""
        return np.asarray(residual - (residual @ self.tangent) @ self.follow)


@dataclass(frozen=True)
class Shapes:
    """Shapes (k, rows): each sum of ``parts`` (c, rows) that ``mix`` (b, c) names, or each part,
    times each of the ``sizes`` (e, rows) that it may have, which are zero at most rows.

    What is summed over the rows is summed once for all shapes that share it: intervals of a
    covariate are many, and their parts few.
    """

    parts: Array
    sizes: Array
    mix: Array | None = None

    def loads(self, z: Array, power: int = 1) -> Array:
        """Sums over the rows (n, k) of ``z`` (n, rows) times each shape to that power, 1 or 2: of
        what is mixed, parts are zero or one, and of a shape no two overlap."""
        found = []
        for size in self.sizes:
            there = slice(None) if size.all() else np.flatnonzero(size)
            own = z[:, there] @ ((self.parts[:, there] * size[there]) ** power).T
            found.append(own if self.mix is None else own @ self.mix.T)
        return np.concatenate(found, axis=1)

    def __getitem__(self, which: Ints) -> Array:
        """The shapes (n, rows) of these numbers."""
        size, shape = np.divmod(which, len(self.parts if self.mix is None else self.mix))
        own = self.parts[shape] if self.mix is None else self.mix[shape] @ self.parts
        return np.asarray(own * self.sizes[size])


@dataclass(frozen=True)
class UnitShapes:
    """Unit shapes (k, rows) freed of what a refit absorbs, of those of ``shapes`` that it leaves:
    ``which`` (k,) numbers them, ``norm`` (k,) is what is left of each."""

    shapes: Shapes
    refit: Refit
    absorbed: Array
    which: Ints
    norm: Array

    @classmethod
    def of(cls, shapes: Shapes, refit: Refit) -> UnitShapes:
        """Those that ``refit`` leaves."""
        moved = shapes.loads(refit.tangent.T).T
        whole = shapes.loads(np.ones((1, shapes.sizes.shape[1])), power=2)[0]
        follow = refit.follow
        lost = np.sum(moved * (2.0 * shapes.loads(follow).T - moved @ (follow @ follow.T)), axis=1)
        which = np.flatnonzero((whole - lost > (1 - ABSORBED**2) * whole) & (whole > 0.0))
        return cls(shapes, refit, moved[which], which, np.sqrt((whole - lost)[which]))

    def __len__(self) -> int:
        return len(self.which)

    def loads(self, z: Array) -> Array:
        """Products (n, k) of ``z`` (n, rows) with the unit shapes."""
        found = self.shapes.loads(z)[:, self.which] - (z @ self.refit.follow.T) @ self.absorbed.T
        return np.asarray(found / self.norm)

    def __getitem__(self, which: Ints) -> Array:
        """The unit shapes (n, rows) of these numbers among the k."""
        left = self.refit(self.shapes[self.which[which]])
        return np.asarray(left / self.norm[which, None])


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


def bands_of(x: Array) -> tuple[Array, Array]:
    """Indicators (cells, rows) of neighbouring intervals of a covariate, and which of them make up
    each (bands, cells) of all intervals, thresholds among them."""
    rank = levels(x)
    count = int(rank.max()) + 1
    edges = np.unique(np.linspace(0, count, min(count, MOST_EDGES) + 1).astype(int))
    cell = np.searchsorted(edges, rank, side="right") - 1
    number = np.arange(edges.size - 1)
    low, high = np.triu_indices(number.size)
    bands = ((number >= low[:, None]) & (number <= high[:, None])).astype(float)
    rows = bands @ np.bincount(cell, minlength=number.size)
    large = (rows >= LEAST_BAND) & (rows <= x.size - 1)
    return (cell == number[:, None]).astype(float), bands[large]


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


def waves_of(x: Array) -> Array:
    """Cosine and sine (2 waves, rows) of each frequency in turn, from half a wave in all to half a
    wave each, or to `MOST_WAVES` in all."""
    if np.ptp(x) <= 0.0:
        return np.zeros((0, x.size))
    t = (x - x.min()) / np.ptp(x)
    most = min((int(levels(x).max()) + 1) // 2, MOST_WAVES)
    turns = 2 * np.pi * np.arange(0.5, most + 0.25, 0.5)[:, None] * t
    return np.stack([np.cos(turns), np.sin(turns)], axis=1).reshape(-1, x.size)


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
