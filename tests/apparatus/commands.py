"""Run the command line: in this process, or in a separate one as a user does."""

import contextlib
import io
import os
import subprocess
import sys
from subprocess import CompletedProcess
from unittest import mock


def airpuck(*arguments, cwd=None, env=None) -> CompletedProcess[str]:
    """Run a command in this process: imports and compiled programs serve all tests.

    Exceptions other than `InputError` propagate, instead of a traceback on standard error.
    """
    from airpuck.cli import main

    words = ["airpuck", *map(str, arguments)]
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", words),
        mock.patch.dict(os.environ, env or {}, clear=env is not None),
        contextlib.chdir(cwd or "."),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            assert isinstance(end.code, int)
            status = end.code
    return CompletedProcess(words, status, out.getvalue(), err.getvalue())


def ran(*arguments, cwd=None) -> CompletedProcess[str]:
    """Run a command that must succeed."""
    process = airpuck(*arguments, cwd=cwd)
    assert process.returncode == 0, process.stderr
    return process


def airpuck_process(*arguments, cwd=None, env=None) -> CompletedProcess[str]:
    """Run a command in a separate process."""
    return subprocess.run(
        [sys.executable, "-c", "from airpuck.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=env,
        check=False,
    )


def refused(process: CompletedProcess[str], *words: str) -> bool:
    """Check for bad input: status 2, one line with these words, no traceback."""
    assert process.returncode == 2, process.stderr
    lines = process.stderr.strip().splitlines()
    assert len(lines) == 1, process.stderr
    for word in words:
        assert word in lines[0]
    return True
