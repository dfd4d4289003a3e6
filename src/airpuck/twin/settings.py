"""Everything about a twin except its model: sensors, radio, effects, faults; a TOML file."""

from __future__ import annotations

import os
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import pydantic

from airpuck.boundary.files import (
    Fraction,
    NonNegative,
    Positive,
    Section,
    read_packaged,
    read_toml,
    write_toml,
)
from airpuck.craft.table import AirHockey
from airpuck.model.quantities import EFFECTS, Pair, Triple

#: Name of the packaged settings in which starts of motors fail.
FAILING_STARTS = "paper:starts"


def _forward(interval: tuple[float, float]) -> tuple[float, float]:
    """Raise ValueError for an interval that ends before it starts."""
    if interval[0] > interval[1]:
        raise ValueError("must end after it starts")
    return interval


Interval = Annotated[tuple[NonNegative, NonNegative], pydantic.AfterValidator(_forward)]


class Radio(Section):
    """The link from the controller to the motors.

    Its defaults were measured on the switches of a real excitation (studies/likeness.md): half of
    the packets take 16 to 25 ms, nine of ten 8 to 32 ms. The timeout is a guess.
    """

    #: Mean delay of a packet; by default the transport delay of the twin's model.
    delay_s: NonNegative | None = None
    #: Its standard deviation. Delays are normal and never negative; packets do not overtake each
    #: other.
    jitter_s: NonNegative = 0.007
    #: Fraction of packets that never arrive.
    loss: Fraction = 0.0
    #: The motors stop after this long without a packet.
    timeout_s: Positive = 0.2
    #: Intervals during which nothing arrives.
    outages_s: tuple[Interval, ...] = ()


class MotionCapture(Section):
    """Cameras that measure the pose.

    Defaults as in the paper's recordings: noise at rest is 0.04 to 0.05 mm and 0.5 to 0.8 mrad, and
    poses arrive 0.4 to 4 ms after their stamp.
    """

    #: Frames per second.
    rate_hz: Positive = 240.0
    #: Standard deviations of white noise.
    position_noise_m: NonNegative = 4.5e-5
    yaw_noise_rad: NonNegative = 6.5e-4
    #: Delay from the frame to the controller; the jitter is the mean of an exponential
    #: distribution.
    latency_s: NonNegative = 0.0005
    latency_jitter_s: NonNegative = 0.0008
    #: Fraction of missing frames.
    dropped: Fraction = 0.0
    #: Intervals without frames.
    gaps_s: tuple[Interval, ...] = ()
    #: Stamps are (1 + drift) t + offset, where t is the recorder's time.
    clock_offset_s: float = 0.0
    clock_drift: float = 0.0
    #: Stamps are rounded to multiples of this; 0: exact.
    stamp_step_s: NonNegative = 0.0

    def stamped(self, time: Any) -> Any:
        """Return the stamps of frames at these times on the recorder's clock."""
        stamp = (1 + self.clock_drift) * time + self.clock_offset_s
        step = self.stamp_step_s
        return np.rint(stamp / step) * step if step else stamp


class OnBoard(Section):
    """Inertial and optical sensors on the craft; their noise is not verified."""

    #: Sampling rate of each sensor; 0: no sensor.
    rate_hz: NonNegative = 100.0
    #: Delay from the measurement to the controller.
    latency_s: NonNegative = 0.01
    #: Standard deviations of white noise.
    acceleration_noise_m_s2: NonNegative = 0.35
    gyro_noise_rad_s: NonNegative = 0.015
    mouse_noise_m_s: NonNegative = 0.01


#: Optional quantities that are effects of their own.
_EFFECTS = {
    name: q for name, q in EFFECTS.items() if q.effect is not None and not callable(q.labels)
}


def _effect_fields() -> dict[str, Any]:
    """Return one field for each coefficient of the optional physics; zero: off."""
    entries: dict[str, Any] = {}
    for q in _EFFECTS.values():
        several = {Pair: (Pair, (0.0, 0.0)), Triple: (Triple, (0.0, 0.0, 0.0))}
        entries |= dict.fromkeys(q.settings or (q.key,), several.get(q.toml, (NonNegative, 0.0)))
    return entries


class Effects(pydantic.create_model("Coefficients", __base__=Section, **_effect_fields())):
    """Optional physics (`airpuck.physics.effects`); zero: off."""

    #: Fraction of the thrust that is lost per second of flight.
    battery_sag_1_s: NonNegative = 0.0

    def coefficients(self) -> dict[str, Any]:
        """Return the coefficients of the active effects, by name."""
        values = {}
        for name, quantity in _EFFECTS.items():
            value = tuple(getattr(self, key) for key in quantity.settings or (quantity.key,))
            values[name] = value if quantity.settings else value[0]
        return {name: value for name, value in values.items() if np.any(value)}


class Stall(Section):
    """A motor that does not turn for a while."""

    #: Name of its propeller.
    motor: str
    #: Begin and end.
    start_s: NonNegative
    stop_s: NonNegative

    @pydantic.model_validator(mode="after")
    def _ends_after_it_starts(self) -> Stall:
        _forward((self.start_s, self.stop_s))
        return self


class Weakness(Stall):
    """A motor that temporarily delivers only part of its thrust."""

    #: Delivered fraction of the modelled thrust.
    share: Fraction


class Motors(Section):
    """Faults of motors that do not follow their commands."""

    #: The motors stand still until this time.
    unarmed_s: NonNegative = 0.0
    #: Delay before an idling motor begins to follow a higher command.
    starting_delay_s: NonNegative = 0.0
    #: Commands below this value count as idling.
    idle_below: Fraction = 0.05
    #: Failures.
    stalls: tuple[Stall, ...] = ()
    #: Losses of thrust; factors for the same motor multiply.
    weak: tuple[Weakness, ...] = ()


class Starts(Section):
    """Starts that fail: motors that rested and do not turn up when they are commanded to."""

    #: Rests of a motor before a start, increasing, from which on the next fractions apply.
    rest_s: tuple[NonNegative, ...] = ()
    #: Fraction of the starts that fail, for each of these; none fails after a shorter rest.
    failed: tuple[Fraction, ...] = ()
    #: A motor that failed idles until its next start, or for a time whose distribution is
    #: exponential with this mean.
    lasting_s: Positive = 0.2

    @pydantic.model_validator(mode="after")
    def _fraction_for_each_rest(self) -> Starts:
        if len(self.rest_s) != len(self.failed):
            raise ValueError("needs as many fractions in failed as rests in rest_s")
        if any(later <= rest for rest, later in pairwise(self.rest_s)):
            raise ValueError("rest_s must increase")
        return self

    def failing(self, rest: float) -> float:
        """Return the probability that a start after a rest fails [s]."""
        reached = sum(rest >= least for least in self.rest_s)
        return self.failed[reached - 1] if reached else 0.0


class TwinSettings(AirHockey):
    """Everything about a twin except the model of the craft.

    By default, sensors and radio are as in the real recordings, and nothing fails.

    Attributes
    ----------
    table : Table
        Rails and goals.
    puck : Puck
        The puck, if there is one.
    mallet : Mallet
        The human's mallet, if there is one.
    radio : Radio
        The link from the controller to the motors.
    motion_capture : MotionCapture
        Poses.
    on_board : OnBoard
        Other sensors.
    effects : Effects
        Optional physics.
    motors : Motors
        Arming, stalls.
    starts : Starts
        Starts of motors that fail, by how long the motor rested.

    Examples
    --------
    >>> settings = airpuck.TwinSettings(radio={"delay_s": 0.03})
    >>> settings.radio.delay_s, settings.radio.jitter_s, settings.motion_capture.rate_hz
    (0.03, 0.007, 240.0)
    """

    radio: Radio = Radio()
    motion_capture: MotionCapture = MotionCapture()
    on_board: OnBoard = OnBoard()
    effects: Effects = Effects()
    motors: Motors = Motors()
    starts: Starts = Starts()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the settings as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        content = self.model_dump(mode="json", exclude_none=True)
        write_toml(path, content, header="Settings of an airpuck twin.")

    def with_usual_delay(self, transport_delay: float) -> TwinSettings:
        """Return settings whose radio has a delay: its own if it states one, or else this one.

        Parameters
        ----------
        transport_delay : float
            Delay of the twin's model, for a radio without a delay of its own [s].

        Returns
        -------
        TwinSettings
            These, or a copy with that delay.
        """
        if self.radio.delay_s is not None:
            return self
        radio = self.radio.model_copy(update={"delay_s": transport_delay})
        return self.model_copy(update={"radio": radio})

    def without_on_board(self) -> TwinSettings:
        """Return settings without on-board sensors, for flights that do not use them.

        Returns
        -------
        TwinSettings
            A copy; each sample takes time.
        """
        on_board = self.on_board.model_copy(update={"rate_hz": 0.0})
        return self.model_copy(update={"on_board": on_board})


def read_twin_settings(path: str | os.PathLike[str]) -> TwinSettings:
    """Read the settings of a twin.

    Parameters
    ----------
    path : path-like
        A TOML file; omitted fields keep their defaults. ``paper:starts``: the defaults, with starts
        that fail as often as on the paper's craft.

    Returns
    -------
    TwinSettings
        The settings.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("twin.toml").write_text("radio.loss = 0.1")
    >>> airpuck.read_twin_settings("twin.toml").radio.loss
    0.1
    """
    if str(path) == FAILING_STARTS:
        return TwinSettings(starts=read_packaged("starts.toml", Starts))
    return read_toml(path, TwinSettings)


def default_twin_settings() -> TwinSettings:
    """Return the default settings: sensors and radio as in the real recordings, no faults."""
    return TwinSettings()
