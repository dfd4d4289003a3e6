"""Pulses find faults of a craft before it flies: on twins with known faults."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from airpuck import InputError, Twin, TwinSettings
from airpuck.flight.loop import fly
from airpuck.flight.preflight import Preflight, judge_pulses, judge_recording, judge_test, preflight
from airpuck.flight.pulses import (
    PulsePlan,
    PulseResponse,
    PulseTest,
    find_pulses,
    pulse_responses,
    sound_pulses,
)
from airpuck.live.fly import ANYWHERE
from airpuck.live.safety import Guard, GuardedPilot
from airpuck.model.model_file import nominal_model, published_model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import MotionCapture, Radio

from ..apparatus.models import four_propellers, scaled

MODEL = published_model("M3")
NAMES = MODEL.vehicle.propeller_names
PLANT = build_plant(MODEL)
IDLE = MODEL.vehicle.command_min


def same(values):
    return values


@dataclass
class Changed:
    """A link to a twin that changes commands or poses; a pose of None does not arrive."""

    twin: Twin
    command: object = same
    pose: object = same

    @property
    def now(self):
        return self.twin.now

    def wait_until(self, time):
        arrived = [(a, self.pose(a.values)) for a in self.twin.wait_until(time) if a.kind == "pose"]
        return [replace(a, values=values) for a, values in arrived if values is not None]

    def send(self, command):
        self.twin.send(self.command(command))

    def announce(self, reference):
        self.twin.announce(reference)


def fly_pulses(command=same, pose=same, seed=3):
    twin = Twin(MODEL, seed=seed, pose=(0.001, 0.002, 0.4), plant=PLANT)
    return preflight(Changed(twin, command, pose), MODEL)


def words(found: Preflight, name: str) -> str:
    return next(check.words for check in found.checks if check.name == name)


def wrong(found: Preflight) -> list[str]:
    return [check.name for check in found.checks if check.verdict == "wrong"]


def test_disturbed_pulses_and_failed_starts_are_ignored():
    def pulse(motor, turn, misfit):
        return PulseResponse(motor, np.array([0, 0, turn]), 0, misfit, np.zeros(1), np.eye(3))

    sound, disturbed, failed = pulse(0, 1.0, 1.0), pulse(0, 9.0, 6.0), pulse(0, 0.2, 1.0)
    alone = pulse(1, 1.0, 1.0), pulse(1, 0.4, 9.0)
    found = sound_pulses([sound, failed, *alone], 0.05, 0.5)
    assert found == {0: [sound], 1: [alone[0]]}
    assert sound_pulses([pulse(0, 0.8, 6.0), sound], 0.05, 0.5)[0] == [sound]
    # Nothing is sound: all count.
    both = [disturbed, sound]
    assert sound_pulses(both, 0.05, 0.5)[0] == both


def test_moments_are_weighted_by_the_radius_of_gyration():
    push = PulseResponse(0, np.array([0.1, 0, 0]), 0, 1.0, np.zeros(1), np.eye(3))
    turn = replace(push, effect=np.array([0, 0, 1.0]))
    assert sound_pulses([push, turn], 0.1, 0.9)[0] == [push, turn]
    assert sound_pulses([push, turn], 0.05, 0.9)[0] == [push]


@pytest.fixture(scope="module")
def flown():
    """A test of a healthy craft, as arrays; no pulse reacts, so that changes can be made later."""
    pilot, twin = PulseTest(MODEL.vehicle), Twin(MODEL, seed=3, pose=(0.01, 0.02, 2.4), plant=PLANT)
    fly(pilot, twin, pilot.duration)
    time, pose = map(np.array, zip(*pilot.poses, strict=True))
    at, command = map(np.array, zip(*pilot.sent_commands, strict=True))
    return time, pose, at, command


def test_a_healthy_craft_is_ready(flown):
    found = judge_pulses(MODEL, *flown)
    assert found.ready
    assert {check.verdict for check in found.checks} == {"ok"}
    np.testing.assert_allclose(found.strength, 1.0, atol=0.3)  # the radio's jitter
    assert found.delay == pytest.approx(MODEL.transport_delay, abs=8e-3)
    content = found.to_json()
    assert content["ready"] is True
    assert set(content["strength"]) == set(NAMES)


@pytest.mark.parametrize(("i", "j"), [(0, 3), (0, 1), (2, 5)])
def test_swapped_motors_are_named(flown, i, j):
    time, pose, at, command = flown
    order = np.arange(6)
    order[[i, j]] = order[[j, i]]
    found = judge_pulses(MODEL, time, pose, at, command[:, order])
    assert wrong(found) == [NAMES[i], NAMES[j]]
    assert f"acts like {NAMES[j]}" in words(found, NAMES[i])
    assert f"acts like {NAMES[i]}" in words(found, NAMES[j])


def only(motor, share):
    """One motor that gives only a share of its command above idle."""
    return lambda u: np.where(np.arange(6) == motor, IDLE + share * (u - IDLE), u)


@pytest.mark.slow
def test_a_dead_motor_is_distinguished_from_a_weak_one():
    dead = fly_pulses(only(2, 0.0))
    assert wrong(dead) == [NAMES[2]]
    assert "does nothing" in words(dead, NAMES[2])
    weak = fly_pulses(only(4, 0.6))
    assert weak.ready
    assert [c.name for c in weak.checks if c.verdict == "look"] == [NAMES[4]]


@pytest.mark.slow
def test_the_delay_is_taken_from_motors_that_respond():
    """Five of six stand still; the delay that best fits their noise is arbitrary."""
    found = fly_pulses(lambda u: np.where(np.arange(6) == 1, u, IDLE))
    assert found.delay == pytest.approx(MODEL.transport_delay, abs=8e-3)
    assert words(found, "transport delay").startswith(f"{1e3 * found.delay:.0f} ms")


@pytest.mark.parametrize(
    ("scale", "pose", "name", "says"),
    [
        # As seen from the other side: the model's propeller points the other way.
        ([1, 1, 1, -1.2, 1, 1], same, NAMES[3], "pushes the other way"),
        (-1.0, same, "pose frame", "all motors push the other way"),
        (1.0, lambda p: p * [1, 1, -1], "pose frame", "yaw has the wrong sign"),
        (1.0, lambda p: p * [1, -1, 1], "pose frame", "axis of the position has the wrong sign"),
        (1.0, lambda p: p * [1, -1, -1], "pose frame", "seen from below"),
        (1.0, lambda p: p[:, [1, 0, 2]], "pose frame", "x and y are exchanged"),
        (1.0, lambda p: np.add(p, [0, 0, np.pi / 2]), "pose frame", "turned by -90 degrees"),
        (1.0, lambda p: p * [1, 1, 180 / np.pi], "units", "in degrees"),
        (1.0, lambda p: p * [100, 100, 1], "units", "in centimetres"),
        (1.0, lambda p: p * [1000, 1000, 1], "units", "in millimetres"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_error_is_reported_as_a_single_cause(flown, scale, pose, name, says):
    time, poses, *commands = flown
    found = judge_pulses(scaled(MODEL, scale), time, pose(poses), *commands)
    assert wrong(found) == [name]
    assert says in words(found, name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "factor", "x"),
    [("millimetres", 1e3, 0.2), ("centimetres", 1e2, -0.05), ("millimetres", 1e3, 0.0)],
)
def test_wrong_units_that_put_the_craft_off_the_table_are_reported(unit, factor, x):
    found = preflight_live_like(lambda p: p * [factor, factor, 1], (x, 0.0, 0.4))
    assert wrong(found) == ["units"]
    assert unit in words(found, "units")


@pytest.mark.slow
def test_yaw_in_degrees_is_reported_by_a_guarded_test():
    found = preflight_live_like(lambda p: p * [1, 1, 180 / np.pi], (0.001, 0.002, 0.4))
    assert "degrees" in words(found, "units")


def preflight_live_like(pose, start) -> Preflight:
    """A test on the twin, behind the same guard as on the graph."""
    pilot = PulseTest(MODEL.vehicle)
    guard = Guard(ANYWHERE)
    guarded = GuardedPilot(pilot, guard, np.full(len(NAMES), IDLE), lambda *_: None)
    fly(guarded, Changed(Twin(MODEL, seed=3, pose=start, plant=PLANT), pose=pose), 6.0)
    return judge_test(pilot, MODEL)


def test_a_small_misalignment_is_accepted(flown):
    time, pose, *commands = flown
    for angle, ready in ((0.6, False), (-0.2, True)):
        found = judge_pulses(MODEL, time, np.add(pose, [0, 0, angle]), *commands)
        assert found.ready == ready


@pytest.mark.parametrize(("later", "verdict"), [(0.015, "look"), (0.06, "wrong")])
def test_a_different_transport_delay_is_reported(flown, later, verdict):
    time, *rest = flown
    found = judge_pulses(MODEL, time + later, *rest)
    last = found.checks[-1]
    assert (last.name, last.verdict) == ("transport delay", verdict)
    assert found.delay == pytest.approx(judge_pulses(MODEL, *flown).delay + later, abs=2e-3)


def test_a_craft_that_does_not_move_is_reported(flown):
    time, pose, *commands = flown
    still = np.random.default_rng(0).normal(pose[0], [5e-5, 5e-5, 6e-4], pose.shape)
    found = judge_pulses(MODEL, time, still, *commands)
    assert wrong(found) == ["motors"]
    assert "none responds" in words(found, "motors")
    frozen = judge_pulses(MODEL, time, np.tile(pose[0], (len(time), 1)), *commands)
    assert "never change" in words(frozen, "poses")


def test_poses_at_60_hz_suffice_and_slower_ones_are_rejected(flown):
    time, pose, *commands = flown
    assert "at least 50" in words(judge_pulses(MODEL, time[::8], pose[::8], *commands), "poses")
    found = judge_pulses(MODEL, time[::4], pose[::4], *commands)
    assert found.ready
    # Pauses of 0.3 s are short for so few poses: the pulse before is still seen.
    assert found.strength == pytest.approx(judge_pulses(MODEL, *flown).strength, abs=0.3)


def test_one_failed_start_does_not_make_a_motor_weak(flown):
    time, pose, at, command = flown
    pulses = find_pulses(at, command, IDLE)
    # A pulse that was sent while nothing moved: a copy of an idle stretch's poses, before the test.
    motor = pulses[0][0]
    length = pulses[0][2] - pulses[0][1]
    early = at[0] - 1.0 + np.arange(0.0, 1.0, 0.01)
    extra = np.full((len(early), command.shape[1]), IDLE)
    extra[(early > early[0] + 0.4) & (early < early[0] + 0.4 + length), motor] = 0.25
    before = time[0] - 1.0 + np.arange(0.0, 1.0, 1 / 240)
    noise = 4e-5 * np.random.default_rng(0).normal(size=(len(before), 3))
    found = judge_pulses(
        MODEL,
        np.concatenate([before, time]),
        np.concatenate([pose[0] + noise, pose]),
        np.concatenate([early, at]),
        np.concatenate([extra, command]),
    )
    whole = judge_pulses(MODEL, *flown)
    assert found.strength[motor] == pytest.approx(whole.strength[motor], abs=0.1)


def test_only_the_named_motors_are_tested():
    pilot = PulseTest(MODEL.vehicle, motors=[1, 4])
    twin = Twin(MODEL, seed=3, plant=PLANT)
    log = fly(pilot, twin, pilot.duration)
    assert set(np.flatnonzero((log.command > IDLE + 1e-3).any(axis=0))) == {1, 4}


@pytest.mark.slow
def test_missing_and_interrupted_poses_are_reported():
    assert wrong(fly_pulses(pose=lambda _: None)) == ["poses"]
    come = iter(range(300))
    found = fly_pulses(pose=lambda p: p if next(come, None) is not None else None)
    assert wrong(found) == ["test"]
    assert "poses stopped coming" in words(found, "test")
    assert "was not tried" in words(found, NAMES[5])
    assert not np.isnan(found.strength[0])


@pytest.mark.slow
def test_invalid_poses_are_ignored():
    turn = iter(range(10_000))
    assert fly_pulses(pose=lambda p: np.full(3, np.nan) if next(turn) % 7 == 0 else p).ready


@pytest.mark.slow
def test_a_four_propeller_craft_is_ready():
    quad = nominal_model(four_propellers())
    found = preflight(Twin(quad, seed=3), quad)
    assert found.ready, found.checks


# The pilot ----------------------------------------------------------------------------------------


def test_motors_are_pulsed_one_at_a_time_alternating_partners():
    pilot = PulseTest(MODEL.vehicle)
    sent = []
    for k in range(round(pilot.duration / 0.01)):
        pilot.pose(0.01 * k, [0, 0, 0])
        sent.append(pilot.step(0.01 * k).command)
        pilot.sent(0.01 * k, sent[-1])
    commands = np.array(sent)
    assert ((commands > IDLE).sum(axis=1) <= 1).all()
    time = 0.01 * np.arange(len(commands))
    pulses = find_pulses(time, commands, IDLE)
    assert [motor for motor, *_ in pulses] == [0, 1, 2, 3, 4, 5] * 2
    plan = PulsePlan()
    for k, (_, begin, end) in enumerate(pulses):
        assert end - begin == pytest.approx(plan.length)
        assert begin == pytest.approx(plan.rest + k * (plan.length + plan.rest))


@pytest.mark.parametrize("rested", [0.0, 0.1, 0.2, 0.5])
def test_a_rest_just_before_counts_as_the_first_pause(rested):
    seen = [(0.01 * k, np.zeros(3)) for k in range(round(rested / 0.01))]
    pilot, rest = PulseTest(MODEL.vehicle, rested=seen), PulsePlan().rest
    for k in range(100):
        now = rested + 0.01 * k
        pilot.pose(now, [0, 0, 0])
        if (pilot.step(now).command > IDLE).any():
            break
    assert now == pytest.approx(rested + max(rest - rested, 0.0), abs=0.011)
    # All poses of the pause are kept: the craft's drift before the pulse is judged by them.
    assert pilot.poses[0][0] == pytest.approx(max(rested - rest, 0.0), abs=0.011)


def test_at_a_rail_the_motors_idle_for_good():
    pilot = PulseTest(MODEL.vehicle)
    for k, x in enumerate([0.0, 1.02, 0.0]):
        pilot.pose(0.35 + 0.01 * k, [x, 0, 0])
        command = pilot.step(0.35 + 0.01 * k).command
    np.testing.assert_array_equal(command, IDLE)
    assert "rail" in pilot.stopped


@pytest.mark.parametrize(
    "plan", [{"level": 0.0}, {"level": 1.1}, {"length": 5.0}, {"rest": 0.1}, {"rounds": 0}]
)
def test_plans_out_of_range_are_rejected(plan):
    with pytest.raises(InputError):
        PulsePlan(**plan)
    with pytest.raises(InputError, match="idle"):
        PulseTest(MODEL.vehicle, PulsePlan(level=IDLE))


# The regression -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lag", "delay", "length", "error"), [(0.04, 0.02, 0.1, 0.0), (0.12, 0.07, 0.2, 0.03)]
)
def test_the_measured_effects_equal_the_columns_of_the_model(lag, delay, length, error):
    """Without noise and jitter: M(0) of the model, column by column, and the delay.

    A slow motor still pushes when the next pulse begins.
    """
    quiet = TwinSettings(
        radio=Radio(delay_s=delay, jitter_s=0.0),
        motion_capture=MotionCapture(
            position_noise_m=0.0, yaw_noise_rad=0.0, latency_s=0.0, latency_jitter_s=0.0
        ),
    )
    own = {"center_of_mass": np.zeros(2), "motor_time_constant": lag}
    still = replace(MODEL, frame="body", parameters=replace(MODEL.parameters, **own))
    pilot = PulseTest(still.vehicle, PulsePlan(length=length))
    twin = Twin(still, quiet, pose=(0, 0, 2.0))
    fly(pilot, twin, pilot.duration)
    time, pose = map(np.array, zip(*pilot.poses, strict=True))
    pose[:, 2] = np.unwrap(pose[:, 2])
    at, command = map(np.array, zip(*pilot.sent_commands, strict=True))
    expected = acceleration_map(np, still.dynamics, 0.0, 0.0)[0]
    responses = pulse_responses(still, time, pose, at, command)
    assert len(responses) == 12
    for response in responses:
        column = expected[:, response.motor]
        np.testing.assert_allclose(response.effect[:2], column[:2], atol=0.15, rtol=error)
        assert response.effect[2] == pytest.approx(column[2], rel=0.006)
        assert response.delay == pytest.approx(delay, abs=1.1e-3)


# From a recording ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_recorded_test_gets_the_same_verdict():
    twin = Twin(MODEL, seed=3, pose=(0.001, 0.002, 0.4), plant=PLANT)
    live = preflight(twin, MODEL)
    again = judge_recording(MODEL, twin.recording())
    assert [c.verdict for c in again.checks] == [c.verdict for c in live.checks]
    np.testing.assert_allclose(again.strength, live.strength, rtol=0.05)


def test_a_recording_with_other_motors_is_rejected():
    twin = Twin(MODEL, plant=PLANT)
    twin.send(np.full(6, IDLE))
    twin.wait_until(0.1)
    with pytest.raises(InputError, match="motor_a_1"):
        judge_recording(nominal_model(four_propellers()), twin.recording())
