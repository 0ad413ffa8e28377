"""One case computed, and what cases share.

A `CaseSession` keeps what is costly to build: a mesh and its matrices, a factor, a reduced basis, a
beam's modes, and the marchers made of them, so that cases that differ in stiffness or height alone
cost their march and nothing else.
"""

from __future__ import annotations

import copy
import math
import sys
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast

from ...meshes import geometry
from ...meshes.collective import ALONE, Parting, with_mpi
from ...meshes.geometry import Tag
from ...solver.analytic import analytic_drop
from ...solver.bodies.base import ContactPoints, with_offsets
from ...solver.bodies.beam import beam_body
from ...solver.bodies.modal import ModalBody, from_arrays, to_arrays
from ...solver.bristle import Bristle
from ...solver.cache import load, sources, store
from ...solver.checkpoint import Checkpoint
from ...solver.contact.enforcement import ContactMethod
from ...solver.contact_phase import History, Observer
from ...solver.drop import DropPlan, DropResult, FlightFrame, ModalFrame, simulate
from ...solver.energy import Budget, Energy
from ...solver.errors import ComputationError
from ...solver.fall import dragged_fall, risen
from ...solver.time.march import ContactMarch, Marcher
from ..inputs.choices import Contact, Model, Tip, Until
from ..inputs.config import DropInputs
from ..inputs.fields import FLAT
from ..inputs.limits import check_result, count_unknowns
from ..inputs.values import Entered, entered, observed
from .parallel import all_ranks

if TYPE_CHECKING:  # MPI, dolfinx and gmsh, which a beam does without
    from mpi4py import MPI

    from ...solver.bodies.reduced import ReducedModel
    from ...solver.bodies.solid import SolidBody

# Steps of an axial period that a reduced basis is made for, and how often its Krylov vectors are
# doubled where that is not enough.
RESOLVING, DOUBLINGS = 16.0, 3
# Numbers in the vectors of a basis beyond which they are not doubled: 1 GB, and more beside it.
MOST_NUMBERS = 1 << 27
# Meshed bodies, bases, marchers and frames that a session keeps from one call to the next. A drop
# of the solid needs three of them, four where it leans.
MOST_KEPT = 12
PARTS = ("mesh", "assemble", "factor", "march")
Timings = dict[str, float]
# What a drop that ends with its first impact has not seen.
NO_REBOUND: dict[str, Any] = {
    "rebound_ratio": None,
    "rebound_height_m": None,
    "cm_rebound_height_m": None,
}
# What one that ends in contact has not seen either.
NOT_RELEASED: dict[str, Any] = {
    "contact_time_s": math.nan,
    "cm_velocity_after_m_s": math.nan,
    "velocity_after_m_s": 3 * (math.nan,),
    "spin_after_rad_s": 3 * (math.nan,),
}


@dataclass(frozen=True)
class Prepared(Entered[DropInputs]):
    """All that a case needs before its first step."""

    frame: FlightFrame
    marcher: ContactMarch


class CaseSession:
    """Computes cases on ``comm``, all ranks of the job unless it is given, and keeps what they
    share until ``close``.

    A solid, and the reduced model made from it, are built by all ranks together. Once `prepare`
    has been called on all of them, cases of modal bodies (analytic, beam, reduced) communicate
    no more, so each rank may run its own. The basis of a reduced model is made for the case's own
    ITS, or for ``basis_its_s`` where that is given, and then serves every ITS.

    Everything is kept until `trim`. All that is made from a body is forgotten together with it.
    """

    def __init__(self, comm: MPI.Intracomm | None = None, basis_its_s: float | None = None) -> None:
        self.comm, self.basis_its_s = comm or all_ranks(), basis_its_s
        # in the order in which they were made, which for solids is that of all ranks
        self._bodies: dict[Hashable, dict[Hashable, Any]] = {}
        self._used: dict[Hashable, int] = {}
        self._alone: CaseSession | None = None
        self._spent = dict.fromkeys(PARTS, 0.0)
        self._parting = Parting(self.comm)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        # where one rank failed alone, PETSc frees the factors at the end of the next session
        if self._parting.together(raised[1]):
            self.close()
        else:
            self._bodies.clear()
            self._used.clear()

    def close(self) -> None:
        """Free what PETSc holds, on all ranks together; nothing that was handed out can be used
        afterwards."""
        if self._alone is not None:
            self._alone.close()
            self._alone = None
        self._forget(list(self._bodies))
        self._parting.close()

    def trim(self) -> None:
        """Forget the bodies that were used longest ago, until there are no more than `MOST_KEPT`
        things; collective."""
        kept = sorted(self._bodies, key=lambda key: self._used[key])
        while sum(len(self._bodies[key]) for key in kept) > MOST_KEPT:
            del kept[0]
        those = set(self.comm.bcast(kept))
        self._forget([key for key in self._bodies if key not in those])
        if self._alone is not None:
            self._alone.trim()

    def _forget(self, keys: list[Hashable]) -> None:
        solids = False
        for key in keys:
            del self._used[key]
            for thing in reversed(self._bodies.pop(key).values()):
                if hasattr(thing, "close"):
                    thing.close()
                    solids = True
        if solids and self.comm.size > 1:  # what Python let go of alone waits for the other ranks
            sys.modules["petsc4py.PETSc"].garbage_cleanup(self.comm)

    def prepare(self, inputs: DropInputs) -> Prepared | None:
        """Build what ``inputs`` needs and is not there yet; None for the analytic model.

        Raises ComputationError where the mesh, its matrices or the factor cannot be made.
        """
        if inputs.model is Model.ANALYTIC:
            return None
        now = entered(inputs)
        frame = self._frame(now)
        return Prepared(now.inputs, now.scene, frame, self._marcher(now, frame))

    def _frame(self, now: Entered[DropInputs], modes: int | None = None) -> FlightFrame:
        inputs, frame = now.inputs, self._flat_ended(now, modes)
        if inputs.tip_shape != FLAT:
            key = ("face", id(frame), inputs.tip_shape)
            frame = self._keep(inputs, key, lambda: _with_face(frame, inputs))
        loss = now.scene.loss_factor
        if loss and isinstance(frame, ModalFrame):
            return self._changed(inputs, frame, loss_factor=loss)
        return frame

    def _flat_ended(self, now: Entered[DropInputs], modes: int | None) -> ReducedModel | ModalFrame:
        inputs = now.inputs
        if inputs.model is Model.SOLID:
            return self._full(inputs)
        if inputs.model is Model.BEAM:
            return self._beam(inputs, now.scene.lateral_inertia)
        frame = self._modal(inputs, modes)
        return frame if inputs.second_order else self._changed(inputs, frame, axis=None)

    def run(
        self,
        inputs: DropInputs,
        observer: Observer | None = None,
        prepared: Prepared | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> tuple[DropResult, Timings]:
        """One case: its result and the seconds since the last one, by part and in total.

        ``prepared`` is what `prepare` gave, where the observer was made for its marcher. What is
        marched step by step goes on from ``checkpoint``.
        Collective for the solid. Raises ComputationError.
        """
        prepared = prepared or self.prepare(inputs)
        with self._timed("march"):
            if prepared is None:
                now = entered(inputs)
                result, scene = _analytic(now), now.scene
            else:
                scene, inputs = prepared.scene, prepared.inputs
                frame, marcher = prepared.frame, prepared.marcher
                plan = inputs.drop_plan(len(frame.body.contact.weights), scene)
                result = simulate(frame, plan, marcher, observer, checkpoint)
                result = self._enriched(prepared, plan, result)
                check_result(inputs, result)
        return observed(result, scene), self.take_timings()

    def take_timings(self) -> Timings:
        """Seconds spent since the last call, by part and in total."""
        spent, self._spent = self._spent, dict.fromkeys(PARTS, 0.0)
        return {**spent, "total": sum(spent.values())}

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            self._spent[part] += time.perf_counter() - started

    def _keep[Thing](self, inputs: DropInputs, key: Hashable, make: Callable[[], Thing]) -> Thing:
        """What was made for ``key`` of the body of ``inputs``; keys of things made from others
        contain the ids of those."""
        body = _solid_key(inputs) if inputs.model.meshed else ("beam", inputs.bristle())
        things = self._bodies.setdefault(body, {})
        self._used[body] = max(self._used.values(), default=0) + 1
        if key not in things:
            things[key] = make()
        return cast("Thing", things[key])

    def _changed(self, inputs: DropInputs, frame: ModalFrame, **values: Any) -> ModalFrame:
        """The frame with these ``values`` in its bodies."""
        key = ("changed", id(frame), *values.items())
        return self._keep(inputs, key, lambda: _each(frame, lambda body: replace(body, **values)))

    def _beam(self, inputs: DropInputs, lateral_inertia: float) -> ModalFrame:
        how = {
            "n_elements": inputs.elements,
            "face": inputs.tip is Tip.FACE,
            "points": inputs.contact_points,
            "second_order": inputs.second_order,
            "lateral_inertia": lateral_inertia,
        }
        bristle = inputs.bristle()
        with self._timed("assemble"):
            key = ("beam", *how.values())
            return self._keep(inputs, key, lambda: _beam_frame(bristle, **how))

    def body_key(self, inputs: DropInputs) -> Hashable:
        """Equal for cases of the solid that share all that is costly to build."""
        return (*_solid_key(inputs), *self._basis(inputs).items())

    def _make_solid(self, inputs: DropInputs) -> SolidBody:
        from ...meshes.check import MeshError
        from ...meshes.distribute import own_to_dolfinx, to_dolfinx
        from ...solver.bodies import linear
        from ...solver.bodies.solid import SolidBody

        with self._timed("mesh"):
            try:
                if inputs.mesh is None:
                    domain, _, facets = to_dolfinx(inputs.mesh_spec(), with_mpi(self.comm))
                else:
                    domain, facets = own_to_dolfinx(inputs.mesh.read(), with_mpi(self.comm))
            except MeshError as error:
                raise ComputationError(f"the mesh could not be made: {error}") from error
        with self._timed("assemble"):
            return SolidBody(
                domain,
                facets,
                int(Tag.TIP),
                inputs.bristle().material,
                inputs.order,
                inputs.contact_points,
                linear.Solver(inputs.solver.value),
            )

    def _full(self, inputs: DropInputs) -> ReducedModel:
        """The solid at full order, and the modes that it flies in, which are kept from run to
        run."""
        from ...solver.bodies.floating import FloatingModel
        from ...solver.bodies.reduced import flying_solid

        solid = self._solid(inputs)
        how = {k: v for k, v in self._basis(inputs).items() if k != "tractions"}

        def make() -> ReducedModel:
            model = flying_solid(solid, **how)
            return FloatingModel(**vars(model)) if inputs.finite else model

        with self._timed("factor"):
            return self._keep(inputs, ("flying", inputs.finite, *how.items()), make)

    def _solid(self, inputs: DropInputs) -> SolidBody:
        return self._keep(inputs, "solid", lambda: self._make_solid(inputs))

    def _reduced(self, inputs: DropInputs, modes: int | None = None) -> ReducedModel:
        """The solid and its reduced model, with a flat tip."""
        from ...solver.bodies.reduced import reduce_solid

        solid, how = self._solid(inputs), self._basis(inputs, modes)
        with self._timed("factor"):
            return reduce_solid(solid, second_order=how["leaning"], **how)

    def _basis(self, inputs: DropInputs, modes: int | None = None) -> dict[str, Any]:
        """What `reduce_solid` is told beside the solid.

        Its shift is that of the time scheme, at an ITS that resolves the impact and no more: what
        is faster than the wave that runs up and down the bristle, contact does not ask for.
        """
        resolving_s = inputs.bristle().axial_period_s / RESOLVING
        c_mass, c_stiffness = inputs.time_scheme().effective(
            self.basis_its_s or max(inputs.its_s, resolving_s), inputs.alpha_1_s, inputs.beta_s
        )
        return {
            "shift_1_s2": c_mass / c_stiffness,
            "n_krylov": modes or inputs.modes,
            "leaning": inputs.leaning,
            "tractions": inputs.contact is Contact.NITSCHE,
        }

    def _modal(self, inputs: DropInputs, modes: int | None) -> ModalFrame:
        """The reduced model alone, the same to the last bit on every rank; kept from run to run."""
        how = tuple(self._basis(inputs, modes).items())
        made_by = (sources(Path(geometry.__file__).parent), self.comm.size)
        key = ("modal", *_solid_key(inputs)[1:-1], inputs.solver.value, how, *made_by)
        return self._keep(inputs, key, lambda: self._stored(inputs, str(key), modes))

    def _stored(self, inputs: DropInputs, key: str, modes: int | None) -> ModalFrame:
        """The reduced solid and its coarser ones as an earlier run stored them, else made and
        stored."""
        arrays = self.comm.bcast(load(key) if self.comm.rank == 0 else None)
        if arrays is None:
            model = self._reduced(inputs, modes)
            made = to_arrays((model.modal, *model.coarser)) if self.comm.rank == 0 else None
            arrays = self.comm.bcast(made)
            if self.comm.rank == 0:
                store(key, arrays)
        body, *coarser = from_arrays(arrays)
        return ModalFrame(body, tuple(coarser))

    def _enriched(self, prepared: Prepared, plan: DropPlan, result: DropResult) -> DropResult:
        """The drop of a reduced solid with as many Krylov vectors as its error asks for.

        They are made by this rank alone, since others may be at other cases.
        """
        inputs = prepared.inputs
        if inputs.model is not Model.REDUCED:
            return result
        modes = inputs.modes
        for _ in range(DOUBLINGS):
            error = result.reduction_error
            if error is None or error <= inputs.reduction_tolerance:
                break
            from ...solver.bodies.reduced import krylov_vectors

            modes *= 2
            vectors = krylov_vectors(modes, leaning=inputs.leaning)
            if vectors * count_unknowns(inputs) > MOST_NUMBERS:
                break
            if self._alone is None:
                self._alone = CaseSession(ALONE, self.basis_its_s)
            frame = self._alone._frame(prepared, modes)
            result = simulate(frame, plan, self._alone._marcher(prepared, frame))
        return result

    def _marcher(self, now: Entered[DropInputs], frame: FlightFrame) -> ContactMarch:
        """A marcher for this case; those that differ in Kn, friction or lean alone share factor
        and compliance."""
        inputs = now.inputs
        method, scheme = inputs.contact_method(now.scene.law), inputs.time_scheme()
        same = (method.enforcement, method.theta, method.gamma0, method.augmentation)
        key = ("marcher", id(frame), same, scheme, inputs.its_s, inputs.gravity_m_s2)
        with self._timed("factor"):
            marcher = self._keep(inputs, key, lambda: _make_marcher(inputs, frame, method))
            return marcher.with_law(method.law, method.friction)


@contextmanager
def session_on(
    comm: MPI.Intracomm, session: CaseSession | None = None, basis_its_s: float | None = None
) -> Iterator[CaseSession]:
    """The ``session``, trimmed, or where there is none one on ``comm`` that ends with the block."""
    if session is None:
        with CaseSession(comm, basis_its_s) as own:
            yield own
        return
    session.trim()
    before, session.basis_its_s = session.basis_its_s, basis_its_s
    try:
        yield session
    finally:
        session.basis_its_s = before


def _make_marcher(inputs: DropInputs, frame: FlightFrame, method: ContactMethod) -> ContactMarch:
    how = (method, inputs.time_scheme(), inputs.its_s, inputs.gravity_m_s2)
    if not inputs.finite:
        return Marcher(frame.body, *how)
    from ...solver.bodies.solid import SolidBody
    from ...solver.time.finite import FiniteMarcher

    assert isinstance(frame.body, SolidBody)
    return FiniteMarcher(frame.body, *how)


def _solid_key(inputs: DropInputs) -> tuple[Hashable, ...]:
    material, points = inputs.bristle().material, inputs.contact_points
    return ("solid", inputs.shape(), material, inputs.order, points, inputs.solver)


def _each(frame: ModalFrame, change: Callable[[ModalBody], ModalBody]) -> ModalFrame:
    """The frame with a body, and coarser ones, that are changed alike."""
    return ModalFrame(change(frame.modal), tuple(change(body) for body in frame.coarser))


def _with_face(frame: ModalFrame | ReducedModel, inputs: DropInputs) -> ModalFrame | ReducedModel:
    """The same body with the points of its end face where the tip's shape puts them.

    A solid's mesh stays flat, and shares what PETSc holds with the body that it is a copy of.
    """

    def shaped(contact: ContactPoints) -> ContactPoints:
        return with_offsets(contact, inputs.face_offsets_m(contact.xy_m))

    if isinstance(frame, ModalFrame):
        return _each(frame, lambda body: replace(body, contact=shaped(body.contact)))
    modal = replace(frame.modal, contact=shaped(frame.modal.contact))
    solid = copy.copy(frame.body)
    solid.contact = shaped(solid.contact)
    return replace(frame, body=solid, modal=modal)


def _beam_frame(bristle: Bristle, **how: Any) -> ModalFrame:
    try:
        return ModalFrame(beam_body(bristle, **how))
    except ValueError as error:
        raise ComputationError(
            f"{error}: bending is lost in round-off; the beam is too slender, shorten --length"
        ) from error


def _analytic(now: Entered[DropInputs]) -> DropResult:
    """Eqs. 1 to 8, up to the end of the impact where no more is asked for."""
    inputs, scene = now.inputs, now.scene
    mass, g = inputs.bristle().mass_kg, inputs.gravity_m_s2
    drag, start = scene.drag_kg_m / mass, scene.release_speed_m_s
    if drag or start:
        result = _launched(inputs, start, drag)
    else:
        result = analytic_drop(mass, inputs.kn_N_m, inputs.height_m, g)
    if inputs.until is Until.REBOUND:
        return result
    fall_s, _ = dragged_fall(inputs.height_m, g, start, drag)
    release_s = fall_s + result.contact_time_s
    end_s = release_s if inputs.until is Until.IMPACT else float(inputs.until)
    rows = [row for row in result.history.rows if row[0] <= end_s * (1.0 + 1e-12)]
    result = replace(result, history=History(rows))
    if end_s < release_s:
        result = replace(_pressed(result, inputs.kn_N_m, end_s - fall_s, end_s), **NOT_RELEASED)
    top_s = release_s + result.impact_speed_m_s / g
    return replace(result, **NO_REBOUND) if end_s < top_s else result


def _pressed(whole: DropResult, kn_N_m: float, since_touch_s: float, now_s: float) -> DropResult:
    """A ``whole`` analytic drop up to an instant of its impact (Eq. 7)."""
    phase = 0.5 * math.pi * since_touch_s / whole.time_to_max_penetration_s
    depth_m = whole.max_penetration_m * math.sin(phase)
    deepest_m = whole.max_penetration_m * math.sin(min(phase, 0.5 * math.pi))
    initial_J = whole.energy.initial_J
    held_J = initial_J * math.sin(phase) ** 2
    now = Energy(initial_J - held_J, 0.0, 0.0, held_J)
    before = [row for row in whole.history.rows if row[0] < now_s]
    last = (now_s, -depth_m, -depth_m, kn_N_m * depth_m, depth_m)
    return replace(
        whole,
        peak_force_N=kn_N_m * deepest_m,
        max_penetration_m=deepest_m,
        time_to_max_penetration_s=min(since_touch_s, whole.time_to_max_penetration_s),
        impulse_N_s=0.5 * whole.impulse_N_s * (1.0 - math.cos(phase)),
        energy=Budget.close(initial_J, now, 0.0),
        history=History([*before, last]),
    )


def _launched(inputs: DropInputs, speed_m_s: float, drag_1_m: float) -> DropResult:
    """The drop from rest that touches as fast; its history begins where both are together."""
    g, height = inputs.gravity_m_s2, inputs.height_m
    fall_s, speed = dragged_fall(height, g, speed_m_s, drag_1_m)
    same = speed * speed / (2.0 * g)
    result = analytic_drop(inputs.bristle().mass_kg, inputs.kn_N_m, same, g)
    ahead = speed / g - fall_s
    rows = [(row[0] - ahead, *row[1:]) for row in result.history.rows if row[0] >= ahead]
    top = float(risen(same, drag_1_m))
    return replace(
        result,
        rebound_height_m=top,
        cm_rebound_height_m=top,
        rebound_ratio=top / height,
        history=History(rows),
    )


def run_case(inputs: DropInputs, comm: MPI.Intracomm | None = None) -> tuple[DropResult, Timings]:
    """One case by itself: its result, and the seconds of mesh, assemble, factor, march, total.

    Collective over ``comm``, all ranks of the job unless it is given, for the reduced and the full
    solid. Raises ComputationError.
    """
    with CaseSession(comm) as session:
        return session.run(inputs)
