"""Bristle against bristle: the gap of two elements, its forces, and rods that bend each other."""

import itertools
import math

import numpy as np
import pytest
from elastica import cantilever
from mpi4py import MPI
from rod_helpers import along, leaning, quaternion, slide
from scipy.linalg import block_diag
from scipy.optimize import brentq, lsq_linear
from scipy.spatial.transform import Rotation

from bristle.meshes.section import Circle
from bristle.solver.bristle import Bristle
from bristle.solver.compiled import nth, write
from bristle.solver.errors import InputError
from bristle.solver.rods.chain import at_rest, stacked, uniform_chain
from bristle.solver.rods.contact import TouchStep, no_touch, obstacle_of
from bristle.solver.rods.element import strains
from bristle.solver.rods.ground import Contact, Ground
from bristle.solver.rods.hub import Clamps, HubPath
from bristle.solver.rods.joint import (
    Brush,
    Group,
    _by_scipy,
    _point_forces,
    joint_step,
    room_for,
)
from bristle.solver.rods.motion import ClampedRod, Hub, Pose, motion_of, scheme_of
from bristle.solver.rods.neighbours import GROUPED, Linked, Neighbours, shared_out
from bristle.solver.rods.pairs import (
    CORNER,
    ROUGH_M,
    Side,
    approach,
    axes_apart,
    between_of,
    candidates,
    meet,
    meet_pair,
    near,
    new_meeting,
    room_for_points,
)
from bristle.solver.rods.rods import Rods
from bristle.solver.rods.section import RodSection
from bristle.solver.rods.step import Law
from bristle.solver.time.scheme import TimeScheme

SECTION = RodSection.of(Bristle())
THIN, WIDE, LENGTH = 2.0 * SECTION.half_thin_m, 2.0 * SECTION.half_wide_m, 0.3365
KN = 2e6
LAW = between_of(Contact(KN, 0.0, 0.0), SECTION)
# thin side along x, wide side along y, downward
DOWN = along([0.0, 0.0, -1.0])


def straight(place, rotation, nodes=2, length=0.02):
    """The pose of a straight rod."""
    s = np.linspace(0.0, length, nodes)
    x = np.array(place) + s[:, None] * rotation[:, 2]
    return Pose(x, np.tile(quaternion(Rotation.from_matrix(rotation)), (nodes, 1)))


def crossing(angle_deg, apart, at_a=0.01, at_b=0.01, nodes=2, length=0.02):
    """Two straight rods whose axes cross at an angle, their thin sides facing each other."""
    turned = Rotation.from_rotvec([math.radians(angle_deg), 0.0, 0.0]).as_matrix() @ DOWN
    a = straight([apart, 0.0, at_a], DOWN, nodes, length)
    b = straight(-at_b * turned[:, 2], turned, nodes, length)
    return a, b


@pytest.mark.parametrize("angle_deg", [90, 60, 20])
@pytest.mark.parametrize("nodes", [2, 3, 4, 12])
@pytest.mark.parametrize("at", [0.01, 0.0093])
def test_rods_that_cross_meet_over_the_same_length_wherever_nodes_are(angle_deg, nodes, at):
    """It is where their projections overlap; elements share it out."""
    apart = THIN - 1e-6
    a, b = crossing(angle_deg, apart, at, 0.0108, nodes)
    room, total = new_meeting(), 0.0
    for e in range(nodes - 1):
        for f in range(nodes - 1):
            length = meet(LAW, a, e, b, f, room)
            if length > 0.0:
                total += 0.5 * length
                assert room.gap[0] == pytest.approx(apart - THIN, rel=1e-6)
                assert room.gap[1] == math.inf
                assert room.normal == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
                # at the crossing, whichever the elements
                assert room.first[0] == pytest.approx([apart, 0.0, 0.0], abs=1e-9)
                assert room.second[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    angle = math.radians(angle_deg)
    assert total == pytest.approx(
        (WIDE + WIDE * abs(math.cos(angle))) / math.sin(angle), rel=CORNER**2
    )


@pytest.mark.parametrize(
    ("offset", "gap", "normal"),
    [
        ([THIN - 1e-6, 0.3e-3, 0.0], -1e-6, [1.0, 0.0, 0.0]),
        ([-THIN + 1e-6, 0.3e-3, 0.0], -1e-6, [-1.0, 0.0, 0.0]),
        ([0.2e-3, WIDE - 2e-6, 0.0], -2e-6, [0.0, 1.0, 0.0]),
    ],
)
def test_parallel_rods_meet_with_their_faces(offset, gap, normal):
    """Side by side over all of their length, by the thin or by the wide side."""
    a, b = straight(offset, DOWN), straight([0.0, 0.0, 0.0], DOWN)
    room = new_meeting()
    assert meet(LAW, a, 0, b, 0, room) == pytest.approx(0.02)
    assert room.gap == pytest.approx([gap, gap], abs=1e-12)
    assert room.normal == pytest.approx(normal, abs=1e-12)


@pytest.mark.parametrize("angle_deg", [0.5, 5, 14, 16, 90])
@pytest.mark.parametrize("gap", [0.15e-3, 0.05e-3, -0.01e-3])
def test_round_wires_are_as_far_apart_as_their_axes_are(angle_deg, gap):
    """At any angle, and wherever along the elements they cross."""
    diameter = 0.5e-3
    bristle = Bristle(section=Circle(diameter))
    law = between_of(Contact(KN, 0.0, 0.0), RodSection.of(bristle))
    a, b = crossing(angle_deg, diameter + gap, at_a=0.006, at_b=0.01)
    room = new_meeting()
    assert meet(law, a, 0, b, 0, room) > 0.0
    assert room.gap.min() == pytest.approx(gap, abs=1e-9)
    assert room.normal == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("angle_deg", [10, 16, 40])
def test_rods_that_cross_in_the_plane_in_which_they_bend_meet_with_their_faces(angle_deg):
    """The normal that their axes have in common points along their wide sides, by which they are
    deep in each other. The upper end of the one that leans away is as deep in the other's face as
    it is put."""
    angle, depth = math.radians(angle_deg), 2e-6
    leans = Rotation.from_rotvec([0.0, -angle, 0.0]).as_matrix() @ DOWN
    place = [0.5 * THIN * (1.0 + math.cos(angle)) - depth, 0.0, 0.0]
    a = straight(place, leans, nodes=3)
    b = straight([0.0, 0.0, 0.01], DOWN)
    room = new_meeting()
    assert meet(LAW, a, 0, b, 0, room) > 0.0
    assert room.normal == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert room.gap.min() == pytest.approx(-depth, abs=0.5 * THIN * CORNER)


def test_rods_that_are_nowhere_beside_each_other_do_not_meet():
    room = new_meeting()
    for place in ([0.0, 1.01 * WIDE, 0.0], [0.0, 0.0, -0.021], [0.1, 0.0, 0.0]):
        a, b = straight(place, DOWN), straight([0.0, 0.0, 0.0], DOWN)
        length = meet(LAW, a, 0, b, 0, room)
        assert length == 0.0 or room.gap.min() > 0.0


def test_a_tip_that_runs_into_a_side_meets_it_with_its_end():
    flat = along([0.0, 1.0, 0.0], wide=(0.0, 0.0, 1.0))  # thin side toward the tip's axis
    turned = flat @ Rotation.from_rotvec([0.0, 0.0, 0.5 * math.pi]).as_matrix()
    apart = 0.5 * min(abs(turned[2] @ np.diag([THIN, WIDE, 0.0])).max(), WIDE)
    a = straight([0.0, 0.0, 0.02 + apart - 1e-6], DOWN)
    b = straight([0.0, -0.01, 0.0], turned)
    room = new_meeting()
    assert meet(LAW, a, 0, b, 0, room) > 0.0
    assert room.normal == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert room.gap.min() == pytest.approx(-1e-6, rel=1e-6)


def held_and_forces(a, b, elements=(0, 0)):
    """What a pair holds in J, and its forces and moments (2, 2, 6) on the nodes."""
    sides = [
        Side(i, e, pose, pose) for i, (e, pose) in enumerate(zip(elements, (a, b), strict=True))
    ]
    points, step = room_for_points(1), TouchStep(no_touch(1, 2), no_touch(1, 2), 0.0, False)
    count, lost, held = meet_pair(LAW, 0, *sides, step, points, 0)
    assert lost == 0.0
    forces = np.zeros((2, 2, 6))
    for p in range(count):
        for side, sign in enumerate((1.0, -1.0)):
            for node, share in enumerate(points.share[p, side]):
                push = sign * share * points.push[p]
                forces[side, node, :3] += push
                turning = 0.5 * sign * points.push[p]
                forces[side, node, 3:] += np.cross(points.arm[p, side], turning)
    return held, forces


def tip_beside(rng):
    """A rod whose tip comes by the middle of another at random, and which way it moves."""
    turned = Rotation.from_rotvec(0.3 * rng.normal(size=3))
    axis = rng.normal(size=3) * [1.0, 1.0, 0.1]
    lean = Rotation.from_rotvec(rng.uniform(0.02, 1.5) * axis / np.linalg.norm(axis))
    spins = [Rotation.from_rotvec([0.0, 0.0, angle]) for angle in rng.uniform(0.0, 6.28, 2)]
    lean = (turned * spins[0] * lean * spins[1]).as_matrix()
    middle = turned.apply([0.0, 0.0, rng.uniform(0.02, 0.04)])
    place = middle + 6e-4 * rng.normal(size=3) - 0.08 * lean[:, 2]
    way = rng.normal(size=3)
    tip, other = (
        straight(*each, 5, 0.08) for each in ((place, lean), (0.0 * place, turned.as_matrix()))
    )
    return tip, other, way / np.linalg.norm(way)


def test_contact_of_a_tip_begins_from_nothing():
    """Wherever it comes from: what contact holds is less than its force makes of the way. Were the
    normal that both axes have in common the only one, a fifth of these would begin 0.2 mm deep."""
    rng, step, touched = np.random.default_rng(7), 2e-5, 0
    for _ in range(20):
        tip, other, way = tip_beside(rng)
        last, push = 0.0, 0.0
        for s in np.arange(-3e-3, 3e-3, step):
            moved = Pose(tip.x + s * way, tip.q)
            each = [held_and_forces(moved, other, (e, f)) for e in range(4) for f in range(3)]
            held = sum(one for one, _ in each)
            force = sum(np.linalg.norm(two[0, :, :3].sum(axis=0)) for _, two in each)
            if s > -3e-3 and min(held, last) < 1e-5:
                assert abs(held - last) < 2.0 * max(force, push, 1.0) * step
            touched += last == 0.0 < held
            last, push = held, force
    assert touched > 10


def test_no_pair_is_nearer_than_its_list_says():
    """Whatever it is that separates them: the list of pairs is made by sections that are wider."""
    rng, room = np.random.default_rng(3), new_meeting()
    pairs, met = np.array([(0, 3, 1, f) for f in range(4)]), 0
    for _ in range(300):
        tip, other, _ = tip_beside(rng)
        stack = motion_of(2, 5, 4)
        for i, pose in enumerate((tip, other)):
            stack.x[i], stack.q[i] = pose
        gaps, closing = np.empty(4), np.empty((4, 2))
        approach(LAW, pairs, stack, np.full((2, 5), 1e-3), room, gaps, closing)
        for f, gap in enumerate(gaps):
            if meet(LAW, tip, 3, other, f, room) > 0.0:
                met += 1
                assert gap <= room.gap.min() + 1e-12
    assert met > 50


@pytest.mark.parametrize("angle_deg", [90, 35, 0])
@pytest.mark.parametrize("depth", [0.4e-6, 3e-6])
def test_forces_are_the_slope_of_the_energy(angle_deg, depth):
    """Of every displacement and rotation of a node. The stretch's length is taken as fixed, which
    is off by the depth over that length."""
    a, b = crossing(angle_deg, THIN - depth, at_a=0.008, at_b=0.0113)
    if angle_deg == 0:
        # side by side, not flush and a little twisted, with edges that are round over CORNER
        twist, s = Rotation.from_rotvec([0.0, 0.0, 0.015]).as_matrix(), math.sin(0.015)
        edge = 0.5 * WIDE * s * s / math.hypot(s, CORNER)
        a = straight([THIN + edge - depth, -0.2e-3, 0.008], twist @ DOWN)
    held, forces = held_and_forces(a, b)
    assert held > 0.0
    assert forces[0].sum(axis=0)[:3] == pytest.approx(-forces[1].sum(axis=0)[:3])
    scale = np.abs(forces[..., :3]).max()
    for side in range(2):
        for node in range(2):
            for c in range(6):
                ends = []
                step = 1e-9 if c < 3 else 1e-7
                for sign in (-1.0, 1.0):
                    x, q = (each.copy() for each in (a, b)[side])
                    if c < 3:
                        x[node, c] += sign * step
                    else:
                        turn = Rotation.from_rotvec(sign * step * np.eye(3)[c - 3])
                        own = Rotation.from_quat(q[node, [1, 2, 3, 0]])
                        q[node] = quaternion(turn * own)
                    moved = Pose(x, q)
                    ends.append(held_and_forces(*(moved, b) if side == 0 else (a, moved))[0])
                slope = -(ends[1] - ends[0]) / (2.0 * step)
                lever = 1.0 if c < 3 else WIDE
                assert forces[side, node, c] == pytest.approx(slope, abs=5e-3 * scale * lever)


def cross_bent(elements, overlap, angle_deg=90.0, steps=80):
    """The force between two clamped bristles that cross, bent by an overlap of their straight
    selves, and the distance of the crossing from each clamp."""
    at_a, at_b = 0.15, 0.4 * LENGTH
    chains = stacked([uniform_chain(SECTION, LENGTH, elements)] * 2)
    surface = obstacle_of(None, SECTION)
    scheme = scheme_of(TimeScheme.generalised(0.6), 1.0, inertia=False)
    turned = Rotation.from_rotvec([math.radians(angle_deg), 0.0, 0.0]).as_matrix() @ DOWN
    clamps = [np.array([0.0, 0.0, at_a]), np.array([-THIN, 0.0, 0.0]) - at_b * turned[:, 2]]
    path, attitudes = HubPath.still(), quaternion(Rotation.from_matrix([DOWN, turned]))
    law = Law(scheme, Hub(path.breaks, path.coefficients), surface, LAW)
    rods = ClampedRod(chains, np.zeros((2, elements + 1, 6)), np.stack(clamps), attitudes)
    stack = motion_of(2, elements + 1, len(surface.rim))
    for i, turn in enumerate((DOWN, turned)):
        now = nth(stack, i)
        now.x[:], now.q[:] = at_rest(nth(chains, i), clamps[i], turn)
        strains(nth(chains, i), now.x, now.q, now.strain)
    near = np.arange(elements)
    pairs = np.array([(0, e, 1, f) for e in near for f in near])
    room = room_for(elements + 1, len(surface.rim), 2, len(pairs))
    brush = Brush(law, rods, stack)
    group = Group(np.arange(2), pairs, no_touch(len(pairs), 2))
    done, part = 0.0, 1.0 / steps
    while done < 1.0:
        part = min(part, 1.0 - done)
        rods.place[1, 0] = -THIN + overlap * (done + part)
        if joint_step(brush, group, 0.0, room) < 0:
            part *= 0.5
            assert part > 1e-5
            continue
        done, part = done + part, min(1.5 * part, 1.0 / steps)
        write(room.new, stack)
        write(room.touch, group.touch)
    return group.touch.normal.sum(), at_a, at_b


@pytest.mark.serial
@pytest.mark.parametrize("elements", [20, 21])
def test_two_bristles_that_cross_bear_the_force_of_two_elasticas(elements):
    """Each is bent by the same force; their deflections are the overlap. Even and odd numbers of
    elements alike: crossings lie within elements, and near nodes."""
    overlap = 0.02
    force, at_a, at_b = cross_bent(elements, overlap)

    def deflections(force):
        bent = [a * cantilever(force * a**2 / SECTION.EI2_Nm2)[0] for a in (at_a, at_b)]
        return sum(bent) - overlap

    linear = 3.0 * SECTION.EI2_Nm2 * overlap / (at_a**3 + at_b**3)
    expected = brentq(deflections, 0.8 * linear, 1.3 * linear, rtol=1e-6)
    assert force == pytest.approx(expected, rel=1e-2)


def test_forces_at_points_are_those_of_each_cluster_and_of_all_as_a_sparse_matrix():
    """Three clusters, of two unknowns, of none, and of three; entries of a place are added up."""
    rng = np.random.default_rng(1)
    blocks = [np.eye(n) + 0.3 * rng.random((n, n)) for n in (2, 3)]
    whole, begins, right = block_diag(*blocks), np.array([0, 2, 2, 5]), rng.random(5)
    places = np.array(np.nonzero(whole), dtype=np.int32)
    values = whole[tuple(places)]
    twice = np.concatenate([0.4 * values, 0.6 * values]), np.tile(places, 2)
    exact = np.linalg.solve(whole, right)
    for solved in (_point_forces(*twice, right, begins), _by_scipy(*twice, right)):
        assert solved == pytest.approx(exact, rel=1e-12)
    singular = np.where((places >= 2).all(axis=0), 0.0, values)
    assert np.isnan(_by_scipy(singular, places, right)).all()
    alone = _point_forces(singular, places, right, begins)
    assert np.isfinite(alone).tolist() == [True, True, False, False, False]


def test_candidates_are_all_pairs_that_are_near():
    """By the distance of two axes as a least-squares problem; and so are those of them that are
    near within less."""
    rng, more = np.random.default_rng(3), 1e-3
    attitudes = Rotation.random(8, rng).as_matrix()
    places = rng.normal(scale=4e-3, size=(8, 1, 3))
    x = places + np.linspace(0.0, 0.02, 5)[:, None] * attitudes[:, None, :, 2]
    room, turned = np.zeros((2000, 4), dtype=np.int64), Rotation.random(rng=rng).as_matrix()
    count = candidates(LAW, x, turned, np.full((8, 5), more), 0, 1, room)
    each = room[:count].tolist()
    parts = []
    for rank in range(3):
        part = candidates(LAW, x, turned, np.full((8, 5), more), rank, 3, room)
        assert part < count
        parts += room[:part].tolist()
    assert parts == each
    apart = {}
    for a, b, e, f in itertools.product(range(8), range(8), range(4), range(4)):
        if a < b:
            sides = np.stack([x[a, e + 1] - x[a, e], x[b, f] - x[b, f + 1]], axis=1)
            found = lsq_linear(sides, x[b, f] - x[a, e], (0.0, 1.0), method="bvls", tol=1e-14)
            apart[frozenset([(a, e), (b, f)])] = math.sqrt(2.0 * found.cost)
            assert axes_apart(x[a], e, x[b], f) == pytest.approx(math.sqrt(2.0 * found.cost))
    for pairs, reach in ((each, more), (near(LAW, np.array(each), x, np.zeros((8, 5))), 0.0)):
        within = math.hypot(THIN, WIDE) + 2.0 * reach
        meet = {pair for pair, distance in apart.items() if distance <= within}
        found = [frozenset([(a, e), (b, f)]) for a, e, b, f in pairs]
        assert set(found) == meet
        assert 3 < len(meet) < len(apart) / 2
        # two tips are met from both sides, and one by its own rod's side
        assert len(found) == len(meet) + sum(all(e == 3 for _, e in pair) for pair in meet)
        assert all(f != 3 or e == 3 for _, e, _, f in pairs)


@pytest.mark.parametrize(("gap_m", "closes_m_s", "met"), [(6e-5, 1.0, False), (1e-5, -15.0, True)])
def test_pairs_that_meet_and_part_within_a_span_are_found(gap_m, closes_m_s, met):
    """Two that close at 1 m/s from 0.1 mm are apart after 0.04 ms. Where they part at 15 m/s then,
    the cubic through gaps and speeds is below zero meanwhile: by 0.025 mm in the middle."""
    near, still, span_s = Neighbours(LAW), HubPath.still().pose(0.0), 4e-5
    stack = motion_of(2, 3, 4)
    for i in range(2):
        stack.x[i], stack.q[i] = straight([-i * (THIN + 1e-4), 0.0, 0.1], DOWN, 3)
    stack.velocity[0, :, 0] = -1.0
    near.search(stack, still, span_s)
    before = near.checkpoint()
    assert near.span_s == span_s
    assert len(near.pairs) == 0
    stack.x[0, :, 0] = gap_m - 1e-4
    stack.velocity[0, :, 0] = -closes_m_s
    assert not near.outran(stack, still)
    missed = near.missed(stack, span_s)
    assert (len(missed) > 0) == met
    assert near.add(missed, before, 2).all() == met
    assert len(near.pairs) == len(missed)


@pytest.mark.parametrize("ranks", [1, 2, 5])
def test_every_rod_has_one_rank(ranks):
    of = np.array([0, 0, 1, 2, 2, 2, 3])
    groups = [Linked(np.flatnonzero(of == g), np.zeros(0, int)) for g in (0, 2)]
    holder, cost = np.arange(7) * ranks // 7, np.array([1.0, 1.0, 3.0, 1.0, 1.0, 1.0, 2.0])
    who = shared_out(groups, holder, cost, ranks)
    assert 0 <= who.min() <= who.max() < ranks
    assert all(len(set(who[group.members])) == 1 for group in groups)
    # nobody has more than a share and what comes on top of it: of groups by their members, and of
    # all, with those counted as `GROUPED` rods of mean cost
    grouped = np.array([True, True, False, True, True, True, False])
    assert np.bincount(who[grouped]).max() <= 5 / ranks + 3
    cost[grouped] = GROUPED * cost.mean()
    assert np.bincount(who, cost).max() <= cost.sum() / ranks + 3.0 * cost.max()
    assert np.array_equal(shared_out([], holder, np.full(7, 1e-3), ranks), holder)


def row(count=4, spacing=0.8e-3, comm=MPI.COMM_WORLD, elements=8, kn=KN, **how):
    """Bristles one behind the other, which touch once they are pressed down and dragged."""
    lean = math.radians(20)
    leans = lean + 5e-4 * np.cos(2.0 * np.arange(count))
    places = np.zeros((count, 3))
    places[:, 0] = spacing * np.arange(count)
    places[:, 2] = LENGTH * math.cos(lean) + 3e-3
    clamps = Clamps(places, np.stack([leaning(each) for each in leans]), np.full(count, LENGTH))
    path, ground = slide(0.02, 0.5, 0.01, 0.01), Ground(kn, 0.3, 0.3)
    between = Contact(kn, 0.2, 0.25, 0.1)
    return Rods(SECTION, clamps, path, ground, elements, between=between, comm=comm, **how)


def test_a_row_that_touches_is_the_same_on_any_number_of_ranks_and_closes_its_energy():
    """Hub's work is stored, kinetic and lost energy to 1e-3; bristles do not pass through each
    other."""
    # so near that frames, which are instants, show them touch
    one = list(row(spacing=0.7e-3, comm=MPI.COMM_SELF).march(0.015, 2e-4))
    every = list(row(spacing=0.7e-3).march(0.015, 2e-4))
    assert max(frame.between_N.max() for frame in one) > 0.0
    for a, b in zip(one, every, strict=True):
        for name in ("force_N", "centre_m", "state", "between_N"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name
        assert a.energy == b.energy
        assert np.array_equal(a.means.force_N, b.means.force_N)
    assert one[-1].energy.closure_relative < 1e-3
    none_went_through(one)


def test_bristles_that_change_their_rank_are_the_same(monkeypatch):
    brought, kept = [], Rods._bring

    def bring(self, who, sums):
        brought.append(np.count_nonzero((who >= 0) & (who != self._holder)))
        return kept(self, who, sums)

    monkeypatch.setattr(Rods, "_bring", bring)
    (one,) = row(9, 0.7e-3, MPI.COMM_SELF).march(0.01, 0.01)
    assert sum(brought) == 0
    (every,) = row(9, 0.7e-3).march(0.01, 0.01)
    assert (sum(brought) > 0) == (MPI.COMM_WORLD.size > 1)
    assert np.array_equal(one.centre_m, every.centre_m)
    assert one.energy == every.energy
    assert np.array_equal(one.means.force_N, every.means.force_N)
    assert np.array_equal(one.greatest_stress_Pa, every.greatest_stress_Pa)


def none_went_through(frames):
    """Bristles of a row stand in their order, wherever they are as high as each other."""
    for frame in frames:
        for front, behind in zip(frame.centre_m[1:], frame.centre_m[:-1], strict=True):
            height = np.linspace(max(front[-1, 2], behind[-1, 2]), front[0, 2], 50)
            gap = np.interp(height, front[::-1, 2], front[::-1, 0])
            gap -= np.interp(height, behind[::-1, 2], behind[::-1, 0])
            assert gap.min() > 0.8 * THIN


def test_a_row_of_rigid_contacts_closes_its_energy():
    kn = SECTION.rigid_N_m(LENGTH / 8)
    # they touch so shortly that frames, which are instants, seldom show it
    frames = list(row(3, 0.6e-3, MPI.COMM_SELF, kn=kn).march(0.01, 5e-5))
    assert max(frame.between_N.max() for frame in frames) > 0.0
    assert frames[-1].energy.closure_relative < 1e-2
    none_went_through(frames)


def test_a_row_that_touches_goes_on_from_a_checkpoint_to_the_bit():
    through, first, second = row(), row(), row()
    expected = list(through.march(0.02, 0.01))[-1]
    list(first.march(0.01, 0.01))
    kept = {name: np.array(each) for name, each in first.checkpoint().items()}
    second.restore(kept)
    assert second.t_s == first.t_s
    (found,) = second.march(0.02, 0.01)
    assert found.t_s == expected.t_s
    names = ("force_N", "torque_Nm", "centre_m", "rotation", "tip_normal_N", "state", "between_N")
    for name in names:
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    assert found.energy == expected.energy
    with pytest.raises(InputError, match="checkpoint"):
        row(3).restore(kept)


def test_bristles_that_begin_in_each_other_are_refused():
    with pytest.raises(InputError, match="begin in each other"):
        row(spacing=0.5 * THIN)


@pytest.mark.campaign
@pytest.mark.serial
@pytest.mark.parametrize("count", [60, 200, 1000])
def test_long_rows_converge(count):
    """Bristles that touch all along the row, over the time of pressing and of setting off."""
    rods = row(count, comm=MPI.COMM_SELF, elements=20)
    frames = list(rods.march(0.1 if count == 60 else 0.02, 0.01))
    assert frames[-1].energy.closure_relative < 1e-2
    assert (frames[-1].between_N > 0.0).any() or (frames[-2].between_N > 0.0).any()


def test_rough_faces_grow_as_stiff_as_they_are():
    """Force and slope are continuous where the quadratic law passes into the linear one. Elements
    with a tip each are met from both sides, and this is one of them."""
    forces = []
    for depth in (0.999 * ROUGH_M, 1.001 * ROUGH_M):
        a, b = crossing(90, THIN - depth)
        forces.append(held_and_forces(a, b)[1][0, :, 0].sum())
    assert forces[1] - forces[0] == pytest.approx(0.5 * KN * 0.002 * ROUGH_M, rel=1e-3)
    assert forces[0] == pytest.approx(0.25 * KN * ROUGH_M, rel=3e-3)
