"""A control step around the quadratic program, as pure functions over an array namespace.

See docs/control.md, "One control step".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxtyping import Num

from airpuck.control.allocation import problem
from airpuck.control.discretization import motor_lag, point_mass
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference
from airpuck.physics.rigid_body import Dynamics, acceleration_map
from airpuck.physics.thrust import inverse_thrust, thrust

#: Bounds of the effectiveness that the allocation counts with. A motor that seems dead is still
#: asked for a little, so that its return is noticed; and no estimate may make the controller timid.
_EFFECTIVENESS = (0.1, 1.5)


class AllocationProblem(NamedTuple):
    """Inputs of the thrust allocation of one control step."""

    #: Acceleration wanted [m/s², m/s², rad/s²].
    request: Num[Any, " 3"]
    #: Motor speeds one period on if nothing is commanded.
    coasting: Num[Any, " n"]
    #: The quadratic program; see `airpuck.control.allocation.problem`.
    a: Num[Any, "3 m"]
    lower: Num[Any, " m+3"]
    upper: Num[Any, " m+3"]
    finite: Any


def plan_stage(
    model: Model, period: float, slack_weight: float, reject_disturbance: bool
) -> Callable[..., AllocationProblem]:
    """Return look-ahead, law and the program of the allocation as one function.

    (xp, state, motor speeds, disturbance, effectiveness, target state, target acceleration, gain)
    → plan.
    """
    dynamics, vehicle = model.dynamics, model.vehicle
    arm, least, most = model.radius_of_gyration, vehicle.command_min, vehicle.command_max
    lag, drive = motor_lag(float(dynamics.motor_time_constant), period)

    def plan(
        xp: Any,
        state: Num[Any, " 6"],
        speed: Num[Any, " n"],
        disturbance: Num[Any, " 3"],
        effectiveness: Num[Any, " n"],
        target: Num[Any, " 6"],
        feedforward: Num[Any, " 3"],
        gain: Num[Any, "3 6"],
    ) -> AllocationProblem:
        # A motor that is believed weak counts for less; nothing is divided by its effectiveness.
        effectiveness = xp.clip(effectiveness, *_EFFECTIVENESS)
        believed = state, speed, disturbance, effectiveness
        following, matrix, offset = look_ahead(xp, dynamics, period, *believed)
        request = feedforward - gain @ pose_difference(xp, following, target)
        request = request - reject_disturbance * disturbance
        coasting = lag * speed
        low = thrust(dynamics.thrust, coasting + drive * least)
        high = thrust(dynamics.thrust, coasting + drive * most)
        posed = problem(xp, arm, slack_weight, request, matrix, offset, low, high)
        return AllocationProblem(request, coasting, *posed)

    return plan


def look_ahead(
    xp: Any,
    dynamics: Dynamics,
    period: float,
    state: Num[Any, " 6"],
    speed: Num[Any, " n"],
    disturbance: Num[Any, " 3"],
    effectiveness: Num[Any, " n"],
) -> tuple[Num[Any, " 6"], Num[Any, "3 n"], Num[Any, " 3"]]:
    """Return the state one period on, and the map M F + g from thrusts to accelerations there.

    Until then the accelerations are settled: motors turn as they do now.
    """
    a, b = point_mass(period)
    matrix, offset = acceleration_map(xp, dynamics, state[2], state[5])
    settled = matrix * effectiveness @ thrust(dynamics.thrust, speed) + offset + disturbance
    following = a @ state + b @ settled
    matrix, offset = acceleration_map(xp, dynamics, following[2], following[5])
    return following, matrix * effectiveness, offset


def command_stage(model: Model, period: float) -> Callable[..., tuple[Any]]:
    """Return the inverse of thrust curves and motor lag, u = B⁻¹ (F⁻¹(F) - A φ) (seq:control).

    (xp, solution, lower, upper, coasting), as in `AllocationProblem` → commands.
    """
    dynamics, vehicle, n = model.dynamics, model.vehicle, model.vehicle.n_propellers
    least, most = vehicle.command_min, vehicle.command_max
    _, drive = motor_lag(float(dynamics.motor_time_constant), period)

    def command(xp: Any, solution: Any, lower: Any, upper: Any, coasting: Any) -> tuple[Any]:
        # Solvers keep bounds to their tolerance; motors keep them to the last digit.
        force = xp.clip(solution[:n], lower[:n], upper[:n])
        speed = inverse_thrust(xp, dynamics.thrust, force)
        return (xp.clip((speed - coasting) / drive, least, most),)

    return command
