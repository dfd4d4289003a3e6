"""Commands by when they begin to act."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from jaxtyping import Float

Command = Float[np.ndarray, " n"]


class HeldCommands:
    """Motor commands, each in force until the next one begins to act."""

    def __init__(self, idle: Command) -> None:
        self._begun: deque[tuple[float, Command]] = deque([(-math.inf, idle)])

    def __len__(self) -> int:
        return len(self._begun)

    def add(self, begins: float, command: Command) -> None:
        """Note the command that was sent last."""
        # Those that would begin later, but were sent before, had wrong times.
        while self._begun and self._begun[-1][0] >= begins:
            self._begun.pop()
        self._begun.append((begins, np.array(command, dtype=float)))

    def drop(self, time: float) -> None:
        """Drop commands older than the command that acts at a time."""
        while len(self._begun) > 1 and self._begun[1][0] <= time:
            self._begun.popleft()

    def until(self, time: float) -> list[tuple[float, Command]]:
        """Return those that have begun to act by a time, with their beginnings."""
        return [entry for entry in self._begun if entry[0] <= time]

    def cut(self, start: float, stop: float) -> list[tuple[float, Command]]:
        """Cut a time where commands change; return durations [s] and commands of the pieces."""
        pieces, now, acting = [], start, self._begun[0][1]
        for begins, command in self._begun:
            if begins > stop:
                break
            if begins > now:
                pieces.append((begins - now, acting))
                now = begins
            acting = command
        return [*pieces, (stop - now, acting)]
