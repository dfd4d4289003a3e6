"""Long calls: their progress, and signals that end them: Ctrl-C, SIGTERM, a closed terminal.

One handler serves the whole life of the command line. Before a command begins and after it has
ended, nothing needs to be tidied up, and the handler ends the process. While a command runs, it
raises `Stopped`, so that temporary files are removed on the way out.
"""

from __future__ import annotations

import builtins
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn

#: Exit status of a process ended by a signal, minus the signal's number.
SIGNALLED = 128
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: After this time a signal that could not be raised is sent again [s].
_AGAIN = 0.01
#: Functions that load a library in C++, which aborts the process at an exception.
_LOADERS = ("ExtensionFileLoader.create_module", "ExtensionFileLoader.exec_module")
#: Time between two lines [s].
_SILENCE = 10.0


class Stopped(KeyboardInterrupt):
    """A signal has arrived; `words` describe what the work leaves behind."""

    def __init__(self, number: int, words: str = "") -> None:
        super().__init__(number, words)
        self.number, self.words = number, words


class _Pending:
    """What the handler has done."""

    #: Whether a command runs, and the handler raises.
    raises = False
    #: The signal that was raised and not yet handled.
    number: int | None = None


def catch_signals() -> None:
    """Install the handler, unless a signal is ignored, as in a background shell."""
    for number in SIGNALS:
        if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
            signal.signal(number, stop)


def stop(number: int, frame: Any = None) -> None:
    """Handle a signal: raise `Stopped` while a command runs, otherwise end the process."""
    if not _Pending.raises:
        _end(number)
    while frame is not None:
        if frame.f_code.co_qualname in _LOADERS:
            _again(number)
            return
        frame = frame.f_back
    _Pending.number = number
    raise Stopped(number)


def _end(number: int) -> NoReturn:
    with suppress(OSError):
        os.write(2, b"airpuck: interrupted\n")
    os._exit(SIGNALLED + number)


def _again(number: int) -> None:
    threading.Timer(_AGAIN, os.kill, (os.getpid(), number)).start()


def check_stopped() -> None:
    """Raise `Stopped` again if a library has dropped it, as IPOPT does."""
    if _Pending.number is not None:
        raise Stopped(_Pending.number)


def stopped_by() -> int | None:
    """Return the number of the signal that was raised and not yet handled."""
    return _Pending.number


def forget_stopped() -> None:
    """Count the last signal as handled."""
    _Pending.number = None


@contextmanager
def until_stopped() -> Iterator[None]:
    """Let a signal end the block, but not what follows: the usual end of a session."""
    with suppress(KeyboardInterrupt):
        yield
    forget_stopped()


@contextmanager
def stoppable() -> Iterator[None]:
    """Let signals raise `Stopped` in this block.

    Signals that are ignored, or that other code handles, stay that way.
    """
    usual = (signal.default_int_handler, signal.SIG_DFL, stop)
    here = threading.current_thread() is threading.main_thread()
    before = {number: signal.getsignal(number) for number in SIGNALS if here}
    taken = {number: handler for number, handler in before.items() if handler in usual}
    hook = sys.unraisablehook

    def again(lost: Any) -> None:
        # Python drops exceptions raised in a destructor or by the garbage collector, where JAX has
        # a callback.
        if isinstance(lost.exc_value, Stopped):
            _again(lost.exc_value.number)
        else:
            hook(lost)

    sys.unraisablehook = again
    _Pending.raises, _Pending.number = True, None
    for number in taken:
        signal.signal(number, stop)
    try:
        yield
        check_stopped()
    finally:
        _Pending.raises = False
        for number, handler in taken.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook


class Progress:
    """Prints a line on standard error every ten seconds, if that is a terminal or a notebook."""

    def __init__(self) -> None:
        self.began = time.monotonic()
        self._due = self.began + _SILENCE

    def __call__(self, line: object) -> None:
        """Print a line if it is time."""
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + _SILENCE
        if sys.stderr.isatty() or hasattr(builtins, "__IPYTHON__"):
            print(line, file=sys.stderr, flush=True)
