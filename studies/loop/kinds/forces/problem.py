"""Records of impact force as a problem for the loop.

Dataset kind ``forces``: force over time of each drop, on a clock that some trigger started, and the
height of each drop in ``drops.csv`` beside it. A record is brought to the amounts of a few shapes
that simulated histories have (`force_curves`), free of the trigger's time (`force_rows`); that is
impulse, peak, duration, asymmetry and all else in them that noise leaves to be seen. The error of
the height goes into all rows of its drop, since force grows with the speed of impact. Where
``drops.csv`` has the height after the impact, it is a row more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.fall import risen
from ....data.datasets import Manifest
from ...problem import Problem, undeclared
from ...responses.drop_model import BounceModel, Drops
from ...responses.emulator import KN_RANGE_N_M
from ...responses.force_curves import CELLS, SHAPES, ForceEmulator, table_errors, with_shapes
from ..drops.problem import carried, stiffness
from .record import KIND, Forces, read_forces
from .rows import Placed, Record, Rows, place, rows

SIGMA_N = 1.0
"""Uncertainty taken for a force where none is declared and no sample shows it."""
MOST_TRIED = 2000
TRUSTED = 3.0
"""A shape is used where the tables' error of it is at most this many of the errors that the records
of all drops together leave it with; the first few always are."""
LEAST_SHAPES = 4
REBOUND = "y1 (mm)"


@dataclass(frozen=True)
class ForceModel(BounceModel):
    """A `Model` of the rows of records, which are sums of a drop's features.

    Features are the amounts of the shapes in N, and the height after the impact in m where there is
    a ``rebound`` to predict it. ``sums`` (rows, features) are the sums, ``group`` (rows,) says
    which drop a row is of.
    """

    sums: Array
    group: NDArray[np.int64]
    rebound: BounceModel | None

    @property
    def refinement(self) -> None:
        """Tables of whole histories have no room for more parameters."""
        return None

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p)."""
        every = self.features(theta)[..., self.group, :]
        return np.asarray(np.einsum("...rf,rf->...r", every, self.sums))

    def features(self, theta: Array) -> Array:
        """Amounts of shapes in N and the height after in m (..., nodes, drops, features)."""
        landing, amounts = self.answer(theta)
        found: list[Array] = list(self.emulator.speed_m_s(landing.same_m) * amounts)
        if self.rebound is not None:
            after, (top, *_) = self.rebound.bounced(theta)
            found.append(after.scale * (risen(top, after.drag_1_m) + after.offset_m))
        full = (*np.shape(theta)[:-1], len(self.weights), len(self.drops))
        return np.stack([np.broadcast_to(each, full) for each in found], axis=-1)

    def having(self, effects: tuple[str, ...]) -> ForceModel:
        """The same with effects in it."""
        rebound = self.rebound and replace(self.rebound, effects=effects)
        return replace(self, effects=effects, rebound=rebound)


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    return forces_problem(read_forces(folder))


def forces_problem(data: Forces, library: Sequence[str] | None = None) -> Problem:
    """The problem of a dataset of forces; ``library`` names the candidates, None means all.

    ``combine`` takes the candidates alone. Raises InputError where it cannot be a problem.
    """
    records, sigma = _records(data)
    names = carried(KIND, (0, 1)) if library is None else list(library)
    wide = _emulator(data, KN_RANGE_N_M)
    kn = data.manifest.kn_N_m or _start(records, wide)
    near = _emulator(data, wide.around(kn))
    emulator = with_shapes(near, names)
    shapes = emulator.known_shapes
    tried, plain_ones = _tried(emulator, names)
    speed = emulator.speed_m_s(data.y0_m)
    usual = np.sqrt(np.mean((tried @ shapes.T / CELLS) ** 2, axis=0))
    samples = float(np.median([emulator.length_s / np.median(np.diff(r.t_s)) for r in records]))
    errors = np.median(speed) * table_errors(emulator, names, kn)
    trusted = errors * math.sqrt(samples * len(records)) < TRUSTED * sigma
    trusted[:LEAST_SHAPES] = True
    placed = [place(record, tried, emulator.cell_s, plain_ones) for record in records]
    made = [
        rows(record, at, tried[at.which], shapes, emulator.cell_s, v * usual, trusted)
        for record, at, v in zip(records, placed, speed, strict=True)
    ]
    order = data.drop - data.drop[0]
    drops = Drops(emulator, data.y0_m, order, ())
    stiff = stiffness(data.manifest.kn_N_m, emulator)
    rebound = None
    if data.y1_m is not None and data.sigma_y_m is not None:
        own = emulator.of_drops()
        rebound = BounceModel(Drops(own, data.y0_m, order, (0,)), stiff, ())
    y1 = data.y1_m if rebound is not None else None
    # what tables miss is common to all drops
    missed = len(records) * np.append(errors, [0.0] * (y1 is not None)) ** 2
    values, weights, known = _together(made, data.y0_m, y1, data.sigma_y_m, missed)
    leading = [
        np.append(each.leading, SHAPES)[: len(v)] for each, v in zip(made, values, strict=True)
    ]
    group = np.repeat(np.arange(len(made)), [len(each) for each in values])
    kinds = np.concatenate(leading)
    titles = np.array([*(f"shape {k + 1} of the force (N)" for k in range(SHAPES)), REBOUND])
    plain = ForceModel(drops, stiff, (), np.concatenate(weights), group, rebound)
    return Problem(
        records=True,
        values=np.concatenate(values),
        scale=np.where(kinds == SHAPES, 1e3, 1.0) / np.concatenate(known),
        unit="N",
        quantity=titles[kinds],
        group=data.drop[group],
        covariates={"height": data.y0_m[group], "order": order[group].astype(float)},
        baseline=plain,
        candidates=[plain.having((name,)) for name in names],
        combine=lambda effects: plain.having(tuple(effects)),
        confirm_why="records are compared with the beam's tables; the solid follows its drops",
        sigma_declared=data.sigma_N is not None,
        warnings=(
            *_taken_as_known(data.manifest),
            *undeclared("sigma_force_N", data.sigma_N),
        ),
        notes={
            "sigma_force_N": sigma,
            "shapes": int(trusted.sum()),
            "touch_s": [at.touch_s for at in placed],
            "left": float(sum(each.left for each in made)),
            "freedom": int(sum(each.freedom for each in made)),
        },
    )


def _taken_as_known(manifest: Manifest) -> tuple[str, ...]:
    """What histories are simulated with although nobody declared it."""
    out = []
    if manifest.friction is None:
        out.append("friction is not declared and taken as 0.5 where the bristle leans")
    if not manifest.damping_declared:
        out.append("the body's damping is not declared and taken as the paper's, 1.07e-5 s")
    return tuple(out)


def _together(
    made: list[Rows], y0_m: Array, y1_m: Array | None, sigma_y_m: float | None, missed: Array
) -> tuple[list[Array], list[Array], list[Array]]:
    """Values, weights and how well each row is known, with the error of y0 in all of a drop, and
    the variance (features,) of what tables have ``missed``."""
    values: list[Array] = []
    weights: list[Array] = []
    known: list[Array] = []
    for i, each in enumerate(made):
        sizes, own, value = each.known, each.weights, each.values
        # force grows with the root of the height, the rebound with the height
        moved: Array = 0.5 * value / y0_m[i]
        if y1_m is not None and sigma_y_m is not None:
            own = np.pad(own, ((0, 1), (0, 1)))
            own[-1, -1] = 1.0 / sigma_y_m
            value = np.append(value, y1_m[i] / sigma_y_m)
            moved = np.append(moved, value[-1] / y0_m[i])
            sizes = np.append(sizes, 1.0 / sigma_y_m)
        moved = moved * (sigma_y_m or 0.0)
        covariance = np.eye(len(value)) + np.outer(moved, moved) + (own * missed) @ own.T
        factor = np.linalg.cholesky(covariance)
        values.append(np.linalg.solve(factor, value))
        weights.append(np.linalg.solve(factor, own))
        known.append(sizes / np.diag(factor))
    return values, weights, known


def _records(data: Forces) -> tuple[list[Record], float]:
    """The records, and the deviation of a sample: declared, or that before the force rises."""
    sigma = data.sigma_N
    if sigma is None:
        quiet = []
        for piece in data.pieces:
            force = data.value[piece]
            first = int(np.argmax(force > 0.2 * force.max()))
            quiet.append(force[: max(first // 2, 0)])
        before = np.concatenate(quiet)
        sigma = float(before.std()) if len(before) > 30 and before.std() > 0.0 else SIGMA_N
    return [Record(data.t_s[p], data.value[p], float(sigma)) for p in data.pieces], float(sigma)


def _emulator(data: Forces, kn_range_N_m: tuple[float, float]) -> ForceEmulator:
    """Over heights with some room, and a time in which the softest contact ends."""
    manifest = data.manifest
    lowest, highest = 0.6 * float(data.y0_m.min()), 1.25 * float(data.y0_m.max())
    softest = math.pi * math.sqrt(manifest.bristle.mass_kg / kn_range_N_m[0])
    material = manifest.bristle.material
    passes = manifest.bristle.length_m / math.sqrt(material.youngs_Pa / material.density_kg_m3)
    length = float(f"{1.4 * softest + 3.0 * passes:.2g}")
    return ForceEmulator(
        manifest.bristle,
        manifest.gravity_m_s2,
        lowest,
        highest,
        kn_range_N_m,
        friction=manifest.friction,
        length_s=length,
    )


def _start(records: list[Record], wide: ForceEmulator) -> float:
    """The stiffness of the baseline that the middle of the drops asks for."""
    heights, stiffnesses = wide.plain.axes
    kns = np.tile(stiffnesses.nodes(), heights.n)
    curves = wide.plain.coefficients.reshape(-1, CELLS)
    best: list[Placed] = [
        place(record, curves, wide.cell_s, len(curves)) for record in records[::3]
    ]
    return float(np.exp(np.median([np.log(kns[each.which]) for each in best])))


def _tried(emulator: ForceEmulator, names: list[str]) -> tuple[Array, int]:
    """Histories (histories, cells) that a record is laid over: some of every table.

    How many of them, the first ones, have no effect in them.
    """
    amounts, rng = [], np.random.default_rng(0)
    for table in (emulator.plain, *(emulator.of(n)[0] for n in emulator.of_impacts(names))):
        # over speed, heights give much the same history; others differ too much from node to node
        finer = [replace(axis, n=2 * axis.n - 1) for axis in table.axes]
        nodes = [axis.nodes()[-1:] if i == 0 else axis.nodes() for i, axis in enumerate(finer)]
        places = np.meshgrid(*nodes, indexing="ij")
        found = table.at(*places).reshape(SHAPES, -1).T
        amounts.append(rng.permutation(found)[:MOST_TRIED])
    return np.asarray(np.concatenate(amounts) @ emulator.known_shapes), len(amounts[0])
