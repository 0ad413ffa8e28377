"""The same impact with numpy and scipy alone: no finite element library, factors kept.

On a box of equal hexahedra the matrices of Lagrange elements are Kronecker products of those of
one-dimensional elements. Every node of the end face stands on a spring that only pushes. As long as
the same ones push, the step's matrix is the same, so there is a sparse LU for each set of them.

    docker/run python3 tests/reference/plain_scipy.py --cells 1 2 42 --its 1e-5
"""

from __future__ import annotations

import itertools
import sys

import numpy as np
from impact import Array, Impact, March, run
from scipy import sparse
from scipy.sparse.linalg import splu

from bristle.solver import paper


def line(length_m: float, cells: int, order: int) -> tuple[Array, Array, Array, Array]:
    """∫φφ, ∫φ'φ, ∫φφ' and ∫φ'φ' of Lagrange elements on a line, each (nodes, nodes)."""
    h, n = length_m / cells, order * cells + 1
    nodes = np.linspace(-1.0, 1.0, order + 1)
    coefficients = np.linalg.inv(np.vander(nodes, increasing=True))
    x, weight = np.polynomial.legendre.leggauss(order + 1)
    powers = np.arange(order + 1)
    value = x[:, None] ** powers @ coefficients
    slope = powers * x[:, None] ** np.maximum(powers - 1, 0) @ coefficients * 2.0 / h
    weight = (0.5 * h * weight)[:, None]
    element = [left.T @ (weight * right) for left in (value, slope) for right in (value, slope)]
    out = np.zeros((4, n, n))
    for cell, k in itertools.product(range(cells), range(4)):
        part = slice(order * cell, order * cell + order + 1)
        out[k, part, part] += element[k]
    both, right, left, slopes = out
    return both, left, right, slopes


def matrices(impact: Impact) -> tuple[sparse.csc_matrix, sparse.csc_matrix, Array]:
    """M and K (n, n), direction by direction, and the area share (nodes of the end face,)."""
    sizes = (paper.THICKNESS_M, paper.WIDTH_M, paper.LENGTH_M)
    lines = [
        line(size, cells, impact.order) for size, cells in zip(sizes, impact.cells, strict=True)
    ]

    def product(first: int | None, second: int | None) -> sparse.csc_matrix:
        """∫ ∂φ/∂first ∂φ/∂second over the box, None being no derivative."""
        # along each axis: neither, the first, the second, or both are differentiated
        one, two, three = (
            sparse.csc_matrix(each[(axis == first) + 2 * (axis == second)])
            for axis, each in enumerate(lines)
        )
        return sparse.kron(sparse.kron(three, two), one, format="csc")

    E, nu = paper.YOUNGS_PA, paper.POISSON
    lam, mu = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
    laplace = sum(product(axis, axis) for axis in range(3))
    blocks = [
        [
            lam * product(a, b) + mu * product(b, a) + (mu * laplace if a == b else 0.0 * laplace)
            for b in range(3)
        ]
        for a in range(3)
    ]
    mass = paper.DENSITY_KG_M3 * product(None, None)
    face = np.kron(lines[1][0].sum(0), lines[0][0].sum(0))
    return (
        sparse.block_diag([mass] * 3, format="csc"),
        sparse.bmat(blocks, format="csc"),
        face / face.sum(),
    )


def march(impact: Impact) -> March:
    """March the impact by Newmark's average acceleration."""
    M, K, share = matrices(impact)
    n, h, beta = M.shape[0], impact.its_s, impact.beta_s
    up = np.zeros(n)
    up[2 * n // 3 :] = 1.0
    # nodes of the end face come first in each direction
    tip = slice(2 * n // 3, 2 * n // 3 + len(share))
    spring = impact.kn_N_m * share
    free = M + (0.5 * h * beta + 0.25 * h * h) * K
    factors = {}

    def factor(pushing):
        if pushing.tobytes() not in factors:
            diagonal = np.zeros(n)
            diagonal[tip] = 0.25 * h * h * spring * pushing
            factors[pushing.tobytes()] = splu(
                sparse.csc_matrix(free + sparse.diags(diagonal)),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            )
        return factors[pushing.tobytes()]

    weight = M @ (-paper.GRAVITY_M_S2 * up)
    u, v, a = np.zeros(n), -impact.speed_m_s * up, -paper.GRAVITY_M_S2 * up
    pushing = np.zeros(len(share), dtype=bool)
    force_N, tip_m = [], []
    for _ in impact.t_s:
        # what the step would do without the new acceleration
        u_near = u + h * v + 0.25 * h * h * a
        v_near = v + 0.5 * h * a
        load = weight - K @ (u_near + beta * v_near)
        for _ in range(20):
            right = load.copy()
            right[tip] -= spring * pushing * u_near[tip]
            a = factor(pushing).solve(right)
            u = u_near + 0.25 * h * h * a
            now = u[tip] < 0.0
            if (now == pushing).all():
                break
            pushing = now
        else:
            raise SystemExit("the set of touching nodes does not settle; give a shorter --its")
        v = v_near + 0.5 * h * a
        force_N.append(float(spring @ np.maximum(-u[tip], 0.0)))
        tip_m.append(float(share @ u[tip]))
    return March(impact.t_s, force_N, tip_m, n)


if __name__ == "__main__":
    sys.exit(run(__doc__, march))
