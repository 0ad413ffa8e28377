"""The loop reads records of impact force, and tells effects apart by their shapes.

The records are made by `force_data`: the beam's drops at shorter steps than the tables'.
"""

from __future__ import annotations

import film_data
import force_data
import numpy as np
import pytest
from model_fit import fit
from scipy.stats import chi2

from bristle.solver.bristle import Bristle
from bristle.solver.effects.library import EFFECTS
from bristle.studies.loop.kinds.forces.problem import forces_problem
from bristle.studies.loop.kinds.forces.record import read_forces
from bristle.studies.loop.responses import force_curves
from bristle.studies.loop.responses.emulator import Emulator
from bristle.studies.loop.responses.force_curves import ForceEmulator, force_history
from bristle.studies.loop.responses.table_drops import beam_of, outcomes_of
from bristle.studies.loop.run import find

KN = 2e6
SIGMA_N = 0.5
KEYS = f"sigma_force_N = {SIGMA_N}\n"
FEW = ("contact_damping", "release_velocity", "scale_error", "clock_error", "wear")
pytestmark = pytest.mark.serial


def written(folder, effects, seed=3, drops=24, **how):
    rng = np.random.default_rng(seed)
    scenes = film_data.scenes(drops, KN, effects, rng)
    records = [force_data.record(scene, rng, sigma_N=SIGMA_N, **how) for scene in scenes]
    heights = [force_data.seen_height(scene, rng) for scene in scenes]
    return force_data.write(folder / "forces", records, heights, KEYS), records


def made(folder, effects, library=FEW, **how):
    path, records = written(folder, effects, **how)
    return forces_problem(read_forces(path), library), records


def fitted(problem, names):
    """Estimates, their deviations and what is left of a model."""
    return fit(problem.combine(names), problem.values)


@pytest.mark.parametrize("effects", [{}, {"contact_damping": 8.0}, {"bristle_tilt": 2.0}])
def test_histories_have_the_impulse_and_peak_of_the_drop(effects):
    scene = film_data.scenes(1, KN, effects, np.random.default_rng(0))[0]
    t, impulse = force_history(Bristle(), scene, film_data.GRAVITY, film_data.FRICTION, 5e-7, 1e-3)
    body = beam_of(Bristle())
    found = outcomes_of(body, [scene], film_data.GRAVITY, 5e-7, film_data.FRICTION)
    assert impulse[-1] == pytest.approx(found.impulse_N_s[0], rel=1e-3)
    steepest = np.max(np.diff(impulse) / np.maximum(np.diff(t), 1e-9))
    assert steepest == pytest.approx(found.peak_force_N[0], rel=1e-2)


def test_a_dashpot_presses_at_once_and_a_spring_does_not():
    rng = np.random.default_rng(0)
    first = {}
    for name in ({}, {"contact_damping": 8.0}):
        scene = film_data.scenes(1, KN, name, rng)[0]
        t, impulse = force_history(
            Bristle(), scene, film_data.GRAVITY, film_data.FRICTION, 2.5e-7, 1e-3
        )
        first[len(name)] = np.interp(1e-6, t, impulse) / 1e-6
    assert first[1] > first[0] + 3.0


def test_rows_are_unit_noise_about_the_truth(tmp_path):
    problem, records = made(tmp_path, {})
    left = problem.values - problem.baseline.predict(np.array([KN]))[0]
    low, high = chi2.ppf([0.0005, 0.9995], left.size)
    assert low < left @ left < high
    # the touch is found to a fraction of the contact's 150 µs
    errors = np.array(problem.notes["touch_s"]) - [touch for *_, touch in records]
    assert np.abs(errors).max() < 3e-6
    # shapes hold the records: what is left of the samples is noise
    assert problem.notes["left"] / problem.notes["freedom"] == pytest.approx(1.0, abs=0.05)


SIZES = {
    "contact_damping": 5.0,
    "release_velocity": 0.2,
    "scale_error": 0.05,
    "clock_error": 0.03,
    "wear": 0.8,
}


@pytest.mark.parametrize("name", SIZES)
def test_effects_are_recovered(name, tmp_path):
    """The size to a tenth, or three standard deviations, and it alone leaves little."""
    problem, _ = made(tmp_path, {name: SIZES[name]})
    theta, spread, left = fitted(problem, (name,))
    assert abs(theta[1] - SIZES[name]) < max(3 * spread[1], 0.1 * SIZES[name])
    for other in FEW:
        if other != name:
            assert fitted(problem, (other,))[2] > left + 20


def test_coarse_samples_serve(tmp_path):
    """20 µs apart, seven samples of the impact: a stiffness to some per cent."""
    problem, _ = made(tmp_path, {}, step_s=2e-5)
    theta, spread, _ = fitted(problem, ())
    assert abs(np.log(theta[0] / KN)) < max(3 * spread[0], 0.02)


def test_what_refines_an_effect_is_not_in_tables_of_histories(monkeypatch):
    """They would take a quarter of an hour; errors stated are those of the yield force alone."""
    few = {"KN_NODES": 4, "HELD_NODES": 4, "ITS_S": 4e-6, "CHECKS": 1}
    for name, value in few.items():
        monkeypatch.setattr(force_curves, name, value)
    monkeypatch.delattr(Emulator, "refined")
    emulator = ForceEmulator(Bristle(), 9.8, 0.02, 0.05, (1e6, 4e6))
    names = ["plastic_contact"]
    errors = force_curves.table_errors(force_curves.with_shapes(emulator, names), names, KN)
    assert np.isfinite(errors).all()
    assert errors.any()


@pytest.mark.campaign
def test_every_effect_of_the_kind_is_a_candidate(tmp_path):
    problem, _ = made(tmp_path, {}, library=None)
    names = {name for each in problem.candidates for name in each.effects}
    assert names == {name for name, effect in EFFECTS.items() if "forces" in effect.kinds}


@pytest.mark.campaign
def test_clean_records_are_adequate(tmp_path):
    assert str(find(made(tmp_path, {}, library=None)[0]).verdict) == "adequate"


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("contact_damping", 5.0),
        ("hunt_crossley", 0.3),
        ("stiffening_contact", 1.3),
        ("adhesion", 3.0),
        ("bristle_tilt", 2.0),
    ],
)
def test_contact_laws_are_told_apart(name, size, tmp_path):
    found = find(made(tmp_path, {name: size}, library=None)[0])
    assert found.effects[:1] == (name,)
