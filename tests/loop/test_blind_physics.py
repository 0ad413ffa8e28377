"""The blind benchmark's own physics against closed forms, facts found by other programs, and the
program that it is to test."""

import math
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from blind.body import Body, bending
from blind.drops import Truth, bounce, seen, speed_down, with_effect
from blind.leaning import Lean, land
from blind.upright import (
    ADHESIVE,
    DASHPOT,
    HUNT_CROSSLEY,
    LINEAR,
    PLASTIC,
    POWER,
    Law,
    impact,
)
from contact_law_helpers import closed_form

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle
from bristle.solver.contact import laws
from bristle.solver.effects.base import Scene
from bristle.solver.effects.library import EFFECTS
from bristle.solver.fall import fallen, risen
from bristle.studies.loop.responses.table_drops import outcomes_of, quantities

pytestmark = pytest.mark.serial
G = 9.8
SPEED = math.sqrt(2.0 * G * 0.05)
# So soft that a bristle is a rigid mass to some parts in a thousand.
SOFT = 1e4


def ratio(body, law, height=0.05, **options):
    done = impact(body, law, math.sqrt(2.0 * G * height), **options)
    return (done.lift_m + done.speed_m_s**2 / (2.0 * G)) / height


def test_nothing_of_the_program_is_imported():
    code = "import blind.leaning, blind.drops, blind.films, blind.make; print(*sys.modules)"
    path = next(each for each in sys.path if each.endswith("reference"))
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {path!r}); {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "blind.leaning" in done.stdout.split()
    assert not [name for name in done.stdout.split() if name.split(".")[0] == "bristle"]


@pytest.mark.parametrize(
    ("kn", "expected"), [(2e6, 0.6555), (1e8, 0.3217), (1e4, 0.9997), (1e12, 0.313)]
)
@pytest.mark.parametrize("height", [0.01, 0.05])
def test_rebound_of_the_papers_bristle(kn, expected, height):
    assert ratio(Body(), Law(LINEAR, kn), height) == pytest.approx(expected, abs=5e-4)


def rigid(law, speed=SPEED):
    """The impact of a bar that is all but rigid beside the contact, without gravity."""
    return impact(Body(beta_s=0.0, youngs_Pa=2e15), law, speed, 0.0, dt_s=2e-7, modes=8)


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        (LINEAR, laws.Linear(SOFT)),
        (DASHPOT, laws.Damped(SOFT, 2.0)),
        (HUNT_CROSSLEY, laws.HuntCrossley(SOFT, 0.4)),
        (POWER, laws.Stiffening(SOFT, 1.7)),
        (PLASTIC, laws.Plastic(SOFT, 2.0)),
        (PLASTIC, laws.Plastic(SOFT, 2.0, 0.1, 3.0)),
        (ADHESIVE, laws.Adhesive(SOFT, 1.5)),
    ],
    ids=str,
)
def test_a_rigid_bar_bounces_as_closed_forms_say(kind, law):
    exact = closed_form(law, Body().mass_kg, SPEED)
    kn, *numbers = (getattr(law, each.name) for each in fields(law))
    done = rigid(Law(kind, kn, *(numbers[:1] if kind == POWER else numbers)))
    assert done.speed_m_s == pytest.approx(exact.kept * SPEED, rel=5e-3)
    assert done.contact_time_s == pytest.approx(exact.time_s, rel=5e-3)
    if kind != DASHPOT:
        assert done.peak_force_N == pytest.approx(exact.peak_N, rel=2e-3)


def test_bending_modes_of_a_free_bar():
    """Roots of Graff, table 3.1; and what slopes draw in: a turn by ψ shortens by ψ² L/4 to the
    centre of mass."""
    body = Body()
    found = bending(body, body.thickness_m)
    radius = math.sqrt(body.youngs_Pa / body.density_kg_m3 / 12.0) * body.thickness_m
    roots = np.sqrt(found.omega[1:5] * body.length_m**2 / radius)
    assert roots == pytest.approx([4.73004, 7.85320, 10.9956, 14.1372], rel=1e-5)
    assert found.tip[1:5] * math.sqrt(body.mass_kg) == pytest.approx([2.0] * 4)
    # slope at the end over tip, of the first mode: 0.98250 × 4.73004
    slope = found.slope[1] / found.tip[1] * body.length_m
    assert slope == pytest.approx(-4.6473, rel=1e-4)
    psi = 0.03
    drawn = 0.5 * (psi / found.slope[0]) ** 2 * found.shortens[0, 0]
    assert drawn == pytest.approx(0.25 * psi**2 * body.length_m, rel=1e-6)


def test_upright_both_marches_agree():
    for kn in (1e5, 2e6):
        one = impact(Body(), Law(LINEAR, kn), SPEED)
        two = land(Body(), kn, Lean(), SPEED)
        assert two.speed_m_s == pytest.approx(one.speed_m_s, rel=2e-4)
        assert two.contact_time_s == pytest.approx(one.contact_time_s, rel=2e-3)
        assert two.peak_force_N == pytest.approx(one.peak_force_N, rel=1e-3)


def test_without_damping_and_friction_a_lean_keeps_its_energy():
    """Of all that bends and turns in it."""
    done = land(Body(beta_s=0.0), 2e6, Lean(3.0), SPEED, dt_s=1e-7)
    assert done.energy_J == pytest.approx(0.5 * Body().mass_kg * SPEED**2, rel=1e-6)


SAME = {
    "air_drag": 60.0,
    "release_velocity": 0.3,
    "height_offset": 2e-3,
    "scale_error": 0.05,
    "clock_error": 0.02,
    "contact_damping": 8.0,
    "hunt_crossley": 0.4,
    "stiffening_contact": 1.7,
    "plastic_contact": 20.0,
    "adhesion": 8.0,
    "material_damping": 3e-6,
    "hysteretic_damping": 0.1,
    "bristle_tilt": 2.0,
    "surface_slope": 3.0,
    "surface_phases": 0.3,
    "wear": 1.0,
    "session": 0.2,
}


@pytest.fixture(scope="module")
def beam():
    """The program's beam, finer than the loop takes it, so that leaning has converged."""
    return beam_body(Bristle(), 64, points=8, second_order=True)


@pytest.mark.parametrize("name", SAME)
def test_a_name_means_the_same_physics_as_in_the_program(beam, name):
    """Two programs that share no line. Where a bristle leans, points of the face in a row of their
    own let go at other instants, and Timoshenko's beam is a little softer."""
    value, kn, height, order, luck = SAME[name], 2e6, 0.04, 30, (0.7, -0.4)
    leans = name in ("bristle_tilt", "surface_slope")
    friction = 0.3 if leans else 0.0
    truth = with_effect(Truth(kn_N_m=kn, friction=friction), name, value)
    mine = seen(truth, np.array([height]), np.array([luck]))[0]
    if name == "wear":  # whose drop is not the first
        mine[1:] = bounce(truth, speed_down(truth, height, 0.0), order, luck)
    if name == "session":  # whose drop is of the second one
        mine = seen(truth, np.full(2, height), np.array([luck, luck]))[1]
    scene = Scene(height, order, luck, beta_s=Body().beta_s, law=laws.Linear(kn))
    scene = EFFECTS[name](value).enter(scene)
    drag, start = scene.drag_kg_m / Body().mass_kg, scene.release_speed_m_s
    same = fallen(np.array([height]), G, np.array([start]), np.array([drag]))
    fall = replace(scene, height_m=float(same[0]))
    top, time, force = quantities(outcomes_of(beam, [fall], G, 2.5e-7, friction))[0]
    read = scene.y_scale * (np.array([height, float(risen(top, drag))]) + scene.y_offset_m)
    assert mine[:2] == pytest.approx(read, rel=3e-3 if leans else 5e-4)
    assert mine[2] == pytest.approx(scene.t_scale * time, rel=1e-2 if leans else 5e-4)
    assert mine[3] == pytest.approx(force, rel=2e-3)
