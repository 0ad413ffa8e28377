"""Reference programs, which share no code with this one, come to the same impact."""

import json
import re
from pathlib import Path

import calculix
import numpy as np
import pytest
from commands import python
from impact import AREA_M2, Impact, March, answer

import bristle
from bristle.solver import paper

pytestmark = pytest.mark.serial
FOLDER = Path(calculix.__file__).parent
CELLS = (1, 1, 12)


def run(name: str, its_s: float, beta_s: float = paper.BETA_S) -> dict:
    done = python(FOLDER / f"{name}.py", "--cells", *CELLS, "--its", its_s, "--beta", beta_s)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def own(its_s: float, scheme: str) -> dict:
    found = bristle.drop(model="solid", cells=CELLS, its_s=its_s, scheme=scheme)
    return {**found, "rebound_ratio": found.cm_rebound_ratio}


@pytest.mark.parametrize("name", ["naive_dolfinx", "plain_scipy"])
def test_on_the_same_mesh_and_scheme_they_agree_to_rounding(name):
    # Newmark's average acceleration with the contact force at the end of the step is the scheme
    # of both; what differs is who assembled, and how the nodes share out a flat face's stiffness
    theirs, ours = run(name, 1e-5), own(1e-5, "newmark")
    assert theirs["n_dofs"] == ours["n_dofs"]
    for quantity in ("rebound_ratio", "peak_force_N"):
        assert theirs[quantity] == pytest.approx(ours[quantity], rel=1e-6)


def test_the_answer_of_a_rigid_body_on_its_spring_is_in_closed_form():
    impact = Impact(its_s=1e-7, until_s=2e-2, kn_N_m=1e4)
    mass = paper.DENSITY_KG_M3 * AREA_M2 * paper.LENGTH_M
    omega, t = np.sqrt(impact.kn_N_m / mass), impact.t_s
    sag = mass * paper.GRAVITY_M_S2 / impact.kn_N_m
    height = sag * (np.cos(omega * t) - 1.0) - impact.speed_m_s / omega * np.sin(omega * t)
    free = np.argmax(height > 0.0)
    height[free:] = np.abs(height[free:])
    found = answer(impact, March(t, impact.kn_N_m * np.maximum(-height, 0.0), height, 0))
    assert found["rebound_ratio"] == pytest.approx(1.0, abs=1e-4)
    depth = sag + np.hypot(sag, impact.speed_m_s / omega)
    assert found["peak_force_N"] == pytest.approx(impact.kn_N_m * depth, rel=1e-6)
    touching = 2.0 * (np.pi - np.arctan(impact.speed_m_s * omega / paper.GRAVITY_M_S2)) / omega
    assert found["contact_time_s"] == pytest.approx(touching, rel=1e-6)


@pytest.mark.parametrize(("order", "per_cell"), [(1, 8), (2, 20)])
def test_the_deck_of_calculix_is_a_whole_impact(order, per_cell):
    impact = Impact(cells=(1, 2, 5), order=order, beta_s=0.0)
    number, elements = calculix.nodes_and_elements(impact)
    assert {len(each) for each in elements} == {per_cell}
    assert sorted({n for each in elements for n in each}) == list(range(1, len(number) + 1))
    parts = dict(re.findall(r"^(\*[^\n]+)\n([^*]*)", calculix.deck(impact), re.MULTILINE))
    nodes = np.array(
        [line.split(",") for line in parts["*NODE, NSET=BRISTLE"].split("\n")[:-1]], float
    )
    span = np.ptp(nodes[:, 1:], axis=0)
    assert span == pytest.approx([paper.THICKNESS_M, paper.WIDTH_M, paper.LENGTH_M])
    # every element turns right-handed round a positive volume, or ccx would refuse it
    corner = {int(n): x for n, *x in nodes}
    for each in elements:
        a, b, c, d = (np.array(corner[each[i]]) for i in (0, 1, 3, 4))
        assert np.linalg.det([b - a, c - a, d - a]) > 0.0
    # the tip's faces are the first elements', and stand on the block's upper face
    assert np.count_nonzero(nodes[:, 3] == 0.0) == len(parts["*NSET, NSET=TIP"].split())
    assert parts["*SURFACE, NAME=FACE, TYPE=ELEMENT"].split() == ["1,", "S1", "2,", "S1"]
    block = np.array(
        [line.split(",") for line in parts["*NODE, NSET=BLOCK"].split("\n")[:-1]], float
    )
    assert block[4:, 3].tolist() == [0.0] * 4
    # Kn over the face, the speed of the fall, and the step
    slope = float(parts["*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"])
    assert slope * AREA_M2 == pytest.approx(impact.kn_N_m)
    speed = parts["*INITIAL CONDITIONS, TYPE=VELOCITY"].split(",")
    assert float(speed[2]) ** 2 / (2.0 * paper.GRAVITY_M_S2) == pytest.approx(impact.height_m)
    first, total, _, longest = map(float, parts["*DYNAMIC, ALPHA=0."].split(","))
    assert (first, total, longest) == (impact.its_s, impact.until_s, impact.its_s)
    assert "*DAMPING" not in parts


def test_calculix_is_not_asked_for_damping():
    # it would damp the contact spring too, which is another impact
    with pytest.raises(SystemExit, match="--beta 0"):
        calculix.deck(Impact())


def test_what_calculix_prints_is_read():
    text = """
 total force (fx,fy,fz) for set BLOCK and time  0.1000000E-04

        0.000000E+00  0.000000E+00  1.500000E+01

 displacements (vx,vy,vz) for set TIP and time  0.1000000E-04

         1 -5.1E-09 -2.1E-08 -7.0E-06
         2  9.0E-21 -2.1E-08 -8.0E-06

 total force (fx,fy,fz) for set BLOCK and time  0.1500000E-04

        0.000000E+00  0.000000E+00  0.000000E+00

 displacements (vx,vy,vz) for set TIP and time  0.1500000E-04

         1 -5.1E-09 -2.1E-08  7.0E-06
         2  9.0E-21 -2.1E-08  8.0E-06
"""
    march = calculix.seen(Impact(beta_s=0.0), calculix.tables(text))
    assert list(march.t_s) == [1e-5, 1.5e-5]
    assert list(march.force_N) == [15.0, 0.0]
    assert list(march.tip_m) == pytest.approx([-7.5e-6, 7.5e-6])


def test_without_ccx_calculix_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    done = python(FOLDER / "calculix.py", "--beta", 0)
    assert done.returncode == calculix.NOT_INSTALLED
    assert "not installed" in done.stderr
