"""The choices of a fit: which prediction errors count, and how the data are prepared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting, Settings

if TYPE_CHECKING:
    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.estimate.encoder import PaperEncoder

#: Weights of the errors of x, y [1/m] and yaw [1/rad] in the published fits.
PUBLISHED_WEIGHTS = (1.0, 1.0, 0.1)
#: Shortest default times of encoder and prediction [s]: 40 and 50 samples at 240 Hz.
_ENCODER, _PREDICTION = 40 / 240, 50 / 240
#: An encoder more than this many times too short is lengthened, by this margin, up to a limit [s].
_SHORT, _LONGEST_ENCODER = 1.2, 1.0
#: Relative difference between the sample periods of recordings that are fitted together.
_SAME_RATE = 0.05

#: Settings outside of a class, under the headings of its settings and of others like them.
of_errors = partial(Setting, heading="Prediction errors to minimise")
of_structure = partial(Setting, heading="Structure of the model")
#: Distance between windows.
Stride = Annotated[
    int | None,
    of_errors("Samples from one window to the next; by default 29 ms", numbers.STRIDE, "N"),
]
YawWeight = Annotated[float, of_errors(r"Weight of yaw errors \[1/rad]", numbers.WEIGHT, "W")]
#: Degree of the thrust polynomials.
Degree = Annotated[
    int | None,
    of_structure("Degree of the thrust polynomials; by default the model's", numbers.DEGREE, "N"),
]
ComFrame = Annotated[
    Literal["body", "world"],
    of_structure("Whether the centre of mass is fixed to the body, or the world as in the paper."),
]


def _paper_encoder() -> PaperEncoder:
    from airpuck.estimate.encoder import PaperEncoder

    return PaperEncoder()


@dataclass(frozen=True)
class Loss(Settings):
    """The prediction errors that a fit minimises, and their weights (eq. combined_loss).

    The default times suit the paper's craft; a slower craft gets longer times of encoder and
    prediction (`suited`).

    Attributes
    ----------
    encoder : PaperEncoder
        Encoder for the initial states of predictions; by default the paper's, with each command in
        force from its own sample on.
    encoder_time : float, optional
        Length of the past that the encoder uses [s]; by default E = 40 samples at 240 Hz, or more
        (`suited`; `remembering` if motors turn out slower than the vehicle file says). (The paper's
        20 samples are three time constants of the motors: 5 % of the earlier motor speeds remain,
        and bias the thrust by about 1 %.)
    weights : tuple of float
        Weights of the x, y [1/m] and γ [1/rad] errors; by default (1, 1, 0.1), as in the
        published fits. The paper's text has (1, 1, 1).
    prediction_time : float, optional
        Length of a prediction [s]; by default T = 50 steps at 240 Hz, or more (`suited`).
    whole : bool
        Whether one window spans the whole trajectory (eq. loss_full).
    spacing : float
        Time between the starts of windows, at least one sample [s]; by default 7 samples at 240 Hz.
        Consecutive windows share nearly all samples: using every seventh keeps nearly all of the
        information at a seventh of the cost.
    robust : bool
        Whether poorly predicted windows count less, so that unmarked faults have little influence.
        `LevenbergMarquardt` only.

    Examples
    --------
    >>> loss = airpuck.Loss(robust=True)  # less weight for badly predicted windows
    >>> loss.robust
    True
    """

    HEADING: ClassVar = "Prediction errors to minimise"

    encoder: PaperEncoder = field(default_factory=_paper_encoder)
    encoder_time: Annotated[
        float | None,
        Setting(
            "Length of the past that the encoder uses; by default 0.167, longer for a slow craft",
            numbers.WINDOW,
            "S",
        ),
    ] = None
    weights: tuple[float, float, float] = PUBLISHED_WEIGHTS
    prediction_time: Annotated[
        float | None,
        Setting(
            "Length of a prediction; by default 0.208, longer for a slow craft", numbers.WINDOW, "S"
        ),
    ] = None
    whole: bool = False
    spacing: float = 7 / 240
    robust: Annotated[
        bool, Setting("Give poorly predicted windows less weight.", option="--robust")
    ] = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        numbers.SPACING.check(self.spacing, "spacing")
        if len(self.weights) != 3:
            raise InputError("must be three numbers: of x, y and yaw", field="weights")
        for weight in self.weights:
            numbers.WEIGHT.check(weight, "weights")

    def suited(self, trajectories: Sequence[Trajectory], vehicle: Vehicle) -> Loss:
        """Return the loss with missing times filled in, long enough for a craft.

        Parameters
        ----------
        trajectories : sequence of Trajectory
            Recordings of the craft.
        vehicle : Vehicle
            The craft; a slow one must be watched for longer.

        Returns
        -------
        Loss
            With encoder and prediction at least as long as thrust takes to show above the noise of
            poses (`airpuck.deviation.time_scale`), and as the slowest motors remember.
        """
        from airpuck.deviation.time_scale import forgetting_time, showing_time

        slow = max(showing_time(trajectories, vehicle), forgetting_time(vehicle))
        return replace(
            self,
            encoder_time=self.encoder_time or max(_ENCODER, slow),
            prediction_time=self.prediction_time or max(_PREDICTION, slow),
        )

    def remembering(self, lag: float) -> Loss:
        """Return the loss with an encoder that forgets the initial speeds of motors.

        Parameters
        ----------
        lag : float
            Time constant of the slowest motor [s].

        Returns
        -------
        Loss
            The same loss if its encoder is long enough.
        """
        from airpuck.deviation.time_scale import FORGOTTEN

        longer = min(_SHORT * FORGOTTEN * lag, _LONGEST_ENCODER)
        enough = longer <= _SHORT**2 * (self.encoder_time or _ENCODER)
        return self if enough else replace(self, encoder_time=longer)

    def samples(self, trajectories: Sequence[Trajectory]) -> tuple[int, int | None, int]:
        """Return E, T and the stride in samples; recordings must have the same rate.

        Parameters
        ----------
        trajectories : sequence of Trajectory
            Data to cut windows from.

        Returns
        -------
        tuple of int
            E, T and stride. T is None if one window spans a trajectory.

        Raises
        ------
        InputError
            If their poses were taken at different rates.
        """
        first = trajectories[0]
        for other in trajectories[1:]:
            if abs(other.sample_period / first.sample_period - 1) > _SAME_RATE:
                raise InputError(
                    f"has poses at {1 / other.sample_period:.0f} Hz, the first recording at "
                    f"{1 / first.sample_period:.0f} Hz; use recordings with equal rates",
                    file=other.source,
                )
        steps = first.steps
        before, stride = steps(self.encoder_time or _ENCODER, least=2), steps(self.spacing)
        ahead = None if self.whole else steps(self.prediction_time or _PREDICTION)
        return before, ahead, stride


@dataclass(frozen=True)
class Preparation(Settings):
    """How earlier fits prepare the data for the last one.

    Attributes
    ----------
    faults : {"exclude", "keep"}
        Whether to exclude windows in which motors or radio failed: a first fit finds them
        (`airpuck.find_faults`), the next excludes them. Published fits keep them. There is no
        search if one window spans the whole trajectory.
    delay : {"fit", "fixed"} or None
        Whether the transport delay is learned, as a continuous parameter for all recordings;
        otherwise each recording's own delay is used, in whole samples. None: `LevenbergMarquardt`
        learns it for rungs with a motor lag, unless a recording was prepared by others: each of
        those was shifted by a different delay.
    retimings : int
        How often commands are moved to the arrival of their packets, and velocities smoothed with
        the model, using the previous fit (`airpuck.identification.retiming`). Applies if the delay
        is learned and motors lag.

    Examples
    --------
    >>> keep = airpuck.Preparation(faults="keep", delay="fixed")
    >>> airpuck.identify(trajectory, "M0", preparation=keep).exclusion is None
    True
    """

    HEADING: ClassVar = "Preparation of the recordings"

    faults: Annotated[
        Literal["exclude", "keep"],
        Setting("Exclude or keep spans where motors or the radio failed."),
    ] = "exclude"
    delay: Annotated[
        Literal["fit", "fixed"] | None,
        Setting(
            "Fit the transport delay, or use each recording's own. By default it is fitted if the "
            "method is Levenberg-Marquardt, the model has a motor lag, and the recordings are raw."
        ),
    ] = None
    retimings: int = 2
