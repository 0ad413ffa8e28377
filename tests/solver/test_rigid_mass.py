"""Drops of one rigid mass against closed forms: spring, dashpot, Hunt and Crossley, Hertz, yield,
pull-off; and datasets that declare one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from bristle.solver.bodies.modal import rigid_body
from bristle.solver.bristle import RigidMass
from bristle.solver.contact.laws import Adhesive, Damped, HuntCrossley, Linear, Plastic, Stiffening
from bristle.solver.effects.base import Scene
from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.data.datasets import read_drops, read_manifest
from bristle.studies.loop.fit import to_unit
from bristle.studies.loop.kinds.drops.problem import heights_about
from bristle.studies.loop.responses.rigid import SIDES, RigidEmulator, rigid_emulator

pytestmark = pytest.mark.serial
GRAVITY, HEIGHT = 9.81, 0.2
MARBLE = RigidMass(0.005, 0.016)
# So stiff that the weight does less than 1e-4 of the impact's work.
KN = 1e8
SPEED = math.sqrt(2.0 * GRAVITY * HEIGHT)
CLOSE = 1e-3


def emulator_of(mass=MARBLE, heights=(HEIGHT, HEIGHT), kns=(KN, KN)):
    return RigidEmulator(mass, GRAVITY, *heights, kns, friction=0.0)


def dropped(law, height=HEIGHT, mass=MARBLE):
    """Rebound over height, contact time, peak force."""
    emulator = emulator_of(mass)
    scene = Scene(height_m=height, law=law)
    rows = emulator.observed([scene], emulator.step_s(law.kn_N_m), 0.0)
    return rows[0] / [height, 1.0, 1.0]


def test_a_mass_falls_and_weighs_what_it_does():
    body = rigid_body(MARBLE)
    assert body.mass_kg == pytest.approx(0.005)
    assert body.n_dofs == 1
    assert MARBLE.front_m2 == pytest.approx(math.pi * 0.008**2)
    assert RigidMass(1.0).front_m2 is None
    for wrong in ({"mass_kg": 0.0}, {"mass_kg": math.nan}, {"mass_kg": 1.0, "diameter_m": -1.0}):
        with pytest.raises(InputError, match="must be a positive number"):
            RigidMass(**wrong)


@pytest.mark.parametrize("kn", [1e6, 1e8])
def test_an_undamped_spring_gives_all_back_in_half_a_period(kn):
    """The weight lengthens the contact by 2 g √(m/Kn) / (π v) of it: 2.3e-4 at 1 MN/m."""
    ratio, time, peak = dropped(Linear(kn))
    assert ratio == pytest.approx(1.0, abs=1e-9)
    assert time == pytest.approx(math.pi * math.sqrt(MARBLE.mass_kg / kn), rel=CLOSE)
    assert peak == pytest.approx(SPEED * math.sqrt(kn * MARBLE.mass_kg), rel=CLOSE)
    again = emulator_of().reference(HEIGHT, kn)
    np.testing.assert_allclose([ratio * HEIGHT, time, peak], again, rtol=CLOSE)


@pytest.mark.parametrize("ratio", [0.01, 0.2, 0.6, 0.9])
def test_a_dashpot_that_may_not_pull_lets_go_where_its_force_is_zero(ratio):
    """T. Schwager and T. Pöschel, Granular Matter 9 (2007) 465: e = exp(-ζ ω t), where the force
    ends at t = (π - atan2(2 ζ s, s² - ζ²)) / (s ω), s = √(1 - ζ²); exp(-ζ π / s) to first order."""
    mass = MARBLE.mass_kg
    omega, s = math.sqrt(KN / mass), math.sqrt(1.0 - ratio**2)
    time = (math.pi - math.atan2(2.0 * ratio * s, s * s - ratio**2)) / (s * omega)
    restitution = math.exp(-ratio * omega * time)
    found = dropped(Damped(KN, 2.0 * ratio * math.sqrt(KN * mass)))
    assert found[0] == pytest.approx(restitution**2, rel=2.0 * CLOSE)
    assert found[1] == pytest.approx(time, rel=CLOSE)
    if ratio < 0.05:
        assert found[0] == pytest.approx(math.exp(-2.0 * ratio * math.pi / s), rel=CLOSE)


@pytest.mark.parametrize("damping", [0.05, 0.3, 1.0])
def test_hunt_and_crossleys_law_gives_back_what_its_integral_says(damping):
    """v dv = -(Kn/m) δ (1 + λ v) dδ integrates to (1 + λ v) / (1 - λ e v) = exp(λ v (1 + e))."""
    x = damping * SPEED

    def integral(e):
        return math.log1p(x) - math.log1p(-x * e) - x * (1.0 + e)

    e = brentq(integral, 1e-6, min(1.0, 1.0 / x) * (1.0 - 1e-9))
    assert dropped(HuntCrossley(KN, damping))[0] == pytest.approx(e * e, rel=2.0 * CLOSE)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.5])
def test_a_power_law_gives_all_back_in_the_time_of_its_closed_form(exponent):
    ratio, time, peak = dropped(Stiffening(KN, exponent, 2e-5))
    closed = emulator_of().stiffened(HEIGHT, KN, exponent)
    assert ratio == pytest.approx(1.0, abs=1e-9)
    assert time == pytest.approx(closed[1], rel=5.0 * CLOSE)
    assert peak == pytest.approx(closed[2], rel=CLOSE)
    if exponent == 1.5:  # Johnson's 2.94, and Hertz's stiffness k with δmax^(5/2) = 5 m v² / (4 k)
        k = KN / math.sqrt(2e-5)
        deepest = (1.25 * MARBLE.mass_kg * SPEED**2 / k) ** 0.4
        assert closed[1] == pytest.approx(2.943 * deepest / SPEED, rel=1e-3)
        assert closed[2] == pytest.approx(k * deepest**1.5, rel=1e-9)


IDEAL = (0.0, 1.0)


@pytest.mark.parametrize(
    ("share", "hardening", "unloading"),
    [*((s, *IDEAL) for s in (0.1, 0.5, 0.9)), (0.4, 0.0, 3.0), (0.4, 0.1, 1.0), (0.4, 0.2, 4.0)],
)
def test_what_yields_gives_back_what_it_unloads_by(share, hardening, unloading):
    """½ m v² goes into ½ Y²/Kn, and beyond into Y x + ½ h Kn x²; ½ F²/(u Kn) comes back, and the
    mass rises from the bottom of what flowed."""
    force = share * SPEED * math.sqrt(KN * MARBLE.mass_kg)
    ratio, _, peak = dropped(Plastic(KN, force, hardening, unloading))
    energy, slope = 0.5 * MARBLE.mass_kg * SPEED**2, hardening * KN
    beyond = energy - 0.5 * force**2 / KN
    most = math.sqrt(force**2 + 2.0 * slope * beyond)
    over = 2.0 * beyond / (force + most)
    indented = force / KN + over - most / (unloading * KN)
    back = 0.5 * most**2 / (unloading * KN) / energy
    close = 0.0 if (hardening, unloading) == IDEAL else 5.0 * CLOSE
    assert ratio == pytest.approx(back - indented / HEIGHT, rel=0.01, abs=close)
    assert peak == pytest.approx(most, rel=CLOSE)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_letting_go_costs_the_spring_at_its_pull_off_force(share):
    force = share * SPEED * math.sqrt(KN * MARBLE.mass_kg)
    assert dropped(Adhesive(KN, force))[0] == pytest.approx(1.0 - share**2, abs=2.0 * CLOSE)


def test_shares_make_drops_of_any_mass_stiffness_and_height_alike():
    """But for the weight, a hundredth of the peak force at most here."""
    for name, side in SIDES.items():
        ratios = []
        for mass, kn, height in ((0.005, 1e8, 0.2), (0.3, 1e7, 0.5), (0.05, 1e6, 1.0)):
            speed = math.sqrt(2.0 * GRAVITY * height)
            value = 0.3 * float(side.scale(mass, kn, speed))
            ratios.append(dropped(side.law(kn, value), height, RigidMass(mass))[0])
        assert np.ptp(ratios) < 0.01, name
        assert max(ratios) < 0.95, name


def test_bounds_hold_what_tables_cover():
    heights = (0.5**2 / (2.0 * GRAVITY), 3.0**2 / (2.0 * GRAVITY))
    wide, narrow = emulator_of(MARBLE, heights, (1e4, 1e8)), emulator_of(MARBLE, heights)
    for name in SIDES:
        parameter = EFFECTS[name].parameters[0]
        found = wide.bounded(name, parameter)
        assert found.low < found.typical < found.high
        assert found.low <= found.null <= found.high
        assert found.name == parameter.name
    (damping,) = narrow.parameters("contact_damping")
    assert damping.high == pytest.approx(1.5 * 2.0 * math.sqrt(KN * MARBLE.mass_kg))
    exponent = EFFECTS["stiffening_contact"].parameters[0]
    assert narrow.parameters("stiffening_contact") == (exponent,)


@pytest.mark.parametrize("name", ["contact_damping", "adhesion"])
def test_what_heights_alone_leave_open_is_as_likely_in_every_decade(name):
    """They tell the share of the scale, which grows with √Kn: along it no Kn is the likelier."""
    emulator = emulator_of(kns=(1e3, 1e9))
    parameter = emulator.bounded(name, EFFECTS[name].parameters[0])
    kn = np.geomspace(1e3, 1e9, 7)
    values = 0.05 * emulator.scale(name, np.array(HEIGHT), kn)
    places = to_unit((parameter,), values[:, None])[:, 0]
    np.testing.assert_allclose(np.diff(places), np.diff(places)[0], rtol=1e-9)
    assert places[0] > 0.0
    assert places[-1] < 1.0


def test_effects_of_an_elastic_or_leaning_body_are_not_carried():
    def carried(mass):
        return {name for name in EFFECTS if emulator_of(mass).carries(name)}

    names = carried(MARBLE)
    assert set(EFFECTS) - names == {
        "material_damping",
        "hysteretic_damping",
        "lateral_inertia",
        "bristle_tilt",
        "surface_slope",
    }
    assert names - carried(RigidMass(0.005)) == {"air_drag"}


def write(folder, body, kind="drops", rows=4):
    text = f'[dataset]\ntitle = "made"\nkind = "{kind}"\n[body]\n{body}\n[measurement]\n'
    text += 'file = "drops.csv"\n'
    (folder / "dataset.toml").write_text(text)
    lines = [f"{n},{100 * n},{26 * n}" for n in range(1, rows + 1)]
    (folder / "drops.csv").write_text("\n".join(["drop,y0_mm,y1_mm", *lines]) + "\n")
    return folder


def test_a_dataset_declares_a_ball(tmp_path):
    folder = write(tmp_path, 'shape = "rigid"\nmass_kg = 0.005\ndiameter_m = 0.016')
    data = read_drops(folder)
    assert data.manifest.body == MARBLE
    assert data.manifest.declared == ("diameter_m", "mass_kg", "shape")
    with pytest.raises(InputError, match=r"dataset.toml:5: shape is rigid: .* needs a bristle"):
        _ = data.manifest.bristle


def test_a_heavy_ball_falls_on_what_carries_its_weight(tmp_path):
    """A bowling ball's tables are made, even that of dents of which it does not come up again."""
    folder = write(tmp_path, 'shape = "rigid"\nmass_kg = 5.0\ndiameter_m = 0.216')
    place = heights_about(read_drops(folder).y0_m)
    made = rigid_emulator(RigidEmulator, read_manifest(folder, "drops"), *place)
    softest = made.kn_range_N_m[0]
    assert 5.0 * made.gravity_m_s2 / softest == pytest.approx(0.1 * place[0])
    (table,) = made.of("plastic_contact")
    kn, share, height = 1e8, 0.5, 0.2
    (ratio, *_) = np.exp(table.at(*map(np.array, (height, kn, share))))
    force = share * math.sqrt(2.0 * made.gravity_m_s2 * height * kn * 5.0)
    indented = 5.0 * made.gravity_m_s2 * height * (1.0 - share**2) / force
    assert ratio == pytest.approx(share**2 - indented / height, rel=0.01)


def test_a_bristle_is_what_it_was(tmp_path):
    manifest = read_manifest(write(tmp_path, "length_m = 0.2\nwidth_m = 0.002"))
    assert manifest.body is manifest.bristle
    assert manifest.bristle.length_m == 0.2
    shaped = read_manifest(write(tmp_path, 'shape = "bristle"\nlength_m = 0.2\nwidth_m = 0.002'))
    assert shaped.bristle == manifest.bristle


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('shape = "rigid"', r":5: shape of rigid needs mass_kg"),
        ('shape = "rigid"\nmass_kg = 0', r":6: mass_kg must be positive"),
        ('shape = "rigid"\nmass_kg = "1"', r":6: mass_kg must be a finite number"),
        ('shape = "rigid"\nmass_kg = 1\ndiameter_m = -1', r":7: diameter_m must be positive"),
        (
            'shape = "rigid"\nmass_kg = 1\ndamping_beta_s = 1e-5',
            r":7: damping_beta_s is not for a rigid body",
        ),
        ('shape = "rigid"\nmass_kg = 1\nlength_m = 0.1', r":7: length_m is not for a rigid body"),
        ('shape = "cube"\nmass_kg = 1', r":5: shape must be one of bristle, rigid, not 'cube'"),
        ("mass_kg = 1", r":5: mass_kg is for shape = \"rigid\" alone"),
    ],
)
def test_a_body_that_is_not_one_is_refused_by_its_line(tmp_path, body, words):
    with pytest.raises(InputError, match=words):
        read_manifest(write(tmp_path, body))
