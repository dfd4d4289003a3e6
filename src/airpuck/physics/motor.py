"""Motor speed: a first-order lag behind the command (eq. motor_dynamics), stepped exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float


def motor_step(xp: Any, speed: Any, command: Any, duration: Any, time_constant: Any) -> Any:
    """Advance the motor speeds under a constant command, exactly.

    φ(t + h) = u + (φ(t) - u) exp(-h/τ), the solution of eq. motor_dynamics. A time constant of zero
    means a motor that follows at once.
    """
    return command + (speed - command) * lag_decay(xp, duration, time_constant)


def lag_decay(xp: Any, duration: Any, time_constant: Any) -> Any:
    """Return exp(-h/τ), A of eq. dis_motor_dynamics; 0 for τ = 0, with a finite derivative."""
    # No division by zero even in the branch that is not taken: where() hides the value of a NaN,
    # but not its derivative.
    lagging = time_constant > 0
    divisor = xp.where(lagging, time_constant, 1.0)
    return xp.where(lagging, xp.exp(-duration / divisor), 0.0)


def motor_speeds(
    time: Float[np.ndarray, " N"], command: Float[np.ndarray, "N n"], time_constant: float
) -> Float[np.ndarray, "N n"]:
    """Let motors follow held commands.

    Parameters
    ----------
    time : array, shape (N,)
        Sample times [s].
    command : array, shape (N, n)
        Command in force from each sample to the next.
    time_constant : float
        Lag τ ≥ 0 [s].

    Returns
    -------
    array, shape (N, n)
        Normalised motor speeds, at the first sample equal to the command.
    """
    # φ' = d φ + (1 - d) u over one step, over two, over four, …: composed until the initial speeds
    # no longer matter.
    decay = np.concatenate([[0.0], lag_decay(np, np.diff(time), time_constant)])[:, None]
    speed = np.concatenate([command[:1], (1 - decay[1:]) * command[:-1]])
    steps = 1
    while steps < len(time) and decay.any():
        speed[steps:] += decay[steps:] * speed[:-steps]
        decay[steps:] = decay[steps:] * decay[:-steps]
        steps *= 2
    return speed
