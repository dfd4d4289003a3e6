"""The twin, the controller and the recorder as processes that are really killed and stopped.

Thresholds leave room for a machine that is busy with other tests; `studies/live_loop.py` has the
strict ones.
"""

from __future__ import annotations

import json
import signal
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from airpuck import identify, preprocess, read_recording
from airpuck.flight.track import Track
from airpuck.live.graph import SENSOR, STATE, Graph
from airpuck.model_file import published_model
from airpuck.recording.message import MessageCodec, StreamCodec
from airpuck.recording.message_types import definitions
from airpuck.recording.stream import Recording, Stream
from airpuck.twin.experiments import track
from airpuck.twin.settings import default_twin_settings

from ..recovered import assert_recovered
from .processes import CODECS, COMMANDS, IDLE, POSES, REFERENCES, Process, Watch

TRUTH = published_model("M3")
#: Room for a busy machine [s].
SLACK = 0.1


class Table:
    """One twin, one watcher and at most one flight, all on one domain."""

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.watch = Watch(domain)
        self.twin = Process("twin", domain=domain)
        self.pilot: Process | None = None

    def fly(self, *arguments: object, terminal: bool = False) -> Process:
        """A flight that holds the middle of the table, or as told; flying when this returns."""
        if self.pilot is None or not self.pilot.alive or arguments or terminal:
            self.land()
            self.watch.until(lambda: self.watch.heard[POSES])
            self.watch.forget()
            self.pilot = Process(
                "fly", "--model", "paper:M3", *arguments, domain=self.domain, terminal=terminal
            )
            self.watch.until(lambda: "flying" in self.watch.events("fly"))
        return self.pilot

    def land(self) -> tuple[int, str, str] | None:
        """End the flight in order."""
        if self.pilot is None or not self.pilot.alive:
            return None
        self.pilot.signal(signal.SIGINT)
        return self.pilot.end()

    def flies(self) -> bool:
        """Whether the last commands steer."""
        commands = self.watch.values(COMMANDS)[-3:]
        return len(commands) == 3 and all((np.abs(c - IDLE) > 1e-9).any() for c in commands)

    def idles(self) -> bool:
        """Whether the last commands idle."""
        commands = self.watch.values(COMMANDS)[-3:]
        return len(commands) == 3 and all(np.abs(c - IDLE).max() < 1e-9 for c in commands)

    def close(self) -> None:
        for process in (self.pilot, self.twin):
            if process is not None:
                process.kill()
        self.watch.close()


@pytest.fixture(scope="module")
def table(domain):
    made = Table(domain)
    yield made
    made.close()


@contextmanager
def recorded(domain, folder):
    """Record in a process meanwhile."""
    process = Process("record", "-q", "-o", folder, domain=domain)
    try:
        yield process
        process.signal(signal.SIGTERM)
        assert process.end()[0] == 0
    finally:
        process.kill()


def until_landing(recording: Recording) -> Recording:
    """Leave out how the craft coasted after its flight."""
    pose, end = recording["pose"], recording["estimate"].received_ns[-1]
    flown = pose.received_ns <= end
    cut = Stream(pose.stamp_ns[flown], pose.received_ns[flown], pose.values[flown], pose.columns)
    return replace(recording, streams={**recording.streams, "pose": cut})


def test_a_flight_to_a_set_point_is_that_of_the_offline_twin(table, tmp_path):
    watch, goal = table.watch, (0.4, -0.2, 1.0)
    watch.until(lambda: watch.heard[POSES])
    with recorded(table.domain, tmp_path / "bag"):
        watch.run(1.0)
        table.fly("--setpoint", 0, 0, 0, "--setpoint", *goal, "--dwell", 1, "--json", "-")
        watch.run(5.0)
        status, out, err = table.land()
        watch.run(0.3)
    assert status == 0, err

    commands = np.array(watch.values(COMMANDS))
    assert commands.min() >= IDLE
    assert commands.max() <= 1.0
    np.testing.assert_array_equal(commands[-1], np.full(6, IDLE))
    assert watch.heard["/navigation/state"]
    assert len(watch.heard["/diagnostics"]) >= 8  # two hearts that beat once a second
    figures = json.loads(out)
    assert figures["outcomes"]["exact"] > 400
    assert figures["pose_to_command_ms"]["p50"] < 10

    recording = read_recording(tmp_path / "bag")
    assert recording.warnings == ()
    track_live = Track.of(until_landing(recording), TRUTH.vehicle, "live")
    (live,), points = track_live.moves(), track_live.set_points
    offline, _ = track(TRUTH, points, 7.0)
    (planned,) = Track.of(offline, TRUTH.vehicle, "offline").moves()
    assert live.pose == pytest.approx(goal)
    assert live.settling_time == pytest.approx(planned.settling_time, abs=0.3)
    apart = np.abs(np.subtract(live.steady_state_error, planned.steady_state_error))
    assert (apart < (5e-3, 5e-3, 0.05)).all()


def test_a_key_stops_the_motors_and_another_lets_them_run(table):
    pilot, watch = table.fly(terminal=True), table.watch
    watch.forget()
    pilot.press(" ")
    watch.until(lambda: watch.said("motors idle: stopped by the operator"))
    watch.run(0.6)
    assert table.idles()
    pilot.press("g")
    watch.until(lambda: "flying" in watch.events("fly"))


def test_a_second_controller_refuses_and_says_whose_the_first_is(table):
    first = table.fly()
    second = Process("fly", "--model", "paper:M3", domain=table.domain)
    status, _, err = second.end()
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    assert f"another controller already: airpuck fly (process {first.pid} on" in err
    table.watch.run(0.1)
    assert table.flies()


def test_poses_that_stop_idle_the_motors_until_they_are_back(table):
    table.fly()
    watch = table.watch
    watch.forget()
    watch.run(0.2)
    table.twin.signal(signal.SIGSTOP)
    try:
        watch.until(lambda: watch.said("motors idle: no pose for 50 ms"), 5.0)
        watch.run(0.3)
    finally:
        table.twin.signal(signal.SIGCONT)
    commands, times = np.array(watch.values(COMMANDS)), np.array(watch.sent(COMMANDS))
    last_pose = watch.sent(POSES)[-1]
    idle = np.abs(commands - IDLE).max(axis=1) < 1e-9
    silent = times > last_pose
    first_idle = times[silent & idle][0]
    assert first_idle - last_pose < 0.06 + SLACK
    assert idle[times >= first_idle].all()
    watch.until(lambda: "flying" in watch.events("fly"))
    watch.until(table.flies)


def test_a_controller_that_stood_still_goes_on(table):
    pilot, watch = table.fly(), table.watch
    watch.forget()
    pilot.signal(signal.SIGSTOP)
    try:
        watch.until(lambda: watch.said("no command for 200 ms, motors stopped"))
    finally:
        pilot.signal(signal.SIGCONT)
    watch.until(lambda: watch.said("commands arrive, motors run"))
    watch.until(table.flies)


def test_motors_idle_while_somebody_else_sends_commands(table):
    table.fly()
    watch, command = table.watch, CODECS[COMMANDS]
    watch.forget()
    rival = Graph("joystick", domain=table.domain)
    rival.publisher(COMMANDS, command.msgtype, command.types, SENSOR)
    watch.until(lambda: watch.said("motors idle: another controller is on the graph: joystick"))
    rival.close()
    watch.until(lambda: "flying" in watch.events("fly"))


def test_garbage_is_survived_and_told(table):
    table.fly()
    watch, pose = table.watch, CODECS[POSES]
    other = dict(definitions(""))
    other[pose.msgtype] = other["std_msgs/msg/String"]
    liar, impostor = (Graph(name, domain=table.domain) for name in ("liar", "impostor"))
    lies = liar.publisher(POSES, pose.msgtype, pose.types, SENSOR)
    # The right name with another content, and another name.
    noise = impostor.publisher(POSES, pose.msgtype, other, SENSOR)
    foreign = StreamCodec("estimate")
    stranger = Graph("stranger", domain=table.domain)
    stranger.publisher(POSES, foreign.msgtype, foreign.types, SENSOR)
    try:
        watch.forget()
        text = MessageCodec("std_msgs/msg/String")
        message = text.blank()
        message.data = 300 * "nonsense"
        for _ in range(20):
            noise.send(text.encode(message))
            watch.run(0.02)
        watch.until(lambda: watch.said("stranger (process "))
        assert watch.said("publishes holohover_msgs/msg/HolohoverStateStamped on /optitrack/drone")
        lies.send(pose.encode(0, (0.0, 0.0, 0.0)))
        watch.until(lambda: watch.said("wrong or late stamp on /optitrack/drone/pose"))
        watch.until(table.flies)
        assert not watch.said("motors idle")

        nothing = (np.nan, 0.0, 0.0)
        watch.until(
            lambda: (
                lies.send(pose.encode(time.time_ns(), nothing))
                or watch.said("motors idle: pose is not finite")
            )
        )
        watch.until(lambda: "flying" in watch.events("fly"))
    finally:
        for graph in (liar, impostor, stranger):
            graph.close()


def test_a_killed_controller_stops_the_motors_and_another_may_follow(table):
    watch = table.watch
    table.land()
    table.fly("--setpoint", 0.5, 0, 0, "--setpoint", -0.5, 0, 0, "--dwell", 1.5)
    watch.run(2.0)  # on its way
    pilot = table.pilot
    watch.forget()
    pilot.kill()
    watch.until(lambda: watch.said("no command for 200 ms, motors stopped"))
    watch.run(0.5)
    # Without motors nothing pushes: from 0.4 s after the last command on the velocity is constant.
    times, poses = np.array(watch.stamps(POSES)), np.array(watch.values(POSES))
    start = (watch.stamps(COMMANDS) or [times[0]])[-1] + 0.4
    coasting = (times > start) & (np.abs(poses[:, 0]) < 0.9) & (np.abs(poses[:, 1]) < 0.4)
    assert coasting.sum() > 20
    for axis in (0, 1):
        line = np.polyfit(times[coasting] - start, poses[coasting, axis], 1)
        apart = poses[coasting, axis] - np.polyval(line, times[coasting] - start)
        assert np.abs(apart).max() < 2e-3
    table.pilot = None
    table.fly("--topic")  # not refused, once the dead one is off the graph


def test_a_set_point_from_the_graph_is_flown_to_unless_it_is_outside(table):
    table.fly("--topic")
    watch, reference = table.watch, CODECS[REFERENCES]
    hand = Graph("hand", domain=table.domain)
    moves = hand.publisher(REFERENCES, reference.msgtype, reference.types, STATE)
    far, near = ((x, 0.1, 0.5, 0.0, 0.0, 0.0) for x in (9.0, -0.2))
    watch.until(lambda: moves.send(reference.encode(0, far)) or watch.said("outside the geofence"))
    for _ in range(40):
        moves.send(reference.encode(0, near))
        watch.run(0.1)
    hand.close()
    here = np.median(np.array(watch.values(POSES))[-50:], axis=0)
    assert (np.abs(here - near[:3]) < (0.03, 0.03, 0.2)).all()


def test_a_killed_twin_idles_the_motors_and_a_bad_radio_does_not_stop_the_next(table, tmp_path):
    watch = table.watch
    table.fly("--setpoint", 0.2, 0.1, 0.5)
    watch.forget()
    table.twin.kill()
    watch.until(lambda: watch.said("motors idle: no pose for 50 ms"))
    settings = default_twin_settings()
    outages = tuple((float(t), float(t) + 0.1) for t in range(1, 60))
    radio = settings.radio.model_copy(update={"loss": 0.3, "outages_s": outages})
    capture = settings.motion_capture.model_copy(update={"dropped": 0.3})
    bad = settings.model_copy(update={"radio": radio, "motion_capture": capture})
    bad.save(tmp_path / "bad.toml")
    watch.forget()
    table.twin = Process("twin", "--twin", tmp_path / "bad.toml", domain=table.domain)
    watch.until(lambda: "flying" in watch.events("fly"))  # without a restart
    watch.run(5.0)
    here = np.median(np.array(watch.values(POSES))[-100:], axis=0)
    assert (np.abs(here - (0.2, 0.1, 0.5)) < (0.05, 0.05, 0.3)).all()


@pytest.mark.study
def test_half_a_minute_of_excitation_gives_the_twins_parameters_back(table, tmp_path):
    watch = table.watch
    table.land()
    table.twin.kill()
    table.twin = Process("twin", "--seed", 3, domain=table.domain)
    watch.until(lambda: not watch.graph.publishers(POSES) or watch.heard[POSES])
    folder = tmp_path / "bag"
    recorder = Process("record", "-q", "-o", folder, domain=table.domain)
    try:
        watch.run(1.0)
        arguments = ("--duration", 30, "--json", tmp_path / "flight.json", "-q")
        flight = Process("fly", "--excite", "--seed", 3, *arguments, domain=table.domain)
        try:
            for _ in range(60):
                watch.run(1.0)
                watch.heard.clear()
                if not flight.alive:
                    break
            status, _, err = flight.end()
            assert status == 0, err
        finally:
            flight.kill()
        watch.run(1.2)
        recorder.kill()  # the recorder is killed: at most the last second is lost
    finally:
        recorder.kill()
    figures = json.loads((tmp_path / "flight.json").read_text())
    assert figures["periods"] > 2800
    assert figures["period_jitter_ms"]["p50"] < 5
    assert figures["pose_to_command_ms"]["p50"] < 10

    recording = read_recording(folder)
    assert len(recording["command"]) >= figures["periods"]
    fit = identify(preprocess(recording), "M3")
    assert_recovered(fit.model.parameters, TRUTH.parameters)
