"""A bristle as a 3-D solid, clamped in a moving hub, over a plane: the reference for a rod.

`solver.rods` is verified against it. Strain and rotation are finite (St. Venant and Kirchhoff,
solver.forms). Hub, plane, friction and contact law are the rod's own. So is the time scheme:
generalised-alpha with equilibrium at the end of every step (see `rods.step`), which on
displacements is Chung and Hulbert's with its constants shifted.

Only the contact points differ. A rod's section touches with its four corners, each with a quarter
of Kn. Here the nodes on the two wide edges of the end face touch, and each edge has half of Kn
distributed over its nodes as over a line. An edge that lies flat on the plane is as stiff as the
rod's two corners. Sides do not touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from ..meshes.distribute import to_dolfinx
from ..meshes.geometry import MeshSpec, Tag
from ..meshes.section import Rectangle
from .arrays import Array
from .bodies.linear import take_direct
from .bristle import Bristle
from .errors import ComputationError, InputError
from .form_cache import form
from .forms import Elasticity, cells_of, own_values
from .rods.chain import System, new_system
from .rods.contact import (
    SLIDES,
    SectionPose,
    Touch,
    TouchStep,
    no_touch,
    obstacle_of,
    touch_section,
)
from .rods.ground import Ground
from .rods.hub import Clamps, HubPath
from .rods.section import RodSection
from .time.finite import assemble
from .time.scheme import TimeScheme

# Tolerance of the residual as a share of EI / L², as for the rod.
NEAR = 1e-7
ITERATIONS = 40
# Newton's matrix takes most of a step's time. It is updated only when a point touches, lets go,
# sticks or slides, or after this many iterations. Static equilibrium is far from its guess, so
# there every iteration updates it.
PATIENT = 4
# Elongation of a tangential spring that slides, however the point moves.
SLIDING_M = 1.0
# Cells across the thin side, across the wide side, and along the axis.
CELLS = 1, 1, 60


@dataclass(frozen=True)
class ClampedState:
    """Output of the solid at one instant: ``force_N`` and ``torque_Nm`` (3,) on the hub (the torque
    about its origin), the middle of the end section ``tip_m`` (3,), and ``normal_N``."""

    t_s: float
    force_N: Array
    torque_Nm: Array
    tip_m: Array
    normal_N: float


class RodState(NamedTuple):
    """State of a rod from its clamp to its tip, in equal elements: centre line ``x`` (n, 3),
    quaternions ``q`` (n, 4), ``velocity``, ``acceleration`` and ``auxiliary`` (n, 6) as in
    `rods.motion.Motion`, and the state (k,) and the springs (k, 3) in m of its tip's points."""

    x: Array
    q: Array
    velocity: Array
    acceleration: Array
    auxiliary: Array
    state: Array
    elongation: Array

    @classmethod
    def of(cls, checkpoint: dict[str, Array], i: int = 0) -> RodState:
        """One rod of a `Rods.checkpoint`."""
        names = ("x", "q", "velocity", "acceleration", "auxiliary")
        tip = (checkpoint[name][i, -1] for name in ("state", "elongation"))
        return cls(*(checkpoint[name][i] for name in names), *tip)


class ClampedSolid:
    """A straight bristle of hexahedra of degree ``order``, clamped at its top face.

    Parameters
    ----------
    bristle : of a rectangular section
    clamps : of this one bristle
    motion : the hub's
    ground : the plane, or None
    t_s : the start time; the bristle is then unstrained and moves with the hub
    gravity_m_s2 : downward
    comm : ranks that share the mesh

    Raises
    ------
    InputError : the section is not a rectangle, or there is more than one clamp
    """

    # state of the contact points now, and after the step in progress
    _touch: Touch
    _after: Touch

    def __init__(
        self,
        bristle: Bristle,
        clamps: Clamps,
        motion: HubPath,
        ground: Ground | None,
        cells: tuple[int, int, int] = CELLS,
        *,
        order: int = 2,
        t_s: float = 0.0,
        gravity_m_s2: float = 0.0,
        rho_infinity: float = 0.6,
        comm: MPI.Intracomm = MPI.COMM_WORLD,
    ) -> None:
        if not isinstance(bristle.section, Rectangle):
            raise InputError("the clamped solid is of a rectangular section")
        if len(clamps) != 1:
            raise InputError(f"the clamped solid is one bristle, not {len(clamps)}")
        self.motion, self.comm, self.t_s = motion, comm, t_s
        self.bristle = replace(bristle, length_m=float(clamps.length_m[0]))
        self._clamp = clamps.position_m[0], clamps.rotation[0]
        self._scheme = TimeScheme.generalised(rho_infinity)
        domain, _, facets = to_dolfinx(
            MeshSpec(self.bristle.length_m, bristle.section, cells), comm
        )
        root, axes = self._clamped_pose(t_s)
        length = self.bristle.length_m
        # the mesh stands on its tip; the rod's axis points from the clamp to the tip
        turned = domain.geometry.x * (1.0, -1.0, -1.0) + (0.0, 0.0, length)
        domain.geometry.x[:] = root + turned @ axes.T
        self.space = fem.functionspace(domain, ("Lagrange", order, (3,)))
        self._own = self.space.dofmap.index_map.size_local
        self._places = self.space.tabulate_dof_coordinates()[: self._own]
        self._local = (self._places - root) @ axes
        held = fem.locate_dofs_topological(self.space, 2, facets.find(int(Tag.TOP)))
        self._held = held[held < self._own]
        self._fixed = fem.Function(self.space)
        self._bc = fem.dirichletbc(self._fixed, held)
        self._make_forms(facets, gravity_m_s2)
        self._make_contact(ground, cells[1] * order)
        self._factored: tuple[float, bytes] | None = None
        self._x, self._out, self._spare = (fem_petsc.create_vector(self._form) for _ in range(3))
        self._matrix = fem_petsc.create_matrix(self._tangent)
        self._newton = self._make_newton()
        self._begin()

    # --- what it shows ----------------------------------------------------------------------------

    def state(self) -> ClampedState:
        """The present output; collective."""
        push = -self._balance[self._held]
        origin = self.motion.pose(self.t_s).position_m
        torque = np.cross(self._now()[self._held] - origin, push).sum(axis=0)
        own = np.concatenate(
            [push.sum(axis=0), torque, self._corners().sum(axis=0), [self._touch.normal.sum()]]
        )
        total = self.comm.allreduce(own)
        return ClampedState(self.t_s, total[:3], total[3:6], total[6:9] / 4.0, float(total[9]))

    def matrices(self) -> tuple[PETSc.Mat, PETSc.Mat]:
        """Stiffness and mass of small vibrations about the present state, without contact.

        A clamped row has 1 on the diagonal of the stiffness and 0 on that of the mass. The caller
        destroys them. Collective.
        """
        self._set_numbers(0.0)
        made = []
        for which, diagonal in ((self._tangent, 1.0), (self._mass, 0.0)):
            made.append(fem_petsc.assemble_matrix(which, [self._bc], diagonal))
            made[-1].assemble()
        return made[0], made[1]

    # --- where it begins --------------------------------------------------------------------------

    def settle(self, rod: RodState, end_force_N: Array | None = None) -> None:
        """Start in the state of a ``rod``: with its velocities, in equilibrium with its inertia.

        Unlike a solid, the rod has no strain across its section. So its displacements only serve as
        a guess, and equilibrium is solved for. A point of the tip slides in the direction in which
        the rod's does, or sticks by its spring. ``end_force_N`` (3,) is a dead force on the end
        face. Collective; raises ComputationError if there is no equilibrium.
        """
        centre, turned = _along(rod, self._local[:, 2], self.bristle.length_m)
        across = self._local * (1.0, 1.0, 0.0)
        arms = turned.apply(across)
        place, rates = centre(rod.x) + arms, []
        for six in (rod.velocity, rod.acceleration, rod.auxiliary):
            spin = turned.apply(centre(six[:, 3:]))
            rates.append(centre(six[:, :3]) + np.cross(spin, arms))
        turning = turned.apply(centre(rod.velocity[:, 3:]))
        centripetal = np.cross(turning, np.cross(turning, arms))
        self._v, self._a, self._auxiliary = rates[0], rates[1] + centripetal, rates[2] + centripetal
        own_values(self._rest, (self._a + self._alpha.value * self._v).ravel())
        if end_force_N is not None:
            self._end_load.value = np.asarray(end_force_N) / self.bristle.section.area_m2
        self._hold_springs(rod)
        self._u[:] = place - self._places
        own_values(self._start, self._u.ravel())
        self._solve(0.0, np.zeros_like(self._u), self._now())

    def _begin(self) -> None:
        pose = self.motion.pose(self.t_s)
        self._u = np.zeros_like(self._places)
        arms = self._places - pose.position_m
        self._v = pose.velocity_m_s + np.cross(pose.angular_velocity_rad_s, arms)
        self._a, self._auxiliary = np.zeros_like(self._u), np.zeros_like(self._u)
        self._balance = np.zeros_like(self._u)

    def _hold_springs(self, rod: RodState) -> None:
        """Set springs to the mean of the rod's points, or to long ones if these slide."""
        touching = rod.state > 0
        if not touching.any():
            return
        spring = rod.elongation[touching].mean(axis=0)
        slides = bool(np.any(rod.state == SLIDES))
        if slides:
            spring = SLIDING_M / np.linalg.norm(spring) * spring
        self._touch.elongation[:, 0] = spring
        self._touch.state[:] = rod.state[touching].max()
        self._touch.speed[:] = np.linalg.norm(rod.velocity[-1, :3]) if slides else 0.0

    # --- the march --------------------------------------------------------------------------------

    def step(self, h_s: float) -> None:
        """Advance by one step; collective. ComputationError if Newton's method fails."""
        self.t_s += h_s
        velocity, acceleration, _ = self._rates(np.zeros_like(self._u), h_s)
        own_values(self._rest, (acceleration + self._alpha.value * velocity).ravel())
        own_values(self._start, self._u.ravel())
        guess = h_s * self._v + 0.5 * h_s * h_s * self._auxiliary
        d = self._solve(h_s, guess, self._now())
        self._v, self._a, self._auxiliary = self._rates(d, h_s)

    def _rates(self, d: Array, h: float) -> tuple[Array, Array, Array]:
        """Velocity, acceleration and auxiliary after a step with increment ``d``."""
        s = self._scheme
        new = (d / (h * h) - self._v / h - (0.5 - s.beta) * self._auxiliary) / s.beta
        velocity = self._v + h * ((1.0 - s.gamma) * self._auxiliary + s.gamma * new)
        mean = (1.0 - s.alpha_m) * new + s.alpha_m * self._auxiliary
        return velocity, (mean - s.alpha_f * self._a) / (1.0 - s.alpha_f), new

    def _solve(self, h: float, guess: Array, before: Array) -> Array:
        """Increment of a step of length ``h`` (zero: to equilibrium); updates the state."""
        self._set_numbers(h)
        self._before_m = before[self._rim]
        d = guess.copy()
        d[self._held] = self._clamped()[self._held] - self._now()[self._held]
        self._x.array[:] = d.ravel()
        self._newton.solve(None, self._x)
        if self._newton.getConvergedReason() <= 0:
            raise ComputationError(
                f"the clamped solid does not converge at {self.t_s:.6g} s (SNES ends with reason "
                f"{self._newton.getConvergedReason()}); take shorter steps"
            )
        d = self._x.array.reshape(-1, 3).copy()
        self._residual(self._newton, self._x, self._spare)  # sets the solution's contact
        self._u = self._u + d
        self._touch, self._after = self._after, self._touch
        return d

    # --- Newton -----------------------------------------------------------------------------------

    def _residual(self, _: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        own_values(self._d, x.getArray(readonly=True))
        assemble(out, self._form)
        balance = out.array.reshape(-1, 3)
        self._press(x.getArray(readonly=True).reshape(-1, 3))
        balance[self._rim] += self._system.residual[:, :3]
        self._balance = balance.copy()
        balance[self._held] = 0.0

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, jacobian: PETSc.Mat, __: PETSc.Mat) -> None:
        self._press(x.getArray(readonly=True).reshape(-1, 3))
        touch = self._h, self._after.state.tobytes()
        old = touch != self._factored or snes.getIterationNumber() > (PATIENT if self._h else 0)
        old = self.comm.allreduce(old, MPI.LOR)
        snes.getKSP().getPC().setReusePreconditioner(not old)
        if not old:
            return
        self._factored = touch
        own_values(self._d, x.getArray(readonly=True))
        jacobian.zeroEntries()
        fem_petsc.assemble_matrix_mat(jacobian, self._tangent, [self._bc])
        jacobian.assemble(PETSc.Mat.AssemblyType.FLUSH)
        for node, block in zip(self._rim, self._system.diagonal[:, :3, :3], strict=True):
            at = np.array([node], dtype=np.int32)
            jacobian.setValuesBlockedLocal(at, at, block, addv=PETSc.InsertMode.ADD)
        jacobian.assemble()

    def _press(self, d: Array) -> None:
        """Contact forces on the nodes that can touch, with their tangent."""
        system, axes = self._system, np.eye(3)
        system.residual[:], system.diagonal[:] = 0.0, 0.0
        step = TouchStep(self._touch, self._after, self._h, False)
        for k, node in enumerate(self._rim):
            now = SectionPose(self._places[node] + self._u[node] + d[node], axes)
            was = SectionPose(self._before_m[k], axes)
            touch_section(self._surfaces[k], k, now, was, step, system)

    def _now(self) -> Array:
        """Present positions of the nodes (n, 3)."""
        return self._places + self._u

    def _corners(self) -> Array:
        """Present positions of the end section's corners that this rank owns."""
        return self._now()[self._at_corners]

    def _clamped_pose(self, t_s: float) -> tuple[Array, Array]:
        """Position (3,) and axes (3, 3) of the clamp at a time."""
        pose, (place, rotation) = self.motion.pose(t_s), self._clamp
        return pose.position_m + pose.rotation @ place, pose.rotation @ rotation

    def _clamped(self) -> Array:
        """Positions that the nodes would have now if the clamp held all of them."""
        root, axes = self._clamped_pose(self.t_s)
        return root + self._local @ axes.T

    def _set_numbers(self, h: float) -> None:
        """Set the forms' coefficients to a step of ``h``; zero means statics."""
        s, self._h = self._scheme, h
        weight = (1.0 - s.alpha_m) / ((1.0 - s.alpha_f) * s.beta * h * h) if h else 0.0
        drag = self._alpha.value * s.gamma / (s.beta * h) if h else 0.0
        self._weight.value = weight + drag
        self._rate.value = self.bristle.material.beta_s / h if h else 0.0

    # --- setup ------------------------------------------------------------------------------------

    def _make_forms(self, facets: mesh.MeshTags, gravity_m_s2: float) -> None:
        material, domain, real = self.bristle.material, self.space.mesh, PETSc.ScalarType
        body, dx = Elasticity.of(material, domain, finite=True), cells_of(self.space)
        self._start, self._d, self._rest = (fem.Function(self.space) for _ in range(3))
        self._weight, self._rate, self._alpha, density = (
            fem.Constant(domain, real(x))
            for x in (0.0, 0.0, material.alpha_1_s, material.density_kg_m3)
        )
        pull = fem.Constant(domain, np.array([0.0, 0.0, -gravity_m_s2], dtype=real))
        self._end_load = fem.Constant(domain, np.zeros(3, dtype=real))
        test, trial = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
        end = self._start + self._d
        change = body.strain_change(self._start + self._d / 2, self._d)
        stress = body.stress(body.strain(self._start) + (1.0 + self._rate) * change)
        balance = ufl.inner(body.deformation(end) * stress, ufl.grad(test)) * dx
        inertia = self._weight * self._d + self._rest - pull
        balance += density * ufl.inner(inertia, test) * dx
        tip = ufl.Measure("ds", domain=domain, subdomain_data=facets)(int(Tag.TIP))
        balance -= ufl.inner(self._end_load, test) * tip
        self._form = form(balance)
        self._tangent = form(ufl.derivative(balance, self._d, trial))
        self._mass = form(density * ufl.inner(trial, test) * dx)

    def _make_contact(self, ground: Ground | None, parts: int) -> None:
        """Make contact nodes and springs on the end face's wide edges, ``parts`` intervals each."""
        section = RodSection.of(self.bristle)
        x, y, s = self._local.T
        near = 1e-6 * section.half_thin_m
        edge = (np.abs(s - self.bristle.length_m) < near) & (
            np.abs(np.abs(x) - section.half_thin_m) < near
        )
        corner = edge & (np.abs(np.abs(y) - section.half_wide_m) < near)
        self._at_corners = np.flatnonzero(corner)
        self._rim = np.flatnonzero(edge) if ground is not None else np.array([], dtype=int)
        whole = obstacle_of(ground, section)
        at = np.round(parts * (0.5 + 0.5 * y[self._rim] / section.half_wide_m)).astype(int)
        shares = 0.5 * _shares(parts)[at] * len(whole.rim)
        self._surfaces = [
            whole._replace(
                rim=np.zeros((1, 2)), reach=0.0, kn=share * whole.kn, kt=share * whole.kt
            )
            for share in shares
        ]
        self._touch, self._after = (no_touch(len(self._rim), 1) for _ in range(2))
        self._system: System = new_system(len(self._rim))
        self._before_m = np.zeros((len(self._rim), 3))
        self._h = 0.0

    def _make_newton(self) -> PETSc.SNES:
        section = RodSection.of(self.bristle)
        bending = min(section.EI1_Nm2, section.EI2_Nm2) / self.bristle.length_m**2
        snes = PETSc.SNES().create(self.comm)
        snes.setFunction(self._residual, self._out)
        snes.setJacobian(self._jacobian, self._matrix)
        snes.setTolerances(rtol=0.0, atol=NEAR * bending, stol=0.0, max_it=ITERATIONS)
        take_direct(snes.getKSP(), PETSc.PC.Type.LU)
        return snes

    def close(self) -> None:
        """Free what PETSc holds."""
        for thing in (self._newton, self._matrix, self._x, self._out, self._spare):
            thing.destroy()


def _shares(parts: int) -> Array:
    """Weights of ``parts`` + 1 equally spaced points for integration over a unit length: Simpson's
    rule, or the trapezoidal one for an odd number of parts."""
    weights = np.full(parts + 1, 2.0)
    if parts % 2:
        weights[[0, -1]] = 1.0
        return weights / (2.0 * parts)
    weights[1::2] = 4.0
    weights[[0, -1]] = 1.0
    return weights / (3.0 * parts)


def _along(rod: RodState, s: Array, length_m: float) -> tuple[Callable[[Array], Array], Rotation]:
    """A spline interpolator of values at the rod's nodes, evaluated at positions ``s`` (n,) in m
    along it, and the axes there."""
    nodes = np.linspace(0.0, length_m, len(rod.x))
    s = np.clip(s, 0.0, length_m)
    turned = RotationSpline(nodes, Rotation.from_quat(rod.q[:, [1, 2, 3, 0]]))(s)
    return lambda values: CubicSpline(nodes, values)(s), turned
