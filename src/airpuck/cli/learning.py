"""Commands from a recording to a validated model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, cast

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import choose, choose_protocol, cut, load, read_craft
from airpuck.cli.options import (
    EncoderName,
    Json,
    ModelName,
    ProtocolName,
    Quiet,
    RecordingPath,
    Seed,
    Span,
    TopicsFile,
    VehicleFile,
)
from airpuck.cli.output import (
    check_destinations,
    is_stdout,
    print_table,
    show_progress,
    warn,
    write_json,
)

PANEL = "From a recording to a validated model"


@app.command(rich_help_panel=PANEL)
def preprocess(
    recording: RecordingPath,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="traj.npz")],
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    delay: Annotated[
        float | None, typer.Option(metavar="S", help="Transport delay; by default it is found.")
    ] = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Turn a recording into a trajectory: states, commands, delay, what not to use."""
    if output.suffix != ".npz":
        from airpuck.boundary.errors import InputError

        raise InputError("must end in .npz", file=output, field="-o")
    check_destinations(output=output, json=json_file)
    trajectory = load(recording, read_craft(vehicle), topics, delay)
    trajectory.save(output)
    figures = {
        "samples": len(trajectory),
        "duration_s": trajectory.duration,
        "delay_s": trajectory.delay if trajectory.delay_known else None,
        "excluded": [vars(span) for span in trajectory.excluded],
        "warnings": list(trajectory.warnings),
    }
    write_json(json_file, figures)
    if not quiet and not is_stdout(json_file):
        warn(trajectory.warnings)
        known = f"{1e3 * trajectory.delay:.1f} ms" if trajectory.delay_known else "compensated"
        print(f"{len(trajectory)} samples, {trajectory.duration:.1f} s, transport delay {known}")
        for span in trajectory.excluded:
            print(f"left out {span.start:.3f} to {span.stop:.3f} s: {span.cause}")
        print(output)


@app.command(rich_help_panel=PANEL)
def identify(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="One or more, of one craft.")
    ],
    model: Annotated[
        str, typer.Option(help="M0 … M5 or quadratic; terms may be added: M3+inflow+pair.")
    ] = "M3",
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Model file to write.")
    ] = Path("model.toml"),
    span: Span = None,
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    method: Annotated[str, typer.Option(help="lm (Levenberg-Marquardt) or adam.")] = "lm",
    epochs: Annotated[int | None, typer.Option(help="Epochs of Adam.", min=1)] = None,
    stride: Annotated[
        int | None, typer.Option(help="Samples between windows; 7, for adam 1.", min=1)
    ] = None,
    degree: Annotated[
        int | None, typer.Option(help="Degree of the thrust polynomials.", min=1, max=9)
    ] = None,
    yaw_weight: Annotated[
        float, typer.Option(help="Weight of yaw errors in the loss [1/rad].", min=0)
    ] = 0.1,
    com_frame: Annotated[
        str, typer.Option(help="Centre of mass fixed to the body, or as in the paper to the world.")
    ] = "body",
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write a page with figures, too.")
    ] = None,
    delay: Annotated[
        str | None,
        typer.Option(
            help="Transport delay: fit it, or take each recording's (fixed); by default fit, where "
            "a motor lag is modelled, with lm, unless others have prepared the recording (data.pt)."
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Let windows that are predicted badly count less."),
    ] = False,
    faults: Annotated[
        str | None,
        typer.Option(
            help="exclude: where motors or radio failed, nothing is learned; or keep. By default "
            "exclude, unless others have prepared the recording (data.pt)."
        ),
    ] = None,
    bootstrap: Annotated[
        int | None,
        typer.Option(metavar="N", help="Fit to N resamplings, too, for their intervals.", min=10),
    ] = None,
    seed: Seed = 0,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Identify a model from recordings and write it as TOML."""
    from airpuck.boundary.errors import InputError
    from airpuck.cli.fit_output import print_fit, show_resampling
    from airpuck.identification.adam import Adam
    from airpuck.identification.bootstrap import bootstrap as resample
    from airpuck.identification.fit import identify
    from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
    from airpuck.identification.problem import Loss, Preparation
    from airpuck.model.rungs import named_rung

    for option, value, choices in (
        ("--method", method, ("lm", "adam")),
        ("--faults", faults, (None, "exclude", "keep")),
        ("--com-frame", com_frame, ("body", "world")),
        ("--delay", delay, (None, "fit", "fixed")),
    ):
        if value not in choices:
            choose(option, str(value), tuple(choice for choice in choices if choice))
    rung = named_rung(model, degree=degree, frame=cast(Any, com_frame))
    if epochs is not None and method != "adam":
        raise InputError("is of adam only; add --method adam", field="--epochs")
    if degree is not None and rung.powers is not None:
        raise InputError(f"is fixed for the model {model}", field="--degree")
    if method != "lm":
        if delay == "fit":
            raise InputError("fit is of lm only", field="--delay")
        for option, given in (("--robust", robust), ("--bootstrap", bootstrap is not None)):
            if given:
                raise InputError("is of lm only", field=option)
    if seed and bootstrap is None:
        raise InputError("is of the resampling only; add --bootstrap N", field="--seed")
    check_destinations(output=output, json=json_file, report=report)
    craft = read_craft(vehicle)
    trajectories = [cut(load(path, craft, topics), span) for path in recordings]
    warn([w for t in trajectories for w in t.warnings], quiet)
    stride = stride or (7 if method == "lm" else 1)
    adam = Adam() if epochs is None else Adam(epochs=epochs)
    with show_progress(quiet) as progress:
        fit = identify(
            trajectories,
            rung,
            vehicle=craft,
            loss=Loss(weights=(1.0, 1.0, yaw_weight), stride=stride, robust=robust),
            method=LevenbergMarquardt() if method == "lm" else adam,
            preparation=Preparation(faults=cast(Any, faults), delay=cast(Any, delay)),
            progress=progress,
        )
        if bootstrap is not None:
            shown = show_resampling(quiet, bootstrap)
            fit = resample(fit, bootstrap, seed=seed, progress=shown)
    fit.model.save(output)
    if report is not None:
        from airpuck.report.fit_report import fit_report

        fit_report(fit, [], trajectories[0], report)
    write_json(json_file, fit.to_json())
    warn(fit.warnings, quiet)
    if not quiet and not is_stdout(json_file):
        print_fit(fit)
        print(output)


@app.command(rich_help_panel=PANEL)
def evaluate(
    model: ModelName,
    recording: RecordingPath,
    span: Span = None,
    protocol: ProtocolName = "paper",
    encoder: EncoderName = "paper",
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Measure how well a model predicts a recording."""
    from airpuck.evaluation.evaluate import evaluate
    from airpuck.model.model_file import read_model

    chosen = choose_protocol(protocol, encoder)
    known = read_model(model)
    trajectory = cut(load(recording, known.vehicle, topics), span)
    warn(trajectory.warnings, quiet)
    evaluation = evaluate(known, trajectory, protocol=chosen, encoder=encoder)
    write_json(json_file, {**evaluation.to_json(), "name": model})
    if not is_stdout(json_file):
        print_table([model], [evaluation])


@app.command(rich_help_panel=PANEL)
def check(
    recording: RecordingPath,
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    json_file: Json = None,
) -> None:
    """Check that motor order and signs of a vehicle file agree with a recording."""
    from airpuck.craft.vehicle import default_vehicle
    from airpuck.faults.layout_check import check_layout

    craft = read_craft(vehicle) or default_vehicle()
    result = check_layout(load(recording, craft, topics), craft)
    write_json(json_file, result.to_json())
    if not is_stdout(json_file):
        for propeller in result.propellers:
            print(f"{propeller.name:16s} {propeller.agreement:6.3f}  {propeller.verdict}")
        print(f"the commands explain {100 * result.explained:.0f} % of the acceleration")
        for sentence in result.remarks:
            print(sentence)
    if not result.agrees:
        from airpuck.boundary.errors import InputError

        wrong = [p.name for p in result.propellers if p.verdict != "agrees"]
        about = ", ".join(wrong) if result.conclusive else "nothing can be said"
        raise InputError(f"does not agree with the vehicle {craft.name!r}: {about}", file=recording)
