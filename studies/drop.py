"""`bristle drop`: one drop, with `result.json`, `history.csv`, and the solid's ParaView series.

Also a script: ``mpirun -n 2 python3 -m bristle.studies.drop --model solid``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ..meshes.collective import run_on_one_rank
from ..solver.checkpoint import Checkpoint
from ..solver.contact_phase import HISTORY_COLUMNS
from ..solver.drop import DropResult
from .command.script import as_script
from .inputs.choices import Model
from .inputs.config import DropInputs
from .inputs.fields import FLAT
from .inputs.limits import input_warnings, result_warnings
from .inputs.values import ANGLES
from .running import results
from .running.cases import CaseSession, Prepared, Timings, session_on
from .running.files import (
    folder_in_place,
    remove,
    to_csv,
    together,
    write_atomically,
    write_json,
)
from .running.parallel import all_ranks, by_rank_0
from .running.progress import compilation_noted, progress, say, warn, working
from .running.steps import Watched, steps_of_contact

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..solver.bodies.reduced import ReducedModel
    from ..solver.bodies.solid import SolidBody
    from ..solver.contact_phase import Observer
    from ..solver.time.march import ContactMarch

    Observe = Callable[[SolidBody, ContactMarch], Observer]

FIELDS = "fields"
# All that a drop writes.
FILES = (results.RESULT_FILE, results.HISTORY_FILE, f"{FIELDS}/", f"{results.CHECKPOINT}/")
# Seconds between the marks of a long march.
KEEP_S = 60.0
# Losses below this share of the impact's energy are none.
ROUNDING = 1e-9


def run_drop(
    inputs: DropInputs,
    out: Path,
    comm: MPI.Intracomm | None = None,
    *,
    session: CaseSession | None = None,
    resume: bool = False,
    keep_s: float = KEEP_S,
    observe: Observe | None = None,
) -> dict[str, Any]:
    """Compute a drop into the folder ``out``; returns what result.json holds, on every rank.

    With a ``session`` its ranks compute it, and what it keeps serves. ``observe`` makes a further
    observer of the march of a solid.
    With ``resume`` a finished result of the same inputs and version is kept, and returned; one that
    was interrupted while it was marched step by step goes on from its last mark, made every
    ``keep_s`` seconds.
    Collective over ``comm``, all ranks of the job unless it is given. Raises InputError where
    ``out`` cannot be used or holds another drop's result, and ComputationError; what ``out`` held
    before is then still there.
    """
    out, comm = Path(out), session.comm if session else comm or all_ranks()
    there = run_on_one_rank(comm, lambda: results.prepare(inputs, out, *FILES, resume=resume))
    if there is not None:
        say(f"{out / results.RESULT_FILE} is finished already, nothing to do")
        return there
    warnings = _warned(input_warnings(inputs))
    with by_rank_0(together(out, results.RESULT_FILE), comm):
        earlier = out / FIELDS, out / results.SCRIPT_FILE
        run_on_one_rank(comm, lambda: remove(*earlier))
        with compilation_noted(), session_on(comm, session) as own:
            how = {"every_s": keep_s, "resume": resume}
            result, timings = _compute(inputs, out, own, observe, **how)
        document = _document(inputs, result, timings, warnings, comm)

        def write() -> dict[str, Any]:
            history = to_csv(HISTORY_COLUMNS, list(result.history.array()))
            write_atomically(out / results.HISTORY_FILE, history)
            return write_json(out / results.RESULT_FILE, document)

        written = run_on_one_rank(comm, write)
    run_on_one_rank(comm, lambda: results.forget_checkpoint(out))
    return written


def simulate_drop(
    inputs: DropInputs, session: CaseSession, observe: Observe | None = None
) -> tuple[dict[str, Any], DropResult]:
    """Compute a drop without writing anything: what result.json would hold, and the result.

    ``observe`` is that of `run_drop`.

    Collective; raises ComputationError.
    """
    warnings = _warned(input_warnings(inputs))
    session.trim()
    with compilation_noted():
        prepared, observer = session.prepare(inputs), None
        if observe is not None and prepared is not None and inputs.model is Model.SOLID:
            observer = _observer(observe, prepared)
        result, timings = session.run(inputs, observer, prepared)
    return _document(inputs, result, timings, warnings, session.comm), result


def _warned(messages: list[str]) -> list[str]:
    """The messages, once the user has been warned."""
    for message in messages:
        warn(message)
    return messages


def _document(
    inputs: DropInputs,
    result: DropResult,
    timings: Timings,
    warnings: list[str],
    comm: MPI.Intracomm,
) -> dict[str, Any]:
    """All of result.json, beside earlier ``warnings`` those of the result; collective."""
    return {
        **results.head(inputs),
        "model": inputs.model.value,
        "contact": inputs.contact.value,
        "deflection": inputs.resolved_deflection.value,
        **{name: results.number(name, inputs, result) for name in results.NUMBERS},
        "energy": asdict(result.energy),
        "reduction_error": result.reduction_error,
        "warnings": [*warnings, *_warned(result_warnings(inputs, result))],
        "wall_s": timings,
        **results.resources(comm),
    }


def _observer(observe: Observe, prepared: Prepared) -> Observer:
    return observe(cast("SolidBody", prepared.frame.body), prepared.marcher)


def _compute(
    inputs: DropInputs, out: Path, session: CaseSession, observe: Observe | None, **how: Any
) -> tuple[DropResult, Timings]:
    """The drop, kept in ``out`` while it is marched: ``how`` is that of a `Checkpoint`."""
    building = working(f"building the {inputs.model} model")
    with building if inputs.model.meshed else nullcontext():
        prepared = session.prepare(inputs)
    if prepared is not None and inputs.model is Model.SOLID:
        mesh = {"mesh": cast("SolidBody", prepared.frame.body).digest()}
        checkpoint = results.checkpoint(inputs, out, session.comm, mesh, **how)
        further = [] if observe is None else [_observer(observe, prepared)]
        return _marched_solid(session, inputs, prepared, checkpoint, out / FIELDS, further)
    # compiled code is done with soon
    with working(f"dropping the {inputs.model} model from {inputs.height_m:g} m"):
        return session.run(inputs, prepared=prepared)


def _marched_solid(
    session: CaseSession,
    inputs: DropInputs,
    prepared: Prepared,
    checkpoint: Checkpoint,
    folder: Path,
    further: list[Observer],
) -> tuple[DropResult, Timings]:
    """The drop of a solid, with its fields for ParaView where they are asked for, and ``further``
    observers."""
    expected = steps_of_contact(inputs.bristle(), inputs.kn_N_m, inputs.its_s)
    with ExitStack() as stack:
        writer = None
        if inputs.write_fields:
            from ..solver.paraview import FLIGHT_FRAMES, FieldWriter

            made = stack.enter_context(by_rank_0(folder_in_place(folder), session.comm))
            body, every = cast("SolidBody", prepared.frame.body), inputs.write_every
            frame = cast("ReducedModel", prepared.frame)
            flight = body, made, prepared.marcher, frame
            writer = stack.enter_context(FieldWriter(*flight, every=every, checkpoint=checkpoint))
        with progress("contact of the solid, expected steps", expected) as advance:
            observers = further if writer is None else [writer, *further]
            watched = Watched(inputs.its_s, advance, *observers)
            done = session.run(inputs, watched, prepared, checkpoint)
        if writer is not None:
            with progress("flight of the solid, frames", FLIGHT_FRAMES) as advance:
                writer.write_flight(advance=advance)
        return done


def summary(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The few numbers of a result that a user looks for first, as names and texts."""
    leaning = any(document["inputs"][name] for name in ANGLES) or (
        document["inputs"]["tip_shape"] != FLAT
    )
    shown = (
        ("impact speed", "impact_speed_m_s", 1.0, "m/s"),
        ("rebound ratio y1/y0", "rebound_ratio", 1.0, ""),
        ("rebound height", "rebound_height_m", 1e3, "mm"),
        ("contact time", "contact_time_s", 1e3, "ms"),
        ("peak force", "peak_force_N", 1.0, "N"),
        ("greatest penetration", "max_penetration_m", 1e6, "µm"),
    )
    rows = [
        (name, f"{scale * document[key]:.4g} {unit}".strip())
        for name, key, scale, unit in shown
        if document[key] is not None
    ]
    if leaning:
        rows.append(("touches", str(document["n_contacts"])))
        if (ratio := document["cm_rebound_ratio"]) is not None:
            rows.append(("centre of mass y1/y0", f"{ratio:.4g}"))
    energy = document["energy"]
    for name in ("friction", "contact", "drag"):
        if (lost := energy[f"{name}_loss_J"]) > ROUNDING * energy["initial_J"]:
            rows.append((f"lost to {name}", f"{1e6 * lost:.3g} µJ"))
    rows.append(("energy closes to", f"{energy['closure_relative']:.1g}"))
    return [*rows, ("wall time", f"{document['wall_s']['total']:.3g} s")]


if __name__ == "__main__":
    as_script("drop")
