"""`identify`, and the one policy for the structure of a model if none is named.

The floor comes first: M3 with the terms of the floor that the recording clearly shows. Then every
term that this fit lacks is tested at once (`missing_terms`). Terms that are significant, and that
predict held-out blocks of time noticeably better, are added in a second fit. The command line,
campaigns and studies use this policy, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Result
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory, vehicle_of
from airpuck.faults.strengths import usual_rung
from airpuck.identification import fit as fitting
from airpuck.identification.fit_result import Fit
from airpuck.identification.method import Iteration, Method
from airpuck.identification.missing_terms import (
    DEGREE,
    MissingTerm,
    missing_terms,
    unseen_level,
    with_shifts,
)
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.problem import prediction_loss
from airpuck.identification.residual import with_residual
from airpuck.identification.retiming import retime_packets
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.shared import identify_each
from airpuck.identification.uncertainty import with_held
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import NEURAL, Rung, named_rung
from airpuck.physics.rigid_body import CenterOfMassFrame
from airpuck.preprocessing.pipeline import Source, load_all
from airpuck.recording.mapping import RecordingMapping

#: Name that stands for the policy, as if no model were named.
AUTO = "auto"


@dataclass(frozen=True, eq=False)
class ModelStructure(Result):
    """The structure of a model: why it was chosen, and what it still lacks.

    Attributes
    ----------
    base : str
        The rung that was fitted first.
    chosen : str
        The rung of the result.
    added : tuple of MissingTerm
        Terms that were added to the first fit.
    missing : tuple of MissingTerm
        Significant terms that the result lacks.
    """

    JSON = "base chosen added missing"

    base: str
    chosen: str
    added: tuple[MissingTerm, ...] = ()
    missing: tuple[MissingTerm, ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """The choice in words."""
        return tuple(
            f"The structure is {self.chosen}: {one.term} lowers the mean squared error of held-out "
            f"parts by {percent(one.held_out)} or more"
            for one in self.added
        )


def identify(
    recordings: Source | Iterable[Source],
    model: str | Rung | None = None,
    *,
    vehicle: Vehicle | None = None,
    mapping: RecordingMapping | None = None,
    initial: Parameters | None = None,
    loss: Loss | None = None,
    method: Method | None = None,
    preparation: Preparation | None = None,
    progress: Callable[[Iteration], None] | None = None,
    each: Sequence[str] = (),
) -> Fit:
    """Identify a model by minimising its multi-step prediction error (eq. combined_loss).

    Parameters
    ----------
    recordings : path-like, Recording, Trajectory, or a sequence of these
        Data of one craft.
    model : str or Rung, optional
        The rung of the model ladder; see `airpuck.named_rung` for degrees and frames. By default,
        or if it is "auto": M3 with the terms that the recordings clearly show.
    vehicle : Vehicle, optional
        The craft; by default the craft that the trajectories were preprocessed for, or the paper's.
    mapping : RecordingMapping, optional
        Topics, files, columns, units and axes of recordings that are named by their paths.
    initial : Parameters, optional
        Initial parameters, for a named model; by default the vehicle's nominal values.
    loss : Loss, optional
        Which prediction errors count, and their weights.
    method : Method, optional
        The optimiser; by default `LevenbergMarquardt()`.
    preparation : Preparation, optional
        Whether faults are left out, the delay is learned and packets are retimed.
    progress : callable, optional
        Called after every iteration of the optimiser; by default a terminal or notebook shows one
        every ten seconds.
    each : sequence of str, optional
        What is fitted for each recording separately, as ``("delay", "tilt")``: ``delay``, ``lag``,
        ``angle``, ``thrust``, or terms of the model. The model has the last recording's values;
        see `Model.recordings`. By default the recordings share everything.

    Returns
    -------
    Fit
        The model, and details of the fit.

    Raises
    ------
    InputError
        If the data do not fit the vehicle or are too short, or the model does not exist.

    Examples
    --------
    >>> fit = airpuck.identify(trajectory, "M0")
    >>> fit.converged
    True
    >>> fit.model.save("model.toml")
    """
    options: dict[str, Any] = {"vehicle": vehicle, "initial": initial, "loss": loss}
    options |= {"method": method, "preparation": preparation, "progress": progress}
    return structured(recordings, model, mapping=mapping, each=each, **options)[0]


def structured(
    recordings: Source | Iterable[Source],
    model: str | Rung | None = None,
    *,
    mapping: RecordingMapping | None = None,
    degree: int | None = None,
    frame: CenterOfMassFrame = "body",
    each: Sequence[str] = (),
    **options: Any,
) -> tuple[Fit, ModelStructure]:
    """Identify a model, and test what it lacks; `options` as for `identify`."""
    trajectories = load_all(recordings, options.get("vehicle"), mapping)
    craft = options.get("vehicle") or vehicle_of(trajectories)
    free = model is None or model == AUTO
    # The published method, and a start of the user's own, are for one structure.
    usual = free and options.get("method") in (None, "lm") and options.get("initial") is None
    name = usual_rung(trajectories[0], craft) if usual else "M3" if free else model
    rung = named_rung(name, degree=degree, frame=frame) if isinstance(name, str) else name
    assert rung is not None
    neural = NEURAL in rung.effects
    if neural and each:
        raise InputError("cannot be combined with each; leave out one of them", field="model")
    if each and len(trajectories) == 1:
        raise InputError("needs several recordings, not one", field="each")
    rung = chosen = rung.physics

    solution: fitting.Solution | None = None

    def solved(rung: Rung) -> tuple[Model, PredictionLoss | None, Callable[[], Fit]]:
        nonlocal solution
        if each:
            joint = identify_each(trajectories, rung, each, **options)
            return joint.model, joint.objective, lambda: joint
        found = solution = fitting.solved(trajectories, rung, after=solution, **options)
        loss, _, simple = solution.result
        return simple, loss, lambda: fitting.judge(found)

    simple, loss, judge = solved(rung)
    found = missing_terms(simple, loss) if usual else []
    # Uncertainties take a third of a fit, and the first of two fits needs none.
    if added := with_shifts(simple, [one for one in found if one.worthwhile]):
        chosen = _richer(rung, [one.term for one in added], np.shape(simple.parameters.thrust)[1])
        simple, loss, judge = solved(chosen)
    fit = judge()
    if added or not usual:
        found = missing_terms(fit.model, fit.objective)
    missing = with_shifts(fit.model, found)
    fit = _widened(fit, missing, bent=any(one.term == DEGREE for one in (*added, *missing)))
    fit = with_residual(fit) if neural else fit
    return fit, ModelStructure(rung.name, fit.model.name, added, missing)


def lacking_on(model: Model, trajectory: Trajectory) -> tuple[MissingTerm, ...]:
    """Test what a model lacks on another recording, whatever its own parameters are there."""
    if not model.delay_learned:
        return ()
    loss = Loss().suited([trajectory], model.vehicle)
    loss = loss.remembering(float(np.max(model.dynamics.lag)))
    prepared, _ = retime_packets([trajectory], model)
    options: dict[str, Any] = {"frame": model.frame, "learns_delay": True}
    tested = prediction_loss(loss, prepared, model.vehicle, **options)
    return with_shifts(model, missing_terms(model, tested))


def _richer(rung: Rung, terms: Sequence[str], degree: int) -> Rung:
    """Add terms to a rung."""
    effects = "+".join([rung.name, *(term for term in terms if term != DEGREE)])
    bends = DEGREE in terms
    return named_rung(effects, degree=degree + 1 if bends else rung.degree, frame=rung.frame)


def _widened(fit: Fit, missing: Sequence[MissingTerm], bent: bool) -> Fit:
    """Widen the errors by what missing terms shift, and curves of another shape leave unseen."""
    known, loss = fit.model.known, fit.objective
    if known is None or loss is None or not (missing or bent):
        return fit
    sure = np.isfinite(known.standard_errors)
    changes, notes = [one.direction for one in missing], list(known.notes)
    if missing:
        lacking = ", ".join(one.term for one in missing)
        notes.append(f"errors include what the model lacks: {lacking}")
    if bent:
        changes.append(unseen_level(fit.model, loss))
        notes.append("errors of thrusts allow for what the curves may do at the slowest commands")
    wider = with_held(known, np.where(sure, changes, 0.0), held=np.zeros_like(sure))
    wider = replace(wider, notes=tuple(notes))
    return replace(fit, model=replace(fit.model, uncertainty=wider))
