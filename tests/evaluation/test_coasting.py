"""From which horizon a model predicts better than coasting."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.coasting import better_from
from airpuck.evaluation.evaluate import evaluate
from airpuck.model.model_file import read_model

PERIOD, PUSH = 1 / 240, 0.5


@pytest.fixture(scope="module")
def accelerated() -> Trajectory:
    """A craft that accelerates forward steadily."""
    time = PERIOD * np.arange(14400)
    state = np.zeros((len(time), 6))
    state[:, 0], state[:, 3] = PUSH / 2 * time**2, PUSH * time
    push = np.tile([PUSH, 0.0, 0.0], (len(time), 1))
    names = default_vehicle().propeller_names
    return Trajectory(time, state, push, time, np.full((len(time), 6), 0.5), names)


@pytest.mark.parametrize("error", [1e-3, 4e-3])
def test_coasting_is_worse_once_it_has_missed_by_more_than_the_model(accelerated, error):
    evaluation = evaluate(read_model("paper:M3"), accelerated)
    known = replace(evaluation, errors=np.zeros_like(evaluation.errors))
    known.errors[:, 0] = error
    found = better_from(known, accelerated)
    # Coasting misses by a t²/2.
    assert found.since == pytest.approx(np.sqrt(2 * error / PUSH), abs=1.5 * PERIOD)
    assert found.interval is not None
    assert found.interval[0] <= found.since <= found.interval[1]


def test_a_model_that_is_never_better_says_so(accelerated):
    evaluation = evaluate(read_model("paper:M3"), accelerated)
    poor = replace(evaluation, errors=np.ones_like(evaluation.errors))
    assert better_from(poor, accelerated).since is None
