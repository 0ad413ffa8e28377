"""Contact laws and their enforcement push back as they should, tangent included."""

import math

import numpy as np
import pytest
from contact_law_helpers import LAWS as EVERY_LAW
from contact_law_helpers import a_step, some_response
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import rod

from bristle.solver.contact.enforcement import ContactMethod, Enforcement, inverse_constant_N_m
from bristle.solver.contact.laws import (
    Adhesive,
    Damped,
    Linear,
    Plastic,
    Stiffening,
)
from bristle.solver.contact.normal import HELD
from bristle.solver.contact.points import Trial
from bristle.solver.contact.section import solve_section
from bristle.solver.errors import ComputationError

pytestmark = pytest.mark.serial
LAWS = [Linear(2e6), Linear(1e4), Linear(1e8)]
WITH_COMPLIANCE = [law for law in EVERY_LAW if not law.conserving_only]
reals = st.floats(-1e-4, 1e-4)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("series", [0.0, 1e-8, 1e-5])
def test_force_is_the_slope_of_the_potential_and_tangent_that_of_the_force(law, series):
    """Open, at the switch and closed, by central differences."""
    step = 1e-10
    drive = np.array([-1e-5, -1e-7, 1e-9, 1e-7, 1e-5, 3e-4])
    above, below = drive + step, drive - step
    slope = (law.potential(above, series) - law.potential(below, series)) / (2 * step)
    force = law.force(drive, series)
    assert slope == pytest.approx(force, rel=1e-4, abs=1e-9 * law.kn_N_m)
    tangent = (law.force(above, series) - law.force(below, series)) / (2 * step)
    assert tangent == pytest.approx(law.tangent(drive, series), rel=1e-6)
    zero = np.zeros(1)
    assert law.force(zero, series) == 0.0
    assert law.potential(zero, series) == 0.0


@pytest.mark.parametrize("law", [*LAWS, *WITH_COMPLIANCE], ids=str)
def test_compliance_in_series_is_taken_off_the_penetration(law):
    drive, series = np.array([2e-5]), 3e-7
    force = law.force(drive, series)
    assert law.force(drive - series * force, 0.0) == pytest.approx(force, rel=1e-12)


def some_drives(n, start, free, rng):
    drives = 1e-5 * rng.normal(size=(2, n, 3))
    drives[0, :, 0] += start
    drives[1, :, 0] += free
    return drives


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
@given(seed=st.integers(0, 10_000), start=reals, free=reals)
@settings(max_examples=60, deadline=None)
def test_step_force_is_the_discrete_gradient_of_the_potential(enforcement, seed, start, free):
    """Force times the change of drive is the change of the stored energy, point by point."""
    rng = np.random.default_rng(seed)
    law, n = Linear(2e6), 4
    drive0, drive_free = some_drives(n, start, free, rng)
    response = some_response(n, 1e-8, rng)
    step = a_step(enforcement, law, response)
    force = step.solve(drive0, drive_free)
    drive1 = drive_free + (response @ force.ravel()).reshape(n, 3)
    stored = law.potential(drive1[:, 0], 0.0) - law.potential(drive0[:, 0], 0.0)
    size = np.abs(law.force(np.array([2e-4]), 0.0)).max() * 1e-4
    assert force[:, 0] * (drive1 - drive0)[:, 0] == pytest.approx(stored, abs=1e-9 * size)
    assert (force[:, 0] >= -1e-6).all()
    assert not force[:, 1:].any()


def test_adhesion_that_newton_jumps_across_is_found():
    """Two points pulled at random, each by the other too: some let go, which Newton's method alone
    does not always decide."""
    law, reach, jumped = Adhesive(2e6, 5.0), 2.5e-6, 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        response = some_response(2, 1e-6, rng)
        start, free = np.zeros((2, 2, 3))
        start[:, 0] = -reach * rng.uniform(0.2, 0.99, 2)
        free[:, 0] = start[:, 0] - reach * rng.uniform(0.0, 8.0, 2)
        alone, step = (a_step(Enforcement.PENALTY, law, response) for _ in range(2))
        for each in (alone, step):
            each.memory[:, 2] = HELD
        trial = Trial(start, free, free.copy(), 0.0 * free, alone.memory, alone.multiplier)
        jumped += solve_section(alone.points, alone.section, trial) < 0
        force = step.solve(start, free)
        end = free + (response @ force.ravel()).reshape(2, 3)
        assert step.end == pytest.approx(end, abs=1e-9 * np.abs(free).max())
        # a spring of both signs while it holds; what lets go on the way has pulled so far alone
        before, after = start[:, 0], end[:, 0]
        holds = 0.5 * law.kn_N_m * (before + after)
        lets_go = 0.5 * law.kn_N_m * (before**2 - reach**2) / (before - after)
        wanted = np.where(np.isclose(force[:, 0], holds) & (after > -reach), holds, lets_go)
        assert force[:, 0] == pytest.approx(wanted, rel=1e-6)
    assert jumped > 0


@given(seed=st.integers(0, 10_000), free=reals, mu=st.sampled_from([0.0, 0.3, 1.0]))
@settings(max_examples=60, deadline=None)
def test_all_solvers_find_the_same_forces_and_drives(seed, free, mu):
    """Newton's method on a section that is rigid, and on one that is not."""
    rng = np.random.default_rng(seed)
    n = 5
    drive0, drive_free = some_drives(n, 1e-5, free, rng)
    response = some_response(n, 1e-8, rng)
    forces = []
    for whole in (False, True):
        step = a_step(Enforcement.PENALTY, Linear(2e6), response, mu=mu, whole=whole)
        forces.append(step.solve(drive0, drive_free))
        answer = (response @ forces[-1].ravel()).reshape(n, 3)
        if forces[-1].any():
            assert step.end == pytest.approx(drive_free + answer, rel=1e-8, abs=1e-15)
    assert forces[1] == pytest.approx(forces[0], rel=1e-8, abs=1e-8)


@given(seed=st.integers(0, 10_000), free=reals)
@settings(max_examples=60, deadline=None)
def test_augmented_lagrangian_on_a_rigid_plane_obeys_signorini_and_coulomb(seed, free):
    rng = np.random.default_rng(seed)
    n, mu = 4, 0.4
    _, drive_free = some_drives(n, 0.0, free, rng)
    response = some_response(n, 1e-8, rng)
    step = a_step(Enforcement.AUGMENTED, Linear(math.inf), response, mu=mu)
    force = step.solve(np.zeros((n, 3)), drive_free)
    end = drive_free + (response @ force.ravel()).reshape(n, 3)
    gap, slip = -end[:, 0], end[:, 1:]
    size, largest = np.abs(drive_free).max(), max(np.abs(force).max(), 1.0)
    normal, friction = force[:, 0], force[:, 1:]
    assert (normal >= 0.0).all()
    assert (gap >= -1e-7 * size).all()
    assert np.abs(normal * gap).max() <= 1e-7 * size * largest
    pull = np.linalg.norm(friction, axis=1)
    assert (pull <= mu * normal + 1e-7 * largest).all()
    sticking = pull < mu * normal - 1e-6 * largest
    assert np.abs(slip[sticking]).max(initial=0.0) <= 1e-6 * size
    # where it slides, friction pulls against the slip (the drive runs backwards)
    across = friction[:, 0] * slip[:, 1] - friction[:, 1] * slip[:, 0]
    assert np.abs(across).max() <= 1e-6 * size * largest
    assert (np.sum(friction * slip, axis=1) >= -1e-7 * size * largest).all()


@pytest.mark.parametrize("end_weight", [1.0, 0.6, None])
@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_augmented_lagrangian_converges_to_penalty_at_the_same_stiffness(end_weight, mu, rng):
    response = some_response(3, 1e-8, rng)
    start, free = some_drives(3, 1e-6, 1e-5, rng)
    forces = [
        a_step(enforcement, Linear(5e6), response, end_weight, mu).solve(start, free)
        for enforcement in (Enforcement.PENALTY, Enforcement.AUGMENTED)
    ]
    assert forces[1] == pytest.approx(forces[0], rel=1e-7, abs=1e-6)


def test_nothing_touches_nothing_pushes():
    step = a_step(Enforcement.PENALTY, Linear(2e6), -1e-8 * np.eye(6))
    above = np.array([[-1e-3, 0.0, 0.0], [-1e-9, 0.0, 0.0]])
    assert not step.solve(above, above).any()


@pytest.mark.parametrize("whole", [True, False])
def test_nonconvergence_names_the_iteration_and_what_to_try(whole):
    """A response that grows with the force can have no equilibrium."""
    step = a_step(Enforcement.PENALTY, Linear(2e6), 2e-6 * np.eye(3), end_weight=1.0, whole=whole)
    with pytest.raises(ComputationError, match="did not converge.*shorten the ITS"):
        step.solve(np.zeros((1, 3)), np.array([[1e-5, 0.0, 0.0]]))


@pytest.mark.parametrize("degree", [1, 2])
def test_inverse_constant_of_a_rod_is_known_and_sharp(degree):
    """p̂² ≤ C uᵀ K u with C = degree² E A / h, reached by the last element alone."""
    body = rod(8, length=2.0, youngs=3.0, degree=degree)
    assert inverse_constant_N_m(body) == pytest.approx(degree**2 * 3.0 / 0.25, rel=1e-3)
    for theta_tau, positive in ((0.99, True), (1.02, False)):
        term = theta_tau / inverse_constant_N_m(body) * body.contact.traction.T
        stiffness = np.diag(body.omega2) - term @ body.contact.traction
        assert (np.linalg.eigvalsh(stiffness).min() > -1e-6 * body.omega2.max()) == positive


def test_only_nitsche_has_a_compliance():
    body = rod(8)
    assert ContactMethod(Linear(1.0)).compliance_m_N(body) == 0.0
    nitsche = ContactMethod(Linear(1.0), Enforcement.NITSCHE, gamma0=2.0)
    assert nitsche.compliance_m_N(body) == pytest.approx(1.0 / 16.0, rel=1e-3)


def test_a_law_with_a_force_in_python_is_refused_by_name():
    """It would be computed as the law whose kind it inherits."""

    class Halved(Linear):
        def force(self, approach, *args, **kwargs):
            return 0.5 * super().force(approach, *args, **kwargs)

    with pytest.raises(TypeError, match=r"Halved\.force"):
        ContactMethod(Halved(2e6))
    for law in (Linear(1e6), Damped(1e6, 1.0), Stiffening(1e6), Plastic(1e6, 1.0)):
        assert ContactMethod(law).law is law
