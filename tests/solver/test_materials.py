"""Materials by name: where they enter, and the damping that their loss factor means."""

import math

import numpy as np
import pytest

from bristle.solver import paper
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.materials import MATERIALS
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.limits import input_warnings
from bristle.studies.inputs.sources import checked

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("name", [each for each in MATERIALS if MATERIALS[each].loss_factor])
@pytest.mark.parametrize("length_m", [0.05, 0.5])
def test_the_first_axial_mode_has_the_loss_factor(name, length_m):
    """The damping over the frequency of the beam's own mode."""
    typical = MATERIALS[name]
    inputs = checked(DropInputs, {"material": name, "length_m": length_m, "model": "beam"})
    material = inputs.bristle().material
    assert (material.youngs_Pa, material.poisson) == (typical.youngs_Pa, typical.poisson)
    body = beam_body(Bristle(length_m, inputs.end_section(), material), 16)
    axial_1_s = math.pi * math.sqrt(typical.youngs_Pa / typical.density_kg_m3) / length_m
    mode = np.argmin(np.abs(body.omega2 - axial_1_s**2))
    loss = body.damping_1_s[mode] / np.sqrt(body.omega2[mode])
    assert loss == pytest.approx(typical.loss_factor, rel=1e-3)
    assert not any("--beta" in each for each in input_warnings(inputs))


def test_steel_is_the_papers_and_what_is_given_wins():
    steel = checked(DropInputs, {"material": "steel"})
    assert steel.bristle().material == Material() == DropInputs().bristle().material
    own = checked(DropInputs, {"material": "nylon", "youngs_Pa": 1e9, "beta_s": 0.0})
    assert (own.youngs_Pa, own.beta_s, own.density_kg_m3) == (1e9, 0.0, 1130.0)
    assert MATERIALS["steel"].damping_s(1.0) == paper.BETA_S
