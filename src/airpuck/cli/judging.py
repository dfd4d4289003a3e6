"""Commands that judge models: what one is, what it leaves unexplained, how several compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import about, choose_protocol, cut, load
from airpuck.cli.learning import PANEL
from airpuck.cli.options import (
    EncoderName,
    Json,
    ModelName,
    ProtocolName,
    Quiet,
    RecordingPath,
    Span,
    TopicsFile,
)
from airpuck.cli.output import check_destinations, is_stdout, print_table, warn, write_json

#: What a model's name ends with, which no recording's does.
_MODEL_FILES = (".toml", ".json")


@app.command(rich_help_panel=PANEL)
def present(model: ModelName, json_file: Json = None) -> None:
    """Present a model: structure, parameters with errors, what follows, how it was learned."""
    from airpuck.cli.judgement_output import print_presentation
    from airpuck.evaluation.presentation import present
    from airpuck.model.model_file import read_model

    presentation = present(read_model(model))
    write_json(json_file, presentation.to_json())
    if not is_stdout(json_file):
        print_presentation(presentation)


@app.command(rich_help_panel=PANEL)
def compare(
    models: Annotated[
        list[str],
        typer.Argument(
            metavar="MODEL... RECORDING",
            help="Models, then the recording; two models alone: what drifted.",
        ),
    ],
    span: Span = None,
    protocol: ProtocolName = "paper",
    encoder: EncoderName = "paper",
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Compare models on one recording; of two learned models, say what drifted."""
    from airpuck.boundary.errors import InputError
    from airpuck.cli.judgement_output import print_drift, print_fit_measures
    from airpuck.evaluation.drift import Drift, drift
    from airpuck.evaluation.evaluate import compare
    from airpuck.evaluation.fit_measures import measure_fit
    from airpuck.model.model_file import read_model

    chosen = choose_protocol(protocol, encoder)
    alone = models[-1].startswith("paper:") or models[-1].endswith(_MODEL_FILES)
    names = models if alone else models[:-1]
    if not names or (alone and len(names) != 2):
        raise InputError("give at least one MODEL and a RECORDING, or two MODELs")
    known = [read_model(name) for name in names]
    figures: dict[str, Any] = {}
    moved = None
    if len(known) == 2 and (alone or all(m.uncertainty is not None for m in known)):
        try:
            moved = drift(*known)
        except InputError as error:
            if alone:
                raise
            moved = Drift((), (f"drift is not told: {error.problem}",))
        figures["drift"] = moved.to_json()
    evaluations, fits = [], []
    if not alone:
        trajectory = cut(load(Path(models[-1]), known[0].vehicle, topics), span)
        warn(trajectory.warnings, quiet)
        evaluations = compare(known, trajectory, protocol=chosen, encoder=encoder)
        fits = [measure_fit(model, trajectory) for model in known]
        figures["evaluations"] = [
            {**evaluation.to_json(), **fit.to_json(), "name": name}
            for name, evaluation, fit in zip(names, evaluations, fits, strict=True)
        ]
    write_json(json_file, figures)
    if is_stdout(json_file):
        return
    if not alone:
        print_table(names, evaluations)
        print_fit_measures(names, fits)
    if moved is not None:
        print_drift(names, moved)


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
    from airpuck.cli.judgement_output import print_coverage, print_fit_measures
    from airpuck.evaluation.fit_measures import measure_fit
    from airpuck.evaluation.prediction_bands import bands_of_all_horizons
    from airpuck.evaluation.residuals import resid
    from airpuck.model.model_file import read_model

    check_destinations(output=output, json=json_file)
    known = read_model(model)
    trajectory = cut(load(recording, known.vehicle, topics), span)
    warn(trajectory.warnings, quiet)
    with about(recording):
        tests = resid(known, trajectory, lags=lags)
        fit = measure_fit(known, trajectory, known=tests.innovations)
        bands = bands_of_all_horizons(known, trajectory, tests.innovations)
    figures = {**tests.to_json(), **fit.to_json(), "bands": [one.to_json() for one in bands]}
    write_json(json_file, {**figures, "name": model})
    page = None
    if output is not None:
        from airpuck.report.residual_report import residual_report

        page = residual_report(known, trajectory, tests, fit, output, bands)
    if not is_stdout(json_file):
        outcome = "nothing rejected" if tests.passed else "rejected"
        print(f"{model}: {outcome}, {tests.samples} one-step innovations, 1 % level")
        for sentence in tests.verdicts:
            print(f"  {sentence}")
        print_coverage(bands)
        print_fit_measures([model], [fit])
        if page is not None:
            print(page)
