import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.io import savemat

import airpuck

CONVERT = Path(__file__).parents[2] / "examples/cybership_enterprise/convert.py"
OURS = Path(airpuck.__file__).parent / "packaged/datasets/cybership-enterprise"


@pytest.fixture
def run(tmp_path):
    """A second of a run: it moves to the north-east, and turns clockwise."""
    script, time = runpy.run_path(str(CONVERT)), np.arange(0, 1, 0.05)
    data = np.zeros((14, len(time)))
    data[0], data[1], data[2], data[6] = time, 1 + time, 2 + 0.5 * time, 0.1 + 0.2 * time
    data[7:12] = np.array([[0.5], [-0.25], [1.003], [0.0], [0.3]])
    data[12:] = np.array([[1.0], [0.4]])
    data[1:7, 3] = 0.0  # the cameras lost the ship
    data[13, :2] = 0.1  # both propellers at the stern start
    (tmp_path / script["RUNS"]).mkdir(parents=True)
    for number in (1, 3, 4):
        file = tmp_path / script["RUNS"] / f"CSE1_data_random_run{number}.mat"
        savemat(file, {"cse1_data": data})
    script["main"](tmp_path, tmp_path / "runs")
    mapping = airpuck.read_mapping(OURS / "mapping.toml")
    return airpuck.read_recording(tmp_path / "runs/run1.csv", mapping=mapping)


def test_north_east_down_becomes_forward_left_up(run):
    first, last = run["pose"].values[[0, -1]]
    np.testing.assert_allclose(first, [1.0, -2.0, -0.1])
    np.testing.assert_allclose(last, [1.95, -2.475, -0.29])


def test_frames_without_the_ship_are_excluded(run):
    assert len(run["pose"].values) == 19


def test_stopped_drives_do_not_push(run):
    np.testing.assert_allclose(run["command"].values[0], [0, 0, 0, 0, 0.3])
    np.testing.assert_allclose(run["command"].values[5], [0.5, -0.25, 1.0, 0.0, 0.3])


def test_a_bow_thruster_that_pushes_sideways_turns_the_ship_clockwise():
    vehicle = airpuck.read_vehicle(OURS / "vehicle.toml")
    effects = airpuck.nominal_model(vehicle).propeller_effects
    bow = vehicle.propeller_names.index("bow")
    assert effects[1, bow] < 0 and effects[2, bow] < 0
    aside = vehicle.propeller_names.index("port_aside")
    assert effects[1, aside] < 0 < effects[2, aside]


def test_the_laboratorys_model_predicts_a_ship_that_obeys_its_equation():
    """Its equation as in cse1_m.m, solved by SciPy for five seconds of constant commands."""
    command = np.array([0.6, -0.3, 0.2, 0.4, -0.5])
    mass = np.array([[14.7, 0, 0], [0, 29.1, 0.523], [0, 0.523, 2.1]])
    damping = np.array([[0.55, 0, 0], [0, 3.94, 0.1], [0, -1.0, 0.3]])
    k = command * [1.28, 1.05, 1.28, 1.05, 2.14]
    turns = 0.055 * (k[0] - k[2]) - 0.425 * (k[1] + k[3]) + 0.415 * k[4]
    force = [k[0] + k[2], k[1] + k[3] + k[4], turns]

    def world(pose, body):
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        return [cos * body[0] - sin * body[1], sin * body[0] + cos * body[1], body[2]]

    def rates(_, x):
        return [*world(x[:3], x[3:]), *np.linalg.solve(mass, force - damping @ x[3:])]

    time, start = np.arange(0, 8, 0.05), [0.0, 0.0, 2.0, 0.2, -0.1, 0.1]
    true = solve_ivp(rates, (0, 8), start, t_eval=time, rtol=1e-9, atol=1e-9).y.T
    moved = np.array([world(row[:3], row[3:]) for row in true])
    vehicle = airpuck.read_vehicle(OURS / "vehicle.toml")
    flight = airpuck.Trajectory(
        time,
        np.hstack([true[:, :3], moved]) * [1, -1, -1, 1, -1, -1],
        np.zeros((len(time), 3)),
        time,
        np.tile(np.maximum([command, -command], 0).ravel(), (len(time), 1)),
        vehicle.propeller_names,
    )
    protocol = airpuck.Protocol("ship", encoder_time=1.0).after(5.0)
    found = airpuck.evaluate(airpuck.nominal_model(vehicle), flight, protocol=protocol)
    predicted = runpy.run_path(str(CONVERT.with_name("table.py")))["laboratory"](found, flight)
    assert np.abs(found.errors[-1]).max() > 0.05
    assert np.abs(predicted.errors).max() < 5e-4
