"""Whether a model can be trusted for control, in words.

docs/method.md explains the four outcomes and their limits.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding, Result
from airpuck.control.laws import law_class
from airpuck.control.tuning import tuning_for
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.time_scale import patience, response_time
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.presentation import WAYS, MainQuantity, main_quantities
from airpuck.faults.layout_findings import AXES
from airpuck.faults.strengths import recording_findings
from airpuck.judgement.findings import (
    Evidence,
    clock_suspect,
    first_causes,
    incomplete,
    timing_suspect,
    too_quiet,
    too_uncertain,
    too_wrong,
    unit_suspect,
)
from airpuck.judgement.rehearsal import Rehearsal, rehearse
from airpuck.model.model_file import Model

#: Errors of parameters count beyond this many standard errors, and beyond a share of the largest
#: accelerations, a delay [s] and a share of the low thrusts that the regression itself errs by.
_SIGNIFICANT, _LEAST_SHARE, _LEAST_DELAY, _LEAST_LOW = 4.0, 0.05, 2e-3, 0.15
#: Relative standard error above which a quantity is called unknown.
UNKNOWN_LIMIT = 0.3
#: Correlation of motor lag and transport delay below which the data determine only their sum.
_NO_SPLIT = -0.9
#: An error of this size counts as 100 %: an angle of a radian turns a thrust away completely.
_WHOLE_ANGLE = 1.0


VerdictOutcome = Literal[
    "trusted", "not_trusted", "not_enough_excitation", "suspect_recording", "not_judged"
]


@dataclass(frozen=True)
class ParametersVerdict(Result):
    """Whether the parameters are right within their errors.

    Attributes
    ----------
    right : bool or None
        None if the model states no errors, or there is no recording to compare it with.
    why : tuple of str
        Reasons if they are not.
    """

    JSON = "right why"

    right: bool | None
    why: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict(Result):
    """Whether a model can be trusted for control, and whether its parameters are right.

    Attributes
    ----------
    outcome : str
        ``trusted``: the controller that airpuck designs from the model by default settles on the
        craft with a margin. ``not_trusted``: it may not. ``not_enough_excitation``: the recording
        moves the craft too little to tell. ``suspect_recording``: its clocks, motor order or units
        look wrong. ``not_judged``: there is no recording to judge by.
    sentences : tuple of str
        In words: the outcome, then the findings, then what is known.
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
    findings : tuple of Finding
        Everything that is wrong, in the order of causes.
    parameters : ParametersVerdict
        Whether the parameters are right within their errors; a wrong model may still fly.
    controller : dict of str to Rehearsal
        How each law that was flown on the twin settles; empty if an earlier cause decided.

    Examples
    --------
    >>> study = airpuck.study(trajectory, model="M0")
    >>> isinstance(study.verdict, airpuck.Verdict), study.verdict.trusted
    (True, False)
    """

    JSON = (
        "trusted outcome sentences relative_errors missed acceleration_errors "
        "response_error_s=response_error findings parameters controller"
    )

    outcome: VerdictOutcome
    sentences: tuple[str, ...]
    relative_errors: dict[str, float]
    missed: Float[np.ndarray, " 3"] | None = None
    acceleration_errors: Float[np.ndarray, " 6"] | None = None
    response_error: float | None = None
    findings: tuple[Finding, ...] = ()
    parameters: ParametersVerdict = ParametersVerdict(None)
    controller: dict[str, Rehearsal] = field(default_factory=dict)

    @property
    def trusted(self) -> bool:
        """Whether the model can be trusted for control."""
        return self.outcome == "trusted"

    def check_recording(self, file: str | os.PathLike[str]) -> None:
        """Raise InputError if the recording is suspect: nothing learned from it can be right.

        Parameters
        ----------
        file : path-like
            The recording.
        """
        if self.outcome == "suspect_recording":
            words = next(iter(self.findings)).sentence
            raise InputError(f"is suspect: {words.removesuffix('.')}", file=file)


def verdict(
    model: Model,
    trajectory: Trajectory | None = None,
    evaluation: Evaluation | None = None,
    *,
    causes: Sequence[Finding] = (),
    laws: Sequence[str] = (),
    axes: Sequence[str] = AXES,
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
    causes : sequence of Finding, optional
        What other checks have found.
    laws : sequence of str, optional
        Laws to fly besides the default one; MPC takes seconds.
    axes : sequence of str, optional
        Axes of the mapping file, in which lines for it are written.

    Returns
    -------
    Verdict
        The outcome, in words.
    """
    evidence = Evidence(model, trajectory, evaluation)
    if trajectory is not None:
        causes = [*recording_findings(trajectory, model.vehicle, axes), *causes]
    outcome, found, flown = _decided(evidence, causes)
    if flown and trajectory is not None and evidence.effects is not None:
        others = [law for law in laws if law not in flown]
        flown |= {law: rehearse(model, trajectory, evidence.effects, law) for law in others}
    findings = first_causes([*causes, *found])
    errors = _relative_errors(model) if model.known is not None else {}
    judged = trajectory is not None
    parameters = _parameters(evidence, findings)
    said_before = {finding.cause for finding in findings}
    sentences = (
        _headline(model, outcome, own=judged and evaluation is None),
        *(finding.sentence for finding in findings),
        *_unknown(model, errors),
        *_timing(model),
        *(_known(evidence, flown) if outcome == "trusted" else ()),
        *(one for one in parameters.why if outcome == "trusted" and one not in said_before),
        *(one.remedy for law, one in flown.items() if law in laws and one.remedy),
        *_compared(evidence),
        *_errors_in_words(errors),
    )
    known = judged or model.known is not None
    accelerations, response = evidence.total if known else (None, None)
    said = tuple(dict.fromkeys(sentences))
    return Verdict(
        outcome, said, errors, evidence.missed, accelerations, response, findings, parameters, flown
    )


def _headline(model: Model, outcome: VerdictOutcome, own: bool) -> str:
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


def _decided(
    evidence: Evidence, causes: Sequence[Finding]
) -> tuple[VerdictOutcome, list[Finding], dict[str, Rehearsal]]:
    """Return the outcome, the findings that lead to it, and the flights that were needed."""
    model = evidence.model
    if wrong := incomplete(model):
        return "not_trusted", wrong, {}
    if evidence.trajectory is None:
        uncertain = too_uncertain(model, *evidence.by_chance)
        return ("not_enough_excitation" if uncertain else "not_judged"), uncertain, {}
    if any(cause.suspect for cause in causes):
        # A fit to such a recording is wrong in every respect: nothing it shows is a cause.
        return "suspect_recording", [], {}
    quiet, uncertain = too_quiet(evidence), too_uncertain(model, *evidence.by_chance)
    clock = clock_suspect(model, evidence.trajectory, determined=not uncertain)
    clock = [*timing_suspect(model, evidence.effects), *clock]
    if suspects := [*clock, *([] if quiet else unit_suspect(model))]:
        return "suspect_recording", suspects, {}
    if quiet or evidence.effects is None or uncertain:
        return "not_enough_excitation", quiet or uncertain, {}
    if wrong := too_wrong(model, *evidence.total, evidence.effects):
        return "not_trusted", wrong, {}
    # Flights come last, since they take longer than everything else.
    law = tuning_for(model).law.kind
    flown = {law: rehearse(model, evidence.trajectory, evidence.effects)}
    if flown[law].settles:
        return "trusted", [], flown
    cause, _, remedy = flown[law].remedy.partition(". ")
    return "not_trusted", [Finding("control", cause.removesuffix("."), remedy=remedy)], flown


def _parameters(evidence: Evidence, findings: Sequence[Finding]) -> ParametersVerdict:
    """Judge whether parameters are right within their errors, as far as a recording shows."""
    model, effects = evidence.model, evidence.effects
    why = [one.cause for one in findings if one.kind not in ("excitation", "control", "actuator")]
    if why or effects is None or model.known is None:
        return ParametersVerdict(False if why else None, tuple(why))
    chance, response = evidence.by_chance
    for share, error, own, (way, *_) in zip(
        effects.push, effects.push_error, chance, WAYS, strict=True
    ):
        if abs(share) > max(_SIGNIFICANT * math.hypot(error, own), _LEAST_SHARE):
            size = "larger" if share > 0 else "smaller"
            why.append(
                f"The modelled acceleration {way} is {percent(abs(float(share)))} {size} than the "
                f"recording shows (± {percent(float(error))})"
            )
    late = max(_SIGNIFICANT * math.hypot(effects.later_error, response), _LEAST_DELAY)
    if abs(effects.later) > patience(model.vehicle) * late:
        when = "later" if effects.later > 0 else "earlier"
        why.append(f"Commands act {1e3 * abs(effects.later):.1f} ms {when} than modelled")
    if abs(low := float(np.median(effects.low))) > _LEAST_LOW:
        why.append(f"Thrusts at low speed are wrong by {percent(abs(low))}")
    return ParametersVerdict(not why, tuple(f"{one}." for one in why))


def _compared(evidence: Evidence) -> list[str]:
    """Compare predictions with a craft that coasts."""
    missed = evidence.missed
    if missed is None:
        return []
    shares = ", ".join(
        percent(float(share)) if share <= 1 else "more than 100 %" for share in missed
    )
    return [
        f"In the typical window of this recording, its errors of x, y and yaw are {shares} of the "
        "errors of constant velocity, a craft that coasts."
    ]


def _known(evidence: Evidence, flown: Mapping[str, Rehearsal]) -> list[str]:
    """Describe why the model is trusted."""
    relative, error = evidence.total
    laws = [law_class(name).__name__ for name, one in flown.items() if one.settles]
    response = _with_error(1e3 * response_time(evidence.model), 1e3 * error)
    return [
        f"Its largest acceleration is known to {percent(float(relative.max()))} in every "
        f"direction; the response time τ + d is {response} ms. Systematic errors that this "
        f"recording shows are included. In simulation, {' and '.join(laws)} with the "
        f"usual tuning settle{'s' * (len(laws) == 1)} on such a craft."
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
    names = "motor_time_constant", "transport_delay"
    if model.known is None or not model.learned.issuperset(names):
        return []
    masks = (model.parameters.mask(frozenset({name})) for name in names)
    lag, delay = (int(np.flatnonzero(mask)[0]) for mask in masks)
    error = float(model.standard_error(response_time))
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
        f"({1e3 * response_time(model):.2f} ms); the split is not: {why}."
    ]


def _errors_in_words(errors: dict[str, float]) -> list[str]:
    """Write the relative errors, combining the thrusts."""
    thrusts = [error for label, error in errors.items() if label.startswith("F(")]
    listed = {label: e for label, e in errors.items() if not label.startswith("F(")}
    words = [f"{label} {percent(error)}" for label, error in listed.items()]
    if thrusts:
        low, high = percent(min(thrusts)), percent(max(thrusts))
        words.append(f"thrusts at full speed {low if low == high else f'{low} to {high}'}")
    scale = " (α: of 1 rad; r: of the propellers' lever arm)" if "α" in listed else ""
    return [f"Statistical errors: {', '.join(words)}{scale}."] if words else []


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
        thrusts = [q.value(model) for q in main_quantities(model) if q.parameter == "thrust"]
        return max(abs(float(quantity.value(model))), float(np.median(np.abs(thrusts))) / 2)
    if quantity.parameter == "angle_offset":
        return quantity.factor * _WHOLE_ANGLE
    if quantity.parameter == "center_of_mass":
        return quantity.factor * float(np.hypot(*model.vehicle.positions.T).mean())
    return abs(float(quantity.value(model))) if quantity.positive else 0.0


def _with_error(value: float, error: float) -> str:
    """Write a value to the two digits of its error."""
    digits = max(1 - math.floor(math.log10(error)), 0) if 0 < error < math.inf else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}"
