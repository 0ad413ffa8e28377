"""Contact of a leaning bristle's end face, marched: springs with friction at points of the face.

Each point has its share of Kn and Coulomb friction behind Mindlin's tangential spring. Contact
forces are impulses between exact free motions of the modes (the scheme of Störmer and Verlet with
an exact drift), which is stable while a step resolves the spring on the tip's own inertia.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

COARSE_S = 2e-6
# Free for so long, a bristle is in flight.
FLIGHT_S = 1e-4


@njit(cache=True, fastmath=True)
def _place(q, tip, slope, shortens, sizes, drawn):
    """Tip's displacement (3,), slopes (2,); ``drawn`` becomes each plane's shortening gradient."""
    na, nb = sizes[0], sizes[1]
    moved, slopes = np.zeros(3), np.zeros(2)
    for i in range(na):
        moved[0] += tip[i] * q[i]
    for k in range(2):
        first = na + 2 + k * nb
        moved[1 + k] = tip[na + k] * q[na + k]
        for i in range(nb):
            moved[1 + k] += tip[first + i] * q[first + i]
            slopes[k] += slope[first + i] * q[first + i]
    for k in range(2):
        first = na + 2 + k * nb
        size = 0.0
        for i in range(nb):
            size += abs(q[first + i])
        if size == 0.0:
            drawn[k] = 0.0
            continue
        mine = q[first : first + nb]
        for i in range(nb):
            total = 0.0
            for j in range(nb):
                total += shortens[k, i, j] * mine[j]
            drawn[k, i] = total
            moved[0] += 0.5 * total * mine[i]
    return moved, slopes


@njit(cache=True)
def _contact(moved, slopes, points, normal, lowest, memory, numbers, left, loads):
    """Forces on the face: ``loads`` becomes force (3,) and the moments (2,) that turn the end.

    ``memory`` holds each point's anchor of the tangential spring along two tangents. Returns the
    normal force and whether any point touches.
    """
    kn, kt, friction = numbers[0], numbers[1], numbers[2]
    loads[:] = 0.0
    total, touched = 0.0, False
    # tangents: the thin direction made square to the normal, and the third
    one = np.array([-normal[1], normal[0], 0.0])
    one /= math.sqrt(one[0] ** 2 + one[1] ** 2)
    two = np.array(
        [
            normal[1] * one[2] - normal[2] * one[1],
            normal[2] * one[0] - normal[0] * one[2],
            normal[0] * one[1] - normal[1] * one[0],
        ]
    )
    for p in range(len(points)):
        s, w, share = points[p, 0], points[p, 1], points[p, 2]
        x = moved[0] - s * slopes[0] - w * slopes[1] + left
        y, z = moved[1], moved[2]
        gap = x * normal[0] + (y + s) * normal[1] + (z + w) * normal[2] - lowest
        slip_1 = x * one[0] + y * one[1] + z * one[2]
        slip_2 = x * two[0] + y * two[1] + z * two[2]
        if gap >= 0.0:
            memory[p, 0], memory[p, 1] = slip_1, slip_2
            continue
        touched = True
        press, spring = -share * kn * gap, share * kt
        drag_1 = -spring * (slip_1 - memory[p, 0])
        drag_2 = -spring * (slip_2 - memory[p, 1])
        size = math.sqrt(drag_1**2 + drag_2**2)
        if size > friction * press:
            drag_1 *= friction * press / size
            drag_2 *= friction * press / size
            memory[p, 0] = slip_1 + drag_1 / spring
            memory[p, 1] = slip_2 + drag_2 / spring
        total += press
        along = press * normal[0] + drag_1 * one[0] + drag_2 * two[0]
        loads[0] += along
        for k in range(1, 3):
            loads[k] += press * normal[k] + drag_1 * one[k] + drag_2 * two[k]
        loads[3] -= s * along
        loads[4] -= w * along
    return total, touched


@njit(cache=True, fastmath=True)
def _drift(q, v, steps):
    for i in range(len(q)):
        a = steps[i, 0, 0] * q[i] + steps[i, 0, 1] * v[i]
        v[i] = steps[i, 1, 0] * q[i] + steps[i, 1, 1] * v[i]
        q[i] = a


@njit(cache=True)
def _fall(q, v, tip, na, up, gravity, dt):
    for k in range(3):
        row = 0 if k == 0 else na + k - 1
        rate = gravity * up[k] / tip[row]
        q[row] -= 0.5 * rate * dt * dt
        v[row] -= rate * dt


@njit(cache=True)
def march(
    q, v, fine, coarse, tip, slope, shortens, sizes, points, normal, up, lowest, memory, numbers, dt
):
    """March in place until the face was free for ``FLIGHT_S``.

    Returns the time, the last release, and the greatest force.
    """
    na, nb = sizes[0], sizes[1]
    soft, delay, gravity = numbers[3], numbers[4], numbers[5]
    drawn, loads = np.zeros((2, nb)), np.zeros(5)
    time, last, peak, left = 0.0, 0.0, 0.0, 0.0
    stays = math.exp(-dt / delay) if delay > 0.0 else 0.0
    kept_q, kept_v, kept_memory = q.copy(), v.copy(), memory.copy()
    touched = True
    while time < 0.3:
        free = not touched and time - last > 5e-6 and abs(left) < 1e-9
        h = COARSE_S if free else dt
        if free:
            kept_q[:], kept_v[:], kept_memory[:] = q, v, memory
            _drift(q, v, coarse)
        else:
            _drift(q, v, fine)
        _fall(q, v, tip, na, up, gravity, h)
        moved, slopes = _place(q, tip, slope, shortens, sizes, drawn)
        total, touched = _contact(
            moved, slopes, points, normal, lowest, memory, numbers, left, loads
        )
        if free and touched:
            # the touch began within a long step: take it again in short ones
            q[:], v[:], memory[:] = kept_q, kept_v, kept_memory
            last = time
            continue
        time += h
        if delay > 0.0:
            left = stays * left + (1.0 - stays) * soft * loads[0]
        if touched:
            last = time
            peak = max(peak, total)
            for i in range(na):
                v[i] += h * tip[i] * loads[0]
            for k in range(2):
                first = na + 2 + k * nb
                v[na + k] += h * tip[na + k] * loads[1 + k]
                for i in range(nb):
                    push = tip[first + i] * loads[1 + k] + slope[first + i] * loads[3 + k]
                    v[first + i] += h * (push + drawn[k, i] * loads[0])
        elif time - last > FLIGHT_S:
            break
    return time, last, peak
