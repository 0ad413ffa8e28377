"""Simulated drops of given scenes for a table: the body, and the time step that suffices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ....solver import paper
from ....solver.analytic import quarter_period_s
from ....solver.arrays import Array
from ....solver.batch import Drops, Outcome, drop_each, drop_many
from ....solver.bodies.beam import beam_body
from ....solver.bodies.modal import ModalBody
from ....solver.bristle import Bristle
from ....solver.contact.enforcement import ContactMethod
from ....solver.contact.laws import Coulomb, mindlin_ratio
from ....solver.effects.base import Scene
from ....solver.fall import risen
from ....solver.rigid import leaning, matrix_of, slope_normal
from ....solver.time.march import Marcher
from ....solver.time.scheme import TimeScheme

# Steps of an impact: against 0.05 µs, y1/y0 and the contact time of an upright beam are then off
# by less than a thousandth from 0.1 to 100 MN/m, its peak force by up to 2 % above 3 MN/m.
ITS_S = 2e-6
SHORTEST_ITS_S = 5e-7
# Of the mass' quarter period on its spring: a soft contact lasts long and needs no shorter step.
SOFT_SHARE = 1 / 100
POINTS = 5


@lru_cache(maxsize=8)
def beam_of(bristle: Bristle) -> ModalBody:
    """The beam that tables are made with, to second order in its slope."""
    return beam_body(bristle, paper.ELEMENTS, points=POINTS, second_order=True)


def its_s(bristle: Bristle, kn_N_m: float) -> float:
    """A step that resolves the spring: a twelfth of the mass' quarter period on it, or `ITS_S`,
    and longer where the contact is so soft that the bristle's waves are slow beside it."""
    quarter = quarter_period_s(bristle.mass_kg, kn_N_m)
    stiff = min(ITS_S, max(quarter / 12.0, SHORTEST_ITS_S))
    return float(f"{max(stiff, SOFT_SHARE * quarter):.0e}")


def leans(scene: Scene) -> bool:
    """Whether a bristle meets the surface otherwise than upright."""
    return any((scene.tilt_deg, scene.tilt_wide_deg, scene.slope_deg, scene.slope_wide_deg))


def quantities(found: Outcome) -> Array:
    """What is measured of drops, (drops, quantities of `table.QUANTITIES`)."""
    return np.stack([found.rebound_height_m, found.contact_time_s, found.peak_force_N], axis=1)


def read_off(found: Array, scenes: Sequence[Scene], mass_kg: float) -> Array:
    """What instruments show of drops of these scenes, from `quantities` (drops, quantities)."""
    drag, scale, offset, clock = np.array(
        [(s.drag_kg_m / mass_kg, s.y_scale, s.y_offset_m, s.t_scale) for s in scenes]
    ).T
    top, time, force = found.T
    return np.stack([scale * (risen(top, drag) + offset), clock * time, force], axis=1)


def outcomes_of(
    body: ModalBody,
    scenes: Sequence[Scene],
    gravity_m_s2: float,
    its: float,
    friction: float,
    *,
    lenient: bool = False,
) -> Outcome:
    """What drops of these scenes give, arrays (scenes,); all share the material's damping and loss.

    Heights are those of a fall from rest in a vacuum. ComputationError where a drop fails or,
    ``lenient``, what `drop_each` makes of it.
    """
    alike: dict[type, list[int]] = {}
    for i, scene in enumerate(scenes):
        alike.setdefault(type(scene.law), []).append(i)
    out = np.empty((len(Outcome._fields), len(scenes)))
    for members in alike.values():
        part = [scenes[i] for i in members]
        out[:, members] = _under_one_law(body, part, gravity_m_s2, its, friction, lenient)
    return Outcome(*out)


def _under_one_law(
    body: ModalBody,
    scenes: Sequence[Scene],
    gravity_m_s2: float,
    its: float,
    friction: float,
    lenient: bool,
) -> Outcome:
    """`outcomes_of` scenes whose laws are of one kind."""
    first = scenes[0]
    body = replace(body, beta_s=first.beta_s, loss_factor=first.loss_factor)
    # a drop that lands upright on a level surface does not slide
    mu = friction if any(map(leans, scenes)) else 0.0
    method = ContactMethod(first.law, friction=Coulomb(mu, mindlin_ratio(paper.POISSON)))

    def marcher_at(its_s: float) -> Marcher:
        return Marcher(body, method, TimeScheme.average(), its_s, gravity_m_s2)

    n = len(body.contact.weights)
    drops = Drops.on_plane(
        n,
        height_m=np.array([s.height_m for s in scenes]),
        kn_N_m=np.array([s.law.kn_N_m for s in scenes]),
        tilt_deg=np.array([s.tilt_deg for s in scenes]),
        tilt_wide_deg=np.array([s.tilt_wide_deg for s in scenes]),
        mu=mu,
    )
    normals = np.array([slope_normal(s.slope_deg, s.slope_wide_deg) for s in scenes])
    turns = np.array([matrix_of(leaning(s.tilt_deg, s.tilt_wide_deg)) for s in scenes])
    at = np.einsum("sxk,nk->snx", turns, body.contact.places_m)
    rises = -np.einsum("sx,snx->sn", normals[:, :2], at[..., :2]) / normals[:, 2:]
    drops = replace(
        drops,
        normals=np.repeat(normals[:, None, :], n, axis=1),
        rises_m=rises,
        laws=np.array([s.law.parameters for s in scenes]),
        damping=np.array([s.law.damping for s in scenes]),
    )
    return drop_each(marcher_at, drops, its) if lenient else drop_many(marcher_at(its), drops)
