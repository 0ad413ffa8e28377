"""What a brush did over time, gathered frame by frame: tables, shapes, and files for ParaView."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.checkpoint import prefixed, under
from ...solver.rods.frame import Frame, RodEnergy, TipState
from ...solver.rods.tally import Means
from ..surface.rough import Surface
from .paraview import write_lines, write_series

LOAD_COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
HUB_COLUMNS = ("t_s", *LOAD_COLUMNS)
SHARE_COLUMNS = ("in_contact", "sticking", "slipping")
MEAN_COLUMNS = ("from_s", "to_s", *LOAD_COLUMNS, *SHARE_COLUMNS)
TIP_COLUMNS = ("x_m", "y_m", "z_m", "normal_N", "friction_N", "between_N")
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
    times_s: list[float] = field(default_factory=list)
    hub: list[Array] = field(default_factory=list)
    means: list[Array] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)
    stress_Pa: list[Array] = field(default_factory=list)
    shapes: list[Array] = field(default_factory=list)
    energies: list[RodEnergy] = field(default_factory=list)
    steps: int = 0

    def take(self, frame: Frame) -> None:
        """Note a frame; OSError where its file cannot be written."""
        number = len(self.times_s)
        self.times_s.append(frame.t_s)
        self.hub.append(np.concatenate([frame.force_N, frame.torque_Nm]))
        mean = frame.means
        ends = [mean.begin_s, mean.end_s]
        self.means.append(np.column_stack([*ends, mean.force_N, mean.torque_Nm, mean.share]))
        contact = np.column_stack([frame.tip_normal_N, frame.tip_friction_N, frame.between_N])
        self.tips.append(np.column_stack([frame.tip_m, contact]))
        self.states.append(np.array(frame.state, dtype=np.int64))
        self.stress_Pa.append(frame.bending_stress_Pa.max(axis=1))
        chosen = self.drawn
        shape = [frame.centre_m[chosen], frame.bending_stress_Pa[chosen, :, None]]
        self.shapes.append(np.concatenate(shape, axis=-1))
        self.energies.append(frame.energy)
        self.steps = frame.steps
        if self.folder is not None:
            each = dict(zip(TIP_COLUMNS[3:], contact.T, strict=True))
            each["state"] = self.states[-1]
            write_lines(self.folder, number, frame.centre_m, frame.bending_stress_Pa, each)

    @property
    def drawn(self) -> NDArray[np.int64]:
        """Numbers of the bristles whose shape is kept, spread over all of them."""
        n = len(self.states[0])
        return np.unique(np.linspace(0, n - 1, min(n, DRAWN)).astype(np.int64))

    def finish(self, reach_m: float, surface: Surface | None) -> None:
        """Write the list of files, and the surface as far as ``reach_m`` beyond all tips."""
        if self.folder is not None:
            places = np.concatenate(self.tips)[:, :2]
            low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
            write_series(self.folder, self.times_s, low, high, surface)

    def hub_table(self) -> pd.DataFrame:
        """A row for each instant: hub.csv."""
        rows = np.column_stack([self.times_s, np.array(self.hub)])
        return pd.DataFrame(rows, columns=list(HUB_COLUMNS))

    def mean_table(self) -> pd.DataFrame:
        """A row for each window of time, of means over it: means.csv."""
        return pd.DataFrame(np.concatenate(self.means), columns=list(MEAN_COLUMNS))

    def interval_table(self) -> pd.DataFrame:
        """As `mean_table`, of the longer intervals between frames."""
        rows = [
            np.average(each, axis=0, weights=each[:, 1] - each[:, 0]) for each in self.means[1:]
        ]
        table = pd.DataFrame(rows, columns=list(MEAN_COLUMNS))
        table["from_s"], table["to_s"] = self.times_s[:-1], self.times_s[1:]
        return table

    def tip_table(self) -> pd.DataFrame:
        """A row for each instant and bristle: tips.csv."""
        n = len(self.states[0])
        table = pd.DataFrame({"t_s": np.repeat(self.times_s, n)})
        table["bristle"] = np.tile(np.arange(n), len(self.times_s))
        table[list(TIP_COLUMNS)] = np.concatenate(self.tips)
        # after the columns that every version has
        between = table.pop("between_N")
        table["state"] = np.vectorize(STATES.get)(np.concatenate(self.states))
        table["between_N"] = between
        return table

    def over_time(self) -> pd.DataFrame:
        """A row for each instant: the greatest bending stress of all bristles."""
        stress = np.max(self.stress_Pa, axis=1)
        return pd.DataFrame({"t_s": self.times_s, "bending_stress_Pa": stress})

    def summary(self, from_s: float) -> dict[str, Any]:
        """What result.json has of the time from ``from_s`` on, energies and stress of all of it.

        Means, rms and greatest values are those of the windows of `mean_table` after ``from_s``, or
        of the last one if there is none.
        """
        means, over = self.mean_table(), self.over_time()
        later = means[means.from_s >= from_s - SAME_S]
        later = later if len(later) else means[-1:]
        width = (later.to_s - later.from_s).to_numpy()
        last = self.energies[-1]
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
                "t_s": self.times_s[worst],
                "bristle": int(self.stress_Pa[worst].argmax()),
            },
            "energy": {
                **asdict(last),
                "numerical_J": last.numerical_J,
                "closure_relative": last.closure_relative,
            },
            "n_steps": self.steps,
        }


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
