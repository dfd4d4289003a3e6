"""How far predictions can be off: linearised propagation of errors through a rollout.

Beside the state z of a prediction run, by the chain rule through every Runge-Kutta step, its
sensitivity to the parameters, S' = F S + G, and the covariance of what the model does not explain,
C' = A C Aᵀ + Q (Ljung 1999, ch. 4 and 7; the covariance is that of an extended Kalman filter that
hears nothing). In A yaw moves the directions of the thrusts, so that what is not known of yaw
spreads to x and y. A learned transport delay is a parameter, too: it moves the moments at which
commands change, so that one piece of a step grows by as much as the next one shrinks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.compute.arrays import scan
from airpuck.compute.compiled import for_batches
from airpuck.data.trajectory import Trajectory
from airpuck.estimate.axis_filter import spread
from airpuck.evaluation.command_pieces import cut_at_commands
from airpuck.evaluation.innovations import Innovations
from airpuck.evaluation.prediction import delay_for
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.rollout import rollout

#: Samples before a start over which motor speeds are followed, for what they owe to the lag.
_LEAD = 40


def predict_with_errors(
    model: Model,
    trajectory: Trajectory,
    known: Innovations,
    starts: Int[np.ndarray, " W"],
    steps: int,
    entries: Bool[np.ndarray, " P"],
) -> tuple[Float[np.ndarray, "T 3 W"], Float[np.ndarray, "T 3 W"], Float[np.ndarray, "T 3 W F"]]:
    """Predict from the filter's estimates, with the covariance and sensitivities of predictions."""
    import jax

    acts = trajectory.command_time + delay_for(model, trajectory)
    durations, commands = cut_at_commands(trajectory.time, acts, trajectory.command)
    later = _growth(commands)
    # The first sample has pieces of no length, so it may stand for those before.
    lead = np.maximum(starts[:, None] + np.arange(1 - _LEAD, 1), 0)
    ahead = starts[:, None] + np.arange(1, steps + 1)
    mean = known.mean[starts]
    densities = np.square([known.noise.acceleration, known.noise.disturbance])
    found = for_batches(jax.vmap(_one_prediction(model, entries, densities)))(
        np.concatenate([mean[:, :, 0], mean[:, :, 1]], axis=1),
        mean[:, :, 2],
        known.covariance[starts],
        known.motor_speed[np.maximum(starts - _LEAD, 0)],
        (commands[lead], durations[lead], later[lead]),
        (commands[ahead], durations[ahead], later[ahead]),
    )
    predicted, variance, sensitivity = (np.array(part) for part in found)
    return (
        np.moveaxis(predicted, 0, 2),
        np.moveaxis(variance, 0, 2),
        np.moveaxis(sensitivity, 0, 2),
    )


def _growth(commands: Float[np.ndarray, "N S n"]) -> Float[np.ndarray, "N S"]:
    """Return the derivatives of the lengths of pieces with respect to the transport delay.

    A piece ends at a command, which moves with the delay, or at a sample, which does not. Where the
    command stays the same it does not matter which.
    """
    changes = (commands[:, 1:] != commands[:, :-1]).any(axis=2)
    return np.diff(changes.astype(float), axis=1, prepend=0.0, append=0.0)


def _one_prediction(
    model: Model, entries: Bool[np.ndarray, " P"], densities: Float[np.ndarray, "2 3"]
) -> Any:
    """Return the function that predicts one window."""
    import jax
    import jax.numpy as jnp

    chosen, estimate = np.flatnonzero(entries), model.parameters.to_vector()
    count, n = len(chosen), model.vehicle.n_propellers

    def dynamics(free: Any) -> Any:
        vector = jnp.asarray(estimate).at[chosen].set(free)
        return model.parameters.with_vector(vector).dynamics(jnp, model.vehicle, model.frame)

    def delayed(free: Any, durations: Any, later: Any) -> Any:
        vector = jnp.asarray(estimate).at[chosen].set(free)
        delay = model.parameters.with_vector(vector).transport_delay
        return durations + later * (delay - model.parameters.transport_delay)

    def follow(free: Any, speed: Any, lead: Any) -> Any:
        tau = dynamics(free).motor_time_constant
        flat = lead[0].reshape(-1, n), delayed(free, *lead[1:]).ravel()

        def turn(speed: Any, held: tuple[Any, Any]) -> tuple[Any, Any]:
            command, duration = held
            speed = motor_step(jnp, speed, command, duration, tau)
            return speed, speed

        return scan(jnp, turn, speed, flat)[0]

    def move(free: Any, state: Any, disturbance: Any, held: tuple[Any, Any, Any]) -> Any:
        commands, *lengths = held
        durations = delayed(free, *lengths)
        end = rollout(jnp, dynamics(free), state, commands, durations)[-1]
        h = durations.sum()
        return end + jnp.concatenate([h * h / 2 * disturbance, h * disturbance, jnp.zeros(n)])

    def predict(
        motion: Any, disturbance: Any, covariance: Any, speed: Any, lead: Any, ahead: Any
    ) -> Any:
        free = jnp.asarray(estimate[chosen])

        def advance(carry: Any, held: Any) -> Any:
            state, slope, covariance = carry
            by_free, by_state = jax.jacfwd(move, argnums=(0, 1))(free, state, disturbance, held)
            state, slope = move(free, state, disturbance, held), by_state @ slope + by_free
            h = held[1].sum()
            push = jnp.concatenate([h * h / 2 * jnp.eye(3), h * jnp.eye(3)])
            change = jnp.block([[by_state[:6, :6], push], [jnp.zeros((3, 6)), jnp.eye(3)]])
            added = spread(jnp, jnp.zeros((3, 3, 3)), h, *densities)
            covariance = change @ covariance @ change.T + _joined(jnp, added)
            return (state, slope, covariance), (state[:3], jnp.diag(covariance)[:3], slope[:3])

        state = jnp.concatenate([motion, follow(free, speed, lead)])
        by_free = jax.jacfwd(follow)(free, speed, lead)
        slope = jnp.concatenate([jnp.zeros((6, count)), by_free])
        begin = state, slope, _joined(jnp, covariance)
        return scan(jnp, advance, begin, ahead)[1]

    return predict


def _joined(xp: Any, covariance: Any) -> Any:
    """Join the axes' covariances of (p, v, d) to one of all p, all v, all d, shape (9, 9)."""
    return xp.einsum("aij,ab->iajb", covariance, xp.eye(3)).reshape(9, 9)
