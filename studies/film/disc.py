"""A ball in a picture: a disc that moves, drawn long by its speed.

It is found as what differs from the background, has the same width in most samples, and touches no
border of the picture, as a hand does. Its centre is found by least squares of grey levels: a disc
that moves down by a length within the exposure, blurred by the lens. Near its edge its brightness
is linear in the direction that its surface faces (Lambert's law). What is averaged is light; a
camera may write its 1/gamma-th power, and half of a soft edge's light is not half of its levels.
So blur and gamma are found before the radius.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares
from scipy.special import ndtr, softmax

from ...solver.arrays import Array
from .edge import instants, mixed
from .reading import Frame, Picture
from .scan import Scan, coarser

COARSE_ROWS = 240
LEAST_RADIUS_PX = 3.0
LIKE = 0.2
"""By what share a blob's width may differ from the ball's."""
PSF_PX, PIXEL_PX = 0.65, 12.0**-0.5
"""Of a lens, and of a pixel, over which it is averaged: standard deviations."""
GAMMAS = np.array([1.0, 1.4, 1.8, 2.2])
LIKELY = np.array([3.0, 1.0, 1.0, 1.0])
"""How likely a film has them before it is looked at: linear, as cameras of laboratories often write
them, or any gamma up to that of a telephone."""
MOST_CLEAR = 12
"""How many samples tell blur, gamma and radius."""
ALIKE = 200.0
"""So many pixels tell as much of gamma as one, since compression and shadows are off in many."""
FAR = 4.0
RIM_PX = 5.0
"""How far inward from its edge the disc is looked at: farther in it may shine."""


@dataclass(frozen=True)
class Disc:
    """A ball in one frame: its centre, the length that it moves down within the exposure, its
    radius, the lens' blur, and the standard error of the centre's row, all in px. ``unlikely`` is
    minus twice the logarithm of the likelihood of what it leaves."""

    number: int
    t_s: float
    column: float
    row: float
    length: float
    radius: float
    psf_px: float
    sigma: float
    unlikely: float


@dataclass(frozen=True)
class Ball:
    """What is known of a film's ball: the picture without it, its radius in px, its brightness over
    the background's, and the factor by which pictures are made coarser to look for it. ``psf_px``
    and ``gamma`` are the camera's, ``radius_error`` is the radius' standard error in px."""

    still: Array
    radius: float
    contrast: float
    factor: int
    noise: float
    psf_px: float = PSF_PX
    gamma: float = 1.0
    radius_error: float = 0.0


def find_ball(film: Scan) -> Ball | None:
    """The ball that moves in a film; None where there is none."""
    still = np.median(film.samples, axis=0).astype(np.float32)
    factor = max(1, round(film.shape[0] / COARSE_ROWS))
    found = [
        (number, *blob)
        for number in range(len(film.samples))
        for blob in blobs(film.samples[number], still, factor, film.noise)
    ]
    if not found:
        return None
    number, column, row, width, _, contrast = np.array(found).T
    near = np.abs(width[:, None] - width) < LIKE * width
    same = near & (np.sign(contrast)[:, None] == np.sign(contrast))
    most = same[int(np.argmax(same.sum(axis=1)))]
    moved = np.hypot(np.ptp(column[most]), np.ptp(row[most]))
    if most.sum() < max(3, len(film.samples) // 8) or moved < 0.5 * np.median(width[most]):
        return None
    radius = float(np.median(width[most])) / 2.0
    ball = Ball(still, radius, float(np.median(contrast[most])), factor, film.noise)
    clear = np.unique(number[most]).astype(int)
    clear = clear[:: -(-len(clear) // MOST_CLEAR)]
    return _as_written(ball, [Frame(0, 0.0, film.samples[each]) for each in clear])


def _as_written(ball: Ball, frames: Sequence[Frame]) -> Ball | None:
    """The ball with the radius, blur and gamma that frames tell; None where too few show it."""
    tried = [replace(ball, gamma=float(each)) for each in GAMMAS]
    sights = [[_seen(frame, each, None, free_radius=True) for each in tried] for frame in frames]
    whole = [[(d.radius, d.psf_px, d.unlikely) for d in row if d] for row in sights if all(row)]
    if len(whole) < 3:
        return None
    radius, psf_px, unlikely = np.moveaxis(np.array(whole), 2, 0)  # each (frames, gammas)
    chance = softmax(np.log(LIKELY) - 0.5 * unlikely.sum(axis=0) / ALIKE)
    radii = np.median(radius, axis=0)
    mean = float(chance @ radii)
    scatter = 1.4826 * np.median(np.abs(radius - radii), axis=0) / np.sqrt(len(whole))
    return replace(
        ball,
        radius=mean,
        radius_error=float(np.sqrt(chance @ ((radii - mean) ** 2 + scatter**2))),
        psf_px=float(chance @ np.median(psf_px, axis=0)),
        gamma=float(chance @ GAMMAS),
    )


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
    first = np.array([*start[:2], max(start[2], 0.5), ball.radius, ball.psf_px])

    def share_of(p: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The disc's share of each pixel's light, by how much its surface faces us there (a
        cosine), and which pixels lie near its edge."""
        away = np.hypot(column[..., None] - p[0], row[..., None] - p[1] - p[2] * parts)
        shares = ndtr((p[3] - away) / np.hypot(p[4], PIXEL_PX))
        faces = np.sqrt(np.maximum(1.0 - (away / p[3]) ** 2, 0.0))
        share = shares.mean(axis=-1)
        facing = (shares * faces).mean(axis=-1) / np.maximum(share, 1e-9)
        return share, facing, (away > p[3] - RIM_PX).any(axis=-1)

    def residual(moved: Array) -> Array:
        """Levels that are left where the disc's brightness is linear in the direction that it
        faces, and the shadow that it throws on what is behind it is linear across."""
        p = first + np.pad(moved, (0, 5 - len(moved)))
        share, facing, rim = share_of(p)
        plane = np.stack([np.ones_like(share), column - p[0], row - p[1]])
        lit = np.concatenate([plane, facing[None]])
        front, back = behind + ball.contrast, behind
        for _ in range(2 if ball.gamma > 1.0 else 1):  # once is exact in a linear film
            front, back = np.clip(front, 1.0, 400.0), np.clip(back, 1.0, 400.0)
            # a mixture is the sum of both levels, each times its derivative (Euler)
            _, of_front, of_back = mixed(share, front, back, ball.gamma)
            design = (np.concatenate([of_front * lit, of_back * plane]) * rim).reshape(7, -1)
            want = ((level - behind * of_back) * rim).ravel()
            shading = np.linalg.solve(design @ design.T + 1e-9 * np.eye(7), design @ want)
            front = np.tensordot(shading[:4], lit, 1)
            back = behind + np.tensordot(shading[4:], plane, 1)
        return want - shading @ design

    free = np.zeros(5 if free_radius else 3)
    # once to know what is usually left, which a shine or a shadow exceeds
    found = least_squares(residual, free, xtol=1e-2)
    usual = max(1.4826 * float(np.median(np.abs(found.fun))), 0.5)
    found = least_squares(residual, found.x, loss="huber", f_scale=FAR * usual, xtol=1e-4)
    p = first + np.pad(found.x, (0, 5 - len(found.x)))
    square = float(np.mean(found.fun**2))
    seen = float((share_of(p)[0] > 0.5).sum())
    if seen < 0.5 * np.pi * p[3] ** 2 or square > (0.35 * ball.contrast) ** 2:
        return None
    x, y, length, radius, psf_px = map(float, p)
    sigma = float(np.sqrt(square * np.linalg.pinv(found.jac.T @ found.jac)[1, 1]))
    unlikely = level.size * float(np.log(2.0 * found.cost / level.size + 0.05))
    return Disc(frame.number, frame.t_s, x, y, abs(length), radius, abs(psf_px), sigma, unlikely)
