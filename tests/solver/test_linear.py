"""The solvers of a solid's equations agree; the right one is taken, and made once."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from solids import reduced_for

from bristle.meshes.section import Circle
from bristle.solver.bodies import linear
from bristle.solver.bodies.linear import TOLERANCE, Cholesky, Solver, choose, make_solver
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Linear
from bristle.solver.drop import DropPlan, simulate
from bristle.solver.errors import ComputationError
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.choices import Model
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running.cases import CaseSession

BODIES = [
    {"cells": (1, 2, 12), "order": 1},
    {"cells": (2, 3, 8), "order": 2},
    {"cells": (2, 1, 6), "order": 2, "section": Circle(2e-3), "geometry_order": 2},
]


def energy_norm(solid, x, c_mass, c_stiffness):
    image = c_mass * solid.mass(x) + c_stiffness * solid.stiffness(x)
    return math.sqrt(solid.dot(x, image))


def places(solid):
    return solid.space.tabulate_dof_coordinates()[: solid.n_local // 3]


@pytest.mark.parametrize("its", [1e-5, 1e-9])
@pytest.mark.parametrize("body", BODIES)
def test_every_method_solves_the_equations(make_solid, body, its):
    """Long steps, where stiffness rules, and short ones, where the mass does."""
    solid = make_solid(**body)
    effective = TimeScheme.average().effective(its, 0.0, 1e-7)
    wanted = np.sin(400.0 * places(solid) + [0.0, 1.0, 2.0]).ravel()
    b = effective[0] * solid.mass(wanted) + effective[1] * solid.stiffness(wanted)
    block = np.asfortranarray(np.column_stack([b, -2.0 * b, 0.0 * b]))
    size = energy_norm(solid, wanted, *effective)
    for method in (Solver.DIRECT, Solver.ITERATIVE):
        solver = make_solver(solid, method, *effective)
        x, columns = solver.solve(b), solver.solve(block)
        solver.close()
        # CG measures the error by its preconditioner, which is not the matrix itself
        close = 100.0 * TOLERANCE if method is Solver.ITERATIVE else 1e-9
        assert energy_norm(solid, x - wanted, *effective) < close * size
        for column, factor in zip(columns.T, (1.0, -2.0, 0.0), strict=True):
            error = np.ascontiguousarray(column - factor * wanted)
            assert energy_norm(solid, error, *effective) < 2.0 * close * size


@pytest.mark.parametrize(("its", "kind"), [(1e-5, "gamg"), (1e-9, "jacobi")])
def test_multigrid_is_for_long_steps(make_solid, its, kind):
    solid = make_solid(**BODIES[0])
    effective = TimeScheme.average().effective(its, 0.0, 0.0)
    solver = make_solver(solid, Solver.ITERATIVE, *effective)
    assert solver.solver.getPC().getType() == kind
    solver.close()


def test_methods_bounce_alike_and_close_the_budget(make_solid, monkeypatch):
    solid = make_solid((1, 2, 4), 0.004, order=1)
    its = 1e-6
    plan = DropPlan(0.05, ContactMethod(Linear(2e6)), its, 9.8)
    results = {}
    for method in (Solver.DIRECT, Solver.ITERATIVE):
        monkeypatch.setitem(solid.__dict__, "method", method)
        solid.release_factors()
        results[method] = simulate(reduced_for(solid, its, 8), plan)
    solid.release_factors()
    direct = results.pop(Solver.DIRECT)
    for result in results.values():
        # every step adds the solver's tolerance at most
        close = direct.n_steps * TOLERANCE
        assert result.rebound_ratio == pytest.approx(direct.rebound_ratio, rel=close)
        for part in ("kinetic_J", "material_loss_J"):
            wanted = getattr(direct.energy, part)
            assert getattr(result.energy, part) == pytest.approx(wanted, rel=close)
        assert result.energy.closure_relative < 1e-6


def test_the_rule_of_choice(make_solid):
    slender, compact = (54_675, 675, 2), (1_000_000, 139, 2)
    for solver, far in ((Solver.AUTO, Solver.ITERATIVE), (Solver.DIRECT, Solver.DIRECT)):
        assert choose(solver, *slender) is Solver.DIRECT
        assert choose(solver, *compact) is far
    assert choose(Solver.ITERATIVE, *slender) is Solver.ITERATIVE
    # along the bar a factor grows as its unknowns
    assert choose(Solver.AUTO, 40 * slender[0], 40 * slender[1], 2) is Solver.DIRECT
    assert make_solid((1, 2, 24), 0.05).method is Solver.DIRECT


@pytest.mark.parametrize("cells", [(2, 2, 60), (3, 3, 40), (6, 6, 6)])
def test_a_factor_is_about_as_large_as_is_thought(make_solid, cells, monkeypatch):
    """What it is thought to be is where the choice turns, to within a factor of two."""
    solid = make_solid(cells, 0.05)
    found = make_solver(solid, Solver.DIRECT, 1e12, 1.0)
    assert isinstance(found, Cholesky)
    size, entries = (solid.n_dofs, len(solid.layers_m), solid.order), found.entries
    found.close()
    monkeypatch.setattr(linear, "LARGEST_FACTOR", 2 * entries)
    assert choose(Solver.AUTO, *size) is Solver.DIRECT
    monkeypatch.setattr(linear, "LARGEST_FACTOR", entries // 2)
    assert choose(Solver.AUTO, *size) is Solver.ITERATIVE


def test_conjugate_gradients_that_do_not_arrive_say_so(make_solid, monkeypatch):
    solid = make_solid((1, 2, 12), order=1)
    monkeypatch.setattr(linear, "ITERATIONS", 1)
    solver = make_solver(solid, Solver.ITERATIVE, 1.0, 1e-10)
    with pytest.raises(ComputationError, match="take a direct solver") as raised:
        solver.solve(np.cos(np.arange(solid.n_local, dtype=float)))
    assert raised.value.inputs == ("solver",)
    solver.close()


def test_a_sweep_factors_once_for_each_step_and_damping():
    """Whatever the stiffness, the height and the enforcement are."""
    small = {"model": Model.SOLID, "cells": (1, 1, 12), "length_m": 0.05, "modes": 12}
    base = DropInputs(**small)
    with CaseSession(MPI.COMM_WORLD) as session:
        for kn in (1e5, 2e6):
            for height in (0.01, 0.05):
                session.run(base.changed(kn_N_m=kn, height_m=height))
        solid = session._full(base).body
        assert solid.factorisations == 1
        session.run(base.changed(contact="augmented"))
        assert solid.factorisations == 1
        session.run(base.changed(its_s=5e-6))
        assert solid.factorisations == 2
        session.run(base)
        assert solid.factorisations == 2
        # damping belongs to the material, so this is another body
        other = base.changed(beta_s=1e-8)
        session.run(other)
        assert (solid.factorisations, session._full(other).body.factorisations) == (2, 1)
