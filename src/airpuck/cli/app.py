"""The application: errors to exit statuses, and the options that precede a command."""

from __future__ import annotations

import os
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

    _keep_compiled_programs()
    # Matrices here are small: threads of linear algebra would only wait for each other, and keep
    # XLA's from working. Only before NumPy is imported does it help to say so.
    for library in ("OPENBLAS", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except InputError as error:
        code = _refuse(str(error))
    except TyperException as error:
        code = _refuse(f"{error.format_message()} (see airpuck --help)")
    except (typer.Abort, KeyboardInterrupt):
        code = _refuse("interrupted")
    sys.exit(code if isinstance(code, int) else 0)


def _keep_compiled_programs() -> None:
    """Let JAX keep what it compiles from process to process, in the user's cache folder.

    Only here, since a process that imports airpuck has settings of its own; and these are JAX's own
    variables, so that a user's come first.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    from platformdirs import user_cache_path

    folder = user_cache_path("airpuck", appauthor=False) / "compiled"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if os.access(folder, os.W_OK):
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")


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
