"""The predictive law against its limits: short versions of `studies/predictive.py`."""

import importlib
import sys
from pathlib import Path
from typing import get_args

import pytest

from airpuck.control.law import SolverStatus
from airpuck.control.predictive import PredictiveSettings

pytestmark = pytest.mark.slow

sys.path.append(str(Path(__file__).parents[2] / "studies"))
cost = importlib.import_module("predictive_limits.cost")
converged = importlib.import_module("predictive_limits.converged")
flights = importlib.import_module("predictive_limits.flights")
hostile = importlib.import_module("predictive_limits.hostile")
rails = importlib.import_module("predictive_limits.rails")


@pytest.fixture(scope="module")
def pairs():
    tuning = flights.law("mpc").model_copy(update={"period_s": 0.02})
    problem = converged.Problem(flights.craft(), tuning.of(PredictiveSettings))
    return [cost.compare(seed, tuning, 0.6, problem) for seed in range(3)]


@pytest.mark.study
def test_the_cost_is_within_a_few_percent_of_the_converged_solution(pairs):
    assert min(pair.solved for pair in pairs) == 1
    ratio = sum(pair.ours for pair in pairs) / sum(pair.converged for pair in pairs)
    assert 0.999 < ratio < 1.03


def test_any_input_gives_a_finite_command_within_limits_and_a_status():
    found = hostile.thrown(flights.law("mpc"), 200, compiled=False)
    assert found.wrong == 0
    assert found.statuses.total() == len(found.spent) == 200
    assert set(found.statuses) <= {*get_args(SolverStatus), "failed"}
    assert len(found.statuses) > 2


@pytest.mark.study
def test_flights_near_rails_touch_none_even_with_packet_loss():
    tuning = flights.law("mpc")
    # Every other target lies within a centimetre of a rail; these do.
    passages = [rails.passed(seed, tuning, 0.3, 1.2) for seed in range(1, 41, 10)]
    assert [passage.contacts for passage in passages] == [0] * 4
    assert 0 < min(passage.clearance for passage in passages) < rails.NEAR
    assert sum(passage.unanswered for passage in passages) <= 1
    assert sorted(passage.left for passage in passages)[2] < 0.02
