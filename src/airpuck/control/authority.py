"""Control authority: the motions that push-only propellers can produce, and how strongly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Num

from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.thrust import thrust

#: Each motion: row of the configuration matrix, sign, and a phrase for messages.
MOTIONS = {
    "forward": (0, 1, "pushes it forward"),
    "back": (0, -1, "pushes it back"),
    "left": (1, 1, "pushes it to the left"),
    "right": (1, -1, "pushes it to the right"),
    "turn left": (2, 1, "turns it left (counter-clockwise)"),
    "turn right": (2, -1, "turns it right (clockwise)"),
}
#: Accelerations below this fraction of what all propellers could produce together count as zero.
_NOTHING = 1e-6
#: `weakest_effort` below which no law can steer [m/s²].
LEAST_EFFORT = 1e-6


@dataclass(frozen=True)
class Authority:
    """How strongly a craft's propellers can drive each motion.

    Attributes
    ----------
    alone : mapping of str to float
        Largest acceleration per motion (`MOTIONS`) with all others zero [m/s², rad/s²]; zero if
        impossible.
    together : mapping of str to float
        Largest acceleration per motion when the craft may also move otherwise.
    """

    alone: dict[str, float]
    together: dict[str, float]

    @property
    def missing(self) -> tuple[str, ...]:
        """Motions that the craft cannot make without another motion."""
        return tuple(name for name, most in self.alone.items() if most == 0)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Missing motions and the reasons; empty for a craft that can move and turn everywhere."""
        if not self.missing:
            return ()
        never = [name for name, most in self.together.items() if most == 0]
        rest = [name for name in self.missing if name not in never]
        found = [f"no propeller {MOTIONS[name][2]}" for name in never]
        if rest:
            found.append(f"not without another motion: {', '.join(rest)}")
        if len(self.missing) == len(MOTIONS):
            found.append("no thrusts cancel: it cannot stay at rest")
        return tuple(found)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        units = {name: "m_s2" if row < 2 else "rad_s2" for name, (row, _, _) in MOTIONS.items()}
        return {
            kind: {f"{name.replace(' ', '_')}_{units[name]}": most for name, most in found.items()}
            for kind, found in (("alone", self.alone), ("together", self.together))
        } | {"missing": list(self.missing)}


def control_authority(model: Model) -> Authority:
    """Compute the largest acceleration of each motion with six linear programs in the thrusts.

    Parameters
    ----------
    model : Model
        The craft; `airpuck.model.model_file.nominal_model` makes one of a vehicle.

    Returns
    -------
    Authority
        The largest accelerations Π F, for thrusts between the lowest and the highest command.
    """
    from scipy.optimize import linprog

    effects = np.asarray(model.dynamics.configuration)
    n, vehicle = effects.shape[1], model.vehicle
    ends = [
        thrust(model.dynamics.thrust, np.full(n, command))
        for command in (vehicle.command_min, vehicle.command_max)
    ]
    low, high = np.minimum(*ends), np.maximum(*ends)
    bounds = np.stack([low, high], axis=1)
    full = float(high.sum()) / vehicle.mass_kg
    alone, together = {}, {}
    for name, (row, sign, _) in MOTIONS.items():
        along = sign * effects[row]
        scale = full if row < 2 else full / model.radius_of_gyration
        others = np.delete(effects, row, axis=0)
        found = linprog(-along, A_eq=others, b_eq=np.zeros(2), bounds=bounds)
        alone[name] = _clear(-found.fun, scale) if found.success else 0.0
        together[name] = _clear(float(np.where(along > 0, high, low) @ along), scale)
    return Authority(alone, together)


def pushes(xp: Any, dynamics: Dynamics, command: float = 1.0) -> Num[Any, " D"]:
    """Return the largest acceleration in each of many directions, whatever the moment [m/s²]."""
    ways = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    turned = np.column_stack([np.cos(ways), np.sin(ways)])
    full = thrust(dynamics.thrust, xp.full(len(dynamics.thrust), command))
    each = (turned @ np.asarray(dynamics.configuration)[:2]) * full
    return xp.sum(xp.maximum(each, 0.0), axis=1)


def weakest_effort(model: Model, running: Bool[np.ndarray, " n"] | bool = True) -> float:
    """Return the largest acceleration in the weakest combination of push and turn [m/s²].

    Angular accelerations are multiplied by the radius of gyration. Some motors may not run.
    """
    each = model.propeller_effects * model.dynamics.thrust.sum(axis=1) * running
    # Between two directions that are each perpendicular to a propeller, the total is concave. The
    # minimum therefore lies where two propellers are perpendicular.
    first, second = np.triu_indices(each.shape[1], 1)
    normal = np.cross(each[:, first], each[:, second], axis=0)
    size = np.linalg.norm(normal, axis=0)
    clear = size > 1e-9 * np.linalg.norm(each, axis=0).max() ** 2
    if not clear.any():
        return 0.0
    unit = normal[:, clear] / size[clear]
    return float(np.maximum(each.T @ np.hstack([unit, -unit]), 0).sum(axis=0).min())


def _clear(most: float, scale: float) -> float:
    """Replace negligible values by zero."""
    return float(most) if most > _NOTHING * scale else 0.0
