"""Recordings in which something looks wrong."""

from dataclasses import replace
from pathlib import Path

from airpuck.craft.vehicle import read_vehicle
from airpuck.evaluation.suspects import unit_suspect
from airpuck.model.model_file import nominal_model

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_an_inertia_is_compared_with_a_ring_around_all_propellers():
    start = nominal_model(read_vehicle(EXAMPLES / "free_flyers/freeflyer2.toml"))
    model = replace(start, free=start.parameters.mask(frozenset({"inertia"})))
    # Its thrusters are at 1.6 times the radius of its base.
    assert unit_suspect(model) == []
    inertia = 3 * model.parameters.inertia
    (said,) = unit_suspect(replace(model, parameters=replace(start.parameters, inertia=inertia)))
    assert said.kind == "units" and "larger than a ring's" in said.cause
