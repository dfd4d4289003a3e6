"""The predictive law against nonlinear predictive control solved to convergence."""

import importlib
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[2] / "studies"))
cost = importlib.import_module("predictive_limits.cost")
converged = importlib.import_module("predictive_limits.converged")
flights = importlib.import_module("predictive_limits.flights")


@pytest.fixture(scope="module")
def pairs():
    tuning = flights.law("mpc").model_copy(update={"period_s": 0.02})
    problem = converged.Problem(flights.craft(), tuning.regulator)
    return [cost.compare(seed, tuning, 0.6, problem) for seed in range(5)]


def test_its_cost_is_within_some_percent_of_the_converged_solution(pairs):
    assert min(pair.solved for pair in pairs) == 1
    ratio = sum(pair.ours for pair in pairs) / sum(pair.converged for pair in pairs)
    assert 0.999 < ratio < 1.03
