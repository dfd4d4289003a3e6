"""The choices of a fit: which prediction errors count, and what is done to the data before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting, Settings

if TYPE_CHECKING:
    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.estimate.encoder import PaperEncoder
    from airpuck.identification.objective import PredictionLoss
    from airpuck.physics.rigid_body import CenterOfMassFrame

#: Weights of the errors of x, y [1/m] and yaw [1/rad] in the published fits.
PUBLISHED_WEIGHTS = (1.0, 1.0, 0.1)
#: Relative difference between the sample periods of recordings that are fitted together.
_SAME_RATE = 0.05

#: Distance between windows.
Stride = Annotated[
    int | None,
    Setting(
        "Samples from one window to the next; by default 29 ms, for adam 1",
        numbers.STRIDE,
        "N",
        heading="Prediction errors that are minimised",
    ),
]
YawWeight = Annotated[
    float,
    Setting(
        r"Weight of yaw errors in the loss \[1/rad]",
        numbers.WEIGHT,
        "W",
        heading="Prediction errors that are minimised",
    ),
]
#: Degree of the thrust polynomials.
Degree = Annotated[
    int | None,
    Setting(
        "Degree of the thrust polynomials; by default the model's",
        numbers.DEGREE,
        "N",
        heading="Structure of the model",
    ),
]


def _paper_encoder() -> PaperEncoder:
    from airpuck.estimate.encoder import PaperEncoder

    return PaperEncoder()


@dataclass(frozen=True)
class Loss(Settings):
    """Which prediction errors a fit minimises, and how much each counts (eq. combined_loss).

    Attributes
    ----------
    encoder : PaperEncoder
        Where predictions start from; by default the paper's, each command in force from its own
        sample on.
    encoder_time : float
        Past that the encoder looks at [s]; by default E = 40 samples at 240 Hz. (The paper's 20
        samples are three time constants of the motors: 5 % of the earlier motor speeds remain,
        and bias the thrust by about 1 %.)
    weights : tuple of float
        Weights of the x, y [1/m] and γ [1/rad] errors; by default (1, 1, 0.1), as in the
        published fits. The paper's text has (1, 1, 1).
    prediction_time : float or None
        Length of a prediction [s]; by default T = 50 steps at 240 Hz. None: one window over the
        whole trajectory (eq. loss_full).
    spacing : float
        Time from one window to the next, at least one sample [s]; by default 7 samples at 240
        Hz. Windows that begin one sample apart share all others: every seventh keeps nearly all of
        the information at a seventh of the cost.
    robust : bool
        Whether windows that the model predicts badly count less, so that unmarked faults have
        little influence. `LevenbergMarquardt` only.
    """

    HEADING: ClassVar = "Prediction errors that are minimised"

    encoder: PaperEncoder = field(default_factory=_paper_encoder)
    encoder_time: Annotated[
        float, Setting("Past that the encoder looks at", numbers.WINDOW, "S")
    ] = 40 / 240
    weights: tuple[float, float, float] = PUBLISHED_WEIGHTS
    prediction_time: Annotated[
        float | None, Setting("Length of a prediction", numbers.WINDOW, "S")
    ] = 50 / 240
    spacing: float = 7 / 240
    robust: Annotated[
        bool, Setting("Let windows that are predicted badly count less.", option="--robust")
    ] = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
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
        from airpuck.data.windows import make_windows
        from airpuck.identification.objective import PredictionLoss
        from airpuck.identification.uncertainty import cluster_windows

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
            Data to cut windows from.

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
class Preparation(Settings):
    """What a first fit does for the data of the last one.

    Attributes
    ----------
    faults : {"exclude", "keep"} or None
        Whether windows in which motors or radio failed are left out: a first fit finds them
        (`airpuck.find_faults`), the next excludes them. None: they are, unless a recording
        was prepared by others (`Trajectory.delay_known`), so that fits to a published data set stay
        comparable. Not searched for where one window spans the whole trajectory.
    delay : {"fit", "fixed"} or None
        Whether the transport delay is learned, as a continuous parameter for all recordings; or
        each recording's own delay is used, in whole samples. None: it is learned by
        `LevenbergMarquardt` on rungs with a motor lag, unless a recording was prepared by others:
        each of those was shifted by another delay.
    retimings : int
        How often commands are moved to when their packets arrived, and velocities smoothed along
        the model, with what the fit before has learned (`airpuck.identification.retiming`). Where
        the delay is learned and motors lag.
    """

    HEADING: ClassVar = "Preparation of the recordings"

    faults: Annotated[
        Literal["exclude", "keep"] | None,
        Setting(
            "Leave out spans where motors or the radio failed, or keep them; by default exclude, "
            "but keep for recordings prepared elsewhere (data.pt)."
        ),
    ] = None
    delay: Annotated[
        Literal["fit", "fixed"] | None,
        Setting(
            "Fit the transport delay, or take each recording's; by default fit, for models with a "
            "motor lag, by lm, from recordings prepared here."
        ),
    ] = None
    retimings: int = 2
