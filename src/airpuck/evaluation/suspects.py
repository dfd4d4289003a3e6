"""Suspicious recordings: clocks, order of the motors, unit of lengths."""

from __future__ import annotations

import numpy as np

from airpuck.boundary.finding import Finding
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.effect_errors import EffectErrors
from airpuck.model.model_file import Model
from airpuck.preprocessing.delay import visible_delay
from airpuck.preprocessing.time_scale import patience

#: Longest transport delay that is plausible without further knowledge, and the largest excess over
#: the vehicle file's delay [s]: as large as the error of the response time that control
#: tolerates; for a slow craft, each is multiplied by its `patience`.
_LONGEST_DELAY, _DELAY_ABOVE = 0.035, 0.015
#: Moment of inertia over mass times radius squared: a ring has 1, and every craft has more than
#: 0.1.
_INERTIA_RANGE = (0.1, 1.0)
#: Cosine between a motor's modelled and estimated effect below which the effect belongs to another
#: motor.
_SAME_MOTOR = 0.5
#: Standard error of a motor's effect, relative to its size, above which its direction is unknown.
_DIRECTION_LIMIT = 0.2
#: Effect of a motor, relative to the typical one, below which the motor counts as dead.
_SEEN = 0.3


def clock_suspect(
    model: Model, trajectory: Trajectory, *, determined: bool = True
) -> list[Finding]:
    """Report commands that act implausibly late or early: the clocks of the recording disagree.

    A learned delay counts only if the model is `determined` by its data: with undetermined
    thrusts, the delay takes on any value.
    """
    seen = visible_delay(trajectory, model.dynamics)
    if seen is None:
        return []
    counts = model.delay_learned and determined
    learned = model.transport_delay if counts else seen
    bears = patience(model.vehicle)
    stated = model.vehicle.nominal.transport_delay_s
    longest = max(bears * _LONGEST_DELAY, stated + bears * _DELAY_ABOVE)
    # The recording determines the delay in whole samples.
    if learned <= 0 or seen < -trajectory.sample_period:
        return [
            Finding(
                "clock",
                "The motion seems to begin before, or as soon as, the commands that cause it",
                f"commands act {1e3 * min(learned, seen):.0f} ms after their time stamps",
                "The poses are probably stamped early: check that the clocks of cameras and "
                "controller are synchronised.",
            )
        ]
    certain = seen - 2 * trajectory.sample_period
    if max(certain, learned if counts else certain) <= longest:
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


def order_suspect(model: Model, effects: EffectErrors | None) -> list[Finding]:
    """Report motors that act like others, or in the opposite direction."""
    if effects is None:
        return []
    rows = np.array([1.0, 1.0, model.radius_of_gyration])[:, None]
    stated, found = model.propeller_effects, rows * effects.found
    size = np.linalg.norm(found, axis=0)
    usual = float(np.median(np.linalg.norm(rows * effects.modelled, axis=0)))
    error = np.linalg.norm(rows * effects.standard_error, axis=0)
    directions = stated / np.maximum(np.linalg.norm(stated, axis=0), 1e-300)
    cosines = directions.T @ (found / np.maximum(size, 1e-300))
    names, said = model.vehicle.propeller_names, []
    for k, name in enumerate(names):
        clear = size[k] > max(_SEEN * usual, error[k] / _DIRECTION_LIMIT)
        if not clear or cosines[k, k] > _SAME_MOTOR:
            continue
        like = int(np.argmax(cosines[:, k]))
        said.append(
            f"{name} pushes the other way" if like == k or cosines[like, k] < _SAME_MOTOR
            else f"{name} acts like {names[like]}"
        )  # fmt: skip
    if not said:
        return []
    remedy = "Check the motors' order, wiring and directions with `airpuck check`."
    return [Finding("order", "; ".join(said), f"{len(said)} of {len(names)} motors", remedy)]


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
