"""Infeasible requests are rejected in one line that names the field and the reason."""

import numpy as np
import pytest

import airpuck
from airpuck import Goal, InputError, Limits, Table
from airpuck.planning.request import checked_request

M3 = airpuck.read_model("paper:M3")
REST = (0.0, 0.0, 0.0)


def checked(start=REST, goal=(0.5, 0.0, 0.0), via=(), keep_out=(), limits=None, table=None):
    return checked_request(M3, start, goal, via, table or Table(), keep_out, limits or Limits())


@pytest.mark.parametrize(
    ("wrong", "field", "words"),
    [
        ({"goal": (1.2, 0, 0)}, "goal", "outside the rails"),
        ({"start": (0, -0.5, 0)}, "start", "outside the rails"),
        ({"goal": (0.5, np.nan, 0)}, "goal", "finite"),
        ({"start": (0, 0)}, "start", "must be 3 or 6 or 12 numbers"),
        ({"goal": (0.5, 0, 10_000.0)}, "goal", "1592 turns"),
        ({"start": (0.9, 0, 0, 2.0, 0, 0)}, "start", "hits the rail"),
        ({"goal": (0.9, 0, 0, -2.0, 0, 0)}, "goal", "come from beyond the rail"),
        ({"start": (0, 0, 0, 9.0, 0, 0)}, "start", "above the limit"),
        ({"start": (0, 0, 0, 0, 0, 99.0)}, "start", "above the limit"),
        ({"via": [(0.3, 0.6)]}, "via", "outside the rails"),
        ({"via": [(0.3, 0.1)], "keep_out": [(0.3, 0.1, 0.05)]}, "via", "keep-out disc"),
        ({"keep_out": [(0.02, 0.1, 0.05)]}, "start", "keep-out disc"),
        ({"keep_out": [(0.3, 0.1, 0.0)]}, "keep_out", "radius"),
        ({"via": [(0.1, 0.1)] * 21}, "via", "at most"),
        ({"goal": REST}, "goal", "already"),
        ({"goal": (0, 0, 2 * np.pi)}, "goal", "already"),
        ({"start": (0, 0, 0, 0, 0, 0, *[2.0] * 6)}, "start", "motor speeds"),
    ],
)
def test_invalid_requests_are_rejected_by_name(wrong, field, words):
    with pytest.raises(InputError, match=words) as error:
        checked(**wrong)
    assert error.value.field == field
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["reserve", "spin", "speed", "margin"])
def test_limits_out_of_range_are_rejected(name):
    with pytest.raises(InputError, match=name):
        Limits(**{name: -1.0})


def test_a_craft_that_can_just_stop_is_accepted():
    # v²/2a alone, without the time that motors take to start.
    speed = 1.5
    room = speed**2 / 2 / 7.95
    rail = Table().reach(M3.vehicle.radius_m)[0]
    with pytest.raises(InputError, match="hits the rail"):
        checked((rail - room, 0, 0, speed, 0, 0))
    checked((rail - 1.5 * room, 0, 0, speed, 0, 0))


def test_the_longer_rotation_is_tried_only_if_it_may_be_faster():
    near, far = checked(goal=(0.5, 0, 0.5)), checked(goal=(0.5, 0, 3.0))
    assert near.goal_yaws() == pytest.approx([0.5])
    assert far.goal_yaws() == pytest.approx([3.0, 3.0 - 2 * np.pi])
    assert checked(goal=Goal(0.5, 0, 7.0)).goal_yaws() == pytest.approx([7.0 - 2 * np.pi])
    assert checked(goal=Goal(0.5, 0, 7.0, turn="exact")).goal_yaws() == (7.0,)


def test_the_reserve_is_a_fraction_of_each_motors_thrust():
    command = checked(limits=Limits(reserve=0.2)).highest_command
    curves = M3.dynamics.thrust
    force = sum(curves[:, k] * command ** (k + 1) for k in range(curves.shape[1]))
    np.testing.assert_allclose(force, 0.8 * curves.sum(axis=1), rtol=2e-3)
