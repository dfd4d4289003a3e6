"""The operator's keys, read without waiting."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from collections.abc import Iterator


class Keyboard:
    """Keys pressed on a terminal; none where standard input is no terminal."""

    def __init__(self, file: int | None) -> None:
        self._file = file

    @property
    def listens(self) -> bool:
        """Whether there is a terminal to press keys on."""
        return self._file is not None

    def pressed(self) -> str:
        """Return the keys pressed since the last call."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return ""
        keys = os.read(self._file, 64).decode(errors="replace")
        if not keys:
            self._file = None
        return keys


@contextlib.contextmanager
def keyboard() -> Iterator[Keyboard]:
    """Let keys through as they are pressed, if standard input is a terminal."""
    # A process in the background would be stopped for reading.
    if not sys.stdin or not sys.stdin.isatty() or os.tcgetpgrp(0) != os.getpgrp():
        yield Keyboard(None)
        return
    import termios
    import tty

    file = sys.stdin.fileno()
    before = termios.tcgetattr(file)
    try:
        tty.setcbreak(file)
        yield Keyboard(file)
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)
