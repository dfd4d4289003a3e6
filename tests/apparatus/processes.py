"""Real processes of airpuck, and a watcher of their messages."""

import os
import pty
import signal
import subprocess
import sys
import time
from collections import defaultdict
from typing import Any

from airpuck.live.graph import Graph
from airpuck.live.process import EVENTS
from airpuck.live.record import Heard, Listener
from airpuck.recording.message import HOLOHOVER_MOTORS, MessageCodec, StreamCodec

POSES, COMMANDS, REFERENCES = "/optitrack/drone/pose", "/drone/control", "/control/state_ref"
CODECS = {
    POSES: StreamCodec("pose"),
    COMMANDS: StreamCodec("command", HOLOHOVER_MOTORS),
    REFERENCES: StreamCodec("reference"),
}
EVENT = MessageCodec(EVENTS.msgtype)
IDLE = 0.03
_MAIN = "from airpuck.cli import main; main()"
#: Makes the terminal on standard input the session's controlling terminal.
_TAKE_TERMINAL = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "


class Process:
    """A running command of airpuck."""

    def __init__(self, *arguments: object, domain: int, terminal: bool = False) -> None:
        #: The operator's end of the terminal that it runs on.
        self.keys, inside = pty.openpty() if terminal else (None, subprocess.DEVNULL)
        code = _TAKE_TERMINAL * terminal + _MAIN
        self._process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments), "--domain", str(domain)],
            stdin=inside,
            start_new_session=terminal,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "JAX_PLATFORMS": "cpu"},
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def press(self, key: str) -> None:
        assert self.keys is not None
        os.write(self.keys, key.encode())

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def end(self, timeout: float = 30.0) -> tuple[int, str, str]:
        """Return the exit status and the output."""
        out, err = self._process.communicate(timeout=timeout)
        return self._process.returncode, out, err

    def kill(self) -> None:
        """Kill it, even if it is stopped."""
        if self.alive:
            self._process.kill()
        self._process.communicate()


class Watch:
    """Receives everything on a domain."""

    def __init__(self, domain: int) -> None:
        self.graph = Graph("watch", domain=domain)
        self._listener = Listener(self.graph)
        self.heard: dict[str, list[Heard]] = defaultdict(list)
        self._told: list[Any] = []

    def run(self, seconds: float) -> None:
        """Listen for a while."""
        stop = time.monotonic() + seconds
        while (left := stop - time.monotonic()) > 0:
            for message in self._listener.listen(min(left, 0.02)):
                self.heard[message.first.topic].append(message)
                if message.first.topic == EVENTS.name:
                    self._told.append(EVENT.decode(message.data))

    def until(self, condition, timeout: float = 30.0):
        """Listen until a condition holds; return its value."""
        stop = time.monotonic() + timeout
        while not (found := condition()):
            assert time.monotonic() < stop, f"it did not happen; events: {self.events()}"
            self.run(0.02)
        return found

    def forget(self) -> None:
        """Discard everything received until now."""
        self.run(0.02)
        self.heard.clear()
        self._told.clear()

    def events(self, name: str = "") -> list[str]:
        """Return the events of all processes, or of those with a name."""
        return [event.msg for event in self._told if name in event.name]

    def said(self, text: str) -> bool:
        """Return whether an event contains these words."""
        return any(text in event for event in self.events())

    def values(self, topic: str) -> list:
        """The numbers of each message on a topic."""
        return [CODECS[topic].decode(message.data)[1] for message in self.heard[topic]]

    def newest(self, topic: str):
        """The numbers of the last message on a topic."""
        return CODECS[topic].decode(self.heard[topic][-1].data)[1]

    def stamps(self, topic: str) -> list[float]:
        """The time in each message's header [s]."""
        return [CODECS[topic].decode(message.data)[0] / 1e9 for message in self.heard[topic]]

    def sent(self, topic: str) -> list[float]:
        """When each message was sent, by its sender [s]."""
        return [message.sent_ns / 1e9 for message in self.heard[topic]]

    def close(self) -> None:
        self.graph.close()


def until(condition, timeout=10.0):
    """Wait until a condition holds."""
    stop = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < stop, "it did not happen"
        time.sleep(0.01)
