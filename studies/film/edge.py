"""Where an end that moves within the exposure lies, from grey levels along the axis of its strip.

A pixel beyond the end shows the background, one within it the strip, and one that the end passes
during the exposure a mean of both, in the share of the time. The lens blurs all of it by a normal
distribution. What is averaged is light; a camera may write its 1/gamma-th power. The end has a
speed v and an acceleration a, so it is at s + v u + a u²/2, u seconds from the middle of the
exposure. Least squares in s, the strip's level and slope, and the background's offset, all frames
at once. Values that lie far off count less (Huber).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import ndtr

from ...solver.arrays import Array
from .follow import End
from .scan import median_of

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
    """How a film's camera sees: the lens' blur (a standard deviation in px), its exposure in s, the
    exponent ``gamma`` with which light grows with levels, and by how many s a row of the picture is
    later than the one above."""

    psf_px: float = PSF_PX
    exposure_s: float = 0.0
    gamma: float = 1.0
    exposure_known: bool = False
    gamma_known: bool = False
    rolling_s: float = 0.0


@dataclass(frozen=True)
class Ends:
    """Ends in frames, padded to one length: ``along`` (frames, pixels) counts outward along the
    strip in px, ``level``, ``behind`` and ``used`` (frames, pixels) belong to it; ``guess``
    (frames,) is about where the end is. ``speed`` and ``bend`` (frames,) are its speed and
    acceleration outward in px/s and px/s²."""

    along: Array
    level: Array
    behind: Array
    used: NDArray[np.bool_]
    guess: Array
    speed: Array
    bend: Array

    @classmethod
    def of(cls, ends: Sequence[End], outward: int) -> Ends:
        """Of what was seen; rows count ``outward`` (1 or -1). They do not move."""
        most = max(len(end.rows) for end in ends)

        def padded(values: Sequence[Array]) -> Array:
            return np.stack([np.pad(v, (0, most - len(v)), mode="edge") for v in values])

        return cls(
            along=padded([outward * end.rows for end in ends]),
            level=padded([end.level for end in ends]),
            behind=padded([end.behind for end in ends]),
            used=np.arange(most) < np.array([len(end.rows) for end in ends])[:, None],
            guess=outward * np.array([end.row for end in ends]),
            speed=np.zeros(len(ends)),
            bend=np.zeros(len(ends)),
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


def edges(ends: Ends, camera: Camera) -> Edges:
    """Fit the ends of frames."""
    longest = camera.exposure_s * float(np.abs(ends.speed).max(initial=0.0))
    u = instants(camera.exposure_s, int(np.ceil(longest / INSTANT_PX)))
    return edges_of(ends, ends.speed[:, None] * u + 0.5 * ends.bend[:, None] * u**2, camera)


def instants(exposure_s: float, count: int = MOST_INSTANTS) -> Array:
    """Instants (n,) of an exposure from its middle, ``count`` of them or as many as are enough."""
    count = int(np.clip(count, 2, MOST_INSTANTS))
    return np.asarray(exposure_s * ((np.arange(count) + 0.5) / count - 0.5))


def edges_of(ends: Ends, moved: Array, camera: Camera) -> Edges:
    """Fit the ends of frames; ``moved`` (frames, instants) says how far they are, outward, from
    where they are in the middle of the exposure."""
    begin = moved.min(axis=1, keepdims=True) - INSIDE_PX
    end = moved.max(axis=1, keepdims=True) + BEYOND_PX
    off = ends.along - ends.guess[:, None]
    inside = ends.used & (off > begin) & (off < begin + INSIDE_PX - 3.0)
    # of each frame: where the end is, level and tilt of the strip, offset of the background
    p = np.zeros((len(off), 4))
    p[:, 0], p[:, 1] = ends.guess, median_of(ends.level, inside, axis=1)
    weight: Array = np.ones_like(ends.level)
    for turn in range(TURNS):
        off = ends.along - p[:, :1]
        w = weight * (ends.used & (off > begin) & (off < end))
        value, slopes = _model(ends, p, moved, camera)
        left = ends.level - value
        if turn > 2:
            noise = 1.4826 * median_of(np.abs(left), w > 0, axis=1)
            noise = np.maximum(noise, LEAST_NOISE)
            weight = np.minimum(1.0, FAR * noise[:, None] / np.maximum(np.abs(left), 1e-9))
        normal = np.einsum("fp,ifp,jfp->fij", w, slopes, slopes)
        # the tilt is small, and so is the offset of the background, whose levels are known
        prior = np.zeros_like(p)
        prior[:, 2], prior[:, 3] = 1e-2 * normal[:, 1, 1], 0.25
        right = np.einsum("fp,ifp,fp->fi", w, slopes, left) - prior * p
        prior += 1e-6 * np.einsum("fii->fi", normal) + 1e-9
        normal += prior[:, :, None] * np.eye(4)
        step = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        step[:, 0] = np.clip(step[:, 0], -2.0, 2.0)
        p += step
        if turn > 4 and np.abs(step[:, 0]).max() < 1e-3:
            break
    freedom = np.maximum((w > 0).sum(axis=1) - 4, 2)
    square = (w * left**2).sum(axis=1) / freedom
    return Edges(p[:, 0], np.sqrt(square * np.linalg.inv(normal)[:, 0, 0]), square)


def _model(ends: Ends, p: Array, moved: Array, camera: Camera) -> tuple[Array, Array]:
    """Levels (frames, pixels) and their derivatives (4, frames, pixels) in the numbers ``p``
    (frames, 4)."""
    at, level, tilt, offset = p.T[:, :, None]
    gap = (at[:, :, None] + moved[:, None, :] - ends.along[:, :, None]) / camera.psf_px
    share = ndtr(gap).mean(axis=2)
    slope = np.exp(-0.5 * gap**2).mean(axis=2) / (np.sqrt(2.0 * np.pi) * camera.psf_px)
    inward = np.clip((ends.along - at) / 10.0, -4.0, 4.0)
    strip = np.clip(level + tilt * inward, 1.0, 400.0)
    back = np.clip(ends.behind + offset, 1.0, 400.0)
    g = camera.gamma
    value, of_strip, of_back = mixed(share, strip, back, g)
    of_at = slope * (strip**g - back**g) * value ** (1.0 - g) / g
    return value, np.stack([of_at, of_strip, of_strip * inward, of_back])


def mixed(share: Array, front: Array, back: Array, gamma: float) -> tuple[Array, Array, Array]:
    """The level of light of which a ``share`` comes from the front and the rest from the back, and
    its derivatives in the levels of both."""
    light = share * front**gamma + (1.0 - share) * back**gamma
    level, bent = light ** (1.0 / gamma), gamma - 1.0
    return level, share * (front / level) ** bent, (1.0 - share) * (back / level) ** bent


def camera_of(ends: Ends, free: NDArray[np.bool_], frame_s: float, given: Camera) -> Camera:
    """The camera that explains the edges best: its blur from frames in which the end is still,
    exposure (unless known) and gamma from frames in which it is fast and flies ``free``."""
    moving = np.abs(ends.speed) * frame_s
    still = _some(ends, moving < STILL_PX)
    if not len(still.guess):
        still = _some(ends, moving < np.percentile(moving, 20))
    fast = _some(ends, free & (moving > FAST_PX))

    def misfit(seen: Ends, tried: Camera) -> float:
        return float(np.sum(np.log(edges(seen, tried).square + 0.05)))

    def best(seen: Ends, camera: Camera, name: str, low: float, high: float) -> Camera:
        """The camera with that value of one of its numbers that leaves least."""

        def with_value(value: float) -> Camera:
            number: dict[str, Any] = {name: float(value)}
            return replace(camera, **number)

        found = minimize_scalar(
            lambda value: misfit(seen, with_value(value)),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 0.01 * (high - low)},
        )
        return with_value(found.x)

    camera = best(still, given, "psf_px", 0.25, MOST_PSF_PX)
    if len(fast.guess) < 3:
        return camera
    if not given.exposure_known:
        tried = frame_s * np.linspace(0.0, 1.0, 11)
        costs = [misfit(fast, replace(camera, exposure_s=float(each))) for each in tried]
        k = int(np.argmin(costs))
        camera = best(fast, camera, "exposure_s", tried[max(k - 1, 0)], tried[min(k + 1, 10)])
    plain = misfit(fast, camera)
    bent = best(fast, camera, "gamma", 1.0, MOST_GAMMA)
    # half the sum of logarithms times the pixels of an edge is a log likelihood
    blurred = np.abs(fast.speed).mean() * camera.exposure_s + 6.0
    if 0.5 * blurred * (plain - misfit(fast, bent)) > CLEARLY:
        return replace(bent, gamma_known=True)
    phone = misfit(fast, replace(camera, gamma=MOST_GAMMA))
    return replace(camera, gamma_known=0.5 * blurred * (phone - plain) > CLEARLY)


def _some(ends: Ends, which: NDArray[np.bool_]) -> Ends:
    """Some of the frames that ``which`` tells, spread over all of them."""
    found = np.flatnonzero(which)
    return ends.of_frames(found[:: -(-len(found) // MOST_FRAMES) or 1])
