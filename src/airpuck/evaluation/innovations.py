"""One-step innovations: measured poses minus a model's predictions from earlier poses.

The predictor is the extended Kalman filter of `airpuck.estimate.axis_filter`, with the physics of
`airpuck.physics.rigid_body`: x, y and γ have states (p, v, d) with p' = v, v' = a + d + w₁ and d' =
w₂. The noise densities maximise the likelihood of the innovations, a prediction error method (Ljung
1999, ch. 7). With the true model the innovations are white.

Along a given motion the filter's three axes are linear and independent, and their gains depend on
only two ratios of variances, λ₁ = q₁h³/r and λ₂ = q₂h⁵/r, with the variance r of the pose, the
squared densities q of w₁ and w₂ and the sample period h. r itself follows in closed form
(concentrated likelihood). So the search is two-dimensional, for all axes and many candidates at
once.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.compute.compiled import for_samples
from airpuck.data.sampling import hold, spaced
from airpuck.data.trajectory import Trajectory, check_propellers
from airpuck.deviation.packet_delays import delay_for
from airpuck.estimate.axis_filter import Noise, correct, process_noise, spread
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.rigid_body import register_pytrees, rollout

#: Ranges of log₁₀ λ₁ and λ₂; the lower end means no noise.
_LOWEST, _HIGHEST = np.array([-14.0, -22.0]), np.array([3.0, 3.0])
#: Number of candidates for each ratio in the first pass, and resolution at which to stop [decades].
_GRID, _FINEST = 9, 0.02
#: Smallest improvement of the likelihood that counts.
_GAIN = 1e-3
#: Standard deviation of the speed at the first pose of a stretch, in pose noise per sample period:
#: practically unknown.
_UNSURE = 1e3
#: Fewest innovations for a likelihood.
_FEWEST = 50
#: Initial values of the search for the noise.
_FIRST_GUESS = Noise((5e-5, 5e-5, 6e-4), (0.1, 0.1, 2.0), (0.2, 0.2, 6.0))
#: Time of used poses before a prediction starts, so that the speed is determined [s].
_SETTLE_S = 0.25


def most_likely_noise(
    pose: Float[np.ndarray, "N 3"],
    added: Float[np.ndarray, "N 3 2"],
    period: Float[np.ndarray, " N"],
    restart: Bool[np.ndarray, " N"],
    measured: Bool[np.ndarray, " N"],
    used: Bool[np.ndarray, " N"],
    typical: float,
    near: Noise | None = None,
) -> tuple[Noise, tuple[int, int, int]]:
    """Find the noise with the largest likelihood, and the number of its nonzero parameters.

    `added` is the model's contribution to position and velocity of each axis from one sample to the
    next; `typical` is the sample period [s]; `near` is an initial guess, if known.
    """
    # No packet is late.
    rest = np.zeros_like(pose), period, restart, measured, used.astype(float)
    units = typical ** np.array([-3.0, -5.0])
    search = NoiseSearch((pose, added[:, :, None], *rest), 1.0, typical, units, _LOWEST, _HIGHEST)
    around = np.array(list(itertools.product((-1, 0, 1), repeat=2)))
    ratios, variance = search.best(*_begin(near, search), around, _FINEST)
    parts: Any = np.sqrt([variance, *(ratios * variance[:, None]).T]).tolist()
    counts: Any = tuple((1 + (ratios > 0).sum(axis=1)).tolist())
    return Noise(*map(tuple, parts)), counts


@dataclass(frozen=True, eq=False)
class NoiseSearch:
    """A search for the noises that make the samples likeliest, each axis on its own."""

    #: What is given for each sample, the motors' lag and the sample period; see `passed`.
    given: tuple[np.ndarray, ...]
    lag: float
    period: float
    #: Each noise at logarithm 0, relative to the variance of the pose; and ranges of log₁₀, whose
    #: lower end means no noise.
    units: Float[np.ndarray, "*axes k"]
    lowest: Float[np.ndarray, " k"]
    highest: Float[np.ndarray, " k"]

    def costs(
        self, points: Float[np.ndarray, "C 3 k"]
    ) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3 k"]]:
        """Return the negative concentrated log-likelihood, up to a constant, r, and the noises."""
        ratios = np.where(points > self.lowest, 10.0**points, 0.0) * self.units
        three = np.pad(ratios, ((0, 0), (0, 0), (0, 3 - ratios.shape[2])))
        squares, logs, _ = passed(three, self.lag, self.period, self.given)
        count = self.given[-1].sum()
        return 0.5 * (count * np.log(squares / count) + logs), squares / count, ratios

    def best(
        self,
        point: Float[np.ndarray, "3 k"],
        step: Float[np.ndarray, "3 k"],
        around: Int[np.ndarray, "C k"],
        finest: float,
    ) -> tuple[Float[np.ndarray, "3 k"], Float[np.ndarray, " 3"]]:
        """Return the likeliest noises, relative to the variance of the pose, and that variance.

        Candidates lie `around` the best point in multiples of its step, which is halved where none
        of them is better, until all steps are at most `finest`.
        """
        axis, least = np.arange(3), np.full(3, np.inf)
        while (step > finest).any():
            candidates = np.clip(point + around[:, None] * step, self.lowest, self.highest)
            cost = self.costs(candidates)[0]
            best = cost.argmin(axis=0)
            better = cost[best, axis] < least - _GAIN
            point = np.where(better[:, None], candidates[best, axis], point)
            least = np.where(better, cost[best, axis], least)
            step = np.where(better[:, None], step, step / 2)
        # A noise must improve Akaike's criterion, otherwise it is zero. There are as many
        # candidates as in the search, to share one program.
        without = np.array(list(itertools.product((False, True), repeat=around.shape[1])))
        some = np.where(np.resize(without, around.shape)[:, None], self.lowest, point)
        cost, variance, ratios = self.costs(some)
        best = (cost + (ratios > 0).sum(axis=2)).argmin(axis=0)
        return ratios[best, axis], variance[best, axis]


def _begin(
    near: Noise | None, search: NoiseSearch
) -> tuple[Float[np.ndarray, "3 2"], Float[np.ndarray, "3 2"]]:
    """Return the centre and the first step of the search."""
    if near is not None:
        densities = np.square([near.acceleration, near.disturbance]).T
        ratios = densities / search.units / np.square(near.pose)[:, None]
        return np.clip(np.log10(ratios + 1e-300), _LOWEST, _HIGHEST), np.full((3, 2), 0.2)
    grid = np.array(list(itertools.product(*np.linspace(_LOWEST, _HIGHEST, _GRID).T)))
    candidates = np.repeat(grid[:, None], 3, axis=1)
    best = search.costs(candidates)[0].argmin(axis=0)
    step = (_HIGHEST - _LOWEST) / (_GRID - 1) / 2
    return candidates[best, np.arange(3)], np.repeat(step[None], 3, axis=0)


def passed(
    ratios: Float[np.ndarray, "C 3 3"], lag: float, period: float, given: tuple[np.ndarray, ...]
) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"], Float[np.ndarray, "N 3 s"] | None]:
    """Pass signals through a filter for each candidate of the noises.

    Candidates are ratios to the variance of the pose: of white accelerations, of disturbances, and
    of late packets that make motors of a `lag` [s] push less or more, m' = -m/τ. Returns sums of
    squares and of logarithms, and the innovations of a single candidate.
    """
    ratios, signals = ratios.reshape(-1, 3), given[1].shape[2]
    none, start = np.zeros(len(ratios)), np.zeros((len(ratios), 4, 4))
    start[:, :3, :3] = initial_covariance(np, none + 1, ratios[:, 1], period)
    carry = np.zeros((len(ratios), signals, 4)), start, none, none
    (*_, squares, logs), scaled = _compiled()((ratios, lag, start), carry, given)
    return squares.reshape(-1, 3), logs.reshape(-1, 3), scaled


@cache
def _compiled() -> Any:
    """Compile the pass over the samples, for some candidates of the noises and some signals."""
    import jax.numpy as jnp

    def advance(known: Any, carry: Any, now: Any) -> Any:
        (ratios, lag, start), (mean, covariance, squares, logs) = known, carry
        pose, added, kicks, h, restart, measured, used = now
        (count, signals, _), (acceleration, disturbance, lateness) = mean.shape, ratios.T
        pose, added = (jnp.tile(a, (count // 3,) + (1,) * (a.ndim - 1)) for a in (pose, added))
        # The first signal is the measured pose; for the others only their contribution matters.
        pose = jnp.pad(pose[:, None], ((0, 0), (0, signals - 1)))
        left = jnp.exp(-h / lag)
        gone = lag * (1 - left)
        step = jnp.array(
            [[1, h, h * h / 2, lag * (h - gone)], [0, 1, h, gone], [0, 0, 1, 0], [0, 0, 0, left]]
        )
        late = lateness * jnp.tile(kicks, count // 3)
        covariance = step @ covariance.at[:, 3, 3].add(late) @ step.T
        grown = process_noise(jnp, h, acceleration, disturbance)
        covariance = covariance.at[:, :3, :3].add(grown)
        mean = (mean @ step.T).at[..., :2].add(added)
        innovation, variance = pose - mean[..., 0], covariance[:, 0, 0] + 1.0
        squares = squares + used * innovation[:, 0] ** 2 / variance
        logs = logs + used * jnp.log(variance)
        gain = measured * covariance[:, :, 0] / variance[:, None]
        mean = mean + gain[:, None] * innovation[..., None]
        covariance = covariance - gain[:, :, None] * covariance[:, None, :, 0]
        mean = jnp.where(restart, jnp.zeros_like(mean).at[..., 0].set(pose), mean)
        covariance = jnp.where(restart, start, covariance)
        # A search needs only the sums.
        scaled = innovation / jnp.sqrt(variance)[:, None] if count == 3 else None
        return (mean, covariance, squares, logs), scaled

    return for_samples(advance)


def initial_covariance(xp: Any, pose_variance: Any, disturbance: Any, period: Any) -> Any:
    """Return the covariance of each axis at the first pose of a stretch."""
    zero = xp.zeros_like(pose_variance)
    speed = pose_variance * (_UNSURE / period) ** 2
    rows = [[pose_variance, zero, zero], [zero, speed, zero], [zero, zero, disturbance]]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations of one model on one trajectory, and the filter behind them."""

    #: Sample times [s].
    time: Float[np.ndarray, " N"]
    #: Measured minus predicted x, y [m], γ [rad].
    values: Float[np.ndarray, "N 3"]
    #: Standard deviations according to the filter.
    deviation: Float[np.ndarray, "N 3"]
    #: False in excluded spans, and at the first two poses of every stretch, which only determine
    #: position and speed of the craft.
    follows: Bool[np.ndarray, " N"]
    #: The measured poses among them.
    used: Bool[np.ndarray, " N"]
    #: Samples at which the filter restarts.
    restart: Bool[np.ndarray, " N"]
    #: The model's contribution to position and velocity of each axis since the previous sample.
    added: Float[np.ndarray, "N 3 2"]
    #: Estimates after each pose: axes x, y, γ; components p, v, d.
    mean: Float[np.ndarray, "N 3 3"]
    #: Covariances of the estimates, for each axis.
    covariance: Float[np.ndarray, "N 3 3 3"]
    #: φ at each sample.
    motor_speed: Float[np.ndarray, "N n"]
    noise: Noise
    #: Number of nonzero noise parameters estimated from these data, for each axis.
    noise_parameters: tuple[int, int, int]

    @property
    def standardised(self) -> Float[np.ndarray, "N 3"]:
        """Innovations divided by their standard deviations; zero where they are not used."""
        return np.where(self.used[:, None], self.values / self.deviation, 0.0)

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood of the used innovations, all three channels."""
        scaled = self.standardised[self.used]
        return float(-0.5 * np.sum(np.log(2 * np.pi * self.deviation[self.used] ** 2) + scaled**2))

    def starts(self, ahead: int, apart: int) -> Int[np.ndarray, " M"]:
        """Choose samples to predict from, each after 0.25 s of used poses.

        None of the `ahead` samples after each is excluded, and starts are at least `apart` samples
        apart.
        """
        settle = max(2, round(_SETTLE_S / float(np.median(np.diff(self.time)))))
        length = settle + ahead
        runs = np.convolve(self.follows, np.ones(length))[length - 1 : len(self.used)] >= length
        return spaced(np.flatnonzero(runs) + settle - 1, apart)


def innovations(model: Model, trajectory: Trajectory, noise: Noise | None = None) -> Innovations:
    """Predict every pose from earlier poses and the commands.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses, and commands that act after the trajectory's delay.
    noise : Noise, optional
        By default the noise with the largest likelihood.

    Returns
    -------
    Innovations
        Innovations at every sample.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or has too few usable samples in a row.
    """
    check_propellers(model.vehicle, trajectory)
    restart, follows = np.ones(len(trajectory), dtype=bool), np.zeros(len(trajectory), dtype=bool)
    for first, last in trajectory.segments:
        known = first + np.flatnonzero(trajectory.measured[first:last])
        if len(known) > 1:
            restart[known[0] + 1 : last], follows[known[1] + 1 : last] = False, True
    used = follows & trajectory.measured
    if used.sum() < _FEWEST:
        raise InputError(
            f"has only {used.sum()} poses whose predecessors are usable; at least {_FEWEST} are "
            "needed to judge one-step predictions",
            file=trajectory.source,
        )
    pose, time = trajectory.state[:, :3], trajectory.time
    begin = np.stack([pose, np.zeros_like(pose), np.zeros_like(pose)], axis=2)
    counts = (0, 0, 0)
    if noise is None:
        noise = _FIRST_GUESS
        for near in (False, True):
            # Accelerations depend on the noise only through the estimated yaw: two passes suffice.
            added = _run_filter(model, trajectory, noise, restart, begin)[2]
            period = np.diff(time, prepend=time[0])
            given = pose, added, period, restart, trajectory.measured, used
            near_by = noise if near else None
            noise, counts = most_likely_noise(*given, trajectory.sample_period, near_by)
    filtered = _run_filter(model, trajectory, noise, restart, begin)
    values, variance, added, mean, covariance, speed = filtered
    found = values, np.sqrt(variance), follows, used, restart, added, mean, covariance, speed
    return Innovations(time, *found, noise, counts)


def motor_speeds_at(
    time: Float[np.ndarray, " N"],
    event_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    *lag: Any,
) -> Float[np.ndarray, "N n"]:
    """Let motors follow commands from their events on; return their speeds at given times.

    The first command is assumed to have been in force before.
    """
    every = np.union1d(time, event_time)
    speeds = motor_speeds(every, hold(event_time, command, every), *lag)
    return speeds[np.searchsorted(every, time)]


def free_run(
    model: Model, trajectory: Trajectory, filtered: Innovations, starts: Int[np.ndarray, " M"]
) -> Float[np.ndarray, "N 3"]:
    """Simulate from the filter's estimates at the starts, without any later poses."""
    restart = np.zeros(len(trajectory), dtype=bool)
    restart[starts] = True
    begin = filtered.mean.copy()
    begin[:, :, 2] = 0.0
    # A filter without any uncertainty ignores poses.
    sure = Noise((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    mean = _run_filter(model, trajectory, sure, restart, begin, np.zeros((3, 3, 3)))[3]
    simulated = mean[:, :, 0]
    simulated[: starts[0]] = np.nan
    return simulated


def _run_filter(
    model: Model,
    trajectory: Trajectory,
    noise: Noise,
    restart: Bool[np.ndarray, " N"],
    begin: Float[np.ndarray, "N 3 3"],
    covariance: Float[np.ndarray, "3 3 3"] | None = None,
) -> tuple[np.ndarray, ...]:
    """Return innovations, variances, the model's contributions, estimates and motor speeds."""
    time, acts = trajectory.time, trajectory.command_time + delay_for(model, trajectory)
    squares = [np.square(part) for part in (noise.pose, noise.acceleration, noise.disturbance)]
    if covariance is None:
        covariance = initial_covariance(np, squares[0], squares[2], trajectory.sample_period)
    lag = model.dynamics.lag, model.dynamics.idle_lag
    speed = motor_speeds_at(time[:1], acts, trajectory.command, *lag)[0]
    pieces = cut_at_commands(time, acts, trajectory.command)
    steps = np.diff(time, prepend=time[0])
    inputs = (trajectory.state[:, :3], trajectory.measured, restart, begin, steps, *pieces)
    known, begun = (model.dynamics, *squares, covariance), (np.zeros((3, 3)), covariance, speed)
    return _compiled_filter()(known, begun, inputs)[1]


@cache
def _compiled_filter() -> Any:
    """Compile the filter over a trajectory; models of one structure share the program."""
    import jax.numpy as jnp

    register_pytrees()

    def advance(known: Any, carry: Any, given: Any) -> Any:
        dynamics, pose_variance, acceleration, disturbance, start = known
        mean, covariance, speed = carry
        pose, measured, restart, begin, h, durations, commands = given
        p, v, d = mean[:, 0], mean[:, 1], mean[:, 2]
        state = jnp.concatenate([p, v, speed])
        end = rollout(jnp, dynamics, state, commands, durations)[-1]
        added = jnp.stack([end[:3] - p - h * v, end[3:6] - v], axis=1)
        mean = jnp.stack([end[:3] + h * h / 2 * d, end[3:6] + h * d, d], axis=1)
        covariance = spread(jnp, covariance, h, acceleration, disturbance)
        innovation = pose - mean[:, 0]
        variance = covariance[:, 0, 0] + pose_variance
        noise = jnp.where(measured, pose_variance, jnp.inf)
        mean, covariance = correct(mean, covariance, 0, innovation, noise)
        mean = jnp.where(restart, begin, mean)
        covariance = jnp.where(restart, start, covariance)
        carry = mean, covariance, end[6:]
        return carry, (innovation, variance, added, *carry)

    return for_samples(advance)


def cut_at_commands(
    time: Float[np.ndarray, " N"],
    event_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N S n"]]:
    """Cut the time before each sample into intervals with one command each.

    Their number S is a power of two, so that few programs serve many recordings.
    """
    inside = (event_time > time[0]) & (event_time < time[-1])
    moments, which = event_time[inside], np.flatnonzero(inside)
    interval = np.searchsorted(time, moments, side="left")
    counts = np.bincount(interval, minlength=len(time))
    place = np.arange(len(moments)) - (np.cumsum(counts) - counts)[interval]
    size = 1 << int(counts.max(initial=0)).bit_length()
    ends = np.repeat(time[:, None], size, axis=1)
    ends[interval, place] = moments
    begins = np.concatenate([[time[0]], time[:-1]])
    durations = np.diff(ends, axis=1, prepend=begins[:, None])
    at_begin = np.clip(np.searchsorted(event_time, begins, side="right") - 1, 0, None)
    chosen = np.repeat(at_begin[:, None], size, axis=1)
    chosen[interval, np.minimum(place + 1, size - 1)] = which
    # Intervals after the last event keep its command.
    chosen = np.maximum.accumulate(chosen, axis=1)
    return durations, command[chosen]
