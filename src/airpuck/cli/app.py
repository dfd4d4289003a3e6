"""The application: exit statuses for errors and signals, and shared options."""

from __future__ import annotations

import contextlib
import errno
import functools
import inspect
import os
import re
import shlex
import signal
import sys
import termios
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.exceptions import TyperException
from typer.main import get_command

from airpuck.boundary.errors import InputError, escaped, explained, unknown
from airpuck.boundary.extensions import HOCKEY, added, loaded
from airpuck.boundary.signals import SIGNALLED, Stopped, forget_stopped, stoppable, stopped_by
from airpuck.cli.options import Json, Quiet, check_inputs, refuse_empty
from airpuck.cli.views import ALL_OPTIONS, OptionView, viewed
from airpuck.compute.process import keep_compiled_programs, single_threaded_algebra

#: Errors of the system that a user can fix; all others are bugs in this package.
_SYSTEM_REFUSES = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EFBIG", "EIO", "EMFILE", "ENAMETOOLONG", "ENOSPC", "EROFS")
}


def _import_rich() -> None:
    """Import what prints help, without modules that ours does not use: a third of its time."""
    unused = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}
    missing = unused.keys() - sys.modules.keys()
    for name in missing:
        sys.modules[name] = SimpleNamespace(**{unused[name]: None})  # pyright: ignore
    try:
        import_module("typer.rich_utils")
    finally:
        for name in missing:
            del sys.modules[name]


class _PlainHelp:
    """Hides the type of a flag in the help: a flag takes no value."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        _import_rich()
        super().format_help(ctx, formatter)  # pyright: ignore[reportAttributeAccessIssue]

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters."""
        parameters = super().get_params(ctx)  # pyright: ignore[reportAttributeAccessIssue]
        for parameter in parameters:
            if isinstance(parameter, TyperOption) and parameter.is_flag:
                parameter.metavar = ""
        return parameters


class Command(_PlainHelp, TyperCommand):
    """A command that checks file names before it starts."""

    #: The parser's own message about them names no option.
    allow_extra_args = True

    def __init__(self, *args: Any, params: Any, callback: Any, **options: Any) -> None:
        #: Options that are views of settings, by parameter.
        self.declared: dict[str, OptionView] = callback.declared
        for parameter in params:
            view = self.declared.get(parameter.name)
            if view and view.row:  # Typer does not know options of several numbers that repeat
                parameter.nargs = view.row
                parameter.type_descriptor = replace(parameter.type_descriptor, annotation=view.kind)
        super().__init__(*args, params=params, callback=callback, **options)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and reject file names that must be mistakes."""
        refuse_empty(args)
        _refuse_model_option(ctx.command_path, self.params, args)
        try:
            rest = super().parse_args(ctx, args)
        except TyperException as error:
            raise _rejected(error) from error
        if not ctx.resilient_parsing:
            if rest:
                raise _unexpected(rest, ctx.command_path, self.params)
            check_inputs(ctx)
        return rest

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help; rare options on request only."""
        for parameter in self.params:
            view = self.declared.get(parameter.name or "")
            if view and isinstance(parameter, TyperOption):
                parameter.hidden = view.rare and ALL_OPTIONS not in ctx.meta
        super().format_help(ctx, formatter)


#: Former options of all commands or of one, with their replacement.
_FORMER = {
    "--adam": "use airpuck.identify(method=...), as in studies/adam.py",
    "--regulator": "use --law",
    "excite --model": "use --truth",
    "design --check": "studies/next_flight.py tests its forecasts",
    "record --mapping": "leave it out: every topic is recorded",
    "record --topics": "leave it out: every topic is recorded",
    "league --bags": "use python studies/ratings.py league.json --bags DIR",
}


#: Former commands, and the option of `fly` that replaces each.
_FLIGHTS = {"fly-setpoints": "--setpoints FILE", "fly-topic": "--follow", "fly-plan": "--plan FILE"}


def _refuse_model_option(command: str, parameters: Sequence[Any], args: Sequence[str]) -> None:
    """Raise InputError if a model, which is the first argument, is given as an option."""
    first = [one.metavar == "MODEL" and not isinstance(one, TyperOption) for one in parameters]
    words = [part for word in args for part in re.split("(?<=^--model)=", word)]
    options = [k for k, word in enumerate(words[:-1]) if word == "--model"]
    if not any(first) or not options:
        return
    models = [words[k + 1] for k in options]
    others = [word for k, word in enumerate(words) if not {k, k - 1} & {*options}]
    line = shlex.join([*command.split(), *models, *others])
    raise InputError(f"the model is the first argument now: {line}", field="--model")


def _rejected(error: Any) -> Exception:
    """Return what is wrong with an option or its value, in one sentence, with the nearest name."""
    if hasattr(error, "possibilities"):
        near = f"; did you mean {error.possibilities[0]}?" if error.possibilities else ""
        option = error.option_name
        former = _FORMER.get(f"{error.ctx.info_name} {option}") or _FORMER.get(option)
        return InputError(f"no such option{f'; {former}' if former else near}", field=option)
    if not hasattr(error.__cause__, "errors"):  # not pydantic's
        return error
    (first, *_), choices = error.__cause__.errors(), error.param.type_descriptor.choices
    if choices:
        problem = unknown(first["input"], choices)
    else:
        words = first["msg"].partition(",")[0].replace("Input should be", "must be")
        problem = f"{words}, not {first['input']!r}"
    return InputError(problem, field=error.param.opts[0])


def _unexpected(words: Sequence[str], command: str, parameters: Sequence[Any]) -> InputError:
    """Return an error that names an argument without an option, and the option that it needs."""

    def choices(parameter: Any) -> Sequence[str]:
        return getattr(parameter.type_descriptor, "choices", None) or ()

    options = [each for each in parameters if words[0] in choices(each)] or [
        each for each in parameters if each.metavar == "PLAYER" and isinstance(each, TyperOption)
    ]
    use = " ".join(f"{each.opts[0]} {word}" for each, word in zip(options, words, strict=False))
    problem = "unexpected argument" + (f"; use {use}" if use else "")
    return InputError(f"{problem} (see {command} --help)", field=words[0])


#: Commands by module, in the order of the help. A module is imported for its own commands only.
_MODULES = (
    ("identification", ("preprocess", "identify")),
    ("validation", ("evaluate", "check", "faults", "present", "compare", "resid", "vehicle")),
    ("live", ("commission",)),
    ("flying", ("replay", "excite", "track", "tune", "animate", "fleet")),
    ("planning", ("design", "plan", "race")),
    ("flying", ("export",)),
    ("live", ("twin", "fly", "fly-fleet", "twin-fleet", "fly-excitation", "record")),
    ("live", ("preflight", "preflight-recording", "watch", "view")),
    ("study", ("campaign", "fetch", "reproduce", "demo")),
)
_OWN = {name: module for module, names in _MODULES for name in names}


class _Group(_PlainHelp, TyperGroup):
    """All commands; a signal ends them with one line. Each is imported and built when needed."""

    #: Whether only names and descriptions are needed.
    lists = False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; other distributions may add it."""
        if cmd_name in self.commands:
            return self.commands[cmd_name]
        make = partial(_listed if self.lists else _built, cmd_name)
        if cmd_name in _FLIGHTS:
            raise InputError(f"{cmd_name} is now airpuck fly MODEL {_FLIGHTS[cmd_name]}")
        if cmd_name in _OWN:
            module = import_module(f"airpuck.cli.{_OWN[cmd_name]}")
            made = make(getattr(module, cmd_name.replace("-", "_")))
        elif cmd_name in (*added("airpuck.commands"), *HOCKEY["airpuck.commands"]):
            made = loaded("airpuck.commands", cmd_name, make)
        else:
            known_commands()  # for the nearest name
            return None
        if not self.lists:
            self.commands[cmd_name] = made
        return made

    def list_commands(self, ctx: Any) -> list[str]:
        """List all commands; a broken entry point gets one line."""
        names = [*_OWN]
        for name in sorted(added("airpuck.commands").keys() - _OWN.keys()):
            try:
                self.get_command(ctx, name)
            except InputError as error:
                _say(str(error))
            else:
                names.append(name)
        return names

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print names and descriptions of all commands."""
        self.lists = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self.lists = False

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except Stopped as stopped:  # Typer would print nothing
            raise typer.Exit(_say_stopped(stopped)) from None


app = typer.Typer(
    name="airpuck",
    cls=_Group,
    help="Identify, simulate and control propeller-driven hovercraft.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def command(panel: str, rare: Sequence[str] = (), *, figures: bool = True) -> Callable[..., Any]:
    """Return a decorator for the function of a command: its place in the help.

    The help shows `rare` options on request only. Every command has --quiet, and --json if it
    reports `figures`: what it prints by `airpuck.cli.output` obeys both.
    """
    shared = {"json_file": Json, "quiet": Quiet} if figures else {"quiet": Quiet}

    def mark(function: Callable[..., Any]) -> Callable[..., Any]:
        function.shown = panel, rare, shared  # pyright: ignore[reportFunctionMemberAccess]
        return function

    return mark


def _built(name: str, function: Callable[..., Any]) -> Any:
    """Return the command of a function."""
    panel, rare, shared = _shown(function)
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    alone.command(name, cls=Command, rich_help_panel=panel)(viewed(function, rare, shared))
    return get_command(alone)


def _listed(name: str, function: Callable[..., Any]) -> Any:
    """Return the command of a function without its options, which take long to build."""
    return TyperCommand(name, help=inspect.getdoc(function), rich_help_panel=_shown(function)[0])


def _shown(function: Callable[..., Any]) -> tuple[str, Sequence[str], dict[str, Any]]:
    return getattr(function, "shown", ("Extensions", (), {}))


@functools.cache
def commands() -> Any:
    """Return the group of all commands; each is built at its first use."""
    return get_command(app)


def known_commands() -> dict[str, Any]:
    """Return all commands by name, with those that other distributions add."""
    group = commands()
    return {name: group.get_command(None, name) for name in group.list_commands(None)}


def main() -> None:
    """Run the command line; user and system errors end with one line and status 2."""
    _open_streams()
    try:
        _check_surroundings()
        keep_compiled_programs()
        single_threaded_algebra()
        with stoppable():
            words = sys.argv[1:] or ["--help"]
            code = commands()(words, prog_name="airpuck", standalone_mode=False)
            sys.stdout.flush()
    except InputError as error:
        code = _say(str(error))
    except TyperException as error:
        command = getattr(getattr(error, "ctx", None), "command_path", "airpuck")
        code = _say(f"{error.format_message()} (see {command} --help)")
    except OSError as error:
        closed = error.errno == errno.EIO and _terminal_closed()
        _close_output()
        if closed:  # a command that runs until it is stopped could not print its results
            number = stopped_by()
            code = SIGNALLED + number if number else 0
        elif error.errno == errno.EPIPE:
            code = 1  # the reader of our output has closed it
        elif error.errno in _SYSTEM_REFUSES:
            code = _say(f"{error.filename or 'output'}: cannot be used ({error.strerror})")
        else:
            raise
    except Stopped as stopped:
        code = _say_stopped(stopped)
    except (typer.Abort, KeyboardInterrupt):
        code = _say_stopped(Stopped(signal.SIGINT))
    sys.exit(code if isinstance(code, int) else 0)


def _say(message: str, status: int = 2) -> int:
    """Print one line on standard error; return the exit status, by default of bad input."""
    with contextlib.suppress(OSError):  # standard error may be a file on a full disk
        print(f"airpuck: {escaped(' '.join(message.split()))}", file=sys.stderr)
    return status


def _say_stopped(stopped: Stopped) -> int:
    """Print that a signal has ended the command; return the exit status."""
    forget_stopped()
    words = f"; {stopped.words}" if stopped.words else ""
    return _say(f"interrupted{words}", SIGNALLED + stopped.number)


def _open_streams() -> None:
    """Replace closed standard streams by the null device; Python has None for them.

    What the encoding of a stream lacks is escaped.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115
        elif mode == "w" and hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(errors="backslashreplace")


def _check_surroundings() -> None:
    """Check the working folder, and override settings of libraries that commands do not need."""
    with explained(OSError, "the working folder was deleted; change to another one"):
        Path.cwd()
    os.environ["MPLBACKEND"] = "agg"  # figures are files
    if not os.environ.get("SOURCE_DATE_EPOCH", "0").isdecimal():
        del os.environ["SOURCE_DATE_EPOCH"]


def _terminal_closed() -> bool:
    """Return whether standard output was a terminal that is closed now."""
    try:
        termios.tcgetattr(1)
    except termios.error as error:
        return error.args[0] == errno.EIO
    return False


def _close_output() -> None:
    """Discard standard output: flushing the rest of the buffer would fail again at exit."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Identify, simulate and control propeller-driven hovercraft."""
    if version:
        from airpuck import __version__

        print(f"airpuck {__version__}")
