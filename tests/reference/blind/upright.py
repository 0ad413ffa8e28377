"""Impact of an upright bar: modes stepped exactly, one contact equation a step.

The force varies linearly over a step, so that what it does to every mode is exact; at the step's
end it and the penetration satisfy the contact law. Penetration is positive into the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from .body import AXIAL, Body, axial_steps, left_over_step

LINEAR, DASHPOT, HUNT_CROSSLEY, POWER, PLASTIC, ADHESIVE = range(6)
# Penetration at which a power law has the force of a linear one.
REFERENCE_M = 2e-5
GRAVITY_M_S2 = 9.8


@dataclass(frozen=True)
class Law:
    """Contact law: which, stiffness, and its other number.

    Dashpot N s/m; Hunt and Crossley's λ in s/m, F = Kn δ (1 + λ dδ/dt); power law's exponent,
    F = Kn δ0 (δ/δ0)^p with δ0 20 µm; yield force in N; pull-off force in N. Beyond yield the force
    ``hardens`` by this share of Kn, and ``unloads`` so many times as stiffly (O. R. Walton and
    R. L. Braun, J. Rheol. 30 (1986) 949, from yield on).
    """

    kind: int
    kn_N_m: float
    number: float = 0.0
    hardens: float = 0.0
    unloads: float = 1.0


@dataclass(frozen=True)
class Rebound:
    """What an impact gave: the speed of the centre of mass and its height against that of first
    touch at the last release, the time since first touch, the greatest force."""

    speed_m_s: float
    lift_m: float
    contact_time_s: float
    peak_force_N: float


def step_s(body: Body, law: Law) -> float:
    """A step that resolves the spring against the bar's impedance, and the bar's own waves."""
    impedance = body.density_kg_m3 * body.area_m2 * body.wave_speed_m_s
    finest = min(impedance / law.kn_N_m, 2e-6)
    return float(2.0 ** np.floor(np.log2(np.clip(finest / 6.0, 2.5e-8, 2e-7))))


def impact(
    body: Body,
    law: Law,
    speed_m_s: float,
    gravity_m_s2: float = GRAVITY_M_S2,
    dt_s: float | None = None,
    modes: int = AXIAL,
) -> Rebound:
    """Let an upright bar at rest in itself come down with ``speed_m_s``."""
    dt = step_s(body, law) if dt_s is None else dt_s
    steps, over = axial_steps(body, dt, modes), left_over_step(body, dt, modes)
    tip = body.axial_tip(modes)
    rows = np.array([law.kind, law.kn_N_m, law.number, law.hardens, law.unloads])
    delayed = body.beta_s if body.beta_s > 1e-3 * dt else 0.0
    return Rebound(
        *_march(
            steps,
            over,
            body.axial_omega(modes),
            tip,
            rows,
            speed_m_s,
            gravity_m_s2,
            dt,
            delayed,
            body.left_out_m_N(modes),
        )
    )


@njit(cache=True)
def _force(law, free, rate, soft, soft_rate, memory):
    """The force for which penetration is ``free - soft F`` and its rate ``rate - soft_rate F``.

    ``memory`` holds the indentation, and whether the tip is held.
    """
    kind, kn, number = int(law[0]), law[1], law[2]
    if kind == LINEAR:
        return max(0.0, kn * free / (1.0 + kn * soft))
    if kind == DASHPOT:
        if free <= 0.0:
            return 0.0
        return max(0.0, (kn * free + number * rate) / (1.0 + kn * soft + number * soft_rate))
    if kind == HUNT_CROSSLEY:
        return _hunt_crossley(kn, number, free, rate, soft, soft_rate)
    if kind == POWER:
        return _power(kn, number, free, soft)
    if kind == PLASTIC:
        slope, stiff = law[3] * kn, law[4] * kn
        spring = stiff if memory[0] > 0.0 else kn
        force = max(0.0, spring * (free - memory[0]) / (1.0 + spring * soft))
        limit = (number * (1.0 - law[3]) + slope * free) / (1.0 + slope * soft)
        if force > limit:
            force = limit
            memory[0] = free - soft * force - force / stiff
        return force
    force = kn * free / (1.0 + kn * soft)
    if force > 0.0:
        memory[1] = 1.0
    elif memory[1] == 0.0 or force < -number:
        memory[1] = 0.0
        force = 0.0
    return force


@njit(cache=True)
def _hunt_crossley(kn, factor, free, rate, soft, soft_rate):
    if free <= 0.0:
        return 0.0
    force = kn * free / (1.0 + kn * soft)
    for _ in range(50):
        depth, fast = free - soft * force, 1.0 + factor * (rate - soft_rate * force)
        wrong = force - kn * depth * fast
        slope = 1.0 + kn * soft * fast + kn * depth * factor * soft_rate
        force -= wrong / slope
        if abs(wrong) < 1e-12 * (1.0 + abs(force)):
            break
    return max(0.0, force)


@njit(cache=True)
def _power(kn, exponent, free, soft):
    """Newton from the right in the penetration, where the sum is convex: it cannot overshoot."""
    if free <= 0.0:
        return 0.0
    depth = free
    unit = kn * REFERENCE_M
    for _ in range(100):
        force = unit * (depth / REFERENCE_M) ** exponent
        wrong = depth + soft * force - free
        if wrong < 1e-15 * free:
            break
        depth -= wrong / (1.0 + soft * exponent * force / depth)
    return unit * (depth / REFERENCE_M) ** exponent


@njit(cache=True)
def _march(steps, over, omega, tip, law, speed, gravity, dt, delay, compliance):
    n = len(tip)
    q, v = np.zeros(n), np.zeros(n)
    v[0] = -speed / tip[0]
    memory = np.zeros(2)
    soft, soft_rate = over[2], 0.0
    for i in range(n):
        soft += tip[i] * steps[i, 0, 3]
        soft_rate += tip[i] * steps[i, 1, 3]
    if delay > 0.0:
        soft_rate += (compliance - over[2]) / delay
    force, before, left, peak = 0.0, 0.0, 0.0, 0.0
    last, touched = 0.0, False
    limit = int(0.02 / dt)
    for step in range(limit):
        free, rate = 0.0, 0.0
        for i in range(n):
            a = steps[i, 0, 0] * q[i] + steps[i, 0, 1] * v[i] + steps[i, 0, 2] * force
            b = steps[i, 1, 0] * q[i] + steps[i, 1, 1] * v[i] + steps[i, 1, 2] * force
            q[i], v[i] = a, b
            free -= tip[i] * a
            rate -= tip[i] * b
        q[0] -= 0.5 * gravity * dt * dt / tip[0]
        v[0] -= gravity * dt / tip[0]
        free += 0.5 * gravity * dt * dt
        rate += gravity * dt
        left = over[0] * left + over[1] * force
        free -= left
        if delay > 0.0:
            rate += left / delay
        new = _force(law, free, rate, soft, soft_rate, memory)
        for i in range(n):
            q[i] += steps[i, 0, 3] * new
            v[i] += steps[i, 1, 3] * new
        left += over[2] * new
        touched = touched or new != 0.0
        if new == 0.0 and force != 0.0:
            # where the force, continued as it fell, is zero
            share = force / (before - force) if 0.0 < force < before else 0.5
            last = (step + min(share, 1.0)) * dt
        peak = max(peak, new)
        before, force = force, new
        if force == 0.0 and touched:
            ringing = abs(left)
            for i in range(1, n):
                ringing += tip[i] * (abs(q[i]) + abs(v[i]) / omega[i])
            if v[0] > 0.0 and q[0] * tip[0] > ringing:
                break
            if v[0] <= 0.0 and free < -1e-3:
                break
    passed = (step + 1) * dt - last
    speed_out = v[0] * tip[0] + gravity * passed
    lift = q[0] * tip[0] - passed * (speed_out - 0.5 * gravity * passed)
    return speed_out, lift, last, peak
