"""Conversion of a lab's numbers: to seconds, metres, yaw, and fractions of full command."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, Shaped

from airpuck.boundary.errors import InputError, listing, shortened
from airpuck.craft.vehicle import unnamed_columns
from airpuck.recording.mapping import MASK_BITS, CommandMapping, PoseMapping

SECOND_NS = 10**9
#: A quaternion whose squared norm is this close to one is not normalised.
_UNIT = 1e-3
#: Numbers of a rotation matrix are exported with five digits or more.
_ORTHOGONAL = 1e-2
#: Limits on the variation of a height above the table: a coordinate that varies by more than the
#: first number is no height [m]; the true height varies by at most the second, as a fraction of
#: that coordinate.
_TABLE, _LEVEL = 0.2, 0.02
#: A height without a third coordinate: the cameras' noise, at most this large [m], above the origin
#: by more than it varies.
_STILL = 1e-3
#: Problem of a number that is not a bit mask.
NO_MASK = f"is not a bit mask (a whole number below 2^{MASK_BITS})"
#: A planar craft rolls less, apart from noise and a tilted body frame, which is constant [rad].
_ROLLS = np.radians(20)
#: A command below this is no disarmed pulse: PX4's is 900 µs, with motors from 1000 to 2000 µs.
_REVERSES = -0.5
#: Most pulses that mean disarmed.
_DISARMED = 3
#: Rounding of scale and offset may leave a command this far outside [0, 1].
_ROUNDING = 1e-9


def stamps_of(
    time: Shaped[np.ndarray, " N"], mapping: PoseMapping | CommandMapping
) -> Int64[np.ndarray, " N"]:
    """Return times [ns]; whole numbers and NumPy's dates are exact."""
    if time.dtype.kind in "Mm":
        missing, whole = np.isnat(time), time.astype(f"{time.dtype.kind}8[ns]").astype(np.int64)
        nanoseconds = whole.astype(float)
    else:
        missing = ~np.isfinite(time)
        unit = mapping.size("time")
        with np.errstate(over="ignore"):  # reported below
            nanoseconds = np.where(missing, 0.0, time) * (unit * SECOND_NS)
        whole = time * round(unit * SECOND_NS) if time.dtype.kind in "iu" else None
    if missing.any():
        row = int(np.argmax(missing)) + 1
        raise InputError(f"row {row} has no time; remove it", field="time")
    nanoseconds += mapping.start_s * SECOND_NS
    if len(time) and np.abs(nanoseconds).max() >= 2**63:
        latest = np.abs(nanoseconds).max() / SECOND_NS
        raise InputError(
            f'reaches {latest:.3g} s, which no clock shows; name its unit, as in units = ["ns"]',
            field="time",
        )
    if whole is None:
        return np.round(nanoseconds).astype(np.int64)
    return whole.astype(np.int64) + round(mapping.start_s * SECOND_NS)


def poses_of(
    position: Float[np.ndarray, "N d"],
    orientation: Float[np.ndarray, "N k"],
    kind: str,
    mapping: PoseMapping,
    names: Sequence[str] = (),
) -> Float[np.ndarray, "N 3"]:
    """Return x, y [m] and yaw [rad] in our axes; NaN for rotations of zero length.

    `kind` is as in `Orientation`, or ``none``; `names` are the orientation's fields in messages.
    """
    index, sign = mapping.permutation
    if kind in ("quaternion", "matrix"):
        # Some programs write zeros when they lose the body.
        orientation = np.where(orientation.any(axis=1, keepdims=True), orientation, np.nan)
    if index[:2].max() >= position.shape[1]:
        raise InputError(
            "has two coordinates, and axes needs the third; name three", field="pose.position"
        )
    if kind != "none":
        _check_vertical(position, mapping)
    horizontal = position[:, index[:2]] * sign[:2] * mapping.size("length") - mapping.origin_m
    # Renaming the axes of table and craft rotates the axis of a rotation, but not its angle.
    if kind == "none":
        yaw = np.full(len(position), np.nan)
    elif kind == "yaw":
        yaw = orientation[:, 0] * (mapping.size("angle") * sign[2])
    elif kind == "quaternion":
        _check_order(orientation, mapping, names)
        x, y, z = (orientation[:, index] * sign).T
        yaw = yaw_of(x, y, z, orientation[:, 3])
    else:
        matrix = _matrices(orientation, kind, mapping.size("angle"))
        # If the axes are a mirror image, the sense of rotations also stays the same.
        mirrored = np.linalg.det(np.eye(3)[index] * sign[:, None]) < 0
        row, column = (0, 1) if mirrored else (1, 0)
        sine = matrix[:, index[row], index[column]] * sign[0] * sign[1]
        yaw = np.arctan2(sine, matrix[:, index[0], index[0]])
    return np.column_stack([horizontal, yaw])


def _check_vertical(position: Float[np.ndarray, "N d"], mapping: PoseMapping) -> None:
    """Raise InputError if x or y is constant while another coordinate varies."""
    finite = position[np.isfinite(position).all(axis=1)]
    if len(finite) < 2:
        return
    index = mapping.permutation[0][: position.shape[1]]
    moved = mapping.size("length") * finite[:, index]
    x, y, *others = np.ptp(np.quantile(moved, (0.01, 0.99), axis=0), axis=0)
    flat, least, most = int(y < x), min(x, y), max(x, y)
    if others:
        if others[0] < _TABLE or least > _LEVEL * others[0]:
            return
    else:
        height = moved[:, flat]
        noisy = np.var(np.diff(height)) > np.var(height) > 0 and abs(height.mean()) > least
        if most <= _TABLE or least >= _STILL or not noisy:
            return
    first, second, third = mapping.axes
    opposite = third.removeprefix("-") if third.startswith("-") else f"-{third}"
    axes = [first, opposite, second] if flat else [second, third, first]
    listed = ", ".join(f'"{axis}"' for axis in axes)
    level, table = ("y", "x and z") if flat else ("x", "y and z")
    which, stays = ("first", "second", "third")[index[flat]], f"stays within {1e3 * least:.1f} mm"
    raise InputError(
        f"the craft moves along {table}, while {level} {stays}: {level.upper()} is up; say so in a "
        f"file for --mapping: pose = {{axes = [{listed}]}}"
        if others
        else f"the craft moves, while its {which} coordinate {stays}, like a height; name the "
        f"columns of all three, and pose = {{axes = [{listed}]}}",
        field="pose.position",
    )


def _check_order(
    quaternion: Float[np.ndarray, "N 4"], mapping: PoseMapping, names: Sequence[str]
) -> None:
    """Raise InputError if the craft rolls, and does not with the quaternion in another order."""
    index, sign = mapping.permutation

    def tilt(order: Sequence[int]) -> Float[np.ndarray, "2"]:
        """Return quantiles of the angle between the craft's and the table's vertical axis."""
        x, y, z, w = (quaternion[:, order][:, [*index, 3]] * [*sign, 1]).T
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            level = 1 - 2 * (x * x + y * y) / (x * x + y * y + z * z + w * w)
        angles = np.arccos(np.clip(level[np.isfinite(level)], -1, 1))
        return np.quantile(angles, (0.05, 0.95)) if len(angles) else np.zeros(2)

    low, high = tilt(range(4))
    if high < _ROLLS or high - low < _ROLLS:
        return
    for order, first in (((1, 2, 3, 0), "w, x, y, z"), ((3, 0, 1, 2), "x, y, z, w")):
        if tilt(order)[1] > _ROLLS:
            continue
        remedy = "reorder its columns"
        if names:
            places = zip("xyzw", (names[place] for place in order), strict=True)
            listed = ", ".join(f'{axis} = "{name}"' for axis, name in places)
            remedy = f"say so in a file for --mapping: pose = {{orientation = {{{listed}}}}}"
        raise InputError(
            f"the craft would roll by up to {np.degrees(high):.0f} degrees: the quaternion is in "
            f"the order {first}; {remedy}",
            field="pose.orientation",
        )


def _matrices(
    orientation: Float[np.ndarray, "N k"], kind: str, angle: float
) -> Float[np.ndarray, "N 3 3"]:
    """Return rotation matrices from matrix entries, rotation vectors or Euler angles."""
    if kind == "matrix":
        found = orientation.reshape(-1, 3, 3)
        finite = found[np.isfinite(orientation).all(axis=1)]
        off = np.abs(finite @ finite.transpose(0, 2, 1) - np.eye(3))
        if (off > _ORTHOGONAL).any() or (np.linalg.det(finite) < 0).any():
            raise InputError("the nine columns are not a rotation matrix", field="pose.orientation")
        return found
    from scipy.spatial.transform import Rotation

    if kind == "vector":
        return Rotation.from_rotvec(orientation * angle).as_matrix()
    return Rotation.from_euler(kind, orientation * angle).as_matrix()


def yaw_of(
    x: Float[np.ndarray, " N"],
    y: Float[np.ndarray, " N"],
    z: Float[np.ndarray, " N"],
    w: Float[np.ndarray, " N"],
) -> Float[np.ndarray, " N"]:
    """Return the rotation of quaternions about the vertical axis [rad]."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        square = x * x + y * y + z * z + w * w
        # Already of unit length in single precision: not normalised, as in the authors' conversion.
        double = np.where(np.abs(square - 1) < _UNIT, 2.0, 2.0 / square)
        return np.arctan2(double * (w * z + x * y), 1 - double * (y * y + z * z))


def commands_of(
    values: Float[np.ndarray, "N k"], mapping: CommandMapping
) -> Float[np.ndarray, "N n"]:
    """Return fractions of full command."""
    if mapping.bits:
        return _switches(values, mapping.bits)
    if mapping.neutral is not None and mapping.span is not None:
        found = (values - mapping.neutral) / mapping.span
        if mapping.disarmed is None:
            _check_disarmed(values, found)
    elif (mapping.scale, mapping.offset) == (1, 0):
        found = values
    else:
        found = mapping.scale * values + mapping.offset
        for limit in (0.0, 1.0):
            found[np.abs(found - limit) < _ROUNDING] = limit
    if mapping.disarmed is not None:
        found = np.where(values == mapping.disarmed, 0.0, found)
    return found


def _check_disarmed(values: Float[np.ndarray, "N k"], found: Float[np.ndarray, "N k"]) -> None:
    """Raise InputError if a pulse below the neutral one is always sent to all motors at once.

    Propellers that reverse have many such pulses, and not all at once.
    """
    below = found < 0
    pulses = np.unique(values[below])
    together = (below.any(axis=1) == below.all(axis=1)).all()
    if not together or not 0 < len(pulses) <= _DISARMED:
        return
    if found.min() > _REVERSES or (len(pulses) == 1 and pulses[0] == 0):
        one = f"say so in a file for --mapping: command = {{disarmed = {pulses[0]:g}}}"
        many = "replace them by the neutral one"
        raise InputError(
            f"pulses of {', '.join(f'{pulse:g}' for pulse in pulses)} lie below the neutral "
            f"one, in {int(below.all(axis=1).sum())} of {len(values)} commands and all motors at "
            f"once: if they are disarmed then, {one if len(pulses) == 1 else many}",
            field="command.neutral",
        )


def _switches(values: Float[np.ndarray, "N k"], bits: tuple[int, ...]) -> Float[np.ndarray, "N n"]:
    """Return the switches in bit masks."""
    if values.shape[1] != 1:
        raise InputError(
            f"a bit mask is one value, and there are {values.shape[1]}", field="command.bits"
        )
    wrong = ~is_mask(values[:, 0])
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"row {row + 1}: {values[row, 0]:g} {NO_MASK}", field="command.bits")
    return (values.astype(np.int64) >> np.array(bits) & 1).astype(np.float64)


def is_mask(value: Any) -> Any:
    """Return where numbers are bit masks: whole, not negative, exact as float64."""
    return (value >= 0) & (value < 2.0**MASK_BITS) & (value == np.floor(value))


def propellers_of(names: tuple[str, ...], mapping: CommandMapping) -> tuple[str, ...]:
    """Return the names of a command's columns, from the mapping if it has any."""
    if mapping.bits:
        names = unnamed_columns(len(mapping.bits))
    if mapping.propellers and len(mapping.propellers) != len(names):
        raise InputError(
            f"names {len(mapping.propellers)} propellers for {len(names)} values",
            field="command.propellers",
        )
    return mapping.propellers or names


def chosen_body(
    names: Iterable[str],
    body: str,
    path: str | os.PathLike[str] | None = None,
    stream: str = "pose",
) -> str:
    """Return the rigid body to read: the only one, or the one named in the mapping."""
    found = list(dict.fromkeys(names))
    if body in found:
        return body
    if len(found) == 1 and not body:
        return found[0]
    if not found:
        raise InputError("names no rigid bodies; leave out body", file=path, field=f"{stream}.body")
    raise InputError(
        f"contains the rigid bodies {listing(found)}; choose one in the mapping, as in "
        f'{stream} = {{body = "{shortened(found[0])}"}}',
        file=path,
        field=f"{stream}.body" if body else None,
    )
