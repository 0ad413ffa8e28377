"""What a tip lands on: a plane under each of its points, and how stiff it is there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .bodies.base import Array, ContactPoints
from .compiled import njit
from .rigid import Pose


@dataclass(frozen=True)
class Ground:
    """The surface as each contact point sees it, rigid in shape.

    Point i meets the plane ``normals[i]`` · x = ``offsets_m[i]`` in world axes; ``scale`` (n,) is
    the stiffness of contact there over the law's.
    """

    normals: Array
    offsets_m: Array
    scale: Array

    @classmethod
    def plane(cls, n_points: int, normal: Array | None = None) -> Ground:
        """One plane through the origin for all points, horizontal unless ``normal`` (3,) is given.

        Raises ValueError where the normal does not point up.
        """
        up = np.array([0.0, 0.0, 1.0]) if normal is None else np.asarray(normal, dtype=float)
        if not up[2] > 0.0:
            raise ValueError("the surface's normal must point up")
        up = up / np.linalg.norm(up)
        return cls(np.tile(up, (n_points, 1)), np.zeros(n_points), np.ones(n_points))


@dataclass(frozen=True)
class Placement:
    """Where a body stands over the ground, in its own axes: ``pose`` in the world's.

    ``frames`` (n, 3, 3) holds the normal and two tangents under each point as rows, ``gaps_m`` (n,)
    the gaps of the unstrained body, ``scale`` (n,) the stiffness of contact over the law's; ``up``
    (3,) is the vertical. ``tip_m`` and ``centre_m`` are the heights of the end section's middle,
    from ``datum_m`` on, and of the centre of mass.
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

    def gaps(self, displacements: Array) -> Array:
        """The gap (n,) of points displaced by (n, 3) along body axes."""
        return np.asarray(self.gaps_m + np.einsum("ix,ix->i", self.frames[:, 0], displacements))


@njit
def local_frames(
    normals: Array, offsets: Array, position: Array, rotation: Array, places: Array
) -> tuple[Array, Array]:
    """Frames (n, 3, 3) in body axes, the first tangent nearest to x, and gaps (n,)."""
    n = len(places)
    frames = np.empty((n, 3, 3))
    gaps = np.empty(n)
    for i in range(n):
        normal = rotation.T @ normals[i]
        across = -normal[0] * normal
        across[0] += 1.0
        size = np.sqrt(across[0] ** 2 + across[1] ** 2 + across[2] ** 2)
        across /= size
        frames[i, 0] = normal
        frames[i, 1] = across
        frames[i, 2, 0] = normal[1] * across[2] - normal[2] * across[1]
        frames[i, 2, 1] = normal[2] * across[0] - normal[0] * across[2]
        frames[i, 2, 2] = normal[0] * across[1] - normal[1] * across[0]
        at = position + rotation @ places[i]
        gaps[i] = normals[i, 0] * at[0] + normals[i, 1] * at[1] + normals[i, 2] * at[2] - offsets[i]
    return frames, gaps


def place(ground: Ground, pose: Pose, points: ContactPoints, datum_m: float = 0.0) -> Placement:
    """A body in ``pose`` over the ``ground``; the tip's height counts from ``datum_m``."""
    rotation = pose.rotation
    places = np.ascontiguousarray(points.places_m, dtype=float)
    frames, gaps = local_frames(ground.normals, ground.offsets_m, pose.position_m, rotation, places)
    tip = float(pose.position_m[2] + rotation[2] @ (points.weights @ places))
    up = np.ascontiguousarray(rotation[2])
    centre = float(pose.position_m[2])
    return Placement(ground, datum_m, pose, frames, gaps, ground.scale, up, tip - datum_m, centre)


def just_touched(ground: Ground, pose: Pose, points: ContactPoints) -> Ground:
    """The ground moved up or down until the unstrained body's first point just touches it."""
    clear = place(ground, pose, points).gaps_m
    rise = float((clear / ground.normals[:, 2]).min())
    return replace(ground, offsets_m=ground.offsets_m + rise * ground.normals[:, 2])
