"""How well models predict a recording, and its faults: pages of `evaluate`, `compare`, `faults`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.error_budget import OWNERS, UNEXPLAINED, ErrorBudget
from airpuck.evaluation.evaluate import Evaluation, evaluate
from airpuck.evaluation.fit_measures import FitMeasures
from airpuck.faults.strengths import STRENGTH_HEADINGS, Strengths, find_strengths, strength_rows
from airpuck.judgement.verdict import Verdict, verdict
from airpuck.model.model_file import Model
from airpuck.preprocessing.quality import left_out_words
from airpuck.report import style
from airpuck.report.craft import actuator_words, craft_section
from airpuck.report.fit_figures import thrust_figure
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page
from airpuck.report.prediction_figures import (
    SHOWN_S,
    WORST,
    error_distribution_figure,
    error_timeline_figure,
    horizon_figure,
    path_figure,
    prediction_figure,
    squares_held,
    touched_by,
    worst_windows,
)
from airpuck.report.tables import budget_table, error_tables, fit_table, span_table

#: Colour of each cause.
_PALETTE = ["BLACK", "SKY", "VERMILLION", "ORANGE", "BLUE", "GREEN", "PURPLE", "LIGHT"]
_COLORS = {o: getattr(style, c) for o, c in zip((*OWNERS, UNEXPLAINED), _PALETTE, strict=True)}
#: Number of bars over a flight, and the smallest share with a label [%].
_BARS, _LABELLED = 100, 6.0


@style.styled
def budget_figure(budget: ErrorBudget) -> Figure:
    """Draw the squared error over the flight, coloured by cause, and the shares beside it."""
    figure = style.new_figure(style.PAGE_WIDTH, 6.2)
    panels = figure.subplots(3, 2, width_ratios=(5.2, 1.0), sharex="col")
    edges = np.linspace(budget.start[0], budget.start[-1], _BARS + 1)
    place = np.clip(np.searchsorted(edges, budget.start, side="right") - 1, 0, _BARS - 1)
    owned = np.concatenate([budget.drops, budget.all_known[None] ** 2])
    for channel, (left, right) in enumerate(panels):
        total = max(float(np.sum(budget.errors[channel] ** 2)), 1e-300)
        base, below, share_below = np.zeros(_BARS), np.zeros(_BARS), 0.0
        for owner, values in zip(_COLORS, owned[:, channel], strict=True):
            color = _COLORS[owner]
            height = 100 * np.bincount(place, values, _BARS) / total
            # What a cause hides from another is subtracted below the axis.
            bottom = np.where(height >= 0, base, below)
            left.bar(edges[:-1], height, np.diff(edges), bottom, align="edge", color=color, lw=0)
            base, below = base + np.maximum(height, 0), below + np.minimum(height, 0)
            share = max(100 * float(values.sum()) / total, 0.0)
            right.bar(0, share, 0.6, share_below, color=color, lw=0)
            if share >= _LABELLED:
                right.text(0.36, share_below + share / 2, f"{share:.0f} %", va="center", fontsize=8)
            share_below += share
        name, unit, factor = style.ERRORS[channel]
        rmse = factor * float(np.sqrt(np.mean(budget.errors[channel] ** 2)))
        left.set_ylabel("squared error [% of total]")
        left.set_title(f"{name}: RMSE {rmse:.3g} {unit}", loc="left")
        left.set(ylim=(1.05 * below.min(), 1.05 * base.max() + 1e-9), xlim=edges[[0, -1]])
        right.set(ylim=(0, 100.5), xlim=(-0.35, 1.0), xticks=[], yticks=[])
        right.set_axis_off()
    panels[-1, 0].set_xlabel("start of the prediction [s]")
    shown = [Patch(color=color, label=owner) for owner, color in _COLORS.items()]
    style.top_legend(figure, shown, columns=4)
    return figure


def budget_section(budget: ErrorBudget) -> PageSection:
    """Show what causes the error."""
    caption = (
        "Squared error after the prediction horizon over the flight, coloured by its cause; the "
        "sums on the right."
    )
    picture = Picture("error_budget", budget_figure(budget), caption)
    return PageSection("budget", "What causes the error", (picture, budget_table(budget)))


@dataclass(frozen=True, eq=False)
class JudgedModels:
    """Models evaluated on one recording."""

    #: The recording.
    trajectory: Trajectory
    #: One evaluation for each model, which its `model` names.
    evaluations: tuple[Evaluation, ...]
    #: Evaluations of the models to compare with.
    reference: tuple[Evaluation, ...] = ()
    #: One word for the reference.
    reference_label: str = "published"
    #: Known faults of the recording.
    faults: tuple[Span, ...] = ()

    @cached_property
    def best(self) -> Evaluation:
        """The evaluation with the lowest geometric mean of its three errors."""
        return min(self.evaluations, key=lambda e: float(np.log(np.maximum(e.rmse, 1e-300)).sum()))


def verdict_section(
    models: Sequence[Model],
    trajectory: Trajectory,
    evaluations: Sequence[Evaluation | None],
    best: str,
    known: Mapping[str, Verdict] | None = None,
) -> PageSection:
    """Summarise the verdicts: every sentence on the best model, two on each other model.

    Models without a known verdict are judged by their evaluation on the trajectory.
    """
    verdicts = {
        model.name: (known or {}).get(model.name) or verdict(model, trajectory, found)
        for model, found in zip(models, evaluations, strict=True)
    }
    sentences = list(verdicts[best].sentences)
    sentences += [" ".join(one.sentences[:2]) for name, one in verdicts.items() if name != best]
    return PageSection("summary", "In short", (Text(sentences, bullets=True),))


def judged_sections(
    judged: JudgedModels, vehicle: Vehicle, error_table: PageTable | None = None
) -> list[PageSection]:
    """Show a flight with its predictions, the size of their errors, and when they occur.

    `error_table` precedes the usual table of errors.
    """
    return [
        _flight_section(judged, vehicle),
        _prediction_section(judged, error_table),
        _timeline_section(judged),
    ]


def path_section(trajectory: Trajectory, vehicle: Vehicle) -> PageSection:
    """Show a flight on which no model was evaluated."""
    return PageSection("flight", "The flight", (_path_picture(trajectory, vehicle),))


def _path_picture(trajectory: Trajectory, vehicle: Vehicle) -> Picture:
    """Show the path of a flight from above."""
    caption = "The flight from above, with the craft at its start, to scale. Grey: rails, if near."
    return Picture("path", path_figure(trajectory, vehicle), caption)


def _flight_section(judged: JudgedModels, vehicle: Vehicle) -> PageSection:
    """Show measured and predicted poses."""
    best, first = judged.best, judged.evaluations[0]
    # More than three lines hide each other.
    shown = judged.evaluations if len(judged.evaluations) <= 3 else (first, best)
    shown = (*(one for one in shown if one is not best), best)
    ahead = best.sample_period * len(best.errors)
    caption = (
        f"{SHOWN_S:g} s of the flight with errors of typical size. A prediction starts at each dot "
        f"from the measured state and uses only the commands for the next {ahead:.2f} s."
    )
    predicted = Picture("prediction", prediction_figure(judged.trajectory, shown), caption)
    blocks = (predicted, _path_picture(judged.trajectory, vehicle))
    return PageSection("flight", "Measured and predicted", blocks)


def _prediction_section(judged: JudgedModels, table: PageTable | None) -> PageSection:
    """Show the errors of predictions."""
    evaluations, label = judged.evaluations, judged.reference_label
    horizon = "RMS error over the prediction horizon."
    if judged.reference:
        horizon += (
            " Broad and dashed lines of one colour coincide where our fit predicts as well as the "
            f"{label} parameters."
        )
    ranks = [100 * np.mean(np.abs(e.at_horizon) <= e.rmse[:, None], axis=1) for e in evaluations]
    distribution = (
        "Cumulative distribution of the errors over the windows. The RMSE (dots) exceeds the error "
        f"of {np.min(ranks):.0f} to {np.max(ranks):.0f} % of the windows. The higher this share, "
        "the more a few large errors dominate the RMSE, and the less it describes the typical "
        "window, at 50 %."
    )
    shares = error_distribution_figure(evaluations)
    curves = horizon_figure(evaluations, judged.reference, label)
    names = [f"{e.model}, {label}" for e in judged.reference] + [e.model for e in evaluations]
    shown = [*judged.reference, *evaluations]
    tables = error_tables(names, shown, judged.trajectory, judged.faults)
    blocks = (
        Text([_protocol_words(evaluations[0])]),
        *((table,) if table else ()),
        *tables,
        Picture("horizon", curves, horizon),
        Picture("error_distribution", shares, distribution),
    )
    return PageSection("prediction", "Prediction error", blocks)


def _timeline_section(judged: JudgedModels) -> PageSection:
    """Show when the best model errs."""
    best = judged.best
    shares = squares_held(best.at_horizon, worst_windows(best.at_horizon))
    caption = (
        f"Absolute error of {best.model} in each window. In each channel, the worst "
        f"{100 * WORST:.0f} % of the windows account for {shares} % of the squared error "
        "(x / y / yaw)."
    )
    if judged.faults:
        touched = touched_by(best, judged.faults)
        caption += (
            " Above and shaded: known faults of this recording. The craft accelerates less than "
            "the commands should make it, because motors are off, the radio link is out or a motor "
            f"does not spin up. {touched.sum()} of {len(touched)} windows overlap a fault; they "
            f"account for {squares_held(best.at_horizon, touched)} % and are not excluded."
        )
    figure = error_timeline_figure(best, judged.faults)
    return PageSection("time", "Errors over time", (Picture("error_timeline", figure, caption),))


def _protocol_words(evaluation: Evaluation) -> str:
    """Describe the protocol in a sentence."""
    protocol = evaluation.protocol
    after = evaluation.horizon_step * evaluation.sample_period
    before = max(round(protocol.encoder_time / evaluation.sample_period), 2)
    return (
        f"Protocol “{protocol.name}”, encoder “{evaluation.encoder}”: "
        f"{evaluation.errors.shape[2]} windows without overlap, each of {before} samples for the "
        f"encoder and {len(evaluation.errors)} predicted steps. Errors are stated after step "
        f"{evaluation.horizon_step} ({after:.3f} s)."
    )


def sources_section(*trajectories: Trajectory) -> PageSection:
    """List the recordings behind the numbers."""
    from airpuck import __version__

    rows = [
        [
            "/".join(Path(t.source).parts[-2:]),
            str(len(t)),
            f"{t.duration:.2f}",
            " ".join(t.hashes.values()) or "none",
            left_out_words(t).removeprefix("left out: "),
        ]
        for t in trajectories
    ]
    caption = f"Recordings behind these numbers; computed by airpuck {__version__}."
    headings = ["recording", "samples", "seconds", "SHA-256", "left out"]
    return PageSection("sources", "Sources", (PageTable(caption, headings, rows),))


def evaluation_report(
    models: Sequence[Model],
    evaluations: Sequence[Evaluation],
    trajectory: Trajectory,
    out: str | os.PathLike[str],
    *,
    names: Sequence[str] = (),
    differences: Sequence[str] = (),
    fits: Sequence[FitMeasures] = (),
    verdicts: Mapping[str, Verdict] | None = None,
    faults: Sequence[Span] = (),
    budget: ErrorBudget | None = None,
    origin: Origin | None = None,
) -> Path:
    """Write a page that compares models of one craft on one recording.

    Parameters
    ----------
    models : sequence of Model
        The models.
    evaluations : sequence of Evaluation
        Their evaluations, in the same order.
    trajectory : Trajectory
        The recording.
    out : path-like
        Folder to write to.
    names : sequence of str, optional
        Display names of the models; by default their rungs.
    differences : sequence of str, optional
        Sentences on how the models differ.
    fits : sequence of FitMeasures, optional
        Their fit to the recording, in the same order.
    verdicts : mapping of str to Verdict, optional
        Known verdicts by display name; other models are judged here.
    faults : sequence of Span, optional
        Known faults of the recording, found by a model that is not under test.
    budget : ErrorBudget, optional
        What causes the errors of the first model.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    names = names or [model.name for model in models]
    models = [replace(model, name=name) for model, name in zip(models, names, strict=True)]
    named = [replace(one, model=name) for one, name in zip(evaluations, names, strict=True)]
    judged = JudgedModels(trajectory, tuple(named), faults=tuple(faults))
    vehicle = models[0].vehicle
    short = verdict_section(models, trajectory, named, judged.best.model, verdicts)
    sections = [short, *judged_sections(judged, vehicle)]
    if budget is not None:
        sections.insert(1, budget_section(budget))
    if differences:
        text = Text(differences, bullets=True)
        sections.append(PageSection("differences", "Do the models differ?", (text,)))
    if fits:
        sections.append(PageSection("fit", "Fit", (fit_table(names, fits),)))
    curves = Picture(
        "thrust",
        thrust_figure(models, trajectory, commands="commands of this flight"),
        "Thrust of each motor over its normalised speed. Bars: histogram of this flight's "
        "commands.",
    )
    sections += [
        PageSection("thrust", "Thrust curves", (curves,)),
        craft_section(vehicle),
        sources_section(trajectory),
    ]
    lead = (
        f"{', '.join(names)} on {trajectory.duration:.1f} s of flight, {len(trajectory)} samples, "
        f"{actuator_words(vehicle)}."
    )
    return write_page(out, f"Predictions of {vehicle.name}", lead, sections, origin)


def fault_section(trajectory: Trajectory, faults: Sequence[Span], model: Model) -> PageSection:
    """Show when and why a recording cannot be trusted."""
    spans = sorted((*trajectory.excluded, *faults), key=lambda span: span.start)
    if not spans:
        words = f"{model.name} shows no temporary faults in {trajectory.duration:.1f} s."
        return PageSection("faults", "Faults", (Text([words]),))
    evaluation = evaluate(model, trajectory)
    touched = touched_by(evaluation, spans)
    words = (
        f"Faults found with {model.name}, the probability of each cause, and prediction errors "
        f"after {evaluation.horizon_step * evaluation.sample_period:.2f} s. {touched.sum()} of "
        f"{len(touched)} windows overlap a fault; they account for "
        f"{squares_held(evaluation.at_horizon, touched)} % of the squared error (x / y / yaw)."
    )
    picture = Picture("fault_timeline", error_timeline_figure(evaluation, spans), words)
    return PageSection("faults", "Faults", (picture, span_table(spans)))


def fault_report(
    trajectory: Trajectory,
    faults: Sequence[Span],
    model: Model,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
) -> Path:
    """Write a page on the faults of a recording."""
    usable = trajectory.leave_out(faults).usable.mean()
    lead = (
        f"{trajectory.source}: {trajectory.duration:.1f} s, {len(trajectory)} samples, "
        f"{100 * usable:.1f} % of them without temporary faults."
    )
    sections = [
        fault_section(trajectory, faults, model),
        strength_section(find_strengths(model, trajectory)),
    ]
    return write_page(out, "Faults of a recording", lead, sections, origin)


def strength_section(strengths: Strengths) -> PageSection:
    """Set the strength of each actuator beside the vehicle file's."""
    caption = (
        "Thrust at the largest command, with 95 % intervals. An actuator is judged in comparison "
        "with the median of the others, each relative to its nominal strength: it is weak if it "
        "lies below by more than four standard errors, and by more than sound motors differ "
        "(nominal.thrust_spread in the vehicle file)."
    )
    table = PageTable(caption, STRENGTH_HEADINGS, strength_rows(strengths))
    words = [Text(list(strengths.sentences))] if strengths.sentences else []
    return PageSection("strengths", "Strength of each actuator", (*words, table))
