"""Exact solutions, and bodies made with no code of the program."""

from __future__ import annotations

import math

import numpy as np
from plain_scipy import line
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
    nodes = degree * n_elements + 1
    both, *_, slopes = line(length, n_elements, degree)
    mass, stiffness = density * area * both, youngs * area * slopes
    # the slopes of the first element's functions at its lower end
    end = np.array({1: [-1.0, 1.0], 2: [-3.0, 4.0, -1.0]}[degree]) * n_elements / length
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
