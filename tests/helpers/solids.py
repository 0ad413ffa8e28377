"""What tests of solids share: bodies reduced for a march of some ITS, and natural frequencies."""

from __future__ import annotations

import math

import numpy as np
from petsc4py import PETSc
from slepc4py import SLEPc

from bristle.solver.bodies.linear import take_direct
from bristle.solver.bodies.reduced import ReducedModel, reduce_solid
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.time.scheme import TimeScheme


def reduced_for(solid: SolidBody, its_s: float, n_krylov: int = 24, **options) -> ReducedModel:
    """The solid reduced for steps of the conserving scheme of ``its_s``."""
    c_mass, c_stiffness = TimeScheme.average().effective(its_s, solid.alpha_1_s, solid.beta_s)
    return reduce_solid(solid, c_mass / c_stiffness, n_krylov, **options)


def frequencies_hz(
    stiffness: PETSc.Mat, mass: PETSc.Mat, near_hz: float, count: int = 14
) -> np.ndarray:
    """Natural frequencies near ``near_hz``, the lowest first, by SLEPc's shift-and-invert."""
    solver = SLEPc.EPS().create(mass.comm)
    solver.setOperators(stiffness, mass)
    solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    solver.setDimensions(count)
    solver.setTarget((2.0 * math.pi * near_hz) ** 2 * 1.003)
    solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    transform = solver.getST()
    transform.setType(SLEPc.ST.Type.SINVERT)
    take_direct(transform.getKSP(), PETSc.PC.Type.LU)
    solver.solve()
    found = [solver.getEigenvalue(i).real for i in range(solver.getConverged())]
    solver.destroy()
    return np.sqrt(np.abs(np.sort(found))) / (2.0 * math.pi)
