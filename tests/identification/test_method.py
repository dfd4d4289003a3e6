"""The default optimiser, against scipy and against its own constraints."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.method import LevenbergMarquardt, SlopeConstraints
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.model.model_file import published_model
from airpuck.model.rungs import RUNGS, named_rung
from airpuck.physics.thrust import is_monotone, thrust_slope

from ..apparatus.plain_loss import plain_residuals
from ..apparatus.synthetic_flights import fly

VEHICLE = default_vehicle()


def noisy_loss(model, noise=0.002, duration=6.0):
    flight = fly(model, duration)
    rng = np.random.default_rng(3)
    state = flight.state + noise * rng.normal(size=flight.state.shape)
    windows = make_windows(replace(flight, state=state), stride=7)
    return PredictionLoss(windows, VEHICLE, PaperEncoder())


@pytest.mark.slow
def test_it_finds_the_minimum_of_scipy_and_of_plain_equations():
    loss = noisy_loss(published_model("M3"))
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    optimiser = LevenbergMarquardt(monotone=False, tolerance=1e-15)
    outcome = optimiser.minimize(loss, start, free)

    def residuals(vector):
        whole = jnp.asarray(start.to_vector()).at[np.flatnonzero(free)].set(vector)
        dynamics = start.with_vector(whole).dynamics(jnp, VEHICLE)
        return plain_residuals(jnp, dynamics, loss.windows, PaperEncoder()).ravel()

    with jax.enable_x64(True):
        scipys = least_squares(
            jax.jit(residuals),
            start.to_vector()[free],
            jac=jax.jit(jax.jacfwd(residuals)),
            x_scale="jac",
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
        )
    assert outcome.loss == pytest.approx(2 * scipys.cost / len(scipys.fun), rel=1e-12)
    np.testing.assert_allclose(outcome.parameters.to_vector()[free], scipys.x, rtol=1e-6, atol=1e-9)


def test_thrust_curves_rise_even_if_the_data_disagree():
    truth = published_model("M3")
    falling = np.tile([0.1, 1.6, -1.2], (6, 1))  # F'(1) = -0.3
    dipping = np.tile([0.45, -1.6, 1.7], (3, 1))  # F' is lowest, -0.05, at φ = 0.31
    thrust = np.concatenate([falling[:3], dipping])
    assert not is_monotone(thrust).any()
    truth = replace(truth, parameters=replace(truth.parameters, thrust=thrust))
    loss = noisy_loss(truth, noise=1e-4)
    start = RUNGS["M3"].initial(VEHICLE)
    free = RUNGS["M3"].mask(start)
    constrained = LevenbergMarquardt().minimize(loss, start, free)
    unconstrained = LevenbergMarquardt(monotone=False).minimize(loss, start, free)
    assert is_monotone(constrained.parameters.thrust).all()
    assert not is_monotone(unconstrained.parameters.thrust).any()
    assert unconstrained.loss < constrained.loss


def test_bounds_are_respected():
    # Data without lag push the time constant towards zero.
    truth = published_model("M0")
    loss = noisy_loss(truth, noise=1e-4)
    start = RUNGS["M2"].initial(VEHICLE)
    outcome = LevenbergMarquardt().minimize(loss, start, RUNGS["M2"].mask(start))
    assert 1e-4 <= outcome.parameters.motor_time_constant < 3e-3


@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_a_step_changes_the_lag_at_most_threefold_and_still_converges(factor):
    truth = published_model("M3")
    loss, rung = noisy_loss(truth, noise=1e-4), named_rung("M3")
    lag = truth.parameters.motor_time_constant
    start = replace(rung.initial(VEHICLE), motor_time_constant=factor * lag)
    free, lags = rung.mask(start), [factor * lag]
    for _ in range(3):
        once = LevenbergMarquardt(max_iterations=1).minimize(loss, start, free)
        start = once.parameters
        lags.append(start.motor_time_constant)
    assert np.abs(np.diff(np.log(lags))).max() <= np.log(3) + 1e-9
    found = LevenbergMarquardt().minimize(loss, start, free).parameters
    assert found.motor_time_constant == pytest.approx(lag, rel=0.05)


def test_a_lag_without_influence_does_not_hinder_the_other_parameters():
    start = replace(RUNGS["M3"].initial(VEHICLE), motor_time_constant=2.3e-4)
    free, begin = RUNGS["M3"].mask(start), start.to_vector()
    lag = start.mask(frozenset({"motor_time_constant"}))
    optimum = np.where(lag, 1e8, np.where(free, 1.01 * begin + 1e-4, begin))
    curvature = np.diag(np.where(lag, 1e-19, 1.0))

    class Bowl(PredictionLoss):
        def __init__(self):
            pass  # it needs no windows

        def quadratic(self, parameters):
            away = parameters.to_vector() - optimum
            gradient = curvature @ away
            return Quadratic(np.array([away @ gradient / 2]), gradient[None], curvature[None])

    found = LevenbergMarquardt(monotone=False).minimize(Bowl(), start, free).parameters
    np.testing.assert_allclose(found.to_vector()[~lag], optimum[~lag], atol=1e-5)


@pytest.mark.slow
def test_an_active_bound_is_met_exactly():
    # A craft that something pushes along has negative drag.
    truth = published_model("M3")
    pushed = replace(truth.parameters, drag=np.array([-0.5, 0.0, -0.5, 0.0]))
    loss = noisy_loss(replace(truth, parameters=pushed), noise=1e-4)
    rung = named_rung("M3+drag")
    start = rung.initial(VEHICLE)
    outcome = LevenbergMarquardt().minimize(loss, start, rung.mask(start))
    assert outcome.parameters.drag[0] == 0.0
    assert outcome.parameters.drag[2] == 0.0


def test_fixed_entries_do_not_change():
    loss = noisy_loss(published_model("M3"))
    start = RUNGS["M2"].initial(VEHICLE)
    outcome = LevenbergMarquardt().minimize(loss, start, RUNGS["M2"].mask(start))
    assert outcome.parameters.inertia == start.inertia
    assert outcome.parameters.angle_offset == 0
    assert not np.array_equal(outcome.parameters.thrust, start.thrust)


def test_the_loss_never_rises_and_is_reported():
    loss = noisy_loss(published_model("M3"))
    start = RUNGS["M3"].initial(VEHICLE)
    seen = []
    outcome = LevenbergMarquardt().minimize(loss, start, RUNGS["M3"].mask(start), seen.append)
    losses = [iteration.loss for iteration in outcome.history]
    assert losses == sorted(losses, reverse=True)
    assert tuple(seen) == outcome.history
    assert outcome.converged


def test_too_few_iterations_are_reported():
    loss = noisy_loss(published_model("M3"))
    start = RUNGS["M3"].initial(VEHICLE)
    outcome = LevenbergMarquardt(max_iterations=1).minimize(loss, start, RUNGS["M3"].mask(start))
    assert not outcome.converged


def test_constraint_rows_are_slopes():
    constraints = SlopeConstraints(np.ones((2, 3), dtype=bool))
    curves = np.random.default_rng(0).normal(size=(2, 3))
    ends = np.tile([0.0, 1.0], (2, 1))
    np.testing.assert_allclose(
        constraints.rows() @ curves.ravel(), thrust_slope(curves, ends).ravel()
    )


def test_a_cut_is_added_where_the_curve_falls_most():
    constraints = SlopeConstraints(np.ones((1, 3), dtype=bool))
    falling = np.array([[0.2, -1.0, 1.0]])  # F' = 0.2 - 2φ + 3φ² is lowest at φ = 1/3
    assert constraints.cut(falling)
    np.testing.assert_allclose(constraints.rows()[-1], [1, 2 / 3, 1 / 3], atol=1e-12)
    assert not constraints.cut(np.array([[0.5, 0.5, 0.5]]))


def test_a_fixed_curve_is_not_cut():
    """A cut would change nothing, so the loop would not end."""
    free = np.array([[False] * 3, [True] * 3])
    falling = np.array([[0.2, -1.0, 1.0], [0.5, 0.5, 0.5]])
    constraints = SlopeConstraints(free)
    assert not constraints.cut(falling)
    assert constraints.cut(falling[::-1])


def test_a_slope_of_fixed_coefficients_is_not_constrained():
    only_quadratic = np.array([[False, True]])
    rows = SlopeConstraints(only_quadratic).rows()
    np.testing.assert_array_equal(rows, [[1, 2]])
