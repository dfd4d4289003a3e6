"""Commands for a craft that airpuck exported to MuJoCo.

The thrust of a motor is a polynomial of its speed φ, but the force of a MuJoCo actuator is linear
in its activation. So each motor has an actuator for each power of φ, named ``NAME``,
``NAME^2``, and so on. `set_command` sets their controls for the next time step, or for a period
of several steps, such that their activations are these powers of φ at its end.

    model = mujoco.MjModel.from_xml_path("craft.xml")
    data = mujoco.MjData(model)
    while data.time < 1.0:
        set_command(model, data, command)
        mujoco.mj_step(model, data)

With the integrators Euler and implicitfast, positions are exact to second order in the time step,
and qvel belongs to the middle of the last step (leap-frog). `set_state` and `get_state` convert.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np


def set_state(model: Any, data: Any, state: Any) -> None:
    """Set x, y, yaw, vx, vy, spin, and the motor speeds if the motors lag."""
    data.qpos[:], data.qvel[:] = state[:3], state[3:6]
    if model.na:
        data.act[:] = np.ravel([np.asarray(state[6:]) ** p for p in _powers(model)])
    mujoco.mj_forward(model, data)  # pyright: ignore[reportAttributeAccessIssue]
    data.qvel[:] -= _half_step(model) * data.qacc


def get_state(model: Any, data: Any) -> np.ndarray:
    """Return x, y, yaw, vx, vy, spin, and the motor speeds if the motors lag."""
    velocities = data.qvel + _half_step(model) * data.qacc
    return np.concatenate([data.qpos, velocities, _speeds(model, data)])


def set_command(model: Any, data: Any, command: Any, period: float | None = None) -> None:
    """Set the controls from the motors' commands in [0, 1], by default for the next time step.

    If you call this once in a control period and then take several steps, give the period [s].
    """
    step = model.opt.timestep
    if model.na and model.nuserdata and data.time > data.userdata[0] + step / 2 > step:
        raise ValueError(
            f"controls for the time until {data.userdata[0]:.6g} s were held until {data.time:.6g} "
            "s; call set_command before each step, or give it the control period"
        )
    held = step if period is None else period
    data.ctrl[:] = controls(model, _speeds(model, data), [command], held)[0]
    if model.nuserdata:
        data.userdata[0] = data.time + held


def controls(model: Any, speeds: Any, commands: Any, period: float | None = None) -> np.ndarray:
    """Return the controls for a sequence of commands, one for each time step (for rollouts).

    The motors begin at `speeds`; without lag these are ignored. With a period [s], there is a
    command for each period instead.
    """
    powers = _powers(model)
    n = model.nu // len(powers)
    u = np.clip(commands, *model.actuator_ctrlrange[:n].T)
    if not model.na:
        return np.hstack([u**p for p in powers])
    held = model.opt.timestep if period is None else period
    decay = np.exp(-held / model.actuator_dynprm[:n, 0])
    path = [np.asarray(speeds)]
    for command in u:
        path.append(command + decay * (path[-1] - command))
    # An activation with time constant τ/p goes from a to c + (a - c) E^p, with E = exp(-h/τ). With
    # the weighted mean c below, it goes from power p of one speed to power p of the next.
    faded, after = decay * np.array(path[:-1]), np.array(path[1:])
    means = []
    for p in powers:
        weights = sum(decay**j for j in range(p))
        means.append(u * sum(after ** (p - 1 - j) * faded**j for j in range(p)) / weights)
    return np.hstack(means)


def _speeds(model: Any, data: Any) -> np.ndarray:
    """Return the motor speeds; none without lag."""
    return data.act[: model.na // len(_powers(model))]


def _half_step(model: Any) -> float:
    """Return the time by which qvel lags behind qpos [s]."""
    exact = mujoco.mjtIntegrator.mjINT_RK4  # pyright: ignore[reportAttributeAccessIssue]
    return 0.0 if model.opt.integrator == exact else model.opt.timestep / 2


def _powers(model: Any) -> range:
    """Return the powers of φ in the thrust curves."""
    return range(1, 1 + int(model.numeric("thrust_degree").data[0]))
