"""The clamped solid: a cantilever's deflection and modes, and the rod of a brush beside it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from rod_helpers import equilibrium, leaning, one_clamp, slide
from solids import frequencies_hz

from bristle.meshes.section import Circle
from bristle.solver.bristle import Bristle
from bristle.solver.clamped import ClampedSolid, RodState
from bristle.solver.errors import InputError
from bristle.solver.rods.chain import at_rest, uniform_chain
from bristle.solver.rods.ground import Ground
from bristle.solver.rods.hub import Clamps, HubPath
from bristle.solver.rods.section import RodSection
from bristle.studies.reproduce.dragged import compare, pressed_dragged_let_go

LEAN = leaning(0.3)
# The least root of cos β cosh β = -1.
ROOT = 1.8751040687


@pytest.fixture(scope="module")
def cantilever(bristle):
    clamp = one_clamp([0.1, 0.0, 0.5], LEAN, bristle.length_m)
    solid = ClampedSolid(bristle, clamp, HubPath.still(), None, (1, 1, 120))
    yield solid
    solid.close()


def test_the_first_bending_mode_is_eulers_and_bernoullis(bristle, cantilever):
    """3.675 Hz; the clamp holds the section's shape too, which stiffens the solid a little."""
    section = RodSection.of(bristle)
    speed = math.sqrt(section.EI2_Nm2 / section.rhoA_kg_m)
    exact = ROOT**2 * speed / (2.0 * math.pi * bristle.length_m**2)
    matrices = cantilever.matrices()
    first, second, *_ = frequencies_hz(*matrices, 0.0, 2)
    for matrix in matrices:
        matrix.destroy()
    assert first == pytest.approx(exact, rel=1e-3)
    # about the strong axis
    assert second == pytest.approx(
        exact * bristle.section.width_m / bristle.section.thickness_m, rel=2e-3
    )


def test_an_end_load_bends_it_as_the_rod(bristle, cantilever):
    """By about the table's 0.55500 and 0.81061 of the length under 10 EI/L², and near the rod."""
    section, length = RodSection.of(bristle), bristle.length_m
    thin, axis = LEAN[:, 0], LEAN[:, 2]
    load = 10.0 * section.EI2_Nm2 / length**2 * thin
    chain = uniform_chain(section, length, 80)
    root = np.array([0.1, 0.0, 0.5])
    x, q = at_rest(chain, root, LEAN)
    loads = np.zeros((81, 6))
    loads[-1, :3] = load
    x, q = equilibrium(chain, x, q, loads, steps=10)
    still, free = np.zeros((81, 6)), np.zeros(4, dtype=np.int8)
    cantilever.settle(RodState(x, q, still, still, still, free, np.zeros((4, 3))), load)
    tip = cantilever.state().tip_m - root
    assert np.linalg.norm(tip - (x[-1] - root)) < 1e-3 * length
    assert tip @ thin == pytest.approx(0.81061 * length, rel=2e-3)
    assert length - tip @ axis == pytest.approx(0.55500 * length, rel=4e-3)
    assert cantilever.state().force_N == pytest.approx(load, rel=1e-4)


def test_ranks_share_one_solid_in_contact(bristle):
    """Pressed down while it slides: as many ranks as there are do what one does."""
    path, height = slide(1e-4, 1.0, 1e-3, 1e-3), bristle.length_m * math.cos(0.3)
    clamp = one_clamp([0.0, 0.0, height + 5e-6], LEAN, bristle.length_m)
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        solid = ClampedSolid(bristle, clamp, path, Ground(), (1, 1, 12), comm=comm)
        for _ in range(8):
            solid.step(2e-5)
        found.append(solid.state())
        solid.close()
    assert found[0].normal_N > 1e-3
    for name in ("force_N", "torque_Nm", "tip_m", "normal_N"):
        assert getattr(found[0], name) == pytest.approx(getattr(found[1], name), abs=1e-6)


@pytest.mark.serial
def test_a_dragged_rod_goes_where_the_solid_goes():
    """Pressed, dragged at 1 m/s and let go within 5 ms: tips within 0.5 % of their path, the hub's
    force and torque within 2 %; both let go, at the same time."""
    rod_of_40 = pressed_dragged_let_go().model_copy(update={"elements": 40})
    found = compare(rod_of_40, (1, 1, 60), step_s=2.5e-5)
    assert found.tip_error < 5e-3
    assert found.force_error < 0.02
    assert found.torque_error < 0.02
    assert found.normal_error < 0.02
    rod, solid = found.gone_s
    assert rod == pytest.approx(solid, abs=1e-4)
    # the window is one of contact and of none, and its force is not at rest
    assert 1e-3 < solid < 4e-3
    assert np.ptp(found.force_N[1][:, 2]) > 1.0


def test_what_it_cannot_be_is_refused(bristle):
    two = Clamps(np.zeros((2, 3)), np.tile(LEAN, (2, 1, 1)), np.full(2, 0.3))
    for body, clamps, words in (
        (replace(bristle, section=Circle(1e-3)), one_clamp([0, 0, 1], LEAN, 0.3), "rectangular"),
        (Bristle(), two, "one bristle, not 2"),
    ):
        with pytest.raises(InputError, match=words):
            ClampedSolid(body, clamps, HubPath.still(), Ground())
