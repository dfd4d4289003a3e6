"""Checks before flight: motor order, spin directions, signs, delay and pose frame, in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.craft.table import Table
from airpuck.flight.effect_match import match_effects
from airpuck.flight.link import Link
from airpuck.flight.loop import fly
from airpuck.flight.preflight_checks import (
    Check,
    beyond_any_table,
    delay_check,
    frame_check,
    motor_verdict,
    pose_check,
    pose_units,
)
from airpuck.flight.pulse_response import pulse_responses
from airpuck.flight.pulses import PulsePlan, PulseTest
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.preprocessing.clock import align_clocks
from airpuck.recording.stream import Recording

#: Share of the modelled effect below which a motor is said to do nothing.
_SILENT = 0.15
#: A pulse that fits this many times worse than the best of its motor was disturbed.
_DISTURBED = 5.0
#: No test turns the craft so often: a yaw that large is in degrees.
_MOST_TURNS = 2


@dataclass(frozen=True, eq=False)
class Preflight:
    """Result of `preflight`."""

    #: In the order in which to mend them.
    checks: tuple[Check, ...]
    #: Of the propellers.
    names: tuple[str, ...]
    #: Thrust of each, as a share of the modelled one; nan where it was not measured.
    strength: Float[np.ndarray, " n"]
    #: Median transport delay of the motors that do something [s]; nan where none does.
    delay: float

    @property
    def ready(self) -> bool:
        """Whether nothing is wrong."""
        return all(check.verdict != "wrong" for check in self.checks)

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        strength = [None if np.isnan(share) else float(share) for share in self.strength]
        return {
            "ready": self.ready,
            "checks": [asdict(check) for check in self.checks],
            "strength": dict(zip(self.names, strength, strict=True)),
            "delay_s": None if np.isnan(self.delay) else self.delay,
        }


def preflight(
    link: Link, model: Model, plan: PulsePlan | None = None, table: Table | None = None
) -> Preflight:
    """Give each motor short pulses, and compare what the craft does with the model.

    Parameters
    ----------
    link : Link
        The craft, resting near the middle of the table.
    model : Model
        What it is believed to be.
    plan : PulsePlan, optional
        Strength and length of the pulses.
    table : Table, optional
        Where the rails are.

    Returns
    -------
    Preflight
        What is wrong, in words.
    """
    pilot = PulseTest(model.vehicle, plan, table)
    fly(pilot, link, pilot.duration)
    return judge_test(pilot, model)


def judge_test(pilot: PulseTest, model: Model) -> Preflight:
    """Judge a test that was flown."""
    if not pilot.poses:
        check = Check("poses", "wrong", "none came: is the motion capture sending, on this topic?")
        return _found_only(check, model)
    pose_time, poses = zip(*pilot.poses, strict=True)
    beyond = beyond_any_table(poses[-1], pilot.reach) if pilot.stopped else None
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
    names = model.vehicle.propeller_names
    if set(command.columns) != set(names):
        raise InputError(
            f"has the motors {', '.join(command.columns)}; the model has {', '.join(names)}",
            file=recording.source,
        )
    order = [command.columns.index(name) for name in names]
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
    """Compare what pulses did with what the model expects of them."""
    n, names = model.vehicle.n_propellers, model.vehicle.propeller_names
    pose = np.column_stack([pose[:, :2], _continuous(pose[:, 2])])
    checks = [pose_check(time, pose, command_time, command, model.vehicle.command_min)]
    # Forces and moments in one unit: moments as forces at the radius of gyration.
    expected = acceleration_map(np, model.dynamics, 0.0, 0.0)[0]
    scale = np.array([1.0, 1.0, model.radius_of_gyration])[:, None]

    responses = pulse_responses(model, time, pose, command_time, command)
    delays = np.array([response.delay for response in responses])

    def measured(change: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 n"]:
        """Effects of all motors if poses were changed by these factors; nan if not tried."""
        again = pulse_responses(model, time, pose * change, command_time, command, delays)
        effects = np.full((3, n), np.nan)
        for motor in {response.motor for response in again}:
            own = [response for response in again if response.motor == motor]
            # Not those that something else disturbed, a rail or a hand.
            least = min(response.misfit for response in own)
            good = [r.effect for r in own if r.misfit <= _DISTURBED * least]
            effects[:, motor] = np.mean(good, axis=0)
        return scale * effects

    unit, words = pose_units(responses, expected)
    if words:
        checks.append(Check("units", "wrong", words))
    effects, expected = measured(unit), scale * expected
    strength = np.linalg.norm(effects, axis=0) / np.linalg.norm(expected, axis=0)
    tried = ~np.isnan(strength)
    moves = tried & ~(strength < _SILENT)
    if not moves.any():
        words = "no pulse of a single motor was recorded"
        if tried.any():
            words = "none does anything: armed? powered? is the command's topic the radio's?"
        checks.append(Check("motors", "wrong", words))
        return Preflight(tuple(checks), names, strength, np.nan)
    motors = np.flatnonzero(moves)
    frame, explained = frame_check(
        lambda change: measured(unit * change)[:, motors], expected[:, motors]
    )
    likeness = match_effects(
        expected[:, motors] if explained else effects[:, motors], expected, motors
    )
    checks.append(frame)
    for k, name in enumerate(names):
        verdict, words = motor_verdict(names, k, likeness.get(k), float(strength[k]))
        checks.append(Check(name, verdict, words))
    # A motor that does nothing has no delay: what fits its noise best says nothing.
    seen = delays[[moves[response.motor] for response in responses]]
    checks.append(delay_check(seen, model.transport_delay))
    return Preflight(tuple(checks), names, strength, float(np.median(seen)))


def _continuous(yaw: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Undo the jumps of a wrapped yaw, be it in radians or, by mistake, in degrees."""
    in_degrees = np.abs(yaw).max(initial=0.0) > _MOST_TURNS * 2 * np.pi
    return np.unwrap(yaw, period=360.0 if in_degrees else 2 * np.pi)
