"""Stills and an animation of the wave in a solid bristle, and its diagram over height and time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from ..report.figures import BLACK, BLUE, GREY, panels, styled
from .bristle_drawing import COLOURS, TIP_COLOURS, Drawing, Pixels, draw_bristle
from .field_series import Array, FieldSeries
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
WIDTH_TO_HEIGHT = 0.16
STRESS = "axial stress (MPa), pressure is negative"


def plan_drawing(wave: Wave) -> tuple[Drawing, list[int]]:
    """What to draw of a wave, and which of the drawn frames are the stills."""
    frames = animated(len(wave.times_s))
    drawing = Drawing(
        frames=list(map(int, frames)),
        side=wave.side,
        window_m=wave.window_m,
        width_to_height=WIDTH_TO_HEIGHT,
        exaggeration=wave.exaggeration,
        widening=wave.widening,
        limit_Pa=wave.greatest_axial_Pa or 1.0,
        tip_frame=wave.tip_frame,
        tip_limit_Pa=float(wave.tip_von_mises_Pa[wave.tip_frame]) or 1.0,
    )
    return drawing, _stills(wave.times_s[frames])


def animated(count: int) -> NDArray[np.intp]:
    """Which of ``count`` frames the animation shows."""
    return np.unique(np.linspace(0, count - 1, N_ANIMATED).round().astype(np.intp))


def _stills(times_s: Array) -> list[int]:
    """Which frames stand for all, in equal steps of the time that frames show."""
    shown = np.minimum(np.diff(times_s), _longest_gap_s(times_s))
    clock = np.concatenate([[0.0], np.cumsum(shown)])
    instants = (np.arange(N_STILLS) + 0.5) / N_STILLS * clock[-1]
    return np.unique(np.abs(clock[:, None] - instants).argmin(axis=0)).tolist()


def _longest_gap_s(times_s: Array) -> float:
    """Longest time from frame to frame that counts as one that frames show."""
    return LONGEST_GAP * float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


def draw_wave(
    series: FieldSeries, wave: Wave, folder: Path, advance: Callable[[], None] = lambda: None
) -> dict[str, Figure]:
    """Draw ``wave``, which was read from ``series``: figures by name, wave.gif in ``folder``.

    ``advance`` is called twice for each frame of the animation.

    Raises
    ------
    DrawingError : there is no display, or drawing failed
    """
    drawing, stills = plan_drawing(wave)
    images, tip = draw_bristle(series, wave, drawing, advance)
    animate(wave, drawing, images, folder / "wave.gif", advance)
    return {
        "wave": stills_figure(wave, drawing, [(drawing.frames[i], images[i]) for i in stills]),
        "tip-stress": tip_figure(wave, drawing, tip),
    }


@styled
def space_time_figure(wave: Wave, bar_speed_m_s: float | None) -> Figure:
    """Axial stress on the axis over height and time, with the path of a wave in a thin bar.

    It ends where the bristle flies off so long that its frames do not show the wave.
    """
    figure, axes = panels(height_in=3.6)
    plot = axes[0, 0]
    limit = wave.greatest_axial_Pa / 1e6 or 1.0
    gone = np.diff(wave.times_s) > _longest_gap_s(wave.times_s)
    end = int(np.argmax(gone)) + 1 if gone.any() else len(wave.times_s)
    time, z = wave.times_s[:end] * 1e6, wave.z_m * 1e3
    shading = "gouraud" if len(time) > 1 else "nearest"
    mesh = plot.pcolormesh(
        z,
        time,
        wave.axial_stress_Pa[:end] / 1e6,
        cmap=COLOURS,
        vmin=-limit,
        vmax=limit,
        shading=shading,
        rasterized=True,
    )
    if bar_speed_m_s:
        _wave_path(plot, wave, bar_speed_m_s)
    released = [t for t, phase in zip(time, wave.phases, strict=False) if phase == "release"]
    for number, t in enumerate(released):
        label = "release" if number == 0 else None
        plot.axhline(t, color=GREY, linewidth=0.8, linestyle=":", label=label)
    plot.set_xlim(z[0], z[-1])
    plot.set_ylim(min(time[0], 0.0), time[-1])
    plot.set_xlabel("height above the tip (mm)")
    plot.set_ylabel("time since touch (µs)")
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
def stills_figure(wave: Wave, drawing: Drawing, stills: list[tuple[int, Pixels]]) -> Figure:
    """The bristle at some instants side by side, true to a scale in each direction."""
    figure, axes = panels(1, len(stills), height_in=4.6, sharey=True)
    for plot, (frame, image) in zip(axes[0], stills, strict=True):
        _show_bristle(plot, wave, drawing, image)
        plot.set_title(_instant(wave.times_s[frame]), loc="center")
        plot.set_xlabel("xy"[drawing.side] + " (mm)")
    axes[0, 0].set_ylabel(_height_label(drawing))
    figure.colorbar(_colours(drawing), ax=axes, label=STRESS)
    figure.suptitle("Time since touch", x=0.02, ha="left", fontsize=9.0)
    return figure


@styled
def tip_figure(wave: Wave, drawing: Drawing, image: Pixels) -> Figure:
    """The tip in true proportions when its stress is greatest."""
    figure, axes = panels(height_in=4.2)
    plot = axes[0, 0]
    plot.imshow(image)
    plot.set_axis_off()
    when = _instant(wave.times_s[drawing.tip_frame])
    plot.set_title(f"The tip in true proportions, from below, {when} after touch")
    colours = ScalarMappable(Normalize(0.0, drawing.tip_limit_Pa / 1e6), TIP_COLOURS)
    figure.colorbar(colours, ax=plot, label="von Mises stress (MPa)")
    return figure


def _show_bristle(plot: Axes, wave: Wave, drawing: Drawing, image: Pixels) -> None:
    left, right, bottom, top = (1e3 * edge for edge in drawing.window_m)
    plot.imshow(image, extent=(left, right, bottom, top), aspect="auto")
    ends = np.array([left, right])
    ground = 1e3 * wave.ground_m(1e-3 * ends)
    plot.fill_between(ends, ground, bottom, color="#dddddd", zorder=0.5, linewidth=0)
    plot.plot(ends, ground, color=BLACK, linewidth=1.0)
    plot.set_ylim(bottom, top)
    plot.set_xlim(left, right)
    plot.xaxis.set_major_locator(MaxNLocator(nbins=2, prune="both", steps=[1, 2, 5, 10]))


def _instant(time_s: float) -> str:
    return f"{1e6 * time_s:.0f} µs" if time_s < 0.01 else f"{1e3 * time_s:.1f} ms"


def _height_label(drawing: Drawing) -> str:
    scale = f"displacement × {drawing.exaggeration:g}"
    if drawing.widening > 1.0:
        scale += f", width × {drawing.widening:g}"
    return f"height (mm), {scale}"


def _colours(drawing: Drawing) -> ScalarMappable:
    limit = drawing.limit_Pa / 1e6
    return ScalarMappable(Normalize(-limit, limit), COLOURS)


@styled
def _animation_figure(wave: Wave, drawing: Drawing, image: Pixels) -> Figure:
    """One frame of the animation, drawn for the first frame; its artists are then updated."""
    figure, axes = panels(1, 2, height_in=4.4, width_ratios=[1, 2.4])
    bristle, profile = axes[0]
    _show_bristle(bristle, wave, drawing, image)
    bristle.set_xlabel("xy"[drawing.side] + " (mm)")
    bristle.set_ylabel(_height_label(drawing))
    limit = 1.05 * drawing.limit_Pa / 1e6
    profile.plot(np.zeros_like(wave.z_m), wave.z_m * 1e3, color=BLUE)
    profile.axvline(0.0, color=GREY, linewidth=0.7)
    profile.set_xlim(-limit, limit)
    profile.set_ylim(0.0, wave.z_m[-1] * 1e3)
    profile.set_xlabel("axial stress on the axis (MPa)")
    profile.set_ylabel("height above the tip (mm)")
    figure.colorbar(_colours(drawing), ax=bristle, label=STRESS)
    figure.suptitle(" ", fontsize=9.0)
    return figure


def animate(
    wave: Wave,
    drawing: Drawing,
    images: list[Pixels],
    gif: Path,
    advance: Callable[[], None] = lambda: None,
) -> None:
    """Write the bristle beside the stress on its axis, frame after frame, as a GIF that repeats.

    ``advance`` is called for each frame.
    """
    figure = _animation_figure(wave, drawing, images[0])
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(ANIMATION_DPI)
    bristle, profile, _ = figure.axes
    canvas.draw()
    # the layout is settled, and settling it anew for each frame would take longer than drawing
    figure.set_layout_engine("none")
    title, pictures = figure.texts[0], []
    for frame, image in zip(drawing.frames, images, strict=True):
        bristle.images[0].set_data(image)
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
