"""The ground under a tip: a plane under each contact point, and its local stiffness."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .bodies.base import ContactPoints
from .compiled import njit
from .rigid import Pose

SAME_LEVEL_M = 1e-9
"""Points whose gaps differ by less touch at once."""


@dataclass(frozen=True)
class Ground:
    """The surface as each contact point sees it, rigid in shape.

    Point i meets the plane ``normals[i]`` · x = ``offsets_m[i]`` in world axes; ``scale`` (n,) is
    the local contact stiffness over the law's.
    """

    normals: Array
    offsets_m: Array
    scale: Array

    @classmethod
    def plane(cls, n_points: int, normal: Array | None = None) -> Ground:
        """One plane through the origin for all points, horizontal unless ``normal`` (3,) is given.

        Raises ValueError if the normal does not point up.
        """
        up = np.array([0.0, 0.0, 1.0]) if normal is None else np.asarray(normal, dtype=float)
        if not up[2] > 0.0:
            raise ValueError("the surface's normal must point up")
        up = up / np.linalg.norm(up)
        return cls(np.tile(up, (n_points, 1)), np.zeros(n_points), np.ones(n_points))


@dataclass(frozen=True)
class Placement:
    """Position of a body over the ground, in body axes; ``pose`` is its pose in the world.

    ``frames`` (n, 3, 3) holds the normal and two tangents under each point as rows, ``gaps_m`` (n,)
    the gaps of the unstrained body, ``scale`` (n,) the contact stiffness over the law's; ``up``
    (3,) is the vertical. ``tip_m`` is the height of the end section's middle over ``datum_m``,
    ``centre_m`` that of the centre of mass.
    """

    ground: Ground
    datum_m: float
    pose: Pose
    frames: Array
    gaps_m: Array
    scale: Array
    up: Array
    tip_m: float
    centre_m: float

    @classmethod
    def upright(cls, points: ContactPoints) -> Placement:
        """Over a horizontal plane, the lowest points just touching."""
        pose, plane = Pose.upright(), Ground.plane(len(points.weights))
        ground = just_touched(plane, pose, points)
        return place(ground, pose, points, place(ground, pose, points).tip_m)

    def nearest(self, points: ContactPoints) -> tuple[Array, Array]:
        """The place where the unstrained body is nearest to the ground, and the normal there, (3,).

        Both in world axes; the centroid if several points are equally near.
        """
        near = self.gaps_m <= self.gaps_m.min() + SAME_LEVEL_M
        weights = points.weights[near] / points.weights[near].sum()
        place = self.pose.position_m + self.pose.rotation @ (weights @ points.places_m[near])
        normal = weights @ self.ground.normals[near]
        return place, normal / np.linalg.norm(normal)

    def gaps(self, displacements: Array) -> Array:
        """The gap (n,) of points displaced by (n, 3) along body axes."""
        return np.asarray(self.gaps_m + np.einsum("ix,ix->i", self.frames[:, 0], displacements))


@njit
def local_frames(
    normals: Array, offsets: Array, position: Array, rotation: Array, places: Array
) -> tuple[Array, Array]:
    """Frames (n, 3, 3) in body axes, the first tangent nearest to x, and gaps (n,)."""
    frames = np.empty((len(places), 3, 3))
    normal = normals @ rotation
    for i in range(len(places)):
        n0, n1, n2 = normal[i, 0], normal[i, 1], normal[i, 2]
        size = math.sqrt((1.0 - n0 * n0) ** 2 + (n0 * n1) ** 2 + (n0 * n2) ** 2)
        a0, a1, a2 = (1.0 - n0 * n0) / size, -n0 * n1 / size, -n0 * n2 / size
        frames[i, 0] = n0, n1, n2
        frames[i, 1] = a0, a1, a2
        frames[i, 2] = n1 * a2 - n2 * a1, n2 * a0 - n0 * a2, n0 * a1 - n1 * a0
    return frames, normals @ position + (normal * places).sum(axis=1) - offsets


def place(ground: Ground, pose: Pose, points: ContactPoints, datum_m: float = 0.0) -> Placement:
    """Placement of a body in ``pose`` over ``ground``; the tip's height counts from ``datum_m``."""
    rotation = pose.rotation
    places = np.ascontiguousarray(points.places_m, dtype=float)
    frames, gaps = local_frames(ground.normals, ground.offsets_m, pose.position_m, rotation, places)
    tip = float(pose.position_m[2] + rotation[2] @ (points.weights @ places))
    up = np.ascontiguousarray(rotation[2])
    centre = float(pose.position_m[2])
    return Placement(ground, datum_m, pose, frames, gaps, ground.scale, up, tip - datum_m, centre)


@njit
def touched_offsets(normals: Array, offsets: Array, rotation: Array, places: Array) -> Array:
    """Offsets (n,) of the planes, moved up or down together until the first of ``places`` just
    touches, for a body at the origin."""
    clear = math.inf
    for i in range(len(places)):
        gap = normals[i] @ (rotation @ places[i]) - offsets[i]
        clear = min(clear, gap / normals[i, 2])
    return offsets + clear * normals[:, 2]


def just_touched(ground: Ground, pose: Pose, points: ContactPoints) -> Ground:
    """The ground, moved up or down until the unstrained body's first point just touches it."""
    places = np.ascontiguousarray(points.places_m, dtype=float)
    there = ground.offsets_m - ground.normals @ pose.position_m
    moved = touched_offsets(ground.normals, there, pose.rotation, places)
    return replace(ground, offsets_m=ground.offsets_m + (moved - there))
