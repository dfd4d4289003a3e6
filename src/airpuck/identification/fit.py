"""`identify`: from trajectories to a model, step by step (fig:learning_architecture)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from airpuck import __version__
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.identification.fault_exclusion import Exclusion, exclude_faults
from airpuck.identification.fit_result import Fit, fit_warnings
from airpuck.identification.identifiability import Identifiability, identifiability_of
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Iteration, Method, Outcome, minimize_on, reweighted
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.preparation_error import error_growth, score_derivatives
from airpuck.identification.problem import Loss, Preparation, Problem
from airpuck.identification.retiming import delay_jitter, retime_packets, variance_of_mean
from airpuck.identification.uncertainty import grown, sandwich, shared_at_borders, varying, widened
from airpuck.model.gauge import fix_gauge
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import Rung
from airpuck.model.uncertainty import Uncertainty


def identify(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung = "M3",
    *,
    vehicle: Vehicle | None = None,
    initial: Parameters | None = None,
    loss: Loss | None = None,
    method: Method | None = None,
    preparation: Preparation | None = None,
    progress: Callable[[Iteration], None] = lambda _: None,
) -> Fit:
    """Identify a model by minimising its multi-step prediction error (eq. combined_loss).

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Data of one craft.
    model : str or Rung, default "M3"
        The rung of the model ladder; see `airpuck.named_rung` for degrees and frames.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    initial : Parameters, optional
        Where to start; by default the vehicle's nominal values.
    loss : Loss, optional
        Which prediction errors count, and how much.
    method : Method, optional
        `LevenbergMarquardt()` by default, or `Adam()`.
    preparation : Preparation, optional
        Whether faults are left out, the delay is learned and packets are retimed.
    progress : callable, optional
        Called after every iteration of the optimiser.

    Returns
    -------
    Fit
        The model, and how it was found.

    Raises
    ------
    InputError
        If the data do not fit the vehicle, are too short, or the model does not exist.
    """
    began = time.perf_counter()
    problem = Problem.of(
        trajectories,
        model,
        vehicle=vehicle,
        initial=initial,
        loss=loss,
        method=method,
        preparation=preparation,
        progress=progress,
    )
    solution = Solution(problem, problem.trajectories)
    solution = leave_out_faults(solution)
    solution = retime(solution)
    solution = minimize(solution)
    return judge(solution, began)


def identifiability(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung = "M3",
    *,
    vehicle: Vehicle | None = None,
    initial: Parameters | None = None,
    loss: Loss | None = None,
    preparation: Preparation | None = None,
) -> Identifiability:
    """Tell before a fit what data can determine, by the information at its start.

    Parameters
    ----------
    trajectories, model, vehicle, initial, loss, preparation
        As for `identify`.

    Returns
    -------
    Identifiability
        In numbers and words.

    Raises
    ------
    InputError
        If the data do not fit the vehicle, are too short, or the model does not exist.
    """
    problem = Problem.of(
        trajectories, model, vehicle=vehicle, initial=initial, loss=loss, preparation=preparation
    )
    hessian = problem.loss_on(problem.trajectories).quadratic(problem.start).hessian
    names = problem.vehicle.propeller_names
    return identifiability_of(hessian, problem.start, problem.free, names)


@dataclass(frozen=True, eq=False)
class Solution:
    """How far a fit has come: the data as they are prepared by now, and what was learned."""

    problem: Problem
    #: As preprocessed, without the spans that are left out.
    trajectories: tuple[Trajectory, ...]
    #: What was left out; None where faults were not searched for.
    exclusion: Exclusion | None = None
    #: The trajectories with retimed packets; None where there are none.
    retimed: tuple[Trajectory, ...] | None = None
    #: When packets arrived, in each trajectory.
    packets: tuple[PacketDelays, ...] = ()
    #: The last fit; None before the first.
    outcome: Outcome | None = None
    #: What the last fit minimised.
    loss: PredictionLoss | None = None

    def fitted(self, method: Method, *, thinned: bool = False) -> Solution:
        """Fit to the data as they are prepared by now; Levenberg-Marquardt goes on where it was."""
        problem = self.problem
        loss = problem.loss_on(self.retimed or self.trajectories)
        loss = loss.thinned if thinned else loss
        if self.outcome is None or not isinstance(method, LevenbergMarquardt):
            outcome = method.minimize(loss, problem.start, problem.free, problem.progress)
        else:
            outcome = minimize_on(method, loss, self.outcome, problem.free, problem.progress)
        return replace(self, outcome=outcome, loss=loss)

    @property
    def result(self) -> tuple[PredictionLoss, Outcome, Model]:
        """What the last fit minimised, how it ended, and its model."""
        assert self.loss is not None and self.outcome is not None
        return self.loss, self.outcome, self.problem.model(self.outcome.parameters)


def leave_out_faults(solution: Solution) -> Solution:
    """Find faults with a first fit, and leave out the windows that they touch."""
    problem, loss = solution.problem, solution.problem.loss
    if not problem.excludes_faults or loss.prediction_length is None:
        return solution
    # A part of the windows is enough to prepare the data.
    solution = solution.fitted(problem.preparing_method, thinned=True)
    _, _, model = solution.result
    length = loss.encoder.length + loss.prediction_length
    exclusion = exclude_faults(solution.trajectories, model, length, loss.stride)
    return replace(solution, exclusion=exclusion, trajectories=exclusion.trajectories)


def retime(solution: Solution) -> Solution:
    """Move packets to when they arrived by the model of a first fit; then by that of a second."""
    for _ in range(solution.problem.retimings):
        solution = solution.fitted(solution.problem.preparing_method, thinned=True)
        _, _, model = solution.result
        retimed, packets = retime_packets(solution.trajectories, model)
        solution = replace(solution, retimed=retimed, packets=packets)
    return solution


def minimize(solution: Solution) -> Solution:
    """Fit to all windows of the prepared data; again with weights, where the loss is robust."""
    problem = solution.problem
    solution = solution.fitted(problem.method)
    if not problem.loss.robust:
        return solution
    loss, outcome, _ = solution.result
    loss, outcome = reweighted(problem.method, loss, outcome, problem.free, problem.progress)
    return replace(solution, loss=loss, outcome=outcome)


def judge(solution: Solution, began: float) -> Fit:
    """Find out how well the parameters are known, and sum up the fit."""
    problem = solution.problem
    loss, outcome, model = solution.result
    # Where Π is learned, Newton's law fixes its scale.
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
        # The last two names of the path: a model file must not tell where its author's home is.
        source=", ".join("/".join(Path(t.source).parts[-2:]) for t in problem.trajectories),
        delay_jitter=delay_jitter(solution.packets),
    )
    model = replace(model, uncertainty=_uncertainty(solution, quadratic, model))
    return Fit(
        model=model,
        loss=outcome.loss,
        history=outcome.history,
        converged=outcome.converged,
        message=outcome.message,
        windows=len(loss.windows),
        wall_s=time.perf_counter() - began,
        warnings=fit_warnings(model, solution.trajectories, outcome, solution.exclusion),
        identifiability=identifiability_of(
            quadratic.hessian, parameters, problem.free, problem.vehicle.propeller_names
        ),
        exclusion=solution.exclusion,
        packet_delays=solution.packets,
        objective=loss,
    )


def _uncertainty(solution: Solution, quadratic: Quadratic, model: Model) -> Uncertainty:
    """Estimate the covariance of the parameters at the optimum of a loss."""
    loss, _, _ = solution.result
    parameters, free, packets = model.parameters, model.free, solution.packets
    known = sandwich(quadratic, parameters, free, shared=shared_at_borders(loss))
    if any(map(len, packets)) and np.isfinite(known.standard_errors).any():
        mixed, hessian = score_derivatives(
            loss, solution.trajectories, model, packets, known.standard_errors
        )
        basis = varying(quadratic.hessian, parameters, free).basis
        known = grown(known, error_growth(mixed, hessian, basis, solution.problem.retimings))
    if model.delay_jitter is None:
        return known
    delay = parameters.mask(frozenset({"transport_delay"}))
    return widened(known, delay, variance_of_mean(packets, model.delay_jitter.standard_deviation_s))


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
        "stride": problem.loss.stride,
        "weights": list(problem.loss.weights),
        "robust": problem.loss.robust,
        **({"left_out": solution.exclusion.to_json()} if solution.exclusion else {}),
        "airpuck": __version__,
    }


def _hashes(trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """Return the hashes of all files; names that several recordings share get their folder's."""
    names = [name for trajectory in trajectories for name in trajectory.hashes]
    found: dict[str, str] = {}
    for number, trajectory in enumerate(trajectories, start=1):
        for name, digest in trajectory.hashes.items():
            key = name
            if names.count(name) > 1:
                key = f"{Path(trajectory.source).name}/{name}"
            if key in found:
                key = f"{number}/{key}"
            found[key] = digest
    return found
