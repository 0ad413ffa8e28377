"""Two-node element of a geometrically exact rod: strains, forces and tangent.

Simo, Comput. Methods Appl. Mech. Engng 49 (1985) 55, and Reissner. The rotation between the nodes
follows the shortest way at a constant rate. So the strains are independent of the path of loading
and invariant under rigid motion (Crisfield and Jelenić, Proc. R. Soc. A 455 (1999) 1125). With the
rotation R of the middle, the rotation vector φ from the first node to the second, and the length l,

    Γ = Rᵀ (x₂ - x₁) / l,    K = φ / l,

at one integration point. Let a and b be the nodes' spins in the axes of the middle. Then, exactly,

    δφ = S (b - a),    spin of the middle = (a + b)/2 - g × (b - a),

    S = s 1 + σ φ φᵀ,   s = ½φ / sin ½φ,   σ = (1 - s) / φ²,   g = τ φ,   τ = tan(¼φ) / (2φ).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Array, zeros
from ..compiled import inlined, njit
from .chain import Chain, System
from .rotation import Vector, between, cross, dot, vector_factor, write_middle

# Angle between nodes in rad below which the coefficients are series.
SMALL_RAD = 0.05


@inlined
def coefficients(square: float) -> tuple[float, float, float, float, float, float]:
    """s, σ, τ and their derivatives by ½φ², from the squared angle between the nodes."""
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
    write_middle(q, e, middle)
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
def _turned_back(middle: Array, solution: Array, e: int, c: int) -> Vector:
    """Component ``c``, in the middle's axes, of three vectors of an element: the second node's
    displacement minus the first's, the mean spin, and the second's spin minus the first's."""
    moved = mean = apart = 0.0
    for k in range(3):
        moved += middle[k, c] * (solution[e + 1, k] - solution[e, k])
        mean += 0.5 * middle[k, c] * (solution[e + 1, 3 + k] + solution[e, 3 + k])
        apart += middle[k, c] * (solution[e + 1, 3 + k] - solution[e, 3 + k])
    return moved, mean, apart


@njit
def strain_energy(chain: Chain, strain: Array) -> float:
    """Strain energy in J at strains (e, 6)."""
    energy = 0.0
    for e in range(len(chain.length)):
        for c in range(6):
            change = strain[e, c] - chain.rest[e, c]
            energy += 0.5 * chain.length[e] * chain.stiffness[e, c] * change * change
    return energy


@inlined
def _three(a: Vector, begin: int, factor: float) -> Vector:
    """Three entries of an array from ``begin`` on, times ``factor``."""
    return factor * a[begin], factor * a[begin + 1], factor * a[begin + 2]


@inlined
def _row(a: Array, i: int) -> Vector:
    return a[i, 0], a[i, 1], a[i, 2]


@inlined
def _skew(v: Vector, i: int, j: int) -> float:
    """Entry i, j of the matrix [v]×."""
    if i == j:
        return 0.0
    other = v[3 - i - j]
    return other if (j - i) % 3 == 2 else -other


@inlined
def _turned(matrix: Array, v: Vector) -> Vector:
    return dot(_row(matrix, 0), v), dot(_row(matrix, 1), v), dot(_row(matrix, 2), v)


@njit
def _forces(chain: Chain, e: int, strain: Array, before: Array, rate: float, out: Array) -> None:
    """Write N and M (6,) in the middle's axes; damping is the difference to the strains ``before``
    times ``rate``, β over the time step."""
    for c in range(6):
        change = strain[c] - chain.rest[e, c] + rate * (strain[c] - before[c])
        out[c] = chain.stiffness[e, c] * change


@inlined
def _moments(d: Vector, f: Vector, force: Vector, moment: Vector) -> tuple[Vector, Vector]:
    """c = N × d and S M - c × g, of d = x₂ - x₁ and φ, all in the same axes."""
    s, sigma, tau, _, _, _ = coefficients(dot(f, f))
    c, along = cross(force, d), sigma * dot(f, moment)
    t = cross(c, _three(f, 0, tau))
    return c, (
        s * moment[0] + along * f[0] - t[0],
        s * moment[1] + along * f[1] - t[1],
        s * moment[2] + along * f[2] - t[2],
    )


class Elements(NamedTuple):
    """The elements of one rod as last assembled: ``middle`` (e, 3, 3), ``strain`` and ``load`` (e,
    6) in the middle's axes, forces and moments ``ends`` (e, 2, 6) at both nodes in world axes, and
    work space for matrices (6, 3, 3)."""

    middle: Array
    strain: Array
    load: Array
    ends: Array
    room: Array


def new_elements(n: int) -> Elements:
    """Empty arrays for ``n`` elements."""
    return zeros(Elements, (n, 3, 3), (n, 6), (n, 6), (n, 2, 6), (6, 3, 3))


@njit
def load_elements(
    chain: Chain, x: Array, q: Array, before: Array, rate: float, elements: Elements
) -> None:
    """Write the strains and the resulting loads of all elements.

    See `_forces` for ``before`` and ``rate``.
    """
    for e in range(len(chain.length)):
        length, middle, strain = chain.length[e], elements.middle[e], elements.strain[e]
        load, ends = elements.load[e], elements.ends[e]
        measure(x, q, e, length, middle, strain)
        _forces(chain, e, strain, before[e], rate, load)
        d, f = _three(strain, 0, length), _three(strain, 3, length)
        c, twist = _moments(d, f, _three(load, 0, 1.0), _three(load, 3, 1.0))
        for i in range(3):
            force, mean, apart = 0.0, 0.0, 0.0
            for k in range(3):
                force += middle[i, k] * load[k]
                mean += 0.5 * middle[i, k] * c[k]
                apart += middle[i, k] * twist[k]
            ends[0, i], ends[1, i] = -force, force
            ends[0, 3 + i], ends[1, 3 + i] = mean - apart, mean + apart


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
    """Write the elements' forces into the residual, and zero the diagonal blocks.

    See `_forces` for ``before`` and ``rate``.
    """
    load_elements(chain, x, q, before, rate, elements)
    for i in range(len(x)):
        for r in range(6):
            system.residual[i, r] = 0.0
            for c in range(6):
                system.diagonal[i, r, c] = 0.0
    for e in range(len(chain.length)):
        for r in range(6):
            system.residual[e, r] += elements.ends[e, 0, r]
            system.residual[e + 1, r] += elements.ends[e, 1, r]


@njit
def foresee(chain: Chain, elements: Elements, solution: Array, out: Array) -> None:
    """Write Γ of the elements (e, 3) to ``out[0]``, and to ``out[1]`` its first-order change by the
    nodes' displacements and spins ``solution`` (n, 6)."""
    for e in range(len(chain.length)):
        length, middle, strain = chain.length[e], elements.middle[e], elements.strain[e]
        f = _three(strain, 3, length)
        _, _, tau, _, _, _ = coefficients(dot(f, f))
        m0, a0, b0 = _turned_back(middle, solution, e, 0)
        m1, a1, b1 = _turned_back(middle, solution, e, 1)
        m2, a2, b2 = _turned_back(middle, solution, e, 2)
        # spin of the middle, half from each node
        t0, t1, t2 = cross(_three(f, 0, tau), (b0, b1, b2))
        turned = cross(_three(strain, 0, 1.0), (a0 - t0, a1 - t1, a2 - t2))
        for c, moved in enumerate((m0, m1, m2)):
            out[0, e, c], out[1, e, c] = strain[c], moved / length + turned[c]


@inlined
def _in_world(matrix: Array, own: Array, factor: float, begin: int, out: Array) -> None:
    """Write, in world axes, the matrix (3, 3) whose diagonal is three entries of ``own``."""
    for i in range(3):
        for j in range(i + 1):
            value = 0.0
            for k in range(3):
                value += matrix[i, k] * own[begin + k] * matrix[j, k]
            out[i, j] = out[j, i] = factor * value


@njit
def _tangent(chain: Chain, e: int, rate: float, system: System, elements: Elements) -> None:
    """Add an element's tangent to its nodes' diagonal blocks, and write the off-diagonal ones.

    Everything is in world axes; changes are relative to the middle, which turns by w. With
    d = x₂ - x₁, the force N on the second node, the stiffness C_N of stretch and shear, and
    V = [N]× - [d]× C_N,

        dN = C_N dd + Vᵀ w,    d(N × d) = V (dd + d × w),    w = (½ + [g]×) a + (½ - [g]×) b,

    and a moment's block by d is the transpose of the force's by its node's spin. The nodes' moments
    turn with the middle.
    """
    one, up = system.diagonal[e], system.above[e]
    down, two = system.below[e + 1], system.diagonal[e + 1]
    length, middle, room = chain.length[e], elements.middle[e], elements.room
    strain, load, stiffness = elements.strain[e], elements.load[e], chain.stiffness[e]
    stretch, couple, turns = room[0], room[1], room[2]
    bend, moved, spins = room[3], room[4], room[5]
    d = _turned(middle, _three(strain, 0, length))
    f = _turned(middle, _three(strain, 3, length))
    force, m = _turned(middle, _three(load, 0, 1.0)), _turned(middle, _three(load, 3, 1.0))
    c, twist = _moments(d, f, force, m)
    s, sigma, tau, s_rate, sigma_rate, tau_rate = coefficients(dot(f, f))
    g = _three(f, 0, tau)
    stiff = (1.0 + rate) / length
    _in_world(middle, stiffness, stiff, 0, stretch)
    _in_world(middle, stiffness, stiff, 3, bend)
    # derivative of S M - c × g by φ at fixed c, then through dφ = S (b - a)
    product, bent = dot(f, m), _turned(bend, f)
    across = cross(c, f)
    for i in range(3):
        along = s_rate * m[i] + sigma_rate * product * f[i] - tau_rate * across[i]
        for j in range(3):
            value = s * bend[i, j] + sigma * f[i] * (bent[j] + m[j]) + along * f[j]
            turns[i, j] = value - tau * _skew(c, i, j)
        turns[i, i] += sigma * product
    for i in range(3):
        along = sigma * dot(_row(turns, i), f)
        for j in range(3):
            bend[i, j] = s * turns[i, j] + along * f[j]
    for i in range(3):
        crossed = cross(d, _row(stretch, i))  # column of [d]× C_N, as C_N is symmetric
        for j in range(3):
            couple[j, i] = _skew(force, j, i) - crossed[j]
    # V [d]×, and Vᵀ [g]× beside Vᵀ / 2: derivatives of the force by the two spins
    for i in range(3):
        crossed = cross(_row(couple, i), d)
        for j in range(3):
            turns[i, j] = crossed[j]
        crossed = cross((couple[0, i], couple[1, i], couple[2, i]), g)
        for j in range(3):
            moved[i, j] = crossed[j]
    for i in range(3):
        for j in range(3):
            one[i, j] += stretch[i, j]
            two[i, j] += stretch[i, j]
            up[i, j] = down[i, j] = -stretch[i, j]
            by_a = 0.5 * couple[j, i] + moved[i, j]
            by_b = 0.5 * couple[j, i] - moved[i, j]
            one[i, 3 + j] -= by_a
            down[i, 3 + j] = by_a
            up[i, 3 + j] = -by_b
            two[i, 3 + j] += by_b
            one[3 + j, i] -= by_a
            up[3 + j, i] = by_a
            down[3 + j, i] = -by_b
            two[3 + j, i] += by_b
    for node in range(2):
        sign = 2.0 * node - 1.0
        load_0 = 0.5 * c[0] + sign * twist[0]
        load_1 = 0.5 * c[1] + sign * twist[1]
        load_2 = 0.5 * c[2] + sign * twist[2]
        for j in range(3):
            crossed = cross(g, (turns[0, j], turns[1, j], turns[2, j]))
            for i in range(3):
                spins[i, j] = 0.5 * turns[i, j] + sign * crossed[i]
                spins[i, j] -= _skew((load_0, load_1, load_2), i, j)
        for i in range(3):
            crossed = cross(_row(spins, i), g)
            for j in range(3):
                by_a = 0.5 * spins[i, j] + crossed[j] - sign * bend[i, j]
                by_b = 0.5 * spins[i, j] - crossed[j] + sign * bend[i, j]
                if node == 0:
                    one[3 + i, 3 + j] += by_a
                    up[3 + i, 3 + j] = by_b
                else:
                    down[3 + i, 3 + j] = by_a
                    two[3 + i, 3 + j] += by_b


@njit
def assemble_tangent(chain: Chain, rate: float, system: System, elements: Elements) -> None:
    """Add the exact tangent of the forces that `assemble_forces` wrote to the diagonal blocks, and
    write the off-diagonal ones."""
    for e in range(len(chain.length)):
        _tangent(chain, e, rate, system, elements)
