"""Flights of several craft on the twin."""

import dataclasses

import numpy as np
import pytest

import airpuck
from airpuck.fleet.scenario import Death, Fleet, FleetCraft, Network, Scenario
from airpuck.twin.settings import Starts

LOSSY = Network(loss=0.3, delay_s=(0.01, 0.03))


def crossing(count, radius=(0.7, 0.4), **scenario):
    """Return craft on an ellipse that change places across its middle."""
    angles = 0.2 + 2 * np.pi * np.arange(count) / count
    places = np.column_stack([radius[0] * np.cos(angles), radius[1] * np.sin(angles)])
    craft = tuple(
        FleetCraft(name=f"h{k}", start=(*p, 0.0), goal=(*-p, 0.5)) for k, p in enumerate(places)
    )
    return Fleet(Scenario(craft=craft, network=LOSSY, **scenario))


def test_three_craft_cross_without_contact():
    flight = airpuck.fly_together(crossing(3))
    assert flight.settled < 6
    assert not flight.contacts
    assert flight.least_gap > 0
    assert (flight.strayed < flight.margins).all()
    goals = np.array([one.goals[-1] for one in crossing(3).members])
    assert np.abs(flight.poses[-1] - goals).max() < 0.1


def test_motors_that_cannot_restart_do_not_divert_a_craft():
    fleet = crossing(2)
    starts = Starts(rest_s=(0.0, 1.0), failed=(1.0, 0.0), lasting_s=1.0)
    fleet.settings = fleet.settings.model_copy(update={"starts": starts})
    flight = airpuck.fly_together(fleet)
    assert flight.settled < 6
    assert (flight.strayed < flight.margins).all()
    assert not flight.contacts


def test_a_seed_reproduces_a_flight():
    one, other = (airpuck.fly_together(crossing(2, duration_s=1.2), seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.poses, other.poses)


@pytest.mark.slow
def test_four_craft_rotate_around_a_ring_of_occupied_goals():
    places = 0.2 * np.column_stack(
        [np.cos(np.arange(4) * np.pi / 2), np.sin(np.arange(4) * np.pi / 2)]
    )
    craft = tuple(
        FleetCraft(name=f"r{k}", start=(*places[k], 0.0), goal=(*places[(k + 1) % 4], 0.0))
        for k in range(4)
    )
    flight = airpuck.fly_together(Fleet(Scenario(craft=craft, network=LOSSY)))
    assert flight.settled < 10
    assert not flight.contacts


@pytest.mark.slow
def test_two_craft_swap_places_where_they_can_barely_pass(tmp_path):
    (tmp_path / "narrow.toml").write_text("[table]\nwidth_m = 0.46\nlength_m = 1.6\n")
    craft = (
        FleetCraft(name="a", start=(-0.6, 0.0, 0.0), goal=(0.6, 0.0, 0.0)),
        FleetCraft(name="b", start=(0.6, 0.0, 0.0), goal=(-0.6, 0.0, 0.0)),
    )
    scenario = Scenario(craft=craft, network=LOSSY, twin="narrow.toml")
    flight = airpuck.fly_together(Fleet(scenario, tmp_path))
    assert flight.settled < 15
    assert not flight.contacts


@pytest.mark.slow
def test_the_others_arrive_without_contact_if_one_dies_at_rest():
    fleet = crossing(4, deaths=(Death(craft="h1", time_s=0.05),), duration_s=8.0)
    flight = airpuck.fly_together(fleet)
    live = [k for k, name in enumerate(flight.names) if name != "h1"]
    assert flight.died == {"h1": 0.05}
    assert not [c for c in flight.contacts if "h1" not in c[1:3]]
    # The goal of the opposite craft is where the dead one rests.
    arrived = [flight.arrived[flight.names[k]] for k in live]
    assert sorted(arrived)[1] < 8


def test_craft_that_collide_are_reported_with_their_closing_speed():
    # Their straight paths are 5 cm apart.
    left = FleetCraft(name="h0", start=(-0.5, 0.025, 0.0), goal=(0.5, 0.025, 0.0))
    right = FleetCraft(name="h1", start=(0.5, -0.025, 0.0), goal=(-0.5, -0.025, 0.0))
    fleet = Fleet(Scenario(craft=(left, right), network=LOSSY))
    for one in fleet.members:  # they believe that they have no size
        one.reach = dataclasses.replace(one.reach, radius=0.0, margin=0.0)
    flight = airpuck.fly_together(fleet)
    assert flight.contacts
    assert flight.contacts[0][1:3] == ("h0", "h1")
    assert 0 < flight.contacts[0][3] < 3
