"""The sections that every report has, whatever was fitted to whatever craft."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.identification.fit_result import Fit
from airpuck.report.craft import craft_figure, frames_figure
from airpuck.report.error_distribution import error_distribution_figure
from airpuck.report.error_timeline import WORST, error_timeline_figure, share_of_squares, touched_by
from airpuck.report.horizon import horizon_figure
from airpuck.report.loss_history import loss_history_figure
from airpuck.report.page import Picture, Section, Table, Text
from airpuck.report.parameter_comparison import parameter_figure
from airpuck.report.parameter_table import Row, coefficient_rows, effect_rows, main_rows
from airpuck.report.study import Study, protocol_words
from airpuck.report.thrust_curves import thrust_figure

#: Factors and formats of x, y, yaw in tables.
_FACTORS, _FORMATS = (1e3, 1e3, 1.0), (".2f", ".2f", ".4f")
_CHANNELS = ("x mm", "y mm", "γ rad")
#: What stands behind a value.
INTERVALS = (
    " ±: standard error, from blocks of two seconds taken as independent; a learned value "
    "without one is held by a constraint, or known only as part of a product. What is wrong in all "
    "of the data alike is not in it."
)


def craft_section(vehicle: Vehicle) -> Section:
    """Show the craft and its frames."""
    return Section(
        "craft",
        "The craft",
        (
            Picture(
                "craft",
                craft_figure(vehicle),
                "Propeller layout, to scale, seen from above. An arrow is the force of a propeller "
                "on the craft; ↺ and ↻ say which way it turns the craft. The two propellers of a "
                "pair have one colour and push against each other, so that a pair can push either "
                "way. From the vehicle file: measured, not learned.",
            ),
            Picture(
                "frames",
                frames_figure(vehicle),
                "Left: position p and yaw γ of the body frame in the world frame (schematic). "
                "Right: α is the rotation of the propeller layout against the measured yaw, r the "
                "offset of the centre of mass from the geometric centre; both exaggerated.",
            ),
        ),
    )


def prediction_section(study: Study, table: Table | None = None) -> Section:
    """Show how far predictions are off."""
    protocol = protocol_words(study.fitted[0])
    blocks: list[Picture | Table | Text] = [table or _error_table(study)]
    blocks.append(_median_table(study))
    compared = bool(study.reference_evaluations)
    blocks.append(
        Picture(
            "horizon",
            horizon_figure(
                study.fitted, study.reference_evaluations, reference_label=study.reference_label
            ),
            "Root mean square error over the time predicted. "
            + (
                "Where broad and dashed lines of a colour coincide, our fit predicts like the "
                f"{study.reference_label} parameters. "
                if compared
                else ""
            )
            + protocol,
        )
    )
    blocks.append(
        Picture(
            "error_distribution",
            error_distribution_figure(study.fitted),
            "Share of windows whose error is smaller than a value (fitted models). The RMSE "
            f"(dots) {_rank_of_rmse(study)} of the windows: the higher, the more it is ruled by a "
            "few, and the less it says about the typical window, at 50 %. " + protocol,
        )
    )
    return Section("prediction", "Prediction error", tuple(blocks))


def timeline_section(study: Study) -> Section:
    """Show where in time the errors of the best fitted model are."""
    best = study.best
    shares = " / ".join(f"{100 * share_of_squares(errors):.0f}" for errors in best.at_horizon)
    known = ""
    if study.faults:
        touched = touched_by(best, study.faults)
        squares = best.at_horizon**2
        held = 100 * squares[:, touched].sum(axis=1) / squares.sum(axis=1)
        known = (
            " Shaded: known faults of this recording, where the craft accelerates far less than "
            "any model expects from the commands, because motors are off, the radio link is out or "
            f"a motor does not spin up. The {touched.sum()} of {len(touched)} windows that touch "
            f"them hold {' / '.join(f'{share:.0f}' for share in held)} % of it; none is left out."
        )
    return Section(
        "time",
        "Where in time the errors are",
        (
            Picture(
                "error_timeline",
                error_timeline_figure(best, study.faults),
                f"Absolute error of each window of {best.model} (fitted). The worst "
                f"{100 * WORST:.0f} % of the windows, chosen for each channel, hold {shares} % of "
                f"the squared error of x / y / yaw.{known} {protocol_words(best)}",
            ),
        ),
    )


def thrust_section(study: Study, names: Sequence[str] | None = None) -> Section:
    """Show the thrust curves."""
    wanted = names or [m.name for m in study.models if m.name in ("M3", "M4")]
    models = [m for m in study.models if m.name in wanted] or study.models
    reference = [study.reference[m.name] for m in models if m.name in study.reference]
    direct = any(m.parameters.configuration_matrix is not None for m in [*models, *reference])
    note = (
        " The scale of M4's thrusts is arbitrary: s times the thrust and 1/s times the propeller's "
        "column of Π predict the same. It is fixed so that a propeller's column of Π has the "
        "length 1/m in x and y, as Newton's law demands."
        if direct
        else ""
    )
    return Section(
        "thrust",
        "Thrust curves",
        (
            Picture(
                "thrust",
                thrust_figure(
                    models, study.training, reference, reference_label=study.reference_label
                ),
                "Thrust of each motor over its normalised speed. Broad: fitted; dashed: "
                f"{study.reference_label}. "
                * bool(reference)
                + "Bands: 95 % intervals at each speed. "
                * any(m.uncertainty is not None for m in models)
                + "Bars: share of the training samples at each command, in twentieths of the range "
                "(a bar that is cut off has its share beside it); the bracket on the axis is the "
                "range that was commanded, outside of which a curve is extrapolated." + note,
            ),
        ),
    )


def optimiser_section(study: Study) -> Section:
    """Show how the fits were found."""
    losses = study.reference_losses
    rows = []
    for fit in study.fits:
        reference = losses.get(fit.model.name)
        rows.append(
            [
                fit.model.name,
                str(int(fit.model.free.sum())),
                str(fit.windows),
                str(fit.iterations),
                f"{1e5 * fit.history[0].loss:.3f}",
                f"{1e5 * fit.loss:.3f}",
                *([] if not losses else ["" if reference is None else f"{1e5 * reference:.3f}"]),
                f"{fit.wall_s:.1f}",
                "yes" if fit.converged else fit.message,
                "; ".join(fit.warnings) or "none",
            ]
        )
    settings = study.fits[0].model.fit
    weights = ", ".join(f"{weight:g}" for weight in settings.get("weights", ()))
    headings = ["model", "free", "windows", "iterations", "loss at start", "loss"]
    headings += [f"loss, {study.reference_label}"] * bool(losses)
    return Section(
        "optimiser",
        "How the fits were found",
        (
            Table(
                "Losses in 10⁻⁵. Loss: mean of the squared errors, weighted by "
                f"({weights}) per m, m and rad, over windows, "
                f"{settings.get('prediction_length')} steps and the channels x, y, γ, without any "
                f"regulariser; a training window every {settings.get('stride')} samples. Time "
                "includes compiling.",
                [*headings, "time s", "converged", "warnings"],
                rows,
            ),
            Picture(
                "loss_history",
                loss_history_figure(study.fits, losses, reference_label=study.reference_label),
                f"Loss over the iterations (method: {settings.get('method')})."
                + (
                    f" Dashed: the {study.reference_label} parameters on the same windows, with "
                    "their own conventions of encoder and frame."
                    if losses
                    else ""
                ),
            ),
        ),
    )


def parameter_section(study: Study) -> Section:
    """Show the parameters."""
    models, labels = [], []
    for model in study.models:
        if model.name in study.reference:
            models.append(study.reference[model.name])
            labels.append(study.reference_label)
        models.append(model)
        labels.append("fitted")
    groups = [("", 2)]
    for model in study.models:
        groups.append((model.name, 2 if model.name in study.reference else 1))

    def table(caption: str, rows: Sequence[Row]) -> Table:
        return Table(
            caption,
            ["", "unit", *labels],
            [[row.label, row.unit, *(cell.text for cell in row.cells)] for row in rows],
            groups,
            frozenset(
                (i, j + 2)
                for i, row in enumerate(rows)
                for j, cell in enumerate(row.cells)
                if cell.free
            ),
        )

    blocks: list[Picture | Table | Text] = [
        table(
            "Parameters; bold: learned. F(1) is the thrust at full speed, of M4 at the physical "
            "scale." + INTERVALS * any(m.uncertainty is not None for m in models),
            main_rows(models),
        )
    ]
    told = [words for fit in study.fits for words in _determined(fit)]
    if told:
        blocks.append(Text(told, bullets=True))
    if study.reference:
        blocks.append(
            Picture(
                "parameters",
                parameter_figure(
                    study.models, study.reference, reference_label=study.reference_label
                ),
                "Relative differences of what each propeller does at full speed, and of inertia "
                "and time constant where they are learned. The accelerations are products of Π "
                "and thrust, which no choice of scale can change, so that M4 can be compared.",
            )
        )
    if any(model.parameters.configuration_matrix is not None for model in models):
        blocks.append(
            table(
                "What each propeller does at full speed. m‖Π_xy‖ is the factor from a thrust as "
                "learned to newtons: 1 where Π follows from first principles or the scale was "
                "fixed after the fit, arbitrary in the published M4.",
                effect_rows(models),
            )
        )
    blocks.append(
        table(
            "Thrust coefficients as learned, F(φ) = aφ + bφ² + cφ³ + ….", coefficient_rows(models)
        )
    )
    return Section("parameters", "Parameters", tuple(blocks))


def _determined(fit: Fit) -> list[str]:
    """Say what the data determine of a model."""
    found, known = fit.identifiability, fit.uncertainty
    if found is None or known is None:
        return []
    first = (
        f"{fit.model.name}: {found.rank} of {found.free} free parameters are determined; condition "
        f"of the scaled information {found.condition:.1e}, weakest: {', '.join(found.weakest)}."
    )
    return [first, *(f"{fit.model.name}: {note}." for note in [*found.notes, *known.notes])]


def _rank_of_rmse(study: Study) -> str:
    """Say how many windows have a smaller error than the RMSE."""
    ranks = [100 * np.mean(np.abs(e.at_horizon) <= e.rmse[:, None], axis=1) for e in study.fitted]
    return f"lies above {np.min(ranks):.0f} to {np.max(ranks):.0f} %"


def _error_table(study: Study) -> Table:
    """Tabulate root mean square errors of all models."""
    rows = [
        [evaluation.model, *errors_as_text(evaluation.rmse)]
        for evaluation in (*study.reference_evaluations, *study.fitted)
    ]
    caption = "Root mean square error. " + protocol_words(study.fitted[0])
    return Table(caption, ["model", *_CHANNELS], rows)


def _median_table(study: Study) -> Table:
    """Tabulate median errors, the reference's beside the fits'."""
    reference = {e.model: e for e in study.reference_evaluations}
    rows = []
    for evaluation in study.fitted:
        row = [evaluation.model]
        if reference:
            other = reference.get(evaluation.model)
            row += ["", "", ""] if other is None else errors_as_text(other.median_abs)
        rows.append(row + errors_as_text(evaluation.median_abs))
    caption = "Median absolute error: the typical window. " + protocol_words(study.fitted[0])
    if not reference:
        return Table(caption, ["model", *_CHANNELS], rows)
    groups = [("", 1), (f"{study.reference_label} parameters", 3), ("fitted here", 3)]
    return Table(caption, ["model", *_CHANNELS, *_CHANNELS], rows, groups)


def errors_as_text(values: np.ndarray) -> list[str]:
    """Format errors of x, y [m] and yaw [rad] as millimetres and radians."""
    return [
        format(factor * value, form)
        for value, factor, form in zip(values, _FACTORS, _FORMATS, strict=True)
    ]
