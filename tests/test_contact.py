"""Do the contact laws and their enforcement push back as they should, tangent included?"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import rod

from bristle.solver.contact.enforcement import (
    ContactMethod,
    Enforcement,
    StepContact,
    inverse_constant_N_m,
)
from bristle.solver.contact.laws import Linear
from bristle.solver.errors import ComputationError

pytestmark = pytest.mark.serial
LAWS = [Linear(2e6), Linear(1e4), Linear(1e8)]
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


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_compliance_in_series_is_taken_off_the_penetration(law):
    drive, series = np.array([2e-5]), 3e-7
    force = law.force(drive, series)
    assert law.force(drive - series * force, 0.0) == pytest.approx(force, rel=1e-12)


def a_step(enforcement, law, response, end_weight=None, series=0.0, **kwargs):
    return StepContact(
        method=ContactMethod(law, enforcement, **kwargs),
        series_m_N=series,
        response=response,
        end_weight=end_weight,
        multiplier=np.zeros(len(response)),
    )


def some_response(n, size, rng):
    """A body's answer to forces: negative definite, as every body's is."""
    root = rng.normal(size=(n, n))
    return -size * (root @ root.T + 0.1 * np.eye(n))


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
@given(seed=st.integers(0, 10_000), start=reals, free=reals)
@settings(max_examples=60, deadline=None)
def test_step_force_is_the_discrete_gradient_of_the_potential(enforcement, seed, start, free):
    """Force times the change of drive is the change of the stored energy, point by point."""
    rng = np.random.default_rng(seed)
    law, n = Linear(2e6), 4
    drive0 = start + 1e-5 * rng.normal(size=n)
    drive_free = free + 1e-5 * rng.normal(size=n)
    step = a_step(enforcement, law, some_response(n, 1e-8, rng))
    force = step.solve(drive0, drive_free)
    drive1 = drive_free + step.response @ force
    stored = law.potential(drive1, 0.0) - law.potential(drive0, 0.0)
    size = np.abs(law.force(np.array([2e-4]), 0.0)).max() * 1e-4
    assert force * (drive1 - drive0) == pytest.approx(stored, abs=1e-9 * size)
    assert (force >= -1e-6).all()


@given(seed=st.integers(0, 10_000), free=reals)
@settings(max_examples=60, deadline=None)
def test_augmented_lagrangian_on_a_rigid_plane_obeys_signorini(seed, free):
    rng = np.random.default_rng(seed)
    n = 4
    drive_free = free + 1e-5 * rng.normal(size=n)
    step = a_step(Enforcement.AUGMENTED, Linear(math.inf), some_response(n, 1e-8, rng))
    force = step.solve(np.zeros(n), drive_free)
    gap = -(drive_free + step.response @ force)
    size = np.abs(drive_free).max()
    assert (force >= 0.0).all()
    assert (gap >= -1e-9 * size).all()
    assert np.abs(force * gap).max() <= 1e-8 * size * max(np.abs(force).max(), 1.0)


@pytest.mark.parametrize("end_weight", [1.0, 0.6, None])
def test_augmented_lagrangian_converges_to_penalty_at_the_same_stiffness(end_weight, rng):
    response = some_response(3, 1e-8, rng)
    start, free = np.array([1e-6, -1e-6, 2e-6]), np.array([2e-5, 1e-5, -3e-5])
    forces = [
        a_step(enforcement, Linear(5e6), response, end_weight).solve(start, free)
        for enforcement in (Enforcement.PENALTY, Enforcement.AUGMENTED)
    ]
    assert forces[1] == pytest.approx(forces[0], rel=1e-8, abs=1e-6)


def test_nothing_touches_nothing_pushes():
    step = a_step(Enforcement.PENALTY, Linear(2e6), -1e-8 * np.eye(2))
    assert not step.solve(np.array([-1e-3, -1e-3]), np.array([-1e-9, -1e-3])).any()


def test_nonconvergence_names_the_iteration_and_what_to_try():
    """A response that grows with the force can have no equilibrium."""
    step = a_step(Enforcement.PENALTY, Linear(2e6), np.array([[2e-6]]), end_weight=1.0)
    with pytest.raises(ComputationError, match="did not converge.*shorten the ITS"):
        step.solve(np.array([0.0]), np.array([1e-5]))


@pytest.mark.parametrize("degree", [1, 2])
def test_inverse_constant_of_a_rod_is_known_and_sharp(degree):
    """p̂² ≤ C uᵀ K u with C = degree² E A / h, reached by the last element alone."""
    body = rod(8, length=2.0, youngs=3.0, degree=degree)
    assert inverse_constant_N_m(body) == pytest.approx(degree**2 * 3.0 / 0.25, rel=1e-3)
    for theta_tau, positive in ((0.99, True), (1.02, False)):
        term = theta_tau / inverse_constant_N_m(body) * body.contact.pressure.T
        stiffness = np.diag(body.omega2) - term @ body.contact.pressure
        assert (np.linalg.eigvalsh(stiffness).min() > -1e-6 * body.omega2.max()) == positive


def test_only_nitsche_has_a_compliance():
    body = rod(8)
    assert ContactMethod(Linear(1.0)).compliance_m_N(body) == 0.0
    nitsche = ContactMethod(Linear(1.0), Enforcement.NITSCHE, gamma0=2.0)
    assert nitsche.compliance_m_N(body) == pytest.approx(1.0 / 16.0, rel=1e-3)


@pytest.mark.parametrize(
    ("build", "word"),
    [
        (lambda: Linear(0.0), "Kn"),
        (lambda: Linear(float("nan")), "Kn"),
        (lambda: ContactMethod(Linear(math.inf)), "nitsche or augmented"),
        (lambda: ContactMethod(Linear(1.0), Enforcement.NITSCHE, theta=2), "theta"),
        (lambda: ContactMethod(Linear(1.0), Enforcement.NITSCHE, gamma0=0.5), "gamma0"),
    ],
)
def test_impossible_contact_is_refused(build, word):
    with pytest.raises(ValueError, match=word):
        build()
