"""Everything that a GPU may speed up, in five minutes; without one, on the CPU.

    AIRPUCK_DATA=... python -m benchmarks.gpu
    AIRPUCK_DATA=... python -m benchmarks.gpu --peer ~/crazyflow/bin/python

JAX chooses the device; JAX_PLATFORMS=cpu compares with the processor. Each row is a process of its
own, with the smaller rows first. A row that fails, or that the five minutes cut short, says so, and
the others are kept. The figures are seconds of flight per second and craft together, fits per
second, and the median time of a Gauss-Newton step over all windows.

The peer is crazyflow, in a Python that has it: Crazyflies under a thrust for each motor, 500 steps
per second of flight. The twin takes the steps that its radio, its cameras and its motors need.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from textwrap import shorten

from .process import Run, run
from .scaling import campaign

HERE = Path(__file__).parent
CRAFT = (1_000, 10_000, 100_000)
#: Processes take memory of the card as they need it, not most of it at once.
SHARED = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
#: Flies Crazyflies for a second, and prints the seconds of flight per second.
CRAZYFLOW = """
import json, os, statistics, sys, tempfile, time
import jax
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim

os.chdir(tempfile.gettempdir())  # MuJoCo writes a log
craft, runs = int(sys.argv[1]), 3
device = jax.devices()[0].platform
sim = Sim(n_worlds=craft, n_drones=1, control=Control.rotor_vel, freq=500, device=device)
command = np.full((craft, 1, 4), 15_000.0)

def second():
    begun = time.perf_counter()
    sim.reset()
    for _ in range(100):
        sim.rotor_vel_control(command)
        sim.step(5)
    jax.block_until_ready(sim.data)
    return time.perf_counter() - begun

second()
wall = statistics.median(second() for _ in range(runs))
print(json.dumps({"rate": craft / wall, "device": jax.devices()[0].device_kind}))
"""


@dataclass
class Measuring:
    """Rows measured, the time when measuring ends, and the file that keeps the rows."""

    until: float
    file: Path | None
    rows: dict[str, str] = field(default_factory=dict)

    def run(self, command: Sequence[object]) -> Run:
        """Run a process, and end it when the time is over."""
        left, cut = self.until - time.monotonic(), threading.Event()
        if left <= 0:
            raise RuntimeError("no time left")

        def ended_in_time(process: subprocess.Popen[bytes]) -> None:
            def end() -> None:
                cut.set()
                process.kill()

            timer = threading.Timer(left, end)
            timer.daemon = True
            timer.start()

        try:
            return run(command, SHARED, until=ended_in_time)
        except RuntimeError as error:
            if cut.is_set():
                raise RuntimeError(f"cut short after {left:.0f} s") from error
            raise

    def row(self, name: str, measure: Callable[[], str]) -> None:
        """Measure a row, or report why it failed, and keep it."""
        begun = time.monotonic()
        try:
            self.rows[name] = measure()
        except (RuntimeError, ValueError, LookupError) as error:
            self.rows[name] = f"none: {shorten(str(error).splitlines()[-1], 120)}"
        print(f"| {name} | {self.rows[name]} | {time.monotonic() - begun:.0f} s |", flush=True)
        if self.file is not None:
            self.file.write_text(json.dumps(self.rows, indent=2) + "\n", "utf-8")


def workload(measuring: Measuring, name: str, *options: object) -> dict[str, float]:
    """Run one of `benchmarks.workloads` while there is time, and return its figures."""
    return measuring.run((sys.executable, "-m", "benchmarks.workloads", name, *options)).figures


def open_loop(measuring: Measuring, craft: int) -> str:
    """Fly a batch of twins under commands that nothing corrects."""
    script = sys.executable, HERE / "twin_throughput.py", "--runs", 3, "--seconds", 1
    last = measuring.run((*script, "--craft", craft)).output.splitlines()[-1]
    _, own, same = last.split()
    return f"{float(own):.3g} with a radio for each, {float(same):.3g} with one for all"


def closed_loop(measuring: Measuring, craft: int) -> str:
    """Steer a batch of twins by their poses."""
    found = workload(measuring, "crowd", "--craft", craft, "--runs", 3)
    return f"{craft / found['wall_s']:.3g}"


def crazyflow(measuring: Measuring, python: Path, craft: int) -> str:
    """Fly as many Crazyflies as twins, with the peer."""
    found = measuring.run((python, "-c", CRAZYFLOW, craft)).figures
    return f"{found['rate']:.3g}, on {found['device']}"


def step(measuring: Measuring) -> str:
    """Time a Gauss-Newton step."""
    return f"{workload(measuring, 'step', '--runs', 3)['wall_s']:.3g} s"


def fits(measuring: Measuring) -> str:
    """Fit to resampled data."""
    found = workload(measuring, "bootstrap", "--replicates", 50)
    return f"{found['fits_per_s']:.3g} fits/s"


def flights(measuring: Measuring, count: int) -> str:
    """Fly and fit in Dask's processes."""
    begun = time.monotonic()
    campaign(count, 1, measuring.run)
    return f"{count / (time.monotonic() - begun):.3g} flights of 10 s with their fits per second"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--peer", type=Path, metavar="PYTHON", help="one that has crazyflow")
    parser.add_argument("--craft", type=int, nargs="+", default=CRAFT)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("-o", "--output", type=Path, help="store the rows as JSON, too")
    options = parser.parse_args()
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
    measuring = Measuring(time.monotonic() + 60 * options.minutes, options.output)
    asked = "import jax; print(jax.devices()[0].device_kind, len(jax.devices()), jax.__version__)"
    measuring.row(
        "device, number, JAX",
        lambda: measuring.run((sys.executable, "-c", asked)).output.strip(),
    )
    measuring.row("Gauss-Newton step of M3, all windows", partial(step, measuring))
    for craft in options.craft:
        flown = f"{craft} craft, seconds of flight per second"
        measuring.row(f"{flown}, commands alone", partial(open_loop, measuring, craft))
        measuring.row(f"{flown}, steered by poses", partial(closed_loop, measuring, craft))
        if options.peer is not None:
            peer = partial(crazyflow, measuring, options.peer, craft)
            measuring.row(f"{flown}, crazyflow", peer)
    measuring.row("fits to resampled data", partial(fits, measuring))
    measuring.row("campaign of 10 flights", partial(flights, measuring, 10))


if __name__ == "__main__":
    main()
