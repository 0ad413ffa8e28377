"""What a brush did over time, gathered frame by frame: tables, shapes, and files for ParaView."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.checkpoint import prefixed, under
from ...solver.rods.frame import Frame, RodEnergy, TipState
from .paraview import write_lines, write_series

HUB_COLUMNS = ("t_s", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
TIP_COLUMNS = ("x_m", "y_m", "z_m", "normal_N", "friction_N")
STATES = {TipState.FREE: "free", TipState.STICK: "stick", TipState.SLIP: "slip"}
# Bristles whose shape is kept for pictures.
DRAWN = 100


def to_arrays(frame: Frame) -> dict[str, Array]:
    """A frame as arrays by name, as a checkpoint keeps it."""
    plain = {each.name: getattr(frame, each.name) for each in fields(frame)}
    energy = asdict(plain.pop("energy"))
    return {name: np.asarray(value) for name, value in plain.items()} | prefixed("energy", energy)


def from_arrays(arrays: Mapping[str, Array]) -> Frame:
    """The frame that `to_arrays` took apart."""
    energy = RodEnergy(**{name: float(value) for name, value in under("energy", arrays)})
    plain: dict[str, Any] = {name: each for name, each in arrays.items() if "." not in name}
    plain |= {"t_s": float(arrays["t_s"]), "steps": int(arrays["steps"])}
    return Frame(**plain, energy=energy)


# Parts of the time whose means say how sure the mean of all is.
BATCHES = 10


@dataclass
class Record:
    """The frames so far, on one rank, and their files in ``folder`` unless that is None."""

    folder: Path | None
    times_s: list[float] = field(default_factory=list)
    hub: list[Array] = field(default_factory=list)
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
        contact = np.column_stack([frame.tip_normal_N, frame.tip_friction_N])
        self.tips.append(np.column_stack([frame.tip_m, contact]))
        self.states.append(np.array(frame.state, dtype=np.int64))
        self.stress_Pa.append(frame.bending_stress_Pa.max(axis=1))
        chosen = self.drawn
        shape = [frame.centre_m[chosen], frame.bending_stress_Pa[chosen, :, None]]
        self.shapes.append(np.concatenate(shape, axis=-1))
        self.energies.append(frame.energy)
        self.steps = frame.steps
        if self.folder is not None:
            each = {"normal_N": contact[:, 0], "friction_N": contact[:, 1]}
            each["state"] = self.states[-1]
            write_lines(self.folder, number, frame.centre_m, frame.bending_stress_Pa, each)

    @property
    def drawn(self) -> NDArray[np.int64]:
        """Numbers of the bristles whose shape is kept, spread over all of them."""
        n = len(self.states[0])
        return np.unique(np.linspace(0, n - 1, min(n, DRAWN)).astype(np.int64))

    def finish(self, reach_m: float) -> None:
        """Write the list of files, and the surface as far as ``reach_m`` beyond all tips."""
        if self.folder is not None:
            places = np.concatenate(self.tips)[:, :2]
            low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
            write_series(self.folder, self.times_s, low, high)

    def hub_table(self) -> pd.DataFrame:
        """A row for each instant: hub.csv."""
        rows = np.column_stack([self.times_s, np.array(self.hub)])
        return pd.DataFrame(rows, columns=list(HUB_COLUMNS))

    def tip_table(self) -> pd.DataFrame:
        """A row for each instant and bristle: tips.csv."""
        n = len(self.states[0])
        table = pd.DataFrame({"t_s": np.repeat(self.times_s, n)})
        table["bristle"] = np.tile(np.arange(n), len(self.times_s))
        table[list(TIP_COLUMNS)] = np.concatenate(self.tips)
        table["state"] = np.vectorize(STATES.get)(np.concatenate(self.states))
        return table

    def over_time(self) -> pd.DataFrame:
        """A row for each instant: shares of tips in contact, sticking and slipping, and the
        greatest bending stress."""
        states = np.array(self.states)
        shares = {
            "in_contact": (states != TipState.FREE).mean(axis=1),
            "sticking": (states == TipState.STICK).mean(axis=1),
            "slipping": (states == TipState.SLIP).mean(axis=1),
        }
        stress = np.max(self.stress_Pa, axis=1)
        return pd.DataFrame({"t_s": self.times_s, **shares, "bending_stress_Pa": stress})

    def summary(self, from_s: float) -> dict[str, Any]:
        """What result.json has of the time from ``from_s`` on, energies and stress of all of it."""
        hub, over = self.hub_table(), self.over_time()
        later = (hub.t_s >= from_s).to_numpy()
        if not later.any():
            later[-1] = True
        last = self.energies[-1]
        worst = int(over.bending_stress_Pa.argmax())
        return {
            "steady_from_s": from_s,
            "force_N": _statistics(hub.iloc[:, 1:4].to_numpy()[later], hub.t_s[later]),
            "torque_Nm": _statistics(hub.iloc[:, 4:].to_numpy()[later], hub.t_s[later]),
            "tips_share": {
                name: float(over[name][later].mean())
                for name in ("in_contact", "sticking", "slipping")
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


def _statistics(vectors: Array, times_s: pd.Series) -> dict[str, Any]:
    """Mean and root mean square of the components of ``vectors`` (n, 3), and of their sizes; the
    greatest size, and when; and the standard errors of the means, by the means of `BATCHES` parts
    one after the other: None where instants are fewer."""
    sizes = np.linalg.norm(vectors, axis=1)
    error = None
    if len(vectors) >= 2 * BATCHES:
        parts = [part.mean(axis=0) for part in np.array_split(vectors, BATCHES)]
        error = (np.std(parts, axis=0, ddof=1) / np.sqrt(BATCHES)).tolist()
    return {
        "mean": vectors.mean(axis=0).tolist(),
        "mean_error": error,
        "rms": np.sqrt((vectors**2).mean(axis=0)).tolist(),
        "mean_size": float(sizes.mean()),
        "rms_size": float(np.sqrt((sizes**2).mean())),
        "greatest_size": float(sizes.max()),
        "greatest_at_s": float(times_s.iloc[sizes.argmax()]),
    }
