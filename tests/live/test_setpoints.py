import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.control.reference import SetPoints, read_setpoints
from airpuck.live.fly import FollowedSetPoint, PlannedSetPoints

FENCE = (1.0, 0.5)


def test_time_counts_from_the_start():
    plan = PlannedSetPoints(SetPoints([0.0, 2.0], [(0, 0, 0), (0.5, 0, 1)]))
    assert plan.at(1e6, 0.0).state[0] == 0.0  # whatever the clock says before
    plan.begin(10.0)
    plan.begin(99.0)  # once only
    assert plan.at(11.9, 0.0).state[0] == 0.0
    assert plan.at(12.0, 0.0).state[0] == 0.5


def test_set_points_are_read_from_a_file(tmp_path):
    path = tmp_path / "points.toml"
    entry = "[[setpoints]]\nat_s = {}\nx_m = {}\ny_m = 0.1\nyaw_rad = 1\n"
    path.write_text(entry.format(0, 0.2) + entry.format(3.5, -0.2))
    points = read_setpoints(path)
    np.testing.assert_array_equal(points.times, [0.0, 3.5])
    np.testing.assert_array_equal(points.poses, [(0.2, 0.1, 1.0), (-0.2, 0.1, 1.0)])
    path.write_text(entry.format(3.5, 0.2) + entry.format(3.5, -0.2))
    with pytest.raises(InputError, match=r"points.toml: setpoints: times must increase"):
        read_setpoints(path)


def test_a_set_point_can_be_moved_from_outside_within_the_geofence():
    followed = FollowedSetPoint(FENCE)
    assert followed.point is None
    assert followed.move(np.array([0.3, 0.2, 1.0])) is None
    assert followed.point is not None
    assert followed.move(np.array([1.1, 0.2, 1.0, 0, 0, 0])) == (
        "a set point outside the geofence, (1.10, 0.20)"
    )
    assert followed.move(np.array([np.nan, 0.2, 1.0])) == "a set point that is not finite"
    assert followed.move(np.array([0.3, 0.2, 1e300])) == "a set point with a yaw of 1e+300 rad"
    np.testing.assert_array_equal(followed.at(0.0, 0.0).state, [0.3, 0.2, 1.0, 0, 0, 0])
    assert followed.move(np.array([-0.4, 0.1, 2.0, 5.0, 5.0, 5.0])) is None
    np.testing.assert_array_equal(followed.at(0.0, 0.0).state, [-0.4, 0.1, 2.0, 0, 0, 0])
