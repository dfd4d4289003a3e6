"""Errors of a model by name: which count, and which are significant.

With enough data any model is wrong. So errors are tested against the smallest relevant one instead
of zero (Murphy and Myors 1999), and only if the data would have shown a larger one. All are
estimated together. Standard errors come from blocks of time, since the effect of a late packet
lasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import Result, plain

#: Level of all tests of one kind together. Their p-values are adjusted by `holm`.
LEVEL = 0.01
#: 99.5 % quantile of the normal distribution: half of a 99 % band, in standard deviations.
BAND = 2.5758293035489004
#: Errors that are times.
_TIMES = ("delay", "lag")


@dataclass(frozen=True)
class Thresholds:
    """Errors that count: of motors and mass, relative to the model [1]; of times [s]."""

    #: Largest errors that do not count.
    least: tuple[float, float]
    #: Errors that a test must be able to show: otherwise nothing is tested.
    shown: tuple[float, float]
    #: Largest probability by chance of an error that is reported.
    level: float


#: Errors of a model in a recording (`resid`).
IN_RECORDING = Thresholds((0.05, 0.005), (0.2, 0.01), LEVEL)
#: Errors in flight (`watch`), which are tested every second, at about four standard deviations;
#: with three, one of 55 healthy flights gave an alarm (`studies/false_alarms.py`). Above
#: standard deviations of 5 % and 2.5 ms, commands change too little for a judgement: estimates then
#: follow the noise of the poses.
IN_FLIGHT = Thresholds((0.1, 0.003), (0.23, 0.0094), 3e-4)


def judged(
    value: Float[np.ndarray, " K"],
    error: Float[np.ndarray, " K"],
    degrees: float,
    least: Float[np.ndarray, " K"],
    shown: Float[np.ndarray, " K"],
) -> tuple[Bool[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Return which values could be tested, and adjusted p-values for errors below the `least`."""
    from scipy.special import stdtr

    tested = shown - BAND * error > least
    p_values = stdtr(min(max(degrees, 1), 1e9), -(np.abs(value) - least) / error)
    adjusted = np.ones(len(value))
    adjusted[tested] = holm(p_values[tested])
    return tested, adjusted


def holm(p_values: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """Adjust p-values so that the chance of any false alarm among them stays below the level.

    The step-down procedure of Holm (1979): the smallest is multiplied by K, the next by K - 1, ….
    The tests need not be independent.
    """
    order = np.argsort(p_values, kind="stable")
    stepped = p_values[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty(len(p_values))
    adjusted[order] = np.minimum(np.maximum.accumulate(stepped), 1.0)
    return adjusted


@dataclass(frozen=True)
class ModelError(Result):
    """One possible error of a model."""

    JSON = "name tested passed p_value"

    #: A motor's name, ``mass``, ``lag``, or ``delay``, which includes the mean delay of the lag.
    name: str
    #: Relative excess strength of a motor, or excess of translation over rotation [1]; extra delay
    #: of commands, or of slower motors [s].
    value: float
    standard_error: float
    #: Smallest error that counts [1, s].
    least: float
    #: Whether the commands would have revealed a relevant error.
    tested: bool
    #: P-value for an error smaller than `least`, adjusted for all tests (Holm).
    p_value: float
    #: Fraction of the squared residual that it alone explains.
    share: float = 0.0
    #: Level of the test.
    level: float = LEVEL

    @property
    def passed(self) -> bool:
        """Whether no error is significant."""
        return not self.tested or self.p_value >= self.level

    @property
    def size(self) -> str:
        """The absolute value in words."""
        unit, factor = (" ms", 1e3) if self.name in _TIMES else (" %", 100.0)
        return f"{factor * abs(self.value):.1f}{unit} ± {factor * self.standard_error:.1f}{unit}"

    @property
    def verdict(self) -> str:
        """One sentence on a significant error."""
        less = self.value < 0
        if self.name == "delay":
            when, what = ("earlier", "large") if less else ("later", "small")
            return (
                f"commands act {self.size} {when} than modelled: is the model's delay or lag too "
                f"{what}?"
            )
        if self.name == "lag":
            how = "faster" if less else "slower"
            return f"motors follow {self.size} {how} than modelled, in addition to any delay"
        word = "less" if less else "more"
        if self.name == "mass":
            how = "light" if less else "heavy"
            return (
                f"motors move the craft {self.size} {word} than modelled, compared with how they "
                f"turn it: is the model too {how}?"
            )
        return f"{self.name} gives {self.size} {word} than modelled"

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``value`` and ``standard_error``, relative to the model; of times with the suffix
        ``_s``.
        """
        unit = "_s" if self.name in _TIMES else ""
        sizes = {f"value{unit}": self.value, f"standard_error{unit}": self.standard_error}
        return super().to_json() | plain(sizes)


def tested_errors(
    names: Sequence[str],
    value: Float[np.ndarray, " K"],
    error: Float[np.ndarray, " K"],
    degrees: float,
    limits: Thresholds,
    *,
    delay_known: float = 0.0,
    share: Float[np.ndarray, " K"] | None = None,
) -> tuple[ModelError, ...]:
    """Name and test errors of a model.

    Their standard errors have the `degrees` of freedom. A delay that was estimated from the
    recording has the standard error `delay_known` [s].
    """
    timing = np.array([name in _TIMES for name in names])
    known = delay_known * np.array([name == "delay" for name in names])
    least, shown = (
        np.where(timing, *limit[::-1]) + known for limit in (limits.least, limits.shown)
    )
    tested, p_values = judged(value, error, degrees, least, shown)
    shares = np.zeros(len(names)) if share is None else share
    figures = zip(names, value, error, least, tested, p_values, shares, strict=True)
    return tuple(
        ModelError(
            name, float(v), float(d), float(s), bool(able), float(p), float(part), limits.level
        )
        for name, v, d, s, able, p, part in figures
    )


def verdicts(errors: Sequence[ModelError]) -> list[str]:
    """Return sentences on errors that were found, not tested, or ruled out."""
    shown = sorted((e for e in errors if not e.passed), key=lambda e: e.p_value)
    motors = [e for e in errors if e.name not in (*_TIMES, "mass")]
    failed = [e for e in motors if not e.passed]
    said = [e.verdict for e in shown if e not in failed]
    alike = len({e.value > 0 for e in failed}) == 1 and len(failed) == len(motors) > 1
    if alike:
        mean = 100 * float(np.mean([e.value for e in motors]))
        word = "less" if mean < 0 else "more"
        said.append(
            f"all motors give {word} than modelled, {abs(mean):.0f} % on average: thrust, or mass "
            "and inertia alike?"
        )
    else:
        said += [e.verdict for e in shown if e in failed]
    untested = [e for e in errors if not e.tested]
    if untested:
        said.append(
            "not tested, since the commands do not reveal them: "
            + ", ".join(f"{e.name} (± {_half_band(e)})" for e in untested)
        )
    fine = [e.name for e in errors if e.tested and e.passed]
    if fine:
        share, time = 100 * IN_RECORDING.least[0], 1e3 * IN_RECORDING.least[1]
        said.append(f"no error above {share:.0f} % or {time:.0f} ms is shown of " + ", ".join(fine))
    return said


def _half_band(error: ModelError) -> str:
    """Write half the 99 % interval."""
    half = BAND * error.standard_error
    return f"{1e3 * half:.0f} ms" if error.name in _TIMES else f"{100 * half:.0f} %"
