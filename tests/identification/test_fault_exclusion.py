"""Fits that leave faults out."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.identification.adam import Adam
from airpuck.identification.fit import identify
from airpuck.model_file import read_model

from .test_robust import MODEL, clean, faulty, off

__all__ = ["clean", "faulty"]


@pytest.fixture(scope="module")
def fit(faulty):
    return identify(faulty, "M3")


def test_faults_do_not_move_the_estimate(fit, faulty, clean):
    kept = identify(faulty, "M3", faults="keep")
    assert off(kept) > 0.05
    assert off(fit) < 0.1 * off(kept)
    assert kept.exclusion is None
    # Commands were made up over half a second, three times.
    (found,) = fit.exclusion.faults
    assert len({round(span.start) for span in found}) == 3
    for begin in (2.0, 6.0, 9.5):
        assert any(s.start < begin + 0.1 and s.stop > begin + 0.4 for s in found)


def test_a_clean_flight_loses_nothing(clean):
    fit, kept = identify(clean, "M3"), identify(clean, "M3", faults="keep")
    assert fit.exclusion.share == 0
    assert fit.exclusion.faults == ((),)
    assert fit.windows == kept.windows
    assert fit.loss == kept.loss


def test_what_was_left_out_is_in_the_model_file(fit, tmp_path):
    fit.model.save(tmp_path / "m.toml")
    left_out = read_model(tmp_path / "m.toml").fit["left_out"]
    assert left_out == fit.exclusion.to_json() == fit.to_json()["faults"]
    assert left_out["share_of_windows"] == pytest.approx(1 - fit.windows / 1112, abs=0.05)
    first = left_out["spans"][0]
    assert set(first) == {"recording", "start_s", "stop_s", "cause", "confidence"}
    assert 0 < first["confidence"] <= 1


def test_iterations_go_on_after_the_faults_are_out(fit):
    numbers = [step.number for step in fit.history]
    assert numbers == list(range(len(numbers)))


def test_adam_leaves_them_out_too(faulty, fit):
    other = identify(faulty, "M3", method=Adam(epochs=1))
    assert other.exclusion.faults == fit.exclusion.faults
    assert other.windows == fit.windows
    assert other.iterations == 1


def test_where_most_looks_faulty_the_model_is_doubted(clean):
    # A log of another flight altogether.
    command = np.random.default_rng(0).uniform(0.3, 1, (24, 6)).repeat(120, axis=0)
    fit = identify(replace(clean, command=command[: len(clean.command)]), "M3")
    assert fit.exclusion.share < 0.5
    if fit.exclusion.share == 0:
        return
    assert fit.windows > 0


def test_one_window_over_the_whole_flight_is_not_cut(clean):
    short = clean.slice(0, 0.1)
    assert identify(short, "M0", prediction_length=None).exclusion is None


def test_the_model_is_the_reference(fit):
    assert fit.model.parameters.inertia == pytest.approx(MODEL.parameters.inertia, rel=0.01)
