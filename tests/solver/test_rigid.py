"""A body turns and flies freely as Euler's equations and its own modes say."""

import math

import numpy as np
import pytest
from leaning_helpers import next_touch_of
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.ground import Ground, local_frames
from bristle.solver.rigid import (
    STEP_RAD,
    Pose,
    fallen,
    free_rotation,
    leaning,
    matrix_of,
    product,
    slope_normal,
    turn,
)
from bristle.solver.time.flight import Flight
from bristle.solver.time.motion import rigid_rows, turning_bounds
from bristle.solver.time.search import look, start_clock

pytestmark = pytest.mark.serial
G = 9.8
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
TOP = np.array([1.0, 0.7, 0.2])
# kg m²; spins about each axis, among them nearly about the middle one, which flips over
SPINS = [(3.0, -20.0, 5.0), (1e-3, 15.0, 0.0), (0.1, 0.2, 40.0), (-12.0, 0.5, 0.5)]


def unit(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def as_scipy(q):
    return Rotation.from_quat(np.roll(q, -1))


def eulers_equations(q, w, inertia, alpha=0.0):
    """The attitude and spin as dense functions of time, by DOP853 far below the tolerances here."""

    def motion(_t, y):
        a, b = np.array(y[:4]), np.array(y[4:])
        spin = Rotation.from_quat(np.roll(a, -1)).as_matrix() @ b  # in the world
        da = 0.5 * np.array(
            [-a[1:] @ spin, *(a[0] * spin + np.cross(spin, a[1:]))]
        )  # world-fixed spin multiplies from the left
        return np.concatenate([da, -np.cross(b, inertia * b) / inertia - alpha * b])

    def at(times):
        times = np.atleast_1d(times)
        run = solve_ivp(
            motion, (0.0, times[-1]), [*q, *w], "DOP853", t_eval=times, rtol=3e-14, atol=1e-14
        )
        return run.y[:4].T, run.y[4:].T

    return at


def runge_kutta_error(angle):
    """What the fourth-order steps of STEP_RAD leave over ``angle``, were errors only to add up."""
    return angle / STEP_RAD * STEP_RAD**5 / 120.0


# --- attitudes ----------------------------------------------------------------------------------


def test_quaternions_are_rotations(rng):
    for _ in range(20):
        p, q, vector = unit(rng), unit(rng), rng.normal(size=3)
        assert matrix_of(q) == pytest.approx(as_scipy(q).as_matrix(), abs=1e-14)
        assert matrix_of(product(p, q)) == pytest.approx(matrix_of(p) @ matrix_of(q), abs=1e-14)
        wanted = Rotation.from_rotvec(vector).as_matrix()
        assert matrix_of(turn(vector)) == pytest.approx(wanted, abs=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-13, 1e-11, 1e-6])
def test_tiny_rotations_keep_their_size(size):
    vector = size * np.array([1.0, -2.0, 2.0]) / 3.0
    assert turn(vector)[1:] == pytest.approx(0.5 * vector, rel=1e-12)


def test_the_upper_end_leans_and_the_section_is_not_twisted():
    """Toward +x and +y for positive tilts, by the angles between the axis' shadows and z."""
    for a, b in ((5.0, 0.0), (-3.0, 0.0), (0.0, 4.0), (7.0, -2.0), (40.0, 30.0)):
        attitude = leaning(a, b)
        axis = matrix_of(attitude)[:, 2]
        assert math.degrees(math.atan(axis[0] / axis[2])) == pytest.approx(a, abs=1e-12)
        assert math.degrees(math.atan(axis[1] / axis[2])) == pytest.approx(b, abs=1e-12)
        assert attitude[3] == 0.0  # turned about a horizontal axis: the shortest way there
        assert axis == pytest.approx(slope_normal(a, b), abs=1e-15)
    assert (leaning(0.0) == UPRIGHT).all()
    # leaning toward its thin side it stands on the edge on that side
    edge = matrix_of(leaning(2.0)) @ np.array([0.25e-3, 0.0, 0.0])
    assert edge[2] == pytest.approx(-0.25e-3 * math.sin(math.radians(2.0)), rel=1e-12)


def test_an_upright_pose_turns_as_it_is_told():
    quarter = Pose.upright().moved(np.zeros(3), np.array([0.0, 0.0, 0.5 * math.pi]))
    assert quarter.rotation == pytest.approx(
        np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), abs=1e-15
    )


def test_rigid_rows_are_translations_and_rotations_about_the_middle(rng):
    places, motion = rng.normal(size=(5, 3)), rng.normal(size=6)
    wanted = motion[:3] + np.cross(motion[3:], places - places.mean(axis=0))
    assert rigid_rows(places) @ motion == pytest.approx(wanted.ravel(), rel=1e-12)


def test_a_small_motion_moves_a_pose_as_displacements_do(rng):
    """To the square of the angle, along body axes."""
    pose = Pose(rng.normal(size=3), unit(rng))
    place, shift, angle = rng.normal(size=(3, 3))
    errors = []
    for size in (1e-2, 1e-3):
        moved = pose.moved(size * shift, size * angle)
        new = moved.position_m + moved.rotation @ place
        displaced = place + size * (shift + np.cross(angle, place))
        errors.append(np.abs(new - pose.position_m - pose.rotation @ displaced).max())
    assert errors[0] < 1e-3
    assert math.log10(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_local_frames_are_right_handed_and_gaps_are_distances(rng):
    normals = np.array([slope_normal(*rng.uniform(-40, 40, 2)) for _ in range(5)])
    offsets, places = rng.normal(size=5), rng.normal(size=(5, 3))
    pose = Pose(rng.normal(size=3), leaning(20.0, -10.0))
    frames, gaps = local_frames(normals, offsets, pose.position_m, pose.rotation, places)
    for frame, normal in zip(frames, normals, strict=True):
        assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-14)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert pose.rotation @ frame[0] == pytest.approx(normal, abs=1e-14)
    world = pose.position_m + places @ pose.rotation.T
    assert gaps == pytest.approx(np.sum(normals * world, axis=1) - offsets, abs=1e-14)


# --- free rotation ------------------------------------------------------------------------------


@pytest.mark.parametrize(("spin", "alpha"), zip(SPINS, (0.0, 0.8, 0.8, 0.0), strict=True))
def test_free_rotation_solves_eulers_equations(spin, alpha, rng):
    """An asymmetric top over 50 rad; errors of the steps grow with the motion's own divergence."""
    attitude, spin = unit(rng), np.array(spin)
    duration = 50.0 / np.linalg.norm(spin)
    times = np.linspace(0.0, duration, 6)[1:]
    wanted, spins = eulers_equations(attitude, spin, TOP, alpha)(times)
    for t, q, w in zip(times, wanted, spins, strict=True):
        found, turned = free_rotation(attitude, spin, TOP, alpha, 0.0, t)
        angle = (as_scipy(found) * as_scipy(q).inv()).magnitude()
        assert angle < 20.0 * runge_kutta_error(50.0)
        assert np.abs(turned - w).max() < 20.0 * runge_kutta_error(50.0) * np.linalg.norm(spin)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_about_a_principal_axis_it_is_closed_form(axis):
    """1000 rad with no more than rounding: the planar case of a bristle that leans to one side."""
    spin, attitude = np.zeros(3), leaning(5.0, 3.0)
    spin[axis] = -25.0
    found, turned = free_rotation(attitude, spin, TOP, 0.0, 2.0, 42.0)
    wanted = as_scipy(attitude) * Rotation.from_rotvec(40.0 * spin)
    assert (as_scipy(found) * wanted.inv()).magnitude() < 1e-12
    assert (turned == spin).all()


@pytest.mark.parametrize("without", [0, 1, 2])
def test_without_spin_about_one_axis_it_still_tumbles(without):
    """And in no time nothing changes."""
    spin = np.insert([3.0, -5.0], without, 0.0)
    found, turned = free_rotation(UPRIGHT, spin, TOP, 0.0, 0.0, 4.0)
    wanted, spins = eulers_equations(UPRIGHT, spin, TOP, 0.0)(np.array([4.0]))
    close = 20.0 * runge_kutta_error(4.0 * np.linalg.norm(spin))
    assert (as_scipy(found) * as_scipy(wanted[0]).inv()).magnitude() < close
    assert np.abs(turned - spins[0]).max() < close * np.linalg.norm(spin)
    same, still = free_rotation(UPRIGHT, spin, TOP, 0.5, 4.0, 4.0)
    assert (same == UPRIGHT).all()
    assert (still == spin).all()


def test_damping_slows_the_clock():
    """About one axis: ω = ω₀ exp(-αt), the angle ω₀ (1 - exp(-αt))/α."""
    spin, alpha, t = np.array([0.0, 6.0, 0.0]), 0.7, 3.0
    found, turned = free_rotation(UPRIGHT, spin, TOP, alpha, 0.0, t)
    angle = 6.0 * -math.expm1(-alpha * t) / alpha
    assert turned[1] == pytest.approx(6.0 * math.exp(-alpha * t), rel=1e-14)
    assert found == pytest.approx([math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0], abs=1e-13)


@pytest.mark.parametrize("alpha", [0.0, 1e-6, 2.0])
def test_the_centre_falls_with_and_without_damping(alpha):
    position, velocity = np.array([0.1, -0.2, 0.3]), np.array([1.0, -0.5, 0.8])

    def motion(_t, y):
        return [*y[3:], *(-alpha * y[3:] - [0.0, 0.0, G])]

    run = solve_ivp(motion, (0.0, 0.4), [*position, *velocity], rtol=1e-12, atol=1e-14)
    at, speed = fallen(position, velocity, G, alpha, 0.4)
    # for small α the closed form loses (α t)⁻² digits of rounding, and 1e-6 asks for four back
    assert at == pytest.approx(run.y[:3, -1], abs=1e-8)
    assert speed == pytest.approx(run.y[3:, -1], abs=1e-8)


# --- flight of a ringing body -------------------------------------------------------------------


class Direct:
    """The world's places of the contact points in flight, written down once more.

    Each mode by the exponential of its own 2 × 2 system, the attitude by DOP853.
    """

    def __init__(self, body, pose, u, v, times):
        self.body = body
        shift = body.translation.T @ u / body.mass_kg
        angle = body.rotation.T @ u / body.inertia_kg_m2
        velocity = pose.rotation @ (body.translation.T @ v) / body.mass_kg
        spin = body.rotation.T @ v / body.inertia_kg_m2
        start = pose.moved(shift, angle)
        attitudes, _ = eulers_equations(start.attitude, spin, body.inertia_kg_m2, body.alpha_1_s)(
            times
        )
        turned = Rotation.from_quat(np.roll(attitudes, -1, axis=1)).as_matrix()
        self.centre = start.position_m + np.outer(times, velocity)
        self.centre[:, 2] -= 0.5 * G * times**2
        elastic = np.flatnonzero(body.omega2)
        self.u = np.zeros((len(times), len(u)))
        step = times[1] - times[0]
        assert np.allclose(np.diff(times), step)
        for i in elastic[(np.abs(u[elastic]) > 0.0) | (np.abs(v[elastic]) > 0.0)]:
            damping = body.alpha_1_s + body.beta_s * body.omega2[i]
            system = np.array([[0.0, 1.0], [-body.omega2[i], -damping]])
            # doubling: all times from powers of one step's propagator
            one = expm(system * step)
            y = np.empty((len(times), 2))
            y[0] = [u[i], v[i]]
            filled = 1
            while filled < len(times):
                more = min(filled, len(times) - filled)
                y[filled : filled + more] = y[:more] @ one.T
                filled, one = filled + more, one @ one
            self.u[:, i] = y[:, 0]
        points = body.contact
        moved = (self.u @ np.asarray(points.displacement).T).reshape(len(times), -1, 3)
        local = points.places_m + moved
        self.places = self.centre[:, None] + np.einsum("tij,tnj->tni", turned, local)
        self.tip = self.places[:, :, 2] @ points.weights


def clearance(places, ground):
    """Of every point from its plane, (times, n)."""
    return np.einsum("ni,tni->tn", ground.normals, places) - ground.offsets_m


@pytest.fixture(scope="module", params=[0.0, 1e-6], ids=["undamped", "damped"])
def body(request):
    return beam_body(Bristle(0.1, material=Material(beta_s=request.param)), 2, points=3)


def launched(body, seed, up=0.5, loud=2e-5):
    """A pose, displacement and velocity: tumbling, rising, ringing in its slower modes."""
    rng = np.random.default_rng(seed)
    v = body.translation @ np.array([0.1, -0.2, up]) + body.rotation @ rng.uniform(-20, 20, 3)
    u = body.rotation @ rng.uniform(-5e-3, 5e-3, 3) + body.translation @ rng.uniform(0, 1e-5, 3)
    slow = np.flatnonzero((body.omega2 > 0.0) & (body.omega2 < (2 * math.pi * 2e4) ** 2))
    amounts = loud * math.sqrt(body.mass_kg) * rng.normal(size=(2, len(slow)))
    u[slow], v[slow] = amounts[0], amounts[1] * np.sqrt(body.omega2[slow])
    return Pose(np.array([0.0, 0.0, 0.0502]), leaning(*rng.uniform(-10, 10, 2))), u, v


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_points_fly_where_modes_and_euler_put_them(body, seed):
    pose, u, v = launched(body, seed)
    times = np.linspace(0.0, 0.06, 61)
    direct = Direct(body, pose, u, v, times)
    flight = Flight(body, pose, 7.0, u, v, G)
    ground = Ground.plane(len(body.contact.weights), slope_normal(4.0, -7.0))
    for k in (0, 1, 20, 60):
        now, q, _ = flight.state(7.0 + times[k])
        places = body.contact.places_m + body.contact.displacements(q)
        found = now.position_m + places @ now.rotation.T
        assert found == pytest.approx(direct.places[k], abs=1e-10)
    traced = flight.trace(ground, 7.0 + times)
    assert traced[:, 0] == pytest.approx(direct.tip, abs=1e-10)
    assert traced[:, 1] == pytest.approx(direct.centre[:, 2], abs=1e-12)
    assert traced[:, 2] == pytest.approx(clearance(direct.places, ground).min(axis=1), abs=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_next_touch_is_the_first_that_dense_sampling_sees(body, seed):
    """Over inclined planes: nothing dips below before it by more than the 1e-8 m of the search."""
    rng = np.random.default_rng(100 + seed)
    pose, u, v = launched(body, seed, up=rng.uniform(-0.2, 0.6))
    ground = Ground.plane(len(body.contact.weights), slope_normal(*rng.uniform(-15, 15, 2)))
    times = np.linspace(0.0, 0.12, 120_001)
    direct = Direct(body, pose, u, v, times)
    lowest = clearance(direct.places, ground).min(axis=1)
    ground = Ground(ground.normals, ground.offsets_m + lowest[0] - 1e-4, ground.scale)
    lowest = lowest - lowest[0] + 1e-4
    flight = Flight(body, pose, 0.0, u, v, G)
    found = next_touch_of(flight, ground, times[-1])
    below = np.flatnonzero(lowest < 0.0)
    if not len(below):
        assert found is None
        return
    k = below[0]
    assert found is not None
    assert times[k - 1] - 1e-12 <= found <= times[k] + 1e-12
    # a parabola through samples is good to far less than what the search leaves out
    near = np.polynomial.Polynomial.fit(times[k - 3 : k + 3], lowest[k - 3 : k + 3], 5)
    exact = brentq(near, times[k - 1], times[k], xtol=1e-15)
    assert abs(found - exact) * abs(near.deriv()(exact)) < 1e-8


@pytest.mark.parametrize("amplitude", [1e-5, 2e-7])
def test_a_tip_that_rings_touches_before_its_rigid_motion_does(amplitude):
    """One axial mode over the plane, almost without gravity."""
    body = beam_body(Bristle(0.1, material=Material(beta_s=0.0)), 2, face=False)
    axial = np.argmax(np.abs(body.contact.coordinates[2]) * (body.omega2 > 1e8))
    u, v = np.zeros((2, len(body.omega2)))
    dip = max(1e-3, 2e-8 / amplitude)  # what the search may leave out is 1e-8 m
    u[axial] = amplitude / body.contact.coordinates[2, axial]
    omega = math.sqrt(body.omega2[axial])
    for share, wanted in ((1.0 - dip, math.acos(-(1.0 - dip)) / omega), (1.001, None)):
        pose = Pose(np.array([0.0, 0.0, 0.05 + share * amplitude]), UPRIGHT)
        found = next_touch_of(Flight(body, pose, 0.0, u, v, 1e-9), Ground.plane(1), 0.01)
        assert found == (wanted if wanted is None else pytest.approx(wanted, rel=1e-9))


@pytest.mark.parametrize("dip", [2e-8, 1e-7, 5e-7])
def test_a_graze_shorter_than_the_loudest_oscillation_shows_is_not_passed_over(dip):
    """A slow loud mode swings down to the plane, a fast one too quiet to set its pace dips below.

    The time below is a hundredth of the slow period and less; the fast motion has a thousandth of
    the slow one's size.
    """
    body = beam_body(Bristle(0.1, material=Material(beta_s=0.0)), 8, face=False)
    rows = body.contact.coordinates
    axial = np.flatnonzero((np.abs(rows[2]) > 0.1 * np.abs(rows[2]).max()) & (body.omega2 > 1e8))
    axial = axial[np.argsort(body.omega2[axial])]
    slow, fast = axial[0], axial[6]
    period = 2.0 * math.pi / math.sqrt(body.omega2[slow])
    loud, quiet = 2e-3, 1.9e-6
    u, v = np.zeros((2, len(body.omega2)))
    u[slow], u[fast] = loud / rows[2, slow], quiet / rows[2, fast]
    times = np.linspace(0.0, period, 2_000_001)
    height = loud * np.cos(math.sqrt(body.omega2[slow]) * times)
    height += quiet * np.cos(math.sqrt(body.omega2[fast]) * times)
    for offset, touches in ((dip, True), (-1e-7, False)):
        clear = height - height.min() - offset
        pose = Pose(np.array([0.0, 0.0, 0.05 - height.min() - offset]), UPRIGHT)
        found = next_touch_of(Flight(body, pose, 0.0, u, v, 1e-9), Ground.plane(1), period)
        below = np.flatnonzero(clear < 0.0)
        assert bool(len(below)) == touches
        if not touches:
            assert found is None
            continue
        assert times[below[-1]] - times[below[0]] < period / 16.0
        assert found == pytest.approx(times[below[0]], abs=2.0 * times[1])


def test_a_point_below_the_plane_on_its_way_out_does_not_touch_until_it_turns():
    body = beam_body(Bristle(0.1, material=Material(beta_s=0.0)), 2, face=False)
    plane, below = Ground.plane(1), Pose(np.array([0.0, 0.0, 0.05 - 1e-6]), UPRIGHT)

    def touched(speed, until):
        v = body.translation @ np.array([0.0, 0.0, speed])
        return next_touch_of(Flight(body, below, 0.0, np.zeros(len(v)), v, G), plane, until)

    landing = 0.1 / G + math.sqrt((0.1 / G) ** 2 - 2e-6 / G)
    assert touched(0.1, 0.03) == pytest.approx(landing, rel=1e-9)
    # the top of this one lies 5e-8 m high: it turns, at 1e-3 / G, before it is out
    assert 1e-3 / G <= touched(1e-3, 4e-4) < 2e-3 / G


@pytest.mark.parametrize(("seed", "loud"), [(0, 2e-5), (1, 2e-6), (2, 2e-5)])
def test_apex_is_the_highest_that_dense_sampling_sees(body, seed, loud):
    """To 2e-7 m, of a rebound of centimetres."""
    pose, u, v = launched(body, 50 + seed, loud=loud)
    times = np.linspace(0.0, 0.12, 120_001)
    direct = Direct(body, pose, u, v, times)
    for until in (0.01, 0.12):
        inside = times <= until + 1e-12
        t, height = Flight(body, pose, 0.0, u, v, G).apex(until)
        assert height == pytest.approx(direct.tip[inside].max(), abs=2e-7)
        at = np.interp(t, times, direct.tip)
        assert 0.0 <= t <= until * (1.0 + 1e-12)
        assert at == pytest.approx(height, abs=2e-7)


@pytest.mark.parametrize("seed", range(4))
def test_turning_stays_within_its_bounds(seed):
    """Of bodies of any principal moments, for as long as they tumble."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.1, 1.0, 3) ** 2
    inertia = np.array([b + c, a + c, a + b]) * (1.0, 1.0, 10.0 ** rng.uniform(-3.0, 0.0))
    spin = rng.normal(size=3) * (1.0, 1.0, 10.0 ** rng.uniform(-2.0, 2.0))
    tumbling, twirling, swerving, swinging = turning_bounds(inertia, spin)
    times = np.linspace(0.0, 60.0 / np.linalg.norm(spin), 3001)
    _, w = eulers_equations(UPRIGHT, spin, inertia)(times)
    rates = np.cross(inertia * w, w) / inertia
    axis = np.cross(w, np.cross(w, [0.0, 0.0, 1.0])) + np.cross(rates, [0.0, 0.0, 1.0])
    close = 1.0 + 1e-9
    assert np.hypot(*w[:, :2].T).max() <= tumbling * close
    assert np.abs(w[:, 2]).max() <= twirling * close
    assert np.linalg.norm(rates, axis=1).max() <= swerving * close
    assert np.linalg.norm(axis, axis=1).max() <= swinging * close


@pytest.mark.parametrize("seed", range(3))
def test_a_clearance_stays_above_what_a_look_promised(body, seed):
    """For as long as the look was to hold, whatever ringing it left out."""
    rng = np.random.default_rng(200 + seed)
    pose, u, v = launched(body, seed, loud=1e-4)
    ground = Ground.plane(len(body.contact.weights), slope_normal(*rng.uniform(-15, 15, 2)))
    planes = ground.normals, ground.offsets_m
    motion = Flight(body, pose, 0.0, u, v, G).motion
    tip, down = motion.flyer.tip, np.array([[0.0, 0.0, -1.0]])
    for seen, *over in ((motion.flyer.points, *planes), (tip, down, np.array([-0.1]))):
        for t in rng.uniform(0.0, 0.05, 5):
            horizon = 10.0 ** rng.uniform(-5.0, -2.0)
            for allowed in (0.0, 1e-5):
                now = look(motion, seen, *over, start_clock(motion), t, allowed, horizon)
                least = math.inf
                for after in horizon * np.linspace(0.0, 1.0, 200):
                    later = look(motion, seen, *over, start_clock(motion), t + after, 0.0, 0.0)
                    if after <= now.safe:
                        least = min(least, later.clear)
                    if seen is tip:  # one point, whose rate is the look's
                        most = now.slack - now.rate * after + 0.5 * now.bending * after**2
                        assert now.clear - later.clear <= most + 1e-12
                assert least >= -1e-12 or now.safe == 0.0


# --- from the march to flight and back ----------------------------------------------------------


def energy(body, pose, u, v):
    height = pose.position_m[2] + (pose.rotation @ (body.translation.T @ u))[2] / body.mass_kg
    strain = 0.5 * u @ (body.omega2 * u)
    return 0.5 * v @ v + strain + body.mass_kg * G * height


@pytest.mark.parametrize("seed", range(4))
def test_taking_off_keeps_energy_momentum_and_the_centre(body, seed):
    """The march's axes stand still: velocity along them is flight's, however it turned."""
    pose, u, v = launched(body, seed)
    u = u + body.rotation @ np.array([0.01, -0.02, 0.1])
    flight = Flight(body, pose, 3.0, u, v, G)
    after, q, qv = flight.state(3.0)
    assert energy(body, after, q, qv) == pytest.approx(energy(body, pose, u, v), rel=1e-13)
    momentum = [p.rotation @ (body.translation.T @ w) for p, w in ((pose, v), (after, qv))]
    assert momentum[1] == pytest.approx(momentum[0], abs=1e-14 * np.linalg.norm(momentum[0]))
    shift = pose.rotation @ (body.translation.T @ u) / body.mass_kg
    assert after.position_m == pytest.approx(pose.position_m + shift, abs=1e-16)
    assert body.rotation.T @ qv == pytest.approx(body.rotation.T @ v, rel=1e-12)
    # what is left is elastic, and it is the same
    assert np.abs(body.translation.T @ q).max() == 0.0
    assert np.abs(body.rotation.T @ q).max() == 0.0
    elastic = body.omega2 > 0.0
    assert q[elastic] == pytest.approx(u[elastic], abs=1e-12 * np.abs(u[elastic]).max())
    assert qv[elastic] == pytest.approx(v[elastic], abs=1e-10 * np.abs(v[elastic]).max())


@pytest.mark.parametrize("seed", range(4))
def test_landing_and_taking_off_again_at_once_changes_nothing(body, seed):
    pose, u, v = launched(body, seed)
    first = Flight(body, pose, 0.0, u, v, G)
    landed = first.state(0.03)
    again = Flight(body, landed[0], 0.03, landed[1], landed[2], G)
    for t in (0.03, 0.05):
        one, two = first.state(t), again.state(t)
        assert two[0].position_m == pytest.approx(one[0].position_m, abs=1e-14)
        # Runge-Kutta's steps fall elsewhere
        assert two[0].attitude == pytest.approx(one[0].attitude, abs=runge_kutta_error(2.0))
        assert two[1] == pytest.approx(one[1], abs=1e-10 * np.abs(one[1]).max())
        assert two[2] == pytest.approx(one[2], abs=1e-8 * np.abs(one[2]).max())
