"""What pulses say about poses, frame, motors and delay, each a check in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.flight.effect_match import AGREES, Likeness, cosines, turn_between, turned
from airpuck.flight.pulse_response import PulseResponse

Verdict = Literal["ok", "look", "wrong"]

#: Shares of the modelled thrust that need no remark: a pulse's length is uncertain by the jitter.
_STRENGTH = (0.7, 1.4)
#: Difference of the transport delay that is worth a remark, and that makes a controller unsafe [s].
_DELAY_DIFFERS, _DELAY_WRONG = 8e-3, 3e-2
#: Poses: least rate [1/s], greatest standard deviation at rest [m, rad] and drift at first [m/s].
_RATE, _NOISE, _DRIFT = 50.0, (1e-3, 2e-2), 0.05
#: Units by which lengths and angles may be off, and how many of them make an SI unit.
_LENGTHS = {"millimetres": 1e3, "centimetres": 1e2}
_DEGREES = 180 / np.pi
#: As many times as far from the middle as the rails no craft is that stands on the table.
_FAR = 2.0
#: Rotation of the rigid body worth a remark, and that no controller should fly with [rad].
_MISALIGNED, _TURNED = 0.12, 0.3
#: Signs by which poses may be wrong, and what that is in words.
_FRAMES = (
    ((1, 1, 1), ""),
    ((1, 1, -1), "the yaw has the wrong sign: it grows counter-clockwise, seen from above"),
    ((1, -1, 1), "an axis of the position has the wrong sign, or x and y are exchanged"),
    ((1, -1, -1), "seen from below: an axis and the yaw have the wrong sign"),
)


@dataclass(frozen=True)
class Check:
    """One thing that was checked."""

    #: What.
    name: str
    #: Whether it is right, deserves a look, or must be mended before a flight.
    verdict: Verdict
    #: What was found, and what to do.
    words: str


def pose_check(
    time: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "N 3"],
    command_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    idle: float,
) -> Check:
    """Check rate, noise and drift of the poses before the first pulse."""
    running = (command > idle + 1e-6).any(axis=1)
    begins = command_time[running.argmax()] if running.any() else np.inf
    rest = time < begins
    rate = 1 / float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if rate < _RATE or rest.sum() < 10:
        return Check("poses", "wrong", f"come at {rate:.0f} Hz; at least {_RATE:g} are needed")
    if not np.ptp(pose, axis=0).any():
        return Check("poses", "wrong", "never change: the rigid body is not tracked")
    line = np.column_stack([np.ones(rest.sum()), time[rest] - time[0]])
    solution, left, *_ = np.linalg.lstsq(line, pose[rest], rcond=None)
    noise = np.sqrt(left / rest.sum()) if len(left) else np.zeros(3)
    drift = float(np.hypot(*solution[1, :2]))
    words = (
        f"{rate:.0f} Hz, noise {1e3 * noise[:2].max():.2g} mm and {1e3 * noise[2]:.2g} mrad at rest"
    )
    if drift > _DRIFT:
        return Check("poses", "look", f"{words}; the craft drifts at {drift:.2f} m/s: let it rest")
    if noise[:2].max() > _NOISE[0] or noise[2] > _NOISE[1]:
        return Check("poses", "look", f"{words}: more than motion capture should have")
    return Check("poses", "ok", words)


def beyond_any_table(pose: Float[np.ndarray, " 3"], reach: Float[np.ndarray, " 2"]) -> Check | None:
    """Say in which units a craft would be on the table that is far from it in metres."""
    x, y = pose[:2]
    if (np.abs(pose[:2]) <= _FAR * reach).all():
        return None
    fitting = [
        unit for unit, factor in _LENGTHS.items() if (np.abs(pose[:2]) <= factor * reach).all()
    ]
    like = f"is it in {' or '.join(fitting)}, or is" if fitting else "is"
    words = (
        f"the craft is at x = {x:.4g}, y = {y:.4g}, beyond any table in metres: {like} the origin "
        "not the middle of the table?"
    )
    return Check("units", "wrong", words)


def pose_units(
    responses: list[PulseResponse], expected: Float[np.ndarray, "3 n"]
) -> tuple[Float[np.ndarray, " 3"], str]:
    """Say in which units poses seem to be, by how much too large the effects are."""
    if not responses:
        return np.ones(3), ""
    push, turn = (
        float(np.median([_ratio(r.effect[part], expected[part, r.motor]) for r in responses]))
        for part in (slice(0, 2), slice(2, 3))
    )
    for unit, factor in _LENGTHS.items():
        if factor / 3 < push <= 3 * factor:
            words = f"positions are in {unit}, not in metres"
            return np.array([1 / factor, 1 / factor, 1.0]), words
    if _DEGREES / 3 < turn < 3 * _DEGREES:
        return np.array([1.0, 1.0, 1 / _DEGREES]), "the yaw is in degrees, not in radians"
    return np.ones(3), ""


def _ratio(measured: Float[np.ndarray, " k"], expected: Float[np.ndarray, " k"]) -> float:
    """Return the ratio of the lengths of two vectors."""
    least = float(np.finfo(float).tiny)
    return float(np.linalg.norm(measured)) / max(float(np.linalg.norm(expected)), least)


def frame_check(
    measured: Callable[[Float[np.ndarray, " 3"]], Float[np.ndarray, "3 m"]],
    expected: Float[np.ndarray, "3 m"],
) -> tuple[Check, bool]:
    """Look for a frame of the poses that explains what all motors do, the likely ones first.

    One that explains only some of them is none: a motor that is wrong must not hide behind it.
    """
    for change, words in _FRAMES:
        effects = measured(np.array(change))
        if not words and (cosines(-effects, expected) >= AGREES).all():
            words = "all motors push the other way: they spin or are mounted the wrong way round"
            return Check("pose frame", "wrong", words), True
        angle = turn_between(effects, expected)
        if (cosines(effects, turned(expected, angle)) < AGREES).any():
            continue
        by = f"turned by {np.rad2deg(angle):.0f} degrees against the craft"
        if words and abs(angle) > _TURNED:
            words = f"{words}; {by}"
        elif abs(angle) > _TURNED:
            words = f"{by}: align the rigid body of the motion capture, or the motors' order"
        if words:
            return Check("pose frame", "wrong", words), True
        if abs(angle) > _MISALIGNED:
            return Check("pose frame", "look", f"{by}: a fit finds it as α"), True
        return Check("pose frame", "ok", "as expected"), True
    return Check("pose frame", "look", "no frame explains what single motors do"), False


def motor_verdict(
    names: tuple[str, ...], k: int, likeness: Likeness | None, strength: float
) -> tuple[Verdict, str]:
    """Say what a motor does."""
    if likeness is None:
        if np.isnan(strength):
            return "look", "was not tried"
        return "wrong", "does nothing: cable, power, or a motor that stands"
    share = f"{100 * strength:.0f} % of the modelled thrust"
    if likeness.acts_as is None:
        angle = np.rad2deg(np.arccos(np.clip(likeness.cosine, -1, 1)))
        return "wrong", f"acts {angle:.0f} degrees off: check position and direction; {share}"
    if likeness.acts_as != k:
        other = names[likeness.acts_as]
        reversed_ = "" if likeness.sign > 0 else " the other way round"
        return "wrong", f"acts like {other}{reversed_}: cables or topics are swapped"
    if likeness.sign < 0:
        return "wrong", f"pushes the other way: spins or is mounted the wrong way round; {share}"
    agrees = _STRENGTH[0] <= strength <= _STRENGTH[1]
    return "ok" if agrees else "look", f"order and sign agree; {share}"


def delay_check(delays: Float[np.ndarray, " p"], modelled: float) -> Check:
    """Compare the transport delay with the model's."""
    found = float(np.median(delays))
    spread = np.quantile(delays, [0.25, 0.75])
    words = (
        f"{1e3 * found:.0f} ms (quartiles {1e3 * spread[0]:.0f} to {1e3 * spread[1]:.0f}), "
        f"the model has {1e3 * modelled:.0f} ms"
    )
    differs = abs(found - modelled)
    if differs > _DELAY_WRONG:
        return Check("transport delay", "wrong", f"{words}: identify anew, or mend the radio")
    if differs > _DELAY_DIFFERS:
        return Check("transport delay", "look", words)
    return Check("transport delay", "ok", words)
