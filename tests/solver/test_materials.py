"""Materials by name: where they enter, and the damping that their loss factor means."""

import json
import math

import numpy as np
import pytest

from bristle.solver import paper
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.materials import MATERIALS
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.fields import DROP_FLAGS
from bristle.studies.inputs.limits import input_warnings
from bristle.studies.inputs.sources import checked, inputs_of
from bristle.studies.running.results import plain_inputs

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("name", [each for each in MATERIALS if MATERIALS[each].loss_factor])
@pytest.mark.parametrize("length_m", [0.05, 0.5])
@pytest.mark.parametrize("given", [{}, {"youngs_Pa": 1.1e9}, {"density_kg_m3": 2000.0}], ids=str)
def test_the_first_axial_mode_has_the_loss_factor(name, length_m, given):
    """The damping over the frequency of the beam's own mode."""
    typical = MATERIALS[name]
    asked = {"material": name, "length_m": length_m, "model": "beam", **given}
    inputs = checked(DropInputs, asked)
    material = inputs.bristle().material
    assert material.poisson == typical.poisson
    assert material.youngs_Pa == given.get("youngs_Pa", typical.youngs_Pa)
    body = beam_body(Bristle(length_m, inputs.end_section(), material), 16)
    axial_1_s = math.pi * math.sqrt(material.youngs_Pa / material.density_kg_m3) / length_m
    mode = np.argmin(np.abs(body.omega2 - axial_1_s**2))
    loss = body.damping_1_s[mode] / np.sqrt(body.omega2[mode])
    assert loss == pytest.approx(typical.loss_factor, rel=1e-3)
    assert not any("--beta" in each for each in input_warnings(inputs))


def test_steel_is_the_papers_and_what_is_given_wins():
    steel = checked(DropInputs, {"material": "steel"})
    assert steel.bristle().material == Material() == DropInputs().bristle().material
    own = checked(DropInputs, {"material": "nylon", "youngs_Pa": 1e9, "beta_s": 0.0})
    assert (own.youngs_Pa, own.beta_s, own.density_kg_m3) == (1e9, 0.0, 1130.0)
    assert MATERIALS["steel"].damping_s(1.0, 1e9, 1e3) == paper.BETA_S


def test_damping_follows_what_is_changed_in_an_earlier_run_unless_it_was_given(tmp_path):
    """And what a TOML file gives stays, whatever the flags name."""
    first = tmp_path / "result.json"
    toml = tmp_path / "own.toml"
    toml.write_text("youngs = 1e9\nbeta = 0.0\n")

    def repeated(config, **given):
        return inputs_of(DropInputs, given, DROP_FLAGS, config)

    def asked(**values):
        return checked(DropInputs, {"material": "nylon", **values})

    def written(inputs):
        first.write_text(json.dumps({"inputs": plain_inputs(inputs)}))

    written(asked(length_m=0.1))
    assert repeated(first).beta_s == asked(length_m=0.1).beta_s
    assert repeated(first, length=0.3).beta_s == asked(length_m=0.3).beta_s
    assert repeated(first, youngs=1e9).beta_s == asked(length_m=0.1, youngs_Pa=1e9).beta_s
    assert repeated(first, material="stainless").youngs_Pa == 200e9
    assert repeated(first, height=0.01).beta_s == asked(length_m=0.1).beta_s
    written(asked(length_m=0.1, beta_s=1e-7))
    assert repeated(first, length=0.3).beta_s == 1e-7
    own = repeated(toml, material="nylon")
    assert (own.youngs_Pa, own.beta_s, own.density_kg_m3) == (1e9, 0.0, 1130.0)
