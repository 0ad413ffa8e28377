"""`bristle brush`: bristles clamped in a moving hub, on a surface.

Writes result.json, hub.csv, means.csv, tips.csv, report.html and the series for ParaView. Also a
script: ``mpirun -n 2 python3 -m bristle.studies.brush --layout cup --count 240``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...meshes.collective import run_on_one_rank, with_mpi
from ...solver.rods.frame import Frame
from ...solver.rods.ground import Contact
from ...solver.rods.rods import BOW_RAD, Rods
from ...solver.rods.section import RodSection
from ..inputs.choices import Motion
from ..inputs.limits import unit_warnings
from ..report.page import REPORT_FILES
from ..running import results
from ..running.files import folder_in_place, remove, together, write_atomically, write_json
from ..running.parallel import all_ranks, by_rank_0
from ..running.progress import compilation_noted, progress, say, warn
from ..surface.ground import surface_facts, surface_of
from ..surface.rough import Surface
from .inputs import BrushInputs
from .page import write_page
from .record import Record, from_arrays, to_arrays

if TYPE_CHECKING:
    from mpi4py import MPI

HUB_FILE, MEANS_FILE, TIPS_FILE, FIELDS = "hub.csv", "means.csv", "tips.csv", "fields"
# All that a brush writes.
FILES = (
    *(results.RESULT_FILE, HUB_FILE, MEANS_FILE, TIPS_FILE),
    *(f"{FIELDS}/", f"{results.CHECKPOINT}/"),
    *REPORT_FILES,
)
# Seconds between the marks of a long march.
KEEP_S = 60.0
# Share of the mean force beyond which its standard error deserves a warning.
UNSURE = 0.2
# Share of all energy beyond which what the time steps lose deserves a warning.
CLOSURE = 0.01
# The surface for ParaView reaches so many lengths beyond the tips, or so far where it is rough.
REACH, ROUGH_REACH_M = 0.25, 5e-3


def run_brush(
    inputs: BrushInputs,
    out: Path,
    comm: MPI.Intracomm | None = None,
    *,
    resume: bool = False,
    keep_s: float = KEEP_S,
) -> dict[str, Any]:
    """Compute a brush into the folder ``out``; returns what result.json holds, on every rank.

    With ``resume`` a finished result of the same inputs and version is kept, and returned; one that
    was interrupted goes on from its last mark, made every ``keep_s`` seconds.
    Collective over ``comm``, all ranks of the job unless it is given. Raises InputError where
    ``out`` cannot be used or holds another brush's result, and ComputationError; what ``out`` held
    before is then still there.
    """
    out, comm, started = Path(out), comm or all_ranks(), time.perf_counter()
    there = run_on_one_rank(comm, lambda: results.prepare(inputs, out, *FILES, resume=resume))
    if there is not None:
        say(f"{out / results.RESULT_FILE} is finished already, nothing to do")
        return there
    warnings = [*unit_warnings(inputs), *_buckling_warnings(inputs)]
    for message in warnings:
        warn(message)
    with ExitStack() as stack:
        stack.enter_context(by_rank_0(together(out, results.RESULT_FILE), comm))
        folder = None
        if inputs.write_fields:
            folder = stack.enter_context(by_rank_0(folder_in_place(out / FIELDS), comm))
        # a file of heights may be gone when the march ends
        surface, first_touch_m = surface_of(inputs), inputs.first_touch_m
        with compilation_noted():
            rods = make_rods(inputs, comm)
            record = _march(inputs, rods, Record(folder), out, comm, resume, keep_s)
        wall_s = {"march": time.perf_counter() - started}
        facts = {"peak_rss_MB": results.peak_rss_MB(comm), "ranks": comm.size}

        def write() -> dict[str, Any]:
            reach_m = ROUGH_REACH_M if surface else REACH * inputs.bristle().length_m
            record.finish(reach_m, surface)
            document = _document(inputs, record, surface, first_touch_m, warnings)
            if not inputs.write_fields:
                remove(out / FIELDS)
            tables = record.hub_table(), record.mean_table(), record.tip_table()
            for name, table in zip((HUB_FILE, MEANS_FILE, TIPS_FILE), tables, strict=True):
                write_atomically(out / name, table.to_csv(index=False))
            write_page(inputs, record, document, out)
            wall_s["total"] = time.perf_counter() - started
            return write_json(out / results.RESULT_FILE, document | {"wall_s": wall_s} | facts)

        written = run_on_one_rank(comm, write)
    run_on_one_rank(comm, lambda: results.forget_checkpoint(out))
    return written


def make_rods(inputs: BrushInputs, comm: MPI.Intracomm) -> Rods:
    """The solver's rods at the start; collective."""
    assert inputs.friction_between is not None
    assert inputs.kt_ratio is not None
    between = None
    if inputs.touch_each_other and inputs.count > 1:
        mu = inputs.friction_between
        between = Contact(inputs.stiffness_N_m, mu, mu, kt_over_kn=inputs.kt_ratio)
    return Rods(
        RodSection.of(inputs.bristle()),
        inputs.clamps,
        inputs.hub_motion,
        inputs.ground,
        inputs.elements,
        between=between,
        gravity_m_s2=inputs.gravity_m_s2,
        bow_rad=-BOW_RAD if inputs.upright else 0.0,
        tolerance=inputs.tolerance,
        comm=with_mpi(comm),
    )


def _march(
    inputs: BrushInputs,
    rods: Rods,
    record: Record,
    out: Path,
    comm: MPI.Intracomm,
    resume: bool,
    keep_s: float,
) -> Record:
    """March to the end, and note each frame on rank 0 and in the checkpoint."""
    kept = results.checkpoint(inputs, out, comm, every_s=keep_s, resume=resume, look=1)
    mark = kept.begin()

    def note(frame: Frame) -> None:
        if comm.rank == 0:
            record.take(frame)
        kept.keep_frame(to_arrays(frame) if comm.rank == 0 else {})

    if mark is None:
        note(rods.frame())
    else:
        rods.restore(mark.arrays)
        for arrays in mark.frames if comm.rank == 0 else ():
            record.take(from_arrays(arrays))
    done = 0 if mark is None else mark.steps
    with progress("brush", math.ceil(inputs.duration_s / inputs.interval_s), done=done) as advance:
        for frame in rods.march(inputs.duration_s, inputs.interval_s):
            done += 1
            note(frame)
            if kept.due():
                kept.save(done, rods.checkpoint())
            advance(words=f"force {np.linalg.norm(frame.force_N):.3g} N")
    return record


def _document(
    inputs: BrushInputs,
    record: Record,
    surface: Surface | None,
    first_touch_m: float,
    warnings: list[str],
) -> dict[str, Any]:
    """What result.json holds but for what the run took."""
    found = record.summary(inputs.steady_from_s)
    more = [*_result_warnings(inputs, record, found)]
    for message in more:
        warn(message)
    return {
        **results.head(inputs),
        "n_bristles": inputs.count,
        "hub_at_first_touch_m": first_touch_m,
        "surface": None if surface is None else surface_facts(surface),
        **found,
        "warnings": [*warnings, *more],
    }


def _buckling_warnings(inputs: BrushInputs) -> list[str]:
    if not inputs.upright or inputs.motion.kind is not Motion.PRESS or inputs.angle_std_deg:
        return []
    return [
        "upright bristles are pressed along their axes: they buckle, and which way is an "
        f"assumption, since their tips point {BOW_RAD:g} rad off; give --mount-angle or --angle-std"
    ]


def _result_warnings(
    inputs: BrushInputs, record: Record, found: Mapping[str, Any]
) -> Iterator[str]:
    """What of a result deserves doubt: bristles that yield, means that are not those of a steady
    state, or not sure, a surface that is not touched, and lost energy."""
    stress, limit = found["bending_stress"], inputs.yield_strength_Pa
    if limit is not None and stress["greatest_Pa"] > limit:
        yield (
            f"bristle {stress['bristle']} bends to {1e-6 * stress['greatest_Pa']:.4g} MPa at "
            f"{stress['t_s']:.4g} s, and yields at {1e-6 * limit:.4g} MPa: it would stay bent, "
            "which is not computed; take less --penetration, or give the wire's own "
            "--yield-strength"
        )
    mean, error = found["force_N"]["mean"], found["force_N"]["mean_error"]
    if inputs.duration_s <= inputs.steady_from_s:
        yield (
            "the run ends before the hub has come down and reached its speed: what is called a "
            "mean is that of the last window alone; give --until more than --start"
        )
    elif error is not None and np.linalg.norm(error) > UNSURE * np.linalg.norm(mean):
        yield (
            f"the mean force is known to ±{np.linalg.norm(error):.2g} N only, because it varies; "
            "give a longer --until"
        )
    if not any(frame.state.any() for frame in record.frames):
        yield (
            "no bristle touches the surface, so that the hub carries weight and inertia alone; "
            "raise --penetration"
        )
    closure = found["energy"]["closure_relative"]
    if closure > CLOSURE:
        yield (
            f"the time steps take or give {closure:.2g} of the energy that goes through the brush: "
            "forces may be off by as much; take a smaller --tolerance"
        )


def summary(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The few numbers of a result that a user looks for first, as names and texts."""
    force, torque, tips = document["force_N"], document["torque_Nm"], document["tips_share"]
    stress = document["bending_stress"]
    rows = [
        ("mean force on the hub", f"{', '.join(f'{each:.4g}' for each in force['mean'])} N"),
        ("greatest force", f"{force['greatest_size']:.4g} N at {force['greatest_at_s']:.4g} s"),
        ("mean torque on the hub", f"{', '.join(f'{each:.4g}' for each in torque['mean'])} N m"),
        ("tips in contact", f"{100.0 * tips['in_contact']:.3g} %"),
        ("sticking, slipping", f"{100 * tips['sticking']:.3g} %, {100 * tips['slipping']:.3g} %"),
        ("greatest bending stress", f"{1e-6 * stress['greatest_Pa']:.4g} MPa"),
        ("lost to friction", f"{document['energy']['friction_loss_J']:.3g} J"),
        ("energy closes to", f"{document['energy']['closure_relative']:.1g}"),
    ]
    return [*rows, ("wall time", f"{document['wall_s']['total']:.3g} s")]
