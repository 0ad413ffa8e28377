"""An upright bristle's bounce as an exact rod: no elements, no time steps of ours, one dimension.

The rod has no lateral inertia and an end that stays plane, which is 1e-4 of y1/y0.

    docker/run python3 tests/reference/modal_series.py --kn 2e6 --beta 0
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from bristle.solver import paper


def modal_series_rebound(kn, height, *, mass, length, speed, beta, gravity, n_modes=80) -> dict:
    """A bristle's upright bounce from the exact cosine modes of a rod, integrated by LSODA.

    Modes above ``n_modes`` have no inertia that matters: together they are a spring and, since
    damping is proportional to stiffness, a dashpot beside it that relaxes in the time ``beta``.
    Without damping they follow at once.
    """
    n = np.arange(1, n_modes + 1)
    omega = n * math.pi * speed / length
    damping = beta * omega**2
    # static compliance of a free rod at its end, relative to the centre of mass: L / (3 E A)
    stiffness = mass * speed**2 / length**2  # E A / L
    rest = 1.0 / (3.0 * stiffness) - np.sum(2.0 / (mass * omega**2))

    def tip(y: np.ndarray) -> float:
        moved = float(y[0] + math.sqrt(2.0) * y[1 : n_modes + 1].sum() + y[-1])
        return moved if beta or moved > 0.0 else moved / (1.0 + kn * rest)

    def motion(_t: float, y: np.ndarray) -> np.ndarray:
        pushed = kn * max(-tip(y), 0.0)
        q, v = y[1 : n_modes + 1], y[n_modes + 2 : -1]
        out = np.empty_like(y)
        out[0], out[1 : n_modes + 1] = y[n_modes + 1], v
        out[n_modes + 1] = pushed / mass - gravity
        out[n_modes + 2 : -1] = math.sqrt(2.0) * pushed / mass - damping * v - omega**2 * q
        out[-1] = (rest * pushed - y[-1]) / beta if beta else 0.0
        return out

    def released(t: float, y: np.ndarray) -> float:
        return -1.0 if t < 1e-7 else tip(y)

    released.terminal, released.direction = True, 1.0
    y = np.zeros(2 * n_modes + 3)
    y[n_modes + 1] = -math.sqrt(2.0 * gravity * height)
    run = solve_ivp(motion, (0.0, 0.01), y, "LSODA", events=released, rtol=1e-9, atol=1e-14)
    up = run.y[n_modes + 1, -1]
    forces = np.array([kn * max(-tip(column), 0.0) for column in run.y.T])
    centre = run.y[0, -1]
    return {
        "contact_time_s": float(run.t[-1]),
        "rebound_ratio": float((up**2 / (2.0 * gravity) + centre) / height),
        "peak_force_N": float(forces.max()),
    }


def papers_rebound(kn: float, height: float, beta: float, n_modes: int = 80) -> dict:
    """That of the paper's bristle."""
    return modal_series_rebound(
        kn,
        height,
        mass=paper.DENSITY_KG_M3 * paper.THICKNESS_M * paper.WIDTH_M * paper.LENGTH_M,
        length=paper.LENGTH_M,
        speed=math.sqrt(paper.YOUNGS_PA / paper.DENSITY_KG_M3),
        beta=beta,
        gravity=paper.GRAVITY_M_S2,
        n_modes=n_modes,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print y1/y0, contact time and peak force of one impact as a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kn", type=float, default=paper.KN_CHOSEN_N_M)
    parser.add_argument("--height", type=float, default=0.05)
    parser.add_argument("--beta", type=float, default=paper.BETA_S)
    parser.add_argument("--modes", type=int, default=160)
    given = parser.parse_args(arguments)
    print(json.dumps(papers_rebound(given.kn, given.height, given.beta, given.modes)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
