"""Commands that judge a model: what it is, what it leaves unexplained."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import about, cut, load
from airpuck.cli.learning import PANEL
from airpuck.cli.options import Json, ModelName, Quiet, RecordingPath, Span, TopicsFile
from airpuck.cli.output import check_destinations, is_stdout, warn, write_json


@app.command(rich_help_panel=PANEL)
def resid(
    model: ModelName,
    recording: RecordingPath,
    span: Span = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write a page, too.")
    ] = None,
    lags: Annotated[int, typer.Option(help="Largest lag, in samples.", min=5)] = 25,
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Test the one-step innovations of a model: whiteness, and what commands still explain."""
    from airpuck.evaluation.goodness import goodness
    from airpuck.evaluation.residuals import resid
    from airpuck.model_file import read_model

    check_destinations(output=output, json=json_file)
    known = read_model(model)
    trajectory = cut(load(recording, known.vehicle, topics), span)
    warn(trajectory.warnings, quiet)
    with about(recording):
        tests = resid(known, trajectory, lags=lags)
        fit = goodness(known, trajectory, known=tests.innovations)
    write_json(json_file, {**tests.to_json(), **fit.to_json(), "name": model})
    page = None
    if output is not None:
        from airpuck.report.residual_report import residual_report

        page = residual_report(known, trajectory, tests, fit, output)
    if not is_stdout(json_file):
        outcome = "nothing rejected" if tests.passed else "rejected"
        print(f"{model}: {outcome}, {tests.samples} one-step innovations, 1 % level")
        for sentence in tests.verdicts:
            print(f"  {sentence}")
        for label, values in (
            (f"{fit.steps} steps ahead", fit.k_step),
            (f"simulated for {fit.restart:g} s", fit.free_run),
            ("simulated throughout", fit.whole),
        ):
            shown = ", ".join(f"{v:.1f}" for v in values)
            print(f"fit {label}: {shown} % (x, y, yaw)")
        print(
            f"log-likelihood {fit.log_likelihood:.1f}, {fit.parameters} fitted parameters, "
            f"AIC {fit.aic:.1f}, BIC {fit.bic:.1f}"
        )
        if page is not None:
            print(page)
