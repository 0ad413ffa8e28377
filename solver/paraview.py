"""Fields of a solid's impact as a time series for ParaView, in the world's frame.

    with FieldWriter(solid, out / "fields", marcher, frame, max_frames=200) as writer:
        simulate(frame, plan, marcher, observer=writer)
        writer.write_flight()

The folder holds: ``solid.bp`` with displacement, velocity, axial and von Mises stress on the nodes
of the solution (a cell of degree 2 stays one, with its 27 nodes); ``tip.bp`` with contact pressure,
gap and displacement on the nodes of the tip's face; ``ground.vtk``, the surface as a square;
``frames.csv`` with time and phase of each frame. The .bp files are ADIOS2's BP4 with the VTX
schema; ParaView reads them with ADIOS2VTXReader, also in parallel. Every frame is on disk when
``write`` returns, so they stay readable if the run is killed.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Self

import numpy as np
from dolfinx import fem
from dolfinx.io import VTXMeshPolicy, VTXWriter

from ..meshes.collective import Parting, run_on_one_rank
from .arrays import Array
from .bodies.reduced import ReducedModel
from .bodies.solid import SolidBody
from .checkpoint import Checkpoint, Mark, under
from .contact_phase import instant_force
from .errors import ComputationError
from .forms import own_values
from .ground import Placement, place
from .nodal_stress import VOIGT, NodalStress, von_mises
from .solid_fields import carried, turned
from .time.finite import FiniteMarcher
from .time.flight import Flight
from .time.march import ContactMarch, Moving
from .tip_face import TipFace

SOLID_FILE, TIP_FILE, FRAMES_FILE = "solid.bp", "tip.bp", "frames.csv"
GROUND_FILE = "ground.vtk"
# Half the side of the ground's square, over the bristle's length.
GROUND_REACH = 0.1
# Frames of a flight between touches, and of the last one.
BETWEEN, FLIGHT_FRAMES = 12, 80
FRAMES_PER_PERIOD = 40
AXIAL = VOIGT.index((2, 2))


class Phase(StrEnum):
    """Phase of the motion at a frame."""

    TOUCH = "touch"
    CONTACT = "contact"
    RELEASE = "release"
    FLIGHT = "flight"


class FieldWriter:
    """Writes frames of a solid's motion during contact: an observer of ``simulate``.

    Displacement is total: from the upright mesh to the body's position in the world, rotation
    included. The world's origin is where the tip first touches the ground (the middle, if several
    points touch at once), and z points up, so an upright bristle has no displacement when it
    touches. Velocity is along the world's axes, stresses along the body's own. In flight both are
    sums of the body's flight modes, whose rotation is the pose's; so a displacement lacks terms of
    second order in the slopes of the bending. ``pressure_Pa`` integrates over the face to the
    contact force, see `TipFace`: with ``marcher`` the force at the frame's own instant, otherwise
    the mean over the last step.

    A frame is written at each touch, then every ``every`` steps, and at release. By default
    ``every`` gives 40 frames in the time in which a wave runs up and back, at most one per step.
    When half of ``max_frames`` are written ``every`` doubles, and again after each further
    twentieth; so even a contact a hundred times longer than expected is covered to its end. At most
    ``max_frames`` are written during contact, the last of them at a release. Frames of flights are
    additional: with ``frame``, in which ``simulate`` flies, `BETWEEN` between touches, and those of
    `write_flight`.

    The mesh is written with every frame. If only the first had it, ParaView's reader would show
    nothing when the first frame requested is another (seen in 5.13), as when a file is opened at a
    later time or from a saved state.

    Frames of contact are stored in ``checkpoint``, so a resumed run writes them again.

    Construction, every call, ``write…`` and ``close`` are collective over the solid's ranks; forms
    are compiled in construction alone. Files of an earlier run in the folder are replaced.
    """

    def __init__(
        self,
        solid: SolidBody,
        folder: Path,
        marcher: ContactMarch | None = None,
        frame: ReducedModel | None = None,
        *,
        every: int | None = None,
        max_frames: int = 200,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        if every is not None and every < 1:
            raise ValueError(f"every must be 1 or more steps, not {every}")
        if max_frames < 2:
            raise ValueError(f"max_frames must be 2 or more, not {max_frames}")
        self.solid, self.folder, self.comm = solid, Path(folder), solid.comm
        self.times_s: list[float] = []
        self._marcher, self._frame = marcher, frame
        self._checkpoint = checkpoint
        # of the upright mesh, whose tip is at z = 0
        height_m = solid.comm.allreduce(solid.domain.geometry.x[:, 2].max(initial=0.0), max)
        self._height_m = float(height_m)
        self._period_s = 2.0 * self._height_m / solid.material.bar_speed_m_s
        its_s = marcher.its_s if marcher else math.inf
        self._every = every or max(1, round(self._period_s / FRAMES_PER_PERIOD / its_s))
        self._max_frames, self._next_doubling = max_frames, max_frames // 2
        self._n_contact, self._since = 0, self._every
        self._phase: Phase | None = None
        self._last: Moving | None = None
        self._origin_m: Array | None = None
        points = solid.contact
        self._none = np.zeros_like(points.weights)
        self._placement = marcher.ground if marcher else Placement.upright(points)
        self._make_fields()
        self._open()

    def _make_fields(self) -> None:
        space = self.solid.space
        scalar = fem.functionspace(self.solid.domain, ("Lagrange", self.solid.order))
        self.displacement = fem.Function(space, name="displacement_m")
        self.velocity = fem.Function(space, name="velocity_m_s")
        self.axial_stress = fem.Function(scalar, name="axial_stress_Pa")
        self.von_mises = fem.Function(scalar, name="von_mises_Pa")
        what = self.displacement, self.solid.material
        flying = marched = NodalStress(*what)
        if isinstance(self._marcher, FiniteMarcher):
            marched = NodalStress(*what, finite=True)
        self._stresses = marched, flying
        self._tip = TipFace(self.solid)

    def _open(self) -> None:
        run_on_one_rank(self.comm, self._clear)
        self._parting = Parting(self.comm)
        body = [self.displacement, self.velocity, self.axial_stress, self.von_mises]
        self._writers = [
            VTXWriter(
                fields[0].function_space.mesh.comm,
                self.folder / name,
                fields,
                engine="BP4",
                mesh_policy=VTXMeshPolicy.update,
            )
            for name, fields in ((SOLID_FILE, body), (TIP_FILE, self._tip.fields))
        ]

    def _clear(self) -> None:
        """Prepare the folder; ComputationError if that is not possible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            for name in (SOLID_FILE, TIP_FILE):
                shutil.rmtree(self.folder / name, ignore_errors=True)
            (self.folder / GROUND_FILE).unlink(missing_ok=True)
            (self.folder / FRAMES_FILE).write_text("frame,t_s,phase\n")
        except OSError as error:
            why = error.strerror or str(error)
            raise ComputationError(
                f"the fields cannot be written to {self.folder}: {why}"
            ) from error

    def __call__(self, state: Moving, step_force: Array) -> None:
        """Record a step; ``step_force`` (n contact points, 3) in N per area share."""
        self._fly_to(state.t_s)
        force, before = step_force[:, 0], self._phase
        if self._marcher is not None:
            self._placement = self._marcher.ground
            if step_force.any():
                force = instant_force(self._marcher, state, step_force)
        self._last, self._since = state, self._since + 1
        self._phase = phase = self.comm.bcast(self._next_phase(state, step_force, force))
        due = self._since >= self._every or self._phase is not before
        kept = 0 if self._phase is Phase.RELEASE else 1
        if due and self._n_contact < self._max_frames - kept:
            if self._checkpoint is not None:
                shown = {"t_s": state.t_s, "u": state.u, "v": state.v, "force": force}
                shown["phase"] = str(self._phase)
                self._checkpoint.keep_frame({k: np.asarray(value) for k, value in shown.items()})
            self.write(state.t_s, state.u, state.v, force, phase)
            self._count()

    def memory(self) -> dict[str, Array]:
        """The frames that were due so far, see `contact_phase.Observer`."""
        counts = [self._every, self._next_doubling, self._n_contact, self._since]
        return {"counts": np.array(counts), "phase": np.array(str(self._phase or ""))}

    def recall(self, mark: Mark, state: Moving) -> None:
        """Write the stored frames, and continue counting."""
        if mark.frames:
            self._fly_to(float(mark.frames[0]["t_s"]))
        if self._marcher is not None:
            self._placement = self._marcher.ground
        for frame in mark.frames:
            phase = Phase(str(frame["phase"]))
            self.write(float(frame["t_s"]), frame["u"], frame["v"], frame["force"], phase)
        kept = dict(under("observer", mark.arrays))
        self._every, self._next_doubling, self._n_contact, self._since = map(int, kept["counts"])
        latest = str(kept["phase"])
        self._phase = Phase(latest) if latest else None
        self._last = state

    def _next_phase(self, state: Moving, step_force: Array, force: Array) -> Phase:
        free = not step_force.any() or (not force.any() and state.approach[:, 0].max() <= 0.0)
        if not free:
            return Phase.CONTACT
        return Phase.RELEASE if self._phase is Phase.CONTACT else Phase.TOUCH

    def _count(self) -> None:
        self._since, self._n_contact = 0, self._n_contact + 1
        if self._n_contact >= self._next_doubling:
            self._every *= 2
            self._next_doubling += max(self._max_frames // 20, 1)

    def write(
        self,
        t_s: float,
        u: Array,
        v: Array,
        force: Array | None = None,
        phase: Phase = Phase.CONTACT,
    ) -> None:
        """Write one frame of any state: ``u``, ``v`` as in State, normal ``force`` (n,) in N or
        none.

        The body is where the marcher last placed it; at the first frame it touches the ground.

        A frame that is not later than the last one is skipped, since ParaView needs increasing
        times. Raises ValueError after ``close``.
        """
        if not self._writers:
            raise ValueError(f"the fields in {self.folder} are closed")
        if self.times_s and t_s <= self.times_s[-1]:
            return
        if self._origin_m is None:
            self._origin_m = self._set_ground()
        own_values(self.displacement, u)
        stress = self._stresses[phase is Phase.FLIGHT]()
        self.axial_stress.x.array[:] = stress[:, AXIAL]
        self.von_mises.x.array[:] = von_mises(stress)
        gaps = self._placement.gaps(self.solid.contact.displacements(u))
        pose = self._placement.pose
        place = carried(self.solid, u, pose, self._origin_m)
        own_values(self.displacement, place)
        own_values(self.velocity, turned(v, pose))
        self._tip.update(self.displacement, self._none if force is None else force, gaps)
        for writer in self._writers:
            writer.write(t_s)
        if self.comm.rank == 0:
            with (self.folder / FRAMES_FILE).open("a") as table:
                table.write(f"{len(self.times_s)},{t_s!r},{phase}\n")
        self.times_s.append(t_s)

    def _set_ground(self) -> Array:
        """Write the ground that the body touches; returns the place of contact, the origin."""
        origin, normal = self._placement.nearest(self.solid.contact)
        half = GROUND_REACH * self._height_m
        if self.comm.rank == 0:
            (self.folder / GROUND_FILE).write_text(_square_vtk(normal, half))
        return origin

    def write_flight(
        self, n_frames: int = FLIGHT_FRAMES, advance: Callable[[], None] = lambda: None
    ) -> None:
        """Write ``n_frames`` over two axial periods of flight after the last recorded state, to
        show the wave travel on.

        ``advance`` is called for each frame. Raises ValueError if no step was recorded.
        """
        if self._last is None:
            raise ValueError("there is no flight before the first step")
        end_s = self._last.t_s + 2.0 * self._period_s
        self._write_flight(np.linspace(self._last.t_s, end_s, n_frames + 1)[1:], advance)

    def _fly_to(self, t_s: float) -> None:
        """Write the flight to a touch at ``t_s`` that was not reached by time steps."""
        if self._last is None or self._frame is None or self._marcher is None:
            return
        flown = t_s - self._last.t_s > 2.0 * self._marcher.its_s
        if flown and self._n_contact < self._max_frames - 1:
            self._write_flight(np.linspace(self._last.t_s, t_s, BETWEEN + 2)[1:-1])
            self._phase = None

    def _write_flight(self, times_s: Array, advance: Callable[[], None] = lambda: None) -> None:
        assert self._last is not None
        assert self._frame is not None
        assert self._marcher is not None
        frame, placed, last = self._frame, self._placement, self._last
        start, u, v = frame.launched(placed.pose, last.u, last.v)
        gravity = self._marcher.gravity_m_s2
        flight = Flight(frame.modal, start, last.t_s, u, v, gravity)
        for t in map(float, times_s):
            pose, q, qv = flight.state(t)
            self._placement = place(placed.ground, pose, self.solid.contact, placed.datum_m)
            u, v = frame.from_modal(np.column_stack([q, qv])).T
            self.write(t, u, v, None, Phase.FLIGHT)
            advance()

    def close(self) -> None:
        """Finish the files; no frames can be added afterwards. Safe to call again. Collective."""
        if not self._writers:
            return
        for writer in self._writers:
            writer.close()
        self._writers = []
        self._parting.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        if self._writers and self._parting.together(raised[1]):
            self.close()


def _square_vtk(normal: Array, half_m: float) -> str:
    """A square in the plane through the origin with the given normal, as a legacy VTK file."""
    first = np.cross(np.array([0.0, 1.0, 0.0]), normal)
    first *= half_m / np.linalg.norm(first)
    second = np.cross(normal, first)
    corners = [x * first + y * second for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    points = "\n".join(" ".join(repr(float(x)) for x in corner) for corner in corners)
    return (
        "# vtk DataFile Version 3.0\nground\nASCII\nDATASET POLYDATA\n"
        f"POINTS 4 double\n{points}\nPOLYGONS 1 5\n4 0 1 2 3\n"
    )
