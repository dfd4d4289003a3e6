"""Options and arguments that several commands share, and what is read for them."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Argument, Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.outputs import Output, check_output
from airpuck.boundary.settings import Setting
from airpuck.cli.output import is_stdout, warn
from airpuck.cli.views import FromFile
from airpuck.control.laws import LAWS
from airpuck.control.settings import ExcitationPlan, read_excitation_plan
from airpuck.control.settings import Seed as Seed
from airpuck.control.settings import Workers as Workers

if TYPE_CHECKING:
    from airpuck.control.tuning import Tuning
    from airpuck.craft.table import AirHockey
    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.model.model_file import Model
    from airpuck.recording.mapping import RecordingMapping
    from airpuck.recording.stream import Recording
    from airpuck.twin.settings import TwinSettings


#: Key in a command's context: its outputs, and the option of each.
_OUTPUTS = "airpuck.outputs"
#: Number of characters shown of a name that is too long.
_SHOWN = 40


def check_written(context: Any, option: str, path: Path, kind: Output) -> None:
    """Reject an output that cannot be written, or that another option uses, before any work."""
    taken: dict[Path, str] = context.meta.setdefault(_OUTPUTS, {})
    whole = Path(os.path.realpath(path))  # a link to itself is refused below
    if whole in taken:
        raise InputError(f"is also the output of {taken[whole]}", file=path, field=option)
    check_output(path, kind, field=option)
    taken[whole] = option


def check_inputs(context: Any) -> None:
    """Reject invalid names, and outputs that are also options."""
    outputs: dict[Path, str] = context.meta.get(_OUTPUTS, {})
    for parameter in context.command.params:
        written = parameter.opts[0] in outputs.values()
        for name in () if written else _texts(context.params.get(parameter.name)):
            try:
                found = os.stat(name)  # noqa: PTH116
            except OSError as error:
                if error.errno == errno.ENOENT and _is_recording(parameter):
                    raise InputError("there is no such file or folder", file=name) from None
                if error.errno == errno.ENAMETOOLONG:
                    shown = f"{str(name)[:_SHOWN]}…"
                    problem = "is a longer name than the system allows"
                    raise InputError(problem, file=shown, field=parameter.opts[0]) from None
                continue
            for output, option in outputs.items():
                if output.exists() and os.path.samestat(output.stat(), found):
                    raise InputError(
                        "is also an input; choose another name", file=name, field=option
                    )


def _is_recording(parameter: Any) -> bool:
    """Return whether an argument names recordings, whose readers take long to import."""
    return parameter.param_type_name == "argument" and str(parameter.metavar).startswith(
        "RECORDING"
    )


def refuse_empty(arguments: list[str]) -> None:
    """Reject an empty name; it would mean the current folder."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        option, _, value = argument.partition("=")
        if not argument:
            field = before if before.startswith("-") else None
            raise InputError("an argument is empty; type a name", field=field)
        if option.startswith("--") and argument.endswith("=") and not value:
            raise InputError("is empty; type a name", field=option)


def _texts(value: Any) -> Iterator[str | Path]:
    """Yield the texts and paths of a parameter."""
    for one in value if isinstance(value, (list, tuple)) else (value,):
        if isinstance(one, (str, Path)):
            yield one


#: Description of an output, by its placeholder in the help.
_KINDS: dict[str, Output] = {"FILE": "file", "DIR": "folder", "BAG": "new folder"}


def output(
    metavar: Literal["FILE", "DIR", "BAG"],
    help: str,
    *names: str,
    endings: tuple[str, ...] = (),
    replaces: str = "",
) -> Any:
    """Return an option for a file or folder to write; by default -o, with any ending.

    Of existing files, it may replace only those with one ending.
    """

    def check(context, parameter, path):  # without annotations as in `views.option`
        if path is None or context.resilient_parsing:
            return path
        option = parameter.opts[0]
        if not is_stdout(path):
            check_written(context, option, path, _KINDS[metavar])
            if replaces and path.suffix != replaces and path.is_file():
                problem = f"exists and does not end in {replaces}; choose another name"
                raise InputError(problem, file=path, field=option)
        if endings and path.suffix not in endings:
            raise InputError(f"must end in {' or '.join(endings)}", file=path, field=option)
        return path

    return Option(*(names or ("-o", "--output")), metavar=metavar, help=help, callback=check)


def figure(what: str) -> Any:
    """Return the option for a figure to write."""
    help = f"Figure of {what} to write: PNG, PDF or SVG."
    return output("FILE", help, "--figure", endings=FIGURES)


#: Endings of figures.
FIGURES = (".png", ".pdf", ".svg")


def _file(option: str, help: str, reader: str = "") -> Setting:
    """Return a setting for a file, or for what a function of airpuck reads from it."""
    read = (lambda path: getattr(airpuck, reader)(path)) if reader else None
    return Setting(help, metavar="FILE", option=option, read=read)


Json = Annotated[
    Path | None,
    output("FILE", "Write the results as JSON; - for standard output.", "--json", replaces=".json"),
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print only the results.")]
Verbose = Annotated[
    bool, Option("--verbose", "-v", help="Print more: conditioning, correlations, constraints.")
]
ReadVehicle = Annotated[
    "Vehicle | None",
    _file("--vehicle", "Vehicle file; by default the paper's craft.", "read_vehicle"),
]
ReadMapping = Annotated[
    "RecordingMapping | None",
    _file(
        "--mapping/--topics",
        "TOML file: topics, files, columns, units and axes of a recording.",
        "read_mapping",
    ),
]
_TWIN = "Settings of the twin: table, sensors, radio, faults; by default the paper's."
ReadTwin = Annotated["TwinSettings | None", _file("--twin", _TWIN, "read_twin_settings")]
TwinFile = Annotated[Path | None, _file("--twin", _TWIN)]
ReadTable = Annotated[
    "AirHockey | None",
    _file("--table", "Table file: size, goals, puck; by default the usual ones.", "read_table"),
]
RecordingPart = Annotated[
    tuple[float, float] | None,
    Setting("Part of the recording to use, as fractions of its length.", numbers.SHARE, "A B"),
]
TuningFile = Annotated[
    Path | None,
    _file("--tuning", "Controller tuning; by default the packaged one, adapted to the model."),
]
PageFolder = Annotated[Path | None, output("DIR", "Also write a page with figures.")]
NewBag = Annotated[Path, output("BAG", "New folder to record to.")]
RecordingPath = Annotated[
    Path,
    Argument(
        metavar="RECORDING",
        help="A bag folder, .mcap, folder of CSV files, data.pt, or preprocessed .npz.",
    ),
]
ControllersModel = Annotated[str, Setting("Model for the controller.", metavar="MODEL")]
BELIEVED = Setting("Model of the craft.", metavar="MODEL")
Truth = Annotated[str, Setting("True model, which the twin flies.", metavar="MODEL")]


def _model_named(meaning: str) -> Any:
    forms = "a model.toml, the authors' params.json or YAML, or paper:M0 … M4"
    return Argument(metavar="MODEL", help=f"{meaning}: {forms}.")


ModelName = Annotated[str, _model_named("Model of the craft")]
RacingModel = Annotated[str, _model_named("Model for the controller and the plan")]
TwinModel = Annotated[str, _model_named("True model of the simulated craft")]
Experiment = Annotated[
    ExcitationPlan,
    FromFile("--plan", "Plan by `airpuck design`; options override it.", read_excitation_plan),
]


def _law(help: str) -> Setting:
    return Setting(help, metavar="LAW", option="--law", complete=lambda: list(LAWS))


LAWS_THERE_ARE = f"Control law: {', '.join(LAWS)}, or FILE.py:NAME of your own law"
#: The state estimator of a controller.
Estimator = Annotated[
    Literal["kalman", "actuation", "learning"] | None,
    Setting(
        "kalman; actuation, which also estimates what each motor does; or learning, which "
        "remembers it, and learns delay, drag and slope; by default the tuning's."
    ),
]
LawName = Annotated[str | None, _law(f"{LAWS_THERE_ARE}; by default the tuning's.")]
JudgedLaw = Annotated[
    str | None,
    _law("Law to fly in simulation besides the usual LQR: mpc (takes seconds), or FILE.py:NAME."),
]
ProtocolOption = Annotated[
    Literal["paper", "paper-long", "causal"],
    Setting("paper; paper-long (encoders may look further back); causal (no later measurements)."),
]
Horizon = Annotated[float, Setting("Horizon at which errors are reported.", numbers.HORIZON, "S")]
EncoderName = Annotated[
    str, Setting("paper, or actuation, which also estimates the effectiveness of each motor.")
]


def read_recording(path: Path, mapping: RecordingMapping | None, **needs: Any) -> Recording:
    """Read a recording, and print its warnings."""
    recording = airpuck.read_recording(path, mapping=mapping, **needs)
    warn(recording.warnings)
    return recording


def load(
    recording: Path,
    vehicle: Vehicle | None,
    mapping: RecordingMapping | None,
    *,
    span: tuple[float, float] | None = None,
    delay: float | None = None,
) -> Trajectory:
    """Load and preprocess a recording, or the part named by --span, and print warnings."""
    trajectory = airpuck.load_trajectory(recording, vehicle, mapping=mapping, delay=delay)
    warn(trajectory.warnings)
    return trajectory if span is None else trajectory.slice(*span)


def read_belief(name: str) -> Model:
    """Read a model for the controller, which inverts its thrust curves."""
    from airpuck.physics.thrust import InverseThrust

    model = airpuck.read_model(name)
    with about(name, "parameters.thrust_N"):
        InverseThrust(model.dynamics.thrust)
    return model


def read_given(
    model: str | None, vehicle: Vehicle | None, read: Callable[[str], Model] = read_belief
) -> Model | None:
    """Read a model if one is given; raise InputError if a vehicle is given, too."""
    if model is None:
        return None
    if vehicle is not None:
        raise InputError(
            "a model includes its vehicle; pass only one of the two", field="--vehicle"
        )
    return read(model)


def model_or_nominal(
    model: str | None, vehicle: Vehicle | None, read: Callable[[str], Model] = read_belief
) -> Model:
    """Read a model, or make the nominal one of a vehicle, by default the paper's."""
    from airpuck.model.model_file import nominal_model

    return read_given(model, vehicle, read) or nominal_model(vehicle or airpuck.default_vehicle())


def read_controls(path: Path | None, kind: str | None = None, *models: Model) -> Tuning:
    """Read a tuning file, by default the one for the craft, and check its weights.

    `kind` overrides the tuning's law; it must suit the models.
    """
    from airpuck.control.lqr import LQRSettings, lqr_gain
    from airpuck.control.tuning import default_tuning, tuning_for

    usual = tuning_for(models[0]) if models else default_tuning()
    tuning = usual if path is None else airpuck.read_tuning(path, *models[:1])
    if models and models[0].fit and models[0].cameras is None:
        words = "does not state the noise of its recordings; the controller assumes the packaged "
        warn([f"the model {models[0].name} {words}noise: identify it again"])
    tuning = tuning if kind is None else tuning.with_law(kind)
    with about(path):
        lqr_gain(tuning.of(LQRSettings).weights, tuning.period_s)
    check_law(path, tuning, *models)
    return tuning


def check_law(path: Path | None, tuning: Tuning, *models: Model) -> None:
    """Raise InputError if the law of a tuning file, or the user's own law, does not suit."""
    from airpuck.control.law import LawOptions, law_named

    make = law_named(tuning.law.kind)
    if not getattr(make, "looks_ahead", True):
        return
    with about(path):
        for model in models:
            make(model, tuning, LawOptions(compiled=False))


def published_flights(models: Sequence[str]) -> list[Path | None]:
    """Find the paper's flights with these models in $AIRPUCK_DATA; warn about missing ones."""
    from airpuck.recording.dataset import VARIABLE

    folder = os.environ.get(VARIABLE)
    flights: list[Path | None] = []
    for model in models:
        path = Path(folder or "") / "control_experiment" / f"data_{model.removeprefix('paper:')}"
        published = model.startswith("paper:") and bool(folder) and path.is_dir()
        flights.append(path if published else None)
    found = zip(models, flights, strict=True)
    missing = [m for m, flight in found if flight is None and m in ("paper:M0", "paper:M4")]
    if missing:
        reason = f"{folder} has no control_experiment" if folder else f"${VARIABLE} is not set"
        hint = f"set {VARIABLE} to the dataset (airpuck fetch downloads it and prints its folder)"
        warn([f"the real flight with {' and '.join(missing)} is missing: {reason}; {hint}"])
    return flights
