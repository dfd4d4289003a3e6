"""`identify`: from trajectories to a model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from airpuck import __version__
from airpuck.errors import InputError
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Iteration, Method
from airpuck.identification.objective import PUBLISHED_WEIGHTS, PredictionLoss
from airpuck.model.parameters import Parameters
from airpuck.model.presets import Preset, preset
from airpuck.model.rigid_body import CenterOfMassFrame
from airpuck.model.thrust import lowest_slope
from airpuck.model_file import Model
from airpuck.trajectory import Trajectory, check_propellers
from airpuck.vehicle import Vehicle, default_vehicle
from airpuck.windows import make_windows


@dataclass(frozen=True)
class Fit:
    """Result of `identify`.

    Attributes
    ----------
    model : Model
        The identified model.
    loss : float
        Mean squared weighted prediction error over windows, steps and channels, without any
        regulariser; see `PredictionLoss`.
    history : tuple of Iteration
        The optimiser's way.
    converged : bool
        Whether the optimiser stopped by its own criterion.
    message : str
        Why it stopped.
    windows : int
        Windows in the loss.
    wall_s : float
        Time it took [s].
    warnings : tuple of str
        What to look at before trusting the model.
    """

    model: Model
    loss: float
    history: tuple[Iteration, ...]
    converged: bool
    message: str
    windows: int
    wall_s: float
    warnings: tuple[str, ...]

    @property
    def iterations(self) -> int:
        """Steps of the optimiser."""
        return self.history[-1].number

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``.

        Returns
        -------
        dict
            ``model, loss, iterations, converged, windows, wall_s, warnings, history``.
        """
        return {
            "model": self.model.name,
            "loss": self.loss,
            "iterations": self.iterations,
            "converged": self.converged,
            "windows": self.windows,
            "wall_s": self.wall_s,
            "warnings": list(self.warnings),
            "history": [asdict(iteration) for iteration in self.history],
        }


#: A motor whose command stays within this range says nothing about its thrust.
_HARDLY = 0.02
#: Samples of the past from which a fit's encoder estimates the present.
_PAST = 40


def identify(
    trajectories: Trajectory | Sequence[Trajectory],
    model: str | Preset = "M3",
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
    progress: Callable[[Iteration], None] = lambda _: None,
) -> Fit:
    """Identify a model by minimising its multi-step prediction error (eq. combined_loss).

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Data of one craft.
    model : str or Preset, default "M3"
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
        Samples from one window to the next. Neighbouring windows share all but one sample: 7 keeps
        the information at a seventh of the cost.
    degree : int, optional
        Degree of the thrust polynomials; by default that of the nominal thrust.
    frame : {"body", "world"}, default "body"
        Where the offset of the centre of mass is constant; "world" is the paper's eq. acc_dyn.
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
    started = time.perf_counter()
    if isinstance(trajectories, Trajectory):
        trajectories = [trajectories]
    vehicle = vehicle or default_vehicle()
    rung = preset(model) if isinstance(model, str) else model
    encoder = encoder or PaperEncoder(length=_PAST)
    method = method or LevenbergMarquardt()
    for trajectory in trajectories:
        check_propellers(vehicle, trajectory)
    _refuse_twins(trajectories)
    windows = make_windows(trajectories, encoder.length, prediction_length, stride)
    start = initial or rung.initial(vehicle, degree)
    free = rung.mask(start)
    loss = PredictionLoss(windows, vehicle, encoder, weights, frame)
    outcome = method.minimize(loss, start, free, progress)
    wall = time.perf_counter() - started
    identified = Model(
        name=rung.name,
        vehicle=vehicle,
        parameters=outcome.parameters,
        free=free,
        frame=frame,
        indexing=encoder.indexing,
        transport_delay=_delay(trajectories, vehicle),
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
            "airpuck": __version__,
        },
        data=_hashes(trajectories),
        # The last two names of the path: a model file must not tell where its author's home is.
        source=", ".join("/".join(Path(t.source).parts[-2:]) for t in trajectories),
    )
    return Fit(
        model=identified,
        loss=outcome.loss,
        history=outcome.history,
        converged=outcome.converged,
        message=outcome.message,
        windows=len(windows),
        wall_s=wall,
        warnings=tuple(
            _idle_motors(trajectories) + _warnings(identified, outcome.converged, outcome.message)
        ),
    )


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


def _delay(trajectories: Sequence[Trajectory], vehicle: Vehicle) -> float:
    """Return the transport delay found in the data, or the nominal one where none can be."""
    known = [trajectory.delay for trajectory in trajectories if trajectory.delay_known]
    return float(np.mean(known)) if known else vehicle.nominal.transport_delay_s


def _idle_motors(trajectories: Sequence[Trajectory]) -> list[str]:
    """Name the motors of which the data can say nothing."""
    ranges = np.max([np.ptp(t.command, axis=0) for t in trajectories], axis=0)
    return [
        f"the command of {name} hardly changes: these data do not determine its thrust"
        for name, extent in zip(trajectories[0].propellers, ranges, strict=True)
        if extent < _HARDLY
    ]


def _warnings(model: Model, converged: bool, message: str) -> list[str]:
    """Say what to look at before trusting a model."""
    warnings = [] if converged else [f"the optimiser has not converged: {message}"]
    vector = model.parameters.to_vector()
    lower, upper = model.parameters.bounds()
    labels = model.parameters.labels(model.vehicle.propeller_names)
    at_bound = model.free & ((vector <= lower) | (vector >= upper))
    warnings += [f"{labels[entry]} is at its bound" for entry in np.flatnonzero(at_bound)]
    nominal = model.vehicle.nominal.inertia_kg_m2
    if not 0.05 < float(model.parameters.inertia) / nominal < 20:
        warnings.append(
            f"the inertia, {float(model.parameters.inertia):.3g} kg m², is far from the nominal "
            f"{nominal:.3g}: do the data excite the yaw?"
        )
    slopes, speeds = lowest_slope(model.parameters.thrust)
    for name, slope, speed in zip(model.vehicle.propeller_names, slopes, speeds, strict=True):
        if slope < 0:
            warnings.append(f"thrust of {name} falls at φ = {speed:.2f}: it cannot be inverted")
    return warnings
