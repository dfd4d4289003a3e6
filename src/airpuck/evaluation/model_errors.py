"""Attribution of a model's innovations to errors: of a motor, mass, delay or lag.

The innovations are regressed on the effects of all errors together. An error is reported only if it
is significantly larger than a negligible one. It is tested only if the commands would have revealed
a relevant error. Standard errors come from blocks of time, since the effect of a late packet lasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool

from airpuck.boundary.results import Result, plain
from airpuck.evaluation.late_packets import LatePackets
from airpuck.evaluation.statistical_tests import BAND, LEVEL, block_regression, holm

#: Negligible errors, and errors that a test must be able to detect: relative, and in seconds.
_SHARE, _SHARE_SHOWN = 0.05, 0.2
_DELAY, _DELAY_SHOWN = 0.005, 0.01
#: Errors that are times.
_TIMES = ("delay", "lag")
#: Length of a block [s].
_BLOCK_S = 0.5


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

    @property
    def passed(self) -> bool:
        """Whether no error is significant at the 1 % level."""
        return not self.tested or self.p_value >= LEVEL

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


def model_errors(
    motors: Sequence[str],
    late: LatePackets,
    used: Bool[np.ndarray, " N"],
    period: float,
    delay_known: float = 0.0,
) -> list[ModelError]:
    """Estimate the errors of all motors, the mass and the delay together, and test them.

    A delay estimated from the recording has the standard error `delay_known` [s].
    """
    from scipy.stats import t

    translation = late.directions[..., 2:].sum(axis=2, keepdims=True) * [[1.0], [1.0], [0.0]]
    regressors = np.concatenate([late.directions, translation], axis=2)[used]
    names = *_TIMES, *motors, "mass"
    timing = np.array([name in _TIMES for name in names])
    least = np.where(timing, _DELAY, _SHARE)
    shown = np.where(timing, _DELAY_SHOWN, _SHARE_SHOWN)
    least[0], shown[0] = least[0] + delay_known, shown[0] + delay_known
    # In units of negligible errors, so that all columns have similar scales.
    given = regressors * least, late.steady[used], period, _BLOCK_S
    values, covariance, blocks = block_regression(*given)
    deviations = np.sqrt(np.diag(covariance))
    tested = shown / least - BAND * deviations > 1
    p_values = t.sf((np.abs(values) - 1) / deviations, blocks - 1)
    adjusted = np.ones(len(names))
    adjusted[tested] = holm(p_values[tested])
    figures = zip(names, least * values, least * deviations, least, tested, adjusted, strict=True)
    return [
        ModelError(name, float(v), float(d), float(s), bool(able), float(p))
        for name, v, d, s, able, p in figures
    ]


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
        said.append(
            f"no error above {100 * _SHARE:.0f} % or {1e3 * _DELAY:.0f} ms is shown of "
            + ", ".join(fine)
        )
    return said


def _half_band(error: ModelError) -> str:
    """Write half the 99 % interval."""
    half = BAND * error.standard_error
    return f"{1e3 * half:.0f} ms" if error.name in _TIMES else f"{100 * half:.0f} %"
