"""Replay: feed a recorded flight to the controller and compare its commands with the record."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Brief
from airpuck.control.law import Status, Step
from airpuck.control.lqr import LQR, look_ahead, motor_lag
from airpuck.control.reference import Target
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.estimate.estimator import Estimate
from airpuck.flight.track import recorded_set_points
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import pose_difference
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.camera_clock import at_exposure
from airpuck.preprocessing.clock import seconds
from airpuck.preprocessing.pipeline import clean_streams
from airpuck.recording.stream import Recording

#: The reason, where the pose was not known.
Estimates = list[Estimate | Status]


@dataclass(frozen=True)
class Gains:
    """Gains of a regulator that treats x and y alike."""

    #: Acceleration for an error in position [1/s²] and in velocity [1/s].
    position: float
    speed: float
    #: Angular acceleration for an error in yaw [1/s²] and in yaw rate [1/s].
    yaw: float
    spin: float

    def matrix(self) -> Float[np.ndarray, "3 6"]:
        """Return K of v = -K x, for the state x, y, γ, vx, vy, ω."""
        of_pose = np.diag([self.position, self.position, self.yaw])
        return np.hstack([of_pose, np.diag([self.speed, self.speed, self.spin])])

    @classmethod
    def of(cls, matrix: Float[np.ndarray, "3 6"]) -> Gains:
        """Extract the gains from a matrix."""
        return cls(*(float(matrix[i, j]) for i, j in ((0, 0), (0, 3), (2, 2), (2, 5))))


@dataclass(frozen=True, eq=False)
class Replay(Brief):
    """Recorded commands, and the controller's commands.

    Attributes
    ----------
    time : array, shape (K,)
        Times of the commands, from the first one on [s].
    sent, computed : array, shape (K, n)
        The recorded commands and ours.
    status : tuple of str
        Outcome of each of our steps.
    reference, pose : array, shape (K, 3)
        The reference, and the estimated pose of the craft [m, m, rad].
    gains : Gains or None
        Gains of the LQR; None for another law.
    fitted : bool
        Whether the gains were fitted to the flight.
    motors : tuple of str
        Names of the motors.
    compared : array of bool, shape (K,)
        Which commands are compared: those in the span at which the pose was known.
    span : array of bool, shape (K,)
        Which commands lie in the span.

    Examples
    --------
    >>> result = airpuck.replay(recording, model)
    >>> isinstance(result, airpuck.Replay), result.computed.shape == result.sent.shape
    (True, True)
    """

    time: Float[np.ndarray, " K"]
    sent: Float[np.ndarray, "K n"]
    computed: Float[np.ndarray, "K n"]
    status: tuple[Status, ...]
    reference: Float[np.ndarray, "K 3"]
    pose: Float[np.ndarray, "K 3"]
    gains: Gains | None
    fitted: bool
    motors: tuple[str, ...]
    compared: Bool[np.ndarray, " K"]
    span: Bool[np.ndarray, " K"]

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of control steps in the span per outcome."""
        found = Counter(self.status[k] for k in np.flatnonzero(self.span))
        return dict(sorted(found.items()))

    @property
    def correlation(self) -> Float[np.ndarray, " n"]:
        """Correlation of recorded and computed commands, for each motor; 0 if one is constant."""
        compared = np.stack([self.sent, self.computed])[:, self.compared]
        sent, computed = compared - compared.mean(axis=1, keepdims=True)
        norm = np.linalg.norm(sent, axis=0) * np.linalg.norm(computed, axis=0)
        return np.sum(sent * computed, axis=0) / np.where(norm > 0, norm, 1.0)

    @property
    def difference(self) -> Float[np.ndarray, "C n"]:
        """Computed minus recorded commands, where they are compared."""
        return (self.computed - self.sent)[self.compared]

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Returns
        -------
        dict
            ``motors`` (``name, correlation, median_abs`` each), ``median_abs`` over all motors,
            ``gains``, ``fitted``, ``steps``, ``outcomes``; all within the span.
        """
        apart = np.abs(self.difference)
        motors = zip(self.motors, self.correlation, np.median(apart, axis=0), strict=True)
        return {
            "motors": [
                {"name": name, "correlation": float(r), "median_abs": float(m)}
                for name, r, m in motors
            ],
            "median_abs": float(np.median(apart)),
            "gains": None if self.gains is None else vars(self.gains),
            "fitted": self.fitted,
            "steps": int(self.compared.sum()),
            "outcomes": self.outcomes,
        }


def replay(
    recording: Recording,
    model: Model,
    *,
    tuning: Tuning | None = None,
    fit_gains: bool = False,
    compensate_delay: bool = False,
    reject_disturbance: bool = False,
    span: tuple[float, float] = (0.0, 1.0),
) -> Replay:
    """Feed the poses of a recorded flight to the controller and compare commands.

    At the time of every recorded command, the controller has received the poses that had arrived by
    then. It continues with the recorded command, so that differences do not accumulate.

    Parameters
    ----------
    recording : Recording
        Poses, commands and references of a flight.
    model : Model
        The controller's model of the craft.
    tuning : Tuning, optional
        Tuning; by default the one for the model.
    fit_gains : bool, default False
        Whether to fit the regulator's four gains to the recorded commands first.
    compensate_delay, reject_disturbance : bool, default False
        See `TrackingController`; the paper's controller did neither.
    span : (float, float), default (0, 1)
        Part of the flight to compare, as fractions of its length.

    Returns
    -------
    Replay
        Both commands, and how well they agree.

    Raises
    ------
    InputError
        If a stream is missing or cannot be used.

    Examples
    --------
    >>> result = airpuck.replay(recording, model)
    >>> result.correlation.shape
    (6,)
    """
    tuning = tuning or tuning_for(model)
    _, commands, aligned = clean_streams(recording, model.vehicle)
    # Aligned times belong to the poses without repetitions.
    pose, _ = at_exposure(recording["pose"])
    if not 0 <= span[0] < span[1] <= 1:
        raise InputError("must be two fractions of the length, 0 <= A < B <= 1", field="span")
    time, sent = commands.time, commands.values
    # The recorder may have been busy; the controller got the poses after their usual latency.
    latency = np.median(seconds(pose.received_ns) - aligned.recorder_epoch - aligned.pose_time)
    controller = TrackingController(
        model,
        recorded_set_points(recording, aligned.recorder_epoch),
        tuning,
        compensate_delay=compensate_delay,
        reject_disturbance=reject_disturbance,
    )
    if fit_gains and controller.law.gain is None:
        problem = "this law has no gains; use --law lqr"
        raise InputError(problem, field="--fit-gains")
    estimates = fly_through(
        controller, aligned.pose_time, aligned.pose_time + latency, pose.values, time, sent
    )
    share = np.arange(len(time)) / len(time)
    inside = (share >= span[0]) & (share < span[1])
    compared = inside & np.array([isinstance(estimate, Estimate) for estimate in estimates])
    if not compared.any():
        raise InputError(
            "the pose was not known at any command in the span; use a longer span, or a recording "
            "whose poses and commands overlap",
            file=recording.source,
        )
    if fit_gains:
        # A motor at its limit carries no information about gains.
        used = np.flatnonzero(compared & (np.abs(sent).max(axis=1) < 0.98))
        _fit_gains(controller, [estimates[k] for k in used], time[used], sent[used])
    computed, status = _steer(controller, estimates, time)
    poses = [e.state[:3] if isinstance(e, Estimate) else np.full(3, np.nan) for e in estimates]
    return Replay(
        time=time - time[0],
        sent=sent,
        computed=computed,
        status=status,
        reference=np.array([target.state[:3] for target in _targets(controller, time)]),
        pose=np.array(poses),
        gains=None if (gain := controller.law.gain) is None else Gains.of(gain),
        fitted=fit_gains,
        motors=model.vehicle.columns,
        compared=compared,
        span=inside,
    )


def fly_through(
    controller: TrackingController,
    stamps: Float[np.ndarray, " N"],
    arrivals: Float[np.ndarray, " N"],
    poses: Float[np.ndarray, "N 3"],
    times: Float[np.ndarray, " K"],
    sent: Float[np.ndarray, "K n"],
) -> Estimates:
    """Run the estimator through the flight; return estimates, or the reason for each missing one.

    Estimates do not depend on the gains.
    """
    estimates: Estimates = []
    following = 0
    for time, command in zip(times, sent, strict=True):
        while following < len(arrivals) and arrivals[following] <= time:
            controller.pose(float(stamps[following]), poses[following])
            following += 1
        estimates.append(controller.refusal(float(time)) or controller.predict(float(time)))
        controller.sent(float(time), command)
    return estimates


def _targets(controller: TrackingController, times: Float[np.ndarray, " K"]) -> list[Target]:
    """Return the targets one period after the commands of these times begin to act."""
    ahead = controller.model.transport_delay + controller.tuning.period_s
    return [controller.reference.at(float(time), ahead) for time in times]


def _steer(
    controller: TrackingController, estimates: Estimates, times: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, "K n"], tuple[Status, ...]]:
    """Compute all commands."""
    idle = controller.model.vehicle.idle
    steps = [
        controller.steer(known, time) if isinstance(known, Estimate) else Step(idle, known)
        for known, time in zip(estimates, times.tolist(), strict=True)
    ]
    return np.array([step.command for step in steps]), tuple(step.status for step in steps)


def _fit_gains(
    controller: TrackingController,
    estimates: Estimates,
    times: Float[np.ndarray, " K"],
    sent: Float[np.ndarray, "K n"],
) -> None:
    """Fit the law's gains: first a robust linear regression, then the commands themselves."""
    from scipy.optimize import least_squares

    law = controller.law
    assert isinstance(law, LQR)
    if len(sent) < 50:
        raise InputError("too few commands below saturation to fit gains to", field="fit-gains")
    linear, angular = _regression(controller, estimates, _targets(controller, times), sent)
    start = np.array([*_robust(*linear), *_robust(*angular)])

    def residuals(factors: Float[np.ndarray, " 4"]) -> Float[np.ndarray, " M"]:
        law.gain = Gains(*(start * factors).tolist()).matrix()
        return (_steer(controller, estimates, times)[0] - sent).ravel()

    # Commands have kinks where bounds become active: steps of one percent average over them.
    found = least_squares(
        residuals, np.ones(4), loss="soft_l1", f_scale=0.02, diff_step=0.01, max_nfev=12
    )
    law.gain = Gains(*(start * found.x).tolist()).matrix()


def _regression(
    controller: TrackingController,
    estimates: Estimates,
    targets: list[Target],
    sent: Float[np.ndarray, "K n"],
) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Collect errors, and the accelerations that resulted from the recorded commands.

    v_{k+1} = -K (x_{k+1} - reference) is linear in the gains, and v_{k+1} follows from the motor
    speeds after the recorded command.
    """
    dynamics, period = controller.model.dynamics, controller.tuning.period_s
    lag, drive = motor_lag(dynamics.lag, period)
    driven = controller.model.vehicle.actuation.split(sent)
    rows = []
    for estimate, target, command in zip(estimates, targets, driven, strict=True):
        assert isinstance(estimate, Estimate)
        speed = estimate.motor_speed
        following, matrix, offset = look_ahead(
            np, dynamics, period, estimate.state, speed, np.zeros(3), np.ones(len(speed))
        )
        given = matrix @ thrust(dynamics.thrust, lag * speed + drive * command) + offset
        rows.append(np.concatenate([pose_difference(np, following, target.state), given]))
    x, y, yaw, vx, vy, spin, ax, ay, turn = np.array(rows).T
    linear = np.stack([np.append(x, y), np.append(vx, vy)], axis=1), -np.append(ax, ay)
    return linear, (np.stack([yaw, spin], axis=1), -turn)


def _robust(regressors: Float[np.ndarray, "M 2"], response: Float[np.ndarray, " M"]) -> list[float]:
    """Least absolute deviations, by iteratively reweighted least squares."""
    weights = np.ones(len(response))
    solution = np.zeros(2)
    for _ in range(30):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(root[:, None] * regressors, root * response, rcond=None)[0]
        apart = np.abs(regressors @ solution - response)
        weights = 1 / np.maximum(apart, 1e-3 * np.abs(response).max() + 1e-12)
    return solution.tolist()
