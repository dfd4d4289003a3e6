"""The world as a controller sees it: measurements come, commands go."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.data.measurement import Measurement


@runtime_checkable
class Link(Protocol):
    """A connection to a craft, simulated or real."""

    @property
    def now(self) -> float:
        """The present, on the controller's clock [s]."""
        ...

    def wait_until(self, time: float) -> list[Measurement]:
        """Let time pass.

        Parameters
        ----------
        time : float
            When to return [s].

        Returns
        -------
        list of Measurement
            Those that have arrived since the last call, in the order of their arrival.
        """
        ...

    def send(self, command: Float[np.ndarray, " n"]) -> None:
        """Send a command now.

        Parameters
        ----------
        command : array, shape (n,)
            Motor commands.
        """

    def announce(self, reference: Float[np.ndarray, " 6"]) -> None:
        """Publish what the craft is asked to do.

        Parameters
        ----------
        reference : array, shape (6,)
            x, y, yaw and their rates.
        """
