import runpy
from pathlib import Path

import numpy as np
import pytest
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
