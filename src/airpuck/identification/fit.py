"""`identify`: from trajectories to a model, step by step (fig:learning_architecture)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from airpuck import __version__
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.identification.fault_exclusion import Exclusion, exclude_faults
from airpuck.identification.fit_result import Fit, fit_warnings
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Iteration, Method, Outcome, minimize_on, reweighted
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.problem import Loss, Preparation, Problem
from airpuck.identification.retiming import (
    delay_jitter,
    error_growth,
    retime_packets,
    score_derivatives,
    spread_of,
    variance_of_mean,
)
from airpuck.identification.uncertainty import (
    Identifiability,
    grown,
    identifiability_of,
    sandwich,
    shared_at_borders,
    varying,
    widened,
)
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
    fitting = _Fitting(problem)
    fitting.leave_out_faults()
    fitting.retime()
    return fitting.judged(fitting.fit(last=True), began)


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


class _Fitting:
    """A fit on its way: the data as they are prepared by now, and what was learned."""

    #: What the last fit minimised.
    loss: PredictionLoss
    #: How the last fit ended; None before the first.
    outcome: Outcome | None = None

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        #: As preprocessed, without the spans that are left out.
        self.trajectories = problem.trajectories
        #: The trajectories with retimed packets, where they were.
        self.prepared = problem.trajectories
        #: When packets arrived, in each trajectory.
        self.packets: tuple[PacketDelays, ...] = ()
        #: What was left out; None where faults were not searched for.
        self.exclusion: Exclusion | None = None

    def fit(self, *, last: bool = False) -> Outcome:
        """Fit to the data as they are prepared by now; Levenberg-Marquardt goes on where it was."""
        problem, method = self.problem, self.problem.method
        self.loss = problem.loss_on(self.prepared)
        if not last:
            # A part of the windows is enough to prepare the data.
            self.loss = self.loss.thinned
            method = method if isinstance(method, LevenbergMarquardt) else LevenbergMarquardt()
        free, progress = problem.free, problem.progress
        if self.outcome is not None and isinstance(method, LevenbergMarquardt):
            outcome = minimize_on(method, self.loss, self.outcome, free, progress)
        else:
            outcome = method.minimize(self.loss, problem.start, free, progress)
        if last and problem.loss.robust:
            self.loss, outcome = reweighted(method, self.loss, outcome, free, progress)
        self.outcome = outcome
        return outcome

    def first_model(self) -> Model:
        """Return a model to prepare the data with."""
        return self.problem.model(self.fit().parameters)

    def leave_out_faults(self) -> None:
        """Find faults with a first fit, and leave out the windows that they touch."""
        before, ahead, stride = self.problem.loss.samples(self.trajectories)
        if self.problem.excludes_faults and ahead is not None:
            model = self.first_model()
            self.exclusion = exclude_faults(self.trajectories, model, before + ahead, stride)
            self.trajectories = self.prepared = self.exclusion.trajectories

    def retime(self) -> None:
        """Move packets to when they arrived by the model of a first fit; then of a second."""
        for _ in range(self.problem.retimings):
            self.prepared, self.packets = retime_packets(self.trajectories, self.first_model())

    def uncertainty(self, quadratic: Quadratic, model: Model) -> Uncertainty:
        """Estimate the covariance of the parameters at the optimum."""
        parameters, free, packets = model.parameters, model.free, self.packets
        known = sandwich(quadratic, parameters, free, shared=shared_at_borders(self.loss))
        if any(map(len, packets)) and np.isfinite(known.standard_errors).any():
            mixed, hessian = score_derivatives(
                self.loss, self.trajectories, model, packets, known.standard_errors
            )
            basis = varying(quadratic.hessian, parameters, free).basis
            known = grown(known, error_growth(mixed, hessian, basis, self.problem.retimings))
        delay = parameters.mask(frozenset({"transport_delay"}))
        return widened(known, delay, variance_of_mean(packets, spread_of(packets)))

    def conditions(self, outcome: Outcome) -> dict[str, Any]:
        """Return the table ``[fit]`` of the model file."""
        problem, windows = self.problem, self.loss.windows
        return {
            "loss": outcome.loss,
            "iterations": outcome.history[-1].number,
            "converged": outcome.converged,
            "method": type(problem.method).__name__,
            "windows": len(windows),
            "encoder_length": windows.encoder_length,
            "prediction_length": windows.prediction_length,
            "stride": self.trajectories[0].steps(problem.loss.spacing),
            "sample_period_s": self.trajectories[0].sample_period,
            "weights": list(problem.loss.weights),
            "robust": problem.loss.robust,
            **({"left_out": self.exclusion.to_json()} if self.exclusion else {}),
            "airpuck": __version__,
        }

    def judged(self, outcome: Outcome, began: float) -> Fit:
        """Find out how well the parameters are known, and sum up the fit."""
        problem = self.problem
        # Where Π is learned, Newton's law fixes its scale.
        parameters = fix_gauge(outcome.parameters, problem.vehicle, problem.free)
        quadratic = outcome.quadratic
        if quadratic is None or parameters is not outcome.parameters:
            quadratic = self.loss.quadratic(parameters)
        model = replace(
            problem.model(parameters),
            indexing=problem.loss.encoder.indexing,
            fit=self.conditions(outcome),
            data=_hashes(problem.trajectories),
            # The last two names of the path: a model file must not tell where its author's home is.
            source=", ".join("/".join(Path(t.source).parts[-2:]) for t in problem.trajectories),
            delay_jitter=delay_jitter(self.packets),
        )
        model = replace(model, uncertainty=self.uncertainty(quadratic, model))
        return Fit(
            model=model,
            loss=outcome.loss,
            history=outcome.history,
            converged=outcome.converged,
            message=outcome.message,
            windows=len(self.loss.windows),
            wall_s=time.perf_counter() - began,
            warnings=fit_warnings(model, self.trajectories, outcome, self.exclusion),
            identifiability=identifiability_of(
                quadratic.hessian, parameters, problem.free, problem.vehicle.propeller_names
            ),
            exclusion=self.exclusion,
            packet_delays=self.packets,
            objective=self.loss,
        )


def _hashes(trajectories: Sequence[Trajectory]) -> dict[str, str]:
    """Return the hashes of all files; names that several recordings share get their folder's."""
    names = [name for trajectory in trajectories for name in trajectory.hashes]
    found: dict[str, str] = {}
    for number, trajectory in enumerate(trajectories, start=1):
        folder = Path(trajectory.source).name
        for name, digest in trajectory.hashes.items():
            key = f"{folder}/{name}" if names.count(name) > 1 else name
            found[f"{number}/{key}" if key in found else key] = digest
    return found
