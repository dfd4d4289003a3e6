"""The same run on a ROS 2 graph, in real time: studies run in another process."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any

from airpuck.boundary.results import Finding
from airpuck.commissioning.commission import Commissioning, commission
from airpuck.commissioning.session import Ended, Work
from airpuck.compute.process import prioritize
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.judgement.study import study
from airpuck.live.fly import EARLY, GraphLink, keyboard
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings

NAME = "airpuck commission"
#: Niceness of the process that computes: the flight comes first.
_NICE = 10


class ProcessWork(Work):
    """Computes in a process of its own, while the loop keeps its periods."""

    def __init__(self) -> None:
        # JAX has threads, which do not survive a fork.
        context = multiprocessing.get_context("spawn")
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            # The process inherits a blocked Ctrl-C, which a terminal sends to all.
            self._pool = ProcessPoolExecutor(1, context, initializer=os.nice, initargs=(_NICE,))
            self._future: Future[Any] = self._pool.submit(id, study)  # imports it
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def start(self, now: float, function: Callable[..., Any], *arguments: Any) -> None:
        """Submit a computation; see `Work`."""
        self._future = self._pool.submit(function, *arguments)

    def done(self, now: float) -> bool:
        """Return whether it has ended; see `Work`."""
        return self._future.done()

    def result(self) -> Any:
        """Wait for the result; see `Work`."""
        return self._future.result()

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def commission_live(
    vehicle: Vehicle,
    out: str | os.PathLike[str] | None = None,
    settings: LiveSettings | None = None,
    *,
    table: Table | None = None,
    seed: int = 0,
    tell: Callable[[str], object] = lambda _: None,
) -> Commissioning:
    """Commission a craft on the graph; any key or Ctrl-C stops it. See `commission`."""
    prioritize(first=True)
    with Process(NAME, settings or LiveSettings()) as process:
        process.refuse_second("command", vehicle.columns, "controller")
        work = ProcessWork()
        link = GraphLink(process, vehicle.columns, announces=True)
        try:
            with keyboard() as pressed:
                process.start("; any key ends the run" if pressed else "")
                link.poses.discard()

                def stopped() -> bool:
                    if rivals := process.graph.publishers(process.topics.command):
                        cause = f"{process.graph.describe(rivals[0])} publishes commands, too"
                        raise Ended(Finding("control", cause, "", "End it, and start again."))
                    return process.interrupted or bool(pressed and pressed())

                given: dict[str, Any] = {"table": table, "seed": seed, "tell": tell}
                given |= {"stopped": stopped, "work": work, "early": EARLY}
                return commission(link, vehicle, out, **given)
        finally:
            work.close()
