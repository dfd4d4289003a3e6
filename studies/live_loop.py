"""Does the loop keep its time? Twin, controller and recorder as processes, for ten minutes.

    python studies/live_loop.py --duration 600

Prints jitter, latency and deadlines as the controller measures them, and the memory of all three
processes at the start and at the end.
"""

from __future__ import annotations

import argparse
import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from one_line import run

from airpuck import read_recording
from airpuck.live.monitor import JITTER_P99, LATENCY_P99

_MAIN = "from airpuck.cli import main; main()"
_START_S = 15.0
LATENCY_P50 = 1e-3


def started(*arguments: object) -> subprocess.Popen[str]:
    """Start a command of airpuck's."""
    command = [sys.executable, "-c", _MAIN, *map(str, arguments), "-q"]
    return subprocess.Popen(command, text=True, stdin=subprocess.DEVNULL)


def memory(process: subprocess.Popen[str]) -> float:
    """Return the resident memory of a process [MB]."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return float(found[1]) / 1e3 if found else float("nan")


def flown(duration: float, domain: int) -> dict[str, Any]:
    """Fly back and forth between set points; return what was measured."""
    with tempfile.TemporaryDirectory() as folder:
        figures, points, bag = (Path(folder) / name for name in ("f.json", "p.toml", "bag"))
        points.write_text(
            "".join(
                f"[[setpoints]]\nat_s = {4.0 * k}\nx_m = {0.4 * (-1) ** k}\ny_m = 0.1\n"
                f"yaw_rad = {float(k % 3)}\n"
                for k in range(int(duration / 4) + 1)
            )
        )
        common = ("--domain", domain)
        processes = {
            "twin": started("twin", *common),
            "record": started("record", "-o", bag, *common),
        }
        try:
            time.sleep(5)
            processes["fly"] = started(
                *("fly", "--model", "paper:M3", "--setpoints", points, "--duration", duration),
                *("--json", figures, *common),
            )
            time.sleep(_START_S)
            before = {name: memory(process) for name, process in processes.items()}
            # A little before the flight ends, all three are still there.
            time.sleep(max(duration - _START_S - 2, 1))
            after = {name: memory(process) for name, process in processes.items()}
            processes["fly"].wait(60)
        finally:
            for process in reversed(processes.values()):
                process.send_signal(signal.SIGINT)
                process.wait(30)
        recording = read_recording(bag)
        return {
            **json.loads(figures.read_text()),
            "memory_MB": {name: [before[name], after[name]] for name in before},
            "recorded": {name: len(stream) for name, stream in recording.streams.items()},
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=600.0)
    parser.add_argument("--domain", type=int, default=99)
    options = parser.parse_args()
    figures = flown(options.duration, options.domain)
    print(json.dumps(figures, indent=2))
    jitter, latency = figures["period_jitter_ms"], figures["pose_to_command_ms"]
    for name, value, target in (
        ("period jitter p99", jitter["p99"], 1e3 * JITTER_P99),
        ("pose to command p50", latency["p50"], 1e3 * LATENCY_P50),
        ("pose to command p99", latency["p99"], 1e3 * LATENCY_P99),
        ("missed deadlines", figures["missed_deadlines"], 0),
    ):
        print(f"{name:20s} {value:7.3f}  target {target:g}  {'' if value <= target else 'MISSED'}")
    for name, (before, after) in figures["memory_MB"].items():
        print(f"memory of {name:10s} {before:7.1f} MB, then {after:7.1f} MB")


if __name__ == "__main__":
    run(main)
