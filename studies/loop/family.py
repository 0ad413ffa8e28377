"""By which numbers are residuals looked at, whatever made them?

One family, declared here and nowhere else: their size (omnibus), each quantity's level, and against
every covariate trend, curvature, smooth shape (Neyman's smooth test with weights falling as a
Gaussian process' do) and trend of their scatter; scatter of one quantity; runs and alternation in
order; correlation within a group.
Residuals are Winsorised by the influence of the noise that they have, so that no outlier decides.
Large is suspicious.

Sources: Rayner, Thas and Best, Smooth Tests of Goodness of Fit (2009); Hart, Nonparametric
Smoothing and Lack-of-Fit Tests (1997), §5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...solver.bristle import Array
from .noise import Ints
from .sample import Sample

DEGREES = 5
# Values of a covariate nearer than this share of its range are meant to be the same.
NEAR = 0.04
# Longer groups are records in time, whose runs show what their rows share.
MOST_SHARED = 6


@dataclass(frozen=True)
class Family:
    """The statistics' ``names`` and what they need: per covariate orthonormal ``shapes``
    (shapes, rows) with their ``degree``, and each quantity's ``levels`` (quantities, rows)."""

    names: tuple[str, ...]
    bases: tuple[tuple[Array, Array], ...]
    levels: Array
    previous: Ints
    pairs: tuple[Ints, Ints]

    def __call__(self, u: Array) -> Array:
        """Statistics (sets, names) of standardised residuals (sets, rows)."""
        square = u**2 - np.mean(u**2, axis=1, keepdims=True)
        columns = [np.sum(u**2, axis=1), np.sum((u @ self.levels.T) ** 2, axis=1)]
        columns.append(
            np.max(u**2 @ (self.levels.T != 0) / np.sum(self.levels != 0, axis=1), axis=1)
        )
        for shapes, degree in self.bases:
            loads = (u @ shapes.T) ** 2
            columns.append(loads[:, degree == 1].sum(axis=1))
            if degree.max() > 1:
                columns.append(loads[:, degree == 2].sum(axis=1))
                columns.append((loads / degree**2).sum(axis=1))
            columns.append(np.abs(square @ shapes[degree == 1].sum(axis=0)))
        linked = np.flatnonzero(self.previous >= 0)
        if linked.size:
            runs = np.sum(u[:, linked] * u[:, self.previous[linked]], axis=1)
            columns += [runs, -runs]
        if self.pairs[0].size:
            columns.append(np.abs(np.sum(u[:, self.pairs[0]] * u[:, self.pairs[1]], axis=1)))
        return np.stack(columns, axis=1)


def family(data: Sample) -> Family:
    """The family for these rows; covariates that order the rows alike count once."""
    names = ["omnibus", "level", "scatter of a quantity"]
    bases: list[tuple[Array, Array]] = []
    seen: list[Array] = []
    for name, x in data.covariates.items():
        shapes, degree = _basis(x, data.kind)
        if degree.size == 0:
            continue
        first = shapes[degree == 1].sum(axis=0)
        if any(abs(first @ s) > 0.98 * np.sqrt((first @ first) * (s @ s)) for s in seen):
            continue
        seen.append(first)
        bases.append((shapes, degree))
        names.append(f"trend with {name}")
        if degree.max() > 1:
            names += [f"curvature with {name}", f"smooth in {name}"]
        names.append(f"scatter with {name}")
    previous = data.noises.previous
    if np.any(previous >= 0):
        names += ["runs", "alternation"]
    first_, second = [], []
    for begin, end in zip(data.starts[:-1], data.starts[1:], strict=True):
        if end - begin > MOST_SHARED:
            continue
        for i in range(int(begin), int(end)):
            for j in range(i + 1, int(end)):
                if data.kind[i] != data.kind[j]:
                    first_.append(i)
                    second.append(j)
    if first_:
        names.append("shared within a group")
    kinds = np.unique(data.kind)
    pairs = (np.array(first_, dtype=np.int64), np.array(second, dtype=np.int64))
    levels = np.stack([(data.kind == k) / np.sqrt(np.sum(data.kind == k)) for k in kinds])
    return Family(tuple(names), tuple(bases), levels, previous, pairs)


def _basis(x: Array, kind: Ints) -> tuple[Array, Array]:
    """Orthonormal polynomials of the covariate's levels, each quantity's own (shapes, rows)."""
    shapes: list[Array] = []
    degrees: list[int] = []
    for each in np.unique(kind):
        mine = np.flatnonzero(kind == each)
        rank = _levels(x[mine])
        most = min(DEGREES, int(rank.max(initial=0)))
        if most < 1 or mine.size < 4:
            continue
        t = rank / rank.max() * 2 - 1
        q, _ = np.linalg.qr(np.vander(t, most + 1, increasing=True))
        for degree in range(1, most + 1):
            shape = np.zeros(x.size)
            # Toward the same side in every quantity, so that scatter adds up.
            shape[mine] = q[:, degree] * np.sign(q[np.argmax(t), degree])
            shapes.append(shape)
            degrees.append(degree)
    return np.array(shapes).reshape(-1, x.size), np.array(degrees, dtype=np.int64)


def _levels(x: Array) -> Ints:
    """Ranks (rows,) of values, those as good as repeated counted as one where all fall into such
    levels: ranks within a level would bend a function of the covariate where it is flat."""
    values, rank = np.unique(x, return_inverse=True)
    near = NEAR * (values[-1] - values[0])
    level = np.concatenate([[0], np.cumsum(np.diff(values) > near)])
    spans = [np.ptp(values[level == k]) for k in np.unique(level)]
    repeated = level[-1] >= 2 and max(spans) <= 2 * near
    return np.asarray(level[rank] if repeated else rank)


def p_values(observed: Array, simulated: Array) -> tuple[Array, Array]:
    """Single p-values of observed (statistics,) and simulated (sets, statistics) values.

    Ranks up to the 90th percentile; beyond it an exponential tail with the mean excess, which is
    what squares of normal numbers have and what gives p-values below one over the number of sets.
    """
    count = simulated.shape[0]
    both = np.concatenate([observed[None], simulated])
    ordered = np.sort(simulated, axis=0)
    edge = ordered[int(0.9 * count)]
    out = np.empty_like(both)
    for k in range(both.shape[1]):
        above = count - np.searchsorted(ordered[:, k], both[:, k], side="left")
        out[:, k] = (above + 1.0) / (count + 1.0)
        beyond = ordered[ordered[:, k] > edge[k], k] - edge[k]
        if beyond.size >= 5:
            tail = both[:, k] > edge[k]
            start = beyond.size / count
            out[tail, k] = start * np.exp(-(both[tail, k] - edge[k]) / beyond.mean())
    return out[0], out[1:]


def corrected(observed: Array, simulated: Array) -> tuple[float, Array]:
    """The smallest p-value corrected for all tests made, and the smallest of every set.

    Westfall and Young, Resampling-Based Multiple Testing (1993), §2.5: the same sets that give
    the single p-values give the distribution of the smallest.
    """
    least = simulated.min(axis=1)
    below = int(np.sum(least <= observed.min()))
    return (below + 1.0) / (least.size + 1.0), least
