"""The state estimator, against a textbook filter and exact simulated flights."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm

from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.estimate.axis_filter import Noise, correct, spread
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import KalmanFilter
from airpuck.model.rigid_body import acceleration, derivative
from airpuck.model_file import read_model

MODEL = read_model("paper:M4")
DELAY = MODEL.transport_delay
TAU = float(MODEL.dynamics.motor_time_constant)
IDLE = np.full(6, MODEL.vehicle.command_min)
NOISE = Noise(pose=(1e-4, 2e-4, 6e-4), acceleration=(0.02, 0.03, 0.6), disturbance=(0.2, 0.3, 6.0))

Commands = list[tuple[float, np.ndarray]]


def some_commands(duration: float, seed: int = 0) -> Commands:
    """New ones a hundred times a second, never at the time of a pose."""
    random = np.random.default_rng(seed)
    times = 0.0037 + 0.01 * np.arange(round(100 * duration))
    return [(float(t), random.uniform(0.03, 0.6, 6)) for t in times]


def acting(commands: Commands, time: float) -> np.ndarray:
    """The command in force at a time."""
    sent = [c for t, c in commands if t + DELAY <= time]
    return sent[-1] if sent else IDLE


def switches(commands: Commands, start: float, end: float) -> list[float]:
    """Both ends and all times between them at which another command comes into force."""
    return [start, *(t + DELAY for t, _ in commands if start < t + DELAY < end), end]


def simulate(
    commands: Commands,
    start: np.ndarray,
    times: np.ndarray,
    push: Callable[[float], np.ndarray] = lambda t: np.zeros(3),
) -> np.ndarray:
    """Exact states of the craft with motors, under an extra acceleration."""

    def rhs(t: float, z: np.ndarray, command: np.ndarray) -> np.ndarray:
        rate = derivative(np, MODEL.dynamics, z, command)
        rate[3:6] += push(t)
        return rate

    states, z = [start], start
    for begin, end in pairwise(times.tolist()):
        for a, b in pairwise(switches(commands, begin, end)):
            command = acting(commands, (a + b) / 2)
            z = solve_ivp(rhs, (a, b), z, args=(command,), rtol=1e-9, atol=1e-12).y[:, -1]
        states.append(z)
    return np.array(states)


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
def test_any_data_are_filtered_as_the_textbook_says(seed):
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


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_arrival_does_not_matter(seed):
    # Three sensors of different latencies, some stamps equal: by stamp or by arrival is the same.
    random = np.random.default_rng(seed)
    told = [(k / 100, "mouse", (random.normal(size=2), 0.01), 0.0) for k in range(1, 40)]
    told += [(k / 100, "imu", (random.normal(size=2), 0.1, (0.35, 0.015)), 0.01) for k in range(40)]
    told += [(k / 200, "pose", (0.01 * random.normal(size=3),), 0.0213) for k in range(1, 80)]
    told.append((0.0, "pose", (np.zeros(3),), -1.0))
    found = []
    for order in (lambda m: m[0], lambda m: m[0] + m[3]):
        ours, commands = KalmanFilter(MODEL, NOISE, compiled=False), some_commands(0.45, seed)
        ours.pose(-0.001, np.zeros(3))
        ours.mouse(-0.001, np.zeros(2), 0.01)
        told.sort(key=lambda m: (m[0], m[3]))
        for time, kind, values, late in sorted(told, key=order):
            while commands and commands[0][0] <= time + max(late, 0):
                ours.command(*commands.pop(0))
            getattr(ours, kind)(time, *values)
            assert len(ours._history) < 60
        found.append(ours.predict(0.41))
    one, other = found
    np.testing.assert_allclose(one.state, other.state, atol=1e-9)
    np.testing.assert_allclose(one.disturbance, other.disturbance, atol=1e-7)
    np.testing.assert_allclose(one.motor_speed, other.motor_speed, atol=1e-12)


def test_only_poses_leave_nothing_to_remember():
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    for command in some_commands(0.4):
        ours.command(*command)
    for k in range(80):
        ours.pose(k / 200, np.zeros(3))
    assert len(ours._history) == len(ours._recent) == 0


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


@given(st.floats(1e-4, 0.1), st.integers(0, 99))
def test_covariance_grows_by_van_loans_integral(h, seed):
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1)
    densities = random.uniform(0, 2, (2, 3))
    grown = spread(np, covariance, h, *densities)
    chain = np.eye(3, k=1)
    for i in range(3):
        driving = np.diag([0, densities[0, i], densities[1, i]])
        van_loan = expm(h * np.block([[-chain, driving], [np.zeros((3, 3)), chain.T]]))
        step = van_loan[3:, 3:].T
        expected = step @ covariance[i] @ step.T + step @ van_loan[:3, 3:]
        np.testing.assert_allclose(grown[i], expected, rtol=1e-11, atol=1e-14)


@given(st.integers(0, 2), st.integers(0, 99))
def test_a_correction_is_the_conditional_gaussian(component, seed):
    # Information form: precisions add.
    random = np.random.default_rng(seed)
    roots = random.normal(size=(3, 3, 3))
    covariance = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    mean, innovation = random.normal(size=(3, 3)), random.normal(size=3)
    variance = np.array([0.5, 2.0, np.inf])
    after, less = correct(mean, covariance, component, innovation, variance)
    unit = np.eye(3)[component]
    for i in range(3):
        precision = np.linalg.inv(covariance[i]) + np.outer(unit, unit) / variance[i]
        expected = np.linalg.inv(precision)
        np.testing.assert_allclose(less[i], expected, atol=1e-9)
        shift = expected @ unit * innovation[i] / variance[i]
        np.testing.assert_allclose(after[i], mean[i] + shift, atol=1e-9)


def test_on_an_exact_flight_it_finds_state_and_disturbance():
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


@pytest.mark.parametrize("compiled", [True, False])
def test_the_future_changes_nothing_before(compiled):
    random = np.random.default_rng(1)
    poses = 0.02 * random.normal(size=(60, 3))
    other = poses.copy()
    other[30:] += 0.5

    def estimates(poses: np.ndarray) -> list[tuple[Estimate, np.ndarray]]:
        ours, found = KalmanFilter(MODEL, NOISE, compiled=compiled), []
        commands = some_commands(0.3)
        for k, pose in enumerate(poses):
            time = k / 240
            while commands and commands[0][0] <= time:
                ours.command(*commands.pop(0))
            ours.pose(time, pose)
            estimate = ours.predict(time + 0.01)
            found.append((estimate, np.append(estimate.state, estimate.disturbance)))
        return found

    one, two = estimates(poses), estimates(other)
    for k, ((kept, then), (_, changed)) in enumerate(zip(one, two, strict=True)):
        # Nor does an estimate that was handed out change later.
        np.testing.assert_array_equal(np.append(kept.state, kept.disturbance), then)
        assert np.array_equal(then, changed) == (k < 30)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_command_acts_after_the_transport_delay_and_not_before(compiled):
    assert DELAY > 0
    with_it, without = (KalmanFilter(MODEL, NOISE, compiled=compiled) for _ in range(2))
    command, sent = np.linspace(0.2, 0.9, 6), 0.1
    for one in (with_it, without):
        one.pose(0.0, np.zeros(3))
    with_it.command(sent, command)
    for time in (sent, sent + DELAY - 1e-9, sent + DELAY):
        one, other = with_it.predict(time), without.predict(time)
        np.testing.assert_allclose(one.state, other.state, atol=1e-15)
        np.testing.assert_allclose(one.motor_speed, other.motor_speed, atol=1e-15)
    for later in (1e-6, 0.01, 0.1, 1.0):
        found = with_it.predict(sent + DELAY + later)
        expected = command + (IDLE - command) * np.exp(-later / TAU)
        np.testing.assert_allclose(found.motor_speed, expected, rtol=1e-12)
    start = np.concatenate([np.zeros(6), IDLE])
    end = sent + DELAY + 0.02
    truth = simulate([(sent, command)], start, np.array([0.0, end]))[-1]
    np.testing.assert_allclose(with_it.predict(end).state[:2], truth[:2], atol=1e-4)


def test_a_command_told_before_the_pose_or_at_once_is_the_same():
    # Only when it acts matters, not how many poses lie in between.
    command = np.linspace(0.2, 0.9, 6)
    one, other = (KalmanFilter(MODEL, NOISE, compiled=False) for _ in range(2))
    one.command(0.05, command)
    for k in range(40):
        time = k / 240
        if k == 12:  # at 0.05 s
            other.command(0.05, command)
        for each in (one, other):
            each.pose(time, np.zeros(3))
    np.testing.assert_array_equal(one.predict(0.2).state, other.predict(0.2).state)


@pytest.mark.parametrize("compiled", [True, False])
def test_wrapped_and_continuous_yaw_give_the_same(compiled):
    one, other = (KalmanFilter(MODEL, NOISE, compiled=compiled) for _ in range(2))
    for k in range(200):
        time, yaw = k / 240, 2.5 + 12 * k / 240
        one.pose(time, np.array([0.1, 0.2, yaw]))
        other.pose(time, np.array([0.1, 0.2, np.arctan2(np.sin(yaw), np.cos(yaw))]))
        np.testing.assert_allclose(one.predict(time).state, other.predict(time).state, atol=1e-9)
    assert one.predict(199 / 240).state[5] == pytest.approx(12, abs=0.1)
    assert one.predict(199 / 240).state[2] == pytest.approx(2.5 + 12 * 199 / 240, abs=1e-2)


def test_a_pose_outside_the_gate_leaves_no_trace():
    ours, fresh = (KalmanFilter(MODEL, NOISE, compiled=False) for _ in range(2))
    gate = 0.1, 0.1, 1.0
    commands = some_commands(0.3)
    for one in (ours, fresh):
        for command in commands:
            one.command(*command)
    for k in range(60):
        time = k / 240
        if k % 7 == 3:
            for jump in ([0.3, 0, 0], [0, -0.3, 0], [0, 0, 1.5]):
                assert not ours.pose(time - 1e-3, np.array(jump), gate)
        for one in (ours, fresh):
            assert one.pose(time, np.zeros(3), gate)
        # A whole turn is no jump.
        np.testing.assert_array_equal(ours.predict(time).state, fresh.predict(time).state)
    assert ours.pose(0.26, np.array([0, 0, 2 * np.pi]), gate)


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


def test_inertial_sensor_and_mouse_improve_velocities_between_sparse_poses():
    poses = velocity_error(imu=False, mouse=False)
    inertial = velocity_error(imu=True, mouse=False)
    optical = velocity_error(imu=False, mouse=True)
    assert (inertial < 0.6 * poses).all()
    assert (optical[:2] < 0.6 * poses[:2]).all()
    assert optical[2] == pytest.approx(poses[2], rel=0.01)  # it says nothing about the spin


def test_before_the_first_pose_nothing_is_known():
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    ours.command(0.0, IDLE)
    ours.imu(0.0, np.zeros(2), 0.0, (0.1, 0.1))
    ours.mouse(0.1, np.zeros(2), 0.1)
    assert ours.time is None


def test_a_restart_keeps_motor_speeds_and_commands_on_their_way():
    ours = KalmanFilter(MODEL, NOISE, compiled=False)
    command = np.linspace(0.2, 0.9, 6)
    ours.pose(0.0, np.zeros(3))
    ours.command(0.0, command)
    ours.command(0.1, IDLE)
    ours.restart(0.1, np.array([1.0, 2.0, 3.0]))
    now = ours.predict(0.1)
    np.testing.assert_array_equal(now.state, [1, 2, 3, 0, 0, 0])
    np.testing.assert_array_equal(now.disturbance, np.zeros(3))
    reached = command + (IDLE - command) * np.exp(-(0.1 - DELAY) / TAU)
    np.testing.assert_allclose(now.motor_speed, reached, rtol=1e-12)
    later = 0.1 + DELAY + 0.02
    peak = command + (IDLE - command) * np.exp(-0.1 / TAU)
    np.testing.assert_allclose(
        ours.predict(later).motor_speed, IDLE + (peak - IDLE) * np.exp(-0.02 / TAU), rtol=1e-12
    )


def test_a_reset_forgets_everything():
    used, fresh = (KalmanFilter(MODEL, NOISE, compiled=False) for _ in range(2))
    used.pose(0.0, np.ones(3))
    used.command(0.0, np.full(6, 0.5))
    used.pose(0.1, np.ones(3))
    used.reset()
    assert used.time is None
    for one in (used, fresh):
        one.pose(0.0, np.zeros(3))
    np.testing.assert_array_equal(used.predict(0.3).state, fresh.predict(0.3).state)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_a_number_never_gets_in(bad):
    seen, spared = (TrackingController(MODEL, SetPoint(0, 0, 0), compiled=False) for _ in range(2))
    for k in range(30):
        time = k / 240
        for one in (seen, spared):
            one.pose(time, np.array([0.001 * k, 0, 0]))
        for place in range(3):
            pose = np.zeros(3)
            pose[place] = bad
            seen.pose(time + 1e-3, pose)
        seen.pose(bad, np.zeros(3))
        seen.imu(time + 1e-3, np.array([0, bad]), 0.0)
        seen.imu(time + 1e-3, np.zeros(2), bad)
        seen.mouse(time + 1e-3, np.array([bad, 0]))
        one, other = seen.filter.predict(time + 0.05), spared.filter.predict(time + 0.05)
        np.testing.assert_array_equal(one.state, other.state)
        np.testing.assert_array_equal(one.disturbance, other.disturbance)
        assert np.isfinite(one.state).all()
