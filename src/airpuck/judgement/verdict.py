"""Whether a model can be trusted for control, in words.

docs/method.md explains the four outcomes and their limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Result
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.coasting import coasting
from airpuck.evaluation.effect_errors import LOW_SPEED, EffectErrors, effect_errors
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.main_quantities import MainQuantity, main_quantities
from airpuck.evaluation.presentation import WAYS, largest_acceleration
from airpuck.evaluation.suspects import clock_suspect, order_suspect, unit_suspect
from airpuck.judgement.rehearsal import failures
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.parameters import LAG
from airpuck.preprocessing.time_scale import patience

#: Largest relative standard error of an acceleration that control may request, and of the response
#: time [s]: within both, all controllers of studies/verdicts.py settle. Times are for the paper's
#: craft; for a slow craft they are multiplied by its `patience`.
ACCELERATION_LIMIT = 0.3
RESPONSE_LIMIT = 0.015
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
#: Relative standard error above which a quantity is called unknown.
UNKNOWN_LIMIT = 0.3
#: Correlation of motor lag and transport delay below which the data determine only their sum.
_NO_SPLIT = -0.9
#: An error of this size counts as 100 %: an angle of a radian turns a thrust away completely.
_WHOLE_ANGLE = 1.0

Outcome = Literal[
    "trusted", "not_trusted", "not_enough_excitation", "suspect_recording", "not_judged"
]


@dataclass(frozen=True)
class Verdict(Result):
    """Whether a model can be trusted for control.

    Attributes
    ----------
    outcome : str
        ``trusted``: a controller designed from the model settles on the craft. ``not_trusted``: it
        may not, since the model is wrong. ``not_enough_excitation``: the recording moves the craft
        too little to tell. ``suspect_recording``: its clocks, motor order or units look wrong.
        ``not_judged``: there is no recording to judge by.
    sentences : tuple of str
        In words: the outcome, then the reason and remedy, then further findings.
    relative_errors : dict
        Standard errors of the learned parameters, by label, relative to their natural size;
        infinite if undetermined.
    missed : array, shape (3,), or None
        Errors of x, y and yaw relative to a craft that coasts.
    acceleration_errors : array, shape (6,), or None
        Relative standard errors of the largest accelerations forward, backward, left, right,
        counter-clockwise and clockwise, systematic errors included.
    response_error : float or None
        Standard error of the response time, systematic errors included [s].
    """

    JSON = (
        "trusted outcome sentences relative_errors missed acceleration_errors "
        "response_error_s=response_error"
    )

    outcome: Outcome
    sentences: tuple[str, ...]
    relative_errors: dict[str, float]
    missed: Float[np.ndarray, " 3"] | None = None
    acceleration_errors: Float[np.ndarray, " 6"] | None = None
    response_error: float | None = None

    @property
    def trusted(self) -> bool:
        """Whether the model can be trusted for control."""
        return self.outcome == "trusted"


def missed_motion(evaluation: Evaluation, trajectory: Trajectory) -> Float[np.ndarray, " 3"]:
    """Return errors of x, y and yaw relative to a craft that coasts, for a typical window."""
    return evaluation.median_abs / np.maximum(coasting(evaluation, trajectory).median_abs, 1e-12)


@dataclass(frozen=True, eq=False)
class _Evidence:
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
        response = float(self.model.standard_error(_response_time))
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
        return missed_motion(self.evaluation, self.trajectory)


def verdict(
    model: Model,
    trajectory: Trajectory | None = None,
    evaluation: Evaluation | None = None,
) -> Verdict:
    """Judge whether a model can be trusted for control.

    Parameters
    ----------
    model : Model
        Any model.
    trajectory : Trajectory, optional
        A recording to judge the model on, preferably not part of its training data.
    evaluation : Evaluation, optional
        How well it predicts that recording, if the recording is not part of its training data.

    Returns
    -------
    Verdict
        The outcome, in words.
    """
    evidence = _Evidence(model, trajectory, evaluation)
    outcome, reasons = _decided(evidence)
    errors = _relative_errors(model) if model.known is not None else {}
    judged = trajectory is not None
    sentences = (
        _headline(model, outcome, own=judged and evaluation is None),
        *reasons,
        *_unknown(model, errors),
        *_timing(model),
        *(_known(evidence) if outcome == "trusted" else ()),
        *_compared(evidence),
        *_errors_in_words(errors),
    )
    accelerations, response = evidence.total
    known = judged or model.known is not None
    return Verdict(
        outcome,
        sentences,
        errors,
        evidence.missed,
        accelerations if known else None,
        response if known else None,
    )


def _headline(model: Model, outcome: Outcome, own: bool) -> str:
    """Describe the outcome in a sentence."""
    name = model.name
    return {
        "trusted": f"{name} can be trusted for control"
        + (", judged by the data it was learned from." if own else "."),
        "not_trusted": f"{name} cannot be trusted for control.",
        "not_enough_excitation": f"The data do not tell whether {name} can be trusted for control: "
        "not enough excitation.",
        "suspect_recording": f"{name} cannot be trusted for control: something is wrong with the "
        "recording.",
        "not_judged": f"Whether {name} can be trusted for control is unknown: evaluate it on a "
        "recording with `airpuck evaluate`.",
    }[outcome]


def _decided(evidence: _Evidence) -> tuple[Outcome, list[str]]:
    """Return the outcome, and sentences with the reason."""
    model = evidence.model
    if wrong := _structural(model):
        return "not_trusted", wrong
    if evidence.trajectory is None:
        uncertain = _uncertain(model, *evidence.by_chance)
        return ("not_enough_excitation", uncertain) if uncertain else ("not_judged", [])
    quiet, order = _quiet(evidence), order_suspect(model, evidence.effects)
    uncertain = _uncertain(model, *evidence.by_chance)
    clock = clock_suspect(model, evidence.trajectory, determined=not uncertain)
    if suspects := [*clock, *order, *([] if quiet else unit_suspect(model))]:
        return "suspect_recording", suspects
    if quiet or evidence.effects is None:
        return "not_enough_excitation", quiet
    if uncertain:
        return "not_enough_excitation", uncertain
    if wrong := _wrong(model, *evidence.total, evidence.effects):
        return "not_trusted", wrong
    # Flights come last, since they take longer than everything else.
    unsettled = failures(model, evidence.trajectory, evidence.effects)
    return ("not_trusted", unsettled) if unsettled else ("trusted", [])


def _structural(model: Model) -> list[str]:
    """Describe what the model or its fit lacks."""
    found = []
    if model.fit.get("converged") is False:
        found.append("The fit did not converge: run it again, with more data or a closer start.")
    if not float(model.parameters.motor_time_constant) > 0 and not _learned_lag(model):
        found.append("The model has no motor lag, so it expects every thrust too early: use M3.")
    return found


def _learned_lag(model: Model) -> bool:
    """Return whether a model's motor lag is learned."""
    return bool(model.free[model.parameters.mask(LAG)].any())


def _quiet(evidence: _Evidence) -> list[str]:
    """Report if a recording excites the craft too little to judge a model by it."""
    fly = "Fly an excitation of 30 s or more: `airpuck excite`, or `airpuck design` for this craft."
    effects, trajectory = evidence.effects, evidence.trajectory
    if effects is None or trajectory is None:
        return [f"The recording is too short to judge a model by it. {fly}"]
    error = np.where(evidence.able, effects.push_error, 0.0)
    worst = int(np.argmax(error))
    found = []
    if error[worst] > ACCELERATION_LIMIT:
        found.append(
            f"The recording determines the largest acceleration {_way(worst)} only to "
            f"{percent(float(error[worst]))}; {percent(ACCELERATION_LIMIT)} is needed."
        )
    judged = patience(evidence.model.vehicle) * _JUDGED_RESPONSE
    if effects.later_error > judged:
        found.append(
            f"The recording determines when commands take effect only to "
            f"{1e3 * effects.later_error:.0f} ms; {1e3 * judged:.0f} ms is needed."
        )
    vehicle = evidence.model.vehicle
    reached = trajectory.command.max(axis=0, initial=0.0) / vehicle.command_max
    lazy = int(np.argmin(reached))
    if reached[lazy] < _REACHED:
        found.append(
            f"The commands of {vehicle.propeller_names[lazy]} reach only "
            f"{percent(float(reached[lazy]))} of the range; thrusts beyond are a guess, and "
            f"{percent(_REACHED)} are needed. If the commands were larger than this, check the "
            "unit in which they were logged; if no motor may go further, say so in the vehicle "
            "file (command_max)."
        )
    return [*found, fly] if found else []


def _uncertain(model: Model, relative: Float[np.ndarray, " 6"], response: float) -> list[str]:
    """Report accelerations, and a response time, that are too uncertain."""
    found = []
    if relative.max() > ACCELERATION_LIMIT:
        found.append(
            f"The largest acceleration {_ways(relative)}; control needs "
            f"{percent(ACCELERATION_LIMIT)}. Use the whole range of all motors."
        )
    needed = patience(model.vehicle) * RESPONSE_LIMIT
    if response > needed:
        known = f"uncertain by {1e3 * response:.0f} ms" if np.isfinite(response) else "unknown"
        found.append(
            f"The response time τ + d is {known}; control needs {1e3 * needed:.0f} ms. Fly "
            "an excitation, whose commands switch: `airpuck excite`."
        )
    return found


def _wrong(
    model: Model, relative: Float[np.ndarray, " 6"], response: float, effects: EffectErrors
) -> list[str]:
    """Report accelerations, and a response time, that are systematically wrong."""
    found = []
    if relative.max() > ACCELERATION_LIMIT:
        off = []
        for (way, *_), share, total in zip(WAYS, effects.push, relative, strict=True):
            chance = math.sqrt(max(total**2 - share**2, 0.0))
            if total > ACCELERATION_LIMIT:
                off.append(f"{way} {percent(abs(share))} too {'large' if share > 0 else 'small'}")
                if abs(share) <= ACCELERATION_LIMIT:
                    off[-1] += f" and uncertain by another {percent(chance)}"
        found.append(
            f"The modelled largest acceleration is wrong: {', '.join(off)}. A richer model may "
            "help (`--model auto`), or a check of mass, inertia and motors in the vehicle file."
        )
    if abs(low := float(np.median(effects.low))) > LOW_LIMIT:
        found.append(
            f"With motors at {percent(LOW_SPEED)} of full speed, the modelled accelerations are "
            f"{percent(abs(low))} too {'large' if low > 0 else 'small'}: the thrust curves have "
            "the wrong shape. Use a richer model (`--model auto`)."
        )
    if response > patience(model.vehicle) * RESPONSE_LIMIT:
        when = "later" if effects.later > 0 else "earlier"
        found.append(
            f"Commands take effect {1e3 * abs(effects.later):.0f} ms {when} than modelled: use a "
            "model with a motor lag, and learn the delay (`--delay fit`)."
        )
    return found


def _way(number: int) -> str:
    """Name a direction of acceleration."""
    return WAYS[number][0]


def _ways(relative: Float[np.ndarray, " 6"]) -> str:
    """Describe in which directions an acceleration is uncertain."""
    return ", ".join(
        f"{way} is uncertain by {percent(float(r))}" if np.isfinite(r) else f"{way} is unknown"
        for (way, *_), r in zip(WAYS, relative, strict=True)
        if r > ACCELERATION_LIMIT
    )


def _compared(evidence: _Evidence) -> list[str]:
    """Compare predictions with a craft that coasts."""
    missed = evidence.missed
    if missed is None:
        return []
    shares = ", ".join(
        percent(float(share)) if share <= 1 else "more than 100 %" for share in missed
    )
    return [
        f"Its errors of x, y and yaw are {shares} of the errors of constant velocity, a craft that "
        "coasts (typical window of this recording)."
    ]


def _known(evidence: _Evidence) -> list[str]:
    """Describe why the model is trusted."""
    relative, error = evidence.total
    response = _with_error(1e3 * _response_time(evidence.model), 1e3 * error)
    return [
        f"Its largest acceleration is known to {percent(float(relative.max()))} in every "
        f"direction; the response time τ + d is {response} ms. Systematic "
        "errors that this recording shows are included. In simulation, the packaged controller "
        "settles on such a craft."
    ]


def _unknown(model: Model, errors: dict[str, float]) -> list[str]:
    """Name the unknown quantities, and the remedy."""
    named = []
    for quantity in _learned(model):
        if errors.get(quantity.label, 0.0) > UNKNOWN_LIMIT:
            error = float(model.standard_error(quantity.value))
            known = f"± {error:.2g} {quantity.unit}" if np.isfinite(error) else "not determined"
            named.append(f"{quantity.label} ({known})")
    if not named:
        return []
    return [
        f"Unknown: {', '.join(named)}. Fly an excitation that determines them (`airpuck design`)."
    ]


def _timing(model: Model) -> list[str]:
    """Report if only the sum of lag and delay is known, and not the split."""
    masks = [
        model.parameters.mask(frozenset({name}))
        for name in ("motor_time_constant", "transport_delay")
    ]
    if model.known is None or not all((model.free & mask).any() for mask in masks):
        return []
    lag, delay = (int(np.flatnonzero(mask)[0]) for mask in masks)
    error = float(model.standard_error(_response_time))
    correlation = float(model.known.correlation[lag, delay])
    if not (np.isfinite(error) and error > 0) or correlation > _NO_SPLIT:
        return []
    errors = model.known.standard_errors[[lag, delay]]
    if np.isfinite(correlation):
        values = model.parameters.to_vector()[[lag, delay]]
        shown = (f"{1e3 * v:.1f} ± {1e3 * e:.1f} ms" for v, e in zip(values, errors, strict=True))
        why = "lag {}, delay {}, correlation {:.2f}".format(*shown, correlation)
    else:
        held = [name for name, e in zip(("lag", "delay"), errors, strict=True) if not e > 0]
        why = f"the {held[0]} is at its bound" if len(held) == 1 else "nothing tells them apart"
    return [
        f"The sum of lag and delay is known to ±{1e3 * error:.2f} ms "
        f"({1e3 * _response_time(model):.2f} ms); the split is not: {why}."
    ]


def _errors_in_words(errors: dict[str, float]) -> list[str]:
    """Write the relative errors, combining the thrusts."""
    thrusts = [error for label, error in errors.items() if label.startswith("F(")]
    listed = {label: e for label, e in errors.items() if not label.startswith("F(")}
    words = [f"{label} {percent(error)}" for label, error in listed.items()]
    if thrusts:
        low, high = percent(min(thrusts)), percent(max(thrusts))
        words.append(f"thrusts at full speed {low if low == high else f'{low} to {high}'}")
    shares = "of the value; of α 1 rad, of r the propellers' lever arm"
    return [f"Standard errors ({shares}): {', '.join(words)}."] if words else []


def _learned(model: Model) -> list[MainQuantity]:
    """Return learned quantities that have a natural size for their errors."""
    return [
        quantity
        for quantity in main_quantities(model)
        if quantity.used(model) and quantity.learned(model) and _size(model, quantity) > 0
    ]


def _relative_errors(model: Model) -> dict[str, float]:
    """Return standard errors relative to the natural size of each quantity.

    Quantities fixed by a constraint have none; undetermined ones are infinite.
    """
    found = {}
    for quantity in _learned(model):
        error = float(model.standard_error(quantity.value))
        if error != 0:
            found[quantity.label] = error / _size(model, quantity) if error > 0 else np.inf
    return found


def _size(model: Model, quantity: MainQuantity) -> float:
    """Return the reference value for an error of a quantity, in its unit; 0 if there is none.

    This is the quantity's value if it is always positive. For an angle it is a radian, for the
    centre of mass the lever arm of the propellers, for a weak or dead motor half the usual thrust.
    """
    if quantity.parameter == "thrust":
        usual = np.median([abs(float(q.value(model))) for q in _thrusts(model)])
        return max(abs(float(quantity.value(model))), float(usual) / 2)
    if quantity.parameter == "angle_offset":
        return quantity.factor * _WHOLE_ANGLE
    if quantity.parameter == "center_of_mass":
        return quantity.factor * float(np.hypot(*model.vehicle.positions.T).mean())
    return abs(float(quantity.value(model))) if quantity.positive else 0.0


def _thrusts(model: Model) -> list[MainQuantity]:
    """Return the motors' thrusts at full command."""
    return [quantity for quantity in main_quantities(model) if quantity.parameter == "thrust"]


def _response_time(model: Model) -> Any:
    """Return the response time of the motors to a command: lag and delay together [s]."""
    return model.parameters.motor_time_constant + model.transport_delay


def _with_error(value: float, error: float) -> str:
    """Write a value to the two digits of its error."""
    digits = max(1 - math.floor(math.log10(error)), 0) if 0 < error < math.inf else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}"
