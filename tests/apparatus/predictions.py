"""Predictions by the plain rollout in NumPy, with commands that change between samples."""

import numpy as np

from airpuck import Model, Trajectory
from airpuck.evaluation.innovations import Innovations, cut_at_commands
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import rollout


def predicted(
    model: Model,
    flight: Trajectory,
    known: Innovations,
    starts: np.ndarray,
    steps: int,
    late: float = 0.0,
    lead: int = 40,
) -> np.ndarray:
    """Predict x, y, γ after each step, shape (T, 3, W), for commands that act `late` [s] late.

    From the filter's estimates, without their disturbances; motor speeds from those `lead` samples
    before.
    """
    durations, commands = cut_at_commands(flight.time, flight.command_time + late, flight.command)
    rows = starts + np.arange(1 - lead, steps + 1)[:, None]
    # One piece after the other: shapes (rows × S, n, W) and (rows × S, W).
    pieces = durations.shape[1]
    held = np.moveaxis(commands[rows], 1, 3).reshape(-1, commands.shape[2], len(starts))
    lasting = np.moveaxis(durations[rows], 1, 2).reshape(-1, len(starts))
    speed, begin = known.motor_speed[starts - lead].T, lead * pieces
    for command, duration in zip(held[:begin], lasting[:begin], strict=True):
        speed = motor_step(np, speed, command, duration, model.parameters.motor_time_constant)
    mean = known.mean[starts]
    state = np.concatenate([mean[:, :, 0].T, mean[:, :, 1].T, speed])
    ends = rollout(np, model.dynamics, state, held[begin:], lasting[begin:])
    return ends[pieces - 1 :: pieces, :3]
