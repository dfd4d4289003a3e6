"""Check that motor order and signs of a vehicle file agree with a recording.

Measured and expected effects of propellers (two forces, a moment) are matched by direction. Effects
are columns; forces rotate with the frame, moments do not. Magnitudes are compared with each other
only, so thrust, mass and inertia need not be right. Effects come with standard errors
(`window_regression`); a propeller gets no verdict if they leave its effect open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import hold
from airpuck.data.trajectory import Trajectory, check_propellers
from airpuck.deviation.window_regression import LEVEL, WindowRegression, regress_windows
from airpuck.faults.layout_findings import AXES, AxisSigns, LayoutCheck, find_axis_signs
from airpuck.faults.propeller_check import (
    EXCHANGED,
    TURNS,
    PropellerCheck,
    force_to_moment,
    judge_propellers,
    rotation,
    rotation_error,
)
from airpuck.model.model_file import nominal_model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.derivative import smoothed_as_measured

#: Explained fraction, relative to the best, from which signs count as explaining as much.
_AS_GOOD = 0.8
#: Longest transport delay to try: absolute [s], or as a multiple of the vehicle file's.
_LONGEST_DELAY, _OF_STATED_DELAY = 0.1, 2.0
#: Standard error above which that rotation counts as unknown [rad].
_KNOWN_TURN = 0.15
#: Standard error of the effect of a motor that never ran [1/kg].
_UNKNOWN = 1e9
#: Least effects of the floor that are reported: the pull relative to one propeller's push, and in
#: standard errors. On real flights over a level and smooth table, errors of the stated thrusts look
#: like a slope of 1.2 % and 4.6, a dish of 6.1 % and 6.6, and friction of 2.4 % and 2.0.
_FLOOR_REPORTED = {"tilt": (0.05, 5.0), "dish": (0.1, 5.0), "friction": (0.03, 3.0)}
#: Parts of a sample in each of which faster commands are held.
_PARTS = 8
#: Forces and moments give a ratio of lengths. A ratio as far from 1 as this is a wrong unit, not a
#: poor guess of the inertia.
_WRONG_UNIT = 5.0
#: Error of the inertia that is remarked, and corrected before directions are judged: a ratio.
_POOR_INERTIA = 2.0


def check_layout(
    trajectory: Trajectory, vehicle: Vehicle, *, axes: Sequence[str] = AXES
) -> LayoutCheck:
    """Measure each motor's effect, and compare it with the vehicle file.

    Mean accelerations over windows are regressed on the nominal thrusts of all motors
    (`window_regression`). Each column of the result is one motor's effect (two forces and a
    moment). Its direction is compared with the columns of the vehicle's configuration matrix, so
    the nominal thrust, mass and inertia need not be right. Transport delays up to 0.1 s are tried,
    since the one found by correlation relies on the layout in question.

    Parameters
    ----------
    trajectory : Trajectory
        A recording in which every motor was used.
    vehicle : Vehicle
        The vehicle file to check.
    axes : sequence of str, default ("x", "y", "z")
        ``axes`` of the mapping with which the recording was read; suggested corrections refer to
        them.

    Returns
    -------
    LayoutCheck
        A verdict for each propeller, and for the layout as a whole.

    Examples
    --------
    >>> check = airpuck.check_layout(trajectory, airpuck.default_vehicle())
    >>> check.agrees
    True
    """
    check_propellers(vehicle, trajectory)
    stated, forces = nominal_model(vehicle).propeller_effects, _nominal_thrusts(trajectory, vehicle)
    modelled = smoothed_as_measured(trajectory, (stated @ forces).T).T
    signs = find_axis_signs(trajectory, modelled, _longest_delay(vehicle))
    tried = [
        _with_signs(trajectory, vehicle, forces, one, tuple(axes))
        for one in dict.fromkeys((signs, AxisSigns()))
    ]
    # A wrong sign leaves forces or moments unexplained. If several choices explain as much, change
    # as few propellers as possible: with few propellers, reversing one also mirrors the craft.
    most = max(one.explained for one in tried)
    as_good = [one for one in tried if one.explained >= _AS_GOOD * most]
    return max(as_good, key=lambda one: one.untouched)


def _with_signs(
    trajectory: Trajectory,
    vehicle: Vehicle,
    forces: Float[np.ndarray, "n N"],
    signs: AxisSigns,
    axes: tuple[str, ...],
) -> LayoutCheck:
    """Compare effects that are measured with these signs of the axes."""
    nominal, names = nominal_model(vehicle), vehicle.propeller_names
    stated = nominal.propeller_effects
    used = float(np.sum(trajectory.usable)) * trajectory.sample_period
    effects = np.asarray(nominal.dynamics.configuration)
    found = regress_windows(signs.undone(trajectory), forces, effects, _longest_delay(vehicle))
    if found is None:
        unknown = tuple(PropellerCheck(name, 0.0, name, "not judged") for name in names)
        return LayoutCheck(unknown, 0.0, 1.0, 0.0, 0.0, signs, usable=used, axes=axes)
    # Express forces and moments in one unit: moments as forces at the radius of gyration.
    rows = np.array([1.0, 1.0, nominal.radius_of_gyration])[:, None]
    measured, error = rows * found.effect, rows * np.minimum(found.error, _UNKNOWN)
    forces_to_moments = force_to_moment(measured, error, stated)
    # The power of ten by which a wrong unit of length explains the ratio.
    wrong = max(forces_to_moments, 1 / forces_to_moments) > _WRONG_UNIT
    ratio = 10.0 ** round(np.log10(forces_to_moments)) if wrong else 1.0
    # A wrong unit of length is no evidence about the inertia.
    inertia = forces_to_moments if ratio == 1 else 1.0
    measured[:2] /= ratio
    error[:2] /= ratio
    turn, turn_error = rotation(measured, stated), rotation_error(measured, error, stated)
    check = LayoutCheck(
        propellers=(),
        explained=found.explained,
        p_value=found.p_value,
        delay=found.delay,
        rotation=turn if turn_error < _KNOWN_TURN else 0.0,
        signs=signs,
        length_ratio=ratio,
        inertia_ratio=inertia if max(inertia, 1 / inertia) > _POOR_INERTIA else 1.0,
        usable=used,
        axes=axes,
        longer=found.longer,
        window=found.length,
        still=not bool(np.isfinite(found.error).any()),
        **_floor(found, stated * vehicle.nominal_thrust.sum(axis=1), signs),
    )
    layout = check.rotation, check.inertia_ratio
    checks = judge_propellers(measured, error, stated, names, found.independent, layout)
    if check.exchanged:
        turned = {TURNS: EXCHANGED}
        checks = tuple(replace(p, verdict=turned.get(p.verdict, p.verdict)) for p in checks)
    if not check.conclusive:
        checks = tuple(replace(one, verdict="not judged") for one in checks)
    return replace(check, propellers=checks)


def _floor(
    found: WindowRegression, full: Float[np.ndarray, "3 n"], signs: AxisSigns
) -> dict[str, Any]:
    """Return the effects of the floor that are certain and large enough to change the results."""
    pushes = np.linalg.norm(full[:2], axis=0)
    push = np.median(pushes[pushes > 0]) if (pushes > 0).any() else np.inf
    # To the axes of the log.
    flipped = {"tilt": (signs.x, signs.y), "dish": (1, 1, signs.x * signs.y), "friction": (1,)}
    values: dict[str, Any] = {}
    for name, (value, error, pull) in found.floor.items():
        share, errors = _FLOOR_REPORTED[name]
        certain = found.p_value < LEVEL and np.linalg.norm(value) >= errors * error.max()
        if certain and pull >= share * push:
            values[name] = tuple((value * flipped[name]).tolist())
    if "tilt" in values:
        values["tilt_error"] = tuple(found.floor["tilt"][1].tolist())
    # Friction cannot push.
    (friction,) = values.pop("friction", (0.0,))
    return values | ({"friction": friction} if friction > 0 else {})


def _nominal_thrusts(trajectory: Trajectory, vehicle: Vehicle) -> Float[np.ndarray, "n N"]:
    """Return the thrusts of nominal motors without a transport delay."""
    # Pulses shorter than a sample are averaged over it.
    pace, count = np.diff(trajectory.command_time), len(trajectory)
    parts = _PARTS if len(pace) and np.mean(pace) < trajectory.sample_period else 1
    fine = np.interp(np.arange(count * parts) / parts, np.arange(count), trajectory.time)
    command = hold(trajectory.command_time, trajectory.command, fine)
    speed = motor_speeds(fine, command, nominal_model(vehicle).dynamics.lag)
    force = thrust(vehicle.nominal_thrust, speed.T)
    if parts == 1:
        return force
    around = np.arange(count)[:, None] * parts + np.arange(parts) - parts // 2
    return force[:, np.clip(around, 0, count * parts - 1)].mean(axis=-1)


def _longest_delay(vehicle: Vehicle) -> float:
    """Return the longest transport delay to try [s]."""
    return max(_LONGEST_DELAY, _OF_STATED_DELAY * vehicle.nominal.transport_delay_s)
