"""The twin, the controller and the recorder as real processes that are killed and stopped.

Thresholds leave room for a machine that is busy with other tests; `studies/live_loop.py` has the
strict ones.
"""

import json
import signal
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from airpuck import Limits, Recording, Stream, identify, plan, preprocess, read_recording
from airpuck.flight.track import Track
from airpuck.live.graph import SENSOR, STATE, Graph
from airpuck.model.model_file import published_model
from airpuck.recording.message import MessageCodec, StreamCodec, definitions
from airpuck.twin.experiments import track
from airpuck.twin.settings import default_twin_settings

from ..apparatus.changes import changed
from ..apparatus.processes import CODECS, COMMANDS, EVENT, IDLE, POSES, REFERENCES, Process, Watch
from ..apparatus.recovery import assert_recovered

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

TRUTH = published_model("M3")
#: Room for a busy machine [s].
SLACK = 0.1
#: A gap in the messages of a process from which on the machine, not the controller, decides [s].
STALL = 0.05


class Table:
    """One twin, one watcher and at most one flight, all on one domain."""

    def __init__(self, domain: int) -> None:
        self.domain = domain
        self.watch = Watch(domain)
        self.twin = Process("twin", domain=domain)
        self.pilot: Process | None = None
        codec = CODECS[REFERENCES]
        self._hand = self.watch.graph.publisher(REFERENCES, codec.msgtype, codec.types, STATE)

    def fly(self, *arguments: object) -> Process:
        """Return a flight, the running one if it can be used; by default it follows the graph."""
        if self.pilot is None or not self.pilot.alive:
            self.watch.forget()
            given = arguments or ("--follow",)
            self.pilot = Process("fly", "paper:M3", *given, domain=self.domain, terminal=True)
            self.until_flying(60.0)
        return self.pilot

    def until_flying(self, timeout: float = 30.0) -> None:
        """Wait until the controller reports an event, again if it has reported it before."""
        told = self.watch.events
        self.watch.until(lambda: any(e.startswith("flying") for e in told("fly")), timeout)

    def go(self, *pose: float) -> None:
        """Move the set point of the flight."""
        for _ in range(4):  # a new flight may not have discovered the publisher yet
            self._hand.send(CODECS[REFERENCES].encode(0, (*pose, 0.0, 0.0, 0.0)))
            self.watch.run(0.05)

    def arrives(self, *pose: float, within: tuple[float, float] = (0.04, 0.25)) -> None:
        """Wait until the craft's median position over half a second is at a place."""
        self.watch.forget()
        self.stays(*pose, within=within)

    def stays(self, *pose: float, within: tuple[float, float]) -> None:
        """Wait until the median of the poses received in half a second is at a place."""

        def there() -> bool:
            poses = np.array(self.watch.values(POSES)[-120:])
            if len(poses) < 120:
                return False
            off = np.abs(np.median(poses, axis=0) - pose)
            return bool((off < (within[0], *within)).all())

        self.watch.until(there)

    def flies(self) -> bool:
        """Return whether the last commands steer."""
        commands = self.watch.values(COMMANDS)[-3:]
        return len(commands) == 3 and all((np.abs(c - IDLE) > 1e-9).any() for c in commands)

    def idles(self) -> bool:
        """Return whether the last commands idle."""
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
    """Drop the poses of the craft that coasts after its flight."""
    pose, end = recording["pose"], recording["estimate"].received_ns[-1]
    flown = pose.received_ns <= end
    cut = Stream(pose.stamp_ns[flown], pose.received_ns[flown], pose.values[flown], pose.columns)
    return replace(recording, streams={**recording.streams, "pose": cut})


def test_a_flight_to_a_set_point_matches_the_offline_twin(table, tmp_path):
    watch, goal = table.watch, (0.4, -0.2, 1.0)
    with recorded(table.domain, tmp_path / "bag"):
        watch.until(lambda: watch.events("record") and watch.heard[POSES], 60.0)
        pilot = table.fly("--setpoint", 0, 0, 0, "--setpoint", *goal, "--dwell", 1, "--json", "-")
        table.stays(*goal, within=(0.01, 0.05))
        watch.run(2.0)
        pilot.press("q")
        status, out, err = pilot.end()
        watch.run(0.3)
    assert status == 0, err

    commands = np.array(watch.values(COMMANDS))
    assert commands.min() >= IDLE
    assert commands.max() <= 1.0
    np.testing.assert_array_equal(commands[-1], np.full(6, IDLE))
    assert watch.heard["/navigation/state"]
    assert len(watch.heard["/diagnostics"]) >= 8  # two processes with a heartbeat once a second
    figures = json.loads(out)
    assert figures["outcomes"]["exact"] > 350
    assert figures["pose_to_command_ms"]["p50"] < 10

    recording = read_recording(tmp_path / "bag")
    assert recording.warnings == ()
    track_live = Track.of(until_landing(recording), TRUTH.vehicle, "live")
    (live,), points = track_live.moves(), track_live.set_points
    offline = track(TRUTH, points, 6.0).recording
    (planned,) = Track.of(offline, TRUTH.vehicle, "offline").moves()
    assert live.pose == pytest.approx(goal)
    assert live.settling_time == pytest.approx(planned.settling_time, abs=0.3)
    apart = np.abs(np.subtract(live.steady_state_error, planned.steady_state_error))
    assert (apart < (5e-3, 5e-3, 0.05)).all()
    assert_events_of_all_are_recorded(tmp_path / "bag")


def test_a_plan_is_flown_once_the_craft_rests_at_its_start(table, tmp_path, monkeypatch):
    # No flight needs the lower bound, which takes seconds.
    monkeypatch.setattr("airpuck.planning.plan._bound", lambda *_: None)
    limits = Limits(reserve=0.1)
    planned = plan(TRUTH, (0.2, 0, 0), (-0.2, 0, 0.5), limits=limits, intervals=20)
    planned.save(tmp_path / "plan.toml")
    watch, goal = table.watch, planned.states[-1, :3]  # of the program: met within 1 mm
    pilot = table.fly("--plan", tmp_path / "plan.toml")
    try:
        watch.until(lambda: watch.heard[REFERENCES])
        watch.until(lambda: np.abs(watch.newest(REFERENCES)[:3] - goal).max() < 2e-3, 40.0)
        watch.run(1.0)
        # After a pause of the machine in flight the craft may be elsewhere, but must come back.
        table.stays(*goal, within=(0.03, 0.25))
    finally:
        pilot.press("q")
        status, _, err = pilot.end()
    assert status == 0, err
    asked, asked_at = np.array(watch.values(REFERENCES)), np.array(watch.sent(REFERENCES))
    poses, seen_at = np.array(watch.values(POSES)), np.array(watch.sent(POSES))
    moving = np.flatnonzero(np.abs(asked[:, 3:]).max(axis=1) > 1e-3)
    begins, ends = asked_at[moving[[0, -1]]]
    assert ends - begins == pytest.approx(planned.duration, abs=SLACK)
    rests = (seen_at > begins - 0.8) & (seen_at < begins)
    assert np.abs(poses[rests, :2] - (0.2, 0)).max() < 0.01
    there = seen_at > ends + 0.5
    assert there.any()
    sent = np.array(watch.sent(COMMANDS))
    gaps = [np.diff(times[times > begins]).max() for times in (seen_at, sent)]
    if max(gaps) < STALL:
        assert np.abs(poses[there, :2] - (-0.2, 0)).max() < 0.03


def assert_events_of_all_are_recorded(folder) -> None:
    """Heartbeats of the twin, the controller, and the recorder itself, with its first and last."""
    from rosbags.highlevel import AnyReader

    with AnyReader([folder]) as reader:
        connections = [c for c in reader.connections if c.topic == "/rosout"]
        said = [EVENT.decode(bytes(raw)) for _, _, raw in reader.messages(connections)]
    names = [event.name for event in said]
    assert set(names) == {"airpuck twin", "airpuck fly", "airpuck record"}
    own = [event.msg for event in said if event.name == "airpuck record"]
    assert own[0].startswith("on domain")
    assert own[-1].startswith("ends after")


def test_one_key_stops_the_motors_and_another_releases_them(table):
    pilot, watch = table.fly(), table.watch
    watch.forget()
    pilot.press(" ")
    watch.until(lambda: watch.said("motors idle: stopped by the operator"))
    watch.run(0.1)
    assert table.idles()
    watch.forget()
    pilot.press("g")
    table.until_flying()


def test_a_second_controller_exits_and_names_the_first(table):
    first = table.fly()
    second = Process("fly", "paper:M3", domain=table.domain)
    status, _, err = second.end()
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    assert f"another controller already: airpuck fly (process {first.pid} on" in err
    table.watch.until(table.flies, 10.0)


def test_motors_idle_while_poses_are_missing(table):
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
    table.until_flying()
    watch.until(table.flies)


def test_a_suspended_controller_resumes(table):
    pilot, watch = table.fly(), table.watch
    watch.forget()
    pilot.signal(signal.SIGSTOP)
    try:
        watch.until(lambda: watch.said("no command for 200 ms, motors stopped"))
    finally:
        pilot.signal(signal.SIGCONT)
    watch.until(lambda: watch.said("commands arrive, motors run"))
    watch.until(table.flies)


def test_invalid_messages_are_survived_and_reported(table):
    table.fly()
    watch, pose = table.watch, CODECS[POSES]
    other = dict(definitions(""))
    other[pose.msgtype] = other["std_msgs/msg/String"]
    liar, impostor = (Graph(name, domain=table.domain) for name in ("liar", "impostor"))
    lies = liar.publisher(POSES, pose.msgtype, pose.types, SENSOR)
    # The right topic with another type, and another topic.
    noise = impostor.publisher(POSES, pose.msgtype, other, SENSOR)
    foreign = StreamCodec("estimate")
    stranger = Graph("stranger", domain=table.domain)
    stranger.publisher(POSES, foreign.msgtype, foreign.types, SENSOR)
    try:
        watch.forget()
        text = MessageCodec("std_msgs/msg/String")
        message = text.message()
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
        watch.forget()
        table.until_flying()
    finally:
        for graph in (liar, impostor, stranger):
            graph.close()


def test_huge_numbers_on_the_graph_end_neither_process(table):
    pilot, watch, codec = table.fly(), table.watch, CODECS[COMMANDS]
    watch.forget()
    table.go(0.2, 0.1, 1e300)
    watch.until(lambda: watch.said("numbers on /control/state_ref beyond 1e+06"))
    impostor = Graph("impostor", domain=table.domain)
    try:
        hand = impostor.publisher(COMMANDS, codec.msgtype, codec.types, SENSOR)
        for _ in range(40):
            hand.send(codec.encode(time.time_ns(), np.full(6, 1e9)))
            watch.run(0.02)
    finally:
        impostor.close()
    watch.until(lambda: watch.said("numbers on /drone/control beyond 1e+06"))
    assert pilot.alive
    assert table.twin.alive
    watch.forget()
    table.until_flying()
    table.go(0.2, 0.1, 0.5)
    table.arrives(0.2, 0.1, 0.5)


def test_a_set_point_from_the_graph_is_reached_unless_it_is_outside(table):
    table.fly()
    table.watch.forget()
    table.go(9.0, 0.1, 0.5)
    table.watch.until(lambda: table.watch.said("outside the geofence"))
    table.go(-0.2, 0.1, 0.5)
    table.arrives(-0.2, 0.1, 0.5)


def test_a_killed_controller_stops_the_motors_and_can_be_replaced(table):
    pilot, watch = table.fly(), table.watch
    table.go(-0.5, 0.0, 0.0)
    table.arrives(-0.5, 0.0, 0.0, within=(0.1, 1.0))
    table.go(0.5, 0.0, 0.0)
    watch.run(0.8)  # on its way
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
    table.fly()  # not refused, once the dead one is off the graph


def test_a_killed_twin_idles_the_motors_and_the_next_one_can_fly(table, tmp_path):
    watch, goal = table.watch, (0.2, 0.1, 0.5)
    table.fly()
    table.go(*goal)
    watch.forget()
    table.twin.kill()
    watch.until(lambda: watch.said("motors idle: no pose for 50 ms"))
    outages = tuple((float(t), float(t) + 0.1) for t in range(1, 60))
    radio = {"loss": 0.3, "outages_s": outages}
    bad = changed(default_twin_settings(), radio=radio, motion_capture={"dropped": 0.3})
    bad.save(tmp_path / "bad.toml")
    watch.forget()
    table.twin = Process("twin", "--twin", tmp_path / "bad.toml", domain=table.domain)
    table.until_flying(60.0)  # without a restart
    watch.run(2.0)  # through two outages
    table.arrives(*goal, within=(0.05, 0.3))


@pytest.mark.study
def test_half_a_minute_of_excitation_recovers_the_parameters(table, tmp_path):
    watch = table.watch
    if table.pilot is not None:
        table.pilot.kill()
    table.twin.kill()
    table.twin = Process("twin", "--seed", 3, domain=table.domain)
    watch.until(lambda: not watch.graph.publishers(POSES) or watch.heard[POSES])
    folder = tmp_path / "bag"
    recorder = Process("record", "-q", "-o", folder, domain=table.domain)
    try:
        watch.run(1.0)
        arguments = ("--duration", 30, "--json", tmp_path / "flight.json", "-q")
        flight = Process("fly-excitation", "--seed", 3, *arguments, domain=table.domain)
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
