"""The Python interface, `import bristle`: drops, sweeps and the loop as objects and tables.

Keyword arguments are the inputs of result.json by name (SI units, angles in degrees), checked as
the command line's are. Under mpirun every rank makes the same call and gets the same answer.
Nothing is printed; warnings and progress go to the logger ``bristle``, of which Python shows
warnings on standard error unless logging is set up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import BaseModel

from ..solver.contact_phase import HISTORY_COLUMNS
from ..solver.errors import InputError
from .close_loop.run import run_close_loop, summary
from .drop import run_drop, simulate_drop
from .drop import summary as drop_summary
from .inputs.config import DropInputs
from .inputs.kinds import forgotten_afterwards
from .inputs.sources import checked
from .inputs.study_fields import LoopInputs
from .running.cases import CaseSession
from .running.results import HISTORY_FILE
from .running.study import TABLE_FILE, Study, rows_of
from .sweep import SweepInputs, run_sweep


class Record(dict[str, Any]):
    """What stands in a JSON file of this program: ``r["energy"]["kinetic_J"]`` or, the same,
    ``r.energy.kinetic_J``."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__(
            (name, Record(value) if isinstance(value, Mapping) else value)
            for name, value in values.items()
        )

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and name in self:
            return self[name]
        raise AttributeError(f"there is no {name} here; there are {', '.join(self)}", name=name)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self})

    def to_dict(self) -> dict[str, Any]:
        """Plain dictionaries, as JSON takes them."""
        return {
            name: value.to_dict() if isinstance(value, Record) else value
            for name, value in self.items()
        }

    def __repr__(self) -> str:
        return f"{type(self).__name__}({super().__repr__()})"


class Drop(Record):
    """A drop: result.json by name, and ``history``, a DataFrame with history.csv's columns."""

    def __init__(self, values: Mapping[str, Any], history: pd.DataFrame) -> None:
        super().__init__(values)
        self.history = history

    def __repr__(self) -> str:
        return _listed(f"{self.model} from {self.inputs.height_m:g} m", drop_summary(self))


class Verdict(Record):
    """What the loop found: verdict.json by name, such as ``verdict``, ``effects``, ``held_out``."""

    def __repr__(self) -> str:
        return _listed(self.title, summary(self.to_dict()))


def _listed(title: str, rows: list[tuple[str, str]]) -> str:
    return "\n".join([title, *(f"  {name:<24}{value}" for name, value in rows)])


class Session(CaseSession):
    """Drops and sweeps that share what is costly to build.

        with bristle.Session() as s:
            for kn in (1e5, 1e6, 1e7):
                s.drop(model="solid", kn_N_m=kn)

    Meshes, matrices, factors, reduced bases and steppers are kept from one call to the next, so
    that a drop with another stiffness, height, friction or lean costs its impact alone. They are
    those of the last three or four solids: the body that was used longest ago is forgotten with
    all that was made from it. Solids that a sweep computes on groups of ranks are forgotten at its
    end.

    ``comm`` is the communicator whose ranks compute; all of them make the same calls. `close`, or
    the end of the block, frees everything, after an error too.
    """

    @forgotten_afterwards()
    def drop(self, *, out: str | Path | None = None, **inputs: Any) -> Drop:
        """As `bristle.drop`."""
        asked = _checked(DropInputs, inputs)
        folder = _folder(out)
        if folder is not None:
            document = run_drop(asked, folder, session=self)
            return Drop(document, pd.read_csv(folder / HISTORY_FILE))
        document, result = simulate_drop(asked, self)
        return Drop(document, pd.DataFrame(result.history.array(), columns=list(HISTORY_COLUMNS)))

    @forgotten_afterwards()
    def sweep(self, *, out: str | Path | None = None, **inputs: Any) -> pd.DataFrame:
        """As `bristle.sweep`."""
        names = {"height_m": "heights_m", "model": "models"}
        for one, other in names.items():
            if one in inputs and other in inputs:
                raise InputError(f"{one}: given twice, also as {other}")
        asked = _checked(
            SweepInputs, {names.get(name, name): each for name, each in inputs.items()}
        )
        folder = _folder(out)
        if folder is not None:
            run_sweep(asked, folder, session=self)
            return pd.read_csv(folder / TABLE_FILE)
        study = Study("sweep", varied=asked.varied)
        rows = rows_of(study, asked.cases(), self)
        columns = list(study.columns)
        seen = [
            {name: math.nan if row[name] is None else row[name] for name in columns} for row in rows
        ]
        return pd.DataFrame(seen, columns=columns)


def drop(*, out: str | Path | None = None, **inputs: Any) -> Drop:
    """One drop, as `bristle drop`: ``bristle.drop(model="solid", tilt_deg=2, friction=0)``.

    With ``out`` the command's files, fields for ParaView among them, are written into that folder.
    Raises InputError and ComputationError.
    """
    with Session() as session:
        return session.drop(out=out, **inputs)


def sweep(*, out: str | Path | None = None, **inputs: Any) -> pd.DataFrame:
    """Every combination of ``models``, ``kn_N_m``, ``height_m``, ``its_s`` and any other number or
    choice, each one or several: ``bristle.sweep(kn_N_m=[1e5, 2e6], tilt_deg=[0, 2])``.

    Returns a row per case with table.csv's columns, and one for each further list. With
    ``out`` the command's files are written into that folder. Raises InputError and
    ComputationError.
    """
    with Session() as session:
        return session.sweep(out=out, **inputs)


@forgotten_afterwards()
def close_loop(dataset: str | Path, *, out: str | Path | None = None, **inputs: Any) -> Verdict:
    """What the model lacks to explain the measurements in the folder ``dataset``.

    ``inputs`` are ``seed``, ``alarm``, ``no_3d`` and ``plugins``. With ``out`` verdict.json and the
    page with its figures are written into that folder. Raises InputError and ComputationError.
    """
    asked = _checked(LoopInputs, inputs)
    if not isinstance(dataset, str | Path):
        raise InputError(f"dataset: must be a folder, not {dataset!r}")
    return Verdict(run_close_loop(Path(dataset), _folder(out), asked))


def _folder(out: str | Path | None) -> Path | None:
    if out is not None and (not isinstance(out, str | Path) or not str(out)):
        raise InputError(f"out: must be a folder, not {out!r}")
    return None if out is None else Path(out)


def _checked[Inputs: BaseModel](kind: type[Inputs], values: Mapping[str, Any]) -> Inputs:
    """Inputs of these keywords, paths and numpy's numbers among them."""
    plain = {name: _plain(value) for name, value in values.items()}
    return checked(kind, plain, {name: name for name in (*kind.model_fields, *values)})


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # numbers and arrays of numpy
        return value.tolist()
    return value
