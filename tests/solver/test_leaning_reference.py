"""References for leaning and friction converge, and agree with each other."""

import math

import leaning_reference as lr
import numpy as np
import pytest
from numpy.polynomial import legendre
from reference import free_free_timoshenko_hz, modal_series_rebound
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

pytestmark = pytest.mark.serial
SPEED = math.sqrt(2.0 * 9.8 * 0.05)
BRISTLE = lr.Bar()
ROUND = lr.Bar(0.1, diameter_m=0.0127)


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


# --- modes --------------------------------------------------------------------------------------


@pytest.mark.parametrize("bar", [BRISTLE, ROUND], ids=["bristle", "round"])
def test_frequencies_are_those_of_the_matrix_exponential(bar):
    found = lr.bending_modes(bar, 8).omega[2:] / (2.0 * math.pi)
    inertia = bar.density_kg_m3 * bar.second_moment_m4
    line = bar.mass_kg / bar.length_m
    for hz in found[:6]:
        other = free_free_timoshenko_hz(bar.length_m, bar.EI, bar.kGA, line, inertia, 1.004 * hz)
        assert hz == pytest.approx(other, rel=1e-6)


@pytest.mark.parametrize("bar", [BRISTLE, ROUND], ids=["bristle", "round"])
def test_no_mode_is_missed(bar):
    """All of them make up the tip's compliance, L³/(105 EI) + 2L/(15 kGA) across but for the rotary
    inertia of the section, which a single lost one would show; and no other ones come before."""
    few, many = (lr.bending_modes(bar, n) for n in (20, 60))
    shear = 2.0 * bar.length_m / (15.0 * bar.kGA)
    whole = bar.length_m**3 / (105.0 * bar.EI) + shear
    close = max(2.0 * (bar.depth_m / bar.length_m) ** 2, 1e-9)
    for modes in (few, many):
        tip, omega = modes.tip[2:], modes.omega[2:]
        found = (tip.T / omega**2) @ tip + modes.remainder
        assert found[1, 1] == pytest.approx(whole, rel=close)
        assert 0.0 < modes.remainder[1, 1] < 5e-3 * whole
        assert modes.remainder[2, 2] > 0.0
    assert many.omega[: len(few.omega)] == pytest.approx(few.omega, rel=1e-9)
    assert many.remainder[1, 1] < 0.5 * few.remainder[1, 1]


def test_axial_modes_make_up_the_static_compliance():
    rest = [lr.axial_modes(BRISTLE, n).remainder[0, 0] for n in (100, 200)]
    assert rest[1] == pytest.approx(rest[0] / 2.0, rel=0.01)


# --- the leaning series -------------------------------------------------------------------------


@pytest.mark.parametrize(("lean", "face"), [(2, False), (5, False), (1, True), (5, True)])
def test_a_second_method_keeps_the_same_speed(lean, face):
    other = ritz_impact(lean, 2e6, 1e-8, face)
    assert series(lean, face=face, points=5).kept == pytest.approx(other, abs=5e-4)


@pytest.mark.parametrize(("kn", "tolerance"), [(2e6, 5e-6), (1e8, 5e-5)])
def test_converges_with_the_step(kn, tolerance):
    coarse, fine = series(5, kn=kn, step_s=1e-7).kept, series(5, kn=kn, step_s=1e-8).kept
    assert coarse == pytest.approx(fine, abs=tolerance)


@pytest.mark.parametrize(("kn", "tolerance"), [(2e6, 1.5e-3), (1e8, 1.5e-3)])
def test_nine_points_are_enough_for_the_end_face(kn, tolerance):
    assert series(5, kn=kn).kept == pytest.approx(series(5, kn=kn, points=33).kept, abs=tolerance)


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


# --- friction -----------------------------------------------------------------------------------


def test_a_stiff_hold_is_coulombs():
    distance, time = 1.0 / (2.0 * 0.5 * 9.8), 1.0 / (0.5 * 9.8)  # v²/(2μg) and v/(μg)
    t = np.linspace(0.0, 2.0 * time, 2001)
    x, v = lr.stick_slip_block(t, 1.0, 2.0, 2.0 * 9.8, 0.5, 1e9)
    assert x[-1] == pytest.approx(distance, abs=1e-6)
    assert np.abs(v[t > 1.01 * time]).max() < 1e-3


@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_the_held_block_obeys_its_equation(speed):
    mass, normal, mu, kt = 2.0, 19.6, 0.5, 5e3

    def motion(_t, y):
        stretch = y[0] - y[2]
        yields = abs(stretch) * kt >= mu * normal and stretch * y[1] > 0.0
        return [y[1], -min(max(kt * stretch, -mu * normal), mu * normal) / mass, yields * y[1]]

    t = np.linspace(0.0, 0.6, 301)
    run = solve_ivp(motion, (0.0, 0.6), [0.0, speed, 0.0], t_eval=t, rtol=1e-9, max_step=2e-4)
    x, v = lr.stick_slip_block(t, speed, mass, normal, mu, kt)
    assert np.allclose(run.y[0], x, atol=2e-4 * speed)
    assert np.allclose(run.y[1], v, atol=1e-2 * speed)
