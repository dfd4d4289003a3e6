"""Encoders: from the past of a window to what a prediction starts from (subsec:encoder)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from airpuck.compute.arrays import scan
from airpuck.data.windows import Past
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics


@runtime_checkable
class Encoder(Protocol):
    """Estimates from the past of a batch of windows what their predictions start from."""

    @property
    def name(self) -> str:
        """What it is called on the command line."""
        ...

    @property
    def causal(self) -> bool:
        """Whether it uses nothing that was measured after the present."""
        ...

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate what to predict from, and what with."""
        ...


@runtime_checkable
class StateEncoder(Encoder, Protocol):
    """An encoder that does not change the model, so that a model can be learned with it."""

    def encode(self, xp: Any, dynamics: Dynamics, past: Past) -> Any:
        """Estimate the state."""
        ...


@dataclass(frozen=True)
class PaperEncoder:
    """The encoder of the paper: measured pose, smoothed velocities, motors lagging the commands.

    Motor speeds start at the first command of the window and follow the later ones.

    Attributes
    ----------
    indexing : {"start", "end"}
        Which command is in force between two samples: the one held at the interval's start, as in
        the rollout, or the one at its end, as in the code behind the published numbers.
    """

    indexing: Literal["start", "end"] = "start"

    @property
    def name(self) -> str:
        """What it is called on the command line."""
        return "paper"

    @property
    def causal(self) -> bool:
        """False: the smoothed velocities look some samples ahead."""
        return False

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate what to predict from; see `Encoder.begin`."""
        return self.encode(np, dynamics, past), dynamics

    def encode(self, xp: Any, dynamics: Dynamics, past: Past) -> Any:
        """Estimate the state; see `StateEncoder.encode`."""
        commands = past.command[:-1] if self.indexing == "start" else past.command[1:]

        def follow(speed: Any, held: tuple[Any, Any]) -> tuple[Any, Any]:
            speed = motor_step(xp, speed, *held, dynamics.motor_time_constant, dynamics.idle_lag)
            return speed, speed[:0]

        speed, _ = scan(xp, follow, past.command[0], (commands, past.duration))
        return xp.concatenate([past.state[-1], speed])
