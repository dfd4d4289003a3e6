"""Runs commands and disturbs them, by a signal at any time or by a full disk.

A server in a separate process imports everything that commands need once, and forks for each
command. Its failures cannot affect the tests. `Server` talks to it.
"""

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

#: Largest file size if the disk is full [bytes].
_FULL = 64


@dataclass(frozen=True)
class Ended:
    """Result of a command."""

    #: Exit status; negative: minus the number of a signal.
    status: int
    error: str
    wall_s: float


class Server:
    """Runs commands in processes, and disturbs them."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "tests.apparatus.disturbed_commands"]
        # Children of a shell that starts the tests in the background ignore Ctrl-C.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(
        self,
        *arguments: object,
        folder: Path,
        sent: int = 0,
        after: float | None = None,
        write: int = 0,
        full: bool = False,
    ) -> Ended:
        """Run a command in a folder.

        The signal is sent `after` some time [s], or with the `write`-th file of an output: before
        it is written, or if negative before it takes its place. To all processes where a terminal
        would: Ctrl-C. `full`: no file may grow from the first output on.
        """
        case = {"arguments": [*map(str, arguments)], "folder": str(folder), "sent": sent}
        case |= {"after": after, "write": write, "full": full}
        assert self._process.stdin is not None and self._process.stdout is not None
        print(json.dumps(case), file=self._process.stdin, flush=True)
        return Ended(**json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End."""
        self._process.communicate()


def _serve() -> None:
    """Serve cases from standard input; a forked child returns and becomes the command."""
    warnings.filterwarnings("ignore", "os.fork")
    for line in sys.stdin:
        case, started = json.loads(line), time.monotonic()
        errors, waits = os.pipe()
        child = os.fork()
        if not child:
            os.close(errors)
            _become(case, waits)
            return
        os.close(waits)
        if case["after"] is not None:
            time.sleep(case["after"])
            with contextlib.suppress(ProcessLookupError):
                _send(child, case["sent"])
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # children that a killed command left running
        with os.fdopen(errors, errors="replace") as text:
            error = text.read()
        wall_s = time.monotonic() - started
        print(json.dumps({"status": code, "error": error, "wall_s": wall_s}), flush=True)


def _send(process: int, number: int) -> None:
    """Send a signal; Ctrl-C goes to all processes of the command."""
    (os.killpg if number == signal.SIGINT else os.kill)(process, number)


def _become(case: dict[str, Any], errors: int) -> None:
    """Become the command."""
    os.setsid()
    os.chdir(case["folder"])
    os.dup2(errors, 2)
    os.close(errors)
    os.dup2(os.open(os.devnull, os.O_RDWR), 1)
    os.dup2(1, 0)
    # As at a command's start: Python's old streams remember other files.
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
    sys.argv = ["airpuck", *case["arguments"]]
    # A report needs flights of 90 s, a test does not.
    airpuck.report.reproduce.demo = partial(airpuck.report.reproduce.demo, duration=8.0)
    counts = {"touch": 0, "replace": 0, "mkdir": 0, "rename": 0}

    def disturbed(name: str, begins: bool) -> None:
        usual = getattr(Path, name)

        def act(path: Path, *arguments: Any, **named: Any) -> Any:
            if path.name.startswith(".") or path.parent.name.startswith("."):
                counts[name] += 1
                if begins and case["full"]:
                    resource.setrlimit(resource.RLIMIT_FSIZE, (_FULL, _FULL))
                begun = counts["touch"] + counts["mkdir"] if begins else 0
                ended = 0 if begins else counts["replace"] + counts["rename"]
                if case["sent"] and case["write"] in (begun or None, -ended or None):
                    _send(os.getpid(), case["sent"])
            return usual(path, *arguments, **named)

        setattr(Path, name, act)

    if case["write"] or case["full"]:
        for name in ("touch", "mkdir"):
            disturbed(name, True)
        for name in ("replace", "rename"):
            disturbed(name, False)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    import jax  # noqa: F401
    import matplotlib.figure  # noqa: F401
    import scipy.optimize  # noqa: F401

    import airpuck.identification.fit
    import airpuck.report.reproduce
    import airpuck.twin.experiments
    from airpuck.cli import main

    _serve()
    if sys.argv[0] == "airpuck":
        main()
