"""Fits of whatever to whatever craft, and the sections of a report on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.data.left_out import left_out_words
from airpuck.data.trajectory import Trajectory
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import prediction_errors
from airpuck.identification.fit_result import Fit, knowledge_words
from airpuck.identification.selection import (
    SELECTION_HEADINGS,
    Selection,
    selection_rows,
    selection_title,
    selection_words,
)
from airpuck.model.model_file import Model
from airpuck.model.quantities import QUANTITIES
from airpuck.report.craft import craft_figure
from airpuck.report.fit_figures import loss_history_figure, parameter_figure, thrust_figure
from airpuck.report.page import Block, Details, Picture, Section, Table, Text, packaged_text
from airpuck.report.parameter_table import coefficient_rows, effect_rows, main_rows, parameter_table

#: What stands behind a value.
_INTERVALS = (
    " ±: standard error, from blocks of two seconds taken as independent; a learned value without "
    "one is held by a constraint, or known only as part of a product. What is wrong in all of the "
    "data alike is not in it."
)


@dataclass(frozen=True, eq=False)
class FitStudy:
    """Models of one craft, learned from one trajectory."""

    #: What the models were learned from.
    training: Trajectory
    #: How they were learned.
    fits: tuple[Fit, ...]
    #: What they are compared with, by name of the rung.
    reference: Mapping[str, Model] = field(default_factory=dict)
    #: What the reference is, in a word.
    reference_label: str = "published"

    @property
    def models(self) -> list[Model]:
        """The models that were learned."""
        return [fit.model for fit in self.fits]

    @cached_property
    def reference_losses(self) -> dict[str, float]:
        """Loss of each reference model on the data of the fit of the same name.

        Those are the data as the fit prepared them: the same windows, faults left out and packets
        moved alike. The reference has its own conventions of encoder and frame, and its own delay.
        """
        losses = {}
        for fit in self.fits:
            model, loss = self.reference.get(fit.model.name), fit.objective
            if model is None or loss is None:
                continue
            windows, encoder = loss.windows_at(model.parameters), PaperEncoder(model.indexing)
            errors = prediction_errors(model.dynamics, windows, encoder)
            losses[fit.model.name] = float(np.mean((np.array(loss.weights)[:, None] * errors) ** 2))
        return losses


def craft_section(vehicle: Vehicle) -> Section:
    """Show the craft and its frames."""
    layout = (
        "Propeller layout, to scale, seen from above. An arrow is the force of a propeller on the "
        "craft; ↺ and ↻ show which way it turns the craft. "
    )
    paired = 2 * len(vehicle.pairs)
    if paired:
        layout += (
            "The two propellers of a pair have one colour and push against each other, so that a "
            "pair can push either way. "
        )
    if paired < vehicle.n_propellers:
        layout += "A propeller without a partner has a colour of its own. "
    layout += "From the vehicle file: measured, not learned."
    frames = (
        "Schematic, whatever the craft has for propellers. Left: position p and yaw γ of the body "
        "frame in the world frame. Right: α is the rotation of the propeller layout against the "
        "measured yaw, r the offset of the centre of mass from the geometric centre; exaggerated."
    )
    pictures = (
        Picture("craft", craft_figure(vehicle), layout),
        Picture("frames", packaged_text("frames.svg"), frames),
    )
    return Section("craft", "The craft", pictures)


def study_sections(study: FitStudy) -> list[Section]:
    """Show what models are, and how they were found."""
    return [_thrust_section(study), _parameter_section(study), _optimiser_section(study)]


def _thrust_section(study: FitStudy) -> Section:
    """Show the thrust curves, of M3 and M4 where they are there."""
    models = [m for m in study.models if m.name in ("M3", "M4")] or study.models
    reference = [study.reference[m.name] for m in models if m.name in study.reference]
    caption = "Thrust of each motor over its normalised speed. "
    if reference:
        caption += f"Broad: fitted; dashed: {study.reference_label}. "
    if any(m.known is not None for m in models):
        caption += "Bands: 95 % intervals at each speed. "
    caption += (
        "Bars: share of the training samples at each command, in twentieths of the range (a bar "
        "that is cut off has its share beside it); the bracket on the axis is the range that was "
        "commanded, outside of which a curve is extrapolated."
    )
    if any(m.parameters.configuration_matrix is not None for m in [*models, *reference]):
        caption += (
            " The scale of M4's thrusts is arbitrary: s times the thrust and 1/s times the "
            "propeller's column of Π predict the same. It is fixed so that a propeller's column of "
            "Π has the length 1/m in x and y, as Newton's law demands."
        )
    figure = thrust_figure(models, study.training, reference, study.reference_label)
    return Section("thrust", "Thrust curves", (Picture("thrust", figure, caption),))


def _optimiser_section(study: FitStudy) -> Section:
    """Show how the fits were found."""
    losses, label = study.reference_losses, study.reference_label
    rows = []
    for fit in study.fits:
        row = {
            "model": fit.model.name,
            "free": f"{fit.model.free.sum()}",
            "windows": f"{fit.windows}",
            "iterations": f"{fit.iterations}",
            "loss at start": f"{1e5 * fit.history[0].loss:.3f}",
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
    table = (
        f"Losses in 10⁻⁵. Loss: mean of the squared errors, weighted by ({weights}) per m, m and "
        f"rad, over windows, {settings['prediction_length']} steps and the channels x, y, γ, "
        f"without any regulariser; a training window every {settings['stride']} samples, on the "
        "data as each fit prepares them: compare losses within a row. Time includes compiling, and "
        "waiting for each other where fits run side by side."
    )
    history = (
        f"Loss over the iterations (method: {settings.get('method')}); it leaps where faults are "
        "left out and packets moved."
    )
    if losses:
        history += (
            f" Dashed: the {label} parameters on the same data, prepared for the last fit of the "
            "same model, with their own conventions of encoder and frame. A fit has the lowest "
            "loss that there is on its data, so that even the truth lies above it."
        )
    figure = loss_history_figure(study.fits, losses, label)
    cells = [list(row.values()) for row in rows]
    blocks = (Table(table, list(rows[0]), cells), Picture("loss_history", figure, history))
    return Section("optimiser", "How the fits were found", blocks)


def _parameter_section(study: FitStudy) -> Section:
    """Show the parameters."""
    label, groups = study.reference_label, [("", 2)]
    models, headings = [], ["", "unit"]
    for model in study.models:
        shown = {"fitted": model}
        if model.name in study.reference:
            shown = {label: study.reference[model.name], **shown}
        models += shown.values()
        headings += shown.keys()
        groups.append((model.name, len(shown)))
    main = (
        "Parameters; bold: learned. F(1) is the thrust at full speed, of M4 at the physical scale."
    )
    main += f" {_meanings(study.models)}."
    if any(m.known is not None for m in models):
        main += _INTERVALS
    blocks: list[Block] = [parameter_table(main, headings, main_rows(models), groups)]
    if study.reference:
        caption = (
            "Relative differences of what each propeller does at full speed, and of inertia and "
            "time constant where they are learned. The accelerations are products of Π and thrust, "
            "which no choice of scale can change, so that M4 can be compared. Bars: 95 % intervals "
            "of the fit."
        )
        figure = parameter_figure(study.models, study.reference, label)
        blocks.append(Picture("parameters", figure, caption))
    determined = [f"{fit.model.name}: {w}." for fit in study.fits for w in knowledge_words(fit)]
    if determined:
        summary = "What the data determine: conditioning, correlations, constraints"
        blocks.append(Details(summary, (Text(determined, bullets=True),)))
    tables = []
    if any(model.parameters.configuration_matrix is not None for model in models):
        caption = (
            "What each propeller does at full speed. m‖Π_xy‖ is the factor from a thrust as "
            "learned to newtons: 1 where Π follows from first principles or the scale was fixed "
            "after the fit, arbitrary in the published M4."
        )
        tables.append(parameter_table(caption, headings, effect_rows(models), groups))
    caption = "Thrust coefficients as learned, F(φ) = aφ + bφ² + cφ³ + …."
    tables.append(parameter_table(caption, headings, coefficient_rows(models), groups))
    blocks.append(Details("Coefficients of each propeller", tables))
    return Section("parameters", "Parameters", blocks)


def _meanings(models: Sequence[Model]) -> str:
    """Say what the symbols mean of what the models have."""
    used = [
        f"{q.symbol}: {q.meaning.partition(';')[0]}"
        for q in QUANTITIES
        if q.shown and any(getattr(m.parameters, q.name) is not None for m in models)
    ]
    return "; ".join(used)


def selection_section(selection: Selection) -> Section:
    """Show how well every rung predicted what was held out, and which was taken."""
    title = (
        f"{selection_title(selection)}, root mean square. The last column is the change of all "
        f"three channels together, weighted as in the loss. {selection_words(selection)}."
    )
    table = Table(title, SELECTION_HEADINGS, selection_rows(selection))
    return Section("selection", "Which terms help", (table,))


def sources_section(*trajectories: Trajectory) -> Section:
    """List what the numbers come from."""
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
    return Section("sources", "Sources", (Table(caption, headings, rows),))
