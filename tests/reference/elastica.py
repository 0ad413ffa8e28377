"""Plane elasticas by scipy's collocation: a cantilever, and a filament pressed on a plane.

Euler's inextensible rod, EI θ'' = -∂/∂θ of the work of its end load, as a boundary value problem.
Lengths are over L, forces over EI/L², moments over EI/L.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_bvp

TOLERANCE = 1e-9


def cantilever(load: float) -> tuple[float, float]:
    """Deflection and shortening of a cantilever's end under a dead load across it.

    θ'' = -P cos θ, θ(0) = 0, θ'(1) = 0, and x' = cos θ, w' = sin θ.
    """
    s = np.linspace(0.0, 1.0, 101)
    guess = np.zeros((4, s.size))
    # the last load's solution begins the next
    for part in np.linspace(0.0, load, 1 + math.ceil(load))[1:]:
        found = solve_bvp(
            lambda s, y, part=part: np.array(
                [y[1], -part * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]
            ),
            lambda a, b: np.array([a[0], b[1], a[2], a[3]]),
            s,
            guess,
            tol=TOLERANCE,
            max_nodes=100_000,
        )
        assert found.success, found.message
        guess = found.sol(s)
    return float(guess[3, -1]), float(1.0 - guess[2, -1])


def filament(lean_rad: float, mu: float, depth: float) -> tuple[float, float]:
    """Normal force and root moment of a filament pressed on a plane, its tip sliding and trailing.

    The clamp leans by ``lean_rad`` to the normal and is ``depth`` below first touch. With θ from
    the normal toward the trailing side θ'' = -N (sin θ + μ cos θ), θ(0) = lean, θ'(1) = 0, and the
    height ∫ cos θ is cos(lean) - depth.
    """

    def slopes(s, y, p):
        return np.array([y[1], -p[0] * (np.sin(y[0]) + mu * np.cos(y[0])), np.cos(y[0])])

    s = np.linspace(0.0, 1.0, 101)
    # a filament bent to an arc of the right order begins the iteration
    bent = 2.0 * math.sqrt(depth)
    guess = np.array(
        [
            lean_rad + bent * np.sin(0.5 * np.pi * s),
            bent * 0.5 * np.pi * np.cos(0.5 * np.pi * s),
            s * math.cos(lean_rad),
        ]
    )
    height = math.cos(lean_rad) - depth
    found = solve_bvp(
        slopes,
        lambda a, b, p: np.array([a[0] - lean_rad, b[1], a[2], b[2] - height]),
        s,
        guess,
        p=[1.5],
        tol=TOLERANCE,
        max_nodes=100_000,
    )
    assert found.success, found.message
    return float(found.p[0]), float(found.y[1, 0])
