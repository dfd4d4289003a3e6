"""The tuning of the tracking controller, as a TOML file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import pydantic

from airpuck.boundary.errors import InputError, about, unknown
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
from airpuck.control.laws import LAWS, check_law, law_class, name_among
from airpuck.deviation.time_scale import lateness, patience
from airpuck.estimate.axis_filter import Noise
from airpuck.model.model_file import Model
from airpuck.model.uncertainty import Cameras

#: Estimators by name.
ESTIMATORS = ("kalman", "actuation", "learning")
#: A craft that takes this many times as long for the same motion needs a slower controller: one
#: actuator accelerates it by less than 0.9 m/s².
_SLOW = 2.0
#: Speeds on the way to a set point, at which errors of stamps become errors of poses: half of the
#: largest ones of the paper's flights [m/s, rad/s].
_FLOWN_SPEED, _FLOWN_SPIN = 0.4, 2.0


class LawSettings(Section):
    """Settings of a law: the table ``[law.NAME]`` of a tuning file.

    A law names the subclass that it uses as `Law.Settings`.

    Attributes
    ----------
    law : str
        Name of the law; for a law in a file, the name of its class.
    tuned : tuple of str
        Settings that `airpuck.tune` may change, such as "weights.position": positive numbers.

    Examples
    --------
    >>> class Stiffness(airpuck.LawSettings):
    ...     law = "Spring"
    ...     stiffness: float = 8.0
    ...
    >>> airpuck.default_tuning().of(Stiffness).stiffness
    8.0
    """

    law: ClassVar[str]
    tuned: ClassVar[tuple[str, ...]] = ()

    def slowed(self, times: float) -> Self:
        """Return the settings for a slower craft.

        Parameters
        ----------
        times : float
            How many times as long the craft takes for the same motion.

        Returns
        -------
        LawSettings
            By default unchanged.
        """
        return self

    def held(self, period_s: float) -> Self:
        """Return the settings for a craft that takes one command in each of its own periods.

        Parameters
        ----------
        period_s : float
            This period [s].

        Returns
        -------
        LawSettings
            By default unchanged.
        """
        return self


OwnSettings = TypeVar("OwnSettings", bound=LawSettings)
Scaled = TypeVar("Scaled", bound=Section)


class ChosenLaw(Section):
    """Choice of the law, and a table of settings for each that has some."""

    model_config = pydantic.ConfigDict(extra="allow")

    #: ``lqr``, ``mpc`` or a law of your own.
    kind: Annotated[str, pydantic.AfterValidator(check_law)] = "lqr"

    @pydantic.model_validator(mode="after")
    def _of_known_laws(self) -> Self:
        for name, table in self.tables.items():
            with about(None, lambda field, name=name: ".".join(filter(None, (name, field)))):
                self.tables[name] = _plain(checked(table, _settings_of(name, table)))
        return self

    @property
    def tables(self) -> dict[str, Any]:
        """The settings by law, as in a file."""
        return self.__pydantic_extra__ or {}


def _settings_of(name: str, table: Any) -> type[LawSettings]:
    """Return the class of a law's settings; raise InputError if no law has this name."""
    try:
        if not isinstance(table, Mapping):
            raise InputError("is not a known key; check its spelling")
        found = getattr(law_class(name), "Settings", None)
    except InputError as error:
        classes = {law: getattr(law_class(law), "Settings", None) for law in LAWS}
        near = [law for law, kind in classes.items() if kind and name in kind.model_fields]
        if not near:
            raise
        # Older files had the settings of the predictive law here.
        key = f"law.{'mpc' if 'mpc' in near else near[0]}.{name}"
        told = f"is now written [{key}]" if isinstance(table, Mapping) else f"is now written {key}"
        raise InputError(told) from error
    if found:
        return found
    raise InputError("this law has no settings; leave the table out")


def _plain(settings: LawSettings) -> dict[str, Any]:
    return settings.model_dump(mode="json", exclude_none=True)


class Estimation(Section):
    """The state estimator and its noise assumptions."""

    #: Whether to assume that motors follow their commands, to estimate the effectiveness of each,
    #: or also to learn what lasts, and the delay.
    estimator: Literal["kalman", "actuation", "learning"] = "kalman"
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
    #: For ``actuation`` and ``learning``: how long an estimate of a failing motor remains valid.
    forgetting_s: Positive = 3.0
    #: For ``learning``: time after which what was learned is as uncertain as before.
    learned_s: Positive = 120.0

    @property
    def noise(self) -> Noise:
        """The noise in the filter's form."""
        pairs = (
            (self.position_m, self.yaw_rad),
            (self.acceleration_density, self.angular_acceleration_density),
            (self.disturbance_density, self.angular_disturbance_density),
        )
        return Noise(*((linear, linear, angular) for linear, angular in pairs))


def scaled(section: Scaled, powers: Mapping[str, float], times: float) -> Scaled:
    """Multiply fields of a section by powers of a number."""
    changed = {key: value * times ** powers[key] for key, value in section if key in powers}
    return section.model_copy(update=changed)


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
    law : ChosenLaw
        The law, and the settings of each; see `of`.
    estimation : Estimation
        Settings of the state estimator.
    modulation : Modulation
        Pulses of on/off thrusters; without effect on propellers.
    least_command : float, default 0
        Lowest command of a law, if above the vehicle's. Motors that never rest need no start, which
        can fail.

    Examples
    --------
    >>> tuning = airpuck.default_tuning()
    >>> isinstance(tuning, airpuck.Tuning), tuning.period_s
    (True, 0.01)
    >>> tuning.save("tuning.toml")
    """

    MOVED: ClassVar = {"weights": "[law.lqr.weights]", "allocation": "[law.lqr]"}
    MOVED |= {"regulator": "[law]", "with_regulator()": "with_law"}
    SHOWN: ClassVar[str] = "period_s law=law.kind settings=law.tables estimation modulation"
    period_s: Annotated[float, pydantic.Field(ge=1e-3, le=0.1)] = 0.01
    law: ChosenLaw
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

    def of(self, settings: type[OwnSettings]) -> OwnSettings:
        """Return the settings of a law.

        Parameters
        ----------
        settings : subclass of LawSettings
            Their class, such as `Law.Settings`.

        Returns
        -------
        LawSettings
            From the law's table; without one, their defaults.

        Raises
        ------
        InputError
            If the class does not state its law, or a setting without a default is missing.
        """
        law = getattr(settings, "law", None)
        if law is None:
            problem = 'needs law = "NAME", the law whose table it reads'
            raise InputError(problem, field=settings.__name__)
        table = name_among(self.law.tables, law, otherwise=law)
        with about(None, lambda field: f"law.{law}.{field}".rstrip(".")):
            return checked(self.law.tables.get(table, {}), settings)

    def with_law(self, kind: str, **settings: Any) -> Tuning:
        """Return the tuning with another law.

        Parameters
        ----------
        kind : str
            One of `airpuck.control.laws.LAWS`, or FILE.py:NAME.
        **settings : Any
            Settings of this law to change.

        Returns
        -------
        Tuning
            A copy.

        Raises
        ------
        InputError
            If the name is unknown.
        """
        law = {**self.law.tables, "kind": kind}
        if settings:
            new = {k: v.model_dump() if isinstance(v, Section) else v for k, v in settings.items()}
            law[kind] = {**law.get(kind, {}), **new}
        return checked({**self.model_dump(mode="json"), "law": law}, Tuning)

    def _each(self, change: Callable[[LawSettings], LawSettings]) -> ChosenLaw:
        """Return the choice of the law, with the settings of each law changed."""
        tables = {
            name: _plain(change(checked(table, _settings_of(name, table))))
            for name, table in self.law.tables.items()
        }
        return ChosenLaw(kind=self.law.kind, **tables)

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
            A copy. The periods remain.
        """
        law = self._each(lambda law: law.slowed(times))
        return self._with_slower_filter(times).model_copy(update={"law": law})

    def _with_slower_filter(self, times: float) -> Tuning:
        """Return the tuning with a filter that takes `times` as long."""
        powers = {"acceleration_density": -1.5, "angular_acceleration_density": -1.5}
        powers |= {"disturbance_density": -2.5, "angular_disturbance_density": -2.5}
        return self.model_copy(update={"estimation": scaled(self.estimation, powers, times)})

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
        return self.model_copy(update={"estimation": self.estimation.model_copy(update=changed)})

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

    A craft that is much slower than the paper's gets a slower controller. A craft with late motors
    gets a slower filter: the controller predicts over the delay and inverts the lag, and both
    enlarge the noise of the poses. A craft that has its own PWM gets one duty cycle for each of its
    periods; the predictive law's steps are then no shorter, and as many. The estimator expects the
    noise that the model's recordings showed, if it is larger than the packaged noise.

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
    slower = slower if slower > _SLOW else 1.0
    tuning = default_tuning().slowed(slower)._with_slower_filter(max(1.0, lateness(model) / slower))
    if model.cameras is not None:
        tuning = tuning.with_noise_of(model.cameras)
    period = kind.pwm_period_s
    if period is None:
        return tuning
    held = tuning._each(lambda law: law.held(period))
    return tuning.model_copy(update={"period_s": period, "law": held})
