"""Forecast standard errors, and the quantities in which they are compared."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Model, PaperEncoder
from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import make_windows
from airpuck.experiment_design.forecast import (
    ComparedQuantities,
    Forecast,
    Information,
    information_of,
    joined,
)
from airpuck.model.model_file import published_model
from airpuck.model.rungs import named_rung

from ..apparatus.beliefs import uncertainty
from ..apparatus.plain_loss import differences, plain_residuals
from ..apparatus.synthetic_flights import fly

MODEL = published_model("M3")
ENTRIES = np.flatnonzero(MODEL.free)
(INERTIA,) = np.flatnonzero(MODEL.parameters.mask(frozenset({"inertia"})))


@pytest.fixture(scope="module")
def trajectory():
    flight = fly(MODEL, duration=6.0)
    noise = np.random.default_rng(1).normal(size=flight.state.shape)
    return replace(flight, state=flight.state + 1e-4 * noise)


@pytest.fixture(scope="module")
def information(trajectory):
    return information_of(trajectory, MODEL, 6.0)


def synthetic(seed, model=MODEL, blocks=10**9):
    """Information and scores of no particular flight, in the units of the parameters."""
    rng, size = np.random.default_rng(seed), len(model.free)
    unit = 1 / np.maximum(np.abs(model.parameters.to_vector()), 1e-3)

    def spread(count):
        root = rng.normal(size=(size, count)) * unit[:, None]
        return root @ root.T / count

    return Information(spread(200), spread(60), 1e-6, 20.0, blocks)


def errors(forecast, flight, duration):
    return forecast.of(flight, duration).standard_errors[ENTRIES]


@pytest.mark.slow
def test_the_information_matches_finite_differences_of_a_plain_rollout(trajectory, information):
    windows = make_windows(trajectory, 40, 50, 7)
    whole = len(windows.time) // 240 * 240
    starts = windows.starts[windows.starts + 90 <= whole]
    vector = MODEL.parameters.to_vector()

    def residuals(vector):
        dynamics = MODEL.parameters.with_vector(vector).dynamics(np, MODEL.vehicle, MODEL.frame)
        return plain_residuals(np, dynamics, windows, PaperEncoder(), starts=starts).ravel()

    jacobian = differences(residuals, vector, ENTRIES).T
    # The loss is the mean over 3 channels and 50 steps; 2 JᵀJ is the curvature of a square.
    expected = 2 * jacobian @ jacobian.T / (3 * 50) / 6.0
    found = information.hessian[np.ix_(ENTRIES, ENTRIES)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)


@pytest.mark.parametrize("blocks", [None, 4])
def test_one_flight_gives_the_sandwich_and_few_blocks_a_mean_inflation(blocks):
    flight = synthetic(0) if blocks is None else synthetic(9, blocks=blocks)
    found = Forecast(MODEL, [flight]).of(flight, 40.0).covariance
    inside = np.ix_(ENTRIES, ENTRIES)
    inverse = np.linalg.inv(flight.hessian[inside])
    inflation = inverse @ flight.scores[inside]
    if blocks is not None:
        inflation = np.trace(inflation) / len(ENTRIES) * np.eye(len(ENTRIES))
    expected = inflation @ inverse / 40.0
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found[inside] / scale, expected / scale, rtol=1e-6, atol=1e-8)


@pytest.mark.slow
def test_twice_the_time_reduces_errors_by_root_two(information):
    forecast = Forecast(MODEL, [information, synthetic(1)])
    once, twice = (errors(forecast, information, duration) for duration in (30.0, 60.0))
    assert (once > 0).all()
    np.testing.assert_allclose(once / twice, np.sqrt(2), rtol=1e-6)


def test_sampled_packets_leave_the_mean_delay_uncertain():
    """Among determined quantities, only the variance of the delay grows, by its own amount."""
    free = MODEL.free | MODEL.parameters.mask(frozenset({"transport_delay"}))
    model, flight = replace(MODEL, free=free), synthetic(7)
    plain = Forecast(model, [flight]).of(flight, 60.0)
    sampled = replace(flight, packets=6e-5)
    found = Forecast(model, [sampled]).of(sampled, 60.0)
    (delay,) = np.flatnonzero(free & ~MODEL.free)
    added = found.covariance - plain.covariance
    scale = np.sqrt(np.diag(found.covariance)[free])
    assert added[delay, delay] == pytest.approx(1e-6, rel=1e-6)
    added[delay, delay] = 0
    assert np.abs(added[np.ix_(free, free)] / np.outer(scale, scale)).max() < 1e-9


def test_prior_knowledge_counts_like_another_flight():
    flight = synthetic(2)
    before = Forecast(MODEL, [flight]).of(flight, 60.0)
    after = Forecast(replace(MODEL, uncertainty=before), [flight])
    now = errors(after, flight, 60.0)
    np.testing.assert_allclose(before.standard_errors[ENTRIES] / now, np.sqrt(2), rtol=1e-6)
    # Knowledge of other parameters does not count.
    changed = replace(MODEL, uncertainty=before).with_delay(0.03)
    np.testing.assert_allclose(
        errors(Forecast(changed, [flight]), flight, 60.0), before.standard_errors[ENTRIES]
    )


def test_larger_residuals_give_larger_errors():
    flight = synthetic(3)
    one, four = (errors(Forecast(MODEL, [flight], level), flight, 60.0) for level in (1.0, 4.0))
    np.testing.assert_allclose(four / one, 2.0, rtol=1e-9)


def test_a_parameter_that_no_flight_excites_is_undetermined_unless_known():
    def dark(information):
        light = np.ones(len(MODEL.free))
        light[INERTIA] = 0.0
        both = np.outer(light, light)
        return replace(
            information, hessian=information.hessian * both, scores=information.scores * both
        )

    flights = [dark(synthetic(seed)) for seed in (4, 5)]
    found = Forecast(MODEL, flights).of(flights[0], 60.0)
    assert len(found.undetermined) == 1
    assert np.abs(found.undetermined[0]).argmax() == INERTIA
    assert np.count_nonzero(found.undetermined[0]) == 1
    before = Forecast(MODEL, [synthetic(6)]).of(synthetic(6), 60.0)
    after = Forecast(replace(MODEL, uncertainty=before), flights).of(flights[0], 60.0)
    assert not len(after.undetermined)
    assert 0 < after.standard_errors[INERTIA] <= before.standard_errors[INERTIA] * (1 + 1e-6)


def test_flights_are_weighted_by_their_length():
    short, long = synthetic(7), replace(synthetic(8), duration=60.0)
    both = joined([short, long])
    np.testing.assert_allclose(both.hessian, 0.25 * short.hessian + 0.75 * long.hessian)
    np.testing.assert_allclose(both.scores, 0.25 * short.scores + 0.75 * long.scores)
    assert both.duration == 80.0
    assert both.blocks == 2 * 10**9


def test_many_blocks_reveal_the_covariance_of_the_residuals():
    # Scores that are twelve times as large in one direction as the information implies.
    rng, size = np.random.default_rng(10), len(ENTRIES)
    stretch = np.where(np.arange(size) == 3, 12.0, 1.0)
    flights = []
    for _ in range(40):
        scores = rng.normal(size=(10, size)) * np.sqrt(stretch)
        hessian, outer = np.zeros((2, len(MODEL.free), len(MODEL.free)))
        hessian[np.ix_(ENTRIES, ENTRIES)] = np.eye(size)
        outer[np.ix_(ENTRIES, ENTRIES)] = scores.T @ scores / 9
        flights.append(Information(hessian, outer, 1e-6, 20.0, 10))
    found = errors(Forecast(MODEL, flights), joined(flights), 1.0) ** 2
    np.testing.assert_allclose(found * 9 / 10, stretch, rtol=0.35)


@pytest.mark.slow
def test_a_flight_of_one_block_is_rejected():
    with pytest.raises(InputError, match="two blocks"):
        information_of(fly(MODEL, duration=1.5), MODEL, 1.5)


def known(model, covariance, undetermined=()):
    return uncertainty(model.parameters.to_vector(), covariance, lost=undetermined)


def at(model, name):
    return np.flatnonzero(model.parameters.mask(frozenset({name})))


def test_published_m3_matches_a_hand_calculation():
    model = published_model("M3")
    compared = ComparedQuantities(model)
    value = dict(zip(compared.labels, compared.values(model), strict=True))
    scale = dict(zip(compared.labels, compared.scales, strict=True))
    a, b, c = model.parameters.thrust[2]
    assert value["F(1) motor_b_1"] == pytest.approx(a + b + c)
    assert value["F(0.5) motor_b_1"] == pytest.approx(a / 2 + b / 4 + c / 8)
    assert scale["F(0.5) motor_b_1"] == pytest.approx(a + b + c)
    assert value["I"] == scale["I"] == model.parameters.inertia
    assert value["τ"] == scale["τ"] == pytest.approx(28.06e-3, abs=1e-5)
    assert scale["α"] == 1.0
    assert scale["r x"] == pytest.approx(np.sqrt(0.2647e-3 / 0.1377), rel=1e-3)
    assert len(compared.labels) == 2 * 6 + 5


def test_fixed_parameters_are_not_compared():
    labels = ComparedQuantities(published_model("M0")).labels
    assert "τ" not in labels
    assert not any(label.startswith("r ") for label in labels)


def test_moving_a_factor_between_thrust_and_matrix_changes_nothing():
    model = published_model("M4")
    factor = np.linspace(0.5, 2, 6)
    p = model.parameters
    other = replace(
        model,
        parameters=replace(
            p,
            thrust=p.thrust * factor[:, None],
            configuration_matrix=p.configuration_matrix / factor,
        ),
    )
    compared = ComparedQuantities(model)
    assert len(compared.labels) >= 24
    np.testing.assert_allclose(
        compared.values(other), compared.values(model), rtol=1e-12, atol=1e-15
    )


def test_a_column_that_only_turns_the_craft_has_no_direction_error():
    model, matrix = published_model("M4"), published_model("M4").parameters.configuration_matrix
    turning = matrix.copy()
    turning[:2, 2] = 0.0
    parameters = replace(model.parameters, configuration_matrix=turning)
    compared = ComparedQuantities(replace(model, parameters=parameters))
    gone = set(ComparedQuantities(model).labels) - set(compared.labels)
    assert gone == {"direction motor_b_1", "turn per push motor_b_1"}
    assert np.isfinite(compared.values(replace(model, parameters=parameters))).all()


def test_errors_of_sums_match_a_hand_calculation():
    model = published_model("M3")
    rng = np.random.default_rng(0)
    root = rng.normal(size=(len(model.free), len(model.free))) * 1e-4
    covariance = root @ root.T
    uncertainty, compared = known(model, covariance), ComparedQuantities(model)
    errors = compared.relative_errors(uncertainty)
    np.testing.assert_allclose(
        compared.relative_errors_of(replace(model, uncertainty=uncertainty)), errors, rtol=1e-6
    )
    first = at(model, "thrust")[:3]
    full = model.parameters.thrust[0].sum()
    expected = np.sqrt(covariance[np.ix_(first, first)].sum()) / full
    assert errors[1] == pytest.approx(expected, rel=1e-6)


def test_undetermined_quantities_have_infinite_errors():
    model = published_model("M3")
    covariance, direction = np.eye(len(model.free)) * 1e-8, np.zeros(len(model.free))
    (inertia,) = at(model, "inertia")
    covariance[inertia], direction[inertia] = 0.0, 1.0
    compared = ComparedQuantities(model)
    errors = compared.relative_errors(known(model, covariance, [direction]))
    assert [compared.labels[k] for k in np.flatnonzero(np.isinf(errors))] == ["I"]
    assert np.isinf(compared.relative_errors(None)).all()
    assert np.isinf(compared.relative_errors_of(model)).all()


def test_a_quantity_without_a_natural_size_has_no_relative_error():
    rung = named_rung("M3+inflow")
    parameters = rung.initial(default_vehicle())
    model = Model(rung.name, default_vehicle(), parameters, rung.mask(parameters))
    covariance = np.eye(len(model.free)) * 1e-8
    compared = ComparedQuantities(model)
    errors = compared.relative_errors(known(model, covariance))
    assert [compared.labels[k] for k in np.flatnonzero(np.isnan(errors))] == ["cᵢ"]  # it is zero
