"""What instruments without noise read of drops with an effect in them.

Effects bear the names, parameters and conventions of the program that is tested, so that a name
means the same physics; how they act is worked out here from the blind bodies' own impacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import rayleigh

from .body import Array, Body
from .leaning import Lean, land
from .upright import (
    ADHESIVE,
    DASHPOT,
    GRAVITY_M_S2,
    HUNT_CROSSLEY,
    LINEAR,
    PLASTIC,
    POWER,
    Law,
    impact,
)

AIR_KG_M3 = 1.204
WEAR_DROPS = 100.0
MOST_SLOPE_DEG = 10.0


@dataclass(frozen=True)
class Truth:
    """All that a set of drops is made of. ``law`` is a kind of upright.Law with its numbers;
    ``friction`` acts where a bristle leans."""

    body: Body = field(default_factory=Body)
    kn_N_m: float = 2e6
    law: int = LINEAR
    number: float = 0.0
    hardens: float = 0.0
    unloads: float = 1.0
    friction: float = 0.0
    tilt_deg: float = 0.0
    slope_std_deg: float = 0.0
    phases_decades: float = 0.0
    wear_decades: float = 0.0
    session_decades: float = 0.0
    cd: float = 0.0
    release_m_s: float = 0.0
    offset_m: float = 0.0
    scale: float = 0.0
    clock: float = 0.0


@dataclass(frozen=True)
class Listed:
    """An effect that the program lists: its parameter, its bounds and where it is absent."""

    name: str
    parameter: str
    low: float
    high: float
    absent: float = 0.0
    logarithmic: bool = False


LISTED = {
    each.name: each
    for each in (
        Listed("air_drag", "cd", 0.0, 100.0),
        Listed("release_velocity", "speed_m_s", -0.5, 0.5),
        Listed("height_offset", "offset_m", -5e-3, 5e-3),
        Listed("scale_error", "relative", -0.2, 0.2),
        Listed("clock_error", "relative", -0.2, 0.2),
        Listed("contact_damping", "c_N_s_m", 0.0, 40.0),
        Listed("hunt_crossley", "damping_s_m", 0.0, 3.0),
        Listed("stiffening_contact", "exponent", 1.0, 3.0, 1.0),
        Listed("plastic_contact", "yield_N", 5.0, 200.0, 200.0, True),
        Listed("adhesion", "pull_off_N", 0.0, 20.0),
        Listed("material_damping", "beta_s", 1e-9, 1e-4, 1.07e-5, True),
        Listed("hysteretic_damping", "loss_factor", 0.0, 0.5),
        Listed("bristle_tilt", "tilt_deg", 0.0, 4.0),
        Listed("surface_slope", "std_deg", 0.0, 5.0),
        Listed("surface_phases", "std_decades", 0.0, 1.0),
        Listed("wear", "decades", -4.0, 4.0),
        Listed("session", "decades", -1.0, 1.0),
    )
}
LAWS = {
    "contact_damping": DASHPOT,
    "hunt_crossley": HUNT_CROSSLEY,
    "stiffening_contact": POWER,
    "plastic_contact": PLASTIC,
    "adhesion": ADHESIVE,
}
_FIELDS = {
    "air_drag": "cd",
    "release_velocity": "release_m_s",
    "height_offset": "offset_m",
    "scale_error": "scale",
    "clock_error": "clock",
    "bristle_tilt": "tilt_deg",
    "surface_slope": "slope_std_deg",
    "surface_phases": "phases_decades",
    "wear": "wear_decades",
    "session": "session_decades",
}


def with_effect(truth: Truth, name: str, value: float) -> Truth:
    """``truth`` with a listed effect in it."""
    if name in LAWS:
        return replace(truth, law=LAWS[name], number=value)
    if name == "material_damping":
        return replace(truth, body=replace(truth.body, beta_s=value))
    if name == "hysteretic_damping":
        return replace(truth, body=replace(truth.body, loss_factor=value))
    return replace(truth, **{_FIELDS[name]: value})


def seen(truth: Truth, heights_m: Array, chance: Array) -> Array:
    """(drops, 4): y0 in m, y1 in m, contact time in s, peak force in N, in the order of drops.

    ``chance`` (drops, 2) are standard normal numbers of each drop.
    """
    out = np.empty((len(heights_m), 4))
    for i, (height, luck) in enumerate(zip(heights_m, chance, strict=True)):
        speed = speed_down(truth, height, truth.release_m_s)
        later = truth.session_decades if 2 * i >= len(heights_m) else 0.0
        own = replace(truth, kn_N_m=truth.kn_N_m * 10.0**later)
        top, out[i, 2], out[i, 3] = bounce(own, speed, i, luck)
        out[i, 0], out[i, 1] = height, top
    out[:, :2] = (1.0 + truth.scale) * (out[:, :2] + truth.offset_m)
    out[:, 2] *= 1.0 + truth.clock
    return out


def drag_1_m(truth: Truth) -> float:
    """Drag on the end section over mass and the square of the speed."""
    return 0.5 * AIR_KG_M3 * truth.cd * truth.body.area_m2 / truth.body.mass_kg


def speed_down(truth: Truth, height_m: float, release_m_s: float) -> float:
    """Speed after a fall that begins with ``release_m_s``, downwards positive."""
    drag = drag_1_m(truth)
    start = release_m_s**2
    if release_m_s < 0.0:
        # first up to rest, then down from there
        height_m += rise(truth, -release_m_s)
        start = 0.0
    if drag < 1e-12:
        return math.sqrt(start + 2.0 * GRAVITY_M_S2 * height_m)
    last = GRAVITY_M_S2 / drag
    return math.sqrt(last + (start - last) * math.exp(-2.0 * drag * height_m))


def rise(truth: Truth, speed_m_s: float) -> float:
    """Height to which a speed upwards carries."""
    drag = drag_1_m(truth)
    if drag < 1e-12:
        return speed_m_s**2 / (2.0 * GRAVITY_M_S2)
    return math.log1p(drag * speed_m_s**2 / GRAVITY_M_S2) / (2.0 * drag)


def _slopes(std_deg: float, luck: Sequence[float]) -> Array:
    """Toward both sides, normal, of a surface that has none steeper than `MOST_SLOPE_DEG`."""
    if std_deg == 0.0:
        return np.zeros(2)
    size = math.hypot(*luck)
    part = rayleigh.cdf(size) * rayleigh.cdf(MOST_SLOPE_DEG / std_deg)
    return std_deg * float(rayleigh.ppf(part)) / size * np.asarray(luck)


def bounce(
    truth: Truth, speed_m_s: float, order: int, luck: Sequence[float]
) -> tuple[float, float, float]:
    """Greatest height, contact time and peak force of one impact."""
    decades = truth.wear_decades * order / WEAR_DROPS + truth.phases_decades * luck[0]
    kn = float(np.clip(truth.kn_N_m * 10.0**decades, 1e3, 1e10))
    slopes = _slopes(truth.slope_std_deg, luck)
    if truth.tilt_deg or truth.slope_std_deg:
        lean = Lean(truth.tilt_deg, float(slopes[0]), float(slopes[1]), truth.friction)
        landed = land(truth.body, kn, lean, speed_m_s)
        return landed.top_m, landed.contact_time_s, landed.peak_force_N
    found = impact(
        truth.body, Law(truth.law, kn, truth.number, truth.hardens, truth.unloads), speed_m_s
    )
    if found.speed_m_s <= 0.0:
        return max(0.0, found.lift_m), found.contact_time_s, found.peak_force_N
    top = max(0.0, found.lift_m + rise(truth, found.speed_m_s))
    return top, found.contact_time_s, found.peak_force_N
