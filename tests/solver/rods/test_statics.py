"""Statics of the rod against the elastica, closed forms, other papers' rods, and its own energy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from elastica import cantilever
from rod_helpers import SLENDER, THIN, equilibrium, quaternion, whole_matrix
from scipy.spatial.transform import Rotation

from bristle.meshes.section import Rectangle
from bristle.solver.bristle import Bristle, Material
from bristle.solver.rods.chain import Chain, at_rest, new_system, uniform_chain
from bristle.solver.rods.element import (
    assemble_forces,
    assemble_tangent,
    load_elements,
    new_elements,
    strain_energy,
    strains,
)
from bristle.solver.rods.section import RodSection

# one rod, which no rank shares
pytestmark = pytest.mark.serial


def loaded(section, length_m, elements, *, force=(0, 0, 0), moment=(0, 0, 0), steps=1, along=None):
    """The tip of a rod that stands in the origin along z under loads at its end."""
    chain = uniform_chain(section, length_m, elements)
    x, q = at_rest(chain, np.zeros(3), np.eye(3) if along is None else along)
    loads = np.zeros((elements + 1, 6))
    loads[-1] = *force, *moment
    return equilibrium(chain, x, q, loads, steps=steps)


# DESIGN's table: deflection and shortening at P L²/EI
TABLE = {1: (0.30172, 0.05643), 2: (0.49346, 0.16064), 5: (0.71379, 0.38763), 10: (0.81061, 0.555)}


@pytest.mark.parametrize("load", TABLE)
def test_a_cantilever_is_the_elastica_and_converges_at_second_order(load):
    exact = cantilever(load)
    assert exact == pytest.approx(TABLE[load], abs=6e-6)
    errors = []
    for elements in (10, 20, 40):
        x, _ = loaded(SLENDER, 1.0, elements, force=(load, 0, 0))
        errors.append(math.hypot(x[-1, 0] - exact[0], 1.0 - x[-1, 2] - exact[1]))
    assert errors[-1] < 1e-3 * exact[0]
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 1.9)


def test_without_residual_bending_the_element_converges_at_second_order_too():
    errors = []
    for elements in (10, 20, 40):
        chain = uniform_chain(SLENDER, 1.0, elements)
        stiffness = chain.stiffness.copy()
        stiffness[:, :2] = 1.0 / THIN**2
        chain = chain._replace(stiffness=stiffness)
        loads = np.zeros((elements + 1, 6))
        loads[-1, 0] = 1.0
        x, _ = equilibrium(chain, *at_rest(chain, np.zeros(3), np.eye(3)), loads)
        exact = cantilever(1.0)
        errors.append(math.hypot(x[-1, 0] - exact[0], 1.0 - x[-1, 2] - exact[1]))
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((rates > 1.9) & (rates < 2.1))


def test_small_loads_are_exact_with_few_elements():
    """Timoshenko's cantilever P L³/3EI + P L/GA, and linear in the load to its square."""
    section = replace(SLENDER, GA1_N=50.0)
    load = 1e-4
    x, _ = loaded(section, 1.0, 3, force=(load, 0, 0))
    assert x[-1, 0] == pytest.approx(load * (1.0 / 3.0 + 1.0 / 50.0), rel=1e-7)


@pytest.mark.parametrize("steps", [1, 2, 7, 20])
def test_a_moment_of_a_full_circle_closes_it_whatever_the_steps(steps):
    """2π EI / L; every element turns by the same angle, so the polygon closes too."""
    x, _ = loaded(SLENDER, 1.0, 40, moment=(0, 2.0 * math.pi, 0), steps=steps)
    assert np.abs(x[-1]).max() < 1e-6
    assert x[20, 0] == pytest.approx(1.0 / math.pi, rel=2e-3)


# Tips of the bend of Bathe and Bolourchi, Int. J. Numer. Meth. Engng 14 (1979), by others' rods.
BEND = {300: (58.84, 22.33, 40.08), 450: (52.32, 18.62, 48.39), 600: (47.23, 15.79, 53.37)}


@pytest.mark.parametrize("load", BEND)
def test_a_bend_of_45_degrees_out_of_its_plane(load):
    e, radius = 1e7, 100.0
    section = RodSection(
        EA_N=e,
        **dict.fromkeys(("GA1_N", "GA2_N"), 0.5 * e),
        # the benchmark's polar moment, 1/6
        **dict.fromkeys(("EI1_Nm2", "EI2_Nm2", "GJ_Nm2"), e / 12.0),
        **dict.fromkeys(("rhoA_kg_m", "rhoI1_kg_m", "rhoI2_kg_m"), 1.0),
        **dict.fromkeys(("half_thin_m", "half_wide_m"), 0.5),
        curvature_1_m=(0.0, -1.0 / radius, 0.0),
    )
    x, _ = loaded(section, 0.25 * math.pi * radius, 16, force=(0, load, 0))
    tip = np.array([x[-1, 2], -x[-1, 0], x[-1, 1]])
    start = radius * np.array([math.sqrt(0.5), 1.0 - math.sqrt(0.5), 0.0])
    assert np.linalg.norm(tip - BEND[load]) < 0.005 * np.linalg.norm(BEND[load] - start)


# Dowell and Traybar's beam at Princeton, as computed by others: small and large deflection.
PRINCETON = {8.896: (8.837e-3, 0.108988), 13.345: (1.5186e-2, 0.156467)}


@pytest.mark.parametrize("load", PRINCETON)
def test_the_princeton_beam_bends_about_both_axes_and_twists(load):
    section = RodSection.of(
        Bristle(0.508, Rectangle(3.2024e-3, 12.3777e-3), Material(71.7e9, 0.31))
    )
    part = load * math.sqrt(0.5)
    x, _ = loaded(section, 0.508, 20, force=(part, part, 0))
    small, large = PRINCETON[load]
    assert math.hypot(x[-1, 0] - large, x[-1, 1] - small) < 0.01 * math.hypot(small, large)
    assert x[-1, 1] == pytest.approx(small, rel=0.011)


def bent(rng, elements=5, angle=0.5):
    """A chain of different elements in any shape, and strains of a moment before."""
    chain = Chain(
        length=rng.uniform(0.3, 0.6, elements),
        stiffness=rng.uniform(1.0, 5.0, (elements, 6)),
        rest=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) + 0.2 * rng.normal(size=(elements, 6)),
        mass=np.ones(elements + 1),
        inertia=np.ones((elements + 1, 3)),
        beta=0.0,
        alpha=0.0,
    )
    x = np.cumsum(0.3 * rng.normal(size=(elements + 1, 3)) + [0, 0, 0.5], axis=0)
    turns = [Rotation.from_rotvec(rng.normal(size=3))]
    for _ in range(elements):
        turns.append(turns[-1] * Rotation.from_rotvec(angle * rng.normal(size=3)))
    return chain, x, quaternion(Rotation.concatenate(turns)), chain.rest + 0.1


def rotations(q):
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


def nudged(x, q, unknown, by):
    """The shape with one of its unknowns changed: a coordinate, or a spin about a world axis."""
    x, q = x.copy(), q.copy()
    node, which = divmod(unknown, 6)
    if which < 3:
        x[node, which] += by
    else:
        q[node] = quaternion(Rotation.from_rotvec(by * np.eye(3)[which - 3]) * rotations(q[node]))
    return x, q


@pytest.mark.parametrize("angle", [0.01, 0.5, 1.2])
def test_tangent_and_forces_are_derivatives(rng, angle):
    """Central differences at h = 1e-5 leave some 1e-10 of truncation and 1e-11/h of rounding."""
    chain, x, q, before = bent(rng, angle=angle)
    n, h, elements = len(x), 1e-5, new_elements(len(x) - 1)
    system = new_system(n)

    def residual(x, q):
        assemble_forces(chain, x, q, before, 0.3, system, elements)
        return system.residual.copy().ravel()

    def energy(x, q):
        strain = np.empty((n - 1, 6))
        strains(chain, x, q, strain)
        return strain_energy(chain, strain)

    residual(x, q)
    assemble_tangent(chain, 0.3, system, elements)
    tangent = whole_matrix(system).reshape(6 * n, 6 * n)
    loads = np.zeros((n, 6))
    load_elements(chain, x, q, before, 0.0, elements)
    loads[:-1] += elements.ends[:, 0]
    loads[1:] += elements.ends[:, 1]
    for unknown in range(6 * n):
        up, down = nudged(x, q, unknown, h), nudged(x, q, unknown, -h)
        slope = (residual(*up) - residual(*down)) / (2 * h)
        assert tangent[:, unknown] == pytest.approx(slope, abs=1e-8)
        gradient = (energy(*up) - energy(*down)) / (2 * h)
        assert loads.ravel()[unknown] == pytest.approx(gradient, abs=1e-8)


def test_a_rigid_motion_changes_no_force(rng):
    """Forces turn with the rod to 1e-10, whatever the angle."""
    chain, x, q, before = bent(rng)
    one, two = new_elements(len(x) - 1), new_elements(len(x) - 1)
    load_elements(chain, x, q, before, 0.3, one)
    for _ in range(5):
        turn = Rotation.from_rotvec(3.0 * rng.normal(size=3))
        moved = turn.apply(x) + 10.0 * rng.normal(size=3)
        load_elements(chain, moved, quaternion(turn * rotations(q)), before, 0.3, two)
        back = turn.inv().apply(two.ends.reshape(-1, 3)).reshape(one.ends.shape)
        assert back == pytest.approx(one.ends, abs=1e-10)
