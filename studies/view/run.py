"""Pictures and an animation of the result of a drop or a brush."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.arrays import Array
from ...solver.contact_phase import HISTORY_COLUMNS
from ...solver.errors import InputError
from ...solver.paraview import SOLID_FILE
from ..data.tables import column, read_table
from ..inputs.texts import exists, parse_json, read_text
from ..report.figures import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SMALLEST,
    VERMILION,
    beside,
    panels,
    picture,
    picture_files,
    styled,
    write_picture,
)
from ..running.files import filled, new_folders, prepare_folder, remove
from ..running.progress import note, progress
from ..running.results import HISTORY_FILE, RESULT_FILE, SCRIPT_FILE

if TYPE_CHECKING:
    from .wave import Wave

FIELDS_FOLDER, VIEW_FOLDER, MEANS_FILE = "fields", "view", "means.csv"
HISTORY, WAVE, TIP_STRESS, SPACE_TIME = "history", "wave", "tip-stress", "space-time"
LOADS, SHAPE = "loads", "shape"
ANIMATION, BRUSH_FILM = "wave.gif", "brush.mp4"
# Beside the first impact in a picture of its history, as a share of it.
MARGIN = 0.1
# All that is drawn.
FILES = (
    *(name for stem in (HISTORY, WAVE, TIP_STRESS, SPACE_TIME) for name in picture_files(stem)),
    *(name for stem in (LOADS, SHAPE) for name in picture_files(stem)),
    *(ANIMATION, BRUSH_FILM),
)


def run_view(
    result_dir: Path, out: Path | None = None, comm: MPI.Intracomm = MPI.COMM_WORLD
) -> list[Path]:
    """Draw the result of a drop or a brush; returns what was written, the same on every rank.
    Collective.

    Into ``out`` (``view`` in the result's folder, where it is left out) come ``history`` (.svg and
    .png), and for a solid with fields ``space-time``, ``wave``, ``tip-stress`` (each .svg and
    .png) and ``wave.gif``; ``open_in_paraview.py`` comes into the result's own folder, beside the
    fields. Of a brush come ``loads``, and with fields ``shape`` (each .svg and .png) and
    ``brush.mp4``. What was there before is replaced when everything is drawn.

    Raises
    ------
    InputError : there is no result, a file of it is not what this program writes, or one that would
        be replaced is not the program's
    """
    result = Path(result_dir)
    target = Path(out) if out is not None else result / VIEW_FOLDER
    return run_on_one_rank(comm, lambda: _view(result, target))


def _view(result: Path, target: Path) -> list[Path]:
    document = read_result(result)
    with new_folders(target):
        if "n_bristles" in document:
            return _view_brush(result, target)
        return _view_drop(result, target, document)


def _view_drop(result: Path, target: Path, document: dict[str, Any]) -> list[Path]:
    """Draw a drop into the folder ``target``; returns the files."""
    history = read_history(result / HISTORY_FILE)
    solid = (result / FIELDS_FOLDER).is_dir()
    if solid:
        from .paraview_state import write_state_script

        prepare_folder(result, SCRIPT_FILE)
    prepare_folder(target, *FILES)
    touch_s, wave = touch_time_s(history), None
    with filled(target) as folder:
        remove(*(target / name for name in FILES))
        write_picture(folder / HISTORY, picture(history_figure(history, document)))
        if solid:
            wave = _view_fields(result, document, touch_s, folder)
        else:
            note(f"{result} has no fields: for pictures of the wave, drop it with --model solid")
        written = [target / name for name in sorted(path.name for path in folder.iterdir())]
    if wave is not None:
        written.append(write_state_script(result, FIELDS_FOLDER, wave, touch_s))
    return written


def read_result(result: Path) -> dict[str, Any]:
    """The result.json of a folder. Raises InputError where there is none, or it is none."""
    path = result / RESULT_FILE
    if not result.is_dir():
        raise InputError(f"{result}: there is no such folder")
    if not exists(path):
        raise InputError(f"{result}: no {RESULT_FILE} here: this is no result of a drop or a brush")
    document = parse_json(path, read_text(path))
    if not isinstance(document, dict) or not {"model", "n_bristles"} & document.keys():
        raise InputError(f"{path}: not a result of a drop or a brush: it names no model")
    return document


def read_history(path: Path) -> dict[str, Array]:
    """The columns of a history.csv. Raises InputError that names the file and the line."""
    rows = read_table(path, HISTORY_COLUMNS)
    return {name: column(path, rows, name) for name in HISTORY_COLUMNS}


def touch_time_s(history: dict[str, Array]) -> float:
    """When the tip came to the plane: the time of the last row before there was a force."""
    pressed = np.flatnonzero(history["force_N"] > 0.0)
    return float(history["t_s"][max(pressed[0] - 1, 0)] if len(pressed) else history["t_s"][0])


@styled
def history_figure(history: dict[str, Array], document: dict[str, Any]) -> Figure:
    """Heights over the whole drop; force and penetration over the first impact."""
    figure, axes = panels(3, 1, height_in=6.0)
    height, force, depth = axes[:, 0]
    t = history["t_s"] * 1e3
    height.plot(t, history["tip_y_m"] * 1e3, color=BLUE, label="lower tip")
    height.plot(
        t, history["cm_y_m"] * 1e3, color=ORANGE, linestyle="--", label="centre of mass, as it fell"
    )
    height.axhline(0.0, color=BLACK, linewidth=0.7)
    height.set(xlabel="time since release (ms)", ylabel="height (mm)", title=_title(document))
    height.set_ylim(top=1.3 * height.get_ylim()[1])
    height.legend(loc="upper right", ncols=2)
    start = touch_time_s(history)
    lasted = float(document.get("contact_time_s") or 0.0)
    end = start + lasted if lasted > 0.0 else float(history["t_s"][-1])
    room = MARGIN * (end - start)
    inside = (history["t_s"] >= start - room) & (history["t_s"] <= end + room)
    since = (history["t_s"][inside] - start) * 1e6
    marker = {"marker": "o", "markersize": 2.5}
    force.plot(since, history["force_N"][inside], color=VERMILION, **marker)
    depth.plot(since, history["penetration_m"][inside] * 1e6, color=BLUE, **marker)
    for plot, label in ((force, "contact force (N)"), (depth, "penetration (µm)")):
        plot.set(xlim=(-1e6 * room, 1e6 * (end - start + room)), ylim=(0.0, None))
        plot.set(xlabel="time since touch (µs)", ylabel=label)
        plot.axvline(1e6 * (end - start), color=GREY, linewidth=0.8, linestyle=":")
    at = 1e6 * (end - start), 1.0
    where: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "fontsize": SMALLEST}
    beside(force, "last release", at, "right", above=False, color=GREY, **where)
    return figure


def _title(document: dict[str, Any]) -> str:
    inputs = document.get("inputs") or {}
    parts = [f"{document.get('model', '')} model, {document.get('contact', '')} contact"]
    if isinstance(inputs.get("kn_N_m"), int | float):
        parts.append(f"Kn {inputs['kn_N_m'] / 1e6:g} MN/m")
    if isinstance(inputs.get("height_m"), int | float):
        parts.append(f"from {inputs['height_m'] * 1e3:g} mm")
    return ", ".join(parts)


def _view_brush(result: Path, target: Path) -> list[Path]:
    """Draw a brush into the folder ``target``; returns the files."""
    from .brush_pictures import BrushSeries, filmed, load_figure, read_means, write_film

    means, fields = read_means(result / MEANS_FILE), result / FIELDS_FOLDER
    series = BrushSeries.of(fields) if fields.is_dir() else None
    prepare_folder(target, *FILES)
    with filled(target) as folder:
        remove(*(target / name for name in FILES))
        write_picture(folder / LOADS, picture(load_figure(means)))
        if series is None:
            note(f"{result} has no fields: for a film, compute the brush without --no-fields")
        else:
            count = 2 * len(filmed(len(series.times_s)))
            with progress("film of the brush, frames", count) as advance:
                last = write_film(series, means, folder / BRUSH_FILM, advance)
            write_picture(folder / SHAPE, picture(last))
        return [target / name for name in sorted(path.name for path in folder.iterdir())]


def _view_fields(result: Path, document: dict[str, Any], touch_s: float, folder: Path) -> Wave:
    """Fill ``folder`` with the pictures of a solid; returns the wave that they show."""
    from .field_series import FieldSeries
    from .pictures import animate, animated, space_time_figure, stills_figure, tip_figure
    from .wave import read_wave

    with FieldSeries(result / FIELDS_FOLDER / SOLID_FILE) as series:
        count = len(series.times_s)
        # each frame is read, and those of the animation once more
        with progress("pictures of the wave, frames", count + len(animated(count))) as advance:
            wave = read_wave(series, touch_s, advance)
            animate(series, wave, folder / ANIMATION, advance)
        figures = {
            WAVE: stills_figure(series, wave),
            TIP_STRESS: tip_figure(series, wave),
            SPACE_TIME: space_time_figure(wave, _bar_speed_m_s(document)),
        }
    for name, figure in figures.items():
        write_picture(folder / name, picture(figure))
    return wave


def _bar_speed_m_s(document: dict[str, Any]) -> float | None:
    """Speed of a wave in a thin bar of the result's material, where its inputs tell it."""
    inputs = document.get("inputs") or {}
    try:
        return float((inputs["youngs_Pa"] / inputs["density_kg_m3"]) ** 0.5)
    except (KeyError, TypeError, ZeroDivisionError):
        return None
