"""The kinds of export, by name, and the function that exports a model."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import added, named
from airpuck.boundary.outputs import check_output, temporary_name, unwritable
from airpuck.boundary.results import Result

if TYPE_CHECKING:  # the help of the command line lists the kinds
    from airpuck.control.tuning import Tuning
    from airpuck.model.model_file import Model
    from airpuck.physics.effects import Effect
    from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics
    from airpuck.planning.plan import Plan
    from airpuck.twin.settings import TwinSettings


@dataclass(frozen=True, eq=False)
class Subject:
    """What is exported: a model, the tuning of its controller, and the table it moves on.

    Attributes
    ----------
    model : Model
        The craft.
    tuning : Tuning
        The controller's tuning.
    twin : TwinSettings
        Table, sensors and radio of the simulation.
    plan : Plan or None
        The flight that the controller tracks.
    """

    model: Model
    tuning: Tuning
    twin: TwinSettings
    plan: Plan | None = None


@dataclass(frozen=True)
class ExportKind:
    """A kind of export.

    Attributes
    ----------
    summary : str
        A short description.
    module : str
        Module whose ``write(subject, folder)`` writes the files and returns facts for the user, by
        name.
    uses : tuple of str
        Inputs besides the model: ``tuning``, ``law``, ``twin``, ``plan``.
    """

    summary: str
    module: str
    uses: tuple[str, ...] = ()


#: A new kind is a module with `write`, and an entry here or an entry point (`airpuck.exports`).
KINDS: dict[str, ExportKind] = {
    "c": ExportKind("the controller as C99", "airpuck.export.c", ("tuning", "law", "plan")),
    "casadi": ExportKind("the dynamics as casadi.Functions", "airpuck.export.casadi"),
    "fmu": ExportKind(
        "the craft on its table as an FMU (FMI 3.0)", "airpuck.export.fmu", ("twin",)
    ),
    "gym": ExportKind("Gymnasium environments", "airpuck.export.gym", ("twin",)),
    "holohover": ExportKind("the files of the paper's authors", "airpuck.export.holohover"),
    "matlab": ExportKind("function files for MATLAB and Octave", "airpuck.export.matlab"),
    "mjcf": ExportKind("the craft on its table for MuJoCo", "airpuck.export.mjcf", ("twin",)),
}


def known_kinds() -> list[str]:
    """Return the names of all kinds; kinds from other distributions come last."""
    return [*KINDS, *(name for name in added("airpuck.exports") if name not in KINDS)]


def kind_named(name: str) -> ExportKind:
    """Return a kind of export, which another distribution may add."""
    return named(name, KINDS, "airpuck.exports", field="kind")


@dataclass(frozen=True)
class Written(Result):
    """The result of an export.

    Attributes
    ----------
    kind : str
        Name of the kind.
    folder : Path
        Where the files are.
    files : tuple of str
        Names of the files.
    facts : dict of str to object
        What the user should know: sizes, names, limits.
    """

    JSON: ClassVar[str] = "kind folder files facts"

    kind: str
    folder: Path
    files: tuple[str, ...]
    facts: dict[str, Any]


def write(
    model: Model,
    kind: str,
    folder: str | os.PathLike[str],
    *,
    tuning: Tuning | None = None,
    twin: TwinSettings | None = None,
    plan: Plan | None = None,
    inputs: Sequence[str | os.PathLike[str]] = (),
) -> Written:
    """Export a model.

    Files of the same names in the folder are replaced; nothing is written if the export fails.

    Parameters
    ----------
    model : Model
        The craft.
    kind : str
        One of `known_kinds`.
    folder : path-like
        Folder for the files; created if necessary.
    tuning : Tuning, optional
        The controller's tuning, for kinds with a controller; by default the one for the model.
    twin : TwinSettings, optional
        Table, sensors and radio, for kinds with a simulation; by default the paper's.
    plan : Plan, optional
        A flight to track, for kinds with a controller.
    inputs : sequence of path-like, optional
        Files that the export must not replace.

    Returns
    -------
    Written
        Names of the files, and facts about them.

    Raises
    ------
    InputError
        If the kind is unknown, does not use an input that is given, or cannot represent the model.
    """
    from airpuck.control.tuning import tuning_for
    from airpuck.twin.settings import default_twin_settings

    check_given(kind, tuning=tuning, twin=twin, plan=plan)
    target = Path(folder)
    check_output(target, "folder")
    settings = tuning or tuning_for(model), twin or default_twin_settings()
    subject = Subject(model, *settings, plan)
    # Files can only be moved within one file system, and an existing folder may be the root of one.
    near = target.absolute() if target.is_dir() else target.absolute().parent
    temporary = near / temporary_name(target)
    try:
        temporary.mkdir(parents=True)
        facts = import_module(kind_named(kind).module).write(subject, temporary)
        names = sorted(p.relative_to(temporary) for p in temporary.rglob("*") if p.is_file())
        kept = {Path(one).resolve() for one in inputs}
        for name in names:
            if (target / name).resolve() in kept:
                raise InputError("is also an input; choose another folder", file=target / name)
            if (target / name).is_dir():
                raise InputError(
                    "is a folder; choose another folder for the files", file=target / name
                )
        for name in names:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            (temporary / name).replace(target / name)
    except OSError as error:
        raise unwritable(target, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return Written(kind, target, tuple(map(str, names)), facts)


def check_given(kind: str, **given: Any) -> None:
    """Raise InputError for an unknown kind of export, or for settings that it does not use."""
    uses = kind_named(kind).uses
    for name, value in given.items():
        if value is not None and name not in uses:
            raise InputError(f"is not part of an export to {kind}; leave it out", field=name)


def refuse_settings(twin: TwinSettings, kind: str, fields: Sequence[str]) -> None:
    """Raise InputError for settings of the twin that an export cannot represent."""
    from airpuck.twin.settings import default_twin_settings

    usual = default_twin_settings()
    for field in fields:
        if attrgetter(field)(twin) != attrgetter(field)(usual):
            raise InputError(
                f"is set, which an export to {kind} cannot represent; leave it out", field=field
            )


def refuse_effects(model: Model | Dynamics, kind: str, held: Sequence[type[Effect]] = ()) -> None:
    """Raise InputError for an effect of the model that an export cannot represent."""
    dynamics: Any = getattr(model, "dynamics", model)
    for effect in dynamics.effects:
        if not isinstance(effect, tuple(held)):
            remedy = "; identify the model without it, or choose another kind"
            cannot(f"the effect {type(effect).__name__}", kind, remedy)


def refuse_actuators(model: Model, kind: str, held: Sequence[str] = ()) -> None:
    """Raise InputError for actuators, apart from propellers, that an export cannot represent."""
    for name in model.vehicle.actuation.kinds:
        if name not in ("propeller", *held):
            cannot(f"actuators of the kind {name}", kind)


def refuse_frame(model: Model, kind: str, frame: CenterOfMassFrame) -> None:
    """Raise InputError if the centre of mass is not fixed to this frame."""
    if model.frame != frame and any(model.parameters.center_of_mass):
        remedy = f"; identify it with --com-frame {frame}"
        cannot(f"a centre of mass that is fixed to the {model.frame}", kind, remedy)


def command_range(model: Model) -> list[tuple[float, float]]:
    """Return the lowest and the highest command of each motor."""
    idle, most = model.vehicle.idle, model.vehicle.command_max
    return [(float(idle[one.column]), most) for one in model.vehicle.actuation.channels]


def cannot(what: str, target: str, remedy: str = "") -> NoReturn:
    """Raise InputError for what a model has and an export cannot represent."""
    problem = f"has {what}, which an export to {target} cannot represent{remedy}"
    raise InputError(problem, field="MODEL")


def printable(text: str) -> str:
    """Return text without characters that end a line, a quoted string or a comment."""
    return "".join(filter(str.isprintable, text)).replace("'", "_").replace("--", "__")
