"""A leaning beam bounces as exact modes say, on planes with and without friction."""

import math

import leaning_reference as lr
import numpy as np
import pytest
from leaning_helpers import HEIGHT, KT, SPEED, G, beam, drop, kept, plan, series, tip_velocity
from reference import rate

from bristle.meshes.section import Circle, Rectangle
from bristle.solver.contact.enforcement import Enforcement
from bristle.solver.drop import simulate
from bristle.solver.ground import Ground
from bristle.solver.rigid import leaning, matrix_of, slope_normal

pytestmark = pytest.mark.serial


def along(result):
    return np.concatenate([result.velocity_after_m_s, result.spin_after_rad_s])


# --- against the modal series -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kn", "beta", "face"),
    [
        (1e5, 1.07e-5, True),
        (2e6, 1e-8, False),
        (2e6, 1.07e-5, True),
        (1e8, 1e-8, True),
        (1e8, 1.07e-5, False),
    ],
)
def test_frictionless_lean_keeps_the_speed_of_the_modal_series(kn, beta, face):
    """Within 1 % of the speed of fall; the two share neither modes nor march.

    Where contact is no stiffer than the modes that the beam has, force and duration agree as well.
    With β = 1e-8 s and 100 MN/m upright a whole axial wave of steep front is shared by few modes:
    there elements bound the agreement.
    """
    frame = beam(beta, 64 if kn > 1e7 else 32, face=face)
    for lean in (0, 2, 5):
        ours = drop(frame, kn, tilt_deg=lean)
        other = series(lean, kn, beta, ours, face=face)
        steep = kn > 1e7 and beta < 1e-6
        assert kept(ours, frame) == pytest.approx(other.kept, abs=0.012 if steep else 2e-3)
        assert ours.n_contacts == len(other.touches)
        first = other.touches[-1, 1]
        assert ours.contact_time_s == pytest.approx(first, rel=1.5e-2 if steep else 2e-3)
        if kn < 1e7:
            assert ours.peak_force_N == pytest.approx(other.peak_force_N, rel=6e-3)


@pytest.mark.parametrize("mu", [0.05, 0.1, 0.3])
@pytest.mark.parametrize(("kn", "face"), [(1e5, False), (2e6, False), (2e6, True)])
def test_with_friction_it_keeps_the_speed_and_the_spin_of_the_series(kn, face, mu):
    """Sliding (0.05) and sticking; what friction takes too, in parts of the energy of fall."""
    frame = beam(1e-8, 32, face=face)
    for lean in (2, 5):
        ours = drop(frame, kn, mu=mu, tilt_deg=lean)
        other = series(lean, kn, 1e-8, ours, face=face, mu=mu, kt=KT * kn)
        assert kept(ours, frame) == pytest.approx(other.kept, abs=2e-3)
        assert ours.peak_force_N == pytest.approx(other.peak_force_N, rel=5e-3)
        fall = frame.modal.mass_kg * G * HEIGHT
        assert ours.energy.friction_loss_J / fall == pytest.approx(other.friction_loss, abs=2e-3)
        # a rigid bar that falls so turns by 6 sin(lean) v/L; sticking takes most of it away
        turning = 6.0 * math.sin(math.radians(lean)) * SPEED / 0.3365
        assert ours.spin_after_rad_s[1] == pytest.approx(other.spin_rad_s, abs=5e-3 * turning)


def test_toward_the_wide_side_it_is_a_bar_of_that_depth():
    frame = beam(1e-8, 32)
    bar = lr.Bar(thickness_m=2.08e-3, width_m=0.5e-3)
    for lean in (1, 2, 5):
        right, left = (drop(frame, tilt_wide_deg=sign * lean) for sign in (1, -1))
        other = series(lean, 2e6, 1e-8, right, face=True, bar=bar)
        assert kept(right, frame) == pytest.approx(other.kept, abs=1e-3)
        # it leans toward +y by turning about -x
        assert -right.spin_after_rad_s[0] == pytest.approx(other.spin_rad_s, rel=5e-3)
        assert along(left) == pytest.approx([-1, -1, 1, -1, -1, -1] * along(right), abs=1e-9)


@pytest.mark.parametrize("length", [0.4, 0.6])
@pytest.mark.parametrize("lean", [20, 30, 45])
def test_long_bars_touch_several_times_as_the_series_does(length, lean):
    """What is left between them is the bar's finite rotation: it falls with the speed of fall.

    Gravity falls with it, so that the series, linear, stays as it is.
    """
    frame = beam(1e-8, 32, face=False, length_m=length, section=Circle(0.0127))
    bar = lr.Bar(length, diameter_m=0.0127)
    errors = []
    for speed in (1.0, 0.1):
        gravity = G * speed
        height, fall = speed**2 / (2.0 * gravity), speed / gravity
        ours = drop(frame, 2e7, height=height, gravity=gravity, tilt_deg=lean, until_s=fall + 6e-3)
        other = series(lean, 2e7, 1e-8, ours, face=False, gravity=gravity, bar=bar, n_axial=40,
                       n_bending=80)  # fmt: skip
        assert ours.n_contacts == len(other.touches) > 1
        assert ours.contact_time_s == pytest.approx(other.last_release_s, rel=2e-3)
        assert ours.peak_force_N == pytest.approx(other.peak_force_N, rel=1e-3)
        back = tip_velocity(ours, frame, lean)[2] / speed
        errors.append([kept(ours, frame) - other.kept, back - other.restitution])
    # the spin is below 6 v/L, so in 4 ms the bar turns by 1/25 at most at 1 m/s, L = 0.6 m
    errors = np.abs(errors)
    assert errors[0].max() < 0.02
    assert errors[1].max() < 3e-3


def test_restitution_of_long_bars_depends_on_the_lean_as_the_series_says():
    """Hardly for 0.1 m, strongly for 0.4 m; in between it falls with length at a given lean."""
    spread = {}
    for length in (0.1, 0.2, 0.4):
        frame = beam(1e-8, 16, face=False, length_m=length, section=Circle(0.0127))
        bar, back = lr.Bar(length, diameter_m=0.0127), []
        for lean in (0, 10, 20, 30):
            ours = drop(frame, 2e7, height=0.5 / G, tilt_deg=lean, until_s=1.0 / G + 6e-3)
            other = series(lean, 2e7, 1e-8, ours, face=False, bar=bar, n_axial=40, n_bending=80)
            back.append(tip_velocity(ours, frame, lean)[2])
            assert back[-1] == pytest.approx(other.restitution, abs=0.01)
        spread[length] = np.ptp(back)
    assert spread[0.1] < 0.1 < spread[0.2]
    assert spread[0.4] > 0.4


# --- the rigid limit ----------------------------------------------------------------------------


@pytest.mark.parametrize(("mu", "sticks"), [(0.0, False), (0.1, False), (1.0, True)])
@pytest.mark.parametrize("lean", [10, 30, 60])
def test_short_thick_and_soft_it_is_the_rigid_bar(lean, mu, sticks):
    """Speeds of the centre, of the tip, and the spin; the hold stiff against the contact."""
    section, length = Rectangle(4e-3, 4e-3), 0.02
    frame = beam(0.0, 4, face=False, length_m=length, section=section)
    speed, gravity = 0.01, 1e-5
    fall = speed / gravity
    ours = drop(frame, 1e3, height=speed**2 / (2.0 * gravity), gravity=gravity, mu=mu, kt=1e3,
                tilt_deg=lean, until_s=fall + 0.01)  # fmt: skip
    rigid = lr.rigid_bar(
        lean,
        length,
        mass_kg=frame.modal.mass_kg,
        inertia_kg_m2=frame.modal.inertia_kg_m2[1],
        mu=mu,
    )
    assert rigid.sticks == sticks
    # the time of contact, some 5 ms, lets it turn by 1e-2 at this speed
    close = 2e-3
    assert ours.velocity_after_m_s[2] / speed == pytest.approx(rigid.centre_normal_m_s, abs=close)
    across = ours.velocity_after_m_s[0] / speed
    assert across == pytest.approx(rigid.centre_tangential_m_s, abs=close)
    tip = tip_velocity(ours, frame, lean)[2] / speed
    assert tip == pytest.approx(rigid.tip_normal_m_s, abs=2.0 * close)
    spin = ours.spin_after_rad_s[1] / speed
    assert spin == pytest.approx(rigid.spin_rad_s, abs=close * 6.0 / length)


# --- symmetries ---------------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_both_sides_mirrored(mu):
    """A corner strikes first and the bristle spins about its axis, one way or the other."""
    frame = beam(1e-8, 8)
    one = drop(frame, mu=mu, tilt_deg=3, tilt_wide_deg=2)
    assert abs(one.spin_after_rad_s[2]) > 1.0
    for a, b in ((1, -1), (-1, 1), (-1, -1)):
        other = drop(frame, mu=mu, tilt_deg=3 * a, tilt_wide_deg=2 * b)
        signs = np.array([a, b, 1, b, a, a * b])
        assert along(other) * signs == pytest.approx(along(one), rel=1e-9, abs=1e-9)
        assert other.impulse_N_s == pytest.approx(one.impulse_N_s, rel=1e-10)


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_round_wire_leans_alike_to_all_sides(mu):
    """Directions a fraction of its ring of contact points apart."""
    frame = beam(1e-8, 8, points=5, section=Circle(1e-3))
    tangent = math.tan(math.radians(4.0))
    results = []
    for turn in (0.0, 2.0 * math.pi / 10, 4.0 * math.pi / 10):
        tilts = [math.degrees(math.atan(tangent * f(turn))) for f in (math.cos, math.sin)]
        result = drop(frame, mu=mu, tilt_deg=tilts[0], tilt_wide_deg=tilts[1])
        c, s = math.cos(turn), math.sin(turn)
        back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        results.append(np.concatenate([back @ along(result)[:3], back @ along(result)[3:]]))
    assert len(frame.modal.contact.weights) == 21
    for other in results[1:]:
        assert other == pytest.approx(results[0], rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("lean", [(2.0, 0.0), (5.0, 0.0), (3.0, -2.0)])
def test_upright_on_a_frictionless_slope_it_is_a_lean_of_that_angle(lean):
    """Only what is normal to the plane counts, of velocity and of gravity."""
    frame = beam(1e-8, 8)
    normal = slope_normal(-lean[0], -lean[1])
    ground = Ground.plane(len(frame.modal.contact.weights), normal)
    sloped = drop(frame, ground=ground)
    cos = normal[2]
    level = drop(frame, height=HEIGHT * cos, gravity=G * cos, tilt_deg=lean[0],
                 tilt_wide_deg=lean[1])  # fmt: skip
    assert level.impact_speed_m_s == pytest.approx(cos * sloped.impact_speed_m_s, rel=1e-12)
    assert sloped.impulse_N_s == pytest.approx(level.impulse_N_s, rel=1e-9)
    assert sloped.contact_time_s == pytest.approx(level.contact_time_s, rel=1e-9)
    assert sloped.spin_after_rad_s == pytest.approx(level.spin_after_rad_s, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_along_the_normal_of_a_slope_a_bristle_that_leans_with_it_stands_upright(mu):
    """Its face meets the slope evenly: nothing turns it but the slip of its tip."""
    frame = beam(1e-8, 8)
    ground = Ground.plane(len(frame.modal.contact.weights), slope_normal(5.0))
    result = drop(frame, mu=mu, tilt_deg=5.0, ground=ground)
    upright = drop(frame)
    cos = math.cos(math.radians(5.0))
    assert result.impulse_N_s == pytest.approx(cos * upright.impulse_N_s, rel=1e-3)
    if mu == 0.0:
        assert np.abs(result.spin_after_rad_s).max() < 1e-9
        # thrown down the slope: what it had along it, it keeps
        slide = np.array([cos, 0.0, -math.sin(math.radians(5.0))])
        before = np.array([0.0, 0.0, -result.impact_speed_m_s - G * result.contact_time_s])
        assert slide @ result.velocity_after_m_s == pytest.approx(slide @ before, rel=1e-3)


# --- momentum and energy ------------------------------------------------------------------------


@pytest.mark.parametrize("mu", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("lean", [(2.0, 0.0), (5.0, 0.0), (3.0, 2.0)])
def test_momentum_along_the_world_axes(lean, mu):
    """m Δv is push and weight; a level plane without friction pushes straight up."""
    frame = beam(1e-8, 8)
    seen = []
    the_plan = plan(mu=mu, tilt_deg=lean[0], tilt_wide_deg=lean[1])
    result = simulate(frame, the_plan, observer=lambda state, force: seen.append((state, force)))
    mass, rotation = frame.modal.mass_kg, matrix_of(leaning(*lean))
    points = frame.modal.contact
    # frames of a level plane: the first tangent nearest to body x
    normal = rotation.T @ [0.0, 0.0, 1.0]
    first = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    first /= np.linalg.norm(first)
    axes = np.stack([normal, first, np.cross(normal, first)])
    push = sum(points.weights @ force for _, force in seen) * the_plan.its_s @ axes
    gravity = np.array([0.0, 0.0, -G * (seen[-1][0].t_s - seen[0][0].t_s)])
    before = np.array([0.0, 0.0, -result.impact_speed_m_s])
    gained = mass * (np.array(result.velocity_after_m_s) - before - gravity)
    # after the release gravity has acted for less than a step
    late = mass * G * the_plan.its_s
    assert gained == pytest.approx(rotation @ push, abs=late + 1e-12)
    assert gained[:2] == pytest.approx((rotation @ push)[:2], abs=1e-12)
    assert result.impulse_N_s == pytest.approx((rotation @ push)[2], rel=1e-12)
    if mu == 0.0:
        assert np.abs(gained[:2]).max() < 1e-14
    else:
        size = np.hypot(*gained[:2])
        assert result.friction_impulse_N_s == pytest.approx(size, rel=1e-6)
        assert size <= mu * result.impulse_N_s * (1.0 + 1e-9)


@pytest.mark.parametrize("beta", [0.0, 1e-8, 1.07e-5])
@pytest.mark.parametrize("mu", [0.0, 0.05, 0.4])
def test_energy_closes_over_several_impacts(beta, mu):
    """With what friction took in it, tumbling and ringing in between.

    Turning about one axis is exact. About several, Runge-Kutta's steps leave STEP_RAD⁵/144 of the
    rotation's energy a radian, and a bristle struck at a corner turns by some ten.
    """
    frame = beam(beta, 8)
    for lean in ((0.0, 0.0), (2.0, 0.0), (5.0, 0.0), (2.0, 3.0)):
        result = drop(frame, its=2e-6, height=0.01, mu=mu, tilt_deg=lean[0],
                      tilt_wide_deg=lean[1], until_s=0.15)  # fmt: skip
        budget = result.energy
        assert budget.closure_relative < (1e-9 if lean[1] else 1e-10)
        assert budget.friction_loss_J >= 0.0
        if mu == 0.0:
            assert budget.friction_loss_J == 0.0
        elif lean[0]:
            assert budget.friction_loss_J > 1e-6 * budget.initial_J
        assert (budget.material_loss_J == 0.0) == (beta == 0.0)
        rows = result.history.array()
        touching = rows[rows[:, 3] > 0.0, 0]
        assert touching[-1] > touching[0] + 0.01  # there was another impact
        assert (np.diff(rows[:, 0]) >= 0.0).all()


@pytest.mark.parametrize("beta", [0.0, 1.07e-5])
@pytest.mark.parametrize("lean", [0.0, 5.0])
def test_energy_closes_where_the_drop_ends_inside_a_touch(beta, lean):
    fall = math.sqrt(2.0 * HEIGHT / G)
    result = drop(beam(beta, 8), its=2e-6, mu=0.3, tilt_deg=lean, until_s=fall + 5.03e-5)
    assert result.energy.closure_relative < 1e-10
    assert result.energy.contact_J > 0.01 * result.energy.initial_J


def test_damping_by_mass_closes_too():
    frame = beam(1e-8, 8, alpha=3.0)
    result = drop(frame, its=2e-6, mu=0.3, tilt_deg=4.0, tilt_wide_deg=1.0, until_s=0.25)
    assert result.energy.closure_relative < 1e-10


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_tip_and_centre_rise_over_where_they_were_at_first_touch(mu):
    """The centre as high as its speed takes it; the tip's middle starts half a side above the edge.

    Rows of the history say the same as the results.
    """
    frame = beam(1e-8, 12)
    result = drop(frame, mu=mu, tilt_deg=2.0, until_s=0.25)
    rows = result.history.array()
    release = math.sqrt(2.0 * HEIGHT / G) + result.contact_time_s
    touch = rows[np.argmax(rows[:, 3] > 0.0), 0]
    assert rows[np.searchsorted(rows[:, 0], touch) - 1, 1:3] == pytest.approx([0.0, 0.0], abs=2e-6)
    up = result.velocity_after_m_s[2]
    at_release = np.interp(release, rows[:, 0], rows[:, 2])
    wanted = at_release + up**2 / (2.0 * G)
    assert result.cm_rebound_height_m == pytest.approx(wanted, abs=2e-6)
    assert result.rebound_ratio == pytest.approx(result.rebound_height_m / HEIGHT, rel=1e-14)
    later = rows[:, 0] > release
    again = rows[later & (rows[:, 3] > 0.0), 0].min(initial=math.inf)
    flying = later & (rows[:, 0] < again)
    for column, top in ((1, result.rebound_height_m), (2, result.cm_rebound_height_m)):
        seen = rows[flying, column].max()
        # 200 rows of a flight; the tip rings between them
        assert top >= seen - 1e-12
        assert top == pytest.approx(seen, abs=2e-3 * HEIGHT if column == 1 else 2e-5 * HEIGHT)


def test_results_are_continuous_in_the_lean():
    """Upright in the limit."""
    frame = beam(1e-8, 8)
    upright, hardly = drop(frame), drop(frame, tilt_deg=1e-4)
    assert along(hardly) == pytest.approx(along(upright), abs=1e-3)
    assert hardly.impulse_N_s == pytest.approx(upright.impulse_N_s, rel=1e-6)


# --- one march and another ----------------------------------------------------------------------

NUMBERS = (
    "impulse_N_s", "peak_force_N", "max_penetration_m", "contact_time_s", "cm_velocity_after_m_s",
    "time_to_max_penetration_s", "n_steps", "n_contacts",
)  # fmt: skip


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
@pytest.mark.parametrize("seed", range(4))
def test_the_compiled_march_is_the_general_one(enforcement, seed):
    """To what their solvers leave: an observer makes the general one march."""
    rng = np.random.default_rng(seed)
    beta = [0.0, 1e-8, 1.07e-5][seed % 3]
    frame = beam(beta, 6, points=5, alpha=5.0 * (seed % 2))
    the_plan = plan(
        10 ** rng.uniform(5, 7.5),
        mu=[0.05, 0.5, 0.2, 0.0][seed],
        method={"enforcement": enforcement},
        tilt_deg=rng.uniform(-6, 6),
        tilt_wide_deg=rng.uniform(-4, 4),
    )
    compiled = simulate(frame, the_plan)
    general = simulate(frame, the_plan, observer=lambda state, force: None)
    for name in NUMBERS:
        wanted = getattr(general, name)
        assert getattr(compiled, name) == pytest.approx(wanted, rel=1e-9), name
    size = np.abs(along(general)).max()
    assert along(compiled) == pytest.approx(along(general), abs=1e-9 * size)
    mine, other = compiled.energy, general.energy
    for name in ("friction_loss_J", "material_loss_J"):
        assert getattr(mine, name) == pytest.approx(getattr(other, name), abs=1e-9 * mine.initial_J)
    a, b = compiled.history.array(), general.history.array()
    assert a.shape == b.shape
    assert np.abs(a - b).max(axis=0) == pytest.approx(
        np.zeros(5), abs=1e-8 * max(1.0, general.peak_force_N)
    )


@pytest.mark.parametrize(("kn", "mu"), [(2e5, 0.05), (2e6, 0.0), (2e6, 0.3)])
def test_nitsche_agrees_with_penalty_at_the_same_stiffness(kn, mu):
    """Within 2e-3 of the speed of fall; what is left for θ = ±1 falls with 1/γ₀, as it must: they
    take the tip's own stress for the contact pressure, with weight τ ~ 1/γ₀."""
    frame = beam(1e-8, 16, points=5)
    for lean in (2.0, 5.0):
        plain = drop(frame, kn, mu=mu, tilt_deg=lean)

        def off(plain=plain, lean=lean, **method):
            method["enforcement"] = Enforcement.NITSCHE
            other = drop(frame, kn, mu=mu, tilt_deg=lean, method=method)
            assert other.peak_force_N == pytest.approx(plain.peak_force_N, rel=2e-3)
            change = other.impulse_N_s - plain.impulse_N_s
            return change / (frame.modal.mass_kg * plain.impact_speed_m_s)

        assert abs(off(theta=0)) < 1e-4
        for theta in (1, -1):
            coarse = off(theta=theta)
            assert abs(coarse) < 2e-3
            if abs(coarse) > 2e-4:
                assert off(theta=theta, gamma0=100.0) == pytest.approx(0.1 * coarse, rel=0.4)


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
@pytest.mark.parametrize("lean", [(5.0, 0.0), (3.0, 2.0)])
def test_second_order_in_the_time_step(lean, enforcement):
    frame = beam(1.07e-5, 8, points=5)
    steps = [1.6e-6, 8e-7, 4e-7]

    def results(its):
        return drop(frame, 2e6, its, tilt_deg=lean[0], tilt_wide_deg=lean[1],
                    method={"enforcement": enforcement})  # fmt: skip

    fine = results(4e-8)  # whose own error is a hundredth of the smallest
    coarse = [results(its) for its in steps]
    for name in ("impulse_N_s", "max_penetration_m"):
        errors = [abs(getattr(result, name) - getattr(fine, name)) for result in coarse]
        assert rate(steps, errors) == pytest.approx(2.0, abs=0.15), name


def test_with_friction_steps_still_converge():
    """A point on the axis, sticking and slipping: between first and second order."""
    frame = beam(1.07e-5, 8, face=False)
    steps = [8e-7, 4e-7, 2e-7, 1e-7]
    for mu in (0.1, 0.5):
        fine = drop(frame, its=2e-8, mu=mu, tilt_deg=3, tilt_wide_deg=2)
        errors = [
            abs(drop(frame, its=h, mu=mu, tilt_deg=3, tilt_wide_deg=2).impulse_N_s
                - fine.impulse_N_s)
            for h in steps
        ]  # fmt: skip
        assert rate(steps, errors) > 1.5
        assert errors[0] < 1e-4 * fine.impulse_N_s
