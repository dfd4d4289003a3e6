"""The function files compute under Octave what airpuck computes."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from airpuck import export
from airpuck.model.simulation import linearize, trim
from tests.apparatus.c_programs import compiler
from tests.apparatus.export_crafts import HELD, PAPER, random_states

CRAFT = {**HELD, "body": replace(PAPER["M3"], frame="body")}
YAW, PERIOD, STATES = 0.7, 0.02, 12
DRIVER = """
cd('{folder}'); clear all;
z = load('states.txt'); u = load('commands.txt');
rates = next = zeros(size(z)); p = airpuck_parameters();
for k = 1:size(z, 1)
    rates(k, :) = airpuck_dynamics(z(k, :), u(k, :), p);
    next(k, :) = airpuck_step(z(k, :), u(k, :), {period}, p);
end
[A, B, hover] = airpuck_hover({yaw}, p);
assert(airpuck_dynamics(z(1, :), u(1, :))', rates(1, :));
save('-text', 'found.txt', 'rates', 'next', 'A', 'B', 'hover');
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Run Octave once for all craft; return its matrices by craft and name."""
    octave, scripts, folders = compiler("octave-cli"), [], {}
    for name, model in CRAFT.items():
        folders[name] = folder = tmp_path_factory.mktemp("matlab")
        export.write(model, "matlab", folder)
        for file, rows in zip(("states", "commands"), random_states(model, STATES), strict=True):
            np.savetxt(folder / f"{file}.txt", rows, fmt="%.17g")
        scripts.append(DRIVER.format(folder=folder, period=PERIOD, yaw=YAW))
    script = tmp_path_factory.mktemp("driver") / "driver.m"
    script.write_text("".join(scripts))
    done = subprocess.run([octave, str(script)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {name: matrices((folder / "found.txt").read_text()) for name, folder in folders.items()}


def matrices(text):
    """Read Octave's text format."""
    parts = text.split("# name: ")[1:]
    return {
        part.split("\n", 1)[0]: np.array(
            [line.split() for line in part.splitlines()[1:] if line and line[0] != "#"], float
        )
        for part in parts
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", CRAFT)
def test_rates_and_steps_equal_those_in_python(name, found):
    model = CRAFT[name]
    states, commands = random_states(model, STATES)
    rates = np.array([model.derivative(*pair) for pair in zip(states, commands, strict=True)])
    after = np.array(
        [model.simulate(z, u[None], PERIOD)[0] for z, u in zip(states, commands, strict=True)]
    )
    np.testing.assert_allclose(found[name]["rates"], rates, rtol=1e-9, atol=1e-9)
    expected = after[:, : states.shape[1]]
    np.testing.assert_allclose(found[name]["next"], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", CRAFT)
def test_the_linearisation_equals_that_in_python(name, found):
    dynamics = CRAFT[name].dynamics
    command = trim(dynamics, yaw=YAW)
    np.testing.assert_allclose(found[name]["hover"][:, 0], command, rtol=0, atol=1e-9)
    for key, matrix in zip("AB", linearize(dynamics, YAW, command), strict=True):
        np.testing.assert_allclose(found[name][key], matrix, rtol=1e-9, atol=1e-9)
