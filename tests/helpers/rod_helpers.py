"""Rods for tests: one at a time, step by step, or clamped by their axis."""

import numpy as np
from scipy.spatial.transform import Rotation

from bristle.solver.compiled import nth, write
from bristle.solver.rods.chain import at_rest, stacked
from bristle.solver.rods.contact import Friction, obstacle_of
from bristle.solver.rods.element import strains
from bristle.solver.rods.ground import Contact
from bristle.solver.rods.hub import ORDER, Clamps, HubPath
from bristle.solver.rods.joint import Brush, Group, joint_step, room_for
from bristle.solver.rods.motion import ClampedRod, Hub, fit_to_step, motion_of, scheme_of
from bristle.solver.rods.pairs import between_of
from bristle.solver.rods.section import RodSection
from bristle.solver.rods.step import Law
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.brush.motion import stroke

THIN, HALF = 1e-4, 1e-8
SLENDER = RodSection(
    EA_N=1.0 / THIN**2,
    GA1_N=1.0 / THIN**2,
    GA2_N=1.0 / THIN**2,
    EI1_Nm2=1.0,
    EI2_Nm2=1.0,
    GJ_Nm2=1.0,
    rhoA_kg_m=1.0,
    rhoI1_kg_m=THIN**2,
    rhoI2_kg_m=THIN**2,
    half_thin_m=HALF,
    half_wide_m=HALF,
)
"""EI = ρA = 1, so slender that it is Euler's inextensible rod to 1e-8; in contact it is a line."""


def along(axis, wide=(0.0, 1.0, 0.0)):
    """The rotation (3, 3) of a clamp by its bristle's axis and wide side."""
    return np.stack([np.cross(wide, axis), wide, axis], axis=1)


def leaning(lean_rad):
    """A bristle that points down, its tip toward -x by an angle."""
    return along([-np.sin(lean_rad), 0.0, -np.cos(lean_rad)])


def quaternion(rotation):
    """Of a rotation of SciPy's, or of many, as the rods have it."""
    return np.ascontiguousarray(rotation.as_quat()[..., [3, 0, 1, 2]])


def whole_matrix(system):
    """A chain's block-tridiagonal matrix (n, 6, n, 6)."""
    n = len(system.diagonal)
    matrix = np.zeros((n, 6, n, 6))
    for i in range(n):
        matrix[i, :, i] = system.diagonal[i]
        if i > 0:
            matrix[i, :, i - 1], matrix[i - 1, :, i] = system.below[i], system.above[i - 1]
    return matrix


def above_ground(section, lean_rad, length_m, above_m=0.0):
    """A clamp from which a straight bristle that leans just touches the plane z = 0."""
    height = length_m * np.cos(lean_rad) + section.half_thin_m * np.sin(lean_rad) + above_m
    return one_clamp([0.0, 0.0, height], leaning(lean_rad), length_m)


def one_clamp(place, rotation, length_m):
    return Clamps(np.array([place], dtype=float), rotation[None], np.array([length_m]))


def press(depth_m, over_s):
    """A hub that comes down from the origin, at rest before and after; quintic in time."""
    return stroke(0.0, depth_m, over_s, 0.0, 0.0)


def slide(depth_m, speed_m_s, over_s, ramp_s, direction=(1.0, 0.0)):
    """Pressed down over ``over_s``, then along a horizontal ``direction`` at a constant speed,
    which it reaches in ``ramp_s``."""
    x, y = np.array(direction) / np.linalg.norm(direction)
    return _set_off(
        press(depth_m, over_s), np.array([speed_m_s * x, speed_m_s * y, 0, 0, 0, 0]), ramp_s
    )


def rotate(depth_m, rpm, over_s, ramp_s):
    """As `slide`, but turned about the vertical through the hub's origin."""
    rates = np.array([0, 0, 0, 0, 0, 2.0 * np.pi * rpm / 60.0])
    return _set_off(press(depth_m, over_s), rates, ramp_s)


def _set_off(path, rates, ramp_s):
    """Uniform motion from the last break but one on, its rates smoothly from zero."""
    start, here = path.breaks[-2], path.coefficients[-1, -1]
    ramp, steady = np.zeros((2, ORDER, 6))
    ramp[-5], ramp[-4], ramp[-1] = -0.5 * rates / ramp_s**3, rates / ramp_s**2, here
    steady[-2], steady[-1] = rates, here + 0.5 * rates * ramp_s
    coefficients = np.stack([path.coefficients[:, 0], ramp, steady], axis=1)
    return HubPath(np.array([0.0, start, start + ramp_s, start + ramp_s + 1.0]), coefficients)


class OneRod:
    """One rod, stepped by hand: ``now`` is its state, ``loads`` (n, 6) act on its nodes."""

    def __init__(self, chain, place, rotation, *, path=None, section=SLENDER, ground=None, rho=0.6):
        nodes = len(chain.mass)
        self.chain, self.surface = chain, obstacle_of(ground, section)
        path = path or HubPath.still()
        turned = quaternion(Rotation.from_matrix(rotation))
        place = np.array(place, dtype=float)
        loads = np.zeros((1, nodes, 6))
        self.rods = ClampedRod(stacked([chain]), loads, place[None], turned[None])
        self.hub, self.between = Hub(path.breaks, path.coefficients), between_of(Contact(), section)
        points = len(self.surface.rim)
        self.stack, self.room = motion_of(1, nodes, points), room_for(nodes, points, 1, 0)
        self.loads = loads[0]
        self.now, self.next = nth(self.stack, 0), nth(self.room.new, 0)
        self.now.x[:], self.now.q[:] = at_rest(chain, place, rotation)
        strains(chain, self.now.x, self.now.q, self.now.strain)
        # steps are the test's, and each is solved to far less than it errs
        self.scheme = scheme_of(TimeScheme.generalised(rho), 1e-9)

    def step(self, h, *, friction=True):
        """One step of ``h`` seconds, or False where Newton's method does not converge."""
        surface = self.surface
        if not friction:
            surface = surface._replace(friction=Friction(0.0, 0.0, 0.0))
        fit_to_step(self.now, h)
        brush = Brush(Law(self.scheme, self.hub, surface, self.between), self.rods, self.stack)
        if joint_step(brush, Group.apart(np.array([0])), h, self.room) < 0:
            return False
        write(self.next, self.now)
        return True

    def let_go(self, force_N):
        """Bent by a force on the tip along x, and free of it from now on."""
        self.loads[-1, 0] = force_N
        self.slowly(1.0, 1.0)
        self.loads[:] = 0.0
        self.scheme = self.scheme._replace(inertia=True)

    def slowly(self, until_s, h_s, **how):
        """Equilibria up to a time, with steps that are halved where they fail."""
        self.scheme = self.scheme._replace(inertia=False)
        h = h_s
        while self.now.totals[0] < until_s - 1e-12:
            h = min(1.5 * h, h_s, until_s - self.now.totals[0])
            while not self.step(h, **how):
                h *= 0.5
                assert h > 1e-6 * h_s


def equilibrium(chain, x, q, loads, *, steps=1):
    """Nodes (n, 3) and quaternions (n, 4) of a rod in equilibrium with dead loads (n, 6), which
    come on in so many equal steps, from a first shape on."""
    rod = OneRod(chain, x[0], Rotation.from_quat(q[0, [1, 2, 3, 0]]).as_matrix())
    rod.scheme = rod.scheme._replace(inertia=False)
    rod.now.x[:], rod.now.q[:] = x, q
    for step in range(1, steps + 1):
        rod.loads[:] = loads * (step / steps)
        assert rod.step(0.0)
    return rod.now.x, rod.now.q
