"""Regression over windows: against textbook least squares, and errors against many flights."""

from itertools import islice

import numpy as np
import pytest
from scipy import stats

from airpuck.data.trajectory import Trajectory
from airpuck.deviation.window_regression import LEVEL, WindowRegression, regress_windows

#: With so few samples a second, windows of five samples are the only ones.
SLOW, SAMPLES = 0.8, 5
#: Effects on the yaw's acceleration of two motors [1/(kg m)].
EFFECTS = np.array([3.0, -2.0])
NONE = np.zeros((3, 2))


def trajectory(time: np.ndarray, pose: np.ndarray) -> Trajectory:
    rate = np.gradient(pose, time, axis=0)
    return Trajectory(
        time=time,
        state=np.hstack([pose, rate]),
        acceleration=np.gradient(rate, time, axis=0),
        command_time=time[:1],
        command=np.zeros((1, 2)),
        propellers=("left", "right"),
    )


def turning(windows: int, noise: float, seed: int, *, alike: float = 0.0):
    """Return a craft that only turns, forces, constant in each window [N], and accelerations.

    `alike` is the correlation of neighbouring windows: of forces, and of disturbances.
    """
    random = np.random.default_rng(seed)
    drawn = random.normal(size=(windows, 3))
    for k in range(1, windows):
        drawn[k] = alike * drawn[k - 1] + np.sqrt(1 - alike**2) * drawn[k]
    force, disturbance = drawn[:, :2], drawn[:, 2]
    pushed = force @ EFFECTS + noise * disturbance
    # A parabola in each window; between windows the yaw may jump, since nothing compares them.
    u = SLOW * (np.arange(SAMPLES) - 2)
    yaw = (random.normal(size=(windows, 1)) * u + pushed[:, None] * u**2 / 2).ravel()
    time = SLOW * np.arange(SAMPLES * windows)
    pose = np.stack([0 * yaw, 0 * yaw, yaw], axis=1)
    return trajectory(time, pose), np.repeat(force, SAMPLES, axis=0).T, pushed


def regressed(flight: Trajectory, forces: np.ndarray, stated: np.ndarray = NONE, delay: float = 0):
    found = regress_windows(flight, forces, stated, delay)
    assert isinstance(found, WindowRegression)
    return found


def textbook(flight: Trajectory, forces: np.ndarray, pushed: np.ndarray):
    """Least squares of the yaw's accelerations on forces, a constant and the mean yaw rate."""
    weight = (1 - np.linspace(-1, 1, SAMPLES) ** 2) ** 2
    spin = flight.state[:, 5].reshape(-1, SAMPLES) @ weight / weight.sum()
    design = np.column_stack([forces[:, ::SAMPLES].T, np.ones(len(pushed)), spin])
    return design, *np.linalg.lstsq(design, pushed)[:2]


def is_white(values: np.ndarray) -> bool:
    return values[1:] @ values[:-1] < 0


def uncorrelated(windows: int, noise: float):
    """Yield flights whose residuals are not correlated, so that each window counts."""
    for seed in range(40):
        flight, forces, pushed = turning(windows, noise, seed)
        design, slope, _ = textbook(flight, forces, pushed)
        left = pushed - design @ slope
        if is_white(left) and is_white(left * (pushed - left)):
            yield flight, forces, pushed


@pytest.mark.parametrize("made", list(islice(uncorrelated(30, 1.5), 3)))
def test_effects_errors_and_f_test_match_least_squares(made):
    flight, forces, pushed = made
    design, slope, (rest,) = textbook(flight, forces, pushed)
    free = len(pushed) - design.shape[1]
    errors = np.sqrt(rest / free * np.diag(np.linalg.inv(design.T @ design)))
    # The same without the forces.
    (total,) = np.linalg.lstsq(design[:, 2:], pushed)[1]
    f_ratio = (total - rest) / 2 / (rest / free)
    p_value = stats.f.sf(f_ratio, 2, free)
    found = regressed(flight, forces)
    assert (found.delay, found.length) == pytest.approx((0.0, SLOW * SAMPLES))
    np.testing.assert_allclose(found.effect[2], slope[:2], rtol=1e-6)
    np.testing.assert_allclose(found.error[2], errors[:2], rtol=1e-6)
    assert found.evidence == pytest.approx(np.log(p_value), rel=1e-6)
    # The craft does not move, so only one of two regressions explains anything.
    share = 1 - rest / free / (total / (free + 2))
    assert found.explained == pytest.approx(share / 2, rel=1e-6)


@pytest.mark.parametrize("alike", [0.0, 0.8])
def test_errors_account_for_slow_disturbances(alike):
    off = []
    for seed in range(40):
        flight, forces, _ = turning(60, 2.0, seed, alike=alike)
        found = regressed(flight, forces)
        off.append((found.effect[2] - EFFECTS) / found.error[2])
    # As if windows were independent, errors would be twice as large as stated.
    assert 0.8 < np.sqrt(np.mean(np.square(off))) < 1.3


@pytest.mark.parametrize("alike", [0.0, 0.8])
def test_chance_is_rarely_reported_as_an_effect(alike):
    claimed = 0
    for seed in range(50):
        flight, _, _ = turning(60, 2.0, seed, alike=alike)
        _, unrelated, _ = turning(60, 2.0, 1000 + seed, alike=alike)
        claimed += np.exp(regressed(flight, unrelated).evidence) < 0.1
    assert 1 <= claimed <= 11


def test_p_values_below_the_floating_point_range_are_exact():
    """With two motors the p-value of F is (1 + 2 F / d) to the power of -d / 2."""
    flight, forces, pushed = next(uncorrelated(2000, 0.5))
    design, _, (rest,) = textbook(flight, forces, pushed)
    (total,) = np.linalg.lstsq(design[:, 2:], pushed)[1]
    free = len(pushed) - design.shape[1]
    exact = -free / 2 * np.log(total / rest)
    assert exact < -700
    found = regressed(flight, forces)
    assert found.evidence == pytest.approx(exact, rel=1e-6)
    assert found.p_value == 0.0


def test_fast_forces_shorten_the_windows():
    random, period = np.random.default_rng(0), 0.01
    forces = np.repeat(random.normal(size=(400, 2)), 10, axis=0)
    spin = np.cumsum(forces @ EFFECTS) * period
    yaw = np.cumsum(spin) * period + 1e-5 * random.normal(size=len(spin))
    time = period * np.arange(len(yaw))
    found = regressed(trajectory(time, np.stack([0 * yaw, 0 * yaw, yaw], axis=1)), forces.T)
    assert found.length < 0.25
    np.testing.assert_allclose(found.effect[2], EFFECTS, rtol=0.1)


@pytest.mark.parametrize(("likeness", "independent"), [(0.95, True), (0.99, False)])
def test_motors_always_driven_alike_are_not_distinguished(likeness, independent):
    """Of the square of either thrust, 10 % or 2 % remain beside the other."""
    flight, forces, _ = turning(400, 0.1, seed=0)
    forces[1] = likeness * forces[0] + np.sqrt(1 - likeness**2) * forces[1]
    assert (regressed(flight, forces).independent == independent).all()


def test_a_flight_of_the_recommended_length_reveals_most_effects():
    windows, noise = 24, 10.0
    stated = np.vstack([np.zeros((2, 2)), EFFECTS])
    longer = [regressed(*turning(windows, noise, seed)[:2], stated).longer for seed in range(20)]
    needed = round(windows * float(np.median(longer)))
    shown = [
        regressed(*turning(needed, noise, 100 + seed)[:2]).p_value < LEVEL for seed in range(40)
    ]
    assert 0.75 < np.mean(shown) < 0.99
