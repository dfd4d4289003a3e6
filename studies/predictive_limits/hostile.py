"""States, targets and limits that should not occur in any flight."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from airpuck.control.predictive import SoftLimits
from airpuck.control.reference import SetPoint, Target
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate

from .flights import craft

#: Limits that cannot all be kept, such as a table smaller than the craft.
LIMITS = (
    ({}, Table()),
    ({}, Table(length_m=0.1, width_m=0.1)),
    ({"speed_m_s": 1e-3, "spin_rad_s": 1e-3}, Table()),
    ({"keep_out_m": ((0.0, 0.0, 5.0), (0.1, 0.0, 5.0))}, Table()),
    ({"fence_m": (5.0, 5.0, 5.001, 5.001), "headway_s": 1.0}, Table()),
)
#: Scales of numbers: ordinary, extreme, infinite and NaN.
_SIZES = np.array([0.0, 1e-9, 1.0, 1.0, 1.0, 10.0, 1e3, 1e9, np.nan, np.inf])


@dataclass(frozen=True, eq=False)
class Anywhere:
    """A pose that no set point allows, as a user's reference might give it."""

    pose: Float[np.ndarray, " 3"]

    def at(self, now: float, ahead: float) -> Target:
        """Return the pose, at rest; see `Reference.at`."""
        return Target(np.append(self.pose, np.zeros(3)), np.zeros(3))


@dataclass
class Steps:
    """Results of many steps."""

    statuses: Counter[str] = field(default_factory=Counter)
    #: Commands that are not finite or beyond the motors' limits.
    wrong: int = 0
    #: Processor time of each step [s]; other programs do not count.
    spent: list[float] = field(default_factory=list)


def thrown(tuning: Tuning, count: int, seed: int = 0, *, compiled: bool = True) -> Steps:
    """Steer from random states to random targets, with each of `LIMITS` in turn."""
    rng, found = np.random.default_rng(seed), Steps()
    low, high = craft().vehicle.command_min, craft().vehicle.command_max
    for changes, table in LIMITS:
        given = tuning.with_law("mpc", limits=SoftLimits(**changes))
        controller = TrackingController(
            craft(), SetPoint(0.0, 0.0, 0.0), given, table=table, compiled=compiled
        )
        for k in range(count // len(LIMITS)):
            # Every other one has all numbers of a usual size.
            sizes = _SIZES[rng.integers(len(_SIZES), size=12)] if k % 2 else np.full(12, 1.0)
            numbers = sizes * rng.normal(size=12)
            estimate = Estimate(k / 100, numbers[:6], rng.uniform(size=6), numbers[6:9])
            target = np.nan_to_num(numbers[9:], nan=1.0, posinf=1e9, neginf=-1e9)
            controller.reference = Anywhere(target)
            begun = time.process_time()
            with np.errstate(all="ignore"):
                step = controller.steer(estimate, k / 100)
            found.spent.append(time.process_time() - begun)
            found.statuses[step.status] += 1
            inside = np.isfinite(step.command).all()
            inside = inside and low <= step.command.min() and step.command.max() <= high
            found.wrong += not inside
    return found
