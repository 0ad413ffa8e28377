"""Bristles clamped in a moving hub over a plane, with mutual contact, on many ranks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from mpi4py import MPI

from .. import paper
from ..arrays import Array, Flags, Integers
from ..bristle import positive
from ..compiled import nth
from ..errors import BristleError, ComputationError, InputError, require
from ..rigid import matrix_of
from ..time.scheme import TimeScheme
from . import motion as rows
from .chain import at_rest, stacked, uniform_chain
from .contact import Touch, obstacle_of
from .element import strains
from .frame import Frame, RodEnergy
from .ground import Contact, Ground
from .hub import Clamps, HubPath
from .joint import Brush, Group, room_for
from .march import march
from .motion import ClampedRod, Hub, Motion, motion_of, scheme_of
from .neighbours import Linked, Neighbours, alone, put, shared_out
from .observe import POTENTIAL, Seen, clearance, observe
from .pairs import between_of
from .section import RodSection
from .settle import settle
from .step import Law
from .tally import COLUMNS, Means, Windows

# Spectral radius of generalised-alpha at infinite frequency.
RHO_INFINITY = 0.6
# Allowed error of a step over a bristle's length.
TOLERANCE = 1e-6
FIRST_STEP_S = 1e-5
# No wire is straighter than this. A perfect one would be compressed instead of buckling.
BOW_RAD = 1e-4
# Instants at which a march checks in advance that the hub takes no clamp into the surface.
LOOKS = 500
# Forces are averaged over windows of time no longer than this.
WINDOW_S = 1e-3
# Longest and shortest span of time between searches for pairs.
LONGEST_S, SHORTEST_S = 1e-3, 1e-7
# A tip may start this share of its length below the surface: it hangs by its weight.
TOUCHING = 1e-6


class Rods:
    """Bristles of one section, clamped in a moving hub, over a plane.

    A bristle that touches no other has time steps of its own; those that may touch each other share
    their steps. Every rank knows the positions of all bristles and marches some of them. The result
    does not depend on the number of ranks.

    Parameters
    ----------
    section, clamps : the bristles' properties, and where they are clamped
    motion : the hub's; at its start the bristles move with it, hanging in equilibrium
    ground : the plane, or None
    between : the contact of bristles with each other, or None if they pass through each other
    elements : of each bristle
    bow_rad : angle by which the tip of an unloaded bristle points off its axis, toward its thin
        side; with it a bristle that is pressed upright buckles
    gravity_m_s2 : downward
    tolerance : the allowed error of a time step over a bristle's length
    rho_infinity : the share of a wave that remains after a step far too long for it, 0 to 1
    comm : ranks that share the bristles

    Raises
    ------
    InputError : a number is out of range, or a bristle starts below the surface or inside another
    ComputationError : a bristle finds no equilibrium under its own weight
    """

    def __init__(
        self,
        section: RodSection,
        clamps: Clamps,
        motion: HubPath,
        ground: Ground | None,
        elements: int = 20,
        *,
        between: Contact | None = None,
        gravity_m_s2: float = paper.GRAVITY_M_S2,
        bow_rad: float = BOW_RAD,
        tolerance: float = TOLERANCE,
        rho_infinity: float = RHO_INFINITY,
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ) -> None:
        if elements < 1:
            raise InputError(f"a rod needs at least one element, not {elements}")
        for name, value in (("gravity", gravity_m_s2), ("the bow", bow_rad)):
            if not math.isfinite(value):
                raise InputError(f"{name} must be finite, not {value}")
        positive("the tolerance of a step", tolerance)
        self.section, self.clamps, self.motion, self.ground = section, clamps, motion, ground
        self.comm, self.elements = comm, elements
        # Which rank marched each rod last, and how many steps and iterations its last span took.
        # Neighbours touch down together, so they start on different ranks.
        self._holder = np.arange(len(clamps)) % comm.size
        self._cost: Array = np.ones(len(clamps))
        self._gravity = np.array([0.0, 0.0, -gravity_m_s2])
        scale_m, path = float(clamps.length_m.min()), (motion.breaks, motion.coefficients)
        law = Law(
            scheme_of(TimeScheme.generalised(rho_infinity), tolerance * scale_m),
            Hub(*(np.ascontiguousarray(each, dtype=float) for each in path)),
            obstacle_of(ground, section),
            between_of(between or Contact(), section),
        )
        self._neighbours = Neighbours(law.between, comm) if between is not None else None
        # groups of the same size recur every few spans
        self._room_for = lru_cache(maxsize=16)(partial(room_for, elements + 1, len(section.rim_m)))
        self._now = motion_of(len(clamps), elements + 1, len(section.rim_m))
        self._brush, self._t_s = Brush(law, self._clamped(bow_rad), self._now), 0.0
        self._refuse_below(np.zeros(1))
        wrong: BristleError | None = None
        for i in self._held():
            try:
                self._begin(int(i))
            except BristleError as error:
                wrong = error
                break
        # all ranks raise the first rank's error
        for found in comm.allgather(wrong):
            if found is not None:
                raise found
        self._tell_all()
        if self._neighbours is not None:
            self._neighbours.search(self._now, self.motion.pose(0.0), LONGEST_S)
            for a, _, b, _ in self._neighbours.begun_in_each_other():
                raise InputError(f"bristles {a} and {b} begin in each other; space them")
        self._means = Means.none()
        first = self._observed().energy
        self._initial_J = float(first[:, 1:3].sum() + first[:, 4].sum())
        self._datum_J = float(first[:, POTENTIAL].sum())

    @property
    def t_s(self) -> float:
        """Time of the latest frame in s."""
        return self._t_s

    def march(self, until_s: float, every_s: float) -> Iterator[Frame]:
        """Frames at multiples of ``every_s`` up to ``until_s``, after the present one; collective.

        Raises
        ------
        InputError : a number is not positive, or the hub takes a clamp below the surface
        ComputationError : a bristle's step fails however short it is
        """
        positive("the end of the march", until_s)
        positive("the time between frames", every_s)
        self._refuse_below(np.linspace(self.t_s, until_s, LOOKS))
        count = math.floor(self.t_s / every_s + 1e-9) + 1
        while self.t_s < until_s:
            end_s = min(count * every_s, until_s)
            self.advance(end_s, math.ceil((end_s - self.t_s) / WINDOW_S * (1.0 - 1e-9)))
            yield self.frame()
            count += 1

    def advance(self, end_s: float, windows: int = 1) -> None:
        """March every bristle to ``end_s``, with means over this many ``windows``; collective.
        Raises ComputationError as `march`."""
        begin_s, sums = self.t_s, np.zeros((len(self.clamps), windows, COLUMNS))
        self._now.totals[:, rows.STRESS] = 0.0
        width_s = (end_s - begin_s) / windows
        while self.t_s < end_s:
            self._advance(end_s, Windows(begin_s, width_s, sums))
        self._tell(([sums], self._held()))
        self._means = Means.of(begin_s, end_s, sums.sum(axis=0), len(self.clamps))

    def _advance(self, end_s: float, windows: Windows) -> None:
        """March every bristle to ``end_s``, or as far as the list of neighbours is valid."""
        near = self._neighbours
        if near is None:
            self._refuse_failure(self._march_apart(self._held(), end_s, windows))
            self._t_s = end_s
            return
        pose, before, longest = self.motion.pose(self.t_s), near.checkpoint(), LONGEST_S
        own = [*_arrays(self._now), windows.sums, self._holder]
        kept, done = [each.copy() for each in own], self._done()
        everyone: Flags = np.ones(len(self.clamps), dtype=np.bool_)
        again = everyone
        near.search(self._now, pose, longest)
        while True:
            until = end_s if self.t_s + 1.01 * near.span_s > end_s else self.t_s + near.span_s
            self._march_span(until, windows, again)
            if near.outran(self._now, self.motion.pose(until)):
                longest, again = 0.5 * (until - self.t_s), everyone
                if longest < SHORTEST_S:
                    raise ComputationError(
                        f"bristles are thrown too far at {until:.6g} s; take a lower tolerance"
                    )
                put(own, again, [each[again] for each in kept])
                near.restore(before)
                near.search(self._now, pose, longest)
                continue
            missed = near.missed(self._now, until - self.t_s)
            if not len(missed):
                break
            again = near.add(missed, before, len(self.clamps))
            put(own, again, [each[again] for each in kept])
        self._cost = 1.0 + self._done() - done
        self._t_s = until

    def _done(self) -> Array:
        """Steps and iterations of each rod (rods,) so far."""
        return np.asarray(self._now.totals[:, [rows.STEPS, rows.ITERATIONS]].sum(axis=1))

    def _march_span(self, until: float, windows: Windows, those: Flags) -> None:
        """March the rods ``those`` (rods,), and groups that they form, to the end of a span."""
        now, near = self._now, self._neighbours
        assert near is not None
        groups, _ = near.groups(len(self.clamps))
        lone = alone(groups, len(self.clamps))
        rank, cost = self.comm.rank, np.where(those, self._cost, 0.0)
        who = shared_out(groups, self._holder, cost, self.comm.size)
        groups = [group for group in groups if those[group.members[0]]]
        self._bring(np.where(those, who, -1), windows.sums)
        mine = those & (who == rank)
        failed = self._march_apart(np.flatnonzero(mine & lone), until, windows)
        touched: list[Integers] = [np.zeros(0, dtype=np.int64)]
        for group in groups:
            if mine[group.members[0]]:
                if failed < 0:
                    failed = self._march_group(group, until, windows)
                touched.append(group.rows)
        # Only the next search's data; `_bring`, `_tell_all` and `_observed` send the rest.
        moved = now.x, now.q, now.velocity, now.totals
        self._tell((moved, np.flatnonzero(mine)), (near.touch, np.concatenate(touched)))
        self._holder[those] = who[those]
        self._refuse_failure(failed)

    def _march_apart(self, members: Integers, end_s: float, windows: Windows) -> int:
        room = self._room_for(1, 0)
        return march(self._brush, Group.apart(members), 1, end_s, windows, room)

    def _march_group(self, linked: Linked, end_s: float, windows: Windows) -> int:
        assert self._neighbours is not None
        group, count = self._neighbours.group(linked), len(linked.members)
        # a power of two, so that few work spaces serve all
        room = self._room_for(count, 1 << (len(group.pairs) - 1).bit_length())
        failed = march(self._brush, group, count, end_s, windows, room)
        put(self._neighbours.touch, linked.rows, group.touch)
        return failed

    def _refuse_failure(self, failed: int) -> None:
        """Raise ComputationError on every rank if a bristle of any rank failed."""
        message = ""
        if failed >= 0:
            at, step = self._now.totals[failed, [rows.TIME, rows.STEP]]
            message = (
                f"bristle {failed} does not converge at {at:.6g} s with a step of "
                f"{step:.3g} s; try more elements, a slower motion, or a lower Kn, a finite one if "
                "it is infinite"
            )
        require(self.comm, failed < 0, message)

    def _bring(self, who: Integers, sums: Array) -> None:
        """Send each rod's whole state and ``sums`` to the rank ``who`` (rods,) that will march it,
        -1 for none; collective."""
        moves = (who >= 0) & (who != self._holder)
        if not moves.any():
            return
        arrays, mine = [*_arrays(self._now), sums], moves & (self._holder == self.comm.rank)
        each = [np.flatnonzero(mine & (who == rank)) for rank in range(self.comm.size)]
        sent = [(those, [array[those] for array in arrays]) for those in each]
        for those, values in self.comm.alltoall(sent):
            put(arrays, those, values)

    def _tell_all(self) -> None:
        """Send the whole state of all rods to every rank; collective."""
        self._tell((_arrays(self._now), self._held()))

    def _held(self) -> Integers:
        """The rods that this rank marched last."""
        return np.flatnonzero(self._holder == self.comm.rank)

    def _tell(self, *parts: tuple[Sequence[Array], Integers]) -> None:
        """Send this rank's rows of arrays to every rank; collective."""
        if self.comm.size > 1:
            mine = [(those, [array[those] for array in arrays]) for arrays, those in parts]
            for theirs in self.comm.allgather(mine):
                for (arrays, _), (those, values) in zip(parts, theirs, strict=True):
                    put(arrays, those, values)

    def frame(self) -> Frame:
        """The present state of all bristles; collective."""
        seen, near = self._observed(), self._neighbours
        pose = self.motion.pose(self.t_s)
        force = -seen.reaction[:, :3]
        arms = seen.x[:, 0] - pose.position_m
        torque = -seen.reaction[:, 3:] + np.cross(arms, force)
        total = seen.energy.sum(axis=0)
        total[POTENTIAL] -= self._datum_J
        stress = self.section.bending_stress_Pa(seen.moment)
        return Frame(
            t_s=self.t_s,
            force_N=force.sum(axis=0),
            torque_Nm=torque.sum(axis=0),
            tip_m=seen.x[:, -1],
            tip_normal_N=seen.surface[:, 0],
            tip_friction_N=seen.surface[:, 1],
            between_N=np.zeros(len(arms)) if near is None else near.normal_N(len(arms)),
            state=seen.surface[:, 2].astype(np.int8),
            centre_m=seen.x,
            rotation=seen.q,
            bending_stress_Pa=stress,
            greatest_stress_Pa=np.maximum(stress.max(axis=1), seen.stress),
            energy=RodEnergy(self._initial_J, *total[:-1].tolist()),
            steps=int(total[-1]),
            means=self._means,
        )

    def checkpoint(self) -> dict[str, Array]:
        """The state of all bristles that the next step needs, on every rank; collective."""
        self._tell_all()
        kept = dict(zip(NAMES, _arrays(self._now), strict=True))
        kept["energy_at_start_J"] = np.array([self._initial_J, self._datum_J])
        kept["time_s"] = np.array(self.t_s)
        return kept | (self._neighbours.checkpoint() if self._neighbours is not None else {})

    def restore(self, kept: Mapping[str, Array]) -> None:
        """Return to a `checkpoint`, bit for bit, on any number of ranks.

        Raises InputError if it does not hold as many bristles and elements.
        """
        for name, mine in zip(NAMES, _arrays(self._now), strict=True):
            if name not in kept or kept[name].shape != mine.shape:
                raise InputError(f"the checkpoint is not one of {len(self.clamps)} such bristles")
            mine[:] = kept[name]
        if self._neighbours is not None:
            if "pairs" not in kept:
                raise InputError("the checkpoint is of bristles that do not touch each other")
            self._neighbours.restore(kept)
        self._t_s = float(kept["time_s"])
        self._initial_J, self._datum_J = map(float, kept["energy_at_start_J"])
        self._means = Means.none()

    # --- start ------------------------------------------------------------------------------------

    def _clamped(self, bow_rad: float) -> ClampedRod:
        """All bristles with their weight, stacked."""
        from scipy.spatial.transform import Rotation

        chains = stacked(
            [
                uniform_chain(_bowed(self.section, bow_rad / length), length, self.elements)
                for length in self.clamps.length_m
            ]
        )
        loads = np.zeros((*chains.mass.shape, 6))
        loads[..., :3] = chains.mass[..., None] * self._gravity
        turned = Rotation.from_matrix(self.clamps.rotation).as_quat()
        attitude = np.ascontiguousarray(turned[:, [3, 0, 1, 2]])
        return ClampedRod(chains, loads, self.clamps.position_m, attitude)

    def _begin(self, i: int) -> None:
        """Bring bristle ``i`` into equilibrium under its weight, moving with the hub.

        Raises InputError if it starts in the surface when unstrained.
        """
        chain, now = nth(self._brush.rods.chain, i), nth(self._now, i)
        pose = self.motion.pose(0.0)
        place = pose.position_m + pose.rotation @ self.clamps.position_m[i]
        now.x[:], now.q[:] = at_rest(chain, place, pose.rotation @ self.clamps.rotation[i])
        strains(chain, now.x, now.q, now.strain)
        gap = float(clearance(self._brush.law.surface, now))
        if gap < -TOUCHING * self.clamps.length_m[i]:
            raise InputError(
                f"bristle {i} begins {-gap:.3g} m below the surface; raise the hub, or press it "
                "down from first touch"
            )
        if not settle(self._brush, i, self._room_for(1, 0)):
            raise ComputationError(
                f"bristle {i} finds no equilibrium under its weight; try more elements"
            )
        spin = pose.angular_velocity_rad_s
        now.velocity[:, :3] = pose.velocity_m_s + np.cross(spin, now.x - pose.position_m)
        now.totals[rows.STEP] = FIRST_STEP_S
        now.velocity[:, 3:] = [matrix_of(each).T @ spin for each in now.q]

    def _refuse_below(self, times_s: Array) -> None:
        if self.ground is None:
            return
        for t in times_s:
            pose = self.motion.pose(float(t))
            places = pose.position_m + self.clamps.position_m @ pose.rotation.T
            gaps = self.ground.gaps_m(places)
            if gaps.min() <= 0.0:
                raise InputError(
                    f"the clamp of bristle {gaps.argmin()} is {-gaps.min():.3g} m below the "
                    f"surface at {t:.4g} s; the hub is pressed too far down, or begins too low"
                )

    def _observed(self) -> Seen:
        """Output of all rods, gathered from the ranks that hold them; collective."""
        mine = self._held()
        seen = observe(self._brush.rods.chain, self._gravity, self._now, mine)
        whole = Seen(*(np.empty((len(self.clamps), *each.shape[1:])) for each in seen))
        put(whole, mine, seen)
        self._tell((whole, mine))
        return whole


# Names of a state's arrays, those of its contact points last.
NAMES = (*Motion._fields[:-1], *Touch._fields)


def _arrays(state: Motion) -> list[Array]:
    """The arrays of a state, ordered as `NAMES`."""
    return [*state[:-1], *state.touch]


def _bowed(section: RodSection, curvature_1_m: float) -> RodSection:
    """The section with this natural curvature about the wide side added."""
    about_1, about_2, twist = section.curvature_1_m
    return replace(section, curvature_1_m=(about_1, about_2 + curvature_1_m, twist))
