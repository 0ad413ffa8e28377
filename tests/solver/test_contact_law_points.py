"""Laws with a curve, a loss or a memory keep their books at every point, in every march.

Tangents against finite differences, random walks, random steps of several points, friction beside
them, and the three marches against one another.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from contact_law_helpers import (
    ENFORCED,
    KN,
    LAWS,
    MOST,
    OMEGA,
    SPEED,
    a_step,
    pushed,
    some_response,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bristle.solver.batch import Drops, drop_many
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import (
    Adhesive,
    Coulomb,
    Damped,
    HuntCrossley,
    Linear,
    Plastic,
    Stiffening,
    Tabulated,
    mindlin_ratio,
)
from bristle.solver.contact.points import CONSERVING, Points, Trial
from bristle.solver.contact.step import commit, settle, spring_energy, take
from bristle.solver.contact_phase import History
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.impact import march_contact
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

pytestmark = pytest.mark.serial
G, ITS = 9.8, 1e-6
DEEP = SPEED / OMEGA
TABLE = Tabulated(KN, (0.0, 0.2 * DEEP, 0.8 * DEEP), (0.0, 0.1 * DEEP, 0.9 * DEEP))
# law, memory, drives at the start and the end of a step; lengths in units of DEEP
REGIMES = {
    "linear, open": (Linear(KN), 0.0, -0.8, -0.4),
    "linear, closing": (Linear(KN), 0.0, -0.4, 0.8),
    "linear, closed": (Linear(KN), 0.0, 0.4, 0.8),
    "linear, still": (Linear(KN), 0.0, 0.4, 0.4),
    "linear, opening": (Linear(KN), 0.0, 0.8, -0.4),
    "open": (Stiffening(KN, 1.5), 0.0, -0.2, -0.1),
    "stiffening, closing": (Stiffening(KN, 2.5), 0.0, -0.1, 0.4),
    "stiffening, closed": (Stiffening(KN, 1.5), 0.0, 0.3, 0.4),
    "stiffening, hardly moved": (Stiffening(KN, 1.5), 0.0, 0.3, 0.3 + 1e-9),
    "stiffening, opening": (Stiffening(KN, 1.5), 0.0, 0.3, -0.1),
    "by a table, closing": (TABLE, 0.0, -0.1, 0.25),
    "by a table, closed": (TABLE, 0.0, 0.4, 0.7),
    "by a table, beyond its end": (TABLE, 0.0, 0.7, 0.9),
    "by a table, opening": (TABLE, 0.0, 0.6, -0.1),
    "damped, closing": (HuntCrossley(KN, 0.4), 0.0, -0.1, 0.4),
    "damped, rising": (HuntCrossley(KN, 0.4), 0.0, 0.5, 0.49),
    "damped, opening": (HuntCrossley(KN, 0.4), 0.0, 0.01, -0.01),
    "damped, would pull": (HuntCrossley(KN, 0.4), 0.0, 0.5, 0.1),
    "elastic": (Plastic(KN, 0.4 * MOST), 0.0, 0.1, 0.3),
    "starts to yield": (Plastic(KN, 0.4 * MOST), 0.0, 0.3, 0.5),
    "just before it yields": (Plastic(KN, 0.4 * MOST), 0.0, 0.3, 0.4 - 1e-4),
    "just after it yields": (Plastic(KN, 0.4 * MOST), 0.0, 0.3, 0.4 + 1e-4),
    "yielding": (Plastic(KN, 0.4 * MOST), 0.3 * DEEP, 0.7, 0.8),
    "unloading": (Plastic(KN, 0.4 * MOST), 0.3 * DEEP, 0.7, 0.6),
    "in its indentation": (Plastic(KN, 0.4 * MOST), 0.3 * DEEP, 0.25, 0.1),
    "leaves its indentation": (Plastic(KN, 0.4 * MOST), 0.3 * DEEP, 0.35, 0.2),
    "hardening": (Plastic(KN, 0.4 * MOST, 0.1, 3.0), 0.0, 0.3, 0.6),
    "unloading steeply": (Plastic(KN, 0.4 * MOST, 0.1, 3.0), 0.4 * DEEP, 0.48, 0.45),
    "hardening on": (Plastic(KN, 0.4 * MOST, 0.1, 3.0), 0.4 * DEEP, 0.45, 0.7),
    "not held": (Adhesive(KN, 0.6 * MOST), 0.0, -0.2, -0.1),
    "touching": (Adhesive(KN, 0.6 * MOST), 0.0, -0.1, 0.2),
    "held": (Adhesive(KN, 0.6 * MOST), 1.0, 0.1, -0.2),
    "just before it lets go": (Adhesive(KN, 0.6 * MOST), 1.0, -0.5, -0.6 + 1e-4),
    "just after it lets go": (Adhesive(KN, 0.6 * MOST), 1.0, -0.5, -0.6 - 1e-4),
    "lets go": (Adhesive(KN, 0.6 * MOST), 1.0, -0.3, -0.8),
    "lets go from above": (Adhesive(KN, 0.6 * MOST), 1.0, 0.3, -0.8),
}


def points_of(law, mu=0.5, soft=0.0, n=1, its=ITS):
    kt = mindlin_ratio(0.28) * KN
    weights = np.full(n, 1.0 / n)
    drag = law.damping / its
    numbers = law.kind, law.parameters, kt, mu, np.ones(n), 0.0, weights
    return Points(*numbers, CONSERVING, soft, drag)


def step_of(start, end, force, memory):
    return Trial(start[None], end[None], end[None], force[None], memory, np.zeros((1, 3)))


def test_contact_ends_where_its_last_point_lets_go():
    """Both points rise by 1.2 um, from 1 and 0.1 um deep, beside dashpots of c/Kn = 0.1 steps: the
    spring of the deep one pushes as hard as its dashpot pulls at a depth of 0.12 um."""
    points = points_of(Damped(KN, 0.1 * ITS * KN), its=ITS)
    points = points._replace(scale=np.ones(2), weights=np.array([0.1, 0.9]))
    start, none = np.zeros((2, 3)), np.zeros((2, 3))
    start[:, 0] = [1e-6, 1e-7]
    end = start - [1.2e-6, 0.0, 0.0]
    force = none.copy()
    force[0, 0] = 1.0
    trial = Trial(start, end, end, force, none.copy(), none)
    assert take(points, trial, 1.0).share == pytest.approx((1.0 - 0.12) / 1.2, rel=1e-12)
    loose = points_of(Tabulated(KN, (0.0, 1e-5, 2e-5), (0.0, 1e-9, 1e-5)), n=2)
    # a spring that hardly pushes yet is no match for its dashpot
    assert take(loose._replace(dashpot=0.1 * KN), trial, 1.0).share == 0.0


# Of a spring that is pressed by 0.4 and was not stretched before, where it begins to slide.
SLIDES = 0.4 / mindlin_ratio(0.28)


@pytest.mark.parametrize(
    ("regime", "soft", "end_weight"),
    [
        (regime, soft, weight)
        for regime, (law, *_) in REGIMES.items()
        for soft in ((0.0,) if law.pulls else (0.0, 1e-7))
        for weight in (CONSERVING, *((1.0, 0.6) if type(law) is Linear else ()))
    ],
)
@pytest.mark.parametrize("slip", [0.0, 1e-3, 0.999 * SLIDES, 1.001 * SLIDES, 3.0])
def test_tangent_of_a_point_against_finite_differences(regime, soft, end_weight, slip):
    """Open, closed, yielding, unloading, held and at the switches; sticking, sliding, and on either
    side of that."""
    law, kept, s0, s1 = REGIMES[regime]
    points = points_of(law, soft=soft, its=DEEP / SPEED / 10.0)._replace(end_weight=end_weight)
    start, step = np.array([s0 * DEEP, 0.0, 0.0]), 1e-7 * DEEP
    end = DEEP * np.array([s1, 0.8 * slip, -0.6 * slip])
    memory, multiplier = np.array([[2e-8, -1e-8, kept]]), np.array([[0.3, 0.05, -0.02]])
    slope = pushed(points, start, end, memory, multiplier)[1]
    for k in range(3):
        shift = step * np.eye(3)[k]
        after = pushed(points, start, end + shift, memory, multiplier)[0]
        before = pushed(points, start, end - shift, memory, multiplier)[0]
        wanted = (after - before) / (2.0 * step)
        assert slope[:, k] == pytest.approx(wanted, rel=1e-4, abs=1e-5 * KN)


@pytest.mark.parametrize("regime", [r for r in REGIMES if not r.startswith("damped")])
def test_force_over_a_step_is_the_mean_along_the_way(regime):
    """∫ F dδ over the change, by two hundred small steps with the memory renewed after each."""
    law, kept, s0, s1 = REGIMES[regime]
    points, none = points_of(law, mu=0.0), np.zeros((1, 3))
    memory, fine = np.array([[0.0, 0.0, kept]]), np.array([[0.0, 0.0, kept]])
    ends = [np.array([s * DEEP, 0.0, 0.0]) for s in np.linspace(s0, s1, 201)]
    work = took = 0.0
    for start, end in itertools.pairwise(ends):
        force = pushed(points, start, end, fine, none)[0]
        work += force[0] * (end - start)[0]
        took += settle(points, step_of(start, end, force, fine))
    force = pushed(points, ends[0], ends[-1], memory, none)[0]
    size = KN * DEEP**2
    assert force[0] * (ends[-1] - ends[0])[0] == pytest.approx(work, abs=1e-11 * size)
    loss = settle(points, step_of(ends[0], ends[-1], force, memory))
    assert loss == pytest.approx(took, abs=1e-11 * size)
    assert memory == pytest.approx(fine, abs=1e-12)


@pytest.mark.parametrize("law", [Linear(KN), *LAWS], ids=str)
@pytest.mark.parametrize("mu", [0.0, 0.4])
@given(seed=st.integers(0, 100_000), stride=st.floats(0.01, 1.0))
@settings(max_examples=20, deadline=None)
def test_a_random_walk_loses_never_less_than_nothing_and_closes(law, mu, seed, stride):
    """Work done on a point = what law and friction took + what they store, step by step."""
    rng = np.random.default_rng(seed)
    points, none = points_of(law, mu=mu, its=DEEP / SPEED / 10.0), np.zeros((1, 3))
    memory, start = np.zeros((1, 3)), np.zeros(3)
    work = lost = 0.0
    size = KN * DEEP**2
    for _ in range(40):
        end = start + stride * DEEP * rng.normal(size=3)
        # a pull back to the surface, without which it would walk away from it
        end[0] *= 0.8
        force = pushed(points, start, end, memory, none)[0]
        held = memory[0, 2]
        if isinstance(law, Plastic):
            beyond = law.hardening * KN * max(start[0], end[0], 0.0)
            assert 0.0 <= force[0] <= (law.yield_N + beyond) * (1.0 + 1e-12)
        elif isinstance(law, Adhesive):
            assert force[0] >= -law.pull_off_N * (1.0 + 1e-12)
        else:
            assert force[0] >= 0.0
        assert np.hypot(*force[1:]) <= mu * max(force[0], 0.0) * (1.0 + 1e-12) + 1e-15
        rubbed = commit(points, step_of(start, end, force, memory))
        took = settle(points, step_of(start, end, force, memory))
        assert min(rubbed, took) >= -1e-13 * size
        if isinstance(law, Plastic):
            flowed = memory[0, 2] - held
            if law.unloading == 1.0:
                assert took == pytest.approx(law.yield_N * flowed, abs=1e-10 * size)
            else:  # at least, since the spring is stiffer where it has yielded
                assert took >= 0.5 * law.yield_N * flowed - 1e-10 * size
        if isinstance(law, Adhesive):
            gone = 0.5 * law.pull_off_N**2 / KN if held > memory[0, 2] else 0.0
            assert took == pytest.approx(gone, abs=1e-13 * size)
        if type(law) in (Linear, Stiffening, Tabulated):
            assert took == 0.0
        work += float(force @ (end - start))
        lost += rubbed + took
        start = end
    stored = law.potential(start[:1], 0.0, 1.0, memory[:, 2])[0] + spring_energy(points, memory)
    # elastic over a step too short for its difference: SHORT² of what is stored
    assert work == pytest.approx(lost + stored, abs=1e-9 * size)


@pytest.mark.parametrize(("law", "enforcement"), ENFORCED, ids=str)
@given(seed=st.integers(0, 100_000), mu=st.sampled_from([0.0, 0.4]))
@example(seed=58271, mu=0.0)  # a force so small that rounding keeps its multiplier from settling
@settings(max_examples=15, deadline=None)
def test_steps_of_several_points_find_their_forces_and_lose_no_less_than_nothing(
    law, enforcement, seed, mu
):
    """A row of steps of four coupled points, by each of the solvers on a section."""
    rng, n = np.random.default_rng(seed), 4
    response = some_response(n, 2e-8, rng)
    frees = DEEP * rng.normal(size=(6, n, 3))
    forces = []
    for whole in (False, True):
        contact = a_step(enforcement, law, response, mu=mu, whole=whole, its_s=DEEP / SPEED)
        start, seen = np.zeros((n, 3)), []
        for free in frees:
            force = contact.solve(start, free)
            end = free + (response @ force.ravel()).reshape(n, 3)
            if force.any():
                assert contact.end == pytest.approx(end, rel=1e-8, abs=1e-9 * DEEP)
            took = contact.commit(start, force)
            # the multiplier is found to 1e-9 of the force
            close = 1e-13 if enforcement is Enforcement.PENALTY else 1e-8
            least = min(took.friction_loss_J, took.contact_loss_J)
            assert least >= -close * KN * DEEP**2
            start = contact.end
            seen.append(force)
        forces.append(np.array(seen))
    if not law.pulls:  # where a point may hold on or let go, either is an answer
        assert forces[1] == pytest.approx(forces[0], rel=1e-6, abs=1e-6 * MOST)


# --- marches ------------------------------------------------------------------------------------


def bristles(beta_s=1e-6):
    return beam_body(Bristle(material=Material(beta_s=beta_s)), 6, points=3)


def scaled(law, kn):
    """The law at another Kn, and forces weak enough that they act in a drop from millimetres."""
    law = replace(law, kn_N_m=kn)
    if isinstance(law, Plastic):
        return replace(law, yield_N=12.0)
    return replace(law, pull_off_N=8.0) if isinstance(law, Adhesive) else law


def drop(body, law, tilt, mu, enforcement=Enforcement.PENALTY, **options):
    method = ContactMethod(law, enforcement, friction=Coulomb(mu))
    plan = DropPlan(0.02, method, 2e-6, G, tilt_deg=tilt, impact_only=True)
    return simulate(ModalFrame(body), plan, **options)


@pytest.mark.parametrize("tilt", [0.0, 2.0])
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_python_and_compiled_march_agree_and_the_budget_closes(law, tilt):
    body, law = bristles(), scaled(law, 1e6)
    results = [drop(body, law, tilt, 0.3, observer=seen) for seen in (None, lambda *_: None)]
    compiled, python = results
    assert compiled.n_contacts == python.n_contacts
    assert compiled.n_steps == python.n_steps
    for name in ("contact_time_s", "peak_force_N", "impulse_N_s", "max_penetration_m"):
        assert getattr(compiled, name) == pytest.approx(getattr(python, name), rel=1e-7)
    speed = compiled.impact_speed_m_s
    assert compiled.velocity_after_m_s == pytest.approx(python.velocity_after_m_s, abs=1e-8 * speed)
    for result in results:
        assert result.energy.closure_relative < 1e-9
    initial = compiled.energy.initial_J
    lost = compiled.energy.contact_loss_J
    assert lost == pytest.approx(python.energy.contact_loss_J, abs=1e-8 * initial)
    if not isinstance(law, Stiffening | Tabulated):
        assert lost > 1e-3 * initial


@pytest.mark.parametrize("law", [law for law in LAWS if not law.pulls], ids=str)
def test_the_augmented_lagrangian_finds_the_same_drop(law):
    body, law = bristles(), scaled(law, 1e6)
    penalty, augmented = (
        drop(body, law, 1.0, 0.3, enforcement)
        for enforcement in (Enforcement.PENALTY, Enforcement.AUGMENTED)
    )
    speed = penalty.impact_speed_m_s
    close = pytest.approx(penalty.velocity_after_m_s, abs=1e-6 * speed)
    assert augmented.velocity_after_m_s == close
    assert augmented.energy.contact_loss_J == pytest.approx(
        penalty.energy.contact_loss_J, abs=1e-6 * penalty.energy.initial_J
    )
    assert augmented.energy.closure_relative < 1e-9


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_many_drops_are_as_each_alone(law, rng):
    """Vertical ones, seen as a column, and leaning ones, each with its own Kn and friction."""
    body, n, its = bristles(1.07e-5), 6, 5e-6
    kn = 10.0 ** rng.uniform(5.7, 6.3, n)
    tilt, mu = np.array([0.0, 1.0, 0.0, 3.0, -2.0, 0.0]), np.array([0.0, 0.3] * 3)
    height = rng.uniform(0.01, 0.04, n)
    drops = Drops.on_plane(9, height_m=height, kn_N_m=kn, tilt_deg=tilt, mu=mu)
    method = ContactMethod(scaled(law, 1e6), friction=Coulomb(0.5))
    together = drop_many(Marcher(body, method, TimeScheme.average(), its, G), drops)
    for i in range(n):
        method = ContactMethod(scaled(law, kn[i]), friction=Coulomb(mu[i]))
        plan = DropPlan(height[i], method, its, G, tilt_deg=tilt[i])
        one = simulate(ModalFrame(body), plan)
        assert together.n_contacts[i] == one.n_contacts
        assert together.n_steps[i] == one.n_steps
        for name in ("contact_time_s", "peak_force_N", "impulse_N_s", "cm_rebound_height_m"):
            assert getattr(together, name)[i] == pytest.approx(getattr(one, name), rel=1e-8)
        assert together.contact_loss_J[i] == pytest.approx(
            one.energy.contact_loss_J, abs=1e-9 * one.energy.initial_J
        )
    assert together.closure_relative.max() < 1e-9


def test_a_full_solid_yields_and_holds(make_solid):
    """The march of any body: the budget of a solid closes, its contact takes energy."""
    solid = make_solid((1, 1, 6), order=1)
    kept = {}
    for law in (Linear(1e6), Plastic(1e6, 3.0), Adhesive(1e6, 3.0)):
        marcher = Marcher(solid, ContactMethod(law), TimeScheme.average(), 2e-6, 0.0)
        v = -0.5 * solid.translation[:, 2]
        touch = march_contact(marcher, 0.0, np.zeros_like(v), np.ascontiguousarray(v), History())
        kept[type(law)] = touch.impulse_N_s
        assert (touch.contact_loss_J > 1e-6) == (not isinstance(law, Linear))
        energy = 0.5 * solid.dot(touch.v, solid.mass(touch.v))
        energy += 0.5 * solid.dot(touch.u, solid.stiffness(touch.u))
        before = 0.5 * solid.dot(v, solid.mass(np.ascontiguousarray(v)))
        lost = touch.contact_loss_J + touch.material_loss_J
        assert energy + lost == pytest.approx(before, rel=1e-9)
    assert kept[Plastic] < kept[Linear]
    assert kept[Adhesive] < kept[Linear]


def test_friction_has_nothing_to_hold_on_to_while_contact_pulls():
    """A held point drags nothing along, and its spring's energy is counted as lost."""
    law = Adhesive(KN, 0.6 * MOST)
    points, none = points_of(law), np.zeros((1, 3))
    memory = np.array([[2e-8, 0.0, 1.0]])
    before = spring_energy(points, memory)
    start, end = np.array([-0.1 * DEEP, 0.0, 0.0]), np.array([-0.2 * DEEP, 1e-6, 0.0])
    force = pushed(points, start, end, memory, none)[0]
    assert force[0] == pytest.approx(-0.15 * DEEP * KN, rel=1e-12)
    assert not force[1:].any()
    assert commit(points, step_of(start, end, force, memory)) == before > 0.0
    assert memory.tolist() == [[0.0, 0.0, 1.0]]


def test_softer_places_yield_at_the_same_traction():
    """Half as stiff a place bears the same most, and is indented less."""
    law = Plastic(KN, 0.4 * MOST)
    points = points_of(law, mu=0.0)._replace(scale=np.array([0.5]))
    start, end, memory = np.zeros(3), np.array([2.0 * DEEP, 0.0, 0.0]), np.zeros((1, 3))
    force = pushed(points, start, end, memory, np.zeros((1, 3)))[0]
    settle(points, step_of(start, end, force, memory))
    assert law.force(end[:1], 0.0, 0.5, memory[:, 2])[0] == pytest.approx(law.yield_N, rel=1e-12)
    assert memory[0, 2] == pytest.approx(2.0 * DEEP - 0.8 * DEEP, rel=1e-12)
