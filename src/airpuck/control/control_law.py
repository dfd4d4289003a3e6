"""The mathematics of a control step around the allocation: pure functions over an array namespace.

See docs/control.md, "One control step".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from airpuck.control.allocation import problem
from airpuck.control.discretization import motor_lag, point_mass
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference
from airpuck.physics.rigid_body import Dynamics, acceleration_map
from airpuck.physics.thrust import inverse_thrust, thrust

#: Where the effectiveness that the allocation reckons with is kept: a motor that seems dead is
#: still asked for a little, so that it is found out when it comes back; and no estimate may make
#: the controller timid.
_EFFECTIVENESS = (0.1, 1.5)


@dataclass(frozen=True)
class ControlLaw:
    """What runs before and after the allocation of a step."""

    #: (xp, state, motor speeds, disturbance, effectiveness, target state, target acceleration,
    #: gain) → the acceleration asked for, motor speeds that the lag leaves without a command, and
    #: the problem of `airpuck.control.allocation.problem`.
    plan: Callable[..., tuple[Any, ...]]
    #: (xp, solution, lower, upper, what the lag leaves) → commands.
    command: Callable[..., tuple[Any]]


def control_law(
    model: Model, period: float, slack_weight: float, reject_disturbance: bool
) -> ControlLaw:
    """Write the control law for a craft."""
    dynamics, vehicle, n = model.dynamics, model.vehicle, model.vehicle.n_propellers
    arm, least, most = model.radius_of_gyration, vehicle.command_min, vehicle.command_max
    lag, drive = motor_lag(float(dynamics.motor_time_constant), period)
    rejected = 1.0 if reject_disturbance else 0.0

    def plan(
        xp: Any,
        state: Any,
        speed: Any,
        disturbance: Any,
        effectiveness: Any,
        target: Any,
        feedforward: Any,
        gain: Any,
    ) -> tuple[Any, ...]:
        # A thrust that is believed weaker than it is counts the less, none is divided by.
        effectiveness = xp.clip(effectiveness, *_EFFECTIVENESS)
        following, matrix, offset = look_ahead(
            xp, dynamics, period, state, speed, disturbance, effectiveness
        )
        error = pose_difference(xp, following, target)
        request = feedforward - gain @ error - rejected * disturbance
        coasting = lag * speed
        low = thrust(dynamics.thrust, coasting + drive * least)
        high = thrust(dynamics.thrust, coasting + drive * most)
        posed = problem(xp, arm, slack_weight, request, matrix, offset, low, high)
        return request, coasting, *posed

    def command(xp: Any, solution: Any, lower: Any, upper: Any, coasting: Any) -> tuple[Any]:
        # Solvers keep bounds to their tolerance; motors keep them to the last digit.
        force = xp.clip(solution[:n], lower[:n], upper[:n])
        speed = inverse_thrust(xp, dynamics.thrust, force)
        return (xp.clip((speed - coasting) / drive, least, most),)

    return ControlLaw(plan, command)


def look_ahead(
    xp: Any,
    dynamics: Dynamics,
    period: float,
    state: Any,
    speed: Any,
    disturbance: Any,
    effectiveness: Any,
) -> tuple[Any, Any, Any]:
    """Return the state one period on, and the map M F + g from thrusts to accelerations there.

    What the motors do until then is settled: they turn as they do now.
    """
    a, b = point_mass(period)
    matrix, offset = acceleration_map(xp, dynamics, state[2], state[5])
    settled = matrix * effectiveness @ thrust(dynamics.thrust, speed) + offset + disturbance
    following = a @ state + b @ settled
    matrix, offset = acceleration_map(xp, dynamics, following[2], following[5])
    return following, matrix * effectiveness, offset
