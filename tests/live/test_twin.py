"""The twin's process, on a graph in memory; `test_processes` has it as a process."""

import numpy as np
import pytest

from airpuck.fleet.scenario import Fleet, FleetCraft, Scenario
from airpuck.live import twin
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import published_model
from airpuck.physics.puck import PuckState
from airpuck.recording.mapping import Topics

from ..apparatus.graph_in_memory import joined
from ..apparatus.processes import COMMANDS, IDLE, POSES

PUCKS = Topics().puck
MODEL = published_model("M3")


@pytest.fixture
def graph(monkeypatch):
    monkeypatch.setattr(twin, "prioritize", lambda **_: None)
    return joined(monkeypatch)


def live(seconds: float) -> LiveSettings:
    return LiveSettings(duration=seconds, quiet=True)


def test_motors_run_while_commands_arrive_and_changes_are_announced(graph):
    turning = np.full(6, IDLE)
    turning[0] = 0.5
    for time in np.arange(0.3, 0.5, 0.01):
        graph.publish(time, COMMANDS, turning)
    for time in np.arange(0.9, 1.2, 0.01):
        graph.publish(time, COMMANDS, turning)
    found = twin.serve_twin(MODEL, live(1.2))
    poses = np.array(graph.values(POSES))
    assert len(poses) == found["poses"] == pytest.approx(1.2 * 240, abs=5)
    assert (found["commands"], found["refused"], found["stops"]) == (50, 0, 1)
    assert np.abs(poses[:70] - poses[0]).max() < 0.01
    assert np.abs(poses[-1] - poses[0]).max() > 0.03
    run, stop = "commands arrive, motors run", "no command for 200 ms, motors stopped"
    assert graph.events[1:] == [run, stop, run]
    assert [text for _, text, _ in graph.states] == [
        "starting",
        "motors stopped: no commands",
        "motors run",
    ]
    assert int(graph.states[-1][2]["poses"]) == pytest.approx(240, abs=5)


@pytest.mark.parametrize(("side", "name"), [(1, "right"), (-1, "left")])
def test_a_puck_in_a_goal_returns_to_its_start(graph, side, name):
    start = PuckState(side * 0.7, 0.1, vx=side * 2.0)
    twin.serve_twin(MODEL, live(1.0), puck=start)
    told = f"the puck is in the {name} goal, and returns to its start"
    assert told in graph.events
    flown = np.array(graph.values(PUCKS, "puck"))
    returns = np.flatnonzero(side * np.diff(flown[:, 0]) < -0.1)
    assert len(returns) > 1
    np.testing.assert_allclose(
        flown[returns + 1, :2], [[start.x, start.y]] * len(returns), atol=0.03
    )


def test_measurements_are_lost_while_the_process_is_suspended(graph):
    graph.clock.at(0.3, lambda: graph.clock.sleep_until(0.5))
    found = twin.serve_twin(MODEL, live(1.0))
    assert found["poses"] == len(graph.values(POSES)) == pytest.approx(0.8 * 240, abs=5)
    (told,) = (event for event in graph.events if "measurements lost" in event)
    assert told.startswith("paused for 0.20")


def test_colliding_craft_are_named_with_their_closing_speed(graph):
    """A craft drives into another one at rest."""
    reach = 2 * MODEL.vehicle.radius_m
    starts = {"hunter": (0.0, 0.0, 0.0), "prey": (reach + 0.1, 0.0, 0.0)}
    craft = tuple(FleetCraft(name=k, start=one, goal=one) for k, one in starts.items())
    forwards = np.where(np.array(MODEL.vehicle.directions)[:, 0] > 0.1, 1.0, IDLE)
    for time in np.arange(0.1, 0.5, 0.05):
        graph.publish(time, COMMANDS, forwards, "/hunter")
    found = twin.serve_fleet(Fleet(Scenario(craft=craft)), live(0.5))
    hunter, prey = (np.array(graph.values(f"/{name}{POSES}", "pose")) for name in starts)
    assert np.abs(prey[:72] - prey[0]).max() < 0.01
    one, other, closing = found["contacts"][0]
    assert (one, other) == ("hunter", "prey")
    assert f"hunter and prey touch, closing at {closing:.2f} m/s" in graph.events
    # The hunter is fastest when it strikes; its path over ten poses gives its speed.
    fastest = np.max(hunter[10:, 0] - hunter[:-10, 0]) * 24.0
    assert closing == pytest.approx(fastest, rel=0.1)
    assert {name: craft["commands"] for name, craft in found["craft"].items()} == {
        "hunter": 8,
        "prey": 0,
    }
