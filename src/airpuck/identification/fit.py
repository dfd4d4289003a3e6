"""`identify`: from trajectories to a model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.trajectory import Trajectory, check_propellers
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.blocks import cluster_windows, shared_at_borders
from airpuck.identification.bootstrap import bootstrap as resample
from airpuck.identification.delay_jitter import delay_jitter, variance_of_mean
from airpuck.identification.doubts import doubts, idle_motors
from airpuck.identification.fault_exclusion import exclude_faults
from airpuck.identification.feedback import preparation_feedback
from airpuck.identification.fit_result import Fit
from airpuck.identification.identifiability import Identifiability, identifiability_of
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Iteration, Method, Outcome, minimize_on
from airpuck.identification.objective import PUBLISHED_WEIGHTS, PredictionLoss, Shares
from airpuck.identification.packet_delays import PacketDelays
from airpuck.identification.refinement import refined
from airpuck.identification.robust import reweighted
from airpuck.identification.transport_delay import (
    DelayChoice,
    delay_warnings,
    learns_delay,
    mean_delay,
)
from airpuck.identification.uncertainty import sandwich, widened
from airpuck.model.gauge import fix_gauge
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import Rung, named_rung
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.rigid_body import CenterOfMassFrame

#: Fits to data that were prepared anew with the last one.
_REFINEMENTS = 2
#: Samples of the past from which a fit's encoder estimates the present.
_PAST = 40


def identify(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung = "M3",
    *,
    vehicle: Vehicle | None = None,
    method: Method | None = None,
    initial: Parameters | None = None,
    encoder: PaperEncoder | None = None,
    weights: tuple[float, float, float] = PUBLISHED_WEIGHTS,
    prediction_length: int | None = 50,
    stride: int = 7,
    degree: int | None = None,
    frame: CenterOfMassFrame = "body",
    delay: DelayChoice | None = None,
    robust: bool = False,
    faults: Literal["exclude", "keep"] | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    progress: Callable[[Iteration], None] = lambda _: None,
    resampled: Callable[[int], None] = lambda _: None,
) -> Fit:
    """Identify a model by minimising its multi-step prediction error (eq. combined_loss).

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Data of one craft.
    model : str or Rung, default "M3"
        The rung of the model ladder.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    method : Method, optional
        `LevenbergMarquardt()` by default, or `Adam()`.
    initial : Parameters, optional
        Where to start; by default the vehicle's nominal values.
    encoder : PaperEncoder, optional
        By default the paper's with E = 40 samples, each command in force from its own sample on.
        (The paper's 20 samples are three time constants of the motors: of what these did before,
        5 % remain, and bias the thrust by about 1 %.)
    weights : tuple of float, optional
        Weights of the x, y [1/m] and γ [1/rad] errors; by default those of the published fits,
        (1, 1, 0.1). The paper's text has (1, 1, 1).
    prediction_length : int or None, default 50
        Steps T to predict. None: one window over the whole trajectory (eq. loss_full).
    stride : int, default 7
        Samples from one window to the next. Windows that begin one sample apart share all others:
        7 keeps nearly all of the information at a seventh of the cost.
    degree : int, optional
        Degree of the thrust polynomials; by default that of the nominal thrust.
    frame : {"body", "world"}, default "body"
        Where the offset of the centre of mass is constant; "world" is the paper's eq. acc_dyn.
    delay : {"fit", "fixed"}, optional
        Whether the transport delay is learned, as a continuous parameter for all recordings; or
        the delay of each recording is taken as it is, in whole samples. By default it is learned
        by `LevenbergMarquardt` on rungs with a motor lag, unless a recording was prepared by
        others (`Trajectory.delay_known`): each of those was shifted by a delay of its own. Where it
        is learned, so are the delays of single packets, and the fit goes on with commands at the
        times of their arrival (`airpuck.identification.refinement`).
    robust : bool, default False
        Whether windows that the model predicts badly count less (`reweighted`): faults that nobody
        has marked then hardly move the estimate.
    faults : {"exclude", "keep"}, optional
        Whether windows in which motors or radio failed are left out: a first fit finds them
        (`airpuck.find_faults`), a second one goes on without them. By default they are, unless a
        recording was prepared by others: fits to a published data set stay comparable. Not
        searched for where one window spans the whole trajectory.
    bootstrap : int, default 0
        Fits to resampled data, for intervals beside those of the standard errors; some hundreds.
        Of `LevenbergMarquardt` only.
    seed : int, default 0
        Seed of the resampling.
    progress : callable, optional
        Called after every iteration of the optimiser.
    resampled : callable, optional
        Called with the number of fits to resampled data done.

    Returns
    -------
    Fit
        The model, and how it was found.

    Raises
    ------
    InputError
        If the data do not fit the vehicle, are too short, or the model does not exist.
    """
    started = time.perf_counter()
    if isinstance(trajectories, Trajectory):
        trajectories = [trajectories]
    method = method or LevenbergMarquardt()
    for name, choice, choices in (
        ("delay", delay, ("fit", "fixed")),
        ("faults", faults, ("exclude", "keep")),
    ):
        if choice not in (None, *choices):
            raise InputError(f"is {' or '.join(choices)}, not {choice!r}", field=name)
    for name, asked in (("bootstrap", bootstrap), ("robust", robust)):
        if asked and not isinstance(method, LevenbergMarquardt):
            raise InputError("is of Levenberg-Marquardt only", field=name)
    vehicle = vehicle or default_vehicle()
    rung = named_rung(model) if isinstance(model, str) else model
    encoder = encoder or PaperEncoder(length=_PAST)
    continuous = learns_delay(delay, rung, method, trajectories)

    def loss_on(trajectories: Sequence[Trajectory]) -> PredictionLoss:
        return replace(
            _loss(trajectories, vehicle, encoder, weights, prediction_length, stride, frame),
            continuous_delay=continuous,
        )

    if faults is None:
        faults = "exclude" if all(t.delay_known for t in trajectories) else "keep"
    loss, exclusion, packets = loss_on(trajectories), None, ()
    start, free = _start(trajectories, vehicle, rung, initial, degree, continuous)
    first = method if isinstance(method, LevenbergMarquardt) else LevenbergMarquardt()
    outcome = None

    def lowered(loss: PredictionLoss) -> Outcome:
        if outcome is None:
            return first.minimize(loss, start, free, progress)
        return minimize_on(first, loss, outcome, free, progress)

    def model_of(outcome: Outcome) -> Model:
        return Model(rung.name, vehicle, outcome.parameters, free, frame)

    # Where a fit only serves to prepare the data, a part of the windows will do.
    if faults == "exclude" and prediction_length is not None:
        outcome = lowered(loss.thinned)
        exclusion = exclude_faults(
            trajectories, model_of(outcome), encoder.length + prediction_length, stride
        )
        trajectories = exclusion.trajectories
        loss = loss_on(trajectories)
    for _ in range(_REFINEMENTS if continuous and rung.lag else 0):
        outcome = lowered(loss.thinned)
        prepared, packets = refined(trajectories, model_of(outcome))
        loss = loss_on(prepared)
    outcome = lowered(loss) if first is method else method.minimize(loss, start, free, progress)
    windows = loss.windows
    if robust:
        loss, outcome = reweighted(method, loss, outcome, free, progress)
    clusters, found = loss.clusters, outcome.parameters
    assert clusters is not None
    outcome = replace(outcome, parameters=fix_gauge(found, vehicle, free))
    shares = outcome.shares if outcome.parameters is found else None
    if shares is None:
        shares = loss.by_cluster(outcome.parameters, clusters)
    uncertainty = _uncertainty(loss, shares, model_of(outcome), trajectories, packets)
    known = identifiability_of(
        shares.hessian.sum(axis=0), outcome.parameters, free, vehicle.propeller_names
    )
    wall = time.perf_counter() - started
    if bootstrap:
        uncertainty = replace(
            uncertainty,
            bootstrap=resample(
                loss,
                outcome.parameters,
                free,
                clusters,
                bootstrap,
                undetermined=uncertainty.undetermined,
                seed=seed,
                progress=resampled,
            )[0],
        )
    jitter = delay_jitter(packets)
    if jitter is not None:
        delays = outcome.parameters.mask(frozenset({"transport_delay"}))
        variance = variance_of_mean(packets, jitter.standard_deviation_s)
        uncertainty = widened(uncertainty, delays, variance)
    identified = Model(
        name=rung.name,
        vehicle=vehicle,
        parameters=outcome.parameters,
        free=free,
        frame=frame,
        indexing=encoder.indexing,
        fit={
            "loss": outcome.loss,
            "iterations": outcome.history[-1].number,
            "converged": outcome.converged,
            "method": type(method).__name__,
            "windows": len(windows),
            "encoder_length": windows.encoder_length,
            "prediction_length": windows.prediction_length,
            "stride": stride,
            "weights": list(weights),
            "robust": robust,
            **({"left_out": exclusion.to_json()} if exclusion else {}),
            "airpuck": __version__,
        },
        data=_hashes(trajectories),
        # The last two names of the path: a model file must not tell where its author's home is.
        source=", ".join("/".join(Path(t.source).parts[-2:]) for t in trajectories),
        uncertainty=uncertainty,
        delay_jitter=jitter,
    )
    return Fit(
        model=identified,
        loss=outcome.loss,
        history=outcome.history,
        converged=outcome.converged,
        message=outcome.message,
        windows=len(windows),
        wall_s=wall,
        warnings=(
            *idle_motors(trajectories),
            *(exclusion.warnings if exclusion else ()),
            *doubts(identified, outcome.converged, outcome.message),
            *delay_warnings(identified, trajectories),
            *(note for note in uncertainty.notes if "rough" in note or "no standard" in note),
        ),
        identifiability=known,
        exclusion=exclusion,
        packet_delays=packets,
        objective=loss,
    )


def _uncertainty(
    loss: PredictionLoss,
    shares: Shares,
    model: Model,
    trajectories: Sequence[Trajectory],
    packets: Sequence[PacketDelays],
) -> Uncertainty:
    """Estimate the covariance of the parameters at the optimum of a loss."""
    assert loss.clusters is not None
    shared = shared_at_borders(loss.windows, loss.clusters)
    uncertainty = sandwich(shares, model.parameters, model.free, shared=shared)
    errors = uncertainty.standard_errors
    if not any(map(len, packets)) or not np.isfinite(errors).any():
        return uncertainty
    feedback = preparation_feedback(loss, trajectories, model, packets, errors, _REFINEMENTS)
    return sandwich(shares, model.parameters, model.free, shared=shared, feedback=feedback)


def identifiability(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Rung = "M3",
    *,
    vehicle: Vehicle | None = None,
    initial: Parameters | None = None,
    degree: int | None = None,
    prediction_length: int | None = 50,
    stride: int = 7,
    frame: CenterOfMassFrame = "body",
    delay: DelayChoice | None = None,
) -> Identifiability:
    """Say before a fit what data can determine, by the information at its start.

    Parameters
    ----------
    trajectories, model, vehicle, initial, degree, prediction_length, stride, frame, delay
        What `identify` would be given.

    Returns
    -------
    Identifiability
        In numbers and words.

    Raises
    ------
    InputError
        If the data do not fit the vehicle, are too short, or the model does not exist.
    """
    if isinstance(trajectories, Trajectory):
        trajectories = [trajectories]
    vehicle = vehicle or default_vehicle()
    rung = named_rung(model) if isinstance(model, str) else model
    encoder = PaperEncoder(length=_PAST)
    continuous = learns_delay(delay, rung, LevenbergMarquardt(), trajectories)
    loss = replace(
        _loss(trajectories, vehicle, encoder, PUBLISHED_WEIGHTS, prediction_length, stride, frame),
        continuous_delay=continuous,
    )
    start, free = _start(trajectories, vehicle, rung, initial, degree, continuous)
    hessian = loss.quadratic(start).hessian
    return identifiability_of(hessian, start, free, vehicle.propeller_names)


def _start(
    trajectories: Sequence[Trajectory],
    vehicle: Vehicle,
    rung: Rung,
    initial: Parameters | None,
    degree: int | None,
    continuous: bool,
) -> tuple[Parameters, Bool[np.ndarray, " P"]]:
    """Return where a fit starts, and which entries are free."""
    start = initial or rung.initial(vehicle, degree)
    if initial is None or not continuous:
        start = replace(start, transport_delay=mean_delay(trajectories, vehicle))
    return start, rung.mask(start) | (start.mask(frozenset({"transport_delay"})) & continuous)


def _loss(
    trajectories: Sequence[Trajectory],
    vehicle: Vehicle,
    encoder: PaperEncoder,
    weights: tuple[float, float, float],
    prediction_length: int | None,
    stride: int,
    frame: CenterOfMassFrame,
) -> PredictionLoss:
    """Check recordings, and cut them into the windows of a loss."""
    for trajectory in trajectories:
        check_propellers(vehicle, trajectory)
    _refuse_twins(trajectories)
    windows = make_windows(trajectories, encoder.length, prediction_length, stride)
    clusters = cluster_windows(windows)
    return PredictionLoss(windows, vehicle, encoder, weights, frame, clusters=clusters)


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


def _refuse_twins(trajectories: Sequence[Trajectory]) -> None:
    """Refuse the same recording twice: it would count double."""
    seen: set[str] = set()
    for trajectory in trajectories:
        # What identifies a recording: all its files together.
        digest = " ".join(sorted(trajectory.hashes.values()))
        if digest and digest in seen:
            raise InputError("is given twice; give each recording once", file=trajectory.source)
        seen.add(digest)
