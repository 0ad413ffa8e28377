"""Frames of a film with what was found in them marked: a few for the page, all as a film."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from ...solver.arrays import Array
from ..film.encoding import film_writer
from ..film.flights import Drop
from ..film.reading import Frame, Picture
from ..film.tracker import Tracked

MARK, AXIS = (255, 40, 0), (0, 200, 255)
ARM_PX = 7
OVERLAY_FPS = 25
"""Overlay films are shown slowly, as many frames a second."""
MARGIN_FRAMES = 5
LEAST_HEIGHT_PX = 240
ABOVE_PX, BELOW_PX, ASIDE_PX = 50, 20, 30
"""How much of a frame is shown about the way of the end."""
AXIS_PX = 40


@dataclass(frozen=True)
class Marked:
    """A frame on the page: what it shows, its picture (rows, columns, 3), and the instant in s."""

    label: str
    t_s: float
    picture: Picture


def write_overlay(track: Tracked, path: Path) -> list[list[Marked]]:
    """Write a film of the frames of all drops with what was found in them, slowly; and return, for
    each drop, frames about its release, its first impact and its highest point, cut to the
    surroundings of the end.

    Raises ComputationError where the film cannot be written.
    """
    wanted = [_moments(track, drop) for drop in track.drops]
    numbers = {int(track.number[i]) for moments in wanted for i in moments.values()}
    kept = {f.number: f.grey for f in _overlaid(track, path) if f.number in numbers}
    return [
        [_cut(track, drop, label, i, kept[int(track.number[i])]) for label, i in moments.items()]
        for drop, moments in zip(track.drops, wanted, strict=True)
    ]


def _moments(track: Tracked, drop: Drop) -> dict[str, int]:
    """Frames of a drop that are shown, by what they show; numbers among the frames seen."""
    used = track.used(drop)
    t = track.t_s[used]

    def nearest(instant: float) -> int:
        return int(used[int(np.argmin(np.abs(t - instant)))])

    found = {"first": int(used[0])}
    if drop.release_s is not None:
        found["let go"] = nearest(drop.release_s)
    for k, impact in enumerate(drop.impact_s[:2]):
        before, after = used[t < impact], used[t > impact]
        if k == 0 and len(before):
            found["down"] = int(before[-1])
        if k == 0 and len(after):
            found["up"] = int(after[0])
        found[f"top {k + 1}"] = nearest(drop.flights[k + 1].top_s)
    found["last"] = int(used[-1])
    return found


def _cut(track: Tracked, drop: Drop, label: str, i: int, grey: Picture) -> Marked:
    """The frame ``i`` with its mark, cut to where the drop's end comes by."""
    own = slice(drop.first, drop.last + 1)
    rows, columns = grey.shape
    top = max(int(track.row[own].min()) - ABOVE_PX, 0)
    bottom = min(int(track.row[own].max()) + BELOW_PX, rows)
    left = max(int(track.column[own].min()) - ASIDE_PX, 0)
    right = min(int(track.column[own].max()) + ASIDE_PX, columns)
    picture = marked(track, i, grey)[top:bottom, left:right]
    return Marked(label, float(track.t_s[i]), picture)


def marked(track: Tracked, i: int | None, grey: Picture) -> Picture:
    """A frame in colour (rows, columns, 3), with the end and the axis that were found in it."""
    picture = Image.fromarray(np.repeat(grey[:, :, None], 3, axis=2))
    if i is not None:
        draw = ImageDraw.Draw(picture)
        x, y = float(track.column[i]), float(track.row[i])
        if track.turn is not None:
            slope = float(np.tan(np.arctan(track.vertical[0]) - track.turn[i]))
            begin = (x - slope * (ARM_PX + AXIS_PX), y - ARM_PX - AXIS_PX)
            draw.line([begin, (x - slope * ARM_PX, y - ARM_PX)], fill=AXIS)
        draw.line([(x - ARM_PX, y), (x - 2, y)], fill=MARK, width=2)
        draw.line([(x + 2, y), (x + ARM_PX, y)], fill=MARK, width=2)
    return np.asarray(picture)


def _overlaid(track: Tracked, path: Path) -> Iterator[Frame]:
    """The film's frames; those of drops are written to the overlay film on the way."""
    shown = np.zeros(int(track.number[-1]) + MARGIN_FRAMES + 2, dtype=bool)
    for drop in track.drops:
        first, last = int(track.number[drop.first]), int(track.number[drop.last])
        shown[max(first - MARGIN_FRAMES, 0) : last + MARGIN_FRAMES + 1] = True
    used: Array = np.concatenate([track.used(drop) for drop in track.drops])
    at = {int(track.number[i]): int(i) for i in used}
    rows, columns = track.shape
    times = max(1, -(-LEAST_HEIGHT_PX // rows))
    # H.264 wants even numbers
    rows, columns = (times * side // 2 * 2 for side in (rows, columns))
    with film_writer(path, OVERLAY_FPS, rows, columns) as add:
        for frame in track.film.frames():
            yield frame
            if frame.number < len(shown) and shown[frame.number]:
                picture = marked(track, at.get(frame.number), frame.grey)
                larger = np.repeat(np.repeat(picture, times, axis=0), times, axis=1)
                add(larger[:rows, :columns])
