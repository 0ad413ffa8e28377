"""The series of a leaning bar converges, keeps energy, and is that of an axial rod upright.

That its modes, its end face and its friction are right is seen where a beam is held against it.
"""

import math

import leaning_reference as lr
import pytest
from reference import modal_series_rebound

pytestmark = pytest.mark.serial
SPEED = math.sqrt(2.0 * 9.8 * 0.05)
BRISTLE = lr.Bar()


def series(lean, *, kn=2e6, beta=1e-8, face=True, until_s=4e-4, **options):
    return lr.leaning_series(
        lean, kn, beta, face=face, **{"speed": SPEED, "until_s": until_s, **options}
    )


@pytest.mark.parametrize(("kn", "tolerance"), [(2e6, 5e-6), (1e8, 5e-5)])
def test_converges_with_the_step(kn, tolerance):
    coarse, fine = series(5, kn=kn, step_s=1e-7).kept, series(5, kn=kn, step_s=1e-8).kept
    assert coarse == pytest.approx(fine, abs=tolerance)


@pytest.mark.parametrize(("kn", "tolerance"), [(2e6, 5e-6), (1e8, 5e-4)])
def test_the_static_remainder_stands_for_the_modes_left_out(kn, tolerance):
    many = series(5, kn=kn, n_axial=300, n_bending=300).kept
    few = {on: series(5, kn=kn, n_axial=25, n_bending=60, remainder=on).kept for on in (1, 0)}
    assert few[1] == pytest.approx(many, abs=tolerance)
    assert abs(few[0] - many) > 3.0 * abs(few[1] - many)


@pytest.mark.parametrize("mu", [0.0, 0.3])
@pytest.mark.parametrize(("lean", "face"), [(0, False), (2, True), (5, True), (5, False)])
def test_energy_is_conserved_without_damping(lean, face, mu):
    impact = series(lean, beta=0.0, face=face, mu=mu)
    assert abs(impact.energy_error) < 1e-6
    assert impact.friction_loss >= 0.0


def test_upright_it_is_the_series_of_an_axial_rod():
    """Against LSODA on the rod, where gravity is made too small to matter."""
    gravity = 1e-3
    for kn, beta in ((1e5, 1.07e-5), (2e6, 1.07e-5), (2e6, 1e-7)):
        other = modal_series_rebound(
            kn,
            SPEED**2 / (2.0 * gravity),
            mass=BRISTLE.mass_kg,
            length=BRISTLE.length_m,
            speed=math.sqrt(BRISTLE.youngs_Pa / BRISTLE.density_kg_m3),
            beta=beta,
            gravity=gravity,
        )
        for face in (False, True):
            ours = series(0, kn=kn, beta=beta, face=face, until_s=6e-4)
            assert ours.kept**2 == pytest.approx(other["rebound_ratio"], abs=1e-5)
            assert ours.peak_force_N == pytest.approx(other["peak_force_N"], rel=1e-3)
            assert ours.touches[0, 1] == pytest.approx(other["contact_time_s"], abs=2e-7)


def test_gravity_adds_its_own_impulse_and_no_more():
    still, heavy = series(5), series(5, gravity=9.8)
    gained = heavy.kept - still.kept
    assert 0.0 < gained < 9.8 * heavy.last_release_s / SPEED
