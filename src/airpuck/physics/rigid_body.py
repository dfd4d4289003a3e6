"""The planar rigid body: from propeller forces to the acceleration of the geometric centre.

The paper's seq:model. All functions are plain array operations over a namespace `xp`; the batch is
the last axis.

`rollout` predicts a batch of windows over many steps (eq. extended_model_dynamics). The rigid body
is integrated with the explicit Runge-Kutta method of fourth order, as in the paper. The motors are
independent of the body, so their exact solution at the stage times is used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Brief
from airpuck.compute.arrays import linear_map, register_pytree, scan, settings_of
from airpuck.compute.rotation import cos_sin
from airpuck.physics.effects import BodyMotion, Effect
from airpuck.physics.motor import all_lags, lag_at, lag_like, lags, motor_step
from airpuck.physics.thrust import thrust

#: The frame in which the offset of the centre of mass is constant. Physically it is the body frame;
#: the paper's eq. acc_dyn, and its published parameters, leave it unrotated in the world.
CenterOfMassFrame = Literal["body", "world"]


def wrapped(xp: Any, angle: Any) -> Any:
    """Shift angles by whole turns to between -π and π."""
    return angle - 2 * np.pi * xp.round(angle * (0.5 / np.pi))


def pose_difference(xp: Any, pose: Any, other: Any) -> Any:
    """Subtract a pose x, y, γ, or a state that begins with one, from another; wrap its yaw."""
    difference = pose - other
    turn = wrapped(xp, difference[2:3])
    return xp.concatenate([difference[:2], turn, difference[3:]])


def to_body(
    values: Float[np.ndarray, "N 3"], yaw: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "N 3"]:
    """Turn rates of x, y, γ into the body frame."""
    x, y, spin = values.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x, spin], axis=1)


@dataclass(frozen=True)
class Dynamics(Brief):
    """Coefficients of the equations of motion.

    For one craft, or for a batch of craft as last axis. Rungs of the model ladder differ only in
    how these follow from their parameters (`airpuck.model.parameters`).

    Attributes
    ----------
    thrust : array, shape (n, degree)
        Thrust polynomials [N].
    configuration : array, shape (3, n)
        Π: maps thrusts to linear acceleration in the body frame and angular acceleration [1/kg,
        1/kg, 1/(kg m)].
    center_of_mass : array, shape (2,)
        r, from the geometric centre to the centre of mass [m].
    motor_time_constant : array, shape () or float
        Lag τ of motor speed behind the command [s].
    frame : {"body", "world"}
        The frame in which `center_of_mass` is constant.
    effects : tuple of Effect
        Optional terms (`airpuck.physics.effects`).
    own_lag : tuple of array, shape (n, 1), or None
        1 where motors have the lag `motor_time_constant` and 0 elsewhere, and the lags of these
        others [s]; None: all have the same.
    """

    SHOWN = "thrust_N=thrust center_of_mass_m=center_of_mass lag_s=motor_time_constant effects"

    thrust: Any
    configuration: Any
    center_of_mass: Any
    motor_time_constant: Any
    frame: CenterOfMassFrame = "body"
    effects: tuple[Effect, ...] = ()
    own_lag: tuple[Any, Any] | None = None

    @property
    def lag(self) -> Any:
        """Lag of the motors [s], of shape (n, 1) if some have their own."""
        return all_lags(self.motor_time_constant, self.own_lag)

    @property
    def idle_lag(self) -> Any:
        """Relative increase of the motors' lag at standstill; None: the same lag at any speed."""
        longer = [effect.idle_lag for effect in self.effects if effect.idle_lag is not None]
        return sum(longer) if longer else None

    @property
    def of_place(self) -> bool:
        """Whether an effect depends on the position on the table."""
        return any(effect.of_place for effect in self.effects)


def register_pytrees() -> None:
    """Let JAX see the arrays inside `Dynamics` and all effects, also those defined since."""
    register_pytree(Dynamics, static=lambda _: ("frame",))
    kinds = Effect.__subclasses__()
    for kind in kinds:
        register_pytree(kind, static=settings_of)
        kinds += kind.__subclasses__()


def turned(xp: Any, vectors: Any, angle: Any) -> Any:
    """Turn vectors, shape (n, 2), counter-clockwise."""
    cos, sin = xp.cos(angle), xp.sin(angle)
    x, y = vectors[:, 0], vectors[:, 1]
    return xp.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def configuration_matrix(
    xp: Any,
    positions: Any,
    directions: Any,
    mass: Any,
    inertia: Any,
    angle_offset: Any,
    center_of_mass: Any,
    couples: Any = 0.0,
) -> Any:
    """Compute Π(θ), shape (3, n), from first principles (subsec:configuration_matrix).

    Forces add up to the acceleration of the centre of mass, their moments about it to the angular
    acceleration. The angle offset α turns both positions (n, 2) and directions (n, 2). A reaction
    wheel has no direction, only a couple: a moment per unit of its thrust.
    """
    dx, dy = turned(xp, directions, angle_offset).T
    px, py = turned(xp, positions, angle_offset).T
    px, py = px - center_of_mass[0], py - center_of_mass[1]
    return xp.stack([dx / mass, dy / mass, (px * dy - py * dx + couples) / inertia])


def acceleration(xp: Any, dynamics: Dynamics, motion: Any, motor_speed: Any) -> Any:
    """Compute the acceleration of the geometric centre and the angular acceleration (eq. acc_dyn).

    a = R(γ) Π_xy F + r × ω' + ω × (r × ω) (eq. acc_corr) and ω' = Π_z F, with r turned by R(γ) if
    it is fixed to the body. Effects change the thrusts F, or add accelerations.

    Parameters
    ----------
    xp : module
        Array namespace.
    dynamics : Dynamics
        Coefficients.
    motion : sequence of array, shape (4, ...) or (6, ...)
        Yaw γ [rad], velocity vx, vy [m/s], angular velocity ω [rad/s]; for effects that depend on
        it, the position x, y [m].
    motor_speed : array, shape (n, ...)
        Normalised motor speeds φ.

    Returns
    -------
    tuple of array, shape (3, ...)
        ax, ay in the world frame [m/s²], ω' [rad/s²].
    """
    yaw, vx, vy, spin, *place = motion
    cos, sin = cos_sin(xp, yaw)
    force = thrust(dynamics.thrust, motor_speed)
    added = []
    if dynamics.effects:
        felt = BodyMotion(cos * vx + sin * vy, cos * vy - sin * vx, spin, cos, sin, *place)
        for effect in dynamics.effects:
            force = effect.thrust(xp, force, felt)
            known = replace(felt, thrust=force) if effect.of_thrust else felt
            added.append(effect.acceleration(xp, known))
    forward, left, angular = linear_map(dynamics.configuration, force)
    for along, across, turning in added:
        forward, left, angular = forward + along, left + across, angular + turning
    heavier = _added_mass(dynamics)
    if heavier is not None:
        center = center_of_mass(dynamics, "body", cos, sin)
        pushed = forward, left, angular
        velocity = cos * vx + sin * vy, cos * vy - sin * vx, spin
        forward, left, angular = _with_added_mass(heavier, center, pushed, velocity)
        return cos * forward - sin * left, sin * forward + cos * left, angular
    rx, ry = center_of_mass(dynamics, "world", cos, sin)
    return (
        cos * forward - sin * left + ry * angular + rx * spin**2,
        sin * forward + cos * left - rx * angular + ry * spin**2,
        angular,
    )


def _added_mass(dynamics: Dynamics) -> tuple[Any, Any, Any] | None:
    """Sum up the added mass of all effects, along and across, and return it with I/m."""
    added = [effect.added_mass for effect in dynamics.effects if effect.added_mass is not None]
    if not added:
        return None
    along, across, (squared_gyration, *_) = zip(*added, strict=True)
    return sum(along), sum(across), squared_gyration


def center_of_mass(
    dynamics: Dynamics, axes: CenterOfMassFrame, cos: Any, sin: Any
) -> tuple[Any, Any]:
    """Return the offset of the centre of mass along the axes of the body, or of the world."""
    rx, ry = dynamics.center_of_mass[0], dynamics.center_of_mass[1]
    if dynamics.frame == axes:
        return rx, ry
    if axes == "body":
        return cos * rx + sin * ry, cos * ry - sin * rx
    return cos * rx - sin * ry, sin * rx + cos * ry


def _with_added_mass(
    added: tuple[Any, Any, Any], center: tuple[Any, Any], pushed: Any, velocity: Any
) -> tuple[Any, Any, Any]:
    """Solve for the accelerations of a craft that moves fluid along (Kirchhoff's equations).

    With the masses m (1 + μₓ) and m (1 + μ_y) about the geometric centre, r the centre of mass and
    ρ² = I/m, per mass:

        (1 + μₓ) aₓ - r_y ω'           = fₓ + rₓ ω² + (μ_y - μₓ) v ω
        (1 + μ_y) a_y + rₓ ω'          = f_y + r_y ω² + (μ_y - μₓ) u ω
        rₓ a_y - r_y aₓ + (ρ² + r²) ω' = ρ² n + rₓ f_y - r_y fₓ - (μ_y - μₓ) u v

    where f and n are the accelerations of the centre of mass without added mass, and a is the
    acceleration of the geometric centre in the world, along the body's axes.
    """
    along, across, squared_gyration = added
    (rx, ry), (u, v, spin), (fx, fy, turn) = center, velocity, pushed
    difference = across - along
    bx = fx + rx * spin**2 + difference * v * spin
    by = fy + ry * spin**2 + difference * u * spin
    moment = squared_gyration * turn + rx * fy - ry * fx - difference * u * v
    # Eliminate aₓ and a_y.
    px, py = ry / (1 + along), rx / (1 + across)
    inertia = squared_gyration + rx * (rx - py) + ry * (ry - px)
    angular = (moment + px * bx - py * by) / inertia
    return (bx + ry * angular) / (1 + along), (by - rx * angular) / (1 + across), angular


def motor_accelerations(
    xp: Any, dynamics: Dynamics, motion: Any, motor_speed: Any
) -> tuple[Any, Any]:
    """Split the accelerations (eq. acc_dyn) into each motor's contribution and the rest."""
    # The accelerations are linear in Π: evaluate with each column alone, and with no column.
    n = motor_speed.shape[0]
    columns = np.concatenate([np.eye(n), np.zeros((1, n))])
    matrix = dynamics.configuration[:, :, None] * columns.T
    one_motor = replace(
        dynamics, configuration=matrix.reshape(matrix.shape + (1,) * (motor_speed.ndim - 1))
    )
    parts = xp.stack(xp.broadcast_arrays(*acceleration(xp, one_motor, motion, motor_speed)))
    rest = parts[:, -1]
    return parts[:, :-1] - rest[:, None], rest


def derivative(xp: Any, dynamics: Dynamics, state: Any, command: Any) -> Any:
    """Evaluate the right-hand side z' = f(z, u) of eq. extended_model_dynamics.

    Without motor lag the state has no motor speeds: they equal the command.
    """
    lagging = state.shape[0] > 6
    motor_speed = state[6:] if lagging else command
    motion = (*state[2:6], *state[:2]) if dynamics.of_place else state[2:6]
    rates = xp.stack(acceleration(xp, dynamics, motion, motor_speed))
    if not lagging:
        return xp.concatenate([state[3:6], rates])
    lag = lag_at(xp, motor_speed, dynamics.lag, dynamics.idle_lag)
    return xp.concatenate([state[3:6], rates, (command - motor_speed) / lag])


def acceleration_map(xp: Any, dynamics: Dynamics, yaw: Any, spin: Any) -> tuple[Any, Any]:
    """Return M(γ) and g(ω) of the accelerations M F + g (eq. acc_dyn), for eq. force_qp.

    Of the optional effects, they contain added mass and the slope of the table. Others are left
    out; a controller rejects them as a disturbance.

    Parameters
    ----------
    xp : module
        Array namespace, such as NumPy.
    dynamics : Dynamics
        Coefficients, such as ``model.dynamics``.
    yaw, spin : float
        γ [rad] and ω [rad/s].

    Returns
    -------
    matrix, offset : array, shape (3, n) and (3,)
        M and g: the accelerations of x, y, γ are M F + g for thrusts F [N].

    Examples
    --------
    >>> matrix, offset = airpuck.acceleration_map(np, model.dynamics, yaw=0.0, spin=0.0)
    >>> matrix.shape, offset.tolist()
    ((3, 6), [0.0, 0.0, 0.0])
    """
    cos, sin = xp.cos(yaw), xp.sin(yaw)
    rx, ry = center_of_mass(dynamics, "world", cos, sin)
    turn = xp.array([[cos, -sin, ry], [sin, cos, -rx], [0.0, 0.0, 1.0]])
    offset = xp.array([rx, ry, 0.0]) * spin**2
    heavier = _added_mass(dynamics)
    if heavier is not None:  # columns for a unit acceleration each, and the centripetal one
        center, unit = center_of_mass(dynamics, "body", cos, sin), np.eye(3, 4)
        rates = 0.0, 0.0, spin * np.eye(4)[3]
        solved = xp.stack(xp.broadcast_arrays(*_with_added_mass(heavier, center, unit, rates)))
        turn = xp.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ solved
        turn, offset = turn[:, :3], turn[:, 3]
    for effect in dynamics.effects:
        if effect.gravity is not None:
            offset = offset + xp.array([*effect.gravity, 0.0])
    return turn @ dynamics.configuration, offset


def step(xp: Any, dynamics: Dynamics, state: Any, command: Any, duration: Any) -> Any:
    """Advance the extended state under a constant command by one Runge-Kutta step."""
    h, tau, idle = duration, lag_like(state, dynamics.lag), dynamics.idle_lag
    # A motor without lag has its new speed from the start of the step.
    begin = xp.where(lags(tau), state[6:], command)
    middle = motor_step(xp, begin, command, h / 2, tau, idle)
    end = motor_step(xp, begin, command, h, tau, idle)

    # Such an effect changes little during a step, so its value at the middle is used.
    place = state[:2] + h / 2 * state[3:5] if dynamics.of_place else None

    def rates(motion: Any, motor_speed: Any) -> Any:
        felt = motion if place is None else (*motion, *place)
        # Of single numbers NumPy makes an array several times faster than it stacks them.
        return xp.array([motion[3], *acceleration(xp, dynamics, felt, motor_speed)])

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
