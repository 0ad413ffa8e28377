"""How is a surface kept, read from a measurement, and opened in ParaView?"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import meshio
import numpy as np
import numpy.typing as npt

from .geometry import _require_positive
from .surface import FEWEST_NODES, Surface
from .surface_phases import Composite, Phase, random_phases
from .surface_text import read_text

Array = npt.NDArray[np.float64]

_PHASE_COLUMNS = {
    "phase_name": "name",
    "phase_youngs_Pa": "youngs_Pa",
    "phase_poisson": "poisson",
    "phase_area_fraction": "area_fraction",
    "phase_grain_size_m": "grain_size_m",
}
"""Arrays of a saved file that hold the composite, one entry per phase; grain size 0: the matrix."""


class Edges(StrEnum):
    """How a map that was measured on a finite piece goes on beyond it."""

    MIRROR = "mirror"
    """Reflected in its edges: heights are continuous, and the tile is about twice as long."""
    PERIODIC = "periodic"
    """Repeated as it is: only for a map whose opposite edges fit."""


@dataclass(frozen=True)
class Measured:
    """How a map of heights becomes a surface.

    Parameters
    ----------
    spacing_m : grid spacing of a matrix, m; None: the file says it
    unit_m : what 1 in a text file is in m, 1e-6 for µm; `.npz` files are in m
    edges : how it goes on beyond its edges
    level : take off the plane that fits best, the tilt under the instrument; else the mean only
    composite : phases, which a height map does not tell: laid out at random
    seed : of the phases

    Raises
    ------
    ValueError : a value is out of its range
    """

    spacing_m: float | None = None
    unit_m: float = 1.0
    edges: Edges = Edges.MIRROR
    level: bool = True
    composite: Composite = field(default_factory=Composite)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.spacing_m is not None:
            _require_positive("spacing_m", self.spacing_m)
        _require_positive("unit_m", self.unit_m)
        object.__setattr__(self, "edges", Edges(self.edges))


def read_surface(path: Path, measured: Measured | None = None) -> Surface:
    """Read a surface: one from `save_surface` as it was, or a map of measured heights.

    A map is a text file (`.csv`, `.txt`: see `bristle.meshes.surface_text`) or a `.npz` file with
    the arrays `heights_m` (ny, nx) and `spacing_m`.

    Parameters
    ----------
    measured : what becomes of a map; None: `Measured()`

    Raises
    ------
    ValueError : the file is malformed, which names the file and, in a text, the line; or
        `measured` is given with a saved surface, which has its phases already
    OSError : the file cannot be read
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        arrays = _load_arrays(path)
        if "phase" in arrays:
            if measured is not None:
                raise ValueError(f"{path} is a saved surface: nothing of `measured` applies to it.")
            return _saved_surface(path, arrays)
        how = measured or Measured()
        heights, spacing = _array_map(path, arrays, how.spacing_m)
    elif suffix in (".csv", ".txt"):
        how = measured or Measured()
        heights, spacing = read_text(path, how.spacing_m, how.unit_m)
    else:
        raise ValueError(f"{path}: a surface is read from .npz, .csv or .txt, not '{suffix}'.")
    if heights.ndim != 2 or min(heights.shape) < FEWEST_NODES:
        raise ValueError(
            f"{path}: a grid of at least {FEWEST_NODES} × {FEWEST_NODES} heights is needed, "
            f"not {' × '.join(map(str, heights.shape))}."
        )
    try:
        return _surface_of_map(heights, spacing, how)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _surface_of_map(heights: Array, spacing_m: float, how: Measured) -> Surface:
    heights = heights - (_best_plane(heights) if how.level else heights.mean())
    if how.edges is Edges.MIRROR:
        ny, nx = heights.shape
        heights = np.pad(heights, ((0, ny - 2), (0, nx - 2)), mode="reflect")
    rng = np.random.default_rng(how.seed)
    phase = random_phases(how.composite, heights.shape, spacing_m, rng)
    return Surface(heights, spacing_m, phase, how.composite)


def _best_plane(heights: Array) -> Array:
    """Least-squares plane through a grid of heights; on a grid the three terms are orthogonal."""
    ny, nx = heights.shape
    x, y = np.arange(nx) - (nx - 1) / 2, np.arange(ny)[:, None] - (ny - 1) / 2
    slope_x = (heights * x).sum() / (ny * (x**2).sum())
    slope_y = (heights * y).sum() / (nx * (y**2).sum())
    return heights.mean() + slope_x * x + slope_y * y


def _load_arrays(path: Path) -> dict[str, npt.NDArray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path}: is not a file of plain arrays: {error}") from error


def _array_map(
    path: Path, arrays: dict[str, npt.NDArray], spacing_m: float | None
) -> tuple[Array, float]:
    heights = _numbers(path, arrays, "heights_m")
    if not np.isfinite(heights).all():
        raise ValueError(f"{path}: heights_m has places that are not finite; fill them.")
    if spacing_m is None:
        spacing = _numbers(path, arrays, "spacing_m")
        if spacing.size != 1:
            raise ValueError(f"{path}: spacing_m must be one number, not {spacing.size}.")
        spacing_m = float(spacing.item())
        _require_positive(f"{path}: spacing_m", spacing_m)
    return heights, spacing_m


def _numbers(path: Path, arrays: dict[str, npt.NDArray], name: str) -> npt.NDArray:
    if name not in arrays:
        raise ValueError(f"{path}: there is no array {name}, only {', '.join(arrays) or 'none'}.")
    if arrays[name].dtype.kind not in "iuf":
        raise ValueError(f"{path}: {name} holds {arrays[name].dtype}, not numbers.")
    return arrays[name].astype(float) if arrays[name].dtype.kind == "f" else arrays[name]


def _saved_surface(path: Path, arrays: dict[str, npt.NDArray]) -> Surface:
    heights, spacing_m = _array_map(path, arrays, None)
    phase = _numbers(path, arrays, "phase")
    if missing := [name for name in _PHASE_COLUMNS if name not in arrays]:
        raise ValueError(f"{path}: phase needs {', '.join(missing)} too.")
    columns = [np.atleast_1d(arrays[name]).tolist() for name in _PHASE_COLUMNS]
    try:
        phases = [
            Phase(name, youngs, poisson, fraction, grain or None)
            for name, youngs, poisson, fraction, grain in zip(*columns, strict=True)
        ]
        return Surface(heights, spacing_m, phase, Composite(tuple(phases)))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def save_surface(surface: Surface, path: Path) -> None:
    """Write a surface as `.npz`: plain arrays that `read_surface` gives back bit for bit.

    Raises
    ------
    ValueError : the name does not end in .npz
    """
    if path.suffix != ".npz":
        raise ValueError(f"{path}: a surface is saved as .npz.")
    columns: dict[str, npt.NDArray] = {
        column: np.array([getattr(phase, name) or 0.0 for phase in surface.composite.phases])
        for column, name in _PHASE_COLUMNS.items()
    }
    np.savez_compressed(
        path,
        allow_pickle=False,
        heights_m=surface.heights_m,
        spacing_m=np.array(surface.spacing_m),
        phase=surface.phase,
        **columns,
    )


def write_vtu(surface: Surface, path: Path) -> None:
    """Write one tile for ParaView: quadrilaterals between the nodes, in m, with height as z.

    Point data: `height_m`, `phase` (its number in the composite), `youngs_Pa`.
    """
    ny, nx = surface.heights_m.shape
    y, x = np.divmod(np.arange(ny * nx), nx)
    points = np.column_stack([x * surface.spacing_m, y * surface.spacing_m, np.zeros(ny * nx)])
    points[:, 2] = surface.heights_m.ravel()
    corner = np.arange(ny * nx).reshape(ny, nx)[:-1, :-1].ravel()
    phase = surface.phase.ravel()
    data = {
        "height_m": surface.heights_m.ravel(),
        "phase": phase.astype(np.int32),
        "youngs_Pa": surface.composite.youngs_Pa[phase],
    }
    quads = corner[:, None] + np.array([0, 1, nx + 1, nx])
    meshio.write(path, meshio.Mesh(points, [("quad", quads)], point_data=data), file_format="vtu")
