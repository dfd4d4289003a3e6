"""The state estimator, against a textbook filter and exact simulated flights."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import KalmanFilter
from airpuck.physics.rigid_body import acceleration

from ..apparatus.measured_flights import (
    IDLE,
    MODEL,
    NOISE,
    TAU,
    Commands,
    acting,
    simulate,
    some_commands,
    switches,
)


class Textbook:
    """One filter of nine states, with exponentials, Van Loan's integral and dense matrices."""

    def __init__(self, time: float, pose: np.ndarray, commands: Commands) -> None:
        self.commands, self.speed = commands, IDLE
        self.start(time, pose)

    def start(self, time: float, pose: np.ndarray) -> None:
        self.time, self.x = time, np.zeros(9)
        self.x[::3] = pose
        variances = [
            [NOISE.pose[i] ** 2, s**2, d**2]
            for i, (s, d) in enumerate([(0.5, 0.1), (0.5, 0.1), (5.0, 3.0)])
        ]
        self.p = np.diag(np.concatenate(variances))

    def advance(self, time: float) -> None:
        chain = np.eye(3, k=1)
        a = block_diag(chain, chain, chain)
        density = np.zeros((9, 9))
        for i in range(3):
            density[3 * i + 1, 3 * i + 1] = NOISE.acceleration[i] ** 2
            density[3 * i + 2, 3 * i + 2] = NOISE.disturbance[i] ** 2
        h = time - self.time
        van_loan = expm(h * np.block([[-a, density], [np.zeros((9, 9)), a.T]]))
        step = van_loan[9:, 9:].T
        self.p = step @ self.p @ step.T + step @ van_loan[:9, 9:]
        # An input on the velocities, held over each piece at its value in the middle.
        into = np.kron(np.eye(3), np.array([[0.0], [1.0], [0.0]]))
        for begin, end in pairwise(switches(self.commands, self.time, time)):
            h, command = end - begin, acting(self.commands, (begin + end) / 2)
            middle = command + (self.speed - command) * np.exp(-h / 2 / TAU)
            yaw = self.x[6] + h / 2 * self.x[7]
            motion = np.array([yaw, self.x[1], self.x[4], self.x[7]])
            push = np.array(acceleration(np, MODEL.dynamics, motion, middle))
            joint = expm(h * np.block([[a, into], [np.zeros((3, 12))]]))
            self.x = joint[:9, :9] @ self.x + joint[:9, 9:] @ push
            self.speed = command + (self.speed - command) * np.exp(-h / TAU)
        self.time = time

    def measure(self, which: list[int], innovation: np.ndarray, deviation: list[float]) -> None:
        h, r = np.eye(9)[which], np.diag(np.square(deviation))
        gain = self.p @ h.T @ np.linalg.inv(h @ self.p @ h.T + r)
        self.x = self.x + gain @ innovation
        # Joseph's form.
        left = np.eye(9) - gain @ h
        self.p = left @ self.p @ left.T + gain @ r @ gain.T

    def pose(self, time: float, pose: np.ndarray) -> None:
        self.advance(time)
        off = pose - self.x[::3]
        off[2] = np.arctan2(np.sin(off[2]), np.cos(off[2]))
        self.measure([0, 3, 6], off, list(NOISE.pose))

    def world(self, vector: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.x[6]), np.sin(self.x[6])
        return np.array([[c, -s], [s, c]]) @ vector

    def imu(self, time: float, force: np.ndarray, gyro: float, deviation: list[float]) -> None:
        self.advance(time)
        motion = np.array([self.x[6], self.x[1], self.x[4], self.x[7]])
        modelled = np.array(acceleration(np, MODEL.dynamics, motion, self.speed))[:2]
        off = np.append(self.world(force) - modelled - self.x[[2, 5]], gyro - self.x[7])
        self.measure([2, 5, 7], off, [deviation[0], deviation[0], deviation[1]])

    def mouse(self, time: float, velocity: np.ndarray, deviation: float) -> None:
        self.advance(time)
        self.measure([1, 4], self.world(velocity) - self.x[[1, 4]], [deviation, deviation])


def agrees(estimate: Estimate, book: Textbook) -> None:
    """Compare an estimate with the textbook's, in the order x, y, γ, vx, vy, ω."""
    expected = np.concatenate([book.x[::3], book.x[1::3]])
    np.testing.assert_allclose(estimate.state, expected, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(estimate.disturbance, book.x[2::3], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(estimate.motor_speed, book.speed, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_filter_matches_the_textbook_on_any_data(seed):
    random = np.random.default_rng(seed)
    commands = some_commands(0.5, seed)
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    for command in commands:
        ours.command(*command)
    first = random.normal(size=3)
    ours.pose(0.0, first)
    book = Textbook(0.0, first, commands)
    time = 0.0
    for k in range(100):
        time += random.uniform(1e-3, 8e-3) if k != 50 else 0.045
        kind = random.choice(["pose", "pose", "pose", "imu", "mouse"])
        if kind == "pose":
            pose = first + 0.05 * random.normal(size=3) + [0, 0, 2 * np.pi * random.integers(-2, 3)]
            assert ours.pose(time, pose)
            book.pose(time, pose)
        elif kind == "imu":
            force, gyro = random.normal(size=2), random.normal()
            ours.imu(time, force, gyro, (0.35, 0.015))
            book.imu(time, force, gyro, [0.35, 0.015])
        else:
            velocity = random.normal(size=2)
            ours.mouse(time, velocity, 0.01)
            book.mouse(time, velocity, 0.01)
        assert ours.time == time
        agrees(ours.predict(time), book)
        if k == 70:
            ours.restart(time + 0.02, first)
            book.advance(time + 0.02)
            book.start(time + 0.02, first)
            time += 0.02
            agrees(ours.predict(time), book)
    ahead = ours.predict(time + 0.06)
    book.advance(time + 0.06)
    agrees(ahead, book)


@pytest.mark.slow
def test_compiled_and_numpy_agree():
    random = np.random.default_rng(5)
    filters = [KalmanFilter(MODEL, NOISE, compiled=compiled) for compiled in (True, False)]
    commands = some_commands(1.0)
    time = 0.0
    for _ in range(150):
        pose = 0.02 * random.normal(size=3)
        while commands and commands[0][0] <= time:
            for one in filters:
                one.command(*commands[0])
            del commands[0]
        for one in filters:
            one.pose(time, pose)
        for ahead in (0.0, 0.004, 0.05):
            compiled, plain = (one.predict(time + ahead) for one in filters)
            np.testing.assert_allclose(compiled.state, plain.state, rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose(compiled.motor_speed, plain.motor_speed, rtol=1e-12)
            np.testing.assert_allclose(
                compiled.disturbance, plain.disturbance, rtol=1e-8, atol=1e-9
            )
        time += random.uniform(1e-3, 3e-2)


@pytest.mark.slow
def test_on_an_exact_flight_state_and_disturbance_are_recovered():
    commands = some_commands(2.5)
    push = np.array([0.15, -0.1, 2.0])
    times = np.arange(0, 2.4, 1 / 240)
    start = np.concatenate([[0.3, -0.2, 0.5, 0.1, 0.2, -1.0], IDLE])
    truth = simulate(commands, start, times, lambda t: push)
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    for command in commands:
        ours.command(*command)
    found = []
    for time, z in zip(times.tolist(), truth, strict=True):
        ours.pose(time, z[:3])
        found.append(ours.predict(time))
    late = times > 1.2
    state = np.array([e.state for e in found])[late]
    np.testing.assert_allclose(state[:, :3], truth[late, :3], atol=2e-5)
    np.testing.assert_allclose(state[:, 3:5], truth[late, 3:5], atol=5e-4)
    np.testing.assert_allclose(state[:, 5], truth[late, 5], atol=1e-2)
    speed = np.array([e.motor_speed for e in found])
    np.testing.assert_allclose(speed, truth[:, 6:], atol=1e-8)
    disturbance = np.array([e.disturbance for e in found])[late]
    np.testing.assert_allclose(disturbance[:, :2] - push[:2], 0, atol=0.01)
    np.testing.assert_allclose(disturbance[:, 2], push[2], atol=0.2)
    # And, knowing the commands, where the craft will be.
    again = KalmanFilter(MODEL, NOISE, compiled=False)
    for command in commands:
        again.command(*command)
    for time, z in zip(times[:480].tolist(), truth[:480], strict=True):
        again.pose(time, z[:3])
    later = again.predict(float(times[504]))
    np.testing.assert_allclose(later.state[:2], truth[504, :2], atol=5e-4)
    np.testing.assert_allclose(later.state[2], truth[504, 2], atol=5e-3)


def test_without_disturbance_noise_no_disturbance_is_estimated():
    still = Noise(NOISE.pose, NOISE.acceleration, (0.0, 0.3, 0.0))
    ours = KalmanFilter(MODEL, still, compiled=False)
    random = np.random.default_rng(0)
    for k in range(50):
        ours.pose(k / 240, 0.01 * random.normal(size=3))
    assert ours.predict(0.3).disturbance[[0, 2]].tolist() == [0, 0]
    assert ours.predict(0.3).disturbance[1] != 0


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_a_pose_is_outside_the_gate_of_a_nan_estimate():
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    ours.pose(0.0, np.zeros(3))
    ours.command(0.0, np.full(MODEL.vehicle.n_propellers, 1e200))
    assert not ours.pose(0.1, np.zeros(3), gate=(0.1, 0.1, 1.0))


def velocity_error(imu: bool, mouse: bool) -> np.ndarray:
    """Root mean square error of vx, vy, ω from noisy poses eight times a second."""
    random = np.random.default_rng(2)
    commands = some_commands(2.6)
    times = np.arange(0, 2.5, 1 / 200)
    start = np.concatenate([np.zeros(6), IDLE])
    phases = np.array([0.0, 1.0, 2.0])

    def push(t: float) -> np.ndarray:
        return np.array([1.0, 1.0, 20.0]) * np.sin(9 * t + phases)

    truth = FLIGHTS.setdefault("wobbling", simulate(commands, start, times, push))
    loose = Noise(NOISE.pose, NOISE.acceleration, (5.0, 5.0, 100.0))
    ours, errors = KalmanFilter(MODEL, loose, compiled=False), []
    for command in commands:
        ours.command(*command)
    for k, (time, z) in enumerate(zip(times.tolist(), truth, strict=True)):
        noise = random.normal(size=8)
        if k % 25 == 0:
            ours.pose(time, z[:3] + noise[:3] * NOISE.pose)
        elif k % 5 == 0:
            c, s = np.cos(z[2]), np.sin(z[2])
            body = np.array([[c, s], [-s, c]])
            rate = np.array(acceleration(np, MODEL.dynamics, z[2:6], z[6:])) + push(time)
            if imu:
                force = body @ rate[:2] + 0.05 * noise[3:5]
                ours.imu(time, force, z[5] + 0.015 * noise[5], (0.05, 0.015))
            if mouse:
                ours.mouse(time + 1e-9, body @ z[3:5] + 0.01 * noise[6:], 0.01)
        if time > 0.5:
            errors.append(ours.predict(time + 2e-9).state[3:] - z[3:6])
    return np.sqrt(np.mean(np.square(errors), axis=0))


FLIGHTS: dict[str, np.ndarray] = {}


@pytest.mark.slow
def test_inertial_sensor_and_mouse_improve_velocities_between_sparse_poses():
    poses = velocity_error(imu=False, mouse=False)
    inertial = velocity_error(imu=True, mouse=False)
    optical = velocity_error(imu=False, mouse=True)
    assert (inertial < 0.6 * poses).all()
    assert (optical[:2] < 0.6 * poses[:2]).all()
    assert optical[2] == pytest.approx(poses[2], rel=0.01)  # it does not measure the spin
