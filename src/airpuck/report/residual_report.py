"""A page on how well a model describes a recording: what `airpuck resid` shows."""

from __future__ import annotations

import os
from pathlib import Path

from airpuck.evaluation.goodness import Goodness
from airpuck.evaluation.residuals import ResidualTests
from airpuck.model_file import Model
from airpuck.report.fit_report import sources_section
from airpuck.report.page import Picture, Section, Table, Text, write_page
from airpuck.report.residual_figure import residual_figure
from airpuck.trajectory import Trajectory


def residual_report(
    model: Model,
    trajectory: Trajectory,
    tests: ResidualTests,
    fit: Goodness,
    out: str | os.PathLike[str],
) -> Path:
    """Write a page on the residual tests.

    Parameters
    ----------
    model : Model
        What was tested.
    trajectory : Trajectory
        The recording.
    tests : ResidualTests
        Whiteness and cross-correlation.
    fit : Goodness
        Fit percentages and information criteria.
    out : path-like
        Folder to write to.

    Returns
    -------
    Path
        ``out/index.html``, one self-contained page; its figures are in ``out/figures`` as well.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    verdict = "nothing was rejected" if tests.passed else "the model does not explain all there is"
    sections = [
        Section(
            "tests",
            "Residual tests",
            (
                Text(tests.verdicts, bullets=True),
                Picture(
                    "residuals",
                    residual_figure(tests, model.vehicle),
                    "Correlations of the one-step innovations, turned into the frame of the body, "
                    f"{tests.samples} samples. Above: with themselves. Below: with the command in "
                    "force that many samples before; broad lines are motors whose test rejects at "
                    "the 1 % level. Bands hold 99 % of the values, each by itself, where there is "
                    "nothing to find. Left of zero are commands still to come.",
                ),
            ),
        ),
        Section("fit", "Fit", (_fit_table(fit), _noise_table(tests))),
        sources_section(trajectory),
    ]
    lead = (
        f"{model.name} on {trajectory.duration:.1f} s of flight: {verdict}. Innovations are what "
        "remains of each pose when it is predicted from those before; with the true model they are "
        "white and know nothing of the commands."
    )
    return write_page(out, f"Residuals of {model.name}", lead, sections)


def _fit_table(fit: Goodness) -> Table:
    """Tabulate fit percentages and criteria."""
    rows = [
        [label, *(f"{value:.2f}" for value in values)]
        for label, values in (
            (f"{fit.steps} steps ahead", fit.k_step),
            (f"simulated for {fit.restart:g} s at a time", fit.free_run),
            ("simulated from start to end", fit.whole),
        )
    ]
    caption = (
        "Fit 100 (1 − ‖y − ŷ‖/‖y − mean y‖) in percent; below zero a simulation is further off "
        f"than the mean. Log-likelihood {fit.log_likelihood:.1f} with {fit.parameters} fitted "
        f"parameters: AIC {fit.aic:.1f}, BIC {fit.bic:.1f}; only differences between models on the "
        "same recording mean something."
    )
    return Table(caption, ["", "x %", "y %", "γ %"], rows)


def _noise_table(tests: ResidualTests) -> Table:
    """Tabulate the noise that was found."""
    noise = tests.innovations.noise
    rows = [
        [name, *(f"{value:.3g}" for value in values), unit]
        for name, values, unit in (
            ("pose", noise.pose, "m, m, rad"),
            ("white acceleration", noise.acceleration, "m/s²/√Hz, rad/s²/√Hz"),
            ("drive of the disturbance", noise.disturbance, "m/s³/√Hz, rad/s³/√Hz"),
        )
    ]
    caption = "Noise of the largest likelihood: standard deviation of the poses, densities."
    return Table(caption, ["", "x", "y", "γ", "unit"], rows)
