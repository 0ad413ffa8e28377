"""How long a pixel is, from a length in view; and what gravity says of scale and clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...solver.arrays import Array
from .flights import Drop
from .tracker import Tracked

LENS = 0.002
"""Share by which a lens' distortion and a body beside the plane of its fall change a scale."""
EDGES_PX = 0.15
"""By how much both edges of a body may seem farther apart than they are: light spreads."""
DIFFERENT = 0.03
"""Share by which two scales differ visibly, whatever their errors."""
ROUND_RATES = (
    24.0,
    25.0,
    30.0,
    50.0,
    60.0,
    100.0,
    120.0,
    200.0,
    240.0,
    480.0,
    500.0,
    960.0,
    1000.0,
)


@dataclass(frozen=True)
class Scale:
    """Millimetres a pixel, the share by which it may be off (a standard error), and its source."""

    mm_per_px: float
    error: float
    source: str


def scale_of(track: Tracked, length_mm: float | None, mm_per_px: float | None) -> Scale | None:
    """The scale of a film; None where nothing gives one.

    ``length_mm`` is the length of the bristle, or the diameter of the ball.
    """
    if mm_per_px is not None:
        return Scale(mm_per_px, 0.0, "--mm-per-px")
    seen = track.length[np.isfinite(track.length)]
    if length_mm is None or len(seen) < 3:
        return None
    # a hand that still hides an end makes it shorter in a few frames
    length = float(np.median(seen))
    spread = 1.4826 * float(np.median(np.abs(seen - length))) / np.sqrt(len(seen))
    edges = EDGES_PX / length
    return Scale(
        length_mm / length,
        float(np.sqrt((spread / length) ** 2 + edges**2 + LENS**2)),
        f"the {track.body} in view, {length_mm:g} mm long and {length:.1f} px",
    )


def gravity_px(track: Tracked) -> tuple[float, float] | None:
    """Gravity in px/s², and the share by which it may be off (a standard error), from all drops;
    None where none tells it."""
    found = [
        (drop.gravity, drop.gravity_error) for drop in track.drops if drop.gravity_error is not None
    ]
    if not found:
        return None
    values, errors = np.array(found).T
    weights = errors**-2.0
    mean = float(np.average(values, weights=weights))
    # more scatter than their errors say has a reason that is not known
    square = float(np.sum(weights * (values - mean) ** 2)) / max(len(values) - 1, 1)
    return mean, float(np.sqrt(max(square, 1.0) / weights.sum())) / mean


def doubts_of(track: Tracked, scale: Scale | None, gravity_m_s2: float) -> list[str]:
    """What scale, clock and gravity say of each other where they disagree, in sentences."""
    seen = gravity_px(track)
    if scale is None or seen is None:
        return []
    shown = 1e-3 * scale.mm_per_px * seen[0]
    ratio = shown / gravity_m_s2
    if abs(ratio - 1.0) < max(3.0 * float(np.hypot(scale.error, seen[1])), DIFFERENT):
        return []
    rate = 1.0 / track.frame_s
    fitting = rate / np.sqrt(ratio)
    near = min(ROUND_RATES, key=lambda each: abs(np.log(each / fitting)))
    if abs(np.log(near / fitting)) < DIFFERENT:
        fitting = near
    return [
        f"{track.film.path.name}: things fall here with {shown:.3g} m/s2 instead of "
        f"{gravity_m_s2:g}. Either the film has {fitting:.4g} frames a second, not {rate:.4g} "
        f"(give --fps {fitting:.4g}), or a pixel is {scale.mm_per_px / ratio:.4g} mm, not "
        f"{scale.mm_per_px:.4g} by {scale.source} (give its true length, or --mm-per-px)"
    ]


def heights(track: Tracked, drop: Drop, floor: float) -> Array:
    """Heights (frames,) over the surface in px, of the frames of a drop that are used."""
    return np.asarray(-track.down[track.used(drop)] - floor)


def floor_of(drops: Sequence[Drop]) -> tuple[float, float] | None:
    """The height in px at which bodies bounce, of all drops of a film, and its standard error; None
    where none bounces."""
    found = [(float(d.floor[0]), d.floor_error or 1.0) for d in drops if len(d.floor)]
    if not found:
        return None
    floors, errors = np.array(found).T
    weights = errors**-2.0
    mean = float(np.average(floors, weights=weights))
    square = float(np.sum(weights * (floors - mean) ** 2)) / max(len(floors) - 1, 1)
    return mean, float(np.sqrt(max(square, 1.0) / weights.sum()))
