"""`study`: one judgement of recordings, which commands, campaigns and reports show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding, Result, html_table
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import Evaluation, evaluate
from airpuck.faults.find import find_faults
from airpuck.faults.layout_findings import AXES
from airpuck.faults.strengths import Strengths, find_strengths, recording_findings, usual_rung
from airpuck.identification.bootstrap import bootstrap as resample
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.method import Iteration, Method
from airpuck.identification.missing_terms import ALL, CHANGE, DEGREE, DELAY, MissingTerm
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.structure import ModelStructure, lacking_on, structured
from airpuck.judgement.findings import actuator_causes
from airpuck.judgement.verdict import Verdict, verdict
from airpuck.model.model_file import Model, published_model
from airpuck.model.rungs import NEURAL, Rung
from airpuck.physics.rigid_body import CenterOfMassFrame
from airpuck.preprocessing.pipeline import Source, load_all, load_trajectory
from airpuck.recording.mapping import RecordingMapping

#: Of a longer recording this much is studied [s]: random errors are then far below those of the
#: model, and memory stays at some 3 GiB.
_LONGEST = 3600.0
_PART = "only the first hour of its poses was used; a span selects another part"


@dataclass(frozen=True, eq=False, repr=False)
class Study(Result):
    """What recordings say about a craft.

    Attributes
    ----------
    fit : Fit
        The model, and details of its fit.
    selection : ModelStructure
        Why the model has its structure, and what it lacks.
    verdict : Verdict
        Whether the model can be trusted for control, and whether its parameters are right.
    strengths : Strengths
        Each actuator's strength against the vehicle file, and against the others.
    training : tuple of Trajectory
        What the model was learned from.
    validation : Trajectory or None
        What it was evaluated on.
    evaluation : Evaluation or None
        How well it predicts the validation recording.

    Examples
    --------
    >>> airpuck.write_bag(recording, "bag/")
    >>> study = airpuck.study("bag/", model="M0")
    >>> isinstance(study, airpuck.Study), study.model.name, study.verdict.trusted
    (True, 'M0', False)
    """

    fit: Fit
    selection: ModelStructure
    verdict: Verdict
    strengths: Strengths
    training: tuple[Trajectory, ...]
    validation: Trajectory | None = None
    evaluation: Evaluation | None = None

    @property
    def model(self) -> Model:
        """The identified model."""
        return self.fit.model

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is wrong, causes first; see `Verdict.findings`."""
        return self.verdict.findings

    @property
    def sentences(self) -> tuple[str, ...]:
        """The study in words: verdict, structure and strengths."""
        found = *self.verdict.sentences, *self.selection.sentences, *self.strengths.sentences
        return tuple(dict.fromkeys(found))

    def __repr__(self) -> str:
        return f"Study({self.model.name}, {self.verdict.outcome}: {self.verdict.sentences[0]})"

    def _repr_html_(self) -> str:
        rows = [(finding.kind, finding.sentence) for finding in self.findings]
        found = html_table("Findings", ("cause", ""), rows) if rows else ""
        return self.model.html(" ".join(self.verdict.sentences[:1])) + found

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Returns
        -------
        dict
            The fit's fields, and ``verdict``, ``findings``, ``parameters``, ``controller``,
            ``strengths`` and ``selection``; with another recording ``validation``.
        """
        said = self.verdict.to_json()
        figures = {**self.fit.to_json(), "verdict": said}
        figures |= {key: said[key] for key in ("findings", "parameters", "controller")}
        figures |= {"strengths": self.strengths.to_json(), "selection": self.selection.to_json()}
        if self.evaluation is not None:
            figures["validation"] = self.evaluation.to_json()
        return figures


def study(
    recordings: Source | Iterable[Source],
    vehicle: Vehicle | None = None,
    model: str | Rung | None = None,
    validation: Source | None = None,
    *,
    mapping: RecordingMapping | None = None,
    span: tuple[float, float] | None = None,
    degree: int | None = None,
    frame: CenterOfMassFrame = "body",
    loss: Loss | None = None,
    method: Method | None = None,
    preparation: Preparation | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    laws: Sequence[str] = (),
    each: Sequence[str] = (),
    progress: Callable[[Iteration], None] | None = None,
    resampled: Callable[[int], None] = lambda _: None,
) -> Study:
    """Identify a model of a craft from recordings, and judge it.

    Parameters
    ----------
    recordings : path-like, Recording, Trajectory, or a sequence of these
        Recordings of one craft; only the first hour of a longer one is studied.
    vehicle : Vehicle, optional
        The craft; by default the one of the trajectories, or the paper's.
    model : str or Rung, optional
        The rung; by default M3 with the terms that the recordings clearly show.
    validation : path-like, Recording or Trajectory, optional
        Another recording, to evaluate the model on.
    mapping : RecordingMapping, optional
        Topics, columns, units and axes of the recordings.
    span : tuple of float, optional
        Part of each recording to learn from, as fractions of its length.
    degree : int, optional
        Degree of the thrust polynomials.
    frame : {"body", "world"}, default "body"
        The frame in which the offset of the centre of mass is constant.
    loss, method, preparation, each, progress
        As for `airpuck.identify`. With `each`, the last recording is judged.
    bootstrap : int, default 0
        Number of fits to resampled data, for bootstrap intervals; `seed` is their seed.
    seed : int, default 0
        See `bootstrap`.
    laws : sequence of str, optional
        Laws to fly in simulation besides the default one, such as ``mpc``, which takes seconds.
    resampled : callable, optional
        Called with the number of resampled fits done.

    Returns
    -------
    Study
        The model, its evaluation, and what is wrong.

    Raises
    ------
    InputError
        If a recording cannot be used, or the model does not exist.

    Examples
    --------
    >>> study = airpuck.study(trajectory, model="M0")
    >>> study.findings[0].kind
    'physics'
    """
    training = load_all(recordings, vehicle, mapping)
    if span is not None:
        training = [one.slice(*span) for one in training]
    parts = [(t, _LONGEST / (t.sample_period * len(t))) for t in training]
    told = [f"{t.source}: {_PART}" for t, part in parts if part < 1]
    training = [t.slice(0.0, part) if part < 1 else t for t, part in parts]
    other = None
    if validation is not None:
        other = load_trajectory(validation, vehicle, mapping=mapping)
    options: dict[str, Any] = {"degree": degree, "frame": frame, "vehicle": vehicle, "loss": loss}
    options |= {"method": method, "preparation": preparation, "progress": progress}
    terms = model.effects if isinstance(model, Rung) else (model or "").split("+")
    if bootstrap and (each or NEURAL in terms):
        problem = "resamples neither recordings with their own parameters nor +residual"
        raise InputError(problem, field="bootstrap")
    fit, structure = structured(training, model, each=each, **options)
    fit = replace(fit, warnings=(*told, *fit.warnings))
    if fit.model.recordings:
        return judged(fit, structure, training[-1:], other, mapping=mapping, laws=laws)
    if bootstrap:
        fit = resample(fit, bootstrap, seed=seed, progress=resampled)
    return judged(fit, structure, training, other, mapping=mapping, laws=laws)


def judged(
    fit: Fit,
    structure: ModelStructure,
    training: Sequence[Trajectory],
    validation: Trajectory | None = None,
    *,
    mapping: RecordingMapping | None = None,
    laws: Sequence[str] = (),
) -> Study:
    """Judge a fit."""
    model = fit.model
    found = None if validation is None else evaluate(model, validation)
    strengths = find_strengths(model, training[0])
    axes = AXES if mapping is None else mapping.pose.axes
    causes = [
        *recording_findings(training[0], model.vehicle, axes),
        *actuator_causes(strengths),
        *map(_lacking, structure.missing),
    ]
    spans = fit.exclusion.trajectories[-len(training)].excluded if fit.exclusion else ()
    shown = validation or training[0].leave_out(spans)
    said = verdict(model, shown, found, causes=causes, laws=laws, axes=axes)
    return Study(fit, structure, said, strengths, tuple(training), validation, found)


def judged_on(
    model: Model,
    trajectory: Trajectory,
    evaluation: Evaluation,
    mapping: RecordingMapping | None = None,
    laws: Sequence[str] = (),
) -> Verdict:
    """Judge a model by its predictions of a recording, and by what it lacks there."""
    causes = list[Finding]()
    with suppress(InputError):  # Too short for windows of a fit.
        causes += map(_lacking, lacking_on(model, trajectory))
    axes = AXES if mapping is None else mapping.pose.axes
    return verdict(model, trajectory, evaluation, causes=causes, laws=laws, axes=axes)


def _lacking(term: MissingTerm) -> Finding:
    """Report a term that a model lacks, with the error that this causes."""
    evidence = f"the loss would fall by {100 * term.gain:.2g} %"
    if term.largest and not term.term.startswith(CHANGE):
        change = f"{abs(term.shift[term.largest]):.2g} {term.unit}"
        evidence += f", and {term.largest} would change by {change}"
    if term.term.startswith(CHANGE):
        return Finding("change", *_changed(term.term.removeprefix(CHANGE), term.value[0], evidence))
    if term.term == "direction":
        turned = f"{math.degrees(term.value[0]):+.1f}"
        cause = f"All thrusts point {turned}° away from the vehicle file's directions"
        remedy = f"Add {turned} to each direction_deg, or use +direction (`--model`)."
        return Finding("layout", cause, evidence, remedy)
    if term.term == DEGREE:
        name, remedy = "a thrust curve of higher degree", "Use a higher degree (`--degree`)."
    else:
        name, remedy = f"the term {term.term}", f"Add +{term.term} (`--model`)."
    return Finding("physics", f"The model lacks {name}", evidence, remedy)


def _changed(what: str, change: float, evidence: str) -> tuple[str, str, str]:
    """Describe what changed from the beginning of a recording to its end."""
    if what == DELAY:
        when = "later" if change > 0 else "earlier"
        cause = f"At its end, commands act {1e3 * abs(change):.1f} ms {when} than at its beginning"
        return cause, evidence, "Check the clocks and the radio."
    give, check = f"{what} gives", "this motor"
    if what == ALL:
        give, check = "All propellers give", "the battery"
    how = "more" if change > 0 else "less"
    cause = f"{give} {percent(abs(change))} {how} thrust at the end than at the beginning"
    return cause, evidence, f"Check {check}, or learn from a part (`--span`)."


def reference_faults(trajectory: Trajectory, vehicle: Vehicle) -> tuple[Span, ...]:
    """Find the faults of a recording by a model that is not under test.

    It is the published M3 for the paper's craft, and for others a robust fit to the recording, as
    in `airpuck faults`. If the model under test chose its own windows, it could call its errors
    faults. Without faults, if the recording is too short for a fit.
    """
    published = published_model("M3")
    if vehicle.propellers == published.vehicle.propellers:
        return find_faults(trajectory, published)
    with suppress(InputError):
        rung = usual_rung(trajectory, vehicle)
        fit = identify(trajectory, rung, vehicle=vehicle, loss=Loss(robust=True))
        return find_faults(trajectory, fit.model)
    return ()
