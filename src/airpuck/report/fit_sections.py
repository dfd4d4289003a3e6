"""Fits of whatever to whatever craft, and the sections of a report on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import Evaluation, hold_for, prediction_errors
from airpuck.identification.fit_result import Fit
from airpuck.model.model_file import Model
from airpuck.report.craft import craft_figure
from airpuck.report.error_figures import (
    WORST,
    error_distribution_figure,
    error_timeline_figure,
    horizon_figure,
    squares_held,
    touched_by,
    worst_windows,
)
from airpuck.report.fit_figures import loss_history_figure, parameter_figure, thrust_figure
from airpuck.report.page import Picture, Section, Table, Text, packaged_text
from airpuck.report.parameter_table import coefficient_rows, effect_rows, main_rows, parameter_table

#: Headings of errors in tables.
_CHANNELS = ("x mm", "y mm", "γ rad")
#: What stands behind a value.
_INTERVALS = (
    " ±: standard error, from blocks of two seconds taken as independent; a learned value without "
    "one is held by a constraint, or known only as part of a product. What is wrong in all of the "
    "data alike is not in it."
)


@dataclass(frozen=True, eq=False)
class FitStudy:
    """Models of one craft, learned from one trajectory and judged on another."""

    #: What the models were learned from.
    training: Trajectory
    #: How they were learned.
    fits: tuple[Fit, ...]
    #: How well they predict, in the same order; can be empty.
    fitted: tuple[Evaluation, ...] = ()
    #: What they are compared with, by name of the rung.
    reference: Mapping[str, Model] = field(default_factory=dict)
    #: How well the reference predicts.
    reference_evaluations: tuple[Evaluation, ...] = ()
    #: What the reference is, in a word.
    reference_label: str = "published"
    #: Known faults of the recording that the models are judged on.
    faults: tuple[Span, ...] = ()

    @property
    def models(self) -> list[Model]:
        """The models that were learned."""
        return [fit.model for fit in self.fits]

    @cached_property
    def reference_losses(self) -> dict[str, float]:
        """Loss of each reference model on the windows of the fit of the same name.

        Each reference is evaluated with its own conventions of encoder and frame.
        """
        losses = {}
        for fit in self.fits:
            model, settings = self.reference.get(fit.model.name), fit.model.fit
            if model is None:
                continue
            lengths = (settings[name] for name in ("encoder_length", "prediction_length", "stride"))
            windows = hold_for(model, make_windows(self.training, *lengths))
            errors = prediction_errors(model.dynamics, windows, PaperEncoder(model.indexing))
            weights = np.array(settings["weights"])[:, None]
            losses[fit.model.name] = float(np.mean((weights * errors) ** 2))
        return losses

    @cached_property
    def best(self) -> Evaluation:
        """The fitted model whose three errors are lowest on geometric average."""
        return min(self.fitted, key=lambda e: float(np.log(np.maximum(e.rmse, 1e-300)).sum()))


def protocol_words(evaluation: Evaluation) -> str:
    """Describe in a sentence how errors were measured."""
    protocol = evaluation.protocol
    after = evaluation.horizon_step * evaluation.sample_period
    return (
        f"Protocol “{protocol.name}”: {evaluation.errors.shape[2]} windows that do not overlap, "
        f"of {round(protocol.encoder_time / evaluation.sample_period)} samples for the encoder and "
        f"{len(evaluation.errors)} steps to predict; errors after step {evaluation.horizon_step} "
        f"({after:.3f} s)."
    )


def errors_as_text(values: np.ndarray) -> list[str]:
    """Format errors of x, y [m] and yaw [rad] as millimetres and radians."""
    x, y, yaw = values
    return [f"{1e3 * x:.2f}", f"{1e3 * y:.2f}", f"{yaw:.4f}"]


def craft_section(vehicle: Vehicle) -> Section:
    """Show the craft and its frames."""
    layout = (
        "Propeller layout, to scale, seen from above. An arrow is the force of a propeller on the "
        "craft; ↺ and ↻ show which way it turns the craft. The two propellers of a pair have one "
        "colour and push against each other, so that a pair can push either way. From the vehicle "
        "file: measured, not learned."
    )
    frames = (
        "Schematic, with six propellers. Left: position p and yaw γ of the body frame in the world "
        "frame. Right: α is the rotation of the propeller layout against the measured yaw, r the "
        "offset of the centre of mass from the geometric centre; both exaggerated."
    )
    pictures = (
        Picture("craft", craft_figure(vehicle), layout),
        Picture("frames", packaged_text("frames.svg"), frames),
    )
    return Section("craft", "The craft", pictures)


def study_sections(study: FitStudy, error_table: Table | None = None) -> list[Section]:
    """Show how well models predict, where any were judged, how they were found, and what they are.

    The table of errors can be replaced.
    """
    judged = []
    if study.fitted:
        judged = [_prediction_section(study, error_table), _timeline_section(study)]
    return [*judged, _thrust_section(study), _optimiser_section(study), _parameter_section(study)]


def _prediction_section(study: FitStudy, table: Table | None = None) -> Section:
    """Show how far predictions are off."""
    protocol, label = protocol_words(study.fitted[0]), study.reference_label
    horizon = "Root mean square error over the time predicted. "
    if study.reference_evaluations:
        horizon += (
            "Where broad and dashed lines of a colour coincide, our fit predicts like the "
            f"{label} parameters. "
        )
    ranks = [100 * np.mean(np.abs(e.at_horizon) <= e.rmse[:, None], axis=1) for e in study.fitted]
    distribution = (
        "Share of windows whose error is smaller than a value (fitted models). The RMSE (dots) "
        f"lies above {np.min(ranks):.0f} to {np.max(ranks):.0f} % of the windows: the higher, the "
        "more it is ruled by a few, and the less it says about the typical window, at 50 %. "
    )
    shares = error_distribution_figure(study.fitted)
    curves = horizon_figure(study.fitted, study.reference_evaluations, label)
    blocks = (
        table or _error_table(study),
        _median_table(study),
        Picture("horizon", curves, horizon + protocol),
        Picture("error_distribution", shares, distribution + protocol),
    )
    return Section("prediction", "Prediction error", blocks)


def _timeline_section(study: FitStudy) -> Section:
    """Show where in time the errors of the best fitted model are."""
    best = study.best
    shares = squares_held(best.at_horizon, worst_windows(best.at_horizon))
    caption = (
        f"Absolute error of each window of {best.model} (fitted). The worst {100 * WORST:.0f} % of "
        f"the windows, chosen for each channel, hold {shares} % of the squared error of "
        "x / y / yaw. "
    )
    if study.faults:
        touched = touched_by(best, study.faults)
        caption += (
            "Shaded: known faults of this recording, where the craft accelerates far less than any "
            "model expects from the commands, because motors are off, the radio link is out or a "
            f"motor does not spin up. The {touched.sum()} of {len(touched)} windows that touch "
            f"them hold {squares_held(best.at_horizon, touched)} % of it; none is left out. "
        )
    figure = error_timeline_figure(best, study.faults)
    picture = Picture("error_timeline", figure, caption + protocol_words(best))
    return Section("time", "Where in time the errors are", (picture,))


def _thrust_section(study: FitStudy) -> Section:
    """Show the thrust curves, of M3 and M4 where they are there."""
    models = [m for m in study.models if m.name in ("M3", "M4")] or study.models
    reference = [study.reference[m.name] for m in models if m.name in study.reference]
    caption = "Thrust of each motor over its normalised speed. "
    if reference:
        caption += f"Broad: fitted; dashed: {study.reference_label}. "
    if any(m.uncertainty is not None for m in models):
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
        row["warnings"] = "; ".join(fit.warnings) or "none"
        rows.append(row)
    settings = study.fits[0].model.fit
    weights = ", ".join(f"{weight:g}" for weight in settings["weights"])
    table = (
        f"Losses in 10⁻⁵. Loss: mean of the squared errors, weighted by ({weights}) per m, m and "
        f"rad, over windows, {settings['prediction_length']} steps and the channels x, y, γ, "
        f"without any regulariser; a training window every {settings['stride']} samples. Time "
        "includes compiling."
    )
    history = f"Loss over the iterations (method: {settings.get('method')})."
    if losses:
        history += (
            f" Dashed: the {label} parameters on the same windows, with their own conventions of "
            "encoder and frame."
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
    if any(m.uncertainty is not None for m in models):
        main += _INTERVALS
    blocks: list[Picture | Table | Text] = [
        parameter_table(main, headings, main_rows(models), groups)
    ]
    if determined := [words for fit in study.fits for words in _determined(fit)]:
        blocks.append(Text(determined, bullets=True))
    if study.reference:
        caption = (
            "Relative differences of what each propeller does at full speed, and of inertia and "
            "time constant where they are learned. The accelerations are products of Π and thrust, "
            "which no choice of scale can change, so that M4 can be compared."
        )
        figure = parameter_figure(study.models, study.reference, label)
        blocks.append(Picture("parameters", figure, caption))
    if any(model.parameters.configuration_matrix is not None for model in models):
        caption = (
            "What each propeller does at full speed. m‖Π_xy‖ is the factor from a thrust as "
            "learned to newtons: 1 where Π follows from first principles or the scale was fixed "
            "after the fit, arbitrary in the published M4."
        )
        blocks.append(parameter_table(caption, headings, effect_rows(models), groups))
    caption = "Thrust coefficients as learned, F(φ) = aφ + bφ² + cφ³ + …."
    blocks.append(parameter_table(caption, headings, coefficient_rows(models), groups))
    return Section("parameters", "Parameters", blocks)


def _determined(fit: Fit) -> list[str]:
    """Summarise what the data determine of a model."""
    found, known = fit.identifiability, fit.uncertainty
    if found is None or known is None:
        return []
    first = (
        f"{fit.model.name}: {found.rank} of {found.free} free parameters are determined; condition "
        f"of the scaled information {found.condition:.1e}, weakest: {', '.join(found.weakest)}."
    )
    return [first, *(f"{fit.model.name}: {note}." for note in [*found.notes, *known.notes])]


def _error_table(study: FitStudy) -> Table:
    """Tabulate root mean square errors of all models."""
    both = (*study.reference_evaluations, *study.fitted)
    rows = [[e.model, *errors_as_text(e.rmse)] for e in both]
    caption = "Root mean square error. " + protocol_words(study.fitted[0])
    return Table(caption, ["model", *_CHANNELS], rows)


def _median_table(study: FitStudy) -> Table:
    """Tabulate median errors, the reference's beside the fits'."""
    caption = "Median absolute error: the typical window. " + protocol_words(study.fitted[0])
    rows = [[e.model, *errors_as_text(e.median_abs)] for e in study.fitted]
    if not study.reference_evaluations:
        return Table(caption, ["model", *_CHANNELS], rows)
    reference = {e.model: errors_as_text(e.median_abs) for e in study.reference_evaluations}
    rows = [[name, *reference.get(name, ("", "", "")), *errors] for name, *errors in rows]
    groups = [("", 1), (f"{study.reference_label} parameters", 3), ("fitted here", 3)]
    return Table(caption, ["model", *_CHANNELS, *_CHANNELS], rows, groups)


def sources_section(*trajectories: Trajectory) -> Section:
    """List what the numbers come from."""
    from airpuck import __version__

    rows = [
        [
            Path(t.source).parent.name or t.source,
            str(len(t)),
            f"{t.duration:.2f}",
            " ".join(t.hashes.values()) or "none",
            "; ".join(f"{s.start:.2f}–{s.stop:.2f} s: {s.cause}" for s in t.excluded) or "nothing",
        ]
        for t in trajectories
    ]
    caption = f"Recordings behind these numbers; computed by airpuck {__version__}."
    headings = ["recording", "samples", "seconds", "SHA-256", "left out"]
    return Section("sources", "Sources", (Table(caption, headings, rows),))
