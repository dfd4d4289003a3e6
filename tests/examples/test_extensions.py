"""The worked examples: users' extensions, each in one short file."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import airpuck
from airpuck.model.model_file import nominal_model
from airpuck.physics.effects import Envelope
from airpuck.physics.rigid_body import rollout
from tests.apparatus import commands
from tests.apparatus.commands import refused
from tests.apparatus.synthetic_flights import fly

EXAMPLES = Path(__file__).parents[2] / "examples"
M3 = airpuck.read_model("paper:M3")


def example(name):
    """Import a file below examples/."""
    spec = importlib.util.spec_from_file_location(Path(name).stem, EXAMPLES / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("own_*/*.py")), ids=lambda path: path.stem)
def test_an_extension_is_one_short_file(file):
    lines = [line for line in file.read_text("utf-8").splitlines() if line.strip()]
    assert len(lines) <= 25


def test_friction_stops_a_coasting_craft_where_newton_predicts():
    rough = example("own_effect/rough_floor.py").RoughFloor(friction_m_s2=0.3)
    dynamics = replace(M3.dynamics, effects=(rough,), thrust=0 * M3.dynamics.thrust)
    start = np.concatenate([[0, 0, 0, 0.6, 0, 0], np.zeros(6)])
    states = rollout(np, dynamics, start, np.zeros((300, 6)), np.full(300, 0.01))
    assert states[-1, 0] == pytest.approx(0.6**2 / (2 * 0.3), rel=0.02)  # v² / 2f
    assert rough.acceleration_bound(Envelope(3.0, 15.0)) == (0.3, 0.0)


def cross_drag(along, across):
    """Return a rung with the effect of the example, and a craft that has these coefficients."""
    rung = airpuck.named_rung(f"M3+{EXAMPLES / 'own_effect/cross_drag.py'}:CrossDrag")
    vector = rung.initial(M3.vehicle).to_vector()
    vector[-2:] = along, across
    vector[: len(vector) - 2] = M3.parameters.to_vector()
    parameters = rung.initial(M3.vehicle).with_vector(vector)
    return rung, replace(
        M3, name=rung.name, frame="body", parameters=parameters, free=rung.mask(parameters)
    )


@pytest.mark.slow
def test_a_fit_learns_the_coefficients_of_a_users_effect():
    rung, truth = cross_drag(0.3, 0.9)
    fit = airpuck.identify(fly(truth, 12.0), rung)
    found, known = fit.model.parameters.cross_drag, fit.model.known
    assert found == pytest.approx([0.3, 0.9], abs=0.02)
    assert (known.standard_errors[-2:] > 0).all()
    assert (np.abs(found - [0.3, 0.9]) < 5 * known.standard_errors[-2:]).all()


@pytest.mark.slow
def test_a_users_effect_can_be_named_wherever_a_model_can(tmp_path):
    term = f"{EXAMPLES / 'own_effect/cross_drag.py'}:CrossDrag"
    bag, model = tmp_path / "bag", tmp_path / "model.toml"
    airpuck.write_bag(airpuck.excite(cross_drag(0.3, 0.9)[1], 8.0, 1), bag)
    identified = commands.airpuck("identify", bag, "--model", f"M3+{term}", "-o", model, "--quiet")
    assert identified.returncode == 0, identified.stderr
    evaluated = commands.airpuck("evaluate", f"{model}+{term}", bag, "--json", "-")
    assert json.loads(evaluated.stdout)["rmse"]["x_m"] < 0.01
    remedy = f"append +{term} to the name of the model"
    assert refused(commands.airpuck("evaluate", model, bag), "effects.cross_drag", remedy)


CENTRED = EXAMPLES / "own_actuator/centred_pulses.py"


@pytest.fixture
def valves(tmp_path):
    """Return files of a craft with valves: a user's kind, and the same with the package's."""
    text = (EXAMPLES / "free_flyers/freeflyer2.toml").read_text("utf-8")
    kept = [line for line in text.splitlines() if line[:4] not in ("rise", "fall", "leas")]
    text = "\n".join([*kept, "motor_time_constant_s = 0.005"]).replace("[0.2]", "[1.0]")
    (tmp_path / "on_off.toml").write_text(text, "utf-8")
    own = tmp_path / "centred.toml"
    own.write_text(text.replace('"on_off"', '"centred"'), "utf-8")
    return f"{own}+{CENTRED}:CentredPulses", tmp_path / "on_off.toml"


def test_a_users_actuators_fly_excitation_and_set_points(valves, tmp_path):
    model = nominal_model(airpuck.read_vehicle(valves[0]))
    settings = airpuck.read_twin_settings(EXAMPLES / "free_flyers/twin.toml")
    assert len(airpuck.excite(model, 2.0, 1, settings=settings)["command"].values) == 20
    goal = airpuck.SetPoint(0.2, 0.0, 0.0)
    flown = airpuck.track(model, goal, 15.0, settings=settings).recording
    assert np.hypot(*(flown["pose"].values[-1, :2] - [0.2, 0.0])) < 0.05
    model.save(tmp_path / "model.toml")
    assert airpuck.read_model(tmp_path / "model.toml").vehicle == model.vehicle


@pytest.mark.slow
def test_a_users_actuators_act_the_same_in_the_twin_and_in_a_fit(valves):
    own, packaged = map(airpuck.read_vehicle, valves)
    model, random = nominal_model(own), np.random.default_rng(0)
    strengths = random.uniform(0.8, 1.2, (8, 1))
    truth = replace(model.parameters, thrust=strengths, transport_delay=0.041)
    settings = airpuck.read_twin_settings(EXAMPLES / "free_flyers/twin.toml")
    quiet = {"rate_hz": 100.0, "position_noise_m": 1e-6, "yaw_noise_rad": 1e-5}
    camera = settings.motion_capture.model_copy(update=quiet)
    settings = settings.model_copy(update={"motion_capture": camera})
    twin = airpuck.Twin(replace(model, parameters=truth), settings)
    for k in range(60):
        twin.wait_until(0.1 * k)
        twin.send(random.random(8) * (random.random(8) < 0.5))
    twin.wait_until(6.0)

    def worst(craft):
        fit = airpuck.identify(
            airpuck.preprocess(twin.recording(), craft),
            "M3",
            loss=airpuck.Loss(prediction_time=0.4, encoder_time=0.1, spacing=0.23),
            preparation=airpuck.Preparation(faults="keep", retimings=0),
        )
        return np.abs(fit.model.parameters.thrust / strengths - 1).max()

    assert worst(own) < 0.02
    assert worst(packaged) > 0.04  # the kind matters


def test_evaluate_accepts_a_users_encoder():
    found = airpuck.evaluate(
        M3, fly(M3, 6.0), encoder=example("own_encoder/last_pose.py").LastPose()
    )
    # Exact states, so that only the guess at the motor speeds is wrong.
    assert 0 < found.rmse[0] < 0.05


def test_a_log_in_json_lines_becomes_a_trajectory(tmp_path):
    flown = airpuck.excite(M3, 5.0, 1)
    pose, command = flown["pose"], flown["command"]
    rows = [
        {"t": (stamp - pose.stamp_ns[0]) * 1e-9, kind: values.tolist()}
        for kind, stream in (("pose", pose), ("command", command))
        for stamp, values in zip(stream.stamp_ns, stream.values, strict=True)
    ]
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)), "utf-8")
    read = airpuck.preprocess(example("own_format/json_lines.py").read_json_lines(path))
    known = airpuck.preprocess(flown)
    np.testing.assert_allclose(read.state[:, :3], known.state[:, :3], atol=1e-9)
    assert read.delay == pytest.approx(known.delay, abs=1 / 240)


def test_a_report_shows_the_command_range(tmp_path):
    flight = fly(M3, 3.0)
    page = example("own_report/command_range.py").report(flight, tmp_path)
    assert page == tmp_path / "index.html"
    median = f"<td>{np.median(flight.input[:, 5]):.2f}</td>"
    assert "Range of the commands" in page.read_text("utf-8")
    assert median in page.read_text("utf-8")
    assert (tmp_path / "figures" / "range.pdf").read_bytes()[:4] == b"%PDF"
