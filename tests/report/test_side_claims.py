"""The paper's side claims on the real recordings."""

import numpy as np
import pytest

from airpuck.model.model_file import published_model
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.report.full_trajectory import sample_landscapes
from airpuck.report.reproduce import TRAINING, VALIDATION, reproduce
from airpuck.report.side_claims import (
    compare_largest_thrusts,
    drop_monotonicity,
    falling_share,
    try_degrees,
)

from .test_page import check_self_contained


@pytest.fixture(scope="module")
def recordings(experiments):
    return tuple(read_authors_experiment(experiments / name) for name in (TRAINING, VALIDATION))


def test_falling_share():
    coefficients = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(falling_share(coefficients), [0, 0.5, 1], atol=2e-3)


def test_published_m4_thrusts_are_larger_only_by_their_scale():
    result = compare_largest_thrusts(
        {"published": published_model("M3")}, {"published": published_model("M4")}
    )
    first, direct = result.first_principles["published"], result.direct["published"]
    assert (direct / first > 1.25).all()
    assert (np.abs(result.direct_scaled["published"] / first - 1) < 0.06).all()
    assert result.to_json()["published"]["M3_N"] == first.tolist()


@pytest.mark.data
def test_without_the_condition_some_thrust_curves_fall(recordings):
    (trial,) = drop_monotonicity(*recordings, cases=(("M3", 3),))
    falling = np.array(trial.to_json()["lowest_slope_N"]) < 0
    assert 1 <= falling.sum() <= 3
    (constrained,) = try_degrees(*recordings, degrees=(3,))
    assert (np.array(constrained.to_json()["lowest_slope_N"]) >= 0).all()
    assert trial.fit.loss < constrained.fit.loss


@pytest.mark.data
def test_long_predictions_have_more_local_minima(recordings):
    model = published_model("M3")
    short, long = sample_landscapes(recordings[0], model, horizons=(50, 5000), span=0.1, points=21)
    assert len(short.minima) == 1
    assert len(long.minima) > 1 or long.loss.max() > 1.5 * long.loss.min()
    assert short.windows > 100 * long.windows / 2
    assert long.to_json()["local_minima"] == len(long.minima)


@pytest.mark.data
@pytest.mark.study
def test_all_side_claims(data, tmp_path):
    result = reproduce(data, tmp_path, side_claims=True)
    claims = result.side_claims
    assert claims is not None
    page = check_self_contained(result.page.read_text(encoding="utf-8"))
    assert "side-claims" in page.ids

    losses = [trial.fit.loss for trial in claims.degrees]
    assert losses == sorted(losses, reverse=True)
    score = [np.log(trial.rmse).sum() for trial in claims.degrees]
    assert int(np.argmin(score)) + 1 == 3

    falls = {
        trial.label: min(trial.to_json()["lowest_slope_N"]) < 0 for trial in claims.unconstrained
    }
    assert falls == {
        "M0, degree 3": False,
        "M1, degree 3": False,
        "M2, degree 3": True,
        "M3, degree 3": True,
        "M4, degree 3": True,
        "M3, degree 5": True,
    }

    full = claims.full_trajectory
    assert len(full.landscapes[0].minima) == 1
    assert len(full.landscapes[-1].minima) > 20
    assert full.nominal.fit.loss > 3 * full.refined.fit.loss
    for trial in (full.nominal, full.refined):
        assert (trial.rmse[:2] > 1.1 * full.batched.rmse[:2]).all()

    thrusts = claims.largest_thrusts
    for kind in ("published", "fitted"):
        first = thrusts.first_principles[kind]
        # Published thrusts have any scale; that of our own fits is Newton's.
        ratio = np.mean(thrusts.direct[kind] / first)
        assert ratio > 1.2 if kind == "published" else abs(ratio - 1) < 0.06
        assert np.abs(thrusts.direct_scaled[kind] / first - 1).max() < 0.06
