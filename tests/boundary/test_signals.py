"""Signals end a command in one line, whatever it is doing."""

import contextlib
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from airpuck.boundary.signals import Stopped, forget_stopped, stop, stoppable, until_stopped


@pytest.fixture(autouse=True)
def handled():
    """Let no later test of this process find a signal that is still to be handled."""
    yield
    forget_stopped()


class Interrupted:
    """A signal arrives in a destructor, where Python drops exceptions."""

    def __init__(self, number: signal.Signals) -> None:
        self._number = number

    def __del__(self) -> None:
        signal.raise_signal(self._number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("lost", [False, True])
def test_signals_stop_a_command_even_if_python_drops_the_first(number, lost):
    before = signal.getsignal(number)
    with pytest.raises(Stopped) as stopped, stoppable():
        if lost:
            Interrupted(number)
            time.sleep(5.0)
        signal.raise_signal(number)
    assert stopped.value.number == number
    assert signal.getsignal(number) is before


def test_existing_signal_handlers_are_kept():
    heard = []
    usual = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    ignored = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with stoppable():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGINT, usual)
        signal.signal(signal.SIGTERM, ignored)
    assert heard == [1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_signal_between_commands_ends_the_process_with_one_line(number, when):
    code = (
        "import signal, sys\n"
        "from airpuck.boundary.signals import catch_signals, stoppable\n"
        "catch_signals()\n"
        f"if {when == 'after'}:\n    with stoppable(): pass\n"
        f"signal.raise_signal({int(number)})\n"
        "print('goes on')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (128 + number, "")
    assert done.stderr == "airpuck: interrupted\n"


def test_a_signal_that_a_library_swallows_still_ends_the_command():
    with pytest.raises(Stopped) as stopped, stoppable(), contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    assert stopped.value.number == signal.SIGTERM


def test_a_session_ended_by_a_signal_is_not_a_failure():
    with stoppable():
        with until_stopped():
            signal.raise_signal(signal.SIGHUP)
            raise AssertionError("goes on")
        ended = True
    assert ended


def test_no_signal_is_raised_while_a_native_library_loads():
    code = SimpleNamespace(co_qualname="ExtensionFileLoader.create_module")
    loading = SimpleNamespace(f_code=code, f_back=None)
    inner = SimpleNamespace(f_code=SimpleNamespace(co_qualname="Any.thing"), f_back=loading)
    loaded = False
    with pytest.raises(Stopped), stoppable():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        stop(signal.SIGINT, inner)
        loaded = True
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        time.sleep(5.0)
    assert loaded
