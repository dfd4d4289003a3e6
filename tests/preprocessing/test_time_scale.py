"""The time in which thrust shows above noise."""

import numpy as np
import pytest

from airpuck.craft.vehicle import default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.time_scale import showing_time


def watched(period: float, noise: float, push: float, seed: int = 0) -> tuple[Trajectory, float]:
    """One motor switches on and off; its acceleration while on is `push` times the nominal one."""
    rng = np.random.default_rng(seed)
    vehicle = default_vehicle()
    matrix = np.asarray(nominal_model(vehicle).dynamics.configuration)[:2, 0]
    time = period * np.arange(2000)
    command = np.zeros((len(time), 6))
    command[:, 0] = push * np.repeat(rng.integers(0, 2, 200), 10)
    force = vehicle.nominal_thrust[0] @ command[:, 0] ** np.arange(1, 4)[:, None]
    acceleration = force[:, None] * matrix
    position = period**2 * np.cumsum(np.cumsum(acceleration, axis=0), axis=0)
    state = np.zeros((len(time), 6))
    state[:, :2] = position + noise * rng.normal(size=position.shape)
    flight = Trajectory(
        time=time,
        state=state,
        acceleration=np.zeros((len(time), 3)),
        command_time=time,
        command=command,
        propellers=vehicle.propeller_names,
    )
    return flight, float(np.sqrt(np.mean(np.sum(acceleration**2, axis=1)) / 2))


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_the_time_is_that_of_fifty_standard_deviations(noise):
    flight, usual = watched(0.02, noise, 0.3)
    expected = np.sqrt(2 * 50 * noise / usual)
    assert showing_time(flight, default_vehicle()) == pytest.approx(min(expected, 3.0), rel=0.05)


def test_motion_between_rare_poses_is_no_noise():
    flight, _ = watched(0.125, 0.0, 1.0)
    assert showing_time(flight, default_vehicle()) < 0.05
