"""`identify`: recovery of a truth, and its warnings."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.identification import fit as module
from airpuck.identification.fit import identify
from airpuck.identification.problem import Problem
from airpuck.identification.settings import Loss
from airpuck.model.model_file import Model, published_model, read_model
from airpuck.model.rungs import named_rung
from airpuck.physics.thrust import is_monotone

from ..apparatus.models import four_propellers, model_of
from ..apparatus.synthetic_flights import fly

#: The encoder starts its motors at the first command of a window. After this many samples they
#: have forgotten it; after the paper's 20 they have not, which biases thrust by a few percent.
LONG = Loss(encoder_time=200 / 240, spacing=3 / 240)


def with_offset_center(model: Model) -> Model:
    center = np.array([1.5e-3, -0.8e-3])
    return replace(model, frame="body", parameters=replace(model.parameters, center_of_mass=center))


def test_exact_data_give_exact_parameters():
    truth = with_offset_center(published_model("M3"))
    fit = identify(fly(truth, duration=12.0), loss=LONG)
    np.testing.assert_allclose(
        fit.model.parameters.to_vector(), truth.parameters.to_vector(), rtol=2e-3, atol=2e-5
    )
    assert fit.loss < 1e-12


@pytest.mark.slow
def test_motors_slower_than_stated_get_longer_windows():
    truth = published_model("M3")
    slow = replace(
        truth, frame="body", parameters=replace(truth.parameters, motor_time_constant=0.06)
    )
    flight = fly(slow, duration=10.0)
    found, short = identify(flight), identify(flight, loss=Loss(encoder_time=40 / 240))
    assert found.model.parameters.motor_time_constant == pytest.approx(0.06, rel=0.005)
    strength = found.model.parameters.thrust.sum(axis=1) / truth.parameters.thrust.sum(axis=1)
    np.testing.assert_allclose(strength, 1.0, atol=0.01)
    # Who gives a length keeps it, and its bias.
    assert short.model.parameters.motor_time_constant < 0.97 * 0.06


@pytest.mark.slow
def test_a_larger_model_starts_at_the_smaller_models_optimum():
    flight, steps = fly(published_model("M3"), duration=12.0), []
    lost = slice(1200, 1320)
    flight.input[lost] = np.roll(flight.input[lost], 1, axis=1)
    simple = module.solved(flight, "M3")
    assert simple.exclusion is not None
    (faults,) = simple.exclusion.faults
    assert faults[0].start == pytest.approx(flight.time[1200], abs=0.1)
    richer = module.solved(flight, "M3+drag", after=simple, progress=steps.append)
    # Drag begins at zero.
    assert steps[0].loss == pytest.approx(simple.result[1].loss, rel=1e-6)
    fresh = module.solved(flight, "M3+drag").result[1].parameters.to_vector()
    found = richer.result[1].parameters.to_vector()
    np.testing.assert_allclose(found, fresh, rtol=2e-3, atol=2e-4)


@pytest.mark.slow
def test_a_larger_model_starts_with_a_third_of_the_nominal_lag_and_the_same_curves():
    flight = fly(published_model("M3"), duration=3.0)
    simple = module.solved(flight, "M3")
    loss, outcome, _ = simple.result
    fast = replace(outcome.parameters, motor_time_constant=1e-6)
    simple = replace(simple, fitted=(loss, replace(outcome, parameters=fast)))
    start = simple.enriched(Problem.of(flight, named_rung("M3", degree=4))).problem.start
    assert start.motor_time_constant == pytest.approx(
        default_vehicle().nominal.motor_time_constant_s / 3
    )
    np.testing.assert_array_equal(start.thrust, np.pad(fast.thrust, [(0, 0), (0, 1)]))


@pytest.mark.slow
def test_two_recordings_are_fitted_jointly():
    truth = with_offset_center(published_model("M3"))
    flights = [fly(truth, duration=6.0, seed=seed) for seed in (1, 2)]
    fit = identify(flights, loss=LONG)
    assert fit.windows == sum(len(range(0, len(f) - 249, 3)) for f in flights)
    np.testing.assert_allclose(fit.model.parameters.inertia, truth.parameters.inertia, rtol=1e-3)
    assert len(fit.model.data) == 2
    with pytest.raises(InputError, match="given twice"):
        identify([flights[0], flights[0]])


def test_the_trajectorys_vehicle_is_the_default():
    flight, vehicle = fly(published_model("M3"), 2.0), default_vehicle()
    heavy = vehicle.model_copy(update={"mass_kg": 0.2})
    remembered = replace(flight, vehicle=heavy)
    assert Problem.of(remembered, "M3").vehicle == heavy
    assert Problem.of(remembered, "M3", vehicle=vehicle).vehicle == vehicle
    assert Problem.of(flight, "M3").vehicle == vehicle


@pytest.mark.parametrize(
    ("samples", "known", "says"),
    [
        (0, True, "^no optimum$"),
        (12, True, "the motion begins 50 ms before the commands"),
        (12, False, "^no optimum$"),
    ],
)
def test_a_failed_fit_is_blamed_on_early_pose_stamps_only_if_they_are_early(
    monkeypatch, samples, known, says
):
    def fails(_):
        raise InputError("no optimum")

    monkeypatch.setattr(module, "minimize", fails)
    flight = fly(published_model("M3"), 6.0)
    later = flight.command_time + samples / 240
    flight = replace(flight, command_time=later, delay=0.0, delay_known=known)
    with pytest.raises(InputError, match=says):
        module.solved(flight, "M3")


def test_recordings_with_different_rates_are_rejected():
    flight = fly(published_model("M3"), 2.0)
    rare = replace(
        flight,
        time=flight.time[::2],
        state=flight.state[::2],
        acceleration=flight.acceleration[::2],
        hashes={},
    )
    with pytest.raises(InputError, match="120 Hz, the first recording at 240 Hz"):
        Loss().samples([flight, rare])
    with pytest.raises(InputError, match="240 Hz, the first recording at 120 Hz"):
        Loss().samples([rare, flight])
    assert Loss().samples([flight]) == (40, 50, 7)
    assert Loss().samples([rare]) == (20, 25, 4)


def test_a_slow_craft_gets_windows_in_which_it_moves_beyond_the_noise():
    paper = default_vehicle()
    flight = fly(published_model("M3"), 2.0)
    noise = 2e-4
    flight.state[:, :2] += noise * np.random.default_rng(0).normal(size=(len(flight), 2))
    usual = Loss().suited([flight], paper)
    assert (usual.encoder_time, usual.prediction_time) == (40 / 240, 50 / 240)
    # 0.45 N push 23 kg by fifty standard deviations, 1 cm, in about a second.
    slow = paper.model_copy(update={"mass_kg": 23.0}).model_copy(
        update={"nominal": paper.nominal.model_copy(update={"thrust_N": (0.45,)})}
    )
    found = Loss().suited([flight], slow)
    assert found.encoder_time == found.prediction_time
    assert 0.45 / 23 * found.prediction_time**2 / 2 == pytest.approx(50 * noise, rel=0.1)
    given = Loss(encoder_time=0.3, prediction_time=0.4).suited([flight], slow)
    assert (given.encoder_time, given.prediction_time) == (0.3, 0.4)


@pytest.mark.slow
def test_a_craft_with_four_propellers_is_identified():
    vehicle = four_propellers()
    start = named_rung("M3").initial(vehicle)
    parameters = replace(
        start,
        thrust=start.thrust * np.array([[1.2], [0.9], [1.1], [0.8]]),
        inertia=0.8 * start.inertia,
        angle_offset=0.05,
        center_of_mass=np.array([2e-3, 1e-3]),
    )
    truth = Model("M3", vehicle, parameters, np.ones(len(parameters.to_vector()), dtype=bool))
    fit = identify(fly(truth, duration=8.0), vehicle=vehicle, loss=LONG)
    np.testing.assert_allclose(
        fit.model.parameters.to_vector(), parameters.to_vector(), rtol=2e-3, atol=1e-5
    )


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 5])
def test_curves_of_any_degree_are_identified(degree):
    fit = identify(fly(published_model("M3"), duration=6.0), named_rung("M3", degree=degree))
    assert fit.model.parameters.thrust.shape == (6, degree)
    assert is_monotone(fit.model.parameters.thrust).all()


def test_the_model_file_round_trips(tmp_path):
    fit = identify(fly(published_model("M3"), duration=3.0), "M4")
    fit.model.save(tmp_path / "model.toml")
    back = read_model(tmp_path / "model.toml")
    np.testing.assert_array_equal(back.parameters.to_vector(), fit.model.parameters.to_vector())
    np.testing.assert_array_equal(back.free, fit.model.free)
    assert back.fit == fit.model.fit
    assert back.data == fit.model.data
    assert back.vehicle == fit.model.vehicle


def test_unknown_motors_are_rejected():
    with pytest.raises(InputError, match="vehicle file"):
        identify(fly(model_of(four_propellers(), "M3"), duration=2.0))


def test_a_motor_that_idles_in_the_used_span_is_named():
    flight = fly(published_model("M3"), duration=6.0)
    command = flight.command.copy()
    command[flight.command_time > 3.0, 2] = 0.3
    part = replace(flight, command=command).slice(0.6, 1.0)
    name = flight.propellers[2]
    assert any(f"command of {name} barely changes" in w for w in identify(part).warnings)


def test_a_fit_keeps_its_objective():
    fit = identify(fly(published_model("M3"), duration=3.0))
    found = fit.objective.quadratic(fit.model.parameters)
    assert found.loss == pytest.approx(fit.loss, rel=1e-9)
    assert len(fit.objective.windows) == fit.windows


def test_a_fit_that_did_not_converge_warns():
    from airpuck.identification.method import LevenbergMarquardt

    fit = identify(
        fly(published_model("M3"), duration=3.0), method=LevenbergMarquardt(max_iterations=1)
    )
    assert any("not converged" in warning for warning in fit.warnings)
