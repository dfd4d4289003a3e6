"""Motors that do not follow their commands."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.twin.craft import MotorUnit
from airpuck.twin.settings import Motors, Stall, Starts, Weakness

from ..apparatus.examples import examples
from ..apparatus.refusals import rejected

NAMES = ("left", "right")
BOTH = np.array([0.6, 0.3])


def unit(**values):
    return MotorUnit(Motors(**values), NAMES)


def test_healthy_motors_follow_their_command():
    motors = unit()
    for now, command in enumerate([BOTH, 1 - BOTH, np.zeros(2), np.array([0.01, 1.0])]):
        np.testing.assert_array_equal(motors.follow(float(now), command), command)
    assert motors.next_change(0.0) == math.inf


def test_motors_do_not_turn_until_armed():
    motors = unit(unarmed_s=2.0)
    assert motors.next_change(0.0) == 2.0
    np.testing.assert_array_equal(motors.follow(0.0, BOTH), 0)
    np.testing.assert_array_equal(motors.follow(np.nextafter(2.0, 0), BOTH), 0)
    np.testing.assert_array_equal(motors.follow(2.0, BOTH), BOTH)
    assert motors.next_change(2.0) == math.inf


def test_an_idling_motor_follows_a_higher_command_after_its_start_delay():
    motors = unit(starting_delay_s=0.1, idle_below=0.05)
    np.testing.assert_array_equal(motors.follow(0.0, np.array([0.03, 0.03])), [0.03, 0.03])
    # Only the first gets a command; until it follows, it turns at idle speed at most.
    go = np.array([0.6, 0.03])
    np.testing.assert_array_equal(motors.follow(1.0, go), [0.05, 0.03])
    assert motors.next_change(1.0) == pytest.approx(1.1)
    np.testing.assert_array_equal(motors.follow(1.05, go), [0.05, 0.03])
    np.testing.assert_array_equal(motors.follow(motors.next_change(1.05), go), go)
    # From then on it follows at once.
    np.testing.assert_array_equal(motors.follow(1.2, BOTH)[0], 0.6)


def test_changing_the_command_during_a_start_does_not_restart_it():
    motors = unit(starting_delay_s=0.1)
    motors.follow(0.0, np.array([0.2, 0.0]))
    motors.follow(0.06, np.array([0.9, 0.0]))
    np.testing.assert_array_equal(motors.follow(0.11, np.array([0.9, 0.0])), [0.9, 0.0])


def test_a_motor_that_idles_again_starts_slowly_again():
    motors, go, idle = unit(starting_delay_s=0.1), np.array([0.6, 0.6]), np.array([0.0, 0.6])
    motors.follow(0.0, go)
    np.testing.assert_array_equal(motors.follow(0.2, go), go)
    np.testing.assert_array_equal(motors.follow(0.3, idle), idle)
    np.testing.assert_array_equal(motors.follow(0.4, go), [0.05, 0.6])
    assert motors.next_change(0.4) == pytest.approx(0.5)
    np.testing.assert_array_equal(motors.follow(0.51, go), go)


def test_an_aborted_start_does_not_count():
    motors, go = unit(starting_delay_s=0.1), np.array([0.6, 0.0])
    motors.follow(0.0, go)
    motors.follow(0.05, np.zeros(2))
    np.testing.assert_array_equal(motors.follow(0.12, go), [0.05, 0.0])


def test_a_stalled_motor_stops_and_the_other_does_not():
    motors = unit(stalls=(Stall(motor="right", start_s=1.0, stop_s=1.5),))
    assert motors.next_change(0.0) == 1.0
    np.testing.assert_array_equal(motors.follow(0.99, BOTH), BOTH)
    np.testing.assert_array_equal(motors.follow(1.0, BOTH), [0.6, 0.0])
    assert motors.next_change(1.0) == 1.5
    np.testing.assert_array_equal(motors.follow(1.49, BOTH), [0.6, 0.0])
    np.testing.assert_array_equal(motors.follow(1.5, BOTH), BOTH)


def test_the_callers_command_is_not_modified():
    command = BOTH.copy()
    unit(stalls=(Stall(motor="right", start_s=0.0, stop_s=9.0),)).follow(1.0, command)
    unit(starting_delay_s=1.0).follow(0.0, command)
    np.testing.assert_array_equal(command, BOTH)


def test_a_stall_of_an_unknown_motor_is_rejected():
    with rejected("(there are left, right)", match="middle", field="motors.stalls"):
        unit(stalls=(Stall(motor="middle", start_s=0.0, stop_s=1.0),))


@examples(100)
@given(
    unarmed=st.floats(0, 1),
    delay=st.floats(0, 0.3),
    stall=st.tuples(st.floats(0, 2), st.floats(0, 1)),
    commands=st.lists(
        st.tuples(st.floats(1e-3, 0.5), st.floats(0, 1), st.floats(0, 1)), max_size=10
    ),
)
def test_motors_are_constant_until_the_next_announced_change(unarmed, delay, stall, commands):
    start, length = stall
    stalls = (Stall(motor="left", start_s=start, stop_s=start + length),)
    motors = unit(unarmed_s=unarmed, starting_delay_s=delay, stalls=stalls)
    now = 0.0
    for wait, *command in commands:
        command, end = np.array(command), now + wait
        while now < end:
            follows, change = motors.follow(now, command), motors.next_change(now)
            assert change > now
            assert ((follows >= 0) & (follows <= command)).all()
            before = np.nextafter(min(change, end), 0)
            np.testing.assert_array_equal(motors.follow(before, command), follows)
            now = min(change, end)


def started(starts, rest, seed):
    """Rest the left motor after it has turned, start it again; return the unit and its command."""
    motors = MotorUnit(Motors(), NAMES, starts, np.random.default_rng(seed))
    go, idle = np.array([0.6, 0.0]), np.zeros(2)
    motors.follow(0.0, go)
    now = 1e6  # whatever happened at the first start is over
    np.testing.assert_array_equal(motors.follow(now, go), go)
    motors.follow(now, idle)
    return motors, motors.follow(now + rest, go)[0]


@pytest.mark.parametrize(("rest", "rate"), [(0.05, 0.0), (0.1, 0.3), (0.19, 0.3), (0.2, 0.05)])
def test_starts_fail_as_often_as_stated_for_the_preceding_rest(rest, rate):
    starts = Starts(rest_s=(0.1, 0.2), failed=(0.3, 0.05), lasting_s=0.1)
    # Beyond a rounding error of the large times.
    outcomes = [started(starts, rest + 1e-6, seed) for seed in range(2000)]
    failed = np.array([command < 0.06 for _, command in outcomes])
    # Four standard errors of a binomial frequency.
    assert abs(failed.mean() - rate) <= 4 * math.sqrt(rate * (1 - rate) / 2000)
    counted = [sum(time > 1e5 for time, *_ in motors.failed_starts) for motors, _ in outcomes]
    np.testing.assert_array_equal(counted, failed)


def test_a_motor_that_failed_to_start_recovers_after_the_stated_mean_time():
    starts, now, go = Starts(rest_s=(0.0,), failed=(1.0,), lasting_s=0.1), 0.0, np.array([0.6, 0.0])
    waits = []
    for seed in range(500):
        motors = MotorUnit(Motors(), NAMES, starts, np.random.default_rng(seed))
        np.testing.assert_array_equal(motors.follow(now, go), [0.05, 0.0])
        waits.append(motors.next_change(now) - now)
        before = np.nextafter(waits[-1], 0)
        np.testing.assert_array_equal(motors.follow(before, go), [0.05, 0.0])
        np.testing.assert_array_equal(motors.follow(waits[-1], go), go)
    assert np.mean(waits) == pytest.approx(0.1, rel=4 / math.sqrt(500))


def test_a_motor_that_never_rests_never_fails_to_start():
    starts = Starts(rest_s=(0.0,), failed=(1.0,))
    motors = MotorUnit(Motors(), NAMES, starts, np.random.default_rng(0))
    motors.follow(0.0, BOTH)
    for now, command in enumerate([BOTH, 0.1 * BOTH + 0.05, 1 - BOTH, BOTH], start=1000):
        np.testing.assert_array_equal(motors.follow(float(now), command), command)
    assert len(motors.failed_starts) == 2


def test_a_weak_motor_gives_its_share_of_thrust_while_it_is_weak():
    losses = (
        Weakness(motor="right", start_s=1.0, stop_s=2.0, share=0.6),
        Weakness(motor="right", start_s=1.5, stop_s=3.0, share=0.5),
    )
    motors = unit(weak=losses)
    right = NAMES.index("right")
    for now, share in ((0.9, 1.0), (1.0, 0.6), (1.7, 0.3), (2.0, 0.5), (3.0, 1.0)):
        expected = np.ones(len(NAMES))
        expected[right] = share
        np.testing.assert_allclose(motors.share(now), expected)
    # Steps of the twin end where something changes.
    assert [motors.next_change(t) for t in (0.5, 1.0, 1.5, 2.0, 3.0)] == [1, 1.5, 2, 3, np.inf]


def test_a_loss_of_an_unknown_motor_is_rejected():
    with rejected(field="motors.weak"):
        unit(weak=(Weakness(motor="middle", start_s=0.0, stop_s=1.0, share=0.5),))
