"""`identify`: from trajectories to a model, step by step (fig:learning_architecture)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import UNKNOWN, PacketDelays
from airpuck.identification.cameras import cameras_of
from airpuck.identification.fit_result import Fit, fit_warnings
from airpuck.identification.method import (
    MOST_LAG,
    LevenbergMarquardt,
    Method,
    Optimum,
    information_of_weights,
    minimize_on,
    reweighted,
)
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.problem import Exclusion, Problem, exclude_faults
from airpuck.identification.retiming import (
    delay_jitter,
    error_growth,
    prepared_gradients,
    retime_packets,
    score_derivatives,
    smoothed_along,
    variance_of_mean,
)
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.uncertainty import (
    Identifiability,
    grown,
    identifiability_of,
    information_growth,
    sandwich,
    shared_at_borders,
    varying,
    widened,
    with_held,
    with_lag_squared,
    without_meaningless,
)
from airpuck.model.model_file import Model
from airpuck.model.parameters import LAG, Parameters, change_degree, fix_gauge
from airpuck.model.rungs import Rung
from airpuck.model.uncertainty import Uncertainty
from airpuck.preprocessing.delay import visible_delay
from airpuck.preprocessing.derivative import is_slow

#: Initial damping of a fit with new terms, of which full steps would go too far.
_CAREFUL = 0.1
#: Step of a difference quotient by a wheel's lag, in its standard errors.
_LAG_STEP = 0.1


def identify(
    trajectories: Trajectory | Sequence[Trajectory], model: str | Rung = "M3", **given: Any
) -> Fit:
    """Fit one model by minimising its error (eq. combined_loss); `given`: fields of `Problem`."""
    return judge(solved(trajectories, model, **given))


def solved(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung,
    *,
    after: Solution | None = None,
    **given: Any,
) -> Solution:
    """Find the optimum of a model, without the uncertainty of its parameters.

    A model with more terms than another starts from the other's solution: with its parameters, the
    faults it found and the arrival times of its packets. A fit that begins with the faulty windows
    can end far from the optimum.
    """
    problem = Problem.of(trajectories, model, **given)
    try:
        solution = after.enriched(problem) if after else Solution(problem, problem.trajectories)
        solution = minimize(retime(leave_out_faults(solution)))
        if (given.get("loss") or Loss()).encoder_time is None:
            solution = remember(solution)
        return solution
    except InputError as error:
        if (early := _early_poses(problem)) is not None:
            raise early from error
        raise


def _early_poses(problem: Problem) -> InputError | None:
    """Return an error about the clocks, for motion that precedes the commands causing it."""
    dynamics = problem.start.dynamics(np, problem.vehicle)
    for trajectory in problem.trajectories:
        delay = visible_delay(trajectory, dynamics)
        # The delay is found in whole samples, and may be off by one.
        if delay is not None and delay < -1.5 * trajectory.sample_period:
            return InputError(
                f"the motion begins {-1e3 * delay:.0f} ms before the commands that cause it: the "
                "poses are stamped early. Synchronise the clocks of cameras and controller, or add "
                "that time to the stamps of the poses",
                file=trajectory.source,
            )
    return None


def identifiability(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung = "M3",
    *,
    vehicle: Vehicle | None = None,
    initial: Parameters | None = None,
    loss: Loss | None = None,
    preparation: Preparation | None = None,
) -> Identifiability:
    """Return what the data can determine, from the information at the start of a fit.

    Parameters
    ----------
    trajectories, model, vehicle, initial, loss, preparation
        As for `identify`.

    Returns
    -------
    Identifiability
        The result in numbers and words.

    Raises
    ------
    InputError
        If the data do not fit the vehicle or are too short, or the model does not exist.

    Examples
    --------
    >>> found = airpuck.identifiability(trajectory, "M0")
    >>> found.rank == found.free
    True
    """
    problem = Problem.of(
        trajectories, model, vehicle=vehicle, initial=initial, loss=loss, preparation=preparation
    )
    hessian = problem.loss_on(problem.trajectories).quadratic(problem.start).hessian
    return identifiability_of(hessian, problem.start, problem.free, problem.vehicle.propeller_names)


@dataclass(frozen=True, eq=False)
class Solution:
    """State of a fit: the data in their current preparation, and the latest outcome."""

    problem: Problem
    #: Trajectories as preprocessed, without the excluded spans.
    trajectories: tuple[Trajectory, ...]
    #: The excluded spans; None if faults were not searched for.
    exclusion: Exclusion | None = None
    #: The trajectories with retimed packets; None if packets keep their times.
    retimed: tuple[Trajectory, ...] | None = None
    #: Arrival times of packets in each trajectory.
    packets: tuple[PacketDelays, ...] = ()
    #: Loss and result of the last fit; None before the first.
    fitted: tuple[PredictionLoss, Optimum] | None = None
    #: When the fit began [s].
    began: float = field(default_factory=time.perf_counter)

    @property
    def result(self) -> tuple[PredictionLoss, Optimum, Model]:
        """Loss, result and model of the last fit."""
        assert self.fitted is not None
        loss, outcome = self.fitted
        return loss, outcome, self.problem.model(outcome.parameters)

    @property
    def loss(self) -> PredictionLoss:
        """The loss on all windows of the data in their current preparation."""
        return self.problem.loss_on(self.retimed or self.trajectories)

    def fit(self, method: Method, loss: PredictionLoss) -> Solution:
        """Minimise a loss; Levenberg-Marquardt starts at the last fit's optimum."""
        start, free, progress = self.problem.start, self.problem.free, self.problem.progress
        if self.fitted is None or not isinstance(method, LevenbergMarquardt):
            outcome = method.minimize(loss, start, free, progress)
        else:
            outcome = minimize_on(method, loss, self.fitted[1], free, progress)
        return replace(self, fitted=(loss, outcome))

    def enriched(self, problem: Problem) -> Solution:
        """Fit a model with more terms to a part of the windows, starting at the optimum."""
        start, (_, outcome, _) = problem.start, self.result
        known = {q.name: getattr(outcome.parameters, q.name) for q in outcome.parameters.quantities}
        known["thrust"] = change_degree(known["thrust"], np.shape(start.thrust)[1])
        # One step changes the lag by at most this factor, and must be able to reach the nominal.
        least = start.motor_time_constant / MOST_LAG
        known["motor_time_constant"] = max(known["motor_time_constant"], least)
        problem = replace(problem, loss=self.problem.loss, initial=replace(start, **known))
        begun = replace(self, problem=problem, fitted=None)
        begun = begun.fit(LevenbergMarquardt(damping=_CAREFUL), begun.loss.thinned)
        return replace(begun, retimed=None)

    def prefit(self) -> Solution:
        """Fit to a part of the windows, enough to prepare the data with."""
        method = self.problem.method
        if not isinstance(method, LevenbergMarquardt):
            method = LevenbergMarquardt()
        return self.fit(method, self.loss.thinned)


def leave_out_faults(solution: Solution) -> Solution:
    """Find faults with a first fit, and exclude the windows that they touch."""
    if solution.problem.preparation.faults == "keep" or solution.problem.loss.whole:
        return solution
    if solution.fitted is None:
        solution = solution.prefit()
    loss, _, model = solution.result
    length = loss.windows.encoder_length + loss.windows.prediction_length
    _, _, stride = solution.problem.loss.samples(solution.trajectories)
    exclusion = exclude_faults(solution.problem.trajectories, model, length, stride)
    return replace(solution, exclusion=exclusion, trajectories=exclusion.trajectories)


def retime(solution: Solution) -> Solution:
    """Move packets to the arrival times under a first fit's model, then under a second fit's.

    Long smoothing spreads every switch of an actuator, which looks like a lag. So the poses of a
    slow craft are smoothed along the nominal model before the first fit.
    """
    problem = solution.problem
    if problem.retimings and any(map(is_slow, solution.trajectories)):
        nominal = problem.model(problem.start)
        along = tuple(smoothed_along(one, nominal) for one in solution.trajectories)
        solution = replace(solution, retimed=along)
    for _ in range(problem.retimings):
        # A search for faults that found none was a fit to the same windows, unless it began with
        # the arrival times of a fit without some terms.
        known = solution.packets or solution.retimed
        if known or solution.exclusion is None or solution.exclusion.share:
            solution = solution.prefit()
        solution = hold_lag(solution)
        _, _, model = solution.result
        retimed, packets = retime_packets(solution.trajectories, model)
        solution = replace(solution, retimed=retimed, packets=packets)
    return solution


def hold_lag(solution: Solution) -> Solution:
    """Fit again with the vehicle file's lag if a fit knows the lag less accurately than the file.

    Poses can barely tell a lag that is a few milliseconds longer from a longer delay, so an error
    of the lag would become the opposite error of the delay.
    """
    problem, (_, outcome, model) = solution.problem, solution.result
    error, lag = problem.vehicle.actuators.lag_error, problem.start.mask(LAG)
    if error is None or not problem.free[lag].any():
        return solution
    loss, packets = solution.loss, solution.packets or (UNKNOWN,) * len(solution.trajectories)
    on_all = replace(solution, fitted=(loss, outcome), packets=packets)
    known = _uncertainty(on_all, loss.quadratic(outcome.parameters), model)
    if float(known.standard_errors[lag][0]) < error:
        return solution
    return replace(solution, problem=replace(problem, lag_held=True), fitted=None).prefit()


def minimize(solution: Solution) -> Solution:
    """Fit to all windows of the prepared data; a robust fit repeats this with weights."""
    problem = solution.problem
    solution = solution.fit(problem.method, solution.loss)
    if not problem.loss.robust:
        return solution
    loss, outcome, _ = solution.result
    fitted = reweighted(problem.method, loss, outcome, problem.free, problem.progress)
    return replace(solution, fitted=fitted)


def remember(solution: Solution) -> Solution:
    """Fit again with a longer encoder if the motors are slower than it assumed.

    Otherwise its guess of their initial speeds would bias lag and thrust: with 60 ms instead of the
    vehicle file's 30, by 6 and 2 %.
    """
    problem, (_, _, model) = solution.problem, solution.result
    longer = problem.loss.remembering(float(np.max(model.dynamics.lag)))
    if longer is problem.loss:
        return solution
    return remember(minimize(retime(replace(solution, problem=replace(problem, loss=longer)))))


def judge(solution: Solution) -> Fit:
    """Estimate the parameters' uncertainty, and summarise the fit."""
    problem = solution.problem
    loss, outcome, model = solution.result
    # If Π is learned, Newton's law fixes its scale.
    parameters = fix_gauge(outcome.parameters, problem.vehicle, problem.free)
    quadratic = outcome.quadratic
    if quadratic is None or parameters is not outcome.parameters:
        quadratic = loss.quadratic(parameters)
    model = replace(
        model,
        parameters=parameters,
        indexing=problem.loss.encoder.indexing,
        fit=_conditions(solution),
        data=_hashes(problem.trajectories),
        # Only the last two parts of the path: a model file must not reveal its author's home
        # folder.
        source=", ".join("/".join(Path(t.source).parts[-2:]) for t in problem.trajectories),
        delay_jitter=delay_jitter(solution.packets),
    )
    model = replace(model, cameras=cameras_of(model, solution.trajectories))
    known = without_meaningless(_uncertainty(solution, quadratic, model), parameters)
    model = replace(model, uncertainty=known)
    return Fit(
        model=model,
        loss=outcome.loss,
        history=outcome.history,
        converged=outcome.converged,
        message=outcome.message,
        windows=len(loss.windows),
        wall_s=time.perf_counter() - solution.began,
        warnings=fit_warnings(model, solution.trajectories, outcome, solution.exclusion),
        identifiability=identifiability_of(
            quadratic.hessian, parameters, problem.free, problem.vehicle.propeller_names
        ),
        exclusion=solution.exclusion,
        packet_delays=solution.packets,
        objective=loss,
    )


def _uncertainty(solution: Solution, quadratic: Quadratic, model: Model) -> Uncertainty:
    """Estimate the covariance of the parameters at the optimum."""
    loss, _, _ = solution.result
    parameters, packets = model.parameters, solution.packets
    space = varying(quadratic.hessian, parameters, model.free)
    known = sandwich(quadratic, parameters, space, shared_at_borders(loss))
    if solution.problem.loss.robust:
        added = information_of_weights(*loss.window_gradients(parameters))
        known = grown(known, information_growth(quadratic.hessian, added, space.basis))
    rounds = solution.problem.retimings
    along = rounds > 0 and any(map(is_slow, solution.trajectories))
    prepared = any(map(len, packets)) or along
    known = _with_held_lags(solution, known, quadratic, space.basis, model if prepared else None)
    if prepared and np.isfinite(known.standard_errors).any():
        mixed, hessian = score_derivatives(
            loss, solution.trajectories, model, packets, known.standard_errors
        )
        # Preparation with the nominal model leaves its values where poses determine nothing.
        rounds = None if along else rounds
        known = grown(known, error_growth(mixed, hessian, space.basis, rounds))
    if model.delay_jitter is not None:
        delay = parameters.mask(frozenset({"transport_delay"}))
        spread = model.delay_jitter.standard_deviation_s
        known = widened(known, delay, variance_of_mean(packets, spread))
    return known if solution.problem.lag_held else with_lag_squared(known, parameters)


def _with_held_lags(
    solution: Solution,
    known: Uncertainty,
    quadratic: Quadratic,
    basis: Float[np.ndarray, "P R"],
    along: Model | None,
) -> Uncertainty:
    """Add the errors of the vehicle file's lags: of the motors if held, and of wheels.

    `along` is the model that the data were prepared with; None: with none. The effect of a wheel's
    lag on the preparation is added here, since this lag is not a parameter.
    """
    problem, (loss, _, model) = solution.problem, solution.result
    vehicle, held = problem.vehicle, np.zeros(len(basis), dtype=bool)
    changes, slopes = [], []
    if problem.lag_held:
        held = model.parameters.mask(LAG)
        error = vehicle.actuators.lag_error or 0.0
        changes.append(error * held)
        slopes.append(error * quadratic.hessian @ held)
        note = f"the lag, {1e3 * float(model.parameters.motor_time_constant):.3g} ± "
        note += f"{1e3 * error:.3g} ms, comes from the vehicle file: poses determine it less well"
        known = replace(known, notes=(*known.notes, note))
    for k, wheel in enumerate(vehicle.wheels):
        error = wheel.lag_error
        if not error > 0:
            continue
        slower = wheel.slower(_LAG_STEP * error)
        wheels = (*vehicle.wheels[:k], slower, *vehicle.wheels[k + 1 :])
        other = vehicle.model_copy(update={"wheels": wheels})
        gradient = replace(loss, vehicle=other).quadratic(model.parameters).gradient
        rise = gradient - quadratic.gradient
        if along is not None:
            both = [along, replace(along, vehicle=other)]
            found, _ = prepared_gradients(loss, solution.trajectories, both, solution.packets)
            rise = rise + found[1] - found[0]
        changes.append(np.zeros(len(basis)))
        slopes.append(rise / _LAG_STEP)
    if not changes:
        return known
    adapted = np.array(changes) - np.array(slopes) @ basis @ basis.T
    return with_held(known, adapted, held)


def _conditions(solution: Solution) -> dict[str, Any]:
    """Return the table ``[fit]`` of the model file."""
    problem = solution.problem
    loss, outcome, _ = solution.result
    return {
        "loss": outcome.loss,
        "iterations": outcome.history[-1].number,
        "converged": outcome.converged,
        "method": type(problem.method).__name__,
        "windows": len(loss.windows),
        "encoder_length": loss.windows.encoder_length,
        "prediction_length": loss.windows.prediction_length,
        "stride": solution.trajectories[0].steps(problem.loss.spacing),
        "sample_period_s": solution.trajectories[0].sample_period,
        "weights": list(problem.loss.weights),
        "robust": problem.loss.robust,
        **({"left_out": solution.exclusion.to_json()} if solution.exclusion else {}),
        "airpuck": __version__,
    }


def _hashes(trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """Return the hashes of all files; if recordings share a name, the key includes the folder."""
    names = [name for trajectory in trajectories for name in trajectory.hashes]
    found: dict[str, str] = {}
    for number, trajectory in enumerate(trajectories, start=1):
        folder = Path(trajectory.source).name
        for name, digest in trajectory.hashes.items():
            key = f"{folder}/{name}" if names.count(name) > 1 else name
            found[f"{number}/{key}" if key in found else key] = digest
    return found
