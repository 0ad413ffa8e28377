"""How a leaning bar bounces, and how a block sticks and slips, by methods not used in the program.

Independent yardsticks. `leaning_series`: the elastic impact of a leaning bar from its axial and
Timoshenko modes. `rigid_bar`: its rigid limit in closed form, with Coulomb friction.
`oscillator_peaks`, `stick_slip_block`: friction in closed form. Nothing is imported from the
program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from blind.body import Body, delayed_step, forced_steps
from numba import njit
from numpy.polynomial import legendre

# --- the bar ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bar(Body):
    """A free prismatic bar of the blind benchmark, the paper's bristle unless told otherwise, and
    the plane in which it bends and leans: over its thickness, or a diameter where it is round.

    The end face of a rectangle can touch point by point, a round end touches at a point.
    """

    @property
    def depth_m(self) -> float:
        """The size of the section in the plane of bending."""
        return self.diameter_m or self.thickness_m

    @property
    def second_moment_m4(self) -> float:
        return self.area_m2 * self.depth_m**2 / (16.0 if self.diameter_m else 12.0)

    @property
    def EI(self) -> float:
        return self.youngs_Pa * self.second_moment_m4

    @property
    def kGA(self) -> float:
        """With k = 10(1+ν)/(12+11ν) of a rectangle, 6(1+ν)/(7+6ν) of a circle (Cowper 1966)."""
        nu = self.poisson
        k = 6.0 / (7.0 + 6.0 * nu) if self.diameter_m else 10.0 / (12.0 + 11.0 * nu)
        return k * (1.0 + nu) * self.youngs_Pa / (2.0 * (1.0 + nu)) * self.area_m2


# --- modes --------------------------------------------------------------------------------------


class TipModes(NamedTuple):
    """Modes of unit mass, as the tip sees them: ω (n,) in rad/s and tip (n, 3) of (u, w, φ).

    u is the displacement along the axis (upwards), w across it, φ the section's rotation with
    w' = φ in rigid motion. ``remainder`` (3, 3) is the static compliance of all modes left out.
    """

    omega: np.ndarray
    tip: np.ndarray
    remainder: np.ndarray


@lru_cache
def axial_modes(bar: Bar, n_modes: int) -> TipModes:
    """Translation and cosines, ω = nπc/L; all elastic ones together yield L/(3EA) at the tip."""
    tip, rest = np.zeros((n_modes + 1, 3)), np.zeros((3, 3))
    tip[:, 0], rest[0, 0] = bar.axial_tip(n_modes + 1), bar.left_out_m_N(n_modes + 1)
    return TipModes(bar.axial_omega(n_modes + 1), tip, rest)


@lru_cache
def bending_modes(bar: Bar, n_modes: int) -> TipModes:
    """Translation, rotation and the first ``n_modes`` elastic free-free Timoshenko modes.

    With ξ from the middle the curvature φ' and the shear w' − φ are series of Legendre polynomials,
    in which the energy of strain, ½ ∫ EI φ'² + kGA (w' − φ)², is diagonal. w and φ are integrals of
    them less the rigid motion, with the mass as weight. So the singular values of the map from the
    strains to the motion, each in the root of its energy, are 1/ω, and its left vectors the modes
    of unit mass: to rounding as long as the polynomials resolve their waves, for which π/2 of them
    a mode are the least. Static deflections under loads at the tip are polynomials too, so that the
    modes that are not returned make up the rest of them exactly.
    """
    h, degrees, rho = bar.length_m / 2.0, 2 * n_modes + 40, bar.density_kg_m3
    integral = legendre.legint(np.eye(degrees + 1), scl=h)  # (degrees + 2, degrees + 1)
    size = degrees + 2
    square = bar.length_m / (2.0 * np.arange(size) + 1.0)  # of each polynomial, over the bar
    strains = 2 * degrees
    w, phi = np.zeros((2, size, strains))
    phi[:-1, :degrees] = integral[:-1, :degrees]
    w[:, :degrees] = integral @ phi[:-1, :degrees]
    w[:-1, degrees:] = integral[:-1, :degrees]
    weights = np.sqrt(rho * np.concatenate([bar.area_m2 * square, bar.second_moment_m4 * square]))
    stiff = np.sqrt(np.concatenate([bar.EI * square[:degrees], bar.kGA * square[:degrees]]))
    moves = weights[:, None] * np.concatenate([w, phi]) / stiff
    rigid = np.zeros((2 * size, 2))
    rigid[0, 0], rigid[1, 1], rigid[size, 1] = 1.0, h, 1.0
    rigid *= weights[:, None]
    rigid /= np.linalg.norm(rigid, axis=0)
    moves -= rigid @ (rigid.T @ moves)
    elastic, slow, _ = np.linalg.svd(moves, full_matrices=False)
    end = np.tile((-1.0) ** np.arange(size), 2) / weights

    def tip_of(modes: np.ndarray) -> np.ndarray:
        across, turned = (end[:, None] * modes).reshape(2, size, -1).sum(axis=1)
        return np.stack([np.zeros_like(across), across, turned], axis=1)

    tip = tip_of(elastic)
    rest = (tip[n_modes:].T * slow[n_modes:] ** 2) @ tip[n_modes:]
    omega = np.concatenate([[0.0, 0.0], 1.0 / slow[:n_modes]])
    return TipModes(omega, np.concatenate([tip_of(rigid), tip[:n_modes]]), rest)


# --- the impact ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class LeaningImpact:
    """What `leaning_series` found; times from first touch, all touches until ``until_s``.

    ``kept`` is J/(m v) − 1: the upward speed of the centre of mass over the speed of fall, without
    what gravity adds meanwhile. ``touches`` (n, 3) holds begin, end and ``kept`` at that end for
    each separate touch. ``restitution`` is −(normal velocity of the tip after)/(before) with the
    velocities of the bar's rigid motion, ringing left out, as a camera would see it.
    ``energy_error`` is (energy now + friction's work − v² m/2)/(v² m/2): zero with β = 0 and no
    gravity, minus the fraction lost in the material with β > 0.
    """

    kept: float
    restitution: float
    spin_rad_s: float
    impulse_N_s: float
    peak_force_N: float
    contact_time_s: float
    touches: np.ndarray
    energy_error: float
    friction_loss: float

    @property
    def last_release_s(self) -> float:
        return float(self.touches[-1, 1])


def leaning_series(
    lean_deg: float,
    kn: float,
    beta: float,
    *,
    face: bool,
    speed: float,
    mu: float = 0.0,
    kt: float | None = None,
    bar: Bar | None = None,
    points: int = 9,
    n_axial: int = 200,
    n_bending: int = 200,
    remainder: bool = True,
    gravity: float = 0.0,
    until_s: float = 3e-3,
    step_s: float = 5e-8,
) -> LeaningImpact:
    """A free bar leaning in its bending plane falls vertically on a rigid plane: exact modes.

    The plane's normal in body axes (across, along) is (−sin t, cos t). A point of the end face at
    x moves by (w, u − x φ), and so its gap is

        g(x) = (x_max − x) sin t − w sin t + (u − x φ) cos t,

    the edge x_max = depth/2 touching first; its slip is w cos t + (u − x φ) sin t. Small motion
    about first touch: rotation after it is taken as small against t. ``face``: Gauss–Lobatto points
    across the end face, each with the spring Kn·weight and a unilateral gap; otherwise one point on
    the axis with Kn. Friction is Coulomb's with a tangential spring ``kt`` (Kn if None), likewise
    weighted. Damping is proportional to stiffness, in the body alone: 2ζω = βω² per mode, and the
    modes left out are a spring and a dashpot that relaxes in β.

    Each mode is advanced exactly under a force linear in time over ``step_s``; the contact forces
    at the end of the step follow from the gaps there by Gauss–Seidel to round-off. So the step only
    limits how the force is interpolated.

    With one point and no gravity the equations are homogeneous, so ``kept`` does not depend on
    ``speed``; the end face closes by and by over x_max − x, and there it does. Gravity acts, if
    given, during the contact as well; ``kept`` counts the plane's impulse alone.
    """
    bar = bar or Bar()
    if face and bar.diameter_m:
        raise ValueError("a round end touches at one point: face=False")
    along, across = axial_modes(bar, n_axial), bending_modes(bar, n_bending)
    omega = np.concatenate([along.omega, across.omega])
    tip = np.concatenate([along.tip, across.tip])
    rest = (along.remainder + across.remainder) * remainder

    x, weights = _gauss_lobatto(points) if face else (np.zeros(1), np.ones(1))
    x = x * bar.depth_m / 2.0
    sin, cos = math.sin(math.radians(lean_deg)), math.cos(math.radians(lean_deg))
    normal = np.stack([np.full_like(x, cos), np.full_like(x, -sin), -x * cos], axis=1)
    tangent = np.stack([np.full_like(x, sin), np.full_like(x, cos), -x * sin], axis=1)
    open_gap = -x * sin - np.min(-x * sin)

    velocity = np.zeros(len(omega))
    root_mass = math.sqrt(bar.mass_kg)
    velocity[0], velocity[n_axial + 1] = -speed * cos * root_mass, speed * sin * root_mass
    weight = gravity / speed * velocity  # modal force
    steps = math.ceil(until_s / step_s)
    steps_of_modes = forced_steps(omega, beta * omega**2, np.ones_like(omega), step_s)
    force, place, velocity, relaxed, slid = _march(
        np.ascontiguousarray(steps_of_modes.transpose(1, 2, 0).reshape(8, -1)),
        delayed_step(beta / step_s),
        np.ascontiguousarray(tip.T),
        rest,
        velocity,
        weight,
        normal,
        tangent,
        open_gap,
        kn * weights,
        (kn if kt is None else kt) * weights,
        mu,
        steps,
    )
    last = tangent.T @ force[-1, 1] + normal.T @ force[-1, 0]
    stored = np.sum(force[-1] ** 2 / np.stack([kn * weights, (kt or kn) * weights])) / 2.0
    energy = (velocity @ velocity + (omega * place) @ (omega * place) + last @ relaxed) / 2.0
    fall = bar.mass_kg * speed**2 / 2.0
    arm = normal.T @ (weights * (open_gap == 0.0)) / np.sum(weights * (open_gap == 0.0))
    rigid = [0, n_axial + 1, n_axial + 2]
    total = force[:, 0].sum(axis=1)
    time = step_s * np.arange(steps + 1)
    touches, impulse = _touches(time, total, bar.mass_kg * speed)
    return LeaningImpact(
        kept=impulse / (bar.mass_kg * speed) - 1.0,
        restitution=float(arm @ tip[rigid].T @ velocity[rigid]) / speed,
        spin_rad_s=float(velocity[rigid[2]] * tip[rigid[2], 2]),
        impulse_N_s=impulse,
        peak_force_N=float(total.max()),
        contact_time_s=float(np.sum(touches[:, 1] - touches[:, 0])),
        touches=touches,
        energy_error=float(energy + stored + slid - fall) / fall,
        friction_loss=slid / fall,
    )


def _gauss_lobatto(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on [−1, 1] and weights that sum to one."""
    if n < 2:
        raise ValueError("Gauss–Lobatto has two points or more")
    legendre = np.polynomial.legendre.Legendre.basis(n - 1)
    x = np.concatenate([[-1.0], np.sort(legendre.deriv().roots().real), [1.0]])
    return x, 1.0 / (n * (n - 1) * legendre(x) ** 2)


@njit(cache=False, fastmath=True)
def _march(
    prop, relax, tip, rest, velocity, weight, normal, tangent, open_gap, kn, kt, mu, steps
):  # pragma: no cover - compiled
    """All forces (steps + 1, normal and tangential, points), last q and q̇, friction's work.

    ``prop`` (8, n): q and q̇ after a step from q, q̇, the force at its begin and at its end.
    """
    n_modes, n_points = tip.shape[1], len(open_gap)
    q, v = np.zeros(n_modes), velocity.copy()
    r, port0, port1 = np.zeros(3), np.zeros(3), np.zeros(3)
    force = np.zeros((steps + 1, 2, n_points))
    anchor, slip = np.zeros(n_points), np.zeros(n_points)
    slid = 0.0

    compliance = relax[2] * rest
    for a in range(3):
        for b in range(3):
            compliance[a, b] += np.sum(tip[a] * prop[3] * tip[b])
    nn, nt = normal @ compliance @ normal.T, normal @ compliance @ tangent.T
    tt = tangent @ compliance @ tangent.T

    for step in range(1, steps + 1):
        u = w = phi = 0.0
        for k in range(n_modes):
            f = tip[0, k] * port0[0] + tip[1, k] * port0[1] + tip[2, k] * port0[2] + weight[k]
            qk, vk, g = q[k], v[k], weight[k]
            q[k] = prop[0, k] * qk + prop[1, k] * vk + prop[2, k] * f + prop[3, k] * g
            v[k] = prop[4, k] * qk + prop[5, k] * vk + prop[6, k] * f + prop[7, k] * g
            u += tip[0, k] * q[k]
            w += tip[1, k] * q[k]
            phi += tip[2, k] * q[k]
        r = relax[0] * r + relax[1] * (rest @ port0)
        free = np.array([u, w, phi]) + r
        gap, along = open_gap + normal @ free, tangent @ free

        N, T = force[step, 0], force[step, 1]
        N[:], T[:] = force[step - 1, 0], force[step - 1, 1]
        touching = False
        for i in range(n_points):
            touching = touching or gap[i] < 0.0 or N[i] > 0.0
        if touching:
            for _ in range(500):
                change = 0.0
                for i in range(n_points):
                    g, s = gap[i] - nn[i, i] * N[i], along[i] - tt[i, i] * T[i]
                    for j in range(n_points):
                        g += nn[i, j] * N[j] + nt[i, j] * T[j]
                        s += nt[j, i] * N[j] + tt[i, j] * T[j]
                    before_N, before_T = N[i], T[i]
                    N[i] = max(0.0, -g / (1.0 / kn[i] + nn[i, i]))
                    if mu > 0.0:
                        s += nt[i, i] * (N[i] - before_N)
                        stuck = -(s - anchor[i]) / (1.0 / kt[i] + tt[i, i])
                        T[i] = min(max(stuck, -mu * N[i]), mu * N[i])
                    change = max(change, abs(N[i] - before_N), abs(T[i] - before_T))
                if change <= 1e-13 * np.max(N):
                    break
        for i in range(n_points):
            slip[i] = along[i]
            for j in range(n_points):
                slip[i] += nt[j, i] * N[j] + tt[i, j] * T[j]
            moved = slip[i] + T[i] / kt[i]
            slid += -(T[i] + force[step - 1, 1, i]) / 2.0 * (moved - anchor[i])
            anchor[i] = moved

        port1 = normal.T @ N + tangent.T @ T
        for k in range(n_modes):
            f = tip[0, k] * port1[0] + tip[1, k] * port1[1] + tip[2, k] * port1[2]
            q[k] += prop[3, k] * f
            v[k] += prop[7, k] * f
        r = r + relax[2] * (rest @ port1)
        port0 = port1
    return force, q, v, r, slid


def _touches(time, force, momentum) -> tuple[np.ndarray, float]:
    """Begin, end and the fraction of speed kept at the end, of each touch; the whole impulse."""
    closed = np.concatenate([[False], force > 0.0, [False]])
    begin = np.flatnonzero(closed[1:] & ~closed[:-1])
    end = np.flatnonzero(~closed[1:] & closed[:-1])
    sums = np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2.0 * np.diff(time))])
    begin, end = np.maximum(begin - 1, 0), np.minimum(end, len(time) - 1)
    kept = sums[end] / momentum - 1.0
    return np.stack([time[begin], time[end], kept], axis=1), float(sums[-1])


# --- the rigid limit ----------------------------------------------------------------------------


@dataclass(frozen=True)
class RigidImpact:
    """After the impact of `rigid_bar`; velocities upwards, toward the lean, and spin with it."""

    centre_normal_m_s: float
    centre_tangential_m_s: float
    spin_rad_s: float
    tip_normal_m_s: float
    sticks: bool


def rigid_bar(
    lean_deg: float, length_m: float, *, mass_kg: float, inertia_kg_m2: float, mu: float
) -> RigidImpact:
    """A rigid bar falls with 1 m/s and strikes a plane with the middle of its end, elastically.

    From the centre to the struck point r = (−L/2 sin t, −L/2 cos t). Impulses T, N there change its
    velocity by

        Δv_t = B_tt T + B_tn N,  Δv_n = B_tn T + B_nn N,
        B_nn = 1/m + r_t²/I,  B_tt = 1/m + r_n²/I,  B_tn = −r_t r_n/I.

    The point begins without tangential velocity, so that it sticks all the time, T = −B_tn/B_tt N,
    if |B_tn| ≤ μ B_tt, and otherwise slips in the direction to which B_tn drives it, T = ∓μ N
    (Routh, Dynamics of a System of Rigid Bodies, 1905; Stronge, Impact Mechanics, 2000, Ch. 3).
    Either way v_n is linear in N: it comes back as fast as it came, whether restitution is
    Newton's, Poisson's or Stronge's.
    """
    lean, half = math.radians(lean_deg), length_m / 2.0
    r_t, r_n = -half * math.sin(lean), -half * math.cos(lean)
    B_nn, B_tt = 1.0 / mass_kg + r_t**2 / inertia_kg_m2, 1.0 / mass_kg + r_n**2 / inertia_kg_m2
    B_tn = -r_t * r_n / inertia_kg_m2
    sticks = abs(B_tn) <= mu * B_tt
    friction = -B_tn / B_tt if sticks else -math.copysign(mu, B_tn)
    N = 2.0 / (B_nn + B_tn * friction)
    T = friction * N
    return RigidImpact(
        centre_normal_m_s=N / mass_kg - 1.0,
        centre_tangential_m_s=T / mass_kg,
        spin_rad_s=-(r_t * N - r_n * T) / inertia_kg_m2,
        tip_normal_m_s=1.0,
        sticks=bool(sticks),
    )


# --- stick and slip -----------------------------------------------------------------------------


def oscillator_peaks(amplitude_m: float, stiffness: float, mu: float, normal_N: float) -> list:
    """Turning points of a mass on a spring rubbing on a Coulomb plane, let go at ``amplitude_m``.

    Each half cycle swings about ±μN/k and loses 2μN/k, a cycle 4μN/k (Den Hartog, Trans. ASME 53,
    1931); it stays where the spring can no longer overcome the friction.
    """
    dead = mu * normal_N / stiffness
    peaks = [amplitude_m]
    while abs(peaks[-1]) > dead:
        peaks.append(-math.copysign(abs(peaks[-1]) - 2.0 * dead, peaks[-1]))
    return peaks


def stick_slip_block(
    time_s, speed_m_s: float, mass_kg: float, normal_N: float, mu: float, kt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of a block sent over a Coulomb plane that holds by a spring ``kt``.

    What a penalty for sticking makes of a sliding block, exactly, with ω² = kt/m and d = μN/kt:
    stick, x = (v/ω) sin ωt, until x = d (if v > ωd, otherwise for ever); slip with v_s = √(v² −
    ω²d²) and deceleration μN/m over v_s² m/(2μN); then it swings back about d short of where it
    stopped, x = x_stop − d (1 − cos ωt), for ever, there being no other damping.
    """
    t = np.asarray(time_s, dtype=float)
    omega, hold = math.sqrt(kt / mass_kg), mu * normal_N / kt
    if speed_m_s <= omega * hold:
        return speed_m_s / omega * np.sin(omega * t), speed_m_s * np.cos(omega * t)
    slip = math.sqrt(speed_m_s**2 - (omega * hold) ** 2)
    brake = mu * normal_N / mass_kg
    begin = math.asin(omega * hold / speed_m_s) / omega
    end, stop = begin + slip / brake, hold + slip**2 / (2.0 * brake)
    stages = [t < begin, t < end]
    s, r = t - begin, t - end
    x = np.select(
        stages,
        [speed_m_s / omega * np.sin(omega * t), hold + slip * s - brake * s**2 / 2.0],
        stop - hold * (1.0 - np.cos(omega * r)),
    )
    v = np.select(
        stages, [speed_m_s * np.cos(omega * t), slip - brake * s], -hold * omega * np.sin(omega * r)
    )
    return x, v
