"""Release, landing place and outcome of each of many drops.

Every drop has a random stream of its own, named by the seed and its number, so that neither the
number of drops nor who computes it changes what is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.batch import Outcome
from ...solver.bodies.base import ContactPoints
from ...solver.errors import InputError
from ...solver.ground import Ground
from ...solver.rigid import leaning, matrix_of
from ..surface.files import read_surface
from ..surface.heights import Roughness
from ..surface.phases import CELLS_PER_GRAIN, PERIOD_IN_GRAINS, Composite
from ..surface.rough import Surface, make_surface
from .inputs import ScatterInputs

# What a random stream is for: the first number of its key.
RELEASES, CHECKS, RESAMPLES, SAMPLES = range(4)
# Nodes per correlation length: the spline's slopes are then those of the surface.
NODES_PER_LENGTH = 10


def generator(seed: int, *key: int) -> np.random.Generator:
    """The stream of ``seed`` that is named by ``key``."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def ground_surface(inputs: ScatterInputs) -> Surface | None:
    """The surface that the drops land on, or None for a level plane of one material.

    Raises InputError where it cannot be read or made.
    """
    if inputs.flat:
        return None
    try:
        if inputs.surface is not None:
            return read_surface(Path(inputs.surface), inputs.surface_seed)
        assert inputs.rms_height_m is not None
        assert inputs.correlation_length_m is not None
        roughness = Roughness(inputs.rms_height_m, inputs.correlation_length_m)
        composite = Composite()
        size, spacing = tile_m(roughness, composite)
        return make_surface(roughness, composite, size, spacing, inputs.surface_seed)
    except OSError as error:
        raise InputError(f"--surface {inputs.surface}: {error.strerror}") from error
    except ValueError as error:
        option = "--surface" if inputs.surface is not None else "--correlation-length"
        raise InputError(f"{option}: {error}") from error


def tile_m(roughness: Roughness, composite: Composite) -> tuple[float, float]:
    """Period and grid spacing that the roughness and the grains need, in m."""
    grains = [grain for _, grain, _ in composite.aggregates]
    size = max(PERIOD_IN_GRAINS * grains[0], roughness.shortest_period_m)
    spacing = min(grains[-1] / CELLS_PER_GRAIN, roughness.correlation_length_m / NODES_PER_LENGTH)
    return math.ceil(size / spacing * (1.0 - 1e-9)) * spacing, spacing


@dataclass(frozen=True)
class Conditions:
    """How drops are released (n,): where over the surface, how turned about the axis, how leaning.

    ``turn_deg`` is the angle from the surface's x to the bristle's thin side.
    """

    number: NDArray[np.int64]
    height_m: Array
    tilt_deg: Array
    tilt_wide_deg: Array
    x_m: Array
    y_m: Array
    turn_deg: Array

    def __len__(self) -> int:
        return len(self.number)


def draw(inputs: ScatterInputs, size_m: tuple[float, float], first: int, last: int) -> Conditions:
    """Drops ``first`` to ``last`` - 1 over a tile of ``size_m``.

    The leans are independent normals, the place is uniform on the tile, the turn is uniform; the
    heights come in turn.
    """
    numbers = np.arange(first, last)
    drawn = np.empty((len(numbers), 5))
    for row, number in zip(drawn, numbers, strict=True):
        stream = generator(inputs.seed, RELEASES, int(number))
        row[:2] = stream.standard_normal(2)
        row[2:] = stream.random(3)
    heights = np.array(inputs.heights_m, dtype=float)
    return Conditions(
        numbers,
        heights[numbers % len(heights)],
        inputs.tilt_deg + inputs.tilt_std_deg * drawn[:, 0],
        inputs.tilt_wide_deg + inputs.tilt_std_deg * drawn[:, 1],
        size_m[0] * drawn[:, 2],
        size_m[1] * drawn[:, 3],
        360.0 * drawn[:, 4],
    )


@dataclass(frozen=True)
class Under:
    """The ground under every point of every tip, along the bristle's horizontal axes.

    ``normals`` (drops, points, 3), ``rises_m`` and ``scale`` (drops, points) as `Drops` takes them;
    ``places_m`` (drops, points, 2) are where the points stand over it.
    """

    normals: Array
    rises_m: Array
    scale: Array
    places_m: Array


def ground_under(
    surface: Surface | None, points: ContactPoints, released: Conditions, steel: tuple[float, float]
) -> Under:
    """What lies under the tips of drops; ``steel`` is the bristle's Young's modulus and ν.

    The surface is seen where the points of the leaning tip stand over it, the middle of the tip
    over the drop's own place, and turned into the bristle's axes.
    """
    shape = len(released), len(points.weights)
    leans = zip(released.tilt_deg, released.tilt_wide_deg, strict=True)
    attitudes = [leaning(float(thin), float(wide)) for thin, wide in leans]
    rotations = np.array([matrix_of(attitude) for attitude in attitudes])
    places = np.einsum("dxy,iy->dix", rotations, points.places_m)[..., :2]
    if surface is None:
        up = np.zeros((*shape, 3))
        up[..., 2] = 1.0
        return Under(up, np.zeros(shape), np.ones(shape), places)
    turn = np.radians(released.turn_deg)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    middle = np.einsum("i,dix->dx", points.weights, places)
    x, y = np.moveaxis(places - middle[:, None], -1, 0)
    patch = surface.patch(
        (released.x_m[:, None] + cos * x - sin * y).ravel(),
        (released.y_m[:, None] + sin * x + cos * y).ravel(),
    )
    nx, ny, nz = patch.normals.reshape(*shape, 3).transpose(2, 0, 1)
    normals = np.stack([cos * nx + sin * ny, cos * ny - sin * nx, nz], axis=-1)
    scale = surface.stiffness_factors(*steel)[patch.phase]
    return Under(normals, patch.heights_m.reshape(shape), scale.reshape(shape), places)


def ground_of(under: Under, which: int) -> Ground:
    """The ground of one drop as `solver.drop` takes it."""
    normals, scale = under.normals[which], under.scale[which]
    over = np.column_stack([under.places_m[which], under.rises_m[which]])
    return Ground(normals, np.einsum("ix,ix->i", normals, over), scale)


@dataclass(frozen=True)
class Local:
    """The ground under each tip in a few numbers (n,), means over the end face.

    ``slope_deg`` and ``slope_wide_deg`` are how far its normal leans toward the thin and the wide
    side; ``lean_deg`` is the angle between it and the bristle; ``rise_std_m`` how far the heights
    under the tip scatter about its plane; ``stiffness_scale`` the stiffness of contact over Kn.
    """

    slope_deg: Array
    slope_wide_deg: Array
    lean_deg: Array
    rise_std_m: Array
    stiffness_scale: Array


def local_ground(released: Conditions, under: Under, weights: Array) -> Local:
    """The means over the end face that say what lies under the tips."""
    tangent = under.normals[..., :2] / under.normals[..., 2:]
    slope = np.einsum("i,dix->dx", weights, tangent)
    lean = np.tan(np.radians(np.stack([released.tilt_deg, released.tilt_wide_deg], axis=-1)))
    axis = np.column_stack([lean, np.ones(len(lean))])
    normal = np.column_stack([slope, np.ones(len(slope))])
    across = np.linalg.norm(np.cross(axis, normal), axis=1)
    along = np.einsum("dx,dx->d", axis, normal)
    # heights over the plane of the mean slope
    rest = under.rises_m + np.einsum("dx,dix->di", slope, under.places_m)
    rest = rest - (rest @ weights)[:, None]
    return Local(
        slope_deg=np.degrees(np.arctan(slope[:, 0])),
        slope_wide_deg=np.degrees(np.arctan(slope[:, 1])),
        lean_deg=np.degrees(np.arctan2(across, along)),
        rise_std_m=np.sqrt(np.square(rest) @ weights),
        stiffness_scale=under.scale @ weights,
    )


@dataclass(frozen=True)
class Check:
    """Drops that were computed twice: how far the reduced body may be off, in impact speeds (None
    for a body that leaves nothing out), and by how much the two ways differ in y1/y0."""

    n: int
    reduction_error: float | None
    difference: float


@dataclass(frozen=True)
class Scatter:
    """All drops that were computed: how they were released, over what, and what they gave.

    ``failed`` tells of those that are left out, by number.
    """

    released: Conditions
    local: Local
    outcome: Outcome
    failed: dict[int, str]

    @property
    def ratio(self) -> Array:
        """y1/y0 of the lower tip (n,)."""
        return np.asarray(self.outcome.rebound_height_m / self.released.height_m)


def table_of(found: Scatter) -> pd.DataFrame:
    """A row a drop: how it was released, over what, and what it gave."""
    height_m = found.released.height_m
    columns = {
        **vars(found.released),
        **vars(found.local),
        "rebound_ratio": found.ratio,
        "cm_rebound_ratio": found.outcome.cm_rebound_height_m / height_m,
        **found.outcome._asdict(),
    }
    table = pd.DataFrame(columns).rename(columns={"number": "drop", "height_m": "y0_m"})
    return table.astype({"n_contacts": int, "n_steps": int})
