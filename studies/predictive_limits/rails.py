"""Flights to targets near the rails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from airpuck.control.tuning import Tuning
from airpuck.twin.settings import default_twin_settings

from .flights import Pose, craft, flown, lossy

#: Largest distance of half of the targets from the rails [m].
NEAR = 0.01


@dataclass(frozen=True)
class Passage:
    """A flight to a target near the rails."""

    #: Number of contacts, and smallest clearance [m].
    contacts: int
    clearance: float
    #: Distance from the target at the end [m].
    left: float
    #: Steps without a solution.
    unanswered: int


def start_and_target(seed: int) -> tuple[Pose, Pose]:
    """Draw two poses on the table; every other target lies within a centimetre of a rail."""
    rng = np.random.default_rng([seed, 11])
    reach = np.array(default_twin_settings().table.reach(craft().vehicle.radius_m))
    start, target = rng.uniform(-reach + 0.005, reach - 0.005, (2, 2))
    if seed % 2:
        rail = rng.integers(2)
        target[rail] = rng.choice([-1, 1]) * (reach[rail] - rng.uniform(0.0, NEAR))
    yaws = rng.uniform(-np.pi, np.pi, 2)
    return (*start.tolist(), float(yaws[0])), (*target.tolist(), float(yaws[1]))


def passed(seed: int, tuning: Tuning, loss: float, duration: float) -> Passage:
    """Fly once."""
    start, target = start_and_target(seed)
    flight = flown(start, target, tuning, duration, settings=lossy(loss), seed=seed)
    reach = default_twin_settings().table.reach(craft().vehicle.radius_m)
    clearance = float((reach - np.abs(flight.state[:, :2])).min())
    unanswered = sum(status in ("iteration limit", "fallback") for status in flight.status)
    left = float(np.hypot(*flight.error[-1, :2]))
    return Passage(flight.contacts, clearance, left, unanswered)
