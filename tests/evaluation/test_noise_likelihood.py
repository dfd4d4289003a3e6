"""The likeliest noises, by a plain Kalman filter with the textbook's likelihood."""

import numpy as np
import pytest

from airpuck.evaluation.innovations import initial_covariance, most_likely_noise

PERIOD, COUNT = 1 / 240, 800
POSE = np.array([2e-4, 1e-4, 1e-3])
#: White accelerations and their drift, by axis; the last has no drift.
ACCELERATION, DISTURBANCE = np.array([0.1, 0.3, 3.0]), np.array([1.0, 3.0, 0.0])


@pytest.fixture(scope="module")
def flight():
    """Poses of a body that only noise moves, and what a model adds to its motion."""
    rng = np.random.default_rng(2)
    added = rng.normal(size=(COUNT, 3, 2)) * [1e-4, 1e-2]
    place, speed, drift, poses = np.zeros(3), np.zeros(3), np.zeros(3), []
    for k in range(COUNT):
        if k:
            drift = drift + rng.normal(size=3) * DISTURBANCE * np.sqrt(PERIOD)
            kick = rng.normal(size=3) * ACCELERATION * np.sqrt(PERIOD)
            place = place + PERIOD * (speed + kick / 2) + PERIOD**2 / 2 * drift + added[k, :, 0]
            speed = speed + kick + PERIOD * drift + added[k, :, 1]
        poses.append(place + rng.normal(size=3) * POSE)
    restart = np.arange(COUNT) == 0
    period = np.where(restart, 0.0, PERIOD)
    measured, used = np.ones(COUNT, dtype=bool), np.arange(COUNT) > 1
    return np.array(poses), added, period, restart, measured, used


def cost(axis, pose, added, noise):
    """Minus the log-likelihood of one axis by a filter of its own."""
    r, q1, q2 = np.square([noise.pose[axis], noise.acceleration[axis], noise.disturbance[axis]])
    h = PERIOD
    step = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    grown = q1 * np.array([[h**3 / 3, h**2 / 2, 0], [h**2 / 2, h, 0], [0, 0, 0]])
    grown = grown + q2 * np.array(
        [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
    )
    mean = np.array([pose[0, axis], 0.0, 0.0])
    # Unknown speed and drift; the first two samples determine them.
    covariance, found = np.diag([r, 1e4, 1e4 * (q2 > 0)]), 0.0
    for k in range(1, COUNT):
        mean = step @ mean + [*added[k, axis], 0.0]
        covariance = step @ covariance @ step.T + grown
        innovation, variance = pose[k, axis] - mean[0], covariance[0, 0] + r
        if k > 3:
            found += (innovation**2 / variance + np.log(variance)) / 2
        gain = covariance[:, 0] / variance
        mean = mean + gain * innovation
        covariance = covariance - np.outer(gain, covariance[0])
    return found


def test_the_estimated_noise_maximises_the_likelihood(flight):
    pose, added, *_ = flight
    noise, counts = most_likely_noise(*flight, PERIOD)
    np.testing.assert_allclose(noise.pose, POSE, rtol=0.15)
    assert counts[0] in (2, 3)
    assert noise.disturbance[2] < 1.0
    for axis in range(3):
        best = cost(axis, pose, added, noise)
        for name in ("pose", "acceleration", "disturbance"):
            for factor in (0.75, 1.33):
                values = list(getattr(noise, name))
                if not values[axis]:
                    continue
                values[axis] *= factor
                other = type(noise)(**{**vars(noise), name: tuple(values)})
                assert cost(axis, pose, added, other) > best - 0.3


def test_local_and_global_searches_agree(flight):
    noise, counts = most_likely_noise(*flight, PERIOD)
    again, same = most_likely_noise(*flight, PERIOD, near=noise)
    assert counts == same
    np.testing.assert_allclose(again.pose, noise.pose, rtol=0.02)
    np.testing.assert_allclose(again.acceleration, noise.acceleration, rtol=0.1, atol=1e-9)


def test_the_result_does_not_depend_on_units(flight):
    pose, added, *rest = flight
    scale = np.array([1e3, 1.0, 1e-2])
    noise, counts = most_likely_noise(*flight, PERIOD)
    other, same = most_likely_noise(pose * scale, added * scale[:, None], *rest, PERIOD)
    assert counts == same
    np.testing.assert_allclose(np.array(other.pose), np.array(noise.pose) * scale, rtol=1e-3)
    np.testing.assert_allclose(
        np.array(other.acceleration), np.array(noise.acceleration) * scale, rtol=0.05
    )


def test_the_initial_speed_is_practically_unknown():
    found = initial_covariance(np, np.array([4.0]), np.array([9.0]), 0.5)
    np.testing.assert_allclose(found[0], np.diag([4.0, 4.0 * (1e3 / 0.5) ** 2, 9.0]))
