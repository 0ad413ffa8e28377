"""A dataset's table: its values, and where one that cannot be used stands."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.errors import InputError
from ..inputs import texts
from ..inputs.texts import quoted

MOST_ROWS = 1_000_000
# Beyond it nothing is a measurement in the units of a table, and squares still are numbers.
LARGEST = 1e12
Rows = list[tuple[int, dict[str, str]]]
LEAST_DROPS = 4


def inside(folder: Path, name: str) -> Path:
    """The path of file ``name`` in ``folder``; InputError where it leads out of it."""
    root = folder.resolve()
    try:
        path = (root / name).resolve()
    except (OSError, ValueError) as error:  # ValueError: a zero byte in it
        raise InputError(f"{folder / 'dataset.toml'}: file {quoted(name)}: {error}") from error
    if not path.is_relative_to(root) or path == root:
        raise InputError(
            f"{folder / 'dataset.toml'}: file {quoted(name)} lies outside the dataset's folder"
        )
    return folder / name


def read_table(path: Path, required: tuple[str, ...]) -> Rows:
    """Rows of a CSV with their line numbers. Lines that start with # are skipped, and so are empty
    ones, which spreadsheets write as commas alone below a table."""
    lines = list(enumerate(_lines(read_text(path)), start=1))
    lines = [
        (n, line)
        for n, line in lines
        if line.replace(",", " ").strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise InputError(f"{path}: no table in it")
    if len(lines) > MOST_ROWS:
        raise InputError(f"{path}: {len(lines)} rows; there can be {MOST_ROWS}")
    where = f"{path}:{lines[0][0]}"
    head = [name.strip() for name in _cells(where, lines[0][1])]
    missing = [name for name in required if name not in head]
    if missing:
        there = quoted(", ".join(head))
        commas = "" if len(head) > 1 else "; a comma stands between columns, a point in numbers"
        raise InputError(f"{where}: no column {missing[0]}; there are {there}{commas}")
    twice = next((name for i, name in enumerate(head) if name in head[:i]), None)
    if twice is not None:
        raise InputError(f"{where}: column {quoted(twice)} appears twice")
    rows = []
    for number, line in lines[1:]:
        cells = [cell.strip() for cell in _cells(f"{path}:{number}", line)]
        if len(cells) != len(head):
            raise InputError(f"{path}:{number}: {len(cells)} values under {len(head)} columns")
        rows.append((number, dict(zip(head, cells, strict=True))))
    if not rows:
        raise InputError(f"{path}: no rows under the columns")
    return rows


def _lines(text: str) -> list[str]:
    """Lines as editors count them; str.splitlines knows further ends of lines."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _cells(where: str, line: str) -> list[str]:
    try:
        return next(csv.reader([line], strict=True), [])
    except csv.Error as error:
        raise InputError(f"{where}: no row of a CSV table: {error}") from error


def read_text(path: Path) -> str:
    """The text of a dataset's file; InputError where there is none, or it is no plain file."""
    if not texts.exists(path):
        raise InputError(f"{path}: no such file")
    if not path.is_file():
        raise InputError(f"{path}: is not a plain file")
    return texts.read_text(path)


def column(
    path: Path,
    rows: Rows,
    name: str,
    *,
    above: float | None = None,
    least: float | None = None,
    whole: bool = False,
    empty: bool = False,
) -> Array:
    """The numbers (rows,) of a column; InputError at the first that is none, or not as asked.

    A cell may be ``empty``, which is NaN.
    """
    checks: list[tuple[Callable[[float], bool], str]] = [
        (math.isfinite, "a finite number"),
        (lambda x: abs(x) <= LARGEST, f"at most {LARGEST:g} in size"),
    ]
    if above is not None:
        checks.append((lambda x: x > above, f"more than {above:g}"))
    if least is not None:
        checks.append((lambda x: x >= least, f"{least:g} or more"))
    if whole:
        checks.append((lambda x: x == int(x), "a whole number"))
    values = np.empty(len(rows))
    hint = "; leave the cell empty where nothing was read" if empty else ""
    for i, (line, row) in enumerate(rows):
        if empty and not row[name]:
            values[i] = np.nan
            continue
        try:
            values[i] = _number(row[name])
        except ValueError as error:
            wrong = f"{path}:{line}: {name} is no number: {quoted(row[name])}{hint}"
            raise InputError(wrong) from error
        if empty and math.isnan(values[i]):
            raise InputError(f"{path}:{line}: {name} is {row[name]}{hint}")
        for good, words in checks:
            if not good(values[i]):
                raise InputError(f"{path}:{line}: {name} must be {words}, not {row[name][:80]}")
    return values


def _number(text: str) -> float:
    """A number as tables write it; Python's own notation takes more, 1_0 for ten."""
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


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


def in_order(path: Path, rows: Rows, name: str) -> tuple[Rows, Array]:
    """The rows by the whole numbers in column ``name``, and these (rows,), whatever order they
    stand in. InputError where two have the same number."""
    numbers = column(path, rows, name, whole=True)
    order = np.argsort(numbers, kind="stable")
    rows = [rows[i] for i in order]
    again = np.flatnonzero(np.diff(numbers[order]) == 0.0)
    if len(again):
        (first, _), (second, _) = rows[again[0]], rows[again[0] + 1]
        number = f"{numbers[order][again[0]]:g}"
        raise InputError(
            f"{path}:{second}: {name} {number} stands in line {first} as well; number each in the "
            "order they were made"
        )
    return rows, numbers[order]


class InPieces:
    """Rows in pieces, one after the other: ``begins`` (pieces + 1,) says where each begins."""

    begins: NDArray[np.int64]

    @property
    def pieces(self) -> list[slice]:
        """The rows of each piece."""
        return [slice(a, b) for a, b in pairwise(self.begins)]


@dataclass(frozen=True)
class Series(InPieces):
    """What is measured over time, piece by piece: ``number``, ``t_s``, ``value`` (rows,)."""

    path: Path
    rows: Rows
    number: NDArray[np.int64]
    t_s: Array
    value: Array
    begins: NDArray[np.int64]

    @property
    def lines(self) -> list[int]:
        """The table's line of each row."""
        return [line for line, _ in self.rows]

    def at(self, piece: int) -> str:
        """File and line where a piece begins."""
        return f"{self.path}:{self.rows[self.begins[piece]][0]}"

    def check_drops(self, least: int, what: str) -> None:
        """InputError where a drop has fewer rows, ``what`` they are, than ``least``, or where there
        are fewer drops than the loop needs."""
        for i, size in enumerate(np.diff(self.begins)):
            if size < least:
                drop = f"{self.at(i)}: drop {self.number[self.begins[i]]}"
                raise InputError(f"{drop} has {size} {what}; {least} or more are needed")
        if len(self.pieces) < LEAST_DROPS:
            raise InputError(f"{self.path}: {len(self.pieces)} drops; the loop needs four or more")


def read_series(path: Path, piece: str, value: str) -> Series:
    """The columns ``piece`` (whole numbers), ``t_s`` and ``value`` of a table, all needed.

    Raises InputError at the first value that cannot be used, where pieces do not count upwards, or
    times do not grow within one.
    """
    rows = read_table(path, required=(piece, "t_s", value))
    number = column(path, rows, piece, whole=True).astype(np.int64)
    times, values = column(path, rows, "t_s"), column(path, rows, value)
    check_order(path, rows, piece, number, repeated=True)
    step = np.diff(number)
    late = np.flatnonzero((step == 0) & (np.diff(times) <= 0.0))
    if len(late):
        raise InputError(f"{path}:{rows[late[0] + 1][0]}: t_s must grow within a {piece}")
    begins = np.concatenate([[0], np.flatnonzero(step) + 1, [len(rows)]]).astype(np.int64)
    return Series(path, rows, number, times, values, begins)


def optional_column(
    path: Path, rows: Rows, name: str, unit: float, least: float = 0.0
) -> Array | None:
    """The column in ``unit``, NaN where a row has no value; None where the table has it not.
    InputError at the first value below ``least``."""
    if name not in rows[0][1]:
        return None
    return unit * column(path, rows, name, least=least, empty=True)
