"""Margins against flights on the twin, whose motors, delays and noise the bound does not know."""

from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.control.tuning import tuning_for
from airpuck.fleet.path import responses, tracking_margin
from airpuck.fleet.scenario import Fleet, FleetCraft, Scenario

MODEL = airpuck.read_model("paper:M3")


def strayed(strength, later):
    """Fly back and forth with a wrong thrust and response; return distance from path and margin."""
    goals = ((0.0, 0.5, 0.0, 0.0), (0.5, -0.5, 0.1, 1.0), (2.5, 0.5, -0.1, 0.0))
    craft = FleetCraft(name="h0", start=(-0.5, 0.0, 0.0), goals=goals)
    fleet = Fleet(Scenario(craft=(craft,), duration_s=5.0))
    true = replace(
        MODEL.parameters,
        thrust=MODEL.parameters.thrust * strength,
        transport_delay=MODEL.parameters.transport_delay + later,
    )
    fleet.members[0].truth = replace(MODEL, parameters=true)
    flight = airpuck.fly_together(fleet)
    return flight.strayed[0], flight.margins[0]


@pytest.mark.slow
@pytest.mark.parametrize(("strength", "later"), [(1.05, 0.003), (0.95, 0.003), (0.95, -0.003)])
def test_a_craft_with_the_assumed_error_stays_within_its_margin(strength, later):
    off, margin = strayed(strength, later)
    assert off < margin


@pytest.mark.slow
def test_a_much_weaker_craft_leaves_its_margin():
    off, margin = strayed(0.6, 0.02)
    assert off > margin


def test_a_later_response_or_harder_push_needs_more_margin():
    tuning = tuning_for(MODEL)
    assert tracking_margin(MODEL, tuning, 2.0) > tracking_margin(MODEL, tuning, 1.0)
    early, late = responses(tuning, 0.01), responses(tuning, 0.08)
    assert early[0] < late[0]
    assert early[1] < late[1]


def test_a_velocity_error_first_grows_without_feedback():
    # Before a command can act, an impulse of 1 m/s has moved the craft by the delay.
    period = tuning_for(MODEL).period_s
    _, change = responses(tuning_for(MODEL), 20 * period)
    assert change >= 2 * 20 * period * (1 - 1e-9)
    assert np.isfinite(change)
