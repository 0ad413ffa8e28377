"""A dragged bristle by the rod of `bristle brush` and by a clamped 3-D solid, side by side."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from mpi4py import MPI

from ...solver.arrays import Array
from ...solver.clamped import ClampedSolid, RodState
from ...solver.rods.hub import HubPath
from ...solver.rods.rods import Rods
from ...solver.rods.section import RodSection
from ..brush.inputs import BrushInputs
from ..brush.motion import X, Z, stroke
from ..inputs.sources import checked
from ..report.figures import BLACK, SERIES, drawing
from ..report.page import Head, Section
from .campaign import Labels, Results, Study, prose

# The window: pressed further by so much within so long, then raised at this speed, which the hub
# reaches within so long.
PRESS_M, PRESS_S = 1e-4, 2e-3
RAISE_M_S, RAMP_S = 1.0, 2e-3
UNTIL_S, STEP_S = 5e-3, 2e-5
# The drag before it, at whose end the bristle has come to rest relative to the hub but for a slow
# oscillation.
START_S, DRAG_S = 0.2, 0.3
HEADS: dict[str, Head] = {
    "t_ms": ("time", "ms", 2),
    "rod_x_mm": ("tip x, rod", "mm", 4),
    "solid_x_mm": ("tip x, solid", "mm", 4),
    "rod_z_mm": ("tip z, rod", "mm", 4),
    "solid_z_mm": ("tip z, solid", "mm", 4),
    "rod_fx_N": ("hub force x, rod", "N", 4),
    "solid_fx_N": ("x, solid", "N", 4),
    "rod_fz_N": ("hub force z, rod", "N", 4),
    "solid_fz_N": ("z, solid", "N", 4),
    "rod_normal_N": ("tip's normal force, rod", "N", 4),
    "solid_normal_N": ("solid", "N", 4),
}


def pressed_dragged_let_go() -> BrushInputs:
    """The paper's bristle leans by 30°, is pressed by a fifth of its length, and dragged at 1 m/s
    with some damping, without weight."""
    return checked(
        BrushInputs,
        {
            "mount_angle_deg": 30.0,
            "penetration_m": 0.0673,
            "motion": "slide:speed=1",
            "gravity_m_s2": 0.0,
            "alpha_1_s": 5.0,
            "start_s": START_S,
            "until_s": DRAG_S + UNTIL_S,
            "elements": 80,
            "tolerance": 1e-7,
        },
    )


def window_path(inputs: BrushInputs) -> HubPath:
    """The hub's path: the drag of ``inputs`` up to the window, and the window."""
    drag = inputs.hub_motion
    here, starts = drag.pose(DRAG_S), np.array([0.0, PRESS_S, PRESS_S + RAMP_S])
    press = stroke(0.0, PRESS_M, PRESS_S, 0.0, 0.0).coefficients[:, :1]
    lift = stroke(0.0, 0.0, RAMP_S, RAISE_M_S, 0.0).coefficients[..., [Z, 1, X, 3, 4, 5]]
    lift[-1, :, Z] -= PRESS_M
    window = np.concatenate([press, lift], axis=1)
    window[-1, :, :3] += here.position_m + starts[:, None] * here.velocity_m_s
    window[-2, :, :3] += here.velocity_m_s
    return HubPath(
        np.concatenate([drag.breaks[:-1], DRAG_S + np.append(starts, starts[-1] + 1.0)]),
        np.concatenate([drag.coefficients, window], axis=1),
    )


@dataclass(frozen=True)
class Window:
    """Rod and solid over one window: tips (n, 3) in m, forces and torques on the hub (n, 3), the
    tip's normal force (n,) in N, at times ``t_s`` (n,) since the window's begin."""

    t_s: Array
    tip_m: tuple[Array, Array]
    force_N: tuple[Array, Array]
    torque_Nm: tuple[Array, Array]
    normal_N: tuple[Array, Array]

    @property
    def tip_error(self) -> float:
        """The greatest distance between the tips, as a share of the path of the solid's."""
        rod, solid = self.tip_m
        path = np.linalg.norm(np.diff(solid, axis=0), axis=1).sum()
        return float(np.linalg.norm(rod - solid, axis=1).max() / path)

    @property
    def force_error(self) -> float:
        """The greatest difference of the hub's force, as a share of the greatest force."""
        return _apart(*self.force_N)

    @property
    def torque_error(self) -> float:
        """The greatest difference of the hub's torque, as a share of the greatest torque."""
        return _apart(*self.torque_Nm)

    @property
    def normal_error(self) -> float:
        """The root of the mean square difference of the normal forces, as a share of theirs."""
        rod, solid = self.normal_N
        return float(np.linalg.norm(rod - solid) / np.linalg.norm(solid))

    @property
    def gone_s(self) -> tuple[float, float]:
        """When the tip is let go, by rod and solid; infinite where it is not."""
        found = [self.t_s[force == 0.0] for force in self.normal_N]
        rod, solid = (float(t[0]) if len(t) else float("inf") for t in found)
        return rod, solid

    def frame(self) -> pd.DataFrame:
        """A row an instant, as the page shows it; the x of tips counts from the solid's first."""
        (rod, solid), first = self.tip_m, self.tip_m[1][0, 0]
        (rod_N, solid_N), (rod_n, solid_n) = self.force_N, self.normal_N
        columns = (
            *(1e3 * self.t_s, 1e3 * (rod[:, 0] - first), 1e3 * (solid[:, 0] - first)),
            *(1e3 * rod[:, Z], 1e3 * solid[:, Z]),
            *(rod_N[:, 0], solid_N[:, 0], rod_N[:, Z], solid_N[:, Z], rod_n, solid_n),
        )
        return pd.DataFrame(dict(zip(HEADS, columns, strict=True)))


def _apart(rod: Array, solid: Array) -> float:
    apart = np.linalg.norm(rod - solid, axis=1).max()
    return float(apart / np.linalg.norm(solid, axis=1).max())


def compare(
    inputs: BrushInputs | None = None,
    cells: tuple[int, int, int] = (1, 1, 120),
    until_s: float = UNTIL_S,
    step_s: float = STEP_S,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> Window:
    """March rod and solid through the window; collective, and the same on every rank.

    The drag before it is the rod's alone. The solid begins with the rod's velocities and in
    equilibrium with its inertia.
    """
    inputs = inputs or pressed_dragged_let_go()
    path, ground, bristle = window_path(inputs), inputs.ground, inputs.bristle()
    rods = Rods(
        RodSection.of(bristle),
        inputs.clamps,
        path,
        ground,
        inputs.elements,
        gravity_m_s2=inputs.gravity_m_s2,
        bow_rad=0.0,
        tolerance=inputs.tolerance,
        comm=MPI.COMM_SELF,
    )
    rods.advance(DRAG_S)
    solid = ClampedSolid(
        bristle,
        inputs.clamps,
        path,
        ground,
        cells,
        t_s=DRAG_S,
        gravity_m_s2=inputs.gravity_m_s2,
        comm=comm,
    )
    try:
        solid.settle(RodState.of(rods.checkpoint()))
        seen = [(rods.frame(), solid.state())]
        for _ in range(round(until_s / step_s)):
            solid.step(step_s)
            rods.advance(solid.t_s)
            seen.append((rods.frame(), solid.state()))
    finally:
        solid.close()
    return Window(
        np.array([now.t_s - DRAG_S for _, now in seen]),
        _both([(rod.tip_m[0], now.tip_m) for rod, now in seen]),
        _both([(rod.force_N, now.force_N) for rod, now in seen]),
        _both([(rod.torque_Nm, now.torque_Nm) for rod, now in seen]),
        _both([(rod.tip_normal_N[0], now.normal_N) for rod, now in seen]),
    )


def _both(pairs: list[tuple[Array, Array]] | list[tuple[float, float]]) -> tuple[Array, Array]:
    rod, solid = zip(*pairs, strict=True)
    return np.array(rod), np.array(solid)


@dataclass
class Dragged(Study):
    """The section of `bristle reproduce`: the rod of a brush beside the clamped solid."""

    cells: tuple[int, int, int] = (1, 1, 120)
    until_s: float = UNTIL_S
    inputs: BrushInputs = field(default_factory=pressed_dragged_let_go)

    def prepare(self, comm: MPI.Intracomm) -> None:
        self._window = compare(self.inputs, self.cells, self.until_s, comm=comm)

    def section(self, results: Results) -> Section:
        found = self._window
        frame = found.frame()
        draft = prose("dragged", found=found, cells=self.cells, elements=self.inputs.elements)
        table = draft.data("dragged", frame, HEADS)
        draft.figure("dragged_tip", tip_figure(frame), table)
        draft.figure("dragged_force", force_figure(frame), table)
        draft.figure("dragged_normal", normal_figure(frame), table)
        return draft.section()


# The solid's line lies under the rod's.
SOLID: Labels = {"lw": 3.5, "alpha": 0.4}


@drawing("tip's way along the plane (mm)", "tip's height (mm)")
def tip_figure(ax: Axes, frame: pd.DataFrame) -> None:
    """The tips' paths."""
    ax.plot(frame.solid_x_mm, frame.solid_z_mm, color=SERIES[0], label="solid", **SOLID)
    ax.plot(frame.rod_x_mm, frame.rod_z_mm, color=BLACK, lw=1.0, label="rod")


@drawing("time (ms)", "force on the hub (N)")
def force_figure(ax: Axes, frame: pd.DataFrame) -> None:
    """Two components of the hub's force over time."""
    for component, colour in (("x", SERIES[0]), ("z", SERIES[1])):
        key = f"f{component}_N"
        ax.plot(
            *(frame.t_ms, frame[f"solid_{key}"]), color=colour, label=f"{component}, solid", **SOLID
        )
        ax.plot(frame.t_ms, frame[f"rod_{key}"], color=colour, lw=1.0, label=f"{component}, rod")


@drawing("time (ms)", "normal force on the tip (mN)", ylim=(0.0, None))
def normal_figure(ax: Axes, frame: pd.DataFrame) -> None:
    """What the plane does to the tip over time."""
    ax.plot(frame.t_ms, 1e3 * frame.solid_normal_N, color=SERIES[0], label="solid", **SOLID)
    ax.plot(frame.t_ms, 1e3 * frame.rod_normal_N, color=BLACK, lw=1.0, label="rod")
