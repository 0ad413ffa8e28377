"""Drops of one rigid mass against closed forms: spring, dashpot, Hunt and Crossley, Hertz, yield,
pull-off; and datasets that declare one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from contact_law_helpers import closed_form

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


MOST = SPEED * math.sqrt(KN * MARBLE.mass_kg)
LAWS = [
    *map(Linear, (1e6, KN)),
    *(Damped(KN, 2.0 * zeta * MOST / SPEED) for zeta in (0.01, 0.2, 0.6, 0.9)),
    *(HuntCrossley(KN, damping) for damping in (0.05, 0.3, 1.0)),
    *(Stiffening(KN, exponent, 2e-5) for exponent in (1.0, 1.5, 2.5)),
    *(Plastic(KN, share * MOST) for share in (0.1, 0.5, 0.9)),
    *(Plastic(KN, 0.4 * MOST, *how) for how in ((0.0, 3.0), (0.1, 1.0), (0.2, 4.0))),
    *(Adhesive(KN, share * MOST) for share in (0.1, 0.5, 0.9)),
]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_mass_bounces_as_without_weight(law):
    """The closed forms of bounces. The weight lengthens the contact by 2 g √(m/Kn) / (π v) of it,
    2.3e-4 at 1 MN/m; the mass rises from where contact lets it go."""
    exact = closed_form(law, MARBLE.mass_kg, SPEED)
    ratio, time, peak = dropped(law)
    close, at_least = 2.0 * CLOSE, 0.0
    if exact.kept == 1.0:
        close = 1e-9
    elif isinstance(law, Plastic):
        close, at_least = 0.01, 5.0 * CLOSE * (law.hardening > 0.0 or law.unloading > 1.0)
    rises = exact.kept**2 - exact.left_m / HEIGHT * isinstance(law, Plastic)
    assert ratio == pytest.approx(rises, rel=close, abs=at_least)
    late = 5.0 if isinstance(law, Stiffening) else 1.0
    assert time == pytest.approx(exact.time_s, rel=late * CLOSE)
    if not isinstance(law, Damped):
        assert peak == pytest.approx(exact.peak_N, rel=CLOSE)


def test_closed_forms_of_the_tables_are_those():
    for kn in (1e6, KN):
        exact = closed_form(Linear(kn), MARBLE.mass_kg, SPEED)
        told = [HEIGHT, exact.time_s, exact.peak_N]
        np.testing.assert_allclose(emulator_of().reference(HEIGHT, kn), told, rtol=CLOSE)
    for exponent in (1.0, 1.5, 2.5):
        exact = closed_form(Stiffening(KN, exponent, 2e-5), MARBLE.mass_kg, SPEED)
        told = emulator_of().stiffened(HEIGHT, KN, exponent)[1:]
        np.testing.assert_allclose(told, [exact.time_s, exact.peak_N], rtol=1e-9)


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
