"""Page of tracked films: for each drop its marked frames, its track, and what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .. import __version__
from ..inputs.sources import into
from ..report.figures import BLACK, BLUE, GREY, VERMILION, WIDTH_IN, panels, styled
from ..report.page import Head, Report, Section, write_report
from ..report.prose import Prose
from .films import FilmedDrop, TrackedFilms
from .overlay import Marked

MOST_DROPS = 24
"""Drops that have a section of their own: a page of more is not read."""
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
    names = [str(track.film.path) for track in found.tracks]
    sections = [_overview(found, document)]
    sections += [_drop_section(found, *each) for each in shown[:MOST_DROPS]]
    if found.warnings:
        sections.insert(0, Section("doubts", "What deserves doubt", list(found.warnings)))
    page = Report(
        title=f"Tracks of {len(found.drops)} drops",
        lead="Where the lower end of the body is in each frame, how sure that is, and pictures to "
        "judge it by.",
        version=__version__,
        command=into(out, "track", *names),
        headline=prose.text("headline", found=found, document=document),
        facts=[
            ("Films", str(len(found.tracks))),
            ("Drops", str(len(found.drops))),
            ("Frames used", str(len(found.table))),
        ],
        sections=sections,
    )
    return write_report(page, out)


def _overview(found: TrackedFilms, document: dict[str, Any]) -> Section:
    draft = prose("overview", found=found, shown=min(len(found.drops), MOST_DROPS))
    films = [
        {
            "film": Path(film["film"]).name,
            "frames_per_s": film["frames_per_s"],
            "mm_per_px": film["mm_per_px"],
            "exposure_ms": 1e3 * film["exposure_s"],
            "roll_deg": film["roll_deg"],
            "gravity_m_s2": film["gravity_m_s2"] and film["gravity_m_s2"]["estimate"],
        }
        for film in document["films"]
    ]
    unit = found.unit
    drops = [
        {
            "drop": drop["drop"],
            "film": drop["film"],
            f"y0_{unit}": drop[f"y0_{unit}"],
            "kept": drop["restitution"][0]["estimate"] if drop["restitution"] else None,
            "low": drop["restitution"][0]["low"] if drop["restitution"] else None,
            "high": drop["restitution"][0]["high"] if drop["restitution"] else None,
            "lean_deg": drop["lean_before_deg"],
            f"sigma_{unit}": drop[f"sigma_{unit}"],
            "frames": drop["frames_used"],
        }
        for drop in document["drops"]
    ]
    for name, rows in (("films", films), ("drops", drops)):
        columns = {key: [row[key] for row in rows] for key in rows[0]}
        heads: dict[str, Head] = {
            f"y0_{unit}": ("from", unit, 4),
            f"sigma_{unit}": ("a frame ±", unit, 2),
        }
        draft.table(name, columns, heads)
    return draft.section()


def _drop_section(found: TrackedFilms, each: FilmedDrop, pictures: Sequence[Marked]) -> Section:
    track, scale = found.tracks[each.film], found.scales[each.film]
    drop, by = each.drop, 1.0 if scale is None else scale.mm_per_px
    used = track.used(drop)
    left_out = int(drop.last - drop.first + 1 - len(used))
    draft = prose(
        "drop",
        f"drop-{each.number}",
        number=each.number,
        drop=drop,
        left_out=left_out,
        name=track.film.path.name,
    )
    floor = found.floors[each.film][0]
    rows = {
        "t_s": track.t_s[used],
        "y": by * (-track.down[used] - floor),
        "sigma": by * track.sigma[used],
        "left": by * track.residual(drop),
    }
    data = draft.data(
        "track", rows, {name: (HEADS[name][0], found.unit, 4) for name in ("y", "sigma", "left")}
    )
    data = type(data)(f"track-{each.number}", data.caption, data.columns, data.rows, data.note)
    draft.marked[f"figure frames-{each.number}"] = draft.marked["figure frames"]
    draft.marked[f"alt frames-{each.number}"] = draft.marked["alt frames"]
    draft.marked[f"figure track-{each.number}"] = draft.marked["figure track"]
    draft.marked[f"alt track-{each.number}"] = draft.marked["alt track"]
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
