"""Pictures and an animation of the wave in a solid bristle, and its space-time diagram."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from ...solver.arrays import Array
from ..report.figures import BLACK, BLUE, GREY, panels, styled
from .field_series import FieldSeries
from .wave import Wave

N_STILLS = 6
N_ANIMATED = 60
FRAME_MS = 100
LONGEST_GAP = 10.0
"""Time from frame to frame that is shown at most, in medians: a flight between touches has few
frames."""
TURNS = 8
"""Lengths of the bristle that the path of a wave is drawn along."""
ANIMATION_DPI = 110
COLOURS, TIP_COLOURS = "RdBu_r", "viridis"
OUTLINE, OUTLINE_POINTS = 0.35, 0.8
TIP_WIDTHS = 1.6
"""Length of bristle in the close-up, in widths of the section."""
TIP_FROM = (-1.0, -0.8, -0.6)
"""Toward the eye, along the bristle's axes: the tip is seen from below."""
SHARP_DEG = 45.0
"""Edges that turn by more are drawn."""
STRESS = "axial stress (MPa), pressure is negative"


@dataclass(frozen=True)
class Outside:
    """The outside of a mesh: its ``nodes`` (n,), and flat ``triangles`` (m, 3) between these,
    their corners counterclockwise as seen from outside."""

    nodes: NDArray[np.int64]
    triangles: NDArray[np.int64]

    @classmethod
    def of(cls, series: FieldSeries, below_m: float = np.inf) -> Outside:
        """Of the cells that lie below a height, each face split at its nodes."""
        nodes, cells = series.nodes_m, series.cells
        cells = cells[(nodes[cells, 2] <= below_m).all(axis=1)]
        counted = np.insert(cells, 0, cells.shape[1], axis=1).ravel()
        kinds = np.full(len(cells), series.cell_type, np.uint8)
        grid: Any = pyvista.UnstructuredGrid(counted, kinds, nodes)
        grid.point_data["node"] = np.arange(len(nodes), dtype=float)
        split = 1 if cells.shape[1] > 8 else 0
        surface = grid.extract_surface(nonlinear_subdivision=split).triangulate()
        node = np.round(surface.point_data["node"]).astype(np.int64)
        if np.abs(surface.points - nodes[node]).max() > 1e-6 * np.ptp(nodes):
            raise ValueError("the faces of the mesh are not split at their nodes")
        shown, places = np.unique(node[surface.regular_faces], return_inverse=True)
        return cls(shown, places.reshape(-1, 3))


@dataclass(frozen=True)
class Seen:
    """A surface as it is seen: ``places_m`` (n, 2) to the right and up, ``triangles`` (m, 3) that
    face the eye, the farthest first, and ``stress_Pa`` (n,)."""

    places_m: Array
    triangles: NDArray[np.int64]
    stress_Pa: Array

    @classmethod
    def of(cls, outside: Outside, places_m: Array, stress_Pa: Array, axes: Array) -> Seen:
        """Along ``axes`` (2, 3), to the right and up, of nodes at places (n, 3)."""
        flat, toward = places_m @ axes.T, places_m @ np.cross(*axes)
        one, other, third = np.moveaxis(flat[outside.triangles], 1, 0)
        (x, y), (a, b) = (other - one).T, (third - one).T
        facing = outside.triangles[x * b - y * a > 0.0]
        farthest_first = np.argsort(toward[facing].mean(axis=1), kind="stable")
        return cls(flat, facing[farthest_first], stress_Pa)

    def draw(self, plot: Axes, colours: ScalarMappable) -> list[Artist]:
        """Draw it in mm, behind the ground, with a grey rim: without stress it is all but white."""
        places = 1e3 * self.places_m
        rim = PolyCollection(
            list(places[self.triangles]),
            facecolors=str(OUTLINE),
            edgecolors=str(OUTLINE),
            linewidths=2.0 * OUTLINE_POINTS,
            rasterized=True,
            zorder=0.3,
        )
        plot.add_collection(rim)
        surface = plot.tripcolor(  # type: ignore[call-overload]
            *places.T,
            self.triangles,
            self.stress_Pa / 1e6,
            shading="gouraud",
            cmap=colours.cmap,
            norm=colours.norm,
            rasterized=True,
            zorder=0.4,
        )
        return [rim, surface]


def seen_from_the_side(series: FieldSeries, wave: Wave, frames: Iterable[int]) -> Iterator[Seen]:
    """The bristle at some frames as pictures show it, displacements and section enlarged.

    ``wave`` was read from ``series``. No more than a frame is held.
    """
    outside = Outside.of(series)
    nodes = series.nodes_m[outside.nodes]
    # up is z, and the lateral axis that is shown runs to the right
    axes = np.eye(3)[[wave.side, 2]]
    for frame in frames:
        moved = wave.stand.moved(nodes, series.read("displacement_m", frame)[outside.nodes])
        placed = wave.stand.drawn(nodes, moved, wave.exaggeration, wave.widenings)
        yield Seen.of(outside, placed, series.read("axial_stress_Pa", frame)[outside.nodes], axes)


def animated(count: int) -> list[int]:
    """Which of ``count`` frames the animation shows."""
    return sorted({round(float(place)) for place in np.linspace(0, count - 1, N_ANIMATED)})


def stills(times_s: Array) -> list[int]:
    """Which frames stand for all, in equal steps of the time that frames show."""
    frames = animated(len(times_s))
    times_s = times_s[frames]
    shown = np.minimum(np.diff(times_s), _longest_gap_s(times_s))
    clock = np.concatenate([[0.0], np.cumsum(shown)])
    instants = (np.arange(N_STILLS) + 0.5) / N_STILLS * clock[-1]
    return [frames[k] for k in np.unique(np.abs(clock[:, None] - instants).argmin(axis=0))]


def _longest_gap_s(times_s: Array) -> float:
    """Longest time from frame to frame that counts as one that frames show."""
    return LONGEST_GAP * float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


@styled
def space_time_figure(wave: Wave, bar_speed_m_s: float | None) -> Figure:
    """Axial stress on the axis over height and time, with the path of a wave in a thin bar.

    It ends where the bristle flies off so long that its frames do not show the wave.
    """
    figure, axes = panels(height_in=3.6)
    plot = axes[0, 0]
    colours = _colours(wave)
    gone = np.diff(wave.times_s) > _longest_gap_s(wave.times_s)
    end = int(np.argmax(gone)) + 1 if gone.any() else len(wave.times_s)
    time, z = wave.times_s[:end] * 1e6, wave.z_m * 1e3
    shading = "gouraud" if len(time) > 1 else "nearest"
    mesh = plot.pcolormesh(
        z,
        time,
        wave.axial_stress_Pa[:end] / 1e6,
        cmap=colours.cmap,
        norm=colours.norm,
        shading=shading,
        rasterized=True,
    )
    if bar_speed_m_s:
        _wave_path(plot, wave, bar_speed_m_s)
    released = [t for t, phase in zip(time, wave.phases, strict=False) if phase == "release"]
    for number, t in enumerate(released):
        label = "release" if number == 0 else None
        plot.axhline(t, color=GREY, linewidth=0.8, linestyle=":", label=label)
    plot.set(xlim=(z[0], z[-1]), ylim=(min(time[0], 0.0), time[-1]))
    plot.set(xlabel="height above the tip (mm)", ylabel="time since touch (µs)")
    if plot.get_legend_handles_labels()[0]:
        figure.legend(loc="outside upper left", ncols=2)
    figure.colorbar(mesh, ax=plot, label=STRESS)
    return figure


def _wave_path(plot: Axes, wave: Wave, speed_m_s: float) -> None:
    """Up and down again at the bar's speed, from the touch on."""
    length, end = wave.size_m[2], wave.times_s[-1]
    turns = np.arange(min(int(end * speed_m_s / length) + 1, TURNS) + 1)
    plot.plot(
        1e3 * length * (turns % 2),
        1e6 * turns * length / speed_m_s,
        color=BLACK,
        linewidth=0.8,
        linestyle="--",
        label="speed of a thin bar",
    )


@styled
def stills_figure(series: FieldSeries, wave: Wave) -> Figure:
    """The bristle at some instants side by side, true to a scale in each direction."""
    frames = stills(wave.times_s)
    figure, axes = panels(1, len(frames), height_in=4.6, sharey=True)
    bristles = seen_from_the_side(series, wave, frames)
    for plot, frame, bristle in zip(axes[0], frames, bristles, strict=True):
        _show_bristle(plot, wave, bristle)
        plot.set_title(_instant(wave.times_s[frame]), loc="center")
    axes[0, 0].set_ylabel(_height_label(wave))
    figure.colorbar(_colours(wave), ax=axes, label=STRESS)
    figure.suptitle("Time since touch", x=0.02, ha="left", fontsize=9.0)
    return figure


@styled
def tip_figure(series: FieldSeries, wave: Wave) -> Figure:
    """The tip in true proportions when its stress is greatest."""
    nodes, frame = series.nodes_m, wave.tip_frame
    width = float(np.ptp(nodes[:, :2], axis=0).max())
    layer = float(np.ptp(nodes[series.cells, 2], axis=1).max())
    outside = Outside.of(series, TIP_WIDTHS * width + layer)
    nodes = nodes[outside.nodes]
    displacement = series.read("displacement_m", frame)[outside.nodes]
    placed = nodes + wave.tip_stand.moved(nodes, displacement)
    right = np.cross([0.0, 0.0, 1.0], TIP_FROM)
    axes = np.array([right, np.cross(TIP_FROM, right)])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    stress = series.read("von_mises_Pa", frame)[outside.nodes]
    tip = Seen.of(outside, placed, stress, axes)

    figure, plots = panels(height_in=4.2)
    plot = plots[0, 0]
    limit = float(wave.tip_von_mises_Pa[frame]) / 1e6 or 1.0
    colours = ScalarMappable(Normalize(0.0, limit), TIP_COLOURS)
    tip.draw(plot, colours)
    faces: Any = tip.triangles
    surface: Any = pyvista.PolyData.from_regular_faces(placed, faces)
    edges = surface.extract_feature_edges(SHARP_DEG)
    lines = (1e3 * np.asarray(edges.points) @ axes.T)[edges.lines.reshape(-1, 3)[:, 1:]]
    plot.add_collection(LineCollection(list(lines), colors=BLACK, linewidths=0.7))
    plot.set_aspect("equal", adjustable="datalim")
    plot.set_axis_off()
    when = _instant(wave.times_s[frame])
    plot.set_title(f"The tip in true proportions, from below, {when} after touch")
    figure.colorbar(colours, ax=plot, label="von Mises stress (MPa)")
    return figure


def _show_bristle(plot: Axes, wave: Wave, bristle: Seen) -> list[Artist]:
    """Draw it on its ground; returns what is the bristle."""
    drawn = bristle.draw(plot, _colours(wave))
    left, right, bottom, top = (1e3 * edge for edge in wave.window_m)
    ends = np.array([left, right])
    ground = 1e3 * wave.ground_m(1e-3 * ends)
    plot.fill_between(ends, ground, bottom, color="#dddddd", zorder=0.5, linewidth=0)
    plot.plot(ends, ground, color=BLACK, linewidth=1.0)
    plot.set(xlim=(left, right), ylim=(bottom, top), xlabel="xy"[wave.side] + " (mm)")
    plot.xaxis.set_major_locator(MaxNLocator(nbins=2, prune="both", steps=[1, 2, 5, 10]))
    return drawn


def _instant(time_s: float) -> str:
    return f"{1e6 * time_s:.0f} µs" if time_s < 0.01 else f"{1e3 * time_s:.1f} ms"


def _height_label(wave: Wave) -> str:
    scale = f"displacement × {wave.exaggeration:g}"
    if wave.widening > 1.0:
        scale += f", width × {wave.widening:g}"
    return f"height (mm), {scale}"


def _colours(wave: Wave) -> ScalarMappable:
    limit = wave.greatest_axial_Pa / 1e6 or 1.0
    return ScalarMappable(Normalize(-limit, limit), COLOURS)


@styled
def _animation_figure(wave: Wave) -> Figure:
    """An empty frame of the animation: the bristle, and the stress on its axis beside it."""
    figure, axes = panels(1, 2, height_in=4.4, width_ratios=[1, 2.4])
    bristle, profile = axes[0]
    bristle.set_ylabel(_height_label(wave))
    profile.plot(np.zeros_like(wave.z_m), wave.z_m * 1e3, color=BLUE)
    profile.axvline(0.0, color=GREY, linewidth=0.7)
    colours = _colours(wave)
    profile.set(xlim=1.05 * np.array(colours.get_clim()), ylim=(0.0, wave.z_m[-1] * 1e3))
    profile.set(xlabel="axial stress on the axis (MPa)", ylabel="height above the tip (mm)")
    figure.colorbar(colours, ax=bristle, label=STRESS)
    figure.suptitle(" ", fontsize=9.0)
    return figure


def animate(
    series: FieldSeries, wave: Wave, gif: Path, advance: Callable[[], None] = lambda: None
) -> None:
    """Write the bristle beside the stress on its axis, frame after frame, as a GIF that repeats.

    ``wave`` was read from ``series``; ``advance`` is called for each frame.
    """
    frames = animated(len(wave.times_s))
    figure = _animation_figure(wave)
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(ANIMATION_DPI)
    plot, profile, _ = figure.axes
    title, pictures = figure.texts[0], []
    drawn: list[Artist] = []
    for frame, bristle in zip(frames, seen_from_the_side(series, wave, frames), strict=True):
        if drawn:
            for artist in drawn:
                artist.remove()
            drawn = bristle.draw(plot, _colours(wave))
        else:
            drawn = _show_bristle(plot, wave, bristle)
            canvas.draw()
            # the layout is settled, and settling it anew for each frame would take longer than all
            figure.set_layout_engine("none")
        profile.lines[0].set_xdata(wave.axial_stress_Pa[frame] / 1e6)
        phase = f", {wave.phases[frame]}" if frame < len(wave.phases) else ""
        title.set_text(f"{_instant(wave.times_s[frame])} after touch{phase}")
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        advance()
    write_gif(pictures, gif)


def write_gif(pictures: list[NDArray[np.uint8]], gif: Path) -> None:
    """Write pictures (height, width, 3) as a GIF that repeats, all in the same 256 colours.

    One palette for all keeps colours from flickering, and takes a tenth of the time of one each.
    Every tone of the stress has its share of it, however seldom it is.
    """
    tones = colormaps[COLOURS](np.linspace(0.0, 1.0, pictures[0].shape[1]))[:, :3]
    tones = np.tile((255.0 * tones).round().astype(np.uint8), (pictures[0].shape[0], 1, 1))
    sample = Image.fromarray(np.concatenate([tones, *pictures[:: max(1, len(pictures) // 8)]]))
    palette = sample.quantize(256)
    frames = [
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    ]
    frames[0].save(
        gif, format="GIF", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0
    )
