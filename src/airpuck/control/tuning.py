"""The tuning of the tracking controller, as a TOML file."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import (
    Fraction,
    NonNegative,
    Positive,
    Section,
    checked,
    laid_over,
    load_toml,
    read_packaged,
    write_toml,
)
from airpuck.boundary.kinds import unknown
from airpuck.control.laws import check_law
from airpuck.deviation.time_scale import patience
from airpuck.estimate.axis_filter import Noise
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Cameras

#: Estimators by name.
ESTIMATORS = ("kalman", "actuation")
#: A craft that takes this many times as long for the same motion needs a slower controller: one
#: actuator accelerates it by less than 0.9 m/s².
_SLOW = 2.0
#: Speeds on the way to a set point, at which errors of stamps become errors of poses: half of the
#: largest ones of the paper's flights [m/s, rad/s].
_FLOWN_SPEED, _FLOWN_SPIN = 0.4, 2.0
#: Limits on steps of a horizon and on discs: with more, a prediction takes longer than a period.
MOST_STEPS, _MOST_DISCS = 80, 8

# Beyond these bounds the Riccati equation cannot be solved in double precision.
Weight = Annotated[float, pydantic.Field(ge=0, le=1e6)]
PositiveWeight = Annotated[float, pydantic.Field(ge=1e-6, le=1e6)]


class Weights(Section):
    """Weights of the linear-quadratic regulator, on squared errors and inputs.

    From 1e-6 to 1e6; weights of the rates may be zero.
    """

    #: Weights of x and y [1/m²], vx and vy [s²/m²], γ [1/rad²], ω [s²/rad²].
    position: PositiveWeight
    speed: Weight
    yaw: PositiveWeight
    spin: Weight
    #: Weights of ax and ay [s⁴/m²], ω' [s⁴/rad²].
    acceleration: PositiveWeight
    angular_acceleration: PositiveWeight

    @property
    def errors(self) -> Float[np.ndarray, " 6"]:
        """Weights of x, y, γ and their rates."""
        pose, rates = [self.position, self.position, self.yaw], [self.speed, self.speed, self.spin]
        return np.array(pose + rates)

    @property
    def efforts(self) -> Float[np.ndarray, " 3"]:
        """Weights of the accelerations of x, y and γ."""
        return np.array([self.acceleration, self.acceleration, self.angular_acceleration])


class Allocation(Section):
    """Settings of the thrust allocation."""

    #: Quadratic programming solver.
    solver: Literal["daqp", "piqp"] = "daqp"
    #: μ: cost of scaling a request down, relative to thrust; at most 1e10.
    slack_weight: Annotated[float, pydantic.Field(gt=0, le=1e10)] = 1e6


class PredictiveWeights(Weights):
    """Weights of the predictive law: those of the LQR, and one for the commands."""

    #: Weight of commands above idle.
    command: PositiveWeight = 0.05


class SoftLimits(Section):
    """Limits of the predictive law besides the motors'; exceeded only if unavoidable."""

    #: Area in which the craft's centre may be: lowest x and y, highest x and y. By default the
    #: table minus the craft's radius and a margin.
    fence_m: tuple[float, float, float, float] | None = None
    #: Smallest distance of the craft's edge from the rails.
    margin_m: NonNegative = 0.004
    #: A moving craft must also be inside the fence this much later, because commands may get lost.
    headway_s: Annotated[float, pydantic.Field(ge=0, le=1)] = 0.05
    #: Limits along the planned trajectory.
    speed_m_s: Positive | None = None
    spin_rad_s: Positive | None = None
    #: Discs to keep out of: x and y of the centre, and the smallest distance of the craft's centre.
    keep_out_m: Annotated[
        tuple[tuple[float, float, Positive], ...], pydantic.Field(max_length=_MOST_DISCS)
    ] = ()
    #: Cost of exceeding a limit by a metre, metre per second or radian per second.
    penalty: Annotated[float, pydantic.Field(ge=1, le=1e8)] = 1e4

    @pydantic.field_validator("fence_m")
    @classmethod
    def _right_way_up(
        cls, fence: tuple[float, float, float, float] | None
    ) -> tuple[float, float, float, float] | None:
        if fence is not None and not (fence[0] < fence[2] and fence[1] < fence[3]):
            raise ValueError("must be lowest x and y, then highest x and y: [-1.0, -0.5, 1.0, 0.5]")
        return fence


def _listed(value: Any) -> Any:
    """Accept a single number as a list of one."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


class LawSettings(Section):
    """Choice of the law, and settings of the predictive one."""

    #: ``lqr``, ``mpc`` or a law of your own; what follows is for ``mpc``.
    kind: Annotated[str, pydantic.AfterValidator(check_law)] = "lqr"
    #: Length of the prediction, in steps of step_s; at most 80 steps.
    horizon_s: Annotated[float, pydantic.Field(ge=0.02, le=5.0)] = 0.6
    step_s: Annotated[float, pydantic.Field(ge=1e-3, le=0.1)] = 0.02
    #: Number of steps per command, block after block; the last number repeats. A single number
    #: applies to all blocks.
    block: Annotated[
        tuple[Annotated[int, pydantic.Field(ge=1, le=50)], ...],
        pydantic.Field(min_length=1, max_length=80),
        pydantic.BeforeValidator(_listed),
    ] = (1, 1, 2, 2, 3)
    #: Largest number of solver iterations.
    iterations: Annotated[int, pydantic.Field(ge=1, le=10_000)] = 400
    weights: PredictiveWeights
    limits: SoftLimits = SoftLimits()

    @pydantic.model_validator(mode="after")
    def _in_time(self) -> LawSettings:
        if self.step_s > self.horizon_s:
            raise ValueError(
                f"step_s = {self.step_s:g} is longer than horizon_s = {self.horizon_s:g}; use a "
                "shorter step or a longer horizon"
            )
        steps = round(self.horizon_s / self.step_s)
        if steps > MOST_STEPS:
            raise ValueError(
                f"horizon_s / step_s is {steps} steps; at most {MOST_STEPS} can be predicted in "
                "time: use a longer step or a shorter horizon"
            )
        return self


class Estimation(Section):
    """The state estimator and its noise assumptions."""

    #: Whether to assume that motors follow their commands, or to estimate the effectiveness of
    #: each.
    estimator: Literal["kalman", "actuation"] = "kalman"
    #: Poses per second; by default as in the recordings that the model was identified from.
    camera_hz: Positive | None = None
    #: Standard deviation of the motion capture.
    position_m: Positive
    yaw_rad: Positive
    #: White noise of the acceleration that the model does not explain [m/s²/√Hz, rad/s²/√Hz].
    acceleration_density: Positive
    angular_acceleration_density: Positive
    #: White noise that drives the disturbance acceleration: how fast it changes [m/s³/√Hz,
    #: rad/s³/√Hz]. Zero disables the estimate of a disturbance.
    disturbance_density: NonNegative
    angular_disturbance_density: NonNegative
    #: Standard deviation of the on-board sensors, if present; from their descriptions, not
    #: verified.
    imu_acceleration_m_s2: Positive = 0.35
    gyro_rad_s: Positive = 0.015
    mouse_m_s: Positive = 1e-2
    #: For ``actuation``: how long an estimate of a motor remains valid.
    forgetting_s: Positive = 3.0

    @property
    def noise(self) -> Noise:
        """The noise in the filter's form."""
        pairs = (
            (self.position_m, self.yaw_rad),
            (self.acceleration_density, self.angular_acceleration_density),
            (self.disturbance_density, self.angular_disturbance_density),
        )
        return Noise(*((linear, linear, angular) for linear, angular in pairs))


class Modulation(Section):
    """Conversion of the duty cycles of on/off thrusters to pulses."""

    #: Form of the pulses.
    kind: Literal["pulse_width", "sigma_delta"] = "pulse_width"
    #: Period of the pulses, for a craft that takes switches.
    period_s: Annotated[float, pydantic.Field(ge=0.01, le=2)] = 0.1


class Tuning(Section):
    """All settings of the controller that are chosen instead of identified.

    Attributes
    ----------
    period_s : float
        Time between commands, from 1e-3 to 0.1.
    weights : Weights
        Weights of the linear-quadratic regulator.
    law : LawSettings
        The law: linear-quadratic or predictive, with its settings.
    allocation : Allocation
        Settings of the thrust allocation.
    estimation : Estimation
        Settings of the state estimator.
    modulation : Modulation
        Pulses of on/off thrusters; without effect on propellers.
    least_command : float, default 0
        Lowest command of a law, if above the vehicle's. Motors that never rest need not start, and
        some starts fail.

    Examples
    --------
    >>> from airpuck.control.tuning import default_tuning
    >>> tuning = default_tuning()
    >>> isinstance(tuning, airpuck.Tuning), tuning.period_s
    (True, 0.01)
    >>> tuning.save("tuning.toml")
    """

    period_s: Annotated[float, pydantic.Field(ge=1e-3, le=0.1)] = 0.01
    weights: Weights
    allocation: Allocation = Allocation()
    law: LawSettings
    estimation: Estimation
    modulation: Modulation = Modulation()
    least_command: Fraction = 0.0

    def turning(self, model: Model) -> Model:
        """Return the model of a craft whose motors take no command below `least_command`.

        Parameters
        ----------
        model : Model
            The craft.

        Returns
        -------
        Model
            The model for a law.

        Raises
        ------
        InputError
            If the craft cannot take the command.
        """
        vehicle = model.vehicle
        if self.least_command <= vehicle.command_min:
            return model
        if self.least_command >= vehicle.command_max or vehicle.actuation.kinds != ("propeller",):
            problem = f"{vehicle.name!r} needs propellers that take more than the least command"
            raise InputError(problem, field="least_command")
        turning = vehicle.model_copy(update={"command_min": self.least_command})
        return replace(model, vehicle=turning)

    def with_estimator(self, estimator: str) -> Tuning:
        """Return the tuning with another estimator.

        Parameters
        ----------
        estimator : str
            One of `ESTIMATORS`.

        Returns
        -------
        Tuning
            A copy.

        Raises
        ------
        InputError
            If the name is unknown.
        """
        if estimator not in ESTIMATORS:
            raise InputError(unknown(estimator, ESTIMATORS), field="estimation.estimator")
        changed = self.estimation.model_copy(update={"estimator": estimator})
        return self.model_copy(update={"estimation": changed})

    def with_law(self, kind: str) -> Tuning:
        """Return the tuning with another law.

        Parameters
        ----------
        kind : str
            One of `airpuck.control.laws.LAWS`, or FILE.py:NAME.

        Returns
        -------
        Tuning
            A copy.

        Raises
        ------
        InputError
            If the name is unknown.
        """
        try:
            check_law(kind)
        except InputError as error:
            raise InputError(error.problem, field="law.kind") from error
        return self.model_copy(update={"law": self.law.model_copy(update={"kind": kind})})

    def slowed(self, times: float) -> Tuning:
        """Return the tuning for a craft that takes `times` as long for the same motion.

        Rates are then lower by this factor, accelerations by its square. The law's and the filter's
        poles slow down with them.

        Parameters
        ----------
        times : float
            Ratio of the durations, such as `airpuck.deviation.time_scale.patience`.

        Returns
        -------
        Tuning
            A copy. The periods and the predictive law's horizon remain.
        """
        powers = {"speed": 2, "spin": 2, "acceleration": 4, "angular_acceleration": 4}
        powers |= {"acceleration_density": -1.5, "angular_acceleration_density": -1.5}
        powers |= {"disturbance_density": -2.5, "angular_disturbance_density": -2.5}
        changed = {}
        for name in ("weights", "estimation"):
            section = getattr(self, name)
            scaled = {key: v * times ** powers[key] for key, v in section if key in powers}
            changed[name] = section.model_copy(update=scaled)
        return self.model_copy(update=changed)

    def with_camera(self, rate_hz: float) -> Tuning:
        """Return the tuning for a camera, unless it states its own rate.

        Parameters
        ----------
        rate_hz : float
            Poses per second.

        Returns
        -------
        Tuning
            A copy.
        """
        changed = {"camera_hz": self.estimation.camera_hz or rate_hz}
        estimation = self.estimation.model_copy(update=changed)
        return self.model_copy(update={"estimation": estimation})

    def with_noise_of(self, cameras: Cameras) -> Tuning:
        """Return the tuning for the noise of some cameras, if it exceeds the tuning's own.

        Parameters
        ----------
        cameras : Cameras
            Noise and stamp errors; the latter count at the speeds of a flight.

        Returns
        -------
        Tuning
            A copy.
        """
        own, jitter = self.estimation, cameras.stamp_jitter_s
        changed = {
            "position_m": math.hypot(cameras.position_noise_m, _FLOWN_SPEED * jitter),
            "yaw_rad": math.hypot(cameras.yaw_noise_rad, _FLOWN_SPIN * jitter),
        }
        changed = {name: max(noise, getattr(own, name)) for name, noise in changed.items()}
        return self.model_copy(update={"estimation": own.model_copy(update=changed)})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the tuning as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        content = self.model_dump(mode="json", exclude_none=True)
        write_toml(path, content, header="An airpuck controller tuning.")


def read_tuning(path: str | os.PathLike[str], model: Model | None = None) -> Tuning:
    """Read a tuning file.

    Parameters
    ----------
    path : path-like
        A TOML file; omitted fields keep the values of the default tuning.
    model : Model, optional
        The controller's model, to which the default is adapted; without it, the packaged tuning.

    Returns
    -------
    Tuning
        The tuning.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("tuning.toml").write_text('law.kind = "mpc"')
    >>> airpuck.read_tuning("tuning.toml").law.kind
    'mpc'
    """
    usual, content = default_tuning() if model is None else tuning_for(model), load_toml(path)
    if "regulator" in content and "law" not in content:  # of older files
        content["law"] = content.pop("regulator")
    return checked(laid_over(usual.model_dump(mode="json"), content), Tuning, file=path)


def default_tuning() -> Tuning:
    """Return the packaged tuning, which is close to the tuning of the paper's experiment.

    Returns
    -------
    Tuning
        Of the LQR; see `Tuning.with_law`.

    Examples
    --------
    >>> airpuck.default_tuning().period_s
    0.01
    """
    return read_packaged("tuning.toml", Tuning)


def tuning_for(model: Model) -> Tuning:
    """Return the packaged tuning, adapted to a craft and its cameras: every controller's default.

    A craft that is much slower than the paper's gets a slower controller. A craft that has its own
    PWM gets one duty cycle for each of its periods; the predictive law's steps are then no shorter,
    and as many. The estimator expects the noise that the model's recordings showed, if it is
    larger than the packaged noise.

    Parameters
    ----------
    model : Model
        The controller's model.

    Returns
    -------
    Tuning
        The tuning.
    """
    slower, kind = patience(model.vehicle), model.vehicle.actuation.kind
    tuning = default_tuning().slowed(slower) if slower > _SLOW else default_tuning()
    if model.cameras is not None:
        tuning = tuning.with_noise_of(model.cameras)
    period = kind.pwm_period_s
    if period is None:
        return tuning
    law = tuning.law
    longer = max(period / law.step_s, 1.0)
    times = {"step_s": longer * law.step_s, "horizon_s": longer * law.horizon_s}
    return tuning.model_copy(update={"period_s": period, "law": law.model_copy(update=times)})
