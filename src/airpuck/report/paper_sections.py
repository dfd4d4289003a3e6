"""The sections that only a report on the paper has: summary, its tables, its conventions."""

from __future__ import annotations

import numpy as np

from airpuck.report.error_figures import WORST, share_of_squares
from airpuck.report.fit_sections import errors_as_text
from airpuck.report.fit_study import FitStudy, protocol_words
from airpuck.report.page import Picture, Section, Table, Text, packaged_text
from airpuck.report.parameter_table import ladder_table

#: table:prediction_error as printed: x [mm], y [mm], γ [rad].
PRINTED = {
    "M0": ("16.2", "15.7", "0.501"),
    "M1": ("15.1", "15.0", "0.495"),
    "M2": ("12.9", "11.4", "0.391"),
    "M3": ("10.8", "9.8", "0.387"),
    "M4": ("10.8", "9.6", "0.387"),
}

_CONVENTIONS = (
    "Protocol “paper”: the validation recording is cut into windows that do not overlap, of "
    "E + T = 20 + 50 samples at 240 Hz. The encoder looks at the first 20, the model predicts the "
    "next 50, and errors are reported after step 48 (0.2 s). No window is left out; yaw is "
    "continuous, so that its error needs no wrapping.",
    "Published parameters are evaluated with the convention of the code that they were learned "
    "with: within the encoder's window the motors follow the command at the end of each interval, "
    "and the offset of the centre of mass stays fixed in the world frame (eq. acc_dyn).",
    "Our fits use one convention throughout: the command at an interval's start acts over it, in "
    "the encoder as in the prediction; the centre of mass is fixed to the body. So the encoder "
    "differs from the published one by one sample of command.",
    "The loss is that of the published fits: squares of the errors of x and y in metres and of a "
    "tenth of the yaw error in radians, mean over steps 1 to 50, channels and windows. The "
    "paper's text has unweighted yaw.",
    "Thrust curves must rise on [0, 1]: a linear constraint in each step of Levenberg-Marquardt, "
    "in place of the paper's regulariser. The published code penalises 3cφ where the proposition "
    "has 3cφ²; here it is as proved.",
    "The paper's angles πi/3 between pairs are 2πi/3 on the craft (three pairs, 120° apart), and "
    "α turns the directions of the thrusts with their positions.",
    "The authors' recordings come preprocessed: velocities from smoothed positions (not causal), "
    "commands shifted by the transport delay of five samples.",
)


def summary_section(study: FitStudy, wall_s: float) -> Section:
    """Say in a few lines what was found."""
    published = {e.model: e for e in study.reference_evaluations}
    agree = sum(
        f"{error:{form}}" == printed
        for name, row in PRINTED.items()
        for error, form, printed in zip(
            published[name].rmse * (1e3, 1e3, 1.0), (".1f", ".1f", ".3f"), row, strict=True
        )
    )
    ratio = np.array([e.rmse / published[e.model].rmse for e in study.fitted])
    steps = [fit.iterations for fit in study.fits]
    best = study.best
    medians, rmse = (" / ".join(errors_as_text(e)) for e in (best.median_abs, best.rmse))
    share = " / ".join(f"{100 * share_of_squares(errors):.0f}" for errors in best.at_horizon)
    findings = (
        f"The published parameters give {agree} of the {3 * len(PRINTED)} numbers of the paper's "
        "Table 2 as printed.",
        "Our own fits, from the paper's initial values and its training recording alone, differ "
        f"from the published errors by {_percent(ratio.min())} to {_percent(ratio.max())}, "
        f"{_percent(ratio.mean())} on average (negative: ours are lower).",
        f"Levenberg-Marquardt needed {min(steps)} to {max(steps)} iterations; all fits and "
        f"evaluations took {wall_s:.1f} s.",
        f"The typical window is predicted much better than the RMSE says: {best.model} (fitted) "
        f"has medians of {medians} against RMSE of {rmse} (x mm / y mm / γ rad), because the worst "
        f"{100 * WORST:.0f} % of the windows hold {share} % of the squared error. Many of these "
        "lie at faults of the recording.",
    )
    return Section("summary", "In short", (Text(findings, bullets=True),))


def learning_section(study: FitStudy) -> Section:
    """Show Table 1 and how a model is learned (fig:learning_architecture)."""
    caption = (
        "From a recording to parameters. The encoder estimates position, velocity and motor speeds "
        "at the present t from E samples; the model predicts T steps under the recorded commands; "
        "the squared errors, over many windows, are the loss, which the optimiser lowers by "
        "changing θ (green) in encoder and model alike."
    )
    diagram = packaged_text("learning_architecture.svg")
    blocks = (
        ladder_table(study.models),
        Picture("learning_architecture", diagram, caption),
    )
    return Section("learning", "The models, and how they are learned", blocks)


def table_2(study: FitStudy) -> Table:
    """Tabulate the paper's Table 2: published parameters against ours."""
    published = {e.model: e for e in study.reference_evaluations}
    rows = []
    for evaluation in study.fitted:
        other = published[evaluation.model]
        rows.append(
            [
                evaluation.model,
                *PRINTED[evaluation.model],
                *errors_as_text(other.rmse),
                *errors_as_text(evaluation.rmse),
                *(_percent(ratio) for ratio in evaluation.rmse / other.rmse),
            ]
        )
    groups = {
        "": 1,
        "as printed": 3,
        "published parameters, here": 3,
        "fitted here": 3,
        "fitted against published": 3,
    }
    return Table(
        "Table 2 of the paper: root mean square prediction error on the validation recording. "
        f"{protocol_words(study.fitted[0])} Published parameters with the published encoder "
        "convention, ours with the consistent one (see Conventions).",
        ["model", *3 * ["x mm", "y mm", "γ rad"], "x", "y", "γ"],
        rows,
        list(groups.items()),
    )


def conventions_section() -> Section:
    """State what every number rests on, and where the paper's text and numbers disagree."""
    return Section("conventions", "Conventions", (Text(_CONVENTIONS, bullets=True),))


def _percent(ratio: float) -> str:
    """Format a ratio as a difference in percent."""
    percent = round(100 * (float(ratio) - 1), 1)
    # No break before the sign of percent, a true minus, and no sign before zero.
    return f"{percent:+.1f}\u00a0%".replace("-", "−") if percent else "0.0\u00a0%"
