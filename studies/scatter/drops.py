"""The drops of a scatter: how each is released, the ground where it lands, and what comes of it.

Every drop has a random stream of its own, named by the seed and its number, so that neither the
number of drops nor who computes it changes what is drawn.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.arrays import Array
from ...solver.batch import Drops, Outcome, drop_many
from ...solver.bodies.base import ContactPoints
from ...solver.bodies.modal import from_arrays, to_arrays
from ...solver.drop import ModalFrame, simulate
from ...solver.errors import ComputationError
from ...solver.ground import Ground
from ...solver.rigid import leaning, matrix_of
from ...solver.time.march import Marcher
from ..inputs.config import DropInputs
from ..running.cases import CaseSession, Timings
from ..running.parallel import start_petsc
from ..surface.rough import Surface
from .inputs import ScatterInputs

# What a random stream is for: the first number of its key.
RELEASES, CHECKS, RESAMPLES, SAMPLES = range(4)
CHUNK = 50

Chunk = dict[str, Any]
Row = list[float]


def generator(seed: int, *key: int) -> np.random.Generator:
    """The stream of ``seed`` that is named by ``key``."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def draw(inputs: ScatterInputs, size_m: tuple[float, float], first: int, last: int) -> pd.DataFrame:
    """Release of drops ``first`` to ``last`` - 1 over a tile of ``size_m``, a row a drop.

    The leans are independent normals, the place is uniform on the tile, the turn is uniform: the
    angle from the surface's x to the bristle's thin side. The heights come in turn.
    """
    numbers = np.arange(first, last)
    drawn = np.empty((len(numbers), 5))
    for row, number in zip(drawn, numbers, strict=True):
        stream = generator(inputs.seed, RELEASES, int(number))
        row[:2] = stream.standard_normal(2)
        row[2:] = stream.random(3)
    heights = np.array(inputs.heights_m, dtype=float)
    return pd.DataFrame(
        {
            "drop": numbers,
            "y0_m": heights[numbers % len(heights)],
            "tilt_deg": inputs.tilt_deg + inputs.tilt_std_deg * drawn[:, 0],
            "tilt_wide_deg": inputs.tilt_wide_deg + inputs.tilt_std_deg * drawn[:, 1],
            "x_m": size_m[0] * drawn[:, 2],
            "y_m": size_m[1] * drawn[:, 3],
            "turn_deg": 360.0 * drawn[:, 4],
        }
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
    surface: Surface | None,
    points: ContactPoints,
    released: pd.DataFrame,
    steel: tuple[float, float],
) -> Under:
    """What lies under the tips of `draw`'s drops; ``steel`` is the bristle's Young's modulus and ν.

    The surface is seen where the points of the leaning tip stand over it, the middle of the tip
    over the drop's own place, and turned into the bristle's axes.
    """
    shape = len(released), len(points.weights)
    leans = zip(released.tilt_deg, released.tilt_wide_deg, strict=True)
    rotations = np.array([matrix_of(leaning(thin, wide)) for thin, wide in leans])
    places = np.einsum("dxy,iy->dix", rotations, points.places_m)[..., :2]
    if surface is None:
        up = np.zeros((*shape, 3))
        up[..., 2] = 1.0
        return Under(up, np.zeros(shape), np.ones(shape), places)
    turn, at_x, at_y = (
        each.to_numpy()[:, None]
        for each in (np.radians(released.turn_deg), released.x_m, released.y_m)
    )
    cos, sin = np.cos(turn), np.sin(turn)
    middle = np.einsum("i,dix->dx", points.weights, places)
    x, y = np.moveaxis(places - middle[:, None], -1, 0)
    patch = surface.patch(
        (at_x + cos * x - sin * y).ravel(),
        (at_y + sin * x + cos * y).ravel(),
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


def local_ground(released: pd.DataFrame, under: Under, weights: Array) -> pd.DataFrame:
    """The ground under each tip in a few numbers, means over the end face, a row a drop.

    ``slope_deg`` and ``slope_wide_deg`` are how far its normal leans toward the thin and the wide
    side; ``lean_deg`` is the angle between it and the bristle; ``rise_std_m`` how far the heights
    under the tip scatter about its plane; ``stiffness_scale`` the stiffness of contact over Kn.
    """
    tangent = under.normals[..., :2] / under.normals[..., 2:]
    slope = np.einsum("i,dix->dx", weights, tangent)
    lean = np.tan(np.radians(np.column_stack([released.tilt_deg, released.tilt_wide_deg])))
    axis, normal = (np.column_stack([each, np.ones(len(each))]) for each in (lean, slope))
    across = np.linalg.norm(np.cross(axis, normal), axis=1)
    along = np.einsum("dx,dx->d", axis, normal)
    # heights over the plane of the mean slope
    rest = under.rises_m + np.einsum("dx,dix->di", slope, under.places_m)
    rest = rest - (rest @ weights)[:, None]
    return pd.DataFrame(
        {
            "slope_deg": np.degrees(np.arctan(slope[:, 0])),
            "slope_wide_deg": np.degrees(np.arctan(slope[:, 1])),
            "lean_deg": np.degrees(np.arctan2(across, along)),
            "rise_std_m": np.sqrt(np.square(rest) @ weights),
            "stiffness_scale": under.scale @ weights,
        }
    )


class Scene:
    """The body over the ``surface``, the same to the last bit on every rank; made by all together.

    One rank alone makes the body, since what comes of a factorisation depends in its last bits on
    how many share it. Raises ComputationError, on all ranks.
    """

    def __init__(self, inputs: ScatterInputs, surface: Surface | None, comm: MPI.Intracomm) -> None:
        self.inputs, self.surface, self.drop = inputs, surface, inputs.drop()
        if self.drop.model.meshed:
            start_petsc(comm)
        arrays, self.spent_s = run_on_one_rank(comm, lambda: _body(self.drop))
        body, *coarser = from_arrays(arrays)
        self.frame = ModalFrame(body, tuple(coarser))
        self.marcher = Marcher(
            body,
            self.drop.contact_method(),
            self.drop.time_scheme(),
            self.drop.its_s,
            self.drop.gravity_m_s2,
        )

    def released(self, first: int, last: int) -> tuple[pd.DataFrame, Under]:
        """How drops ``first`` to ``last`` - 1 are released, and what lies under them."""
        size = (1.0, 1.0) if self.surface is None else self.surface.size_m
        released = draw(self.inputs, size, first, last)
        steel = self.inputs.youngs_Pa, self.inputs.poisson
        return released, ground_under(self.surface, self.frame.modal.contact, released, steel)

    def conditions(self) -> pd.DataFrame:
        """How all drops are released, and the ground under their tips in a few numbers."""
        released, under = self.released(0, self.inputs.drops)
        weights = self.frame.modal.contact.weights
        return released.join(local_ground(released, under, weights))

    def chunk(self, number: int) -> Chunk:
        """The rows of one chunk of drops (`_dropped`)."""
        first = number * CHUNK
        last = min(first + CHUNK, self.inputs.drops)
        started = time.perf_counter()
        rows = self._dropped(*self.released(first, last))
        return {"rows": rows, "wall_s": time.perf_counter() - started}

    def check(self, number: int) -> tuple[float | None, float] | None:
        """A drop by itself: the reduced body's error, and how far y1/y0 is from that among many.

        None where the drop fails among many; ComputationError where it does so by itself alone.
        """
        released, under = self.released(number, number + 1)
        (row,) = self._dropped(released, under)
        if isinstance(row, str):
            return None
        plan = replace(
            self.drop.drop_plan(len(self.frame.modal.contact.weights)),
            height_m=float(released.y0_m[0]),
            tilt_deg=float(released.tilt_deg[0]),
            tilt_wide_deg=float(released.tilt_wide_deg[0]),
            ground=ground_of(under, 0),
        )
        try:
            result = simulate(self.frame, plan, self.marcher)
        except ComputationError as error:
            raise ComputationError(f"drop {number}: {error}") from error
        ratio = row[Outcome._fields.index("rebound_height_m")] / plan.height_m
        return result.reduction_error, abs((result.rebound_ratio or 0.0) - ratio)

    def _dropped(self, released: pd.DataFrame, under: Under) -> list[Row | str]:
        """The outcome of each drop, or why it failed."""
        n = len(released)
        drops = Drops(
            height_m=released.y0_m.to_numpy(),
            tilt_deg=released.tilt_deg.to_numpy(),
            tilt_wide_deg=released.tilt_wide_deg.to_numpy(),
            kn_N_m=np.full(n, self.inputs.kn_N_m),
            mu=np.full(n, self.drop.friction_law().mu),
            normals=under.normals,
            rises_m=under.rises_m,
            scale=under.scale,
        )
        return _attempt(self.marcher, drops)


def _body(drop: DropInputs) -> tuple[dict[str, Array], Timings]:
    """The body and coarser ones as arrays, to be sent, and the seconds that they took."""
    with CaseSession(MPI.COMM_SELF) as session:
        ready = session.prepare(drop)
        assert ready is not None
        assert isinstance(ready.frame, ModalFrame)
        return to_arrays((ready.frame.modal, *ready.frame.coarser)), session.take_timings()


def _attempt(marcher: Marcher, drops: Drops) -> list[Row | str]:
    """The outcome of each drop, or why it failed; those that fail are found by halving."""
    try:
        table = np.column_stack(drop_many(marcher, drops))
        return [list(map(float, row)) for row in table]
    except ComputationError as error:
        if len(drops) == 1:
            return [str(error).removeprefix("drop 0: ")]
    half = len(drops) // 2
    parts = drops.part(0, half), drops.part(half, len(drops))
    return [row for part in parts for row in _attempt(marcher, part)]
