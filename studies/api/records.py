"""What the Python functions return: results by name, with a table for notebooks and a plot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from ...solver import paper
from ..drop import summary as drop_summary
from ..its import GOAL, QUANTITIES
from ..running.files import to_plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pyvista import UnstructuredGrid

    from ...solver.solid_fields import SolidFields

INFINITIES = {"inf": math.inf, "-inf": -math.inf}


class Record(dict[str, Any]):
    """What stands in a JSON file of this program: ``r["energy"]["kinetic_J"]`` or, the same,
    ``r.energy.kinetic_J``."""

    # What stands beside the JSON: attributes, given behind the values in this order.
    _beside: ClassVar[tuple[str, ...]] = ()

    def __init__(self, values: Mapping[str, Any], *beside: Any) -> None:
        if len(beside) != len(self._beside):
            wanted = ", ".join(("values", *self._beside))
            raise TypeError(f"{type(self).__name__} is made of {wanted}")
        super().__init__((name, _value(value)) for name, value in values.items())
        vars(self).update(zip(self._beside, beside, strict=True))

    def __reduce__(self) -> tuple[Any, ...]:
        beside = (vars(self)[name] for name in self._beside)
        return type(self), (dict(self), *beside), vars(self)

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in self:
            return self[name]
        raise AttributeError(f"there is no {name} here; there are {', '.join(self)}", name=name)

    def __missing__(self, name: str) -> Any:
        """What stands beside the JSON, such as ``r["history"]``."""
        if name in vars(self):
            return vars(self)[name]
        raise KeyError(name)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self})

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, as they stand in the JSON."""
        return to_plain(self)

    def rows(self) -> list[tuple[str, str]]:
        """Names and values of what is looked at first."""
        return [(name, _short(value)) for name, value in self.items()]

    def heading(self) -> str:
        """The line above `rows`."""
        return type(self).__name__

    def __repr__(self) -> str:
        return "\n".join([self.heading(), *(f"  {name:<24}{text}" for name, text in self.rows())])

    def _repr_html_(self) -> str:
        """The same as a table, which notebooks show."""
        rows = "".join(
            f"<tr><th style='text-align: left'>{escape(name)}</th>"
            f"<td style='text-align: left'>{escape(text)}</td></tr>"
            for name, text in self.rows()
        )
        return f"<table><caption>{escape(self.heading())}</caption>{rows}</table>"


class Energy(Record):
    """Where the energy of a drop went, in J; ``closure_relative`` is what is missing from the sum,
    as a share of the impact's energy."""

    initial_J: float
    kinetic_J: float
    strain_J: float
    potential_J: float
    contact_J: float
    material_loss_J: float
    contact_loss_J: float
    friction_loss_J: float
    drag_loss_J: float
    numerical_J: float
    closure_relative: float
    flight_J: float


class Drop(Record):
    """A drop: what result.json holds, by name.

    ``history`` is a DataFrame with history.csv's columns. ``fields`` has the fields of a solid in
    contact (`SolidFields`), and is None for other models.
    """

    schema: int
    version: str
    inputs: Record
    model: str
    contact: str
    deflection: str
    impact_speed_m_s: float
    rebound_ratio: float | None
    rebound_height_m: float | None
    contact_time_s: float | None
    n_contacts: int
    peak_force_N: float
    impulse_N_s: float
    max_penetration_m: float
    time_to_max_penetration_s: float
    cm_velocity_after_m_s: float | None
    velocity_after_m_s: list[float] | None
    spin_after_rad_s: list[float] | None
    cm_rebound_height_m: float | None
    cm_rebound_ratio: float | None
    friction_impulse_N_s: float
    reduction_error: float | None
    n_dofs: int
    n_steps: int
    energy: Energy
    warnings: list[str]
    wall_s: Record
    peak_rss_MB: float
    ranks: int
    history: pd.DataFrame
    fields: SolidFields | None
    _beside = ("history", "fields")

    def __init__(
        self, values: Mapping[str, Any], history: pd.DataFrame, fields: SolidFields | None = None
    ) -> None:
        super().__init__({**values, "energy": Energy(values["energy"])}, history, fields)

    def __reduce__(self) -> tuple[Any, ...]:
        """Without the fields, which belong to a communicator."""
        return type(self), (dict(self), self.history)

    def rows(self) -> list[tuple[str, str]]:
        return drop_summary(self)

    def heading(self) -> str:
        return f"{self.model} from {self.inputs.height_m:g} m"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Height of the lower tip over time and, in a smaller Axes inside, the force of the first
        impact; returns the outer one."""
        ax = _axes(ax)
        t, force = self.history.t_s, self.history.force_N
        ax.plot(1e3 * t, 1e3 * self.history.tip_y_m, label="lower tip")
        ax.axhline(0.0, color="black", linewidth=0.7)
        ax.set(xlabel="time since release (ms)", ylabel="height (mm)", title=self.heading())
        ax.set_ylim(top=1.9 * ax.get_ylim()[1])
        pressed = np.flatnonzero(force.to_numpy() > 0.0)
        touch_s = t[max(pressed[0] - 1, 0)] if len(pressed) else t.iloc[0]
        lasted = self.contact_time_s or float(t.iloc[-1] - touch_s)
        inside = (t >= touch_s - 0.1 * lasted) & (t <= touch_s + 1.1 * lasted)
        inner = ax.inset_axes((0.42, 0.6, 0.55, 0.36))
        inner.plot(1e6 * (t[inside] - touch_s), force[inside], color="tab:red")
        inner.set_xlabel("time since touch (µs)", fontsize="small")
        inner.set_ylabel("force (N)", fontsize="small")
        inner.tick_params(labelsize="small")
        return ax


class Verdict(Record):
    """What the loop found: what verdict.json holds, by name."""

    verdict: str
    effects: list[str]
    weights: Record
    probabilities: Record
    in_words: list[str]
    detection: Record
    open_set: Record
    parameters: Record
    classes: list[list[str]]
    detectable: Record
    fit: Record
    noise: Record
    warnings: list[str]
    bookkeeping: list[Record]
    held_out: Record | None
    confirmed_in_3d: Record | None
    next_experiment: Record | None
    seed: int
    title: str

    def rows(self) -> list[tuple[str, str]]:
        from ..close_loop.run import summary

        return summary(self.to_dict())

    def heading(self) -> str:
        return self.title

    def plot(self, ax: Axes | None = None) -> Axes:
        """The error on held-out data before and after the effects found, beside the noise; without
        held-out data that of the fit."""
        ax = _axes(ax)
        if self.held_out:
            unit = self.held_out.unit
            names = {"before": "rms_before", "after": "rms_after", "noise": "noise"}
            bars = {name: self.held_out[key] for name, key in names.items()}
        else:
            unit, fit = "declared noise", self.fit
            bars = {"before": fit.rms_sigma_before, "after": fit.rms_sigma, "noise": 1.0}
        ax.bar(list(bars), list(bars.values()), color=["tab:red", "tab:blue", "lightgrey"])
        found = ", ".join(self.effects)
        ax.set(ylabel=f"rms error ({unit})", title=f"{self.verdict}{': ' if found else ''}{found}")
        return ax


class TimeSteps(Record):
    """The study of time steps, its.json by name.

    ``needs`` has the longest ITS that each quantity allows, ``errors`` the error of each step,
    ``table`` a row for each case; all are DataFrames.
    """

    needs: pd.DataFrame
    errors: pd.DataFrame
    table: pd.DataFrame
    _beside = ("needs", "errors", "table")

    def rows(self) -> list[tuple[str, str]]:
        return [
            (
                f"{row.model}, {row.kn_N_m:g} N/m",
                f"{row.quantity} {row.bound}{row.its_needed_s:.2g} s",
            )
            for row in self.needs.itertuples()
        ]

    def heading(self) -> str:
        return f"longest ITS for an error of {100 * GOAL:g} %"

    def plot(self, ax: Axes | None = None) -> Axes:
        """The longest ITS of each quantity over Kn."""
        ax = _axes(ax)
        for (model, quantity), rows in self.needs.groupby(["model", "quantity"], sort=False):
            least = rows.groupby("kn_N_m").its_needed_s.min()
            ax.loglog(least.index, least, marker="o", label=f"{QUANTITIES[quantity]}, {model}")
        ax.set(xlabel="Kn (N/m)", ylabel="longest ITS (s)", title=self.heading())
        ax.legend(fontsize="small")
        return ax


class Scatter(Record):
    """Drops by chance: scatter.json by name, and ``table``, a DataFrame with a row for each."""

    n_drops: int
    n_failed: int
    statistics: Record
    factors: Record
    warnings: list[str]
    table: pd.DataFrame
    _beside = ("table",)

    def rows(self) -> list[tuple[str, str]]:
        names = {"mean of y1/y0": "mean", "standard deviation": "std"}
        found = [
            (title, f"{each.estimate:.3f} ({each.low:.3f} to {each.high:.3f})")
            for title, name in names.items()
            if (each := self.statistics[name])
        ]
        return [*found, *(("doubt", each) for each in self.warnings)]

    def heading(self) -> str:
        return f"{self.n_drops} drops"

    def plot(self, ax: Axes | None = None) -> Axes:
        """The distribution of y1/y0 beside the measured mean and band."""
        ax = _axes(ax)
        ax.hist(self.table.rebound_ratio, bins="auto", density=True, color="tab:blue", alpha=0.6)
        ax.axvspan(*paper.RATIO_BAND_90, color="grey", alpha=0.2, label="measured, 90 %")
        ax.axvline(paper.RATIO_MEAN, color="black", linestyle="--", label="measured mean")
        ax.set(xlabel="y1/y0", ylabel="density", title=self.heading())
        ax.legend()
        return ax


class Brush(Record):
    """A brush: what result.json holds, by name.

    ``hub``, ``means`` and ``tips`` are DataFrames with the columns of hub.csv, means.csv and
    tips.csv.
    """

    inputs: Record
    n_bristles: int
    hub_at_first_touch_m: float
    steady_from_s: float
    window_s: float
    force_N: Record
    torque_Nm: Record
    tips_share: Record
    bending_stress: Record
    energy: Record
    n_steps: int
    warnings: list[str]
    wall_s: Record
    peak_rss_MB: float
    ranks: int
    hub: pd.DataFrame
    means: pd.DataFrame
    tips: pd.DataFrame
    _beside = ("hub", "means", "tips")

    def rows(self) -> list[tuple[str, str]]:
        from ..brush.run import summary

        return summary(self)

    def heading(self) -> str:
        return f"a brush of {self.n_bristles}, {self.inputs.layout}"

    def plot(self, ax: Axes | None = None) -> Axes:
        """The force on the hub over time, by component."""
        ax = _axes(ax)
        for axis in "xyz":
            ax.plot(self.means.to_s, self.means[f"f{axis}_N"], label=axis)
        ax.set(xlabel="time (s)", ylabel="force on the hub (N)", title=self.heading())
        ax.legend()
        return ax


class Calibration(Record):
    """Kn from measured drops: calibrate.json by name."""

    n_drops: int
    rebound_ratio: Record
    kn_N_m: Record
    kn_per_area_N_m3: float | None
    reachable_ratio: list[float]
    curve: Record
    warnings: list[str]

    @property
    def programs(self) -> pd.DataFrame:
        """Where other finite element programs take this Kn, and as which number; no rows where no
        Kn was found."""
        from ..calibrate.page import programs

        kn = self.kn_N_m.estimate
        return programs(kn, kn / self.kn_per_area_N_m3) if kn else programs(1.0, 1.0).iloc[:0]

    def rows(self) -> list[tuple[str, str]]:
        from ..calibrate.run import told

        where = {"where to enter these": "the table `programs`"}
        return [(name, where.get(name, text)) for name, text in told(self.to_dict())]

    def heading(self) -> str:
        return f"Kn from {self.source}"

    def plot(self, ax: Axes | None = None) -> Axes:
        """The model's y1/y0 over Kn, the measured band, and the Kn where they meet."""
        ax = _axes(ax)
        ax.semilogx(self.curve.kn_N_m, self.curve.rebound_ratio, color="black", label="model")
        ratio, kn = self.rebound_ratio, self.kn_N_m
        ax.axhspan(ratio.low, ratio.high, color="tab:blue", alpha=0.3, label="measured mean")
        if kn.estimate is not None:
            ax.axvline(kn.estimate, color="tab:red", label=f"Kn = {kn.estimate:.3g} N/m")
        ax.set(xlabel="Kn (N/m)", ylabel="y1/y0", title=self.heading())
        ax.legend()
        return ax


class InFolder(Record):
    """A record with a ``table``, a DataFrame, and the ``folder`` where the dataset lies, which is
    None where it was not written."""

    table: pd.DataFrame
    folder: Path | None
    _beside = ("table", "folder")


class Tracks(InFolder):
    """Tracked films: what track.json holds by name, and a ``table`` with the columns of
    tracks.csv."""

    unit: str
    films: list[Record]
    drops: list[Record]
    warnings: list[str]

    def rows(self) -> list[tuple[str, str]]:
        from ..track.run import told

        return told(self.to_dict())

    def heading(self) -> str:
        return f"tracks of {len(self.drops)} drops"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Heights over time since each drop's first frame."""
        ax = _axes(ax)
        for drop, rows in self.table.groupby("drop"):
            since = rows.t_s - rows.t_s.iloc[0]
            ax.plot(since, rows[f"y_{self.unit}"], ".", markersize=3, label=f"drop {drop}")
        ax.set(xlabel="time (s)", ylabel=f"height of the end ({self.unit})", title=self.heading())
        if len(self.drops) <= 8:
            ax.legend()
        return ax


class Dataset(InFolder):
    """A made dataset: its truth by name, and a ``table`` of what was measured."""

    effects: list[Record]

    def rows(self) -> list[tuple[str, str]]:
        hidden = [each.name for each in self.effects]
        if self.unlisted is not None:
            hidden.append(self.unlisted)
        return [
            ("drops", str(len(self.table))),
            ("measured", ", ".join(map(str, self.table.columns[1:]))),
            ("hidden in it", ", ".join(hidden) or "nothing"),
        ]

    def heading(self) -> str:
        return "a made dataset" if self.folder is None else str(self.folder)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Height after over height before."""
        ax = _axes(ax)
        ax.plot(self.table.y0_mm, self.table.y1_mm, "o", fillstyle="none")
        ax.set(xlabel="y0 (mm)", ylabel="y1 (mm)", title=self.heading())
        return ax


class Mesh(Record):
    """A mesh: its measures and quality by name, ``grid`` for PyVista."""

    spec: Record
    quality: Record
    grid: UnstructuredGrid
    _beside = ("grid",)

    def rows(self) -> list[tuple[str, str]]:
        return [(name, _short(value)) for name, value in self.quality.items()]

    def heading(self) -> str:
        return f"{self.quality.n_cells} hexahedra"

    def plot(self, ax: Axes | None = None) -> Axes:
        """The outline of the lowest cells, seen from the wide side."""
        ax = _axes(ax)
        edges = self.grid.extract_surface().extract_all_edges()
        points, lines = edges.points, edges.lines.reshape(-1, 3)[:, 1:]
        low = np.unique(np.round(points[:, 2], 9))[: min(24, len(points))][-1]
        shown = lines[(points[lines][:, :, 2] <= low).all(axis=1)]
        for a, b in 1e3 * points[shown]:
            ax.plot((a[1], b[1]), (a[2], b[2]), color="black", linewidth=0.5)
        ax.set(xlabel="across the wide side (mm)", ylabel="height (mm)", title=self.heading())
        return ax


def _axes(ax: Axes | None) -> Axes:
    """The Axes to draw on: those given, or new ones, which pyplot knows and nothing shows yet."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(layout="constrained")[1]


def _value(value: Any) -> Any:
    """A value of a JSON as Python has it: infinity is a number again, a mapping a `Record`."""
    if isinstance(value, Record):
        return value
    if isinstance(value, Mapping):
        return Record(value)
    if isinstance(value, list | tuple):
        return [_value(each) for each in value]
    return INFINITIES.get(value, value) if isinstance(value, str) else value


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
