"""The twin: determinism, timing, and recordings that read like real ones."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from airpuck import InputError, PuckState, Table, Twin, TwinSettings
from airpuck.control.excitation import Excitation
from airpuck.model.model_file import nominal_model, published_model
from airpuck.physics.rigid_body import rollout
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.bag import write_bag
from airpuck.twin.plant import build_plant
from airpuck.twin.play import World
from airpuck.twin.settings import MotionCapture, OnBoard, Radio

from ..apparatus.changes import changed

MODEL = replace(
    published_model("M3"),
    frame="body",
    parameters=replace(published_model("M3").parameters, center_of_mass=np.array([2e-3, -1e-3])),
)
QUIET = TwinSettings(
    radio=Radio(delay_s=0.02, jitter_s=0.0, timeout_s=0.5),
    motion_capture=MotionCapture(
        position_noise_m=0.0, yaw_noise_rad=0.0, latency_s=0.001, latency_jitter_s=0.0
    ),
    on_board=OnBoard(acceleration_noise_m_s2=0.0, gyro_noise_rad_s=0.0, mouse_noise_m_s=0.0),
)
#: A radio without delay, which waits for seconds.
AT_ONCE = {"delay_s": 0.0, "timeout_s": 9.0}
NOISY = TwinSettings(
    radio=Radio(delay_s=0.0208, jitter_s=0.007, loss=0.1),
    motion_capture=MotionCapture(
        position_noise_m=5e-5,
        yaw_noise_rad=6e-4,
        latency_s=0.0005,
        latency_jitter_s=0.0008,
        dropped=0.02,
    ),
)


@pytest.fixture(scope="module")
def plant():
    return build_plant(MODEL, QUIET)


def signals(duration, seed=0, hold=0.1):
    """One motor of each pair at random, and its opposite: + - - + brings the craft back to rest."""
    rng, rows = np.random.default_rng(seed), []
    while len(rows) < round(duration / 0.01):
        first, second = np.full((2, 6), 0.03)
        which, force = rng.integers(0, 2, 3), rng.uniform(0.03, 0.5, 3)
        first[np.arange(0, 6, 2) + which] = second[np.arange(1, 6, 2) - which] = force
        for row in (first, second, second, first):
            rows += [row] * round(hold / 0.01)
    return np.array(rows[: round(duration / 0.01)])


def flown(settings, commands, plant, *, seed=0, stop=None, pose=(0.0, 0.0, 0.3)):
    twin = Twin(MODEL, settings, seed=seed, pose=pose, plant=plant)
    heard = []
    for k, command in enumerate(commands):
        heard += twin.wait_until(0.01 * k)
        if k % 50 == 0:
            twin.announce(np.full(6, 0.01 * k))
        twin.send(command)
    heard += twin.wait_until(0.01 * len(commands) if stop is None else stop)
    return twin, heard


def digests(folder):
    return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def quiet(plant):
    return flown(QUIET, signals(1.6), plant)


def test_a_seed_determines_the_bytes_of_a_recording(tmp_path, plant):
    for name, seed in (("one", 1), ("two", 1), ("six", 6)):
        twin, _ = flown(NOISY, signals(1.0), plant, seed=seed)
        write_bag(twin.recording(), tmp_path / name / "bag")
    one, same, other = (digests(tmp_path / name / "bag") for name in ("one", "two", "six"))
    assert len(one) == 2
    assert one == same
    assert one.keys() == other.keys()
    assert one["bag_0.mcap"] != other["bag_0.mcap"]


def test_the_flight_does_not_depend_on_how_often_measurements_are_read(plant):
    commands = signals(1.0)
    twin, heard = flown(NOISY, commands, plant)
    again, more = Twin(MODEL, NOISY, pose=(0.0, 0.0, 0.3), plant=plant), []
    for k, command in enumerate(commands):
        for part in (0.003, 0.0071, 0.01):
            more += again.wait_until(max(0.01 * (k - 1) + part, 0.0) if part < 0.01 else 0.01 * k)
        again.send(command)
    more += again.wait_until(1.0)
    assert len(heard) == len(more)
    np.testing.assert_allclose(again.truth[1], twin.truth[1], atol=1e-5)


def test_a_command_acts_exactly_after_its_delay(quiet):
    # Piecewise constant commands, 20 ms late, integrated at 1 ms from rest.
    twin, _ = quiet
    late = np.vstack([np.zeros((2, 6)), signals(1.6)])[:160]
    start = np.zeros(12)
    start[2] = 0.3
    steps = np.repeat(late, 10, axis=0)
    states = rollout(np, MODEL.dynamics, start, steps, np.full(len(steps), 1e-3))
    times, truth = twin.truth
    fine = CubicSpline(1e-3 * np.arange(len(steps) + 1), np.vstack([start, states])[:, :3])
    assert np.ptp(truth[:, :3], axis=0).min() > 0.02
    np.testing.assert_allclose(truth[:, :3], fine(times), atol=3e-6)
    # And at frames that coincide with a millisecond, motors and velocities too.
    whole = np.flatnonzero(np.arange(len(times)) % 12 == 0)[1:]
    index = np.rint(times[whole] * 1000).astype(int) - 1
    np.testing.assert_allclose(truth[whole], states[index], atol=1e-5)


def test_a_delay_between_two_frames_is_not_rounded(plant):
    # One motor at full power: its speed shows how long it has been running.
    settings = changed(QUIET, radio={"delay_s": 0.0231, "timeout_s": 5.0})
    command = np.array([1.0, 0, 0, 0, 0, 0])
    twin, _ = flown(settings, [command], plant, stop=0.05)
    times, states = twin.truth
    running = np.maximum(times - 0.0231, 0)
    tau = MODEL.parameters.motor_time_constant
    np.testing.assert_allclose(states[:, 6], 1 - np.exp(-running / tau), atol=1e-9)


@pytest.mark.slow
def test_battery_sag_reduces_the_thrust():
    settings = changed(QUIET, effects={"battery_sag_1_s": 0.4}, radio=AT_ONCE)
    # At 0.5 s a fifth is gone, at 2.5 s and later everything.
    twin = Twin(MODEL, settings)
    twin.send(np.array([0.5, 0.0, 0, 0, 0, 0]))
    heard = {}
    for time in (0.5, 2.6):
        twin.wait_until(time)
        index = np.searchsorted(twin.truth[0], time - 0.01)
        state = twin.truth[1][index : index + 2]
        heard[time] = np.diff(state[:, 5])[0] * 240
    full = MODEL.dynamics.configuration[2, 0] * (MODEL.dynamics.thrust[0] @ [0.5, 0.25, 0.125])
    assert heard[0.5] == pytest.approx(full * (1 - 0.4 * 0.494), rel=0.01)
    assert heard[2.6] == pytest.approx(0.0, abs=1e-6)


def test_an_accelerometer_measures_thrust_but_not_the_slope():
    # On a table that slopes along x, one motor runs while the battery empties.
    settings = changed(QUIET, on_board={"rate_hz": 100.0}, radio=AT_ONCE)
    sloping = {"battery_sag_1_s": 0.4, "tilt_rad": (0.01, 0.0)}
    twin = Twin(MODEL, changed(settings, effects=sloping))
    twin.wait_until(0.2)
    rest = [m.values for m in twin.wait_until(0.5) if m.kind == "imu"]
    np.testing.assert_array_equal(rest, np.tile([0, 0, 9.81, 0, 0, rest[0][5]], (len(rest), 1)))
    felt = {}
    for sag in (0.0, 0.4):
        twin = Twin(MODEL, changed(settings, effects={"battery_sag_1_s": sag}))
        twin.send(np.array([0.5, 0.0, 0, 0, 0, 0]))
        imu = [m for m in twin.wait_until(0.5) if m.kind == "imu"]
        felt[sag] = imu[-1]
    assert felt[0.4].stamp == felt[0.0].stamp
    push = MODEL.dynamics.configuration[:2, 0] * (
        MODEL.dynamics.thrust[0] @ [0.5, 0.25, 0.125] * (1 - 0.4 * felt[0.4].stamp)
    )
    assert np.hypot(*push) > 0.1
    # The remainder is the acceleration of the centre about the offset centre of mass.
    spin = twin.state[5]
    assert np.hypot(*felt[0.4].values[:2]) == pytest.approx(
        np.hypot(*push), abs=2e-3 * (spin**2 + abs(spin) * 20)
    )
    assert np.hypot(*felt[0.4].values[:2]) < 0.9 * np.hypot(*felt[0.0].values[:2])


def test_a_radio_clips_commands_and_rejects_nan(plant):
    twin = Twin(MODEL, QUIET, plant=plant)
    twin.send(np.array([-0.5, 1.5, 0.3, 0.0, 1.0, 0.2]))
    np.testing.assert_array_equal(
        twin.recording()["command"].values, [[0.0, 1.0, 0.3, 0.0, 1.0, 0.2]]
    )
    twin.wait_until(0.5)
    assert twin.state[6:].min() >= 0
    one = np.where(np.arange(6) == 2, np.nan, 0.3)
    for bad in (one, np.full(6, np.nan), np.full(6, np.inf), np.zeros(4)):
        with pytest.raises(InputError, match="command: needs 6 finite"):
            twin.send(bad)


@pytest.mark.parametrize(("value", "span"), [(30.0, "0.2 to 30"), (-5.0, "-5 to 0.2")])
def test_one_command_in_another_unit_is_rejected(plant, value, span):
    command = np.where(np.arange(6) == 2, value, 0.2)
    with pytest.raises(InputError, match=f"command: goes from {span}, but motors take 0 to 1"):
        Twin(MODEL, QUIET, plant=plant).send(command)


def test_without_noise_poses_are_exact_and_other_sensors_their_derivatives(quiet):
    twin, heard = quiet
    times, states = twin.truth
    poses = np.array([m.values for m in heard if m.kind == "pose"])
    np.testing.assert_allclose(poses, states[: len(poses), :3], atol=1e-12)
    path = CubicSpline(times, states[:, :3])

    def body(time, vectors):
        yaw = path(time)[:, 2]
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        return np.einsum("ijk,kj->ki", turn, vectors)

    mouse = [m for m in heard if m.kind == "mouse"]
    stamps = np.array([m.stamp for m in mouse])
    values = np.array([m.values for m in mouse])
    np.testing.assert_allclose(values, body(stamps, path(stamps, 1)[:, :2]), atol=1e-4)
    assert np.ptp(values, axis=0).min() > 0.1

    imu = [m for m in heard if m.kind == "imu"]
    stamps = np.array([m.stamp for m in imu])
    values = np.array([m.values for m in imu])
    np.testing.assert_allclose(values[:, 5], path(stamps, 1)[:, 2], atol=2e-2)
    np.testing.assert_array_equal(values[:, 2:5], np.tile([9.81, 0, 0], (len(values), 1)))
    # Thrust has a kink when a command changes; half a frame later it is smooth again.
    smooth = (np.rint(stamps * 100) % 10 >= 4) & (stamps > 0.1) & (stamps < 1.5)
    found = body(stamps, path(stamps, 2)[:, :2])
    np.testing.assert_allclose(values[smooth, :2], found[smooth], atol=0.02)
    assert np.ptp(values[:, :2], axis=0).min() > 1


def test_a_recording_contains_what_was_sent_announced_and_measured(quiet):
    twin, heard = quiet
    recording = twin.recording()
    commands = recording["command"]
    np.testing.assert_array_equal(commands.values, signals(1.6))
    np.testing.assert_array_equal(np.diff(commands.stamp_ns), 10_000_000)
    assert commands.columns == MODEL.vehicle.propeller_names
    np.testing.assert_allclose(recording["reference"].values[:, 0], 0.5 * np.arange(4))
    poses = [m.values for m in heard if m.kind == "pose"]
    np.testing.assert_array_equal(recording["pose"].values[: len(poses)], poses)
    np.testing.assert_allclose(recording["pose"].values, twin.truth[1][:, :3], atol=1e-12)
    assert (np.diff(recording["pose"].received_ns) >= 0).all()


def excited(settings, plant):
    """Fly an excitation experiment of 15 s."""
    twin, pilot = Twin(MODEL, settings, plant=plant), Excitation(nominal_model(MODEL.vehicle))
    for k in range(1500):
        for measurement in twin.wait_until(0.01 * k):
            if measurement.kind == "pose":
                pilot.pose(measurement.stamp, measurement.values)
        command = pilot.step(twin.now).command
        twin.send(command)
        pilot.sent(twin.now, command)
    return twin.recording()


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.01, 0.0208, 0.04])
def test_preprocessing_finds_the_delay_to_one_sample_despite_lost_frames(plant, delay):
    settings = changed(NOISY, radio={"delay_s": delay})
    assert preprocess(excited(settings, plant), MODEL.vehicle).delay == pytest.approx(
        delay, abs=1.5 / 240
    )


def test_a_craft_that_receives_no_commands_stays_at_rest(plant):
    twin = Twin(MODEL, QUIET, plant=plant, pose=(0.4, -0.2, 1.0))
    twin.wait_until(0.5)
    np.testing.assert_array_equal(twin.state, [0.4, -0.2, 1.0, *[0.0] * 9])
    assert set(twin.recording().streams) == {"pose", "imu", "mouse"}


def test_without_onboard_sensors_there_are_only_poses(plant):
    settings = QUIET.model_copy(update={"on_board": OnBoard(rate_hz=0.0)})
    twin = Twin(MODEL, settings, plant=plant)
    assert {m.kind for m in twin.wait_until(0.2)} == {"pose"}
    assert set(twin.recording().streams) == {"pose"}


def test_waiting_ends_at_the_requested_time(plant):
    twin = Twin(MODEL, QUIET, plant=plant)
    for time in (0.0, 0.1, 0.1, 0.1 + 1e-12, 0.7):
        twin.wait_until(time)
        assert twin.now == time


def test_contacts_with_a_rail_are_recorded(plant):
    reach = QUIET.table.reach(MODEL.vehicle.radius_m)[1]
    assert flown(QUIET, np.full((50, 6), 0.03), plant)[0].contacts == []
    push = np.full((50, 6), 0.03)
    push[:, 0] = 0.6  # pushes along the body's y axis
    twin, _ = flown(QUIET, push, plant, pose=(0.0, reach - 0.02, 0.0))
    assert twin.contacts
    time, state = twin.truth
    # Before, it moves towards the rail, afterwards away from it.
    first = np.searchsorted(time, twin.contacts[0])
    assert state[first - 2, 4] > 0 > state[first + 1, 4]
    assert twin.contacts == sorted(twin.contacts)


def test_a_twin_without_logs_measures_the_same_values(plant):
    heard = []
    for logs in (True, False):
        twin = Twin(MODEL, QUIET, seed=2, plant=plant, logs=logs)
        heard.append([m for k in range(20) for m in twin.wait_until(0.013 * k)])
    assert len(heard[0]) > 100
    for one, other in zip(*heard, strict=True):
        assert (one.kind, one.stamp) == (other.kind, other.stamp)
        np.testing.assert_array_equal(one.values, other.values)


def test_the_speed_of_a_contact_is_normal_to_the_rail(plant):
    """The craft meets the rail slowly while it moves fast along it."""
    reach = QUIET.table.reach(MODEL.vehicle.radius_m)[0]
    push = np.full((60, 6), 0.03)
    push[:, 0] = 0.6  # along y, and a little along x
    twin, _ = flown(QUIET, push, plant, pose=(reach - 0.005, 0.1, -0.3))
    met, speed = twin.craft.contacts[0]
    time, state = twin.truth
    before = state[np.searchsorted(time, met) - 1]
    assert before[4] > 5 * before[3] > 0.2
    assert speed == pytest.approx(before[3], rel=0.05)


def test_a_table_smaller_than_the_craft_and_an_incomplete_world_are_rejected(plant):
    small = QUIET.model_copy(update={"table": Table(length_m=0.2, width_m=0.12, goal_width_m=0.1)})
    with pytest.raises(InputError, match="table: is smaller than the craft"):
        Twin(MODEL, small, plant=plant)
    alone = Twin(MODEL, QUIET, plant=plant, world=World(QUIET, PuckState(0.5, 0.0)))
    with pytest.raises(InputError, match="add a second one"):
        alone.wait_until(0.1)
