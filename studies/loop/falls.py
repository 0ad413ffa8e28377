"""What does an accelerometer read that falls through air?

Dataset kind ``falls``: proper acceleration of something that falls freely, its own accelerometer's
reading. Gravity is not seen. In a vacuum the reading is the sensor's bias and nothing else, and
that is the baseline; drag is what it reads beyond: a = k v², dv/dt = g − k v², released at rest,

    v(t) = √(g/k) tanh(√(g k) t)                (tan in place of tanh on the way up, t < 0)

(L. D. Landau and E. M. Lifshitz, Mechanics, or any text on falls with quadratic drag).

A record's time zero need not be the release. Records that are cut when motion is well under way
read more at their first sample and are shorter by as much. So the falls are taken to be from one
height and to be recorded to the end: record i begins ``fall_time_s`` − T_i after the release, T_i
its duration and the fall's time a free parameter of the baseline. Without this one number each
fall needs a start of its own.

A value is the mean reading over `BIN_S`, in closed form since k v² = g − dv/dt: its mean is
g − Δv/Δt. The noise is measured: what third differences of neighbouring values leave of them, at
like times of all falls together; they see no quadratic trend. A fall is a group. Slower changes,
such as of a drag that turns with the falling body, are not in it, on purpose.

Not identifiable: ``release_velocity`` and ``height_offset`` are for all falls together just another
fall time; ``scale_error`` and ``clock_error`` are nearly another k; buoyancy (1 part in 1000 of g)
is a bias; a delay of the sensor's filter is another fall time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...solver.bristle import Array
from ...solver.effects.base import Parameter
from ...solver.errors import InputError
from .falls_record import BIN_S, Falls
from .problem import Problem

LEAST_DRAG_1_M = 1e-9
ROUNDED_TOGETHER = 10.0
"""By how much averaging betters the rounding of a reading, at best."""
NODES = np.linspace(-3.0, 3.0, 41)
LIBRARY = ("air_drag", "drag_scatter", "release_velocity", "scale_error", "clock_error")


def speed(time_s: Array, k_1_m: Array | float, gravity_m_s2: float) -> Array:
    """Speed downward in m/s at times since it was zero, with quadratic drag; arrays broadcast.

    Before, the body is on its way up. Drag of zero is a vacuum.
    """
    drag = np.maximum(k_1_m, LEAST_DRAG_1_M)
    rate = np.sqrt(gravity_m_s2 * drag)
    turned = rate * time_s
    up = np.tan(np.maximum(np.minimum(turned, 0.0), -1.5))
    return np.asarray(np.sqrt(gravity_m_s2 / drag) * np.where(turned < 0.0, up, np.tanh(turned)))


def since_rest(speed_m_s: Array, k_1_m: Array | float, gravity_m_s2: float) -> Array:
    """The time in s since the speed was zero: the inverse of `speed`."""
    drag = np.maximum(k_1_m, LEAST_DRAG_1_M)
    part = speed_m_s * np.sqrt(drag / gravity_m_s2)
    time = np.where(part < 0.0, np.arctan(part), np.arctanh(np.clip(part, 0.0, 1.0 - 1e-12)))
    return np.asarray(time / np.sqrt(gravity_m_s2 * drag))


@dataclass(frozen=True)
class Bins:
    """Means of neighbouring readings.

    ``group``, ``begin_s``, ``end_s``, ``mean_m_s2``, ``place`` (rows,): which bin of its fall each
    is; ``duration_s`` (rows,) of its fall.
    """

    data: Falls
    group: NDArray[np.int64]
    begin_s: Array
    end_s: Array
    mean_m_s2: Array
    place: NDArray[np.int64]
    duration_s: Array

    @cached_property
    def sigma(self) -> Array:
        """Noise (rows,) of the means in m/s²."""
        square: list[list[float]] = [[] for _ in range(int(self.place.max()) + 1)]
        for number in np.unique(self.group):
            third = np.diff(self.mean_m_s2[self.group == number], 3)
            for i, value in enumerate(third):
                for j in range(i, i + 4):
                    square[j].append(value**2 / 20.0)
        every = np.array([np.mean(values) for values in square])
        smooth = np.convolve(np.pad(every, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
        # readings come in steps: no mean is known better than the rounding of one of them
        steps = np.diff(np.unique(self.data.reading_m_s2))
        least = steps[steps > 0.0].min(initial=1.0) / np.sqrt(12.0) / ROUNDED_TOGETHER
        return np.asarray(np.maximum(np.sqrt(smooth), least)[self.place])


def in_bins(data: Falls) -> Bins:
    """Means over equal parts of about `BIN_S` of each fall, at least four."""
    parts = []
    for piece in data.pieces:
        times, reading = data.times_s[piece], data.reading_m_s2[piece]
        count = max(4, round((times[-1] - times[0]) / BIN_S))
        edges = np.round(np.linspace(0, len(times), count + 1)).astype(int)
        half = 0.5 * (times[-1] - times[0]) / (len(times) - 1)
        for j, (a, b) in enumerate(pairwise(edges)):
            begin, end = times[a] - times[0] - half, times[b - 1] - times[0] + half
            mean, duration = reading[a:b].mean(), times[-1] - times[0]
            parts.append((data.fall[piece.start], begin, end, mean, j, duration))
    number, begin, end, mean, place, duration = np.array(parts).T
    return Bins(data, number.astype(np.int64), begin, end, mean, place.astype(np.int64), duration)


def baseline_parameters(data: Falls) -> tuple[Parameter, ...]:
    """The baseline's free parameters: the sensor's bias, and the time that the fall takes."""
    longest = max(float(data.times_s[p.stop - 1] - data.times_s[p.start]) for p in data.pieces)
    low, high = 0.9 * longest, 1.5 * longest
    why = "the longest record misses little of its fall"
    bias = "accelerometers of telephones, before calibration"
    return (
        Parameter("bias_m_s2", "m/s²", -0.5, 0.5, -0.05, why=bias),
        Parameter("fall_time_s", "s", low, high, longest, longest, why=why),
    )


EFFECT_PARAMETERS: dict[str, tuple[Parameter, ...]] = {
    "air_drag": (
        Parameter("k_1_m", "1/m", 0.0, 1.0, 0.05, why="½ρ c A/m: a steel ball 1e-3, a sheet 1"),
    ),
    "release_velocity": (Parameter("speed_m_s", "m/s", -1.0, 1.0, 0.2, why="a hand lets go"),),
    "height_offset": (Parameter("offset_m", "m", -0.3, 0.3, 0.05, why="a tape measure by hand"),),
    "scale_error": (Parameter("relative", "", -0.2, 0.2, 0.05, why="sensor's gain"),),
    "clock_error": (Parameter("relative", "", -0.2, 0.2, 0.02, why="sensor's sampling rate"),),
    "drag_scatter": (
        Parameter("scatter", "", 0.0, 0.5, 0.15, why="a flat body falls broadside or edge on"),
    ),
}
"""By effect. Only ``drag_scatter`` is not among the names that drops have as well."""


@dataclass(frozen=True)
class FallModel:
    """The reading, with effects in it; a `Model`.

    With ``drag_scatter`` the logarithm of k is normal from fall to fall, with that deviation. Its
    nodes are evenly spaced and many, since a fall's own rows tell its k to a per cent: Gauss's few
    would leave gaps between them. Else there is one node.
    """

    bins: Bins
    effects: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        chosen = (p for name in self.effects for p in EFFECT_PARAMETERS[name])
        return baseline_parameters(self.bins.data) + tuple(chosen)

    @cached_property
    def _nodes(self) -> tuple[Array, Array]:
        if "drag_scatter" not in self.effects:
            return np.zeros(1), np.ones(1)
        weights = np.exp(-0.5 * NODES**2)
        return NODES, weights / weights.sum()

    @property
    def weights(self) -> Array:
        return self._nodes[1]

    def named(self, theta: Array) -> dict[tuple[str, str], Array]:
        """Parameters (..., p) as (..., 1, 1) by effect ("" for the baseline) and name."""
        owners = ["", ""] + [name for name in self.effects for _ in EFFECT_PARAMETERS[name]]
        return {
            (owner, each.name): np.asarray(theta, dtype=float)[..., i, None, None]
            for i, (owner, each) in enumerate(zip(owners, self.parameters, strict=True))
        }

    def readings(self, theta: Array) -> Array:
        """Mean readings (..., nodes, rows) in m/s² for parameters (..., p)."""
        at, none = self.named(theta), np.zeros((1, 1))
        gravity = self.bins.data.manifest.gravity_m_s2
        drag = at.get(("air_drag", "k_1_m"), none)
        scatter = at.get(("drag_scatter", "scatter"), none)
        drag = drag * np.exp(scatter * self._nodes[0][:, None])
        clock = 1.0 + at.get(("clock_error", "relative"), none)
        gain = 1.0 + at.get(("scale_error", "relative"), none)
        whole = at["", "fall_time_s"]
        higher = at.get(("height_offset", "offset_m"), none)
        whole = np.sqrt(np.maximum(whole**2 + 2.0 * higher / gravity, 0.0))
        pushed = since_rest(at.get(("release_velocity", "speed_m_s"), none), drag, gravity)
        begun = whole - self.bins.duration_s / clock + pushed
        begin, end = self.bins.begin_s / clock, self.bins.end_s / clock
        gained = speed(begun + end, drag, gravity) - speed(begun + begin, drag, gravity)
        return np.asarray(at["", "bias_m_s2"] + gain * (gravity - gained / (end - begin)))

    def predict(self, theta: Array) -> Array:
        """Whitened predictions (..., nodes, rows) for parameters (..., p)."""
        return self.readings(theta) / self.bins.sigma


def fall_problem(data: Falls, library: Sequence[str] = LIBRARY) -> Problem:
    """The falls as a `Problem`; ``library`` names the candidates.

    ``drag_scatter``, a drag that differs from fall to fall, shows with ``air_drag`` only.
    ``combine`` also takes ``height_offset``, which is the baseline's fall time by another name.
    """
    bins = in_bins(data)
    combine = _combine(bins)
    return Problem(
        values=bins.mean_m_s2 / bins.sigma,
        scale=bins.sigma,
        unit="m/s²",
        quantity=np.full(len(bins.group), "reading"),
        group=bins.group,
        covariates={
            "time": 0.5 * (bins.begin_s + bins.end_s),
            "order": bins.group.astype(float),
        },
        baseline=combine(()),
        candidates=[combine((name,)) for name in library],
        combine=combine,
        confirm_why="nothing of a bristle is in these data: a body falls and does not touch",
        notes={
            "samples_per_value": len(data.fall) / len(bins.group),
            "not_identifiable": "release velocity, height and the time of the fall; gain, clock "
            "and drag, nearly",
        },
    )


def _combine(bins: Bins) -> Callable[[tuple[str, ...]], FallModel]:
    def combine(effects: tuple[str, ...]) -> FallModel:
        for name in effects:
            if name not in EFFECT_PARAMETERS:
                known = ", ".join(EFFECT_PARAMETERS)
                raise InputError(f"a falls dataset cannot carry {name}; {known} it can")
        return FallModel(bins, tuple(effects))

    return combine


def rms_of_samples(data: Falls, own: str) -> float:
    """Rms residual in m/s² over all samples, none averaged, with least squares on all of them.

    One bias and one fall time serve all falls; each has its ``own`` drag, "constant" or, "drifting"
    linearly in time: how well this physics can do, for comparison, not a prediction of anything.
    """
    gravity = data.manifest.gravity_m_s2
    index = np.repeat(np.arange(len(data.begins) - 1), np.diff(data.begins))
    first = data.times_s[data.begins[:-1]]
    duration = data.times_s[data.begins[1:] - 1] - first
    times = data.times_s - first[index]
    middle = times / duration[index] - 0.5
    falls = len(duration)

    def residual(x: Array) -> Array:
        drag = np.abs(x[2 : 2 + falls])[index]
        moving = speed(x[1] - duration[index] + times, drag, gravity)
        change = 1.0 + x[2 + falls :][index] * middle if own == "drifting" else 1.0
        return np.asarray(x[0] + drag * change * moving * np.abs(moving) - data.reading_m_s2)

    count = 2 * falls if own == "drifting" else falls
    start = np.concatenate([[0.0, duration.max()], np.full(falls, 0.05), np.zeros(count - falls)])
    fitted = least_squares(residual, start, x_scale=np.maximum(np.abs(start), 0.1))
    return float(np.sqrt(np.mean(fitted.fun**2)))
