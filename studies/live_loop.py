"""Does the loop meet its deadlines? Twin, controller and recorder as processes, for ten minutes.

    python studies/live_loop.py --duration 600
    python studies/live_loop.py --duration 600 --law mpc

Prints jitter, latency and deadlines as measured by the controller, and the memory of all three
processes at the start and at the end; exits with status 1 if a limit is exceeded. A bare loop runs
beside them in a separate process with the same priority: it only sleeps until each period is due.
Deadlines that it misses are due to the machine; those that the controller misses beyond them are
ours. `make studies` runs this study after all others, with nothing beside it.
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
from airpuck.compute.process import prioritize
from airpuck.control.laws import LAWS
from airpuck.flight.clock import JITTER_P99, LATENCY_P99, Clock, LoopTiming

_MAIN = "from airpuck.cli import main; main()"
#: Time from the start of the flight to the first measurement of memory and the bare loop [s].
_SETTLED_S = 3.0
LATENCY_P50 = 1e-3
#: Allowed growth of a process [MB], for example by the index of the recording.
GROWTH = 3.0


def started(*arguments: object, said: Path) -> subprocess.Popen[str]:
    """Start a command of airpuck's, with its output in a file."""
    command = [sys.executable, "-c", _MAIN, *map(str, arguments)]
    none = subprocess.DEVNULL
    with said.open("w") as file:
        return subprocess.Popen(command, text=True, stdin=none, stdout=none, stderr=file)


def wait_for(process: subprocess.Popen[str], said: Path, words: str) -> None:
    """Wait until a process has printed a text."""
    while words not in said.read_text():
        if process.poll() is not None:
            raise RuntimeError(f"a process ended early: {said.read_text()}")
        time.sleep(0.1)


def bare_loop(duration: float, period: float = 0.01) -> dict[str, Any]:
    """Sleep until each period is due, and do nothing; return how late it wakes."""
    prioritize(first=True)
    clock, timing = Clock(), LoopTiming(period)
    for k in range(1, round(duration / period) + 1):
        clock.sleep_until(k * period)
        timing.add(k * period, clock.now, None)
    return timing.to_json()


def memory(process: subprocess.Popen[str]) -> float:
    """Return the resident memory of a process [MB]."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return float(found[1]) / 1e3 if found else float("nan")


def flown(duration: float, domain: int, regulator: str = "lqr") -> dict[str, Any]:
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
        said = {name: Path(folder) / name for name in ("twin", "record", "fly")}
        processes = {
            "twin": started("twin", *common, said=said["twin"]),
            "record": started("record", "-o", bag, *common, said=said["record"]),
        }
        try:
            # The recorder is there long before the controller is compiled.
            processes["fly"] = started(
                *("fly", "paper:M3", "--setpoints", points, "--duration", duration),
                *("--law", regulator, "--json", figures, *common),
                said=said["fly"],
            )
            # A busy machine takes long to compile.
            for name, process in processes.items():
                wait_for(process, said[name], "on domain")
            time.sleep(_SETTLED_S)
            bare = subprocess.Popen(
                [
                    sys.executable,
                    __file__,
                    "--bare",
                    "--duration",
                    str(max(duration - _SETTLED_S, 0)),
                ],
                text=True,
                stdout=subprocess.PIPE,
            )
            before = {name: memory(process) for name, process in processes.items()}
            # A little before the flight ends, all three are still there.
            time.sleep(max(duration - _SETTLED_S - 2, 1))
            after = {name: memory(process) for name, process in processes.items()}
            processes["fly"].wait(60)
            beside = json.loads(bare.communicate(timeout=60)[0])
        finally:
            for process in reversed(processes.values()):
                process.send_signal(signal.SIGINT)
                process.wait(30)
        recording = read_recording(bag)
        return {
            **json.loads(figures.read_text()),
            "bare_loop": beside,
            "memory_MB": {name: [before[name], after[name]] for name in before},
            "recorded": {name: len(stream) for name, stream in recording.streams.items()},
        }


def missed(figures: dict[str, Any]) -> float:
    """Return the share of periods that missed their deadline [%]."""
    return 100 * figures["missed_deadlines"] / max(figures["periods"], 1)


def bounds(figures: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Return each limited quantity: its name, its value, and its limit."""
    jitter, latency = figures["period_jitter_ms"], figures["pose_to_command_ms"]
    return [
        ("period jitter p99, ms", jitter["p99"], 1e3 * JITTER_P99),
        ("pose to command p50, ms", latency["p50"], 1e3 * LATENCY_P50),
        ("pose to command p99, ms", latency["p99"], 1e3 * LATENCY_P99),
        ("missed deadlines, %", missed(figures), 0.1),
        ("beyond the bare loop, %", missed(figures) - missed(figures["bare_loop"]), 0.1),
        *(
            (f"growth of {name}, MB", after - before, GROWTH)
            for name, (before, after) in figures["memory_MB"].items()
        ),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=600.0)
    parser.add_argument("--domain", type=int, default=99)
    parser.add_argument("--law", choices=LAWS, default="lqr")
    parser.add_argument("--bare", action="store_true", help="only the bare loop, as JSON")
    options = parser.parse_args()
    if options.bare:
        print(json.dumps(bare_loop(options.duration)))
        return
    figures = flown(options.duration, options.domain, options.law)
    print(json.dumps(figures, indent=2))
    held = True
    for name, value, limit in bounds(figures):
        broken = value > limit
        held = held and not broken
        print(f"{name:24s} {value:8.3f}  at most {limit:g}{'  BROKEN' if broken else ''}")
    sys.exit(not held)


if __name__ == "__main__":
    run(main)
