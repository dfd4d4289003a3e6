"""Runs on links that a person could have got wrong: each ends with its cause, and keeps all."""

from types import SimpleNamespace

import numpy as np
import pytest

from airpuck import Measurement, Pilot, Step, commission, read_recording
from airpuck.boundary.results import Finding
from airpuck.commissioning import excitations
from airpuck.commissioning.excitations import WarmUp, first_cause, prepare
from airpuck.commissioning.session import Work
from airpuck.commissioning.steps import Pulses, Rest, hovering
from airpuck.craft.vehicle import default_vehicle
from airpuck.physics.rigid_body import turned

VEHICLE = default_vehicle()


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch):
    """Compile for a study with slow cameras only; these runs end before their first study."""
    monkeypatch.setattr(excitations, "prepare", lambda craft, hz: hz < 30 and prepare(craft, hz))


class Still:
    """A link to a craft that lies still: poses at a rate, with noise, around a place."""

    def __init__(
        self, rate=120.0, noise=1e-4, place=(0.02, -0.01, 0.3), until=np.inf, push=0.0, stamps=0.0
    ):
        self.now, self.sent, self._stamps = 0.0, [], stamps
        self.rate, self._noise, self._place, self._until = rate, noise, np.array(place), until
        self._push, self._count = push, 0
        self._rng = np.random.default_rng(0)

    def wait_until(self, time):
        arrived = []
        while self.rate and (stamp := self._count / self.rate) <= min(time, self._until):
            self._count += 1
            moved = np.array([0.5 * self._push * stamp**2, 0.0, 0.0])
            pose = self._place + moved + self._noise * self._rng.normal(size=3)
            pose[2] = np.remainder(pose[2] + np.pi, 2 * np.pi) - np.pi
            blurred = stamp + self._stamps * np.sin(7e3 * stamp)
            arrived.append(Measurement("pose", blurred, pose))
        self.now = time
        return arrived

    def send(self, command):
        self.sent.append(command)

    def announce(self, reference):
        pass


@pytest.mark.slow
@pytest.mark.parametrize(
    ("link", "kind", "cause"),
    [
        (Still(rate=0.0), "poses", "No pose has arrived"),
        (Still(until=0.3), "poses", "No pose has arrived"),
        (Still(rate=20.0), "poses", "Poses come at 20 Hz"),
        (Still(noise=0.0), "poses", "The pose never changes"),
        (Still(noise=0.01), "poses", "noise is 1"),
        (Still(place=(300.0, 20.0, 0.0)), "units", "beyond the rails"),
        (Still(place=(0.9, 0.0, 0.0)), "table", "near a rail"),
    ],
)
def test_a_run_without_useful_poses_ends_with_the_cause(link, kind, cause):
    found = commission(link, VEHICLE)
    assert (found.outcome, found.trusted, found.model) == (kind, False, None)
    assert cause in found.findings[0].cause
    assert found.findings[0].remedy
    assert all((command == VEHICLE.idle).all() for command in link.sent)
    assert found.flight_s == 0


@pytest.mark.slow
def test_a_craft_that_does_not_respond_is_not_flown():
    link = Still(rate=240.0)
    found = commission(link, VEHICLE)
    assert found.outcome == "actuator"
    # Pulses of single motors were all that it was sent.
    assert max(np.count_nonzero(command > VEHICLE.idle + 1e-3) for command in link.sent) == 1


@pytest.mark.slow
def test_any_key_ends_the_run_with_idle_motors(tmp_path):
    link = Still(rate=240.0)
    found = commission(link, VEHICLE, tmp_path, stopped=lambda: link.now > 1.5)
    assert found.findings[0].cause == "Stopped by the operator"
    assert link.now < 1.7
    assert (link.sent[-1] == VEHICLE.idle).all()
    assert [flight.name for flight in found.flights] == ["01_rest", "02_pulses"]
    for flight in found.flights:
        kept = read_recording(tmp_path / "flights" / flight.name)
        assert len(kept["pose"]) == len(flight.recording["pose"])
    assert (tmp_path / "vehicle.toml").exists()


def test_repeated_poses_of_a_logger_are_counted_once():
    found = commission(Repeating(rate=120.0), VEHICLE, steps=[Rest()])
    assert found.steps[0].words.startswith("poses at 120 Hz")


def test_the_rest_step_measures_rate_noise_and_slope():
    link = Still(rate=100.0, noise=2e-4, push=0.1)
    found = commission(link, VEHICLE, steps=[Rest(duration_s=1.0)])
    assert found.outcome == "not_trusted"
    [step] = found.steps
    assert "100 Hz" in step.words
    assert "10." in step.words.partition("slope of ")[2]  # 0.1 m/s² over 9.81 m/s² is 10.2 mrad


@pytest.mark.slow
def test_flight_time_counts_every_second_with_running_motors():
    link = Still(rate=240.0)
    found = commission(link, VEHICLE, steps=[])
    assert found.flight_s == 0
    found = commission(link, VEHICLE, stopped=lambda: link.now > 2.5)
    on = [(command > VEHICLE.idle + 1e-3).any() for command in link.sent]
    assert found.flight_s == pytest.approx(0.01 * sum(on), abs=0.02)
    assert sum(on) > 10


class SlowWork(Work):
    """Takes ten looks."""

    looks = 0

    def start(self, now, function, *arguments): ...

    def done(self, now):
        self.looks += 1
        return self.looks > 10

    def result(self): ...


def test_poses_that_arrive_during_compilation_are_used():
    found = commission(Still(rate=120.0), VEHICLE, steps=[WarmUp(), Rest()], work=SlowWork())
    assert [one.step for one in found.steps] == ["rest"]
    assert not found.findings


class Noting(SlowWork):
    """Notes when the work begins, and the rate that it is for."""

    looks = 10

    def start(self, now, function, *arguments):
        self.began, self.rate = now, arguments[-1]


class Repeating(Still):
    """A logger faster than the cameras: each pose three times."""

    def wait_until(self, time):
        return [one for one in super().wait_until(time) for _ in range(3)]


@pytest.mark.parametrize(
    "link", [Still(rate=60.0, stamps=3e-4), Still(rate=240.0, stamps=3e-4), Repeating(rate=120.0)]
)
def test_the_rate_is_known_before_a_craft_on_a_slope_drifts_far(link):
    """Half g times 20 mrad times 0.15 s squared: 2 mm."""
    work, rate = Noting(), link.rate
    commission(link, VEHICLE, steps=[WarmUp()], work=work)
    assert work.rate == pytest.approx(rate, rel=0.025)
    assert work.began < 0.15


class Pushing(Pilot):
    """Runs all motors at half speed."""

    def step(self, time):
        return Step(np.full(VEHICLE.n_propellers, 0.5), "open loop", np.zeros(3), None)


class Twice:
    """Two flights: one whose pilot watches the poses itself, and one behind the guard."""

    def run(self, session):
        for guarded in (False, True):
            session.fly("push", Pushing(), 0.5, guarded=guarded)


def test_a_second_flight_starts_without_delay():
    found = commission(Still(), VEHICLE, steps=[Twice()])
    _, second = (flight.recording["command"].values for flight in found.flights)
    assert (second[:-1] == 0.5).all()


class Idle(Pilot):
    """Lets all motors idle."""

    def step(self, time):
        return Step(VEHICLE.idle, "open loop", np.zeros(3), None)


class Brief:
    """A controller made while the craft coasts."""

    def run(self, session):
        session.fly("coast", Idle(), 0.5)
        self.estimate = hovering(session).step(session.link.now).estimate


def test_a_new_controller_knows_the_speed_immediately():
    step = Brief()
    commission(Still(rate=120.0, push=0.4), VEHICLE, steps=[step])
    assert step.estimate.state[3] == pytest.approx(0.2, rel=0.1)  # 0.4 m/s² for 0.5 s


@pytest.mark.parametrize("push", [0.2, -0.2])
@pytest.mark.parametrize("yaw", [0.3, np.pi])
def test_the_first_pulse_pushes_a_drifting_craft_uphill(push, yaw):
    link = Still(rate=120.0, push=push, place=(0.02, -0.01, yaw))
    commission(link, VEHICLE, steps=[Rest(), Pulses()], stopped=lambda: link.now > 1.2)
    [motor] = np.flatnonzero(next(c for c in link.sent if (c > VEHICLE.idle + 1e-3).any()) > 0.1)
    [[along_x, _]] = turned(np, VEHICLE.directions[[motor]], yaw)
    assert along_x * push < -0.7 * abs(push)


@pytest.mark.parametrize(
    ("kinds", "named"),
    [
        (("actuator", "control"), "control"),
        (("physics", "control"), "physics"),
        (("actuator",), "actuator"),
    ],
)
def test_a_weak_motor_is_named_only_if_there_is_no_other_cause(kinds, named):
    found = SimpleNamespace(findings=[Finding(kind, kind) for kind in kinds])
    assert first_cause(found).kind == named
