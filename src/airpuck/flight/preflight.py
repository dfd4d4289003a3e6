"""Preflight checks: motor order, spin directions, signs, delay and pose frame, in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import Result
from airpuck.craft.table import Table
from airpuck.craft.vehicle import match_columns
from airpuck.faults.propeller_check import (
    AGREES,
    EffectMatch,
    cosines,
    match_effects,
    rotation,
    turned,
)
from airpuck.flight.loop import Link, fly
from airpuck.flight.pulses import PulsePlan, PulseResponse, PulseTest, pulse_responses, sound_pulses
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.preprocessing.clock import align_clocks
from airpuck.recording.stream import Recording

CheckStatus = Literal["ok", "look", "wrong"]

#: Fractions of the modelled thrust that need no comment: jitter makes a pulse's length uncertain.
_STRENGTH = (0.7, 1.4)
#: Difference of the transport delay that is worth mentioning, and that makes a controller unsafe
#: [s].
_DELAY_DIFFERS, _DELAY_WRONG = 8e-3, 3e-2
#: Limits for poses: lowest rate [1/s], largest standard deviation at rest [m, rad], largest initial
#: drift [m/s].
_RATE, _NOISE, _DRIFT = 50.0, (1e-3, 2e-2), 0.05
#: Units that poses may mistakenly be in, and how many of each make an SI unit.
_LENGTHS = {"millimetres": 1e3, "centimetres": 1e2}
_DEGREES = 180 / np.pi
#: No craft stands on the table beyond this multiple of the rails' distance from the centre.
_FAR = 2.0
#: Rotation of the rigid body that is worth mentioning, and that no controller should fly with
#: [rad].
_MISALIGNED, _TURNED = 0.12, 0.3
#: Sign errors of poses, and their descriptions.
_FRAMES = (
    ((1, 1, 1), ""),
    ((1, 1, -1), "the yaw has the wrong sign: it grows counter-clockwise, seen from above"),
    ((1, -1, 1), "an axis of the position has the wrong sign, or x and y are exchanged"),
    ((1, -1, -1), "seen from below: an axis and the yaw have the wrong sign"),
)
#: Fraction of the modelled effect below which a motor counts as dead.
_SILENT = 0.15
#: A motor did not start if a pulse had less than this fraction of the effect of its strongest one.
_STARTED = 0.4
#: The test never turns the craft this far: such a yaw is in degrees.
_MOST_TURNS = 2


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    #: The checked item.
    name: str
    #: Whether it is right, deserves a look, or must be fixed before a flight.
    verdict: CheckStatus
    #: The finding and its remedy.
    words: str


@dataclass(frozen=True, eq=False)
class Preflight(Result):
    """Result of `preflight`."""

    JSON = "ready checks strength=strengths delay_s=delay"

    #: Checks, in the order in which to fix them.
    checks: tuple[Check, ...]
    #: Names of the propellers.
    names: tuple[str, ...]
    #: Thrust of each, as a fraction of the modelled one; nan if not measured.
    strength: Float[np.ndarray, " n"]
    #: Median transport delay of the working motors [s]; nan if none works.
    delay: float

    @property
    def strengths(self) -> dict[str, float]:
        """`strength` of each propeller, by name."""
        return dict(zip(self.names, self.strength.tolist(), strict=True))

    @property
    def ready(self) -> bool:
        """Whether nothing is wrong."""
        return all(check.verdict != "wrong" for check in self.checks)


def preflight(
    link: Link, model: Model, plan: PulsePlan | None = None, table: Table | None = None
) -> Preflight:
    """Give each motor short pulses, and compare the craft's response with the model.

    Parameters
    ----------
    link : Link
        The craft, at rest near the centre of the table.
    model : Model
        Model of the craft.
    plan : PulsePlan, optional
        Strength and length of the pulses.
    table : Table, optional
        Table with the rails.

    Returns
    -------
    Preflight
        Findings in words.

    Examples
    --------
    >>> found = airpuck.preflight(airpuck.Twin(model), model)
    >>> len(found.names)
    6
    """
    pilot = PulseTest(model.vehicle, plan, table)
    fly(pilot, link, pilot.duration)
    return judge_test(pilot, model)


def judge_test(pilot: PulseTest, model: Model) -> Preflight:
    """Judge a completed test."""
    if not pilot.poses:
        check = Check(
            "poses", "wrong", "none arrived: is the motion capture sending, on this topic?"
        )
        return _found_only(check, model)
    pose_time, poses = zip(*pilot.poses, strict=True)
    beyond = _beyond_any_table(poses[-1], pilot.reach) if pilot.stopped else None
    if beyond is not None:
        return _found_only(beyond, model)
    command_time, commands = zip(*pilot.sent_commands, strict=True)
    found = judge_pulses(
        model, np.array(pose_time), np.array(poses), np.array(command_time), np.array(commands)
    )
    if pilot.stopped:
        missed = np.isnan(found.strength).any()
        early = Check("test", "wrong" if missed else "look", f"ended early: {pilot.stopped}")
        found = replace(found, checks=(early, *found.checks))
    return found


def _found_only(check: Check, model: Model) -> Preflight:
    """Return a test that ended before any motor was tried."""
    unknown = np.full(model.vehicle.n_propellers, np.nan)
    return Preflight((check,), model.vehicle.propeller_names, unknown, np.nan)


def judge_recording(model: Model, recording: Recording) -> Preflight:
    """Judge the pulses of a recorded test; see `preflight`."""
    pose, command = recording["pose"], recording["command"]
    order = match_columns(model.vehicle, command.columns, source=recording.source)
    clocks = align_clocks(pose, command)
    return judge_pulses(
        model, clocks.pose_time, pose.values[:, :3], clocks.command_time, command.values[:, order]
    )


def judge_pulses(
    model: Model,
    time: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "N 3"],
    command_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
) -> Preflight:
    """Compare the effects of pulses with the model."""
    n, names = model.vehicle.n_propellers, model.vehicle.propeller_names
    pose = np.column_stack([pose[:, :2], _continuous(pose[:, 2])])
    if model.vehicle.actuation.two_way.any():
        command = np.maximum(model.vehicle.actuation.split(command), model.vehicle.command_min)
    running = (command > model.vehicle.command_min + 1e-6).any(axis=1)
    rest = time < (command_time[running.argmax()] if running.any() else np.inf)
    checks = [_pose_check(time, pose, rest)]
    # Express forces and moments in one unit: moments as forces at the radius of gyration.
    expected = acceleration_map(np, model.dynamics, 0.0, 0.0)[0]
    scale = np.array([1.0, 1.0, model.radius_of_gyration])[:, None]

    responses = pulse_responses(model, time, pose, command_time, command)
    delays = np.array([response.delay for response in responses])

    def measured(change: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 n"]:
        """Effects of all motors if poses are scaled by these factors; nan if not tried."""
        again = pulse_responses(model, time, pose * change, command_time, command, delays)
        effects = np.full((3, n), np.nan)
        for motor, pulses in sound_pulses(again, model.radius_of_gyration, _STARTED).items():
            effects[:, motor] = np.mean([response.effect for response in pulses], axis=0)
        return scale * effects

    unit, words = _pose_units(responses, expected)
    if words:
        checks.append(Check("units", "wrong", words))
    effects, expected = measured(unit), scale * expected
    strength = np.linalg.norm(effects, axis=0) / np.linalg.norm(expected, axis=0)
    tried = ~np.isnan(strength)
    moves = tried & ~(strength < _SILENT)
    if not moves.any():
        words = "no pulse of a single motor was recorded"
        if tried.any():
            words = "none responds: armed? powered? does the radio use the command's topic?"
        checks.append(Check("motors", "wrong", words))
        return Preflight(tuple(checks), names, strength, np.nan)
    motors = np.flatnonzero(moves)
    frame, explained = _frame_check(
        lambda change: measured(unit * change)[:, motors], expected[:, motors]
    )
    likeness = match_effects(
        expected[:, motors] if explained else effects[:, motors], expected, motors
    )
    checks.append(frame)
    for k, name in enumerate(names):
        verdict, words = _motor_verdict(names, k, likeness.get(k), float(strength[k]))
        checks.append(Check(name, verdict, words))
    # A dead motor has no delay: the best fit to its noise is meaningless.
    seen = delays[[moves[response.motor] for response in responses]]
    checks.append(_delay_check(seen, model.transport_delay))
    return Preflight(tuple(checks), names, strength, float(np.median(seen)))


def _continuous(yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Undo the jumps of a wrapped yaw, whether in radians or, by mistake, in degrees."""
    in_degrees = np.abs(yaw).max(initial=0.0) > _MOST_TURNS * 2 * np.pi
    return np.unwrap(yaw, period=360.0 if in_degrees else 2 * np.pi)


def _pose_check(
    time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N 3"], rest: Bool[np.ndarray, " N"]
) -> Check:
    """Check rate, noise and drift of the poses at rest, before the first pulse."""
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


def _beyond_any_table(
    pose: Float[np.ndarray, " 3"], reach: Float[np.ndarray, " 2"]
) -> Check | None:
    """Check whether the craft is far from any table, and which units would put it on one."""
    distance = np.abs(pose[:2])
    if (distance <= _FAR * reach).all():
        return None
    fitting = [unit for unit, factor in _LENGTHS.items() if (distance <= factor * reach).all()]
    like = f"is it in {' or '.join(fitting)}, or is" if fitting else "is"
    words = (
        f"the craft is at x = {pose[0]:.4g}, y = {pose[1]:.4g}, beyond any table in metres: {like} "
        "the origin not the middle of the table?"
    )
    return Check("units", "wrong", words)


def _pose_units(
    responses: list[PulseResponse], expected: Float[np.ndarray, "3 n"]
) -> tuple[Float[np.ndarray, " 3"], str]:
    """Guess units from effects that are too large; return factors to SI, and a finding."""
    if not responses:
        return np.ones(3), ""
    found = _sizes(np.array([response.effect for response in responses]).T)
    modelled = _sizes(expected[:, [response.motor for response in responses]])
    push, turn = np.median(found / np.maximum(modelled, np.finfo(float).tiny), axis=1)
    for unit, factor in _LENGTHS.items():
        if factor / 3 < push <= 3 * factor:
            scale = np.array([1 / factor, 1 / factor, 1.0])
            return scale, f"positions are in {unit}, not in metres"
    if _DEGREES / 3 < turn < 3 * _DEGREES:
        return np.array([1.0, 1.0, 1 / _DEGREES]), "the yaw is in degrees, not in radians"
    return np.ones(3), ""


def _sizes(effects: Float[np.ndarray, "3 p"]) -> Float[np.ndarray, "2 p"]:
    """Return the sizes of the forces and of the moments."""
    return np.stack([np.hypot(effects[0], effects[1]), np.abs(effects[2])])


def _frame_check(
    measured: Callable[[Float[np.ndarray, " 3"]], Float[np.ndarray, "3 m"]],
    expected: Float[np.ndarray, "3 m"],
) -> tuple[Check, bool]:
    """Look for a frame of the poses that explains the effects of all motors, likely ones first.

    A frame that explains only some motors does not count: it must not hide a wrong motor.
    """
    for change, words in _FRAMES:
        effects = measured(np.array(change))
        if not words and (np.diag(cosines(-effects, expected)) >= AGREES).all():
            words = "all motors push the other way: they spin or are mounted the wrong way round"
            return Check("pose frame", "wrong", words), True
        angle = rotation(effects, expected)
        if (np.diag(cosines(effects, turned(expected, angle))) < AGREES).any():
            continue
        by = f"turned by {np.rad2deg(angle):.0f} degrees against the craft"
        if words and abs(angle) > _TURNED:
            words = f"{words}; {by}"
        elif abs(angle) > _TURNED:
            words = f"{by}: align the rigid body of the motion capture, or the motors' order"
        if words:
            return Check("pose frame", "wrong", words), True
        if abs(angle) > _MISALIGNED:
            return Check("pose frame", "look", f"{by}: a fit identifies it as α"), True
        return Check("pose frame", "ok", "as expected"), True
    return Check("pose frame", "look", "no frame explains what single motors do"), False


def _motor_verdict(
    names: tuple[str, ...], k: int, likeness: EffectMatch | None, strength: float
) -> tuple[CheckStatus, str]:
    """Judge the effect of a motor."""
    if likeness is None:
        if np.isnan(strength):
            return "look", "was not tried"
        return "wrong", "does nothing: check its cable, power and bearing"
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


def _delay_check(delays: Float[np.ndarray, " p"], modelled: float) -> Check:
    """Compare the transport delay with the model's."""
    found = float(np.median(delays))
    spread = np.quantile(delays, [0.25, 0.75])
    words = (
        f"{1e3 * found:.0f} ms (quartiles {1e3 * spread[0]:.0f} to {1e3 * spread[1]:.0f}), "
        f"the model has {1e3 * modelled:.0f} ms"
    )
    differs = abs(found - modelled)
    if differs > _DELAY_WRONG:
        return Check("transport delay", "wrong", f"{words}: identify again, or repair the radio")
    if differs > _DELAY_DIFFERS:
        return Check("transport delay", "look", words)
    return Check("transport delay", "ok", words)
