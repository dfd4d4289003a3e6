"""The command line: each command parses, calls the verb of the same name, and prints."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.exceptions import TyperException

if TYPE_CHECKING:
    from airpuck.evaluation.evaluate import Evaluation
    from airpuck.identification.method import Iteration
    from airpuck.trajectory import Trajectory
    from airpuck.vehicle import Vehicle

app = typer.Typer(
    name="airpuck",
    help="Identify, simulate and control propeller-driven hovercraft.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write the figures as JSON; - for standard output."
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but results.")]
VehicleFile = Annotated[
    Path | None,
    typer.Option("--vehicle", metavar="FILE", help="Vehicle file; by default the paper's craft."),
]
TopicsFile = Annotated[
    Path | None,
    typer.Option("--topics", metavar="FILE", help="TOML file with the names of a bag's topics."),
]
Span = Annotated[
    tuple[float, float] | None,
    typer.Option("--span", metavar="A B", help="Part to use, as fractions of the length."),
]
RecordingPath = Annotated[
    Path,
    typer.Argument(
        metavar="RECORDING",
        help="A bag folder, .mcap, folder of CSV files, data.pt, or preprocessed .npz.",
    ),
]
ModelName = Annotated[
    str,
    typer.Argument(
        metavar="MODEL", help="A model.toml, the authors' params.json, or paper:M0 … M4."
    ),
]


def main() -> None:
    """Run the command line; bad usage and bad input end with one line and status 2."""
    from airpuck.errors import InputError

    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except InputError as error:
        code = _refuse(str(error))
    except TyperException as error:
        code = _refuse(f"{error.format_message()} (see airpuck --help)")
    except (typer.Abort, KeyboardInterrupt):
        code = _refuse("interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def _refuse(message: str) -> int:
    """Print one line on standard error; return the exit status for bad usage and bad input."""
    print("airpuck: " + " ".join(message.split()), file=sys.stderr)
    return 2


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Identify, simulate and control propeller-driven hovercraft."""
    if version:
        from airpuck import __version__

        print(f"airpuck {__version__}")


@app.command()
def fetch(
    everything: Annotated[
        bool, typer.Option("--all", help="All recordings, not only the study's.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Download and verify the public dataset (or verify $AIRPUCK_DATA)."""
    from airpuck.recording import fetch

    say = _say(quiet)
    print(fetch(all=everything, progress=lambda done, of, name: say(f"{done + 1}/{of} {name}")))


@app.command()
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
    trajectory = _load(recording, _vehicle(vehicle), topics, delay)
    if output.suffix != ".npz":
        from airpuck.errors import InputError

        raise InputError("must end in .npz", file=output, field="-o")
    trajectory.save(output)
    figures = {
        "samples": len(trajectory),
        "duration_s": trajectory.duration,
        "delay_s": trajectory.delay if trajectory.delay_known else None,
        "excluded": [vars(span) for span in trajectory.excluded],
        "warnings": list(trajectory.warnings),
    }
    _write_json(json_file, figures)
    if not quiet and not _is_stdout(json_file):
        _warn(trajectory.warnings)
        known = f"{1e3 * trajectory.delay:.1f} ms" if trajectory.delay_known else "compensated"
        print(f"{len(trajectory)} samples, {trajectory.duration:.1f} s, transport delay {known}")
        for span in trajectory.excluded:
            print(f"left out {span.start:.3f} to {span.stop:.3f} s: {span.cause}")
        print(output)


@app.command()
def identify(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="One or more, of one craft.")
    ],
    model: Annotated[str, typer.Option(help="M0 … M4 or quadratic.")] = "M3",
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
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Identify a model from recordings and write it as TOML."""
    from airpuck.identification.adam import Adam
    from airpuck.identification.fit import identify
    from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
    from airpuck.model.presets import preset

    preset(model)
    _choose("--method", method, ("lm", "adam"))
    _choose("--com-frame", com_frame, ("body", "world"))
    craft = _vehicle(vehicle)
    trajectories = [_cut(_load(path, craft, topics), span) for path in recordings]
    _warn([w for t in trajectories for w in t.warnings], quiet)
    adam = Adam() if epochs is None else Adam(epochs=epochs)
    with _progress(quiet) as progress:
        fit = identify(
            trajectories,
            model,
            vehicle=craft,
            method=LevenbergMarquardt() if method == "lm" else adam,
            weights=(1.0, 1.0, yaw_weight),
            stride=stride or (7 if method == "lm" else 1),
            degree=degree,
            frame="body" if com_frame == "body" else "world",
            progress=progress,
        )
    fit.model.save(output)
    if report is not None:
        from airpuck.report.fit_report import fit_report

        fit_report(fit, [], trajectories[0], report)
    _write_json(json_file, fit.to_json())
    _warn(fit.warnings, quiet)
    if not quiet and not _is_stdout(json_file):
        print(
            f"{fit.model.name}: loss {fit.loss:.4e} after {fit.iterations} iterations "
            f"on {fit.windows} windows, {fit.wall_s:.1f} s ({fit.message})"
        )
        print(output)


@app.command()
def evaluate(
    model: ModelName,
    recording: RecordingPath,
    span: Span = None,
    protocol: Annotated[str, typer.Option(help="paper")] = "paper",
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Measure how well a model predicts a recording."""
    _compare([model], recording, span, protocol, topics, json_file, quiet, single=True)


@app.command()
def compare(
    models: Annotated[
        list[str],
        typer.Argument(metavar="MODEL... RECORDING", help="Models, then the recording."),
    ],
    span: Span = None,
    protocol: Annotated[str, typer.Option(help="paper")] = "paper",
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Compare several models on one recording."""
    if len(models) < 2:
        from airpuck.errors import InputError

        raise InputError("give at least one MODEL and a RECORDING")
    *names, recording = models
    _compare(names, Path(recording), span, protocol, topics, json_file, quiet, single=False)


@app.command()
def check(
    recording: RecordingPath,
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    json_file: Json = None,
) -> None:
    """Check that motor order and signs of a vehicle file agree with a recording."""
    from airpuck.identification.layout_check import check_layout
    from airpuck.vehicle import default_vehicle

    craft = _vehicle(vehicle) or default_vehicle()
    result = check_layout(_load(recording, craft, topics), craft)
    _write_json(json_file, result.to_json())
    if not _is_stdout(json_file):
        for propeller in result.propellers:
            print(f"{propeller.name:16s} {propeller.agreement:6.3f}  {propeller.verdict}")
        print(f"the commands explain {100 * result.explained:.0f} % of the acceleration")
        for sentence in result.remarks:
            print(sentence)
    if not result.agrees:
        from airpuck.errors import InputError

        wrong = [p.name for p in result.propellers if p.verdict != "agrees"]
        about = ", ".join(wrong) if result.conclusive else "nothing can be said"
        raise InputError(f"does not agree with the vehicle {craft.name!r}: {about}", file=recording)


@app.command()
def reproduce(
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the public dataset.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path("out"),
    side_claims: Annotated[
        bool, typer.Option("--side-claims", help="Re-test the paper's side claims too (minutes).")
    ] = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the paper's tables and figures, published against ours."""
    from airpuck.report.reproduce import reproduce

    result = reproduce(data, out, side_claims=side_claims, progress=_say(quiet))
    _write_json(json_file, result.to_json())
    if not _is_stdout(json_file):
        print(out / "index.html")


@app.command()
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path("demo"),
    quiet: Quiet = False,
) -> None:
    """Walk the whole way on recordings that are simulated: no download, no hardware."""
    from airpuck.demo import demo

    print(demo(out, progress=_say(quiet)))


def _vehicle(path: Path | None) -> Vehicle | None:
    """Read the vehicle file, if one is given."""
    if path is None:
        return None
    from airpuck.vehicle import read_vehicle

    return read_vehicle(path)


def _load(
    recording: Path, vehicle: Vehicle | None, topics: Path | None, delay: float | None = None
) -> Trajectory:
    """Load and preprocess a recording."""
    from airpuck.preprocessing.load import load_trajectory
    from airpuck.recording.topics import read_topics

    names = None if topics is None else read_topics(topics)
    return load_trajectory(recording, vehicle, topics=names, delay=delay)


def _cut(trajectory: Trajectory, span: tuple[float, float] | None) -> Trajectory:
    """Keep the part that --span names."""
    return trajectory if span is None else trajectory.slice(*span)


def _choose(option: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuse a value that is not among the choices."""
    from airpuck.errors import InputError

    if value not in choices:
        raise InputError(f"{value!r} is none of {', '.join(choices)}", field=option)


def _compare(
    names: list[str],
    recording: Path,
    span: tuple[float, float] | None,
    protocol: str,
    topics: Path | None,
    json_file: Path | None,
    quiet: bool,
    *,
    single: bool,
) -> None:
    """Evaluate models on a recording and print a table."""
    from airpuck.evaluation.evaluate import PROTOCOLS, compare
    from airpuck.model_file import read_model

    _choose("--protocol", protocol, tuple(PROTOCOLS))
    models = [read_model(name) for name in names]
    trajectory = _cut(_load(recording, models[0].vehicle, topics), span)
    _warn(trajectory.warnings, quiet)
    evaluations = compare(models, trajectory, protocol=PROTOCOLS[protocol])
    figures = [
        {**evaluation.to_json(), "name": name}
        for name, evaluation in zip(names, evaluations, strict=True)
    ]
    _write_json(json_file, figures[0] if single else {"evaluations": figures})
    if not _is_stdout(json_file):
        _print_table(names, evaluations)


def _print_table(names: list[str], evaluations: list[Evaluation]) -> None:
    """Print errors of several models as a table."""
    from rich.console import Console
    from rich.table import Table

    first = evaluations[0]
    after = first.horizon_step * first.sample_period
    table = Table(
        title=f"Prediction error after {after:.3f} s, {first.errors.shape[2]} windows, "
        f"protocol {first.protocol.name}",
        title_justify="left",
    )
    for heading in ("model", "x mm", "y mm", "yaw rad", "median x", "median y", "median yaw"):
        table.add_column(
            heading, justify="left" if heading == "model" else "right", overflow="fold"
        )
    for name, evaluation in zip(names, evaluations, strict=True):
        row = [
            f"{factor * value:.{digits}f}"
            for values in (evaluation.rmse, evaluation.median_abs)
            for value, factor, digits in zip(values, (1e3, 1e3, 1), (2, 2, 4), strict=True)
        ]
        table.add_row(name, *row)
    # What is not a terminal has no width: let rows be as long as they are.
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def _progress(quiet: bool) -> Any:
    """Show an optimiser's iterations: one live line on a terminal, plain lines elsewhere."""
    from contextlib import contextmanager

    @contextmanager
    def shown() -> Any:
        if quiet:
            yield lambda _: None
        elif sys.stderr.isatty():
            from rich.console import Console

            with Console(stderr=True).status("compiling …") as status:
                yield lambda iteration: status.update(_line(iteration))
        else:
            yield lambda iteration: print(_line(iteration), file=sys.stderr)

    return shown()


def _line(iteration: Iteration) -> str:
    """Describe one iteration."""
    held_out = iteration.test_loss
    tail = "" if held_out is None else f", held out {held_out:.4e}"
    return f"iteration {iteration.number}: loss {iteration.loss:.4e}{tail}"


def _say(quiet: bool) -> Any:
    """Return a function that prints what is being done."""
    return (lambda _: None) if quiet else (lambda text: print(text, file=sys.stderr, flush=True))


def _warn(warnings: Any, quiet: bool = False) -> None:
    """Print warnings on standard error."""
    if not quiet:
        for warning in warnings:
            print(f"warning: {warning}", file=sys.stderr)


def _is_stdout(json_file: Path | None) -> bool:
    """Say whether JSON goes to standard output, where nothing else may then be printed."""
    return json_file is not None and str(json_file) == "-"


def _write_json(json_file: Path | None, figures: Any) -> None:
    """Write figures where --json says."""
    if json_file is None:
        return
    text = json.dumps(figures, indent=2) + "\n"
    if _is_stdout(json_file):
        sys.stdout.write(text)
        return
    from airpuck.files import replacing

    with replacing(json_file) as temporary:
        temporary.write_text(text, encoding="utf-8")
