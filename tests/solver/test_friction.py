"""Coulomb friction sticks, slips and brakes as blocks, oscillators and pressed faces do.

The bodies are made by hand: a few modes of unit mass and points that move with them.
"""

import itertools
import math

import leaning_reference as lr
import numpy as np
import pytest
from contact_law_helpers import pushed
from hypothesis import example, given, settings
from hypothesis import strategies as st
from reference import rate

from bristle.meshes.section import Rectangle
from bristle.solver.bodies.base import ContactPoints
from bristle.solver.bodies.modal import ModalBody
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.contact.normal import SHORT
from bristle.solver.contact.points import CONSERVING, Points, Trial
from bristle.solver.contact.step import commit, spring_energy
from bristle.solver.contact_phase import History
from bristle.solver.energy import marching_energy
from bristle.solver.ground import Ground, place
from bristle.solver.impact import march_contact
from bristle.solver.rigid import Pose, leaning, slope_normal
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

pytestmark = pytest.mark.serial
G = 9.8
MASS, MU, KN = 2.0, 0.5, 1e6
WEIGHT = MASS * G


def block(*, spring_N_m=0.0, alpha=0.0, inertia=1.0, sides=(0.1, 0.3), points=3):
    """A block of six rigid modes that touches with its lower face, the centre of mass in it.

    ``spring_N_m`` holds it along x.
    """
    xy, weights = Rectangle(*sides).contact_points(points)
    omega2 = np.zeros(6)
    omega2[0] = spring_N_m / MASS
    sizes = np.sqrt([MASS] * 3 + [inertia] * 3)
    shapes = np.zeros((len(xy), 3, 6))
    shapes[:, [0, 1, 2], [0, 1, 2]] = 1.0
    # θ × (x, y, 0)
    shapes[:, 2, 3], shapes[:, 2, 4] = xy[:, 1], -xy[:, 0]
    shapes[:, 0, 5], shapes[:, 1, 5] = -xy[:, 1], xy[:, 0]
    return ModalBody(
        name="block",
        omega2=omega2,
        translation=np.diag(sizes)[:, :3],
        rotation=np.diag(sizes)[:, 3:],
        contact=ContactPoints(
            coordinates=np.diag(1.0 / sizes),
            support=np.tile(np.arange(6), (len(xy), 1)),
            shapes=shapes,
            traction=np.zeros((3 * len(xy), 6)),
            weights=weights,
            places_m=np.column_stack([xy, np.zeros(len(xy))]),
        ),
        alpha_1_s=alpha,
        beta_s=0.0,
    )


def marching(body, its, mu=MU, kt_over_kn=1.0, slope=(0.0, 0.0), scheme=None, enforcement=None):
    """A marcher of the block flat on a slope, and the state in which it presses at rest."""
    method = ContactMethod(
        Linear(KN), enforcement or Enforcement.PENALTY, friction=Coulomb(mu, kt_over_kn)
    )
    marcher = Marcher(body, method, scheme or TimeScheme.average(), its, G)
    plane = Ground.plane(len(body.contact.weights), slope_normal(*slope))
    marcher.place(place(plane, Pose(np.zeros(3), leaning(*slope)), body.contact))
    pressed = -WEIGHT * marcher.ground.up[2] / KN
    return marcher, body.translation @ np.array([0.0, 0.0, pressed])


def run(marcher, u, v, steps, look=1):
    """Displacement and velocity of the centre (k, 3) every ``look`` steps, and friction's loss."""
    body = marcher.body
    state, lost, out = marcher.start(0.0, u, v), 0.0, []
    for k in range(steps + 1):
        if k % look == 0:
            out.append([body.translation.T @ x / MASS for x in (state.u, state.v)])
        step = marcher.step(state)
        state = step.state
        lost += step.friction_loss_J
    out = np.array(out)
    return out[:, 0], out[:, 1], lost


# --- sliding blocks -----------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.5, 2.5])
@pytest.mark.parametrize(
    "scheme",
    [TimeScheme.average(), TimeScheme.newmark(), TimeScheme.generalised(0.8)],
    ids=lambda s: s.name,
)
def test_a_block_sent_over_a_plane_moves_as_one_held_by_the_spring_does(angle, scheme):
    """Stick, slip, brake, swing: the closed form all the way, in whatever direction it is sent."""
    speed, kt = 0.4, 1e-2 * KN
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    period = 2.0 * math.pi * math.sqrt(MASS / kt)
    its, steps = period / 400, 800
    marcher, u = marching(block(), its, kt_over_kn=1e-2, scheme=scheme)
    x, v, _ = run(marcher, u, marcher.body.translation @ (speed * direction), steps)
    times = its * np.arange(steps + 1)
    wanted, speeds = lr.stick_slip_block(times, speed, MASS, WEIGHT, MU, kt)
    # the phase of a swing falls behind by (ωh)²/12 a radian, and here it is at most 4π of them
    close = (2.0 * math.pi / 400) ** 2 / 12.0 * 4.0 * math.pi
    reach = np.abs(wanted).max()
    assert x @ direction == pytest.approx(wanted, abs=close * reach)
    assert v @ direction == pytest.approx(speeds, abs=close * speed)
    across = np.cross([0.0, 0.0, 1.0], direction)
    assert np.abs(x @ across).max() < 1e-12
    assert x[:, 2] == pytest.approx(-WEIGHT / KN, rel=1e-9)


def test_energy_closes_while_it_slides_and_sticks():
    marcher, u = marching(block(), 1e-4)
    body = marcher.body
    v = body.translation @ [0.3, -0.2, 0.05] + body.rotation @ [0.0, 0.02, 0.4]
    state = marcher.start(0.0, u, v)
    start, lost = marching_energy(marcher, state).total_J, 0.0
    for _ in range(2000):
        step = marcher.step(state)
        state = step.state
        assert step.friction_loss_J >= -1e-15
        lost += step.friction_loss_J
    left = marching_energy(marcher, state).total_J
    kinetic = 0.5 * v @ v
    assert 0.1 * kinetic < lost < kinetic
    assert left + lost == pytest.approx(start, abs=1e-10 * kinetic)


@pytest.mark.parametrize("slope", [(0.99, 0.0), (0.0, -0.99), (0.7, 0.7)])
def test_below_the_angle_of_friction_it_stays(slope):
    """Damped to rest, it hangs in the spring by m g sin / Kt and has not crept after 1e5 steps."""
    steepest = math.degrees(math.atan(MU))
    slope = tuple(steepest * s for s in slope)
    its, alpha = 1e-3, 2.0 * math.sqrt(KN / MASS)  # critical damping of the hold
    marcher, u = marching(block(alpha=alpha), its, slope=slope)
    up = marcher.ground.up
    hang = -WEIGHT * up[:2] / KN
    assert 0.9 * MU < np.hypot(*up[:2]) / up[2] < MU  # close to slipping, but not there
    after = march_contact(marcher, 0.0, u, np.zeros(6), History(), until_s=1e5 * its)
    assert after.n_steps == 100_000
    rest = marcher.body.translation.T @ after.u / MASS
    assert rest[:2] == pytest.approx(hang, abs=1e-9 * np.abs(hang).max())
    # 1e5 steps of rounding
    assert after.friction_loss_J < 1e-10 * WEIGHT * np.abs(hang).max()


@pytest.mark.parametrize("beyond", [1.02, 1.5, 3.0])
def test_above_the_angle_of_friction_it_accelerates(beyond):
    """By g (sin - μ cos), down the slope, once the spring has given way."""
    angle = beyond * math.atan(MU)
    marcher, u = marching(block(), 1e-4, slope=(math.degrees(angle), 0.0))
    x, v, _ = run(marcher, u, np.zeros(6), 1000, look=500)
    down = -math.copysign(1.0, marcher.ground.up[0])
    gained = down * (v[2, 0] - v[1, 0]) / (500 * 1e-4)
    assert gained == pytest.approx(G * (math.sin(angle) - MU * math.cos(angle)), rel=1e-9)
    assert down * x[2, 0] > 0.0


# --- the rubbing oscillator ---------------------------------------------------------------------


def test_an_oscillator_loses_four_mu_n_over_k_a_cycle():
    """And stops where the spring can no longer overcome friction."""
    spring, amplitude = 4e3, 0.03
    peaks = lr.oscillator_peaks(amplitude, spring, MU, WEIGHT)
    assert len(peaks) == 7
    hold = 10.0 * KN
    its = 2.0 * math.pi * math.sqrt(MASS / spring) / 2000
    marcher, u = marching(block(spring_N_m=spring), its, kt_over_kn=10.0)
    u = u + marcher.body.translation @ [amplitude, 0.0, 0.0]
    x, _, _ = run(marcher, u, np.zeros(6), 8000)
    x = x[:, 0]
    turns = 1 + np.flatnonzero(np.diff(x[1:]) * np.diff(x[:-1]) < 0.0)
    # while it sticks it trembles in the hold by up to μ N / Kt: those are no turning points
    found = [amplitude, *(x[k] for k in turns if abs(x[k]) > 0.0)]
    swings = [found[0]]
    for value in found[1:]:
        if abs(value - swings[-1]) > 10.0 * MU * WEIGHT / hold:
            swings.append(value)
    elastic = 2.0 * MU * WEIGHT / hold
    sampled = 0.5 * amplitude * (math.pi / 2000) ** 2
    for i, (value, peak) in enumerate(zip(swings, peaks, strict=True)):
        assert value == pytest.approx(peak, abs=(i + 1) * (elastic + 4.0 * sampled))
    assert x[-1] == pytest.approx(peaks[-1], abs=8.0 * (elastic + 4.0 * sampled))


# --- a point on a known path ---------------------------------------------------------------------

STRETCH = MU * WEIGHT / KN  # of a spring as stiff as the law, at the limit


def dragged_along(path, presses):
    """Elongation (k, 2) of the spring, mean force (k - 1, 2) and loss (k - 1,) of a point.

    It is taken along a ``path`` (k, 2) under normal forces (k,)."""
    law = Linear(KN)
    points = Points(law.kind, law.parameters, KN, MU, np.ones(1), 0.0, np.ones(1), CONSERVING, 0.0)
    memory, none = np.zeros((1, 3)), np.zeros((1, 3))
    approach = np.column_stack([presses / KN, path])
    stretched, pulls, losses = [memory[0, :2].copy()], [], []
    energy = spring_energy(points, memory)
    for start, end in itertools.pairwise(approach):
        force, _ = pushed(points, start, end, memory, none)
        trial = Trial(start[None], end[None], end[None], force[None], memory, none)
        losses.append(commit(points, trial))
        work = force[1:] @ (end - start)[1:]
        before, energy = energy, spring_energy(points, memory)
        gained = energy - before
        assert work == pytest.approx(gained + losses[-1], abs=1e-12 * MU * WEIGHT * STRETCH)
        stretched.append(memory[0, :2].copy())
        pulls.append(force[1:])
    return np.array(stretched), np.array(pulls), np.array(losses)


def to_and_fro(steps, turns):
    """From nothing to three times the stretch at the limit, and back and forth (k,)."""
    return 3.0 * STRETCH * np.sin(0.5 * math.pi * np.arange(turns * steps + 1) / steps)


@pytest.mark.parametrize("steps", [7, 24, 100, 1000])
def test_under_a_constant_force_a_spring_and_slider_is_followed_exactly(steps):
    """The stop of Prandtl and Ishlinskii: between turns, the elongation clipped at the limit."""
    path = to_and_fro(steps, 9)
    stretched, _, losses = dragged_along(
        np.column_stack([0.6 * path, -0.8 * path]), np.full(len(path), WEIGHT)
    )
    wanted = np.zeros(len(path))
    for k, slip in enumerate(np.diff(path)):
        wanted[k + 1] = np.clip(wanted[k] + slip, -STRETCH, STRETCH)
    assert stretched @ [0.6, -0.8] == pytest.approx(wanted, abs=1e-12 * STRETCH)
    assert stretched @ [0.8, 0.6] == pytest.approx(np.zeros(len(path)), abs=1e-12 * STRETCH)
    assert losses.min() >= -1e-14 * MU * WEIGHT * STRETCH


def test_a_cycle_takes_the_area_of_its_loop():
    """4 μ N (A - μ N / Kt), approached by the square of the step."""
    steps, limit = np.array([16, 32, 64, 128, 256]), MU * WEIGHT
    wanted = 4.0 * limit * (3.0 * STRETCH - STRETCH)
    errors = []
    for n in steps:
        path = np.column_stack([to_and_fro(n, 5), np.zeros(5 * n + 1)])
        losses = dragged_along(path, np.full(len(path), WEIGHT))[2]
        errors.append(abs(losses[n:].sum() - wanted) / wanted)
    assert (np.array(errors) <= 20.0 / steps**2).all()


@pytest.mark.parametrize("along", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("angle", [0.3, 1.5])
def test_a_stretched_spring_turns_into_the_slip_along_a_tractrix(along, angle):
    """tan φ/2 falls as exp(-s/R); to second order in the step, and steadily however long it is."""
    begin = STRETCH * np.array([math.cos(angle), math.sin(angle)])
    wanted = 2.0 * math.atan(math.tan(0.5 * angle) * math.exp(-along))
    steps, errors = np.array([8, 16, 32, 64, 128]), []
    for n in steps:
        # the first step, from rest, stretches it; it sticks
        way = begin + np.outer(np.linspace(0.0, along * STRETCH, n + 1), [1.0, 0.0])
        stretched, _, _ = dragged_along(np.vstack([[0.0, 0.0], way]), np.full(n + 2, WEIGHT))
        angles = np.arctan2(stretched[1:, 1], stretched[1:, 0])
        assert np.hypot(*stretched[-1]) == pytest.approx(STRETCH, rel=1e-12)
        assert (np.diff(angles) <= 1e-12).all()
        assert angles[-1] >= 0.0
        errors.append(abs(angles[-1] - wanted))
    if along < 1.0:
        assert rate(1.0 / steps, errors) == pytest.approx(2.0, abs=0.2)


@given(seed=st.integers(0, 100_000), stride=st.floats(0.01, 10.0))
@example(seed=3834, stride=1.0)  # a normal force that hardly changes
@settings(max_examples=100, deadline=None)
def test_on_any_path_the_spring_ends_within_the_yield_surface_and_no_step_gains(seed, stride):
    rng = np.random.default_rng(seed)
    path = np.cumsum(stride * STRETCH * rng.normal(size=(60, 2)), axis=0)
    presses = WEIGHT * rng.uniform(-0.3, 2.0, 60)
    stretched, pulls, losses = dragged_along(path, presses)
    limits = MU * np.maximum(presses, 0.0) / KN
    assert (np.hypot(*stretched.T) <= limits * (1.0 + 1e-12)).all()
    mean = 0.5 * (presses[1:] + presses[:-1])
    inside = (presses[1:] > 0.0) & (presses[:-1] > 0.0)
    # the mean normal force is a difference of potentials over one of approaches, from `SHORT` on
    rounding = 8.0 * np.finfo(float).eps / SHORT
    assert (np.hypot(*pulls[inside].T) <= MU * mean[inside] * (1.0 + rounding)).all()
    assert losses.min() >= -1e-13 * MU * WEIGHT * STRETCH * max(stride, 1.0)


# --- a pressed face -----------------------------------------------------------------------------


def dragged(velocity, spin=0.0, enforcement=Enforcement.PENALTY):
    """Forces per area share (n, 3) along x, y and the normal of a heavy face on its way."""
    body = block(points=5)
    marcher, u = marching(body, 1e-6, kt_over_kn=1e3, enforcement=enforcement)
    v = body.translation @ [*velocity, 0.0] + body.rotation @ [0.0, 0.0, spin]
    state = marcher.start(0.0, u, v)
    for _ in range(30):
        step = marcher.step(state)
        state = step.state
    return body.contact, marcher.along_axes(step.force)


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
@pytest.mark.parametrize("angle_deg", [0, 90, 180, 45, -120, 17])
def test_an_ironed_face_pulls_back_evenly_with_mu_n(angle_deg, enforcement):
    angle = math.radians(angle_deg)
    direction = np.array([math.cos(angle), math.sin(angle)])
    points, force = dragged(0.5 * direction, enforcement=enforcement)
    assert points.weights @ force[:, 2] == pytest.approx(WEIGHT, rel=1e-8)
    assert force[:, 2] == pytest.approx(np.full(25, WEIGHT), rel=1e-8)
    assert force[:, :2] == pytest.approx(np.tile(-MU * WEIGHT * direction, (25, 1)), rel=1e-8)


def test_a_face_that_turns_on_the_spot_is_braked_by_mu_n_times_its_mean_radius():
    points, force = dragged((0.0, 0.0), spin=3.0)
    moment = points.weights @ np.cross(points.places_m, force)
    radius = np.hypot(*points.xy_m.T)
    assert moment[2] == pytest.approx(-MU * WEIGHT * points.weights @ radius, rel=1e-6)
    assert points.weights @ force[:, :2] == pytest.approx(np.zeros(2), abs=1e-6 * WEIGHT)
    sizes = np.hypot(*force[radius > 1e-9, :2].T)
    assert sizes == pytest.approx(np.full(24, MU * WEIGHT), rel=1e-8)


@given(
    angle=st.floats(0.0, 2.0 * math.pi),
    slip=st.floats(1e-7, 1e-4),
    stretch=st.floats(-1e-5, 1e-5),
    end_weight=st.sampled_from([CONSERVING, 1.0, 0.6]),
    soft=st.sampled_from([0.0, 1e-7]),
)
@settings(max_examples=100, deadline=None)
def test_the_return_mapping_knows_no_direction(angle, slip, stretch, end_weight, soft):
    """Forces and tangents turn with the tangent frame; friction never exceeds μ N."""
    law, one = Linear(KN), np.ones(1)
    points = Points(law.kind, law.parameters, 0.8 * KN, MU, one, 0.0, one, end_weight, soft)
    c, s = math.cos(angle), math.sin(angle)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    start, end = np.array([1e-5, 2e-6, -1e-6]), np.array([2e-5, 2e-6 + slip, -1e-6])
    spring, multiplier = np.array([0.0, stretch, -0.5 * stretch]), np.array([8.0, 1.0, -2.0])

    def seen(frame):
        memory = np.array([[*(frame @ spring)[1:], 0.0]])
        return pushed(points, frame @ start, frame @ end, memory, (frame @ multiplier)[None])

    (force, slope), (other, other_slope) = seen(np.eye(3)), seen(turned)
    assert other == pytest.approx(turned @ force, rel=1e-10, abs=1e-10)
    assert other_slope == pytest.approx(turned @ slope @ turned.T, rel=1e-8, abs=1e-6 * KN)
    # 0.6 has part of the step before in it, and a multiplier holds once it has converged
    if end_weight != 0.6 and (soft == 0.0 or end_weight == CONSERVING):
        assert np.hypot(*force[1:]) <= MU * force[0] * (1.0 + 1e-12)
