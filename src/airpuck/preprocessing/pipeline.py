"""From a recording to a trajectory: all steps of subsec:data_preprocessing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.settings import fits
from airpuck.craft.vehicle import Vehicle, default_vehicle, match_columns
from airpuck.data.sampling import bridged, usual_period
from airpuck.data.trajectory import Span, Trajectory
from airpuck.data.trajectory_file import read_trajectory
from airpuck.model.parameters import nominal_parameters
from airpuck.physics.rigid_body import Dynamics
from airpuck.preprocessing.camera_clock import at_exposure
from airpuck.preprocessing.clock import Aligned, align_clocks, continued
from airpuck.preprocessing.delay import commands_explain, estimate_delay, motion_precedes
from airpuck.preprocessing.derivative import (
    acceleration,
    in_parts,
    shortest_stretch,
    smooth_stretches,
    smoothing_times,
    unwrap_yaw,
    velocity,
)
from airpuck.preprocessing.quality import (
    COMMAND_GAP_PERIODS,
    Samples,
    check_commands,
    check_poses,
    drop_disorder,
    find_frozen,
    find_gaps,
    find_jumps,
    interpolated,
    longest_pause,
    lost_frames_words,
    other_parts,
    steps_of_motion,
    with_lost_frames,
)
from airpuck.recording.mapping import RecordingMapping, Topics
from airpuck.recording.read import read_recording
from airpuck.recording.stream import Recording
from airpuck.recording.torch_archive import read_authors_experiment

#: A command this far above the lowest one marks the beginning of the experiment.
_BEGINS_ABOVE_MINIMUM = 0.02
_NO_COMMANDS = "no commands"
#: Correlation below which no delay can be found. A flight that only hovers has 0.1, a flight
#: between set points more than 0.5.
_NO_DELAY_BELOW = 0.3
#: Correlation below which the commands do not explain the motion.
_WEAK_CORRELATION = 0.5

#: A recording: its path, what was read from it, or what was preprocessed.
Source = str | os.PathLike[str] | Recording | Trajectory


def load_trajectory(
    path: Source,
    vehicle: Vehicle | None = None,
    *,
    mapping: RecordingMapping | None = None,
    topics: Topics | None = None,
    delay: float | None = None,
) -> Trajectory:
    """Read a recording and preprocess it, or read an already preprocessed one.

    Parameters
    ----------
    path : path-like, Recording or Trajectory
        Anything that `read_recording` reads, the authors' data.pt (or its folder), or an .npz
        written by `Trajectory.save`. What was read already is preprocessed; what was preprocessed
        already is returned unchanged.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    mapping : RecordingMapping, optional
        Topics, files, columns, units and axes of a recording.
    topics : Topics, optional
        Short for a mapping that only names topics.
    delay : float, optional
        Transport delay of a raw recording [s]; by default estimated by correlation.

    Returns
    -------
    Trajectory
        The trajectory.

    Raises
    ------
    InputError
        If the file cannot be read or does not fit the vehicle.

    Examples
    --------
    >>> airpuck.write_bag(recording, "bag/")
    >>> trajectory = airpuck.load_trajectory("bag/")
    >>> trajectory.propellers[0]
    'motor_a_1'
    """
    if isinstance(path, Trajectory):
        return path
    if isinstance(path, Recording):
        return preprocess(path, vehicle, delay=delay)
    path = Path(path)
    archive = path / "data.pt" if path.is_dir() else path
    preprocessed = path.suffix == ".npz" or (archive.suffix == ".pt" and archive.is_file())
    if preprocessed and (delay, mapping, topics) != (None, None, None):
        raise InputError(
            "is preprocessed already: its transport delay is fixed and there is nothing to map",
            file=path,
            field="delay" if delay is not None else "mapping",
        )
    if path.suffix == ".npz":
        return read_trajectory(path)
    if preprocessed:
        return read_authors_experiment(archive)
    return preprocess(read_recording(path, mapping=mapping, topics=topics), vehicle, delay=delay)


def load_all(
    recordings: Source | Iterable[Source],
    vehicle: Vehicle | None = None,
    mapping: RecordingMapping | None = None,
) -> list[Trajectory]:
    """Return the trajectories of one or several recordings, whatever form each has."""
    several = isinstance(recordings, Iterable) and not fits(recordings, Source)
    given: Any = recordings if several else [recordings]
    listed = list(given)
    strange = [type(one).__name__ for one in listed if not fits(one, Source)]
    if strange or not listed:
        problem = f"must be paths, recordings or trajectories, not {[*strange, 'nothing'][0]}"
        raise InputError(problem, field="recordings")
    return [load_trajectory(one, vehicle, mapping=mapping) for one in listed]


def preprocess(
    recording: Recording,
    vehicle: Vehicle | None = None,
    *,
    delay: float | None = None,
    nominal: Dynamics | None = None,
) -> Trajectory:
    """Turn a recording into a trajectory.

    The steps are clock alignment, checks, dropping of out-of-order samples, unwrapping of yaw,
    cropping to the commanded span, differentiation between gaps, and transport delay. Nothing is
    interpolated: samples keep the times of the motion capture, and unusable ones are marked.

    Parameters
    ----------
    recording : Recording
        Poses and commands.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    delay : float, optional
        Transport delay [s]; by default estimated by correlation.
    nominal : Dynamics, optional
        Model for estimating the delay; by default the vehicle's nominal one.

    Returns
    -------
    Trajectory
        States, commands, excluded spans and warnings.

    Raises
    ------
    InputError
        If the recording lacks a stream or holds implausible numbers, or if poses and commands do
        not overlap.

    Examples
    --------
    >>> trajectory = airpuck.preprocess(recording)
    >>> 0.01 < trajectory.delay < 0.03  # [s]
    True
    """
    if delay is not None:
        numbers.DELAY.check(delay, "delay")
    vehicle = vehicle or default_vehicle()
    poses, commands, aligned = clean_streams(recording, vehicle)
    begins_above = vehicle.command_min + _BEGINS_ABOVE_MINIMUM
    with about(recording.source):
        kept = _crop_to_commands(poses.time, commands, begins_above)
    time, values = poses.time[kept], poses.values[kept]
    values = np.column_stack([values[:, :2], unwrap_yaw(values[:, 2])])
    jumps, frozen = find_jumps(time, values), find_frozen(time, values)
    pauses = find_gaps(time, longest_pause(usual_period(time)))
    pose = recording["pose"]
    logged = (pose.stamp_ns != pose.received_ns).any()  # then arrivals show steps of its clock
    stepped = {} if logged else steps_of_motion(time, values)
    time, values, measured = with_lost_frames(time, values)
    breaks = (*poses.breaks, *commands.breaks, *stepped)
    state, accelerations, short = _differentiated(time, values, measured, jumps, vehicle)
    longest = COMMAND_GAP_PERIODS * usual_period(commands.time) if len(commands.time) > 1 else 0.0
    silent = find_gaps(commands.time, longest, _NO_COMMANDS)
    unusable = (*pauses, *frozen, *jumps, *silent, *short, *other_parts(time, breaks))
    driven, drive = vehicle.actuation.drive(commands.time, commands.values)
    trajectory = Trajectory(
        time=time,
        state=state,
        acceleration=accelerations,
        command_time=driven,
        command=drive,
        propellers=vehicle.propeller_names,
        excluded=unusable,
        source=recording.source,
        hashes=recording.hashes,
        warnings=recording.warnings
        + aligned.warnings
        + poses.warnings
        + tuple(
            f"the cameras' clock steps by {1e3 * step:.0f} ms after {after:.3f} s: the motion shows"
            " that no frame is lost there; the longest part of the recording is used"
            for after, step in stepped.items()
        )
        + lost_frames_words(time, measured)
        + commands.warnings,
        vehicle=vehicle,
        lost=time[~measured],
    )
    nominal = nominal or nominal_parameters(vehicle).dynamics(np, vehicle)
    return _compensate_delay(trajectory, delay, nominal, vehicle.nominal.transport_delay_s)


def clean_streams(recording: Recording, vehicle: Vehicle) -> tuple[Samples, Samples, Aligned]:
    """Return poses and commands on one time axis, checked, sorted, and in the vehicle's order."""
    pose, command = recording["pose"], recording["command"]
    order = match_columns(vehicle, command.columns, source=recording.source)
    pose, rolled = continued(pose, "pose")
    pose, said = at_exposure(pose)
    aligned = align_clocks(pose, command)
    aligned = replace(aligned, warnings=(*rolled, *said, *aligned.warnings))
    lowest = np.where(vehicle.actuation.two_way, -1.0, 0.0)[np.argsort(order)]
    try:
        check_poses(pose, aligned.pose_time)
        check_commands(command, aligned.command_time, lowest)
        poses = drop_disorder(aligned.pose_time, pose.values, "pose")
        commands = drop_disorder(aligned.command_time, command.values[:, order], "command")
    except InputError as error:  # stamps may be the cause
        problem, file = "; ".join((error.problem, *aligned.warnings)), recording.source
        raise InputError(problem, file=file, field=error.field) from error
    return poses, commands, aligned


def _crop_to_commands(
    pose_time: Float[np.ndarray, " N"], commands: Samples, begins_above: float
) -> slice:
    """Find the poses between the first command that moves the craft and the last command."""
    time, command = commands.time, commands.values
    moving = np.flatnonzero(np.abs(command).max(axis=1) > begins_above)
    if len(moving) == 0:
        raise InputError(f"no command exceeds {begins_above:g}: the motors never moved the craft")
    # Like the authors, start with the command after it, so that a whole interval has passed.
    begin, end = time[min(moving[0] + 1, len(time) - 1)], time[-1]
    first, last = np.searchsorted(pose_time, (begin, end), side="right").tolist()
    if last - first < 2:
        raise InputError(
            f"poses ({pose_time[0]:.3f} to {pose_time[-1]:.3f} s) and commands "
            f"({begin:.3f} to {end:.3f} s) do not overlap; check that both clocks are the same "
            "(dates count seconds from 1970), or shift one by start_s in a mapping"
        )
    return slice(first, last)


def _differentiated(
    time: Float[np.ndarray, " N"],
    values: Float[np.ndarray, "N 3"],
    measured: Bool[np.ndarray, " N"],
    jumps: Sequence[Span],
    vehicle: Vehicle,
) -> tuple[Float[np.ndarray, "N 6"], Float[np.ndarray, "N 3"], list[Span]]:
    """Differentiate each stretch between long pauses separately; mark those that are too short."""
    rates, accelerations = np.zeros_like(values), np.zeros_like(values)
    short, period = [], usual_period(time[measured])
    fewest = shortest_stretch(period)
    durations = smoothing_times(time[measured], values[measured], vehicle)
    known = bridged(time, measured)
    for part in smooth_stretches(time, known, max(durations), jumps):
        within, real = time[part], measured[part]
        if len(within) >= fewest:
            for found, derive in ((rates, velocity), (accelerations, acceleration)):
                found[part] = in_parts(derive, within, values[part], period, durations, real)
        elif not any(jump.start <= within[0] and within[-1] <= jump.stop for jump in jumps):
            short.append(Span(float(within[0]), float(within[-1]), "too short to smooth"))
    if measured.all():
        return np.concatenate([values, rates], axis=1), accelerations, short
    values, between = interpolated(time, values, rates, measured)
    rates[~known] = between[~known]
    for column in accelerations.T:
        column[~known] = np.interp(time[~known], time[known], column[known])
    return np.concatenate([values, rates], axis=1), accelerations, short


def _compensate_delay(
    trajectory: Trajectory, delay: float | None, nominal: Dynamics, usual: float
) -> Trajectory:
    """Set the transport delay, given or estimated; drop the samples before the first command."""
    warnings = list(trajectory.warnings)
    if delay is None:
        samples, correlation = estimate_delay(trajectory, nominal)
        found = correlation >= _NO_DELAY_BELOW
        if samples < 0 and found and motion_precedes(trajectory, nominal):
            warnings.append(
                f"the motion precedes the commands by {-samples * trajectory.sample_period:.2g} s; "
                "no delay was compensated: check the clocks of both streams"
            )
        # A low correlation may be due to noise: a regression decides whether commands cause the
        # motion.
        if correlation < _WEAK_CORRELATION and not commands_explain(trajectory, nominal):
            warnings.append(
                f"the commands explain little of the motion (correlation {correlation:.2f}): "
                "check motor order and signs with `airpuck check`"
            )
        if not found:
            warnings.append(f"no delay was found; the vehicle's, {1e3 * usual:.1f} ms, is used")
        delay = max(samples, 0) * trajectory.sample_period if found else usual
        first = round(delay / trajectory.sample_period)
    else:
        first = int(np.searchsorted(trajectory.time, trajectory.time[0] + delay))
    if len(trajectory) - first < 2:
        raise InputError("is shorter than its transport delay", file=trajectory.source)
    start = trajectory.time[first]
    excluded = []
    for span in trajectory.excluded:
        # A pause of the commands lasts until the next command acts.
        stop = span.stop + delay if span.cause == _NO_COMMANDS else span.stop
        if stop >= start:
            excluded.append(replace(span, start=span.start - start, stop=stop - start))
    return replace(
        trajectory,
        time=trajectory.time[first:] - start,
        state=trajectory.state[first:],
        acceleration=trajectory.acceleration[first:],
        lost=trajectory.lost - start,
        command_time=trajectory.command_time - start,
        delay=float(delay),
        excluded=tuple(excluded),
        warnings=tuple(warnings),
    )
