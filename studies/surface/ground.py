"""The surface that inputs ask for, and what results tell of it."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...solver.errors import InputError
from ..inputs.named import digest_of
from ..inputs.study_fields import CORRELATION_LENGTH_M, ReliefFields
from .files import read_surface
from .phases import CELLS_PER_GRAIN, PERIOD_IN_GRAINS, Composite
from .rough import MAX_NODES, Roughness, Surface, make_surface

# Nodes per correlation length: the spline's slopes are then those of the surface.
NODES_PER_LENGTH = 10


def surface_of(inputs: ReliefFields) -> Surface | None:
    """The surface that is measured or drawn, or None where the inputs ask for a plane.

    Raises InputError where it cannot be read or made.
    """
    if inputs.surface is None and inputs.rms_height_m is None:
        return None
    length = inputs.correlation_length_m or CORRELATION_LENGTH_M
    try:
        if inputs.surface is not None:
            return _measured(inputs.surface.path, inputs.surface.sha256, inputs.surface_seed)
        return _drawn(inputs.rms_height_m or 0.0, length, inputs.surface_seed)
    except OSError as error:
        raise InputError(f"--surface: {error.filename}: {error.strerror}") from error
    except ValueError as error:
        option = "--surface" if inputs.surface is not None else "--correlation-length"
        raise InputError(f"{option}: {error}") from error


@lru_cache(maxsize=4)
def _measured(path: str, sha256: str, seed: int) -> Surface:
    if digest_of(Path(path)) != sha256:
        raise ValueError(f"{path} has changed since the run began")
    return read_surface(Path(path), seed)


@lru_cache(maxsize=4)
def _drawn(rms_height_m: float, length_m: float, seed: int) -> Surface:
    roughness, composite = Roughness(rms_height_m, length_m), Composite()
    size_m, spacing_m = tile_m(roughness, composite)
    side = round(size_m / spacing_m)
    if side**2 > MAX_NODES:
        other = "longer" if length_m < CORRELATION_LENGTH_M else "shorter"
        raise ValueError(
            f"with {length_m:g} m the surface needs a grid of {side} × {side} nodes, and "
            f"{math.isqrt(MAX_NODES)} × {math.isqrt(MAX_NODES)} are the most; take a {other} one"
        )
    return make_surface(roughness, composite, size_m, spacing_m, seed)


def tile_m(roughness: Roughness, composite: Composite) -> tuple[float, float]:
    """Period and grid spacing that the roughness and the grains need, in m."""
    grains = [grain for _, grain, _ in composite.aggregates]
    size = max(PERIOD_IN_GRAINS * grains[0], roughness.shortest_period_m)
    spacing = min(grains[-1] / CELLS_PER_GRAIN, roughness.correlation_length_m / NODES_PER_LENGTH)
    return math.ceil(size / spacing * (1.0 - 1e-9)) * spacing, spacing


def surface_facts(surface: Surface) -> dict[str, Any]:
    """What result.json has of a surface; its rms height is about the tile's own mean."""
    x, y = (math.degrees(math.atan(surface.rms_slope(axis))) for axis in (1, 0))
    names = [phase.name for phase in surface.composite.phases]
    return {
        "size_m": surface.size_m,
        "spacing_m": surface.spacing_m,
        "rms_height_m": float(surface.heights_m.std()),
        "correlation_length_m": surface.correlation_length_m(),
        "rms_slope_x_deg": x,
        "rms_slope_y_deg": y,
        "fractions": dict(zip(names, map(float, surface.fractions), strict=True)),
    }


def surface_rows(facts: dict[str, Any]) -> dict[str, Any]:
    """The same for a table of a page, by the quantity's name with its unit."""
    length = facts["correlation_length_m"]
    return {
        "period along x and y (mm)": " and ".join(f"{1e3 * side:.4g}" for side in facts["size_m"]),
        "rms height (µm)": 1e6 * facts["rms_height_m"],
        "correlation length (mm)": None if length is None else 1e3 * length,
        "rms slope along x (degrees)": facts["rms_slope_x_deg"],
        "rms slope along y (degrees)": facts["rms_slope_y_deg"],
        **{f"share of {name}": part for name, part in facts["fractions"].items()},
    }
