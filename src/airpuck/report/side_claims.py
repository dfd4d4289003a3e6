"""Claims that the paper makes in passing, each tested again by a function of its own.

Every test fits on the training experiment only and judges on the validation experiment by the
paper's protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.gauge import physical_thrust
from airpuck.identification.fit import identify
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust_slope
from airpuck.report.full_trajectory import FullTrajectory, predict_whole_trajectory
from airpuck.report.study import Study
from airpuck.report.trial import Trial, judge

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class LargestThrusts:
    """The thrust at φ = 1 of M3 and M4, as learned and at the physical scale."""

    #: Names of the propellers.
    propellers: tuple[str, ...]
    #: F(1) of M3, of M4 as learned, and of M4 at the physical scale [N]; keys ``published`` and
    #: ``fitted``.
    first_principles: Mapping[str, Float[np.ndarray, " n"]]
    direct: Mapping[str, Float[np.ndarray, " n"]]
    direct_scaled: Mapping[str, Float[np.ndarray, " n"]]

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        return {
            "propellers": list(self.propellers),
            **{
                kind: {
                    "M3_N": self.first_principles[kind].tolist(),
                    "M4_as_learned_N": self.direct[kind].tolist(),
                    "M4_scaled_N": self.direct_scaled[kind].tolist(),
                }
                for kind in self.first_principles
            },
        }


@dataclass(frozen=True, eq=False)
class SideClaims:
    """All side claims."""

    #: M3 with thrust polynomials of rising degree.
    degrees: tuple[Trial, ...]
    #: Fits whose thrust curves are free to fall.
    unconstrained: tuple[Trial, ...]
    #: Batched against full-trajectory loss.
    full_trajectory: FullTrajectory
    #: M4's largest thrust against M3's.
    largest_thrusts: LargestThrusts

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        return {
            "degrees": [trial.to_json() for trial in self.degrees],
            "unconstrained": [trial.to_json() for trial in self.unconstrained],
            "full_trajectory": self.full_trajectory.to_json(),
            "largest_thrusts": self.largest_thrusts.to_json(),
        }


def try_degrees(
    training: Trajectory,
    validation: Trajectory,
    *,
    degrees: Sequence[int] = (1, 2, 3, 4, 5),
    say: Say = lambda _: None,
) -> tuple[Trial, ...]:
    """Fit M3 with thrust polynomials of several degrees.

    The paper: "We tested different polynomials up to degree five but found a 3rd-order polynomial
    works best for our system."
    """
    trials = []
    for degree in degrees:
        say(f"side claim: M3 with thrust polynomials of degree {degree}")
        trials.append(
            judge(
                f"degree {degree}",
                identify(training, "M3", degree=degree, faults="keep"),
                validation,
            )
        )
    return tuple(trials)


def drop_monotonicity(
    training: Trajectory,
    validation: Trajectory,
    *,
    cases: Sequence[tuple[str, int]] = (
        ("M0", 3),
        ("M1", 3),
        ("M2", 3),
        ("M3", 3),
        ("M4", 3),
        ("M3", 5),
    ),
    say: Say = lambda _: None,
) -> tuple[Trial, ...]:
    """Fit without the condition that thrust rises with motor speed.

    The paper: "the obtained thrust profiles exhibit a non-monotonic behavior without the
    regularization term".
    """
    trials = []
    for name, degree in cases:
        say(f"side claim: {name} of degree {degree} without the monotonicity condition")
        method = LevenbergMarquardt(monotone=False)
        fit = identify(training, name, degree=degree, method=method, faults="keep")
        trials.append(judge(f"{name}, degree {degree}", fit, validation))
    return tuple(trials)


def compare_largest_thrusts(
    first_principles: Mapping[str, Model], direct: Mapping[str, Model]
) -> LargestThrusts:
    """Compare the largest thrusts of a first-principles model and of one that learns Π directly.

    The paper: "the max thrust predicted by M4 is considerably larger than that of M3, suggesting
    that the configuration matrix Π is compensating". Nothing observable fixes the scale of M4's
    thrusts; `airpuck.evaluation.gauge` says how it is fixed here.
    """
    return LargestThrusts(
        propellers=next(iter(direct.values())).vehicle.propeller_names,
        first_principles={
            kind: physical_thrust(model).sum(axis=1) for kind, model in first_principles.items()
        },
        direct={
            kind: np.asarray(model.parameters.thrust).sum(axis=1) for kind, model in direct.items()
        },
        direct_scaled={kind: physical_thrust(model).sum(axis=1) for kind, model in direct.items()},
    )


def falling_share(coefficients: Float[np.ndarray, "n degree"]) -> Float[np.ndarray, " n"]:
    """Compute on which share of [0, 1] each thrust curve falls."""
    speed = np.tile(np.linspace(0, 1, 1001), (len(coefficients), 1))
    return np.mean(thrust_slope(coefficients, speed) < 0, axis=1)


def retest_side_claims(
    study: Study, validation: Trajectory, *, say: Say = lambda _: None
) -> SideClaims:
    """Test all side claims again."""
    fits = {fit.model.name: fit for fit in study.fits}
    training = study.training
    return SideClaims(
        degrees=try_degrees(training, validation, say=say),
        unconstrained=drop_monotonicity(training, validation, say=say),
        full_trajectory=predict_whole_trajectory(training, validation, fits["M3"], say=say),
        largest_thrusts=compare_largest_thrusts(
            {"published": study.reference["M3"], "fitted": fits["M3"].model},
            {"published": study.reference["M4"], "fitted": fits["M4"].model},
        ),
    )
