"""Run items on the workers of a Dask cluster, and survive the death of workers."""

from __future__ import annotations

import contextlib
import logging
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import pydantic

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, explained, installed
from airpuck.boundary.signals import SIGNALS, Stopped, stop
from airpuck.campaigns.fingerprints import program
from airpuck.campaigns.items import Item, Row
from airpuck.compute.process import usable_cores

#: Number of dead workers after which an item counts as failed.
DEADLY = 3
#: Timeout for the scheduler to answer, and then to have a worker [s].
PATIENCE = 10.0
#: Dask topic of progress events.
_TOPIC = "airpuck-progress"
_SETTINGS = {
    # Dask retries an item after a worker's death.
    "distributed.scheduler.allowed-failures": DEADLY - 1,
    # On a busy machine a worker may take long to restart.
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.comm.timeouts.connect": "5m",
    # Dask would warn about long runs of compiled code.
    "distributed.admin.tick.limit": "1h",
}


@dataclass(frozen=True)
class Entry:
    """An item and its place in the campaign."""

    #: Key of the item; equal computations have equal keys in all campaigns.
    key: str
    #: Values from the grid, by dotted field.
    setting: dict[str, Any]
    item: Item


class ItemResult(pydantic.BaseModel):
    """Result of an item; its file holds null for NaN."""

    rows: tuple[Row, ...]
    #: Hash of the other files that the item wrote.
    written: str | None = None
    #: Reason for a failure.
    failure: str | None = None
    #: Computing time, unless its workers died [s].
    wall_s: float | None = None


def checked_workers(workers: int | str | None, jobs: int | None = None) -> int | str | None:
    """Return a number of processes, or the address of a Dask scheduler as it is.

    With a number of `jobs`, there are no more processes than jobs, and by default one per core.
    """
    if isinstance(workers, str):
        if "://" in workers:
            return workers
        try:
            workers = int(workers)
        except ValueError:
            known = f"must be a number, or an address like tcp://HOST:8786, not {workers!r}"
            raise InputError(known, field="workers") from None
    if workers is not None:
        numbers.WORKERS.check(workers, "workers")
    return workers if jobs is None else min(workers or usable_cores(), jobs)


def dispatch(
    entries: Iterable[Entry],
    *,
    workers: int | str | None = None,
    tell: Callable[[str, float], None] = lambda key, share: None,
) -> Iterator[tuple[Entry, ItemResult]]:
    """Compute items on workers, and yield each with its result, in any order.

    `workers` is what `checked_workers` returns.

    Workers report the progress of an item through `tell(key, share)`. There are never more items in
    progress than worker threads, so a worker that dies takes no waiting items with it.
    """
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
    waiting, under_way = iter(entries), {}
    with _noting_interrupts(finished), _client(workers) as client:
        client.subscribe_topic(_TOPIC, lambda event: tell(*event[1]))
        while True:
            threads = max(1, sum(client.nthreads().values()))
            while len(under_way) < threads and (entry := next(waiting, None)) is not None:
                report = partial(_tell, entry.key)
                key = f"item-{entry.key}"
                future = client.submit(compute, entry.item, report, key=key, pure=False)
                under_way[future.key] = entry
                future.add_done_callback(finished.put)
            if not under_way:
                break
            future = finished.get()
            if isinstance(future, Stopped):
                raise future
            yield under_way.pop(future.key), _result(future)
            future.release()
        if not finished.empty():
            raise finished.get()


@contextlib.contextmanager
def _noting_interrupts(finished: queue.SimpleQueue[Any]) -> Iterator[None]:
    """Put the first Ctrl-C, SIGTERM or SIGHUP in the queue; the second raises at once.

    Python drops exceptions that a signal raises in a destructor or in a callback of the garbage
    collector, and Dask has both. `SimpleQueue.put` is safe there.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.getsignal(n) for n in SIGNALS}
    # Handlers installed by other code stay in place.
    taken = [n for n, h in before.items() if h in (signal.default_int_handler, stop)]

    def note(number: int, _frame: Any) -> None:
        signal.signal(number, before[signal.Signals(number)])
        finished.put(Stopped(number, "run it again to compute the rest"))

    for number in taken:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])


def compute(item: Item, tell: Callable[[float], None] = lambda share: None) -> ItemResult:
    """Compute one item; runs on a worker."""
    started, rows, written, failure = time.perf_counter(), (), None, None
    try:
        rows = tuple(item.reporting(tell).run())
        written = item.written()
    except Exception as error:
        failure = _described(error)
    wall = time.perf_counter() - started
    return ItemResult(rows=rows, written=written, failure=failure, wall_s=wall)


def _tell(key: str, share: float) -> None:
    """Report the progress of an item; runs on a worker."""
    from distributed import get_worker

    get_worker().log_event(_TOPIC, (key, share))


def _described(error: BaseException) -> str:
    """Describe an error, with its type unless the message is written for users."""
    if isinstance(error, (InputError, ArithmeticError)):
        return str(error)
    # Messages of compilers have many lines.
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _result(future: Any) -> ItemResult:
    """Return the result of a future, or the reason of its failure."""
    from distributed.scheduler import KilledWorker

    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise InputError("the scheduler went away; run again for the rest", field="workers")
    error = future.exception()
    why = _described(error)
    if isinstance(error, KilledWorker):
        why = f"its worker died {DEADLY} times (out of memory, a crash, a kill)"
    return ItemResult(rows=(), failure=why)


@contextlib.contextmanager
def _client(workers: int | str | None) -> Iterator[Any]:
    """Connect to a cluster, or start one."""
    needs = "campaigns need Dask: pip install 'airpuck[campaign]'"
    with installed(f"{needs} (match and league: or use --workers 1)"):
        from dask import config
        from distributed import Client

    local: dict[str, Any] = {"n_workers": workers, "threads_per_worker": 1, "processes": True}
    local |= {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
    with config.set(_SETTINGS):
        if not isinstance(workers, str):
            with Client(**local) as client:
                client.register_worker_callbacks(setup=_ignore_interrupts)
                yield client
            return
        problem = "no Dask scheduler answers there ({error})"
        with explained((OSError, ValueError), problem, file=workers, field="workers"):
            client = Client(workers, timeout=PATIENCE)
        with client:
            _check_workers(client, workers)
            yield client


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C on a worker; the terminal sends it to all, and the parent stops workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_workers(client: Any, scheduler: str) -> None:
    """Check that a cluster has workers and that they run this version of airpuck."""
    unusable = partial(explained, file=scheduler, field="workers")
    idle = unusable(TimeoutError, "has no workers; start some with `dask worker ADDRESS`")
    with idle, unusable(ImportError, "its workers lack a package ({error})"):
        client.wait_for_workers(1, timeout=PATIENCE)
        programs = set(client.run(program).values())
    if programs != {program()}:
        why = "its workers run another version of airpuck; install this one there"
        raise InputError(why, file=scheduler, field="workers")
