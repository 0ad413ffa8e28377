"""The bristle as a mass on a spring, in closed form (Eqs. 1 to 8 of the paper)."""

from __future__ import annotations

import math

import numpy as np

from .contact_phase import History
from .drop import DropResult
from .energy import Budget, Energy

SAMPLES = 400


def quarter_period_s(mass_kg: float, kn_N_m: float) -> float:
    """tp - ti = (π/2) √(m/Kn), the time from touch to greatest penetration (Eq. 8)."""
    return 0.5 * math.pi * math.sqrt(mass_kg / kn_N_m)


def greatest_penetration_m(
    mass_kg: float, kn_N_m: float, height_m: float, gravity_m_s2: float
) -> float:
    """Δcmax from ½ Kn Δcmax² = m g y0 (Eq. 3)."""
    return math.sqrt(2.0 * mass_kg * gravity_m_s2 * height_m / kn_N_m)


def penetration_m(
    t_s: np.ndarray, mass_kg: float, kn_N_m: float, height_m: float, gravity_m_s2: float
) -> np.ndarray:
    """Δc(t) = v_i √(m/Kn) sin(√(Kn/m) t) with t from first touch, while it lasts (Eq. 7)."""
    omega = math.sqrt(kn_N_m / mass_kg)
    depth = math.sqrt(2.0 * gravity_m_s2 * height_m) / omega * np.sin(omega * np.asarray(t_s))
    return np.where((t_s >= 0.0) & (omega * np.asarray(t_s) <= math.pi), depth, 0.0)


def analytic_drop(
    mass_kg: float, kn_N_m: float, height_m: float, gravity_m_s2: float
) -> DropResult:
    """A drop by Eqs. 1 to 8: without loss, and without gravity during contact, as in Eq. 7."""
    speed = math.sqrt(2.0 * gravity_m_s2 * height_m)
    quarter = quarter_period_s(mass_kg, kn_N_m)
    deepest = greatest_penetration_m(mass_kg, kn_N_m, height_m, gravity_m_s2)
    energy = mass_kg * gravity_m_s2 * height_m
    return DropResult(
        impact_speed_m_s=speed,
        rebound_ratio=1.0,
        rebound_height_m=height_m,
        contact_time_s=2.0 * quarter,
        n_contacts=1,
        peak_force_N=kn_N_m * deepest,
        impulse_N_s=2.0 * mass_kg * speed,
        max_penetration_m=deepest,
        time_to_max_penetration_s=quarter,
        cm_velocity_after_m_s=speed,
        n_dofs=1,
        n_steps=0,
        energy=Budget.close(energy, Energy(energy, 0.0, 0.0), 0.0),
        cm_rebound_height_m=height_m,
        velocity_after_m_s=(0.0, 0.0, speed),
        spin_after_rad_s=(0.0, 0.0, 0.0),
        friction_impulse_N_s=0.0,
        history=_history(mass_kg, kn_N_m, height_m, gravity_m_s2, 2.0 * quarter),
    )


def _history(
    mass_kg: float, kn_N_m: float, height_m: float, gravity_m_s2: float, contact_s: float
) -> History:
    """Fall, contact and rise to the height of release."""
    speed = math.sqrt(2.0 * gravity_m_s2 * height_m)
    fall_s = speed / gravity_m_s2
    down = np.linspace(0.0, fall_s, SAMPLES, endpoint=False)
    contact = np.linspace(0.0, contact_s, SAMPLES)
    up = np.linspace(0.0, fall_s, SAMPLES)[1:]
    depth = penetration_m(contact, mass_kg, kn_N_m, height_m, gravity_m_s2)
    t = np.concatenate([down, fall_s + contact, fall_s + contact_s + up])
    fall, rise = 0.5 * gravity_m_s2 * down**2, speed * up - 0.5 * gravity_m_s2 * up**2
    tip = np.concatenate([height_m - fall, -depth, rise])
    inside = np.concatenate([0.0 * down, depth, 0.0 * up])
    table = np.stack([t, tip, tip, kn_N_m * inside, inside], axis=1)
    history = History()
    history.extend(table)
    return history
