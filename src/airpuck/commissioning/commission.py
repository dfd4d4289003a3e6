"""From the box to a trusted flight: `commission` on any link, `commission_live` on a graph."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Finding, Result
from airpuck.commissioning.excitations import Excitations, WarmUp
from airpuck.commissioning.session import Commissioned, Ended, KeptFlight, Learned, Work
from airpuck.commissioning.steps import CommissioningStep, Hover, Pulses, Rest
from airpuck.compute.process import prioritize
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.flight.loop import Link
from airpuck.judgement.study import Study, study
from airpuck.live.fly import EARLY, GraphLink, keyboard
from airpuck.live.process import Process
from airpuck.live.settings import LiveSettings
from airpuck.model.model_file import Model
from airpuck.recording.bag import write_bag


@dataclass(frozen=True, eq=False)
class Commissioning(Result):
    """What a run has learned, and whether its model is trusted.

    Attributes
    ----------
    outcome : str
        ``trusted``, or the kind of the first finding against it.
    findings : tuple of Finding
        Why the run ended without a trusted model (first cause), and what was corrected.
    given, vehicle : Vehicle
        The craft as stated, and as flown: corrected.
    table : Table
        The table.
    model : Model or None
        The last identified model.
    study : Study or None
        The last study.
    flights : tuple of KeptFlight
        All flights.
    steps : tuple of Learned
        What each step found.
    flight_s : float
        Seconds with motors on.
    wall_s : float
        Seconds in all.

    Examples
    --------
    >>> from airpuck.commissioning.steps import Rest
    >>> found = airpuck.commission(airpuck.Twin(model), model.vehicle, steps=[Rest()])
    >>> isinstance(found, airpuck.Commissioning), found.outcome
    (True, 'not_trusted')
    """

    JSON = "outcome flight_s wall_s steps findings"

    outcome: str
    findings: tuple[Finding, ...]
    given: Vehicle
    table: Table
    vehicle: Vehicle
    model: Model | None
    study: Study | None
    flights: tuple[KeptFlight, ...]
    steps: tuple[Learned, ...]
    flight_s: float
    wall_s: float

    @property
    def trusted(self) -> bool:
        """Whether the model may be flown."""
        return self.outcome == "trusted"

    @property
    def sentences(self) -> list[str]:
        """The outcome in words, and what to type next."""
        if not self.trusted:
            return [finding.sentence for finding in self.findings]
        assert self.study is not None
        corrections = [f"Corrected: {finding.cause}." for finding in self.findings]
        took = f"{self.flight_s:.1f} s of flight, {self.wall_s:.0f} s in all."
        return [*self.study.verdict.sentences[:1], took, *corrections]


#: From a craft at rest to a trusted model.
STEPS: tuple[CommissioningStep, ...] = (WarmUp(), Rest(), Pulses(), Hover(), Excitations())


def commission(
    link: Link,
    vehicle: Vehicle,
    out: str | os.PathLike[str] | None = None,
    *,
    table: Table | None = None,
    steps: Sequence[CommissioningStep] | None = None,
    seed: int = 0,
    tell: Callable[[str], object] = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
    work: Work | None = None,
    early: float = 0.0,
) -> Commissioning:
    """Fly a craft from the box until a model of it is trusted.

    Parameters
    ----------
    link : Link
        The craft, at rest near the middle of the table.
    vehicle : Vehicle
        The craft with rough numbers.
    out : path-like, optional
        Folder for the recordings, ``model.toml`` and a corrected ``vehicle.toml``.
    table : Table, optional
        Table with the rails; by default the paper's.
    steps : sequence of CommissioningStep, optional
        By default `STEPS`: warm-up, rest, pulses, hover, excitations.
    seed : int, default 0
        Seed of the excitations.
    tell : callable, optional
        Receives a line about each step.
    stopped : callable, optional
        Polled every period; returns whether the operator wants the run to end.
    work : Work, optional
        How to compute while the craft flies; by default computing time passes on the link's clock.
    early : float, default 0
        Poses are processed until this long before a command is due [s].

    Returns
    -------
    Commissioning
        The model, all flights, and the first cause if it is not trusted.

    Examples
    --------
    The first step alone, without motors; without `steps` the run takes a minute or two:

    >>> from airpuck.commissioning.steps import Rest
    >>> found = airpuck.commission(airpuck.Twin(model), model.vehicle, steps=[Rest()])
    >>> found.trusted, [one.step for one in found.steps]
    (False, ['rest'])
    """
    begun = time.monotonic()
    given = seed, tell, stopped, work or Work(), early
    session = Commissioned(link, vehicle, table or Table(), *given)
    ended: Finding | None = None
    try:
        for step in STEPS if steps is None else steps:
            step.run(session)
    except Ended as end:
        ended = end.finding
    except InputError as error:
        ended = Finding("control", error.problem, "", "Check the layout in the vehicle file.")
    finally:
        # Writing takes longer than a command may be missing: the craft lands first.
        session.land()
        for flight in session.flights if out is not None else ():
            write_bag(flight.recording, Path(out or "") / "flights" / flight.name)
    if ended is not None:
        session.note("end", ended.sentence)
    trusted = ended is None and session.study is not None and session.study.verdict.trusted
    found = Commissioning(
        "trusted" if trusted else "not_trusted" if ended is None else ended.kind,
        (*(() if ended is None else (ended,)), *session.findings),
        vehicle,
        session.table,
        session.vehicle,
        None if session.study is None else session.study.model,
        session.study,
        tuple(session.flights),
        tuple(session.learned),
        session.flight_s,
        time.monotonic() - begun,
    )
    if out is not None:
        found.vehicle.save(Path(out) / "vehicle.toml")
        if found.model is not None:
            found.model.save(Path(out) / "model.toml")
    return found


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
    with Process("airpuck commission", settings or LiveSettings()) as process:
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

                return commission(
                    link,
                    vehicle,
                    out,
                    table=table,
                    seed=seed,
                    tell=tell,
                    stopped=stopped,
                    work=work,
                    early=EARLY,
                )
        finally:
            work.close()
