"""Options and arguments that several commands share."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option
from typer.core import TyperOption

from airpuck.boundary.errors import InputError
from airpuck.cli.output import is_stdout


def writable(context: Any, parameter: TyperOption, path: Path | None) -> Path | None:
    """Refuse a place that cannot be written to, or is another option's, before the work is done."""
    if path is None or is_stdout(path):
        return path
    taken: dict[Path, str] = context.meta.setdefault("airpuck.written", {})
    option, whole = parameter.opts[0], path.absolute()
    if whole in taken:
        raise InputError(f"is the place of {taken[whole]}, too", file=path, field=option)
    taken[whole] = option
    existing = next(folder for folder in (whole, *whole.parents) if folder.exists())
    if existing == whole and existing.is_file():
        existing = whole.parent
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        problem = f"cannot be written ({error.strerror}); choose another place"
        raise InputError(problem, file=path, field=option) from None
    return path


def output(metavar: str, help: str, *names: str) -> Any:
    """Return an option for a file or folder to write; by default -o."""
    names = names or ("-o", "--output")
    return Option(*names, metavar=metavar, help=help, callback=writable)


Json = Annotated[
    Path | None, output("FILE", "Write the figures as JSON; - for standard output.", "--json")
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Say nothing but results.")]
Verbose = Annotated[
    bool, Option("--verbose", "-v", help="Say more: conditioning, correlations, constraints.")
]
VehicleFile = Annotated[
    Path | None,
    Option("--vehicle", metavar="FILE", help="Vehicle file; by default the paper's craft."),
]
MappingFile = Annotated[
    Path | None,
    Option(
        "--mapping",
        "--topics",
        metavar="FILE",
        help="TOML file: topics, files, columns, units and axes of a recording.",
    ),
]
Span = Annotated[
    tuple[float, float] | None,
    Option("--span", metavar="A B", help="Part to use, as fractions of the length."),
]
TuningFile = Annotated[
    Path | None,
    Option("--tuning", metavar="FILE", help="Controller tuning; by default the packaged."),
]
PageFolder = Annotated[Path | None, output("DIR", "Write a page of figures, too.")]
NewBag = Annotated[Path, output("BAG", "Folder to record to; new.")]
RecordingPath = Annotated[
    Path,
    Argument(
        metavar="RECORDING",
        help="A bag folder, .mcap, folder of CSV files, data.pt, or preprocessed .npz.",
    ),
]
CONTROLLERS_MODEL = Option(
    "--model", metavar="MODEL", help="What the controller believes the craft to be."
)
BELIEVED_MODEL = Option("--model", metavar="MODEL", help="What the craft is believed to be.")
ModelName = Annotated[
    str, Argument(metavar="MODEL", help="A model.toml, the authors' params.json, or paper:M0 … M4.")
]
TwinFile = Annotated[
    Path | None,
    Option(
        "--twin", metavar="FILE", help="Table, sensors, radio, faults; by default the packaged."
    ),
]
SetPointsFile = Annotated[
    Path | None,
    Option("--setpoints", metavar="FILE", help="Set points and their times, as TOML."),
]
PlanFile = Annotated[
    Path | None,
    Option("--plan", metavar="FILE", help="Amplitude, hold, length and margin, by airpuck design."),
]
Amplitude = Annotated[float | None, Option(help="Largest random signal, by default 1.")]
Hold = Annotated[
    float | None, Option(metavar="S", help=r"Time between its changes \[s], by default 0.2.")
]
PilotClass = Annotated[
    str | None,
    Option(
        "--pilot",
        metavar="FILE.py:NAME",
        help="A controller of your own: a class that is made from (model, reference).",
    ),
]
Seed = Annotated[int, Option(metavar="N", help="Seed of everything random.", min=0)]
ProtocolName = Annotated[
    Literal["paper", "paper-long", "causal"],
    Option(
        "--protocol",
        help="paper; paper-long: encoders may look further back; causal: nothing measured later.",
    ),
]
Horizon = Annotated[
    float, Option(metavar="S", help="After how long errors are reported.", min=0.001, max=10)
]
EncoderName = Annotated[
    Literal["paper", "actuation"],
    Option("--encoder", help="paper; actuation: estimates what each motor really does, too."),
]
