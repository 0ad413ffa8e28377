"""Measured surfaces: maps of heights from text files and NumPy archives."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...meshes.section import require_positive
from .phases import Composite, random_phases
from .rough import FEWEST_NODES, Surface
from .text import read_text

Array = npt.NDArray[np.float64]


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
            require_positive("spacing_m", self.spacing_m)
        require_positive("unit_m", self.unit_m)
        object.__setattr__(self, "edges", Edges(self.edges))


def read_surface(path: Path, measured: Measured | None = None) -> Surface:
    """Read a map of measured heights.

    It is a text file (`.csv`, `.txt`: see `bristle.studies.surface.text`) or a `.npz` file with
    the arrays `heights_m` (ny, nx) and `spacing_m`.

    Parameters
    ----------
    measured : what becomes of a map; None: `Measured()`

    Raises
    ------
    ValueError : the file is malformed, which names the file and, in a text, the line
    OSError : the file cannot be read
    """
    suffix, how = path.suffix.lower(), measured or Measured()
    if suffix == ".npz":
        arrays = _load_arrays(path)
        heights, spacing = _array_map(path, arrays, how.spacing_m)
    elif suffix in (".csv", ".txt"):
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
        require_positive(f"{path}: spacing_m", spacing_m)
    return heights, spacing_m


def _numbers(path: Path, arrays: dict[str, npt.NDArray], name: str) -> npt.NDArray:
    if name not in arrays:
        raise ValueError(f"{path}: there is no array {name}, only {', '.join(arrays) or 'none'}.")
    if arrays[name].dtype.kind not in "iuf":
        raise ValueError(f"{path}: {name} holds {arrays[name].dtype}, not numbers.")
    return arrays[name].astype(float) if arrays[name].dtype.kind == "f" else arrays[name]
