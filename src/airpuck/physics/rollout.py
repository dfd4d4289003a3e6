"""Multi-step prediction of a batch of windows, by eq. extended_model_dynamics.

The rigid body is integrated with the explicit Runge-Kutta method of fourth order, as in the paper.
The motors are independent of the body, so their exact solution at the stage times is used.
"""

from __future__ import annotations

from typing import Any

from airpuck.compute.arrays import scan
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration


def step(xp: Any, dynamics: Dynamics, state: Any, command: Any, duration: Any) -> Any:
    """Advance the extended state under a constant command by one Runge-Kutta step."""
    h, tau, idle = duration, dynamics.motor_time_constant, dynamics.idle_lag
    # A motor without lag has its new speed from the start of the step.
    begin = xp.where(tau > 0, state[6:], command)
    middle = motor_step(xp, begin, command, h / 2, tau, idle)
    end = motor_step(xp, begin, command, h, tau, idle)

    def rates(motion: Any, motor_speed: Any) -> Any:
        return xp.stack([motion[3], *acceleration(xp, dynamics, motion, motor_speed)])

    motion = state[2:6]
    k1 = rates(motion, begin)
    k2 = rates(motion + h / 2 * k1, middle)
    k3 = rates(motion + h / 2 * k2, middle)
    k4 = rates(motion + h * k3, end)
    # Nothing depends on the position, so its stages are sums of the velocity's stages.
    position = state[:2] + h * motion[1:3] + h**2 / 6 * (k1 + k2 + k3)[1:3]
    return xp.concatenate([position, motion + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), end])


def rollout(xp: Any, dynamics: Dynamics, state: Any, commands: Any, durations: Any) -> Any:
    """Predict a batch of windows.

    Parameters
    ----------
    xp : module
        numpy or jax.numpy.
    dynamics : Dynamics
        Coefficients.
    state : array, shape (6 + n, ...)
        Extended states to start from.
    commands : array, shape (T, n, ...)
        Command in force over each step.
    durations : array, shape (T, ...)
        Duration of each step [s].

    Returns
    -------
    array, shape (T, 6 + n, ...)
        Extended state at the end of each step.
    """

    def advance(state: Any, held: tuple[Any, Any]) -> tuple[Any, Any]:
        state = step(xp, dynamics, state, *held)
        return state, state

    return scan(xp, advance, state, (commands, durations))[1]
