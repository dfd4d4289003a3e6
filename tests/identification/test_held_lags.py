"""Errors of lags that a fit holds, and of the data that are prepared with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck import Loss, Twin, preprocess, read_vehicle
from airpuck.craft.table import Table
from airpuck.deviation.packet_delays import UNKNOWN
from airpuck.identification.problem import prediction_loss
from airpuck.identification.retiming import score_derivatives, smoothed_along
from airpuck.model.model_file import nominal_model
from airpuck.twin.settings import read_twin_settings

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
PERIOD, DURATION, MILLISECONDS = 0.1, 40.0, 1e-3


def pulsed():
    """Return the model of a free-flyer, and 40 s under pulses that begin every 0.1 s."""
    model = nominal_model(read_vehicle(FREE_FLYERS / "atmos.toml"))
    settings = read_twin_settings(FREE_FLYERS / "twin.toml")
    camera = settings.motion_capture.model_copy(update={"rate_hz": 100.0})
    table = Table(length_m=200.0, width_m=200.0)
    settings = settings.model_copy(update={"motion_capture": camera, "table": table})
    rng, twin, command = np.random.default_rng(0), Twin(model, settings), np.zeros(8)
    for k in range(round(DURATION / PERIOD)):
        if k % 5 == 0:
            command = rng.random(8) * (rng.random(8) < 0.5)
        twin.wait_until(PERIOD * k)
        twin.send(command)
    return model, preprocess(twin.recording(), model.vehicle)


@pytest.mark.slow
def test_the_effect_of_a_fixed_lag_averages_over_the_phases_of_pulses() -> None:
    """A longer lag and a shorter delay hardly change the forces; at one phase they seem to."""
    model, trajectory = pulsed()
    parameters = model.parameters
    vector, free = parameters.to_vector(), parameters.mask(frozenset({"thrust", "inertia"}))
    lag, delay = (
        1.0 * parameters.mask(frozenset({name}))
        for name in ("motor_time_constant", "transport_delay")
    )
    model = replace(model, free=free | (delay > 0))
    change = 2 * MILLISECONDS * (lag - delay)
    # The windows last six periods of the pulses.
    loss = Loss(prediction_time=0.5, encoder_time=0.1, spacing=0.19)

    def quadratic(sign):
        other = replace(model, parameters=parameters.with_vector(vector + sign * change))
        prepared = smoothed_along(trajectory, other)
        made = prediction_loss(loss, [prepared], model.vehicle, learns_delay=True)
        return made.quadratic(parameters)

    def moved(hessian, scores):
        return np.linalg.solve(hessian[np.ix_(free, free)], -scores[free])[:-1]

    low, high = quadratic(-1), quadratic(1)
    expected = moved((low.hessian + high.hessian) / 2, (high.gradient - low.gradient) / 2)
    mixed, hessian = score_derivatives(
        prediction_loss(loss, [trajectory], model.vehicle, learns_delay=True),
        [trajectory],
        model,
        [UNKNOWN],
        MILLISECONDS * (lag + delay),
    )
    stated = moved(hessian, mixed @ change)
    # Of all thrusters alike; windows that all begin with pulses find 2.4 mN.
    assert abs(np.mean(stated - expected)) < 1e-3
