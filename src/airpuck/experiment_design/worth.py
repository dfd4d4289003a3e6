"""What an excitation is worth that was rehearsed: expected errors, by which plans are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.excitation_plan import ExcitationPlan
from airpuck.experiment_design.expected_errors import Forecast, Information, joined
from airpuck.experiment_design.quantities_of_interest import (
    HELD,
    RelativeErrors,
    interests,
    scales_of,
)
from airpuck.experiment_design.rehearsal import Rehearsal
from airpuck.model.model_file import Model

#: By what candidates are compared: the largest relative error, or the geometric mean of all.
Criterion = Literal["worst", "mean"]


@dataclass(frozen=True, eq=False)
class Candidate:
    """An excitation, and what it is expected to give."""

    #: What to fly.
    plan: ExcitationPlan
    #: Least distance to a rail in all its rehearsals [m]; 0: it met one.
    clearance: float
    #: Standard errors after the flight, with what is known before, in shares of the scale of each
    #: interest; infinite where one stays undetermined.
    relative: Float[np.ndarray, " K"]
    #: The same from this flight alone, on the twin.
    alone: Float[np.ndarray, " K"]
    #: The criterion, smaller is better; infinite for what is refused.
    score: float
    #: Why it is not proposed; empty where it may be.
    refused: str


class Judge:
    """Compares what was flown."""

    def __init__(self, model: Model, criterion: Criterion, margin: float) -> None:
        self.wanted, self.margin = interests(model), margin
        self._model, self._criterion = model, criterion
        self._scale = scales_of(self.wanted)
        self.relative = RelativeErrors(model, self.wanted).of
        self.flown: dict[ExcitationPlan, list[Rehearsal]] = {}
        #: Of the usual excitation, prepared as for the model's fit; None where all flights are.
        self.as_fitted: list[Information] | None = None
        #: Whether the loss of the model's fit says how large its residuals are.
        self.scaled = model.fit.get("loss") is not None and not model.fit.get("robust")

    def level(self, usual: ExcitationPlan) -> float:
        """Return the variance of the residuals of the model's fit, in those of the twin."""
        told = self._informations(usual) if self.as_fitted is None else self.as_fitted
        if not (self.scaled and told):
            return 1.0
        return float(self._model.fit["loss"]) / joined(told).loss

    def ranked(self) -> list[Candidate]:
        """Judge all plans that were flown."""
        forecast = self._forecast()
        found = (self._judged(plan, forecast) for plan in self.flown)
        return sorted(found, key=lambda one: (one.score, -one.clearance))

    def candidate(self, plan: ExcitationPlan) -> Candidate:
        """Judge a plan by all its flights."""
        return self._judged(plan, self._forecast())

    def _informations(self, plan: ExcitationPlan) -> list[Information]:
        """Return what all flights of a plan say."""
        return [one.information for one in self.flown[plan] if one.information is not None]

    def _forecast(self) -> Forecast:
        """Return what predicts errors, from all that was flown."""
        known = [one for plan in self.flown for one in self._informations(plan)]
        if not known:
            raise InputError(
                "every rehearsal met a rail; are the table's length and width right?",
                field="table",
            )
        # The usual excitation is the first.
        return Forecast(self._model, known, self.level(next(iter(self.flown))))

    def _judged(self, plan: ExcitationPlan, forecast: Forecast) -> Candidate:
        """Judge a plan by all its flights."""
        clearance = min(one.clearance for one in self.flown[plan])
        refused = ""
        if clearance < self.margin:
            refused = "meets a rail" if clearance == 0 else f"{1e3 * clearance:.0f} mm from a rail"
        relative = alone = np.full(len(self.wanted), np.inf)
        known = self._informations(plan)
        if known:
            flight = joined(known)
            relative = self.relative(forecast.of(flight, plan.duration_s))
            alone = self.relative(forecast.of(flight, plan.duration_s, alone=True))
        score = math.inf if refused else self._score(relative)
        return Candidate(plan, clearance, relative, alone, score, refused)

    def _score(self, relative: Float[np.ndarray, " K"]) -> float:
        """Return the criterion, of what has a size and no constraint holds."""
        judged = relative[np.isfinite(self._scale) & (relative > HELD)]
        if self._criterion == "worst" or not np.isfinite(judged).all():
            return float(judged.max(initial=0.0))
        return float(np.exp(np.log(judged).mean()))
