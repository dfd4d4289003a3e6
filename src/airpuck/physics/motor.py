"""Motor speed: a first-order lag behind the command (eq. motor_dynamics), stepped exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

#: Speed over which the additional lag of idling motors fades.
IDLE = 0.1
#: Number of iterations after which speeds of idling motors have settled, and the tolerance.
_MOST_PASSES, _SETTLED = 50, 1e-9
#: Motors with a shorter lag follow at once: the ratio of a period to it would overflow [s].
_NO_LAG = 1e-12


def motor_step(
    xp: Any, speed: Any, command: Any, duration: Any, time_constant: Any, idle_lag: Any = None
) -> Any:
    """Advance the motor speeds under a constant command.

    φ(t + h) = u + (φ(t) - u) exp(-h/τ), the solution of eq. motor_dynamics. A time constant of zero
    means a motor that follows at once. If the lag depends on the speed
    (`airpuck.physics.effects.IdleLag`), the lag at the middle of the step is used, which is of
    second order.
    """
    if idle_lag is not None:
        time_constant = _lag_within(xp, speed, command, duration, time_constant, idle_lag)
    time_constant = lag_like(speed, time_constant)
    return command + (speed - command) * lag_decay(xp, duration, time_constant)


def _lag_within(
    xp: Any, speed: Any, command: Any, duration: Any, time_constant: Any, idle_lag: Any
) -> Any:
    """Return the lag in the middle of a step."""
    decay = lag_decay(xp, duration / 2, lag_at(xp, speed, time_constant, idle_lag))
    return lag_at(xp, command + (speed - command) * decay, time_constant, idle_lag)


def lag_at(xp: Any, speed: Any, time_constant: Any, idle_lag: Any = None) -> Any:
    """Return τ(φ) = τ (1 + c exp(-φ/0.1)), the lag at a speed; τ if c is None."""
    time_constant = lag_like(speed, time_constant)
    if idle_lag is None:
        return time_constant
    return time_constant * (1 + idle_lag * xp.exp(-speed / IDLE))


def lag_decay(xp: Any, duration: Any, time_constant: Any) -> Any:
    """Return exp(-h/τ), A of eq. dis_motor_dynamics; 0 for τ = 0, with a finite derivative."""
    if _symbolic(time_constant):
        return xp.exp(-duration / time_constant)
    # Avoid a division by zero even in the unused branch: where() hides a NaN value, but not its
    # derivative.
    lagging = time_constant > _NO_LAG
    divisor = xp.where(lagging, time_constant, 1.0)
    return xp.where(lagging, xp.exp(-duration / divisor), 0.0)


def all_lags(usual: Any, own_lag: tuple[Any, Any] | None) -> Any:
    """Return the lag of all motors, or of each, (n, 1): usual * shared + own (`Dynamics`).

    Motors of a model without lag have none of their own, either.
    """
    if own_lag is None:
        return usual
    shared, own = own_lag
    return usual * shared + own * lags(usual)


def lag_like(speed: Any, time_constant: Any) -> Any:
    """Return a lag, which may have one row for each motor, in the shape of motor speeds."""
    rows = np.ndim(time_constant) == 2 and np.ndim(speed) == 1
    return time_constant[:, 0] if rows else time_constant


def lags(time_constant: Any) -> Any:
    """Return whether motors lag at all."""
    return True if _symbolic(time_constant) else time_constant > 0


def _symbolic(time_constant: Any) -> bool:
    """Return whether a lag consists of CasADi's symbols, which have no truth value.

    Such a lag is never 0: it is a free parameter, or depends on the speed.
    """
    return getattr(getattr(time_constant, "dtype", None), "hasobject", False)


def motor_speeds(
    time: Float[np.ndarray, " N"],
    command: Float[np.ndarray, "N n"],
    time_constant: float | Float[np.ndarray, ""] | Float[np.ndarray, "n 1"],
    idle_lag: float | Float[np.ndarray, ""] | None = None,
) -> Float[np.ndarray, "N n"]:
    """Simulate motors under held commands.

    Parameters
    ----------
    time : array, shape (N,)
        Sample times [s].
    command : array, shape (N, n)
        Command in force from each sample to the next.
    time_constant : float or array, shape (n, 1)
        Lag τ ≥ 0 of all motors, or of each [s].
    idle_lag : float, optional
        Relative increase of the lag at standstill; see `airpuck.physics.effects.IdleLag`.

    Returns
    -------
    array, shape (N, n)
        Normalised motor speeds; the first sample equals the command.
    """
    duration, time_constant = np.diff(time)[:, None], lag_like(time, time_constant)
    speed = _followed(command, lag_decay(np, duration, time_constant))
    if idle_lag is None:
        return speed
    # Iterate on the lag until it no longer changes: each step then equals `motor_step`.
    for _ in range(_MOST_PASSES):
        before = speed
        lag = _lag_within(np, speed[:-1], command[:-1], duration, time_constant, idle_lag)
        speed = _followed(command, lag_decay(np, duration, lag))
        if np.abs(speed - before).max() < _SETTLED:
            break
    return speed


def _followed(
    command: Float[np.ndarray, "N n"], decays: Float[np.ndarray, "M k"]
) -> Float[np.ndarray, "N n"]:
    """Let speeds decay towards the commands, by a given factor in each step."""
    # One step is φ' = d φ + (1 - d) u. Compose steps into two, four, … until the initial speeds no
    # longer matter.
    decay = np.concatenate([np.zeros_like(decays[:1]), decays])
    speed = np.concatenate([command[:1], (1 - decay[1:]) * command[:-1]])
    steps = 1
    while steps < len(command) and decay.any():
        speed[steps:] += decay[steps:] * speed[:-steps]
        decay[steps:] = decay[steps:] * decay[:-steps]
        steps *= 2
    return speed
