"""Which actuator is weak, dead, reversed or swapped throughout."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import Model, Recording, Trajectory, Vehicle
from airpuck.craft.vehicle import default_vehicle
from airpuck.faults.find import find_faults
from airpuck.faults.layout_check import check_layout
from airpuck.faults.strengths import find_strengths, on_table_of, recording_findings, usual_rung
from airpuck.identification.fit import identify
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite

from ..apparatus.beliefs import believed
from ..apparatus.changes import changed, with_propellers
from ..apparatus.models import scaled
from ..apparatus.synthetic_flights import fly, record
from ..apparatus.two_way_craft import triangle


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


def test_a_correct_recording_has_no_findings(recording):
    assert recording_findings(with_mistake(recording), default_vehicle()) == ()


@pytest.mark.parametrize(
    ("pose", "kind", "cause", "remedy"),
    [
        ((1, 1, -1), "signs", "The yaw is flipped", 'axes = ["x", "y", "-z"]'),
        ((1, -1, 1), "signs", "The y axis is flipped", 'axes = ["x", "-y", "z"]'),
        ((10, 10, 1), "units", "The unit of length", "[pose]"),
    ],
)
def test_wrong_axes_or_units_of_poses_are_the_cause(recording, pose, kind, cause, remedy):
    (found,) = recording_findings(with_mistake(recording, pose), default_vehicle())
    assert (found.kind, found.suspect) == (kind, True)
    assert found.cause.startswith(cause) and remedy in found.remedy


def test_the_correction_is_stated_in_terms_of_the_mapping(recording):
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


def test_high_resting_commands_below_full_scale_are_not_pulse_widths(recording):
    flight = with_mistake(recording, command=lambda command: 0.4 + 0.2 * command)
    assert not [one for one in recording_findings(flight, default_vehicle()) if one.kind == "units"]


def test_swapped_motors_are_the_cause(recording):
    order = [1, 2, 0, 3, 4, 5]
    flight = with_mistake(recording, command=lambda command: command[:, order])
    (found,) = recording_findings(flight, default_vehicle())
    assert found.kind == "order"
    # The column of motor k holds the command of motor order[k], and so acts like it.
    names = default_vehicle().propeller_names
    said = [f"{names[k]} acts like {names[order[k]]}" for k in range(3)]
    assert found.cause == "; ".join(said)


def test_directions_of_the_air_flow_are_the_cause(recording):
    wrong = with_propellers(
        default_vehicle(), lambda _, p: {"direction_deg": p.direction_deg + 180}
    )
    flight = replace(with_mistake(recording), vehicle=wrong)
    (found,) = recording_findings(flight, Vehicle.model_validate(wrong.model_dump()))
    assert (found.kind, found.cause) == ("signs", "All propellers push the other way")


def test_one_reversed_motor_does_not_make_the_recording_suspect(recording):
    wrong = with_propellers(
        default_vehicle(), lambda k, p: {"direction_deg": p.direction_deg + 180 * (k == 0)}
    )
    (found,) = recording_findings(with_mistake(recording), wrong)
    assert (found.kind, found.cause) == ("actuator", "motor_a_1 pushes the other way")


#: Position and direction of craft with other numbers of propellers.
LAYOUTS = {
    3: [((45, 0), 70), ((-22, 39), 190), ((-22, -39), 310)],
    4: [((45, 15), 100), ((-45, 15), 260), ((15, 45), 350), ((15, -45), 170)],
    8: [
        *(((45, 20), 180), ((45, -20), 180), ((20, -45), 90), ((-20, -45), 90)),
        *(((-45, -20), 0), ((-45, 20), 0), ((-20, 45), 270), ((20, 45), 270)),
    ],
}


def craft(count: int) -> Vehicle:
    vehicle = default_vehicle()
    if count == 6:
        return vehicle
    propellers = [
        {"name": f"p{k}", "position_m": (x / 1e3, y / 1e3), "direction_deg": angle}
        for k, ((x, y), angle) in enumerate(LAYOUTS[count])
    ]
    return Vehicle.model_validate(vehicle.model_dump() | {"propellers": propellers, "pairs": ()})


def truth(vehicle: Vehicle, *scale: float) -> Model:
    """The nominal craft with some of its thrusts scaled."""
    factors = np.ones(vehicle.n_propellers)
    factors[: len(scale)] = scale
    return scaled(nominal_model(vehicle), factors)


def fitted(model: Model, error: float, rng=None) -> Model:
    """What a fit would return: thrusts with independent relative errors of that size."""
    thrust = np.asarray(model.parameters.thrust)
    full = np.asarray(nominal_model(model.vehicle).parameters.thrust)
    if rng is not None:
        thrust = thrust + full * error * rng.normal(size=(len(full), 1))
    parameters = replace(model.parameters, thrust=thrust)
    vector, free = parameters.to_vector(), parameters.mask(frozenset({"thrust"}))
    covariance = np.zeros((len(vector), len(vector)))
    for k, row in enumerate(full):
        columns = slice(k * len(row), (k + 1) * len(row))
        covariance[columns, columns] = error**2 * np.outer(row, row)
    return believed(replace(model, parameters=parameters, free=free), covariance, quantile=2.023)


@pytest.mark.parametrize("count", [3, 4, 6, 8])
@pytest.mark.parametrize("common", [1.0, 0.8])
def test_healthy_actuators_are_not_accused(count, common):
    rng, accused = np.random.default_rng(count), 0
    for _ in range(40):
        model = fitted(truth(craft(count), *[common] * count), 0.06, rng)
        accused += bool(find_strengths(model).remarkable)
    assert accused <= 2


@pytest.mark.parametrize("count", [3, 4, 6, 8])
@pytest.mark.parametrize(("scale", "verdict"), [(0.0, "dead"), (0.3, "weak"), (0.6, "weak")])
def test_a_weak_actuator_is_named(count, scale, verdict):
    # The vehicle file's mass is wrong, too.
    model = fitted(truth(craft(count), *[1.3 * scale, *[1.3] * (count - 1)]), 0.04)
    strengths = find_strengths(model)
    (found,) = strengths.remarkable
    assert (found.name, found.verdict) == (craft(count).propeller_names[0], verdict)
    assert found.of_nominal == pytest.approx(1.3 * scale)
    low, high = found.interval_95
    assert (high - low) / 2 / found.nominal == pytest.approx(2.023 * 0.04, rel=1e-3)
    assert found.name in strengths.sentences[0]


@pytest.mark.parametrize("count", [3, 4, 6, 8])
def test_a_somewhat_weak_motor_is_named_with_its_factor(count):
    # The vehicle file is 16 % optimistic; the motors' curves are known to half a percent.
    model = fitted(truth(craft(count), 0.84 * 0.85, *[0.84] * (count - 1)), 0.84 * 0.005)
    strengths = find_strengths(model)
    (found,) = strengths.remarkable
    assert (found.name, found.of_others) == (craft(count).propeller_names[0], pytest.approx(0.85))
    (sentence,) = strengths.sentences
    assert sentence.startswith(f"Throughout the recording: {found.name} gives 85 ± 0.")
    # The others' median has an error, too.
    assert 0.0049 < found.of_others_error < 0.009


@pytest.mark.parametrize(
    ("share", "spread", "named"), [(0.96, 0.05, 0), (0.96, 0.02, 1), (0.9, 0.2, 0)]
)
def test_a_weakness_within_the_usual_spread_is_not_reported(share, spread, named):
    model = fitted(truth(craft(6), share), 0.004)
    vehicle = changed(model.vehicle, nominal={"thrust_spread": spread})
    strengths = find_strengths(replace(model, vehicle=vehicle))
    assert len(strengths.remarkable) == named
    assert strengths.actuators[0].of_others == pytest.approx(share)


def test_a_motor_with_uncertain_strength_is_not_called_weak():
    """Ten percent below the others, at three standard errors."""
    assert not find_strengths(fitted(truth(craft(6), 0.9), 0.03)).remarkable


@pytest.mark.parametrize(("flown", "named"), [(1.0, 0), (0.85, 1)])
def test_a_motor_is_weak_only_if_fit_and_recording_agree(flown, named):
    """A fit that lacks some physics may be certain of a strength that the craft does not have."""
    flight = fly(truth(craft(6), flown), 15.0, seed=3)
    strengths = find_strengths(fitted(truth(craft(6), 0.85), 0.004), flight)
    assert len(strengths.remarkable) == named
    # The standard error includes what the recording contradicts.
    apart = 0.85 - flown
    assert strengths.actuators[0].of_others_error == pytest.approx(abs(apart), abs=0.03)


def test_a_common_error_is_one_finding():
    strengths = find_strengths(fitted(truth(craft(6), *[0.7] * 6), 0.02))
    assert not strengths.remarkable
    assert "about 70 % of their nominal strength" in strengths.sentences[0]


def test_unknown_strengths_are_not_judged():
    strengths = find_strengths(truth(craft(6), 0.5))
    assert {one.verdict for one in strengths.actuators} == {"unknown"}
    assert not strengths.sentences


def wrong(vehicle: Vehicle, kind: str) -> Vehicle:
    """A vehicle file that turns the first propeller around, or swaps it with the second."""
    first, second, *_ = vehicle.propellers
    places = [one.model_dump(exclude={"name"}) for one in (second, first)]
    edited = dict(enumerate(places)) if kind == "swapped" else {}
    edited |= {0: {"direction_deg": first.direction_deg + 180}} if kind == "reversed" else {}
    wrong = with_propellers(vehicle, lambda k, _: edited.get(k, {}))
    return Vehicle.model_validate(wrong.model_dump())


@pytest.mark.parametrize("count", [3, 4, 6, 8])
@pytest.mark.parametrize("kind", ["reversed", "swapped"])
def test_reversed_and_swapped_actuators_are_named(count, kind):
    vehicle = craft(count)
    flight = fly(truth(vehicle), 20.0, seed=1)
    model = fitted(nominal_model(wrong(vehicle, kind)), 0.02)
    found = {one.name: one.verdict for one in find_strengths(model, flight).remarkable}
    first, second = vehicle.propeller_names[:2]
    swapped = {first: f"acts like {second}", second: f"acts like {first}"}
    assert found == (swapped if kind == "swapped" else {first: "reversed"})


@pytest.mark.slow
def test_a_fit_to_a_craft_with_a_dead_propeller_names_it():
    """The fit takes the dead propeller for a healthy one, held at zero by a constraint."""
    flight = preprocess(record(truth(craft(6), 0.0), duration=10.0, noise=5e-5))
    strengths = find_strengths(identify(flight).model, flight)
    (found,) = strengths.remarkable
    assert found.verdict == "dead"
    assert max(abs(one.of_nominal - 1) for one in strengths.actuators[1:]) < 0.1


TILT = (0.05, -0.03)


def flight_on_a_slope(*scale: float) -> Trajectory:
    """A flight with some thrusts scaled, on a table that is not level."""
    model = truth(craft(6), *scale)
    return fly(
        replace(model, parameters=replace(model.parameters, tilt=np.array(TILT))), 15.0, seed=2
    )


def test_a_level_table_is_not_called_tilted():
    flight = fly(truth(craft(6), 0.6), 15.0, seed=2)
    assert check_layout(flight, craft(6)).tilt is None
    assert usual_rung(flight, craft(6)) == "M3"
    model = nominal_model(craft(6))
    assert on_table_of(model, flight) is model


@pytest.mark.parametrize("scale", [1.0, 0.6])
def test_a_tilted_table_is_not_blamed_on_an_actuator(scale):
    flight = flight_on_a_slope(scale)
    check = check_layout(flight, craft(6))
    assert check.agrees
    np.testing.assert_allclose(check.tilt, TILT, atol=3 * max(check.tilt_error))
    assert "tilted" in check.remarks[0]
    assert usual_rung(flight, craft(6)) == "M3+tilt"
    # A fit without the slope explains it by thrusts: one seems weak, whichever is.
    spoilt = fitted(truth(craft(6), 1.0, 0.5), 0.02)
    found = {one.name: one.verdict for one in find_strengths(spoilt, flight).remarkable}
    assert found == ({} if scale == 1 else {craft(6).propeller_names[0]: "weak"})


@pytest.mark.parametrize("count", [3, 8])
def test_a_slope_is_detected_with_other_layouts(count):
    model = truth(craft(count))
    parameters = replace(model.parameters, tilt=np.array(TILT))
    flight = fly(replace(model, parameters=parameters), 15.0, seed=2)
    np.testing.assert_allclose(check_layout(flight, craft(count)).tilt, TILT, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "true", "near", "says", "rung"),
    [
        ("dish", (1.0, -0.8, 0.6), 0.1, "not flat", "M3+dish"),
        ("friction", (0.5, 0.0), 0.05, "rough", "M3+drag+friction"),
    ],
)
def test_uneven_and_rough_floors_are_recognised(name, true, near, says, rung):
    model = truth(craft(6))
    parameters = replace(model.parameters, **{name: np.array(true)})
    flight = fly(replace(model, parameters=parameters), 15.0, seed=2)
    check = check_layout(flight, craft(6))
    assert check.agrees
    assert list(check.floor) == [name]
    np.testing.assert_allclose(check.floor[name], true, atol=near)
    assert says in check.remarks[0]
    assert usual_rung(flight, craft(6)) == rung


def test_faults_are_found_on_a_tilted_table():
    flight = flight_on_a_slope()
    model = on_table_of(fitted(nominal_model(craft(6)), 0.02), flight)
    np.testing.assert_allclose(model.parameters.tilt, TILT, atol=5e-3)
    assert not model.free[model.parameters.mask(frozenset({"tilt"}))].any()
    assert find_faults(flight, model) == ()


def test_a_wheel_is_not_compared_with_propellers_of_unknown_thrust(tmp_path):
    # Five propellers push 1.5 times as hard as guessed; the wheel's torque is from a data sheet.
    vehicle = triangle(tmp_path)
    found = find_strengths(fitted(truth(vehicle, *[1.5] * 3, 1.0, 1.5, 1.5, 1.0), 0.02))
    assert [one.name for one in found.remarkable] == []
    assert found.common == pytest.approx(1.5)
    weak = find_strengths(fitted(truth(vehicle, *[1.5] * 3, 0.5, 1.5, 1.5, 0.5), 0.02))
    assert [one.name for one in weak.remarkable] == ["wheel", "wheel_reverse"]


def test_an_undetermined_strength_is_not_reported_as_sound():
    found = find_strengths(fitted(truth(craft(4), 0.6), 0.3))
    assert {one.verdict for one in found.actuators} == {"unknown"}
    (said,) = found.sentences
    assert said.startswith("The recording does not determine the strength of p0 (-1 % to 121 %")
