"""The whole table of speed.

    AIRPUCK_DATA=... python -m benchmarks                   # takes minutes; keep the machine idle
    AIRPUCK_DATA=... python -m benchmarks --only identify   # rows whose names begin with this
    AIRPUCK_DATA=... python -m benchmarks --only command    # each command, in % of the peer's fit
    AIRPUCK_DATA=... python -m benchmarks --long --authors ~/holohover-sysid

Prints the table and stores it as out/benchmarks.json and out/benchmarks.md. Values are medians.
Processes are timed from start to end, including the interpreter's start, with an empty compilation
cache unless stated otherwise. JAX_PLATFORMS=cpu or cuda chooses the device.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import re
import statistics
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

from airpuck import InputError
from airpuck.compute.process import usable_cores
from airpuck.recording.dataset import dataset_folder

from . import authors
from .commands import COMMANDS, measured, slower
from .process import AIRPUCK, Run, run, workload
from .workloads import STUDY, TRAINING

HERE = Path(__file__).parent
COLD = {"JAX_ENABLE_COMPILATION_CACHE": "false"}
#: Programs are kept as by the commands.
STORED = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
#: Fits of the peer by whose median the commands' times are divided.
_PEER_FITS = 3
PACKAGES = ("airpuck", "jax", "jaxlib", "numpy", "scipy", "piqp", "daqp", "torch")

Row = dict[str, object]


class Table:
    """The measured rows.

    Parameters
    ----------
    runs : int
        Runs of each row.
    only : sequence of str
        Prefixes of the names of rows to measure; empty: all.
    """

    def __init__(self, runs: int, only: Sequence[str]) -> None:
        self.runs, self.only = runs, tuple(only)
        self.rows: list[Row] = []

    def add(
        self,
        name: str,
        unit: str,
        measure: Callable[[], float | Sequence[float] | str],
        *,
        target: str = "",
        runs: int | None = None,
    ) -> None:
        """Measure a row: a number per run, several of one run, or the reason why there is none."""
        if self.only and not name.startswith(self.only):
            return
        values: list[float] = []
        for _ in range(self.runs if runs is None else runs):
            found = measure()
            if isinstance(found, str):
                self.rows.append({"name": name, "skipped": found})
                print(f"{name}: {found}", flush=True)
                return
            values += [found] if isinstance(found, float) else list(found)
        self.rows.append(
            {
                "name": name,
                "unit": unit,
                "median": statistics.median(values),
                "min": min(values),
                "max": max(values),
                "runs": len(values),
                "target": target,
            }
        )
        print(_line(self.rows[-1]), flush=True)


def _line(row: Row) -> str:
    """Write a row of the Markdown table."""
    if "skipped" in row:
        return f"| {row['name']} | | | | | {row['skipped']} |"
    cells = (f"{row[key]:.4g}" for key in ("median", "min", "max"))
    return f"| {row['name']} | {' | '.join(cells)} | {row['unit']} | {row['target']} |"


def whole_processes(table: Table, folder: Path) -> None:
    """Commands, from start to end."""
    data = dataset_folder() / TRAINING
    bag, model = folder / "bag", folder / "m.toml"
    automatic = (*AIRPUCK, "identify", data, "-o", model, "-q")
    identify = (*automatic, "--model", "M3")
    warm = STORED | {"JAX_COMPILATION_CACHE_DIR": str(folder / "compiled")}

    def timed(*command: object, cold: bool = False) -> Callable[[], float]:
        return lambda: run(command, COLD if cold else None).wall_s

    def compiled_before(*command: object) -> Callable[[], float]:
        compile_once = cache(partial(run, command, warm))

        def again() -> float:
            compile_once()
            return run(command, warm).wall_s

        return again

    def preprocess() -> float:
        if not bag.exists():
            workload("bag", "--output", bag)
        return run((*AIRPUCK, "preprocess", bag, "-o", folder / "t.npz", "-q")).wall_s

    python = (sys.executable, "-c")
    table.add("import airpuck", "s", timed(*python, "import airpuck"), target="≤ 0.3")
    table.add("airpuck --help", "s", timed(*AIRPUCK, "--help"), target="≤ 0.5")
    table.add("identify M3", "s", timed(*identify, cold=True), target="≤ 5, aim 2.5")
    table.add("identify M3, compiled before", "s", compiled_before(*identify), target="aim 2")
    table.add("identify, any terms", "s", timed(*automatic, cold=True))
    table.add("identify, any terms, compiled before", "s", compiled_before(*automatic))
    table.add(
        "M0 to M4, fitted and judged", "s", timed(*python, STUDY, cold=True), target="≤ 12, aim 6"
    )
    table.add("60 s bag to trajectory", "s", preprocess, target="≤ 1.5")


def each_command(table: Table, folder: Path) -> None:
    """Each command with nothing compiled before, and with all of it; say what got slower."""
    names = {f"command {name}, {when}": when for name in COMMANDS for when in ("cold", "compiled")}
    if table.only and not any(name.startswith(table.only) for name in names):
        return
    fits = [float(workload("peer", "--runs", 1).figures["cpu_s"]) for _ in range(_PEER_FITS)]
    peer = statistics.median(fits)
    table.add("command: the peer's fit", "s of CPU", lambda: peer, runs=1)
    stored = STORED | {"JAX_COMPILATION_CACHE_DIR": str(folder / "compiled")}

    def share(name: str, when: str) -> float:
        if when == "compiled":
            measured(name, folder, stored)
        return 100 * measured(name, folder, COLD if when == "cold" else stored).cpu_s / peer

    complaints = []
    for row, when in names.items():
        name = row.removeprefix("command ").removesuffix(f", {when}")
        table.add(row, "% of the peer", lambda name=name, when=when: share(name, when), runs=1)
        if table.rows and table.rows[-1]["name"] == row:
            complaints.append(slower(f"{name}, {when}", float(str(table.rows[-1]["median"]))))
    for complaint in filter(None, complaints):
        print(f"slower than in benchmarks/README.md: {complaint}", flush=True)


def inside(table: Table, folder: Path) -> None:
    """Measure inside a process."""
    steps: list[Run] = []

    def step() -> float:
        steps.append(workload("step"))
        return float(steps[-1].figures["wall_s"])

    def again() -> float:
        return float(workload("identify_again").figures["wall_s"])

    def fits() -> float:
        return float(workload("bootstrap").figures["fits_per_s"])

    flights: list[Run] = []

    def first() -> float:
        flights.append(workload("new_model", environment=STORED))
        return float(flights[-1].figures["first_cpu_s"])

    table.add("identify M3, second time in a process", "s", again, target="≤ 0.4, aim 0.1")
    table.add("step over all windows", "s", step, target="≤ 1, aim 0.3")
    if steps:
        table.add("step over all windows, peak memory", "MiB", lambda: steps[-1].peak_mib, runs=1)
    table.add("fits to resampled data", "1/s", fits, runs=1)
    table.add("new model, first second of flight in a process", "s of CPU", first, runs=2)
    if flights:
        later = float(flights[-1].figures["cpu_s"])
        table.add("new model, a later one in the process", "s of CPU", lambda: later, runs=1)


def scripts(table: Table, folder: Path) -> None:
    """Run the scripts beside this one, and read their output."""

    def printed(pattern: str, script: str, *arguments: str) -> Callable[[], Sequence[float] | str]:
        def measure() -> Sequence[float] | str:
            output = run((sys.executable, HERE / script, *arguments)).output
            found = re.findall(pattern, output, re.MULTILINE)
            return [float(value) for value in found] or f"{script} prints no such line"

        return measure

    number = r"([\d.e+]+)"
    for column, radio in ((rf"{number} +\S+", "own radio"), (rf"\S+ +{number}", "same radio")):
        pattern = rf"^ *1000 +{column}"
        measure = printed(pattern, "twin_throughput.py", "--craft", "1000")
        table.add(f"batch of 1000 twins, {radio}", "flight s/s", measure, runs=1)
    for share, target in (("p50", "≤ 100, aim 50"), ("p99", "≤ 200, aim 150")):
        pattern = rf"^total.*{share} +{number}"
        table.add(
            f"control step, {share}", "µs", printed(pattern, "control_step.py"), target=target
        )


def peers(table: Table, folder: Path, checkout: Path | None) -> None:
    """Measure the alternatives."""

    def peer() -> float:
        return float(workload("peer").figures["wall_s"])

    def demo() -> float:
        # Alternate them, so that a slow or busy machine affects both alike.
        whole = run((*AIRPUCK, "demo", "-q", "-o", folder / "demo"), COLD).wall_s
        return whole / peer()

    table.add("NumPy and scipy.optimize.least_squares, M3", "s", peer)
    table.add("demo, whole process, against that fit by NumPy", "–", demo)
    if checkout is not None:
        table.add("an epoch of the authors' code", "s", lambda: authors.epochs(checkout), runs=1)


def long(table: Table, folder: Path) -> None:
    """Measure the slow rows, which take minutes."""
    peaks: dict[int, float] = {}

    def hour(seconds: int) -> float:
        bag = folder / f"bag{seconds}"
        workload("bag", "--seconds", seconds, "--output", bag)
        done = run((*AIRPUCK, "preprocess", bag, "-o", folder / "t.npz", "-q"))
        peaks[seconds] = done.peak_mib
        return done.wall_s

    def adam() -> float | str:
        found = workload("adam").figures
        if found["reached"]:
            return float(found["wall_s"])
        reached = f"{found['loss']:.4e}, not {found['goal']:.4e}"
        return f"{found['epochs']} epochs, {found['wall_s']:.0f} s: {reached}"

    for seconds in (600, 3600):
        name = f"{seconds // 60} min bag to trajectory"
        table.add(name, "s", lambda seconds=seconds: hour(seconds), runs=1)
        if seconds in peaks:
            table.add(f"{name}, peak memory", "MiB", lambda seconds=seconds: peaks[seconds], runs=1)
    table.add("Adam, until 0.1 % above the same loss", "s", adam, runs=1)


def machine() -> dict[str, object]:
    """Return machine, versions and date in words."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    cpu = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", cpu.read_text()) if cpu.exists() else []
    devices = run((sys.executable, "-c", "import jax; print(jax.devices()[0].device_kind)")).output
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "processor": names[0] if names else platform.processor(),
        "cores": usable_cores(),
        "load_before": os.getloadavg()[0],
        "jax_device": devices.strip(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--only", action="append", default=[], metavar="NAME")
    parser.add_argument("--long", action="store_true", help="also bags of up to an hour, and Adam")
    parser.add_argument("--authors", type=Path, metavar="PATH", help="checkout of holohover-sysid")
    parser.add_argument("-o", "--output", type=Path, default=Path("out"), metavar="DIR")
    options = parser.parse_args()
    about, table = machine(), Table(options.runs, options.only)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole_processes(table, folder)
        each_command(table, folder)
        inside(table, folder)
        scripts(table, folder)
        peers(table, folder, options.authors)
        if options.long:
            long(table, folder)
    options.output.mkdir(parents=True, exist_ok=True)
    stored = {**about, "rows": table.rows}
    (options.output / "benchmarks.json").write_text(json.dumps(stored, indent=2) + "\n")
    told = [f"* {key}: {value}" for key, value in about.items()]
    head = ["| | median | min | max | unit | target |", "|---|---|---|---|---|---|"]
    text = "\n".join([*told, "", *head, *map(_line, table.rows)]) + "\n"
    (options.output / "benchmarks.md").write_text(text)
    print("\n" + text)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"benchmarks: {error}")
