"""Progress of long calls."""

import builtins
import sys
import time

#: Time between two lines [s].
_SILENCE = 10.0


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
