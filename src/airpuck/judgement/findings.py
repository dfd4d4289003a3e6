"""Causes of a verdict: what a recording shows to be wrong with itself, its craft or a model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding, by_cause
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.effect_errors import LOW_SPEED, EffectErrors, effect_errors
from airpuck.deviation.time_scale import patience, response_time
from airpuck.evaluation.comparison import coasting
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.presentation import WAYS, largest_acceleration
from airpuck.faults.strengths import Strengths
from airpuck.model.model_file import Model, nominal_model
from airpuck.preprocessing.delay import visible_delay
from airpuck.preprocessing.quality import CLOCK_STEP

#: Largest relative standard error of an acceleration that control may request, and of the response
#: time [s]: within both, all controllers of studies/verdicts.py settle. Times are for the paper's
#: craft; for a slow craft they are multiplied by its `patience`.
ACCELERATION_LIMIT = 0.3
RESPONSE_LIMIT = 0.015
#: Largest systematic error of those accelerations, relative to the model's: a craft with 0.6 times
#: the modelled thrust settles. Below, flights in simulation decide.
WRONG_LIMIT = 0.4
#: Largest error of the accelerations with motors at `LOW_SPEED`, relative to the model's: between
#: 30 % (M2 with twice the inertia, which settles) and 46 % (quadratic curves, which do not).
LOW_LIMIT = 0.35
#: Standard error of a recording's timing above which it is not informative enough [s].
_JUDGED_RESPONSE = 0.006
#: Lowest acceptable maximum of each motor's commands, relative to the largest: thrusts beyond are
#: an extrapolation of the curve.
_REACHED = 0.6
#: Directions count only if the nominal acceleration exceeds this fraction of the largest one.
_ABLE = 0.05
#: The rung that the library's own choice of a structure extends.
_CHOSEN = "M3"
#: Remedy for too little excitation.
_FLY = "Fly an excitation of 30 s or more: `airpuck excite`, or `airpuck design` for this craft."


@dataclass(frozen=True, eq=False)
class Evidence:
    """Known errors of a model."""

    model: Model
    trajectory: Trajectory | None
    evaluation: Evaluation | None

    @cached_property
    def effects(self) -> EffectErrors | None:
        """Systematic errors that the recording reveals."""
        return None if self.trajectory is None else effect_errors(self.model, self.trajectory)

    @cached_property
    def able(self) -> Bool[np.ndarray, " 6"]:
        """The directions in which the craft is built to accelerate; others are not judged."""
        most = largest_acceleration(nominal_model(self.model.vehicle))
        best = np.repeat([most[:4].max(), most[4:].max()], [4, 2])
        return most > _ABLE * best

    @cached_property
    def by_chance(self) -> tuple[Float[np.ndarray, " 6"], float]:
        """Standard errors of the fit: of the largest accelerations, and the response time [s]."""
        if self.model.known is None:
            return np.zeros(len(WAYS)), 0.0
        error = self.model.standard_error(largest_acceleration)
        relative = np.where(np.isfinite(error), error, np.inf)
        relative /= np.maximum(largest_acceleration(self.model), 1e-12)
        response = float(self.model.standard_error(response_time))
        relative = np.where(self.able, relative, 0.0)
        return relative, response if np.isfinite(response) else np.inf

    @cached_property
    def total(self) -> tuple[Float[np.ndarray, " 6"], float]:
        """Standard errors including systematic errors."""
        (chance, response), effects = self.by_chance, self.effects
        if effects is None:
            return chance, response
        push = np.where(self.able, effects.push, 0.0)
        return np.hypot(chance, push), float(np.hypot(response, effects.later))

    @cached_property
    def missed(self) -> Float[np.ndarray, " 3"] | None:
        """Errors relative to a craft that coasts."""
        if self.evaluation is None or self.trajectory is None:
            return None
        coasts = coasting(self.evaluation, self.trajectory).median_abs
        return self.evaluation.median_abs / np.maximum(coasts, 1e-12)


def incomplete(model: Model) -> list[Finding]:
    """Describe what the model or its fit lacks."""
    found = []
    if model.fit.get("converged") is False:
        remedy = "Run it again, with more data or a closer start."
        found.append(Finding("physics", "The fit did not converge", remedy=remedy))
    learned = "motor_time_constant" in model.learned
    if not float(model.parameters.motor_time_constant) > 0 and not learned:
        cause = "The model has no motor lag, so it expects every thrust too early"
        found.append(Finding("physics", cause, remedy="Use M3."))
    return found


def too_quiet(evidence: Evidence) -> list[Finding]:
    """Report if a recording excites the craft too little to judge a model by it."""
    effects, trajectory = evidence.effects, evidence.trajectory
    if effects is None or trajectory is None:
        return [
            Finding("excitation", "The recording is too short to judge a model by it", "", _FLY)
        ]
    error = np.where(evidence.able, effects.push_error, 0.0)
    worst = int(np.argmax(error))
    found = []
    if error[worst] > ACCELERATION_LIMIT:
        found.append(
            f"The recording determines the largest acceleration {WAYS[worst][0]} only to "
            f"{percent(float(error[worst]))}; {percent(ACCELERATION_LIMIT)} is needed"
        )
    judged = patience(evidence.model.vehicle) * _JUDGED_RESPONSE
    if effects.later_error > judged:
        found.append(
            f"The recording determines when commands take effect only to "
            f"{1e3 * effects.later_error:.0f} ms; {1e3 * judged:.0f} ms is needed"
        )
    vehicle = evidence.model.vehicle
    reached = trajectory.command.max(axis=0, initial=0.0) / vehicle.command_max
    lazy = int(np.argmin(reached))
    if reached[lazy] < _REACHED:
        found.append(
            f"The commands of {vehicle.propeller_names[lazy]} reach only "
            f"{percent(float(reached[lazy]))} of the range; thrusts beyond are a guess, and "
            f"{percent(_REACHED)} is needed. If the commands were larger than this, check the "
            "unit in which they were logged; if no motor may go further, say so in the vehicle "
            "file (command_max)"
        )
    return [
        Finding("excitation", cause, remedy=_FLY if cause is found[-1] else "") for cause in found
    ]


def too_uncertain(
    model: Model, relative: Float[np.ndarray, " 6"], response: float
) -> list[Finding]:
    """Report accelerations, and a response time, that are too uncertain."""
    found = []
    if relative.max() > ACCELERATION_LIMIT:
        cause = f"The largest acceleration {_ways(relative)}"
        needed = f"control needs {percent(ACCELERATION_LIMIT)}"
        remedy = "Use the whole range of all motors."
        found.append(Finding("excitation", cause, needed, remedy))
    needed = patience(model.vehicle) * RESPONSE_LIMIT
    if response > needed:
        known = f"uncertain by {1e3 * response:.0f} ms" if np.isfinite(response) else "unknown"
        remedy = "Fly an excitation, whose commands switch: `airpuck excite`."
        limit = f"control needs {1e3 * needed:.0f} ms"
        found.append(Finding("excitation", f"The response time τ + d is {known}", limit, remedy))
    return found


def too_wrong(
    model: Model, relative: Float[np.ndarray, " 6"], response: float, effects: EffectErrors
) -> list[Finding]:
    """Report accelerations, and a response time, that are systematically wrong."""
    found = []
    if relative.max() > WRONG_LIMIT:
        off = []
        for (way, *_), share, total in zip(WAYS, effects.push, relative, strict=True):
            chance = math.sqrt(max(total**2 - share**2, 0.0))
            if total > WRONG_LIMIT:
                off.append(f"{way} {percent(abs(share))} too {'large' if share > 0 else 'small'}")
                if abs(share) <= WRONG_LIMIT:
                    off[-1] += f" and uncertain by another {percent(chance)}"
        cause = f"The modelled largest acceleration is wrong: {', '.join(off)}"
        remedy = f"{next_step(model)} Or check mass, inertia and motors in the vehicle file."
        found.append(Finding("physics", cause, remedy=remedy))
    if abs(low := float(np.median(effects.low))) > LOW_LIMIT:
        cause = (
            f"With motors at {percent(LOW_SPEED)} of full speed, the modelled accelerations are "
            f"{percent(abs(low))} too {'large' if low > 0 else 'small'}: the thrust curves have "
            "the wrong shape"
        )
        found.append(Finding("physics", cause, remedy=next_step(model)))
    if response > patience(model.vehicle) * RESPONSE_LIMIT:
        when = "later" if effects.later > 0 else "earlier"
        cause = f"Commands take effect {1e3 * abs(effects.later):.0f} ms {when} than modelled"
        remedy = "Use a model with a motor lag, and learn the delay (`--delay fit`)."
        found.append(Finding("physics", cause, remedy=remedy))
    return found


def next_step(model: Model) -> str:
    """Return what to do about wrong physics beyond the terms that findings of their own name."""
    if model.name.partition("+")[0] != _CHOSEN:
        return "Leave out `--model`: the structure is then chosen by the recording."
    return (
        "Beyond those named here, no term that airpuck tests explains it: `airpuck resid` shows "
        "which motors or times are wrong."
    )


def _ways(relative: Float[np.ndarray, " 6"]) -> str:
    """Describe in which directions an acceleration is uncertain."""
    return ", ".join(
        f"{way} is uncertain by {percent(float(r))}" if np.isfinite(r) else f"{way} is unknown"
        for (way, *_), r in zip(WAYS, relative, strict=True)
        if r > ACCELERATION_LIMIT
    )


def first_causes(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return the findings that no other one explains, in the order of causes.

    The consequences of a suspect recording look like anything else, so only its first cause counts.
    """
    ordered = by_cause(findings)
    if ordered and ordered[0].suspect:
        return tuple(one for one in ordered if one.kind == ordered[0].kind)
    return ordered


def actuator_causes(strengths: Strengths) -> list[Finding]:
    """Return actuators that are weak, dead or reversed; swapped ones are wrong in the order."""
    return [
        Finding("actuator", one.sentence, remedy="Check this motor and its propeller.")
        for one in strengths.remarkable
        if one.verdict in ("weak", "dead", "reversed")
    ]


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
        cause = "A clock steps within the recording, and without times of arrival it is unknown "
        cause += "before or after which step the stamps are right"
        lost = f"{sum(span.stop - span.start for span in stepped):.1f} s are left out"
        remedy = "Record a bag, which has times of arrival, or name the right part with `--span`."
        return [Finding("clock", cause, lost, remedy)]
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
        cause = "The motion seems to begin before the commands that cause it"
        acts = f"commands act {1e3 * min(learned, seen):.0f} ms after their time stamps"
        remedy = "The poses are probably stamped early: check that the clocks of cameras and "
        remedy += "controller are synchronised."
        return [Finding("clock", cause, acts, remedy)]
    certain = seen - 2 * trajectory.sample_period
    # A delay that takes the place of the lag is none: only their sum is well known.
    lag = float(np.max(model.dynamics.lag))
    taken = max(float(np.max(nominal_model(model.vehicle).dynamics.lag)) - lag, 0.0)
    if max(certain, learned if counts else certain) - taken <= longest:
        return []
    cause = f"Commands seem to act {1e3 * max(learned, seen):.0f} ms after their time stamps"
    remedy = (
        "The poses are probably stamped late: check that the clocks of cameras and controller are "
        "synchronised. If the radio is that slow, say so in the vehicle file "
        "(nominal.transport_delay_s)."
    )
    return [Finding("clock", cause, f"up to {1e3 * longest:.0f} ms are plausible", remedy)]


def timing_suspect(model: Model, effects: EffectErrors | None) -> list[Finding]:
    """Report commands whose delay changes within the recording: a fit learns a mean of both."""
    if effects is None:
        return []
    found = effects.timing
    least = patience(model.vehicle) * _DELAY_CHANGES
    if abs(found.change) < least or found.p_value > _BY_CHANCE:
        return []
    acts = f"{1e3 * abs(found.change):.0f} ms {'later' if found.change > 0 else 'earlier'}"
    cause = f"Commands act {acts} after {found.at:.0f} s than before"
    remedy = "A clock was set or drifted during the flight: synchronise the clocks of cameras and "
    remedy += "controller before it, or identify from one part with `--span`."
    return [Finding("clock", cause, f"± {1e3 * found.error:.1f} ms", remedy)]


def unit_suspect(model: Model) -> list[Finding]:
    """Report an impossible learned inertia: lengths are in a wrong unit."""
    vehicle = model.vehicle
    learned = "inertia" in model.learned
    # Some craft carry propellers outside the radius that meets the rails.
    radius = max(vehicle.radius_m, float(np.hypot(*vehicle.positions.T).max()))
    ratio = float(model.parameters.inertia) / (vehicle.mass_kg * radius**2)
    if not learned or _INERTIA_RANGE[0] <= ratio <= _INERTIA_RANGE[1]:
        return []
    what = "larger than a ring's" if ratio > 1 else "smaller than any craft's"
    cause = f"The moment of inertia is {what} of the craft's mass and radius"
    remedy = "Check the unit of the positions, and radius and propeller positions in the vehicle "
    return [Finding("units", cause, f"{ratio:.2g} m R²", remedy + "file.")]
