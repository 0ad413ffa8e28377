"""A brush for ParaView: a line for each bristle, frame by frame, and the surface as squares.

The series is PVD over VTU, which ParaView 5.13 opens. It is written here and not by meshio, which
knows no cell of many points in a row.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ..surface.rough import Surface

Values = NDArray[Any]
SERIES, GROUND = "brush.pvd", "ground.vtu"
LINE, SQUARE = 4, 9
# Squares along each side of a rough surface, at most.
FINEST = 400
TYPES = {"f": ("Float64", "<f8"), "i": ("Int64", "<i8"), "u": ("UInt8", "u1")}


def frame_file(number: int) -> str:
    """The name of a frame."""
    return f"frame-{number:05d}.vtu"


def write_lines(
    folder: Path, number: int, centre_m: Array, stress_Pa: Array, bristles: Mapping[str, Values]
) -> None:
    """Write a frame: centre lines (n, nodes, 3), the bending stress (n, nodes) along them, and what
    each of the ``bristles`` has, (n,) by name; OSError."""
    n, nodes, _ = centre_m.shape
    along = {"bending_stress_Pa": stress_Pa.ravel()}
    cells = np.arange(n * nodes).reshape(n, nodes)
    each = {"bristle": np.arange(n), **bristles}
    text = _vtu(centre_m.reshape(-1, 3), cells, LINE, along, each)
    (folder / frame_file(number)).write_text(text)


def write_series(
    folder: Path, times_s: list[float], low_m: Array, high_m: Array, surface: Surface | None
) -> None:
    """Write the list of frames, and the surface between two corners (2,); OSError."""
    x, y = (_steps(float(low_m[c]), float(high_m[c]), surface) for c in range(2))
    points = np.zeros((len(x) * len(y), 3))
    points[:, 0], points[:, 1] = np.tile(x, len(y)), np.repeat(y, len(x))
    if surface is not None:
        points[:, 2] = surface.patch(points[:, 0], points[:, 1]).heights_m
    numbers = np.arange(len(points)).reshape(len(y), len(x))
    corners = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]
    cells = np.stack([each.ravel() for each in corners], axis=-1)
    (folder / GROUND).write_text(_vtu(points, cells, SQUARE, {}, {}))
    entries = [
        f'<DataSet timestep="{t!r}" part="{part}" file="{name}"/>'
        for number, t in enumerate(times_s)
        for part, name in enumerate((frame_file(number), GROUND))
    ]
    (folder / SERIES).write_text(_file("Collection", "".join(entries)))


def _steps(low_m: float, high_m: float, surface: Surface | None) -> Array:
    """Where the lines of the grid lie along one side."""
    if surface is None:
        return np.array([low_m, high_m])
    wanted = math.ceil((high_m - low_m) / surface.spacing_m)
    return np.linspace(low_m, high_m, min(wanted, FINEST) + 1)


def _vtu(
    points: Array,
    cells: Values,
    kind: int,
    on_points: Mapping[str, Values],
    on_cells: Mapping[str, Values],
) -> str:
    """An unstructured grid whose ``cells`` (n, points of each) are all of one ``kind`` of VTK."""
    n, size = cells.shape
    layout = {
        "connectivity": cells.ravel(),
        "offsets": size * np.arange(1, n + 1),
        "types": np.full(n, kind, dtype=np.uint8),
    }
    parts: dict[str, Mapping[str, Values]] = {
        "Points": {"": points},
        "Cells": layout,
        "PointData": on_points,
        "CellData": on_cells,
    }
    inside = "".join(
        f"<{part}>{''.join(_array(name, values) for name, values in arrays.items())}</{part}>"
        for part, arrays in parts.items()
    )
    piece = f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{n}">{inside}</Piece>'
    return _file("UnstructuredGrid", piece)


def _array(name: str, values: Values) -> str:
    """An array in base64, behind its length in bytes."""
    kind, stored = TYPES[values.dtype.kind]
    raw = np.ascontiguousarray(values, dtype=stored).tobytes()
    text = base64.b64encode(np.array(len(raw), dtype="<u8").tobytes() + raw).decode()
    wide = values.shape[1] if values.ndim == 2 else 1
    head = f'type="{kind}" Name="{name}" NumberOfComponents="{wide}" format="binary"'
    return f"<DataArray {head}>{text}</DataArray>"


def _file(kind: str, inside: str) -> str:
    head = f'type="{kind}" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    return f'<?xml version="1.0"?>\n<VTKFile {head}><{kind}>{inside}</{kind}></VTKFile>\n'
