"""A report on fits: `airpuck identify --report`, and sections of other pages."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory, as_trajectories
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import prediction_errors
from airpuck.evaluation.presentation import delay_words
from airpuck.faults.strengths import Strengths, find_strengths
from airpuck.identification.fit_result import Fit, knowledge_words
from airpuck.judgement.verdict import Verdict
from airpuck.model.model_file import Model
from airpuck.model.quantities import QUANTITIES
from airpuck.report.craft import actuator_words, craft_section
from airpuck.report.evaluation_report import (
    JudgedModels,
    fault_section,
    judged_sections,
    path_section,
    sources_section,
    strength_section,
    verdict_section,
)
from airpuck.report.fit_figures import (
    coefficient_rows,
    effect_rows,
    main_rows,
    packet_delay_figure,
    parameter_figure,
    parameter_table,
    thrust_figure,
)
from airpuck.report.page import (
    Block,
    Details,
    Origin,
    PageSection,
    PageTable,
    Picture,
    Text,
    write_page,
)

#: Iterations of a fit that a table has room for.
_SHOWN = 8
#: Footnote on the standard errors in tables of parameters.
_INTERVALS = (
    " ±: standard error, with blocks of two seconds taken as independent. A learned value without "
    "one is held by a constraint, or known only as a factor of a product. The tolerances of the "
    "vehicle file are included; other systematic errors common to all the data are not."
)


@dataclass(frozen=True, eq=False)
class FitStudy:
    """Models of one craft, learned from one recording."""

    #: The training recording.
    training: Trajectory
    #: The fits.
    fits: tuple[Fit, ...]
    #: Models to compare with, by rung.
    reference: Mapping[str, Model] = field(default_factory=dict)
    #: One word for the reference.
    reference_label: str = "published"

    @property
    def models(self) -> list[Model]:
        """The learned models."""
        return [fit.model for fit in self.fits]

    @cached_property
    def reference_losses(self) -> dict[str, float]:
        """Loss of each reference model on the data of the fit of the same rung.

        The data are as the fit prepared them, without faults and with retimed packets. The
        reference keeps its own conventions of encoder and frame, and its own delay.
        """
        losses = {}
        for fit in self.fits:
            model, loss = self.reference.get(fit.model.name), fit.objective
            if model is None or loss is None:
                continue
            windows, encoder = loss.windows_at(model.parameters), PaperEncoder(model.indexing)
            errors = prediction_errors(model.dynamics, windows, encoder)
            losses[fit.model.name] = float(
                np.nanmean((np.array(loss.weights)[:, None] * errors) ** 2)
            )
        return losses


def study_sections(study: FitStudy) -> list[PageSection]:
    """Show the thrust curves and parameters of the models, and how they were fitted."""
    return [_thrust_section(study), _parameter_section(study), _optimiser_section(study)]


def _thrust_section(study: FitStudy) -> PageSection:
    """Show the thrust curves; of M3 and M4 only, if these are among the models."""
    models = [m for m in study.models if m.name in ("M3", "M4")] or study.models
    reference = [study.reference[m.name] for m in models if m.name in study.reference]
    caption = "Thrust of each motor over its normalised speed. "
    if reference:
        caption += f"Broad: fitted; dashed: {study.reference_label}. "
    if any(m.known is not None for m in models):
        caption += "Bands: 95 % intervals at each speed. "
    caption += (
        "Bars: histogram of the training commands; a truncated bar is labelled with its value. The "
        "bracket on the axis is the commanded range; outside it a curve is extrapolated."
    )
    if any(m.parameters.configuration_matrix is not None for m in [*models, *reference]):
        caption += (
            " M4 knows thrust only up to a scale: s times the thrust and 1/s times the propeller's "
            "column of Π predicts the same motion. The scale is fixed so that each column of Π has "
            "length 1/m in x and y, as Newton's law demands."
        )
    figure = thrust_figure(models, study.training, reference, study.reference_label)
    return PageSection("thrust", "Thrust curves", (Picture("thrust", figure, caption),))


def _optimiser_section(study: FitStudy) -> PageSection:
    """Show how the fits converged."""
    losses, label = study.reference_losses, study.reference_label
    rows = []
    for fit in study.fits:
        row = {
            "model": fit.model.name,
            "free": f"{fit.model.free.sum()}",
            "windows": f"{fit.windows}",
            "iterations": f"{fit.iterations}",
            "loss by iteration": " → ".join(f"{1e5 * i.loss:.3g}" for i in fit.history[-_SHOWN:]),
            "loss": f"{1e5 * fit.loss:.3f}",
        }
        if losses:
            reference = losses.get(fit.model.name)
            row[f"loss, {label}"] = "" if reference is None else f"{1e5 * reference:.3f}"
        row["time s"] = f"{fit.wall_s:.1f}"
        row["converged"] = "yes" if fit.converged else fit.message
        if any(other.warnings for other in study.fits):
            row["warnings"] = "; ".join(fit.warnings) or "none"
        rows.append(row)
    settings = study.fits[0].model.fit
    weights = ", ".join(f"{weight:g}" for weight in settings["weights"])
    stride = settings["stride"]
    every = "at every sample" if stride == 1 else f"every {stride} samples"
    table = (
        f"Losses in 10⁻⁵: mean squared error, weighted by ({weights}) per m, m and rad, over "
        f"windows, {settings['prediction_length']} steps and the channels x, y, γ, without "
        f"regulariser. A training window starts {every}. Each fit "
        "prepares its own data, so compare losses within a row only. The loss jumps where faults "
        f"are excluded and packets retimed (the last {_SHOWN} iterations; method: "
        f"{settings.get('method')}). Time includes compilation and, for parallel fits, waiting."
    )
    if losses:
        table += (
            f" The {label} parameters are evaluated on the data of the last fit of the same model, "
            "with their own conventions of encoder and frame. A fit minimises the loss on its "
            "data, so even the true parameters have a higher one."
        )
    shown = PageTable(table, list(rows[0]), [list(row.values()) for row in rows])
    return PageSection("optimiser", "Convergence of the fits", (shown,))


def _parameter_section(study: FitStudy) -> PageSection:
    """Show the parameters, and which of them the data determine."""
    label, groups = study.reference_label, [("", 2)]
    models, headings = [], ["quantity", "unit"]
    for model in study.models:
        shown = {"fitted": model}
        if model.name in study.reference:
            shown = {label: study.reference[model.name], **shown}
        models += shown.values()
        headings += shown.keys()
        groups.append((model.name, len(shown)))
    main = "Parameters; bold: learned. F(1): thrust at full speed, for M4 at the physical scale."
    main += f" {_meanings(study.models)}."
    if any(m.known is not None for m in models):
        main += _INTERVALS
    blocks: list[Block] = [parameter_table(main, headings, main_rows(models), groups)]
    if study.reference:
        caption = (
            "Relative differences of the accelerations from each propeller at full speed, and of "
            "inertia and time constant where learned. Accelerations are products of Π and thrust "
            "and do not depend on M4's scale. Bars: 95 % intervals of the fit."
        )
        figure = parameter_figure(study.models, study.reference, label)
        blocks.append(Picture("parameters", figure, caption))
    determined = [f"{fit.model.name}: {w}." for fit in study.fits for w in knowledge_words(fit)]
    if determined:
        summary = "Identifiability: conditioning, correlations, constraints"
        blocks.append(Details(summary, (Text(determined, bullets=True),)))
    tables = []
    if any(model.parameters.configuration_matrix is not None for model in models):
        caption = (
            "Effect of each propeller at full speed. m‖Π_xy‖ converts a learned thrust to newtons. "
            "It is 1 where Π follows from first principles or the scale was fixed after the fit, "
            "and arbitrary in the published M4."
        )
        tables.append(parameter_table(caption, headings, effect_rows(models), groups))
    caption = "Thrust coefficients as learned, F(φ) = aφ + bφ² + cφ³ + …."
    tables.append(parameter_table(caption, headings, coefficient_rows(models), groups))
    blocks.append(Details("Coefficients of each propeller", tables))
    return PageSection("parameters", "Parameters", blocks)


def _meanings(models: Sequence[Model]) -> str:
    """Explain the symbols of the parameters in use."""
    used = [
        f"{q.symbol}: {q.meaning.partition(';')[0]}"
        for q in QUANTITIES[1:]  # the first are thrust curves, shown as forces
        if any(getattr(m.parameters, q.name) is not None for m in models)
    ]
    return "; ".join(used)


def fit_report(
    fits: Fit | Sequence[Fit],
    training: Trajectory | Sequence[Trajectory],
    out: str | os.PathLike[str],
    *,
    judged: JudgedModels | None = None,
    truth: Model | None = None,
    title: str | None = None,
    opening: Sequence[Block] = (),
    more: Sequence[PageSection] = (),
    strengths: Strengths | None = None,
    verdicts: Mapping[str, Verdict] | None = None,
    origin: Origin | None = None,
) -> Path:
    """Write a report on one or several fits.

    Parameters
    ----------
    fits : Fit or sequence of Fit
        Fits of one craft to one recording.
    training : Trajectory or sequence of Trajectory
        The training recordings; figures show the first.
    out : path-like
        Folder to write to.
    judged : JudgedModels, optional
        Evaluations on another recording, in the same order.
    truth : Model, optional
        The true model, if known, to compare the fits with.
    title : str, optional
        By default the name of the craft.
    opening : sequence of Block, optional
        Blocks to add to the summary.
    more : sequence of PageSection, optional
        Sections to add at the end.
    strengths : Strengths, optional
        Of the last fit's actuators; by default from `find_strengths`.
    verdicts : mapping of str to Verdict, optional
        Of the models, by name; missing ones are judged here.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If there is no fit, or the folder cannot be written to.
    """
    fits, learned = (fits,) if isinstance(fits, Fit) else tuple(fits), as_trajectories(training)
    training = learned[0]
    if not fits:
        raise InputError("there is no fit to report on")
    if truth is not None:
        # The truth has no encoder; with the fits' encoder, losses are comparable.
        truth = replace(truth, indexing=fits[0].model.indexing)
    study = FitStudy(
        training=training,
        fits=fits,
        reference={} if truth is None else {truth.name: truth},
        reference_label="true" if truth is not None else "reference",
    )
    last, vehicle = fits[-1], fits[0].model.vehicle
    strengths = strengths or find_strengths(last.model, training)
    by, best = [None] * len(fits), last.model.name
    if judged is not None:
        by, best = list(judged.evaluations), judged.best.model
    shown = training if judged is None else judged.trajectory
    short = verdict_section(study.models, shown, by, best, verdicts)
    if strengths.sentences:
        short = replace(short, blocks=(Text(list(strengths.sentences)), *short.blocks))
    sections = [replace(short, blocks=(*short.blocks, *opening))]
    if judged is None:
        sections.append(path_section(training, vehicle))
    else:
        sections += judged_sections(judged, vehicle)
    sections += [*study_sections(study), strength_section(strengths), craft_section(vehicle)]
    if last.packet_delays and len(last.packet_delays[0]):
        sections.append(_delay_section(last, training))
    if last.exclusion is not None:
        sections.append(fault_section(training, last.exclusion.faults[0], last.model))
    sources = learned if judged is None else [*learned, judged.trajectory]
    sections += [*more, sources_section(*sources)]
    duration, samples = sum(one.duration for one in learned), sum(map(len, learned))
    lead = (
        f"{', '.join(fit.model.name for fit in fits)}: identified from {duration:.1f} s of flight, "
        f"{samples} samples, {actuator_words(vehicle)}"
    )
    if len(learned) > 1:
        lead += f", {len(learned)} recordings; figures show the first"
    if last.model.delay_learned:
        lead += f", transport delay {delay_words(last.model)}"
    elif training.delay_known:
        lead += f", transport delay {1e3 * training.delay:.1f} ms"
    title = title or f"Identification of {vehicle.name}"
    return write_page(out, title, lead + ".", sections, origin)


def _delay_section(fit: Fit, training: Trajectory) -> PageSection:
    """Show the delays of single packets."""
    delays = fit.packet_delays[0]
    caption = (
        f"Delay of the {len(delays)} packets that changed the thrust visibly, ± two standard "
        f"errors; transport delay {delay_words(fit.model)}. A lost packet appears late by the time "
        "to the next one. Jitter is the spread that the standard errors do not explain."
    )
    figure = packet_delay_figure(training.command_time, delays, fit.model)
    return PageSection("delay", "Transport delay", (Picture("packet_delays", figure, caption),))
