"""Encoders: from the past of a window to the initial state of a prediction (subsec:encoder)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from airpuck.boundary.arguments import checked_class
from airpuck.compute.arrays import scan
from airpuck.data.windows import Past
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics


@runtime_checkable
class Encoder(Protocol):
    """Estimates initial states of predictions from the past of a batch of windows."""

    @property
    def name(self) -> str:
        """The encoder's name on the command line."""
        ...

    @property
    def causal(self) -> bool:
        """Whether it uses only measurements up to the present."""
        ...

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate the initial state and the dynamics for a prediction."""
        ...


@runtime_checkable
class StateEncoder(Encoder, Protocol):
    """An encoder that does not change the model, so that a model can be learned with it.

    Examples
    --------
    >>> isinstance(airpuck.PaperEncoder(), airpuck.StateEncoder)
    True
    """

    def encode(self, xp: Any, dynamics: Dynamics, past: Past) -> Any:
        """Estimate the state.

        Parameters
        ----------
        xp : module
            Array namespace.
        dynamics : Dynamics
            Coefficients of the craft.
        past : Past
            Measurements and commands up to the start of a prediction.

        Returns
        -------
        array, shape (6 + n, ...)
            x, y, γ, their rates and the motors' speeds.
        """
        ...


@checked_class
@dataclass(frozen=True)
class PaperEncoder:
    """The encoder of the paper: measured pose, smoothed velocities, motors lagging the commands.

    Motor speeds start at the first command of the window and follow the later ones.

    Attributes
    ----------
    indexing : {"start", "end"}
        Which command is in force between two samples: the one held at the interval's start, as in
        the rollout, or the one at its end, as in the code behind the published numbers.

    Examples
    --------
    >>> encoder = airpuck.PaperEncoder()
    >>> airpuck.evaluate(model, trajectory, encoder=encoder).encoder
    'paper'
    """

    indexing: Literal["start", "end"] = "start"
    #: The encoder's name on the command line.
    name = "paper"
    #: The smoothed velocities look a few samples ahead.
    causal = False

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate the initial state and the dynamics; see `Encoder.begin`."""
        return self.encode(np, dynamics, past), dynamics

    def encode(self, xp: Any, dynamics: Dynamics, past: Past) -> Any:
        """Estimate the state; see `StateEncoder.encode`."""
        commands = past.command[:-1] if self.indexing == "start" else past.command[1:]

        def follow(speed: Any, held: tuple[Any, Any]) -> tuple[Any, Any]:
            speed = motor_step(xp, speed, *held, dynamics.lag, dynamics.idle_lag)
            return speed, speed[:0]

        speed, _ = scan(xp, follow, past.command[0], (commands, past.duration))
        return xp.concatenate([past.state[-1], speed])
