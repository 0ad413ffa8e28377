"""Closing the loop on a dataset: what the model lacks, and the error before and after.

`bristle close-loop DATASET`. Reads a dataset of any kind, runs the loop (studies.loop), confirms
what it found with the 3-D model, and writes verdict.json and one page. Also a script:
``python3 -m bristle.studies.close_loop DATASET``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.errors import InputError
from .. import __version__
from ..data.datasets import Manifest, read_manifest
from ..inputs.kinds import KINDS
from ..inputs.study_fields import LoopInputs
from ..loop.finding import Finding, p_text, plain
from ..loop.problem import Entry, Model, Problem
from ..loop.run import find, pieces
from ..running.files import new_folders, prepare_folder, together, write_json
from ..running.mark import refuse_foreign
from ..running.parallel import share_out, start_petsc
from ..running.progress import progress, working
from .confirm import LEFT_OUT, Confirmation, confirm
from .opening import few_data, names_of_groups, on_few, opening, times, would_have_shown
from .rows import Closed

SCHEMA = "bristle-close-loop-1"
VERDICT_FILE = "verdict.json"
# How the note begins on a column that is not used.
UNDECLARED = "left aside: the dataset declares no "


def run_close_loop(
    dataset: Path,
    out: Path | None,
    inputs: LoopInputs | None = None,
    *,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> dict[str, Any]:
    """Run the loop on the dataset in a folder; write ``verdict.json``, ``report.html``, its tables
    and figures into ``out``, or nothing where that is None.

    Returns what verdict.json holds. Collective: rank 0 works, with solids of its own, so that the
    result does not depend on the number of ranks. Raises InputError where the dataset or an option
    is wrong, ComputationError where a simulation fails; nothing is written then.
    """
    asked, dataset = inputs or LoopInputs(), Path(dataset)
    if not asked.no_3d:
        start_petsc(comm)
    manifest = run_on_one_rank(comm, lambda: _begun(dataset, out))
    slow = ", which takes minutes the first time" if manifest.kind == "forces" else ""
    with working(f"preparing the data{slow}"):
        problem = _made(lambda: problem_of(manifest), comm)
    with progress("Effects simulated", len(problem.candidates), alike=False) as advance:
        _simulate(problem, comm, advance)
    return run_on_one_rank(comm, lambda: _run(manifest, problem, out, asked))


def close_several(
    datasets: Sequence[tuple[Manifest, Callable[[], Problem]]], comm: MPI.Intracomm
) -> list[Closed]:
    """Run the loop on several datasets, each given with what makes it a problem.

    Without the 3-D model; dealt out over the ranks. Returns what was found in their order on rank
    0, an empty list elsewhere. Collective; raises InputError and ComputationError on all ranks.
    """
    asked, problems = LoopInputs(no_3d=True), []
    with progress("Datasets prepared", len(datasets)) as advance:
        for _, make in datasets:  # in turn, since they may share what is simulated
            problems.append(_made(make, comm))
            _simulate(problems[-1], comm)
            advance()
    found: dict[int, Finding] = {}
    with progress("Loops closed", len(datasets)) as advance:

        def take(i: int, finding: Finding) -> None:
            found[i] = finding
            advance()

        def search(i: int) -> Finding:
            finding = find(problems[i], asked.seed, asked.alarm)
            return finding if comm.rank == 0 else sendable(finding)

        share_out(comm, len(problems), search, take)
    left_out = Confirmation(None, LEFT_OUT)
    return [Closed(datasets[i][0], asked, found[i], left_out) for i in sorted(found)]


def sendable(finding: Finding) -> Finding:
    """The finding as another rank can have it: its problem makes no other models there."""
    own = replace(finding.problem, experiments=(), confirm=None, with_sigma=None)
    return replace(finding, problem=replace(own, combine=_combined))


def _combined(effects: tuple[str, ...]) -> Model:
    raise NotImplementedError(f"{effects}: models are made on the rank that ran the loop")


def _made(make: Callable[[], Problem], comm: MPI.Intracomm) -> Problem:
    """The problem on every rank, first on rank 0: what that keeps on the disk serves the others."""
    first: list[Problem] = []  # which cannot be sent
    run_on_one_rank(comm, lambda: first.append(make()))
    return first[0] if first else make()


def _begun(dataset: Path, out: Path | None) -> Manifest:
    """The dataset's declarations; InputError where they or ``out`` are no good, long before both
    are needed."""
    manifest = read_manifest(dataset)
    if out is not None:
        there = next(each for each in (out.absolute(), *out.absolute().parents) if each.exists())
        if not there.is_dir():
            raise InputError(f"--out {out}: {there} is a file, not a folder")
        refuse_foreign(out, *_files())
    return manifest


def _files() -> tuple[str, ...]:
    """All that the loop writes."""
    from ..report.page import REPORT_FILES  # slow to import: not before the dataset is read

    return VERDICT_FILE, *REPORT_FILES


def _simulate(
    problem: Problem, comm: MPI.Intracomm, advance: Callable[[], None] = lambda: None
) -> None:
    """Have every candidate predict once, dealt out over the ranks.

    Some of them first simulate thousands of drops, which are then kept on the disk for all ranks
    and for the next run. Collective; raises ComputationError where they fail.
    """
    candidates = problem.candidates[::-1]  # what takes longest to simulate stands last

    def predict(i: int) -> None:
        candidates[i].predict(np.array([each.typical for each in candidates[i].parameters]))

    if comm.size > 1:
        share_out(comm, len(candidates), predict, lambda i, nothing: advance())
        return
    for i in range(len(candidates)):
        predict(i)
        advance()


def _run(
    manifest: Manifest, problem: Problem, out: Path | None, inputs: LoopInputs
) -> dict[str, Any]:
    if out is None:
        return verdict(close(manifest, problem, inputs))
    from .page import write_page

    with new_folders(out):
        prepare_folder(out, *_files())
        closed = close(manifest, problem, inputs)
        content = verdict(closed)
        with together(out, VERDICT_FILE):
            write_page(closed, out)
            return write_json(out / VERDICT_FILE, content)


def close(manifest: Manifest, problem: Problem, inputs: LoopInputs) -> Closed:
    """Run the loop on a problem, and confirm with the 3-D model what it found."""
    with progress("Steps of the search", pieces(problem)) as advance:
        finding = find(problem, inputs.seed, inputs.alarm, advance)
    if inputs.no_3d:
        confirmation = Confirmation(None, LEFT_OUT)
    else:
        solid = problem.confirm is not None
        with working("confirming in three dimensions") if solid else nullcontext():
            confirmation = confirm(finding)
    return Closed(manifest, inputs, finding, confirmation)


def problem_of(manifest: Manifest) -> Problem:
    """The dataset, read and made a problem. Raises InputError."""
    try:
        read = KINDS[manifest.kind].load()
    except (ImportError, AttributeError) as error:
        raise manifest.wrong(
            "kind", f"is {manifest.kind}, which cannot be loaded: {error}"
        ) from None
    found = read(manifest.folder)
    if not isinstance(found, Problem):
        raise manifest.wrong("kind", f"is {manifest.kind}, whose function returns no Problem")
    doubts = [manifest.lengths_doubt] if manifest.lengths_doubt else []
    if isinstance(KINDS[manifest.kind], EntryPoint) and manifest.unread:
        doubts.append(f"nothing reads these of [measurement]: {', '.join(manifest.unread)}")
    return _doubted(found, doubts)


def _doubted(problem: Problem, doubts: Sequence[str]) -> Problem:
    """The problem with these doubts, and one for each column whose errors nobody declared; also
    with other errors."""
    unused = [
        f"{name} is {words}; declare it, and this column is used too"
        for name, words in problem.notes.items()
        if str(words).startswith(UNDECLARED)
    ]
    again = problem.with_sigma
    return replace(
        problem,
        warnings=(*problem.warnings, *doubts, *unused),
        with_sigma=None if again is None else lambda times: _doubted(again(times), doubts),
    )


def verdict(closed: Closed) -> dict[str, Any]:
    """What ``verdict.json`` holds: CONTRACT.md's keys, and what repeats and explains the run."""
    finding, problem = closed.finding, closed.problem
    return {
        "schema": SCHEMA,
        "version": __version__,
        **finding.verdict_json(),
        "warnings": closed.warnings,
        "in_words": opening(finding),
        "would_have_shown": would_have_shown(finding, problem),
        "few_data": few_data(finding, problem, closed.manifest.kind),
        **closed.confirmation.keys(),
        "kind": closed.manifest.kind,
        "title": closed.manifest.title,
        "n_groups": len(np.unique(problem.group)),
        "n_values": len(problem.values),
        "alarm": finding.alarm,
        "tests": plain(finding.tests),
        "tests_after": plain(finding.tests_after),
        "evidence": [
            {key: value for key, value in plain(each).items() if key != "theta"}
            for each in finding.evidences
        ],
        "unlisted": {"shape": finding.shape, "log_evidence": finding.unlisted},
        "inputs": closed.inputs.model_dump(mode="json"),
    }


def summary(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of what a terminal shows."""
    held, solid = content["held_out"], content["confirmed_in_3d"]
    names = [f"{name} ({content['probabilities'][name]:.2f})" for name in content["effects"]]
    rows = [("verdict", content["verdict"])]
    if names:
        rows.append(("effects", ", ".join(names)))
    told = {"in words": content["in_words"][: 2 if content["lead"] else 1]}
    if content["few_data"] is not None:
        told["few data"] = on_few(content["few_data"])
    elif content["verdict"] == "adequate":
        told["would have shown"] = content["would_have_shown"]
    for label, lines in told.items():
        rows += zip([label, *[""] * len(lines)], lines, strict=False)
    first, last = content["detection"]["p_value"], content["open_set"]["p_value"]
    chance = f"{p_text(first)}: chance makes data as odd as these {times(first)}"
    if content["verdict"] != "adequate" and first > content["alarm"]:
        chance = f"{p_text(first)} by the tests of these data alone; the doubts say what shows it"
    rows.append(("something is missing", chance))
    beside = ""
    if content["verdict"] == "unknown" and content["nearest"]:
        beside = f"with {' and '.join(content['nearest']['effects'])} in the model, "
    left = f"{beside}{p_text(last)}: chance leaves as much {times(last)}"
    rows.append(("something is left", left))
    for name, each in content["parameters"].items():
        value = f"{each['estimate']:.4g} ({each['low']:.4g} to {each['high']:.4g}) {each['unit']}"
        rows.append((name, value.rstrip()))
    if held:
        rows.append(("held-out error", f"{_change(held, held['unit'])}; noise {held['noise']:.3g}"))
        if names:
            low, high = held["log_score_gain_low"], held["log_score_gain_high"]
            gain = f"{held['log_score_gain']:+.3g} ({low:+.3g} to {high:+.3g})"
            rows.append(("held-out log score", gain))
        rows.append(("held-out in 90 %", f"{100 * held['coverage_90']:.0f} %"))
    if solid:
        rows.append(("the same in 3-D", _change(solid, solid["unit"])))
    if content["next_experiment"]:
        rows.append(("measure next", content["next_experiment"]["change"]))
    rows += [("doubt", each) for each in content["warnings"]]
    rows += [("left aside", each) for each in content["left_aside"]]
    one, several = names_of_groups(content["kind"])
    wrong = [Entry(**each).words(one, several) for each in content["bookkeeping"]]
    rows += [("written wrongly?", each) for each in wrong]
    return rows


def _change(errors: dict[str, Any], unit: str) -> str:
    """Errors before and after, once where nothing was added in between."""
    if errors["rms_before"] == errors["rms_after"]:
        return f"{errors['rms_after']:.3g} {unit}"
    return f"{errors['rms_before']:.3g} to {errors['rms_after']:.3g} {unit}"
