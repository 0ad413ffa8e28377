"""The two-node element of a geometrically exact rod: strains, forces and their tangent.

Simo, Comput. Methods Appl. Mech. Engng 49 (1985) 55, and Reissner. Rotation runs between the nodes
along the shortest way at a constant rate, so the strains do not depend on the path of loading and
do not change with a rigid motion (Crisfield and Jelenić, Proc. R. Soc. A 455 (1999) 1125). With the
rotation R of the middle and the rotation vector φ from the first node to the second, over the
length l,

    Γ = Rᵀ (x₂ - x₁) / l,    K = φ / l,

one point of integration. Let a and b be the nodes' spins in the axes of the middle. Then, exactly,

    δφ = S (b - a),    spin of the middle = (a + b)/2 - g × (b - a),

    S = s 1 + σ φ φᵀ,   s = ½φ / sin ½φ,   σ = (1 - s) / φ²,   g = τ φ,   τ = tan(¼φ) / (2φ).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import inlined, njit
from .chain import Chain, System
from .rotation import between, vector_factor, write_matrix_of

# Below this angle between nodes, in rad, coefficients are their series.
SMALL_RAD = 0.05


@inlined
def coefficients(square: float) -> tuple[float, float, float, float, float, float]:
    """s, σ, τ and their derivatives by ½φ², of the squared angle between nodes."""
    if square < SMALL_RAD * SMALL_RAD:
        s = 1.0 + square * (1.0 / 24.0 + square * (7.0 / 5760.0 + square * 31.0 / 967680.0))
        sigma = -(1.0 / 24.0 + square * (7.0 / 5760.0 + square * 31.0 / 967680.0))
        tau = 0.125 + square * (1.0 / 384.0 + square / 15360.0)
        s_rate = 1.0 / 12.0 + square * (7.0 / 1440.0 + square * 31.0 / 161280.0)
        sigma_rate = -(7.0 / 2880.0 + square * 31.0 / 241920.0)
        tau_rate = 1.0 / 192.0 + square / 3840.0
        return s, sigma, tau, s_rate, sigma_rate, tau_rate
    angle = math.sqrt(square)
    sine, cosine, tangent = math.sin(0.5 * angle), math.cos(0.5 * angle), math.tan(0.25 * angle)
    s = 0.5 * angle / sine
    sigma = (1.0 - s) / square
    tau = 0.5 * tangent / angle
    s_rate = (0.5 - 0.5 * s * cosine) / (sine * angle)
    sigma_rate = -(s_rate + 2.0 * sigma) / square
    tau_rate = (0.125 * (1.0 + tangent * tangent) - tau) / square
    return s, sigma, tau, s_rate, sigma_rate, tau_rate


@njit
def measure(x: Array, q: Array, e: int, length: float, middle: Array, strain: Array) -> None:
    """Write the rotation of an element's middle (3, 3) and its strains (6,): Γ, K."""
    w, v0, v1, v2 = between(q[e], q[e + 1])
    factor = vector_factor(w, v0, v1, v2) / length
    strain[3], strain[4], strain[5] = factor * v0, factor * v1, factor * v2
    # the first node's rotation, then half of that between
    h = math.sqrt(0.5 * (1.0 + w))
    h0, h1, h2 = 0.5 * v0 / h, 0.5 * v1 / h, 0.5 * v2 / h
    p, p0, p1, p2 = q[e, 0], q[e, 1], q[e, 2], q[e, 3]
    write_matrix_of(
        p * h - p0 * h0 - p1 * h1 - p2 * h2,
        p * h0 + p0 * h + p1 * h2 - p2 * h1,
        p * h1 - p0 * h2 + p1 * h + p2 * h0,
        p * h2 + p0 * h1 - p1 * h0 + p2 * h,
        middle,
    )
    d0, d1, d2 = x[e + 1, 0] - x[e, 0], x[e + 1, 1] - x[e, 1], x[e + 1, 2] - x[e, 2]
    for c in range(3):
        strain[c] = (middle[0, c] * d0 + middle[1, c] * d1 + middle[2, c] * d2) / length


@njit
def strains(chain: Chain, x: Array, q: Array, out: Array) -> None:
    """Write the strains (e, 6) of every element."""
    middle = np.empty((3, 3))
    for e in range(len(chain.length)):
        measure(x, q, e, chain.length[e], middle, out[e])


@njit
def _turned_back(middle: Array, solution: Array, e: int, c: int) -> tuple[float, float, float]:
    """A component, in the middle's axes, of the displacement of an element's second node over its
    first's, of their mean spin, and of the spin of the second over the first's."""
    moved = mean = apart = 0.0
    for k in range(3):
        moved += middle[k, c] * (solution[e + 1, k] - solution[e, k])
        mean += 0.5 * middle[k, c] * (solution[e + 1, 3 + k] + solution[e, 3 + k])
        apart += middle[k, c] * (solution[e + 1, 3 + k] - solution[e, 3 + k])
    return moved, mean, apart


@njit
def foresee(
    chain: Chain,
    x: Array,
    q: Array,
    e: int,
    solution: Array,
    share: float,
    middle: Array,
    strain: Array,
    out: Array,
) -> None:
    """Write Γ (3,) of an element after a ``share`` of the nodes' displacements and spins (n, 6), to
    first order."""
    length = chain.length[e]
    measure(x, q, e, length, middle, strain)
    f0, f1, f2 = length * strain[3], length * strain[4], length * strain[5]
    _, _, tau, _, _, _ = coefficients(f0 * f0 + f1 * f1 + f2 * f2)
    g0, g1, g2 = tau * f0, tau * f1, tau * f2
    m0, a0, b0 = _turned_back(middle, solution, e, 0)
    m1, a1, b1 = _turned_back(middle, solution, e, 1)
    m2, a2, b2 = _turned_back(middle, solution, e, 2)
    # the spin of the middle, of which a half is from either node
    w0 = a0 - (g1 * b2 - g2 * b1)
    w1 = a1 - (g2 * b0 - g0 * b2)
    w2 = a2 - (g0 * b1 - g1 * b0)
    out[0] = strain[0] + share * (m0 / length + strain[1] * w2 - strain[2] * w1)
    out[1] = strain[1] + share * (m1 / length + strain[2] * w0 - strain[0] * w2)
    out[2] = strain[2] + share * (m2 / length + strain[0] * w1 - strain[1] * w0)


@njit
def strain_energy(chain: Chain, strain: Array) -> float:
    """In J, of strains (e, 6)."""
    energy = 0.0
    for e in range(len(chain.length)):
        for c in range(6):
            change = strain[e, c] - chain.rest[e, c]
            energy += 0.5 * chain.length[e] * chain.stiffness[e, c] * change * change
    return energy


@njit
def _skew(v: Array, out: Array) -> None:
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]


@njit
def _times(a: Array, b: Array, out: Array) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@njit
def _forces(chain: Chain, e: int, strain: Array, before: Array, rate: float, out: Array) -> None:
    """Write N and M (6,) in the middle's axes, damping by the strains ``before`` included.

    ``rate`` is β over the time step.
    """
    for c in range(6):
        change = strain[c] - chain.rest[e, c] + rate * (strain[c] - before[c])
        out[c] = chain.stiffness[e, c] * change


@njit
def _moments(
    length: float, strain: Array, load: Array
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """c = N × d and S M - c × g, in the middle's axes."""
    d0, d1, d2 = length * strain[0], length * strain[1], length * strain[2]
    c0 = load[1] * d2 - load[2] * d1
    c1 = load[2] * d0 - load[0] * d2
    c2 = load[0] * d1 - load[1] * d0
    f0, f1, f2 = length * strain[3], length * strain[4], length * strain[5]
    s, sigma, tau, _, _, _ = coefficients(f0 * f0 + f1 * f1 + f2 * f2)
    along = sigma * (f0 * load[3] + f1 * load[4] + f2 * load[5])
    g0, g1, g2 = tau * f0, tau * f1, tau * f2
    t0 = s * load[3] + along * f0 - (c1 * g2 - c2 * g1)
    t1 = s * load[4] + along * f1 - (c2 * g0 - c0 * g2)
    t2 = s * load[5] + along * f2 - (c0 * g1 - c1 * g0)
    return (c0, c1, c2), (t0, t1, t2)


@njit
def _end_loads(
    length: float, middle: Array, strain: Array, load: Array, one: Array, two: Array
) -> None:
    """Write an element's force and moment (6,) at its first and at its second node."""
    c, twist = _moments(length, strain, load)
    for i in range(3):
        force, mean, apart = 0.0, 0.0, 0.0
        for k in range(3):
            force += middle[i, k] * load[k]
            mean += 0.5 * middle[i, k] * c[k]
            apart += middle[i, k] * twist[k]
        one[i], two[i] = -force, force
        one[3 + i], two[3 + i] = mean - apart, mean + apart


@njit
def end_loads(chain: Chain, x: Array, q: Array, before: Array, rate: float, out: Array) -> None:
    """Write the forces and moments (e, 2, 6) in world axes that make every element's strains.

    The first of an element's two is at its first node. See `_forces` for ``before`` and ``rate``.
    """
    middle, strain, load = np.empty((3, 3)), np.empty(6), np.empty(6)
    for e in range(len(chain.length)):
        measure(x, q, e, chain.length[e], middle, strain)
        _forces(chain, e, strain, before[e], rate, load)
        _end_loads(chain.length[e], middle, strain, load, out[e, 0], out[e, 1])


class Elements(NamedTuple):
    """The elements of one rod as last assembled: ``middle`` (e, 3, 3), ``strain`` and ``load``
    (e, 6) in the middle's axes, and room for two ends' loads (2, 6) and for blocks (24, 3, 3)."""

    middle: Array
    strain: Array
    load: Array
    ends: Array
    room: Array


@njit
def new_elements(n: int) -> Elements:
    """Room for so many."""
    return Elements(
        np.zeros((n, 3, 3)),
        np.zeros((n, 6)),
        np.zeros((n, 6)),
        np.zeros((2, 6)),
        np.zeros((24, 3, 3)),
    )


@njit
def assemble_forces(
    chain: Chain,
    x: Array,
    q: Array,
    before: Array,
    rate: float,
    system: System,
    elements: Elements,
) -> None:
    """Write the elements' forces into the residual, and zero into the diagonal blocks.

    See `_forces` for ``before`` and ``rate``.
    """
    one, two = elements.ends[0], elements.ends[1]
    for i in range(len(x)):
        for r in range(6):
            system.residual[i, r] = 0.0
            for c in range(6):
                system.diagonal[i, r, c] = 0.0
    for e in range(len(chain.length)):
        middle, strain, load = elements.middle[e], elements.strain[e], elements.load[e]
        measure(x, q, e, chain.length[e], middle, strain)
        _forces(chain, e, strain, before[e], rate, load)
        _end_loads(chain.length[e], middle, strain, load, one, two)
        for r in range(6):
            system.residual[e, r] += one[r]
            system.residual[e + 1, r] += two[r]


@njit
def _tangent(
    chain: Chain,
    e: int,
    strain: Array,
    load: Array,
    c: tuple[float, float, float],
    twist: tuple[float, float, float],
    rate: float,
    room: Array,
    vector: Array,
) -> None:
    """Write into ``room[1:10]`` how the force and the two moments (rows) change with x₂ - x₁ and
    with the spins a and b (columns), all in the middle's axes."""
    length = chain.length[e]
    stretch, force_x, couple_x = room[1], room[10], room[11]
    arm, force_arm, g_cross, bend = room[12], room[13], room[14], room[15]
    half_a, half_b, tmp, spin, c_cross = room[16], room[17], room[18], room[19], room[20]
    # dN = stretch d(d); dc = couple_x (dx + d × spin)
    for i in range(3):
        vector[i] = length * strain[i]
    _skew(vector, arm)
    _skew(load[:3], force_arm)
    for i in range(3):
        for j in range(3):
            stiff = chain.stiffness[e, j] * (1.0 + rate) / length
            stretch[i, j] = stiff if i == j else 0.0
            couple_x[i, j] = force_arm[i, j] - arm[i, j] * stiff
    for i in range(3):
        for j in range(3):
            force_x[i, j] = couple_x[j, i]  # of the spin
    f = (length * strain[3], length * strain[4], length * strain[5])
    s, sigma, tau, s_rate, sigma_rate, tau_rate = coefficients(
        f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    )
    for i in range(3):
        vector[i] = tau * f[i]
    _skew(vector, g_cross)
    for i in range(3):
        for j in range(3):
            half = 0.5 if i == j else 0.0
            half_a[i, j], half_b[i, j] = half + g_cross[i, j], half - g_cross[i, j]
    # d(S M - c × g) at fixed c by b - a, through dφ = S (b - a)
    dot = f[0] * load[3] + f[1] * load[4] + f[2] * load[5]
    for i in range(3):
        vector[i] = c[i]
    _skew(vector, c_cross)
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            m_i, m_j = load[3 + i], load[3 + j]
            stiff = chain.stiffness[e, 3 + j] * (1.0 + rate) / length
            value = (s * one + sigma * f[i] * f[j]) * stiff
            value += (s_rate * m_i + sigma_rate * dot * f[i]) * f[j]
            value += sigma * (one * dot + f[i] * m_j)
            for k in range(3):
                gradient = (tau if k == j else 0.0) + tau_rate * f[k] * f[j]
                value -= c_cross[i, k] * gradient
            tmp[i, j] = value
            spin[i, j] = s * one + sigma * f[i] * f[j]
    _times(tmp, spin, bend)
    _times(force_x, half_a, room[2])
    _times(force_x, half_b, room[3])
    _times(couple_x, arm, spin)  # dc by the spin of the middle
    for node in range(2):
        sign = 2.0 * node - 1.0
        lever = half_b if node == 0 else half_a
        row = 4 + 3 * node
        _times(lever, couple_x, room[row])
        _times(lever, spin, tmp)
        for i in range(3):
            vector[i] = 0.5 * c[i] + sign * twist[i]
        _skew(vector, c_cross)
        for i in range(3):
            for j in range(3):
                tmp[i, j] -= c_cross[i, j]
        _times(tmp, half_a, room[row + 1])
        _times(tmp, half_b, room[row + 2])
        for i in range(3):
            for j in range(3):
                room[row + 1, i, j] -= sign * bend[i, j]
                room[row + 2, i, j] += sign * bend[i, j]


@njit
def _give(turned: Array, column: int, row: int, sign: float, first: Array, second: Array) -> None:
    """Add a block to rows of the blocks of the first and the second node's columns."""
    for i in range(3):
        for j in range(3):
            value = sign * turned[i, j]
            if column == 0:
                first[row + i, j] -= value
                second[row + i, j] += value
            elif column == 1:
                first[row + i, 3 + j] += value
            else:
                second[row + i, 3 + j] += value


@njit
def _scatter(e: int, middle: Array, room: Array, system: System) -> None:
    """Turn the nine blocks of an element into world axes, and give them to the nodes' blocks."""
    turned, tmp = room[22], room[21]
    one, two = system.diagonal[e], system.diagonal[e + 1]
    up, down = system.above[e], system.below[e + 1]
    for block in range(9):
        own = room[1 + block]
        for i in range(3):
            for j in range(3):
                tmp[i, j] = (
                    middle[i, 0] * own[0, j] + middle[i, 1] * own[1, j] + middle[i, 2] * own[2, j]
                )
        row, column = block // 3, block % 3
        for i in range(3):
            for j in range(3):
                turned[i, j] = (
                    tmp[i, 0] * middle[j, 0] + tmp[i, 1] * middle[j, 1] + tmp[i, 2] * middle[j, 2]
                )
        # rows: force on the second node, moment on the first, moment on the second; columns: the
        # second node's displacement over the first's, then the spins of the two
        if row == 0:
            _give(turned, column, 0, -1.0, one, up)
            _give(turned, column, 0, 1.0, down, two)
        elif row == 1:
            _give(turned, column, 3, 1.0, one, up)
        else:
            _give(turned, column, 3, 1.0, down, two)


@njit
def assemble_tangent(chain: Chain, rate: float, system: System, elements: Elements) -> None:
    """Add the exact tangent of the forces that `assemble_forces` has just written to the diagonal
    blocks, and write the others."""
    room, vector = elements.room, elements.ends[0]
    for i in range(len(system.residual)):
        for row in range(6):
            for column in range(6):
                system.above[i, row, column] = system.below[i, row, column] = 0.0
    for e in range(len(chain.length)):
        strain, load = elements.strain[e], elements.load[e]
        c, twist = _moments(chain.length[e], strain, load)
        _tangent(chain, e, strain, load, c, twist, rate, room, vector)
        _scatter(e, elements.middle[e], room, system)
