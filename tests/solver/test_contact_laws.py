"""Stiffening, damped, plastic and adhesive contact, and a law from outside, against closed forms.

A mass of one mode, without gravity, comes to a plane with a known speed. What it does is compared
with formulas, or with an integration that shares no code with the program.
"""

import importlib
import itertools
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from contact_law_helpers import (
    ENFORCED,
    KN,
    LAWS,
    MASS,
    MOST,
    OMEGA,
    SPEED,
    bounce,
    closed_form,
    marcher_of,
    mass_on_a_foot,
)
from reference import rate
from scipy.optimize import brentq

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import (
    Adhesive,
    Damped,
    HuntCrossley,
    Linear,
    Plastic,
    Stiffening,
    Tabulated,
)
from bristle.solver.contact_phase import History
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.energy import marching_energy
from bristle.solver.errors import ComputationError
from bristle.solver.impact import march_contact
from bristle.solver.time.scheme import TimeScheme

pytestmark = pytest.mark.serial
ENFORCEMENTS = [Enforcement.PENALTY, Enforcement.AUGMENTED]
# A half wave of the spring on this many steps: the scheme is of second order in 1/STEPS, with a
# constant of order π²/12 for the period and π²/4 for what is sampled at the ends of steps.
STEPS = 400
CLOSE = 10.0 / STEPS**2
ITS = math.pi / OMEGA / STEPS


def after(law, its=ITS, **options):
    """The touch, the share of its speed with which the mass leaves, and what was seen."""
    touch, history = bounce(law, its, **options)
    return touch, float(touch.v[0]) / (math.sqrt(MASS) * SPEED), history


# --- closed forms -------------------------------------------------------------------------------


def hardening(share):
    """The law of docs/examples."""
    return importlib.import_module("my_plastic_law").Hardening(KN, 0.5 * MOST, share)


# Laws, and by how much they are harder to follow than a linear spring, in the square of the step:
# the frequency at the deepest point of a power law is up to √p of the mean one, a damped bounce
# turns over in less time than the spring's half wave, the deepest point of one that yields is met
# at the end of a step only, and the slower it lets go the longer a step's error is seen.
BOUNCES = {
    **{f"power {p}": (partial(Stiffening, KN, p, 1e-5), 4.0 * p) for p in (1.0, 1.5, 2.0, 3.0)},
    **{
        f"dashpot {zeta}": (partial(Damped, KN, 2.0 * zeta * MOST / SPEED), 1.0 / (1.0 - zeta**2))
        for zeta in (0.003, 0.01, 0.02, 0.2, 0.6)
    },
    **{
        f"damped by λ v {lost}": (partial(HuntCrossley, KN, lost / SPEED), 4.0 * (1.0 + lost) ** 2)
        for lost in (0.05, 0.3, 1.0, 3.0)
    },
    **{f"yield {s}": (partial(Plastic, KN, s * MOST), 2.0 / s**2) for s in (0.1, 0.5, 0.9)},
    **{
        f"yield {how}": (partial(Plastic, KN, 0.4 * MOST, *how), 12.5)
        for how in ((0.0, 3.0), (0.1, 1.0), (0.2, 4.0))
    },
    **{f"hardening {h}": (partial(hardening, h), 8.0) for h in (0.01, 0.1, 0.5)},
    **{
        f"adhesion {share}": (partial(Adhesive, KN, share * MOST), (1.0 - share**2) ** -0.5)
        for share in (0.0, 0.1, 0.5, 0.9)
    },
}
MARCHES = {"compiled": {}, "stepwise": {"observer": lambda *_: None}}
MARCHES["augmented"] = {"enforcement": Enforcement.AUGMENTED}


@pytest.mark.parametrize("march", MARCHES)
@pytest.mark.parametrize("name", BOUNCES)
def test_a_bounce_is_that_of_the_closed_form(name, march, monkeypatch):
    """Speed, time, force and depth; energy and momentum to rounding. The end of a touch falls
    anywhere within a step."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "docs" / "examples")
    make, harder = BOUNCES[name]
    law = make()
    if law.pulls and march == "augmented":
        pytest.skip("adhesion is for penalty alone")
    exact = closed_form(law)
    conserves = isinstance(law, Stiffening | Adhesive)
    half = exact.time_s if isinstance(law, Stiffening) else math.pi / OMEGA
    for steps in (100.0, 171.7, 400.0):
        touch, kept, history = after(law, half / steps, **MARCHES[march])
        close, rows = 10.0 * harder / steps**2, history.array()
        exactly = 1e-7 if march == "augmented" else 1e-10
        assert kept == pytest.approx(exact.kept, rel=exactly if conserves else close)
        assert touch.release_s == pytest.approx(exact.time_s, rel=close)
        lost = 0.5 * MASS * SPEED**2 * (1.0 - kept**2)
        assert touch.contact_loss_J == pytest.approx(lost, abs=exactly * MASS * SPEED**2)
        assert touch.impulse_N_s == pytest.approx(MASS * SPEED * (1.0 + kept), rel=exactly)
        if exact.left_m > SPEED * half / steps:  # rows of a history have no depth beyond the plane
            left = np.interp(touch.release_s, rows[:, 0], rows[:, 4])
            assert left == pytest.approx(exact.left_m, abs=close * SPEED / OMEGA)
        if law.pulls:
            pulled = -rows[:, 3].min()
            assert law.pull_off_N - KN * SPEED * half / steps <= pulled
            assert pulled <= law.pull_off_N * (1.0 + 1e-12)
        if not isinstance(law, Damped):
            assert touch.max_penetration_m == pytest.approx(exact.depth_m, rel=close)
            peak = exactly if isinstance(law, Plastic) and not law.hardening else close
            assert touch.peak_force_N == pytest.approx(exact.peak_N, rel=peak)


def test_a_bounce_of_hertzs_lasts_as_johnson_says():
    """Contact Mechanics, Eq. 11.24: 2.94 δ/v."""
    exact = closed_form(Stiffening(KN, 1.5))
    assert exact.time_s == pytest.approx(2.94 * exact.depth_m / SPEED, rel=2e-3)


@pytest.mark.parametrize("enforcement", ENFORCEMENTS)
def test_stiffening_with_exponent_one_is_linear(enforcement):
    rows = [
        bounce(law, 10.0 * ITS, enforcement=enforcement)[1].array()
        for law in (Stiffening(KN, 1.0), Linear(KN))
    ]
    size = np.abs(rows[1]).max(axis=0)
    # the multiplier is found to 1e-9 of the force by either law's own iteration
    close = 1e-12 if enforcement is Enforcement.PENALTY else 1e-7
    assert (np.abs(rows[0] - rows[1]) <= close * size).all()


def test_little_hunt_and_crossley_damping_takes_two_thirds_of_lambda_v():
    kept = [after(HuntCrossley(KN, share / SPEED))[1] for share in (1e-3, 2e-3)]
    slopes = [(1.0 - kept[0]) / 1e-3, (1.0 - kept[1]) / 2e-3]
    # linear in λ v, extrapolated to zero
    assert 2.0 * slopes[0] - slopes[1] == pytest.approx(2.0 / 3.0, abs=1e-5)


def test_a_table_of_a_straight_line_is_linear():
    """Within its end and beyond it; the bounce presses 26 µm."""
    linear = after(Linear(KN))[0]
    for reach in (4e-5, 1e-5):
        touch = after(Tabulated(KN, (0.0, 0.3 * reach, reach), (0.0, 0.3 * reach, reach)))[0]
        assert touch.peak_force_N == pytest.approx(linear.peak_force_N, rel=1e-12)
        assert touch.release_s == pytest.approx(linear.release_s, rel=1e-9)


def test_a_table_takes_arrays():
    depth, force = (0.0, 1e-5, 3e-5), (0.0, 4e-6, 5e-5)
    law = Tabulated(KN, np.array(depth), np.array(force))
    assert law == Tabulated(KN, depth, force)
    assert hash(law) == hash(Tabulated(KN, depth, force))


def test_a_table_of_a_film_over_the_ground():
    """Of F = Kn (δ - d (1 - exp(-δ/d))), whose work is ½ m v² at the greatest penetration."""
    film = 8e-6
    law = Tabulated.of(KN, lambda depth: depth + film * np.expm1(-depth / film), 1e-4)

    def work(depth):
        return KN * (0.5 * depth**2 - film * depth - film**2 * math.expm1(-depth / film))

    most = brentq(lambda depth: work(depth) - 0.5 * MASS * SPEED**2, 0.0, 1e-4, xtol=1e-16)
    touch, kept, _ = after(law)
    assert touch.max_penetration_m == pytest.approx(most, rel=4.0 * CLOSE)
    peak = KN * (most + film * math.expm1(-most / film))
    assert touch.peak_force_N == pytest.approx(peak, rel=4.0 * CLOSE)
    assert kept == pytest.approx(1.0, abs=1e-12)


def test_below_yield_plastic_contact_is_linear():
    most = 1.001 * SPEED * math.sqrt(KN * MASS)
    touch, kept, history = after(Plastic(KN, most))
    linear = bounce(Linear(KN), ITS)[1].array()
    assert history.array() == pytest.approx(linear, rel=1e-9, abs=1e-15)
    assert abs(touch.contact_loss_J) < 1e-13 * MASS * SPEED**2
    assert kept == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("stepwise", [False, True])
@pytest.mark.parametrize("damping", [0.1, 0.5])
def test_a_dashpot_is_in_the_force_that_is_shown(damping, stepwise):
    """At the first touch it bears c v alone; what is shown adds up to the impulse."""
    c = 2.0 * damping * math.sqrt(KN * MASS)
    observer = (lambda state, force: None) if stepwise else None
    touch, history = bounce(Damped(KN, c), ITS, observer=observer)
    rows = history.array()
    force = rows[:, 3]
    first = force[force > 0.0][0]
    assert first == pytest.approx(c * SPEED, rel=2.0 * OMEGA * ITS * (1.0 + 1.0 / damping))
    assert ITS * force.sum() == pytest.approx(touch.impulse_N_s, rel=1e-9)
    assert force.max() == touch.peak_force_N


def test_a_mass_that_never_lets_go_is_named():
    """Soon: nobody waits for two million steps of it."""
    with pytest.raises(ComputationError, match="still in contact after 20000 steps"):
        bounce(Adhesive(KN, 1.01 * SPEED * math.sqrt(KN * MASS)), ITS)


def test_stronger_adhesion_than_the_bounce_holds():
    """It swings about the plane as on a spring of both signs, and no energy goes."""
    most = 1.01 * SPEED * math.sqrt(KN * MASS)
    periods = 3.25
    touch, history = bounce(Adhesive(KN, most), ITS, until_s=periods * 2.0 * math.pi / OMEGA)
    assert touch.contact_loss_J == pytest.approx(0.0, abs=1e-12 * MASS * SPEED**2)
    assert touch.contact_J == pytest.approx(0.5 * MASS * SPEED**2, rel=1e-5)
    rows = history.array()
    force = SPEED * math.sqrt(KN * MASS) * np.sin(OMEGA * rows[:, 0])
    # the phase falls behind by (ω h)²/12 a radian
    behind = (OMEGA * ITS) ** 2 / 12.0 * OMEGA * rows[-1, 0]
    assert np.abs(rows[:, 3] - force).max() <= 1.1 * behind * np.abs(force).max()


# --- order, energy ------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_second_order_in_the_its(law):
    """Where the mass is long after: root mean square over phases of the first touch in a step."""
    period = math.pi / OMEGA
    steps = np.array([24, 48, 96, 192])
    late = 2.5 * period

    def place(its, gap_m):
        marcher = marcher_of(law, its, gap_m=gap_m)
        u, v = np.zeros(1), np.full(1, -math.sqrt(MASS) * SPEED)
        end = late + gap_m / SPEED
        touch = march_contact(marcher, 0.0, u, v, History(), until_s=np.inf, wait_s=end)
        return (touch.u[0] + touch.v[0] * (end - touch.end_s)) / math.sqrt(MASS) + gap_m

    # half a step of the coarsest march apart from one another, so no phase is special
    gaps = SPEED * period / steps[0] * (np.arange(12) + 0.37) / 12.0
    exact = place(period / 6000, 0.0)
    errors = [
        math.sqrt(np.mean([(place(period / n, gap) - exact) ** 2 for gap in gaps])) for n in steps
    ]
    assert rate(1.0 / steps, errors) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(("law", "enforcement"), ENFORCED, ids=str)
def test_energy_closes_step_by_step_and_no_step_gains(law, enforcement):
    marcher = marcher_of(law, math.pi / OMEGA / 50, enforcement=enforcement)
    energy = 0.5 * MASS * SPEED**2
    state = marcher.start(0.0, np.zeros(1), np.full(1, -math.sqrt(MASS) * SPEED))
    lost, pressed = 0.0, 0.0
    for _ in range(100):
        step = marcher.step(state)
        state = step.state
        # the multiplier is found to 1e-9 of the force
        assert step.contact_loss_J >= -(1e-15 if enforcement is Enforcement.PENALTY else 1e-8)
        lost += step.contact_loss_J
        now = marching_energy(marcher, state)
        pressed = max(pressed, now.contact_J)
        assert now.total_J + lost == pytest.approx(energy, rel=1e-10)
    assert pressed > 0.1 * energy
    assert state.v[0] > 0.0
    assert now.contact_J == 0.0


@pytest.mark.parametrize("observer", [None, lambda *_: None], ids=["compiled", "stepwise"])
def test_a_law_that_makes_energy_is_an_error(monkeypatch, observer):
    """The budget closes with it: what it gave counts as a loss below nothing."""
    law = HuntCrossley(KN, 0.4)
    assert bounce(law, 10.0 * ITS, observer=observer)[0].contact_loss_J > 0.0
    monkeypatch.setattr(HuntCrossley, "damping", property(lambda self: -1e-6 * self.damping_s_m))
    with pytest.raises(ComputationError, match="the contact law gave .* J in the touch"):
        bounce(law, 10.0 * ITS, observer=observer)


@pytest.mark.parametrize("seen", [None, lambda *_: None], ids=["compiled", "stepwise"])
def test_a_later_touch_of_the_impact_comes_down_into_its_indentation(seen):
    """A slow mass is turned by the spring at the depth that the first touch left; elsewhere nothing
    is remembered of it."""
    marcher = marcher_of(Plastic(KN, 0.3 * MOST), ITS)

    def touch(speed, memory):
        start = np.zeros(1), np.full(1, -math.sqrt(MASS) * speed)
        return march_contact(marcher, 0.0, *start, History(), seen, memory=memory)

    first = touch(SPEED, None)
    again = touch(0.1 * SPEED, first.memory)
    elsewhere = touch(0.1 * SPEED, None)
    (indented,) = first.memory
    # yields from 0.3 to √(1 - 0.3²) of the way that a spring would give, see the test of yield
    assert indented > 0.3 * SPEED / OMEGA
    assert again.max_penetration_m == pytest.approx(indented + 0.1 * SPEED / OMEGA, rel=CLOSE)
    assert elsewhere.max_penetration_m == pytest.approx(0.1 * SPEED / OMEGA, rel=CLOSE)
    assert again.memory == first.memory
    assert again.contact_loss_J == pytest.approx(0.0, abs=1e-12 * first.contact_loss_J)


def test_micro_touches_share_an_indentation_and_impacts_do_not(monkeypatch):
    """Of a bristle whose tip chatters."""
    from bristle.solver import drop

    seen = []

    def watched(*args):
        touch = march_contact(*args)
        seen.append((args[1], args[-1], touch))
        return touch

    monkeypatch.setattr(drop, "march_contact", watched)
    body = beam_body(Bristle(material=Material(beta_s=1e-8)), 8)
    method = ContactMethod(Plastic(1e7, 50.0))
    plan = DropPlan(0.05, method, 1e-6, 9.8, until_s=0.3, tilt_deg=10.0)
    result = simulate(ModalFrame(body), plan)
    assert result.n_contacts > 1
    impacts = [i for i, (_, memory, _) in enumerate(seen) if memory is None]
    assert len(impacts) > 1
    for (t, _, before), (later, memory, _) in itertools.pairwise(seen):
        if memory is None:
            assert later - t > 0.01
        else:
            assert np.array_equal(memory, before.memory)
            assert before.memory.any()
    assert result.energy.closure_relative < 1e-6


# --- points -------------------------------------------------------------------------------------


def test_a_face_of_points_is_one_point_where_all_are_alike():
    """A total force: many points of it yield and let go as the whole does."""
    for law in LAWS:
        one, many = (bounce(law, 10.0 * ITS, body=mass_on_a_foot(n))[0] for n in (1, 7))
        assert many.v == pytest.approx(one.v, rel=1e-9)
        assert many.peak_force_N == pytest.approx(one.peak_force_N, rel=1e-9)
        assert many.contact_loss_J == pytest.approx(one.contact_loss_J, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    ("build", "word"),
    [
        (lambda: Linear(0.0), "Kn"),
        (lambda: Linear(math.nan), "Kn"),
        (lambda: ContactMethod(Linear(math.inf)), "nitsche or augmented"),
        (lambda: ContactMethod(Linear(1.0), Enforcement.NITSCHE, theta=2), "theta"),
        (lambda: ContactMethod(Linear(1.0), Enforcement.NITSCHE, gamma0=0.5), "gamma0"),
        (lambda: Stiffening(math.inf, 1.5), "Kn"),
        (lambda: Stiffening(1e6, 0.9), "exponent"),
        (lambda: Stiffening(1e6, 3.1), "exponent"),
        (lambda: Stiffening(1e6, math.nan), "exponent"),
        (lambda: Stiffening(1e6, 2.0, 0.0), "reference"),
        (lambda: Tabulated(math.inf, (0.0, 1e-5), (0.0, 1.0)), "Kn"),
        (lambda: Tabulated(1e6, (1e-6, 1e-5), (0.0, 1.0)), "penetrations .* begin with zero"),
        (lambda: Tabulated(1e6, (0.0, 1e-5, 1e-5), (0.0, 1.0, 2.0)), "penetrations .* increase"),
        (lambda: Tabulated(1e6, (0.0, 1e-5), (0.0, math.nan)), "forces"),
        (lambda: Tabulated(1e6, (0.0,), (0.0,)), "penetrations"),
        (lambda: Tabulated(1e6, (0.0, 1e-5), (0.0, 1.0, 2.0)), "as many"),
        (lambda: HuntCrossley(math.inf, 0.1), "Kn"),
        (lambda: HuntCrossley(1e6, -0.1), "damping"),
        (lambda: Plastic(math.inf, 1.0), "Kn"),
        (lambda: Plastic(1e6, 0.0), "yield"),
        (lambda: Adhesive(math.inf, 1.0), "Kn"),
        (lambda: Adhesive(1e6, -1.0), "pull-off"),
        (lambda: Adhesive(1e6, math.inf), "pull-off"),
        (lambda: ContactMethod(HuntCrossley(1e6, 0.1), Enforcement.NITSCHE), "HuntCrossley.*nitsc"),
        (lambda: ContactMethod(Plastic(1e6, 1.0), Enforcement.NITSCHE), "Plastic.*nitsche"),
        (lambda: ContactMethod(Adhesive(1e6, 1.0), Enforcement.NITSCHE), "Adhesive.*nitsche"),
        (lambda: ContactMethod(Adhesive(1e6, 1.0), Enforcement.AUGMENTED), "Adhesive.*augmented"),
        (lambda: marcher_of(Plastic(1e6, 1.0), ITS, scheme=TimeScheme.newmark()), "conserving"),
        (lambda: marcher_of(HuntCrossley(1e6, 0.1), ITS, scheme=TimeScheme.newmark()), "conserv"),
    ],
)
def test_impossible_contact_is_refused(build, word):
    with pytest.raises(ValueError, match=word):
        build()
