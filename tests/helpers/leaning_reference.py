"""How a leaning bar bounces, and how a block sticks and slips, by methods not used in the program.

Independent yardsticks. `leaning_series`: the elastic impact of a leaning bar from exact axial
and Timoshenko modes. `rigid_bar`: its rigid limit in closed form, with Coulomb friction.
`oscillator_peaks`, `stick_slip_block`: friction in closed form. Nothing is imported from the
program.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.polynomial import Polynomial
from scipy.linalg import expm

# --- the bar ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bar:
    """A free prismatic bar of length L and one bending plane, in which it leans. SI units.

    ``depth_m`` is the size of the section in that plane; ``flat_end`` tells whether the section is
    a rectangle, whose end face can touch point by point, or round, which touches at a point.
    """

    length_m: float
    area_m2: float
    second_moment_m4: float
    shear_coefficient: float
    depth_m: float
    flat_end: bool
    youngs_Pa: float = 207e9
    poisson: float = 0.28
    density_kg_m3: float = 7800.0

    @classmethod
    def rectangular(cls, length_m=0.3365, depth_m=0.5e-3, width_m=2.08e-3, **material) -> Bar:
        """The paper's bristle unless told otherwise; k = 10(1+ν)/(12+11ν) (Cowper 1966)."""
        nu = material.get("poisson", 0.28)
        return cls(
            length_m,
            depth_m * width_m,
            width_m * depth_m**3 / 12.0,
            10.0 * (1.0 + nu) / (12.0 + 11.0 * nu),
            depth_m,
            True,
            **material,
        )

    @classmethod
    def round(cls, length_m, diameter_m, **material) -> Bar:
        """A round bar with rounded end; k = 6(1+ν)/(7+6ν) (Cowper 1966)."""
        nu = material.get("poisson", 0.28)
        return cls(
            length_m,
            math.pi * diameter_m**2 / 4.0,
            math.pi * diameter_m**4 / 64.0,
            6.0 * (1.0 + nu) / (7.0 + 6.0 * nu),
            diameter_m,
            False,
            **material,
        )

    @property
    def mass_kg(self) -> float:
        return self.density_kg_m3 * self.area_m2 * self.length_m

    @property
    def rotary_inertia_kg_m2(self) -> float:
        """About the centre: ρA L³/12 + ρI L, as a Timoshenko beam has it."""
        rho, length = self.density_kg_m3, self.length_m
        return rho * self.area_m2 * length**3 / 12.0 + rho * self.second_moment_m4 * length

    @property
    def EA(self) -> float:
        return self.youngs_Pa * self.area_m2

    @property
    def EI(self) -> float:
        return self.youngs_Pa * self.second_moment_m4

    @property
    def kGA(self) -> float:
        shear = self.youngs_Pa / (2.0 * (1.0 + self.poisson))
        return self.shear_coefficient * shear * self.area_m2


# --- exact modes --------------------------------------------------------------------------------


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
    n = np.arange(n_modes + 1)
    omega = n * math.pi * math.sqrt(bar.EA / (bar.density_kg_m3 * bar.area_m2)) / bar.length_m
    tip = np.zeros((n_modes + 1, 3))
    tip[:, 0] = np.where(n == 0, 1.0, math.sqrt(2.0)) / math.sqrt(bar.mass_kg)
    rest = np.zeros((3, 3))
    rest[0, 0] = bar.length_m / (3.0 * bar.EA) - np.sum((tip[1:, 0] / omega[1:]) ** 2)
    return TipModes(omega, tip, rest)


@lru_cache
def bending_modes(bar: Bar, n_modes: int) -> TipModes:
    """Translation, rotation and the first ``n_modes`` exact free-free Timoshenko modes.

    With ξ from the middle, h = L/2, s = ω²ρ/(kG): w'' + s w = φ' and EI φ'' + kGA (w' − φ) + ρIω² φ
    = 0 have solutions of wave number κ and, evanescent below the cut-off ω_c = √(kGA/ρI) and
    travelling above it, μ or ν:

        κ² = √(a²/4 + b) + a/2,  μ² = −ν² = √(a²/4 + b) − a/2,
        a = ω²(ρ/E + ρ/kG),  b = ω²(ρA/EI − ω²ρ²/(E kG)).

    M = Q = 0 at both ends (Huang, J. Appl. Mech. 28, 1961; here split in even and odd) is brought
    to phase(ω) = nπ, n = 1, 2, …: the phase counts the modes, and nothing overflows.
    """
    h, rho = bar.length_m / 2.0, bar.density_kg_m3
    rigid = np.zeros((2, 3))
    rigid[0, 1] = 1.0 / math.sqrt(bar.mass_kg)
    rigid[1, 1:] = np.array([-h, 1.0]) / math.sqrt(bar.rotary_inertia_kg_m2)
    c_slow = math.sqrt(bar.kGA / (rho * bar.area_m2))
    euler = (math.pi * (n_modes + 2) / bar.length_m) ** 2 * math.sqrt(bar.EI / rho / bar.area_m2)
    top = min(euler, math.pi * (n_modes + 2) / bar.length_m * c_slow)
    found = []
    for even in (True, False):
        omega = _phase_roots(bar, even, top, n_modes // 2 + 2)
        found.append((omega, _tip_of(bar, omega, even)))
    omega = np.concatenate([f[0] for f in found])
    tip = np.concatenate([f[1] for f in found])
    first = np.argsort(omega)[:n_modes]
    if len(first) < n_modes:
        raise RuntimeError(f"{len(first)} bending modes found below {top:.3g} rad/s, not {n_modes}")
    omega, tip = omega[first], tip[first]
    rest = static_bending_compliance(bar) - (tip / omega[:, None] ** 2).T @ tip
    return TipModes(np.concatenate([[0.0, 0.0], omega]), np.concatenate([rigid, tip]), rest)


def static_bending_compliance(bar: Bar) -> np.ndarray:
    """Elastic tip motion (u, w, φ) under unit tip loads, (3, 3), the bar accelerating freely.

    Q' = ρA(a + αξ) and M' = ρIα − Q are integrated from Q = −F, M = −m at the tip; what remains of
    rigid motion in w and φ is taken out with the mass as weight.
    """
    h, rho = bar.length_m / 2.0, bar.density_kg_m3
    line, inertia = rho * bar.area_m2, rho * bar.second_moment_m4
    mass, rotary = bar.mass_kg, bar.rotary_inertia_kg_m2
    compliance = np.zeros((3, 3))
    xi = Polynomial([0.0, 1.0])
    for column, (force, moment) in ((1, (1.0, 0.0)), (2, (0.0, 1.0))):
        turn = (moment - h * force) / rotary
        Q = (line * (force / mass + turn * xi)).integ(lbnd=-h) - force
        M = (inertia * turn - Q).integ(lbnd=-h) - moment
        phi = (M / bar.EI).integ()
        w = (phi + Q / bar.kGA).integ()
        shift = (line * w).integ(lbnd=-h)(h) / mass
        spin = (line * w * xi + inertia * phi).integ(lbnd=-h)(h) / rotary
        compliance[1:, column] = w(-h) - shift + h * spin, phi(-h) - spin
    return compliance


def _wave_numbers(bar: Bar, omega):
    """κ, the square of μ (negative above the cut-off), and s = ω²ρ/(kG)."""
    rho = bar.density_kg_m3
    s = omega**2 * rho * bar.area_m2 / bar.kGA
    e = omega**2 * rho / bar.youngs_Pa
    root = np.sqrt((s - e) ** 2 / 4.0 + omega**2 * rho * bar.area_m2 / bar.EI)
    middle = (s + e) / 2.0
    mu2 = (omega**2 * rho * bar.area_m2 / bar.EI - s * e) / (root + middle)
    return np.sqrt(root + middle), mu2, s


def _phase(bar: Bar, omega, even: bool):
    """A function of ω that passes a multiple of π at each natural frequency."""
    h = bar.length_m / 2.0
    kappa, mu2, s = _wave_numbers(bar, omega)
    size = np.sqrt(np.abs(mu2))
    p, r = (mu2 + s) / kappa, (kappa**2 - s) / size
    tanh = np.tanh(size * h)
    below = np.where(even, np.arctan2(r * tanh, p), -np.arctan2(p * tanh, r))
    ratio = np.where(even, p / r, r / p)
    return kappa * h + np.where(mu2 > 0.0, below, _stretch(kappa * h, ratio) + size * h)


def _stretch(angle, ratio):
    """arctan(ratio · tan angle) − angle, in the quadrant of ``angle``."""
    turned = np.arctan2(ratio * np.sin(angle), np.cos(angle))
    return turned - np.angle(np.exp(1j * angle))


def _phase_roots(bar: Bar, even: bool, top: float, n_roots: int) -> np.ndarray:
    """The frequencies below ``top`` where the phase is π, 2π, …, by bisection of all at once."""

    def passed(omega):
        return np.floor(_phase(bar, omega, even) / math.pi)

    # Equal steps of ω resolve the travelling waves, equal steps of its root the bending waves.
    even_steps = np.linspace(0.0, 1.0, 40 * n_roots)[1:]
    grid = np.unique(np.concatenate([even_steps, even_steps**2])) * top
    count = passed(grid)
    if np.any(np.diff(count) < 0):
        raise RuntimeError("the phase falls back past a multiple of π: modes may be missed")
    number = np.arange(1, count[-1] + 1)
    right = np.searchsorted(count, number)
    low, high = grid[np.maximum(right - 1, 0)], grid[right]
    for _ in range(60):
        middle = (low + high) / 2.0
        is_low = passed(middle) < number
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    return (low + high) / 2.0


def _tip_of(bar: Bar, omega: np.ndarray, even: bool) -> np.ndarray:
    """(u, w, φ) at the tip, ξ = −h, of the modes scaled to ∫ρA w² + ρI φ² = 1."""
    h, rho = bar.length_m / 2.0, bar.density_kg_m3
    kappa, mu2, s = (column[:, None] for column in _wave_numbers(bar, omega))
    size = np.sqrt(np.abs(mu2))
    evanescent = mu2 > 0.0

    def waves(xi):
        """w and φ of both solutions; the evanescent one scaled to about one at the end."""
        near, far = np.exp(size * (np.abs(xi) - h)), np.exp(-size * (np.abs(xi) + h))
        cosh, sinh = (near + far) / 2.0, np.sign(xi) * (near - far) / 2.0
        cos, sin = np.cos(size * xi), np.sin(size * xi)
        ck, sk = np.cos(kappa * xi), np.sin(kappa * xi)
        a, b = (mu2 + s) / size, (s - kappa**2) / kappa
        if even:
            slow = np.where(evanescent, cosh, cos), a * np.where(evanescent, sinh, sin)
            return slow, (ck, b * sk)
        slow = np.where(evanescent, sinh, sin), a * np.where(evanescent, cosh, -cos)
        return slow, (sk, -b * ck)

    # φ' = w'' + s w and w' − φ of the two solutions at ξ = h, both of which must vanish.
    (w1, p1), (w2, p2) = waves(np.array([[h]]))
    bend1, bend2 = (mu2 + s) * w1, (s - kappa**2) * w2
    shear1, shear2 = _shear(p1, mu2, s), _shear(p2, -(kappa**2), s)
    use_bend = np.hypot(bend1, bend2) / kappa > np.hypot(shear1, shear2)
    one = np.where(use_bend, -bend2, -shear2)
    two = np.where(use_bend, bend1, shear1)

    panels = max(8, math.ceil(float(kappa.max()) * h / 2.0))
    x, weight = np.polynomial.legendre.leggauss(8)
    xi = ((np.arange(panels)[:, None] + (x + 1.0) / 2.0) * h / panels).ravel()[None, :]
    weights = np.tile(weight, panels) * h / panels  # doubled: the other half is alike
    tip = np.zeros((len(omega), 3))
    (w1, p1), (w2, p2) = waves(xi)
    w, phi = one * w1 + two * w2, one * p1 + two * p2
    mass = rho * (bar.area_m2 * w**2 + bar.second_moment_m4 * phi**2) @ weights
    (w1, p1), (w2, p2) = waves(np.array([[-h]]))
    tip[:, 1] = (one * w1 + two * w2)[:, 0]
    tip[:, 2] = (one * p1 + two * p2)[:, 0]
    return tip / np.sqrt(mass)[:, None]


def _shear(phi, lambda2, s):
    """w' − φ of a solution e^{λξ}: since φ = (λ² + s)/λ² w', it is −s φ/(λ² + s)."""
    return -s * phi / (lambda2 + s)


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
    time_s: np.ndarray
    force_N: np.ndarray

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
    n_bending: int = 500,
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
    bar = bar or Bar.rectangular()
    if face and not bar.flat_end:
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
    force, place, velocity, relaxed, slid = _march(
        _propagators(omega, beta, step_s),
        _relaxation(beta, step_s),
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
        time_s=time,
        force_N=total,
    )


def _gauss_lobatto(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on [−1, 1] and weights that sum to one."""
    if n < 2:
        raise ValueError("Gauss–Lobatto has two points or more")
    legendre = np.polynomial.legendre.Legendre.basis(n - 1)
    x = np.concatenate([[-1.0], np.sort(legendre.deriv().roots().real), [1.0]])
    return x, 1.0 / (n * (n - 1) * legendre(x) ** 2)


def _propagators(omega: np.ndarray, beta: float, dt: float) -> np.ndarray:
    """(8, n): q and q̇ after a step from q, q̇, the force at its begin and at its end.

    The exponential of q'' = −ω² q − βω² q' + F, F' = const, with time in steps.
    """
    system = np.zeros((len(omega), 4, 4))
    system[:, 0, 1] = system[:, 1, 2] = system[:, 2, 3] = 1.0
    system[:, 1, 0], system[:, 1, 1] = -((omega * dt) ** 2), -beta * omega**2 * dt
    e = expm(system)[:, :2]
    e[:, 1] /= dt
    e[:, :, 1] *= dt
    e[:, :, 2:] *= dt**2
    e[:, :, 2] -= e[:, :, 3]
    return np.ascontiguousarray(e.transpose(1, 2, 0).reshape(8, -1))


def _relaxation(beta: float, dt: float) -> np.ndarray:
    """r + β r' = R f with f linear over the step: r₁ = c₀ r₀ + c₁ R f₀ + c₂ R f₁."""
    if beta == 0.0:
        return np.array([0.0, 0.0, 1.0])
    decay = math.exp(-dt / beta)
    mean = -math.expm1(-dt / beta) * beta / dt
    return np.array([decay, mean - decay, 1.0 - mean])


@njit(cache=False, fastmath=True)
def _march(
    prop, relax, tip, rest, velocity, weight, normal, tangent, open_gap, kn, kt, mu, steps
):  # pragma: no cover - compiled
    """All forces (steps + 1, normal and tangential, points), last q and q̇, friction's work."""
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
