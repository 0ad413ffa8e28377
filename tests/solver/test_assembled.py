"""The condensed marches against the step's form assembled whole, step by step."""

import numpy as np
import pytest
from assembled import AssembledMarcher, drop_assembled, drop_condensed

from bristle.solver.bristle import Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Damped, Linear
from bristle.solver.errors import InputError
from bristle.solver.ground import Ground, just_touched, place
from bristle.solver.rigid import Pose, leaning, slope_normal
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked

G, ITS, STEPS, SPEED = 9.8, 1e-6, 14, 1.0
MATERIAL = Material(alpha_1_s=30.0, beta_s=2e-7)


@pytest.fixture
def solids(make_solid):
    return lambda cells, points: make_solid(cells, material=MATERIAL, points=points)


def march(marcher, tilt_deg, slope_deg=0.0):
    """Forces (steps, n, 3) of an impact, and the last state."""
    points, pose = marcher.body.contact, Pose(np.zeros(3), leaning(tilt_deg))
    ground = Ground.plane(len(points.weights), slope_normal(slope_deg, 0.0))
    marcher.place(place(just_touched(ground, pose, points), pose, points))
    down = marcher.body.translation @ (-SPEED * pose.rotation[2])
    state, forces = marcher.start(0.0, np.zeros_like(down), down), []
    for _ in range(STEPS):
        state, force, *_ = marcher.step(state)
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
    ("upright", 0.0, 0.0, 0.0, (1, 2, 8), 5, Enforcement.PENALTY, 1),
    ("leaning", 3.0, 0.0, 0.0, (1, 2, 8), 5, Enforcement.PENALTY, 1),
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
    inputs = checked(DropInputs, {"height_m": 0.01, "its_s": 2e-6, "until": "impact", **drop})
    condensed, assembled = drop_condensed(inputs), drop_assembled(inputs)
    assert assembled.n_steps == condensed.n_steps
    for name in ("peak_force_N", "contact_time_s", "cm_velocity_after_m_s", "max_penetration_m"):
        assert getattr(assembled, name) == pytest.approx(getattr(condensed, name), rel=1e-8)


def test_another_law_is_that_of_a_march_made_for_it(solids):
    """The plane's numbers in the form follow the law, both ways."""
    solid, soft, stiff = solids((1, 2, 8), 5), Linear(2e5), Linear(2e6)
    how = (TimeScheme.average(), ITS, G)
    made = [AssembledMarcher(solid, ContactMethod(law), *how) for law in (soft, stiff)]
    try:
        first, second = (march(marcher, 2.0) for marcher in made)
        assert np.abs(first[0]).max() < 0.5 * np.abs(second[0]).max()
        alike(march(made[0].with_law(stiff), 2.0), second, 1e-9)
        alike(march(made[0], 2.0), first, 1e-9)
    finally:
        for marcher in made:
            marcher.close()


@pytest.mark.parametrize(
    ("method", "said"),
    [
        (ContactMethod(Linear(2e6), Enforcement.AUGMENTED), "linear law, by penalty or Nitsche"),
        (ContactMethod(Damped(2e6, 5.0)), "linear law, by penalty or Nitsche"),
        (ContactMethod(Linear(2e6), friction=Coulomb(0.1)), "contact points at nodes"),
    ],
)
def test_what_the_assembled_form_does_not_know_is_refused(solids, method, said):
    solid, plain = solids((1, 2, 8), 5), ContactMethod(Linear(2e6))
    with pytest.raises(InputError, match=said):
        AssembledMarcher(solid, method, TimeScheme.average(), ITS, G)
    marcher = AssembledMarcher(solid, plain, TimeScheme.average(), ITS, G)
    try:
        if method.enforcement is plain.enforcement:
            with pytest.raises(InputError, match=said):
                marcher.with_law(method.law, method.friction)
        points = solid.contact
        bent = Ground.plane(len(points.weights), slope_normal(1.0, 0.0))
        bent.normals[0] = (0.0, 0.0, 1.0)
        with pytest.raises(InputError, match="one plane"):
            marcher.place(place(bent, Pose(np.zeros(3), leaning(0.0)), points))
    finally:
        marcher.close()
