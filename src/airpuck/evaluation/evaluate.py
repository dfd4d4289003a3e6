"""Prediction errors of a model on a trajectory: the paper's protocol (sec:results).

Its result at 0.2 s is table:prediction_error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from airpuck.boundary.arguments import chosen
from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result, html_table, plain
from airpuck.data.trajectory import Span, Trajectory, as_trajectories, check_propellers
from airpuck.data.windows import Windows, integration_parts, make_windows
from airpuck.deviation.time_scale import forgetting_time, showing_time
from airpuck.estimate.actuation import ActuationEncoder
from airpuck.estimate.encoder import Encoder, PaperEncoder, StateEncoder
from airpuck.evaluation.statistical_tests import BLOCK_S, rmse_interval
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics, rollout

#: Names of the channels in every result, with their units.
CHANNELS = ("x_m", "y_m", "yaw_rad")
#: Number of starts per prediction horizon if every start counts: twelve in 0.2 s, every fourth
#: sample at 240 Hz. Neighbours nearly repeat each other: compared with using all starts, root mean
#: squares change by less than 1 %, and intervals by less than their own error.
_STARTS_PER_HORIZON = 12
#: Past that is long enough for the motors of the paper's craft [s].
_LONG = 40 / 240
#: After a fault, until motor speeds are known again: three time constants [s].
RECOVERY_S = 0.08
#: Number of windows predicted at once, which bounds the memory.
_BATCH = 1024


def by_channel(values: Float[np.ndarray, " 3"]) -> dict[str, float]:
    """Name the values of x, y [m] and yaw [rad]."""
    return dict(zip(CHANNELS, values.tolist(), strict=True))


@dataclass(frozen=True)
class Protocol:
    """The choice of predictions, and the time at which they are evaluated.

    Examples
    --------
    >>> found = airpuck.evaluate(model, trajectory, protocol=airpuck.Protocol().after(0.4))
    >>> bool((found.rmse > airpuck.evaluate(model, trajectory).rmse).all())
    True
    """

    #: Every reported number names its protocol.
    name: str = "paper"
    #: Duration of the encoder's past and of the prediction [s]; windows do not overlap. By default
    #: E = 20 and T = 50 samples at 240 Hz.
    encoder_time: float = 20 / 240
    prediction_time: float = 50 / 240
    #: Prediction horizon at which errors are reported [s]; the nearest step counts.
    horizon: float = 0.2
    #: Longest past that an encoder may use if it is usable [s]; by default the window's.
    longest_past: float | None = None
    #: Whether an encoder must use only measurements up to the present.
    causal: bool = False

    def after(self, horizon: float) -> Protocol:
        """Return the protocol with errors reported at another horizon.

        Parameters
        ----------
        horizon : float
            After which time errors count [s]; predictions become longer if necessary.

        Returns
        -------
        Protocol
            A copy.
        """
        return replace(self, horizon=horizon, prediction_time=max(horizon, self.prediction_time))

    def suited(self, model: Model, trajectory: Trajectory) -> Protocol:
        """Return the protocol with times that suit a slow craft; see `evaluate`.

        Predictions last until thrust stands out from the noise of poses. Slow motors remember more
        commands than the window has.
        """
        lasting = showing_time([trajectory], model.vehicle)
        remembered = forgetting_time(model.vehicle)
        if remembered <= _LONG:
            return replace(self, prediction_time=max(self.prediction_time, lasting))
        past = max(self.longest_past or self.encoder_time, remembered)
        lasting = max(self.prediction_time, lasting, remembered)
        return replace(self, prediction_time=lasting, longest_past=past)


#: The windows, and therefore the predictions, are the same for all horizons.
PROTOCOLS = {
    "paper": Protocol(),
    "paper-long": Protocol("paper-long", longest_past=_LONG),
    "causal": Protocol("causal", longest_past=_LONG, causal=True),
}
#: Their names.
ProtocolName = Literal["paper", "paper-long", "causal"]


#: Encoders by name, each made for a model and a protocol.
ENCODERS: dict[str, Callable[[Model, Protocol], Encoder]] = {
    "paper": lambda model, _: PaperEncoder(model.indexing),
    "actuation": lambda _, protocol: ActuationEncoder("causal" if protocol.causal else "smoothed"),
}


@dataclass(frozen=True, eq=False)
class EveryStart(Result):
    """Prediction errors at the horizon from every start, in overlapping windows.

    Attributes
    ----------
    errors : array, shape (3, W)
        Predicted minus measured x, y [m], γ [rad].
    start : array, shape (W,)
        Start time of each prediction [s].
    """

    JSON = "windows=start.size rmse:x_m,y_m,yaw_rad"

    errors: Float[np.ndarray, "3 W"]
    start: Float[np.ndarray, " W"]

    @property
    def rmse(self) -> Float[np.ndarray, " 3"]:
        """Root mean square of each channel."""
        return np.sqrt(np.mean(self.errors**2, axis=1))

    @cached_property
    def interval(self) -> Float[np.ndarray, "2 3"]:
        """95 % interval of `rmse` by block bootstrap; NaN if the recording is too short."""
        return rmse_interval(self.errors, self.start)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``interval_95`` of each channel, None below 12 s of flight; ``block_s``, the length of
        the bootstrap's blocks.
        """
        return super().to_json() | {
            "interval_95": known_intervals(self.interval),
            "block_s": BLOCK_S,
        }


def known_intervals(interval: Float[np.ndarray, "2 3"]) -> dict[str, list[float] | None]:
    """Return the ends of each channel's interval for JSON; None if unknown."""
    ends = [bounds.tolist() if np.isfinite(bounds).all() else None for bounds in interval.T]
    return dict(zip(CHANNELS, ends, strict=True))


@dataclass(frozen=True, eq=False)
class Evaluation(Result):
    """Prediction errors of one model on one trajectory.

    Attributes
    ----------
    model : str
        Name of the model.
    protocol : Protocol
        The protocol of the evaluation.
    encoder : str
        Encoder that gives the initial state of predictions.
    errors : array, shape (T, 3, W)
        Predicted minus measured x, y [m], γ [rad], for every step and window; NaN where a frame was
        lost, but never at the reported step.
    start : array, shape (W,)
        Start time of each prediction [s].
    sample_period : float
        Time of one step [s].
    left_out : int
        Number of windows lost to excluded spans.
    every_start : EveryStart
        The errors at the horizon, from overlapping windows.
    horizon_step : int
        Index of the step at which errors are reported, counted from 1.

    Examples
    --------
    >>> evaluation = airpuck.evaluate(model, trajectory)
    >>> isinstance(evaluation, airpuck.Evaluation)
    True
    >>> evaluation.errors.shape[:2]  # samples ahead; x, y, yaw
    (50, 3)
    """

    JSON = (
        "model protocol=protocol.name encoder horizon_step windows=start.size left_out "
        "rmse:x_m,y_m,yaw_rad median_abs:x_m,y_m,yaw_rad every_start"
    )

    model: str
    protocol: Protocol
    encoder: str
    errors: Float[np.ndarray, "T 3 W"]
    start: Float[np.ndarray, " W"]
    sample_period: float
    left_out: int
    every_start: EveryStart
    horizon_step: int

    def __repr__(self) -> str:
        x, y, yaw = self.rmse
        return (
            f"Evaluation({self.model}, {1e3 * x:.2f} mm, {1e3 * y:.2f} mm, {yaw:.4f} rad RMS after "
            f"{self.horizon_step * self.sample_period:.2f} s in {self.errors.shape[2]} windows)"
        )

    def _repr_html_(self) -> str:
        rows = zip(CHANNELS, self.rmse.tolist(), self.median_abs.tolist(), strict=True)
        return html_table(repr(self), ("", "RMS error", "median absolute error"), rows)

    @property
    def at_horizon(self) -> Float[np.ndarray, "3 W"]:
        """Errors of every window at the reported step."""
        return self.errors[self.horizon_step - 1]

    @cached_property
    def rmse_over_horizon(self) -> Float[np.ndarray, "T 3"]:
        """Root mean square over the windows, at every step."""
        known = ~np.isnan(self.errors)
        squares = np.sum(np.where(known, self.errors, 0.0) ** 2, axis=2)
        return np.sqrt(squares / np.maximum(known.sum(axis=2), 1))

    @property
    def rmse(self) -> Float[np.ndarray, " 3"]:
        """Root mean square at the reported step; a column of table:prediction_error."""
        return self.rmse_over_horizon[self.horizon_step - 1]

    @property
    def median_abs(self) -> Float[np.ndarray, " 3"]:
        """Median absolute error at the reported step."""
        return np.median(np.abs(self.at_horizon), axis=1)

    def healthy(self, faults: Sequence[Span]) -> EveryStart:
        """Return the errors from every start that touches no fault.

        Parameters
        ----------
        faults : sequence of Span
            Faults found by a model that is not under test.

        Returns
        -------
        EveryStart
            Errors of the other starts.
        """
        every, sound = self.every_start, np.full(len(self.every_start.start), True)
        first = every.start - max(self.protocol.encoder_time, self.protocol.longest_past or 0.0)
        last = every.start + self.horizon_step * self.sample_period
        for fault in faults:
            sound &= (last <= fault.start) | (first >= fault.stop + RECOVERY_S)
        return EveryStart(every.errors[:, sound], every.start[sound])

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``horizon_s``, when errors are reported, and ``rmse_over_horizon``, for each step.

        Returns
        -------
        dict
            ``model, protocol, encoder, horizon_s, horizon_step, windows, left_out, rmse,
            median_abs, every_start``, and per step ``rmse_over_horizon``.
        """
        over_horizon = [plain(by_channel(row)) for row in self.rmse_over_horizon]
        horizon = {"horizon_s": self.horizon_step * self.sample_period}
        return super().to_json() | horizon | {"rmse_over_horizon": over_horizon}


def evaluate(
    model: Model,
    trajectory: Trajectory,
    *,
    protocol: Protocol | ProtocolName = "paper",
    encoder: Encoder | str = "paper",
) -> Evaluation:
    """Measure how well a model predicts a trajectory.

    The trajectory is cut into windows that do not overlap. In each, the encoder uses the first E
    samples and the model predicts the next T. Errors at the horizon are also computed from every
    start, in overlapping windows, with intervals.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Data that the model was not learned from.
    protocol : Protocol or {"paper", "paper-long", "causal"}, default "paper"
        By default the paper's: E = 20 and T = 50 samples at 240 Hz, evaluated after 0.2 s. For a
        slow craft, the times of a named protocol become longer.
    encoder : Encoder or {"paper", "actuation"}, default "paper"
        Encoder for initial states. The paper's encoder has the indexing that the model was learned
        with.

    Returns
    -------
    Evaluation
        The errors.

    Raises
    ------
    InputError
        If the model is of another craft, the trajectory is shorter than one window, or the encoder
        looks further ahead than the protocol allows.

    Examples
    --------
    >>> evaluation = airpuck.evaluate(model, trajectory)
    >>> bool(evaluation.rmse[0] < 0.01)  # x after 0.2 s [m]
    True
    """
    [trajectory] = as_trajectories(trajectory)
    check_propellers(model.vehicle, trajectory)
    protocol, encoder = with_choices(model, trajectory, protocol, encoder)
    before, ahead = _samples(trajectory, protocol)
    windows, errors = _predicted(model, trajectory, protocol, encoder, before + ahead)
    judged, spacing = every_start(trajectory, protocol)
    everywhere, all_errors = _predicted(model, trajectory, judged, encoder, spacing)
    return Evaluation(
        model=model.name,
        protocol=protocol,
        encoder=encoder.name,
        errors=errors,
        start=windows.time[windows.present],
        sample_period=trajectory.sample_period,
        left_out=len(trajectory) // (before + ahead) - len(windows),
        every_start=EveryStart(all_errors[-1], everywhere.time[everywhere.present]),
        horizon_step=all_errors.shape[0],
    )


def with_choices(
    model: Model, trajectory: Trajectory, protocol: Protocol | str, encoder: Encoder | str
) -> tuple[Protocol, Encoder]:
    """Return protocol and encoder, which may be named; raise InputError if they do not fit."""
    if not isinstance(protocol, Protocol):
        protocol = chosen(protocol, PROTOCOLS, "protocol").suited(model, trajectory)
    if isinstance(encoder, str):
        encoder = chosen(encoder, ENCODERS, "encoder")(model, protocol)
    if protocol.causal and not encoder.causal:
        raise InputError(
            f"the encoder {encoder.name} looks ahead, which the protocol {protocol.name} forbids; "
            "choose the encoder actuation",
            field="encoder",
        )
    return protocol, encoder


def _samples(trajectory: Trajectory, protocol: Protocol) -> tuple[int, int]:
    """Return the number of samples in a window before and after its present."""
    return trajectory.steps(protocol.encoder_time, least=2), trajectory.steps(
        protocol.prediction_time
    )


def _predicted(
    model: Model, trajectory: Trajectory, protocol: Protocol, encoder: Encoder, stride: int
) -> tuple[Windows, Float[np.ndarray, "T 3 W"]]:
    """Predict from one start in every `stride` samples."""
    windows, past = judged_windows(model, trajectory, protocol, encoder, stride)
    return windows, prediction_errors(model.dynamics, windows, encoder, past)


def every_start(trajectory: Trajectory, protocol: Protocol) -> tuple[Protocol, int]:
    """Return a protocol whose predictions end at the horizon, and the samples between starts."""
    step = min(trajectory.steps(protocol.horizon), _samples(trajectory, protocol)[1])
    spacing = max(1, round(step / _STARTS_PER_HORIZON))
    return replace(protocol, prediction_time=step * trajectory.sample_period), spacing


def judged_windows(
    model: Model, trajectory: Trajectory, protocol: Protocol, encoder: Encoder, stride: int
) -> tuple[Windows, Int[np.ndarray, " W"]]:
    """Return the windows to predict, and the samples of each that the encoder may use."""
    before, ahead = _samples(trajectory, protocol)
    judged = min(trajectory.steps(protocol.horizon), ahead)
    windows = make_windows(trajectory, before, ahead, stride=stride, judged=judged)
    past = _past(trajectory, windows, protocol)
    if isinstance(encoder, StateEncoder):
        windows = hold_for(model, windows)
        past = windows.parts * (past - 1) + 1
    elif model.delay_learned:
        # Such an encoder compares its model with each pose, and finer steps would add no poses.
        windows = windows.delayed(model.transport_delay, model.vehicle.nominal.transport_delay_s)
    return windows, past


def _past(trajectory: Trajectory, windows: Windows, protocol: Protocol) -> Int[np.ndarray, " W"]:
    """Return the number of usable past samples of each window, within the protocol."""
    firsts = np.array([first for first, _ in trajectory.segments])
    present = windows.present
    begun = firsts[np.searchsorted(firsts, present, side="right") - 1]
    longest = trajectory.steps(protocol.longest_past or protocol.encoder_time, least=2)
    return np.minimum(present - begun + 1, longest)


def compare(
    models: Sequence[Model],
    trajectory: Trajectory,
    *,
    protocol: Protocol | ProtocolName = "paper",
    encoder: str = "paper",
) -> list[Evaluation]:
    """Evaluate several models on the same windows.

    Parameters
    ----------
    models : sequence of Model
        The models.
    trajectory : Trajectory
        Data that none of the models was learned from.
    protocol : Protocol or {"paper", "paper-long", "causal"}, default "paper"
        See `evaluate`.
    encoder : {"paper", "actuation"}, default "paper"
        See `evaluate`.

    Returns
    -------
    list of Evaluation
        One for each model, in their order.

    Examples
    --------
    >>> paper = [airpuck.read_model(name) for name in ("paper:M0", "paper:M3")]
    >>> [evaluation.model for evaluation in airpuck.compare(paper, trajectory)]
    ['M0', 'M3']
    """
    return [evaluate(model, trajectory, protocol=protocol, encoder=encoder) for model in models]


def hold_for(model: Model, windows: Windows) -> Windows:
    """Hold the commands of windows with a model's delay, in steps as short as a fit's."""
    if not model.delay_learned:
        return windows
    windows = windows.refined(max(map(integration_parts, windows.trajectories)))
    return windows.delayed(model.transport_delay, model.vehicle.nominal.transport_delay_s)


def batches(past: Int[np.ndarray, " W"]) -> Iterator[tuple[int, Int[np.ndarray, " B"]]]:
    """Divide windows into batches with equally long pasts; yield that length and the windows."""
    for length in np.unique(past).tolist():
        alike = np.flatnonzero(past == length)
        for first in range(0, len(alike), _BATCH):
            yield length, alike[first : first + _BATCH]


def prediction_errors(
    dynamics: Dynamics,
    windows: Windows,
    encoder: Encoder,
    past: Int[np.ndarray, " W"] | None = None,
) -> Float[np.ndarray, "T 3 W"]:
    """Predict every window and compare with the measurements.

    Parameters
    ----------
    dynamics : Dynamics
        Coefficients of the model.
    windows : Windows
        Windows to predict.
    encoder : Encoder
        Encoder that gives the initial state of predictions.
    past : array of int, shape (W,), optional
        Number of past samples that the encoder may use; by default the window's.

    Returns
    -------
    array, shape (T, 3, W)
        Predicted minus measured x, y [m], γ [rad], at the poses; NaN where frames were lost.
    """
    poses = slice(windows.parts - 1, None, windows.parts)
    errors = np.empty((windows.prediction_length // windows.parts, 3, len(windows)))
    if past is None:
        past = np.full(len(windows), windows.encoder_length)
    for length, part in batches(past):
        starts = windows.starts[part]
        state, now = encoder.begin(dynamics, windows.past(starts, length))
        commands, durations, measured = windows.future(starts)
        predicted = rollout(np, now, state, commands, durations)
        errors[:, :, part] = (predicted[:, :3] - measured[:, :3])[poses]
    if not windows.measured.all():
        step = np.arange(1, windows.prediction_length + 1)[poses]
        lost = ~windows.measured[windows.present + step[:, None]]
        errors[np.broadcast_to(lost[:, None], errors.shape)] = np.nan
    return errors
