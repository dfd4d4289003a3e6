"""Dynamics as CasADi functions, traced from the package's own equations of motion."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from airpuck.boundary.errors import check_known, installed
from airpuck.compute.arrays import with_symbols
from airpuck.export.kinds import Subject, command_range, refuse_actuators
from airpuck.model.model_file import Model
from airpuck.physics import rigid_body

if TYPE_CHECKING:
    import casadi

#: Names and units of position, yaw and their rates.
_MOTION = {"x": "m", "y": "m", "yaw": "rad", "vx": "m/s", "vy": "m/s", "spin": "rad/s"}


def functions(model: Model, free: Sequence[str] = ()) -> dict[str, casadi.Function]:
    """Return the dynamics of a model as CasADi functions.

    Parameters
    ----------
    model : Model
        The craft, with any effects.
    free : sequence of str
        Names of the parameters that become an argument ``theta``, such as ``thrust``, in the order
        of `Parameters.to_vector`; the others are constants.

    Returns
    -------
    dict of str to casadi.Function
        ``continuous(state, command[, theta])`` returns the rate of the state, and
        ``discrete(state, command, period[, theta])`` the state after a period [s] of a held
        command. Commands are those that reach the motors, so the transport delay is left out.
        States are as for `Model.derivative`.

    Raises
    ------
    InputError
        If CasADi is not installed, or the equations of motion have no parameter of a given name.
    """
    with installed("an export to casadi needs CasADi: pip install 'airpuck[plan]'"):
        import casadi

    names = _arguments(model)
    for name in free:
        problem = f"the equations of motion have no parameter {name!r}; choose from "
        check_known(name, names, problem + ", ".join(names), field="free")
    refuse_actuators(model, "casadi", ["on_off", "reversible propeller"])
    mask = model.parameters.mask(frozenset(free))
    states, n = len(_state_units(model)), model.vehicle.n_propellers
    z, u, h = casadi.SX.sym("state", states), casadi.SX.sym("command", n), casadi.SX.sym("period")
    theta = casadi.SX.sym("theta", int(mask.sum()))

    def rates(state: Any, command: Any, entries: Any) -> Any:
        return rigid_body.derivative(np, _dynamics(model, mask, entries), state, command)

    def following(state: Any, command: Any, period: Any, entries: Any) -> Any:
        # Without lag the motor speeds are not states: they equal the command.
        begin = state if states > len(_MOTION) else np.concatenate([state, command])
        dynamics = _dynamics(model, mask, entries)
        return rigid_body.step(np, dynamics, begin, command, period[0])[:states]

    def function(name: str, equations: Any, given: dict[str, Any], result: str) -> casadi.Function:
        arguments = given | ({"theta": theta} if free else {})
        value = with_symbols(equations, *given.values(), theta)
        return casadi.Function(name, [*arguments.values()], [value], [*arguments], [result])

    given = {"state": z, "command": u}
    return {
        "continuous": function("continuous", rates, given, "rate"),
        "discrete": function("discrete", following, {**given, "period": h}, "next_state"),
    }


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the functions with constant parameters, and with the learned ones as an argument."""
    model, vehicle = subject.model, subject.model.vehicle
    free = [name for name in _arguments(model) if name in model.learned]
    for names, suffix in [([], ""), (free, "_free")][: 2 if free else 1]:
        for name, function in functions(model, names).items():
            function.save(str(folder / f"{name}{suffix}.casadi"))
    mask, units = model.parameters.mask(frozenset(free)), _state_units(model)
    labels = np.array(model.parameters.labels(vehicle.propeller_names))[mask]
    content = {
        "model": model.name,
        "source": model.source,
        "vehicle": vehicle.name,
        "state": units,
        "command": dict.fromkeys(vehicle.propeller_names, "1"),
        "command_range": command_range(model),
        "period": "s",
        "theta": dict(zip(labels.tolist(), model.parameters.to_vector()[mask], strict=True)),
        "transport_delay_s": model.transport_delay,
    }
    (folder / "arguments.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return {
        "state": ", ".join(f"{name} [{unit}]" for name, unit in units.items()),
        "command": f"{vehicle.command_min:g} to {vehicle.command_max:g}, "
        + ("the fraction of time open" if vehicle.actuators.pulsed else "as it reaches the motors"),
        "theta": ", ".join(free) or "none, since no parameter was learned",
        "transport delay": f"{1e3 * model.transport_delay:.4g} ms, not in the functions",
    }


def _state_units(model: Model) -> dict[str, str]:
    """Return names and units of the states; the motor speeds are states if the motors lag."""
    if not model.dynamics.motor_time_constant > 0:
        return _MOTION
    return _MOTION | {f"speed_{name}": "1" for name in model.vehicle.propeller_names}


def _arguments(model: Model) -> list[str]:
    """Return the names of the parameters on which the equations of motion depend."""
    without = {"transport_delay"}
    if not model.dynamics.motor_time_constant > 0:
        without.add("motor_time_constant")
    if model.parameters.configuration_matrix is not None:
        without |= {"inertia", "angle_offset"}
    return [q.name for q in model.parameters.quantities if q.name not in without]


def _dynamics(model: Model, mask: np.ndarray, entries: Any) -> rigid_body.Dynamics:
    """Return the dynamics with some entries of the parameters' vector replaced."""
    if not mask.any():
        return model.dynamics
    vector = model.parameters.to_vector().astype(object)
    vector[mask] = entries[:, 0]
    symbols = model.parameters.with_vector(vector)
    free = model.parameters.with_vector(mask)
    moved = {
        q.name: np.asarray(getattr(symbols, q.name))
        for q in free.quantities
        if np.any(getattr(free, q.name))
    }
    # NumPy computes with symbols inside arrays only: numbers and pairs get an axis for the batch.
    moved = {name: value if value.ndim == 2 else value[..., None] for name, value in moved.items()}
    parameters = replace(model.parameters, **moved)
    return parameters.dynamics(np, model.vehicle, model.frame)
