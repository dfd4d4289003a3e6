"""Conversion of a lab's numbers: to seconds, metres, yaw, and fractions of full command."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int64, Shaped

from airpuck.boundary.errors import InputError
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
#: Problem of a number that is not a bit mask.
NO_MASK = f"is not a bit mask (a whole number below 2^{MASK_BITS})"
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
) -> Float[np.ndarray, "N 3"]:
    """Return x, y [m] and yaw [rad] in our axes; `kind` as in `Orientation`, or ``none``."""
    index, sign = mapping.permutation
    if index[:2].max() >= position.shape[1]:
        raise InputError(
            "has two coordinates, and axes needs the third; name three", field="pose.position"
        )
    _check_vertical(position, mapping)
    horizontal = position[:, index[:2]] * sign[:2] * mapping.size("length") - mapping.origin_m
    # Renaming the axes of table and craft rotates the axis of a rotation, but not its angle.
    if kind == "none":
        yaw = np.full(len(position), np.nan)
    elif kind == "yaw":
        yaw = orientation[:, 0] * (mapping.size("angle") * sign[2])
    elif kind == "quaternion":
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
    """Raise InputError if the third coordinate varies while x or y is constant."""
    finite = position[np.isfinite(position).all(axis=1)]
    if position.shape[1] < 3 or len(finite) == 0:
        return
    index, _ = mapping.permutation
    x, y, z = np.ptp(np.quantile(finite[:, index], (0.01, 0.99), axis=0), axis=0)
    size = mapping.size("length")
    if z * size < _TABLE or min(x, y) > _LEVEL * z:
        return
    first, second, third = mapping.axes
    opposite = third.removeprefix("-") if third.startswith("-") else f"-{third}"
    axes = [first, opposite, second] if y < x else [second, third, first]
    level, table = ("y", "x and z") if y < x else ("x", "y and z")
    listed = ", ".join(f'"{axis}"' for axis in axes)
    raise InputError(
        f"the craft moves along {table}, while {level} stays within {1e3 * min(x, y) * size:.1f} "
        f"mm: {level.upper()} is up; say so in a file for --mapping: pose = {{axes = [{listed}]}}",
        field="pose.position",
    )


def _matrices(
    orientation: Float[np.ndarray, "N k"], kind: str, angle: float
) -> Float[np.ndarray, "N 3 3"]:
    """Return rotation matrices from matrix entries or Euler angles."""
    if kind == "matrix":
        found = orientation.reshape(-1, 3, 3)
        finite = found[np.isfinite(orientation).all(axis=1)]
        off = np.abs(finite @ finite.transpose(0, 2, 1) - np.eye(3))
        if (off > _ORTHOGONAL).any() or (np.linalg.det(finite) < 0).any():
            raise InputError("the nine columns are not a rotation matrix", field="pose.orientation")
        return found
    parts = [_about(axis, orientation[:, k] * angle) for k, axis in enumerate(kind.lower())]
    first, second, third = parts if kind.isupper() else parts[::-1]
    return first @ second @ third


def _about(axis: str, angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 3 3"]:
    """Return rotations about one axis."""
    found = np.zeros((len(angle), 3, 3))
    first = "xyz".index(axis)
    second, third = (first + 1) % 3, (first + 2) % 3
    found[:, first, first] = 1
    found[:, second, second] = found[:, third, third] = np.cos(angle)
    found[:, third, second] = np.sin(angle)
    found[:, second, third] = -np.sin(angle)
    return found


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
        return (values - mapping.neutral) / mapping.span
    if (mapping.scale, mapping.offset) == (1, 0):
        return values
    found = mapping.scale * values + mapping.offset
    for limit in (0.0, 1.0):
        found[np.abs(found - limit) < _ROUNDING] = limit
    return found


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
