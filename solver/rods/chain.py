"""Elements and nodes of a rod, and its block-tridiagonal system.

Node 0 is clamped. Its row is kept for the reaction; the system is that of the other nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array, zeros
from ..compiled import inlined, njit
from .section import RodSection


class Chain(NamedTuple):
    """One rod: ``length`` (e,) in m of its elements, their ``stiffness`` (e, 6) and ``rest``
    strains.

    Strains are those of `element.measure`. Inertia is lumped at the nodes: ``mass`` (e + 1,) in kg
    and ``inertia`` (e + 1, 3) in kg m² about the section's axes. Damping is Rayleigh's.
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

    Shear stiffness has the residual bending flexibility in series, 1/GA + l²/(12 EI). With it, two
    nodes and one integration point are exact under end loads at small rotation (MacNeal, Comput.
    Struct. 8 (1978) 175), and a thin rod does not lock.
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
    """Centre line (e + 1, 3) and quaternions (e + 1, 4) of an unstrained rod, from its clamp's
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
    """Chains of equal numbers of elements, stacked along a first axis, scalars too; see
    `compiled.nth`."""
    return Chain._make(np.array(each) for each in zip(*chains, strict=True))


@njit
def total_length(chain: Chain) -> float:
    """Length of the rod in m."""
    total = 0.0
    for e in range(len(chain.length)):
        total += chain.length[e]
    return total


class System(NamedTuple):
    """Newton's system of one rod: blocks (n, 6, 6) on the diagonal, above and below it, the
    residual (n, 6) and the solution (n, 6).

    The first three rows and unknowns of a node are forces and displacements, the others moments and
    rotations, all in world axes.
    """

    diagonal: Array
    above: Array
    below: Array
    residual: Array
    solution: Array


def new_system(n: int) -> System:
    """An empty system of a rod with ``n`` nodes."""
    return zeros(System, (n, 6, 6), (n, 6, 6), (n, 6, 6), (n, 6), (n, 6))


@njit
def solve_columns(system: System, columns: Array) -> bool:
    """Solve in place for the loads ``columns`` (n, 6, m); False if the matrix is singular.

    Block Gauss-Jordan elimination with pivoting. The clamped node does not move. Blocks of six are
    eliminated in explicit loops, since LAPACK's overhead on them is several times the arithmetic.
    The blocks ``above`` are overwritten.
    """
    diagonal, above, below = system.diagonal, system.above, system.below
    n, many, room = columns.shape[0], columns.shape[2], np.empty((6, 12))
    columns[0] = 0.0
    for i in range(1, n):
        loads = columns[i]
        for r in range(6):
            for c in range(6):
                room[r, c], room[r, 6 + c] = diagonal[i, r, c], above[i, r, c]
            if i > 1:
                # tuples cannot alias, so loops over them are vectorised
                row = _six(below[i, r], 0)
                for c in range(6):
                    value = room[r, c]
                    for k in range(6):
                        value -= row[k] * above[i - 1, k, c]
                    room[r, c] = value
                for j in range(many):
                    value = loads[r, j]
                    for k in range(6):
                        value -= row[k] * columns[i - 1, k, j]
                    loads[r, j] = value
        for k in range(6):
            p = k
            for r in range(k + 1, 6):
                if abs(room[r, k]) > abs(room[p, k]):
                    p = r
            pivot = room[p, k]
            if not abs(pivot) > 0.0:
                return False
            if p != k:
                for j in range(12):
                    room[k, j], room[p, j] = room[p, j], room[k, j]
                for j in range(many):
                    loads[k, j], loads[p, j] = loads[p, j], loads[k, j]
            pivot = 1.0 / pivot
            for j in range(12):
                room[k, j] *= pivot
            for j in range(many):
                loads[k, j] *= pivot
            row_k = (*_six(room[k], 0), *_six(room[k], 6))
            for r in range(6):
                factor = room[r, k]
                if r != k:
                    for j in range(12):
                        room[r, j] -= factor * row_k[j]
                    for j in range(many):
                        loads[r, j] -= factor * loads[k, j]
        for r in range(6):
            for c in range(6):
                above[i, r, c] = room[r, 6 + c]
    for i in range(n - 2, 0, -1):
        for r in range(6):
            row = _six(above[i, r], 0)
            for j in range(many):
                value = columns[i, r, j]
                for c in range(6):
                    value -= row[c] * columns[i + 1, c, j]
                columns[i, r, j] = value
    return True


@inlined
def _six(a: Array, i: int) -> tuple[float, float, float, float, float, float]:
    """Entries of a row from ``i`` on."""
    return a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5]
