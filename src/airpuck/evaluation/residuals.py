"""Residual tests on one-step innovations (Ljung 1999, ch. 16.6).

Two questions. Are the innovations white, or do past ones say something about the next? Do the
motor commands still explain them, so that the model has not used all of their information? Both
tests are made in the frame of the body, where a motor pushes one way whatever the yaw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory, hold
from airpuck.evaluation.cross_correlation import (
    CrossCorrelation,
    cross_correlations,
    suspicions,
)
from airpuck.evaluation.evaluate import delay_for
from airpuck.evaluation.innovations import Innovations, innovations
from airpuck.evaluation.statistical_tests import Whiteness, ljung_box, p_text
from airpuck.model.model_file import Model

#: Channels of the innovations in the frame of the body.
BODY_CHANNELS = ("forward", "left", "yaw")
#: Largest lag [samples].
LAGS = 25
#: Share of the strongest push below which there is none.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Residual tests of one model on one trajectory.

    Attributes
    ----------
    model : str
        Name of the rung.
    samples : int
        Innovations used.
    sample_period : float
        [s].
    whiteness : tuple of Whiteness
        One for each of `BODY_CHANNELS`.
    correlations : tuple of CrossCorrelation
        For each channel, each motor that moved.
    innovations : Innovations
        What was tested.
    """

    model: str
    samples: int
    sample_period: float
    whiteness: tuple[Whiteness, ...]
    correlations: tuple[CrossCorrelation, ...]
    innovations: Innovations

    @property
    def passed(self) -> bool:
        """Whether nothing was rejected."""
        return all(test.passed for test in (*self.whiteness, *self.correlations))

    @property
    def verdicts(self) -> list[str]:
        """Sentences: whiteness of each channel, motors that still explain something, and why."""
        said = [test.verdict for test in self.whiteness]
        for channel in BODY_CHANNELS:
            tests = [test for test in self.correlations if test.channel == channel]
            failed = [test for test in tests if not test.passed]
            said += [test.verdict for test in sorted(failed, key=lambda test: test.p_value)]
            if tests and not failed:
                least = min(test.p_value for test in tests)
                said.append(f"no motor explains more of {channel} (smallest {p_text(least)})")
        return said + suspicions(self.correlations)

    def to_json(self) -> dict[str, Any]:
        """Return the figures.

        Returns
        -------
        dict
            ``model, samples, sample_period_s, passed, verdicts, noise``, and lists ``whiteness``
            and ``cross_correlation``.
        """
        noise = self.innovations.noise
        return {
            "model": self.model,
            "samples": self.samples,
            "sample_period_s": self.sample_period,
            "passed": self.passed,
            "verdicts": self.verdicts,
            "noise": {
                "pose": list(noise.pose),
                "acceleration_density": list(noise.acceleration),
                "disturbance_density": list(noise.disturbance),
            },
            "whiteness": [
                {**_figures(test), "autocorrelation": test.autocorrelation.tolist()}
                for test in self.whiteness
            ],
            "cross_correlation": [
                {
                    **_figures(test),
                    "motor": test.motor,
                    "early": test.early,
                    "correlation": test.correlation.tolist(),
                }
                for test in self.correlations
            ],
        }


def _figures(test: Whiteness | CrossCorrelation) -> dict[str, Any]:
    """Return what all tests have."""
    names = ("channel", "passed", "statistic", "p_value", "band")
    return {name: getattr(test, name) for name in names} | {"degrees_of_freedom": test.degrees}


def resid(model: Model, trajectory: Trajectory, *, lags: int = LAGS) -> ResidualTests:
    """Test the one-step innovations of a model.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Data, better other than those that it was learned from.
    lags : int, default 25
        Largest lag M [samples].

    Returns
    -------
    ResidualTests
        Whiteness and cross-correlation with the commands, each at the 1 % level.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or too short for so many lags.
    """
    n, usable = len(trajectory.propellers), int(trajectory.usable.sum())
    if lags < 5 or usable < 4 * lags * n:
        raise InputError(
            f"{lags} lags of {n} motors need at least {4 * max(lags, 5) * n} usable poses, there "
            f"are {usable}; lags can be from 5 to {usable // (4 * n)}",
            field="lags",
        )
    found = innovations(model, trajectory)
    body = to_body(found, trajectory.state[:, 2])
    whiteness = tuple(
        ljung_box(name, body[:, k], found.used, lags, found.noise_parameters[k] - 1)
        for k, name in enumerate(BODY_CHANNELS)
    )
    acts = trajectory.command_time + delay_for(model, trajectory)
    held = hold(acts, trajectory.command, trajectory.time)
    motors, effects = trajectory.propellers, _effects(model)
    correlations = [
        test
        for k, name in enumerate(BODY_CHANNELS)
        for test in cross_correlations(name, body[:, k], found.used, held, motors, effects[k], lags)
    ]
    return ResidualTests(
        model=model.name,
        samples=int(found.used.sum()),
        sample_period=trajectory.sample_period,
        whiteness=whiteness,
        correlations=tuple(correlations),
        innovations=found,
    )


def _effects(model: Model) -> Float[np.ndarray, "3 n"]:
    """Return how each motor pushes `BODY_CHANNELS` [1/kg].

    What the cosine of a right angle leaves by rounding is no push.
    """
    effects = model.propeller_effects
    return np.where(np.abs(effects) > _ROUNDING * np.abs(effects).max(), effects, 0.0)


def to_body(found: Innovations, yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"]:
    """Turn standardised innovations into the frame of the body."""
    x, y, spin = found.standardised.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x, spin], axis=1)
