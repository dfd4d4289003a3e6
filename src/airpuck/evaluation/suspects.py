"""Suspicious recordings: clocks, unit of lengths."""

from __future__ import annotations

import numpy as np

from airpuck.boundary.results import Finding
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.effect_errors import EffectErrors
from airpuck.deviation.time_scale import patience
from airpuck.model.model_file import Model, nominal_model
from airpuck.preprocessing.delay import visible_delay
from airpuck.preprocessing.quality import CLOCK_STEP

#: Longest transport delay that is plausible without further knowledge, and the largest excess over
#: the vehicle file's delay [s]: as large as the error of the response time that control
#: tolerates; for a slow craft, each is multiplied by its `patience`.
_LONGEST_DELAY, _DELAY_ABOVE = 0.035, 0.015
#: Usable time from which a learned delay counts [s]: in 8 s with faults, fits learn no lag and a
#: delay of 43 ms.
_LONG_ENOUGH = 10.0
#: Change of the delay within a recording that matters [s], as a fit's error would at the verdict,
#: and its probability by chance. Nine real recordings and eight sound flights of the twin had more
#: than 0.0008; steps by 20 ms or more in eight flights had 6 standard errors or more.
_DELAY_CHANGES, _BY_CHANCE = 0.005, 1e-4
#: Moment of inertia over mass times radius squared: a ring has 1, and every craft has more than
#: 0.1.
_INERTIA_RANGE = (0.1, 1.0)


def clock_suspect(
    model: Model, trajectory: Trajectory, *, determined: bool = True
) -> list[Finding]:
    """Report commands that act implausibly late or early: the clocks of the recording disagree.

    A learned delay counts only if the recording is long enough and the model is `determined` by
    its data: with undetermined thrusts, the delay takes on any value.
    """
    stepped = [span for span in trajectory.excluded if span.cause == CLOCK_STEP]
    if stepped:
        return [
            Finding(
                "clock",
                "A clock steps within the recording, and no times of arrival tell before or after "
                "which step the stamps are right",
                f"{sum(span.stop - span.start for span in stepped):.1f} s are left out",
                "Record a bag, which has times of arrival, or name the right part with `--span`.",
            )
        ]
    seen = visible_delay(trajectory, model.dynamics)
    if seen is None:
        return []
    usable = float(trajectory.usable.sum()) * trajectory.sample_period
    counts = model.delay_learned and determined and usable >= _LONG_ENOUGH
    learned = model.transport_delay if counts else seen
    bears = patience(model.vehicle)
    stated = model.vehicle.nominal.transport_delay_s
    longest = max(bears * _LONGEST_DELAY, stated + bears * _DELAY_ABOVE)
    # `seen` is in whole samples, and negative only if motion visibly precedes the commands. A delay
    # that was learned outweighs one sample of it, unless the fit ended at its bound, zero.
    if seen < (0 if learned <= 0 else -trajectory.sample_period):
        return [
            Finding(
                "clock",
                "The motion seems to begin before the commands that cause it",
                f"commands act {1e3 * min(learned, seen):.0f} ms after their time stamps",
                "The poses are probably stamped early: check that the clocks of cameras and "
                "controller are synchronised.",
            )
        ]
    certain = seen - 2 * trajectory.sample_period
    # A delay that takes the place of the lag is none: only their sum is well known.
    lag = float(np.max(model.dynamics.lag))
    taken = max(float(np.max(nominal_model(model.vehicle).dynamics.lag)) - lag, 0.0)
    if max(certain, learned if counts else certain) - taken <= longest:
        return []
    return [
        Finding(
            "clock",
            f"Commands seem to act {1e3 * max(learned, seen):.0f} ms after their time stamps",
            f"up to {1e3 * longest:.0f} ms are plausible",
            "The poses are probably stamped late: check that the clocks of cameras and controller "
            "are synchronised. If the radio is that slow, say so in the vehicle file "
            "(nominal.transport_delay_s).",
        )
    ]


def timing_suspect(model: Model, effects: EffectErrors | None) -> list[Finding]:
    """Report commands whose delay changes within the recording: a fit learns a mean of both."""
    if effects is None:
        return []
    found = effects.timing
    least = patience(model.vehicle) * _DELAY_CHANGES
    if abs(found.change) < least or found.p_value > _BY_CHANCE:
        return []
    return [
        Finding(
            "clock",
            f"Commands act {1e3 * abs(found.change):.0f} ms "
            f"{'later' if found.change > 0 else 'earlier'} after {found.at:.0f} s than before",
            f"± {1e3 * found.error:.1f} ms",
            "A clock was set or drifted during the flight: synchronise the clocks of cameras and "
            "controller before it, or identify from one part with `--span`.",
        )
    ]


def unit_suspect(model: Model) -> list[Finding]:
    """Report an impossible learned inertia: lengths are in a wrong unit."""
    vehicle = model.vehicle
    learned = bool(model.free[model.parameters.mask(frozenset({"inertia"}))].any())
    # Some craft carry propellers outside the radius that meets the rails.
    radius = max(vehicle.radius_m, float(np.hypot(*vehicle.positions.T).max()))
    ratio = float(model.parameters.inertia) / (vehicle.mass_kg * radius**2)
    if not learned or _INERTIA_RANGE[0] <= ratio <= _INERTIA_RANGE[1]:
        return []
    what = "larger than a ring's" if ratio > 1 else "smaller than any craft's"
    return [
        Finding(
            "units",
            f"The moment of inertia is {what} of the craft's mass and radius",
            f"{ratio:.2g} m R²",
            "Check the unit of the positions, and radius and propeller positions in the vehicle "
            "file.",
        )
    ]
