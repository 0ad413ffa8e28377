"""Drops by the 3-D solid, with effects in it that were found with the beam.

Nothing of the beam's tables is used: every drop is simulated with the solid reduced to its modes,
and effects enter through the same scenes as everywhere (solver.effects).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import lru_cache

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from .....meshes.section import Circle, Rectangle
from .....solver.arrays import Array
from .....solver.bodies.modal import ModalBody
from .....solver.bristle import Bristle
from .....solver.drop import ModalFrame
from .....solver.effects.base import Effect
from .....solver.errors import ComputationError
from ....inputs.choices import Model
from ....inputs.sources import checked
from ....running.cases import CaseSession
from ....running.steps import with_shorter_its
from ...responses.drop_model import DropModel
from ...responses.emulator import PLAIN_STEP
from ...responses.table import QUANTITIES
from ...responses.table_drops import ITS_S, leans, outcomes_of, quantities, read_off

# Deviates of chance, with weights that sum to one: five of a normal number (Gauss and Hermite;
# exact to the ninth moment), and for a slope three sizes (of its square, Gauss and Laguerre) in
# two directions of a quadrant.
NORMAL = 5
SIZES = 3
DIRECTIONS_DEG = (22.5, 67.5)
# A lean of this much makes the solid's modes bend; how far a drop leans makes no other body.
ANY_LEAN_DEG = 1.0


@lru_cache(maxsize=4)
def solid_of(bristle: Bristle, gravity_m_s2: float, leaning: bool) -> ModalBody:
    """This rank's own `reduced_solid`."""
    return reduced_solid(bristle, gravity_m_s2, leaning, MPI.COMM_SELF)


def reduced_solid(
    bristle: Bristle, gravity_m_s2: float, leaning: bool, comm: MPI.Intracomm
) -> ModalBody:
    """The solid of a bristle, reduced, to be upright or to lean; kept from run to run.

    Collective over ``comm``. Raises ComputationError.
    """
    from ....inputs.config import DropInputs

    section = bristle.section
    inputs = checked(
        DropInputs,
        {
            "model": Model.REDUCED,
            "length_m": bristle.length_m,
            **(asdict(section) if isinstance(section, Rectangle | Circle) else {}),
            **asdict(bristle.material),
            "gravity_m_s2": gravity_m_s2,
            "its_s": ITS_S,
            "tilt_deg": ANY_LEAN_DEG if leaning else 0.0,
        },
    )
    with CaseSession(comm) as session:
        prepared = session.prepare(inputs)
        if prepared is None or not isinstance(prepared.frame, ModalFrame):
            raise ComputationError("the solid could not be reduced to its modes")
        return prepared.frame.modal


def chances(effects: Sequence[Effect]) -> tuple[list[tuple[tuple[float, ...], ...]], Array]:
    """Standard normal numbers for each effect, by node, and the nodes' weights, which sum to one.

    Effects that do not differ from drop to drop have nothing drawn.
    """
    each = [_nodes(effect) for effect in effects]
    nodes = [tuple(x for x, _ in node) for node in itertools.product(*each)]
    weights = [np.prod([w for _, w in node]) for node in itertools.product(*each)]
    return nodes, np.asarray(weights, dtype=float)


def _nodes(effect: Effect) -> list[tuple[tuple[float, ...], float]]:
    if not effect.random:
        return [((0.0, 0.0), 1.0)]
    if effect.name == "surface_slope":
        half_squares, shares = np.polynomial.laguerre.laggauss(SIZES)
        return [
            (
                (size * float(np.cos(np.radians(angle))), size * float(np.sin(np.radians(angle)))),
                float(share) / len(DIRECTIONS_DEG),
            )
            for size, share in zip(np.sqrt(2.0 * half_squares), shares, strict=True)
            for angle in DIRECTIONS_DEG
        ]
    deviates, shares = np.polynomial.hermite_e.hermegauss(NORMAL)
    shares = shares / shares.sum()
    return [((float(x), 0.0), float(w)) for x, w in zip(deviates, shares, strict=True)]


def solid_drops(model: DropModel, theta: Array, which: Sequence[int]) -> Array:
    """What instruments show of the drops numbered ``which``, in SI (drops, quantities).

    Means over chance where effects differ from drop to drop. Raises ComputationError.
    """
    emulator, friction = model.emulator, model.friction(theta)
    nodes, weights = chances(model.entered(theta))
    scenes = [scene for node in nodes for scene in model.scenes(theta, which, node)]
    body = solid_of(emulator.bristle, emulator.gravity_m_s2, any(map(leans, scenes)))
    # as the table of plain drops is made (`Emulator`), or with shorter steps
    found = with_shorter_its(
        lambda its: quantities(outcomes_of(body, scenes, emulator.gravity_m_s2, its, friction)),
        PLAIN_STEP * emulator.step_s(max(scene.law.kn_N_m for scene in scenes)),
    )
    found = read_off(found, scenes, emulator.bristle.mass_kg)
    if model.gain is not None:
        found[:, 2] *= theta[len(model.own) - 1]
    shaped = found.reshape(len(nodes), len(which), len(QUANTITIES))
    return np.einsum("n,ndq->dq", weights, shaped)[:, list(model.drops.quantities)]


def whitened_solid(
    model: DropModel, theta: Array, groups: NDArray[np.int64], group: NDArray[np.int64]
) -> Array:
    """Whitened predictions by the solid for the rows of ``groups``; ``group`` (drops,) numbers
    the model's drops."""
    which = np.flatnonzero(np.isin(group, groups)).astype(np.int64)
    part = replace(
        model,
        drops=model.drops.of(which),
        errors=replace(model.errors.only(which), values=None),
        correction=None,
    )
    at = np.asarray(theta, dtype=float)
    return part.errors.rows(part.by_few(lambda few: solid_drops(few, at, range(len(few.drops)))))
