"""Bristles clamped in a moving hub over a plane, dealt out over ranks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from .. import paper
from ..arrays import Array
from ..bristle import positive
from ..errors import BristleError, ComputationError, InputError, require
from ..time.scheme import TimeScheme
from . import motion as rows
from .chain import at_rest, chain_of, stacked, uniform_chain
from .contact import surface_of
from .frame import Frame, RodEnergy
from .ground import Ground
from .hub import Clamps, HubMotion
from .march import march_all
from .motion import Hub, motion_of, rod, scheme_of, set_strains
from .observe import clearance, observe
from .rotation import world_to_body
from .section import RodSection
from .settle import settle
from .tally import COLUMNS, Means

# The spectral radius of generalised-alpha at infinite frequency.
RHO_INFINITY = 0.6
# The greatest error of a step over a bristle's length.
TOLERANCE = 1e-6
FIRST_STEP_S = 1e-5
# A wire is no straighter than this; a perfect one would be compressed for ever instead of buckling.
BOW_RAD = 1e-4
# Instants at which a march looks ahead whether the hub takes a clamp into the surface.
LOOKS = 500
# Forces are averaged over windows of time no longer than this.
WINDOW_S = 1e-3
# A tip may lie this share of its length below the surface at the start: it hangs by its weight.
TOUCHING = 1e-6


class Rods:
    """Bristles of one section, clamped in a hub that moves, over a plane.

    Every bristle is a rod by itself: it marches from frame to frame with steps of its own, so what
    it does depends on no other bristle and on no number of ranks.

    Parameters
    ----------
    section, clamps : what the bristles are, and where they are clamped
    motion : the hub's; at its begin the bristles move with it, hanging in equilibrium
    ground : the plane, or None
    elements : of each bristle
    bow_rad : how far the tip of an unloaded bristle points off its axis, toward its thin side; one
        that is pressed upright buckles by it
    gravity_m_s2 : downward
    tolerance : the greatest error of a time step over a bristle's length
    rho_infinity : the share of a wave that a step far too long for it leaves, 0 to 1
    comm : ranks, each of which has a block of the bristles

    Raises
    ------
    InputError : a number is out of its range, or a bristle begins below the surface
    ComputationError : a bristle finds no equilibrium under its own weight
    """

    def __init__(
        self,
        section: RodSection,
        clamps: Clamps,
        motion: HubMotion,
        ground: Ground | None,
        elements: int = 20,
        *,
        gravity_m_s2: float = paper.GRAVITY_M_S2,
        bow_rad: float = BOW_RAD,
        tolerance: float = TOLERANCE,
        rho_infinity: float = RHO_INFINITY,
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ) -> None:
        if elements < 1:
            raise InputError(f"a rod needs at least one element, not {elements}")
        if not math.isfinite(gravity_m_s2):
            raise InputError(f"gravity must be finite, not {gravity_m_s2}")
        if not math.isfinite(bow_rad):
            raise InputError(f"the bow must be finite, not {bow_rad}")
        positive("the tolerance of a step", tolerance)
        self.section, self.clamps, self.motion, self.ground = section, clamps, motion, ground
        self.comm, self.elements = comm, elements
        self.mine = np.array_split(np.arange(len(clamps)), comm.size)[comm.rank]
        self._gravity = np.array([0.0, 0.0, -gravity_m_s2])
        self._surface = surface_of(ground, section)
        chains = [
            uniform_chain(_bowed(section, bow_rad / length), length, elements)
            for length in clamps.length_m
        ]
        # a rank without bristles keeps one that it does not march, for its arrays' types
        kept = self.mine if len(self.mine) else np.array([0])
        self._chains = stacked([chains[i] for i in kept])
        scale_m = float(clamps.length_m.min())
        self._scheme = scheme_of(TimeScheme.generalised(rho_infinity), tolerance * scale_m)
        self._hub = self._hub_of(kept)
        self._loads = np.zeros((len(kept), elements + 1, 6))
        self._loads[..., :3] = self._chains.mass[..., None] * self._gravity
        self._now = motion_of(len(kept), elements + 1, len(self._surface.rim))
        self._other = rod(motion_of(1, elements + 1, len(self._surface.rim)), 0)
        self._refuse_below(np.zeros(1))
        wrong: BristleError | None = None
        for at, i in enumerate(self.mine):
            try:
                self._begin(at, int(i))
            except BristleError as error:
                wrong = error
                break
        # the first rank's error is everyone's
        for found in comm.allgather(wrong):
            if found is not None:
                raise found
        self._means = Means.none()
        first = self._observed()
        self._initial_J = float(first["energy"][:, :2].sum() + first["energy"][:, 5].sum())
        self._datum_J = float(first["energy"][:, 2].sum())

    @property
    def t_s(self) -> float:
        """The time of the latest frame."""
        return float(self._now.totals[0, rows.TIME])

    def march(self, until_s: float, every_s: float) -> Iterator[Frame]:
        """Frames at multiples of ``every_s`` up to ``until_s``, after the present one; collective.

        On other ranks than the first a frame has that rank's bristles only.

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
        """March every bristle to ``end_s``, and take means over so many ``windows`` until there;
        collective. Raises ComputationError as `march`."""
        failed, begin_s, sums = -1, self.t_s, np.zeros((windows, COLUMNS))
        if len(self.mine):
            failed = march_all(
                self._chains,
                self._scheme,
                self._surface,
                self._loads,
                self._hub,
                self._now,
                self._other,
                end_s,
                sums,
            )
        else:
            self._now.totals[0, rows.TIME] = end_s
        message = ""
        if failed >= 0:
            at, step = self._now.totals[failed, [rows.TIME, rows.STEP]]
            message = (
                f"bristle {self.mine[failed]} does not converge at {at:.6g} s with a step of "
                f"{step:.3g} s; try a lower Kn, more elements, or a slower motion"
            )
        require(self.comm, failed < 0, message)
        parts = self.comm.gather(sums)
        whole = sums if parts is None else np.sum(parts, axis=0)
        rods = len(self.mine if parts is None else self.clamps)
        self._means = Means.of(begin_s, end_s, whole, max(rods, 1))

    def frame(self) -> Frame:
        """All bristles as they are now; collective."""
        seen = self._observed()
        pose = self.motion.pose(self.t_s)
        force = -seen["reaction"][:, :3]
        arms = seen["x"][:, 0] - pose.position_m
        torque = -seen["reaction"][:, 3:] + np.cross(arms, force)
        energy = seen["energy"].sum(axis=0)
        return Frame(
            t_s=self.t_s,
            force_N=force.sum(axis=0),
            torque_Nm=torque.sum(axis=0),
            tip_m=seen["x"][:, -1],
            tip_normal_N=seen["surface"][:, 0],
            tip_friction_N=seen["surface"][:, 1],
            state=seen["surface"][:, 2].astype(np.int8),
            centre_m=seen["x"],
            rotation=seen["q"],
            bending_stress_Pa=self.section.bending_stress_Pa(seen["moment"]),
            energy=RodEnergy(
                initial_J=self._initial_J,
                hub_work_J=float(energy[3]),
                kinetic_J=float(energy[0]),
                strain_J=float(energy[1]),
                potential_J=float(energy[2]) - self._datum_J,
                contact_J=float(energy[5]),
                material_loss_J=float(energy[4]),
                friction_loss_J=float(energy[6]),
            ),
            steps=int(energy[7]),
            means=self._means,
        )

    def checkpoint(self) -> dict[str, Array]:
        """Everything that the next step needs, of all bristles, on every rank; collective."""
        kept = {**self._now._asdict(), **self._now.touch._asdict()}
        kept.pop("touch")
        whole = {}
        for name, mine in kept.items():
            parts = self.comm.allgather(mine[: len(self.mine)])
            whole[name] = np.concatenate(parts)
        whole["energy_at_start_J"] = np.array([self._initial_J, self._datum_J])
        return whole

    def restore(self, kept: Mapping[str, Array]) -> None:
        """Go back to a `checkpoint`, to the bit, on any number of ranks.

        Raises InputError where it is not one of as many bristles and elements.
        """
        present = {**self._now._asdict(), **self._now.touch._asdict()}
        present.pop("touch")
        for name, mine in present.items():
            shape = (len(self.clamps), *mine.shape[1:])
            if name not in kept or kept[name].shape != shape:
                raise InputError(f"the checkpoint is not one of {len(self.clamps)} such bristles")
            mine[: len(self.mine)] = kept[name][self.mine]
        if not len(self.mine):
            self._now.totals[:] = kept["totals"][:1]
        self._initial_J, self._datum_J = map(float, kept["energy_at_start_J"])
        self._means = Means.none()

    # --- start ------------------------------------------------------------------------------------

    def _hub_of(self, kept: Array) -> Hub:
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_matrix(self.clamps.rotation[kept]).as_quat()
        return Hub(
            np.ascontiguousarray(self.motion.breaks, dtype=float),
            np.ascontiguousarray(self.motion.coefficients, dtype=float),
            self.clamps.position_m[kept],
            np.ascontiguousarray(turned[:, [3, 0, 1, 2]]),
        )

    def _begin(self, at: int, i: int) -> None:
        """The bristle ``i`` in equilibrium under its weight, moving with the hub."""
        chain, now, pose = chain_of(self._chains, at), rod(self._now, at), self.motion.pose(0.0)
        place = pose.position_m + pose.rotation @ self.clamps.position_m[i]
        now.x[:], now.q[:] = at_rest(chain, place, pose.rotation @ self.clamps.rotation[i])
        set_strains(chain, now)
        self._refuse_tips_below(at, i)
        hub = self._hub._replace(place=self._hub.place[at], attitude=self._hub.attitude[at])
        loads = self._loads[at]
        if not settle(chain, self._scheme, self._surface, loads, hub, now, self._other):
            raise ComputationError(
                f"bristle {i} finds no equilibrium under its weight; try more elements"
            )
        spin = pose.angular_velocity_rad_s
        now.velocity[:, :3] = pose.velocity_m_s + np.cross(spin, now.x - pose.position_m)
        now.totals[rows.STEP] = FIRST_STEP_S
        now.velocity[:, 3:] = world_to_body(now.q, spin)

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

    def _refuse_tips_below(self, at: int, i: int) -> None:
        """InputError where a bristle as it is without strain begins in the surface."""
        gap = float(clearance(self._surface, rod(self._now, at)))
        if gap < -TOUCHING * self.clamps.length_m[i]:
            raise InputError(
                f"bristle {i} begins {-gap:.3g} m below the surface; raise the hub, or press it "
                "down from first touch"
            )

    def _observed(self) -> dict[str, Array]:
        """What `observe` finds: of all bristles on the first rank, of its own on another."""
        mine = observe(self._chains, self._surface, self._gravity, self._now)
        found = {}
        for name, array in mine._asdict().items():
            own = array[: len(self.mine)]
            parts = self.comm.gather(own)
            found[name] = own if parts is None else np.concatenate(parts)
        return found


def _bowed(section: RodSection, curvature_1_m: float) -> RodSection:
    """With so much more natural curvature about the wide side."""
    about_1, about_2, twist = section.curvature_1_m
    return replace(section, curvature_1_m=(about_1, about_2 + curvature_1_m, twist))
