"""Whether a model can be trusted for control, in words: from what is known of its errors.

The limits, and why they are where they are, stand in docs/method.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.numbers import percent
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import Evaluation
from airpuck.evaluation.main_quantities import MainQuantity, main_quantities
from airpuck.evaluation.presentation import WAYS, largest_acceleration
from airpuck.model.model_file import Model

#: Largest relative standard error of an acceleration that control may ask for.
ACCELERATION_LIMIT = 0.1
#: Largest standard error of the response time, lag and delay together [s].
RESPONSE_LIMIT = 0.005
#: Largest share of the commanded motion that predictions may miss, in the typical window.
MISSED_LIMIT = 0.25
#: Relative standard error above which a quantity is called unknown.
UNKNOWN_LIMIT = 0.3
#: Correlation of motor lag and transport delay below which data know their sum only.
_NO_SPLIT = -0.9
#: An error of this size counts as a whole: an angle of a radian turns a thrust away altogether.
_WHOLE_ANGLE = 1.0


@dataclass(frozen=True)
class Verdict:
    """Whether a model can be trusted for control.

    Attributes
    ----------
    trusted : bool or None
        None where nothing is known of its errors.
    sentences : tuple of str
        In words: the outcome, then what is wrong, then what else is known.
    relative_errors : dict
        Standard errors of what was learned, by label, relative to its natural size; infinite where
        the data do not determine it.
    missed : array, shape (3,), or None
        Share of the commanded motion of x, y and yaw that predictions of another recording miss.
    """

    trusted: bool | None
    sentences: tuple[str, ...]
    relative_errors: dict[str, float]
    missed: Float[np.ndarray, " 3"] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "trusted": self.trusted,
            "sentences": list(self.sentences),
            "relative_errors": self.relative_errors,
            "missed": None if self.missed is None else self.missed.tolist(),
        }


def missed_motion(evaluation: Evaluation, trajectory: Trajectory) -> Float[np.ndarray, " 3"]:
    """Return the share of what the commands did to x, y and yaw that predictions miss.

    What the commands did is the way from where the craft would have coasted to, at the speed that
    it had. Medians of both, so that windows with faults do not decide.
    """
    first = np.searchsorted(trajectory.time, evaluation.start - trajectory.sample_period / 2)
    last = first + evaluation.horizon_step
    state, lasted = trajectory.state, trajectory.time[last] - trajectory.time[first]
    driven = state[last, :3] - state[first, :3] - state[first, 3:] * lasted[:, None]
    return evaluation.median_abs / np.maximum(np.median(np.abs(driven), axis=0), 1e-12)


def verdict(model: Model, missed: Float[np.ndarray, " 3"] | None = None) -> Verdict:
    """Judge whether a model can be trusted for control.

    Parameters
    ----------
    model : Model
        Any model.
    missed : array, shape (3,), optional
        From `missed_motion`, on a recording that it was not learned from.

    Returns
    -------
    Verdict
        The outcome, in words, worst first.
    """
    judged = model.known is not None
    errors = _relative_errors(model) if judged else {}
    wrong = [*_structural(model), *(_uncertain(model) if judged else ()), *_mispredicted(missed)]
    unknown = _unknown(model, errors)
    if wrong:
        trusted = False
        outcome = f"{model.name} cannot be trusted for control"
    elif not judged and missed is None:
        trusted = None
        outcome = f"{model.name}: whether it can be trusted for control is not known"
    else:
        trusted = True
        outcome = f"{model.name} can be trusted for control"
    outcome += ", as far as its own data tell." if missed is None and trusted else "."
    known = [] if wrong else _known(model, missed)
    more = [] if judged else ["Nothing is known of its parameters' errors: identify it anew."]
    if judged and missed is None:
        more.append("How it predicts a flight that it was not learned from is not known: give one.")
    sentences = (
        outcome,
        *wrong,
        *unknown,
        *_timing(model),
        *known,
        *more,
        *_errors_in_words(errors),
    )
    return Verdict(trusted, sentences, errors, missed)


def _structural(model: Model) -> list[str]:
    """Tell what a model lacks, or its fit."""
    found = []
    if model.fit.get("converged") is False:
        found.append("The fit had not converged: run it again, with more data or from nearby.")
    if not float(model.parameters.motor_time_constant) > 0:
        found.append("It has no motor lag, so that it expects every thrust too early: take M3.")
    return found


def _uncertain(model: Model) -> list[str]:
    """Tell which accelerations, and whether the response time, are not known well enough."""
    found = []
    size, error = largest_acceleration(model), model.standard_error(largest_acceleration)
    relative = np.where(np.isfinite(error), error, np.inf) / np.maximum(size, 1e-12)
    if relative.max() > ACCELERATION_LIMIT:
        ways = [f"{way} {percent(r)}" for (way, *_), r in zip(WAYS, relative, strict=True)
                if r > ACCELERATION_LIMIT]  # fmt: skip
        found.append(
            f"Its largest accelerations are not known to {percent(ACCELERATION_LIMIT)}: "
            f"{', '.join(ways)}. Use the whole range of all motors."
        )
    error = float(model.standard_error(_response_time))
    if not error <= RESPONSE_LIMIT:
        known = f"± {1e3 * error:.0f} ms" if np.isfinite(error) else "not determined"
        found.append(
            f"The response time τ + d is {known}, and should be known to "
            f"{1e3 * RESPONSE_LIMIT:.0f} ms: fly an excitation, whose commands switch."
        )
    return found


def _mispredicted(missed: Float[np.ndarray, " 3"] | None) -> list[str]:
    """Tell where predictions miss too much."""
    if missed is None or missed.max() <= MISSED_LIMIT:
        return []
    return [
        f"In the flight that it was judged on it misses {_channels(missed)} of what the commands "
        f"do to x, y and yaw, more than {percent(MISSED_LIMIT)}: a richer model may help, or a "
        "check of clocks, motor order and faults."
    ]


def _unknown(model: Model, errors: dict[str, float]) -> list[str]:
    """Name what is unknown, and the remedy."""
    named = []
    for quantity in _learned(model):
        if errors.get(quantity.label, 0.0) > UNKNOWN_LIMIT:
            error = float(model.standard_error(quantity.value))
            known = f"± {error:.2g} {quantity.unit}" if np.isfinite(error) else "not determined"
            named.append(f"{quantity.label} ({known})")
    if not named:
        return []
    return [
        f"Unknown: {', '.join(named)}. Fly an excitation; `airpuck design` says which finds them."
    ]


def _timing(model: Model) -> list[str]:
    """Say that the sum of lag and delay is known, and the split is not, where that is so."""
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


def _known(model: Model, missed: Float[np.ndarray, " 3"] | None) -> list[str]:
    """Tell what the trust rests on."""
    found = []
    if model.known is not None:
        size, error = largest_acceleration(model), model.standard_error(largest_acceleration)
        response, spread = _response_time(model), float(model.standard_error(_response_time))
        found.append(
            f"Its largest acceleration is known to {percent(float((error / size).max()))} in "
            f"every direction; the response time τ + d is "
            f"{_with_error(1e3 * response, 1e3 * spread)} ms."
        )
    if missed is not None:
        found.append(
            f"In the flight that it was judged on it misses {_channels(missed)} of what the "
            "commands do to x, y and yaw (typical window)."
        )
    return found


def _errors_in_words(errors: dict[str, float]) -> list[str]:
    """Write the relative errors, those of thrusts together."""
    thrusts = [error for label, error in errors.items() if label.startswith("F(")]
    listed = {label: e for label, e in errors.items() if not label.startswith("F(")}
    words = [f"{label} {percent(error)}" for label, error in listed.items()]
    if thrusts:
        low, high = percent(min(thrusts)), percent(max(thrusts))
        words.append(f"thrusts at full speed {low if low == high else f'{low} to {high}'}")
    shares = "of the value; of α 1 rad, of r the propellers' lever arm"
    return [f"Standard errors ({shares}): {', '.join(words)}."] if words else []


def _learned(model: Model) -> list[MainQuantity]:
    """Return what a model learned and whose size says how large an error is."""
    return [
        quantity
        for quantity in main_quantities(model)
        if quantity.used(model) and quantity.learned(model) and _size(model, quantity) > 0
    ]


def _relative_errors(model: Model) -> dict[str, float]:
    """Return standard errors relative to the natural size of each quantity.

    Those held by a constraint have none; those that the data do not determine are infinite.
    """
    found = {}
    for quantity in _learned(model):
        error = float(model.standard_error(quantity.value))
        if error != 0:
            found[quantity.label] = error / _size(model, quantity) if error > 0 else np.inf
    return found


def _size(model: Model, quantity: MainQuantity) -> float:
    """Return what an error of a quantity is relative to, in its unit; 0 where nothing is.

    That is its value, where it is positive by nature. An angle counts by the radian, the centre of
    mass by the lever arm of the propellers.
    """
    if quantity.parameter == "angle_offset":
        return quantity.factor * _WHOLE_ANGLE
    if quantity.parameter == "center_of_mass":
        return quantity.factor * float(np.hypot(*model.vehicle.positions.T).mean())
    return abs(float(quantity.value(model))) if quantity.positive else 0.0


def _response_time(model: Model) -> Any:
    """Return how long after a command a motor has followed it: lag and delay together [s]."""
    return model.parameters.motor_time_constant + model.transport_delay


def _channels(shares: Float[np.ndarray, " 3"]) -> str:
    """Write the shares of x, y and yaw."""
    return ", ".join(percent(float(share)) for share in shares)


def _with_error(value: float, error: float) -> str:
    """Write a value to the two digits of its error."""
    digits = max(1 - math.floor(math.log10(error)), 0) if 0 < error < math.inf else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}"
