"""A free-flyer with on/off thrusters, identified back from a flight of its twin."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from airpuck import Loss, Preparation, Twin, identify, preprocess, read_vehicle
from airpuck.identification.bootstrap import bootstrap, resampled_estimates
from airpuck.model.model_file import nominal_model
from airpuck.model.parameters import LAG
from airpuck.twin.settings import read_twin_settings

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
PERIOD = 0.1


@pytest.fixture(scope="module")
def flown():
    """Return the true parameters of a twin, and a recording of 8 s."""
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
    return truth, twin.recording()


def fitted(recording, vehicle, retimings):
    """Identify a model."""
    return identify(
        preprocess(recording, vehicle),
        loss=Loss(prediction_time=0.4, encoder_time=0.1, spacing=0.23),
        preparation=Preparation(faults="keep", retimings=retimings),
    )


@pytest.mark.slow
def test_forces_and_delay_of_the_twin_are_recovered(flown) -> None:
    truth, recording = flown
    found = fitted(recording, read_vehicle(FREE_FLYERS / "atmos.toml"), 0).model.parameters
    assert found.thrust.shape == (8, 1)
    np.testing.assert_allclose(found.thrust, truth.thrust, rtol=0.02)
    assert found.transport_delay == pytest.approx(0.041, abs=0.01)
    assert found.transport_delay + found.motor_time_constant == pytest.approx(0.046, abs=2e-3)


@pytest.fixture(scope="module")
def held(flown, tmp_path_factory):
    """Return a fit that keeps the file's lag, 5 ± 0.3 ms."""
    text = (FREE_FLYERS / "atmos.toml").read_text()
    text = text.replace("fall_s = 0.005", "fall_s = 0.005\nlag_error_s = 3e-4")
    path = tmp_path_factory.mktemp("held") / "craft.toml"
    path.write_text(text)
    return fitted(flown[1], read_vehicle(path), 1)


@pytest.mark.slow
def test_a_lag_that_poses_determine_poorly_keeps_the_file_value_and_error(held) -> None:
    fit, lag = held, held.model.parameters.mask(LAG)
    known = fit.uncertainty
    assert known is not None
    assert not fit.model.free[lag].any()
    assert fit.model.parameters.motor_time_constant == 0.005
    assert known.standard_errors[lag] == pytest.approx(3e-4)
    assert "from the vehicle file" in " ".join(known.notes)
    assert fit.model.parameters.transport_delay == pytest.approx(0.041, abs=2e-3)


@pytest.mark.slow
def test_resampled_fits_draw_a_fixed_lag_from_its_error(held) -> None:
    """The delay is shorter where the lag is longer."""
    loss = held.objective
    # A longer flight has that many blocks of its own.
    blocks = replace(loss, clusters=np.arange(len(loss.windows)) // 4)
    fit = replace(held, objective=blocks)
    estimates = resampled_estimates(fit, 12, seed=1)
    lag, delay = (
        estimates[:, fit.model.parameters.mask(frozenset({name}))][:, 0]
        for name in ("motor_time_constant", "transport_delay")
    )
    assert 1.5e-4 < np.std(lag) < 5e-4
    assert np.mean(lag) == pytest.approx(0.005, abs=3e-4)
    assert np.corrcoef(lag, delay)[0, 1] < -0.6
    found = bootstrap(fit, 12, seed=1).uncertainty.bootstrap
    entry = fit.model.parameters.mask(LAG)
    assert 6e-4 < (found.upper - found.lower)[entry] < 14e-4
