"""The hub's prescribed motion, its clamps, and what is refused of them."""

import numpy as np
import pytest
from rod_helpers import press, rotate, slide
from scipy.spatial.transform import Rotation

from bristle.solver.errors import InputError
from bristle.solver.rods.hub import Clamps, HubPath

# one rod, which no rank shares
pytestmark = pytest.mark.serial

TURNED = rotate(0.01, 100.0, 0.1, 0.05)
TABLE = HubPath.table(
    np.array([0.0, 0.1, 0.3, 0.4, 0.6]),
    np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, -0.01, 0.1, 0.0, 0.2],
            [0.1, 0.05, -0.01, 0.3, -0.2, 0.9],
            [0.2, 0.05, -0.02, 0.3, -0.5, 1.9],
            [0.2, 0.05, -0.02, 0.3, -0.5, 1.9],
        ]
    ),
)


@pytest.mark.parametrize("path", [slide(0.01, 0.7, 0.1, 0.05, (3.0, 4.0)), TURNED, TABLE])
def test_velocities_are_the_rates_of_the_pose(path):
    """Central differences, whose error is of second order in the step."""
    for t in (0.02, 0.07, 0.12, 0.14, 0.25, 0.35, 0.9):
        now, errors = path.pose(t), []
        for h in (1e-3, 5e-4):
            before, after = path.pose(t - h), path.pose(t + h)
            speed = (after.position_m - before.position_m) / (2 * h)
            turned = Rotation.from_matrix(after.rotation @ before.rotation.T)
            spin = turned.as_rotvec() / (2 * h)
            errors.append(
                np.abs(speed - now.velocity_m_s).max()
                + np.abs(spin - now.angular_velocity_rad_s).max()
            )
        assert errors[1] < max(0.3 * errors[0], 1e-8)


def test_a_hub_is_pressed_down_and_then_slides_or_turns_at_its_rate():
    assert press(0.01, 0.1).pose(0.05).position_m == pytest.approx([0.0, 0.0, -0.005])
    late = slide(0.01, 0.5, 0.1, 0.04, (3.0, 4.0)).pose(1.14)
    assert late.velocity_m_s == pytest.approx([0.3, 0.4, 0.0])
    # the ramp covers half of what the full speed would
    assert late.position_m == pytest.approx([0.3 * 1.02, 0.4 * 1.02, -0.01])
    assert TURNED.pose(3.0).angular_velocity_rad_s == pytest.approx([0.0, 0.0, 100 * np.pi / 30])


def test_a_table_is_met_at_its_rows_and_rests_outside():
    assert TABLE.pose(0.3).position_m == pytest.approx([0.1, 0.05, -0.01])
    rotation = Rotation.from_rotvec([0.3, -0.5, 1.9]).as_matrix()
    for t in (0.4, 0.6, 5.0):
        assert TABLE.pose(t).position_m == pytest.approx([0.2, 0.05, -0.02])
        assert TABLE.pose(t).rotation == pytest.approx(rotation)
    assert np.all(TABLE.pose(-3.0).velocity_m_s == 0.0)


def test_a_table_of_a_smooth_motion_converges():
    """Akima's interpolation of a circle: at least second order in the rows' distance."""
    errors = []
    at = np.linspace(0.3, 0.7, 41)
    for n in (21, 81, 321):
        t = np.linspace(0.0, 1.0, n)
        rows = np.zeros((n, 6))
        rows[:, 0], rows[:, 1] = np.cos(6.0 * t), np.sin(6.0 * t)
        path = HubPath.table(t, rows)
        exact = np.stack([np.cos(6.0 * at), np.sin(6.0 * at)], -1)
        found = np.array([path.pose(each).position_m[:2] for each in at])
        errors.append(np.abs(found - exact).max())
    assert np.all(np.divide(errors[:-1], errors[1:]) > 16.0)


@pytest.mark.parametrize(
    ("times", "change", "words"),
    [
        ([0.0, 0.1, 0.1], 0.0, "row 3"),
        ([0.0, 0.1, 0.05], 0.0, "must increase"),
        ([0.0, 0.1, 0.2], 50.0, "jumps between rows 2 and 3"),
        ([0.0, 0.1, 0.2], np.nan, "finite"),
    ],
)
def test_a_table_that_is_no_motion_is_refused(times, change, words):
    rows = np.zeros((3, 6))
    rows[2, 0] = change
    with pytest.raises(InputError, match=words):
        HubPath.table(np.array(times), rows)


def test_a_path_that_jumps_is_refused():
    coefficients = np.zeros((6, 2, 6))
    coefficients[-1, 1, 0] = 1e-3
    with pytest.raises(InputError, match="jumps at 1 s"):
        HubPath(np.array([0.0, 1.0, 2.0]), coefficients)


def test_clamps_need_rotations_and_lengths():
    eye = np.eye(3)[None]
    assert len(Clamps(np.zeros((1, 3)), eye, np.ones(1))) == 1
    with pytest.raises(InputError, match="proper rotation"):
        Clamps(np.zeros((1, 3)), -eye, np.ones(1))
    with pytest.raises(InputError, match="positive length"):
        Clamps(np.zeros((1, 3)), eye, np.zeros(1))
    with pytest.raises(InputError, match="shapes"):
        Clamps(np.zeros((2, 3)), eye, np.ones(1))
