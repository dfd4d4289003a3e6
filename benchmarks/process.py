"""Whole processes: their time, their peak memory, and their output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
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
    peak_mib : float
        Largest resident set.
    output : str
        Its standard output.
    """

    wall_s: float
    peak_mib: float
    output: str

    @property
    def figures(self) -> dict[str, Any]:
        """The JSON in its last line."""
        return json.loads(self.output.splitlines()[-1])


def run(command: Sequence[Any], **environment: str) -> Run:
    """Run a command to its end, with environment variables; raises if it fails."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        started = time.perf_counter()
        process = subprocess.Popen(
            [str(part) for part in command], stdout=out, stderr=err, env=os.environ | environment
        )
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode:
            raise RuntimeError(f"{' '.join(process.args)}: {err.read().strip()[-400:]}")
        return Run(wall, used.ru_maxrss / 1024, out.read())


def workload(name: str, *arguments: Any, **environment: str) -> Run:
    """Run one of `benchmarks.workloads` in a separate process."""
    return run([sys.executable, "-m", "benchmarks.workloads", name, *arguments], **environment)
