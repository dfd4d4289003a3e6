"""The Gauss-Newton approximation of the prediction loss: r'r, J'r and J'J of a batch of windows.

Sensitivities of the prediction are propagated forward with the state and summed up inside the time
loop, which returns a number, a vector and a small matrix, whatever the number of windows. The
equations of motion are not differentiated by hand. At each Runge-Kutta stage JAX computes the local
Jacobian of the accelerations in forward mode. It differentiates with respect to the thrusts instead
of the many coefficients behind them; the powers of the polynomials are applied afterwards.

For speed (`airpuck.compute.compiled`), the batch is the last axis throughout, the sensitivities of
yaw and of velocities are kept separate, and the direct effects of the local coordinates are added
in place, each kind to its own part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import accumulate, pairwise
from typing import Any

import jax
import jax.numpy as jnp

from airpuck.compute.compiled import for_batches
from airpuck.data.windows import gather_past
from airpuck.estimate.encoder import StateEncoder
from airpuck.physics.effects import IdleLag
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics, acceleration
from airpuck.physics.thrust import thrust, thrust_slope


def normal_equations(
    dynamics: tuple[Any, tuple[Any, Any], Any, Any],
    basis: tuple[Any, Any],
    time: Any,
    state: Any,
    command: Any,
    command_slope: Any,
    starts: Any,
    multiplicity: Any,
    channel_weights: Any,
    *,
    encoder: StateEncoder,
    lengths: tuple[int, int],
    frame: CenterOfMassFrame,
) -> tuple[Any, Any, Any]:
    """Return r² and Jᵀr of each of a batch of B windows, and the sum of their JᵀJ.

    `lengths` are E and T. Local coordinates are the thrust coefficients, K directions of Π and the
    effects, the centre of mass if it acts beside Π, τ and its increase at standstill, and the
    transport delay.

    The function is long because its inner functions share a dozen traced arrays, which would
    otherwise be arguments of each.
    """
    coefficients, linear, center, lag_values = dynamics
    tau, lags = lag_values[0], lag_values.shape[0]
    (n, degree), batch = coefficients.shape, starts.shape[0]
    # The lag does not depend on the delay, the last local coordinate.
    by_lag, (before, ahead) = jnp.eye(lags + 1, lags), lengths

    past = gather_past(jnp, time, state, command, starts, before)
    past_slope = gather_past(jnp, time, state, command_slope, starts, before).command

    def with_delay(slope: Any) -> Any:
        """Return the derivative of a command with respect to lag and delay."""
        return jnp.stack([*[jnp.zeros_like(slope)] * lags, slope])

    def encode(values: Any, command: Any) -> Any:
        idle = [IdleLag(value) for value in values[1:]]
        model = Dynamics(coefficients, linear[0], center, values[0], frame, (*linear[1], *idle))
        return encoder.encode(jnp, model, replace(past, command=command))

    def accelerate(*by: Any) -> Any:
        """Accelerations given thrusts, Π and the effects, centre of mass, and motion."""
        force, (matrix, effects), center, motion = by
        # As if propellers pushed as strongly as they turn.
        model = Dynamics(jnp.ones((n, 1)), matrix, center, tau, frame, effects)
        return jnp.stack(acceleration(jnp, model, motion, force))

    def local(force: Any, motion: Any) -> tuple[Any, list[Any]]:
        """Accelerations, and derivatives by each argument of `accelerate`, (3, ·, B)."""
        point = force, linear, center, motion
        each = jnp.ones(batch)
        along = jnp.eye(n)[..., None] * each, basis, jnp.eye(2), jnp.eye(4)[..., None] * each

        def slopes(k: int) -> Any:
            _, push = jax.linearize(
                lambda part: accelerate(*point[:k], part, *point[k + 1 :]), point[k]
            )
            return jax.vmap(push, out_axes=1)(along[k])

        return accelerate(*point), [slopes(k) for k in range(len(point))]

    # Without effects nothing depends on the velocity.
    felt = range(4) if linear[1] else (0, 3)
    sizes = (coefficients.size, len(basis[0]), 2, lags + 1)
    edges = list(accumulate(sizes, initial=0))

    # Compiled separately so that it is traced only once for all four stages.
    @jax.jit
    def rates(
        motion: Any, d_yaw: Any, d_velocity: Any, speed: Any, d_speed: Any
    ) -> tuple[Any, Any]:
        """Time derivative of (γ, vx, vy, ω), and of the sensitivities of (vx, vy, ω)."""
        value, slopes = local(thrust(coefficients, speed), motion)
        by_force, by_direction, by_center, by_motion = slopes
        powers = jnp.stack([speed**power for power in range(1, degree + 1)], axis=1)
        by_thrust = (by_force[:, :, None] * powers).reshape(3, -1, batch)
        by_speed = by_force * thrust_slope(coefficients, speed)
        by_motor = sum(by_speed[:, None, i] * d_speed[:, i] for i in range(n))
        d_motion = (d_yaw, *d_velocity)
        d_acceleration: Any = sum(by_motion[:, k, None] * d_motion[k] for k in felt)
        directly = (by_thrust, by_direction, by_center, by_motor)
        for part, (first, last) in zip(directly, pairwise(edges), strict=True):
            d_acceleration = d_acceleration.at[:, first:last].add(part)
        return jnp.concatenate([motion[3:], value]), d_acceleration

    def lag(speed: Any, d_speed: Any, held: Any, d_held: Any, duration: Any) -> tuple[Any, Any]:
        end, push = jax.linearize(
            lambda speed, held, values: motor_step(jnp, speed, held, duration, *values),
            speed,
            held,
            lag_values,
        )
        return end, jax.vmap(push)(d_speed, d_held, by_lag)

    def step(carry: Any, k: Any) -> tuple[Any, None]:
        position, motion, speed, d_position, d_yaw, d_velocity, d_speed, sums = carry
        now = starts + before - 1 + k
        held, h = command[now].T, time[now + 1] - time[now]
        d_held = with_delay(command_slope[now].T)
        # As in `airpuck.physics.rollout.step`, with the sensitivities of every quantity.
        begin = jnp.where(tau > 0, speed, held), jnp.where(tau > 0, d_speed, d_held)
        middle, end = (lag(*begin, held, d_held, duration) for duration in (h / 2, h))
        k1, a1 = rates(motion, d_yaw, d_velocity, *begin)
        d2 = d_velocity + h / 2 * a1
        k2, a2 = rates(motion + h / 2 * k1, d_yaw + h / 2 * d_velocity[2], d2, *middle)
        d3 = d_velocity + h / 2 * a2
        k3, a3 = rates(motion + h / 2 * k2, d_yaw + h / 2 * d2[2], d3, *middle)
        d4 = d_velocity + h * a3
        k4, a4 = rates(motion + h * k3, d_yaw + h * d3[2], d4, *end)
        position += h * motion[1:3] + h**2 / 6 * (k1 + k2 + k3)[1:3]
        motion += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        d_pose = h * d_velocity + h**2 / 6 * (a1 + a2 + a3)
        d_position, d_yaw = d_position + d_pose[:2], d_yaw + d_pose[2]
        d_velocity += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

        scale = channel_weights[:, None] * jnp.sqrt(multiplicity)
        predicted = jnp.concatenate([position, motion[:1]])
        residual = scale * (predicted - state[now + 1, :3].T)
        square, score, curvature = sums
        square += jnp.sum(residual**2, axis=0)
        for c, row in enumerate((*d_position, d_yaw)):
            row = scale[c] * row
            score += row * residual[c]
            curvature += row @ row.T
        sums = square, score, curvature
        return (position, motion, end[0], d_position, d_yaw, d_velocity, end[1], sums), None

    encoded, push = jax.linearize(encode, lag_values, past.command)
    d_encoded = jax.vmap(push)(by_lag, with_delay(past_slope))
    size = edges[-1]
    # Only lag and delay move the encoder's estimate.
    d_begun = jnp.moveaxis(d_encoded[:, :6], 0, 1)
    d_state = jnp.zeros((6, size, batch)).at[:, -(lags + 1) :].set(d_begun)
    carry = (
        encoded[:2],
        encoded[2:6],
        encoded[6:],
        d_state[:2],
        d_state[2],
        d_state[3:],
        d_encoded[:, 6 : 6 + n],
        (jnp.zeros(batch), jnp.zeros((size, batch)), jnp.zeros((size, size))),
    )
    return jax.lax.scan(step, carry, jnp.arange(ahead))[0][-1]


@cache
def compiled_normal_equations() -> Callable[..., tuple[Any, Any, Any]]:
    """Compile `normal_equations`; the last three arguments must be hashable."""
    return for_batches(normal_equations, static_argnames=("encoder", "lengths", "frame"))
