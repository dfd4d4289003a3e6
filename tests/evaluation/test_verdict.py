"""Whether a model can be trusted: shares and limits against what is known by hand."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.evaluation.evaluate import evaluate
from airpuck.evaluation.verdict import MISSED_LIMIT, missed_motion, verdict
from airpuck.model.model_file import Model, published_model
from airpuck.model.uncertainty import Uncertainty

from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), frame="body", indexing="start")
LABELS = MODEL.parameters.labels(MODEL.vehicle.propeller_names)


def scaled(factor: float) -> Model:
    parameters = MODEL.parameters
    return replace(
        MODEL, parameters=replace(parameters, thrust=factor * np.asarray(parameters.thrust))
    )


def known(**errors: float) -> Model:
    """The model with standard errors of 1 % of each parameter, or as given by label [SI]."""
    vector = MODEL.parameters.to_vector()
    spread = np.where(MODEL.free, 0.01 * np.abs(vector), np.nan)
    for label, error in errors.items():
        spread[LABELS.index(label)] = error
    covariance = np.diag(np.nan_to_num(spread) ** 2)
    nothing = np.zeros((0, len(vector)))
    return replace(MODEL, uncertainty=Uncertainty(vector, covariance, spread, nothing, 30, 2.0))


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, 12.0, seed=3)


@pytest.mark.parametrize("missing", [0.1, 0.4])
def test_a_craft_with_less_thrust_than_modelled_is_missed_by_that_share(flight, missing):
    # All accelerations are proportional to thrust, but for the slow turning of the craft.
    model = scaled(1 - missing)
    found = missed_motion(evaluate(model, flight), flight)
    np.testing.assert_allclose(found, missing, rtol=0.25)
    np.testing.assert_allclose(found[2], missing, rtol=0.03)
    assert verdict(model, found).trusted == (missing < MISSED_LIMIT)


def test_a_model_without_thrust_misses_all_and_the_truth_nearly_nothing(flight):
    np.testing.assert_allclose(missed_motion(evaluate(scaled(0.0), flight), flight), 1, rtol=0.05)
    assert (missed_motion(evaluate(MODEL, flight), flight) < 0.02).all()


def test_errors_are_relative_to_natural_sizes():
    parameters = MODEL.parameters
    model = known(angle_offset=0.02, **{"center_of_mass x": 0.001})
    found = verdict(model).relative_errors
    assert found["I"] == pytest.approx(0.01)
    assert found["τ"] == pytest.approx(0.01)
    assert found["α"] == pytest.approx(0.02)
    arm = np.mean([np.hypot(*p.position_m) for p in MODEL.vehicle.propellers])
    assert found["r x"] == pytest.approx(0.001 / arm)
    a, b, c = np.asarray(parameters.thrust)[0]
    by_hand = 0.01 * np.sqrt(a**2 + b**2 + c**2) / (a + b + c)
    assert found["F(1) motor_a_1"] == pytest.approx(by_hand, rel=1e-4)


def test_a_lag_that_is_not_known_is_said_with_a_remedy():
    found = verdict(known(motor_time_constant=0.076))
    assert found.trusted is False
    words = " ".join(found.sentences)
    assert "Unknown: τ (± 76 ms)" in words
    assert "τ + d is ± 76 ms" in words
    assert "excitation" in words
    assert found.sentences[0].startswith("M3 cannot be trusted for control")


def test_numbers_have_the_digits_that_their_errors_allow():
    model = known(motor_time_constant=0.0002, transport_delay=0.0003, inertia=1e-6)
    said = " ".join(verdict(model, np.array([0.04, 0.039, 0.0996])).sentences)
    response = 1e3 * (MODEL.parameters.motor_time_constant + MODEL.transport_delay)
    assert f"response time τ + d is {response:.2f} ± 0.36 ms" in said
    assert "misses 4.0 %, 3.9 %, 10 %" in said


def test_a_response_time_whose_parts_trade_off_is_known():
    model = known()
    assert model.uncertainty is not None
    lag, delay = LABELS.index("motor_time_constant"), LABELS.index("transport_delay")
    covariance = model.uncertainty.covariance.copy()
    covariance[np.ix_([lag, delay], [lag, delay])] = 0.02**2 * np.array([[1, -1], [-1, 1]])
    errors = model.uncertainty.standard_errors.copy()
    errors[[lag, delay]] = 0.02
    uncertainty = replace(model.uncertainty, covariance=covariance, standard_errors=errors)
    free = model.free | MODEL.parameters.mask(frozenset({"transport_delay"}))
    found = verdict(replace(model, free=free, uncertainty=uncertainty))
    assert found.trusted
    assert any("Unknown: τ" in sentence for sentence in found.sentences)


def test_a_thrust_that_is_not_known_is_not_trusted():
    weak = {f"thrust motor_a_1 φ^{k}": 0.3 for k in (1, 2, 3)}
    found = verdict(known(**weak))
    assert found.trusted is False
    assert "clockwise" in found.sentences[1]
    assert "F(1) motor_a_1" in " ".join(found.sentences)


def test_what_the_data_say_nothing_about_is_not_determined():
    model = known()
    assert model.uncertainty is not None
    entry = LABELS.index("inertia")
    errors = model.uncertainty.standard_errors.copy()
    errors[entry] = np.nan
    nowhere = np.eye(len(LABELS))[entry : entry + 1]
    uncertainty = replace(model.uncertainty, undetermined=nowhere, standard_errors=errors)
    found = verdict(replace(model, uncertainty=uncertainty))
    assert found.trusted is False
    assert "I (not determined)" in " ".join(found.sentences)
    assert found.to_json()["relative_errors"]["I"] == np.inf


def test_without_errors_and_predictions_nothing_is_known():
    found = verdict(published_model("M3"))
    assert found.trusted is None
    assert "not known" in found.sentences[0]
    assert found.relative_errors == {}
    assert verdict(published_model("M0")).trusted is False  # it has no lag
    assert verdict(published_model("M3"), np.full(3, 0.2)).trusted is True


def test_a_fit_that_did_not_end_is_not_trusted():
    found = verdict(replace(known(), fit={"converged": False}))
    assert found.trusted is False
    assert "not converged" in found.sentences[1]


def test_errors_of_other_parameters_are_nobodys():
    """A model that was changed after its fit has none, rather than errors that are unbounded."""
    found = verdict(known().with_delay(0.03))
    assert found.trusted is None
    assert "Nothing is known of its parameters' errors" in " ".join(found.sentences)


def timed(lag_error: float, delay_error: float, correlation: float):
    """M3 that learned lag and delay, with these standard errors [s]."""
    model = MODEL.with_delay(0.015)
    masks = [
        model.parameters.mask(frozenset({name}))
        for name in ("motor_time_constant", "transport_delay")
    ]
    lag, delay = (np.flatnonzero(mask)[0] for mask in masks)
    vector = model.parameters.to_vector()
    covariance = np.zeros((len(vector), len(vector)))
    covariance[lag, lag], covariance[delay, delay] = lag_error**2, delay_error**2
    covariance[lag, delay] = covariance[delay, lag] = correlation * lag_error * delay_error
    spread = np.sqrt(np.diag(covariance))
    known = Uncertainty(
        vector,
        covariance,
        np.where(spread > 0, spread, np.nan),
        np.zeros((0, len(vector))),
        30,
        2.0,
    )
    return replace(model, uncertainty=known, free=model.free | masks[1])


def of_timing(model):
    return [words for words in verdict(model).sentences if "the split is not" in words]


def test_the_sum_of_lag_and_delay_is_known_where_the_split_is_not():
    model = timed(3e-3, 2.5e-3, -0.96)
    # By hand: √(3² + 2.5² - 2·0.96·3·2.5) = √0.85 ms; the published lag is 28.06 ms.
    [words] = of_timing(model)
    assert words == (
        "The sum of lag and delay is known to ±0.92 ms (43.06 ms); the split is not: "
        "lag 28.1 ± 3.0 ms, delay 15.0 ± 2.5 ms, correlation -0.96."
    )
    assert of_timing(timed(3e-3, 2.5e-3, -0.85)) == []
    [words] = of_timing(timed(0.0, 0.4e-3, 0.0))
    assert "±0.40 ms" in words and words.endswith("the lag is at its bound.")
    [words] = of_timing(timed(0.4e-3, 0.0, 0.0))
    assert "±0.40 ms" in words and words.endswith("the delay is at its bound.")
    assert of_timing(timed(0.0, 0.0, 0.0)) == []
    assert of_timing(MODEL) == []
