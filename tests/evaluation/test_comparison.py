"""From which horizon a model predicts better than coasting."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.comparison import ModelDifference, better_from, model_differences
from airpuck.evaluation.evaluate import PROTOCOLS, Evaluation, EveryStart, evaluate
from airpuck.model.model_file import read_model

from ..apparatus.residuals import residuals

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
def test_coasting_is_worse_once_its_error_exceeds_the_models(accelerated, error):
    evaluation = evaluate(read_model("paper:M3"), accelerated)
    known = replace(evaluation, errors=np.zeros_like(evaluation.errors))
    known.errors[:, 0] = error
    found = better_from(known, accelerated)
    # Coasting misses by a t²/2.
    assert found.since == pytest.approx(np.sqrt(2 * error / PUSH), abs=1.5 * PERIOD)
    assert found.interval is not None
    assert found.interval[0] <= found.since <= found.interval[1]


def test_a_model_that_is_never_better_is_reported_as_such(accelerated):
    evaluation = evaluate(read_model("paper:M3"), accelerated)
    poor = replace(evaluation, errors=np.ones_like(evaluation.errors))
    assert better_from(poor, accelerated).since is None


def evaluation(errors, start):
    nothing = np.zeros((50, 3, 1))
    everywhere = EveryStart(errors, start)
    paper = PROTOCOLS["paper"]
    return Evaluation("M3", paper, "paper", nothing, start[:1], 1 / 240, 0, everywhere, 1)


def test_only_significant_differences_are_reported():
    errors, start = residuals(3, 60.0, 6)
    base, own = errors[:3], errors[3:]
    # x a fifth smaller, y as large, yaw a fifth larger.
    other = np.array([0.8, 1.0, 1.2])[:, None] * base + 0.05 * own
    (found,) = model_differences(["A", "B"], [evaluation(e, start) for e in (base, other)])
    assert found.differs == [True, False, True]
    ratio = np.sqrt(np.mean(other**2, axis=1) / np.mean(base**2, axis=1))
    np.testing.assert_allclose(found.ratio, ratio)
    better, same, worse = found.verdict.split(", ")
    assert better.startswith(f"B against A: x {100 * (1 - ratio[0]):.1f} % better (")
    assert same.startswith("y: no difference shown (") and same.endswith(" % worse)")
    assert worse.startswith(f"yaw {100 * (ratio[2] - 1):.1f} % worse (")
    written = found.to_json()
    assert written["differs"] == {"x_m": True, "y_m": False, "yaw_rad": True}
    low, high = written["interval_95"]["x_m"]
    assert low < written["rmse_ratio"]["x_m"] < high


def test_equal_models_show_no_difference():
    errors, start = residuals(5, 60.0, 15)
    shared = errors[:3]
    flown = [evaluation(shared + 0.3 * errors[k : k + 3], start) for k in (3, 6, 9, 12)]
    found = model_differences(list("ABCD"), flown)
    assert len(found) == 6
    assert all(one.verdict.endswith("no difference shown") for one in found)


def test_short_recordings_are_not_judged():
    errors, start = residuals(0, 5.0, 3)
    (found,) = model_differences(["A", "B"], [evaluation(e, start) for e in (errors, 2 * errors)])
    assert "too few seconds" in found.verdict
    written = found.to_json()
    assert written["interval_95"]["x_m"] is None and written["p_value"]["x_m"] is None
    assert found.differs == [False, False, False]
    assert model_differences(["A"], [evaluation(errors, start)]) == []


def test_an_interval_starts_with_its_smaller_end():
    interval = np.array([[0.7, 0.95, 0.5], [1.1, 1.4, 0.6]])
    p_value = np.array([0.5, 0.5, 0.001])
    found = ModelDifference("A", "B", np.array([0.9, 1.2, 0.55]), interval, p_value)
    assert found.verdict == (
        "B against A: x: no difference shown (10.0 % worse to 30.0 % better), "
        "y: no difference shown (5.0 % better to 40.0 % worse), yaw 45.0 % better (40.0 to 50.0 %)"
    )
