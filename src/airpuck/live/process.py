"""What the live processes share: an orderly end, real-time care, one of a kind."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import time
from collections.abc import Iterator

from airpuck.boundary.errors import InputError
from airpuck.live.domain import LEASE
from airpuck.live.graph import SENSOR, Graph
from airpuck.recording.message import StreamCodec

#: Time for discovery to find who is there, before one may say that nobody is [s].
_LOOK_AROUND = 0.6
#: Priority above ordinary processes, below the system's own.
_PRIORITY = 10


class Ending:
    """Says when to end: on Ctrl-C, on SIGTERM, or after a while."""

    def __init__(self) -> None:
        self.asked = False

    def _ask(self, *_: object) -> None:
        self.asked = True


@contextlib.contextmanager
def orderly() -> Iterator[Ending]:
    """Turn SIGINT and SIGTERM into a question that a loop asks."""
    ending = Ending()
    before = {number: signal.signal(number, ending._ask) for number in _SIGNALS}
    try:
        yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def hurry() -> None:
    """Ask the system to let this process run first; where it may not, it does without."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


@contextlib.contextmanager
def unhurried() -> Iterator[None]:
    """Let others run first for a while: what is compiled meanwhile must not keep them waiting."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except (OSError, AttributeError):
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, *before)


def settle_memory() -> None:
    """Keep the garbage collector from looking through everything that was made so far."""
    gc.collect()
    gc.freeze()


def refuse_second(graph: Graph, topic: str, codec: StreamCodec, what: str) -> None:
    """See that nobody else publishes on a topic."""
    heard = graph.subscription(topic, codec.msgtype, codec.types, SENSOR)
    start = time.monotonic()
    while (others := graph.publishers(topic)) or graph.age < _LOOK_AROUND:
        silent = time.monotonic() - start
        if others and (heard.take() or silent > LEASE + 1.0):
            raise InputError(
                f"there is another {what} already: {graph.describe(others[0])}; end it first, or "
                "take another --domain",
                field=topic,
            )
        time.sleep(0.02)
