"""Text files of measured surfaces.

Two kinds: a matrix of heights z, one row of the grid per line, and a list of points x y z of a
regular grid, in any order.  Numbers are separated by commas, semicolons or blanks; lines that begin
with # are comments, of which `# spacing_m = 1e-5` gives a matrix its spacing; a first line without
a single number is taken for column names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...meshes.section import require_positive
from .heights import MAX_NODES

Array = npt.NDArray[np.float64]

OFF_GRID = 0.05
"""Part of the spacing by which a listed point may miss its place on the grid."""
SAME_SPACING = 1e-3
"""Relative difference that is allowed between the spacings in x and y."""
_SPACING = re.compile(r"#\s*spacing_m\s*[=:]\s*(\S+)\s*$")


def read_text(path: Path, spacing_m: float | None, unit_m: float) -> tuple[Array, float]:
    """Read a matrix of heights or a list of points.

    Three columns are a list of points, anything else a matrix (a surface has at least four nodes
    along each side, so there is no doubt).

    Parameters
    ----------
    spacing_m : of a matrix, m; None: the file says it.  A list says it by its points.
    unit_m : what 1 in the file is in m; a spacing in the file's comments is in m already

    Returns
    -------
    heights : (ny, nx), m, row 0 at the smallest y
    spacing : m

    Raises
    ------
    ValueError : the file is malformed; the words name it and the line
    OSError : it cannot be read
    """
    lines: list[int] = []
    rows: list[list[float]] = []
    declared: float | None = None
    for line, content in _lines(path):
        if isinstance(content, float):
            declared = content
            continue
        if rows and len(content) != len(rows[0]):
            raise ValueError(
                f"{path}:{line}: {len(content)} numbers where line {lines[0]} has {len(rows[0])}."
            )
        lines.append(line)
        rows.append(content)
        if len(rows) * len(content) > 3 * MAX_NODES:
            raise ValueError(f"{path}:{line}: more than {MAX_NODES} heights; thin them out.")
    if not rows:
        raise ValueError(f"{path}: there are no numbers in it.")
    table = np.array(rows) * unit_m
    if table.shape[1] == 3:
        if spacing_m is not None or declared is not None:
            raise ValueError(f"{path}: a list of points x y z has its spacing from its points.")
        return _grid_of_points(path, table, lines)
    spacing = spacing_m if spacing_m is not None else declared
    if spacing is None:
        raise ValueError(
            f"{path}: a matrix of {table.shape[0]} × {table.shape[1]} heights needs a spacing: "
            "give spacing_m, or write '# spacing_m = …' into the file."
        )
    return table, spacing


def _lines(path: Path) -> Iterator[tuple[int, list[float] | float]]:
    """Yield the number of each line that says something, and its numbers or the spacing."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not a text file ({error.reason}).") from None
    started = False
    for number, line in enumerate(text.splitlines(), start=1):
        if not (stripped := line.strip()):
            continue
        if stripped.startswith("#"):
            if match := _SPACING.match(stripped):
                yield number, _spacing(match[1], f"{path}:{number}")
            continue
        fields = _split(stripped)
        if started or any(_is_number(field) for field in fields):
            yield number, [_height(field, f"{path}:{number}") for field in fields]
        started = True


def _split(line: str) -> list[str]:
    for separator in (";", ","):
        if separator in line:
            return [field.strip() for field in line.removesuffix(separator).split(separator)]
    return line.split()


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _height(field: str, place: str) -> float:
    if not _is_number(field):
        raise ValueError(f"{place}: '{field}' is not a number.")
    value = float(field)
    if not math.isfinite(value):
        raise ValueError(f"{place}: '{field}' is not a height; fill places that were not measured.")
    return value


def _spacing(field: str, place: str) -> float:
    value = _height(field, place)
    require_positive(f"{place}: spacing_m", value)
    return value


def _grid_of_points(path: Path, points: Array, lines: list[int]) -> tuple[Array, float]:
    """Sort a list of points (n, 3) into a grid; returns its heights (ny, nx) and spacing."""
    columns = [_grid_indices(path, points[:, axis], lines, "xy"[axis]) for axis in (0, 1)]
    (i, step_x), (j, step_y) = columns
    if not math.isclose(step_x, step_y, rel_tol=SAME_SPACING):
        raise ValueError(
            f"{path}: the spacing is {step_x:g} m in x and {step_y:g} m in y; it must be the same."
        )
    nx, ny = int(i.max()) + 1, int(j.max()) + 1
    if nx * ny > MAX_NODES:
        raise ValueError(f"{path}: the points are too scattered for a grid ({nx} × {ny} nodes).")
    row_of_node = np.full(ny * nx, -1)
    for row, node in enumerate(j * nx + i):
        if row_of_node[node] >= 0:
            raise ValueError(
                f"{path}:{lines[row]}: the same point as in line {lines[row_of_node[node]]}."
            )
        row_of_node[node] = row
    if (row_of_node < 0).any():
        j_missing, i_missing = divmod(int(np.argmax(row_of_node < 0)), nx)
        x = points[:, 0].min() + i_missing * step_x
        y = points[:, 1].min() + j_missing * step_y
        raise ValueError(
            f"{path}: {np.count_nonzero(row_of_node < 0)} points of the {ny} × {nx} grid are "
            f"missing, the first at x = {x:g} m, y = {y:g} m."
        )
    return points[row_of_node, 2].reshape(ny, nx), (step_x + step_y) / 2


def _grid_indices(
    path: Path, values: Array, lines: list[int], axis: str
) -> tuple[npt.NDArray[np.int64], float]:
    """Number of each value along a regular axis, from 0, and the axis' step."""
    start, extent = values.min(), np.ptp(values)
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-6 * extent]
    if not len(gaps):
        raise ValueError(f"{path}: all points have the same {axis}.")
    step = extent / round(extent / np.median(gaps))
    index = np.rint((values - start) / step)
    off = np.abs(values - start - index * step) > OFF_GRID * step
    if off.any():
        row = int(np.argmax(off))
        raise ValueError(
            f"{path}:{lines[row]}: {axis} = {values[row]:g} m is not on the grid that begins at "
            f"{start:g} m with a spacing of {step:g} m."
        )
    return index.astype(np.int64), float(step)
