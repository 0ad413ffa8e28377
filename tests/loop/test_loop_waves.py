"""Passes along a rod against closed forms and independent solutions, and measured ones.

The measured record lies in studies/measured/square-bar; its ``dataset.toml`` names the source.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from model_fit import fit
from reference import pochhammer_chree_hz
from scipy.signal import lfilter

from bristle.meshes.section import Circle, Rectangle
from bristle.solver import paper
from bristle.solver.bristle import Bristle, Material
from bristle.solver.errors import InputError
from bristle.studies.data.datasets import read_manifest
from bristle.studies.loop.kinds.waves.noise import quiet_power, whitening
from bristle.studies.loop.kinds.waves.problem import read_waves, wave_problem
from bristle.studies.loop.kinds.waves.rod import SHORTEST_WAVE, Rod, attached_mass
from bristle.studies.loop.kinds.waves.solid import solid_wave_numbers
from bristle.studies.loop.run import find

MEASURED = Path(__file__).resolve().parents[2] / "studies" / "measured" / "square-bar"
LENGTH_M, MODULUS_PA, DENSITY = 0.2, 70e9, 2800.0
SPEED = math.sqrt(MODULUS_PA / DENSITY)
PASS_S = LENGTH_M / SPEED
BETA_S = 2e-8
pytestmark = pytest.mark.serial


def pulse(t, width_s):
    """A smooth pulse from 0 to ``width_s``, of height one."""
    return np.where((t > 0) & (t < width_s), np.sin(np.pi * t / width_s) ** 4, 0.0)


def images(t, place, width_s):
    """Strain at ``place`` (of the length) by d'Alembert's waves: images of a pulse, no damping."""
    strain = np.zeros_like(t)
    for trip in range(20):
        strain += pulse(t - (2 * trip + place) * PASS_S, width_s)
        strain -= pulse(t - (2 * trip + 2 - place) * PASS_S, width_s)
    return strain


def modal(t, place, width_s, beta_s=0.0, gyration_m2=0.0, modes=300):
    """The same by a modal series of the free-free rod under a force pulse on one end, damped.

    u = Σ q_n cos(kx), k = nπ/L, (1 + gk²) q̈ + βc²k² q̇ + c²k² q = 2 F / m, g being ν² I_p / A of
    Love's rod, integrated exactly for a force that is linear between samples (``t`` from zero).
    Strain is −Σ q_n k sin(kx); its static part, which converges slowly, is summed in closed form,
    (1 − x/L) F.
    """
    step, force = t[1] - t[0], pulse(t, width_s)
    strain = force * (1 - place)
    for n in range(1, modes + 1):
        inertia = 1.0 + gyration_m2 * (n * np.pi / LENGTH_M) ** 2
        omega = n * np.pi / PASS_S / math.sqrt(inertia)
        damping = beta_s * omega**2
        root = -0.5 * damping + 1j * np.sqrt(complex(omega**2 - 0.25 * damping**2))
        decay = np.exp(root * step)
        # ∫ of exp(root (step - s)) times 1 and s / step
        one = (decay - 1) / root
        ramp = (one - step) / (root * step)
        drive = np.zeros(len(t), dtype=complex)
        drive[1:] = (one - ramp) * force[:-1] + ramp * force[1:]
        q = lfilter([1.0], [1.0, -decay], drive).imag / root.imag - force / omega**2
        strain += 2 / PASS_S**2 / inertia * q * (n * np.pi) * np.sin(n * np.pi * place)
    return strain


def write(folder, t, columns, declared="", body="", **keys):
    """A dataset folder of kind waves; ``keys`` replace or add lines under [measurement]."""
    folder.mkdir(exist_ok=True)
    names = ["a_V", "b_V", "c_V", "d_V"][: len(columns)]
    measurement = {
        "file": '"record.csv"',
        "signal": '["a_V", "b_V"]' if len(columns) == 2 else '"a_V"',
        "unit": '"V"',
        "baseline_until_s": "-1e-6",
        "first_pass_s": [0.4 * PASS_S, 0.95 * PASS_S],
        "predict_s": [1.4 * PASS_S, 7.4 * PASS_S],
    } | keys
    lines = [f"{key} = {value}" for key, value in measurement.items() if value != ""]
    body = body or (
        f"length_m = {LENGTH_M}\nwidth_m = 2e-3\nthickness_m = 2e-3\n"
        f"youngs_modulus_Pa = {MODULUS_PA}\ndensity_kg_m3 = {DENSITY}\npoisson_ratio = 0.33\n"
    )
    head = f'[dataset]\ntitle = "made"\nkind = "waves"\n[body]\n{body}{declared}\n[measurement]'
    (folder / "dataset.toml").write_text("\n".join([head, *lines, ""]))
    table, names = np.column_stack([t, *columns]), ",".join(["t_s", *names])
    np.savetxt(folder / "record.csv", table, "%.9g", ",", header=names, comments="")
    return folder


class Case:
    """A gauge, a pulse, and the windows of it in lengths of the bar."""

    def __init__(self, places, width_s, first, predict):
        self.places, self.width_s = places, width_s
        self.first = [each * PASS_S for each in first]
        self.predict = [each * PASS_S for each in predict]
        self.t = np.arange(-20e-6, self.predict[1] + 3e-6, 0.1e-6)

    def record(self, folder, solve, noise=0.0, seed=0, **keys):
        rng, after = np.random.default_rng(seed), self.t > -1e-12
        columns = []
        for place in self.places:
            strain = np.zeros_like(self.t)
            strain[after] = solve(self.t[after], place)
            strain /= np.abs(strain).max()
            columns.append(strain + noise * rng.standard_normal(len(strain)) + 0.3)
        told = {
            "signal": '"a_V"',
            "gauge_x_m": self.places[0] * LENGTH_M,
            "first_pass_s": self.first,
            "predict_s": self.predict,
        }
        if len(self.places) == 2:
            told |= {"signal_2": '"b_V"', "gauge_2_x_m": self.places[1] * LENGTH_M}
        return read_waves(write(folder, self.t, columns, **(told | keys)))


CASES = {
    "mid-length": Case([0.5], 8e-6, [0.4, 0.95], [1.4, 7.4]),
    "near the struck end, passes overlap": Case([0.1], 12e-6, [0.05, 0.5], [1.0, 9.0]),
    "near the far end, the first pass overlaps": Case([0.8], 30e-6, [0.7, 1.6], [1.7, 9.7]),
    "a pulse longer than the bar": Case([0.5], 60e-6, [0.4, 2.2], [2.3, 8.3]),
    "a second gauge": Case([0.2, 0.7], 12e-6, [0.1, 0.7], [0.6, 1.2]),
    "a second gauge with reflections": Case([0.2, 0.7], 12e-6, [0.1, 0.7], [0.6, 4.6]),
}
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A record at mid-length of a rod with `BETA_S` by modal series, with noise of each gauge."""
    rng, case = np.random.default_rng(3), CASES["mid-length"]
    strain, after = np.zeros_like(case.t), case.t > -1e-12
    strain[after] = modal(case.t[after], 0.5, 8e-6, BETA_S)
    strain /= np.abs(strain).max()
    noisy = [strain + 2e-3 * rng.standard_normal(len(strain)) + 0.3 for _ in range(2)]
    return read_waves(write(tmp_path_factory.mktemp("made"), case.t, noisy))


def relative_residual(model, theta, passes=None):
    """Residual over signal, both rms over all samples that are predicted.

    ``theta`` (p,). ``passes``, counted from 2, are lengths of the bar of equal time in what is
    predicted. All frequencies that the record holds count, electrical noise among them.
    """
    whole = model.propagation
    data = whole.data
    begin, end = (data.index(each) for each in data.predict_s)
    chosen = np.zeros(len(data.times_s), dtype=bool)
    if passes is None:
        chosen[begin:end] = True
    else:
        span = (data.predict_s[1] - data.predict_s[0]) * model.baseline[0].typical
        count = round(span / whole.rod.length_m)
        for each in passes:
            first, last = (begin + (end - begin) * k // count for k in (each - 2, each - 1))
            chosen[first:last] = True
    signal = data.predicted.signal[chosen]
    spectrum = np.pad(model.spectra(theta), (0, whole.padded // 2 + 1 - len(whole.omega)))
    late = np.fft.irfft(spectrum, whole.padded)
    late *= np.exp(whole.damping * data.step_s * np.arange(whole.padded))
    predicted = late[np.flatnonzero(chosen) - whole.begin]
    return float(np.linalg.norm(signal - predicted) / np.linalg.norm(signal))


def fitted_rows(problem):
    return ~np.isin(problem.group, problem.held or ())


def truth(model, beta_s):
    exact = {"wave_speed_m_s": SPEED, "driving_gain": 1.0, "beta_s": beta_s}
    return np.array([exact.get(p.name, 0.0) for p in model.parameters])


@every_case
def test_passes_are_superposed_as_by_images(tmp_path, case):
    """What d'Alembert's images give, up to what lies beyond the band that is carried."""
    data = case.record(tmp_path, lambda t, place: images(t, place, case.width_s), sigma=1e-6)
    model = wave_problem(data).baseline
    assert relative_residual(model, truth(model, 1e-16)) < 3e-4


@every_case
def test_passes_are_damped_as_by_a_modal_series(tmp_path, case):
    """An independent solution in time, of 300 modes: what they leave out is (1/300)³ or so."""

    def solve(t, place):
        return modal(t, place, case.width_s, BETA_S)

    data = case.record(tmp_path, solve, sigma=1e-6)
    # the records are scaled each to height one: damping on the way is the second gauge's gain
    model = wave_problem(data).baseline
    exact = truth(model, BETA_S)
    if data.second is not None:
        heights = [np.abs(solve(case.t[case.t > -1e-12], place)).max() for place in case.places]
        exact[[p.name for p in model.parameters].index("driving_gain")] = heights[0] / heights[1]
    assert relative_residual(model, exact) < 2e-4
    assert relative_residual(model, np.where(exact == BETA_S, 1e-12, exact)) > 1e-3


def test_lateral_inertia_disperses_as_a_modal_series_of_loves_rod(tmp_path):
    case, gyration = CASES["near the far end, the first pass overlaps"], 7.26e-8
    data = case.record(tmp_path, lambda t, p: modal(t, p, 30e-6, BETA_S, gyration), sigma=1e-6)
    problem = wave_problem(data)
    assert problem.baseline.propagation.rod.gyration_m2 == pytest.approx(gyration, rel=1e-2)
    exact = truth(problem.baseline, BETA_S)
    model = problem.combine(("lateral_inertia",))
    strength = gyration / model.propagation.rod.gyration_m2
    assert relative_residual(model, np.append(exact, strength)) < 2e-4
    assert relative_residual(problem.baseline, exact) > 1e-3


@every_case
def test_what_is_not_declared_is_found_within_its_interval(tmp_path, case):
    """Of independent records with noise, estimates scatter as the rows' noise says: of z² over
    records and parameters, a mean of one, known to √(2/n), z of one record being nearly free of
    each other's (3 standard errors, doubled for the noise's own level, which is estimated)."""
    squares = []
    for seed in range(6):
        data = case.record(
            tmp_path, lambda t, place: modal(t, place, case.width_s, BETA_S), 3e-3, seed
        )
        problem = wave_problem(data)
        model = problem.baseline
        theta, spread, _ = fit(model, problem.values, fitted_rows(problem))
        names = [p.name for p in model.parameters]
        beta, speed = names.index("beta_s"), names.index("wave_speed_m_s")
        squares.append((np.log(theta[beta] / BETA_S) / spread[beta]) ** 2)
        squares.append(((theta[speed] - SPEED) / spread[speed]) ** 2)
    assert np.mean(squares) < 1.0 + 6.0 * math.sqrt(2.0 / len(squares))
    assert max(squares) < 16.0


def test_rows_that_are_fitted_share_no_noise(made, tmp_path):
    """The first pass's noise returns in every pass; after whitening none of it is shared.

    Of rows at the truth: mean square one, and of the sum of passes with the signs that a shared
    first pass would give them, as much as of any other sum.
    """
    case, one, summed = CASES["mid-length"], [], []
    for seed in range(6):
        data = case.record(tmp_path, lambda t, place: images(t, place, 8e-6), 1e-2, seed)
        problem = wave_problem(data)
        left = problem.values - problem.baseline.predict(truth(problem.baseline, 1e-16))[0]
        rows = left[fitted_rows(problem)].reshape(4, -1)
        one.append(np.mean(rows**2))
        pairs = rows[:-1] * rows[1:]
        summed.append(np.mean(pairs))
    count = 6 * rows.size
    # the noise is estimated: it may be larger by its standard error
    assert 0.7 < np.mean(one) < 1.0 + 4 * math.sqrt(2 / count)
    assert abs(np.mean(summed)) < 4 / math.sqrt(0.75 * count)


def test_noise_that_rows_share_is_taken_out_of_the_fitted_ones_only():
    rng = np.random.default_rng(1)
    own, shared = rng.uniform(0.5, 2.0, 8), rng.standard_normal((8, 3))
    fitted = np.arange(8) < 5
    white = whitening(own, shared, fitted)
    covariance = white.factor @ (np.diag(own**2) + shared @ shared.T) @ white.factor.T
    np.testing.assert_allclose(covariance[:5, :5], np.eye(5), atol=1e-12)
    np.testing.assert_allclose(np.diag(covariance), 1.0)
    np.testing.assert_allclose(white.scale, 1.0 / np.diag(white.factor))


@pytest.mark.parametrize(("beta_s", "loss"), [(1e-9, 0.0), (0.0, 2e-3), (1e-9, 2e-3)])
def test_a_monochromatic_wave_decays_as_weak_loss_says(beta_s, loss):
    """exp(−ω (ωβ + η) x / 2c), the next order being a square of the loss smaller."""
    omega = 2 * np.pi * np.array([5e4, 1e5, 3e5])
    angle = omega * beta_s + loss
    number = Rod(LENGTH_M, 0.0).wave_number(omega, SPEED, beta_s, loss, dispersion=0.0)
    np.testing.assert_allclose(-number.imag, 0.5 * omega / SPEED * angle, rtol=angle.max() ** 2)
    np.testing.assert_allclose(number.real, omega / SPEED, rtol=angle.max() ** 2)


def test_rounding_is_noise_also_where_the_quiet_stretch_shows_none(tmp_path):
    """An 8-bit converter's step over √12, though before the pulse all samples are alike."""
    case = CASES["mid-length"]
    record = case.record(tmp_path, lambda t, p: images(t, p, 8e-6))
    step = np.ptp(record.gauge.signal) / 256.0
    rounded = replace(record.gauge, signal=step * np.round(record.gauge.signal / step))
    power = quiet_power(replace(record, gauge=rounded), rounded, 1e5)(np.array([1e4, 1e5]))
    np.testing.assert_allclose(power, step**2 / 12.0)


@pytest.mark.parametrize("loss", [4e-4, 2e-2])
def test_a_loss_constant_over_frequency_disperses_as_causality_asks(loss):
    """No wave comes before its cause: phase speed c (ω/ω₁)^γ and decay tan(½πγ) ω x / c
    (Kjartansson, J. Geophys. Res. 84 (1979) 4737, eqs. 10 and 11), of a real modulus at ω₁ there,
    whose size is 1/cos πγ of its real part."""
    first = np.pi * SPEED / LENGTH_M
    omega, power = first * np.array([1.0, 3.0, 40.0]), np.arctan(loss) / np.pi
    number = Rod(LENGTH_M, 0.0).wave_number(omega, SPEED, loss_factor=loss)
    speed = SPEED / np.sqrt(np.cos(np.pi * power)) / np.cos(0.5 * np.pi * power)
    speed = speed * (omega / first) ** power
    np.testing.assert_allclose(omega / number.real, speed, rtol=1e-12)
    decay = np.tan(0.5 * np.pi * power) * omega / speed
    np.testing.assert_allclose(-number.imag, decay, rtol=1e-9)


def test_mass_proportional_damping_decays_in_time_at_half_its_rate():
    """exp(−αt/2) for weak damping: along x, exp(−αx / 2c)."""
    number = Rod(LENGTH_M, 0.0).wave_number(2 * np.pi * np.array([1e5]), SPEED, alpha_1_s=100.0)
    np.testing.assert_allclose(-number.imag, 50.0 / SPEED, rtol=1e-6)


@pytest.mark.parametrize("section", [Circle(4e-3), Rectangle(2e-3, 3e-3)])
def test_lateral_inertia_slows_waves_as_pochhammer_and_chree_expand(section):
    """c / c₀ = 1 − ν² π² (a/λ)² + O(λ⁻⁴) of a round bar; ½ ν² k² I_p / A of any other.

    The remainder must fall with the fourth power.
    """
    poisson = 0.3
    rod = Rod.of(Bristle(0.2, section, Material(MODULUS_PA, poisson, DENSITY)))
    slow = []
    for wavelength in (0.08, 0.04):
        k = 2 * np.pi / wavelength
        if isinstance(section, Circle):
            first = (poisson * np.pi * 0.5 * section.diameter_m / wavelength) ** 2
        else:
            polar = (section.thickness_m**2 + section.width_m**2) / 12
            first = 0.5 * poisson**2 * k**2 * polar
        omega = k * SPEED * (1 - first)
        number = rod.wave_number(np.array([omega]), SPEED, strength=1.0)[0].real
        slow.append(abs(number / k - 1))
        assert slow[-1] < 2 * first**2
    assert np.log2(slow[1] / slow[0]) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("poisson", [0.2, 0.29, 0.35])
def test_a_round_rod_is_used_where_it_is_pochhammers(poisson):
    """At the shortest wave that is used Love's phase speed is right to 1e-3, as `SHORTEST_WAVE`
    says, and at half of that length it no longer is."""
    rod = Rod.of(Bristle(10.0, Circle(2.0), Material(1.0, poisson, 1.0)))
    assert rod.radius_m == pytest.approx(1.0)
    off = []
    for wavelength in (SHORTEST_WAVE, SHORTEST_WAVE / 2):
        k = 2 * np.pi / wavelength
        omega = 2.0 * np.pi * pochhammer_chree_hz(k, 1.0, 1.0, poisson, 1.0)
        love = rod.wave_number(np.array([omega]), 1.0, strength=1.0)[0].real
        off.append(abs(k / love - 1))
    assert off[0] < 1e-3 < off[1]


@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_waves_never_grow(strength):
    """Over all bounds, and where Love's rod carries no wave at all."""
    rod = Rod(LENGTH_M, 1e-5)
    omega = 2 * np.pi * np.geomspace(1.0, 1e8, 4000) - 1e4j
    for beta_s in (0.0, 1e-12, 1e-4):
        for loss in (0.0, 0.1):
            number = rod.wave_number(omega, SPEED, beta_s, loss, strength)
            assert np.all(np.isfinite(number))
            assert np.all(number.imag <= 0.0)


def test_an_attached_mass_delays_below_its_frequency_and_returns_no_more_than_it_gets():
    omega = 2 * np.pi * np.array([1e3, 1e5])
    returned = attached_mass(omega, SPEED / LENGTH_M, 0.002, 1e5, 0.3)
    # far below: the bar is longer by its mass, 2 m / (ρ A c) at each reflection
    assert -np.angle(returned[0]) == pytest.approx(2 * omega[0] * 0.002 * PASS_S, rel=1e-3)
    assert np.all(np.abs(returned) < 1.0)
    free = attached_mass(omega, SPEED / LENGTH_M, 0.002, 1e5, 1e-12)
    assert abs(free[0]) == pytest.approx(1.0, abs=1e-9)


def test_damping_that_is_not_declared_is_free_and_one_that_is_can_be_wrong(made, tmp_path):
    assert not made.manifest.damping_declared
    problem = wave_problem(made)
    free = {p.name: p for p in problem.baseline.parameters}
    assert free["beta_s"].logarithmic
    assert free["beta_s"].low <= 1e-12
    assert free["beta_s"].high >= 1e-4
    assert {m.effects for m in problem.candidates} == {
        ("hysteretic_damping",),
        ("lateral_inertia",),
    }
    folder = write(tmp_path / "a", made.times_s, [made.gauge.signal] * 2, "damping_beta_s = 3e-6\n")
    declared = wave_problem(read_waves(folder))
    assert "beta_s" not in {p.name for p in declared.baseline.parameters}
    (other,) = (m for m in declared.candidates if m.effects == ("material_damping",))
    assert other.parameters[-1].null == 3e-6


def test_without_a_body_the_damping_is_the_papers(tmp_path):
    (tmp_path / "dataset.toml").write_text('[dataset]\nkind = "waves"\n')
    assert read_manifest(tmp_path).damping_declared


def test_a_material_is_held_to_and_a_length_that_contradicts_it_is_told(tmp_path):
    """The bar declared 13 % too long: the speed may not follow, and a sentence says why."""
    case = CASES["mid-length"]
    long = f"length_m = {1.13 * LENGTH_M}\nwidth_m = 2e-3\nthickness_m = 2e-3\n"
    material = f"youngs_modulus_Pa = {MODULUS_PA}\ndensity_kg_m3 = {DENSITY}\n"

    def solve(t, place):
        return modal(t, place, 8e-6, BETA_S)

    told = {"gauge_x_m": 0.565 * LENGTH_M}
    (tmp_path / "a").mkdir()
    case.record(tmp_path / "a", solve, 3e-3, body=long + material, **told)
    known = wave_problem(read_waves(tmp_path / "a"))
    speed = known.baseline.parameters[0]
    assert speed.low == pytest.approx(0.95 * SPEED)
    assert speed.high == pytest.approx(1.05 * SPEED)
    assert any("13% off" in each for each in known.warnings)
    theta, *_ = fit(known.baseline, known.values, fitted_rows(known))
    left = known.values - known.baseline.predict(theta)[0]
    assert np.mean(left**2) > 20.0
    (tmp_path / "b").mkdir()
    case.record(tmp_path / "b", solve, 3e-3, body=long, **told)
    unknown = wave_problem(read_waves(tmp_path / "b"))
    theta, *_ = fit(unknown.baseline, unknown.values, fitted_rows(unknown))
    assert theta[0] == pytest.approx(1.13 * SPEED, rel=1e-3)
    assert not any("off:" in each for each in unknown.warnings)


def test_noise_is_that_of_the_mean_of_two_gauges(made):
    """Larger by its standard error, of three windows a frequency, which is estimated too."""
    problem = wave_problem(made)
    apart = problem.scale[~fitted_rows(problem)]
    # a row held out carries the first pass's noise as well, through half of the window or more
    assert 0.8 * 2e-3 / math.sqrt(2) < np.median(apart) < 2.0 * 2e-3


def test_few_passes_are_held_out_by_frequency(tmp_path):
    case = CASES["mid-length"]
    short = [case.predict[0], case.predict[0] + 2 * PASS_S]
    data = case.record(tmp_path, lambda t, p: images(t, p, 8e-6), 3e-3, predict_s=short)
    problem = wave_problem(data)
    assert problem.held
    assert len(np.unique(problem.group)) == 6
    assert any("bands of frequency" in each for each in problem.warnings)
    for group in problem.held:
        frequency = problem.covariates["frequency"][problem.group == group]
        assert frequency.max() - frequency.min() < 0.5 * problem.covariates["frequency"].max()


def test_models_are_vectorised_nested_and_finite_over_all_bounds(made):
    problem = wave_problem(made)
    plain = problem.baseline
    start = np.array([p.typical for p in plain.parameters])
    rng = np.random.default_rng(0)
    for model in [*problem.candidates, problem.combine(("attached_mass",))]:
        absent = np.concatenate([start, [p.null for p in model.parameters[len(start) :]]])
        np.testing.assert_allclose(model.predict(absent), plain.predict(start), atol=1e-9)
        low, high = (np.array([getattr(p, k) for p in model.parameters]) for k in ("low", "high"))
        corners = np.where(rng.random((64, len(low))) < 0.5, low, high)
        many = model.predict(corners.reshape(2, 32, -1))
        assert many.shape == (2, 32, 1, len(problem.values))
        assert np.all(np.isfinite(many))
        np.testing.assert_allclose(many[1, 3], model.predict(corners[35]), rtol=1e-9, atol=1e-9)


def test_a_record_that_shows_too_little_is_refused(tmp_path):
    case = CASES["mid-length"]
    folders = [tmp_path / name for name in "abc"]
    quiet = case.record(folders[0], lambda t, p: images(t, p, 8e-6))
    with pytest.raises(InputError, match=r"baseline_until_s leaves samples without any noise"):
        wave_problem(quiet)
    flat = case.record(folders[1], lambda t, p: 1e-30 + images(t, p, 8e-6), 50.0)
    with pytest.raises(InputError, match=r"first_pass_s holds no pulse above the noise"):
        wave_problem(flat)
    edge = case.record(
        folders[2], lambda t, p: images(t, p, 8e-6), 1e-3, gauge_x_m=0.9995 * LENGTH_M
    )
    with pytest.raises(InputError, match=r"gauge_x_m lets .* overlap the first pass.* is needed"):
        wave_problem(edge)


def test_effects_that_a_bar_cannot_carry_are_refused(made):
    with pytest.raises(InputError, match="cannot carry air_drag"):
        wave_problem(made).combine(("air_drag",))


@pytest.fixture(scope="module")
def measured():
    return wave_problem(read_waves(MEASURED))


def test_the_bundled_bar_declares_what_is_the_papers():
    manifest = read_manifest(MEASURED)
    assert manifest.bristle.material.beta_s == paper.BETA_S
    assert "Los Alamos" in (MEASURED / "LICENSE").read_text()
    assert (MEASURED / "dataset.toml").stat().st_size < 4000


def residual(problem, effects):
    """Parameters fitted, and what is left of held-out passes, over the signal, both rms."""
    model = problem.combine(effects)
    theta, *_ = fit(model, problem.values, fitted_rows(problem))
    return theta, relative_residual(model, theta, problem.held)


def test_measured_passes_refute_the_declared_damping(measured):
    """The pulse of 10 us spans frequencies up to 1/10 us; declared damping leaves nothing above
    √(2 / (β 40 us)) / 2π = 11 kHz after one pass. So nearly all of it must be missing, and with
    the damping freed the rest must be what bending and noise leave and what the rod still lacks.
    """
    _, before = residual(measured, ())
    theta, after = residual(measured, ("material_damping",))
    assert before > 0.9
    assert after < 0.2 * before
    assert theta[-1] < 1e-7
    # the declared modulus is right to its tolerance, and the gauge where it is said to be
    assert theta[0] == pytest.approx(np.sqrt(71.7e9 / 2810.0), rel=0.01)
    assert abs(theta[1]) < 2e-3
    for other in measured.candidates:
        if "material_damping" not in other.effects:
            assert residual(measured, other.effects)[1] > 0.9


def test_a_mass_at_the_ends_explains_held_out_passes_better_than_the_library(measured):
    effects = ("material_damping", "lateral_inertia")
    _, without = residual(measured, effects)
    assert residual(measured, (*effects, "attached_mass"))[1] < 0.85 * without


def test_the_solid_bar_predicts_the_measured_passes_as_loves_rod_does(measured):
    """Love's rod is the solid to first order in (width / wavelength)², here 2e-3 at most."""
    assert measured.confirm is not None
    damped = measured.combine(("material_damping",))
    theta, *_ = fit(damped, measured.values, fitted_rows(measured))
    passes = np.array(measured.held)
    rows = np.isin(measured.group, passes)
    solid = measured.confirm(damped, theta, passes)
    love = measured.combine((*damped.effects, "lateral_inertia"))
    rod = love.predict(np.append(theta, 1.0))[0, rows]
    plain = damped.predict(theta)[0, rows]
    assert solid.shape == rod.shape
    assert np.linalg.norm(solid - rod) < 0.05 * np.linalg.norm(rod - plain)
    volts, measured_volts = solid * measured.scale[rows], (measured.values * measured.scale)[rows]
    assert np.linalg.norm(volts - measured_volts) < 0.25 * np.linalg.norm(measured_volts)


def test_a_piece_of_a_long_bar_disperses_as_the_bar():
    """Of a bar of a fifth of the length, the ends count five times as much: still little."""
    bar = replace(read_manifest(MEASURED).bristle, length_m=0.4)
    plain = 2 * np.pi * np.array([1e5, 2e5, 3e5]) / bar.material.bar_speed_m_s
    piece = solid_wave_numbers(bar, 3.5e5)(plain) / plain - 1.0
    love = Rod.of(bar)
    omega = plain * bar.material.bar_speed_m_s
    rod = love.wave_number(omega, bar.material.bar_speed_m_s, strength=1.0).real / plain - 1.0
    np.testing.assert_allclose(piece, rod, rtol=0.05)


def test_as_many_values_as_parameters_are_said_to_show_nothing(tmp_path):
    """One arrival of a slow pulse at a second gauge: speed, size and damping take all there is."""
    case = Case([0.2, 0.7], 20e-6, [0.1, 0.7], [0.6, 1.2])
    data = case.record(tmp_path, lambda t, p: images(t, p, case.width_s), 0.2)
    finding = find(wave_problem(data))
    assert len(finding.rows) <= len(finding.parameters)
    assert any("as many free parameters as values" in each for each in finding.warnings)
    assert not finding.noise["finding"]
