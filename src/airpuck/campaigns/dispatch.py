"""Items to the workers of a Dask cluster, and results back, whatever becomes of the workers."""

from __future__ import annotations

import contextlib
import logging
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.campaigns.item import Entry, Item
from airpuck.campaigns.results import Result

#: An item is given up when this many workers have died of it.
DEADLY = 3
#: How long a scheduler may take to answer, and then to have a worker [s].
PATIENCE = 10.0
#: What stands for Ctrl-C among finished items.
_INTERRUPT = None


def dispatch(
    entries: Iterable[Entry],
    done: Callable[[Entry, Result], None],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> None:
    """Compute items on workers, in any order.

    No more items are under way than workers have threads, so that one that kills its worker puts
    no other under suspicion.
    """
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
    with _noting_interrupts(finished), _client(scheduler, workers) as client:
        waiting, under_way = iter(entries), {}

        def submit() -> None:
            room = max(1, sum(client.nthreads().values())) - len(under_way)
            # Not zip(range(room), waiting): it would take one item too many.
            for _ in range(room):
                entry = next(waiting, None)
                if entry is None:
                    return
                future = client.submit(compute, entry.item, key=f"item-{entry.key}", pure=False)
                under_way[future.key] = entry
                future.add_done_callback(finished.put)

        submit()
        while under_way:
            future = finished.get()
            if future is _INTERRUPT:
                raise KeyboardInterrupt
            done(under_way.pop(future.key), _result(future))
            future.release()
            submit()
        if not finished.empty():
            raise KeyboardInterrupt


@contextlib.contextmanager
def _noting_interrupts(finished: queue.SimpleQueue[Any]) -> Iterator[None]:
    """Put the first Ctrl-C in the queue; the second raises at once, as ever.

    An exception that a signal raises can come up anywhere, and is lost in destructors and in
    callbacks of the garbage collector, of which Dask has both. This queue may be put to in between.
    """
    as_ever = signal.default_int_handler
    here = threading.current_thread() is threading.main_thread()
    if not here or signal.getsignal(signal.SIGINT) is not as_ever:
        # Signals are somebody else's business.
        yield
        return

    def note(_number: int, _frame: Any) -> None:
        signal.signal(signal.SIGINT, as_ever)
        finished.put(_INTERRUPT)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, as_ever)


def compute(item: Item) -> Result:
    """Compute one item; runs on a worker."""
    started = time.perf_counter()
    try:
        rows = tuple(item.run())
    except (InputError, ArithmeticError) as error:
        return Result((), " ".join(str(error).split()), time.perf_counter() - started)
    return Result(rows, wall_s=time.perf_counter() - started)


def _result(future: Any) -> Result:
    """Take a result, or find out why there is none."""
    from distributed.scheduler import KilledWorker

    if future.status == "finished":
        return future.result()
    if future.status == "error":
        error = future.exception()
        if isinstance(error, KilledWorker):
            why = f"its worker died {DEADLY} times (out of memory, a crash, a kill)"
            return Result((), why)
        told = " ".join(str(error).split())
        return Result((), f"{type(error).__name__}: {told}")
    raise InputError("the scheduler went away; run again for the rest", field="--scheduler")


@contextlib.contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start one."""
    try:
        from dask import config
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "campaigns need Dask: install airpuck with its extra, pip install 'airpuck[campaign]'"
        ) from None
    settings = {
        # A worker's death is no failure of its item yet.
        "distributed.scheduler.allowed-failures": DEADLY - 1,
        # On a busy machine a worker takes long to start again: no reason to give it up.
        "distributed.deploy.lost-worker-timeout": "1h",
        "distributed.comm.timeouts.connect": "5m",
        # Dask takes a busy loop in compiled code for a fault, and says so.
        "distributed.admin.tick.limit": "1h",
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(config.set(settings))
        if scheduler is None:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,  # pyright: ignore[reportArgumentType]
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(cluster)
            client = stack.enter_context(Client(cluster))
            client.register_worker_callbacks(setup=_ignore_interrupts)
            yield client
            return
        try:
            client = stack.enter_context(Client(scheduler, timeout=PATIENCE))
        except (OSError, ValueError) as error:
            raise InputError(
                f"no Dask scheduler answers there ({error})", file=scheduler, field="--scheduler"
            ) from error
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise InputError(
                "has no workers; start some, dask worker ADDRESS",
                file=scheduler,
                field="--scheduler",
            ) from error
        _same_version(client, scheduler)
        yield client


def _ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent, which stops its workers: a terminal sends it to all."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _version() -> str:
    return __version__


def _same_version(client: Any, scheduler: str) -> None:
    """Refuse workers that would compute something else, or nothing."""
    try:
        versions = set(client.run(_version).values())
    except ImportError as error:
        raise InputError(
            f"its workers lack a package ({error})", file=scheduler, field="--scheduler"
        ) from error
    if versions - {__version__}:
        raise InputError(
            f"its workers have airpuck {', '.join(sorted(versions))}, here it is {__version__}",
            file=scheduler,
            field="--scheduler",
        )
