"""What to fly next: the excitation that shrinks the worst-determined quantities most."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.control.excitation_plan import ExcitationPlan
from airpuck.control.tuning import Tuning, default_tuning
from airpuck.experiment_design.quantities_of_interest import Interest
from airpuck.experiment_design.rehearsal import Act, Crew, Rehearsal, Stage, World
from airpuck.experiment_design.worth import Candidate, Criterion, Judge
from airpuck.model.model_file import Model
from airpuck.model.rungs import named_rung
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import check_seed

#: The first candidates: all combinations of amplitudes, hold times and margins.
_AMPLITUDES = (1.0, 0.6)
_HOLDS = (0.15, 0.25, 0.4, 0.6)
_MARGINS = (0.05, 0.15)
#: Then changes of the best: of its hold time, of its margin, and of single amplitudes.
_STRETCHES = (0.8, 1.25)
_WEAKER = 0.6
#: The best so many are flown at full length, so often each; if none of them keeps away from the
#: rails, the next ones.
_FINALISTS, _FLIGHTS = 3, 3


@dataclass(frozen=True, eq=False)
class Design:
    """A proposal, and what it was chosen from."""

    #: The truth of the rehearsals, and what is known before.
    model: Model
    #: What candidates are judged by.
    wanted: tuple[Interest, ...]
    #: Relative standard errors now; infinite where nothing is known.
    known: Float[np.ndarray, " K"]
    #: The excitation of the paper, of the same length.
    usual: Candidate
    #: The best that keeps away from the rails.
    proposal: Candidate
    #: All that were rehearsed, the best first.
    candidates: tuple[Candidate, ...]
    #: By what.
    criterion: Criterion
    #: Variance of the residuals of the model's fit, in those of the twin.
    level: float
    #: Where it was rehearsed.
    stage: Stage

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        labels = [one.label for one in self.wanted]

        def by_label(errors: Float[np.ndarray, " K"]) -> dict[str, float | None]:
            return {
                label: float(error) if math.isfinite(error) else None
                for label, error in zip(labels, errors, strict=True)
            }

        def figures(candidate: Candidate) -> dict[str, Any]:
            return {
                **candidate.plan.model_dump(mode="json"),
                "clearance_m": candidate.clearance,
                "score": candidate.score if math.isfinite(candidate.score) else None,
                "refused": candidate.refused,
                "relative_error": by_label(candidate.relative),
                "relative_error_alone": by_label(candidate.alone),
            }

        return {
            "criterion": self.criterion,
            "residual_level": self.level,
            "quantities": {
                one.label: {"unit": one.unit, "scale": one.scale} for one in self.wanted
            },
            "known": by_label(self.known),
            "usual": figures(self.usual),
            "proposal": figures(self.proposal),
            "candidates": [figures(candidate) for candidate in self.candidates],
        }


def design(
    model: Model,
    *,
    duration: float = 60.0,
    criterion: Criterion = "worst",
    margin: float = 0.08,
    rehearsal: float = 20.0,
    amplitudes: Sequence[float] = _AMPLITUDES,
    holds: Sequence[float] = _HOLDS,
    seed: int = 0,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Design:
    """Propose the excitation to fly next.

    Parameters
    ----------
    model : Model
        What is believed of the craft; with its uncertainty, that is what is known before.
    duration : float, default 60
        Length of the flight to propose [s].
    criterion : {"worst", "mean"}, default "worst"
        The largest relative standard error, or the geometric mean of all.
    margin : float, default 0.08
        Least distance of the craft to the rails in every rehearsal [m].
    rehearsal : float, default 20
        Length of the rehearsals of all candidates [s]. The best are then flown at full length.
    amplitudes, holds : sequence of float
        Amplitudes and hold times [s] to combine at first.
    seed : int, default 0
        Seed of the rehearsals.
    settings : TwinSettings, optional
        Of the twin; by default the packaged ones.
    tuning : Tuning, optional
        Of the controller; by default the packaged one.
    processes : int, optional
        By default one for each core. The result does not depend on it.
    progress : callable, optional
        Called with the number of rehearsals done, and of those that are due so far.

    Returns
    -------
    Design
        The proposal, and all candidates.

    Raises
    ------
    InputError
        If a number is out of range, the model has learned nothing, or no candidate keeps the
        margin.

    Notes
    -----
    The residuals of a real flight are larger than those of the twin. Where the model says with what
    loss it was fitted, predictions are scaled by its ratio to the loss of the usual excitation on
    the twin; not so after a robust fit, whose loss counts faults that it does not follow. Where the
    model was fitted with a fixed delay, so is the twin's flight that its loss is compared with.
    """
    tuning, settings = tuning or default_tuning(), settings or default_twin_settings()
    _check(model, duration, criterion, margin, rehearsal, seed)
    given, model = model, _as_learned_next(model)
    stage = Stage(model, settings, tuning)
    usual = ExcitationPlan(duration_s=duration)
    grid = [
        usual.model_copy(update={"amplitude": a, "hold_s": h, "margin_m": m})
        for a in amplitudes
        for h in holds
        for m in _MARGINS
        if h >= tuning.period_s
    ]
    signals = model.vehicle.n_propellers - len(model.vehicle.pairs)
    judge = Judge(model, criterion, margin)
    with Crew(stage, processes) as crew:
        rehearsals = _Rehearsals(crew, judge, seed, progress)
        short = min(rehearsal, duration)
        if judge.scaled and model.delay_learned and not given.delay_learned:
            rehearsals.fly_as_fitted(given, usual, short)
        rehearsals.fly([usual, *(plan for plan in grid if plan != usual)], short)
        rehearsals.fly(_near(judge.ranked()[0].plan, signals, tuning.period_s), short)
        rehearsals.fly([usual], duration, _FLIGHTS)
        chosen = _finals(rehearsals, judge, usual, duration)
    return Design(
        model=model,
        wanted=judge.wanted,
        known=judge.relative(model.uncertainty),
        usual=judge.candidate(usual),
        proposal=chosen,
        candidates=tuple(judge.ranked()),
        criterion=criterion,
        level=judge.level(usual),
        stage=stage,
    )


def _finals(
    rehearsals: _Rehearsals, judge: Judge, usual: ExcitationPlan, duration: float
) -> Candidate:
    """Fly the best at full length, and return the best of those that keep the margin."""
    final = [usual]
    while True:
        left = [one for one in judge.ranked() if not one.refused]
        flown = [one for one in left if one.plan in final and one.plan != usual]
        if flown:
            return min((one for one in left if one.plan in final), key=lambda one: one.score)
        waiting = [one.plan for one in left if one.plan not in final][:_FINALISTS]
        if not waiting:
            if left:
                # The usual one, which was flown before.
                return left[0]
            raise InputError(
                f"no excitation keeps {1e3 * judge.margin:g} mm away from the rails; lower it",
                field="margin",
            )
        rehearsals.fly(waiting, duration, _FLIGHTS)
        final += waiting


class _Rehearsals:
    """Flies plans, each flight with chances of its own, and counts them."""

    def __init__(
        self, crew: Crew, judge: Judge, seed: int, progress: Callable[[int, int], None]
    ) -> None:
        self._crew, self._judge, self._seed, self._progress = crew, judge, seed, progress
        self._done = 0

    def fly(self, plans: Sequence[ExcitationPlan], length: float, flights: int = 1) -> None:
        """Fly plans for some seconds, and hand the results to the judge."""
        for plan, one in self._flown(Stage.rehearse, plans, length, flights):
            self._judge.flown.setdefault(plan, []).append(one)

    def fly_as_fitted(self, model: Model, usual: ExcitationPlan, length: float) -> None:
        """Fly the usual plan for what a model fitted like this one leaves unexplained."""
        flown = self._flown(partial(_rehearse_as, model), [usual], length, _FLIGHTS)
        self._judge.as_fitted = [one.information for _, one in flown if one.information is not None]

    def _flown(
        self, act: Act[Rehearsal], plans: Sequence[ExcitationPlan], length: float, flights: int
    ) -> Iterator[tuple[ExcitationPlan, Rehearsal]]:
        """Fly plans for some seconds."""
        owners = [plan for plan in plans for _ in range(flights)]
        tasks = [
            (plan.model_copy(update={"duration_s": length}), self._seed + self._done + number)
            for number, plan in enumerate(owners)
        ]
        total = self._done + len(tasks)
        for plan, one in zip(owners, self._crew.fly(act, tasks), strict=True):
            self._done += 1
            self._progress(self._done, total)
            yield plan, one


def _rehearse_as(
    model: Model, stage: Stage, plan: ExcitationPlan, seed: int, world: World
) -> Rehearsal:
    """Rehearse on a stage whose model differs only in what is learned."""
    return replace(stage, model=model).rehearse(plan, seed, world)


def _near(plan: ExcitationPlan, signals: int, period: float) -> list[ExcitationPlan]:
    """Return plans near one: other hold times, and one signal weaker than the others."""
    found = [
        plan.model_copy(update={"hold_s": max(round(factor * plan.hold_s, 3), period)})
        for factor in _STRETCHES
    ]
    between = sum(_MARGINS) / len(_MARGINS)
    found.append(plan.model_copy(update={"margin_m": between}))
    each = np.broadcast_to(plan.amplitude, signals)
    for weak in range(signals if signals > 1 else 0):
        scaled = each * np.where(np.arange(signals) == weak, _WEAKER, 1.0)
        found.append(plan.model_copy(update={"amplitude": tuple(np.round(scaled, 3).tolist())}))
    return found


def _as_learned_next(model: Model) -> Model:
    """Free the transport delay where the next fit will: on rungs with a motor lag."""
    if not named_rung(model.name).lag:
        return model
    delay = model.parameters.mask(frozenset({"transport_delay"}))
    uncertainty = model.uncertainty
    if uncertainty is not None and not model.delay_learned:
        # It has no variance since it was not learned, not since it were known.
        unknown = np.concatenate([uncertainty.undetermined, delay[None].astype(float)])
        uncertainty = replace(uncertainty, undetermined=unknown)
    return replace(model, free=model.free | delay, uncertainty=uncertainty)


def _check(
    model: Model, duration: float, criterion: str, margin: float, rehearsal: float, seed: int
) -> None:
    """Refuse what cannot be rehearsed."""
    check_seed(seed)
    if criterion not in ("worst", "mean"):
        raise InputError(f"must be 'worst' or 'mean', not {criterion!r}", field="criterion")
    if not (math.isfinite(margin) and margin > 0):
        raise InputError("must be a positive number of metres", field="margin")
    for name, value in (("duration", duration), ("rehearsal", rehearsal)):
        if not (math.isfinite(value) and value >= 6):
            raise InputError("must be at least 6 s: several blocks of time", field=name)
    if not model.free.any():
        raise InputError("has learned no parameters; give one that was identified", file=model.name)
