"""The application: errors and signals to exit statuses, and what all commands share."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Callable
from itertools import islice
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.exceptions import TyperException

from airpuck.boundary.errors import InputError
from airpuck.boundary.terminal import escaped
from airpuck.cli.names import check_inputs, refuse_empty
from airpuck.cli.views import viewed
from airpuck.compute.process import (
    Stopped,
    keep_compiled_programs,
    single_threaded_algebra,
    stoppable,
)

#: Of a process that a signal ends, less the signal's number.
_SIGNALLED = 128
#: What the system refuses a user; any other error of it is a failure of ours.
_SYSTEM_REFUSES = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EFBIG", "EIO", "EMFILE", "ENAMETOOLONG", "ENOSPC", "EROFS")
}


class _PlainFlags:
    """Leaves out of the help that a flag is a truth value: it takes none."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters."""
        parameters = super().get_params(ctx)  # pyright: ignore[reportAttributeAccessIssue]
        for parameter in parameters:
            if isinstance(parameter, TyperOption) and parameter.is_flag:
                parameter.metavar = ""
        return parameters


class Command(_PlainFlags, TyperCommand):
    """A command, whose names of files are checked before it starts."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and refuse names that cannot be meant."""
        refuse_empty(args)
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing:
            check_inputs(ctx)
        return rest


def repeated(**counts: int) -> type[Command]:
    """Return a kind of command whose named options take several numbers and may be repeated.

    Typer knows options of several numbers, and options that are repeated, but not both in one. The
    command gets texts with the numbers in them.
    """

    class Repeated(Command):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            """Join the numbers to one argument."""
            joined, left = [], iter(args)
            for arg in left:
                joined.append(arg)
                count = counts.get(arg.removeprefix("--").replace("-", "_"), 0)
                if count and arg.startswith("--"):
                    joined.append(" ".join(islice(left, count)))
            return super().parse_args(ctx, joined)

    return Repeated


class _Group(_PlainFlags, TyperGroup):
    """All commands; what a signal ends says so in one line."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except Stopped as stopped:  # Typer would say nothing
            words = f"; {stopped.words}" if stopped.words else ""
            raise typer.Exit(_say(f"interrupted{words}", _SIGNALLED + stopped.number)) from None


class _App(typer.Typer):
    """The application, whose commands are `Command`s and views of settings objects."""

    def command(self, *args: Any, cls: type[Command] = Command, **options: Any) -> Any:
        """Return a decorator that adds a command."""
        add = super().command(*args, cls=cls, **options)

        def added(command: Callable[..., Any]) -> Callable[..., Any]:
            add(viewed(command))
            return command

        return added


app = _App(
    name="airpuck",
    cls=_Group,
    help="Identify, simulate and control propeller-driven hovercraft.",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; what a user or the system refuses ends with one line and status 2."""
    keep_compiled_programs()
    single_threaded_algebra()
    try:
        with stoppable():
            code = app(sys.argv[1:] or ["--help"], prog_name="airpuck", standalone_mode=False)
            sys.stdout.flush()
    except InputError as error:
        code = _say(str(error))
    except TyperException as error:
        code = _say(f"{error.format_message()} (see airpuck --help)")
    except OSError as error:
        _close_output()
        if error.errno == errno.EPIPE:
            code = 1  # who reads our output has read enough
        elif error.errno in _SYSTEM_REFUSES:
            code = _say(f"{error.filename or 'output'}: cannot be used ({error.strerror})")
        else:
            raise
    except (typer.Abort, KeyboardInterrupt):
        code = _say("interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def _say(message: str, status: int = 2) -> int:
    """Print one line on standard error; return the exit status, by default of bad input."""
    print(f"airpuck: {escaped(' '.join(message.split()))}", file=sys.stderr)
    return status


def _close_output() -> None:
    """Write no more to standard output: what is left in the buffer would fail again at the end."""
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
