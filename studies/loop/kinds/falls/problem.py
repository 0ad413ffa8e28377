"""Falls of an accelerometer through air as a `Problem` of the loop.

Dataset kind ``falls``: proper acceleration of something that falls freely, its own accelerometer's
reading. Gravity is not seen. In a vacuum the reading is the sensor's bias and nothing else, and
that is the baseline; drag is what it reads beyond (`falls_motion`). Falls may be from one height or
from many, and end before the impact or at it: when each body was let go is told by its own mean
reading (`falls_rows`), and what is predicted is the course within the fall. A fall is a group.

Not identifiable, and so no candidates: a speed at release and a height, which are another instant
of release; a delay of the sensor's filter, the same; buoyancy, added mass, and dry friction of a
guide, which are a bias; gain and clock, which are nearly another drag. Slower changes, such as of a
drag that turns with the falling body, are not in it, on purpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from .....solver.arrays import Array
from .....solver.effects.base import Parameter
from ...problem import Problem, carried
from .motion import predicted
from .record import Falls, read_falls
from .rows import Bins, in_bins

NODES = np.linspace(-3.0, 3.0, 41)
LIBRARY = ("air_drag", "linear_drag", "drag_scatter")
BASELINE = (
    Parameter(
        "bias_m_s2", "m/s²", -2.0, 2.0, 0.0, why="a sensor's, and dry friction of a guide with it"
    ),
)
EFFECT_PARAMETERS: dict[str, tuple[Parameter, ...]] = {
    "air_drag": (
        Parameter("k_1_m", "1/m", 0.0, 5.0, 0.05, why="½ρ c A/m: a steel ball 1e-3, a sheet 5"),
    ),
    "linear_drag": (
        Parameter("c_1_s", "1/s", 0.0, 5.0, 0.2, why="friction of a guide over mass; Stokes"),
    ),
    "drag_scatter": (
        Parameter("scatter", "", 0.0, 0.5, 0.15, why="a flat body falls broadside or edge on"),
    ),
}
"""By effect. ``air_drag`` alone is among the names that drops have as well."""


@dataclass(frozen=True)
class FallModel:
    """The reading, with effects in it; a `Model`.

    With ``drag_scatter`` the logarithm of the drag is normal from fall to fall, with that
    deviation. Its nodes are evenly spaced, ``closer`` times as close as `NODES`: a fall's own rows
    tell its drag to a few per cent, and Gauss's few nodes would leave gaps between them. Readings
    between `NODES` are interpolated. Without ``drag_scatter`` there is one node.
    """

    bins: Bins
    effects: tuple[str, ...] = ()
    closer: int = 1

    def finer(self, by: int) -> FallModel:
        """The model with nodes that lie ``by`` times as close."""
        return replace(self, closer=by)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        chosen = (p for name in self.effects for p in EFFECT_PARAMETERS[name])
        return BASELINE + tuple(chosen)

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        if "drag_scatter" not in self.effects:
            return np.zeros(1), np.ones(1)
        nodes = np.linspace(NODES[0], NODES[-1], (NODES.size - 1) * self.closer + 1)
        weights = np.exp(-0.5 * nodes**2)
        return nodes, weights / weights.sum()

    @cached_property
    def _between(self) -> Array:
        """What readings at `NODES` make of those at all nodes (nodes, `NODES`), by splines."""
        return np.asarray(CubicSpline(NODES, np.eye(NODES.size))(self._nodes[0]))

    @property
    def weights(self) -> Array:
        return self._nodes[1]

    def readings(self, theta: Array) -> Array:
        """Mean readings (..., nodes, bins) in m/s² for parameters (..., p)."""
        theta = np.asarray(theta, dtype=float)
        at = {each.name: theta[..., i, None] for i, each in enumerate(self.parameters)}
        nodes = NODES if "drag_scatter" in self.effects else np.zeros(1)
        factor = np.exp(at.get("scatter", 0.0) * nodes)
        each = at["bias_m_s2"], at.get("k_1_m", 0.0) * factor, at.get("c_1_s", 0.0) * factor
        shape = (*theta.shape[:-1], len(nodes))
        bias, k, c = (np.broadcast_to(some, shape).ravel() for some in each)
        bins = self.bins
        out = np.empty((k.size, len(bins.begin_s)))
        predicted(
            bias,
            k,
            c,
            bins.data.manifest.gravity_m_s2,
            bins.begin_s,
            bins.end_s,
            bins.level_m_s2,
            bins.begins,
            out,
        )
        readings = out.reshape(*shape, -1)
        return self._between @ readings if self.closer > 1 else readings

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p)."""
        return self.bins.rows(self.readings(theta))


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    return fall_problem(read_falls(folder))


def fall_problem(data: Falls) -> Problem:
    """The falls as a `Problem`, with the candidates of `LIBRARY`.

    ``drag_scatter``, a drag that differs from fall to fall, shows with another drag only. The
    baseline's bias shows with a drag only.
    """
    bins = in_bins(data)

    def combine(effects: Sequence[str]) -> FallModel:
        return FallModel(bins, carried("falls", effects, EFFECT_PARAMETERS))

    falls, place = len(data.numbers), bins.bin_of_row
    index = np.searchsorted(bins.begins, place, side="right") - 1
    covariates = {"time": bins.middle_s[place], "order": data.numbers[index].astype(float)}
    if data.height_m is not None:
        covariates["height"] = data.height_m[index]
    return Problem(
        records=True,
        values=bins.rows(bins.mean_m_s2),
        scale=bins.sigma_m_s2[place],
        unit="m/s²",
        quantity=np.full(len(place), "reading"),
        group=data.numbers[index],
        covariates=covariates,
        baseline=combine(()),
        candidates=[combine((name,)) for name in LIBRARY],
        combine=combine,
        confirm_why="nothing of a bristle is in these data: a body falls and does not touch",
        notes={
            "samples_per_value": len(data.fall) / len(bins.begin_s),
            "sigma_m_s2": bins.noise.sigma_m_s2,
            "sigma_grows_by": float(np.exp(bins.noise.growth)),
            "correlation_of_neighbours": bins.noise.correlation,
            "release": f"told by the mean reading of each fall: {falls} of "
            f"{len(bins.begin_s)} values are spent on it, and none is predicted by itself",
            "not_identifiable": "release velocity, height and delay of the sensor are another "
            "release; dry friction is a bias; gain and clock are nearly another drag",
        },
        warnings=data.warnings,
        left_aside=data.left_aside,
    )
