"""An identification problem: data without faults, model, settings, and their checks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from airpuck.boundary.errors import InputError
from airpuck.boundary.signals import Progress
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.trajectory import Span, Trajectory, as_trajectories, check_propellers, vehicle_of
from airpuck.data.windows import make_windows
from airpuck.faults.find import find_faults
from airpuck.identification.method import Iteration, LevenbergMarquardt, Method
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.uncertainty import cluster_windows
from airpuck.model.model_file import Model
from airpuck.model.parameters import LAG, Parameters
from airpuck.model.rungs import Rung, named_rung
from airpuck.physics.rigid_body import CenterOfMassFrame

#: Largest fraction of the windows that faults may take; beyond it the model must be wrong.
MOST = 0.5
#: Number of motor time constants after which an encoder knows the motor speeds again.
_SETTLING = 3.0


@dataclass(frozen=True, eq=False)
class Problem:
    """An identification problem: data, model, loss, optimiser, preparation."""

    trajectories: tuple[Trajectory, ...]
    rung: Rung
    vehicle: Vehicle = field(default_factory=default_vehicle)
    #: Initial parameters; None: the vehicle's nominal values.
    initial: Parameters | None = None
    loss: Loss = field(default_factory=Loss)
    method: Method = field(default_factory=LevenbergMarquardt)
    preparation: Preparation = field(default_factory=Preparation)
    #: Whether the motor lag keeps the vehicle file's value.
    lag_held: bool = False
    progress: Callable[[Iteration], None] = field(default_factory=Progress)

    @classmethod
    def of(
        cls, trajectories: Trajectory | Sequence[Trajectory], model: str | Rung, **options: Any
    ) -> Problem:
        """Set up a problem; other fields that are None take their defaults."""
        trajectories = as_trajectories(trajectories)
        rung = (named_rung(model) if isinstance(model, str) else model).physics
        given = {name: value for name, value in options.items() if value is not None}
        if "vehicle" not in given:
            given["vehicle"] = vehicle_of(trajectories)
        # Chosen once, so that preparing the data does not change the windows.
        given["loss"] = given.get("loss", Loss()).suited(trajectories, given["vehicle"])
        return cls(tuple(trajectories), rung, **given)

    def __post_init__(self) -> None:
        """Raise InputError if the problem cannot be solved."""
        if not isinstance(self.method, LevenbergMarquardt):
            if self.loss.robust:
                raise InputError("works with Levenberg-Marquardt only", field="robust")
            if self.preparation.delay == "fit":
                raise InputError("fit works with Levenberg-Marquardt only", field="delay")
        for trajectory in self.trajectories:
            check_propellers(self.vehicle, trajectory)
        # All its files together identify a recording.
        digests = [" ".join(sorted(t.hashes.values())) for t in self.trajectories]
        for number, (trajectory, digest) in enumerate(zip(self.trajectories, digests, strict=True)):
            if digest and digest in digests[:number]:
                raise InputError(
                    "is given twice; name each recording only once", file=trajectory.source
                )

    @property
    def learns_delay(self) -> bool:
        """Whether the transport delay is one of the parameters."""
        if self.preparation.delay is not None:
            return self.preparation.delay == "fit"
        can = isinstance(self.method, LevenbergMarquardt)
        return can and self.rung.lag and all(t.delay_known for t in self.trajectories)

    @property
    def retimings(self) -> int:
        """Number of times that packets are retimed."""
        return self.preparation.retimings if self.learns_delay and self.rung.lag else 0

    @cached_property
    def start(self) -> Parameters:
        """Initial parameters of the fit."""
        start = self.initial or self.rung.initial(self.vehicle)
        if self.lag_held:
            start = replace(start, motor_time_constant=self.vehicle.nominal.motor_time_constant_s)
        if self.initial is not None and self.learns_delay:
            return start
        return replace(start, transport_delay=mean_delay(self.trajectories, self.vehicle))

    @cached_property
    def free(self) -> Bool[np.ndarray, " P"]:
        """Marks the parameters that are learned."""
        delay, lag = self.start.mask(frozenset({"transport_delay"})), self.start.mask(LAG)
        free = self.rung.mask(self.start, self.vehicle) | (delay & self.learns_delay)
        return free & ~(lag & self.lag_held)

    def loss_on(self, trajectories: Sequence[Trajectory]) -> PredictionLoss:
        """Return the loss on prepared trajectories."""
        frame, learns_delay = self.rung.frame, self.learns_delay
        return prediction_loss(
            self.loss, trajectories, self.vehicle, frame=frame, learns_delay=learns_delay
        )

    def model(self, parameters: Parameters) -> Model:
        """Return the model with these parameters."""
        return Model(self.rung.name, self.vehicle, parameters, self.free, self.rung.frame)


def prediction_loss(
    loss: Loss,
    trajectories: Sequence[Trajectory],
    vehicle: Vehicle,
    *,
    frame: CenterOfMassFrame = "body",
    learns_delay: bool = False,
) -> PredictionLoss:
    """Cut trajectories into windows, and return the loss over them, in equally weighted clusters.

    `frame` is the frame of the offset of the centre of mass; `learns_delay` makes the transport
    delay a parameter.
    """
    before, ahead, stride = loss.samples(trajectories)
    windows = make_windows(trajectories, before, ahead, stride)
    own, clusters = (loss.encoder, loss.weights), cluster_windows(windows)
    return PredictionLoss(windows, vehicle, *own, frame, None, learns_delay, clusters)


def mean_delay(trajectories: Sequence[Trajectory], vehicle: Vehicle) -> float:
    """Return the transport delay found by preprocessing, in whole samples [s]."""
    known = [trajectory.delay for trajectory in trajectories if trajectory.delay_known]
    return float(np.mean(known)) if known else vehicle.nominal.transport_delay_s


@dataclass(frozen=True, eq=False)
class Exclusion:
    """The faults that a fit leaves out."""

    #: The recordings without their faults.
    trajectories: tuple[Trajectory, ...]
    #: The faults found in each recording.
    faults: tuple[tuple[Span, ...], ...]
    #: Fraction of the windows that they took.
    share: float
    #: Names recordings with an implausible fraction of faulty windows; all of their windows are
    #: kept.
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json`` and the model file."""
        names = ("recording", "start_s", "stop_s", "cause", "confidence")
        return {
            "share_of_windows": self.share,
            "spans": [
                dict(zip(names, (Path(trajectory.source).name, *astuple(span)), strict=True))
                for trajectory, faults in zip(self.trajectories, self.faults, strict=True)
                for span in faults
            ],
        }


def exclude_faults(
    trajectories: Sequence[Trajectory], model: Model, length: int, stride: int
) -> Exclusion:
    """Find the faults of recordings, and exclude them until the motors have settled."""
    settling = _SETTLING * float(model.dynamics.motor_time_constant)
    kept, found, warnings = [], [], []
    before = after = 0
    for trajectory in trajectories:
        faults = find_faults(trajectory, model)
        healthy = trajectory.leave_out([replace(f, stop=f.stop + settling) for f in faults])
        windows = len(trajectory.window_starts(length, stride))
        left = len(healthy.window_starts(length, stride))
        if left < (1 - MOST) * windows:
            name = Path(trajectory.source).name or "a recording"
            warnings.append(
                f"{100 * (1 - left / windows):.0f} % of the windows of {name} look faulty; none is "
                "left out, because the model itself seems wrong: check the vehicle "
                "file with `airpuck check`"
            )
            healthy, faults, left = trajectory, (), windows
        kept.append(healthy)
        found.append(faults)
        before, after = before + windows, after + left
    return Exclusion(tuple(kept), tuple(found), 1 - after / before, tuple(warnings))
