"""What a brush did over time, gathered frame by frame: tables, shapes, and files for ParaView."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...solver.arrays import Array
from ...solver.checkpoint import prefixed, under
from ...solver.rods.frame import Frame, RodEnergy, TipState
from ...solver.rods.tally import Means
from ..surface.rough import Surface
from .paraview import write_lines, write_series
from .shape import spread

LOAD_COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
SHARE_COLUMNS = ("in_contact", "sticking", "slipping")
MEAN_COLUMNS = ("from_s", "to_s", *LOAD_COLUMNS, *SHARE_COLUMNS)
# Columns of tips.csv, and arrays for ParaView, by what a frame calls them.
AT_TIPS = {"normal_N": "tip_normal_N", "friction_N": "tip_friction_N", "between_N": "between_N"}
STATES = {TipState.FREE: "free", TipState.STICK: "stick", TipState.SLIP: "slip"}
# Bristles whose shape is kept for pictures.
DRAWN = 100
# Times that differ by less are the same.
SAME_S = 1e-12


def to_arrays(frame: Frame) -> dict[str, Array]:
    """A frame as arrays by name, as a checkpoint keeps it."""
    plain = {each.name: getattr(frame, each.name) for each in fields(frame)}
    parts = {name: asdict(plain.pop(name)) for name in ("energy", "means")}
    whole = {name: np.asarray(value) for name, value in plain.items()}
    return whole | prefixed("energy", parts["energy"]) | prefixed("means", parts["means"])


def from_arrays(arrays: Mapping[str, Array]) -> Frame:
    """The frame that `to_arrays` took apart."""
    energy = RodEnergy(**{name: float(value) for name, value in under("energy", arrays)})
    plain: dict[str, Any] = {name: each for name, each in arrays.items() if "." not in name}
    plain |= {"t_s": float(arrays["t_s"]), "steps": int(arrays["steps"])}
    return Frame(**plain, energy=energy, means=Means(**dict(under("means", arrays))))


# Parts of the time whose means say how sure the mean of all is.
BATCHES = 10


@dataclass
class Record:
    """The frames so far, on one rank, and their files in ``folder`` unless that is None."""

    folder: Path | None
    # with the centre lines, axes and stress of drawn bristles alone
    frames: list[Frame] = field(default_factory=list)
    # the greatest in each bristle
    stress_Pa: list[Array] = field(default_factory=list)

    def take(self, frame: Frame) -> None:
        """Note a frame; OSError where its file cannot be written."""
        if self.folder is not None:
            number, stress = len(self.frames), frame.bending_stress_Pa
            each = {name: getattr(frame, of) for name, of in AT_TIPS.items()}
            each["state"] = frame.state.astype(np.int64)
            write_lines(self.folder, number, frame.centre_m, stress, each)
        self.stress_Pa.append(frame.greatest_stress_Pa)
        drawn = spread(len(frame.state), DRAWN)
        names = "centre_m", "rotation", "bending_stress_Pa"
        kept = {name: getattr(frame, name)[drawn] for name in names}
        # a view of all lines would hold them
        self.frames.append(replace(frame, tip_m=frame.tip_m.copy(), **kept))

    def _each(self, name: str) -> Array:
        """What all frames have by this name, one after another."""
        return np.array([getattr(frame, name) for frame in self.frames])

    def finish(self, reach_m: float, surface: Surface | None) -> None:
        """Write the list of files, and the surface as far as ``reach_m`` beyond all tips."""
        if self.folder is not None:
            places = self._each("tip_m").reshape(-1, 3)[:, :2]
            low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
            times_s = [frame.t_s for frame in self.frames]
            write_series(self.folder, times_s, low, high, surface)

    def hub_table(self) -> pd.DataFrame:
        """A row for each instant: hub.csv."""
        rows = np.column_stack([self._each(name) for name in ("t_s", "force_N", "torque_Nm")])
        return pd.DataFrame(rows, columns=["t_s", *LOAD_COLUMNS])

    def mean_table(self) -> pd.DataFrame:
        """A row for each window of time, of means over it: means.csv."""
        rows = [_windows(frame.means) for frame in self.frames]
        return pd.DataFrame(np.concatenate(rows), columns=list(MEAN_COLUMNS))

    def interval_table(self) -> pd.DataFrame:
        """As `mean_table`, of the longer intervals between frames."""
        windows = [_windows(frame.means) for frame in self.frames[1:]]
        rows = [np.average(each, axis=0, weights=each[:, 1] - each[:, 0]) for each in windows]
        table = pd.DataFrame(rows, columns=list(MEAN_COLUMNS))
        times_s = self._each("t_s")
        table["from_s"], table["to_s"] = times_s[:-1], times_s[1:]
        return table

    def tip_table(self) -> pd.DataFrame:
        """A row for each instant and bristle: tips.csv."""
        tips = self._each("tip_m")
        count, n = tips.shape[:2]
        table = pd.DataFrame(tips.reshape(-1, 3), columns=["x_m", "y_m", "z_m"])
        table.insert(0, "t_s", np.repeat(self._each("t_s"), n))
        table.insert(1, "bristle", np.tile(np.arange(n), count))
        for name, of in AT_TIPS.items():
            table[name] = self._each(of).ravel()
        states = np.vectorize(STATES.get)(self._each("state").ravel())
        # before the column that not every version has
        table.insert(table.columns.get_loc("between_N"), "state", states)
        return table

    def over_time(self) -> pd.DataFrame:
        """A row for each instant: the greatest bending stress in any bristle since the last."""
        stress = np.max(self.stress_Pa, axis=1)
        return pd.DataFrame({"t_s": self._each("t_s"), "bending_stress_Pa": stress})

    def summary(self, from_s: float) -> dict[str, Any]:
        """What result.json has of the time from ``from_s`` on, energies and stress of all of it.

        Means, rms and greatest values are those of the windows of `mean_table` after ``from_s``, or
        of the last one if there is none.
        """
        means, over = self.mean_table(), self.over_time()
        later = means[means.from_s >= from_s - SAME_S]
        later = later if len(later) else means[-1:]
        width = (later.to_s - later.from_s).to_numpy()
        last = self.frames[-1].energy
        worst = int(over.bending_stress_Pa.argmax())
        return {
            "steady_from_s": from_s,
            "window_s": float(width.max()),
            "force_N": _statistics(later, LOAD_COLUMNS[:3], width),
            "torque_Nm": _statistics(later, LOAD_COLUMNS[3:], width),
            "tips_share": {
                name: float(np.average(later[name], weights=width)) for name in SHARE_COLUMNS
            },
            "bending_stress": {
                "greatest_Pa": float(over.bending_stress_Pa[worst]),
                "t_s": self.frames[worst].t_s,
                "bristle": int(self.stress_Pa[worst].argmax()),
            },
            "energy": {
                **asdict(last),
                "numerical_J": last.numerical_J,
                "closure_relative": last.closure_relative,
            },
            "n_steps": self.frames[-1].steps,
        }


def _windows(means: Means) -> Array:
    """A row of `MEAN_COLUMNS` for each window."""
    ends = means.begin_s, means.end_s
    return np.column_stack([*ends, means.force_N, means.torque_Nm, means.share])


def _statistics(windows: pd.DataFrame, names: Sequence[str], width: Array) -> dict[str, Any]:
    """Mean and root mean square of the three columns ``names``, and of the size of the vector that
    they are; the greatest size, and when; and the standard errors of the means, by the means of
    `BATCHES` parts one after the other: None where windows are fewer. ``width`` (n,) weighs them.
    """
    vectors = windows[list(names)].to_numpy()
    sizes = np.linalg.norm(vectors, axis=1)
    error = None
    if len(vectors) >= 2 * BATCHES:
        parts = [part.mean(axis=0) for part in np.array_split(vectors, BATCHES)]
        error = (np.std(parts, axis=0, ddof=1) / np.sqrt(BATCHES)).tolist()
    return {
        "mean": np.average(vectors, axis=0, weights=width).tolist(),
        "mean_error": error,
        "rms": np.sqrt(np.average(vectors**2, axis=0, weights=width)).tolist(),
        "mean_size": float(np.average(sizes, weights=width)),
        "rms_size": float(np.sqrt(np.average(sizes**2, weights=width))),
        "greatest_size": float(sizes.max()),
        "greatest_at_s": float(windows.to_s.iloc[sizes.argmax()]),
    }
