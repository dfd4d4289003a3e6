"""The guard, without a network: what idles the motors and for how long, and what does not."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import Measurement, Pilot, SafetyLimits, Step, Table
from airpuck.live.safety import Guard, GuardedPilot, half_of

FRAME = 1 / 240
LIMITS = SafetyLimits(geofence=(1.0, 0.5))
RNG = np.random.default_rng(0)


def poses(watched, start, stop, at=(0.1, 0.2, 0.3)):
    """Feed good poses with realistic noise; return the time of the last."""
    times = np.arange(start, stop, FRAME)
    for time in times:
        pose = np.array(at) + 1e-5 * RNG.standard_normal(3)
        if isinstance(watched, Guard):
            watched.pose(time, pose)
        else:
            watched.measured(Measurement("pose", time, pose))
    return float(times[-1])


@pytest.fixture
def guard():
    made = Guard(LIMITS)
    poses(made, 0.0, 0.5)
    return made


def test_motors_wait_until_poses_have_been_good_for_a_while():
    guard = Guard(LIMITS)
    assert guard.refusal(0.0) == "no pose yet"
    last = poses(guard, 0.0, LIMITS.settle - 0.02)
    assert guard.refusal(last) == "no pose yet"
    last = poses(guard, last + FRAME, LIMITS.settle + 0.02)
    assert guard.refusal(last) is None


def test_missing_poses_idle_the_motors(guard):
    last = 0.5 - FRAME
    assert guard.refusal(last + 0.045) is None
    assert guard.refusal(last + 0.055) == "no pose for 50 ms"
    last = poses(guard, 1.0, 1.2)
    assert guard.refusal(last) == "no pose for 50 ms"  # back, but not for long enough
    last = poses(guard, last + FRAME, 1.4)
    assert guard.refusal(last) is None


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        ((np.nan, 0.2, 0.3), "pose is not finite"),
        ((0.1, np.inf, 0.3), "pose is not finite"),
        ((0.3, 0.2, 0.3), "pose jumped by 0.20 m and 0.00 rad"),
        ((0.1, 0.2, 0.3 + 2.0), "pose jumped by 0.00 m and 2.00 rad"),
    ],
)
def test_one_bad_pose_idles_the_motors_until_good_ones_follow(guard, pose, reason):
    guard.pose(0.5, np.array(pose))
    assert guard.refusal(0.5) == reason
    last = poses(guard, 0.5 + FRAME, 0.5 + LIMITS.settle / 2)
    assert guard.refusal(last) is not None
    last = poses(guard, last + FRAME, 0.55 + LIMITS.settle)
    assert guard.refusal(last) is None


def test_wrapping_of_the_yaw_is_not_a_jump():
    guard = Guard(LIMITS)
    for k, yaw in enumerate((3.0, 3.1, -3.1, -3.0)):
        guard.pose(k * FRAME, np.array([0.0, 0.0, yaw]))
        assert guard.position is not None
        assert guard.refusal(k * FRAME) == "no pose yet"


def test_a_frozen_pose_idles_the_motors(guard):
    frozen = np.array([0.1, 0.2, 0.3])
    for k in range(LIMITS.frozen):
        assert guard.refusal(0.5 + k * FRAME) is None
        guard.pose(0.5 + k * FRAME, frozen)
    assert guard.refusal(0.5 + LIMITS.frozen * FRAME) == (
        "the pose is frozen: 12 equal ones in a row"
    )


def test_a_non_finite_pose_does_not_count_as_frozen(guard):
    frozen, until = np.array([0.1, 0.2, 0.3]), LIMITS.frozen - 1
    for k in range(2 * until + 1):
        guard.pose(0.5 + k * FRAME, frozen if k != until else np.full(3, np.nan))
    assert guard.refusal(0.6) == "pose is not finite"


def test_a_stop_holds_until_it_is_released(guard):
    guard.stop("operator", "stopped by the operator")
    last = poses(guard, 0.5, 2.0)
    assert guard.refusal(last) == "stopped by the operator"
    guard.release("operator")
    assert guard.refusal(last) == "after a stop"
    last = poses(guard, 2.0, 2.4)
    assert guard.refusal(last) is None
    guard.release("operator")  # again: nothing happens
    assert guard.refusal(last) is None


PLACES = st.tuples(st.floats(-1.05, 1.05), st.floats(-0.52, 0.52), st.floats(-4, 4))
#: A wait and a move, both within ±1, and what happens: in most cases nothing special.
EVENTS = st.lists(st.tuples(*[st.floats(-1, 1)] * 4, st.integers(0, 40)), min_size=20, max_size=60)


def happened(event: tuple[float, ...]) -> tuple[float, np.ndarray]:
    """Return the wait [s] and the move of the next pose: like a camera's, or a fault."""
    wait, *move, kind = event
    wait, moved = 0.023 + 0.022 * wait, 0.02 * np.array(move)
    match kind:
        case 20:
            wait *= 4
        case 21:
            moved *= 50
        case 22:
            moved[0] = math.nan
        case 23 | 24:
            moved *= 0
    return wait, moved


def plausible(history: list[tuple[float, np.ndarray]], k: int) -> bool:
    """Whether pose k is finite, inside the fence, no jump and not one of many equal ones."""
    time, pose = history[k]
    x, y, _ = pose
    if not (np.isfinite(pose).all() and -1.0 <= x <= 1.0 and -0.5 <= y <= 0.5):
        return False
    if k == 0 or not np.isfinite(history[k - 1][1]).all():
        return True
    before, last = history[k - 1]
    moved, turned = pose[:2] - last[:2], math.remainder(pose[2] - last[2], math.tau)
    equal = [np.array_equal(pose, other) for _, other in history[max(k - 11, 0) : k]]
    return (
        math.hypot(*moved) <= 0.05 + 3 * (time - before)
        and abs(turned) <= 0.5 + 40 * (time - before)
        and not (len(equal) == 11 and all(equal))
    )


def test_motors_run_only_if_all_poses_were_plausible_for_a_while():
    """Against the whole history of poses, whereas the guard remembers only the last one."""
    ran = []

    @given(PLACES, EVENTS)
    def check(place, events):
        guard, history = Guard(LIMITS), []
        begun = [(0.02, np.full(3, 1e-5 * (-1) ** k)) for k in range(20)]
        time, pose = 0.0, np.array(place)
        #: Since when nothing was wrong; None: something is.
        since = None
        for wait, move in [*begun, *map(happened, events)]:
            time, pose = time + wait, pose + move
            # The loop asks more often than the camera measures.
            allowed = guard.refusal(time) is None
            if history and time - history[-1][0] > LIMITS.pose_timeout:
                assert not allowed
                since = None
            history.append((time, pose))
            guard.pose(time, pose.copy())
            if not plausible(history, len(history) - 1):
                since = None
            elif since is None:
                since = time
            settled = since is not None and time + 0.02 - since >= LIMITS.settle
            assert (guard.refusal(time + 0.02) is None) == settled
            ran.append(settled)
            if not np.isfinite(pose).all():
                pose = np.array(place)

    check()
    assert 0.15 < np.mean(ran) < 0.8


@pytest.mark.parametrize("x", [-0.99, 0.99])
@pytest.mark.parametrize("y", [-0.49, 0.49])
def test_the_geofence_has_four_sides(x, y):
    for outside in ((1.03 * x, y), (x, 1.04 * y)):
        guard = Guard(LIMITS)
        last = poses(guard, 0.0, 0.5, at=(x, y, 0.0))
        assert guard.refusal(last) is None
        guard.pose(last + FRAME, np.array([*outside, 0.0]))
        assert guard.refusal(last + FRAME) == "the craft is outside the geofence"


@pytest.mark.parametrize("passed", [-0.4, 0.0])
def test_an_old_stamp_does_not_excuse_a_jump(passed, guard):
    # 0.4 s later the craft could be there.
    guard.pose(0.5 + passed, np.array([0.4, 0.2, 0.3]))
    assert guard.refusal(0.5) == "pose jumped by 0.30 m and 0.00 rad"


@pytest.mark.parametrize(
    ("moved", "turned", "jumps"),
    [(0.05 + 2.95 * 0.04, 2.0, False), (0.05 + 3.1 * 0.04, 0.0, True), (0.0, 2.2, True)],
)
def test_speeds_above_three_metres_and_forty_radians_a_second_are_jumps(
    guard, moved, turned, jumps
):
    """40 ms after the last pose, beside the 5 cm and 0.5 rad that any two poses may be apart."""
    late = 0.5 - FRAME + 0.04
    guard.pose(late, np.array([0.1 + moved, 0.2, 0.3 + turned]))
    assert (guard.refusal(late) is not None) == jumps


@pytest.mark.parametrize("side", [-1, 1])
def test_the_opponents_half_is_out_of_bounds(side):
    guard = Guard(half_of(Table(length_m=2.2, width_m=1.1), 0.07, side))
    # Its edge is 1 cm over the line, then 3 cm.
    last = poses(guard, 0.0, 0.5, at=(0.06 * side, 0.0, 0.0))
    assert guard.refusal(last) is None
    last = poses(guard, 0.5, 0.6, at=(0.04 * side, 0.0, 0.0))
    assert guard.refusal(last) == "the craft is in the opponent's half"
    last = poses(guard, 0.6, 0.7, at=(0.02 * side, 0.0, 0.0))
    assert guard.refusal(last)
    last = poses(guard, 0.7, 1.2, at=(0.07 * side, 0.0, 0.0))
    assert guard.refusal(last) is None
    # The rails hold on the own half, too; noise of a craft that leans on one is inside.
    assert guard.limits.geofence == pytest.approx((1.04, 0.49))


class Playing(Pilot):
    """A pilot that returns the command set by a test."""

    watches = ("puck",)

    def __init__(self):
        self.command = np.full(2, 0.5)

    def step(self, time):
        if self.command is None:
            raise ZeroDivisionError("in the solver")
        return Step(self.command.copy(), "exact", np.zeros(3), None)


@pytest.fixture
def guarded():
    logged = []
    made = GuardedPilot(
        Playing(), Guard(LIMITS), np.full(2, 0.03), lambda level, text: logged.append((level, text))
    )
    made.logged = logged
    poses(made, 0.0, 0.5)
    return made


def test_commands_are_clipped_between_idle_and_full(guarded):
    assert guarded.watches == ("puck",)
    guarded.pilot.command = np.array([-1.0, 7.0])
    np.testing.assert_array_equal(guarded.step(0.5).command, [0.03, 1.0])
    assert guarded.logged == [("info", "flying")]


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (None, "the controller failed: ZeroDivisionError: in the solver"),
        (np.array([0.5, np.nan]), "the controller's command is not 2 finite numbers"),
    ],
)
def test_a_failing_controller_idles_the_motors_and_may_recover(guarded, command, reason):
    guarded.pilot.command = command
    step = guarded.step(0.5)
    assert step.status == "unsafe"
    assert not step.flies
    np.testing.assert_array_equal(step.command, [0.03, 0.03])
    guarded.pilot.command = np.full(2, 0.4)
    assert guarded.step(0.51).status == "unsafe"
    last = poses(guarded, 0.52, 0.9)
    assert guarded.step(last).status == "exact"
    assert guarded.logged == [("error", f"motors idle: {reason}"), ("info", "flying")]


@pytest.mark.parametrize("kind", ["pose", "imu", "mouse", "puck", "mallet", "sent"])
def test_a_controller_that_fails_on_a_measurement_idles_the_motors(kind):
    def fail(*news):
        if kind == "sent" or news[0].kind == kind:
            raise ZeroDivisionError("in the filter")

    pilot, logged = Playing(), []
    setattr(pilot, "sent" if kind == "sent" else "measured", fail)
    made = GuardedPilot(pilot, Guard(LIMITS), np.full(2, 0.03), lambda _, text: logged.append(text))
    last = poses(made, 0.0, 0.5)
    if kind != "pose":
        assert made.step(last).flies
        size = {"imu": 6, "mouse": 2}.get(kind, 3)
        news = (last, np.zeros(2)) if kind == "sent" else (Measurement(kind, last, np.zeros(size)),)
        (made.sent if kind == "sent" else made.measured)(*news)
    np.testing.assert_array_equal(made.step(last).command, [0.03, 0.03])
    assert logged[-1] == "motors idle: the controller failed: ZeroDivisionError: in the filter"


def test_an_invalid_command_idles_the_motors(guarded):
    step = Step(np.full(2, 0.5), "exact", np.zeros(3), None)
    # Without type checks, a user's step can hold anything.
    object.__setattr__(step, "command", [0.5, "full"])
    guarded.pilot.step = lambda time: step
    given = guarded.step(0.5)
    assert given.status == "unsafe"
    np.testing.assert_array_equal(given.command, [0.03, 0.03])
    [(level, words)] = guarded.logged
    assert level == "error" and "a command that is not an array of numbers" in words


def test_a_change_is_logged_once(guarded):
    guarded.step(0.5)
    for k in range(5):
        guarded.step(1.0 + k / 100)
    assert guarded.logged == [("info", "flying"), ("error", "motors idle: no pose for 50 ms")]
