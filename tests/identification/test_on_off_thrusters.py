"""A free-flyer with on/off thrusters, identified back from a flight of its twin."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck import Loss, Preparation, Twin, identify, preprocess, read_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.twin.settings import read_twin_settings

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
PERIOD = 0.1


@pytest.mark.slow
def test_forces_and_delay_of_a_twin_come_back() -> None:
    model = nominal_model(read_vehicle(FREE_FLYERS / "atmos.toml"))
    rng = np.random.default_rng(0)
    truth = replace(
        model.parameters,
        thrust=model.parameters.thrust * rng.uniform(0.8, 1.2, (8, 1)),
        transport_delay=0.041,
    )
    settings = read_twin_settings(FREE_FLYERS / "twin.toml")
    quiet = {"rate_hz": 100.0, "position_noise_m": 1e-6, "yaw_noise_rad": 1e-5}
    camera = settings.motion_capture.model_copy(update=quiet)
    settings = settings.model_copy(update={"motion_capture": camera})
    twin = Twin(replace(model, parameters=truth), settings)
    for k in range(80):
        twin.wait_until(PERIOD * k)
        # Each thruster rests often: a random subset, for pulses of random lengths.
        twin.send(rng.random(8) * (rng.random(8) < 0.5))
    twin.wait_until(8.0)
    assert not twin.contacts
    fit = identify(
        preprocess(twin.recording(), model.vehicle),
        loss=Loss(prediction_time=0.4, encoder_time=0.1, spacing=0.2),
        preparation=Preparation(faults="keep", retimings=0),
    )
    found = fit.model.parameters
    assert found.thrust.shape == (8, 1)
    np.testing.assert_allclose(found.thrust, truth.thrust, rtol=0.02)
    assert found.transport_delay == pytest.approx(0.041, abs=0.01)
    assert found.transport_delay + found.motor_time_constant == pytest.approx(0.046, abs=2e-3)
