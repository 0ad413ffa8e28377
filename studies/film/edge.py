"""Where an end that moves within the exposure lies, from grey levels along the axis of its strip.

A pixel beyond the end shows the background, one within it the strip, and one that the end passes
during the exposure a mean of both, in the share of the time. The lens blurs all of it by a normal
distribution. What is averaged is light; a camera may write its 1/gamma-th power. The end has a
speed v and an acceleration a, so it is at s + v u + a u²/2, u seconds from the middle of the
exposure. Least squares in s, the strip's level and slope, and the background's offset, all frames
at once. Values that lie far off count less (Huber).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from ...solver.arrays import Array
from .follow import End

MOST_INSTANTS, INSTANT_PX = 24, 1.0
"""Of an exposure: at most so many, and as near to each other as the lens blurs. With twice as many
an end that moves ten pixels changes by less than a hundredth of one."""
TURNS = 12
INSIDE_PX, BEYOND_PX = 20.0, 14.0
"""How far from what the end passes levels are compared."""
FAR = 3.0
LEAST_NOISE = 0.5
STILL_PX, FAST_PX = 0.5, 4.0
"""A frame whose end moves less in it is sharp; one that moves more tells exposure and gamma."""
PSF_PX, MOST_PSF_PX = 0.6, 4.0
MOST_GAMMA = 2.4
"""Of cameras: sRGB and Rec. 709 are about 2.2 and 2.0, a machine's camera has 1."""
CLEARLY = 9.0
"""How much a sum of squares, over its noise, falls where a gamma other than 1 is taken."""
MOST_FRAMES = 24


@dataclass(frozen=True)
class Camera:
    """How a film's camera sees: the lens' blur (a standard deviation in px), its exposure in s, and
    the exponent ``gamma`` with which light grows with levels."""

    psf_px: float = PSF_PX
    exposure_s: float = 0.0
    gamma: float = 1.0
    exposure_known: bool = False
    gamma_known: bool = False


@dataclass(frozen=True)
class Ends:
    """Ends in frames, padded to one length: ``along`` (frames, pixels) counts outward along the
    strip in px, ``level``, ``behind`` and ``used`` (frames, pixels) belong to it; ``guess``
    (frames,) is about where the end is."""

    along: Array
    level: Array
    behind: Array
    used: NDArray[np.bool_]
    guess: Array

    @classmethod
    def of(cls, ends: Sequence[End], outward: int) -> Ends:
        """Of what was seen; rows count ``outward`` (1 or -1)."""
        most = max(len(end.rows) for end in ends)

        def padded(values: Sequence[Array]) -> Array:
            return np.stack([np.pad(v, (0, most - len(v)), mode="edge") for v in values])

        used = np.arange(most) < np.array([len(end.rows) for end in ends])[:, None]
        rows = padded([outward * end.rows for end in ends])
        return cls(
            rows,
            padded([end.level for end in ends]),
            padded([end.behind for end in ends]),
            used,
            outward * np.array([end.row for end in ends]),
        )

    def of_frames(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Ends:
        """Those of some frames."""
        return Ends(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Edges:
    """Where ends are: ``at`` (frames,) in px outward, its standard error, and the mean square that
    is left, in grey levels (frames,)."""

    at: Array
    sigma: Array
    square: Array


def edges(ends: Ends, speed: Array, bend: Array, camera: Camera) -> Edges:
    """Fit the ends of frames; ``speed`` and ``bend`` (frames,) are in px/s and px/s², outward."""
    longest = camera.exposure_s * float(np.abs(speed).max(initial=0.0))
    u = instants(camera.exposure_s, int(np.ceil(longest / INSTANT_PX)))
    return edges_of(ends, speed[:, None] * u + 0.5 * bend[:, None] * u**2, camera)


def instants(exposure_s: float, count: int = MOST_INSTANTS) -> Array:
    """Instants (n,) of an exposure from its middle, ``count`` of them or as many as are enough."""
    count = int(np.clip(count, 2, MOST_INSTANTS))
    return np.asarray(exposure_s * ((np.arange(count) + 0.5) / count - 0.5))


def edges_of(ends: Ends, moved: Array, camera: Camera) -> Edges:
    """Fit the ends of frames; ``moved`` (frames, instants) says how far they are, outward, from
    where they are in the middle of the exposure."""
    n = len(ends.guess)
    ahead, back = moved.max(axis=1), moved.min(axis=1)
    at = ends.guess.copy()
    inside = ends.used & (ends.along < (at + back)[:, None] - 3.0)
    level = _median(ends.level, inside & (ends.along > (at + back)[:, None] - INSIDE_PX))
    tilt: Array = np.zeros(n)
    offset: Array = np.zeros(n)
    weight: Array = np.ones_like(ends.level)
    normal = np.tile(np.eye(4), (n, 1, 1))
    for turn in range(TURNS):
        near = (ends.along > (at + back)[:, None] - INSIDE_PX) & (
            ends.along < (at + ahead)[:, None] + BEYOND_PX
        )
        w = weight * (near & ends.used)
        value, slopes = _model(ends, at, level, tilt, offset, moved, camera)
        left = ends.level - value
        count = np.maximum((w > 0).sum(axis=1), 6)
        if turn > 2:
            noise = 1.4826 * _median(np.abs(left), w > 0)
            noise = np.maximum(noise, LEAST_NOISE)
            weight = np.minimum(1.0, FAR * noise[:, None] / np.maximum(np.abs(left), 1e-9))
        normal = np.einsum("fp,ifp,jfp->fij", w, slopes, slopes)
        # the offset of the background is small, its levels are known
        normal[:, 2, 2] += 1e-2 * normal[:, 1, 1] + 1e-9
        normal[:, 3, 3] += 1e-9 + 1.0 / 4.0
        right = np.einsum("fp,ifp,fp->fi", w, slopes, left)
        right[:, 2] -= 1e-2 * normal[:, 1, 1] * tilt
        right[:, 3] -= offset / 4.0
        normal += 1e-6 * np.einsum("fii,ij->fij", normal, np.eye(4)) + 1e-9 * np.eye(4)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        at = at + np.clip(step[:, 0], -2.0, 2.0)
        level, tilt, offset = level + step[:, 1], tilt + step[:, 2], offset + step[:, 3]
        if turn > 4 and np.abs(step[:, 0]).max() < 1e-3:
            break
    square = (w * left**2).sum(axis=1) / np.maximum(count - 4, 2)
    sigma = np.sqrt(square * np.linalg.inv(normal)[:, 0, 0])
    return Edges(at, sigma, square)


def _model(
    ends: Ends,
    at: Array,
    level: Array,
    tilt: Array,
    offset: Array,
    moved: Array,
    camera: Camera,
) -> tuple[Array, Array]:
    """Levels (frames, pixels) and their derivatives (4, frames, pixels) in ``at``, ``level``,
    ``tilt`` and ``offset``."""
    gap = (at[:, None, None] + moved[:, None, :] - ends.along[:, :, None]) / camera.psf_px
    share = ndtr(gap).mean(axis=2)
    slope = np.exp(-0.5 * gap**2).mean(axis=2) / (np.sqrt(2.0 * np.pi) * camera.psf_px)
    inward = np.clip((ends.along - at[:, None]) / 10.0, -4.0, 4.0)
    strip = np.clip(level[:, None] + tilt[:, None] * inward, 1.0, 400.0)
    back = np.clip(ends.behind + offset[:, None], 1.0, 400.0)
    g = camera.gamma
    light = share * strip**g + (1.0 - share) * back**g
    value = light ** (1.0 / g)
    by_light = value / light / g
    of_strip = share * g * strip ** (g - 1.0) * by_light
    of_back = (1.0 - share) * g * back ** (g - 1.0) * by_light
    of_at = slope * (strip**g - back**g) * by_light
    return value, np.stack([of_at, of_strip, of_strip * inward, of_back])


def _median(values: Array, used: NDArray[np.bool_]) -> Array:
    """Medians (frames,) of what is ``used``; of all where nothing is."""
    used = used | ~np.asarray(used.any(axis=1))[:, None]
    ordered = np.sort(np.where(used, values, np.inf), axis=1)  # what is not used comes last
    count = used.sum(axis=1)
    middle = np.stack([(count - 1) // 2, count // 2], axis=1)
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))


def camera_of(
    ends: Ends, speed: Array, bend: Array, free: NDArray[np.bool_], frame_s: float, given: Camera
) -> Camera:
    """The camera that explains the edges best: its blur from frames in which the end is still,
    exposure (unless known) and gamma from frames in which it is fast and flies ``free``."""
    moving = np.abs(speed) * frame_s
    camera = given
    still = _some(moving < STILL_PX)
    if not len(still):
        still = _some(moving < np.percentile(moving, 20))
    fast = _some(free & (moving > FAST_PX))

    def misfit(which: NDArray[np.int64], tried: Camera) -> float:
        found = edges(ends.of_frames(which), speed[which], bend[which], tried)
        return float(np.sum(np.log(found.square + 0.05)))

    def least(
        which: NDArray[np.int64], camera_with: Callable[[float], Camera], low: float, high: float
    ) -> float:
        found = minimize_scalar(
            lambda value: misfit(which, camera_with(float(value))),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 0.01 * (high - low)},
        )
        return float(found.x)

    sharp = camera
    psf_px = least(still, lambda value: replace(sharp, psf_px=value), 0.25, MOST_PSF_PX)
    camera = replace(camera, psf_px=psf_px)
    if len(fast) < 3:
        return camera
    if not given.exposure_known:
        tried = frame_s * np.linspace(0.0, 1.0, 11)
        costs = [misfit(fast, replace(camera, exposure_s=float(each))) for each in tried]
        best = int(np.argmin(costs))
        low, high = tried[max(best - 1, 0)], tried[min(best + 1, 10)]
        lit = camera
        best_s = least(fast, lambda value: replace(lit, exposure_s=value), low, high)
        camera = replace(camera, exposure_s=best_s)
    plain = misfit(fast, camera)
    linear = camera
    gamma = least(fast, lambda value: replace(linear, gamma=value), 1.0, MOST_GAMMA)
    bent = replace(camera, gamma=gamma)
    # half the sum of logarithms times the pixels of an edge is a log likelihood
    blurred = np.abs(speed[fast]).mean() * camera.exposure_s + 6.0
    if 0.5 * blurred * (plain - misfit(fast, bent)) > CLEARLY:
        return replace(bent, gamma_known=True)
    phone = misfit(fast, replace(camera, gamma=MOST_GAMMA))
    return replace(camera, gamma_known=0.5 * blurred * (phone - plain) > CLEARLY)


def _some(which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Numbers of some of the frames that ``which`` tells, spread over all of them."""
    found = np.flatnonzero(which)
    return found[:: -(-len(found) // MOST_FRAMES)] if len(found) else found
