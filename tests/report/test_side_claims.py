"""The paper's side claims on the real recordings, as `studies/side_claims.py` tests them."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from airpuck.model.model_file import published_model
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.report.reproduce import TRAINING, VALIDATION

from ..apparatus.pages import check_self_contained

sys.path.append(str(Path(__file__).parents[2] / "studies"))
claims = importlib.import_module("side_claims")


@pytest.fixture(scope="module")
def recordings(experiments):
    return tuple(read_authors_experiment(experiments / name) for name in (TRAINING, VALIDATION))


def test_the_falling_share_is_measured():
    coefficients = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(claims.falling_share(coefficients), [0, 0.5, 1], atol=2e-3)


def test_the_minima_of_a_landscape_are_counted():
    factor = np.linspace(0.9, 1.1, 201)
    for loss, count in (((factor - 1) ** 2, 1), (factor, 0), (np.cos(100 * factor), 3)):
        assert len(claims.Landscape(1, 1, factor, loss).minima) == count


def test_published_m4_thrusts_differ_only_by_their_scale():
    thrusts = claims.largest_thrusts(published_model("M3"), published_model("M4"))
    first = thrusts["M3_N"]
    assert (thrusts["M4_as_learned_N"] / first > 1.25).all()
    assert (np.abs(thrusts["M4_scaled_N"] / first - 1) < 0.06).all()


@pytest.mark.slow
@pytest.mark.data
def test_without_the_condition_some_thrust_curves_fall(recordings):
    (trial,) = claims.drop_monotonicity(*recordings, cases=(("M3", 3),))
    falling = np.array(trial.to_json()["lowest_slope_N"]) < 0
    assert 1 <= falling.sum() <= 3
    (constrained,) = claims.try_degrees(*recordings, degrees=(3,))
    assert (np.array(constrained.to_json()["lowest_slope_N"]) >= 0).all()
    assert trial.fit.loss < constrained.fit.loss


@pytest.mark.data
@pytest.mark.study
def test_longer_predictions_have_more_local_minima(recordings):
    short, long = claims.sample_landscapes(
        recordings[0], published_model("M3"), horizons=(50, 5000), span=0.1, points=21
    )
    assert len(short.minima) == 1
    assert len(long.minima) > 1 or long.loss.max() > 1.5 * long.loss.min()
    assert short.windows > 100 * long.windows / 2
    assert long.to_json()["local_minima"] == len(long.minima)


@pytest.mark.data
@pytest.mark.study
def test_all_side_claims_are_reported(data, tmp_path, monkeypatch):
    monkeypatch.setenv("AIRPUCK_DATA", str(data))
    numbers = claims.side_claims(tmp_path)
    assert json.loads((tmp_path / "side_claims.json").read_text()) == numbers
    page = check_self_contained((tmp_path / "index.html").read_text(encoding="utf-8"))
    assert "side-claims" in page.ids

    losses = [trial["loss"] for trial in numbers["degrees"]]
    assert losses == sorted(losses, reverse=True)
    score = [np.log(list(trial["rmse"].values())).sum() for trial in numbers["degrees"]]
    assert int(np.argmin(score)) + 1 == 3

    falls = {trial["label"]: min(trial["lowest_slope_N"]) < 0 for trial in numbers["unconstrained"]}
    assert falls == {
        "M0, degree 3": False,
        "M1, degree 3": False,
        "M2, degree 3": True,
        "M3, degree 3": True,
        "M4, degree 3": True,
        "M3, degree 5": True,
    }

    full = numbers["full_trajectory"]
    assert full["landscapes"][0]["local_minima"] == 1
    assert full["landscapes"][-1]["local_minima"] > 20
    assert full["full_from_nominal"]["loss"] > 3 * full["full_from_batched"]["loss"]
    for name in ("full_from_nominal", "full_from_batched"):
        for channel in ("x_m", "y_m"):
            assert full[name]["rmse"][channel] > 1.1 * full["batched"]["rmse"][channel]

    for kind in ("published", "fitted"):
        thrusts = {name: np.array(v) for name, v in numbers["largest_thrusts"][kind].items()}
        # Published thrusts have an arbitrary scale; our own fits have Newton's.
        ratio = np.mean(thrusts["M4_as_learned_N"] / thrusts["M3_N"])
        assert ratio > 1.2 if kind == "published" else abs(ratio - 1) < 0.06
        assert np.abs(thrusts["M4_scaled_N"] / thrusts["M3_N"] - 1).max() < 0.06
