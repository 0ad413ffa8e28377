"""A rod's elements and nodes, and the block-tridiagonal system that they make.

Node 0 is clamped. Its row is kept for the reaction; the system is that of the other nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array, zeros
from ..compiled import njit
from .section import RodSection


class Chain(NamedTuple):
    """One rod: ``length`` (e,) in m of its elements, their stiffness (e, 6) and strains at rest.

    Strains are those of `element.measure`. Inertia is lumped in the nodes: ``mass`` (e + 1,) in kg
    and ``inertia`` (e + 1, 3) in kg m² about the section's axes. ``beta`` and ``alpha`` are the
    damping's.
    """

    length: Array
    stiffness: Array
    rest: Array
    mass: Array
    inertia: Array
    beta: float
    alpha: float


def uniform_chain(section: RodSection, length_m: float, elements: int) -> Chain:
    """A rod of equal elements.

    Shear's stiffness has the residual bending flexibility in series, 1/GA + l²/(12 EI): it makes
    two nodes with one point of integration exact under end loads while rotations are small
    (MacNeal, Comput. Struct. 8 (1978) 175), and keeps a thin rod from locking.
    """
    length = length_m / elements
    shear_1 = 1.0 / (1.0 / section.GA1_N + length**2 / (12.0 * section.EI2_Nm2))
    shear_2 = 1.0 / (1.0 / section.GA2_N + length**2 / (12.0 * section.EI1_Nm2))
    bending = section.EI1_Nm2, section.EI2_Nm2, section.GJ_Nm2
    rotary = section.rhoI1_kg_m, section.rhoI2_kg_m, section.rhoI1_kg_m + section.rhoI2_kg_m
    share = np.full(elements + 1, length)
    share[[0, -1]] *= 0.5
    return Chain(
        length=np.full(elements, length),
        stiffness=np.tile([shear_1, shear_2, section.EA_N, *bending], (elements, 1)),
        rest=np.tile([0.0, 0.0, 1.0, *section.curvature_1_m], (elements, 1)),
        mass=section.rhoA_kg_m * share,
        inertia=np.outer(share, rotary),
        beta=section.beta_s,
        alpha=section.alpha_1_s,
    )


def at_rest(chain: Chain, position_m: Array, rotation: Array) -> tuple[Array, Array]:
    """Centre line (e + 1, 3) and quaternions (e + 1, 4) of a rod without strain, from its clamp's
    position (3,) and rotation (3, 3)."""
    from scipy.spatial.transform import Rotation

    attitude = Rotation.from_matrix(rotation)
    places, attitudes = [np.asarray(position_m, dtype=float)], [attitude]
    for e in range(len(chain.length)):
        length, rest = chain.length[e], chain.rest[e]
        half = Rotation.from_rotvec(0.5 * length * rest[3:])
        places.append(places[-1] + length * (attitude * half).apply(rest[:3]))
        attitude = attitude * half * half
        attitudes.append(attitude)
    quaternions = Rotation.concatenate(attitudes).as_quat()
    return np.array(places), np.ascontiguousarray(quaternions[:, [3, 0, 1, 2]])


def stacked(chains: Sequence[Chain]) -> Chain:
    """Chains of as many elements each, stacked along a first axis, numbers too; see
    `compiled.nth`."""
    return Chain._make(np.array(each) for each in zip(*chains, strict=True))


@njit
def total_length(chain: Chain) -> float:
    """In m."""
    total = 0.0
    for e in range(len(chain.length)):
        total += chain.length[e]
    return total


class System(NamedTuple):
    """Newton's system of one rod: blocks (n, 6, 6) of the diagonal, above and below it, residual
    (n, 6), and room for its solution (n, 6).

    Of a node's six rows and unknowns the first three are forces and displacements in world axes,
    the others moments and rotations about world axes.
    """

    diagonal: Array
    above: Array
    below: Array
    residual: Array
    solution: Array


def new_system(n: int) -> System:
    """Room for a rod of ``n`` nodes."""
    return zeros(System, (n, 6, 6), (n, 6, 6), (n, 6, 6), (n, 6), (n, 6))


@njit
def _eliminate(room: Array, width: int) -> bool:
    """Gauss and Jordan with pivots on 6 rows of ``width`` columns; False where it is singular."""
    for k in range(6):
        p = k
        for i in range(k + 1, 6):
            if abs(room[i, k]) > abs(room[p, k]):
                p = i
        pivot = room[p, k]
        if not abs(pivot) > 0.0:
            return False
        if p != k:
            for j in range(k, width):
                room[k, j], room[p, j] = room[p, j], room[k, j]
        pivot = 1.0 / pivot
        for j in range(k + 1, width):
            room[k, j] *= pivot
        for i in range(6):
            factor = room[i, k]
            if i != k and factor != 0.0:
                for j in range(k + 1, width):
                    room[i, j] -= factor * room[k, j]
    return True


@njit
def solve_columns(system: System, columns: Array) -> bool:
    """Solve for ``columns`` (n, 6, m) of loads in place: block Gauss elimination.

    The clamped node does not move. Blocks of six are eliminated by hand: LAPACK's overhead on them
    is several times the arithmetic. The blocks ``above`` are used up. Returns False where the
    matrix is singular.
    """
    diagonal, above, below = system.diagonal, system.above, system.below
    n, many = columns.shape[0], columns.shape[2]
    room = np.empty((6, 12 + many))
    for r in range(6):
        for j in range(many):
            columns[0, r, j] = 0.0
    for i in range(1, n):
        width = 12 + many if i < n - 1 else 6 + many
        for r in range(6):
            for c in range(6):
                room[r, c] = diagonal[i, r, c]
                if i < n - 1:
                    room[r, 6 + many + c] = above[i, r, c]
            for j in range(many):
                room[r, 6 + j] = columns[i, r, j]
            if i > 1:
                for k in range(6):
                    factor = below[i, r, k]
                    for c in range(6):
                        room[r, c] -= factor * above[i - 1, k, c]
                    for j in range(many):
                        room[r, 6 + j] -= factor * columns[i - 1, k, j]
        if not _eliminate(room, width):
            return False
        for r in range(6):
            for j in range(many):
                columns[i, r, j] = room[r, 6 + j]
            if i < n - 1:
                for c in range(6):
                    above[i, r, c] = room[r, 6 + many + c]
    for i in range(n - 2, 0, -1):
        for r in range(6):
            for c in range(6):
                for j in range(many):
                    columns[i, r, j] -= above[i, r, c] * columns[i + 1, c, j]
    return True
