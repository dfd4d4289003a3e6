"""The check of motor order and signs against a recording."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.craft.vehicle import Propeller, Vehicle, default_vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.window_regression import regress_windows
from airpuck.faults import layout_check, propeller_check
from airpuck.faults.layout_check import check_layout
from airpuck.faults.layout_findings import AxisSigns
from airpuck.faults.propeller_check import match_effects, rotation, turned
from airpuck.model.model_file import nominal_model, published_model
from airpuck.physics.rigid_body import acceleration_map
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite

from ..apparatus.boats import boat, sail, zigzag
from ..apparatus.changes import changed, with_propellers
from ..apparatus.examples import examples
from ..apparatus.public_recordings import BLUE
from ..apparatus.synthetic_flights import edited as with_edit
from ..apparatus.synthetic_flights import record


@pytest.fixture(scope="module")
def flight():
    return preprocess(record(duration=10.0, noise=5e-5))


def edited(edit) -> Vehicle:
    """The default vehicle with other propellers."""
    return with_propellers(default_vehicle(), edit)


def moved(propeller: Propeller, angle: float, mirror: bool = False) -> dict:
    x, y = propeller.position_m
    direction = propeller.direction_deg
    if mirror:
        y, direction = -y, -direction
    cos, sin = np.cos(angle), np.sin(angle)
    position = cos * x - sin * y, sin * x + cos * y
    return {"position_m": position, "direction_deg": direction + np.rad2deg(angle)}


def test_the_true_layout_is_accepted(flight):
    check = check_layout(flight, default_vehicle())
    assert check.agrees
    assert not check.remarks
    assert min(p.agreement for p in check.propellers) > 0.97
    # A notebook shows what the command prints, on fewer lines.
    each, explained = repr(check).splitlines()
    assert [word.split()[-1] for word in each.split(";")] == ["agrees"] * 6
    assert explained.endswith("% of the acceleration")
    # The published M3 is turned by -0.0375 rad against the nominal layout.
    assert check.rotation == pytest.approx(-0.0375, abs=0.01)


def test_a_wrong_sign_is_named(flight):
    turned = edited(lambda k, p: {"direction_deg": p.direction_deg + 180 * (k == 2)})
    check = check_layout(flight, turned)
    assert not check.agrees
    wrong = [p for p in check.propellers if p.verdict != "agrees"]
    assert [p.name for p in wrong] == ["motor_b_1"]
    assert wrong[0].agreement < -0.9
    assert "other way" in wrong[0].verdict


def test_directions_that_state_the_air_flow_are_one_mistake(flight):
    turned = edited(lambda _, p: {"direction_deg": p.direction_deg + 180})
    check = check_layout(flight, turned)
    assert check.wrong == ("all directions",)
    (remark,) = check.remarks
    assert "not of the air" in remark
    # Their strengths are those along the true direction.
    assert min(one.strength for one in check.propellers) > 0.8


@pytest.mark.parametrize(("first", "second"), [(0, 3), (1, 5), (2, 4)])
def test_swapped_motors_are_named(flight, first, second):
    propellers = default_vehicle().propellers
    order = list(range(6))
    order[first], order[second] = second, first
    vehicle = edited(lambda k, p: propellers[order[k]].model_dump() | {"name": p.name})
    check = check_layout(flight, vehicle)
    verdicts = {p.name: p for p in check.propellers if p.verdict != "agrees"}
    assert set(verdicts) == {propellers[first].name, propellers[second].name}
    assert verdicts[propellers[first].name].behaves_like == propellers[second].name


def test_a_rotated_layout_is_reported(flight):
    check = check_layout(flight, edited(lambda _, p: moved(p, np.pi / 2)))
    assert not check.agrees
    assert "turned by -92 degrees" in check.remarks[0]
    # None of them is swapped: in the rotated layout all agree with the file.
    assert {p.verdict for p in check.propellers} == {"turned with the whole layout"}
    assert [p.behaves_like for p in check.propellers] == [p.name for p in check.propellers]
    assert check.wrong == ("the yaw's zero",)


def test_a_mirrored_layout_is_reported(flight):
    # The lab's file has Y up.
    mirrored = edited(lambda _, p: moved(p, 0.0, mirror=True))
    check = check_layout(flight, mirrored, axes=("x", "z", "y"))
    assert check.mirrored
    assert not check.agrees
    assert check.remarks[0].startswith("the y axis and the yaw are flipped")
    assert 'axes = ["x", "-z", "-y"]' in check.remarks[0]


@pytest.mark.parametrize("ratio", [0.01, 0.1, 10.0, 100.0])
def test_a_wrong_unit_of_length_is_named_and_no_propeller_accused(flight, ratio):
    scale = np.array([ratio, ratio, 1.0])
    logged = replace(
        flight, state=flight.state * np.tile(scale, 2), acceleration=flight.acceleration * scale
    )
    check = check_layout(logged, default_vehicle())
    assert check.length_ratio == pytest.approx(ratio)
    assert check.wrong == ("the unit of length",)
    assert f"moves {ratio:g} times as far" in check.remarks[0]
    assert {p.verdict for p in check.propellers} == {"agrees"}


def test_less_than_two_seconds_are_not_judged(flight):
    check = check_layout(flight.slice(0.0, 0.15), default_vehicle())
    assert not check.conclusive
    assert {p.verdict for p in check.propellers} == {"not judged"}
    assert "1.5 s" in check.remarks[0]


def quad() -> Vehicle:
    """The square craft of docs/your_own_craft.md."""
    places = {"fl": (1, 1, 315), "fr": (1, -1, 45), "rl": (-1, 1, 225), "rr": (-1, -1, 135)}
    return Vehicle.model_validate(
        {
            "name": "quad",
            "mass_kg": 0.21,
            "radius_m": 0.08,
            "command_min": 0.05,
            "propellers": [
                {"name": name, "position_m": (0.045 * x, 0.045 * y), "direction_deg": angle}
                for name, (x, y, angle) in places.items()
            ],
            "nominal": {"thrust_N": (0.0, 0.6), "inertia_kg_m2": 6.7e-4},
        }
    )


SIGNS = list(product((1, -1), repeat=3))


@pytest.fixture(scope="module", params=[6, 4])
def recorded(request):
    """Half a minute on the twin, and the craft."""
    vehicle = default_vehicle() if request.param == 6 else quad()
    return excite(nominal_model(vehicle), 20.0, seed=1), vehicle


@pytest.mark.slow
@pytest.mark.parametrize("signs", SIGNS)
def test_flipped_axes_are_named_with_their_correction(recorded, signs):
    recording, vehicle = recorded
    logged = edited_poses(recording, signs)
    check = check_layout(preprocess(logged, vehicle), vehicle)
    assert check.conclusive
    if signs == (1, 1, 1):
        assert check.agrees
        assert not check.remarks
        return
    assert not check.agrees
    remark = " ".join(check.remarks)
    axes = [axis if sign > 0 else f"-{axis}" for axis, sign in zip("xyz", signs, strict=True)]
    assert f"axes = {axes}".replace("'", '"') in remark
    if signs != (-1, -1, 1):  # The same as a rigid body that is turned by 180 degrees.
        names = [n for n, s in zip(("x axis", "y axis", "yaw"), signs, strict=True) if s < 0]
        assert check.signs.flipped == tuple(name.removesuffix(" axis") for name in names)
        assert check.wrong == tuple(f"the {name}" for name in names)
        assert remark.startswith(" and ".join(f"the {name}" for name in names))
        # With true signs the propellers agree with the file.
        assert all(p.verdict == "agrees" for p in check.propellers)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_swapped_columns_of_x_and_y_are_one_cause(recorded, sign):
    recording, vehicle = recorded
    logged = edited_poses(recording, (sign, sign, 1))
    pose = logged["pose"]
    exchanged = replace(pose, values=pose.values[:, [1, 0, *range(2, pose.values.shape[1])]])
    logged = replace(logged, streams={**logged.streams, "pose": exchanged})
    check = check_layout(preprocess(logged, vehicle), vehicle)
    assert check.wrong == ("the order of x and y",)
    (remark,) = check.remarks
    assert f"axes = {'[-y, -x, z]' if sign < 0 else '[y, x, z]'}" in remark.replace('"', "")
    assert {one.verdict for one in check.propellers} == {"agrees once x and y are exchanged"}
    assert check.to_json()["exchanged"]


def test_a_layout_without_clear_propellers_is_not_called_rotated(flight):
    """Rotations of vague effects mean nothing."""
    quiet = replace(flight, command=np.full_like(flight.command, 0.3))
    assert "the yaw's zero" not in check_layout(quiet, default_vehicle()).wrong


def edited_poses(recording, signs):
    def edit(stamp, received, values):
        return stamp, received, values * signs

    return with_edit(recording, "pose", edit)


def test_mass_thrust_and_inertia_need_not_be_accurate(flight):
    vehicle = default_vehicle()
    wrong = {"thrust_N": (0.0, 2.0), "inertia_kg_m2": 8e-4, "motor_time_constant_s": 0.06}
    assert check_layout(flight, changed(vehicle, mass_kg=0.3, nominal=wrong)).agrees


@pytest.mark.parametrize("ratio", [0.25, 0.3, 3.0])
def test_a_poor_estimate_of_the_inertia_accuses_no_propeller(flight, ratio):
    inertia = ratio * default_vehicle().nominal.inertia_kg_m2
    craft = changed(default_vehicle(), nominal={"inertia_kg_m2": inertia})
    check = check_layout(flight, craft)
    assert check.agrees
    assert check.inertia_ratio == pytest.approx(1 / ratio, rel=0.25)
    assert any("inertia" in remark for remark in check.remarks)


@pytest.mark.parametrize(("error", "verdict"), [(0.01, "has no such effect"), (0.2, "not clear")])
def test_only_a_certain_deviation_is_reported(flight, monkeypatch, error, verdict):
    vehicle = default_vehicle()
    effect = np.asarray(nominal_model(vehicle).dynamics.configuration).copy()
    push = np.linalg.norm(effect[:2, 0])
    effect[:2, 0] = turned(effect[:, :1], 0.75)[:2, 0]
    errors = np.full_like(effect, 1e-3 * push)
    errors[:2, 0] = error * push

    def measured(*given):
        return replace(regress_windows(*given), effect=effect, error=errors)

    monkeypatch.setattr(layout_check, "regress_windows", measured)
    first, *others = check_layout(flight, vehicle).propellers
    assert first.verdict.startswith(verdict)
    assert {one.verdict for one in others} == {"agrees"}


def test_one_unused_motor_does_not_make_a_recording_inconclusive(flight, monkeypatch):
    vehicle = default_vehicle()

    def measured(*given):
        found = regress_windows(*given)
        errors = np.where(np.arange(6) == 2, np.inf, found.error)
        return replace(found, error=errors, p_value=0.5)

    monkeypatch.setattr(layout_check, "regress_windows", measured)
    check = check_layout(flight, vehicle)
    assert not check.conclusive and not check.still


def test_a_rotation_is_not_reported_if_motors_are_swapped():
    swapped = layout_check.PropellerCheck("a", -1.0, "b", "behaves like b: motors are swapped")
    fine = layout_check.PropellerCheck("c", 1.0, "c", "agrees")
    check = layout_check.LayoutCheck((fine,), 0.9, 0.0, 0.0, 0.45, AxisSigns())
    assert any("turned by" in remark for remark in check.remarks)
    assert not replace(check, propellers=(swapped, fine)).remarks


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_not_conclusive(flight, seed):
    rng = np.random.default_rng(seed)
    state = 1e-4 * rng.normal(size=flight.state.shape)
    noise = replace(flight, state=state, acceleration=rng.normal(size=flight.acceleration.shape))
    check = check_layout(noise, default_vehicle())
    assert not check.conclusive
    assert not check.agrees
    assert "too little" in check.remarks[0]


@pytest.mark.parametrize("moved", [1, 2, 3, 4, 5, 6])
def test_commands_from_another_time_explain_nothing(flight, moved):
    """The motion is smooth, and far from white: that alone must not look like an explanation."""
    elsewhere = np.roll(flight.command, moved * len(flight.command) // 7, axis=0)
    assert not check_layout(replace(flight, command=elsewhere), default_vehicle()).conclusive


def slow(seconds: float, seed: int = 0, noise: float = 3e-4):
    """A craft with 0.02 m/s² per motor at 16 Hz, disturbed by white accelerations."""
    rng = np.random.default_rng(seed)
    vehicle = changed(default_vehicle(), mass_kg=30.0, nominal={"inertia_kg_m2": 0.08})
    time = np.arange(0, seconds, 0.06)
    command = np.repeat(rng.integers(0, 2, (len(time) // 10 + 1, 6)), 10, axis=0)[: len(time)]
    full = nominal_model(vehicle).vehicle.nominal_thrust.sum(axis=1)
    effect = np.asarray(nominal_model(vehicle).dynamics.configuration) * full
    state = np.zeros((len(time), 6))
    for k in range(1, len(time)):
        x, y, turn = effect @ command[k - 1]
        yaw = state[k - 1, 2]
        acceleration = [
            np.cos(yaw) * x - np.sin(yaw) * y,
            np.sin(yaw) * x + np.cos(yaw) * y,
            turn,
        ] + rng.normal(size=3) * [0.02, 0.02, 0.2]
        state[k, 3:] = state[k - 1, 3:] + 0.06 * np.array(acceleration)
        state[k, :3] = state[k - 1, :3] + 0.03 * (state[k - 1, 3:] + state[k, 3:])
    state[:, :3] += noise * rng.normal(size=(len(time), 3))
    flight = Trajectory(
        time=time,
        state=state,
        acceleration=np.gradient(np.gradient(state[:, :3], time, axis=0), time, axis=0),
        command_time=time,
        command=command.astype(float),
        propellers=vehicle.propeller_names,
    )
    return flight, vehicle


def test_a_slow_and_noisy_craft_is_judged():
    flight, vehicle = slow(200.0)
    check = check_layout(flight, vehicle)
    # Motors give 0.05 m/s²: of the variance of raw accelerations, a few percent.
    raw = np.diff(flight.state[:, 0], n=2) / 0.06**2
    assert 0.07 * np.var(raw) > 0.05**2
    assert check.agrees
    for propeller in check.propellers:
        assert abs(propeller.strength - 1) < 4 * propeller.strength_error


def test_a_short_flight_of_a_slow_craft_states_how_much_longer_to_fly():
    flight, vehicle = slow(9.0, noise=1e-2)
    check = check_layout(flight, vehicle)
    assert not check.conclusive
    assert "would be seen in about" in check.remarks[0]


def test_the_delay_is_estimated(flight):
    # This check finds its own delay: the one found by correlation need not be right.
    assert check_layout(flight, default_vehicle()).delay == pytest.approx(5 / 240, abs=1 / 240)


@pytest.mark.data
def test_the_real_craft_agrees_with_its_vehicle_file(experiments):
    from airpuck.recording.read import read_recording

    check = check_layout(preprocess(read_recording(experiments / BLUE / BLUE)), default_vehicle())
    assert check.agrees
    assert min(p.agreement for p in check.propellers) > 0.98


MODEL = published_model("M3")
EFFECTS = acceleration_map(np, MODEL.dynamics, 0.0, 0.0)[0] * np.array([[1], [1], [0.04]])


@examples(60)
@given(
    order=st.permutations(range(6)),
    signs=st.lists(st.sampled_from([1, -1]), min_size=6, max_size=6),
    seed=st.integers(0, 1000),
)
def test_any_order_and_sign_is_found_if_effects_differ(order, signs, seed):
    """Six effects no two of which are parallel: an octahedron's axes, turned, would be."""
    rng = np.random.default_rng(seed)
    fixed = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [1, -1, 0], [-1, 0.2, 1]]).T
    seen = np.array(signs) * fixed[:, list(order)] * rng.uniform(0.5, 2, 6)
    found = match_effects(seen, fixed, np.arange(6))
    assert {k: (m.acts_as, m.sign) for k, m in found.items()} == {
        k: (order[k], signs[k]) for k in range(6)
    }


def test_an_effect_that_matches_no_motor_is_reported():
    seen = EFFECTS.copy()
    seen[:, 2] = turned(seen[:, 2:3], np.deg2rad(60))[:, 0]
    found = match_effects(seen, EFFECTS, np.arange(6))
    assert found[2].acts_as is None
    assert [found[k].acts_as for k in (0, 1, 3, 4, 5)] == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("angle", [-2.5, 0.0, 1.0])
def test_a_rotation_is_estimated(angle):
    assert rotation(turned(EFFECTS, angle), EFFECTS) == pytest.approx(angle)


def steady_turn(duration: float = 60.0):
    """A voyage in which the propellers never change; the boat turns since one is faster."""
    vehicle = boat()
    return preprocess(sail(lambda *_: (0.45, 0.5), duration), vehicle), vehicle


def test_constant_commands_are_inconclusive():
    flight, vehicle = steady_turn()
    check = check_layout(flight, vehicle)
    assert not check.conclusive and not check.agrees
    assert {one.verdict for one in check.propellers} == {"not judged"}
    (remark,) = check.remarks
    assert "the commands never change" in remark


@pytest.mark.slow
def test_a_zigzag_course_determines_neither_floor_nor_strengths():
    vehicle = boat()
    flight = preprocess(sail(zigzag(), 60.0), vehicle)
    assert not [said for said in flight.warnings if "precedes" in said]
    check = check_layout(flight, vehicle)
    # The table is level and smooth, and the layout right, but drag explains the motion as well.
    assert not check.floor and not check.remarks and not check.wrong
    assert {one.verdict for one in check.propellers} == {propeller_check.UNDETERMINED}


@pytest.mark.slow
def test_independent_commands_determine_the_propellers():
    levels = np.random.default_rng(3).uniform(0.2, 0.9, (120, 2))
    vehicle = boat()
    flight = preprocess(sail(lambda t, _: levels[int(t)], 120.0), vehicle)
    check = check_layout(flight, vehicle)
    assert check.agrees and not check.remarks
    assert [one.strength for one in check.propellers] == pytest.approx([1.0, 1.0], abs=0.05)
