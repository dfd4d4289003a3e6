"""The authors' files: written and read back they are the same model."""

import json
from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, export
from airpuck.boundary.files import load_yaml
from airpuck.export.holohover import params_json, params_yaml
from airpuck.model.model_file import read_model
from tests.apparatus.export_crafts import FOUR, PAPER, random_states

PUBLISHED = pytest.mark.parametrize("name", PAPER)


@pytest.fixture(params=PAPER)
def written(request, tmp_path):
    export.write(PAPER[request.param], "holohover", tmp_path)
    return PAPER[request.param], tmp_path


def test_params_json_round_trips_exactly(written):
    model, folder = written
    again = read_model(folder / "params.json")
    np.testing.assert_array_equal(again.parameters.to_vector(), model.parameters.to_vector())
    np.testing.assert_array_equal(again.free, model.free)
    assert (again.name, again.frame, again.vehicle) == (model.name, "world", model.vehicle)


def test_the_controllers_file_gives_the_same_dynamics(written):
    model, folder = written
    again = read_model(folder / "holohover_params.yaml")
    assert again.vehicle.command_min == model.vehicle.command_min
    for name in ("thrust", "inertia", "motor_time_constant", "center_of_mass"):
        np.testing.assert_array_equal(
            getattr(again.parameters, name), getattr(model.parameters, name)
        )
    for state, command in zip(*random_states(model, 20), strict=True):
        np.testing.assert_allclose(
            again.derivative(state, command), model.derivative(state, command), rtol=1e-12
        )
    before, after = load_file(folder), load(params_yaml(again), folder)
    for key, value in before.items():
        np.testing.assert_allclose(after[key], value, rtol=1e-14, atol=1e-14)


def load_file(folder):
    content = load_yaml(folder / "holohover_params.yaml")
    return {key: np.ravel(value).tolist() for key, value in content.items()}


def load(text, folder):
    (folder / "again").mkdir()
    (folder / "again" / "holohover_params.yaml").write_text(text)
    return load_file(folder / "again")


@PUBLISHED
def test_a_published_params_json_round_trips(name, data, tmp_path):
    path = data / "models" / "paper" / name / "params.json"
    published, model = json.loads(path.read_text()), read_model(path)
    content = params_json(model)
    for key in ("center_of_mass", "mass", "inertia", "signal2thrust", "motor_angle_offset", "tau"):
        assert content["model_params"][key] == published["model_params"][key]
    for key in ("motors_vec", "motors_pos"):
        np.testing.assert_allclose(
            content["model_params"][key], published["model_params"][key], rtol=0, atol=5e-7
        )
    for key, value in content["model"].items():
        assert value == published["model"][key]
    (tmp_path / "params.json").write_text(json.dumps(content))
    again = read_model(tmp_path / "params.json")
    np.testing.assert_array_equal(again.parameters.to_vector(), model.parameters.to_vector())
    np.testing.assert_array_equal(again.free, model.free)
    assert again.vehicle == model.vehicle


#: A file in the layout of the published ones: other numbers, in single precision, unchanged.
FILE = """
mass: 146.3e-3
CoM: [-1e-3, 2.5e-4, 0.0]
inertia: 0.000294
#inertia: 0.5356e-3
idle_signal: 0.05
motor_tau: 0.0313
use_configuration_matrix: {direct}
configuration_matrix:
            [0.0, 0.0, -5.9, 5.9, 5.9, -5.9,
            6.8, -6.8, -3.4, 3.4, -3.4, 3.4,
            82.2, -82.2, 82.2, -82.2, 82.2, -82.2]
"""


def file_of_the_controller(direct):
    text = FILE.format(direct=direct)
    for k, name in enumerate(("a_1", "a_2", "b_1", "b_2", "c_1", "c_2"), start=1):
        angle = k * np.pi / 3
        text += f"motor_pos_{name}: [{0.04 * np.cos(angle):.6f}, {0.04 * np.sin(angle):.6f}, 0.0]\n"
        x, y = np.float32(-np.sin(angle)), np.float32(np.cos(angle))
        text += f"learned_motor_vec_{name}: [{float(x)}, {float(y)}, 0.0]\n"
        text += f"signal_to_thrust_coeffs_motor_{k}: [0.0{k}, 0.97, -0.45] # [0.1, 1.0, -0.5]\n"
    return text


@pytest.mark.parametrize("direct", ["false", "true"])
def test_a_controller_file_round_trips(direct, tmp_path):
    path = tmp_path / "holohover_params.yaml"
    path.write_text(file_of_the_controller(direct))
    model, before = read_model(path), load_file(tmp_path)
    again = load(params_yaml(model), tmp_path)
    assert before.keys() == again.keys()
    for key, value in before.items():
        # Directions are unit vectors; without `use_configuration_matrix` the matrix is not used.
        if key != "configuration_matrix" or direct == "true":
            assert again[key] == pytest.approx(value, rel=0, abs=1e-7 if "vec" in key else 0)
    # The first motor pushes at 150 degrees from (0.02, 0.0346).
    found = model.derivative(np.r_[np.zeros(6), 1, np.zeros(5)], np.zeros(6))
    x, y = np.cos(np.pi * 5 / 6) / 0.1463, 0.5 / 0.1463
    arm = 0.5 * (0.02 + 1e-3) - np.cos(np.pi * 5 / 6) * (0.034641 - 2.5e-4)
    effect = np.array([0.0, 6.8, 82.2] if direct == "true" else [x, y, arm / 0.000294])
    forward, left, spin = effect * (0.01 + 0.97 - 0.45)
    expected = [forward + 2.5e-4 * spin, left + 1e-3 * spin, spin]
    np.testing.assert_allclose(found[3:6], expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("mass: -1", "mass"),
        ("motor_pos_a_1: [0, 0]", "motor_pos_a_1"),
        ("learned_motor_vec_a_1: [0.5, 0, 0]", "unit vectors"),
        ("configuration_matrix: [1, 2]", "configuration_matrix"),
        ("signal_to_thrust_coeffs_motor_1: [0.1]", "same length"),
    ],
)
def test_a_damaged_file_ends_in_one_line(line, message, tmp_path):
    key = line.partition(":")[0]
    lines = file_of_the_controller("true").replace("\n            ", " ").splitlines()
    path = tmp_path / "holohover_params.yaml"
    path.write_text("\n".join(line if old.startswith(f"{key}:") else old for old in lines))
    with pytest.raises(InputError, match=message) as caught:
        read_model(path)
    assert "holohover_params.yaml" in str(caught.value)


@pytest.mark.parametrize("text", ["", "[1, 2]", "mass: 0.1", "? [1, 2]\n: 3\n", "2001-01-01: 1\n"])
def test_an_unrelated_yaml_file_is_rejected_in_one_line(text, tmp_path):
    path = tmp_path / "holohover_params.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"holohover_params\.yaml"):
        read_model(path)


def with_vehicle(**changed):
    return replace(PAPER["M2"], vehicle=PAPER["M2"].vehicle.model_copy(update=changed))


MOVED = PAPER["M2"].vehicle.propellers[0].model_copy(update={"direction_deg": 80.0})


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (FOUR, "4 propellers instead of 6"),
        (replace(PAPER["M3"], frame="body"), "fixed to the body.*--com-frame world"),
        (with_vehicle(command_max=0.9), "highest command of 0.9"),
        (
            with_vehicle(propellers=(MOVED, *PAPER["M2"].vehicle.propellers[1:])),
            "directions other than",
        ),
    ],
)
def test_unrepresentable_models_are_rejected_by_name(model, message, tmp_path):
    with pytest.raises(InputError, match=message):
        export.write(model, "holohover", tmp_path / "out")
    assert not (tmp_path / "out").exists()
