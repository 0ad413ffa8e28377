"""The beam vibrates as a free-free Timoshenko beam does."""

import math

import numpy as np
import pytest
from reference import free_free_timoshenko_hz, rate

from bristle.meshes.section import Circle, Rectangle
from bristle.solver.bodies.beam import beam_body, beam_contact, beam_matrices
from bristle.solver.bristle import Bristle, Material
from bristle.solver.errors import InputError

pytestmark = pytest.mark.serial
BEAMS = [Bristle(), Bristle(0.05, Circle(2e-3)), Bristle(0.03, Rectangle(1e-3, 3e-3))]


def frequencies_hz(bristle, n_elements):
    return np.sqrt(beam_body(bristle, n_elements).omega2) / (2.0 * math.pi)


def nearest(found, wanted):
    return found[np.argmin(np.abs(found - wanted))]


def axial_hz(bristle, n):
    return n * bristle.material.bar_speed_m_s / (2.0 * bristle.length_m)


def torsion_hz(bristle, n):
    mat, sec = bristle.material, bristle.section
    polar = sec.second_moment_x_m4 + sec.second_moment_y_m4
    speed = math.sqrt(mat.shear_modulus_Pa * sec.torsion_m4 / (mat.density_kg_m3 * polar))
    return n * speed / (2.0 * bristle.length_m)


def bending_hz(bristle, second_moment, n):
    mat, sec = bristle.material, bristle.section
    root = (4.730040744862704, 7.853204624095838, 10.995607838001671)[n - 1]
    slender = (root / bristle.length_m) ** 2 / (2.0 * math.pi)
    slender *= math.sqrt(mat.youngs_Pa * second_moment / (mat.density_kg_m3 * sec.area_m2))
    shear = sec.shear_coefficient(mat.poisson) * mat.shear_modulus_Pa * sec.area_m2
    radius2 = second_moment / sec.area_m2
    # first-order correction for shear and rotary inertia puts the search near the root
    flexible = 1.0 + mat.youngs_Pa * sec.area_m2 / shear
    near = slender * (1.0 - 0.5 * (root / bristle.length_m) ** 2 * radius2 * flexible)
    return free_free_timoshenko_hz(
        bristle.length_m,
        mat.youngs_Pa * second_moment,
        shear,
        mat.density_kg_m3 * sec.area_m2,
        mat.density_kg_m3 * second_moment,
        near,
    )


@pytest.mark.parametrize("bristle", BEAMS, ids=["paper", "wire", "stocky"])
def test_axial_bending_and_torsion_frequencies_converge_at_fourth_order(bristle):
    sizes = np.array([8, 16, 32])
    found = [frequencies_hz(bristle, n) for n in sizes]
    sec = bristle.section
    exact = [axial_hz(bristle, 1), axial_hz(bristle, 3), torsion_hz(bristle, 2)]
    exact += [
        bending_hz(bristle, moment, n)
        for moment in (sec.second_moment_x_m4, sec.second_moment_y_m4)
        for n in (1, 2)
    ]
    for wanted in exact:
        errors = [abs(nearest(f, wanted) / wanted - 1.0) for f in found]
        assert errors[-1] < 2e-5, wanted
        clear = [(1.0 / n, e) for n, e in zip(sizes, errors, strict=True) if e > 1e-10]
        if len(clear) == 3:
            assert 3.6 < rate(*zip(*clear, strict=True)) < 4.5, wanted


def test_six_rigid_motions_and_the_mass_of_the_paper(bristle):
    body = beam_body(bristle, 16)
    assert np.count_nonzero(body.omega2 == 0.0) == 6
    assert body.mass_kg == pytest.approx(bristle.mass_kg, rel=1e-12)
    assert body.mass_kg == pytest.approx(2.73e-3, rel=2e-4)  # printed to three digits


def test_end_section_sees_the_force_that_presses_on_it(bristle):
    """A free beam pushed steadily at its tip by 1 N: A σ = 1 N at every point.

    Its displacement is quadratic, so a single quadratic element is exact.
    """
    body = beam_body(bristle, 1)
    load = body.contact.weights @ body.contact.displacement[2::3]
    rest = np.divide(load, body.omega2, out=np.zeros_like(load), where=body.omega2 > 0.0)
    tractions = body.contact.tractions(rest)
    assert tractions[:, 2] == pytest.approx(np.ones(len(tractions)), rel=1e-8)
    assert tractions[:, :2] == pytest.approx(np.zeros((len(tractions), 2)), abs=1e-8)


def test_torsion_constant_of_rectangles():
    """Against the table of Timoshenko and Goodier: J = k a b³ for a / b = 1, 2, 10."""
    for ratio, k in ((1.0, 0.1406), (2.0, 0.229), (10.0, 0.312)):
        assert Rectangle(1.0, ratio).torsion_m4 == pytest.approx(k * ratio, rel=2.5e-3)


def test_slow_bending_survives_beside_fast_axial_waves():
    """A wire a third of a metre long and a tenth of a millimetre thick still has its first mode."""
    wire = Bristle(0.34, Circle(1e-4))
    found = frequencies_hz(wire, 16)
    wanted = bending_hz(wire, wire.section.second_moment_x_m4, 1)
    assert nearest(found, wanted) == pytest.approx(wanted, rel=1e-3)


def test_modes_are_orthonormal_and_diagonalise(bristle):
    mass, stiffness = beam_matrices(bristle, 16)
    body = beam_body(bristle, 16)
    assert body.translation.T @ body.translation == pytest.approx(
        bristle.mass_kg * np.eye(3), rel=1e-12, abs=1e-16
    )
    assert np.trace(np.linalg.solve(mass, stiffness)) == pytest.approx(body.omega2.sum(), rel=1e-9)
    seen = body.contact.displacement
    compliance = seen @ body.factor(1e9, 1.0)(seen.T)
    rows = beam_contact(bristle, 16, face=True).displacement
    direct = rows @ np.linalg.solve(1e9 * mass + stiffness, rows.T)
    assert compliance == pytest.approx(direct, rel=1e-7, abs=1e-9 * direct.max())


@pytest.mark.parametrize("section", [Rectangle(0.5e-3, 2e-3), Circle(3e-3)])
def test_contact_points_integrate_area_and_second_moments(section):
    xy, weights = section.contact_points(5)
    area = section.area_m2
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)
    assert weights @ xy == pytest.approx(np.zeros(2), abs=1e-18)
    assert area * weights @ xy[:, 0] ** 2 == pytest.approx(section.second_moment_x_m4, rel=1e-12)
    assert area * weights @ xy[:, 1] ** 2 == pytest.approx(section.second_moment_y_m4, rel=1e-12)
    assert area * weights @ (xy[:, 0] * xy[:, 1]) == pytest.approx(0.0, abs=1e-25)


@pytest.mark.parametrize(
    ("build", "word"),
    [
        (lambda: Rectangle(0.0, 1.0), "thickness"),
        (lambda: Circle(float("nan")), "diameter"),
        (lambda: Material(poisson=0.5), "Poisson"),
        (lambda: Material(beta_s=-1.0), "beta"),
        (lambda: Bristle(length_m=-1.0), "length"),
        (lambda: beam_body(Bristle(), 0), "element"),
    ],
)
def test_impossible_bristles_are_refused_by_name(build, word):
    with pytest.raises((InputError, ValueError), match=word):
        build()
