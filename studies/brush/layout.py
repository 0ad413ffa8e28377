"""Places and directions of a brush's bristles in its hub: single, row, ring, cup.

The hub's axes are the world's before it moves: z up, x the direction in which it slides. All
clamps lie in the plane z = 0 of the hub, and bristles point downward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...meshes.section import Rectangle, Section
from ...solver.arrays import Array
from ...solver.rods.section import half_sides_m
from ..inputs.choices import Layout

# Far below what a section measures.
SAME_M = 1e-12


@dataclass(frozen=True)
class Stand:
    """Where bristles stand in the plane of the hub: ``place_m`` (n, 2), and the direction outward
    from the hub's axis there, ``outward`` (n, 2), x where there is none."""

    place_m: Array
    outward: Array


def stand(
    layout: Layout, count: int, rows: int, tufts: int, radius_m: float, spacing_m: float
) -> Stand:
    """``count`` bristles in a ``layout``.

    A row lies across x, its further rows behind it. Rings lie inside the outermost one, which has
    ``radius_m``. A ring of a cup has ``tufts`` of equal numbers of bristles, each a grid about as
    deep as it is wide; the rings of a cup are so far apart that one grid line stays free between
    them. Raises ValueError where ``count`` cannot be shared out, or the innermost ring has no room.
    """
    if layout is Layout.SINGLE:
        if count != 1:
            raise ValueError(f"a single bristle is 1, not {count}; take another --layout")
        return Stand(np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    groups = rows * tufts if layout is Layout.CUP else rows
    each, left = divmod(count, groups)
    if left or not each:
        what = {Layout.CUP: "tufts", Layout.RING: "rings"}.get(layout, "rows")
        raise ValueError(f"{count} bristles cannot be shared out evenly over {groups} {what}")
    if layout is Layout.ROW:
        grid = spacing_m * _grid(rows, each)
        away = np.linalg.norm(grid, axis=1, keepdims=True)
        outward = np.where(away > SAME_M, grid / np.maximum(away, SAME_M), [1.0, 0.0])
        return Stand(grid, outward)
    tuft, depth, around = _grid(1, 1), 1, each
    if layout is Layout.CUP:
        wide = math.ceil(math.sqrt(each))
        depth, around = math.ceil(each / wide), tufts
        tuft = spacing_m * _grid(depth, wide)[:each]
    pitch = spacing_m * (depth + (layout is Layout.CUP))
    radii = radius_m - pitch * np.arange(rows)
    if radii[-1] - 0.5 * depth * spacing_m <= 0.0:
        raise ValueError(
            f"rings {1e3 * pitch:.3g} mm apart, {rows} of them, do not fit into "
            f"a radius of {1e3 * radius_m:.3g} mm"
        )
    angle = np.arange(around) * (2.0 * math.pi / around)
    outward = np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.column_stack([-outward[:, 1], outward[:, 0]])
    # rings, tufts of a ring, bristles of a tuft
    middle = radii[:, None, None, None] * outward[None, :, None]
    inside = tuft[:, :1] * outward[:, None] + tuft[:, 1:] * along[:, None]
    place = (middle + inside[None]).reshape(-1, 2)
    facing = np.broadcast_to(outward[None, :, None], (rows, around, len(tuft), 2)).reshape(-1, 2)
    return Stand(place, facing.copy())


def _grid(deep: int, wide: int) -> Array:
    """Points (deep · wide, 2) one apart about the origin, the first coordinate across rows."""
    x, y = np.meshgrid(np.arange(deep), np.arange(wide), indexing="ij")
    points = np.stack([x - 0.5 * (deep - 1), y - 0.5 * (wide - 1)], axis=-1)
    return np.asarray(points.reshape(-1, 2), dtype=float)


def directions(
    outward: Array, forward: Array, lean_deg: Array, flare_deg: float, twist_deg: float
) -> Array:
    """Axes (n, 3, 3) of bristles as columns: thin side, wide side, axis away from the hub.

    ``forward`` (n, 2) is the direction of motion, ``lean_deg`` (n, 2) how far the clamp leans from
    the vertical along it and to its left; a clamp that leans forward has its tip behind. The axis
    is leaned ``flare_deg`` toward ``outward`` (n, 2) on top, then turned by ``twist_deg``.
    """
    n = len(forward)
    left = np.column_stack([-forward[:, 1], forward[:, 0]])
    slope = np.tan(np.radians(lean_deg))
    flat = math.tan(math.radians(flare_deg)) * outward
    flat = flat - slope[:, :1] * forward - slope[:, 1:] * left
    axis = np.column_stack([flat, np.full(n, -1.0)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    ahead = np.column_stack([forward, np.zeros(n)])
    thin = ahead - np.einsum("ix,ix->i", ahead, axis)[:, None] * axis
    thin /= np.linalg.norm(thin, axis=1)[:, None]
    wide = np.cross(axis, thin)
    c, s = math.cos(math.radians(twist_deg)), math.sin(math.radians(twist_deg))
    return np.stack([c * thin + s * wide, c * wide - s * thin, axis], axis=-1)


def lowest_m(section: Section, roots_m: Array, rotation: Array, length_m: Array) -> Array:
    """Height (n,) of the lowest point of each straight bristle's lower end section."""
    ends = roots_m[:, 2] + length_m * rotation[:, 2, 2]
    half = half_sides_m(section)
    if isinstance(section, Rectangle):
        return np.asarray(ends - np.abs(rotation[:, 2, :2]) @ half)
    return np.asarray(ends - half[0] * np.hypot(rotation[:, 2, 0], rotation[:, 2, 1]))


def overlapping(
    section: Section, roots_m: Array, rotation: Array, length_m: Array
) -> tuple[int, int] | None:
    """The first two straight bristles that overlap, or None.

    Each is a box, and two boxes are apart where one of 15 axes separates them (Gottschalk, Lin and
    Manocha, OBBTree, SIGGRAPH 1996). A round wire is taken as the square around it.
    """
    half = np.column_stack([np.tile(half_sides_m(section), (len(length_m), 1)), 0.5 * length_m])
    centres = roots_m + 0.5 * length_m[:, None] * rotation[:, :, 2]
    axes = np.swapaxes(rotation, 1, 2)
    for i in range(len(length_m) - 1):
        # a box's own axes settle nearly all, at little cost
        seen = np.abs(axes[i + 1 :].reshape(-1, 3) @ rotation[i]).reshape(-1, 3, 3)
        reach = half[i] + np.einsum("nka,nk->na", seen, half[i + 1 :])
        distance = np.abs((centres[i + 1 :] - centres[i]) @ rotation[i])
        near = i + 1 + np.flatnonzero((distance < reach).all(axis=1))
        between = centres[near] - centres[i]
        crossed = np.cross(axes[i][None, :, None], axes[near][:, None]).reshape(-1, 9, 3)
        further = np.concatenate([axes[near], crossed], axis=1)
        left = ~_apart(further, between, rotation[i], half[i], rotation[near], half[near])
        if left.any():
            return i, int(near[left][0])
    return None


def _apart(
    axes: Array, between: Array, own: Array, own_half: Array, others: Array, half: Array
) -> NDArray[np.bool_]:
    """Whether one of ``axes`` (n, k, 3) separates the box of axes ``own`` (3, 3) from each of
    ``others`` (n, 3, 3) at ``between`` (n, 3) from it."""
    reach = np.abs(axes @ own) @ own_half + (np.abs(axes @ others) @ half[..., None])[..., 0]
    distance = np.abs((axes @ between[..., None])[..., 0])
    # parallel axes have no cross product, which separates nothing
    return np.asarray((distance >= np.maximum(reach, SAME_M)).any(axis=1))
