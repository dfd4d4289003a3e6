"""Whether a model can be trusted: errors and limits, against hand calculations."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.results import Finding
from airpuck.deviation.effect_errors import effect_errors
from airpuck.evaluation.evaluate import evaluate
from airpuck.judgement.findings import LOW_LIMIT, Evidence
from airpuck.judgement.rehearsal import Rehearsal
from airpuck.judgement.verdict import verdict
from airpuck.model.model_file import Model, published_model

from ..apparatus.beliefs import believed
from ..apparatus.models import scaled
from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), frame="body", indexing="start")
LABELS = MODEL.parameters.labels(MODEL.vehicle.propeller_names)


def known(**errors: float) -> Model:
    """The model with standard errors of 1 % of each parameter, or as given by label [SI]."""
    vector = MODEL.parameters.to_vector()
    spread = 0.01 * np.abs(vector) * MODEL.free
    for label, error in errors.items():
        spread[LABELS.index(label)] = error
    return believed(MODEL, spread)


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, 12.0, seed=3)


def judged(model: Model, trajectory):
    return verdict(model, trajectory, evaluate(model, trajectory))


@pytest.mark.parametrize("missing", [0.1, 0.4])
def test_a_craft_with_less_thrust_than_modelled_has_that_relative_error(flight, missing):
    # All accelerations are proportional to thrust, apart from the craft's slow rotation.
    model = scaled(MODEL, 1 - missing)
    found = judged(model, flight)
    np.testing.assert_allclose(found.missed, missing, rtol=0.25)
    np.testing.assert_allclose(found.missed[2], missing, rtol=0.03)
    # Modelled 0.6, found 1: the model's accelerations are two thirds too small.
    off = 1 / (1 - missing) - 1
    np.testing.assert_allclose(found.acceleration_errors, off, rtol=0.05)
    assert found.outcome == ("trusted" if missing == 0.1 else "not_trusted")
    assert found.trusted == (missing == 0.1)


def test_a_verdict_on_a_wrong_model_names_the_direction_and_the_error(flight):
    said = " ".join(judged(scaled(MODEL, 0.6), flight).sentences)
    assert "cannot be trusted" in said
    assert "forward 6" in said and "too small" in said


def test_an_error_within_the_limit_counts_with_its_uncertainty(flight):
    sure = known(**{f"thrust {one} φ^3": 0.165 for one in MODEL.vehicle.propeller_names})
    assert sure.uncertainty is not None
    model = scaled(MODEL, 0.76)
    uncertainty = replace(sure.uncertainty, estimate=model.parameters.to_vector())
    found = judged(replace(model, uncertainty=uncertainty), flight)
    assert found.outcome == "not_trusted"
    assert "too small and uncertain by another 2" in found.sentences[1]


def test_a_model_without_thrust_predicts_like_a_coasting_craft(flight):
    still = scaled(MODEL, 0.0)
    found = Evidence(still, flight, evaluate(still, flight)).missed
    np.testing.assert_allclose(found, 1, rtol=0.05)
    assert (Evidence(MODEL, flight, evaluate(MODEL, flight)).missed < 0.02).all()


def test_a_long_delay_makes_the_clocks_suspect(flight):
    late = MODEL.with_delay(MODEL.transport_delay + 0.3)
    earlier = replace(
        flight, command_time=flight.command_time - 0.321, delay=0.321, delay_known=True
    )
    found = judged(late, earlier)
    assert found.outcome == "suspect_recording"
    assert "321 ms after their time stamps" in found.sentences[1]
    assert "clocks" in found.sentences[1]


def test_a_model_learned_with_wrong_clocks_is_not_trusted(flight):
    later = replace(flight, command_time=flight.command_time - 0.01, delay=0.01, delay_known=True)
    found = judged(MODEL.with_delay(0.03), later)
    assert found.outcome == "not_trusted"
    assert "20 ms earlier than modelled" in found.sentences[1]


def test_motion_before_its_commands_makes_the_clocks_suspect(flight):
    early = replace(flight, command_time=flight.command_time + 0.05, delay_known=True)
    free = MODEL.free | MODEL.parameters.mask(frozenset({"transport_delay"}))
    for model in (MODEL, replace(MODEL, free=free).with_delay(0.0)):
        found = judged(model, early)
        assert found.outcome == "suspect_recording"
        assert "stamped early" in found.sentences[1]


def test_swapped_motors_are_named(flight):
    order = [0, 1, 3, 2, 4, 5]
    swapped = replace(flight, command=flight.command[:, order])
    found = judged(MODEL, swapped)
    assert found.outcome == "suspect_recording"
    first, second = (MODEL.vehicle.propeller_names[k] for k in (2, 3))
    assert f"{first} acts like {second}; {second} acts like {first}" in found.sentences[1]
    assert "airpuck check" in found.sentences[1]


def test_positions_in_feet_give_an_impossible_inertia(flight):
    parameters = replace(MODEL.parameters, inertia=3.28 * MODEL.parameters.inertia)
    parameters = replace(parameters, thrust=3.28 * np.asarray(parameters.thrust))
    state = flight.state * [3.28, 3.28, 1.0, 3.28, 3.28, 1.0]
    found = judged(replace(MODEL, parameters=parameters), replace(flight, state=state))
    assert found.outcome == "suspect_recording"
    assert "unit of the positions" in found.sentences[1]


def test_wrong_curve_shapes_are_reported_at_low_speed(flight):
    speed = np.linspace(0, 1, 101)[:, None]
    powers = speed ** np.arange(1, 4)
    true = powers @ np.asarray(MODEL.parameters.thrust).T
    # κ φ², nearest to each true curve.
    curves = np.zeros((6, 3))
    curves[:, 1] = (speed**2 * true).sum(axis=0) / (speed**4).sum()
    found = judged(replace(MODEL, parameters=replace(MODEL.parameters, thrust=curves)), flight)
    assert found.outcome == "not_trusted"
    assert "wrong shape" in " ".join(found.sentences)


@pytest.mark.parametrize(("right", "told"), [([0], True), ([0, 1, 2, 3], False)])
def test_curves_count_as_wrong_only_if_most_motions_are_wrong(flight, right, told, monkeypatch):
    """Motors with the right curves leave some motions right, and others wrong."""
    monkeypatch.setattr("airpuck.judgement.verdict.rehearse", lambda *_: Rehearsal(2.0))
    speed = np.linspace(0, 1, 101)[:, None]
    true = np.asarray(MODEL.parameters.thrust)
    curves = np.zeros((6, 3))
    curves[:, 1] = (speed**2 * (speed ** np.arange(1, 4) @ true.T)).sum(axis=0) / (speed**4).sum()
    curves[right] = true[right]
    model = replace(MODEL, parameters=replace(MODEL.parameters, thrust=curves))
    effects = effect_errors(model, flight)
    assert effects is not None
    low = np.abs(effects.low)
    assert low.min() < LOW_LIMIT < low.max()
    assert ("wrong shape" in " ".join(judged(model, flight).sentences)) is told


def test_half_the_command_range_is_not_enough_excitation():
    def linear(thrust: float) -> Model:
        curves = np.tile([thrust, 0.0, 0.0], (6, 1))
        return replace(MODEL, parameters=replace(MODEL.parameters, thrust=curves))

    flight = fly(linear(0.6), 8.0, seed=3)
    halved, model = replace(flight, command=flight.command / 2), linear(1.2)
    found = judged(model, halved)
    assert found.outcome == "not_enough_excitation"
    assert "reach only 45 % of the range" in found.sentences[1]
    assert "unit" in found.sentences[1]
    # The same craft, if its motors have a lower limit.
    vehicle = model.vehicle.model_copy(update={"command_max": 0.5})
    assert judged(replace(model, vehicle=vehicle), halved).trusted


def test_a_flight_without_switching_excites_too_little(flight):
    still = replace(flight, command=np.full_like(flight.command, 0.03))
    rng = np.random.default_rng(0)
    state = np.zeros_like(flight.state) + rng.normal(0, 1e-4, flight.state.shape)
    found = judged(known(), replace(still, state=state))
    assert found.outcome == "not_enough_excitation"
    assert "airpuck excite" in " ".join(found.sentences)
    short = flight.slice(0.0, 0.2)
    assert verdict(known(), short).outcome == "not_enough_excitation"


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


def test_an_unknown_lag_is_reported_with_a_remedy():
    found = verdict(known(motor_time_constant=0.076))
    assert found.outcome == "not_enough_excitation"
    words = " ".join(found.sentences)
    assert "Unknown: τ (± 76 ms)" in words
    assert "τ + d is uncertain by 76 ms" in words
    assert "airpuck excite" in words
    assert found.sentences[0].startswith("The data do not tell whether M3 can be trusted")


def test_numbers_have_as_many_digits_as_their_errors_allow(flight):
    model = known(motor_time_constant=0.002, transport_delay=0.003, inertia=1e-6)
    said = " ".join(judged(model, flight).sentences)
    response = 1e3 * (MODEL.parameters.motor_time_constant + MODEL.transport_delay)
    assert f"response time τ + d is {response:.1f} ± 3.6 ms" in said


def test_a_model_whose_controller_does_not_settle_is_not_trusted(flight, monkeypatch):
    failed = Rehearsal(0.5, "It does not settle. Check it.")
    monkeypatch.setattr("airpuck.judgement.verdict.rehearse", lambda *_: failed)
    found = judged(MODEL, flight)
    assert found.outcome == "not_trusted"
    assert found.sentences[1] == "It does not settle. Check it."
    assert found.controller["lqr"].settles is False
    assert found.to_json()["controller"]["lqr"]["margin"] == 0.5


def test_the_remedy_for_a_requested_law_is_reported(flight, monkeypatch):
    """The usual law settles; what another one needs is no reason for distrust."""

    def flown(model, trajectory, effects, law=None):
        return Rehearsal(0.5, f"{law.upper()} needs calm.") if law else Rehearsal(2.0)

    monkeypatch.setattr("airpuck.judgement.verdict.rehearse", flown)
    found = verdict(MODEL, flight, laws=("mpc",))
    assert found.trusted and "MPC needs calm." in found.sentences
    assert [one.settles for one in found.controller.values()] == [True, False]
    assert "needs calm" not in " ".join(verdict(MODEL, flight).sentences)


def test_a_model_may_fly_despite_wrong_parameters(flight):
    model = known()
    assert model.uncertainty is not None
    off = scaled(MODEL, 0.85)
    uncertainty = replace(model.uncertainty, estimate=off.parameters.to_vector())
    assert judged(model, flight).parameters.right
    found = judged(replace(off, uncertainty=uncertainty), flight)
    assert found.trusted
    assert found.parameters.right is False
    assert any("forward is 18 % smaller" in one for one in found.parameters.why)
    # Without errors there is nothing to be right within.
    assert judged(MODEL, flight).parameters.right is None


def test_a_cause_found_by_another_check_comes_first(flight):
    cause = Finding("axes", "y points the wrong way", "6 of 6 motors", "Set axes.y.")
    found = verdict(MODEL, flight, causes=[cause])
    assert found.outcome == "suspect_recording"
    assert found.sentences[1] == "y points the wrong way (6 of 6 motors). Set axes.y."
    assert found.findings == (cause,)


def test_a_response_time_is_known_even_if_its_parts_trade_off(flight):
    model = known()
    assert model.uncertainty is not None
    lag, delay = LABELS.index("motor_time_constant"), LABELS.index("transport_delay")
    covariance = model.uncertainty.covariance.copy()
    covariance[np.ix_([lag, delay], [lag, delay])] = 0.02**2 * np.array([[1, -1], [-1, 1]])
    errors = model.uncertainty.standard_errors.copy()
    errors[[lag, delay]] = 0.02
    uncertainty = replace(model.uncertainty, covariance=covariance, standard_errors=errors)
    free = model.free | MODEL.parameters.mask(frozenset({"transport_delay"}))
    found = judged(replace(model, free=free, uncertainty=uncertainty), flight)
    assert found.trusted
    assert any("Unknown: τ" in sentence for sentence in found.sentences)


def test_an_unknown_thrust_needs_more_excitation():
    weak = {f"thrust motor_a_1 φ^{k}": 0.9 for k in (1, 2, 3)}
    found = verdict(known(**weak))
    assert found.outcome == "not_enough_excitation"
    assert "clockwise" in found.sentences[1]
    assert "F(1) motor_a_1" in " ".join(found.sentences)


def test_a_delay_learned_with_unknown_thrusts_accuses_no_clock(flight):
    # A fit to a craft that hovers: thrusts unknown, and a delay of 71 ± 2 ms where it is 21 ms.
    delay = MODEL.free | MODEL.parameters.mask(frozenset({"transport_delay"}))
    outcomes = {}
    for error in (0.9, 1e-3):
        model = known(**{f"thrust motor_a_1 φ^{k}": error for k in (1, 2, 3)})
        late = replace(model, free=delay).with_delay(0.071)
        assert model.uncertainty is not None
        uncertainty = replace(model.uncertainty, estimate=late.parameters.to_vector())
        timed = replace(
            flight, command_time=flight.command_time - 0.021, delay=0.021, delay_known=True
        )
        outcomes[error] = judged(replace(late, uncertainty=uncertainty), timed).outcome
    assert outcomes == {0.9: "not_enough_excitation", 1e-3: "suspect_recording"}


def test_the_thrust_of_a_dead_motor_can_be_known():
    model = known()
    assert model.uncertainty is not None
    thrust = np.array(model.parameters.thrust)
    error = 0.01 * np.linalg.norm(thrust[2])
    thrust[2] *= 1e-3
    half = np.median(thrust.sum(axis=1)) / 2
    parameters = replace(model.parameters, thrust=thrust)
    uncertainty = replace(model.uncertainty, estimate=parameters.to_vector())
    found = verdict(replace(model, parameters=parameters, uncertainty=uncertainty))
    assert found.relative_errors["F(1) motor_b_1"] == pytest.approx(error / half, rel=0.03)
    assert "F(1) motor_b_1" not in " ".join(found.sentences)


def test_parameters_without_information_are_not_determined():
    model = known()
    assert model.uncertainty is not None
    entry = LABELS.index("inertia")
    errors = model.uncertainty.standard_errors.copy()
    errors[entry] = np.nan
    nowhere = np.eye(len(LABELS))[entry : entry + 1]
    uncertainty = replace(model.uncertainty, undetermined=nowhere, standard_errors=errors)
    found = verdict(replace(model, uncertainty=uncertainty))
    assert not found.trusted
    assert "I (not determined)" in " ".join(found.sentences)
    assert found.relative_errors["I"] == np.inf
    assert found.to_json()["relative_errors"]["I"] is None


def test_without_a_recording_there_is_no_verdict(flight):
    found = verdict(published_model("M3"))
    assert found.outcome == "not_judged" and found.trusted is False
    assert "airpuck evaluate" in found.sentences[0]
    assert found.relative_errors == {}
    assert found.acceleration_errors is None
    assert verdict(published_model("M0")).outcome == "not_trusted"  # it has no lag
    assert judged(MODEL, flight).trusted
    assert "judged by the data it was learned from" in verdict(known(), flight).sentences[0]


def test_an_unconverged_fit_is_not_trusted():
    found = verdict(replace(known(), fit={"converged": False}))
    assert found.outcome == "not_trusted"
    assert "did not converge" in found.sentences[1]


def test_errors_of_other_parameters_accuse_no_motor():
    """A model that was changed after its fit has no errors, instead of infinite ones."""
    found = verdict(known().with_delay(0.03))
    assert found.outcome == "not_judged"
    assert found.acceleration_errors is None


def timed(lag_error: float, delay_error: float, correlation: float):
    """M3 that learned lag and delay, with these standard errors [s]."""
    model = MODEL.with_delay(0.015)
    masks = [
        model.parameters.mask(frozenset({name}))
        for name in ("motor_time_constant", "transport_delay")
    ]
    lag, delay = (np.flatnonzero(mask)[0] for mask in masks)
    covariance = np.zeros((len(masks[0]),) * 2)
    covariance[lag, lag], covariance[delay, delay] = lag_error**2, delay_error**2
    covariance[lag, delay] = covariance[delay, lag] = correlation * lag_error * delay_error
    return believed(replace(model, free=model.free | masks[1]), covariance)


def of_timing(model):
    return [words for words in verdict(model).sentences if "the split is not" in words]


def test_the_sum_of_lag_and_delay_is_known_even_if_the_split_is_not():
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


def test_a_finding_about_a_flying_model_is_reported_once(flight):
    lacking = Finding("physics", "The model lacks the term tilt", "0.5 %", "Add +tilt.")
    found = verdict(known(), flight, causes=[lacking])
    assert found.trusted and found.parameters.why == ("The model lacks the term tilt",)
    assert [one for one in found.sentences if "lacks the term" in one] == [lacking.sentence]
