"""Options: every number has documented limits; flags, completion."""

import os
import re
import subprocess
import sys

import pytest

from airpuck.boundary.errors import InputError
from airpuck.boundary.numbers import Range
from airpuck.cli.app import known_commands
from airpuck.cli.output import show_time_left

from ..apparatus.commands import airpuck, refused

COMMANDS = known_commands()


def numbers():
    """Return every parameter of every command that takes one or more numbers."""
    for name, command in COMMANDS.items():
        for parameter in command.params:
            kind = str(parameter.type_descriptor.annotation)
            if "float" in kind or "int" in kind:
                size = parameter.nargs
                yield pytest.param(
                    name, parameter.opts[0], size, "int" in kind, id=f"{name} {parameter.opts[0]}"
                )


@pytest.mark.parametrize(("name", "option", "size", "whole"), list(numbers()))
def test_every_number_has_limits(tmp_path, name, option, size, whole):
    # The last of several is checked, too.
    wrong = [str(10**24), str(-(10**24))] if whole else ["1e308", "-1e308", "inf", "nan"]
    for text in wrong:
        values = ["0.5"] * (size - 1) + [text]
        process = airpuck(name, option, *values, cwd=tmp_path)
        assert refused(process, f"{option}: must be ", ": "), text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_names_limits_and_no_truth_values(name):
    shown = airpuck(name, "--help", env={**os.environ, "COLUMNS": "200"}).stdout
    assert "bool" not in shown
    assert "<float" not in shown and "<int" not in shown
    options = [line for line in shown.splitlines() if re.match(r"│ [* ]*-", line)]
    assert 1 <= len(options) - 1 <= 12  # besides --help


def test_limits():
    above = Range(0, 1, "why", above=True)
    assert str(above) == "above 0, at most 1"
    assert str(Range(1, 2**63 - 1, "why", "s")) == "1 to 9.22e18 s"
    for limits, good, bad in (
        (above, (1e-300, 1), (0, 1.001, float("nan"))),
        (Range(0.5, 2, "why"), (0.5, 2), (0.4, float("inf"), float("nan"))),
    ):
        for value in good:
            limits.check(value, "x")
        for value in bad:
            with pytest.raises(InputError, match=r"^x: must be .*: why$"):
                limits.check(value, "x")


def test_limits_hold_in_python_as_well():
    from airpuck import Loss

    for make in (
        lambda: Loss(spacing=1e308),
        lambda: Loss(weights=(1.0, 1.0, float("inf"))),
        lambda: Loss(encoder_time=float("nan")),
    ):
        with pytest.raises(InputError, match="must be from"):
            make()


def completions(*words: str) -> list[str]:
    """Return the completions that the shell is offered for the last word."""
    environment = {
        **os.environ,
        "_AIRPUCK_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
    }
    command = [sys.executable, "-m", "airpuck"]
    process = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert process.stderr == ""
    return process.stdout.split()


@pytest.mark.slow
def test_the_shell_completes():
    assert completions("airpuck", "iden") == ["identify", "identify-puck"]
    assert completions("airpuck", "identify", "--st") == ["--stride"]
    # Completion does not reject the preceding words.
    typed = ("identify", "x", "-o", "/nowhere/x", "--stride", "0", "--delay", "")
    assert completions("airpuck", *typed) == ["fit", "fixed"]
    assert "auto" in completions("airpuck", "identify", "x", "--model", "")
    assert completions("airpuck", "identify", "x", "--model", "M5") == ["M5"]


def test_time_that_is_left_is_said_while_there_is_some(capsys):
    with show_time_left("flights", quiet=False) as progress:
        for done in (0.5, 1.0):
            progress(done, 1.0)
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("flights: 50 %, about ")
    assert last == "flights: 100 %"


def test_the_shell_finds_the_completion():
    command = [sys.executable, "-m", "airpuck", "--show-completion", "bash"]
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    shown = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert "_AIRPUCK_COMPLETE=complete_bash" in shown.stdout
