"""Causes that make a recording or a vehicle file useless, found without a model of the craft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from airpuck.boundary.finding import Finding, by_cause
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.faults.layout_check import check_layout
from airpuck.faults.layout_findings import AXES, LayoutCheck, propeller_findings

#: Pulses of 1 to 2 ms divided by the longest leave commands above this, while motors idle below
#: the second number, and the fraction of the time that a command rests at its lowest value.
_LOWEST_PULSE, _IDLES_BELOW, _RESTS = 0.4, 0.3, 0.05
#: Least largest command of pulses, and fraction of the unexplained motion left by their neutral.
_REACHES, _BETTER = 0.9, 0.6
#: Tolerance of equal commands [1].
_SAME = 1e-3

#: The latest check of each recording, and the vehicle file that it was checked against.
_checks: WeakKeyDictionary[Trajectory, tuple[Vehicle, LayoutCheck]] = WeakKeyDictionary()


def checked_layout(
    trajectory: Trajectory, vehicle: Vehicle, axes: Sequence[str] = AXES
) -> LayoutCheck:
    """Check the layout, once for all who ask."""
    known = _checks.get(trajectory)
    if known is None or known[0] != vehicle:
        known = _checks[trajectory] = vehicle, check_layout(trajectory, vehicle)
    return replace(known[1], axes=tuple(axes))


def recording_findings(
    trajectory: Trajectory, vehicle: Vehicle, axes: Sequence[str] = AXES
) -> tuple[Finding, ...]:
    """Return what is wrong with poses, commands and layout, in the order of causes.

    Lines for the mapping file are in terms of its `axes`. The floor is left out: a model with the
    right terms is not wrong on it.
    """
    if pulses := _pulse_widths(trajectory, vehicle):
        return pulses
    check = checked_layout(trajectory, vehicle, axes)
    if not check.conclusive:
        return ()
    common = [one for one in check.common if one.kind != "physics"]
    return by_cause((*common, *propeller_findings(check)))


def _pulse_widths(trajectory: Trajectory, vehicle: Vehicle) -> tuple[Finding, ...]:
    """Report commands that look like pulse widths whose neutral was not subtracted."""
    command = trajectory.command
    if vehicle.actuation.two_way.any() or vehicle.command_min > _IDLES_BELOW or not len(command):
        return ()
    lowest = command.min(axis=0)
    rests = np.mean(command <= lowest + _SAME, axis=0)
    idle = float(np.median(lowest))
    moves = np.ptp(command, axis=0) > _SAME
    if not (moves.all() and (np.abs(lowest - idle) <= _SAME).all() and (rests > _RESTS).all()):
        return ()
    if idle < _LOWEST_PULSE or command.max() < _REACHES:
        return ()
    # As pulses they must explain the motion better; a motor may also rest at such a command.
    pulses = replace(trajectory, command=(command - idle) / (1 - idle))
    left = 1 - check_layout(pulses, vehicle).explained
    if left > _BETTER * (1 - checked_layout(trajectory, vehicle).explained):
        return ()
    return (
        Finding(
            "units",
            "The commands look like pulse widths without their neutral",
            f"every motor rests at {idle:.2g}, never below",
            "Use neutral and span instead of scale in the mapping file, under [command], such as "
            "neutral = 1000, span = 1000; if motors do idle there, say so in the vehicle file "
            "(command_min).",
        ),
    )
