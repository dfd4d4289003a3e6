"""Options and arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option
from typer.core import TyperOption

from airpuck.boundary import numbers
from airpuck.boundary.numbers import Range
from airpuck.boundary.outputs import Output
from airpuck.boundary.settings import Setting
from airpuck.cli.names import check_written
from airpuck.cli.output import is_stdout
from airpuck.cli.views import FromFile
from airpuck.control.excitation_plan import ExcitationPlan, read_excitation_plan
from airpuck.control.laws import LAWS

#: Description of an output, by its placeholder in the help.
_KINDS: dict[str, Output] = {"FILE": "file", "DIR": "folder", "BAG": "new folder"}


def output(metavar: Literal["FILE", "DIR", "BAG"], help: str, *names: str) -> Any:
    """Return an option for a file or folder to write; by default -o."""

    def check(context: Any, parameter: TyperOption, path: Path | None) -> Path | None:
        if path is not None and not is_stdout(path) and not context.resilient_parsing:
            check_written(context, parameter.opts[0], path, _KINDS[metavar])
        return path

    return Option(*(names or ("-o", "--output")), metavar=metavar, help=help, callback=check)


def number(metavar: str, help: str, limits: Range, *names: str) -> Any:
    """Return an option for one or several numbers, within limits that the help names."""

    def check(context: Any, parameter: TyperOption, value: Any) -> Any:
        for one in value if isinstance(value, (tuple, list)) else (value,):
            if one is not None and not context.resilient_parsing:
                limits.check(one, parameter.opts[0])
        return value

    words = f"{help.removesuffix('.')} ({limits})."
    return Option(*names, metavar=metavar, help=words, callback=check)


Json = Annotated[
    Path | None, output("FILE", "Write the figures as JSON; - for standard output.", "--json")
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print results only.")]
Verbose = Annotated[
    bool, Option("--verbose", "-v", help="Print more: conditioning, correlations, constraints.")
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
    number("A B", "Part to use, as fractions of the length.", numbers.SHARE, "--span"),
]
TuningFile = Annotated[
    Path | None,
    Option("--tuning", metavar="FILE", help="Controller tuning; by default the packaged one."),
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
CONTROLLERS_MODEL = Option("--model", metavar="MODEL", help="Model for the controller.")
BELIEVED_MODEL = Option("--model", metavar="MODEL", help="Model of the craft.")
ModelName = Annotated[
    str, Argument(metavar="MODEL", help="A model.toml, the authors' params.json, or paper:M0 … M4.")
]
TwinFile = Annotated[
    Path | None,
    Option(
        "--twin",
        metavar="FILE",
        help="Table, sensors, radio, faults; by default the packaged ones.",
    ),
]
TableFile = Annotated[
    Path | None,
    Option(
        "--table",
        metavar="FILE",
        help="Table file: dimensions, goals, puck; by default the usual ones.",
    ),
]
SetPointsFile = Annotated[
    Path | None,
    Option("--setpoints", metavar="FILE", help="Set points and their times, as TOML."),
]
Experiment = Annotated[
    ExcitationPlan,
    FromFile(
        "--plan", "An excitation by `airpuck design`; options change it.", read_excitation_plan
    ),
]
PilotClass = Annotated[
    str | None,
    Option(
        "--pilot",
        metavar="FILE.py:NAME",
        help="Your own controller: a class with the arguments (model, reference).",
    ),
]
LAWS_THERE_ARE = f"Control law: {', '.join(LAWS)}, or FILE.py:NAME"
RegulatorName = Annotated[
    str | None,
    Option("--regulator", metavar="LAW", help=f"{LAWS_THERE_ARE}; by default the tuning's."),
]
Seed = Annotated[int, number("N", "Seed of all random numbers.", numbers.SEED)]
ProtocolName = Annotated[
    Literal["paper", "paper-long", "causal"],
    Option(
        "--protocol",
        help="paper; paper-long: encoders may look further back; causal: no later measurements.",
    ),
]
Horizon = Annotated[
    float, number("S", "Prediction horizon at which errors are reported.", numbers.HORIZON)
]
EncoderName = Annotated[
    str, Setting("paper; actuation: also estimates the effectiveness of each motor.")
]
