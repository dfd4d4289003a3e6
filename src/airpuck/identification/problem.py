"""What is to be identified, and how: the choices of a fit, their checks and their defaults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.trajectory import Trajectory, as_trajectories, check_propellers, vehicle_of
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Iteration, Method
from airpuck.identification.objective import PUBLISHED_WEIGHTS, PredictionLoss
from airpuck.identification.uncertainty import cluster_windows
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import Rung, named_rung
from airpuck.physics.rigid_body import CenterOfMassFrame

_ENCODER = PaperEncoder()
#: Relative difference between the sample periods of recordings that are fitted together.
_SAME_RATE = 0.05


@dataclass(frozen=True)
class Loss:
    """Which prediction errors a fit minimises, and how much each counts (eq. combined_loss).

    Attributes
    ----------
    encoder : PaperEncoder
        Where predictions start from; by default the paper's, each command in force from its own
        sample on.
    encoder_time : float
        What the encoder looks at [s]; by default that of E = 40 samples at 240 Hz. (The paper's 20
        samples are three time constants of the motors: of what these did before, 5 % remain, and
        bias the thrust by about 1 %.)
    weights : tuple of float
        Weights of the x, y [1/m] and γ [1/rad] errors; by default those of the published fits,
        (1, 1, 0.1). The paper's text has (1, 1, 1).
    prediction_time : float or None
        What is predicted [s]; by default that of T = 50 steps at 240 Hz. None: one window over the
        whole trajectory (eq. loss_full).
    spacing : float
        From one window to the next, at least one sample [s]; by default that of 7 samples at 240
        Hz. Windows that begin one sample apart share all others: every seventh keeps nearly all of
        the information at a seventh of the cost.
    robust : bool
        Whether windows that the model predicts badly count less, so that unmarked faults hardly
        move the estimate. `LevenbergMarquardt` only.
    """

    encoder: PaperEncoder = _ENCODER
    encoder_time: float = 40 / 240
    weights: tuple[float, float, float] = PUBLISHED_WEIGHTS
    prediction_time: float | None = 50 / 240
    spacing: float = 7 / 240
    robust: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that make no loss."""
        numbers.WINDOW.check(self.encoder_time, "encoder_time")
        if self.prediction_time is not None:
            numbers.WINDOW.check(self.prediction_time, "prediction_time")
        numbers.SPACING.check(self.spacing, "spacing")
        for weight in self.weights:
            numbers.WEIGHT.check(weight, "weights")

    def on(
        self,
        trajectories: Sequence[Trajectory],
        vehicle: Vehicle,
        *,
        frame: CenterOfMassFrame = "body",
        learns_delay: bool = False,
    ) -> PredictionLoss:
        """Cut trajectories into windows, and return the loss over them.

        Parameters
        ----------
        trajectories : sequence of Trajectory
            Data of one craft.
        vehicle : Vehicle
            The craft.
        frame : {"body", "world"}, default "body"
            Where the offset of the centre of mass is constant.
        learns_delay : bool, default False
            Whether the transport delay is one of the parameters.

        Returns
        -------
        PredictionLoss
            With its windows grouped into clusters; all windows count alike.
        """
        before, ahead, stride = self.samples(trajectories)
        windows = make_windows(trajectories, before, ahead, stride)
        return PredictionLoss(
            windows,
            vehicle,
            self.encoder,
            self.weights,
            frame,
            continuous_delay=learns_delay,
            clusters=cluster_windows(windows),
        )

    def samples(self, trajectories: Sequence[Trajectory]) -> tuple[int, int | None, int]:
        """Return E, T and the stride in samples, or refuse recordings of different rates.

        Parameters
        ----------
        trajectories : sequence of Trajectory
            What windows are to be cut from.

        Returns
        -------
        tuple of int
            T is None where one window spans a trajectory.

        Raises
        ------
        InputError
            If their poses were taken at different rates.
        """
        first = trajectories[0]
        ahead = self.prediction_time
        for other in trajectories[1:]:
            if abs(other.sample_period / first.sample_period - 1) > _SAME_RATE:
                raise InputError(
                    f"has poses at {1 / other.sample_period:.0f} Hz, the first recording at "
                    f"{1 / first.sample_period:.0f} Hz; identify from recordings of one rate",
                    file=other.source,
                )
        steps = first.steps
        before, stride = steps(self.encoder_time), steps(self.spacing)
        return before, None if ahead is None else steps(ahead), stride


@dataclass(frozen=True)
class Preparation:
    """What a first fit does for the data of the last one.

    Attributes
    ----------
    faults : {"exclude", "keep"} or None
        Whether windows in which motors or radio failed are left out: a first fit finds them
        (`airpuck.find_faults`), the next goes on without them. None: they are, unless a recording
        was prepared by others (`Trajectory.delay_known`), so that fits to a published data set stay
        comparable. Not searched for where one window spans the whole trajectory.
    delay : {"fit", "fixed"} or None
        Whether the transport delay is learned, as a continuous parameter for all recordings; or
        the delay of each recording is taken as it is, in whole samples. None: it is learned by
        `LevenbergMarquardt` on rungs with a motor lag, unless a recording was prepared by others:
        each of those was shifted by another delay.
    retimings : int
        How often commands are moved to when their packets arrived, and velocities smoothed along
        the model, with what the fit before has learned (`airpuck.identification.retiming`). Where
        the delay is learned and motors lag.
    """

    faults: Literal["exclude", "keep"] | None = None
    delay: Literal["fit", "fixed"] | None = None
    retimings: int = 2

    def __post_init__(self) -> None:
        """Refuse what is no choice."""
        for name, choices in (("delay", ("fit", "fixed")), ("faults", ("exclude", "keep"))):
            choice = getattr(self, name)
            if choice not in (None, *choices):
                raise InputError(f"is {' or '.join(choices)}, not {choice!r}", field=name)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be identified from what, and how."""

    trajectories: tuple[Trajectory, ...]
    rung: Rung
    vehicle: Vehicle = field(default_factory=default_vehicle)
    #: Where to start; None: at the vehicle's nominal values.
    initial: Parameters | None = None
    loss: Loss = field(default_factory=Loss)
    method: Method = field(default_factory=LevenbergMarquardt)
    preparation: Preparation = field(default_factory=Preparation)
    progress: Callable[[Iteration], None] = field(default_factory=lambda: lambda _: None)

    @classmethod
    def of(
        cls, trajectories: Trajectory | Sequence[Trajectory], model: str | Rung, **options: Any
    ) -> Problem:
        """Pose a problem; what is None among the other fields takes its default."""
        trajectories = as_trajectories(trajectories)
        rung = named_rung(model) if isinstance(model, str) else model
        given = {name: value for name, value in options.items() if value is not None}
        if "vehicle" not in given:
            given["vehicle"] = vehicle_of(trajectories)
        return cls(tuple(trajectories), rung, **given)

    def __post_init__(self) -> None:
        """Refuse what cannot be fitted."""
        if not isinstance(self.method, LevenbergMarquardt):
            if self.loss.robust:
                raise InputError("is of Levenberg-Marquardt only", field="robust")
            if self.preparation.delay == "fit":
                raise InputError("fit is of Levenberg-Marquardt only", field="delay")
        for trajectory in self.trajectories:
            check_propellers(self.vehicle, trajectory)
        # All its files together identify a recording.
        digests = [" ".join(sorted(t.hashes.values())) for t in self.trajectories]
        for number, (trajectory, digest) in enumerate(zip(self.trajectories, digests, strict=True)):
            if digest and digest in digests[:number]:
                raise InputError("is given twice; give each recording once", file=trajectory.source)

    @property
    def _delays_known(self) -> bool:
        """Whether all recordings were prepared here, so that their delays are known."""
        return all(trajectory.delay_known for trajectory in self.trajectories)

    @property
    def excludes_faults(self) -> bool:
        """Whether faults are searched for and left out."""
        default = "exclude" if self._delays_known else "keep"
        wanted = (self.preparation.faults or default) == "exclude"
        return wanted and self.loss.prediction_time is not None

    @property
    def learns_delay(self) -> bool:
        """Whether the transport delay is one of the parameters."""
        if self.preparation.delay is not None:
            return self.preparation.delay == "fit"
        can = isinstance(self.method, LevenbergMarquardt)
        return can and self.rung.lag and self._delays_known

    @property
    def retimings(self) -> int:
        """How often packets are retimed."""
        return self.preparation.retimings if self.learns_delay and self.rung.lag else 0

    @cached_property
    def start(self) -> Parameters:
        """Where the fit starts."""
        start = self.initial or self.rung.initial(self.vehicle)
        if self.initial is not None and self.learns_delay:
            return start
        return replace(start, transport_delay=mean_delay(self.trajectories, self.vehicle))

    @cached_property
    def free(self) -> Bool[np.ndarray, " P"]:
        """Which parameters are learned."""
        delay = self.start.mask(frozenset({"transport_delay"}))
        return self.rung.mask(self.start) | (delay & self.learns_delay)

    def loss_on(self, trajectories: Sequence[Trajectory]) -> PredictionLoss:
        """Return the loss on the trajectories as they are prepared by now."""
        return self.loss.on(
            trajectories, self.vehicle, frame=self.rung.frame, learns_delay=self.learns_delay
        )

    def model(self, parameters: Parameters) -> Model:
        """Return the model that parameters make up."""
        return Model(self.rung.name, self.vehicle, parameters, self.free, self.rung.frame)


def mean_delay(trajectories: Sequence[Trajectory], vehicle: Vehicle) -> float:
    """Return the transport delay that preprocessing found, in whole samples [s]."""
    known = [trajectory.delay for trajectory in trajectories if trajectory.delay_known]
    return float(np.mean(known)) if known else vehicle.nominal.transport_delay_s
