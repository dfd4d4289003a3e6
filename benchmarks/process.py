"""Whole processes: their time, their peak memory, and their output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

AIRPUCK = (sys.executable, "-c", "from airpuck.cli import main; main()")


@dataclass(frozen=True)
class Run:
    """One run of a process.

    Attributes
    ----------
    wall_s : float
        From its start to its end, including the interpreter's start.
    cpu_s : float
        The same of all its threads, and of processes that it waited for.
    peak_mib : float
        Largest resident set.
    output : str
        Its standard output.
    """

    wall_s: float
    cpu_s: float
    peak_mib: float
    output: str

    @property
    def figures(self) -> dict[str, Any]:
        """The JSON in its last line."""
        return json.loads(self.output.splitlines()[-1])


def run(
    command: Sequence[Any],
    environment: Mapping[str, str] | None = None,
    *,
    status: int | None = 0,
    until: Callable[[subprocess.Popen[bytes]], None] | None = None,
) -> Run:
    """Run a command to its end, with environment variables; raise if it has another exit status.

    `until` waits for something, and ends the command. Without a `status` any will do.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            [str(part) for part in command],
            stdout=out,
            stderr=err,
            env={**os.environ, **(environment or {})},
        )
        if until is not None:
            until(process)
        _, ended, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(ended)
        out.seek(0)
        err.seek(0)
        if status is not None and process.returncode != status:
            raise RuntimeError(f"{' '.join(map(str, command))}: {err.read().strip()[-400:]}")
        cpu = used.ru_utime + used.ru_stime
        return Run(wall, cpu, used.ru_maxrss / 1024, out.read())


def workload(name: str, *arguments: Any, environment: Mapping[str, str] | None = None) -> Run:
    """Run one of `benchmarks.workloads` in a separate process."""
    return run([sys.executable, "-m", "benchmarks.workloads", name, *arguments], environment)
