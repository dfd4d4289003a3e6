"""Experiment design: find the excitation that reduces the largest uncertainties most."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.control.settings import Criterion, ExcitationPlan, ProposedDuration, ProposedMargin
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.experiment_design.forecast import (
    HELD,
    ComparedQuantities,
    Forecast,
    Information,
    ProgressCallback,
    Trial,
    fly_trial,
    joined,
    on_processes,
)
from airpuck.model.model_file import Model
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import check_seed

#: The first candidates: all combinations of amplitudes, hold times and margins.
_AMPLITUDES = (1.0, 0.6)
_HOLDS = (0.15, 0.25, 0.4, 0.6)
_MARGINS = (0.05, 0.15)
#: Then variations of the best: of its hold time, of its margin, and of single amplitudes.
_STRETCHES = (0.8, 1.25)
_WEAKER = 0.6
#: Number of finalists flown at full length, and flights of each. If none stays away from the rails,
#: the next candidates follow.
_FINALISTS, _FLIGHTS = 3, 3


@dataclass(frozen=True, eq=False)
class CandidateFlight(Result):
    """An excitation and its expected accuracy."""

    JSON = (
        "amplitude=plan.amplitude hold_s=plan.hold_s duration_s=plan.duration_s "
        "margin_m=plan.margin_m clearance_m=clearance score refused relative_error"
    )

    #: The quantities whose errors it predicts.
    quantities: ComparedQuantities
    #: The excitation to fly.
    plan: ExcitationPlan
    #: Smallest distance to a rail in all its trials [m]; 0: it touched one.
    clearance: float
    #: Relative standard errors after the flight, including prior knowledge; infinite where a
    #: quantity stays undetermined.
    relative: Float[np.ndarray, " K"]
    #: The criterion, smaller is better; infinite for rejected candidates.
    score: float
    #: Reason for rejection; empty if it may be proposed.
    refused: str

    @property
    def relative_error(self) -> dict[str, float]:
        """Relative standard error after the flight, by quantity; None: undetermined."""
        return self.quantities.labelled(self.relative)


@dataclass(frozen=True, eq=False)
class Design(Result):
    """A proposal and its alternatives."""

    JSON = "criterion residual_level quantities known usual proposal candidates"

    #: The true model of the trials, whose uncertainty is the prior knowledge.
    model: Model
    #: Unit of each quantity, and the scale of its errors.
    quantities: ComparedQuantities
    #: Relative standard errors before the flight; infinite where nothing is known.
    relative_before: Float[np.ndarray, " K"]
    #: The paper's excitation, with the same length.
    usual: CandidateFlight
    #: The best candidate that stays away from the rails.
    proposal: CandidateFlight
    #: All flown candidates, the best first.
    candidates: tuple[CandidateFlight, ...]
    #: Rule that combines errors of several quantities into one score.
    criterion: Criterion
    #: Variance of the residuals of the model's fit, relative to the twin's.
    residual_level: float

    @property
    def known(self) -> dict[str, float]:
        """Relative standard error before the flight, by quantity; None: unknown."""
        return self.quantities.labelled(self.relative_before)


def design(
    model: Model,
    *,
    duration: ProposedDuration = 60.0,
    criterion: Criterion = "worst",
    margin: ProposedMargin = 0.08,
    rehearsal: ProposedDuration = 20.0,
    amplitudes: Sequence[float] = _AMPLITUDES,
    holds: Sequence[float] = _HOLDS,
    seed: int = 0,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    processes: int | None = None,
    progress: ProgressCallback = lambda _done, _total: None,
) -> Design:
    """Propose the excitation to fly next.

    Parameters
    ----------
    model : Model
        Model of the craft; its uncertainty is the prior knowledge.
    duration : float, default 60
        Length of the flight to propose [s].
    criterion : {"worst", "mean"}, default "worst"
        The largest relative standard error, or the geometric mean of all.
    margin : float, default 0.08
        Smallest distance of the craft to the rails in every trial flight [m].
    rehearsal : float, default 20
        Length of the trial flights of all candidates [s]. The best are then flown at full length.
    amplitudes, holds : sequence of float
        Amplitudes and hold times [s] to combine first.
    seed : int, default 0
        Seed of the trial flights.
    settings : TwinSettings, optional
        Settings of the twin; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    processes : int, optional
        By default one per core. The result does not depend on it.
    progress : callable, optional
        Called with the seconds of trial flights done, and the expected total.

    Returns
    -------
    Design
        The proposal, and all candidates.

    Raises
    ------
    InputError
        If a number is out of range, the model has no learned parameters, or no candidate keeps the
        margin.

    Notes
    -----
    The residuals of a real flight are larger than the twin's. If the model records the loss of its
    fit, predictions are scaled by its ratio to the loss of the usual excitation on the twin. This
    does not apply after a robust fit, whose loss includes faults that it does not follow. If the
    model was fitted with a fixed delay, so is the twin's flight that its loss is compared with.

    Examples
    --------
    >>> found = airpuck.design(model, duration=60.0)  # doctest: +SKIP
    >>> found.proposal.plan.save("plan.toml")  # doctest: +SKIP
    >>> airpuck.design(model, duration=1.0)
    Traceback (most recent call last):
        ...
    airpuck.boundary.errors.InputError: ...
    """
    tuning, settings = tuning or tuning_for(model), settings or default_twin_settings()
    check_seed(seed)
    if not model.free.any():
        raise InputError("has no learned parameters; use an identified model", file=model.name)
    given, model = model, _as_learned_next(model)
    usual = ExcitationPlan(duration_s=duration)
    grid = [
        replace(usual, amplitude=a, hold_s=h, margin_m=m)
        for a in amplitudes
        for h in holds
        for m in _MARGINS
        if h >= tuning.period_s
    ]
    short = min(rehearsal, duration)
    near = len(_near(usual, model, tuning.period_s))
    expected = short * (1 + len(grid) + near) + duration * _FLIGHTS * (1 + _FINALISTS)
    with on_processes(processes) as run:
        search = _Search(
            model, usual, criterion, margin, settings, tuning, seed, run, progress, expected
        )
        if search.fit_has_loss and model.delay_learned and not given.delay_learned:
            search.as_fitted = [t for _, t in search.flown(given, [usual], short, _FLIGHTS)]
        search.fly([usual, *(plan for plan in grid if plan != usual)], short)
        search.fly(_near(search.ranked()[0].plan, model, tuning.period_s), short)
        search.fly([usual], duration, _FLIGHTS)
        proposal = search.finals(duration)
    ranked = search.ranked()
    return Design(
        model=model,
        quantities=search.quantities,
        relative_before=search.quantities.relative_errors(model.known),
        usual=next(one for one in ranked if one.plan == usual),
        proposal=proposal,
        candidates=tuple(ranked),
        criterion=criterion,
        residual_level=search.residual_level(),
    )


@dataclass(eq=False)
class _Search:
    """Completed trial flights, and their information about each plan."""

    model: Model
    #: The excitation of the paper.
    usual: ExcitationPlan
    criterion: Criterion
    #: Smallest distance to a rail [m].
    margin: float
    settings: TwinSettings
    tuning: Tuning
    seed: int
    #: Like the built-in `map`.
    run: Callable[..., Iterable[Any]]
    progress: ProgressCallback
    #: Expected seconds of trial flights; the number may grow.
    expected: float

    def __post_init__(self) -> None:
        """Begin without any flights."""
        self.quantities = ComparedQuantities(self.model)
        fit = self.model.fit
        #: Whether the loss of the model's fit indicates the size of its residuals.
        self.fit_has_loss = fit.get("loss") is not None and not fit.get("robust")
        self._trials: dict[ExcitationPlan, list[Trial]] = {}
        #: Trials of the usual excitation, prepared as for the model's fit; None: prepared like all
        #: flights.
        self.as_fitted: list[Trial] | None = None
        self._flights, self._done_s = 0, 0.0

    def fly(self, plans: Sequence[ExcitationPlan], length: float, flights: int = 1) -> None:
        """Fly plans for a few seconds."""
        for plan, trial in self.flown(self.model, plans, length, flights):
            self._trials.setdefault(plan, []).append(trial)

    def flown(
        self, model: Model, plans: Sequence[ExcitationPlan], length: float, flights: int
    ) -> Iterator[tuple[ExcitationPlan, Trial]]:
        """Fly plans, each flight with its own seed."""
        repeated = [plan for plan in plans for _ in range(flights)]
        flown = [replace(plan, duration_s=length) for plan in repeated]
        seeds = range(self.seed + self._flights, self.seed + self._flights + len(flown))
        self._flights += len(flown)
        self.expected = max(self.expected, self._done_s + length * len(flown))
        act = partial(fly_trial, model, self.settings, self.tuning)
        for plan, trial in zip(repeated, self.run(act, flown, seeds), strict=True):
            self._done_s += length
            self.progress(self._done_s, self.expected)
            yield plan, trial

    def residual_level(self) -> float:
        """Return the variance of the residuals of the model's fit, relative to the twin's."""
        trials = self._trials[self.usual] if self.as_fitted is None else self.as_fitted
        flights = _informations(trials)
        if not (self.fit_has_loss and flights):
            return 1.0
        return float(self.model.fit["loss"]) / joined(flights).loss

    def ranked(self) -> list[CandidateFlight]:
        """Rate all flown plans, the best first."""
        flights = [one for trials in self._trials.values() for one in _informations(trials)]
        if not flights:
            raise InputError(
                "every trial flight met a rail; are the table's length and width right?",
                field="table",
            )
        forecast = Forecast(self.model, flights, self.residual_level())
        candidates = [self._rated(plan, forecast) for plan in self._trials]
        return sorted(candidates, key=lambda one: (one.score, -one.clearance))

    def finals(self, duration: float) -> CandidateFlight:
        """Fly the best at full length, and return the best of those that keep the margin."""
        final = [self.usual]
        while True:
            left = [one for one in self.ranked() if not one.refused]
            flown = [one for one in left if one.plan in final]
            waiting = [one.plan for one in left if one.plan not in final][:_FINALISTS]
            if any(one.plan != self.usual for one in flown) or (flown and not waiting):
                return flown[0]
            if not waiting:
                raise InputError(
                    f"no excitation keeps {1e3 * self.margin:g} mm away from the rails; allow less",
                    field="margin",
                )
            self.fly(waiting, duration, _FLIGHTS)
            final += waiting

    def _rated(self, plan: ExcitationPlan, forecast: Forecast) -> CandidateFlight:
        """Rate a plan by all its flights."""
        clearance = min(trial.clearance for trial in self._trials[plan])
        refused = ""
        if clearance < self.margin:
            refused = "meets a rail" if clearance == 0 else f"{1e3 * clearance:.0f} mm from a rail"
        relative = np.full(len(self.quantities.labels), np.inf)
        flights = _informations(self._trials[plan])
        if flights:
            after = forecast.of(joined(flights), plan.duration_s)
            relative = self.quantities.relative_errors(after)
        score = math.inf if refused else self._score(relative)
        return CandidateFlight(self.quantities, plan, clearance, relative, score, refused)

    def _score(self, relative: Float[np.ndarray, " K"]) -> float:
        """Compute the criterion from quantities that have a scale and no active constraint."""
        counted = relative[np.isfinite(self.quantities.scales) & (relative > HELD)]
        if self.criterion == "worst" or not np.isfinite(counted).all():
            return float(counted.max(initial=0.0))
        return float(np.exp(np.log(counted).mean()))


def _informations(trials: Sequence[Trial]) -> list[Information]:
    """Return the information from trials, except those that met a rail."""
    return [trial.information for trial in trials if trial.information is not None]


def _near(plan: ExcitationPlan, model: Model, period: float) -> list[ExcitationPlan]:
    """Return plans near a given one: other hold times, another margin, or one weaker signal."""
    changes: list[dict[str, Any]] = [
        {"hold_s": max(round(factor * plan.hold_s, 3), period)} for factor in _STRETCHES
    ]
    changes.append({"margin_m": sum(_MARGINS) / len(_MARGINS)})
    signals = len(model.vehicle.columns) - len(model.vehicle.pairs)
    for weak in range(signals if signals > 1 else 0):
        amplitude = np.broadcast_to(plan.amplitude, signals).astype(float)
        amplitude[weak] *= _WEAKER
        changes.append({"amplitude": tuple(np.round(amplitude, 3).tolist())})
    return [replace(plan, **change) for change in changes]


def _as_learned_next(model: Model) -> Model:
    """Learn the transport delay if the next fit will, on rungs with a motor lag."""
    if not model.rung.lag:
        return model
    delay = model.parameters.mask(frozenset({"transport_delay"}))
    uncertainty = model.known
    if uncertainty is not None and not model.delay_learned:
        # It has no variance because it was not learned, not because it is known.
        unknown = np.concatenate([uncertainty.undetermined, delay[None].astype(float)])
        uncertainty = replace(uncertainty, undetermined=unknown)
    return replace(model, free=model.free | delay, uncertainty=uncertainty)
