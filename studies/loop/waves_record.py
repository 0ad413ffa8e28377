"""Which record of a gauge on a ringing bar is measured, and can every key and value be used?

A public example with its source, commit and licence in its ``dataset.toml`` is a square aluminium
bar from lanl/HopPyBar (examples/mini-Kolsky/PMMA-13, BSD-3-Clause).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...solver.bristle import Array
from ...solver.errors import InputError
from ..data.datasets import Manifest, read_manifest
from ..data.tables import column, read_table
from ..data.texts import finite, quoted

UNIT = re.compile(r"[\w%°/·*^.() -]{1,20}")
NEAR_MIDDLE = 0.1
"""How far from mid-length a gauge may lie, in half lengths."""


@dataclass(frozen=True)
class Waves:
    """A record: times (samples,) in s, evenly spaced; ``signal`` (samples,) less its offset.

    ``difference`` (samples,) is half the difference of two gauges on opposite faces, less its
    offset, or None where there is one. Both are in ``unit``. ``first_pass_s`` and ``predict_s``
    are (begin, end). ``off_centre_m`` is by how much the gauge is said to lie off mid-length,
    toward whichever end.
    """

    manifest: Manifest
    times_s: Array
    signal: Array
    difference: Array | None
    unit: str
    baseline_until_s: float
    first_pass_s: tuple[float, float]
    predict_s: tuple[float, float]
    off_centre_m: float

    @property
    def step_s(self) -> float:
        return float((self.times_s[-1] - self.times_s[0]) / (len(self.times_s) - 1))


def read_waves(folder: Path) -> Waves:
    """Read a dataset of kind ``waves``.

    Raises InputError naming file and line of what cannot be used: a key, a window outside the
    record, times that are not evenly spaced.
    """
    manifest = read_manifest(folder, "waves")
    names = _signal(manifest)
    until = _number(manifest, "baseline_until_s", manifest.measurement.get("baseline_until_s"))
    first, predict = _window(manifest, "first_pass_s"), _window(manifest, "predict_s")
    if predict[0] < first[1]:
        raise manifest.wrong("predict_s", "must begin after the first pass has ended")
    path = manifest.table()
    rows = read_table(path, required=("t_s", *names))
    if len(rows) < 100:
        raise InputError(f"{path}: {len(rows)} samples are no record of a wave")
    times = column(path, rows, "t_s")
    step = (times[-1] - times[0]) / (len(times) - 1)
    uneven = np.flatnonzero(~(np.abs(np.diff(times) - step) < 0.01 * abs(step)) | (step <= 0.0))
    if len(uneven):
        raise InputError(f"{path}:{rows[uneven[0] + 1][0]}: t_s must grow in equal steps")
    for key, (begin, end) in (("first_pass_s", first), ("predict_s", predict)):
        if begin < times[0] or end > times[-1]:
            raise manifest.wrong(key, f"must lie within {times[0]:g} to {times[-1]:g}")
    quiet = times < until
    if np.count_nonzero(quiet) < 50 or until > first[0]:
        raise manifest.wrong("baseline_until_s", "must leave 50 samples before the first pass")
    gauges = np.array([column(path, rows, name) for name in names])
    gauges -= gauges[:, quiet].mean(axis=1, keepdims=True)
    return Waves(
        manifest=manifest,
        times_s=times,
        signal=gauges.mean(axis=0),
        difference=0.5 * (gauges[0] - gauges[1]) if len(names) == 2 else None,
        unit=_unit(manifest),
        baseline_until_s=until,
        first_pass_s=first,
        predict_s=predict,
        off_centre_m=_off_centre(manifest),
    )


def _off_centre(manifest: Manifest) -> float:
    middle = 0.5 * manifest.bristle.length_m
    place = manifest.measurement.get("gauge_x_m", middle)
    off = abs(_number(manifest, "gauge_x_m", place) - middle)
    if off > NEAR_MIDDLE * middle:
        raise manifest.wrong(
            "gauge_x_m", f"must be near mid-length, {middle:g}: passes overlap elsewhere"
        )
    return off


def _unit(manifest: Manifest) -> str:
    """The unit, as labels of figures can show it: a dollar would begin a formula there."""
    unit = manifest.measurement.get("unit", "V")
    if not isinstance(unit, str) or not UNIT.fullmatch(unit):
        raise manifest.wrong("unit", f"must be a unit such as V or µm/m, not {quoted(unit)}")
    return unit


def _signal(manifest: Manifest) -> tuple[str, ...]:
    names = manifest.measurement.get("signal")
    names = [names] if isinstance(names, str) else names
    good = isinstance(names, list) and 1 <= len(names) <= 2 and len(set(map(str, names)))
    if not (good and isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise manifest.wrong("signal", "must name one column, or two of gauges on opposite faces")
    if len(set(names)) != len(names):
        raise manifest.wrong("signal", "names a column twice")
    return tuple(names)


def _number(manifest: Manifest, key: str, value: object) -> float:
    number = finite(value)
    if number is None:
        raise manifest.wrong(key, f"must be a finite number, not {quoted(value)}")
    return number


def _window(manifest: Manifest, key: str) -> tuple[float, float]:
    value = manifest.measurement.get(key)
    if not (isinstance(value, list) and len(value) == 2):
        raise manifest.wrong(key, "must be [begin, end]")
    begin, end = (_number(manifest, key, each) for each in value)
    if not begin < end:
        raise manifest.wrong(key, "must end after it begins")
    return begin, end
