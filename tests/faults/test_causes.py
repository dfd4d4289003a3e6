"""Causes that make a recording useless, from the recording and the vehicle file alone."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.faults.causes import recording_findings
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import excite


@pytest.fixture(scope="module")
def recording():
    return excite(nominal_model(default_vehicle()), 12.0, seed=3)


def with_mistake(recording: Recording, pose=None, command=None) -> Trajectory:
    """The recording with other signs of the pose, or with edited commands."""
    seconds = {
        name: (stream.stamp_ns - recording["pose"].stamp_ns[0]) / 1e9
        for name, stream in (("pose", recording["pose"]), ("command", recording["command"]))
    }
    poses = recording["pose"].values[:, :3] * (1.0 if pose is None else np.array(pose))
    commands = recording["command"].values
    commands = commands if command is None else command(commands)
    arrays = seconds["pose"], poses, seconds["command"], commands
    return preprocess(Recording.from_arrays(*arrays, propellers=default_vehicle().columns))


def test_a_right_recording_has_no_findings(recording):
    assert recording_findings(with_mistake(recording), default_vehicle()) == ()


@pytest.mark.parametrize(
    ("pose", "kind", "cause", "remedy"),
    [
        ((1, 1, -1), "signs", "The yaw is flipped", 'axes = ["x", "y", "-z"]'),
        ((1, -1, 1), "signs", "The y axis is flipped", 'axes = ["x", "-y", "z"]'),
        ((10, 10, 1), "units", "The unit of length", "[pose]"),
    ],
)
def test_wrong_poses_are_the_cause(recording, pose, kind, cause, remedy):
    (found,) = recording_findings(with_mistake(recording, pose), default_vehicle())
    assert (found.kind, found.suspect) == (kind, True)
    assert found.cause.startswith(cause) and remedy in found.remedy


def test_the_corrected_line_is_in_terms_of_the_mapping(recording):
    flight, axes = with_mistake(recording, (1, -1, 1)), ("x", "z", "y")
    (found,) = recording_findings(flight, default_vehicle(), axes)
    assert 'axes = ["x", "-z", "y"]' in found.remedy


def test_pulse_widths_without_their_neutral_are_the_cause(recording):
    flight = with_mistake(recording, command=lambda command: 0.5 + 0.5 * command)
    (found,) = recording_findings(flight, default_vehicle())
    assert found.kind == "units" and "neutral" in found.remedy
    # A vehicle whose motors idle there is right.
    idling = default_vehicle().model_copy(update={"command_min": 0.5})
    assert not [one for one in recording_findings(flight, idling) if "pulse" in one.cause]


def test_commands_that_rest_high_are_no_pulse_widths_if_they_do_not_reach_the_top(recording):
    flight = with_mistake(recording, command=lambda command: 0.4 + 0.2 * command)
    assert not [one for one in recording_findings(flight, default_vehicle()) if one.kind == "units"]


def test_motors_in_another_order_are_the_cause(recording):
    order = [1, 2, 0, 3, 4, 5]
    flight = with_mistake(recording, command=lambda command: command[:, order])
    (found,) = recording_findings(flight, default_vehicle())
    assert found.kind == "order"
    # The column of motor k holds the command of motor order[k], and so acts like it.
    names = default_vehicle().propeller_names
    said = [f"{names[k]} acts like {names[order[k]]}" for k in range(3)]
    assert found.cause == "; ".join(said)


def test_directions_of_the_air_are_the_cause(recording):
    vehicle = default_vehicle()
    turned = [
        one.model_copy(update={"direction_deg": one.direction_deg + 180})
        for one in vehicle.propellers
    ]
    wrong = vehicle.model_copy(update={"propellers": tuple(turned)})
    flight = replace(with_mistake(recording), vehicle=wrong)
    (found,) = recording_findings(flight, Vehicle.model_validate(wrong.model_dump()))
    assert (found.kind, found.cause) == ("signs", "All propellers push the other way")


def test_one_reversed_motor_does_not_make_the_recording_suspect(recording):
    vehicle = default_vehicle()
    first, *others = vehicle.propellers
    first = first.model_copy(update={"direction_deg": first.direction_deg + 180})
    wrong = vehicle.model_copy(update={"propellers": (first, *others)})
    (found,) = recording_findings(with_mistake(recording), wrong)
    assert (found.kind, found.cause) == ("actuator", f"{first.name} pushes the other way")
