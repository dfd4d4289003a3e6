"""Evaluation, down to the published digits."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Protocol, Span
from airpuck.evaluation.comparison import coasting
from airpuck.evaluation.evaluate import compare, evaluate
from airpuck.model.model_file import published_model, read_model

from ..apparatus.models import four_propellers, model_of
from ..apparatus.public_recordings import TABLE_2, VALIDATION
from ..apparatus.synthetic_flights import fly


@pytest.fixture(scope="module")
def flight():
    return fly(published_model("M3"), duration=4.0)


def test_the_true_model_predicts_exactly(flight):
    model = replace(published_model("M3"), indexing="start")
    evaluation = evaluate(model, flight, protocol=Protocol(encoder_time=200 / 240))
    # The encoder starts its motors at the first command of the window; after 200 samples, thirty
    # time constants, they have forgotten it.
    np.testing.assert_allclose(evaluation.errors, 0, atol=1e-9)


def test_the_baseline_coasts_at_the_speed_of_the_start(flight):
    # A craft that accelerates at 2 m/s² in x is t² metres ahead of it.
    t = flight.time
    zero = np.zeros_like(t)
    state = np.stack([t**2, 0.3 * t, -0.5 * t, 2 * t, zero + 0.3, zero - 0.5], axis=1)
    moving = replace(flight, state=state)
    evaluation = evaluate(published_model("M3"), moving)
    found = coasting(evaluation, moving)
    assert found.model == "constant velocity"
    assert found.errors.shape == evaluation.errors.shape
    after = evaluation.horizon_step * evaluation.sample_period
    expected = np.array([-(after**2), 0.0, 0.0])[:, None]
    np.testing.assert_allclose(found.at_horizon - expected, 0, atol=1e-9)
    np.testing.assert_allclose(found.every_start.errors - expected, 0, atol=1e-9)


def test_shifting_the_world_shifts_predictions_equally(flight):
    shifted = replace(flight, state=flight.state + np.array([0.1, -0.3, 0, 0, 0, 0]))
    errors = [evaluate(published_model("M3"), f).errors for f in (flight, shifted)]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)


def test_a_jump_of_the_measurement_gives_an_error_of_opposite_sign(flight):
    # From 2 s on everything is measured 0.1 m further in x.
    step = np.where(flight.time >= 2.0, 0.1, 0.0)[:, None] * [1, 0, 0, 0, 0, 0]
    jumped = replace(flight, state=flight.state + step)
    base, errors = (evaluate(published_model("M3"), f) for f in (flight, jumped))
    change = (errors.errors - base.errors)[-1, 0]
    crossing = (errors.start < 2.0) & (errors.start + 50 / 240 >= 2.0)
    np.testing.assert_allclose(change, np.where(crossing, -0.1, 0.0), atol=1e-12)


def test_windows_do_not_overlap_and_cover_the_flight(flight):
    evaluation = evaluate(published_model("M3"), flight)
    assert len(evaluation.start) == len(flight) // 70
    np.testing.assert_allclose(np.diff(evaluation.start), 70 / 240)
    assert evaluation.horizon_step == 48
    assert evaluation.left_out == 0


@pytest.mark.parametrize(
    ("spans", "first_samples"),
    [
        # Samples 241 … 359 are gone: three windows fit before and eight after, of thirteen.
        ([(1.001, 1.499)], [0, 70, 140, *range(360, 960 - 69, 70)]),
        # Sample 48 too: none before it, two from 49 to 240.
        ([(0.199, 0.201), (1.001, 1.499)], [49, 119, *range(360, 960 - 69, 70)]),
        # A span in the samples left over by thirteen windows costs none, ...
        ([(3.81, 4.5)], list(range(0, 910, 70))),
        # ... and a single sample in the middle of the flight one at most.
        ([(1.999, 2.001)], [*range(0, 480 - 69, 70), *range(481, 960 - 69, 70)]),
    ],
)
def test_excluded_spans_are_skipped_and_counted(flight, spans, first_samples):
    assert len(flight) == 960
    marked = replace(flight, excluded=tuple(Span(*span, "gap") for span in spans))
    evaluation = evaluate(published_model("M3"), marked)
    present = np.array(first_samples) + 19
    np.testing.assert_allclose(evaluation.start, present / 240, atol=1e-9)
    assert evaluation.left_out == 13 - len(first_samples)
    assert evaluation.to_json()["left_out"] == 13 - len(first_samples)


def test_figures_match_plain_numpy(flight):
    evaluation = evaluate(published_model("M2"), flight)
    error = evaluation.errors[47]
    np.testing.assert_allclose(evaluation.rmse, np.sqrt((error**2).mean(axis=1)))
    np.testing.assert_allclose(evaluation.median_abs, np.median(np.abs(error), axis=1))
    document = evaluation.to_json()
    assert document["horizon_s"] == pytest.approx(0.2)
    assert document["rmse"]["x_m"] == evaluation.rmse[0]
    assert document["protocol"] == "paper"
    assert len(document["rmse_over_horizon"]) == 50


def test_a_model_of_another_craft_is_rejected(flight):
    with pytest.raises(InputError, match="4 \\(front, left, back, right\\)"):
        evaluate(model_of(four_propellers(), "M3"), flight)


@pytest.mark.data
@pytest.mark.parametrize("name", TABLE_2)
def test_published_parameters_reproduce_table_2(experiments, name):
    from airpuck.recording.torch_archive import read_authors_experiment

    validation = read_authors_experiment(experiments / VALIDATION / "data.pt")
    (evaluation,) = compare([published_model(name)], validation)
    assert evaluation.errors.shape == (50, 3, 334)
    x, y, yaw = evaluation.rmse
    assert (round(1e3 * x, 2), round(1e3 * y, 2), round(yaw, 4)) == TABLE_2[name]


@pytest.mark.data
@pytest.mark.parametrize("name", TABLE_2)
def test_the_packaged_numbers_match_the_authors(data, name):
    packaged = published_model(name)
    authors = read_model(data / "models" / "paper" / name / "params.json")
    assert authors.name == name
    np.testing.assert_array_equal(packaged.parameters.to_vector(), authors.parameters.to_vector())
    np.testing.assert_array_equal(packaged.free, authors.free)


def test_every_start_includes_the_starts_of_the_protocol(flight):
    model = published_model("M3")
    evaluation = evaluate(model, flight)
    everywhere = evaluation.every_start
    # Every fourth sample: the starts 70 samples apart are among them every second time.
    np.testing.assert_allclose(np.diff(everywhere.start), 4 / 240)
    shared, here, there = np.intersect1d(
        evaluation.start.round(6), everywhere.start.round(6), return_indices=True
    )
    assert len(shared) == len(evaluation.start[::2])
    np.testing.assert_allclose(everywhere.errors[:, there], evaluation.at_horizon[:, here])
    assert evaluation.to_json()["every_start"]["interval_95"]["x_m"] is None  # 4 s are too short


def test_a_different_horizon_lengthens_predictions_only_if_needed():
    usual = Protocol()
    near, far = usual.after(0.1), usual.after(1.0)
    assert (near.horizon, near.prediction_time) == (0.1, usual.prediction_time)
    assert (far.horizon, far.prediction_time) == (1.0, 1.0)


def test_a_causal_protocol_estimates_effectiveness_from_the_past_alone(flight):
    # Poses after the start of a prediction must not change the error at its start.
    model = replace(published_model("M3"), indexing="start")
    protocol = Protocol("causal", causal=True, longest_past=40 / 240)
    whole = evaluate(model, flight, protocol=protocol, encoder="actuation")
    state = flight.state.copy()
    later = len(state) // 2
    state[later:, :2] += 0.05 * np.sin(np.arange(len(state) - later))[:, None]
    other = evaluate(model, replace(flight, state=state), protocol=protocol, encoder="actuation")
    # Whole windows that end before the change; a smoothed estimate would look beyond.
    before = whole.start + 80 / 240 < flight.time[later]
    assert 0 < before.sum() < len(before)
    np.testing.assert_array_equal(whole.errors[:, :, before], other.errors[:, :, before])
