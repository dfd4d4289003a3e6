"""`preprocess`: all steps of subsec:data_preprocessing, from a recording to a trajectory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle, default_vehicle, match_columns
from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.zero_order_hold import hold
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.rigid_body import Dynamics
from airpuck.preprocessing.clock import align_clocks
from airpuck.preprocessing.delay import LONGEST, DelayEstimate, estimate_delay
from airpuck.preprocessing.derivative import (
    ACCELERATION_WINDOW,
    acceleration,
    unwrap_yaw,
    velocity,
)
from airpuck.preprocessing.quality import (
    COMMAND_GAP_PERIODS,
    check_commands,
    check_poses,
    drop_disorder,
    find_frozen,
    find_gaps,
    find_jumps,
    stretches,
)
from airpuck.recording.stream import Recording

#: A command this far above the lowest one means that the experiment has begun.
_BEGINS_ABOVE_MINIMUM = 0.02
_NO_COMMANDS = "no commands"
#: Correlation below which the commands hardly explain the motion.
_WEAK_CORRELATION = 0.5


def preprocess(
    recording: Recording,
    vehicle: Vehicle | None = None,
    *,
    delay: float | None = None,
    nominal: Dynamics | None = None,
) -> Trajectory:
    """Turn a recording into a trajectory.

    Clock alignment, checks, dropping of samples out of order, unwrapping of yaw, cropping to the
    commanded span, differentiation between gaps, transport delay. Nothing is interpolated: samples
    stay at the times of the motion capture, and what cannot be used is marked.

    Parameters
    ----------
    recording : Recording
        Poses and commands.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    delay : float, optional
        Transport delay [s]; by default it is found by correlation.
    nominal : Dynamics, optional
        Model to find the delay with; by default the vehicle's nominal one.

    Returns
    -------
    Trajectory
        States, commands, excluded spans and warnings.

    Raises
    ------
    InputError
        If the recording lacks a stream or holds numbers that cannot be what they should be, or if
        poses and commands do not overlap.
    """
    if delay is not None and not 0 <= delay <= LONGEST:
        raise InputError(
            f"must be between 0 and {LONGEST:g} s, not {delay:g}; radios take some 10 ms",
            field="delay",
        )
    vehicle = vehicle or default_vehicle()
    pose, command = recording["pose"], recording["command"]
    order = match_columns(vehicle, command.columns, source=recording.source)
    aligned = align_clocks(pose, command)
    check_poses(pose, aligned.pose_time, recording.source)
    check_commands(command, aligned.command_time, recording.source)
    poses = drop_disorder(aligned.pose_time, pose.values, "pose")
    commands = drop_disorder(aligned.command_time, command.values[:, order], "command")

    first, last = crop_to_commands(
        poses.time,
        commands.time,
        commands.values,
        begins_above=vehicle.command_min + _BEGINS_ABOVE_MINIMUM,
        source=recording.source,
    )
    time, values = poses.time[first:last], poses.values[first:last]
    values = np.column_stack([values[:, :2], unwrap_yaw(values[:, 2])])
    spans = [*find_gaps(time), *find_frozen(time, values), *find_jumps(time, values)]
    spans += find_gaps(commands.time, _NO_COMMANDS, COMMAND_GAP_PERIODS)
    rates, accelerations, short = _differentiate_between_gaps(time, values)
    state = np.concatenate([values, rates], axis=1)
    trajectory = Trajectory(
        time=time,
        state=state,
        acceleration=accelerations,
        command_time=commands.time,
        command=commands.values,
        propellers=vehicle.propeller_names,
        excluded=tuple(spans + short),
        source=recording.source,
        hashes=recording.hashes,
        warnings=recording.warnings + aligned.warnings + poses.warnings + commands.warnings,
    )
    return _with_delay(
        trajectory, delay, nominal or nominal_parameters(vehicle).dynamics(np, vehicle)
    )


def crop_to_commands(
    pose_time: Float[np.ndarray, " N"],
    command_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    *,
    begins_above: float,
    source: str = "",
) -> tuple[int, int]:
    """Find the poses between the first command that moves the craft and the last one."""
    moving = np.flatnonzero(command.max(axis=1) > begins_above)
    if len(moving) == 0:
        raise InputError(
            f"no command exceeds {begins_above:g}: the motors were never told to move", file=source
        )
    # As the authors do: from the command after it on, so that a whole interval has passed.
    begin, end = command_time[min(moving[0] + 1, len(command_time) - 1)], command_time[-1]
    first = int(np.searchsorted(pose_time, begin, side="right"))
    last = int(np.searchsorted(pose_time, end, side="right"))
    if last - first < 2:
        raise InputError(
            f"poses ({pose_time[0]:.3f} to {pose_time[-1]:.3f} s) and commands "
            f"({begin:.3f} to {end:.3f} s) do not overlap; check that both clocks are the same",
            file=source,
        )
    return first, last


def _differentiate_between_gaps(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], list[Span]]:
    """Differentiate each stretch for itself; mark those too short for it."""
    rates, accelerations = np.zeros_like(values), np.zeros_like(values)
    short = []
    for part in stretches(time):
        within = time[part]
        if len(within) < ACCELERATION_WINDOW:
            short.append(Span(float(within[0]), float(within[-1]), "too short to smooth"))
            continue
        rates[part] = velocity(within, values[part])
        accelerations[part] = acceleration(within, values[part])
    return rates, accelerations, short


def _with_delay(trajectory: Trajectory, delay: float | None, nominal: Dynamics) -> Trajectory:
    """Set the transport delay, given or found, and leave out what precedes the first command."""
    warnings = list(trajectory.warnings)
    if delay is None:
        estimate = estimate_delay(
            trajectory.time,
            trajectory.state,
            trajectory.acceleration,
            hold(trajectory.command_time, trajectory.command, trajectory.time),
            nominal,
            trajectory.usable,
        )
        warnings += _judge(estimate)
        delay = max(estimate.samples, 0) * trajectory.sample_period
        skip = max(estimate.samples, 0)
    else:
        begin = trajectory.time[0] + delay
        skip = int(np.searchsorted(trajectory.time, begin))
    keep = slice(skip, None)
    if len(trajectory.time[keep]) < 2:
        raise InputError("is shorter than its transport delay", file=trajectory.source)
    start = trajectory.time[skip]
    return replace(
        trajectory,
        time=trajectory.time[keep] - start,
        state=trajectory.state[keep],
        acceleration=trajectory.acceleration[keep],
        command_time=trajectory.command_time - start,
        delay=float(delay),
        excluded=tuple(
            replace(span, start=span.start - start, stop=span.stop - start)
            for span in (_acting(span, delay) for span in trajectory.excluded)
            if span.stop >= start
        ),
        warnings=tuple(warnings),
    )


def _acting(span: Span, delay: float) -> Span:
    """Extend a pause of the commands to when the next one acts."""
    return replace(span, stop=span.stop + delay) if span.cause == _NO_COMMANDS else span


def _judge(estimate: DelayEstimate) -> list[str]:
    """Say what is odd about an estimated delay."""
    warnings = []
    if estimate.samples < 0:
        warnings.append(
            f"the motion precedes the commands by {-estimate.samples} samples; no delay was "
            "compensated: check the clocks of both streams"
        )
    if estimate.correlation < _WEAK_CORRELATION:
        warnings.append(
            f"the commands explain little of the motion (correlation {estimate.correlation:.2f}): "
            "check motor order and signs with `airpuck check`"
        )
    return warnings
