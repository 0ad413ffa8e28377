"""One bristle dragged at 1 m/s by programs that share no code: error in the hub's force, CPU time.

    docker/run python3 tests/benchmarks/dragged.py --elastica FOLDER

The bristle leans by 30°, comes down by a fifth of its length and reaches 1 m/s within 0.2 s. It is
computed by the rods of `bristle brush`; by a plane Reissner beam in dolfinx, as a user would write
it; and by PyElastica where that is installed (``--elastica FOLDER`` adds a folder to the path of
modules). All have the same Kn, friction and damping by α. The rods alone have damping by β as well,
which takes the ringing of axial waves that the others resolve. The hub's force is averaged over
windows of 10 ms, and compared from 0.2 s on, when the bristle is dragged steadily. The error is the
root of the mean square of its difference from that of a fine rod, over that of the force itself.

CPU time is that of the process (user and system), after everything is compiled.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from mpi4py import MPI
from numba import njit

from bristle.solver.rods.hub import hub_coordinates
from bristle.solver.rods.rods import Rods
from bristle.solver.rods.section import RodSection
from bristle.studies.brush.inputs import BrushInputs
from bristle.studies.inputs.sources import checked

UNTIL_S, WINDOW_S = 0.25, 1e-2
START_S, LEAN, ALPHA_1_S = 0.2, math.radians(30.0), 20.0


def inputs_of(elements: int) -> BrushInputs:
    """The brush of one bristle."""
    values = {"mount_angle_deg": 30.0, "penetration_m": 0.0673, "motion": "slide:speed=1"}
    values |= {"gravity_m_s2": 0.0, "alpha_1_s": ALPHA_1_S, "start_s": START_S}
    return checked(BrushInputs, {**values, "until_s": UNTIL_S, "elements": elements})


@dataclass(frozen=True)
class Run:
    """Mean force on the hub over each window (n, 2) in N, x and z, and CPU time in s."""

    force_N: np.ndarray
    cpu_s: float

    def error(self, exact: Run) -> float:
        """While the bristle is dragged steadily, as a share of the force."""
        first = round(START_S / WINDOW_S)
        difference = self.force_N[first:] - exact.force_N[first:]
        return float(np.linalg.norm(difference) / np.linalg.norm(exact.force_N[first:]))


def window_ends() -> np.ndarray:
    """In s."""
    return WINDOW_S * np.arange(1, round(UNTIL_S / WINDOW_S) + 1)


def rod(elements: int, tolerance: float = 1e-6) -> Run:
    """By the rods of `bristle brush`."""
    inputs = inputs_of(elements)
    section, path = RodSection.of(inputs.bristle()), inputs.hub_motion
    rods = Rods(
        section,
        inputs.clamps,
        path,
        inputs.ground,
        elements,
        gravity_m_s2=0.0,
        bow_rad=0.0,
        tolerance=tolerance,
        comm=MPI.COMM_SELF,
    )
    started, found = time.process_time(), []
    for t in window_ends():
        rods.advance(float(t))
        found.append(rods.frame().means.force_N[0, [0, 2]])
    return Run(np.array(found), time.process_time() - started)


def beam(elements: int, step_s: float) -> Run:
    """By a plane Reissner beam of quadratic elements in dolfinx: generalised-alpha with steps of
    equal length, penalty on the tip's corners, Newton's method with a fresh LU."""
    import ufl
    from dolfinx import fem, mesh
    from dolfinx.fem.petsc import NonlinearProblem
    from dolfinx.nls.petsc import NewtonSolver
    from petsc4py import PETSc

    inputs = inputs_of(elements)
    section, path, ground = RodSection.of(inputs.bristle()), inputs.hub_motion, inputs.ground
    length, half = inputs.bristle().length_m, section.half_thin_m
    domain = mesh.create_interval(MPI.COMM_SELF, elements, [0.0, length])
    V = fem.functionspace(domain, ("Lagrange", 2, (3,)))  # x, z, turn
    u, u0, v0, a0, b0 = (fem.Function(V) for _ in range(5))
    test = ufl.TestFunction(V)
    rho = 0.6
    am, af = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    beta, gamma = 0.25 * (1.0 - am + af) ** 2, 0.5 - am + af
    h, constants = step_s, (am, af, beta, gamma)
    axis, side = (-ufl.sin(u[2]), -ufl.cos(u[2])), (ufl.cos(u[2]), -ufl.sin(u[2]))
    slope = (u[0].dx(0), u[1].dx(0))
    stretch = slope[0] * axis[0] + slope[1] * axis[1] - 1.0
    shear = slope[0] * side[0] + slope[1] * side[1]
    energy = section.EA_N * stretch**2 + section.GA1_N * shear**2
    energy += section.EI2_Nm2 * u[2].dx(0) ** 2
    reduced = ufl.dx(metadata={"quadrature_degree": 2})
    velocity, acceleration, _ = _rates((u, u0, v0, a0, b0), h, constants)
    inertia = ufl.as_vector(
        [
            weight * (acceleration[i] + inputs.alpha_1_s * velocity[i])
            for i, weight in enumerate((section.rhoA_kg_m, section.rhoA_kg_m, section.rhoI2_kg_m))
        ]
    )
    form = ufl.derivative(0.5 * energy * reduced, u, test)
    form += ufl.inner(inertia, test) * ufl.dx(metadata={"quadrature_degree": 4})
    ends = mesh.meshtags(
        domain, 0, mesh.locate_entities_boundary(domain, 0, lambda x: x[0] > 0.5 * length), 1
    )
    tip = ufl.Measure("ds", domain=domain, subdomain_data=ends)(1)
    anchors = [fem.Constant(domain, PETSc.ScalarType(0.0)) for _ in range(2)]
    kn, kt, mu = 0.5 * ground.kn_N_m, 0.5 * ground.kt_over_kn * ground.kn_N_m, inputs.friction
    for sign, anchor in zip((-1.0, 1.0), anchors, strict=True):
        normal = kn * ufl.max_value(0.0, -(u[1] + sign * half * side[1]))
        trial = kt * (u[0] + sign * half * side[0] - anchor)
        friction = ufl.max_value(-mu * normal, ufl.min_value(mu * normal, trial))
        push = (-friction, normal)
        moved_x = test[0] - sign * half * ufl.sin(u[2]) * test[2]
        moved_z = test[1] - sign * half * ufl.cos(u[2]) * test[2]
        form -= (push[0] * moved_x + push[1] * moved_z) * tip
    held = fem.Function(V)
    clamp = mesh.locate_entities_boundary(domain, 0, lambda x: np.isclose(x[0], 0.0))
    bc = fem.dirichletbc(held, fem.locate_dofs_topological(V, 0, clamp))
    problem = NonlinearProblem(form, u, [bc])
    newton = NewtonSolver(MPI.COMM_SELF, problem)
    newton.atol, newton.rtol, newton.convergence_criterion = 1e-7, 1e-9, "residual"
    newton.max_it = 40
    newton.krylov_solver.setType("preonly")
    newton.krylov_solver.getPC().setType("lu")
    s = V.tabulate_dof_coordinates()[:, 0]
    height = path.pose(0.0).position_m[2]
    start = np.stack([-s * math.sin(LEAN), height - s * math.cos(LEAN), np.full_like(s, LEAN)], 1)
    u.x.array[:] = u0.x.array[:] = start.ravel()
    first, last = int(np.argmin(s)), int(np.argmax(s))
    reaction = fem.form(form)

    def corners() -> list[tuple[float, float]]:
        x, z, turn = u.x.array.reshape(-1, 3)[last]
        return [
            (x + sign * half * math.cos(turn), z - sign * half * math.sin(turn))
            for sign in (-1.0, 1.0)
        ]

    for anchor, (x, _) in zip(anchors, corners(), strict=True):
        anchor.value = x
    started, found, t = time.process_time(), [], 0.0
    per = round(WINDOW_S / h)
    for _ in window_ends():
        mean = np.zeros(2)
        for _ in range(per):
            t += h
            place = path.pose(t).position_m
            held.x.array.reshape(-1, 3)[:] = place[0], place[2], LEAN
            u.x.array[:] = u0.x.array + h * v0.x.array + 0.5 * h * h * b0.x.array
            newton.solve(u)
            seen = tuple(each.x.array for each in (u, u0, v0, a0, b0))
            rates = _rates(seen, h, constants)
            for function, values in zip((v0, a0, b0), rates, strict=True):
                function.x.array[:] = values
            mean -= fem.assemble_vector(reaction).array.reshape(-1, 3)[first, :2] / per
            u0.x.array[:] = u.x.array
            for anchor, (x, z) in zip(anchors, corners(), strict=True):
                reach = mu * kn * max(0.0, -z) / kt
                anchor.value = x - min(max(x - float(anchor.value), -reach), reach)
        found.append(mean)
    return Run(np.array(found), time.process_time() - started)


def _rates(seen: tuple, h: float, constants: tuple) -> tuple:
    """Velocity, acceleration and its average at the end of a step, of fields or of numbers."""
    new, old, v, a, b = seen
    am, af, beta, gamma = constants
    later = ((new - old) / h**2 - v / h - (0.5 - beta) * b) / beta
    speed = v + h * ((1.0 - gamma) * b + gamma * later)
    return speed, ((1.0 - am) * later + am * b - af * a) / (1.0 - af), later


def elastica(elements: int, *, inertia: float = 1.0) -> Run:
    """By PyElastica, with the rotary inertia raised by a factor, which allows longer steps."""
    import elastica as ea

    inputs = inputs_of(elements)
    section, path, ground = RodSection.of(inputs.bristle()), inputs.hub_motion, inputs.ground
    length, half = inputs.bristle().length_m, section.half_thin_m
    size = length / elements
    fastest = max(
        2.0 * math.sqrt(section.EA_N / section.rhoA_kg_m) / size,
        2.0 * math.sqrt(section.GA1_N / (section.rhoA_kg_m * size**2)),
        math.sqrt(section.GA1_N / (inertia * section.rhoI2_kg_m))
        + 2.0 * math.sqrt(section.EI2_Nm2 / (inertia * section.rhoI2_kg_m)) / size,
    )
    per = math.ceil(WINDOW_S / (0.7 * 2.0 / fastest))
    dt = WINDOW_S / per
    clamp = inputs.clamps.rotation[0]
    body = ea.CosseratRod.straight_rod(
        elements,
        path.pose(0.0).position_m,
        clamp[:, 2].copy(),
        clamp[:, 0].copy(),
        length,
        math.sqrt(section.rhoA_kg_m / inputs.density_kg_m3 / math.pi),
        inputs.density_kg_m3,
        youngs_modulus=inputs.youngs_Pa,
        shear_modulus=inputs.youngs_Pa / (2.0 * (1.0 + inputs.poisson)),
    )
    rotary = (
        inertia
        * size
        * np.array(
            [section.rhoI1_kg_m, section.rhoI2_kg_m, section.rhoI1_kg_m + section.rhoI2_kg_m]
        )
    )
    for i in range(3):
        body.shear_matrix[i, i] = (section.GA1_N, section.GA2_N, section.EA_N)[i]
        body.bend_matrix[i, i] = (section.EI1_Nm2, section.EI2_Nm2, section.GJ_Nm2)[i]
        body.mass_second_moment_of_inertia[i, i] = rotary[i]
        body.inv_mass_second_moment_of_inertia[i, i] = 1.0 / rotary[i]
    directors = body.director_collection[..., 0].copy()
    breaks, coefficients = path.breaks, path.coefficients
    kn, kt = 0.25 * ground.kn_N_m, 0.25 * ground.kt_over_kn * ground.kn_N_m
    mu, anchors = inputs.friction, np.full((2, 1), np.nan)

    class Clamp(ea.ConstraintBase):
        def constrain_values(self, system, time) -> None:
            place, _ = _hub(breaks, coefficients, float(time))
            system.position_collection[:, 0] = place
            system.director_collection[..., 0] = directors

        def constrain_rates(self, system, time) -> None:
            _, speed = _hub(breaks, coefficients, float(time))
            system.velocity_collection[:, 0] = speed
            system.omega_collection[:, 0] = 0.0

    class Plane(ea.NoForces):
        def apply_forces(self, system, time=0.0) -> None:
            _touch(
                system.position_collection,
                system.director_collection,
                system.external_forces,
                system.external_torques,
                anchors,
                (half, 2.0 * kn, 2.0 * kt, mu),
            )

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        pass

    simulator = Simulator()
    simulator.append(body)
    simulator.constrain(body).using(
        Clamp, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    simulator.add_forcing_to(body).using(Plane)
    simulator.dampen(body).using(
        ea.AnalyticalLinearDamper, uniform_damping_constant=inputs.alpha_1_s, time_step=dt
    )
    simulator.finalize()
    stepper = ea.PositionVerlet()
    t = stepper.step(simulator, np.float64(0.0), np.float64(dt))  # compiles
    started, found = time.process_time(), []
    share = 0.5 * section.rhoA_kg_m * size
    for i in range(len(window_ends())):
        mean = np.zeros(3)
        count = per - (i == 0)
        for _ in range(count):
            t = stepper.step(simulator, t, np.float64(dt))
            mean += body.internal_forces[:, 0] / count
        begin, end = (_hub(breaks, coefficients, x)[1] for x in (float(t) - WINDOW_S, float(t)))
        pull = mean - share * ((end - begin) / WINDOW_S + ALPHA_1_S * 0.5 * (begin + end))
        found.append(pull[[0, 2]])
    return Run(np.array(found), time.process_time() - started)


def _hub(breaks: np.ndarray, coefficients: np.ndarray, t: float) -> tuple:
    out = np.empty((2, 6))
    hub_coordinates(breaks, coefficients, t, out)
    return out[0, :3], out[1, :3]


@njit
def _touch(position, director, force, torque, anchors, numbers) -> None:
    half, kn, kt, mu = numbers
    n = position.shape[1] - 1
    side = director[0, :, n - 1]
    total = np.zeros(3)
    moment = np.zeros(3)
    for k in range(2):
        sign = 2.0 * k - 1.0
        arm = sign * half * side
        x, z = position[0, n] + arm[0], position[2, n] + arm[2]
        if z >= 0.0:
            anchors[k, 0] = np.nan
            continue
        normal = -kn * z
        if np.isnan(anchors[k, 0]):
            anchors[k, 0] = x
        reach = mu * normal / kt
        anchors[k, 0] = x - min(max(x - anchors[k, 0], -reach), reach)
        push = np.array([-kt * (x - anchors[k, 0]), 0.0, normal])
        total += push
        moment += np.cross(arm, push)
    force[:, n] += total
    torque[:, n - 1] += director[:, :, n - 1] @ moment


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elastica", default="", help="a folder that holds PyElastica")
    parser.add_argument("--only", default="rod,beam,elastica")
    given = parser.parse_args(arguments)
    if given.elastica:
        sys.path.insert(0, given.elastica)
    rod(20)  # compiles
    exact = rod(80, 1e-8)
    print(f"fine rod: mean force {exact.force_N[-1]} N, {exact.cpu_s:.2f} s", flush=True)
    runs: list[tuple[str, Callable[[], Run]]] = []
    if "rod" in given.only:
        runs += [
            (f"rod, {n} elements, tolerance {e:g}", partial(rod, n, e))
            for n, e in ((20, 1e-6), (20, 1e-7), (20, 1e-8))
        ]
    if "beam" in given.only:
        runs += [
            (f"dolfinx, {n} elements, {1e6 * h:g} us", partial(beam, n, h))
            for n, h in ((10, 1e-3), (10, 5e-4), (10, 2e-4))
        ]
    if "elastica" in given.only:
        if importlib.util.find_spec("elastica") is None:
            print("PyElastica is not installed: left out")
        else:
            runs += [
                (f"PyElastica, {n} elements, inertia x {f:g}", partial(elastica, n, inertia=f))
                for n, f in ((20, 100.0), (40, 100.0))
            ]
    for name, run in runs:
        found = run()
        print(f"{name}: error {found.error(exact):.2e}, CPU {found.cpu_s:.2f} s", flush=True)


if __name__ == "__main__":
    main()
