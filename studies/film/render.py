"""Drops of a bristle as a camera films them: pictures are drawn, and share no code with the reader.

A rectangle of the bristle's colour moves over a mottled wall, in front of a floor. Each picture is
the mean over its exposure of pictures whose edges are smooth over a pixel, with noise added, and is
encoded as H.264.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from .encoding import film_writer

INSTANTS = 12
"""Of an exposure, of which a picture is the mean."""


@dataclass(frozen=True)
class Look:
    """What camera and scene are like: frames a second, exposure in s, mm a pixel, grey levels of
    wall, bristle and floor, standard deviations of the wall's mottles and of the noise, gamma, and
    the quality of the encoding (x264's rate factor, smaller is better)."""

    fps: float = 240.0
    exposure_s: float = 1e-3
    mm_per_px: float = 0.6
    wall: float = 60.0
    bristle: float = 190.0
    floor: float = 95.0
    mottles: float = 3.0
    noise: float = 1.5
    gamma: float = 1.0
    crf: int = 18
    length_mm: float = 336.5
    width_mm: float = 2.08
    above_mm: float = 25.0
    below_mm: float = 12.0
    columns: int = 128

    def corner_mm(self, lean_deg: float) -> float:
        """By how much the lower corner of the end of a bristle that leans is below its middle."""
        return 0.5 * self.width_mm * abs(float(np.sin(np.radians(lean_deg))))


@dataclass(frozen=True)
class Flown:
    """What is drawn: heights (m) of the middle of the lower end over where it is as a corner of it
    touches, at times in s up to ``until_s``, and the lean in degrees, the upper end to the right,
    which grows by ``spin_deg_s`` from the first impact on."""

    height_m: Callable[[Array], Array]
    until_s: float
    lean_deg: float = 0.0
    spin_deg_s: float = 0.0

    @property
    def landed_s(self) -> float:
        """When it first touches the surface, to a few hundredths of a millisecond."""
        every = np.linspace(0.0, self.until_s, 20_000)
        return float(every[int(np.argmax(self.height_m(every) <= 0.0))])


def bouncing(
    y0_m: float,
    y1_m: float,
    contact_s: float,
    gravity_m_s2: float,
    *,
    release_m_s: float = 0.0,
    drag_1_m: float = 0.0,
    held_s: float = 0.12,
    bounces: int = 3,
    slower_m_s2: float = 0.0,
) -> tuple[Callable[[Array], Array], float]:
    """Heights of a body that is held, falls under quadratic drag and bounces, and when it lands
    last. The first bounce leads to ``y1_m``, the others keep the same share of the speed. From it
    on gravity is smaller by ``slower_m_s2``.

    Fall and rise in closed form (Lamb, Dynamics, 1923, section 94).
    """
    k, g = max(drag_1_m, 1e-7), gravity_m_s2
    c, limit = np.sqrt(g * k), np.sqrt(g / k)
    early = np.arctanh(release_m_s / limit) / c
    fall_s = np.arccosh(np.cosh(c * early) * np.exp(k * y0_m)) / c - early
    down, fall_c = limit * np.tanh(c * (fall_s + early)), c
    c, limit = np.sqrt((g - slower_m_s2) * k), np.sqrt((g - slower_m_s2) / k)
    up = limit * np.sqrt(np.expm1(2.0 * k * max(y1_m, 0.0)))
    share = up / down
    starts, ups, t = [], [], held_s + fall_s
    for _ in range(bounces):
        starts.append(t + contact_s)
        ups.append(up)
        high = np.log1p((up / limit) ** 2) / (2.0 * k)
        t += contact_s + (np.arctan(up / limit) + np.arccosh(np.exp(k * high))) / c
        up = share * limit * np.sqrt(-np.expm1(-2.0 * k * high))

    def height(t_s: Array) -> Array:
        t_s = np.asarray(t_s, dtype=float)
        since = np.maximum(t_s - held_s, 0.0)
        below = np.log(np.cosh(fall_c * (since + early))) - np.log(np.cosh(fall_c * early))
        fallen = below / k
        y = np.maximum(y0_m - fallen, 0.0)
        for start, speed in zip(starts, ups, strict=True):
            top_s, high = np.arctan(speed / limit) / c, np.log1p((speed / limit) ** 2) / (2.0 * k)
            from_top = t_s - start - top_s
            rising = np.log(np.cos(np.minimum(c * np.abs(from_top), 1.5))) / k
            falling = -np.log(np.cosh(c * from_top)) / k
            arc = high + np.where(from_top < 0.0, rising, falling)
            y = np.where(t_s >= start, np.maximum(arc, 0.0), y)
        return y

    return height, float(t)


def write_film(
    path: Path, flown: Flown, look: Look, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Write the film; returns the times (frames,) in s of the middles of its exposures.

    Raises ComputationError where it cannot be written.
    """
    high_mm = 1e3 * float(np.max(flown.height_m(np.linspace(0.0, flown.until_s, 2000))))
    rows = int((look.length_mm + high_mm + look.above_mm + look.below_mm) / look.mm_per_px)
    landed = flown.landed_s
    most = flown.lean_deg + flown.spin_deg_s * max(flown.until_s - landed, 0.0)
    # a bristle that leans needs a wider picture
    wide = look.columns + look.length_mm / look.mm_per_px * np.tan(np.radians(most))
    rows, columns = rows // 2 * 2, int(wide) // 2 * 2
    floor_row = rows - look.below_mm / look.mm_per_px
    wall = _light(_wall(rows, columns, floor_row, look, rng), look.gamma)
    times = np.arange(0.0, flown.until_s, 1.0 / look.fps)
    parts = look.exposure_s * ((np.arange(INSTANTS) + 0.5) / INSTANTS)
    with film_writer(path, round(look.fps), rows, columns, look.crf) as add:
        for t in times:
            heights_mm = 1e3 * flown.height_m(t + parts) + look.corner_mm(flown.lean_deg)
            tips = floor_row - heights_mm / look.mm_per_px
            leans = flown.lean_deg + flown.spin_deg_s * np.maximum(t + parts - landed, 0.0)
            shares = [
                _share(rows, columns, float(tip), float(lean), look)
                for tip, lean in zip(tips, leans, strict=True)
            ]
            light = wall + np.mean(shares, axis=0) * (_light(look.bristle, look.gamma) - wall)
            grey = 255.0 * light ** (1.0 / look.gamma) + look.noise * rng.normal(size=light.shape)
            picture = np.clip(np.round(grey), 0, 255).astype(np.uint8)
            add(np.repeat(picture[:, :, None], 3, axis=2))
    return np.asarray(times + 0.5 * look.exposure_s)


def _light(level: Array | float, gamma: float) -> Array:
    return np.asarray((np.asarray(level, dtype=float) / 255.0) ** gamma)


def _wall(rows: int, columns: int, floor_row: float, look: Look, rng: np.random.Generator) -> Array:
    """A wall with mottles some px wide, and the floor."""
    coarse = rng.normal(size=(rows // 8 + 2, columns // 8 + 2))
    mottles = np.kron(coarse, np.ones((8, 8)))[:rows, :columns]
    for axis in (0, 1):
        mottles = (np.roll(mottles, 4, axis) + np.roll(mottles, -4, axis) + 2.0 * mottles) / 4.0
    level = np.where(np.arange(rows)[:, None] > floor_row, look.floor, look.wall)
    return np.clip(level + look.mottles * mottles / mottles.std(), 1.0, 254.0)


def _share(rows: int, columns: int, tip_row: float, lean_deg: float, look: Look) -> Array:
    """The share of each pixel (rows, columns) that the bristle covers, its end at ``tip_row``."""
    lean = np.radians(lean_deg)
    half, length = 0.5 * look.width_mm / look.mm_per_px, look.length_mm / look.mm_per_px
    axis = 0.45 * look.columns
    ends = axis, axis + length * np.sin(lean)
    left, right = max(int(min(ends) - half - 3.0), 0), int(max(ends) + half + 4.0)
    row, column = np.mgrid[:rows, left : min(right, columns)].astype(float)
    x, y = column - axis, tip_row - row
    along = y * np.cos(lean) + x * np.sin(lean)
    aside = x * np.cos(lean) - y * np.sin(lean)

    def within(distance: Array) -> Array:
        # a pixel whose centre is so far inside an edge is covered by that share
        return np.clip(distance + 0.5, 0.0, 1.0)

    wide = np.clip(within(aside + half) + within(half - aside) - 1.0, 0.0, 1.0)
    share = np.zeros((rows, columns))
    share[:, left:right] = wide * np.clip(within(along) + within(length - along) - 1.0, 0.0, 1.0)
    return share
