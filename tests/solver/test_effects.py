"""Each effect enters one place of a drop, the same in beam and solid, and as theory says."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

from bristle.solver import paper
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bodies.modal import from_arrays, to_arrays
from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.base import Place, Scene
from bristle.solver.effects.library import EFFECTS, enter_all
from bristle.solver.effects.surface import MOST_SLOPE_DEG, steepness_deg
from bristle.solver.errors import InputError
from bristle.solver.fall import dragged_fall, falling, risen
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.named import EffectInput
from bristle.studies.inputs.values import entered
from bristle.studies.running.cases import CaseSession

pytestmark = pytest.mark.serial
NAMES = (
    "air_drag",
    "release_velocity",
    "height_offset",
    "scale_error",
    "clock_error",
    "contact_damping",
    "hunt_crossley",
    "stiffening_contact",
    "plastic_contact",
    "adhesion",
    "material_damping",
    "hysteretic_damping",
    "lateral_inertia",
    "bristle_tilt",
    "surface_slope",
    "surface_phases",
    "wear",
    "session",
)


def drop(effect=None, **values):
    if effect is not None:
        values["effects"] = [effect]
    return DropInputs.model_validate({"cells": (1, 1, 40), "contact_points": 5, **values})


@pytest.fixture(scope="module")
def session():
    with CaseSession(MPI.COMM_SELF) as made:
        yield made


def test_the_library_has_the_contracts_names():
    assert sorted(EFFECTS) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is_and_knows_its_bounds(name):
    kind = EFFECTS[name]
    assert kind.name == name
    assert kind.title
    assert kind.source
    assert kind.kinds <= {"drops", "tracks", "forces", "waves", "falls"}
    assert [field.name for field in fields(kind)] == [each.name for each in kind.parameters]
    for parameter in kind.parameters:
        assert parameter.low <= parameter.typical <= parameter.high
        assert parameter.low <= parameter.null <= parameter.high
        with pytest.raises(InputError, match=parameter.name):
            kind(**{parameter.name: parameter.high + 1.0})


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_changes_one_thing_and_its_absence_nothing(name):
    kind, scene = EFFECTS[name], Scene(beta_s=paper.BETA_S, order=10, chance=(0.7, 0.0))
    after = kind().enter(scene)
    changed = [f.name for f in fields(Scene) if getattr(after, f.name) != getattr(scene, f.name)]
    assert len(changed) == 1
    absent = kind(*(each.null for each in kind.parameters)).enter(scene)
    if kind.place is not Place.CONTACT:
        assert absent == scene


def test_effects_enter_whatever_their_order():
    scene = Scene(order=50, chance=(1.0, -1.0))
    effects = [EFFECTS["contact_damping"](), EFFECTS["wear"](1.0), EFFECTS["surface_slope"](2.0)]
    assert enter_all(scene, effects) == enter_all(scene, effects[::-1])
    assert enter_all(scene, effects).law.kn_N_m == pytest.approx(2e6 * 10**0.5)


@pytest.mark.parametrize("std_deg", [0.5, 4.0, 8.0])
def test_no_slope_is_steeper_than_any_and_none_gather_there(std_deg):
    """As if steeper ones were drawn anew; held at the limit they would pass for a narrow peak."""
    rng = np.random.default_rng(5)
    drawn = std_deg * np.hypot(*rng.standard_normal((2, 400_000)))
    kept = np.sort(drawn[drawn <= MOST_SLOPE_DEG])
    shares = np.array([0.01, 0.1, 0.5, 0.9, 0.99])
    rayleigh = np.sqrt(-2.0 * np.log1p(-shares))
    # a quantile of so many drops, to five deviations
    own = [np.searchsorted(kept, steepness_deg(size, std_deg)) / kept.size for size in rayleigh]
    assert own == pytest.approx(shares, abs=5 * 0.5 / np.sqrt(kept.size))
    scene = EFFECTS["surface_slope"](std_deg).enter(Scene(chance=(-3.0, 4.0)))
    assert np.hypot(scene.slope_deg, scene.slope_wide_deg) == steepness_deg(5.0, std_deg)
    assert scene.slope_wide_deg == pytest.approx(-4.0 / 3.0 * scene.slope_deg)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "lateral_inertia"])
def test_beam_and_reduced_solid_have_the_same_effect(name, session):
    """Where the tip slides or leans, within what the two differ by without it."""
    close = 2e-3 if name not in ("bristle_tilt", "surface_slope") else 1e-2
    found = [session.run(drop(name, model=model))[0] for model in ("beam", "reduced")]
    assert found[0].rebound_ratio == pytest.approx(found[1].rebound_ratio, rel=close)
    assert found[0].peak_force_N == pytest.approx(found[1].peak_force_N, rel=5 * close)
    for result in found:
        assert result.energy.closure_relative < 1e-4


def test_a_law_is_the_same_in_the_solid(session):
    for name in ("contact_damping", "plastic_contact", "hunt_crossley"):
        solid = drop(name, model="solid", write_fields=False)
        full, reduced = (session.run(each)[0] for each in (solid, drop(name, model="reduced")))
        assert full.rebound_ratio == pytest.approx(reduced.rebound_ratio, rel=1e-5)


def dragged(k, start, until_s=1.0, *, g=paper.GRAVITY_M_S2, ends=None, **how):
    """Path and speed downward by m v' = m g - k m v |v|, to where ``ends`` of both crosses zero."""

    def motion(_, y):
        return [y[1], g - k * y[1] * abs(y[1])]

    def event(_, y):
        return ends(*y)

    event.terminal = True
    events = None if ends is None else event
    return solve_ivp(motion, (0.0, until_s), start, events=events, rtol=1e-12, atol=1e-14, **how)


@pytest.mark.parametrize("start", [-0.3, 0.0, 0.4])
@pytest.mark.parametrize("drag", [0.5, 1e-5])
def test_a_fall_with_drag_is_the_differential_equations(start, drag):
    time, speed = dragged_fall(0.05, paper.GRAVITY_M_S2, start, drag)
    done = dragged(drag, [0.0, start], time, dense_output=True)
    assert done.y[0, -1] == pytest.approx(0.05, abs=1e-9)
    assert done.y[1, -1] == pytest.approx(speed, abs=1e-9)
    for t in np.linspace(0.1, 0.9, 5) * time:
        path, speed = falling(float(t), paper.GRAVITY_M_S2, start, 0.0, drag)
        assert path == pytest.approx(done.sol(t)[0], abs=1e-8)
        assert speed == pytest.approx(done.sol(t)[1], abs=1e-8)


def test_a_rise_with_drag_ends_where_energy_says():
    k, g, speed = 0.7, paper.GRAVITY_M_S2, 1.2
    done = dragged(k, [0.0, -speed], ends=lambda _, v: v)
    assert -done.y[0, -1] == pytest.approx(risen(speed**2 / (2.0 * g), k), abs=1e-9)


FLAT = ({"width_m": 2.08e-3, "thickness_m": 0.5e-3}, 2.08e-3 * 0.5e-3)
ROUND = ({"diameter_m": 1.5e-3}, math.pi * 0.75e-3**2)


# the mesh of a solid's round section lacks a part of its mass
@pytest.mark.parametrize(
    ("model", "section"),
    [("analytic", FLAT), ("beam", FLAT), ("beam", ROUND), ("reduced", FLAT)],
    ids=["analytic", "beam", "round beam", "reduced"],
)
def test_air_drag_is_half_density_coefficient_end_section_and_speed_squared(
    model, section, session
):
    """m v' = m g - ½ ρ c_d A v² down, m v' = -m g - ½ ρ c_d A v² up, air of 1.204 kg/m³."""
    sizes, area = section
    inputs = drop("air_drag:cd=40", model=model, length_m=0.2, density_kg_m3=2700.0, **sizes)
    k, g = 0.5 * 1.204 * 40.0 * area / (2700.0 * area * 0.2), inputs.gravity_m_s2

    def end(start, ends):
        return dragged(k, start, g=g, ends=ends).y[:, -1]

    def turned(_, v):
        return v

    result, _ = session.run(inputs)
    speed = end([0.0, 0.0], lambda y, _: y - inputs.height_m)[1]
    assert speed < (1.0 - 5e-4) * math.sqrt(2.0 * g * inputs.height_m)
    assert result.impact_speed_m_s == pytest.approx(speed, rel=1e-9)
    # what rises is released a penetration away from where it touched
    after = result.cm_velocity_after_m_s
    assert after**2 / (2.0 * g) + end([0.0, -after], turned)[0] > 3e-6
    vacuum, _ = session.run(inputs.model_copy(update={"effects": ()}))
    if model != "analytic":
        mass, fallen = 2700.0 * area * 0.2, g * inputs.height_m - 0.5 * speed**2
        back = end([-1e-9, -after], lambda y, _: y)[1]
        flown = 0.5 * (after**2 - back**2)
        assert result.energy.drag_loss_J == pytest.approx(mass * (fallen + flown), rel=1e-3)
        assert vacuum.energy.drag_loss_J == 0.0
        assert result.energy.material_loss_J < vacuum.energy.material_loss_J
    released = vacuum.cm_rebound_height_m - vacuum.cm_velocity_after_m_s**2 / (2.0 * g)
    top = released - end([0.0, -after], turned)[0]
    assert result.cm_rebound_height_m == pytest.approx(top, abs=1e-7)


def test_drag_acts_in_every_flight(session):
    """Heights after the first and the second impact are those of m v' = -m g - k v |v|, and the
    budget of several impacts closes."""
    inputs = drop("air_drag:cd=100", model="beam", until=0.5)
    result, _ = session.run(inputs)
    bristle, g = inputs.bristle(), inputs.gravity_m_s2
    k = 0.5 * 1.204 * 100.0 * 2.08e-3 * 0.5e-3 / bristle.mass_kg
    t, _, height, force, _ = result.history.array().T
    landed = np.flatnonzero((force[1:] > 0.0) & (force[:-1] == 0.0)) + 1
    assert len(landed) >= 3
    apart = np.split(np.arange(len(t)), np.flatnonzero(force > 0.0))
    flights = [rows[2:-1] for rows in apart if t[rows[-1]] - t[rows[0]] > 0.05]
    assert len(flights) >= 3  # the fall, and two rebounds
    for rows in flights[1:]:
        x, s = height[rows], t[rows] - t[rows[0]]
        # its starting speed from its own first rows, which a cubic fits
        speed = np.polynomial.Polynomial.fit(s[:9], x[:9], 4).deriv()(0.0)
        run = dragged(k, [-x[0], -speed], s[-1], g=g, t_eval=s)
        assert x == pytest.approx(-run.y[0], abs=1e-7)
        in_vacuum = x[0] + speed * s - 0.5 * g * s * s
        assert np.abs(in_vacuum + run.y[0]).max() > 1e-6
    assert result.energy.closure_relative < 1e-6


def test_release_speed_counts_as_height(session):
    """v_i² = v_0² + 2 g y_0, up or down."""
    plain, _ = session.run(drop(model="beam", height_m=0.05 + 0.2**2 / (2 * paper.GRAVITY_M_S2)))
    for sign in (-1.0, 1.0):
        thrown, _ = session.run(drop(f"release_velocity:speed_m_s={0.2 * sign}", model="beam"))
        assert thrown.impact_speed_m_s == pytest.approx(plain.impact_speed_m_s, rel=1e-12)
        assert thrown.rebound_height_m == pytest.approx(plain.rebound_height_m, rel=1e-9)


def test_a_loss_factor_is_the_decay_of_every_mode():
    """Free ringing loses 2 π η of its energy a cycle to first order, whatever the frequency."""
    eta = 1e-3
    body = replace(beam_body(Bristle(), 8), beta_s=0.0, loss_factor=eta)
    elastic = body.omega2[body.omega2 > 0.0]
    damping = body.damping_1_s[body.omega2 > 0.0]
    cycle = 2.0 * math.pi / np.sqrt(elastic)
    assert 1.0 - np.exp(-damping * cycle) == pytest.approx(2.0 * math.pi * eta, rel=4e-3)
    assert not body.damping_1_s[body.omega2 == 0.0].any()


def test_loves_correction_lowers_axial_frequencies_as_he_says():
    """ω_n = n π c / L / √(1 + (ν n π r_p / L)²), r_p the polar radius of gyration."""
    bristle = Bristle()
    section, material = bristle.section, bristle.material
    polar = (section.second_moment_x_m4 + section.second_moment_y_m4) / section.area_m2
    bodies = [beam_body(bristle, 60, lateral_inertia=share) for share in (0.0, 1.0)]
    axial = []
    for body in bodies:
        moved = np.asarray(body.contact.rows @ body.contact.coordinates)[2::3]
        tip = np.abs(body.contact.weights @ moved)
        chosen = (tip > 1e-3 * tip.max()) & (body.omega2 > 0.0)
        axial.append(np.sqrt(body.omega2[chosen])[:6])
    n = np.arange(1, 7)
    expected = 1.0 / np.sqrt(1.0 + polar * (material.poisson * n * math.pi / bristle.length_m) ** 2)
    assert axial[1] / axial[0] - 1.0 == pytest.approx(expected - 1.0, rel=1e-3)


def test_entered_effects_stand_in_the_inputs_that_can_hold_them():
    now = entered(drop("bristle_tilt:tilt_deg=3"))
    assert now.inputs.tilt_deg == 3.0
    assert now.inputs.effects == ()
    assert entered(drop("material_damping:beta_s=1e-7")).inputs.beta_s == 1e-7
    assert isinstance(entered(drop()).scene.law, Linear)


def test_an_effect_survives_its_own_words():
    given = drop("wear:decades=0.5").effects
    assert given == (EffectInput(name="wear", parameters={"decades": 0.5}),)
    again = DropInputs.model_validate({"effects": [each.model_dump() for each in given]})
    assert again.effects == given


def test_instruments_see_heights_and_times_as_they_are_off(session):
    plain, _ = session.run(drop(model="beam"))
    high, _ = session.run(drop("height_offset:offset_m=0.002", model="beam"))
    assert high.rebound_height_m == pytest.approx(plain.rebound_height_m + 0.002)
    assert high.rebound_ratio == pytest.approx(high.rebound_height_m / 0.052)
    slow, _ = session.run(drop("clock_error:relative=0.1", model="beam"))
    assert slow.contact_time_s == pytest.approx(1.1 * plain.contact_time_s)
    large, _ = session.run(drop("scale_error:relative=0.1", model="beam"))
    assert large.rebound_ratio == pytest.approx(plain.rebound_ratio)
    assert large.rebound_height_m == pytest.approx(1.1 * plain.rebound_height_m)


def test_a_modal_body_comes_back_from_its_arrays_to_the_bit():
    body = beam_body(Bristle(), 4, points=3, second_order=True)
    again = from_arrays(to_arrays([body]))[0]
    assert to_arrays([again]).keys() == to_arrays([body]).keys()
    for name, value in to_arrays([body]).items():
        assert np.array_equal(to_arrays([again])[name], value)
    assert again.axis is not None


@pytest.mark.parametrize("kind", EFFECTS.values(), ids=EFFECTS)
def test_an_effect_without_numbers_is_of_its_typical_size(kind):
    assert kind().values() == tuple(each.typical for each in kind.parameters)
