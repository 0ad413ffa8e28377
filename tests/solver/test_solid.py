"""The solid: modes against closed forms, contact rows, the same on any ranks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from reference import free_free_timoshenko_hz, pochhammer_chree_hz, rate
from scipy.optimize import brentq
from solids import frequencies_hz, reduced_for

from bristle.meshes.section import Circle, Rectangle
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.drop import RESOLVED, DropPlan, ModalFrame, simulate
from bristle.solver.time import march
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

WIRE = Circle(2e-3)


def nearest(found, wanted):
    return found[np.argmin(np.abs(found - wanted))]


def nearest_of(solid, wanted_hz):
    """The solid's natural frequency nearest to ``wanted_hz``."""
    found = frequencies_hz(solid.stiffness_matrix, solid.mass_matrix, wanted_hz)
    return nearest(found, wanted_hz)


@pytest.mark.parametrize("order", [1, 2])
def test_mass_rigid_motions_and_a_uniform_strain(make_solid, order):
    solid = make_solid((1, 2, 12), order=order)
    bristle = Bristle(0.02)
    assert solid.mass_kg == pytest.approx(bristle.mass_kg, rel=1e-12)
    motions = solid.rigid_motions()
    stiff = [solid.stiffness(motion) for motion in motions.T]
    some = solid.stiffness(np.sin(np.arange(solid.n_local, dtype=float)))
    scale = math.sqrt(solid.dot(some, some))
    for motion, force in zip(motions.T, stiff, strict=True):
        size = math.sqrt(solid.dot(motion, motion))
        assert math.sqrt(solid.dot(force, force)) < 1e-12 * scale * size
    # patch test: uniaxial stress, ε_zz = e, ε_xx = ε_yy = -ν e
    x = solid.space.tabulate_dof_coordinates()[: solid.n_local // 3]
    strain = 1e-3
    u = strain * x * np.array([-0.28, -0.28, 1.0])
    energy = 0.5 * solid.dot(u.ravel(), solid.stiffness(u.ravel()))
    volume = bristle.section.area_m2 * bristle.length_m
    assert energy == pytest.approx(0.5 * 207e9 * strain**2 * volume, rel=1e-10)
    tractions = solid.contact.tractions(u.ravel())
    pull = 207e9 * strain * bristle.section.area_m2
    wanted = np.tile([0.0, 0.0, -pull], (len(tractions), 1))
    assert tractions == pytest.approx(wanted, rel=1e-9, abs=1e-9 * pull)


@pytest.mark.parametrize("order", [1, 2])
def test_contact_points_cover_the_face(make_solid, order):
    solid = make_solid((2, 3, 8), order=order)
    points, section = solid.contact, Rectangle()
    # nine across at least, an odd number in each cell so that nodes are among them
    nodes = (2 * 4 + 1) * (3 * 4 + 1)
    assert points.xy_m.shape == (nodes, 2)
    assert points.weights.sum() == pytest.approx(1.0, rel=1e-13)
    assert np.abs(points.xy_m).max(axis=0) == pytest.approx(
        [0.5 * section.thickness_m, 0.5 * section.width_m], abs=1e-9
    )
    motions = solid.rigid_motions()
    for axis in range(3):
        moved = points.displacements(motions[:, axis])
        assert moved == pytest.approx(np.tile(np.eye(3)[axis], (nodes, 1)), abs=1e-12)
        turned = points.displacements(motions[:, 3 + axis])
        assert turned == pytest.approx(np.cross(np.eye(3)[axis], points.places_m), abs=1e-9)
    if order == 2:
        second = section.area_m2 * points.weights @ points.xy_m[:, 0] ** 2
        assert second == pytest.approx(section.second_moment_x_m4, rel=1e-6)


def test_axial_frequencies_of_a_round_bar_are_pochhammer_and_chrees(make_solid):
    """The ends of a real bar differ from a wave's cross-section by terms beyond (k a)²."""
    material = Material()
    length = 0.06
    solid = make_solid((2, 1, 48), length, section=WIRE, geometry_order=2)
    for n in (1, 3, 5):
        k = n * math.pi / length
        exact = pochhammer_chree_hz(k, 1e-3, 207e9, 0.28, 7800.0)
        bar = n * material.bar_speed_m_s / (2 * length)
        lateral = 1.0 - exact / bar
        assert lateral == pytest.approx(0.25 * (0.28 * k * 1e-3) ** 2, rel=0.05)
        found = nearest_of(solid, exact)
        assert found == pytest.approx(exact, rel=max(0.1 * lateral, 2e-5))


@pytest.mark.parametrize("family", ["axial", "bending x", "bending y", "torsion"])
def test_frequencies_agree_with_the_beam(make_solid, family):
    """A 30 mm length of the bristle; Timoshenko's theory itself is good to about 1e-3 here."""
    length = 0.03
    solid = make_solid((1, 3, 60), length)
    bristle = Bristle(length)
    beam = beam_body(bristle, 32)
    mat, sec = bristle.material, bristle.section
    polar = sec.second_moment_x_m4 + sec.second_moment_y_m4
    speed = math.sqrt(mat.shear_modulus_Pa * sec.torsion_m4 / (mat.density_kg_m3 * polar))
    slender = (4.730040744862704 / length) ** 2 / (2 * math.pi)
    near = {
        "axial": mat.bar_speed_m_s / (2 * length),
        "bending x": slender * math.sqrt(207e9 * sec.second_moment_x_m4 / (7800 * sec.area_m2)),
        "bending y": slender * math.sqrt(207e9 * sec.second_moment_y_m4 / (7800 * sec.area_m2)),
        "torsion": speed / (2 * length),
    }[family]
    beam_hz = nearest(np.sqrt(beam.omega2) / (2 * math.pi), near)
    found = nearest_of(solid, beam_hz)
    # St. Venant's torsion leaves out warping held back by inertia: of the order of the section
    # over the length, a few per cent here
    assert found == pytest.approx(beam_hz, rel=3e-2 if family == "torsion" else 2e-3)


# Cowper, J. Appl. Mech. 33 (1966), and Hutchinson, J. Appl. Mech. 68 (2001), whose coefficients
# match the frequencies of solids; for the rectangle twice as high as wide his series is summed.
STOUT = {
    "rectangle": (Rectangle(2e-3, 4e-3), (1, 3, 12), {0.0: (5 / 6, 5 / 6), 0.28: (0.8488, 0.8652)}),
    "circle": (Circle(3e-3), (2, 1, 10), {0.0: (6 / 7, 6 / 7), 0.28: (0.8848, 0.9210)}),
}


@pytest.mark.parametrize("poisson", [0.0, 0.28])
@pytest.mark.parametrize("shape", STOUT)
def test_shear_of_a_stout_bar_is_cowpers_in_the_beam_and_hutchinsons_in_the_solid(
    make_solid, shape, poisson
):
    """A bar 3.2 times as long as high bends by 5 to 7 % slower because of shear. Timoshenko's
    equation, solved for the shear coefficient that gives the frequency found."""
    section, cells, coefficients = STOUT[shape]
    cowper, hutchinson = coefficients[poisson]
    material = Material(poisson=poisson)
    length = 3.2 * getattr(section, "width_m", 3e-3)
    moment, area = section.second_moment_y_m4, section.area_m2
    bending, shear = 207e9 * moment, 207e9 / (2.0 + 2.0 * poisson) * area

    def timoshenko_hz(coefficient, near):
        inertia = 7800.0 * area, 7800.0 * moment
        return free_free_timoshenko_hz(length, bending, coefficient * shear, *inertia, near)

    def read_from(hz):
        return brentq(lambda each: timoshenko_hz(each, hz) / hz - 1.0, 0.7, 1.1, xtol=1e-7)

    root = 4.730040744862704 / length
    # Timoshenko's first correction of the slender beam, taken as the start of a geometric series
    slow = 1.0 + root**2 * moment / area * (1.0 + bending * area / (moment * shear * cowper))
    slender = root**2 * math.sqrt(bending / (7800.0 * area))
    wanted = timoshenko_hz(cowper, slender / (2.0 * math.pi * math.sqrt(slow)))
    assert timoshenko_hz(0.8 * cowper, wanted) < 0.99 * wanted
    beam = beam_body(Bristle(length, section, material), 32)
    found = nearest(np.sqrt(beam.omega2) / (2.0 * math.pi), wanted)
    assert read_from(found) == pytest.approx(cowper, rel=3e-4)
    order = 2 if shape == "circle" else 1
    solid = make_solid(cells, length, material=material, section=section, geometry_order=order)
    found = nearest_of(solid, wanted)
    assert read_from(found) == pytest.approx(hutchinson, rel=0.01)


@pytest.mark.parametrize(("order", "expected"), [(1, 2.0), (2, 4.0)])
def test_axial_frequency_converges_at_the_rate_of_the_elements(make_solid, order, expected):
    """Poisson's ratio zero makes the axial mode of a prism exact: n c / 2L."""
    material = Material(poisson=0.0)
    cells = (4, 8, 16)
    exact = material.bar_speed_m_s / (2 * 0.02)
    errors = []
    for n in cells:
        solid = make_solid((1, 1, n), 0.02, order, material)
        errors.append(abs(nearest_of(solid, exact) / exact - 1.0))
    assert rate([1 / n for n in cells], errors) == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize("method", list(Enforcement))
def test_full_order_and_reduced_bounce_alike(make_solid, method):
    solid = make_solid((1, 2, 24), 0.05)
    its = 1e-6
    reduced = reduced_for(solid, its, 24)
    plan = DropPlan(0.05, ContactMethod(Linear(2e6), method), its, 9.8)
    full = simulate(reduced, plan)
    small = simulate(ModalFrame(reduced.modal, reduced.coarser), plan)
    # Nitsche's forces act along the pressure's rows too, which the basis was not made from
    close = 1e-6 if method is Enforcement.NITSCHE else 1e-7
    assert small.rebound_ratio == pytest.approx(full.rebound_ratio, rel=close)
    assert small.peak_force_N == pytest.approx(full.peak_force_N, rel=1e-6)
    assert full.reduction_error is None
    speed_error = abs(small.cm_velocity_after_m_s - full.cm_velocity_after_m_s)
    assert speed_error / full.impact_speed_m_s <= 100.0 * small.reduction_error
    if method is not Enforcement.NITSCHE:
        assert full.energy.closure_relative < 1e-6
        assert small.energy.closure_relative < 1e-10


def test_error_that_is_stated_is_of_the_true_ones_size(make_solid):
    """Within a factor of a hundred of that to the full order, and small where the basis is rich."""
    solid = make_solid((1, 2, 24), 0.05)
    its = 1e-6
    plan = DropPlan(0.05, ContactMethod(Linear(2e7)), its, 9.8, impact_only=True)
    full = simulate(reduced_for(solid, its, 40), plan)
    stated = []
    for n in (2, 10, 20, 40):
        reduced = reduced_for(solid, its, n)
        found = simulate(ModalFrame(reduced.modal, reduced.coarser), plan)
        off = abs(found.cm_velocity_after_m_s - full.cm_velocity_after_m_s)
        off = max(off / full.impact_speed_m_s, RESOLVED)
        # two vectors and their halves are no sequence
        assert 0.01 < found.reduction_error / off < (100.0 if n > 2 else math.inf)
        stated.append(found.reduction_error)
    assert stated[0] > 1e-3
    assert stated[-1] == RESOLVED


def test_solid_on_a_rigid_plane(make_solid):
    """Undamped, Kn → ∞ by Nitsche: 2L/c, ρ c A v, 2 m v, in three dimensions."""
    material = Material(beta_s=0.0)
    length, cells = 0.1, 50
    solid = make_solid((1, 2, cells), length, material=material)
    period = 2 * length / material.bar_speed_m_s
    its = period / cells / 6
    reduced = reduced_for(solid, its, 60)
    nitsche = ContactMethod(Linear(math.inf), Enforcement.NITSCHE)
    plan = DropPlan(2.0, nitsche, its, 9.8, impact_only=True)
    forces = []

    def look(state, force):
        forces.append((state.t_s, solid.contact.weights @ force[:, 0]))

    result = simulate(reduced, plan, observer=look)
    front = cells ** (-2 / 3)
    speed = result.impact_speed_m_s
    assert result.impulse_N_s == pytest.approx(2 * solid.mass_kg * speed, rel=front)
    assert result.contact_time_s == pytest.approx(period, rel=front)
    t, force = np.array(forces).T
    inside = (t - t[0] > 0.2 * period) & (t - t[0] < 0.8 * period)
    plateau = 7800 * material.bar_speed_m_s * Rectangle().area_m2 * speed
    assert force[inside].mean() == pytest.approx(plateau, rel=front)


def test_ranks_do_not_matter(make_solid):
    """The same drop on this communicator and on each rank alone."""
    its = 1e-6
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        solid = make_solid((1, 2, 24), 0.05, comm=comm)
        reduced = reduced_for(solid, its, 24)
        plan = DropPlan(0.05, ContactMethod(Linear(2e6)), its, 9.8)
        results.append(simulate(reduced, plan))
    shared, alone = results
    assert shared.n_dofs == alone.n_dofs
    assert shared.rebound_ratio == pytest.approx(alone.rebound_ratio, rel=1e-9)
    assert shared.peak_force_N == pytest.approx(alone.peak_force_N, rel=1e-9)
    assert shared.energy.material_loss_J == pytest.approx(alone.energy.material_loss_J, rel=1e-7)


def test_responses_to_contact_are_kept_or_solved_for_alike(make_solid, monkeypatch):
    """An edge first, with friction: every point is pushed every way."""
    its = 1e-6
    solid = make_solid((1, 2, 24), 0.05)
    reduced = reduced_for(solid, its, 24, leaning=True)
    method = ContactMethod(Linear(2e6), friction=Coulomb(0.5))
    plan = DropPlan(0.05, method, its, 9.8, impact_only=True, tilt_deg=1.0)
    results = []
    for most in (math.inf, 0):
        monkeypatch.setattr(march, "MOST_KEPT", most)
        results.append(simulate(reduced, plan))
    kept, solved = results
    assert solved.n_steps == kept.n_steps
    assert solved.cm_velocity_after_m_s == pytest.approx(kept.cm_velocity_after_m_s, rel=1e-9)
    assert solved.peak_force_N == pytest.approx(kept.peak_force_N, rel=1e-9)
    assert solved.energy.friction_loss_J == pytest.approx(kept.energy.friction_loss_J, rel=1e-7)


def test_one_factor_serves_every_stiffness_and_law(make_solid):
    solid = make_solid((1, 2, 24), 0.05)
    solid.release_factors()
    plan = DropPlan(0.05, ContactMethod(Linear(2e6)), 1e-6, 9.8)
    reduced = reduced_for(solid, 1e-6, 16)
    marcher = Marcher(solid, plan.method, plan.scheme, plan.its_s, 9.8)
    assert len(solid._solvers) == 1
    one = simulate(reduced, plan, marcher)
    softer = replace(plan, method=ContactMethod(Linear(1e5)))
    other = simulate(reduced, softer, marcher.with_law(Linear(1e5)))
    assert len(solid._solvers) == 1
    assert other.contact_time_s > one.contact_time_s


def test_another_law_keeps_nitsches_compliance_or_is_refused(make_solid):
    """Its γ₀ is another one on a rigid plane, where none is given."""
    solid, scheme, its = make_solid((1, 1, 12)), TimeScheme.average(), 1e-6
    nitsche = ContactMethod(Linear(2e6), Enforcement.NITSCHE)
    soft = Marcher(solid, nitsche, scheme, its, 9.8)
    with pytest.raises(ValueError, match="gamma0 is 2 at a Kn of inf N/m, and 10 in this march"):
        soft.with_law(Linear(math.inf))
    assert soft.with_law(Linear(1e5)).contact.compliance_m_N == soft.tau
    given = Marcher(solid, replace(nitsche, gamma0=5.0), scheme, its, 9.8)
    rigid = given.with_law(Linear(math.inf))
    made = Marcher(solid, rigid.method, scheme, its, 9.8)
    assert (rigid.tau, rigid.contact.compliance_m_N) == (made.tau, made.tau)
    fall = -solid.translation[:, 2]
    forces = [m.step(m.start(0.0, 0.0 * fall, fall)).force for m in (rigid, made)]
    assert np.abs(forces[1]).max() > 0.0
    assert np.array_equal(*forces)
