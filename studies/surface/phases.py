"""Phases of a composite surface, laid out at random.

Grains are shrunken Voronoi cells: seeds are spread evenly (a few of Lloyd's steps) over what is
still matrix, and a place belongs to a grain where it is nearer to its own seed than to the next
one by more than a threshold, which is chosen so that the fraction comes out.  Coarse grains first,
then finer ones between them.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.spatial import cKDTree

from ...solver.arrays import Array

Positive = Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)]

CELLS_PER_GRAIN = 3
"""Fewest grid spacings across a grain."""
PERIOD_IN_GRAINS = 4.0
"""Grains are laid out on a tile at least this many of the largest one long."""
LLOYD_STEPS = 4
SAMPLES, SAMPLES_PER_GRAIN = 250_000, 30
"""Points on which seeds are evened out and thresholds found: at least so many."""


@dataclass(frozen=True)
class Phase:
    """One material of a composite surface.

    ``area_fraction`` is its part of the surface; ``grain_size_m`` the diameter of the circle that
    has a grain's mean area, None for the matrix. Raises ValueError where a value is out of its
    range.
    """

    name: Annotated[str, Field(pattern=r"\S")]
    youngs_Pa: Positive
    poisson: Annotated[float, Field(strict=True, gt=-1.0, le=0.5)]
    area_fraction: Annotated[float, Field(strict=True, gt=0.0, le=1.0)]
    grain_size_m: Positive | None = None


CONCRETE = (
    Phase("cement", youngs_Pa=12e9, poisson=0.2, area_fraction=0.30),
    Phase("fine aggregate", youngs_Pa=80e9, poisson=0.2, area_fraction=0.28, grain_size_m=0.6e-3),
    Phase("coarse aggregate", youngs_Pa=69e9, poisson=0.2, area_fraction=0.42, grain_size_m=9.5e-3),
)
"""Concrete whose aggregate is laid bare by wear.

Young's moduli: Vanegas-Useche, Abdel-Wahab and Parker, CMC 56(1), 2018, what a better model needs.
The rest is assumed.  Fractions: 70 % aggregate, two fifths of it fine, inside the 60 to 75 % by
volume of ordinary mixes (Kosmatka and Wilson, Design and Control of Concrete Mixtures, Portland
Cement Association); on a plane section area fractions are volume fractions (Delesse).  Grain
sizes: sieves in the middle of fine (below 4.75 mm) and coarse aggregate (ASTM C33).  Poisson's
ratios: a common value for all three.
"""


@dataclass(frozen=True)
class Composite:
    """The phases of a surface, one matrix and any number of aggregates, in the order of their
    numbers on it; concrete by default.

    Raises ValueError where there is not one matrix, a name is there twice, or the fractions do not
    sum to 1.
    """

    phases: Annotated[tuple[Phase, ...], Field(max_length=255)] = CONCRETE

    def __post_init__(self) -> None:
        if [phase.grain_size_m for phase in self.phases].count(None) != 1:
            raise ValueError("a composite has exactly one matrix, a phase without grain_size_m.")
        names = [phase.name for phase in self.phases]
        if len(set(names)) < len(names):
            raise ValueError(f"phases must have different names, not {', '.join(names)}.")
        total = math.fsum(phase.area_fraction for phase in self.phases)
        if not math.isclose(total, 1.0, abs_tol=1e-6):
            raise ValueError(f"the area fractions must sum to 1, not {total:g}.")

    def contact_moduli_Pa(self, bristle_youngs_Pa: float, bristle_poisson: float) -> Array:
        """Plane-strain contact modulus E* of each phase with a bristle, Pa, shape (phases,).

        1/E* = (1 - ν1²)/E1 + (1 - ν2²)/E2: Johnson, Contact Mechanics, 1985, section 4.2.
        """
        surface = np.array([(1 - phase.poisson**2) / phase.youngs_Pa for phase in self.phases])
        return 1 / (surface + (1 - bristle_poisson**2) / bristle_youngs_Pa)

    @property
    def matrix(self) -> int:
        """Number of the phase between the grains."""
        return [phase.grain_size_m for phase in self.phases].index(None)

    @property
    def aggregates(self) -> list[tuple[int, float, float]]:
        """Number, grain size (m) and area fraction of each aggregate, the coarsest first."""
        found = [
            (number, phase.grain_size_m, phase.area_fraction)
            for number, phase in enumerate(self.phases)
            if phase.grain_size_m is not None
        ]
        return sorted(found, key=lambda aggregate: -aggregate[1])


def random_phases(
    composite: Composite, shape: tuple[int, ...], spacing_m: float, rng: np.random.Generator
) -> npt.NDArray[np.uint8]:
    """Lay out the grains and return the phase number at every node, shape (ny, nx).

    A tile that is at least `PERIOD_IN_GRAINS` of the coarsest grains long has the composite's
    fractions, to about 0.003, and grains that go on across its edges.  A shorter one is a window
    on such a tile: its fractions are random, right only on the average over many.

    Raises
    ------
    ValueError : the grid is too coarse for the finest grains
    """
    for number, grain, _ in reversed(composite.aggregates):
        if spacing_m * CELLS_PER_GRAIN > grain * (1 + 1e-9):
            raise ValueError(
                f"spacing_m {spacing_m:g} is too coarse for the {composite.phases[number].name}: "
                f"grains of {grain:g} m need {grain / CELLS_PER_GRAIN:.4g} m or less."
            )
    phase = np.full(shape[0] * shape[1], composite.matrix, dtype=np.uint8)
    if not composite.aggregates:
        return phase.reshape(shape)
    coarsest = composite.aggregates[0][1]
    period = np.maximum(np.array(shape[::-1]) * spacing_m, PERIOD_IN_GRAINS * coarsest)
    y, x = np.divmod(np.arange(len(phase)), shape[1])
    nodes = np.column_stack([x, y]) * spacing_m
    samples = _even_points(period, composite)
    remaining = 1.0
    is_matrix = np.ones(len(nodes), dtype=bool)
    for number, grain, fraction in composite.aggregates:
        count = max(1, round(fraction * period.prod() / (math.pi / 4 * grain**2)))
        cells = _Cells(_spread_seeds(samples, count, period, rng), period)
        depth = cells.depth(samples)
        threshold = np.quantile(depth, 1 - min(1.0, fraction / remaining))
        samples = samples[depth <= threshold]
        remaining -= fraction
        taken = np.flatnonzero(is_matrix)
        taken = taken[cells.depth(nodes[taken]) > threshold]
        phase[taken] = number
        is_matrix[taken] = False
    return phase.reshape(shape)


class _Cells:
    """Voronoi cells of seeds on a torus."""

    def __init__(self, seeds: Array, period: Array) -> None:
        images = [seeds + period * (i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        self._tree = cKDTree(np.concatenate(images))

    def depth(self, points: Array) -> Array:
        """How much nearer each point is to its own seed than to the next, m; 0 on an edge."""
        nearest, _ = self._tree.query(points, k=2)
        return nearest[:, 1] - nearest[:, 0]


def _even_points(period: Array, composite: Composite) -> Array:
    """A square grid of points that fills the tile."""
    grains = sum(
        fraction * period.prod() / (math.pi / 4 * grain**2)
        for _, grain, fraction in composite.aggregates
    )
    step = math.sqrt(period.prod() / max(SAMPLES, SAMPLES_PER_GRAIN * grains))
    axes = [(np.arange(n := math.ceil(length / step)) + 0.5) / n * length for length in period]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _spread_seeds(points: Array, count: int, period: Array, rng: np.random.Generator) -> Array:
    """Choose `count` of the points and move each to the middle of those nearest to it."""
    seeds = points[rng.choice(len(points), count, replace=False)]
    for _ in range(LLOYD_STEPS):
        _, owner = cKDTree(seeds, boxsize=period).query(points)
        away = points - seeds[owner]
        away -= period * np.round(away / period)
        n_owned = np.maximum(np.bincount(owner, minlength=count), 1)
        for axis in (0, 1):
            seeds[:, axis] += np.bincount(owner, away[:, axis], count) / n_owned
        seeds = np.mod(seeds, period)
        seeds[seeds >= period * (1 - 1e-15)] = 0.0  # a box is half open, a rounded mod is not
    return seeds
