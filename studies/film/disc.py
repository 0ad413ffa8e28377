"""A ball in a picture: a disc that moves, drawn long by its speed.

It is found as what differs from the background, has the same width in most samples, and touches no
border of the picture, as a hand does. Its centre is found by least squares of grey levels: a disc
that moves down by a length within the exposure, blurred by the lens. Near its edge its brightness
is linear across.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.special import ndtr

from ...solver.arrays import Array
from .edge import instants
from .reading import Frame, Picture
from .scan import Scan, coarser

COARSE_ROWS = 240
LEAST_RADIUS_PX = 3.0
LIKE = 0.2
"""By what share a blob's width may differ from the ball's."""
PSF_PX = 0.7
FAR = 4.0
RIM_PX = 5.0
"""How far inward from its edge the disc is looked at: farther in it may shine."""


@dataclass(frozen=True)
class Disc:
    """A ball in one frame: its centre, the length that it moves down within the exposure, its
    radius, and the standard error of the centre's row, all in px."""

    number: int
    t_s: float
    column: float
    row: float
    length: float
    radius: float
    sigma: float


@dataclass(frozen=True)
class Ball:
    """What is known of a film's ball: the picture without it, its radius in px, its brightness over
    the background's, and the factor by which pictures are made coarser to look for it."""

    still: Array
    radius: float
    contrast: float
    factor: int
    noise: float


def find_ball(film: Scan) -> Ball | None:
    """The ball that moves in a film; None where there is none."""
    still = np.median(film.samples, axis=0).astype(np.float32)
    factor = max(1, round(film.shape[0] / COARSE_ROWS))
    found = [each for s in film.samples for each in blobs(s, still, factor, film.noise)]
    if not found:
        return None
    column, row, width, _, contrast = np.array(found).T
    near = np.abs(width[:, None] - width) < LIKE * width
    same = near & (np.sign(contrast)[:, None] == np.sign(contrast))
    most = same[int(np.argmax(same.sum(axis=1)))]
    moved = np.hypot(np.ptp(column[most]), np.ptp(row[most]))
    if most.sum() < max(3, len(film.samples) // 8) or moved < 0.5 * np.median(width[most]):
        return None
    radius = float(np.median(width[most])) / 2.0
    ball = Ball(still, radius, float(np.median(contrast[most])), factor, film.noise)
    frames = [Frame(0, 0.0, sample) for sample in film.samples]
    fitted = [_seen(frame, ball, None, free_radius=True) for frame in frames]
    radii = [disc.radius for disc in fitted if disc is not None]
    return replace(ball, radius=float(np.median(radii))) if len(radii) >= 3 else None


def discs(frames: Iterable[Frame], ball: Ball) -> list[Disc]:
    """The ball in each frame in which it is seen whole."""
    found: list[Disc] = []
    for frame in frames:
        seen = _seen(frame, ball, found[-1] if found else None)
        if seen is not None:
            found.append(seen)
    return found


def blobs(
    grey: Picture, still: Array, factor: int, noise: float
) -> list[tuple[float, float, float, float, float]]:
    """Column, row, width, height and contrast of what differs from the background and touches no
    border, in px."""
    coarse = coarser(grey - still, factor)
    rows, columns = coarse.shape
    size = np.abs(coarse)
    threshold = max(6.0 * noise / factor + 3.0, 0.35 * float(size.max()))
    labels, _ = ndimage.label(size > threshold)
    found = []
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        down, right = box
        height, width = down.stop - down.start, right.stop - right.start
        inside = down.start > 0 and right.start > 0 and down.stop < rows and right.stop < columns
        mask = labels[box] == number
        # a disc fills pi / 4 of the square about it, one drawn long more
        if not inside or width * factor < 2 * LEAST_RADIUS_PX or not 0.6 < mask.mean() <= 1.0:
            continue
        if not 0.8 * width < height < 6.0 * width:
            continue
        contrast = float(np.median(coarse[box][mask]))
        middle = (factor - 1) / 2.0
        column = factor * (right.start + (width - 1) / 2.0) + middle
        row = factor * (down.start + (height - 1) / 2.0) + middle
        # the middle row of the mask is as wide as the disc
        wide = float(np.median(mask.sum(axis=1)[height // 3 : height - height // 3]))
        found.append((column, row, factor * wide, float(factor * height), contrast))
    return found


def _seen(frame: Frame, ball: Ball, last: Disc | None, free_radius: bool = False) -> Disc | None:
    """The ball in a frame; None where it is not seen. Of blobs that are like it, the one nearest to
    the ``last`` disc is it, or else the one most like it."""

    def unlike(width: float) -> float:
        return abs(width / ball.radius / 2.0 - 1.0)

    found = []
    for column, row, width, height, contrast in blobs(
        frame.grey, ball.still, ball.factor, ball.noise
    ):
        if unlike(width) < 1.5 * LIKE and contrast * ball.contrast > 0.0:
            far = np.hypot(column - last.column, row - last.row) if last else unlike(width)
            found.append((float(far), (column, row, max(height - width, 0.0))))
    return _fitted(frame, ball, min(found)[1], free_radius) if found else None


def _fitted(
    frame: Frame, ball: Ball, start: tuple[float, float, float], free_radius: bool
) -> Disc | None:
    """The disc near ``start``, by least squares; None where it is not in the picture.

    ``start`` has its column and row, and the length that it moves.
    """
    reach_x = int(ball.radius + 6.0)
    reach_y = int(ball.radius + 0.7 * start[2] + 6.0)
    left, top = round(start[0]) - reach_x, round(start[1]) - reach_y
    rows, columns = frame.grey.shape
    part = np.s_[
        max(top, 0) : min(top + 2 * reach_y + 1, rows),
        max(left, 0) : min(left + 2 * reach_x + 1, columns),
    ]
    level = frame.grey[part].astype(float)
    if level.size < 9:
        return None
    behind = ball.still[part].astype(float)
    row, column = np.mgrid[part]
    parts = instants(1.0, int(np.ceil(start[2])))
    first = np.array([*start[:2], max(start[2], 0.5), ball.radius])

    def share_of(p: Array) -> tuple[Array, NDArray[np.bool_]]:
        """The disc's share of each pixel, and which lie near its edge."""
        away = np.hypot(column[..., None] - p[0], row[..., None] - p[1] - p[2] * parts)
        share = ndtr((p[3] - away) / PSF_PX).mean(axis=-1)
        return share, (away > p[3] - RIM_PX).any(axis=-1)

    def residual(moved: Array) -> Array:
        """Levels that are left where the disc's brightness is linear across, and so is the shadow
        that it throws on what is behind it."""
        p = first + np.pad(moved, (0, 4 - len(moved)))
        share, rim = share_of(p)
        plane = np.stack([np.ones_like(share), column - p[0], row - p[1]])
        design = (np.concatenate([share * plane, (1.0 - share) * plane]) * rim).reshape(6, -1)
        want = ((level - behind * (1.0 - share)) * rim).ravel()
        shading = np.linalg.solve(design @ design.T + 1e-9 * np.eye(6), design @ want)
        return want - shading @ design

    free = np.zeros(4 if free_radius else 3)
    # once to know what is usually left, which a shine or a shadow exceeds
    found = least_squares(residual, free, xtol=1e-2)
    usual = max(1.4826 * float(np.median(np.abs(found.fun))), 0.5)
    found = least_squares(residual, found.x, loss="huber", f_scale=FAR * usual, xtol=1e-4)
    p = first + np.pad(found.x, (0, 4 - len(found.x)))
    square = float(np.mean(found.fun**2))
    seen = float((share_of(p)[0] > 0.5).sum())
    if seen < 0.5 * np.pi * p[3] ** 2 or square > (0.35 * ball.contrast) ** 2:
        return None
    sigma = float(np.sqrt(square * np.linalg.pinv(found.jac.T @ found.jac)[1, 1]))
    return Disc(
        frame.number, frame.t_s, float(p[0]), float(p[1]), abs(float(p[2])), float(p[3]), sigma
    )
