"""Dynamics of the rod: modes, spin-up, large overall motion, orders, and no energy from nowhere."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from rod_helpers import SLENDER, OneRod, along, leaning, one_clamp, rotate, whole_matrix
from scipy.integrate import solve_ivp
from scipy.interpolate import BPoly, PPoly
from scipy.linalg import eigh
from scipy.optimize import brentq

from bristle.solver.rods.chain import Chain, at_rest, new_system, uniform_chain
from bristle.solver.rods.element import assemble_forces, assemble_tangent, new_elements
from bristle.solver.rods.hub import HubPath
from bristle.solver.rods.motion import energies
from bristle.solver.rods.rods import Rods
from bristle.solver.rods.section import RodSection

# one rod, which no rank shares
pytestmark = pytest.mark.serial


def frequencies_Hz(chain):
    """Of small vibrations about the straight rod, from its tangent and its lumped masses."""
    x, q = at_rest(chain, np.zeros(3), np.eye(3))
    n, system = len(x), new_system(len(x))
    elements = new_elements(n - 1)
    assemble_forces(chain, x, q, chain.rest, 0.0, system, elements)
    assemble_tangent(chain, 0.0, system, elements)
    free = whole_matrix(system)[1:, :, 1:].reshape(6 * (n - 1), -1)
    mass = np.concatenate([np.tile(chain.mass[1:, None], 3), chain.inertia[1:]], axis=1).ravel()
    return np.sqrt(eigh(free, np.diag(mass), eigvals_only=True)) / (2.0 * math.pi)


def test_bending_modes_of_the_clamped_bristle(bristle):
    """Euler and Bernoulli's f = β² √(EI/ρA) / 2πL² with cos β cosh β = -1, the first 3.675 Hz.

    The error falls with the square of the element size: the tip's lumped mass. The first four of
    the weak axis have to be told from the first of the strong one, which is at 4.16 times 3.675 Hz.
    """
    section = RodSection.of(bristle)
    roots = [
        brentq(lambda b: math.cos(b) + 1.0 / math.cosh(b), (k - 0.7) * math.pi, (k - 0.3) * math.pi)
        for k in (1, 2, 3, 4)
    ]
    speed = math.sqrt(section.EI2_Nm2 / section.rhoA_kg_m)
    exact = np.array(roots) ** 2 * speed / (2.0 * math.pi * bristle.length_m**2)
    assert exact[0] == pytest.approx(3.675, abs=5e-4)
    errors = []
    for elements in (40, 80):
        found = frequencies_Hz(uniform_chain(section, bristle.length_m, elements))
        nearest = np.array([found[np.abs(found - f).argmin()] for f in exact])
        errors.append(np.abs(nearest / exact - 1.0))
    assert np.all(errors[1] < 1e-3)
    assert np.all(errors[0] / errors[1] > 3.6)


def spun_up() -> HubPath:
    """Simo and Vu-Quoc's ψ = 0.4 (t²/2 + (15/2π)² (cos(2πt/15) - 1)) to 15 s, then 6 t - 45 rad.

    Quintics that share value, rate and acceleration every half second are within 1e-9 rad of it.
    """
    t, w = np.arange(0.0, 15.01, 0.5), 2.0 * math.pi / 15.0
    angle = 0.4 * (0.5 * t**2 + (np.cos(w * t) - 1.0) / w**2)
    rate, change = 0.4 * (t - np.sin(w * t) / w), 0.4 * (1.0 - np.cos(w * t))
    quintic = PPoly.from_bernstein_basis(
        BPoly.from_derivatives(t, np.stack([angle, rate, change], -1))
    )
    coefficients = np.zeros((6, len(t), 6))
    coefficients[:, :-1, 5] = quintic.c
    coefficients[-2:, -1, 5] = 6.0, angle[-1]
    return HubPath(np.append(t, 16.0), coefficients)


def test_spin_up_of_an_arm_lags_and_stretches():
    """Lag -0.574 and stretch 5.14e-4 = ω² ρA L³ / 3EA; with averaged strains it would be more."""
    section = RodSection(
        2.8e7, 1e7, 1e7, 1.4e4, 1.4e4, 1.4e4, 1.2, 6e-4, 6e-4, half_thin_m=0.01, half_wide_m=0.01
    )
    path = spun_up()
    arm = one_clamp(np.zeros(3), along([1.0, 0.0, 0.0], wide=(0.0, 0.0, 1.0)), 10.0)
    rods = Rods(section, arm, path, None, 40, gravity_m_s2=0.0, comm=MPI.COMM_SELF)
    lags, stretches, times = [], [], []
    for frame in rods.march(30.0, 0.02):
        tip = path.pose(frame.t_s).rotation.T @ frame.tip_m[0]
        lags.append(tip[1])
        stretches.append(tip[0] - 10.0)
        times.append(frame.t_s)
    assert min(lags) == pytest.approx(-0.574, rel=5e-3)
    assert times[int(np.argmin(lags))] == pytest.approx(6.76, abs=0.05)
    steady = np.array(stretches)[np.array(times) > 20.0]
    assert steady.mean() == pytest.approx(5.14e-4, rel=0.01)


def test_a_right_angle_cantilever_swings_far_out_of_its_plane():
    """Simo and Vu-Quoc, Comput. Methods Appl. Mech. Engng 66 (1988): EA = GA = 1e6, EI = GJ = 1e3,
    ρA = 1, ρI = 10, two arms of 10; a force of 50 at the elbow out of the plane after 1 s, gone
    after 2 s. Largest excursions at the tip and the elbow, within 2 %."""
    per_arm, h = 10, 0.05
    n = 2 * per_arm + 1
    rest = np.zeros((n - 1, 6))
    rest[:per_arm, 2], rest[per_arm:, 0] = 1.0, 1.0
    share = np.ones(n)
    share[[0, -1]] = 0.5
    inertia = np.full((n, 3), 10.0)
    inertia[:per_arm, 2] = inertia[per_arm + 1 :, 0] = 20.0
    inertia[per_arm] = 15.0, 10.0, 15.0
    stiffness = np.tile([1e6, 1e6, 1e6, 1e3, 1e3, 1e3], (n - 1, 1))
    # residual bending, about the axis across each arm
    soft = 1.0 / (1e-6 + 1.0 / 12e3)
    stiffness[:per_arm, [0, 1]] = stiffness[per_arm:, [1, 2]] = soft
    chain = Chain(np.ones(n - 1), stiffness, rest, share, share[:, None] * inertia, 0.0, 0.0)
    arm = OneRod(chain, np.zeros(3), along([1.0, 0.0, 0.0], wide=(0.0, 0.0, 1.0)), rho=0.9)
    tip, elbow = [], []
    for k in range(int(17.0 / h)):
        t = (k + 1) * h
        arm.loads[per_arm, 2] = 50.0 * max(0.0, 1.0 - abs(t - 1.0))
        assert arm.step(h)
        tip.append((arm.now.x[-1, 2], t))
        elbow.append((arm.now.x[per_arm, 2], t))
    highest, lowest = max(tip), min(tip)
    assert highest[0] == pytest.approx(8.25, rel=0.02)
    assert highest[1] == pytest.approx(7.44, abs=0.15)
    assert lowest[0] == pytest.approx(-9.73, rel=0.02)
    assert lowest[1] == pytest.approx(15.87, abs=0.2)
    assert min(elbow)[0] == pytest.approx(-4.06, rel=0.02)
    assert min(elbow)[1] == pytest.approx(10.87, abs=0.2)


def swung(elements=8, rho=0.6):
    """A bent rod let go, far beyond small deflections; its first period is about 1.8."""
    chain = uniform_chain(replace(SLENDER, EA_N=1e4, GA1_N=1e4, GA2_N=1e4), 1.0, elements)
    arm = OneRod(chain, np.zeros(3), np.eye(3), rho=rho)
    arm.let_go(3.0)
    return arm


def test_free_vibration_makes_no_energy_in_1e4_steps():
    arm = swung()
    start = sum(energies(arm.chain, arm.now, np.zeros(3))[:2])
    most = 0.0
    for _ in range(10_000):
        assert arm.step(2e-3)
        now = sum(energies(arm.chain, arm.now, np.zeros(3))[:2])
        most = max(most, now)
    assert most <= start * (1.0 + 1e-6)
    assert now > 0.5 * start


@pytest.mark.parametrize("uneven", [0.0, 1.0 / 3.0])
def test_the_scheme_is_of_second_order(uneven):
    """Differences between halved steps fall by four, at an instant of large bending; also where
    every other step is twice as long."""
    found = []
    for steps in (100, 200, 400):
        arm = swung(rho=0.8)
        # the load is let go smoothly, or the first steps' jump is of lower order
        for k in range(steps):
            h = (1.0 + (-1) ** k * uneven) * 0.5 / steps
            arm.loads[-1, 0] = 3.0 * math.cos(math.pi * (arm.now.totals[0] + h)) ** 4
            assert arm.step(h)
        found.append(arm.now.x[-1].copy())
    ratio = np.linalg.norm(found[1] - found[0]) / np.linalg.norm(found[2] - found[1])
    assert 3.6 < ratio < 4.4


@pytest.mark.parametrize("damping", ["beta", "alpha"])
def test_damping_is_rayleighs(damping):
    """A small vibration in the first mode decays by (α + β ω²)/2 per second, to the order of the
    ratio itself."""
    omega = 1.8751041**2
    rate = 0.02 * omega
    numbers = {"beta_s": 2.0 * rate / omega**2} if damping == "beta" else {"alpha_1_s": 2.0 * rate}
    section = replace(SLENDER, EA_N=1e4, GA1_N=1e4, GA2_N=1e4, **numbers)
    arm = OneRod(uniform_chain(section, 1.0, 20), np.zeros(3), np.eye(3), rho=0.9)
    arm.let_go(1e-3)
    period = 2.0 * math.pi / omega
    held, h = [], period / 200
    for k in range(1200):
        assert arm.step(h)
        if (k + 1) % 200 == 0:
            held.append(sum(energies(arm.chain, arm.now, np.zeros(3))[:2]))
    decay = np.log(held[1] / held[5]) / (2.0 * 4.0 * period)
    assert decay == pytest.approx(rate, rel=0.01)
    lost = arm.now.totals[3]
    assert lost > 0.0


def test_gravity_and_reaction_at_rest(bristle):
    """The hub carries the weight and its moment about the hub's origin, of nodes as they hang."""
    section = RodSection.of(bristle)
    clamp = one_clamp([0.1, 0.0, 0.0], along([1.0, 0.0, 0.0], wide=(0.0, 0.0, 1.0)), 0.3)
    rods = Rods(section, clamp, HubPath.still(), None, bow_rad=0.0, comm=MPI.COMM_SELF)
    frame = rods.frame()
    weights = 9.8 * uniform_chain(section, 0.3, 20).mass
    assert frame.force_N == pytest.approx([0.0, 0.0, -weights.sum()], abs=1e-8)
    moment = weights @ frame.centre_m[0, :, 0]
    assert frame.torque_Nm == pytest.approx([0.0, moment, 0.0], rel=1e-6, abs=1e-9)


def test_steps_are_short_enough_for_a_rod_that_only_twists(bristle):
    """Its clamp is set off about its axis in 0.1 ms: the torque, beside that of discs on shafts."""
    section, ends = replace(RodSection.of(bristle), beta_s=0.0), 3e-4 + 5e-4 * np.arange(5)
    path = rotate(0.0, 3000.0, 1e-4, 1e-4)
    clamp = one_clamp(np.zeros(3), leaning(0.0), bristle.length_m)
    calm = {"bow_rad": 0.0, "gravity_m_s2": 0.0, "tolerance": 1e-8, "comm": MPI.COMM_SELF}
    rods = Rods(section, clamp, path, None, **calm)
    inertia, shaft = uniform_chain(section, bristle.length_m, 20).inertia[1:, 2], 20
    shaft *= section.GJ_Nm2 / bristle.length_m

    def rates(t, state):
        turned = path.pose(t).rotation[:2, 0]
        angles = np.append(math.atan2(turned[1], turned[0]), state[:20])
        torques = shaft * np.diff(angles)
        return [*state[20:40], *((np.append(torques[1:], 0.0) - torques) / inertia), torques[0]]

    told = {"t_eval": ends, "rtol": 1e-9, "atol": 1e-12, "max_step": 1e-5}
    expected = np.diff(solve_ivp(rates, (0.0, ends[-1]), np.zeros(41), **told).y[-1]) / 5e-4
    rods.advance(ends[0])
    for end_s, torque_Nm in zip(ends[1:], expected, strict=True):
        rods.advance(end_s)
        found = rods.frame().means.torque_Nm[0, 2]
        assert found == pytest.approx(torque_Nm, abs=0.02 * np.abs(expected).max())
