"""Scenarios: what a file states, and mistakes in it."""

import numpy as np
import pytest

import airpuck
from airpuck.fleet.scenario import Fleet, FleetCraft, Obstacle, Scenario, packaged_scenarios

A = {"name": "a", "start": (-0.5, 0.0, 0.0), "goal": (0.5, 0.0, 0.0)}
B = {"name": "b", "start": (0.5, 0.3, 0.0), "goal": (-0.5, 0.3, 0.0)}


def fleet(*craft, **scenario):
    """Return a fleet of craft given as dictionaries."""
    return Fleet(Scenario(craft=tuple(FleetCraft(**one) for one in craft), **scenario))


@pytest.mark.parametrize("name", packaged_scenarios())
def test_every_packaged_scenario_can_be_read(name):
    assert len(airpuck.read_fleet(name).members) >= 4


@pytest.mark.parametrize(
    ("craft", "scenario", "words"),
    [
        ((A, {**B, "name": "a"}), {}, "'a' is the name of two craft"),
        ((A, {**B, "start": (-0.45, 0.0, 0.0)}), {}, "of b is 0.05 m from that of a"),
        ((A, {**B, "goal": (0.5, 0.05, 0.0)}), {}, "of b is 0.05 m from that of a"),
        ((A, {**B, "goal": (1.09, 0.0, 0.0)}), {}, "of b is too close to a rail"),
        ((A,), {"obstacles": (Obstacle(x_m=0.45, y_m=0.0, radius_m=0.1),)}, "an obstacle"),
        ((A,), {"deaths": ({"craft": "x", "time_s": 1.0},)}, "'x'"),
        ((A, {**B, "goal": None}), {"formation": ((0, 0, 0), (0.3, 0.3, 0))}, "1 craft without"),
    ],
)
def test_a_mistake_ends_in_one_line(craft, scenario, words):
    with pytest.raises(airpuck.InputError, match=words):
        fleet(*craft, **scenario)


def test_formation_poses_are_assigned_to_minimise_travel():
    left, right = {**A, "goal": None}, {**B, "goal": None}
    flown = fleet(left, right, formation=((0.4, 0.1, 0.0), (-0.4, 0.1, 0.0)))
    np.testing.assert_allclose(flown.member("a").goal(0.0)[:2], (-0.4, 0.1))
    np.testing.assert_allclose(flown.member("b").goal(0.0)[:2], (0.4, 0.1))


def test_each_goal_applies_from_its_time():
    flown = fleet({**A, "goals": ((0.0, 0.0, 0.0, 0.0), (3.0, 0.4, 0.1, 1.0))})
    np.testing.assert_allclose(flown.member("a").goal(2.9), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(flown.member("a").goal(3.0), (0.4, 0.1, 1.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "craft"),
        ("craft = 3", "craft"),
        ('[[craft]]\nname = "a b"\nstart = [0, 0, 0]', "name"),
        ('[[craft]]\nname = "a"\nstart = [0, 0]', "start"),
        ('[[craft]]\nname = "a"\nstart = [0, nan, 0]', "start"),
        ('[[craft]]\nname = "a"\nstart = [0, 0, 0]\nmodel = "nobody.toml"', "nobody.toml"),
        ('[[craft]]\nname = "a"\nstart = [0, 0, 0]\n[network]\nloss = 2', "loss"),
    ],
)
def test_an_invalid_file_is_rejected_by_name(tmp_path, text, words):
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    with pytest.raises(airpuck.InputError, match=words):
        airpuck.read_fleet(path)


def test_an_unknown_scenario_lists_the_known_ones():
    with pytest.raises(airpuck.InputError, match="into_square"):
        airpuck.read_fleet("into_sqare")


def test_a_craft_takes_the_shorter_rotation_to_its_goal():
    flown = fleet({**A, "start": (-0.5, 0.0, 3.0), "goal": (0.5, 0.0, -3.0)})
    np.testing.assert_allclose(flown.member("a").goal(0.0)[2], 2 * np.pi - 3.0)
