"""A page on how well a model describes a recording: what `airpuck resid` shows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.fit_measures import FitMeasures
from airpuck.evaluation.prediction_bands import PredictionBands
from airpuck.evaluation.residuals import ResidualTests
from airpuck.model.model_file import Model
from airpuck.report.fit_report import sources_section
from airpuck.report.page import Picture, Section, Table, Text, write_page
from airpuck.report.prediction_bands_figure import prediction_bands_figure
from airpuck.report.residual_figure import residual_figure


def residual_report(
    model: Model,
    trajectory: Trajectory,
    tests: ResidualTests,
    fit: FitMeasures,
    out: str | os.PathLike[str],
    bands: Sequence[PredictionBands] = (),
) -> Path:
    """Write a page on the residual tests."""
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
        *([_bands_section(bands)] if bands else []),
        Section("fit", "Fit", (_fit_table(fit), _noise_table(tests))),
        sources_section(trajectory),
    ]
    lead = (
        f"{model.name} on {trajectory.duration:.1f} s of flight: {verdict}. Innovations are what "
        "remains of each pose when it is predicted from those before; with the true model they are "
        "white and know nothing of the commands."
    )
    return write_page(out, f"Residuals of {model.name}", lead, sections)


def _bands_section(bands: Sequence[PredictionBands]) -> Section:
    """Show predicted against measured trajectories."""
    parameters = (
        "the dark part is what the parameters' standard errors alone make of it. "
        if bands[0].by_parameters is not None
        else "the model's file has no standard errors, so none of its parameters are in them. "
    )
    rows = [
        [
            f"{one.horizon:.1f} s",
            str(len(one.start)),
            *(f"{share:.0f}" for share in one.coverage),
            *(f"{one.to_json()['half_band'][key]:.3g}" for key in ("x_m", "y_m", "yaw_rad")),
        ]
        for one in bands
    ]
    return Section(
        "bands",
        "Predictions",
        (
            Picture(
                "prediction_bands",
                prediction_bands_figure(bands[0], bands[-1]),
                "Predictions from the estimate of a filter that hears all poses before, and none "
                "after; right columns: measured minus predicted. Bands should hold 95 % of the "
                "measured poses: "
                + parameters
                + "The rest is what the model does not explain, as one-step innovations have it, "
                "and the noise of the pose. Drawn is the simulation with the median error. Errors "
                "are propagated linearly: with yaw unsure by more than a radian, bands of x and y "
                "are an order of magnitude.",
            ),
            Table(
                "Poses at the end of a prediction: share within the 95 % band, of all predictions "
                "that do not overlap; median half width of the bands.",
                ["ahead", "predictions", "x %", "y %", "γ %", "± x m", "± y m", "± γ rad"],
                rows,
            ),
        ),
    )


def _fit_table(fit: FitMeasures) -> Table:
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
