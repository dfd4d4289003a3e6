"""The flight loop, with a made-up link and pilot."""

import re
from dataclasses import replace
from time import sleep
from typing import ClassVar

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.control.law import FLYING, Pilot, Prediction, Step
from airpuck.control.reference import Rendezvous, SetPoint, SetPoints
from airpuck.control.tracking import TrackingController
from airpuck.data.measurement import Measurement
from airpuck.flight.loop import control, fly
from airpuck.model.model_file import read_model
from airpuck.twin.experiments import track
from airpuck.twin.settings import default_twin_settings
from airpuck.twin.twin import Twin

from ..apparatus.changes import changed

IDLE = np.full(6, 0.03)


class FakeLink:
    """A clock, and measurements that arrive at given times."""

    def __init__(self, measurements=(), now=0.0):
        self.now = now
        self.waits, self.sent, self.announced = [], [], []
        self._waiting = sorted(measurements, key=lambda entry: entry[0])

    def wait_until(self, time):
        assert time >= self.now
        self.now = time
        self.waits.append(time)
        arrived = [m for arrival, m in self._waiting if arrival <= time]
        self._waiting = self._waiting[len(arrived) :]
        return arrived

    def send(self, command):
        self.sent.append((self.now, command.copy()))

    def announce(self, reference):
        self.announced.append((self.now, reference.copy()))


class LateLink(FakeLink):
    """Returns a little later than requested."""

    def wait_until(self, time):
        arrived = super().wait_until(max(time, self.now))
        self.now = time + 0.002
        return arrived


class FakePilot(Pilot):
    """Counts and records its inputs, in order."""

    outcomes: ClassVar = ("no pose", "exact", "scaled")

    def __init__(self, reference=None):
        self.reference = reference or SetPoint(0.1, 0.2, 0.3)
        self.events = []

    def measured(self, measurement):
        self.events.append((measurement.kind, measurement.stamp, tuple(measurement.values)))

    def step(self, time):
        count = sum(event[0] == "step" for event in self.events)
        self.events.append(("step", time, ()))
        return Step(IDLE + 0.001 * count, self.outcomes[count % 3], np.zeros(3), None)

    def sent(self, time, command):
        self.events.append(("sent", time, tuple(command)))

    def told(self, kind):
        return [event[1:] for event in self.events if event[0] == kind]


def pose(stamp, x=0.0):
    return Measurement("pose", stamp, np.array([x, 0.0, 0.0]))


def test_every_tenth_prediction_and_all_step_times_are_kept():
    plan = Prediction(np.array([0.1]), np.zeros((1, 6)), ())

    class Predicts(FakePilot):
        def step(self, time):
            sleep(1e-3)
            known = time > 0.05  # the first steps have none
            return replace(super().step(time), prediction=plan if known else None)

    log = fly(Predicts(), FakeLink(), 0.35)
    assert list(log.predictions) == [10, 20, 30]
    assert log.took.shape == (35,) and (log.took >= 1e-3).all()


def test_the_period_does_not_drift_if_the_link_is_late():
    link = LateLink()
    fly(FakePilot(), link, 1.0)
    np.testing.assert_allclose(link.waits, 0.01 * np.arange(101), atol=1e-12)


@pytest.mark.parametrize(
    ("duration", "period", "count"), [(1.0, 0.01, 100), (1.0, 0.02, 50), (0.3, 0.1, 3)]
)
def test_a_command_is_sent_every_period(duration, period, count):
    link = FakeLink()
    log = fly(FakePilot(), link, duration, period)
    assert len(log.status) == len(log.reference) == count
    for times in (log.time, [time for time, _ in link.sent]):
        np.testing.assert_allclose(times, period * np.arange(count), atol=1e-12)
    assert link.now == pytest.approx(duration)


def test_a_flight_starts_at_the_time_of_the_link():
    link, pilot = FakeLink(now=50.0), FakePilot()
    log = fly(pilot, link, 0.5)
    assert log.time[0] == 50.0
    assert link.now == pytest.approx(50.5)
    assert pilot.told("step")[0] == (50.0, ())


def test_measurements_are_delivered_once_in_order_before_the_next_step():
    rng = np.random.default_rng(0)
    arrivals = np.sort(rng.uniform(0, 0.985, 200))
    link, pilot = FakeLink([(t, pose(t - 0.001, x=k)) for k, t in enumerate(arrivals)]), FakePilot()
    fly(pilot, link, 1.0)
    assert [values[0] for _, values in pilot.told("pose")] == list(range(200))
    np.testing.assert_array_equal([stamp for stamp, _ in pilot.told("pose")], arrivals - 0.001)
    # A pose that arrived between two steps is delivered between them.
    steps = -1
    for kind, stamp, _ in pilot.events:
        steps += kind == "step"
        if kind == "pose":
            assert 0.01 * steps < stamp + 0.001 <= 0.01 * (steps + 1) + 1e-9


def test_the_pilot_is_told_the_command_that_was_sent():
    link, pilot = FakeLink(), FakePilot()
    log = fly(pilot, link, 0.1)
    for k, (time, command) in enumerate(link.sent):
        np.testing.assert_array_equal(command, IDLE + 0.001 * k)
        assert pilot.told("sent")[k] == (time, tuple(command))
    np.testing.assert_array_equal(log.command, [command for _, command in link.sent])
    kinds = [event[0] for event in pilot.events]
    assert kinds == ["step", "sent"] * 10
    assert log.status == (*("no pose", "exact", "scaled") * 3, "no pose")


def test_a_reference_is_announced_only_when_it_changes():
    reference = SetPoints([0.0, 0.305, 0.6], [(0, 0, 0), (1, 0.3, 1.5), (0.5, -0.3, -1)])
    link = FakeLink()
    log = fly(FakePilot(reference), link, 1.0)
    times = [time for time, _ in link.announced]
    np.testing.assert_allclose(times, [0.0, 0.31, 0.6], atol=1e-9)
    np.testing.assert_array_equal([state[:3] for _, state in link.announced], reference.poses)
    np.testing.assert_array_equal(log.reference[:31], np.zeros((31, 3)))
    np.testing.assert_array_equal(log.reference[31], [1, 0.3, 1.5])
    np.testing.assert_array_equal(log.reference[-1], [0.5, -0.3, -1])


def test_a_rendezvous_is_announced_as_the_state_to_reach():
    link, state = FakeLink(), (0.5, 0.1, 0.0, 2.0, 0.0, -1.0)
    fly(FakePilot(Rendezvous(0.295, state, then=SetPoint(0.0, 0.0, 0.3))), link, 0.5)
    (first, met), (second, after) = link.announced
    assert (first, second) == pytest.approx((0.0, 0.3))
    np.testing.assert_array_equal(met, state)
    np.testing.assert_array_equal(after, [0, 0, 0.3, 0, 0, 0])


def test_a_pilot_receives_watched_bodies_and_requested_onboard_sensors():
    heard = [
        (0.02, Measurement("imu", 0.015, np.array([1, 2, 9.81, 4, 5, 6.0]))),
        (0.03, Measurement("mouse", 0.025, np.array([0.7, 0.8]))),
        (0.04, pose(0.035)),
        (0.05, Measurement("puck", 0.045, np.array([0.1, 0.2, 0.3]))),
        (0.06, Measurement("mallet", 0.055, np.array([0.4, 0.5, 0.6]))),
    ]
    deaf, hearing = FakePilot(), FakePilot()
    hearing.watches = ("puck",)
    fly(deaf, FakeLink(heard), 0.1)
    fly(hearing, FakeLink(heard), 0.1, on_board=True)
    assert deaf.told("imu") == deaf.told("mouse") == []
    assert hearing.told("imu") == [(0.015, (1, 2, 9.81, 4, 5, 6))]
    assert hearing.told("mouse") == [(0.025, (0.7, 0.8))]
    assert deaf.told("puck") == deaf.told("mallet") == hearing.told("mallet") == []
    assert hearing.told("puck") == [(0.045, (0.1, 0.2, 0.3))]
    assert len(deaf.told("pose")) == len(hearing.told("pose")) == 1


class Used(TrackingController):
    """Counts the poses it receives, and those that its filter uses."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.told, self.used, use = 0, 0, self.filter.pose

        def counted(time, pose, gate=None):
            used = use(time, pose, gate)
            self.used += used and gate is not None
            return used

        self.filter.pose = counted

    def pose(self, time, pose):
        self.told += 1
        super().pose(time, pose)


@pytest.mark.slow
def test_sensors_with_different_latencies_work_together():
    late, less = {"latency_s": 0.02}, {"latency_s": 0.01}
    settings = changed(default_twin_settings(), motion_capture=late, on_board=less)
    model = read_model("paper:M4")
    pilot = Used(model, SetPoints([0.0, 0.5], [(0, 0, 0), (0.3, 0.2, 1.0)]))
    twin = Twin(model, settings)
    fly(pilot, twin, 4.0, on_board=True)
    assert pilot.used > 0.97 * pilot.told > 700
    time, state = twin.truth
    np.testing.assert_allclose(state[time > 3.5, :2], [[0.3, 0.2]] * sum(time > 3.5), atol=5e-3)


@pytest.mark.slow
def test_onboard_sensors_alone_do_not_keep_a_craft_flying():
    settings = changed(default_twin_settings(), motion_capture={"gaps_s": ((1.0, 2.0),)})
    model = read_model("paper:M4")
    pilot = TrackingController(model, SetPoint(0.1, 0.0, 0.0))
    log = fly(pilot, Twin(model, settings), 2.5, on_board=True)
    status = np.array(log.status)
    assert (status[(log.time > 1.07) & (log.time < 2.0)] == "stale pose").all()
    assert np.isin(status[(log.time > 2.03) | (np.abs(log.time - 0.5) < 0.4)], FLYING).all()


def test_errors_of_a_pilot_propagate():
    class Broken(FakePilot):
        def step(self, time):
            raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        fly(Broken(), FakeLink(), 0.1)


def test_measurements_are_delivered_in_order_and_once():
    stamps = [0.001, 0.007, 0.009, 0.0195]
    link, pilot = FakeLink([(stamp, pose(stamp)) for stamp in stamps]), FakePilot()
    actions = list(control(pilot, link, 0.03, early=0.002))
    np.testing.assert_allclose(link.waits, [0, 0.008, 0.01, 0.018, 0.02])
    assert [action.due for action in actions] == pytest.approx([0, 0.01, 0.02])
    assert [time for time, _ in pilot.told("pose")] == stamps


def test_periods_during_a_suspension_are_skipped():
    class SleptLink(FakeLink):
        def wait_until(self, time):
            return super().wait_until(max(time, self.now))

    link, pilot = SleptLink(), FakePilot()
    due = []
    for action in control(pilot, link, 0.1):
        due.append(action.due)
        if len(due) == 3:
            link.now += 0.043  # the process was suspended
    assert due == pytest.approx([0, 0.01, 0.02, 0.06, 0.07, 0.08, 0.09])


def test_a_log_measures_how_well_each_set_point_was_reached():
    points = SetPoints([0.0, 0.2, 2.5], [(0, 0, 0), (0.3, 0.1, 0.5), (0.1, 0.1, 0.5)])
    log = track(read_model("paper:M3"), points, 5.0, seed=1)
    found = log.metrics()
    assert [result.pose for result in found] == [(0, 0, 0), (0.3, 0.1, 0.5), (0.1, 0.1, 0.5)]
    for result in found[1:]:
        x, y, yaw = log.recording["pose"].values.T
        time = log.recording["pose"].time - log.recording["command"].time[0]
        off = np.abs([x - result.pose[0], y - result.pose[1], yaw - result.pose[2]]).T
        away = (off > [0.021, 0.021, 0.06]).any(axis=1)
        inside = (time > result.start) & (time < result.stop)
        last = time[inside & away][-1]
        assert result.settling_time == pytest.approx(last - result.start, abs=0.1)
        assert "settling_time_s=" in repr(result) and "yaw_rad" in repr(result)
    assert repr(log).startswith("FlightLog(500 commands in 5.0 s")


def test_an_unrecorded_flight_has_no_metrics():
    controller = TrackingController(read_model("paper:M3"), SetPoint(0.0, 0.0, 0.0))
    log = fly(controller, Twin(read_model("paper:M3")), 0.1)
    with pytest.raises(InputError, match=r"not recorded; a twin has its own, twin\.recording"):
        log.metrics()
    with pytest.raises(InputError, match=r"one object now: log = airpuck\.track.*log\.recording"):
        _, log = log  # pyright: ignore[reportGeneralTypeIssues]


class SlowClock:
    """A wall clock that advances by seconds at each look."""

    def __init__(self, step):
        self.now, self.step = 0.0, step

    def __call__(self):
        self.now += self.step
        return self.now


@pytest.mark.parametrize(
    ("step", "watched", "told"), [(3.0, True, True), (3.0, False, False), (0.001, True, False)]
)
def test_a_slow_flight_shows_the_remaining_time_on_a_terminal(
    monkeypatch, capsys, step, watched, told
):
    monkeypatch.setattr("time.monotonic", SlowClock(step))
    monkeypatch.setattr("sys.stderr.isatty", lambda: watched)
    fly(FakePilot(), FakeLink(), 1.0)
    lines = capsys.readouterr().err.splitlines()
    assert bool(lines) == told
    if told:
        flown, left = map(
            float, re.fullmatch(r"flown ([\d.]+) of 1 s, about (\d+) s left", lines[-1]).groups()
        )
        assert 0.9 < flown <= 1.0 and left < 60
    assert len(lines) < 100
