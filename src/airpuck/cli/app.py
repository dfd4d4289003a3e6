"""The application: errors to exit statuses, and the options that precede a command."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

app = typer.Typer(
    name="airpuck",
    help="Identify, simulate and control propeller-driven hovercraft.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; bad usage and bad input end with one line and status 2."""
    from airpuck.boundary.errors import InputError
    from airpuck.compute.process import keep_compiled_programs, single_threaded_algebra

    keep_compiled_programs()
    single_threaded_algebra()
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
