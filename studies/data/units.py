"""Values so far off that they were given in another unit than the one that is named.

A thousandth or a thousandfold of what was measured computes just as well, and what is then found
is wrong. Bounds are wide: no bristle, brush or wire that was meant is outside of them.
"""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np

from ...solver import paper
from ...solver.arrays import Array
from ...solver.bristle import Bristle, RigidMass
from ...solver.errors import InputError
from ..inputs.limits import MOST_DAMPED

HEIGHTS_MM = (1.0, 5000.0)
# Rises over the height before: the highest of one drop, the highest of all drops at least.
MOST_RISE, LEAST_RISE = 10.0, 0.01
# Times beyond what a rigid bristle on the paper's softest and stiffest contact would do.
FAR = 30.0
BAR_SPEED_M_S = (10.0, 30_000.0)
# Lengths over the thinner side.
SLENDEREST = 2e4


def check_heights(path: Path, lines: Sequence[int], y0_m: Array, y1_m: Array | None = None) -> None:
    """InputError at the first drop (drops,) from, or to, a height that is none of mm."""
    low, high = HEIGHTS_MM
    for line, y0 in zip(lines, 1e3 * y0_m, strict=True):
        if math.isfinite(y0) and not low * (1.0 - 1e-9) <= y0 <= high * (1.0 + 1e-9):
            raise InputError(
                f"{path}:{line}: y0_mm must lie between {low:g} and {high:g}, not {y0:g}; "
                "is it in mm?"
            )
    if y1_m is None or not np.isfinite(y1_m).any():
        return
    rise = y1_m / y0_m
    for line, y1, share in zip(lines, 1e3 * y1_m, rise, strict=True):
        if share > MOST_RISE:
            raise InputError(
                f"{path}:{line}: y1_mm of {y1:g} is {share:.3g} times y0_mm; are both in mm?"
            )
    if 0.0 < np.nanmax(rise) < LEAST_RISE:
        highest = int(np.nanargmax(rise))
        raise InputError(
            f"{path}:{lines[highest]}: y1_mm of {1e3 * y1_m[highest]:g} is {rise[highest]:.2g} of "
            "y0_mm, and no other drop rises higher; are both in mm?"
        )


def check_marks(path: Path, lines: Sequence[int], y_m: Array) -> None:
    """InputError at the first height of a film (frames,) that is farther off than drops are."""
    most = 2.0 * HEIGHTS_MM[1]
    for line, y in zip(lines, 1e3 * y_m, strict=True):
        if abs(y) > most:
            raise InputError(f"{path}:{line}: y_mm of {y:g} is beyond {most:g}; is it in mm?")


def check_contact_times(
    path: Path, lines: Sequence[int], name: str, times_s: Array, body: Bristle | RigidMass
) -> None:
    """InputError at the first contact time (drops,) that no impact has; NaN is not looked at.

    Eq. 8 of the paper gives those of a rigid body.
    """
    kns = max(paper.KN_N_M), min(paper.KN_N_M)
    low, high = (math.pi * math.sqrt(body.mass_kg / kn) for kn in kns)
    for line, time in zip(lines, times_s, strict=True):
        if not low / FAR <= time <= FAR * high and math.isfinite(time):
            raise InputError(
                f"{path}:{line}: {name}: a contact of {time:.3g} s is not one of this body, "
                f"{low / FAR:.1g} to {FAR * high:.1g} s; is it in another unit?"
            )


def check_peaks(
    path: Path,
    lines: Sequence[int],
    name: str,
    peaks_N: Array,
    y0_m: Array,
    body: Bristle | RigidMass,
    gravity_m_s2: float,
    off_N: float = 0.0,
) -> None:
    """InputError at the first greatest force (drops,) that no impact has; NaN is not looked at.

    Where readings may be off by ``off_N``, small ones may be less than any impact has.
    """
    momentum = body.mass_kg * np.sqrt(2.0 * gravity_m_s2 * y0_m)
    for line, peak, mv in zip(lines, peaks_N, momentum, strict=True):
        low, high = (
            float(mv * math.sqrt(kn / body.mass_kg))
            for kn in (min(paper.KN_N_M), max(paper.KN_N_M))
        )
        if not low / FAR - off_N <= peak <= FAR * high and math.isfinite(peak * mv):
            raise InputError(
                f"{path}:{line}: {name}: a peak of {peak:.3g} N is not one of this body from "
                f"{1e3 * mv * mv / (2.0 * gravity_m_s2 * body.mass_kg**2):.3g} mm, "
                f"{low / FAR:.1g} to {FAR * high:.1g} N; is it in N?"
            )


def doubtful_body(bristle: Bristle, declared: Container[str]) -> tuple[str, str] | None:
    """The declared key that cannot be in its unit, and why; None without doubt."""
    section, material = bristle.section, bristle.material
    bending = max(section.second_moment_x_m4, section.second_moment_y_m4)
    widest = math.sqrt(12.0 * bending / section.area_m2)  # of a flat wire; of a round one 0.87 d
    thinnest = section.area_m2 / widest
    speed, (low, high) = material.bar_speed_m_s, BAR_SPEED_M_S
    doubts: list[tuple[bool, tuple[str, ...], str]] = [
        (
            not low <= speed <= high,
            ("density_kg_m3", "youngs_modulus_Pa"),
            f"makes axial waves of {speed:.3g} m/s; are stiffness and density in Pa and kg/m³?",
        ),
        (
            bristle.length_m <= widest,
            ("length_m", "thickness_m", "width_m", "diameter_m"),
            f"makes a bristle {bristle.length_m:g} m long and {widest:.3g} m wide; are both in m?",
        ),
        (
            bristle.length_m > SLENDEREST * thinnest,
            ("length_m", "thickness_m", "width_m", "diameter_m"),
            f"makes a bristle {bristle.length_m:g} m long, {thinnest:.3g} m thin; are both in m?",
        ),
        (
            bristle.axial_damping > MOST_DAMPED,
            ("damping_beta_s",),
            f"damps the first axial mode {bristle.axial_damping:.3g} times critically; is it in s?",
        ),
    ]
    found = ((key, why) for doubt, keys, why in doubts if doubt for key in keys if key in declared)
    return next(found, None)
