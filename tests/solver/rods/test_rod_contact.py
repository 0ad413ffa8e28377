"""Contact of rods with a plane: its tangent, the elastica's filament, friction, and energy."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from elastica import filament
from mpi4py import MPI
from rod_helpers import (
    HALF,
    SLENDER,
    OneRod,
    above_ground,
    along,
    leaning,
    one_clamp,
    press,
    slide,
)
from scipy.spatial.transform import Rotation

from bristle.meshes.section import Circle
from bristle.solver.bristle import Bristle
from bristle.solver.rods.chain import at_rest, new_system, uniform_chain
from bristle.solver.rods.contact import (
    SLIDES,
    STICKS,
    Friction,
    SectionPose,
    TouchStep,
    coefficient,
    no_touch,
    obstacle_of,
    touch_section,
)
from bristle.solver.rods.frame import TipState
from bristle.solver.rods.ground import Ground
from bristle.solver.rods.hub import HubPath
from bristle.solver.rods.march import first_crossing
from bristle.solver.rods.relief import RoughPlane
from bristle.solver.rods.rods import Rods
from bristle.solver.rods.section import RodSection

# one rod, which no rank shares
pytestmark = pytest.mark.serial

# N L²/EI of a filament pressed on a plane, by clamp's lean in degrees and friction, at depths of
# 0.05, 0.1 and 0.2 of its length.
NORMAL = {
    (0, 0.0): (2.53087, 2.59814, 2.74557),
    (0, 0.2): (1.64075, 1.90481, 2.23504),
    (0, 0.5): (1.07393, 1.36006, 1.74716),
    (30, 0.0): (0.46376, 0.77062, 1.19344),
    (30, 0.2): (0.36457, 0.62989, 1.02934),
    (30, 0.5): (0.27600, 0.49440, 0.85314),
}
ROOT = {0: 1.63771, 30: 0.90938}


def pressed_then_slid(lean_deg, mu, depth, elements):
    """Pressed without friction, then slid until the tip trails; every step an equilibrium.

    An upright rod is pressed while it leans by 0.3 rad, which the slide takes back: from upright it
    would not know where to bend.
    """
    lean, extra = math.radians(lean_deg), 0.3 if lean_deg == 0 else 0.0
    path = np.zeros((6, 2, 6))
    path[-1, :, 2] = HALF * math.sin(lean) + np.array(
        [math.cos(lean + extra), math.cos(lean) - depth]
    )
    path[-2, 0, 2] = path[-1, 1, 2] - path[-1, 0, 2]
    path[-1, :, 4], path[-2, 1, 4], path[-2, 1, 0] = extra, -extra, 0.6
    rod = OneRod(
        uniform_chain(SLENDER, 1.0, elements),
        [0.0, 0.0, 0.0],
        leaning(lean),
        path=HubPath(np.array([0.0, 1.0, 2.0]), path),
        ground=Ground(kn_N_m=1e5, friction_kinetic=mu, friction_static=mu),
    )
    start = leaning(lean + extra)
    rod.now.x[:], rod.now.q[:] = at_rest(rod.chain, path[-1, 0, :3], start)
    rod.slowly(1.0, 1.0 / 30.0, friction=False)
    rod.slowly(2.0, 1.0 / 30.0)
    return rod.now


@pytest.mark.parametrize("lean_deg", [0, 30])
@pytest.mark.parametrize("mu", [0.0, 0.2, 0.5])
def test_a_filament_on_a_plane_is_the_elastica(lean_deg, mu):
    for depth, published in zip((0.05, 0.1, 0.2), NORMAL[lean_deg, mu], strict=True):
        force, moment = filament(math.radians(lean_deg), mu, depth)
        assert force == pytest.approx(published, abs=6e-6)
        now = pressed_then_slid(lean_deg, mu, depth, 40)
        assert now.touch.normal.sum() == pytest.approx(force, rel=1e-3)
        assert abs(now.holding[4]) == pytest.approx(moment, rel=1e-3)
        if mu > 0.0:
            assert np.all(now.touch.state[now.touch.normal > 0.0] == SLIDES)
            assert -now.holding[0] == pytest.approx(-mu * now.touch.normal.sum(), rel=1e-4)
    if mu == 0.5:
        assert abs(now.holding[4]) == pytest.approx(ROOT[lean_deg], rel=5e-3)


def test_the_filament_converges_at_second_order():
    """Against the elastica at the depth that the tip's penetration leaves."""
    errors = []
    for elements in (10, 20, 40):
        normal = pressed_then_slid(30, 0.5, 0.2, elements).touch.normal.sum()
        force, _ = filament(math.radians(30), 0.5, 0.2 - normal / 1e5)
        errors.append(abs(normal / force - 1.0))
    assert np.all(np.divide(errors[:-1], errors[1:]) > 3.5)


# States of the one section that `touched` moves: how far it goes in and along, and the speed
# of sliding before.
CASES = {
    "open": (5e-3, 0.0, 0.0),
    "sticks": (-1e-3, 1e-4, 0.0),
    "slides": (-1e-3, 5e-3, 0.03),
    "slides at the kinetic coefficient": (-1e-3, 5e-3, 1e3),
}


@pytest.mark.parametrize("case", CASES)
def test_tangent_of_contact(rng, case):
    """Central differences; what is linear in the spin and the place leaves 1e-6 of 1e5 N/m."""
    depth, along_m, speed = CASES[case]
    section = replace(SLENDER, half_thin_m=0.02, half_wide_m=0.05)
    ground = Ground(4e5, 0.3, 0.5, 0.05, point_m=(0.0, 0.0, 0.1), normal=(0.1, -0.2, 1.0))
    surface = obstacle_of(ground, section)
    turn = (
        Rotation.from_rotvec([0.01, -0.02, 0.7])
        * Rotation.align_vectors([surface.normal], [[0.0, 0.0, 1.0]])[0]
    )
    place = surface.point + depth * surface.normal
    tangential = np.cross(surface.normal, [0.0, 1.0, 0.0])
    before, now = no_touch(1, 4), no_touch(1, 4)
    before.speed[:] = speed
    before.elongation[0, :] = 1e-4 * np.cross(surface.normal, [1.0, 0.0, 0.0])
    was = place - along_m * tangential + 1e-3 * surface.normal

    def residual(shift, spin):
        system = new_system(1)
        system.diagonal[:] = system.residual[:] = 0.0
        turned = (Rotation.from_rotvec(spin) * turn).as_matrix()
        moved, started = SectionPose(place + shift, turned), SectionPose(was, turn.as_matrix())
        touch_section(surface, 0, moved, started, TouchStep(before, now, 0.1, False), system)
        return system.residual[0].copy(), system.diagonal[0].copy()

    force, tangent = residual(np.zeros(3), np.zeros(3))
    states = set(now.state[0])
    if case == "open":
        assert states == {0}
        assert not force.any()
    else:
        assert states & {STICKS, SLIDES} == ({STICKS} if case == "sticks" else {SLIDES})
    h = 1e-7
    for k in range(6):
        nudge = h * np.eye(6)[k]
        up, down = residual(nudge[:3], nudge[3:])[0], residual(-nudge[:3], -nudge[3:])[0]
        assert tangent[:, k] == pytest.approx((up - down) / (2 * h), abs=1e-6 * 4e5)


def test_a_point_that_stuck_holds_at_first():
    """Its force is that of one that slides, its tangent that of one that sticks."""
    surface = obstacle_of(Ground(4e5, 0.3, 0.3), SLENDER)
    place, tangents, pushes = np.array([0.0, 0.0, -1e-3]), [], []
    for mu, early in ((0.3, False), (0.3, True), (1e9, False)):
        law = surface._replace(friction=Friction(mu, mu, 0.0))
        before, now, system = no_touch(1, 4), no_touch(1, 4), new_system(1)
        before.state[:] = STICKS
        was = place - np.array([5e-3, 0.0, 0.0])
        sections = SectionPose(place, np.eye(3)), SectionPose(was, np.eye(3))
        touch_section(law, 0, *sections, TouchStep(before, now, 0.1, early), system)
        tangents.append(system.diagonal[0, :3, :3].copy())
        pushes.append(system.residual[0, :3].copy())
    assert np.array_equal(pushes[1], pushes[0])
    assert np.array_equal(tangents[1], tangents[2])
    assert abs(tangents[0][0, 0]) < 1e-6 * tangents[1][0, 0]


def test_friction_falls_with_the_speed_of_sliding():
    """Stribeck's curve: static at rest, kinetic at speed, exp(-1) of the way at its own speed."""
    law = Friction(0.5, 0.3, 0.1)
    assert coefficient(law, 0.0) == 0.5
    assert coefficient(law, 0.1) == pytest.approx(0.3 + 0.2 / math.e)
    assert coefficient(law, 10.0) == pytest.approx(0.3)
    assert coefficient(Friction(0.5, 0.3, 0.0), 1e-12) == 0.3


def test_stick_and_slip_of_a_mass_on_a_belt():
    """A leaf spring with its mass at the tip, dragged slowly: slips by 2 (μs - μk) N/k beside what
    the hub goes on meanwhile, then sticks for 2 (μs - μk) N/(k v). The mass is so light that the
    hub's speed over the slip's is 3 %, which enters by its square. The section is a point, or half
    of its corners would slip before the others."""
    static, kinetic, speed, mass, depth = 0.6, 0.4, 0.01, 5e-5, 0.01
    section = replace(SLENDER, EA_N=2.0, half_thin_m=1e-9, half_wide_m=1e-9)
    chain = uniform_chain(section, 1.0, 1)
    chain = chain._replace(mass=np.array([0.0, mass]), inertia=np.full((2, 3), 1e-9))
    breaks, path = np.array([0.0, 1.0, 2.0]), np.zeros((6, 2, 6))
    path[-2, 0, 2], path[-1, 1, 2], path[-2, 1, 0] = -depth, -depth, speed
    belt = OneRod(
        chain,
        [0.0, 0.0, 1.0],
        leaning(0.0),
        path=HubPath(breaks, path),
        ground=Ground(2e5, kinetic, static),
        section=section,
    )
    belt.slowly(1.0, 0.5)
    normal, held = belt.now.touch.normal.sum(), belt.now.holding[0]
    belt.slowly(1.1, 0.01)
    stiffness = (belt.now.holding[0] - held) / (0.1 * speed)
    assert stiffness == pytest.approx(3.0, rel=0.02)
    belt.scheme = belt.scheme._replace(inertia=True)
    h, places, states = 1e-4, [], []
    for _ in range(15_000):
        assert belt.step(h)
        places.append(belt.now.x[-1, 0])
        states.append(int(belt.now.touch.state[-1].max()))
    slipping = np.array(states) == SLIDES
    starts = np.flatnonzero(slipping[1:] & ~slipping[:-1]) + 1
    ends = np.flatnonzero(~slipping[1:] & slipping[:-1]) + 1
    loose = 2.0 * (static - kinetic) * normal / stiffness
    large = [
        (s, e) for s, e in zip(starts, ends, strict=False) if places[e] - places[s] > 0.1 * loose
    ]
    assert len(large) >= 4
    for s, e in large[1:]:
        slip = places[e] - places[s - 1] - speed * (e - s) * h
        assert slip == pytest.approx(loose, rel=0.01)
    for (_, e), (s, _) in itertools.pairwise(large[1:]):
        assert (s - e) * h == pytest.approx(loose / speed, rel=0.01)


@pytest.mark.parametrize("mu", [0.2, 0.5])
@pytest.mark.parametrize("pulls", [1.0, -1.0])
def test_a_thin_wire_over_a_drum_is_a_capstan(mu, pulls):
    """Pulled over the drum against a force at its other end, or let go by it: between both ends the
    force grows by exp(μ φ), φ the angle of wrap (Euler). The wire is as curved as the drum."""
    radius, half, spacing = 0.02, math.radians(40.0), 1e-4
    stiff, soft = 1e4, 1e-6
    section = replace(
        SLENDER,
        **dict.fromkeys(("EA_N", "GA1_N", "GA2_N"), stiff),
        **dict.fromkeys(("EI1_Nm2", "EI2_Nm2", "GJ_Nm2"), soft),
        half_thin_m=1e-6,
        half_wide_m=1e-6,
        curvature_1_m=(0.0, 1.0 / radius, 0.0),
    )
    x = spacing * np.array([*range(200), *range(-200, 0)])
    heights = np.sqrt(np.maximum(radius**2 - x**2, (0.5 * radius) ** 2))
    drum = RoughPlane(np.tile(heights, (4, 1)), spacing, np.ones((4, len(x))))
    path = np.zeros((6, 2, 6))
    path[-2, 1, 4] = -0.01 * pulls  # about the drum's axis, so that the clamp stays on it
    sine, cosine = math.sin(half), math.cos(half)
    wire = OneRod(
        uniform_chain(section, 2.0 * half * radius, 40),
        [-radius * sine, 0.0, radius * cosine],
        along([cosine, 0.0, sine]),
        path=HubPath(np.array([0.0, 1.0, 2.0]), path),
        section=section,
        ground=Ground(2e6, mu, mu, rough=drum),
    )
    wire.loads[-1, :3] = cosine, 0.0, -sine
    wire.slowly(1.0, 0.25, friction=False)
    assert np.linalg.norm(wire.now.holding[:3]) == pytest.approx(1.0, rel=0.005)
    wire.slowly(1.1, 0.01)
    touch = wire.now.touch
    assert np.all(touch.state[touch.normal > 0.0] == SLIDES)
    force = np.linalg.norm(wire.now.holding[:3])
    # the force changes from node to node: an element's angle may be in or out
    assert force == pytest.approx(math.exp(pulls * mu * 2.0 * half), rel=mu * 2.0 * half / 40)


def test_a_step_that_crosses_the_surface_is_cut_where_it_does():
    """The tip goes from 3 mm above to 1 mm below, or back: at 3/4 of the step, or at 1/4."""
    rod = OneRod(
        uniform_chain(SLENDER, 1.0, 2), [0.0, 0.0, 1.0], leaning(0.0), ground=Ground(4e5, 0.0, 0.0)
    )
    above, below = rod.now, rod.next
    for state, height in ((above, 3e-3), (below, -1e-3)):
        state.x[:, 2], state.q[:] = [1.0, 0.5, height], rod.now.q
    below.touch.state[-1], below.touch.normal[-1] = SLIDES, 1e5 * 1e-3
    held = 0.5 * 1e5 * 1e-3**2
    down, up = (above, below), (below, above)
    for (old, new), share in ((down, 0.75), (up, 0.25)):
        found = first_crossing(rod.surface, old, new, 0.9 * held)
        assert share < found < 1.03 * share
        assert first_crossing(rod.surface, old, new, 1.1 * held) == 1.0


def dragged(tolerance, **numbers):
    """The paper's bristle pressed down by a tenth of its length, then dragged at 1 m/s."""
    section = replace(RodSection.of(Bristle()), **numbers)
    clamp = above_ground(section, math.radians(20.0), 0.3365)
    path, ground = slide(0.03365, 1.0, 0.05, 0.05), Ground(2e6, 0.4, 0.6, 0.05)
    return Rods(section, clamp, path, ground, 10, tolerance=tolerance, comm=MPI.COMM_SELF)


@pytest.mark.parametrize("beta_s", [1e-3, 1.0])
def test_strong_damping_asks_for_no_shorter_steps(beta_s):
    """Damping is implicit: what grows with β over the step is stiff, as elements are anyway."""
    calm, usual = dragged(1e-5, beta_s=beta_s), dragged(1e-5)
    (after,), (expected,) = calm.march(0.12, 0.12), usual.march(0.12, 0.12)
    assert after.steps < 2 * expected.steps
    assert after.energy.material_loss_J > expected.energy.material_loss_J
    assert after.energy.closure_relative < 0.05


def test_energy_closes_with_contact_and_friction():
    """Hub's work = held + lost, to 1e-3 of it; what is left falls with the tolerance of a step."""
    closures = []
    for tolerance in (1e-5, 1e-7):
        rods = dragged(tolerance)
        (frame,) = rods.march(0.12, 0.12)
        assert frame.energy.friction_loss_J > 0.02 * frame.energy.hub_work_J
        assert frame.energy.material_loss_J > 0.0
        closures.append(frame.energy.closure_relative)
    assert closures[1] < 1e-3
    assert closures[1] < 0.3 * closures[0]


@pytest.mark.parametrize("kn_N_m", [1e4, 2e6, 1e9])
def test_a_stiffer_surface_only_lessens_the_penetration(kn_N_m):
    """From soft to all but rigid: the force settles at the elastica's, the depth at N/Kn."""
    lean, depth = math.radians(30), 0.1
    rod = OneRod(
        uniform_chain(SLENDER, 1.0, 20),
        [0.0, 0.0, math.cos(lean) + HALF * math.sin(lean)],
        leaning(lean),
        path=press(depth, 1.0),
        ground=Ground(kn_N_m, 0.0, 0.0),
    )
    rod.slowly(1.0, 0.05)
    normal = rod.now.touch.normal.sum()
    force, _ = filament(lean, 0.0, depth - normal / kn_N_m)
    assert normal == pytest.approx(force, rel=2e-3)


@pytest.mark.parametrize(
    ("wire", "near", "most"),
    [(None, 1e-6, 2), (Circle(8e-4), 1e-3, 20)],
    ids=["rectangle", "round"],
)
def test_a_rigid_surface_is_the_limit_of_stiff_ones_and_does_not_chatter(bristle, wire, near, most):
    """Ten times as stiff, it presses as hard: what it gives way by, N/Kn, is 1e-8 of the depth. The
    tip sticks first and then slides. It takes a few more steps than on the paper's surface, and
    many more on a stiffer one. A thick round wire shakes on while it is pressed, sticks and slips
    20 times on the stiffer surface, and a tenth of the steps' tolerance changes its mean force by
    1e-4."""
    bristle = replace(bristle, section=wire or bristle.section)
    section, length = RodSection.of(bristle), 0.3365
    clamp = above_ground(section, math.radians(20.0), length)
    pressing, changes, steps = [], [], []
    rigid = section.rigid_N_m(length / 20)
    for kn in (2e6, rigid, 10.0 * rigid):
        path = press(0.1 * length, 0.3)
        rods = Rods(section, clamp, path, Ground(kn, 0.3, 0.3), 20, comm=MPI.COMM_SELF)
        frames = list(rods.march(0.6, 2e-3))
        pressing.append(np.mean([frame.force_N[2] for frame in frames[50:150]]))
        states = np.array([frame.state[0] for frame in frames])
        changes.append(np.count_nonzero(np.diff(states)))
        steps.append(frames[-1].steps)
    assert pressing[1] == pytest.approx(pressing[2], rel=near)
    assert changes[1] <= most
    assert steps[1] < 2 * steps[0]
    assert steps[2] > 3 * steps[1]


def test_a_rod_pulled_along_a_floor_accelerates_by_what_friction_leaves(bristle):
    """F = m a + μ N for a rod that lies flat, N its weight but for the half element at the hub:
    so ½ (F - μ N) t² / m is the hub's path. Within 1 %."""
    section, length, acceleration, mu = RodSection.of(bristle), 0.2, 2.0, 0.3
    path = np.zeros((6, 1, 6))
    path[3, 0, 0] = 0.5 * acceleration
    clamp = one_clamp(
        [0.0, 0.0, section.half_thin_m], along([-1.0, 0.0, 0.0], wide=(0, 1.0, 0)), length
    )
    along_floor, floor = HubPath(np.array([0.0, 5.0]), path), Ground(2e6, mu, mu)
    rods = Rods(section, clamp, along_floor, floor, 20, comm=MPI.COMM_SELF)
    (frame,) = rods.march(0.4, 0.4)
    mass = section.rhoA_kg_m * length
    assert frame.tip_normal_N[0] == pytest.approx(mass * 9.8, rel=0.04)
    assert frame.state[0] == TipState.SLIP
    pull = -frame.force_N[0]
    travelled = 0.5 * (pull - mu * frame.tip_normal_N[0]) * 0.4**2 / mass
    assert travelled == pytest.approx(0.5 * acceleration * 0.4**2, rel=0.01)
    assert frame.tip_m[0, 0] + length == pytest.approx(0.5 * acceleration * 0.4**2, rel=0.01)
