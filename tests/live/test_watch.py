"""Watching a craft on the graph: a flight of a known craft, on a graph in memory."""

import numpy as np
import pytest

from airpuck.live.process import HEARTBEATS, Process
from airpuck.live.settings import LiveSettings
from airpuck.live.watch import Observer, watch_live
from airpuck.model.model_file import published_model

from ..apparatus.graph_in_memory import joined
from ..apparatus.processes import COMMANDS, POSES
from ..apparatus.synthetic_flights import record

MODEL = published_model("M3")


def flying(graph, seconds: float, share: float = 1.0) -> None:
    """Publish a flight in which the first motor gives a share of its commands."""
    flight = record(duration=seconds, noise=5e-5)
    start = flight["pose"].stamp_ns[0]
    for topic, name in ((POSES, "pose"), (COMMANDS, "command")):
        for stamp, values in zip(flight[name].stamp_ns, flight[name].values, strict=True):
            told = values / ([share, 1, 1, 1, 1, 1] if name == "command" else 1)
            graph.publish((stamp - start) / 1e9 + 0.01, topic, told)


def test_a_weak_motor_is_named(monkeypatch):
    graph, lines = joined(monkeypatch), []
    flying(graph, 2.1, 0.6)
    found = watch_live(MODEL, lines.append, LiveSettings(duration=2.1))
    motor = MODEL.vehicle.propeller_names[0]
    assert len(lines) == 2
    assert [f"{motor} gives" in line for line in lines] == [False, True]
    assert [f"{motor} gives" in event for event in graph.events] == [False, True]
    assert [state for _, state, _ in graph.states] == lines
    # The share of thrust, which is not linear in the command.
    assert 0.4 < found["propellers"][motor]["effectiveness"] < 0.7
    assert found["flying"]


def test_findings_of_a_controller_are_shown(monkeypatch):
    flight, lines = joined(monkeypatch), []
    with Process("airpuck fly", LiveSettings(quiet=True)) as process:
        process.start("")
        flight.clock.sleep_until(0.5)
        process.events.heartbeat("info", "exact", {"found: left": "62 ± 3 %", "misses": 0})
    graph = joined(monkeypatch)
    graph.replay(flight, HEARTBEATS.name)
    watch_live(MODEL, lines.append, LiveSettings(duration=1.2))
    assert lines[1:] == ["the controller finds: left 62 ± 3 %"]


def test_rates_and_newest_values_match_the_messages(monkeypatch):
    graph = joined(monkeypatch)
    flying(graph, 1.2)
    with Process("watch", LiveSettings(quiet=True)) as process:
        observer, poses = Observer(process, MODEL), []
        process.start("")
        for time in np.arange(0.02, 1.1, 0.02):
            graph.clock.sleep_until(time)
            poses += observer.look()
    flight = record(duration=1.2, noise=5e-5)
    np.testing.assert_allclose(poses, flight["pose"].values[: len(poses)], atol=1e-6)
    np.testing.assert_array_equal(observer.newest["pose"], poses[-1])
    assert observer.rates == pytest.approx({"pose": 240.0, "command": 100.0}, rel=0.05)
    assert observer.age("pose") < 0.021 and observer.age("estimate") == np.inf
