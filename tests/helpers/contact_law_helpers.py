"""What tests of contact laws share: a mass on a plane, the laws tried, and their closed forms."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import beta

from bristle.solver.bodies.base import ContactPoints
from bristle.solver.bodies.modal import ModalBody
from bristle.solver.contact.enforcement import ContactMethod, Enforcement, StepContact
from bristle.solver.contact.laws import (
    Adhesive,
    Coulomb,
    Damped,
    HuntCrossley,
    Linear,
    Plastic,
    Stiffening,
    Tabulated,
)
from bristle.solver.contact.points import Trial
from bristle.solver.contact.section import new_section
from bristle.solver.contact.step import point_force
from bristle.solver.contact_phase import History
from bristle.solver.ground import Ground, place
from bristle.solver.impact import march_contact
from bristle.solver.rigid import Pose, leaning
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

# The paper's bristle, about: 1.4 g come with 1 m/s onto 2 MN/m, and press 53 N into 26 μm.
MASS, SPEED, KN = 1.4e-3, 1.0, 2e6
OMEGA = math.sqrt(KN / MASS)
MOST = SPEED * math.sqrt(KN * MASS)
LAWS = [
    Stiffening(KN, 1.5),
    Stiffening(KN, 2.7, 1e-5),
    # soft, stiff, soft again, and straight on beyond its end
    Tabulated(KN, (0.0, 5e-6, 1.2e-5, 2e-5), (0.0, 1e-6, 1.5e-5, 1.7e-5)),
    Damped(KN, 0.2 * math.sqrt(KN * MASS)),
    HuntCrossley(KN, 0.4 / SPEED),
    Plastic(KN, 0.45 * MOST),
    Plastic(KN, 0.45 * MOST, 0.1, 3.0),
    Adhesive(KN, 0.6 * MOST),
]
# Adhesion is for penalty alone.
ENFORCED = [
    (law, enforcement)
    for law in LAWS
    for enforcement in (Enforcement.PENALTY, Enforcement.AUGMENTED)
    if enforcement is Enforcement.PENALTY or not law.pulls
]


def pushed(points, start, end, memory, multiplier):
    """Force (3,) of a single point over a step, and its tangent (3, 3), by approaches (3,)."""
    trial = Trial(start[None], end[None], end[None], np.zeros((1, 3)), memory, multiplier)
    n, t0, t1, n_s, t0_0, t1_1, t0_1, t0_s, t1_s = point_force(points, trial, 0)
    tangent = np.array([[n_s, 0.0, 0.0], [t0_s, t0_0, t0_1], [t1_s, t0_1, t1_1]])
    return np.array([n, t0, t1]), tangent


def a_step(enforcement, law, response, end_weight=None, mu=0.0, whole=False, **more) -> StepContact:
    """A step of points whose approaches answer by ``response`` (3 n, 3 n), by way of a section.

    Every point of a ``whole`` section moves with all of its coordinates.
    """
    n = len(response) // 3
    support, values = np.arange(3 * n).reshape(n, 3), np.tile(np.eye(3), (n, 1, 1))
    if whole:
        support = np.tile(np.arange(3 * n), (n, 1))
        values = np.eye(3 * n).reshape(n, 3, 3 * n)
    return StepContact(
        method=ContactMethod(law, enforcement, friction=Coulomb(mu)),
        compliance_m_N=0.0,
        section=new_section(support, values, -response * n),
        weights=np.full(n, 1.0 / n),
        scale=np.ones(n),
        end_weight=end_weight,
        **more,
    )


def some_response(n, size, rng):
    """A body's answer to forces (3 n, 3 n): negative definite, as every body's is."""
    root = rng.normal(size=(3 * n, 3 * n))
    return -size * (root @ root.T / 3.0 + 0.1 * np.eye(3 * n))


def mass_on_a_foot(points=1) -> ModalBody:
    """A mass that only moves up and down, on a foot of so many points of unequal shares."""
    shares = np.arange(1.0, points + 1.0)
    return ModalBody(
        name="mass",
        omega2=np.zeros(1),
        translation=np.array([[0.0, 0.0, math.sqrt(MASS)]]),
        rotation=np.zeros((1, 3)),
        contact=ContactPoints(
            coordinates=np.array([[1.0 / math.sqrt(MASS)]]),
            support=np.zeros((points, 1), dtype=np.int64),
            shapes=np.tile([[[0.0], [0.0], [1.0]]], (points, 1, 1)),
            traction=np.zeros((3 * points, 1)),
            weights=shares / shares.sum(),
            places_m=np.zeros((points, 3)),
        ),
        alpha_1_s=0.0,
        beta_s=0.0,
    )


def marcher_of(law, its, *, body=None, gap_m=0.0, enforcement=None, scheme=None) -> Marcher:
    """A march of the mass without gravity, ``gap_m`` over a plane."""
    body = body or mass_on_a_foot()
    method = ContactMethod(law, enforcement or Enforcement.PENALTY)
    marcher = Marcher(body, method, scheme or TimeScheme.average(), its, 0.0)
    pose = Pose(np.array([0.0, 0.0, gap_m]), leaning(0.0, 0.0))
    marcher.place(place(Ground.plane(len(body.contact.weights)), pose, body.contact))
    return marcher


def bounce(law, its, *, until_s=math.inf, observer=None, **options):
    """The touch of a mass that comes with SPEED, and its history."""
    history = History()
    v = np.full(1, -math.sqrt(MASS) * SPEED)
    marcher = marcher_of(law, its, **options)
    touch = march_contact(marcher, 0.0, np.zeros(1), v, history, observer, until_s)
    return touch, history


class Closed(NamedTuple):
    """What is known of a bounce without gravity: share of the speed kept, time in contact, greatest
    force and depth, and the depth at which it lets go; not a number where it is not known."""

    kept: float
    time_s: float
    peak_N: float
    depth_m: float
    left_m: float = 0.0


def closed_form(law, mass_kg=MASS, speed_m_s=SPEED) -> Closed:
    """The bounce of a mass on a law, of those here or `Hardening` of docs/examples."""
    m, v, kn = mass_kg, speed_m_s, law.kn_N_m
    omega, most = math.sqrt(kn / m), v * math.sqrt(kn * m)
    if isinstance(law, Damped):
        # T. Schwager and T. Pöschel, Granular Matter 9 (2007) 465: the force ends at T while it is
        # still pressed, and the restitution is exp(-ζ ω T)
        zeta = law.damping / (2.0 * math.sqrt(kn * m))
        root = math.sqrt(1.0 - zeta**2)
        time = (math.pi - math.atan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2)) / (omega * root)
        kept = math.exp(-zeta * omega * time)
        return Closed(kept, time, math.nan, math.nan, law.damping * kept * v / kn)
    if isinstance(law, Linear | Stiffening):
        # δ = ((p+1) m v² / 2c)^(1/(p+1)), T = 2 δ/v B(1/(p+1), ½)/(p+1)
        exponent = getattr(law, "exponent", 1.0)
        c = kn * getattr(law, "reference_m", 1.0) ** (1.0 - exponent)
        depth = (0.5 * (exponent + 1.0) * m * v**2 / c) ** (1.0 / (exponent + 1.0))
        time = 2.0 * depth / v * float(beta(1.0 / (exponent + 1.0), 0.5)) / (exponent + 1.0)
        return Closed(1.0, time, c * depth**exponent, depth)
    if isinstance(law, HuntCrossley):
        return _of_hunt_crossley(kn, law.damping_s_m, m, v)
    if isinstance(law, Adhesive):
        # the spring is gone that lets go, after ½ + asin(F/F₀)/π half waves
        share = law.pull_off_N / most
        time = (math.pi + math.asin(share)) / omega
        return Closed(math.sqrt(1.0 - share**2), time, most, v / omega, -law.pull_off_N / kn)
    # ½ m v² goes into ½ Y²/Kn, and beyond into Y x + ½ h Kn x²; ½ F²/(u Kn) comes back. A quarter
    # wave on Kn to yield, part of one on h Kn, and a quarter wave on u Kn
    force, soft, unloading = law.yield_N, law.hardening * kn, getattr(law, "unloading", 1.0)
    beyond = 0.5 * m * v**2 - 0.5 * force**2 / kn
    peak = math.sqrt(force**2 + 2.0 * soft * beyond)
    over, slow = 2.0 * beyond / (force + peak), math.sqrt(soft / m)
    flows = m * math.sqrt(2.0 * beyond / m) / force
    time = (math.asin(force / most) + 0.5 * math.pi / math.sqrt(unloading)) / omega
    time += math.atan(slow * flows) / slow if slow else flows
    depth, back = force / kn + over, peak / (unloading * kn)
    return Closed(peak / (most * math.sqrt(unloading)), time, peak, depth, depth - back)


def _of_hunt_crossley(kn: float, damping_s_m: float, m: float, v: float) -> Closed:
    """By integration: contact ends where its depth does, or before, where it would pull."""

    def force(y):
        return kn * y[0] * (1.0 + damping_s_m * y[1])

    def motion(_t, y):
        return [y[1], -max(force(y), 0.0) / m]

    def released(t, y):
        return 1.0 if t == 0.0 else y[0]

    released.terminal, released.direction = True, -1.0
    close, until = {"rtol": 1e-11, "atol": 1e-16}, 50.0 * math.sqrt(m / kn)
    run = solve_ivp(motion, (0.0, until), [0.0, v], "LSODA", None, True, released, **close)
    seen = run.sol(np.linspace(0.0, run.t[-1], 20001))
    peak, depth = max(max(force(y), 0.0) for y in seen.T), float(seen[0].max())
    return Closed(-float(run.y[1, -1]) / v, float(run.t[-1]), peak, depth)
