"""A hub moves as asked: from rest, down by the penetration, on at its speed, or through a file."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bristle.solver.errors import InputError
from bristle.studies.brush.motion import COLUMNS, read_path, stroke

pytestmark = pytest.mark.serial


def test_a_stroke_sinks_by_the_depth_and_reaches_its_speeds():
    hub = stroke(0.3, 0.02, 0.1, 0.7, -5.0)
    for t, height in ((0.0, 0.3), (0.05, 0.29), (0.1, 0.28), (0.9, 0.28)):
        pose = hub.pose(t)
        assert pose.position_m[2] == pytest.approx(height, abs=1e-12)
        assert pose.position_m[1] == 0.0
    for t in (0.1, 0.35, 2.0):  # half of the speed on average while it is reached
        pose = hub.pose(t)
        assert pose.position_m[0] == pytest.approx(0.7 * (t - 0.05), abs=1e-12)
        np.testing.assert_allclose(pose.velocity_m_s, [0.7, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(pose.angular_velocity_rad_s, [0.0, 0.0, -5.0], atol=1e-12)
        turned = Rotation.from_euler("z", -5.0 * (t - 0.05)).as_matrix()
        np.testing.assert_allclose(pose.rotation, turned, atol=1e-12)
    start = hub.pose(0.0)
    assert not start.velocity_m_s.any()
    assert not start.angular_velocity_rad_s.any()


def test_a_stroke_has_no_jump_in_velocity_or_acceleration():
    hub = stroke(0.3, 0.02, 0.1, 0.7, -5.0)
    h = 1e-4
    for t in (0.0, 0.1):
        at = [hub.pose(t + k * h).position_m for k in (-1, 0, 1)] if t else []
        if t:
            second = (at[0] - 2.0 * at[1] + at[2]) / h**2
            # the third derivatives are 60 of the depth and 6 of the speed over the start's cube
            assert np.abs(second).max() < h * (60.0 * 0.02 / 0.1**3 + 6.0 * 0.7 / 0.1**2)
    for t in (0.03, 0.08, 0.4):
        moved = (hub.pose(t + h).position_m - hub.pose(t - h).position_m) / (2.0 * h)
        np.testing.assert_allclose(hub.pose(t).velocity_m_s, moved, atol=1e-4)


def write(path, rows):
    lines = [",".join(COLUMNS), *(",".join(map(repr, map(float, row))) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_file_is_followed_row_by_row_and_its_spin_is_that_of_the_turn(tmp_path):
    """The rotation vector may grow beyond a whole turn."""
    t = np.linspace(0.0, 1.0, 11)
    rows = np.column_stack([t, 0.1 * t, 0 * t, 0.3 - 0.02 * t**2, 0.2 * t, 0 * t, 9.0 * t])
    path = read_path(write(tmp_path / "path.csv", rows))
    for row in rows:
        pose = path.pose(row[0])
        np.testing.assert_allclose(pose.position_m, row[1:4], atol=1e-12)
        expected = Rotation.from_rotvec(row[4:]).as_matrix()
        np.testing.assert_allclose(pose.rotation, expected, atol=1e-12)
    h = 1e-6
    for at in (0.13, 0.77):
        before, after = (Rotation.from_matrix(path.pose(at + x).rotation) for x in (-h, h))
        spin = (after * before.inv()).as_rotvec() / (2.0 * h)
        np.testing.assert_allclose(path.pose(at).angular_velocity_rad_s, spin, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([(0, 0, 0, 0.3, 0, 0, 0), (0.001, 0.2, 0, 0.3, 0, 0, 0)], r":3: the hub jumps: 200 m/s"),
        ([(0, 0, 0, 0.3, 0, 0, 3.1), (1, 0, 0, 0.3, 0, 0, -3.1)], r":3: the hub jumps: it turns"),
        ([(0, 0, 0, 0.3, 0, 0, 0), (1e-4, 0, 0, 0.3, 0, 0, 3)], r":3: the hub jumps: 3e\+04 rad/s"),
        ([(0, 0, 0, 0.3, 0, 0, 0), (0, 0, 0, 0.2, 0, 0, 0)], r":3: t_s must count upwards"),
        ([(0, 0, 0, 0.3, 0, 0, 0)], "needs two rows"),
        ([(0.1, 0, 0, 0.3, 0, 0, 0), (1, 0, 0, 0.3, 0, 0, 0)], "the first at t_s = 0"),
        ([(0, 0, 0, math.nan, 0, 0, 0), (1, 0, 0, 0.3, 0, 0, 0)], ":2: z_m must be a finite"),
    ],
)
def test_a_path_that_is_none_is_refused_with_its_line(tmp_path, rows, says):
    with pytest.raises(InputError, match=says):
        read_path(write(tmp_path / "path.csv", rows))
