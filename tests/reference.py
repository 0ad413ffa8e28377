"""What the tests compare with: exact solutions and methods that share no code with the program."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import jv

from bristle.solver.bodies.base import ContactPoints
from bristle.solver.bodies.modal import ModalBody, modal_form


def rate(sizes, errors) -> float:
    """Least-squares slope of log error over log size."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def free_free_timoshenko_hz(
    length, bending_EI, shear_kGA, mass_per_m, inertia_per_m, near_hz
) -> float:
    """The natural frequency of a free-free Timoshenko beam close to ``near_hz``.

    Exact: the state (w, φ, M, Q) is carried over the length by a matrix exponential, and M = Q = 0
    at both ends makes a 2 × 2 determinant vanish.
    """

    def determinant(hz: float) -> float:
        w2 = (2.0 * math.pi * hz) ** 2
        system = np.zeros((4, 4))
        system[0, 1], system[0, 3] = 1.0, 1.0 / shear_kGA
        system[1, 2] = 1.0 / bending_EI
        system[2, 1], system[2, 3] = -inertia_per_m * w2, -1.0
        system[3, 0] = -mass_per_m * w2
        scale = np.array([1.0, 1.0 / length, bending_EI / length**2, bending_EI / length**3])
        scaled = system * scale[None, :] / scale[:, None]
        return float(np.linalg.det(expm(scaled * length)[2:, :2]))

    return float(brentq(determinant, 0.97 * near_hz, 1.03 * near_hz, xtol=1e-10 * near_hz))


def pochhammer_chree_hz(wavenumber, radius, youngs, poisson, density) -> float:
    """Frequency of the lowest longitudinal wave of an infinite round bar (Achenbach, Sec. 6.10)."""
    shear = youngs / (2.0 * (1.0 + poisson))
    c_t2 = shear / density
    c_l2 = youngs * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson)) / density
    k, a = wavenumber, radius

    def equation(omega: float) -> float:
        p = np.sqrt(complex(omega**2 / c_l2 - k**2))
        q = np.sqrt(complex(omega**2 / c_t2 - k**2))
        value = (
            2.0 * p / a * (q**2 + k**2) * jv(1, p * a) * jv(1, q * a)
            - (q**2 - k**2) ** 2 * jv(0, p * a) * jv(1, q * a)
            - 4.0 * k**2 * p * q * jv(1, p * a) * jv(0, q * a)
        )
        return float(value.real)

    bar = math.sqrt(youngs / density) * k
    grid = bar * np.linspace(1.0 + 1e-9, 0.9, 2000)
    values = [equation(omega) for omega in grid]
    first = next(i for i in range(len(grid) - 1) if values[i] * values[i + 1] <= 0.0)
    return float(brentq(equation, grid[first + 1], grid[first], xtol=1e-13 * bar)) / (2.0 * math.pi)


def rod(
    n_elements: int,
    *,
    length=1.0,
    youngs=1.0,
    density=1.0,
    area=1.0,
    degree=1,
    beta=0.0,
    clamped_top=False,
) -> ModalBody:
    """An axial rod of linear or quadratic elements, its tip at the bottom free to touch."""
    h = length / n_elements
    nodes = degree * n_elements + 1
    points = np.linspace(-1.0, 1.0, degree + 1)
    vandermonde = np.linalg.inv(np.vander(points, increasing=True))
    x, w = np.polynomial.legendre.leggauss(degree + 1)
    powers = np.arange(degree + 1)
    value = (x[:, None] ** powers) @ vandermonde
    slope = (
        powers * np.where(powers > 0, x[:, None] ** np.maximum(powers - 1, 0), 0.0)
    ) @ vandermonde
    slope = slope * 2.0 / h
    mass, stiffness = np.zeros((nodes, nodes)), np.zeros((nodes, nodes))
    for e in range(n_elements):
        span = slice(degree * e, degree * e + degree + 1)
        mass[span, span] += density * area * h / 2.0 * value.T @ (w[:, None] * value)
        stiffness[span, span] += youngs * area * h / 2.0 * slope.T @ (w[:, None] * slope)
    end = (powers * (-1.0) ** np.maximum(powers - 1, 0)) @ vandermonde * 2.0 / h
    tip, traction = np.zeros((1, nodes)), np.zeros((3, nodes))
    tip[0, 0] = 1.0
    traction[2, : degree + 1] = -youngs * area * end
    keep = slice(0, nodes - 1 if clamped_top else nodes)
    contact = ContactPoints(
        coordinates=tip[:, keep],
        support=np.zeros((1, 1), dtype=np.int64),
        shapes=np.array([[[0.0], [0.0], [1.0]]]),
        traction=traction[:, keep],
        weights=np.ones(1),
        places_m=np.array([[0.0, 0.0, -0.5 * length]]),
    )
    rigid = np.zeros((nodes, 6))
    if not clamped_top:
        rigid[:, 2] = 1.0
    return modal_form(
        "rod", mass[keep, keep], stiffness[keep, keep], rigid[keep], contact, 0.0, beta
    )


def modal_series_rebound(kn, height, *, mass, length, speed, beta, gravity, n_modes=80) -> dict:
    """A bristle's upright bounce from the exact cosine modes of a rod, integrated by LSODA.

    Modes above ``n_modes`` have no inertia that matters: together they are a spring and, since
    damping is proportional to stiffness, a dashpot beside it that relaxes in the time ``beta``.
    """
    n = np.arange(1, n_modes + 1)
    omega = n * math.pi * speed / length
    damping = beta * omega**2
    # static compliance of a free rod at its end, relative to the centre of mass: L / (3 E A)
    stiffness = mass * speed**2 / length**2  # E A / L
    rest = 1.0 / (3.0 * stiffness) - np.sum(2.0 / (mass * omega**2))

    def tip(y: np.ndarray) -> float:
        return float(y[0] + math.sqrt(2.0) * y[1 : n_modes + 1].sum() + y[-1])

    def motion(_t: float, y: np.ndarray) -> np.ndarray:
        pushed = kn * max(-tip(y), 0.0)
        q, v = y[1 : n_modes + 1], y[n_modes + 2 : -1]
        out = np.empty_like(y)
        out[0], out[1 : n_modes + 1] = y[n_modes + 1], v
        out[n_modes + 1] = pushed / mass - gravity
        out[n_modes + 2 : -1] = math.sqrt(2.0) * pushed / mass - damping * v - omega**2 * q
        out[-1] = (rest * pushed - y[-1]) / beta
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
