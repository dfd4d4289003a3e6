"""Model selection: the ladder is tried on held-out blocks of the user's own recording.

The richest rung, which contains all others, prepares the data (faults, packets). Each rung is
fitted to all of the data. For each of K blocks of time, the fit then continues without the block,
from its optimum, and predicts the block from every start. No training data lie within a window's
length of the block. All folds share the preparation, by parameters that saw all data; the block
itself is predicted from the raw recording.

Rungs are compared in pairs on the same predictions, with intervals by blocks of time. The simplest
rung whose error is within one standard error of the smallest is chosen (Breiman, Friedman, Olshen
and Stone, "Classification and Regression Trees", 1984, section 3.4.3; here with the standard error
of the difference). Errors within half a percent count as equal: on the twin, drag that does not
exist lowers them by a tenth of a percent, since it damps the noise of initial states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory, as_trajectories
from airpuck.data.windows import Windows, make_windows
from airpuck.evaluation.evaluate import hold_for, prediction_errors
from airpuck.evaluation.statistical_tests import log_mean_square_errors, rmse_ratio
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.problem import Exclusion, Problem
from airpuck.identification.settings import Loss, Preparation
from airpuck.model.model_file import Model
from airpuck.model.rungs import Rung, named_rung
from airpuck.preprocessing.time_scale import showing_time

#: Rungs that are tried, the simplest first.
LADDER = ("M0", "M2", "M3", "M5", "M5+drag", "M5+drag+idle")
#: Minimum prediction horizon for the comparison, and time between starts [s].
_HORIZON, _SPACING = 0.2, 4 / 240
#: Logarithm of a negligible ratio of mean squares: half a percent of the root.
_NEGLIGIBLE = 0.01
#: Windows per second that a fold learns from: 2 % less information for half of the time.
_EVERY = 2
#: A fold starts at the optimum of all data: few, rough steps suffice.
_FOLD_FIT = LevenbergMarquardt(max_iterations=15, tolerance=1e-4)


@dataclass(frozen=True, eq=False)
class CandidateModel(Result):
    """A rung that was tried.

    Attributes
    ----------
    model : Model
        Fitted to all data, as prepared for the richest rung.
    errors : array, shape (4, W)
        Errors of W held-out predictions at the horizon: x, y [m], yaw [rad], and the root of the
        sum of their weighted squares, by which rungs are compared.
    change : array, shape (4,)
        Ratio of root mean squares to the next simpler rung's; NaN for the first.
    interval : array, shape (2, 4)
        95 % interval of `change`.
    excess : float
        Logarithm of the mean weighted square relative to the best rung's.
    standard_error : float
        Of `excess`.
    """

    JSON = (
        "model=name free rmse:x_m,y_m,yaw_rad excess excess_standard_error=standard_error "
        "within_one_standard_error=within"
    )

    model: Model
    errors: Float[np.ndarray, "4 W"]
    change: Float[np.ndarray, " 4"]
    interval: Float[np.ndarray, "2 4"]
    excess: float
    standard_error: float

    @property
    def name(self) -> str:
        """Name of the rung."""
        return self.model.name

    @property
    def free(self) -> int:
        """Number of free parameters."""
        return int(self.model.free.sum())

    @property
    def rmse(self) -> Float[np.ndarray, " 3"]:
        """Root mean squares of x, y [m] and yaw [rad]."""
        return np.sqrt(np.mean(self.errors[:3] ** 2, axis=1))

    @property
    def within(self) -> bool:
        """Whether it is within one standard error of the best, or as good."""
        return self.excess <= max(self.standard_error, _NEGLIGIBLE)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``change``, ``change_lower_95``, ``change_upper_95``: ratio of the errors ``x``,
        ``y``, ``yaw`` and ``weighted`` to the rung before, with its interval; None for the first
        rung.
        """
        changes = {"change": self.change}
        changes |= dict(zip(("change_lower_95", "change_upper_95"), self.interval, strict=True))
        first = bool(np.isnan(self.change).any())
        return super().to_json() | {k: None if first else _by_error(v) for k, v in changes.items()}


@dataclass(frozen=True, eq=False)
class Selection(Result):
    """The ladder, tried on held-out blocks of the data.

    Attributes
    ----------
    candidates : tuple of CandidateModel
        All rungs, the simplest first.
    fit : Fit
        Fit of the chosen rung to all data; its model file lists the other candidates.
    folds : int
        Number of blocks of time that were held out in turn.
    start : array, shape (W,)
        Start time of each held-out prediction [s].
    horizon : float
        Time from the start of a prediction to its error [s].

    Examples
    --------
    >>> long = airpuck.preprocess(airpuck.excite(model, 20.0, seed=1))
    >>> selection = airpuck.select_model(long, ladder=("M0", "M2"))
    >>> isinstance(selection, airpuck.Selection), [rung.name for rung in selection.candidates]
    (True, ['M0', 'M2'])
    """

    JSON = (
        "chosen=fit.model.name best=best.name folds horizon_s=horizon predictions=start.size "
        "rungs=candidates"
    )

    candidates: tuple[CandidateModel, ...]
    fit: Fit
    folds: int
    start: Float[np.ndarray, " W"]
    horizon: float

    @property
    def best(self) -> CandidateModel:
        """The rung with the smallest held-out error."""
        return min(self.candidates, key=lambda candidate: candidate.excess)


def _by_error(values: Float[np.ndarray, " 4"]) -> dict[str, float]:
    """Name ratios of the errors."""
    return dict(zip(("x", "y", "yaw", "weighted"), values.tolist(), strict=True))


def select_model(
    trajectories: Trajectory | Sequence[Trajectory],
    ladder: Sequence[str | Rung] = LADDER,
    *,
    vehicle: Vehicle | None = None,
    loss: Loss | None = None,
    preparation: Preparation | None = None,
    folds: int = 5,
    progress: Callable[[str], None] = lambda _: None,
) -> Selection:
    """Try the rungs of the ladder on held-out blocks of the data, and identify with the best.

    It chooses the simplest rung whose held-out error is within one standard error of the smallest.

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Data of one craft.
    ladder : sequence of str or Rung, optional
        Rungs to try, the simplest first.
    vehicle, loss, preparation
        See `airpuck.identify`.
    folds : int, default 5
        Number of blocks of time that are held out in turn.
    progress : callable, optional
        Called with a sentence on each completed step.

    Returns
    -------
    Selection
        Held-out errors of every rung, and the fit of the chosen one to all data.

    Raises
    ------
    InputError
        If the data do not fit the vehicle, or are too short for this number of blocks.

    Examples
    --------
    >>> selection = airpuck.select_model(trajectory)  # doctest: +SKIP
    >>> selection.best.name, selection.fit.model.name  # doctest: +SKIP
    >>> airpuck.select_model(trajectory.slice(0.0, 0.1))
    Traceback (most recent call last):
        ...
    airpuck.boundary.errors.InputError: ...
    """
    loss, preparation = loss or Loss(), preparation or Preparation()
    if loss.whole:
        raise InputError("needs windows shorter than the recording", field="whole")
    trajectories = as_trajectories(trajectories)
    rungs = [named_rung(rung) if isinstance(rung, str) else rung for rung in ladder]
    settings: Any = {"vehicle": vehicle, "loss": loss}
    richest = identify(trajectories, rungs[-1], preparation=preparation, **settings)
    suited = loss.suited(trajectories, richest.model.vehicle)
    if loss.encoder_time is None:
        suited = suited.remembering(float(np.max(richest.model.dynamics.lag)))
    settings["loss"] = loss = suited
    healthy = richest.exclusion.trajectories if richest.exclusion else tuple(trajectories)
    settings["preparation"] = replace(preparation, faults="keep")
    held_out = _HeldOut.of(healthy, loss, richest.model.vehicle, folds)
    models, errors = [], []
    for rung in rungs:
        model, objective = _learned(Problem.of(healthy, rung, **settings), richest.objective)
        models.append(model)
        errors.append(held_out.errors_of(model, objective, loss))
        progress(f"{rung.name}: predicted {folds} held-out blocks of time")
    candidates = _compared(models, errors, held_out)
    chosen = [candidate.within for candidate in candidates].index(True)
    fit = richest
    if chosen != len(rungs) - 1:
        fit = identify(healthy, rungs[chosen], **settings)
    fit = _recorded(fit, richest.exclusion, candidates)
    horizon = held_out.windows.prediction_length * healthy[0].sample_period
    return Selection(candidates, fit, folds, held_out.start, horizon)


def _learned(problem: Problem, prepared: PredictionLoss | None) -> tuple[Model, PredictionLoss]:
    """Fit a rung to data as prepared for another."""
    assert prepared is not None
    loss = problem.loss_on(prepared.windows.trajectories)
    loss = replace(loss, multiplicity=prepared.multiplicity)
    outcome = LevenbergMarquardt().minimize(loss, problem.start, problem.free)
    return problem.model(outcome.parameters), loss


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """Predictions from every start of the data, in blocks of time that are held out in turn."""

    #: Predictions that lie within one block.
    windows: Windows
    #: Block of each prediction.
    block: Int[np.ndarray, " W"]
    #: First sample of each block, and the end of the last.
    edges: Int[np.ndarray, " E"]

    @classmethod
    def of(
        cls, trajectories: Sequence[Trajectory], loss: Loss, vehicle: Vehicle, folds: int
    ) -> _HeldOut:
        """Cut the data into blocks of equally many predictions."""
        before, ahead, _ = loss.samples(trajectories)
        steps = trajectories[0].steps
        # A slow craft is predicted for longer, to see the models' differences.
        horizon = max(_HORIZON, showing_time(trajectories, vehicle))
        ahead = min(steps(horizon), ahead or 1)
        windows = make_windows(trajectories, before, ahead, steps(_SPACING), judged=ahead)
        cuts = np.arange(1, folds) * len(windows) // folds
        edges = np.concatenate([[0], windows.starts[cuts], [len(windows.time)]])
        block = np.searchsorted(edges, windows.starts, side="right") - 1
        inside = windows.starts + _length(windows) <= edges[block + 1]
        if len(set(block[inside].tolist())) < folds:
            raise InputError(
                f"is too short to hold out {folds} blocks of time; name a model instead",
                file=trajectories[0].source,
            )
        return cls(replace(windows, starts=windows.starts[inside]), block[inside], edges)

    @property
    def start(self) -> Float[np.ndarray, " W"]:
        """Start time of each prediction [s]."""
        return self.windows.time[self.windows.present]

    def errors_of(
        self, model: Model, objective: PredictionLoss, loss: Loss
    ) -> Float[np.ndarray, "4 W"]:
        """Learn without each block, and predict it; see `CandidateModel.errors`."""
        errors = np.empty((4, len(self.windows)))
        for number in range(len(self.edges) - 1):
            members = self.block == number
            learned = self._without(model, objective, number)
            windows = hold_for(learned, replace(self.windows, starts=self.windows.starts[members]))
            errors[:3, members] = prediction_errors(learned.dynamics, windows, loss.encoder)[-1]
        weighted = np.array(loss.weights)[:, None] * errors[:3]
        errors[3] = np.sqrt(np.sum(weighted**2, axis=0))
        return errors

    def _without(self, model: Model, loss: PredictionLoss, number: int) -> Model:
        """Continue a fit without a block and everything within a window's length of it."""
        first, gap = loss.windows.starts, _length(loss.windows)
        apart = first + 2 * gap <= self.edges[number]
        apart |= first >= self.edges[number + 1] + gap
        apart &= np.arange(len(first)) % _EVERY == 0
        counted = apart if loss.multiplicity is None else apart * loss.multiplicity
        kept = replace(loss, multiplicity=counted.astype(float), clusters=None)
        outcome = _FOLD_FIT.minimize(kept, model.parameters, model.free)
        return replace(model, parameters=outcome.parameters)


def _length(windows: Windows) -> int:
    """Return the samples of a window."""
    return windows.encoder_length + windows.prediction_length


def _compared(
    models: Sequence[Model], errors: Sequence[Float[np.ndarray, "4 W"]], held_out: _HeldOut
) -> tuple[CandidateModel, ...]:
    """Compare every rung with the next simpler one and with the best."""
    start = held_out.start
    squares = np.array([of_rung[3] ** 2 for of_rung in errors])
    logs = np.log(squares.mean(axis=1))
    best = int(np.argmin(logs))
    covariance, degrees = log_mean_square_errors(squares, start)
    if not degrees:
        raise InputError(
            f"has too few predictions to compare models by ({len(start)}); name a model instead",
            file=held_out.windows.trajectories[0].source,
        )
    own = np.diag(covariance)
    variance = own + own[best] - 2 * covariance[best]
    found = []
    for k, model in enumerate(models):
        change, interval = np.full(4, np.nan), np.full((2, 4), np.nan)
        if k:
            change, interval, _ = rmse_ratio(errors[k - 1], errors[k], start)
        spread = float(np.sqrt(max(variance[k], 0.0)))
        excess = float(logs[k] - logs[best])
        found.append(CandidateModel(model, errors[k], change, interval, excess, spread))
    return tuple(found)


def _recorded(fit: Fit, exclusion: Exclusion | None, candidates: Sequence[CandidateModel]) -> Fit:
    """Record in a fit the candidates it was chosen from, and what was excluded for it."""
    record = {
        "rule": "simplest within one standard error, or half a percent, of the best",
        "ladder": [candidate.name for candidate in candidates],
        "excess": [candidate.excess for candidate in candidates],
        "excess_standard_errors": [candidate.standard_error for candidate in candidates],
    }
    conditions = {**fit.model.fit, "selection": record}
    if exclusion is not None:
        conditions["left_out"] = exclusion.to_json()
    model = replace(fit.model, fit=conditions)
    return replace(fit, model=model, exclusion=exclusion)
