"""Results as JSON: how they begin, what they hold of a drop, whether they are the same run's."""

from __future__ import annotations

import json
import resource
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from ...meshes.collective import run_on_one_rank
from ...solver.checkpoint import Checkpoint, clear
from ...solver.drop import DropResult
from ...solver.errors import InputError
from .. import __version__
from ..inputs.config import DropInputs
from ..inputs.sources import OPTIONS
from ..inputs.texts import exists, parse_json, quoted, read_text
from .files import prepare_folder, to_json
from .mark import claim, refuse_foreign

if TYPE_CHECKING:
    from mpi4py import MPI

SCHEMA = 1
RESULT_FILE, HISTORY_FILE, CHECKPOINT = "result.json", "history.csv", "checkpoint"
# What `view` writes beside the fields of a solid.
SCRIPT_FILE = "open_in_paraview.py"
OTHERS = ("energy", "history", "reduction_error")
NUMBERS = (
    *(each.name for each in fields(DropResult) if each.name not in OTHERS),
    "cm_rebound_ratio",
)


def plain_inputs(inputs: BaseModel) -> dict[str, Any]:
    """Inputs as they stand in a file, from which `--config` reads them again."""
    return json.loads(to_json(inputs.model_dump(mode="python")))


def head(inputs: BaseModel, schema: int | str = SCHEMA) -> dict[str, Any]:
    """How every document of a run begins, by which `check_same` knows it again."""
    return {"schema": schema, "version": __version__, "inputs": plain_inputs(inputs)}


def prepare(inputs: BaseModel, out: Path, *files: str, resume: bool) -> dict[str, Any] | None:
    """Make the folder of one run ready: with ``resume`` the result that is there, if any.

    ``files`` are all that the run may write. Raises InputError where the folder cannot be used, one
    of them is not the program's, or the result has other inputs.
    """
    prepare_folder(out)
    path = out / RESULT_FILE
    there = read_document(path) if resume else None
    if there is not None:
        check_same(path, there, inputs)
    else:
        refuse_foreign(out, *files)
    return there


def checkpoint(
    inputs: BaseModel, out: Path, comm: MPI.Intracomm, made_of: Mapping[str, str] = {}, **how: Any
) -> Checkpoint:
    """The checkpoint of one run in its folder, for these inputs and this version, and for what it
    is ``made_of`` further; ``how`` is that of a `Checkpoint`."""
    made_for = {OPTIONS.get(k, k): str(v) for k, v in plain_inputs(inputs).items()}
    made_for |= {"version": __version__, **made_of}
    run_on_one_rank(comm, lambda: claim(out, f"{CHECKPOINT}/"))
    return Checkpoint(out / CHECKPOINT, comm, made_for, **how)


def forget_checkpoint(out: Path) -> None:
    """Remove the checkpoint of a run that is done."""
    if (out / CHECKPOINT).exists():
        clear(out / CHECKPOINT)
        claim(out)


def number(name: str, inputs: DropInputs, result: DropResult) -> Any:
    """What a result.json or a table holds under ``name`` of a drop."""
    if name == "cm_rebound_ratio":
        height = result.cm_rebound_height_m
        return None if height is None else height / inputs.height_m
    if name == "friction_loss_J":
        return result.energy.friction_loss_J
    value = getattr(result, name)
    if value is None or np.isnan(value).any():
        return None  # the drop ended before it could be seen
    return list(value) if isinstance(value, tuple) else value


def read_document(path: Path) -> dict[str, Any] | None:
    """A result, or None where there is none; InputError where it is not one of this program."""
    if not exists(path):
        return None
    try:
        document = parse_json(path, read_text(path))
    except InputError as error:
        raise InputError(f"--resume {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get("inputs"), dict):
        raise InputError(f"--resume {path}: not a result of this program: it has no inputs")
    return document


def check_same(path: Path, there: Mapping[str, Any], inputs: BaseModel) -> None:
    """InputError that names the first difference between what is ``there`` and what is asked."""
    check_version(path, there)
    old, new = there["inputs"], plain_inputs(inputs)
    different = [key for key in {**new, **old} if old.get(key) != new.get(key)]
    if different:
        # a study is another one by what is no list first
        key = min(different, key=lambda key: isinstance(new.get(key), list))
        raise InputError(
            f"--resume {path}: {OPTIONS.get(key, key)} is {_shown(old.get(key))} there, "
            f"{_shown(new.get(key))} is asked for; choose another --out"
        )


def check_version(path: Path, there: Mapping[str, Any]) -> None:
    """InputError where what is ``there`` was made by another version."""
    if there.get("version") != __version__:
        raise InputError(
            f"--resume {path}: made by version {quoted(there.get('version'))}, "
            f"this is {__version__}; choose another --out"
        )


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else quoted(value)


def resources(comm: MPI.Intracomm) -> dict[str, Any]:
    """How many ranks computed and, in MB, their `peak_rss_MB`; collective."""
    return {"peak_rss_MB": peak_rss_MB(comm), "ranks": comm.size}


def peak_rss_MB(comm: MPI.Intracomm) -> float:
    """Greatest resident memory in MB (10⁶ bytes), summed over the ranks; collective."""
    return float(comm.allreduce(_own_peak_MB()))


def _own_peak_MB() -> float:
    """From the kernel's account of this program; getrusage also counts what it was forked from."""
    try:
        status = Path("/proc/self/status").read_text()
        line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / 1e6
    except (OSError, StopIteration):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
