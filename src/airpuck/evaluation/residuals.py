"""Residual tests on one-step innovations (Ljung 1999, ch. 16.6).

Two questions. Are the innovations white, or do past ones say something about the next? Do the
motor commands still explain them, so that the model has not used all of their information? Both
tests are made in the frame of the body, where a motor pushes one way whatever the yaw. A third asks
which error of the model that would be. Late packets and feedback are part of the null hypothesis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.data.trajectory import Trajectory, hold
from airpuck.evaluation.cross_correlation import CrossCorrelation, cross_correlations
from airpuck.evaluation.evaluate import delay_for
from airpuck.evaluation.innovations import Innovations, innovations
from airpuck.evaluation.late_packets import LatePackets, late_packets
from airpuck.evaluation.model_errors import ModelError, model_errors, verdicts
from airpuck.evaluation.statistical_tests import Whiteness, ljung_box
from airpuck.evaluation.structure import Structure, cut, find_structure, missing_accelerations
from airpuck.model.model_file import Model

#: Channels of the innovations in the frame of the body.
BODY_CHANNELS = ("forward", "left", "yaw")
#: Largest lag [samples].
LAGS = 25
#: Share of the strongest push below which there is none.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ResidualTests(Result):
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
    errors : tuple of ModelError
        Of each motor, the mass and the delay.
    structure : tuple of Structure
        What residuals depend on, for each regressor and channel.
    innovations : Innovations
        Of the filter that does not know of late packets.
    late : LatePackets
        Innovations of the filter that allows for late packets: what was tested.
    """

    JSON = (
        "model samples sample_period_s=sample_period passed verdicts noise=innovations.noise "
        "jitter_s=late.jitter whiteness cross_correlation=correlations model_errors=errors "
        "structure"
    )

    model: str
    samples: int
    sample_period: float
    whiteness: tuple[Whiteness, ...]
    correlations: tuple[CrossCorrelation, ...]
    errors: tuple[ModelError, ...]
    structure: tuple[Structure, ...]
    innovations: Innovations
    late: LatePackets

    @property
    def passed(self) -> bool:
        """Whether nothing was rejected."""
        tests = *self.whiteness, *self.correlations, *self.errors, *self.structure
        return all(test.passed for test in tests)

    @property
    def verdicts(self) -> list[str]:
        """Sentences: whiteness of each channel, motors that still explain something, and why."""
        said = [test.verdict for test in self.whiteness]
        for channel in BODY_CHANNELS:
            tests = [t for t in self.correlations if t.channel == channel and t.tested]
            failed = [test for test in tests if not test.passed]
            said += [test.verdict for test in sorted(failed, key=lambda test: test.p_value)]
            if tests and not failed:
                most = 100 * max(test.share for test in tests)
                said.append(f"no motor explains more of {channel} (at most {most:.1f} %)")
        shown = sorted((s for s in self.structure if s.shown), key=lambda s: -s.share)
        said += verdicts(self.errors) + [one.verdict for one in shown]
        if not shown:
            names = ", ".join(dict.fromkeys(one.regressor for one in self.structure))
            said.append(f"residuals depend on none of {names}")
        return said


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
        If the trajectory is of another craft, or too short for this number of lags.
    """
    n, usable = len(trajectory.propellers), int(trajectory.usable.sum())
    if lags < 5 or usable < 4 * lags * n:
        raise InputError(
            f"{lags} lags of {n} motors need at least {4 * max(lags, 5) * n} usable poses, there "
            f"are {usable}; lags can be from 5 to {usable // (4 * n)}",
            field="lags",
        )
    found = innovations(model, trajectory)
    bins = cut(trajectory, found)
    others = missing_accelerations(bins, trajectory.state[:, 2])
    late = late_packets(model, trajectory, found, others)
    motors, used = trajectory.propellers, found.used
    # A delay that the model did not learn is the recording's, found in whole samples.
    period = trajectory.sample_period
    known = 0.0 if model.delay_learned else period
    errors = model_errors(motors, late, used, period, known)
    told = {error.name for error in errors if error.tested}
    # The mean delay of the packets is judged separately.
    late_by = errors[0].value
    structure = find_structure(model, trajectory, found, late, bins, late_by)
    body = to_body(late.values, trajectory.state[:, 2])
    whiteness = tuple(
        ljung_box(name, body[:, k], used, lags, found.noise_parameters[k] - 1)
        for k, name in enumerate(BODY_CHANNELS)
    )
    acts = trajectory.command_time + delay_for(model, trajectory)
    held, effects = hold(acts, trajectory.command, trajectory.time), _effects(model)
    correlations = [
        test
        for k, name in enumerate(BODY_CHANNELS)
        for test in cross_correlations(name, body[:, k], used, held, motors, effects[k], lags, told)
    ]
    return ResidualTests(
        model=model.name,
        samples=int(found.used.sum()),
        sample_period=trajectory.sample_period,
        whiteness=whiteness,
        correlations=tuple(correlations),
        errors=tuple(errors),
        structure=tuple(structure),
        innovations=found,
        late=late,
    )


def _effects(model: Model) -> Float[np.ndarray, "3 n"]:
    """Return how each motor pushes `BODY_CHANNELS` [1/kg].

    What the cosine of a right angle leaves by rounding is no push.
    """
    effects = model.propeller_effects
    return np.where(np.abs(effects) > _ROUNDING * np.abs(effects).max(), effects, 0.0)


def to_body(
    values: Float[np.ndarray, "N 3"], yaw: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 3"]:
    """Turn x, y, γ into the frame of the body."""
    x, y, spin = values.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x, spin], axis=1)
