"""Many rods in one hub: ranks, checkpoints, forces on the hub, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from rod_helpers import above_ground, along, leaning, one_clamp, press, slide
from scipy.spatial.transform import Rotation

from bristle.meshes.section import Circle
from bristle.solver.bristle import Bristle
from bristle.solver.errors import InputError
from bristle.solver.rods.chain import uniform_chain
from bristle.solver.rods.frame import TipState
from bristle.solver.rods.ground import Ground
from bristle.solver.rods.hub import Clamps, HubPath
from bristle.solver.rods.rods import Rods
from bristle.solver.rods.section import RodSection

LENGTH, LEAN = 0.3365, math.radians(20)
HEIGHT = LENGTH * math.cos(LEAN)
PATH = slide(0.02, 0.5, 0.02, 0.02)


def rows(count=5, comm=MPI.COMM_WORLD, path=PATH, **how):
    """Bristles of different lengths side by side, leaning."""
    section = RodSection.of(Bristle())
    lengths = LENGTH * (1.0 - 0.01 * np.arange(count))
    places = np.zeros((count, 3))
    places[:, 1] = 0.01 * np.arange(count)
    places[:, 2] = HEIGHT + section.half_thin_m
    clamps = Clamps(places, np.tile(leaning(LEAN), (count, 1, 1)), lengths)
    ground = Ground(2e6, 0.3, 0.5, 0.05)
    return Rods(section, clamps, path, ground, 6, comm=comm, tolerance=1e-5, **how)


def test_mean_forces_are_impulses_even_of_tips_that_bounce():
    """Without friction the hub alone pushes along x: what it gives is what the bristle gains.

    Instants tell nothing of it: the tip bounces between them.
    """
    section = RodSection.of(Bristle())
    clamp = one_clamp([0.0, 0.0, HEIGHT + section.half_thin_m], leaning(LEAN), LENGTH)
    path = slide(0.02, 1.0, 0.05, 0.05)
    rods = Rods(section, clamp, path, Ground(2e6, 0.0, 0.0), comm=MPI.COMM_SELF)
    mass, momentum, impulse, instants = uniform_chain(section, LENGTH, 20).mass, [], [], []
    for frame in rods.march(0.2, 0.01):
        momentum.append(mass @ rods.checkpoint()["velocity"][0, :, 0])
        means = frame.means
        assert means.end_s[-1] == frame.t_s
        assert len(means.end_s) == 10
        impulse.append(np.sum((means.end_s - means.begin_s) * means.force_N[:, 0]))
        instants.append(0.01 * frame.force_N[0])
        assert 0.0 <= means.share.min() <= means.share.max() <= 1.0
    gained, largest = np.diff(momentum), np.abs(impulse).max()
    np.testing.assert_allclose(-np.array(impulse[1:]), gained, atol=2e-3 * largest)
    assert np.abs(np.array(instants[1:]) + gained).max() > 0.2 * largest


def test_a_step_gives_to_every_window_what_falls_into_it():
    """Frames so close that each is one step: the mean is that of its two ends, and so is the
    torque's about a hub that moves. In windows, steps that end elsewhere give the same sum."""
    fine, whole, cut = rows(1), rows(1), rows(1)
    before = fine.frame()
    for frame in fine.march(2e-5, 1e-6):
        for name in ("force_N", "torque_Nm"):
            mean = 0.5 * (getattr(before, name) + getattr(frame, name))
            np.testing.assert_allclose(getattr(frame.means, name)[0], mean, rtol=1e-9, atol=1e-12)
        before = frame
    whole.advance(0.03)
    cut.advance(0.03, 7)
    for name in ("force_N", "torque_Nm", "share"):
        seven, one = (getattr(each.frame().means, name) for each in (cut, whole))
        np.testing.assert_allclose(seven.mean(axis=0), one[0], rtol=1e-9, atol=1e-12)


def test_what_the_bristles_do_to_the_hub_is_what_the_ground_does_to_them():
    """Pressed slowly and left to settle: normal force and friction pass on to the hub, with its
    moment about the hub's origin, where the weight is known."""
    section = RodSection.of(Bristle())
    clamp = one_clamp([0.05, 0.02, HEIGHT + section.half_thin_m], leaning(LEAN), LENGTH)
    # strong damping by mass brings it to rest
    calm = replace(section, alpha_1_s=60.0)
    rods = Rods(calm, clamp, press(0.02, 0.05), Ground(2e6, 0.3, 0.5), 20)
    frame = list(rods.march(0.6, 0.6))[-1]
    if MPI.COMM_WORLD.rank > 0:
        return
    share = np.full(21, LENGTH / 20)
    share[[0, -1]] *= 0.5
    weights = 9.8 * section.rhoA_kg_m * share
    assert frame.state[0] == TipState.STICK
    assert frame.force_N[2] == pytest.approx(frame.tip_normal_N[0] - weights.sum(), rel=1e-4)
    assert abs(frame.force_N[0]) == pytest.approx(frame.tip_friction_N[0], rel=1e-4)
    assert frame.tip_friction_N[0] < 0.5 * frame.tip_normal_N[0]
    # about the hub's origin, 0.02 m below the world's: the lower edge's force, and the weights
    thin = Rotation.from_quat(frame.rotation[0, -1, [1, 2, 3, 0]]).as_matrix()[:, 0]
    edge = frame.tip_m[0] - math.copysign(section.half_thin_m, thin[2]) * thin
    moment = frame.centre_m[0, :, 0] @ weights - edge[0] * frame.tip_normal_N[0]
    moment += (edge[2] + 0.02) * frame.force_N[0]
    assert frame.torque_Nm[1] == pytest.approx(moment, rel=1e-4)
    # and the root's moment is the greatest stress of the rod
    above = HEIGHT + section.half_thin_m
    root = frame.torque_Nm[1] - above * frame.force_N[0] + 0.05 * frame.force_N[2]
    modulus = 2.08e-3 * 0.5e-3**2 / 6.0
    assert frame.bending_stress_Pa[0, 0] == pytest.approx(abs(root) / modulus, rel=1e-3)


@pytest.mark.parametrize(
    "bristle", [Bristle(), Bristle(section=Circle(1e-3))], ids=["flat", "round"]
)
def test_the_greatest_stress_is_that_of_all_steps(bristle):
    """One frame of a tip that bounces, beside frames so close that they miss nothing."""
    section, path = RodSection.of(bristle), slide(0.005, 0.5, 0.02, 0.02)
    clamp = above_ground(section, LEAN, LENGTH)

    def marched(every_s):
        rods = Rods(section, clamp, path, Ground(2e6, 0.3, 0.3), 6, comm=MPI.COMM_SELF)
        return list(rods.march(0.03, every_s))

    fine = max(frame.bending_stress_Pa.max() for frame in marched(1e-5))
    (whole,) = marched(0.03)
    assert whole.bending_stress_Pa.max() < 0.95 * fine
    assert whole.greatest_stress_Pa[0] == pytest.approx(fine, rel=0.02)


@pytest.mark.parametrize("kn_N_m", [1e2, 2e6, 1e10])
def test_a_bristle_begins_at_rest_on_any_surface(kn_N_m):
    """One that sags on the surface by its weight stays where it is, whatever Kn: it moves by no
    more than Newton's tolerance times its flexibility. The hub carries what the surface does not,
    to the rounding of coordinates times Kn.
    """
    section = RodSection.of(Bristle())
    clamp = above_ground(section, LEAN, LENGTH, 1e-4)
    rods = Rods(section, clamp, HubPath.still(), Ground(kn_N_m, 0.0, 0.0), 20)
    before = rods.frame()
    (after,) = rods.march(0.02, 0.02)
    if MPI.COMM_WORLD.rank == 0:
        assert np.abs(after.centre_m - before.centre_m).max() < 1e-7
        weight = 9.8 * section.rhoA_kg_m * LENGTH
        assert before.tip_normal_N[0] > 0.2 * weight
        assert -before.force_N[2] == pytest.approx(weight - before.tip_normal_N[0], abs=1e-5)


def test_an_upright_bristle_buckles():
    """It bears about Euler's load of a column that is clamped and pinned, 20.19 EI/L², while its
    tip sticks; compressed without buckling it would bear EA δ/L, 5 000 times as much."""
    section = RodSection.of(Bristle())
    clamp = one_clamp([0.0, 0.0, LENGTH], leaning(0.0), LENGTH)
    rods = Rods(section, clamp, press(0.01, 0.1), Ground(2e6, 5.0, 5.0), 20)
    frame = list(rods.march(0.2, 0.2))[-1]
    if MPI.COMM_WORLD.rank == 0:
        euler = 20.19 * section.EI2_Nm2 / LENGTH**2
        assert 0.2 * euler < frame.tip_normal_N[0] < 3.0 * euler
        assert np.abs(frame.centre_m[0, :, 0]).max() > 0.1 * LENGTH


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"place": [0.0, 0.0, -0.1]}, "clamp of bristle 0 is 0.1 m below"),
        ({"place": [0.0, 0.0, 0.9 * HEIGHT]}, "begins 0.03"),
        ({"elements": 0}, "at least one element"),
        ({"gravity_m_s2": math.nan}, "gravity"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_impossible_input_is_refused(change, words):
    section = RodSection.of(Bristle())
    place = change.pop("place", [0.0, 0.0, 2.0 * HEIGHT])
    with pytest.raises(InputError, match=words):
        Rods(section, one_clamp(place, leaning(LEAN), LENGTH), PATH, Ground(), **change)


def test_a_frame_may_fall_on_a_break_of_the_path_but_for_rounding():
    """Steps end at breaks; none is left of 1e-17 s."""
    breaks = np.array([0.0, 0.1 + 0.2, 1.0])
    assert breaks[1] > 0.3
    path = HubPath(breaks, np.zeros((6, 2, 6)))
    rods = rows(1, path=path)
    assert [frame.t_s for frame in rods.march(0.32, 0.3)] == [0.3, 0.32]


def test_a_hub_that_goes_below_the_surface_is_refused_before_the_march():
    deep = press(1.01 * HEIGHT, 0.1)
    with pytest.raises(InputError, match="below the surface at 0.0"):
        next(rows(path=deep).march(0.2, 0.01))


def test_a_clamp_below_a_tilted_plane_is_refused():
    section = RodSection.of(Bristle())
    clamp = one_clamp([1.0, 0.0, 0.5], along([0.0, 0.0, 1.0]), 0.1)
    Rods(section, clamp, HubPath.still(), Ground(), 4)
    with pytest.raises(InputError, match="clamp"):
        Rods(section, clamp, HubPath.still(), Ground(normal=(-1.0, 0.0, 1.0)), 4)


def one_second_dragged():
    """The paper's bristle, leaning by 30 degrees, after a second of being pressed and set off."""
    section = RodSection.of(Bristle())
    path = slide(0.1 * LENGTH, 1.0, 0.2, 0.2)
    clamp = above_ground(section, math.radians(30), LENGTH)
    rods = Rods(section, clamp, path, Ground(), 20, comm=MPI.COMM_SELF)
    (before,) = rods.march(1.0, 1.0)
    return rods, before


def test_a_steady_drag_takes_long_steps():
    """A bristle that slides steadily is not stepped by what its waves or its contact would need:
    the first axial wave of one element takes 3 microseconds, a step here about a millisecond."""
    rods, before = one_second_dragged()
    (after,) = rods.march(2.0, 2.0)
    assert after.state[0] == TipState.SLIP
    assert after.energy.friction_loss_J > before.energy.friction_loss_J
    assert after.steps - before.steps < 2000
    assert after.energy.closure_relative < 1e-4
