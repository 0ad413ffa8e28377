"""Which values stand in a dataset's table, and where exactly is one that cannot be used?"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError

TABLE_BYTES = 50_000_000
Rows = list[tuple[int, dict[str, str]]]


def inside(folder: Path, name: str) -> Path:
    """The path of file ``name`` in ``folder``; InputError where it leads out of it."""
    root = folder.resolve()
    path = (root / name).resolve()
    if not path.is_relative_to(root) or path == root:
        raise InputError(
            f"{folder / 'dataset.toml'}: file {name!r} lies outside the dataset's folder"
        )
    return folder / name


def read_table(path: Path, required: tuple[str, ...]) -> Rows:
    """Rows of a CSV with their line numbers; lines that are empty or start with # are skipped."""
    lines = list(enumerate(read_text(path).splitlines(), start=1))
    lines = [(n, line) for n, line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise InputError(f"{path}: no table in it")
    head = [name.strip() for name in _cells(lines[0][1])]
    where = f"{path}:{lines[0][0]}"
    missing = [name for name in required if name not in head]
    if missing:
        raise InputError(f"{where}: no column {missing[0]}; there are {', '.join(head)}")
    if len(set(head)) != len(head):
        raise InputError(f"{where}: a column appears twice")
    rows = []
    for number, line in lines[1:]:
        cells = [cell.strip() for cell in _cells(line)]
        if len(cells) != len(head):
            raise InputError(f"{path}:{number}: {len(cells)} values under {len(head)} columns")
        rows.append((number, dict(zip(head, cells, strict=True))))
    return rows


def _cells(line: str) -> list[str]:
    return next(csv.reader(io.StringIO(line)), [])


def read_text(path: Path) -> str:
    try:
        if path.stat().st_size > TABLE_BYTES:
            raise InputError(f"{path}: larger than {TABLE_BYTES // 1_000_000} MB")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from error


def column(
    path: Path,
    rows: Rows,
    name: str,
    *,
    above: float | None = None,
    least: float | None = None,
    whole: bool = False,
) -> Array:
    checks: list[tuple[Callable[[float], bool], str]] = [(math.isfinite, "a finite number")]
    if above is not None:
        checks.append((lambda x: x > above, f"more than {above:g}"))
    if least is not None:
        checks.append((lambda x: x >= least, f"{least:g} or more"))
    if whole:
        checks.append((lambda x: x == int(x), "a whole number"))
    values = np.empty(len(rows))
    for i, (line, row) in enumerate(rows):
        try:
            values[i] = float(row[name])
        except ValueError as error:
            raise InputError(f"{path}:{line}: {name} is no number: {row[name]!r}") from error
        for good, words in checks:
            if not good(values[i]):
                raise InputError(f"{path}:{line}: {name} must be {words}, not {row[name]}")
    return values


def check_order(
    path: Path, rows: Rows, name: str, numbers: Array | NDArray[np.int64], repeated: bool = False
) -> None:
    """InputError at the first of ``numbers`` (rows,) that does not count upwards.

    A number may stand in several rows that follow each other where it may be ``repeated``.
    """
    step = np.diff(numbers)
    wrong = np.flatnonzero(step < 0 if repeated else step <= 0)
    if len(wrong):
        line = rows[wrong[0] + 1][0]
        raise InputError(f"{path}:{line}: {name} must count upwards in the order they were made")


def group_begins(
    path: Path, rows: Rows, name: str, numbers: NDArray[np.int64], t_s: Array
) -> NDArray[np.int64]:
    """Where each group of rows of one number begins, and where the last ends (groups + 1,).

    Raises InputError where ``numbers`` (rows,) do not count upwards, or times ``t_s`` (rows,) do
    not grow within a group; ``name`` is what a group is.
    """
    check_order(path, rows, name, numbers, repeated=True)
    step = np.diff(numbers)
    late = np.flatnonzero((step == 0) & (np.diff(t_s) <= 0.0))
    if len(late):
        raise InputError(f"{path}:{rows[late[0] + 1][0]}: t_s must grow within a {name}")
    return np.concatenate([[0], np.flatnonzero(step) + 1, [len(rows)]]).astype(np.int64)


def optional_column(path: Path, rows: Rows, name: str, unit: float) -> Array | None:
    if name not in rows[0][1]:
        return None
    values = np.full(len(rows), np.nan)
    for i, (line, row) in enumerate(rows):
        if row[name]:
            values[i] = unit * column(path, [(line, row)], name, least=0.0)[0]
    return values
