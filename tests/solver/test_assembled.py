"""The condensed marches against the step's form assembled whole, step by step."""

import numpy as np
import pytest
from mpi4py import MPI

from bristle.meshes import geometry
from bristle.meshes.distribute import to_dolfinx
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.errors import InputError
from bristle.solver.ground import Ground, just_touched, place
from bristle.solver.rigid import Pose, leaning, slope_normal
from bristle.solver.time.assembled import AssembledMarcher
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import run_case

G, ITS, STEPS, SPEED = 9.8, 1e-6, 14, 1.0
MATERIAL = Material(alpha_1_s=30.0, beta_s=2e-7)


@pytest.fixture(scope="module")
def solids():
    made = {}

    def build(cells, points):
        if (cells, points) not in made:
            domain, _, facets = to_dolfinx(geometry.MeshSpec(0.02, cells=cells), MPI.COMM_WORLD)
            made[cells, points] = SolidBody(
                domain, facets, int(geometry.Tag.TIP), MATERIAL, 2, points
            )
        return made[cells, points]

    yield build
    for solid in made.values():
        solid.close()


def march(marcher, tilt_deg, slope_deg=0.0):
    """Forces (steps, n, 3) of an impact, and the last state."""
    points, pose = marcher.body.contact, Pose(np.zeros(3), leaning(tilt_deg))
    ground = Ground.plane(len(points.weights), slope_normal(slope_deg, 0.0))
    marcher.place(place(just_touched(ground, pose, points), pose, points))
    down = marcher.body.translation @ (-SPEED * pose.rotation[2])
    state, forces = marcher.start(0.0, np.zeros_like(down), down), []
    for _ in range(STEPS):
        state, force, _, _ = marcher.step(state)
        forces.append(force)
    return np.array(forces), state


def alike(one, other, forces=1e-10):
    (force, state), (reference, expected) = one, other
    largest = np.abs(reference).max()
    assert largest > 0.0
    assert np.abs(force - reference).max() < forces * largest
    assert np.abs(state.u - expected.u).max() < 1e-9 * np.abs(expected.u).max()
    assert np.abs(state.v - expected.v).max() < 1e-9 * np.abs(expected.v).max()


CASES = [
    ("upright", 0.0, 0.0, 0.0, (1, 2, 8), 9, Enforcement.PENALTY, 1),
    ("leaning", 3.0, 0.0, 0.0, (1, 2, 8), 9, Enforcement.PENALTY, 1),
    ("slope and friction", 2.0, -4.0, 0.1, (1, 2, 8), 3, Enforcement.PENALTY, 1),
    ("symmetric Nitsche", 2.0, 0.0, 0.0, (1, 1, 8), 5, Enforcement.NITSCHE, 1),
    ("incomplete Nitsche", 2.0, 0.0, 0.0, (1, 1, 8), 5, Enforcement.NITSCHE, 0),
    ("skew Nitsche, friction", 2.0, 3.0, 0.1, (1, 1, 8), 3, Enforcement.NITSCHE, -1),
]


@pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_condensed_march_is_the_assembled_one(solids, case, finite):
    _, tilt, slope, mu, cells, n, enforcement, theta = case
    solid = solids(cells, n)
    method = ContactMethod(Linear(2e6), enforcement, theta, friction=Coulomb(mu))
    how = (solid, method, TimeScheme.average(), ITS, G)
    assembled = AssembledMarcher(*how, finite=finite)
    condensed = FiniteMarcher(*how) if finite else Marcher(*how)
    try:
        alike(march(condensed, tilt, slope), march(assembled, tilt, slope))
    finally:
        assembled.close()
        if finite:
            condensed.close()


@pytest.mark.parametrize("lean", [{}, {"tilt_deg": 2.0}], ids=["upright", "leaning"])
def test_a_drop_of_the_assembled_form_is_that_of_the_condensed_march(lean):
    drop = {"model": "solid", "cells": (1, 2, 10), "length_m": 0.02, "friction": 0.0, **lean}
    drop = {"height_m": 0.01, "its_s": 2e-6, "until": "impact", **drop}
    condensed, assembled = (
        run_case(checked(DropInputs, {**drop, "solver": solver}), MPI.COMM_WORLD)[0]
        for solver in ("direct", "snes")
    )
    assert assembled.n_steps == condensed.n_steps
    for name in ("peak_force_N", "contact_time_s", "cm_velocity_after_m_s", "max_penetration_m"):
        assert getattr(assembled, name) == pytest.approx(getattr(condensed, name), rel=1e-8)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"model": "beam"}, "--model solid"),
        ({"contact": "augmented"}, "--contact"),
        ({"scheme": "newmark"}, "--scheme"),
        ({"march": True}, "--march"),
        ({"tip_shape": "worn:angle=1"}, "--tip-shape"),
        ({"tilt_deg": 2.0, "cells": (1, 1, 4)}, "--contact-points: .* or 3 with 1 × 1 cells"),
        ({"tilt_deg": 2.0, "order": 1, "contact_points": 3}, "--order: .* or 2"),
        ({"effects": ["plastic_contact:yield_N=20"]}, "--effect: .* linear contact law"),
    ],
    ids=str,
)
def test_what_the_assembled_form_does_not_know_is_refused(values, named):
    with pytest.raises(InputError, match=named):
        checked(DropInputs, {"model": "solid", "solver": "snes", **values})


@pytest.mark.serial
def test_friction_between_nodes_is_refused_by_the_assembled_form():
    """Of a round wire, whose nodes nobody knows before its mesh is made."""
    inputs = {"model": "solid", "solver": "snes", "tilt_deg": 2.0, "diameter_m": 1e-3}
    inputs |= {"cells": (2, 2, 8), "length_m": 0.02, "contact_points": 25}
    with pytest.raises(InputError, match="--contact-points 3"):
        run_case(checked(DropInputs, inputs), MPI.COMM_SELF)
