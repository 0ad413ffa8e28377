"""The series of a leaning bar converges, keeps energy, and is that of an axial rod upright.

That its modes, its end face and its friction are right is seen where a beam is held against it.
"""

import math

import leaning_reference as lr
import numpy as np
import pytest
from numpy.polynomial import legendre
from reference import modal_series_rebound
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

pytestmark = pytest.mark.serial
SPEED = math.sqrt(2.0 * 9.8 * 0.05)
BRISTLE = lr.Bar()


def series(lean, *, kn=2e6, beta=1e-8, face=True, until_s=4e-4, **options):
    return lr.leaning_series(
        lean, kn, beta, face=face, **{"speed": SPEED, "until_s": until_s, **options}
    )


def ritz_impact(lean_deg, kn, beta, face, *, bar=BRISTLE, n=120, until_s=3e-4):
    """Fraction of speed kept: Legendre polynomials for u, w and φ, marched by DOP853.

    A second route: no exact mode, no static remainder, no step of ours.
    """
    x, weight = legendre.leggauss(n + 4)
    weight = weight * bar.length_m / 2.0
    value = legendre.legvander(x, n - 1)
    slope = legendre.legval(x, legendre.legder(np.eye(n))).T * 2.0 / bar.length_m
    vv, vs = value.T * weight @ value, value.T * weight @ slope
    ss = slope.T * weight @ slope
    line = bar.density_kg_m3 * bar.area_m2
    zero = np.zeros((n, n))
    inertia = bar.density_kg_m3 * bar.second_moment_m4
    M = np.block([[line * vv, zero], [zero, inertia * vv]])
    K = np.block([[bar.kGA * ss, -bar.kGA * vs.T], [-bar.kGA * vs, bar.EI * ss + bar.kGA * vv]])
    w2, across = eigh(K, M)
    u2, along = eigh(bar.youngs_Pa * bar.area_m2 * ss, line * vv)
    # The highest modes of a Ritz basis are wrong and only cost steps.
    across, w2 = across[:, w2 < (2e6) ** 2], w2[w2 < (2e6) ** 2]
    along, u2 = along[:, u2 < 1e14], u2[u2 < 1e14]

    end = (-1.0) ** np.arange(n)
    sin, cos = math.sin(math.radians(lean_deg)), math.cos(math.radians(lean_deg))
    spots = np.array([-1.0, -math.sqrt(3 / 7), 0.0, math.sqrt(3 / 7), 1.0]) if face else np.zeros(1)
    share = np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180.0 if face else np.ones(1)
    spots = spots * bar.depth_m / 2.0
    bend = -sin * (end @ across[:n]) - cos * np.outer(spots, end @ across[n:])
    rows = np.hstack([bend, np.tile(cos * (end @ along), (len(spots), 1))])
    gap = (spots.max() - spots) * sin
    omega2 = np.maximum(np.concatenate([w2, u2]), 0.0)
    start = SPEED * np.concatenate([sin * across.T @ M[:, 0], -cos * along.T @ (line * vv[:, 0])])
    m = len(omega2)

    def motion(_t, y):
        q, v = y[:m], y[m : 2 * m]
        force = kn * share * np.maximum(-gap - rows @ q, 0.0)
        return np.concatenate([v, rows.T @ force - omega2 * (q + beta * v), [force.sum()]])

    y = np.concatenate([np.zeros(m), start, [0.0]])
    run = solve_ivp(motion, (0.0, until_s), y, "DOP853", rtol=1e-8, atol=1e-12, max_step=1e-6)
    return run.y[-1, -1] / (bar.mass_kg * SPEED) - 1.0


@pytest.mark.parametrize(("lean", "face"), [(2, False), (5, True)])
def test_a_second_method_keeps_the_same_speed(lean, face):
    other = ritz_impact(lean, 2e6, 1e-8, face)
    assert series(lean, face=face, points=5).kept == pytest.approx(other, abs=5e-4)


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
