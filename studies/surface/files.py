"""Measured surfaces: maps of heights from text files and NumPy archives, in m.

A text is of one of two kinds: a matrix of heights z, one row of the grid per line, and a list of
points x y z of a regular grid, in any order.  Numbers are separated by commas, semicolons or
blanks; lines that begin with # are comments, of which `# spacing_m = 1e-5` gives a matrix its
spacing; a first line without a single number is taken for column names.  An archive has the arrays
`heights_m` (ny, nx) and `spacing_m`.
"""

from __future__ import annotations

import math
import re
import zipfile
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...meshes.section import require_positive
from ...solver.arrays import Array
from .phases import Composite, random_phases
from .rough import FEWEST_NODES, MAX_NODES, Surface

OFF_GRID = 0.05
"""Part of the spacing by which a listed point may miss its place on the grid."""
SAME_SPACING = 1e-3
"""Relative difference that is allowed between the spacings in x and y."""
_SPACING = re.compile(r"#\s*spacing_m\s*[=:]\s*(\S+)\s*$")


def read_surface(path: Path, seed: int = 0) -> Surface:
    """Read a surface that was measured on a finite piece.

    The plane that fits best, the tilt under the instrument, is taken off.  Beyond its edges the map
    goes on by its mirror image, so that heights are continuous and the tile is about twice as long.
    Phases, which a map of heights does not tell, are concrete's, laid out at random by ``seed``.

    Raises
    ------
    ValueError : the file is malformed, which names the file and, in a text, the line
    OSError : the file cannot be read
    """
    heights, spacing_m = read_map(path)
    if heights.ndim != 2 or min(heights.shape) < FEWEST_NODES:
        raise ValueError(
            f"{path}: a grid of at least {FEWEST_NODES} × {FEWEST_NODES} heights is needed, "
            f"not {' × '.join(map(str, heights.shape))}."
        )
    ny, nx = heights.shape
    heights = np.pad(heights - _best_plane(heights), ((0, ny - 2), (0, nx - 2)), mode="reflect")
    composite = Composite()
    try:
        phase = random_phases(composite, heights.shape, spacing_m, np.random.default_rng(seed))
        return Surface(heights, spacing_m, phase, composite)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _best_plane(heights: Array) -> Array:
    """Least-squares plane through a grid of heights; on a grid the three terms are orthogonal."""
    ny, nx = heights.shape
    x, y = np.arange(nx) - (nx - 1) / 2, np.arange(ny)[:, None] - (ny - 1) / 2
    slope_x = (heights * x).sum() / (ny * (x**2).sum())
    slope_y = (heights * y).sum() / (nx * (y**2).sum())
    return heights.mean() + slope_x * x + slope_y * y


def read_map(path: Path) -> tuple[Array, float]:
    """Heights (ny, nx), row 0 at the smallest y, and the grid's spacing, of a file; errors as
    `read_surface`."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _read_archive(path)
    if suffix in (".csv", ".txt"):
        return _read_text(path)
    raise ValueError(f"{path}: a surface is read from .npz, .csv or .txt, not '{suffix}'.")


def _read_archive(path: Path) -> tuple[Array, float]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path}: is not a file of plain arrays: {error}") from error
    for name in ("heights_m", "spacing_m"):
        if name not in arrays:
            there = ", ".join(arrays) or "none"
            raise ValueError(f"{path}: there is no array {name}, only {there}.")
        if arrays[name].dtype.kind not in "iuf":
            raise ValueError(f"{path}: {name} holds {arrays[name].dtype}, not numbers.")
    heights, spacing = arrays["heights_m"].astype(float), arrays["spacing_m"]
    if not np.isfinite(heights).all():
        raise ValueError(f"{path}: heights_m has places that are not finite; fill them.")
    if spacing.size != 1:
        raise ValueError(f"{path}: spacing_m must be one number, not {spacing.size}.")
    require_positive(f"{path}: spacing_m", float(spacing.item()))
    return heights, float(spacing.item())


def _read_text(path: Path) -> tuple[Array, float]:
    """Three columns are a list of points, anything else a matrix: a surface has at least four nodes
    along each side, so there is no doubt."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not a text file ({error.reason}).") from None
    declared: float | None = None
    lines: list[int] = []
    rows: list[list[float]] = []
    named = False
    for number, line in enumerate(map(str.strip, text.splitlines()), start=1):
        place, comment = f"{path}:{number}", line.startswith("#")
        if comment and (match := _SPACING.match(line)):
            declared = _height(match[1], place)
            require_positive(f"{place}: spacing_m", declared)
        if comment or not line:
            continue
        fields = _split(line)
        if not (rows or named or any(map(_is_number, fields))):
            named = True
            continue
        rows.append([_height(field, place) for field in fields])
        lines.append(number)
        if len(fields) != len(rows[0]):
            raise ValueError(
                f"{place}: {len(fields)} numbers where line {lines[0]} has {len(rows[0])}."
            )
        if len(rows) * len(fields) > 3 * MAX_NODES:
            raise ValueError(f"{place}: more than {MAX_NODES} heights; thin them out.")
    if not rows:
        raise ValueError(f"{path}: there are no numbers in it.")
    table = np.array(rows)
    if table.shape[1] == 3:
        if declared is not None:
            raise ValueError(f"{path}: a list of points x y z has its spacing from its points.")
        return _grid_of_points(path, table, lines)
    if declared is None:
        raise ValueError(
            f"{path}: a matrix of {table.shape[0]} × {table.shape[1]} heights needs a spacing: "
            "write '# spacing_m = …' into the file."
        )
    return table, declared


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
    node = j * nx + i
    _, first, again = np.unique(node, return_index=True, return_inverse=True)
    repeated = first[again] != np.arange(len(node))
    if repeated.any():
        row = int(np.argmax(repeated))
        earlier = lines[first[again[row]]]
        raise ValueError(f"{path}:{lines[row]}: the same point as in line {earlier}.")
    missing = np.setdiff1d(np.arange(nx * ny), node)
    if len(missing):
        y, x = points[:, 1::-1].min(axis=0) + np.array(divmod(missing[0], nx)) * [step_y, step_x]
        raise ValueError(
            f"{path}: {len(missing)} points of the {ny} × {nx} grid are missing, "
            f"the first at x = {x:g} m, y = {y:g} m."
        )
    return points[first, 2].reshape(ny, nx), (step_x + step_y) / 2


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
