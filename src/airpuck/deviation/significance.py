"""Which errors count, and which are significant: one table of thresholds, one test.

With enough data any model is wrong. So errors are tested against the smallest relevant one instead
of zero (Murphy and Myors 1999), and only if the data would have shown a larger one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

#: Level of all tests of one kind together. Their p-values are adjusted by `holm`.
LEVEL = 0.01
#: 99.5 % quantile of the normal distribution: half of a 99 % band, in standard deviations.
BAND = 2.5758293035489004


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
