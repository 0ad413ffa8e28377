"""Records of strain gauges on a bar with free ends, read with every key and value checked.

What is needed: a gauge (``signal``: its column, or two columns of gauges on opposite faces, whose
mean holds no bending), its place ``gauge_x_m`` from the end that the pulse comes from, a quiet
stretch before the pulse (until ``baseline_until_s``), the first pass alone (``first_pass_s``), and
a later stretch to be predicted (``predict_s``): at the same gauge, with one later pass or more, or
at a second gauge farther along (``signal_2``, ``gauge_2_x_m``), with the first pass there.
``sigma``, where it is declared, is the standard deviation of a sample in the signal's unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.errors import InputError
from ....data.datasets import Manifest, read_manifest
from ....data.tables import Rows, column, read_table
from ....inputs.texts import quoted

Flags = NDArray[np.bool_]
UNIT = re.compile(r"[\w%°/·*^.() -]{1,20}")
LEAST_QUIET = 12
LEAST_PASS = 8
UNEVEN = 0.3
"""How far a step in time may be from the mean one, over it: times may be written rounded."""


@dataclass(frozen=True)
class Gauge:
    """A gauge at ``x_m`` from the struck end: ``signal`` (samples,) less its offset.

    ``difference`` (samples,) is half the difference of two gauges on opposite faces, less its
    offset, or None where there is one. ``placed`` says whether its place was declared.
    """

    x_m: float
    signal: Array
    difference: Array | None
    placed: bool = True


@dataclass(frozen=True)
class Waves:
    """A record: times (samples,) in s, evenly spaced, and one gauge or two, in ``unit``.

    ``first_pass_s`` and ``predict_s`` are (begin, end); ``sigma`` is None where not declared.
    """

    manifest: Manifest
    times_s: Array
    gauge: Gauge
    second: Gauge | None
    unit: str
    sigma: float | None
    baseline_until_s: float
    first_pass_s: tuple[float, float]
    predict_s: tuple[float, float]

    @property
    def step_s(self) -> float:
        return float((self.times_s[-1] - self.times_s[0]) / (len(self.times_s) - 1))

    @property
    def predicted(self) -> Gauge:
        """The gauge whose record is predicted."""
        return self.gauge if self.second is None else self.second

    @property
    def quiet(self) -> int:
        """Samples before the pulse."""
        return int(np.count_nonzero(self.times_s < self.baseline_until_s))

    def index(self, time_s: float) -> int:
        """The sample at that time, or the next one."""
        return round(np.ceil((time_s - self.times_s[0]) / self.step_s - 1e-3))


def read_waves(folder: Path) -> Waves:
    """Read a dataset of kind ``waves``.

    Raises InputError naming file and line of what cannot be used: a key, a window outside the
    record, times that are not evenly spaced, and saying what would be needed.
    """
    manifest = read_manifest(folder, "waves")
    measurement = manifest.measurement
    names = _signal(manifest, "signal")
    others = _signal(manifest, "signal_2") if "signal_2" in measurement else ()
    if set(names) & set(others):
        raise manifest.wrong("signal_2", "names a column of signal")
    first, predict = _window(manifest, "first_pass_s"), _window(manifest, "predict_s")
    until = first[0]
    if "baseline_until_s" in measurement:
        until = manifest.finite("baseline_until_s", measurement["baseline_until_s"])
    places = _places(manifest, bool(others))
    path = manifest.table()
    rows = read_table(path, required=("t_s", *names, *others))
    times = _times(path, rows)
    if not others and predict[0] < first[1]:
        raise manifest.wrong(
            "predict_s", "must begin after the first pass has ended: at one gauge, only later "
            "passes can be predicted"
        )  # fmt: skip
    if predict[0] < first[0]:
        raise manifest.wrong("predict_s", "must not begin before the first pass does")
    windows = {"first_pass_s": first, "predict_s": predict}
    for key, (begin, end) in windows.items():
        if begin < times[0] or end > times[-1]:
            raise manifest.wrong(key, f"must lie within {times[0]:g} to {times[-1]:g}")
    quiet = times < until
    if np.count_nonzero(quiet) < LEAST_QUIET or until > first[0]:
        raise manifest.wrong(
            "baseline_until_s",
            f"must leave {LEAST_QUIET} samples or more before the first pass: they show the noise",
        )
    for key, (begin, end) in windows.items():
        if np.count_nonzero((times >= begin) & (times <= end)) < LEAST_PASS:
            raise manifest.wrong(key, f"holds fewer than {LEAST_PASS} samples of the record")
    gauges = [
        _gauge(path, rows, some, quiet, place)
        for some, place in zip((names, others), places, strict=False)
        if some
    ]
    return Waves(
        manifest=manifest,
        times_s=times,
        gauge=gauges[0],
        second=gauges[1] if others else None,
        unit=_unit(manifest),
        sigma=_sigma(manifest),
        baseline_until_s=until,
        first_pass_s=first,
        predict_s=predict,
    )


def _times(path: Path, rows: Rows) -> Array:
    if len(rows) < LEAST_QUIET + 2 * LEAST_PASS:
        raise InputError(f"{path}: {len(rows)} samples are no record of a wave")
    times = column(path, rows, "t_s")
    step = (times[-1] - times[0]) / (len(times) - 1)
    usual = np.median(np.diff(times))
    uneven = np.abs(np.diff(times) - usual) > UNEVEN * abs(usual)
    uneven |= np.diff(times) <= 0.0
    if np.any(uneven):
        line = rows[int(np.flatnonzero(uneven)[0]) + 1][0]
        raise InputError(f"{path}:{line}: t_s must grow in equal steps; no sample may be missing")
    drift = np.abs(times - times[0] - step * np.arange(len(times)))
    if drift.max() > step:
        line = rows[int(np.argmax(drift))][0]
        raise InputError(f"{path}:{line}: t_s must grow in equal steps; here they have changed")
    return times


def _gauge(
    path: Path, rows: Rows, names: tuple[str, ...], quiet: Flags, place: tuple[float, bool]
) -> Gauge:
    faces = np.array([column(path, rows, name) for name in names])
    faces -= faces[:, quiet].mean(axis=1, keepdims=True)
    apart = 0.5 * (faces[0] - faces[1]) if len(names) == 2 else None
    return Gauge(place[0], faces.mean(axis=0), apart, place[1])


def _places(manifest: Manifest, second: bool) -> tuple[tuple[float, bool], ...]:
    """Where the gauges are, and whether that is declared; the first at mid-length where not."""
    measurement, length = manifest.measurement, manifest.bristle.length_m
    places = []
    for key in ("gauge_x_m", "gauge_2_x_m")[: 2 if second else 1]:
        if key not in measurement and (key == "gauge_2_x_m" or second):
            raise manifest.wrong(
                key, "is missing: with two gauges the place of each must be known, from the end "
                "that the pulse comes from"
            )  # fmt: skip
        place = manifest.finite(key, measurement.get(key, 0.5 * length))
        if not 0.0 < place < length:
            raise manifest.wrong(
                key,
                f"must lie between the ends, 0 and {length:g}, counted from the end that the "
                "pulse comes from",
            )
        places.append((place, key in measurement))
    if second and places[1][0] <= places[0][0]:
        raise manifest.wrong(
            "gauge_2_x_m", "must be farther than gauge_x_m from the end that the pulse comes from"
        )
    if not second and "gauge_2_x_m" in measurement:
        raise manifest.wrong("gauge_2_x_m", "needs signal_2, the column of the second gauge")
    return tuple(places)


def _unit(manifest: Manifest) -> str:
    """The unit, as labels of figures can show it: a dollar would begin a formula there."""
    unit = manifest.measurement.get("unit", "V")
    if not isinstance(unit, str) or not UNIT.fullmatch(unit):
        raise manifest.wrong("unit", f"must be a unit such as V or µm/m, not {quoted(unit)}")
    return unit


def _sigma(manifest: Manifest) -> float | None:
    if "sigma" not in manifest.measurement:
        return None
    sigma = manifest.finite("sigma", manifest.measurement["sigma"])
    if not sigma > 0.0:
        raise manifest.wrong("sigma", f"must be positive, not {sigma:g}")
    return sigma


def _signal(manifest: Manifest, key: str) -> tuple[str, ...]:
    names = manifest.measurement.get(key)
    names = [names] if isinstance(names, str) else names
    good = isinstance(names, list) and 1 <= len(names) <= 2
    if not (good and isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise manifest.wrong(key, "must name one column, or two of gauges on opposite faces")
    if len(set(names)) != len(names):
        raise manifest.wrong(key, "names a column twice")
    return tuple(names)


def _window(manifest: Manifest, key: str) -> tuple[float, float]:
    value = manifest.measurement.get(key)
    if value is None:
        raise manifest.wrong(
            key,
            "is missing: [begin, end] of the first pass alone"
            if key == "first_pass_s"
            else "is missing: [begin, end] of what is to be predicted, one later pass or more",
        )
    if not (isinstance(value, list) and len(value) == 2):
        raise manifest.wrong(key, "must be [begin, end]")
    begin, end = (manifest.finite(key, each) for each in value)
    if not begin < end:
        raise manifest.wrong(key, "must end after it begins")
    return begin, end
