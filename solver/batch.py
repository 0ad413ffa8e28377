"""Many drops of one body in compiled code: as `drop.simulate`, without histories.

For bodies in modes under the conserving scheme and a law that acts on gaps. Each drop has its own
lean, height, ground, stiffness and friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .bodies.base import ContactPoints
from .bodies.modal import ModalBody
from .compiled import meanwhile, njit, unowned
from .contact.points import Points, changed
from .contact_phase import STAYING, STEP_LIMIT
from .drop import TOUCH_LIMIT, WAIT_STEPS, slowest_period_s
from .energy import ASTRAY
from .errors import ComputationError
from .ground import local_frames, touched_offsets
from .impact import compiled, gain_allowed
from .rigid import leaning, matrix_of
from .time import modal_march
from .time.flight import Sky, energies, fly
from .time.march import Marcher
from .time.modal_march import MarchLimits, Modes, Touching, march
from .time.motion import Flyer, Stance, centre, flyer, landing, turned

TOO_MANY, FALLEN, GAINED, OFF_BUDGET = 5, 6, 7, 8
# Contact that lasts longer than this, in s and in radians of the mass on its spring, counts as
# permanent. A bristle that leans by more than 6 degrees slides on for up to a period of its slowest
# bending. Contact with a law that pulls, and with a linear spring and friction, counts as permanent
# after the radians of the spring or of the slowest axial wave with the tip held, whichever is
# later.
LONGEST_S, LONGEST_RAD = 0.004, 20.0
FAILURES = {
    modal_march.NOT_CONVERGED: "the contact forces did not converge; shorten the ITS",
    modal_march.NOT_FINITE: "the motion is not finite; shorten the ITS",
    modal_march.TOO_LONG: "in contact for more steps than a touch takes; adhesion may hold it",
    FALLEN: "the bristle falls over, onto its side or upper end, which cannot touch here",
    GAINED: "friction or the contact law gave energy, where they can only take",
    OFF_BUDGET: f"the energy budget is off by more than {ASTRAY:g} times the impact's energy; "
    "shorten the ITS or lean it less",
    TOO_MANY: f"more than {TOUCH_LIMIT} touches in one impact; shorten the ITS",
}


# Shares of the ITS that are tried if contact forces do not converge.
SHORTER = (0.5, 0.2)
# Relative size of a motion that counts as rounding.
ROUNDING = 1e-12
# Axes along which the ground can push all points of an end section alike: along an upright bristle
# on a level surface, or in the plane of symmetry in which the bristle leans or the surface slopes.
COLUMN, PLANES = (2,), ((0, 2), (1, 2))


@dataclass(frozen=True)
class Drops:
    """The inputs in which drops differ, with one entry (or row) per drop.

    ``normals`` (drops, points, 3) and ``rises_m`` (drops, points) are the ground's planes under the
    tip. Each passes through the place over or under its point of the end section where the ground
    is ``rises_m`` above its mean; for a slope these are the slope's own heights. The ground is then
    moved until the first point touches. ``scale`` (drops, points) is the local stiffness over
    ``kn_N_m``. ``laws`` (drops, parameters), if given, holds the contact law's other parameters in
    the order of `ContactLaw.parameters`, ``damping`` (drops,) its `ContactLaw.damping`.
    """

    height_m: Array
    tilt_deg: Array
    tilt_wide_deg: Array
    kn_N_m: Array
    mu: Array
    normals: Array
    rises_m: Array
    scale: Array
    laws: Array | None = None
    damping: Array | None = None

    def __len__(self) -> int:
        return len(self.height_m)

    def part(self, first: int, last: int) -> Drops:
        """Drops ``first`` to ``last`` - 1."""
        which = np.zeros(len(self), dtype=bool)
        which[first:last] = True
        return self.chosen(which)

    def chosen(self, which: NDArray[np.bool_], points: NDArray[np.int64] | None = None) -> Drops:
        """The drops ``which`` (drops,) with all their points, or with these ``points`` only."""
        some = np.arange(self.scale.shape[1]) if points is None else points
        return Drops(
            self.height_m[which],
            self.tilt_deg[which],
            self.tilt_wide_deg[which],
            self.kn_N_m[which],
            self.mu[which],
            self.normals[which][:, some],
            self.rises_m[which][:, some],
            self.scale[which][:, some],
            None if self.laws is None else self.laws[which],
            None if self.damping is None else self.damping[which],
        )

    def confined_to(self, part: SymmetricPart) -> NDArray[np.bool_]:
        """Which drops (drops,) load a section along a ``part``'s axes alone, and its groups
        equally."""
        across = [axis for axis in (0, 1) if axis not in part.axes]
        tilts = np.stack([self.tilt_deg, self.tilt_wide_deg], axis=1)
        still = (tilts[:, across] == 0.0).all(axis=1)
        level = (np.abs(self.normals[:, :, across]) <= ROUNDING).all(axis=(1, 2))
        first = part.points[part.group]
        uneven = np.abs(self.rises_m - self.rises_m[:, first]).max(axis=1)
        alike = (self.scale == self.scale[:, first]).all(axis=1)
        return still & level & alike & (uneven <= ROUNDING * part.size_m)

    @classmethod
    def on_plane(
        cls,
        n_points: int,
        *,
        height_m: Array | float,
        kn_N_m: Array | float,
        tilt_deg: Array | float = 0.0,
        tilt_wide_deg: Array | float = 0.0,
        mu: Array | float = 0.0,
    ) -> Drops:
        """Drops onto a horizontal plane; numbers apply to all, arrays (drops,) to one drop each."""
        values = np.broadcast_arrays(height_m, tilt_deg, tilt_wide_deg, kn_N_m, mu)
        columns = [np.array(value, dtype=float).reshape(-1) for value in values]
        n = len(columns[0])
        normals = np.zeros((n, n_points, 3))
        normals[..., 2] = 1.0
        height, tilt, tilt_wide, kn, friction = columns
        rises, scale = np.zeros((n, n_points)), np.ones((n, n_points))
        return cls(height, tilt, tilt_wide, kn, friction, normals, rises, scale)


class Outcome(NamedTuple):
    """Result of one drop, or arrays of results: names and units of `drop.DropResult` and its
    energy.

    Losses are those up to the last release of the first impact, as with `DropPlan.impact_only`: the
    flight that follows is not included.
    """

    rebound_height_m: Array
    cm_rebound_height_m: Array
    cm_velocity_after_m_s: Array
    contact_time_s: Array
    n_contacts: Array
    peak_force_N: Array
    impulse_N_s: Array
    spin_x_rad_s: Array
    spin_y_rad_s: Array
    spin_z_rad_s: Array
    material_loss_J: Array
    friction_loss_J: Array
    contact_loss_J: Array
    closure_relative: Array
    n_steps: Array


class Common(NamedTuple):
    """What all drops share; any contact is followed for at least ``followed_s``."""

    modes: Modes
    flyer: Flyer
    sky: Sky
    points: Points
    kt_over_kn: float
    followed_s: float


class Columns(NamedTuple):
    """The inputs in which drops differ, one row per drop: see `Drops`."""

    laws: Array
    damping: Array
    mu: Array
    tilt: Array
    tilt_wide: Array
    height: Array
    normals: Array
    rises: Array
    scale: Array


@njit
def one_drop(common: Common, points: Points, columns: Columns, which: int, out: Array) -> int:
    """Write the result of drop ``which`` to ``out``, ordered as `Outcome`; returns the status."""
    modes, flyer, sky = common.modes, common.flyer, common.sky
    places, gravity, height = flyer.points.places, sky.gravity, columns.height[which]
    normals, rises = columns.normals[which], columns.rises[which]
    attitude = leaning(columns.tilt[which], columns.tilt_wide[which])
    pose = Stance(np.zeros(3), attitude, np.zeros(0), np.zeros(0))
    rotation = matrix_of(pose.attitude)
    # the plane under a point is that of a flat ground, raised
    offsets: Array = np.empty(len(places))
    for i in range(len(places)):
        at = rotation @ places[i]
        offsets[i] = normals[i, 0] * at[0] + normals[i, 1] * at[1] + normals[i, 2] * rises[i]
    offsets = touched_offsets(normals, offsets, rotation, places)
    datum = rotation[2] @ flyer.tip.places[0]
    u: Array = np.zeros(len(modes.omega2))
    v: Array = flyer.translation @ (-math.sqrt(2.0 * gravity * height) * rotation[2])
    initial = modes.mass * gravity * height
    longest = max(common.followed_s, LONGEST_RAD * math.sqrt(modes.mass / points.law[0]))
    limit = STEP_LIMIT // STAYING if points.kind.remembers else STEP_LIMIT
    limit = min(limit, int(longest / modes.its) + 1)
    lost, impulse, peak, first, last = np.zeros(3), 0.0, 0.0, -1.0, 0.0
    top, centre_top, now, wait, touches, steps = -math.inf, -math.inf, 0.0, 0.0, 0, 0
    memory: Array = np.zeros(len(places))
    frames, gaps = local_frames(normals, offsets, pose.position, rotation, places)
    for _ in range(TOUCH_LIMIT):
        if frames[:, 0, 2].min() <= 0.0:
            return FALLEN
        touching = Touching(points, frames, gaps, rotation[2].copy(), 0.0, 0.0, gravity)
        limits = MarchLimits(max(wait - now, 0.0), math.inf, limit - steps, False)
        done = march(modes, touching, u, v, memory, limits)
        if done.status != modal_march.RELEASED:
            return done.status
        steps, memory = steps + done.steps, done.memory[:, 2].copy()
        lost += np.array([done.material_loss, done.friction_loss, done.contact_loss])
        if done.impulse != 0.0:
            touches, impulse, peak = touches + 1, impulse + done.impulse, max(peak, done.peak)
            first, last = now if first < 0.0 else first, now + done.release
        now += done.steps * modes.its
        start = Stance(pose.position, pose.attitude, done.u, done.v)
        flown = fly(flyer, normals, offsets, start, sky, (1.0 + ASTRAY) * initial - lost.sum())
        before = energies(flown.motion, 0.0)
        closure = abs(initial - before.total - lost.sum())
        if flown.astray or not closure <= ASTRAY * initial:
            return OFF_BUDGET
        if flown.soon:
            u, v, wait = done.u, done.v, now + flown.next
            continue
        top, centre_top = max(top, flown.tip_m - datum), max(centre_top, flown.centre_m)
        if flown.over:
            break
        pose = landing(flown.motion, flown.next)
        u, v = pose.u, pose.v
        after = energies(flown.motion, flown.next)
        lost[0] += before.total - after.total
        now += flown.next
        wait, rotation = now, matrix_of(pose.attitude)
        frames, gaps = local_frames(normals, offsets, pose.position, rotation, places)
    else:
        return TOO_MANY
    out[0], out[1] = top, centre_top
    out[2] = centre(flown.motion, last - now)[1][2]
    out[3], out[4], out[5], out[6] = last - first, touches, peak, impulse
    out[7:10] = turned(flown.motion, last - now)[1]
    out[10:13] = lost
    out[13], out[14] = closure / initial, steps
    return modal_march.RELEASED


@njit
def many_drops(common: Common, columns: Columns, out: Array, status: NDArray[np.int64]) -> None:
    """`one_drop` for every row; writes ``out`` (drops, …) and ``status`` (drops,)."""
    common, columns = unowned(common), unowned(columns)
    points = common.points
    for i in range(len(columns.height)):
        law, dashpot = columns.laws[i], columns.damping[i] / common.modes.its
        kt, mu, scale = common.kt_over_kn * law[0], columns.mu[i], columns.scale[i]
        own = changed(points, law, kt, mu, scale, points.proximal, dashpot)
        status[i] = one_drop(common, own, columns, i, out[i])


def drop_many(marcher: Marcher, drops: Drops) -> Outcome:
    """Simulate all ``drops`` of the ``marcher``'s body at its ITS; arrays (drops,) in `Outcome`.

    The marcher's law and friction provide what ``drops`` does not. Raises ComputationError if the
    marcher's method cannot be compiled, or a drop fails, which it names.
    """
    out, status = _dropped(marcher, drops)
    failed = np.flatnonzero(status != modal_march.RELEASED)
    if len(failed):
        raise ComputationError(f"drop {failed[0]}: {FAILURES[int(status[failed[0]])]}")
    return Outcome(*out.T)


def drop_each(marcher_at: Callable[[float], Marcher], drops: Drops, its_s: float) -> Outcome:
    """As `drop_many`, at the ITS ``its_s`` or, for each drop, the longest share that converges.

    The result is NaN if none does, or if a bristle falls over, stays in contact, or slides for
    longer than one that bounces is in contact.
    """
    out, status = _dropped(marcher_at(its_s), drops, slides=False)
    for part in SHORTER:
        again = ~np.isin(status, (modal_march.RELEASED, modal_march.TOO_LONG, FALLEN))
        if not again.any():
            break
        out[again], status[again] = _dropped(
            marcher_at(part * its_s), drops.chosen(again), slides=False
        )
    out[status != modal_march.RELEASED] = np.nan
    return Outcome(*out.T)


def _dropped(
    marcher: Marcher, drops: Drops, *, slides: bool = True
) -> tuple[Array, NDArray[np.int64]]:
    """Results (drops, fields) of `drop_many` and `drop_each`, and the status of each drop."""
    if not compiled(marcher):
        raise ComputationError(
            "many drops at once need a body in modes, the conserving scheme, and penalty or the "
            "augmented Lagrangian at a finite Kn"
        )
    if marcher.body.alpha_1_s:
        raise ComputationError("many drops at once need alpha = 0")
    assert isinstance(marcher.body, ModalBody)
    out = np.zeros((len(drops), len(Outcome._fields)))
    status = np.zeros(len(drops), dtype=np.int64)
    rest: NDArray[np.bool_] = np.ones(len(drops), dtype=bool)
    parts = [symmetric_part(marcher.body, axes) for axes in (COLUMN, *PLANES)]
    followed = _followed_s(marcher, parts[0], bool((drops.mu > 0.0).all()), slides)
    for part in parts:
        if part is not None and (own := rest & drops.confined_to(part)).any():
            reduced = Marcher(
                part.body, marcher.method, marcher.scheme, marcher.its_s, marcher.gravity_m_s2
            )
            some = drops.chosen(own, part.points)
            out[own], status[own] = _drop(reduced, some, marcher, followed)
            rest &= ~own
    out[rest], status[rest] = _drop(marcher, drops.chosen(rest), marcher, followed)
    return out, status


def _followed_s(marcher: Marcher, column: SymmetricPart | None, rubs: bool, slides: bool) -> float:
    """Least time in s for which contact is followed.

    ``rubs`` says whether there is friction. If the bristle ``slides`` on, contact is followed to
    its end. ``column`` is the part of the body that upright drops move.
    """
    assert isinstance(marcher.body, ModalBody)
    points, longest = marcher.tables()[1].points, LONGEST_S
    if column is not None and (points.kind.pulls or (rubs and len(points.law) == 1)):
        # with the tip held, the slowest wave takes twice as long as free
        longest = LONGEST_RAD * slowest_period_s(column.body) / math.pi
    return max(longest, slowest_period_s(marcher.body)) if slides else longest


def _drop(
    marcher: Marcher, drops: Drops, method: Marcher, followed_s: float
) -> tuple[Array, NDArray[np.int64]]:
    """As `_dropped`, for ``drops`` that share their contact points.

    Contact's constants are those of ``method``; ``marcher`` may have fewer contact points.
    """
    assert isinstance(marcher.body, ModalBody)
    assert isinstance(method.body, ModalBody)
    modes, touching = marcher.tables()
    constants = method.tables()[1].points
    laws = np.array(drops.laws)
    if drops.laws is None:
        laws = np.tile(touching.points.law, (len(drops), 1))
    laws[:, 0] = drops.kn_N_m
    damping = drops.damping
    if damping is None:
        damping = np.full(len(drops), marcher.method.law.damping)
    rows = np.zeros((len(drops), len(Outcome._fields)))
    codes = np.zeros(len(drops), dtype=np.int64)
    common = Common(
        modes=modes,
        flyer=flyer(marcher.body),
        sky=Sky(
            marcher.gravity_m_s2, 0.0, slowest_period_s(method.body), WAIT_STEPS * marcher.its_s
        ),
        points=touching.points._replace(proximal=constants.proximal),
        kt_over_kn=marcher.method.friction.kt_over_kn,
        followed_s=followed_s,
    )
    columns = Columns(
        laws=laws,
        damping=np.ascontiguousarray(damping, dtype=float),
        mu=np.ascontiguousarray(drops.mu),
        tilt=np.ascontiguousarray(drops.tilt_deg, dtype=float),
        tilt_wide=np.ascontiguousarray(drops.tilt_wide_deg, dtype=float),
        height=np.ascontiguousarray(drops.height_m),
        normals=np.ascontiguousarray(drops.normals),
        rises=np.ascontiguousarray(drops.rises_m),
        scale=np.ascontiguousarray(drops.scale),
    )
    meanwhile(many_drops, common, columns, rows, codes)
    found = Outcome(*rows.T)
    allowed = (
        gain_allowed(marcher, found.n_steps) * modes.mass * common.sky.gravity * columns.height
    )
    gained = np.minimum(found.friction_loss_J, found.contact_loss_J) < -allowed
    codes[gained & (codes == modal_march.RELEASED)] = GAINED
    return rows, codes


@dataclass(frozen=True)
class SymmetricPart:
    """The part of a ``body`` that moves when its end section is loaded along ``axes`` alone.

    ``points`` (k,) represent all of the section's points, ``group`` (n,) says which one represents
    each. ``size_m`` is the section's greatest extent.
    """

    axes: tuple[int, ...]
    body: ModalBody
    points: NDArray[np.int64]
    group: NDArray[np.int64]
    size_m: float


def symmetric_part(body: ModalBody, axes: tuple[int, ...]) -> SymmetricPart | None:
    """The part of a body that moves when its end section is loaded along ``axes`` alone.

    Points at the same place along these axes are merged, and only the modes that they load are
    kept. None if such points do not move alike.
    """
    every = body.contact
    n, along = len(every.weights), list(axes)
    moved = (every.rows @ every.coordinates).reshape(n, 3, -1)
    lines = every.places_m[:, :2] * [axis in axes for axis in (0, 1)] + 0.0
    _, points, group = np.unique(lines, axis=0, return_index=True, return_inverse=True)
    group = group.reshape(n)
    share = (group == np.arange(len(points))[:, None]) * every.weights
    weights = share.sum(axis=1)
    share /= weights[:, None]
    together = np.einsum("gn,nxm->gxm", share, moved)
    least = ROUNDING * np.abs(together[:, along]).max()
    own = (np.abs(together[:, along]) > least).any(axis=(0, 1))
    apart = moved[:, :, own]
    apart[:, along] -= together[group][:, along][:, :, own]
    even = all(np.ptp(every.places_m[group == i, 2]) == 0.0 for i in range(len(points)))
    if not even or np.abs(apart).max() > least or body.translation[~own][:, along].any():
        return None
    translation, rotation = np.zeros((2, int(own.sum()), 3))
    translation[:, along] = body.translation[own][:, along]
    if len(along) == 2:
        across = 1 - along[0]
        rotation[:, across] = body.rotation[own, across]
    sizes = np.abs(every.coordinates)
    used = sizes[:, own].max(axis=1) > ROUNDING * sizes.max(axis=1)
    shapes = every.rows.reshape(n, 3, -1)[points][:, :, used]
    tractions = every.traction.reshape(n, 3, -1)[points][:, :, own]
    contact = ContactPoints(
        coordinates=np.ascontiguousarray(every.coordinates[np.ix_(used, own)]),
        support=np.tile(np.arange(shapes.shape[2]), (len(points), 1)),
        shapes=shapes,
        traction=tractions.reshape(3 * len(points), -1),
        weights=weights,
        places_m=share @ every.places_m,
    )
    bends = body.axis if len(along) == 2 else None
    moving = replace(
        body,
        omega2=body.omega2[own],
        translation=translation,
        rotation=rotation,
        contact=contact,
        axis=bends and bends.in_modes(np.eye(len(own))[:, own]),
    )
    return SymmetricPart(axes, moving, points, group, float(np.ptp(every.places_m, axis=0).max()))
