"""Page of tracked films: for each drop its marked frames, its track, and what it leaves; and their
``dataset.toml``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...solver import paper
from ..film.scale import touching_px
from ..inputs.choices import Body
from ..inputs.sources import command_line
from ..inputs.study_fields import TrackInputs
from ..report.figures import BLACK, BLUE, GREY, VERMILION, WIDTH_IN, panels, styled
from ..report.page import Head, Report, Section, environment, write_report
from ..report.prose import Prose
from .films import TABLE, FilmedDrop, TrackedFilms
from .overlay import Marked

MOST_DROPS = 24
"""Drops that have a section of their own: a page of more is not read."""
STEEL_KG_M3, UNKNOWN_BALL_MM = 7800.0, 10.0
HEADS: dict[str, Head] = {
    "t_s": ("time", "s", 6),
    "y": ("height", "", 5),
    "sigma": ("standard error", "", 3),
    "left": ("less the parabolas", "", 3),
    "frames_per_s": ("frames a second", "", 4),
    "mm_per_px": ("a pixel", "mm", 4),
    "exposure_ms": ("exposure", "ms", 3),
    "roll_deg": ("camera's roll", "°", 2),
    "gravity_m_s2": ("things fall with", "m/s²", 4),
    "kept": ("speed kept at the first impact", "", 4),
    "lean_deg": ("lean before it", "°", 3),
}
prose = Prose(Path(__file__).with_name("words.j2"), HEADS)


def write_tracks(
    found: TrackedFilms,
    document: dict[str, Any],
    pictures: Sequence[Sequence[Sequence[Marked]]],
    out: Path,
) -> Path:
    """Write ``report.html``, figures and tables into ``out``; ``document`` is what track.json
    holds, ``pictures`` are those of each drop of each film. Returns the page's path."""
    shown = list(zip(found.drops, (each for film in pictures for each in film), strict=True))
    names = [str(each.track.film.path) for each in found.films]
    sections = [_overview(found, document)]
    sections += [_drop_section(found, *each) for each in shown[:MOST_DROPS]]
    if found.warnings:
        sections.insert(0, Section("doubts", "What deserves doubt", list(found.warnings)))
    page = Report(
        title=f"Tracks of {len(found.drops)} drops",
        lead="Where the lower end of the body is in each frame, how sure that is, and pictures to "
        "judge it by.",
        command=command_line("track", found.inputs, TrackInputs(), out, *names),
        headline=prose.text("headline", found=found, document=document),
        facts=[
            ("Films", str(len(found.films))),
            ("Drops", str(len(found.drops))),
            ("Frames used", str(len(found.table))),
        ],
        sections=sections,
    )
    return write_report(page, out)


def _overview(found: TrackedFilms, document: dict[str, Any]) -> Section:
    draft = prose("overview", found=found, shown=min(len(found.drops), MOST_DROPS))
    films, drops, unit = document["films"], document["drops"], found.unit
    columns: dict[str, list[Any]] = {
        "film": [Path(each["film"]).name for each in films],
        "frames_per_s": [each["frames_per_s"] for each in films],
        "mm_per_px": [each["mm_per_px"] for each in films],
        "exposure_ms": [1e3 * each["exposure_s"] for each in films],
        "roll_deg": [each["roll_deg"] for each in films],
        "gravity_m_s2": [(each["gravity_m_s2"] or {}).get("estimate") for each in films],
    }
    draft.table("films", columns)
    kept = [(each["restitution"] or [{}])[0] for each in drops]
    columns = {
        "drop": [each["drop"] for each in drops],
        "film": [each["film"] for each in drops],
        f"y0_{unit}": [each[f"y0_{unit}"] for each in drops],
        "kept": [each.get("estimate") for each in kept],
        "low": [each.get("low") for each in kept],
        "high": [each.get("high") for each in kept],
        "lean_deg": [each["lean_before_deg"] for each in drops],
        f"sigma_{unit}": [each[f"sigma_{unit}"] for each in drops],
        "frames": [each["frames_used"] for each in drops],
    }
    heads: dict[str, Head] = {
        f"y0_{unit}": ("from", unit, 4),
        f"sigma_{unit}": ("a frame ±", unit, 2),
    }
    draft.table("drops", columns, heads)
    return draft.section()


def _drop_section(found: TrackedFilms, each: FilmedDrop, pictures: Sequence[Marked]) -> Section:
    track, drop, by, floor = each.film.track, each.drop, each.film.by, each.film.floor[0]
    used = track.used(drop)
    draft = prose(
        "drop",
        f"drop-{each.number}",
        number=each.number,
        drop=drop,
        left_out=len(drop.frames) - len(used),
        name=track.film.path.name,
    )
    rows = {
        "t_s": track.t_s[used],
        "y": by * (-track.down[used] - floor),
        "sigma": by * track.sigma[used],
        "left": by * track.residual(drop),
    }
    heads: dict[str, Head] = {
        name: (HEADS[name][0], found.unit, 4) for name in ("y", "sigma", "left")
    }
    data = draft.data(f"track-{each.number}", rows, heads)
    draft.figure(f"frames-{each.number}", _strip(pictures), data)
    t = np.linspace(track.t_s[used[0]], track.t_s[used[-1]], 400)
    curve = by * (drop.height(t) - floor)
    draft.figure(f"track-{each.number}", _track_figure(rows, t, curve, found.unit), data)
    return draft.section()


@styled
def _strip(pictures: Sequence[Marked]) -> Figure:
    """Marked frames side by side."""
    rows, columns = pictures[0].picture.shape[:2]
    height_in = WIDTH_IN / len(pictures) * rows / columns + 0.5
    figure, axes = panels(1, len(pictures), height_in=float(np.clip(height_in, 1.2, 6.0)))
    for ax, each in zip(axes[0], pictures, strict=True):
        ax.imshow(each.picture, interpolation="nearest")
        ax.set_title(f"{each.label}\n{each.t_s:.4f} s", fontsize=7.0)
        ax.set_axis_off()
    return figure


@styled
def _track_figure(rows: dict[str, Any], t: np.ndarray, curve: np.ndarray, unit: str) -> Figure:
    """Heights over time above, what the parabolas leave below."""
    figure, axes = panels(2, 1, height_in=4.2, sharex=True, height_ratios=(3, 1))
    upper, lower = axes[:, 0]
    upper.plot(t, curve, color=BLUE, lw=0.9, label="held, and parabolas")
    upper.plot(rows["t_s"], rows["y"], "o", color=BLACK, ms=2.0, label="frames")
    upper.set_ylabel(f"height of the end ({unit})")
    upper.legend(loc="upper right")
    lower.axhline(0.0, color=GREY, lw=0.7)
    lower.errorbar(
        rows["t_s"], rows["left"], yerr=rows["sigma"], fmt="o", color=VERMILION, ms=2.0, lw=0.7
    )
    lower.set(xlabel="time (s)", ylabel=f"left ({unit})")
    return figure


def manifest(found: TrackedFilms) -> str:
    """``dataset.toml`` of the tracks."""
    inputs, films = found.inputs, found.films
    names = ", ".join(each.track.film.path.name for each in films)
    ball_mm = _ball_mm(found) if inputs.body is Body.BALL else 0.0
    steel_kg = STEEL_KG_M3 * math.pi / 6.0 * (1e-3 * ball_mm) ** 3
    surfaces = [each.by * np.hypot(each.floor[1], touching_px(each.track.drops)) for each in films]
    templates = environment(Path(__file__).parent, {})
    text: str = templates.get_template("dataset.toml.j2").render(
        found=found,
        inputs=inputs,
        paper=paper,
        table=TABLE,
        names=_quoted(names[:700]),
        ball_mm=ball_mm,
        ball_kg=1e-3 * inputs.mass_g if inputs.mass_g else steel_kg,
        other_length=inputs.length_mm and abs(inputs.length_mm - 1e3 * paper.LENGTH_M) > 1e-6,
        surface=max(surfaces),
        scales=[each.scale for each in films if each.scale is not None],
        width_mm=np.median([each.by * each.track.width for each in films]),
    )
    return text


def _ball_mm(found: TrackedFilms) -> float:
    """The ball's diameter, as given or as the films show it."""
    if found.inputs.diameter_mm:
        return found.inputs.diameter_mm
    if found.unit == "px":
        return UNKNOWN_BALL_MM
    return float(np.median([each.by * np.nanmedian(each.track.length) for each in found.films]))


def _quoted(text: str) -> str:
    """A text as it may stand in a string of TOML."""
    safe = "".join(each if each.isprintable() else "?" for each in text)
    return safe.replace("\\", "\\\\").replace('"', '\\"')
