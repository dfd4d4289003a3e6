"""Ranges of user-supplied numbers, and display of fractions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from airpuck.boundary.errors import InputError


@dataclass(frozen=True)
class Range:
    """The lowest and highest number that makes sense, and why no other does."""

    low: float
    high: float
    #: The reason, as half a sentence.
    why: str
    unit: str = ""
    #: Whether the lowest number itself is excluded.
    above: bool = False

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.above:
            return f"above {_text(self.low)}, at most {_text(self.high)}{unit}"
        return f"{_text(self.low)} to {_text(self.high)}{unit}"

    def check(self, value: float, field: str) -> None:
        """Raise InputError for nan or a number out of the range."""
        if not isinstance(value, Real):
            raise InputError(f"must be a number, not {value!r}", field=field)
        inside = self.low < value <= self.high if self.above else self.low <= value <= self.high
        if not inside:
            words = str(self) if self.above else f"from {self}"
            raise InputError(f"must be {words}: {self.why}", field=field)


def check_finite(**given: float) -> None:
    """Raise InputError that names the first number that is nan or infinite."""
    for name, value in given.items():
        if not (isinstance(value, Real) and math.isfinite(value)):
            raise InputError(f"must be a finite number, not {value!r}", field=name)


def percent(share: float, otherwise: str = "not determined") -> str:
    """Write a fraction, or a relative error, in percent: to two digits if it is small."""
    if not math.isfinite(share):
        return otherwise
    return f"{100 * share:#.2g} %" if abs(share) < 0.0995 else f"{100 * share:.0f} %"


def _text(number: float) -> str:
    """Write a number without unnecessary digits."""
    if abs(number) < 1e6:
        return f"{number:g}"
    mantissa, exponent = f"{number:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"


#: Upper limits of numbers in files, by the unit at the end of their names: far beyond any craft,
#: table, motor or flight, and far from where squares overflow. Time stamps count from 1970.
_LARGEST = dict.fromkeys(("_m_s2", "_rad_s", "_1_s", "_m_s", "_deg", "_rad", "_hz", "_N"), 1e5)
_LARGEST |= {"_kg_m2": 1e6, "_kg": 1e4, "_m": 1e4, "_ns": 2.0**64, "_s": 1e10}
_LARGEST_OF_ALL = 1e15


def check_size(name: str, value: object) -> None:
    """Raise ValueError for a number, or one in a list, that is too large for its unit."""
    if isinstance(value, tuple | list):
        for one in value:
            check_size(name, one)
    elif isinstance(value, int | float):
        most = next((m for unit, m in _LARGEST.items() if name.endswith(unit)), _LARGEST_OF_ALL)
        if abs(value) > most:
            raise ValueError(f"{name} = {value:g} must be within ±{_text(most)}")


# Ranges for flights and recordings.
FLIGHT_DURATION = Range(
    0.01, 3600, "at least one command, at most an hour, which is a million poses", "s"
)
LIVE_DURATION = Range(0.01, 604_800, "a command on the graph runs for a week at most", "s")
DESIGN_DURATION = Range(6, 3600, "several blocks of time, and at most an hour", "s")
DWELL = Range(0.1, 1000, "a craft needs about a second to reach a set point", "s")
HOLD = Range(0.001, 60, "signals that change more rarely do not excite the craft", "s")
AMPLITUDE = Range(0, 1, "commands go from 0 to 1", above=True)
SIGNAL = Range(0, 1, "commands go from 0 to 1")
COORDINATE = Range(-100, 100, "the table is a few metres long, and yaw a few turns at most")
DISTANCE = Range(0, 100, "the table is a few metres long", "m", above=True)
MARGIN = Range(0, 1, "the table is about a metre wide", "m", above=True)
DELAY = Range(0, 0.5, "radios take about 10 ms", "s")
RESERVE = Range(0, 0.9, "with less than a tenth of its thrust a craft barely moves")
SPIN_LIMIT = Range(0.1, 40, "a lower limit prevents turning; cameras lose a faster craft", "rad/s")
SPEED_LIMIT = Range(0.01, 20, "the table is a few metres long", "m/s")
CLEARANCE = Range(0, 1, "the table is about a metre wide", "m")
SMOOTHING = Range(0, 0.01, "with more, commands barely change in a second", "s²")
INTERVALS = Range(10, 400, "fewer miss switches, and more take minutes")
PULSE_ROUNDS = Range(1, 100, "the battery lasts for a few minutes")
SEED = Range(0, 2**63 - 1, "seeds have 64 bits")
GAME_SEED = Range(0, 2**62 - 1, "each side has its own 64-bit seed")
DOMAIN = Range(0, 232, "each DDS domain has its own ports, from 7400 + 250 per domain on")
PORT = Range(1, 65_535, "TCP has 65535 ports")
PAGE_PORT = Range(0, 65_535, "TCP has 65535 ports; with 0 there is no page")
GAMES = Range(1, 100_000, "each takes about a minute of one core")
GOALS = Range(1, 1000, "someone must be able to win")
GAME_TIME = Range(0.01, 1e6, "at least one step, at most some days", "s")
PAUSE = Range(0, 1e10, "pauses cannot be negative", "s")
WORKERS = Range(1, 1024, "each is a process of its own")

# Ranges for fits and evaluations.
SHARE = Range(0, 1, "parts of a recording are given as fractions of its length")
STRIDE = Range(1, 10_000, "more samples than a flight has would leave no window", "samples")
WINDOW = Range(0.001, 60, "at least a sample; predictions of a minute are pure noise", "s")
HORIZON = Range(0.001, 10, "predictions beyond a few seconds are pure noise", "s")
SPACING = Range(0, 60, "windows farther apart leave most of a flight out", "s")
DEGREE = Range(1, 9, "higher powers are indistinguishable")
WEIGHT = Range(0, 1e6, "with more, no other error counts")
REPLICATES = Range(10, 100_000, "fewer give no interval, and each takes most of a second")
EPISODES = Range(1, 100_000, "each takes a few seconds")
CHECK_FLIGHTS = Range(1, 1000, "each takes several seconds")
CRAFT_SPREAD = Range(0, 1, "with more, thrusts differ by more than a factor of e")
LAGS = Range(5, 1000, "fewer reveal nothing, and no effect lasts longer than a few seconds")

# Ranges for pictures.
SPEED = Range(0.001, 1000, "at other speeds nothing can be seen")
FRAME_RATE = Range(0.01, 50, "a GIF shows a frame for 0.02 s to a few minutes", "per second")
TABLE_SIDE = Range(0, 100, "the table is a few metres long", "m", above=True)
