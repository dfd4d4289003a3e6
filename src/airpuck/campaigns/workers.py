"""Items to the workers of a Dask cluster, and results back, whatever becomes of the workers."""

from __future__ import annotations

import contextlib
import logging
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import pydantic

from airpuck.boundary.errors import InputError
from airpuck.campaigns.fingerprint import program
from airpuck.campaigns.items import Item, Row
from airpuck.campaigns.spec import Entry
from airpuck.compute.process import Stopped, stop

#: An item is given up when this many workers have died of it.
DEADLY = 3
#: How long a scheduler may take to answer, and then to have a worker [s].
PATIENCE = 10.0
#: Under which workers tell how far they are.
_TOPIC = "airpuck-progress"
_SETTINGS = {
    # A worker's death is no failure of its item yet.
    "distributed.scheduler.allowed-failures": DEADLY - 1,
    # On a busy machine a worker takes long to start again: no reason to give it up.
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.comm.timeouts.connect": "5m",
    # Dask takes a busy loop in compiled code for a fault, and says so.
    "distributed.admin.tick.limit": "1h",
}


class ItemResult(pydantic.BaseModel):
    """What became of an item; a figure that is not finite is null in its file, and then nan."""

    rows: tuple[Row, ...]
    #: Hash of what it wrote beside them.
    written: str | None = None
    #: Why it failed.
    failure: str | None = None
    #: Time it took, unless its workers died [s].
    wall_s: float | None = None


def dispatch(
    entries: Iterable[Entry],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    tell: Callable[[str, float], None] = lambda key, share: None,
) -> Iterator[tuple[Entry, ItemResult]]:
    """Compute items on workers, and yield each with its result, in any order.

    What they tell of items under way goes to `tell`: key and share done. No more items are under
    way than workers have threads, so that one that kills its worker puts no other under suspicion.
    """
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
    waiting, under_way = iter(entries), {}
    with _noting_interrupts(finished), _client(scheduler, workers) as client:
        client.subscribe_topic(_TOPIC, lambda event: tell(*event[1]))
        while True:
            threads = max(1, sum(client.nthreads().values()))
            while len(under_way) < threads and (entry := next(waiting, None)) is not None:
                told = partial(_tell, entry.key)
                key = f"item-{entry.key}"
                future = client.submit(compute, entry.item, told, key=key, pure=False)
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
    """Put the first Ctrl-C or SIGTERM in the queue; the second raises at once.

    An exception that a signal raises is lost where it comes up in a destructor or in a callback of
    the garbage collector, and Dask has both. A `SimpleQueue` may be put to there.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    # What somebody else handles stays so.
    taken = [n for n, h in before.items() if h in (signal.default_int_handler, stop)]

    def note(number: int, _frame: Any) -> None:
        signal.signal(number, before[signal.Signals(number)])
        finished.put(Stopped(number, "run it again for what is missing"))

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
        rows = tuple(item.told(tell).run())
        written = item.written()
    except Exception as error:
        failure = _described(error)
    wall = time.perf_counter() - started
    return ItemResult(rows=rows, written=written, failure=failure, wall_s=wall)


def _tell(key: str, share: float) -> None:
    """Tell, on a worker, which share of an item is done."""
    from distributed import get_worker

    get_worker().log_event(_TOPIC, (key, share))


def _described(error: BaseException) -> str:
    """Describe an error, with its type where the message is not written for users."""
    if isinstance(error, (InputError, ArithmeticError)):
        return str(error)
    # Compilers write many lines.
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _result(future: Any) -> ItemResult:
    """Take a result, or find out why there is none."""
    from distributed.scheduler import KilledWorker

    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise InputError("the scheduler went away; run again for the rest", field="--scheduler")
    error = future.exception()
    why = _described(error)
    if isinstance(error, KilledWorker):
        why = f"its worker died {DEADLY} times (out of memory, a crash, a kill)"
    return ItemResult(rows=(), failure=why)


@contextlib.contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start one."""
    try:
        from dask import config
        from distributed import Client
    except ImportError:
        raise InputError("campaigns need Dask: pip install distributed") from None
    local: dict[str, Any] = {"n_workers": workers, "threads_per_worker": 1, "processes": True}
    local |= {"dashboard_address": None, "silence_logs": logging.CRITICAL}
    with config.set(_SETTINGS):
        if scheduler is None:
            with Client(**local) as client:
                client.register_worker_callbacks(setup=_ignore_interrupts)
                yield client
            return
        try:
            client = Client(scheduler, timeout=PATIENCE)
        except (OSError, ValueError) as error:
            raise _unusable(scheduler, f"no Dask scheduler answers there ({error})") from error
        with client:
            _check_workers(client, scheduler)
            yield client


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which stops its workers: a terminal sends it to all."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_workers(client: Any, scheduler: str) -> None:
    """Refuse a cluster without workers, or with ones that would compute something else."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
        programs = set(client.run(program).values())
    except TimeoutError as error:
        why = "has no workers; start some, dask worker ADDRESS"
        raise _unusable(scheduler, why) from error
    except ImportError as error:
        raise _unusable(scheduler, f"its workers lack a package ({error})") from error
    if programs != {program()}:
        raise _unusable(scheduler, "its workers run another airpuck; install the same there")


def _unusable(scheduler: str, why: str) -> InputError:
    """Name the scheduler in what is refused."""
    return InputError(why, file=scheduler, field="--scheduler")
