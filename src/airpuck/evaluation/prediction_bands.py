"""Predictions with 95 % bands, from the uncertainty of a model.

Every Runge-Kutta step of a prediction also advances two quantities (Ljung 1999, ch. 4 and 7; an
extended Kalman filter without measurements). The first is the state's sensitivity to the
parameters, by the chain rule, S' = F S + G. The second is the covariance of unmodelled effects, C'
= A C Aᵀ + Q. Through A, yaw changes the directions of the thrusts, so uncertainty of yaw spreads to
x and y. A learned transport delay is a parameter, too: it moves the times at which commands change,
so one part of a step grows by as much as the next one shrinks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.compute.arrays import register_pytree, scan
from airpuck.compute.compiled import for_batches, lengthened
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import delay_for
from airpuck.estimate.axis_filter import spread
from airpuck.evaluation.fit_measures import RESTART
from airpuck.evaluation.innovations import Innovations, cut_at_commands, innovations
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.physics.motor import all_lags, motor_step
from airpuck.physics.rigid_body import CenterOfMassFrame, rollout

#: 97.5 % quantile of the normal distribution: half of a 95 % band, in standard deviations.
BAND = 1.959963984540054
#: Horizons shown for a recording: the paper's, and a simulation [s].
HORIZONS = (0.2, RESTART)
#: Number of samples before a start over which motor speeds are tracked for their dependence on the
#: lag.
_LEAD = 40
#: Smallest number of windows in a program; a few more cost nothing, but another program takes
#: seconds.
_FEWEST = 64


@dataclass(frozen=True, eq=False)
class PredictionBands(Result):
    """Predictions of W windows over T samples, with 95 % bands.

    Attributes
    ----------
    model : str
        Name of the rung.
    start : array, shape (W,)
        Start time of each prediction [s].
    time : array, shape (T, W)
        Times predicted [s].
    predicted, measured : array, shape (T, 3, W)
        x, y [m], γ [rad]; measured: NaN where a frame was lost.
    by_parameters : array, shape (T, 3, W), or None
        Half the band due to the uncertainty of the parameters: quantile of Student's t times the
        standard error. None if the model has no uncertainty; nan where the prediction depends on
        undetermined parameters.
    total : array, shape (T, 3, W)
        Half the band that should contain measured poses: the root of the sum of squares of
        `by_parameters` and of 1.96 standard deviations of unmodelled effects, the initial state
        and the measured pose.

    Examples
    --------
    >>> bands = airpuck.prediction_bands(model, trajectory)
    >>> isinstance(bands, airpuck.PredictionBands), bands.total.shape == bands.predicted.shape
    (True, True)
    """

    JSON = (
        "horizon_s=horizon windows=start.size coverage_percent=coverage:x_m,y_m,yaw_rad "
        "half_band:x_m,y_m,yaw_rad half_band_parameters:x_m,y_m,yaw_rad"
    )

    model: str
    start: Float[np.ndarray, " W"]
    time: Float[np.ndarray, "T W"]
    predicted: Float[np.ndarray, "T 3 W"]
    measured: Float[np.ndarray, "T 3 W"]
    by_parameters: Float[np.ndarray, "T 3 W"] | None
    total: Float[np.ndarray, "T 3 W"]

    @property
    def horizon(self) -> float:
        """Longest prediction time, averaged over the windows [s]."""
        return float(np.mean(self.time[-1] - self.start))

    @property
    def covered(self) -> Bool[np.ndarray, "T 3 W"]:
        """Whether each measured pose is within the total band."""
        return np.abs(self.measured - self.predicted) <= self.total

    @property
    def coverage(self) -> Float[np.ndarray, " 3"]:
        """Percentage of the windows whose pose at the horizon is within its total band.

        Among those with a known band and a measured pose.
        """
        known = np.isfinite(self.total[-1] + self.measured[-1]).sum(axis=1)
        share = np.full(3, np.nan)
        return np.divide(100.0 * self.covered[-1].sum(axis=1), known, out=share, where=known > 0)

    @property
    def half_band(self) -> Float[np.ndarray, " 3"]:
        """Half the total band at the horizon, median of the windows."""
        return np.median(self.total[-1], axis=1)

    @property
    def half_band_parameters(self) -> Float[np.ndarray, " 3"] | None:
        """Half the band from the parameters at the horizon, median of the windows."""
        return None if self.by_parameters is None else np.median(self.by_parameters[-1], axis=1)


def prediction_bands(
    model: Model,
    trajectory: Trajectory,
    *,
    horizon: float = 0.2,
    starts: Int[np.ndarray, " W"] | None = None,
    known: Innovations | None = None,
) -> PredictionBands:
    """Predict windows of a trajectory with 95 % bands.

    Predictions start from the estimates of the filter behind the one-step innovations, which uses
    every pose up to the start; after that, only the commands are used. Errors are propagated
    linearly: if the band of yaw is wider than about a radian, the bands of x and y are only orders
    of magnitude.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses, and commands.
    horizon : float, default 0.2
        Prediction horizon [s].
    starts : array of int, shape (W,), optional
        Samples to start from. By default they follow each other without overlap, wherever poses are
        usable for a quarter of a second before and throughout the prediction.
    known : Innovations, optional
        Innovations of the same model, if known; for example with the noise of another recording.

    Returns
    -------
    PredictionBands
        Predictions and bands.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or no window fits.

    Examples
    --------
    >>> bands = airpuck.prediction_bands(model, trajectory, horizon=0.2)
    >>> len(bands.coverage)  # x, y, yaw: percent of the poses within the bands
    3
    """
    numbers.HORIZON.check(horizon, "horizon")
    if known is None:
        known = innovations(model, trajectory)
    steps = trajectory.steps(horizon)
    if starts is None:
        starts = known.starts(steps, steps)
    if len(starts) == 0 or starts.min() < 0 or starts.max() + steps >= len(trajectory):
        raise InputError(
            f"has no usable stretch that is long enough to predict {horizon:g} s",
            file=trajectory.source,
        )
    uncertainty = model.known
    entries = np.zeros(len(model.free), dtype=bool) if uncertainty is None else uncertainty.moved
    predicted, variance, sensitivity = predict_with_errors(
        model, trajectory, known, starts, steps, entries
    )
    variance = variance + np.square(known.noise.pose)[:, None]
    squares, by_parameters = BAND**2 * variance, None
    if uncertainty is not None:
        gradient = np.zeros((len(entries), predicted.size))
        gradient[entries] = sensitivity.reshape(predicted.size, -1).T
        error = uncertainty.errors_along(gradient).reshape(predicted.shape)
        by_parameters = uncertainty.quantile * error
        squares = squares + by_parameters**2
    ahead = starts + np.arange(1, steps + 1)[:, None]
    poses = np.where(trajectory.measured[:, None], trajectory.state[:, :3], np.nan)
    return PredictionBands(
        model=model.name,
        start=trajectory.time[starts],
        time=trajectory.time[ahead],
        predicted=predicted,
        measured=np.moveaxis(poses[ahead], 2, 1),
        by_parameters=by_parameters,
        total=np.sqrt(squares),
    )


def bands_of_all_horizons(
    model: Model, trajectory: Trajectory, filtered: Innovations
) -> tuple[PredictionBands, ...]:
    """Predict over each of `HORIZONS` for which the recording has a long enough stretch."""
    return tuple(
        prediction_bands(model, trajectory, horizon=horizon, known=filtered)
        for horizon, ahead in zip(HORIZONS, map(trajectory.steps, HORIZONS), strict=True)
        if len(filtered.starts(ahead, ahead))
    )


def predict_with_errors(
    model: Model,
    trajectory: Trajectory,
    filtered: Innovations,
    starts: Int[np.ndarray, " W"],
    steps: int,
    entries: Bool[np.ndarray, " P"],
) -> tuple[Float[np.ndarray, "T 3 W"], Float[np.ndarray, "T 3 W"], Float[np.ndarray, "T 3 W F"]]:
    """Predict from the filter's estimates.

    Returns x, y [m], γ [rad], their variances, and their derivatives by the chosen `entries` of θ.
    """
    acts = trajectory.command_time + delay_for(model, trajectory)
    durations, commands = cut_at_commands(trajectory.time, acts, trajectory.command)
    later, count, starts = _growth(commands), len(starts), lengthened(starts, _FEWEST)
    # The first sample has pieces of zero length, so it can replace the samples before it.
    lead = np.maximum(starts[:, None] + np.arange(1 - _LEAD, 1), 0)
    ahead = starts[:, None] + np.arange(1, steps + 1)
    mean = filtered.mean[starts]
    densities = np.square([filtered.noise.acceleration, filtered.noise.disturbance])
    estimate = model.parameters
    register_pytree(type(estimate))  # effects of the user's own make it another class
    found = _compiled()(
        model.vehicle,
        model.frame,
        (estimate, estimate.to_vector(), np.flatnonzero(entries), densities),
        np.concatenate([mean[:, :, 0], mean[:, :, 1]], axis=1),
        mean[:, :, 2],
        filtered.covariance[starts],
        filtered.motor_speed[np.maximum(starts - _LEAD, 0)],
        (commands[lead], durations[lead], later[lead]),
        (commands[ahead], durations[ahead], later[ahead]),
    )
    predicted, variance, sensitivity = (np.moveaxis(np.array(a)[:count], 0, 2) for a in found)
    return predicted, variance, sensitivity


def _growth(commands: Float[np.ndarray, "N S n"]) -> Float[np.ndarray, "N S"]:
    """Return the derivatives of the lengths of pieces with respect to the transport delay.

    An interval ends at a command, which moves with the delay, or at a sample, which does not. If
    the command stays the same, the choice does not matter.
    """
    changes = (commands[:, 1:] != commands[:, :-1]).any(axis=2)
    return np.diff(changes.astype(float), axis=1, prepend=0.0, append=0.0)


@cache
def _compiled() -> Any:
    """Compile predictions of windows; models of one craft and structure share the program."""
    import jax

    def windows(vehicle: Vehicle, frame: CenterOfMassFrame, known: Any, *each: Any) -> Any:
        return jax.vmap(_one_prediction(vehicle, frame, *known))(*each)

    return for_batches(windows, static_argnums=(0, 1))


def _one_prediction(
    vehicle: Vehicle,
    frame: CenterOfMassFrame,
    estimate: Parameters,
    vector: Any,
    chosen: Any,
    densities: Any,
) -> Any:
    """Return the function that predicts one window.

    `vector` contains the estimate; `chosen` are the entries of θ to differentiate by.
    """
    import jax
    import jax.numpy as jnp

    count, n = len(chosen), vehicle.n_propellers

    def parameters(free: Any) -> Parameters:
        return estimate.with_vector(vector.at[chosen].set(free))

    def delayed(free: Any, durations: Any, later: Any) -> Any:
        return durations + later * (parameters(free).transport_delay - estimate.transport_delay)

    def follow(free: Any, speed: Any, lead: Any) -> Any:
        moved = parameters(free)
        tau = all_lags(moved.motor_time_constant, vehicle.actuation.own_lag)
        lag = tau, moved.idle_lag
        flat = lead[0].reshape(-1, n), delayed(free, *lead[1:]).ravel()

        def turn(speed: Any, held: tuple[Any, Any]) -> tuple[Any, Any]:
            command, duration = held
            speed = motor_step(jnp, speed, command, duration, *lag)
            return speed, speed

        return scan(jnp, turn, speed, flat)[0]

    def move(free: Any, state: Any, disturbance: Any, held: tuple[Any, Any, Any]) -> Any:
        commands, *lengths = held
        durations = delayed(free, *lengths)
        dynamics = parameters(free).dynamics(jnp, vehicle, frame)
        end = rollout(jnp, dynamics, state, commands, durations)[-1]
        h = durations.sum()
        return end + jnp.concatenate([h * h / 2 * disturbance, h * disturbance, jnp.zeros(n)])

    def predict(
        motion: Any, disturbance: Any, covariance: Any, speed: Any, lead: Any, ahead: Any
    ) -> Any:
        free = vector[chosen]

        def advance(carry: Any, held: Any) -> Any:
            state, slope, covariance = carry
            by_free, by_state = jax.jacfwd(move, argnums=(0, 1))(free, state, disturbance, held)
            state, slope = move(free, state, disturbance, held), by_state @ slope + by_free
            h = held[1].sum()
            push = jnp.concatenate([h * h / 2 * jnp.eye(3), h * jnp.eye(3)])
            change = jnp.block([[by_state[:6, :6], push], [jnp.zeros((3, 6)), jnp.eye(3)]])
            added = spread(jnp, jnp.zeros((3, 3, 3)), h, *densities)
            covariance = change @ covariance @ change.T + _joined(jnp, added)
            return (state, slope, covariance), (state[:3], jnp.diag(covariance)[:3], slope[:3])

        state = jnp.concatenate([motion, follow(free, speed, lead)])
        by_free = jax.jacfwd(follow)(free, speed, lead)
        slope = jnp.concatenate([jnp.zeros((6, count)), by_free])
        begin = state, slope, _joined(jnp, covariance)
        return scan(jnp, advance, begin, ahead)[1]

    return predict


def _joined(xp: Any, covariance: Any) -> Any:
    """Combine the axes' covariances of (p, v, d) into one of all p, all v, all d, shape (9, 9)."""
    return xp.einsum("aij,ab->iajb", covariance, xp.eye(3)).reshape(9, 9)
