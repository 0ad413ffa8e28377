"""A study: many cases computed, journalled, and put into a table."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence, Sized
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import numpy as np
from mpi4py import MPI
from pydantic import PrivateAttr, ValidationInfo, model_validator

from ...meshes.collective import run_on_one_rank
from ...solver.drop import DropResult
from ...solver.errors import ComputationError
from ..inputs.choices import Model
from ..inputs.config import DropInputs, Inputs
from ..inputs.fields import DiscretisationFields, HeightsField, ListFields
from ..inputs.limits import input_warnings, result_warnings
from ..inputs.sources import checked
from . import results
from .cases import CaseSession, session_on
from .files import to_csv, together, write_atomically, write_json
from .groups import build_reduced, refuse_more_ranks, run_cases
from .journal import Journal
from .progress import progress, say, warn, working

CASES = 100_000
TABLE_FILE = "table.csv"
COLUMNS = (
    *("model", "contact", "kn_N_m", "y0_m", "its_s", "rebound_ratio", "contact_time_s"),
    *("peak_force_N", "max_penetration_m", "energy_closure", "wall_s"),
    *("time_to_max_penetration_s", "impulse_N_s", "cm_velocity_after_m_s", "n_contacts"),
    *("n_steps", "n_dofs", "reduction_error", "cm_rebound_ratio"),
    *("friction_impulse_N_s", "friction_loss_J"),
)
CURVE_POINTS = 120
# What models have no use for.
DIVISION = set(DiscretisationFields.model_fields)
UNUSED = {
    Model.ANALYTIC: DIVISION,
    Model.BEAM: DIVISION - {"elements"},
    Model.REDUCED: {"elements"},
    Model.SOLID: {"elements"},
}

Row = dict[str, Any]
Sessions = Callable[[], AbstractContextManager[CaseSession]]


def check_number(*lists: Sized) -> None:
    """ValueError where lists make more cases than a study may have."""
    if math.prod(map(len, lists)) > CASES:
        raise ValueError(f"the lists make more than {CASES:,} cases")


class StudyInputs(Inputs, ListFields, HeightsField):
    """Lists of models, stiffnesses, heights and time steps: a case for each combination.

    A case that is impossible is refused by the place in a file where its value stands, if any.
    """

    _places: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _of_mesh(cls, data: Any) -> Any:
        """The one default model that a mesh has."""
        if isinstance(data, dict) and data.get("mesh") is not None and data.get("models") is None:
            return {**data, "models": (Model.REDUCED,)}
        return data

    @model_validator(mode="after")
    def _few_enough(self, info: ValidationInfo) -> Self:
        check_number(self.models, self.kn_N_m, self.heights_m, self.its_s)
        origins = (info.context or {}).get("origins", {})
        in_file = {name: place for name, place in origins.items() if not place.startswith("--")}
        one_of = {"models": "model", "heights_m": "height_m"}
        self._places = {one_of.get(name, name): place for name, place in in_file.items()}
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Further inputs of which there are several."""
        return ()

    def shared(self) -> list[dict[str, Any]]:
        """What cases have beside model, stiffness, height and step, of each combination."""
        return [self.model_dump(exclude=LIST_FIELDS)]

    def cases(self) -> list[DropInputs]:
        """Every combination once, in the order of the table; InputError where one is impossible."""
        return [
            checked(
                DropInputs,
                {**shared, "model": model, "kn_N_m": kn, "height_m": height, "its_s": its},
                self._places,
            )
            for model in sorted(set(self.models), key=list(Model).index)
            for shared in self.shared()
            for kn in sorted(set(self.kn_N_m))
            for height in sorted(set(self.heights_m))
            for its in sorted(set(self.its_s), reverse=True)
        ]


# The fields of lists that every study has.
LIST_FIELDS = set(StudyInputs.model_fields) - set(Inputs.model_fields)


@dataclass(frozen=True)
class Study:
    """What tells one study from another: its name, its result, and what it makes of its rows.

    ``finish`` writes figures and further tables into a folder, on one rank, and returns what the
    study's JSON says besides; ``files`` are all that it may write, folders with a slash at their
    end. With ``curves`` rows have the tip's path over time, for figures. ``basis_its_s`` is the ITS
    that reduced models are made for, or None for each case's own. ``varied`` are further inputs
    that differ between cases, which rows have too. With ``failures`` a case that fails is a row
    without values, its error among its warnings.
    """

    name: str
    finish: Callable[[Sequence[Row], Path], dict[str, Any]] = lambda rows, out: {}
    curves: bool = False
    basis_its_s: float | None = None
    varied: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    failures: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """The table's."""
        return tuple(dict.fromkeys((*COLUMNS, *self.varied)))

    @property
    def document(self) -> str:
        return f"{self.name}.json"


def run_study[Asked: StudyInputs](
    study_of: Callable[[Asked], Study],
    inputs: Asked,
    out: Path,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    session: CaseSession | None = None,
    resume: bool = False,
    ranks_per_case: int | None = None,
) -> None:
    """Compute every case and write table.csv, the study's own files, and last its JSON.

    ``study_of`` makes the study of its inputs. Cases are spread over the ranks
    (`groups.run_cases`). With a ``session`` its ranks compute them, and what it keeps serves.
    With ``resume`` finished cases in ``out`` are kept, those of shorter lists too. Collective.
    Raises InputError where ``out`` cannot be used or has no case of this study, and
    ComputationError.
    """
    comm = comm if session is None else session.comm
    out, started = Path(out), time.perf_counter()
    study, cases = study_of(inputs), inputs.cases()
    refuse_more_ranks(cases, comm.size, ranks_per_case)
    names = _names(study, cases)
    journal = Journal(out, inputs, names)
    files = (study.document, TABLE_FILE, *study.files)
    done = run_on_one_rank(comm, lambda: journal.prepare(*files, resume=resume))
    if done is None:
        say(f"{out / study.document} is finished already, nothing to do")
        return
    if done:
        say(f"{len(done)} of {len(cases)} cases are there already")
    done = {i: {**row, **_varied(study, cases[i])} for i, row in done.items()}
    sessions = partial(session_on, comm, session, study.basis_its_s)
    spent = {"shared": _compute(study, cases, names, sessions, done, journal.add, ranks_per_case)}
    facts = {"wall_s": spent, **results.resources(comm)}

    @together(out, study.document)
    def write() -> None:
        rows = [done[i] for i in range(len(cases))]
        spent["cases"] = sum(row["wall_s"] for row in rows)
        extra = study.finish(rows, out)
        table = to_csv(study.columns, [[row[name] for name in study.columns] for row in rows])
        write_atomically(out / TABLE_FILE, table)
        which = ("model", "kn_N_m", "y0_m", "its_s", *study.varied, "warnings")
        warnings = [{name: row[name] for name in which} for row in rows if row["warnings"]]
        if warnings:
            warn(f"{len(warnings)} of {len(rows)} cases have warnings, see {out / study.document}")
        spent["total"] = time.perf_counter() - started
        head = {**results.head(inputs), "n_cases": len(rows), **extra, **facts}
        write_json(out / study.document, {**head, "warnings": warnings})

    run_on_one_rank(comm, write)
    if comm.rank == 0:
        journal.finish()
        say(f"{len(cases)} cases in {out / TABLE_FILE}")


def rows_of(study: Study, cases: Sequence[DropInputs], session: CaseSession) -> list[Row]:
    """A row for every case, on every rank, without writing anything. Raises ComputationError."""
    done: dict[int, Row] = {}
    sessions = partial(session_on, session.comm, session, study.basis_its_s)
    _compute(study, cases, _names(study, cases), sessions, done, lambda i, row: row)
    done = session.comm.bcast(done)
    return [done[i] for i in range(len(cases))]


def _names(study: Study, cases: Sequence[DropInputs]) -> list[str]:
    """What tells cases apart: all inputs but those that their model has no use for."""
    return [
        sha256(
            f"{study.name} {case.model_dump_json(exclude=UNUSED[case.model])}".encode()
        ).hexdigest()
        for case in cases
    ]


def _compute(
    study: Study,
    cases: Sequence[DropInputs],
    names: Sequence[str],
    sessions: Sessions,
    done: dict[int, Row],
    keep: Callable[[int, Row], Row],
    ranks_per_case: int | None = None,
) -> float:
    """Fill ``done`` on rank 0 with what is missing and ``keep`` has kept; the seconds of what the
    cases shared.

    Cases with the same of the ``names`` are computed once.
    """
    alike: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        if i not in done:
            alike.setdefault(name, []).append(i)
    same = {each[0]: each for each in alike.values()}
    parts: dict[tuple[Any, ...], list[int]] = {}
    for i in same:
        parts.setdefault(tuple(getattr(cases[i], name) for name in study.varied), []).append(i)
    shared_s = 0.0
    with progress(study.name, len(cases), done=len(done)) as advance:

        def take(part: Sequence[int], k: int, row: Row) -> None:
            kept = keep(part[k], row)
            for i in same[part[k]]:
                done[i] = {**kept, **_varied(study, cases[i])}
                advance()

        for part in parts.values():  # in turn, since each has bodies of its own
            own = [cases[i] for i in part]
            with sessions() as session:
                if any(case.model is Model.REDUCED for case in own):
                    with working("building the reduced model"):
                        build_reduced(session, own)
                shared_s += session.take_timings()["total"]
                run_cases(session, own, partial(_row, study), partial(take, part), ranks_per_case)
    return shared_s


def _row(study: Study, session: CaseSession, inputs: DropInputs) -> Row:
    row: Row = {
        "model": inputs.model.value,
        "contact": inputs.contact.value,
        "kn_N_m": inputs.kn_N_m,
        "y0_m": inputs.height_m,
        "its_s": inputs.its_s,
        **_varied(study, inputs),
    }
    try:
        result, timings = session.run(inputs)
    except ComputationError as error:
        if study.failures:
            lost = dict.fromkeys(name for name in COLUMNS if name not in row)
            return {**row, **lost, "wall_s": 0.0, "warnings": [f"failed: {error}"]}
        varied = "".join(f", {name} {value}" for name, value in _varied(study, inputs).items())
        case = f"{inputs.model}, Kn {inputs.kn_N_m:g} N/m, y0 {1e3 * inputs.height_m:g} mm, "
        message = f"{case}ITS {inputs.its_s:g} s{varied}: {error}"
        raise ComputationError(message, inputs=error.inputs) from error
    row |= {"energy_closure": result.energy.closure_relative, "wall_s": timings["total"]}
    row |= {name: results.number(name, inputs, result) for name in COLUMNS if name not in row}
    row["warnings"] = [*input_warnings(inputs), *result_warnings(inputs, result)]
    if study.curves:
        row["curve"] = _curve(result)
    return row


def _varied(study: Study, inputs: DropInputs) -> Row:
    """Those inputs of a case that differ from case to case."""
    values = {name: getattr(inputs, name) for name in study.varied}
    return {name: str(x) if isinstance(x, StrEnum) else x for name, x in values.items()}


def _curve(result: DropResult) -> dict[str, list[float]]:
    """The tip's height over time, with an impact thinned to what a figure can show."""
    rows = result.history.array()
    touching = np.flatnonzero(rows[:, 3] > 0.0)
    keep = np.arange(len(rows))
    if len(touching) > CURVE_POINTS:
        inside = np.linspace(touching[0], touching[-1], CURVE_POINTS).astype(int)
        keep = np.unique(np.concatenate([keep[: touching[0]], inside, keep[touching[-1] :]]))
    t, y = ([float(f"{x:.8g}") for x in rows[keep, i]] for i in (0, 1))
    return {"t_s": t, "tip_y_m": y}
