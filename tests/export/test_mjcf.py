"""The craft in MuJoCo flies, coasts and bounces as in airpuck."""

import subprocess
import sys
from dataclasses import replace

import mujoco
import mujoco.rollout
import numpy as np
import pytest

from airpuck import InputError, Table, export
from airpuck.export import mujoco_craft as craft
from airpuck.export.mjcf import xml
from airpuck.twin.settings import default_twin_settings
from tests.apparatus.export_crafts import EFFECTS, FOUR, PAPER

#: The published M3 has its centre of mass fixed to the world.
M3 = replace(PAPER["M3"], frame="body")
CRAFT = {**PAPER, "M3": M3, "tilt": replace(EFFECTS["tilt"], frame="body"), "four": FOUR}
LARGE = Table(length_m=20.0, width_m=20.0)


def started(model, state, table=LARGE):
    compiled = mujoco.MjModel.from_xml_string(xml(model, table))
    data = mujoco.MjData(compiled)
    craft.set_state(compiled, data, state)
    return compiled, data


@pytest.mark.parametrize("model", CRAFT.values(), ids=CRAFT)
def test_a_second_of_free_flight_matches_the_model(model):
    random, n = np.random.default_rng(0), model.vehicle.n_propellers
    commands = random.uniform(model.vehicle.command_min, 1, (10, n))
    speeds = random.uniform(0, 1, n if model.dynamics.motor_time_constant > 0 else 0)
    state = np.concatenate([[0.1, -0.2, 0.5, 0.3, -0.4, 0.6], speeds])
    compiled, data = started(model, state)
    steps = round(0.1 / compiled.opt.timestep)
    controls = craft.controls(compiled, speeds, np.repeat(commands, steps, axis=0))
    full = np.zeros((1, mujoco.mj_stateSize(compiled, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    mujoco.mj_getState(compiled, data, full[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states, _ = mujoco.rollout.rollout(compiled, data, full, controls[None])
    flown = states[0, steps - 1 :: steps, 1:4]  # time, then qpos
    expected = model.simulate(state, np.repeat(commands, 50, axis=0), 2e-3)[49::50]
    np.testing.assert_allclose(flown, expected[:, :3], rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("seed", "period", "off"),
    [(0, None, (1e-5, 1e-5))] + [(seed, 0.01, (1e-4, 5e-3)) for seed in range(3)],
)
def test_commands_are_set_before_each_step_or_once_per_stated_period(seed, period, off):
    state = np.concatenate([np.zeros(6), np.full(6, 0.03)])
    commands = np.random.default_rng(seed).uniform(0.03, 1, (20, 6))
    compiled, data = started(M3, state)
    steps = round(0.01 / compiled.opt.timestep)
    for command in commands:
        for _ in range(1 if period else steps):
            craft.set_command(compiled, data, command, *([period] if period else []))
            mujoco.mj_step(compiled, data, steps if period else 1)
    expected = M3.simulate(state, np.repeat(commands, 10, axis=0), 1e-3)[-1]
    flown = craft.get_state(compiled, data)
    np.testing.assert_allclose(flown[:2], expected[:2], atol=off[0])
    np.testing.assert_allclose(flown[2], expected[2], atol=off[1])
    np.testing.assert_allclose(flown[3:6], expected[3:6], atol=1e9 if period else 1e-3)
    np.testing.assert_allclose(flown[6:], expected[6:], atol=1e-12)


def test_commands_held_for_too_long_are_rejected():
    compiled, data = started(M3, np.concatenate([np.zeros(6), np.full(6, 0.03)]))
    craft.set_command(compiled, data, [0.5] * 6)
    mujoco.mj_step(compiled, data, 2)
    with pytest.raises(ValueError, match="call set_command before each step, or give it the"):
        craft.set_command(compiled, data, [0.5] * 6)
    mujoco.mj_resetData(compiled, data)
    craft.set_command(compiled, data, [0.5] * 6)


@pytest.mark.parametrize(("integrator", "exact"), [("implicitfast", 1), ("Euler", 1), ("RK4", 0)])
def test_the_lag_is_exact_except_with_runge_kutta(integrator, exact):
    text = xml(M3, LARGE).replace('"implicitfast"', f'"{integrator}"')
    compiled = mujoco.MjModel.from_xml_string(text)
    compiled.opt.timestep = float(M3.parameters.motor_time_constant) / 10
    data = mujoco.MjData(compiled)
    for _ in range(10):
        data.ctrl[:] = 1.0
        mujoco.mj_step(compiled, data)
    assert (abs(data.act[0] - (1 - np.exp(-1))) < 1e-12) == exact


@pytest.mark.parametrize("restitution", [0.3, 0.5, 0.7, 0.9, 1.0])
@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_rails_have_the_restitution_of_the_table(restitution, speed):
    table = Table(restitution=restitution, friction=0.0)
    compiled, data = started(PAPER["M2"], np.r_[0.9, 0, 0, speed, 0, 0, np.zeros(6)], table)
    for _ in range(round(0.4 / speed / compiled.opt.timestep)):
        mujoco.mj_step(compiled, data)
        if data.qvel[0] < 0 and data.qpos[0] < 1.1 - 0.07 - 0.01:
            break
    assert -data.qvel[0] / speed == pytest.approx(restitution, abs=0.03)
    assert data.qpos[1] == pytest.approx(0, abs=2e-3)


def test_sensors_measure_pose_and_forces():
    compiled, data = started(M3, np.r_[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, np.full(6, 0.5)])
    mujoco.mj_forward(compiled, data)
    for name, value in (("x", 0.1), ("y", 0.2), ("yaw", 0.3)):
        assert data.sensor(f"pose_{name}").data == pytest.approx(value)
    powers = ("force_motor_a_1", "force_motor_a_1^2", "force_motor_a_1^3")
    force = sum(data.sensor(name).data[0] for name in powers)
    assert force == pytest.approx(M3.parameters.thrust[0] @ [0.5, 0.25, 0.125])


def test_the_files_work_without_airpuck(tmp_path):
    written = export.write(M3, "mjcf", tmp_path)
    assert written.files == ("airpuck_craft.py", "craft.xml")
    code = (
        "import sys, mujoco, airpuck_craft as craft\n"
        "model = mujoco.MjModel.from_xml_path('craft.xml')\n"
        "data = mujoco.MjData(model)\n"
        "craft.set_command(model, data, [0.5] * 6)\n"
        "mujoco.mj_step(model, data)\n"
        "assert 'airpuck' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_a_centre_of_mass_fixed_to_the_world_is_rejected():
    with pytest.raises(InputError, match=r"fixed to the world.*--com-frame body"):
        xml(PAPER["M3"], LARGE)


@pytest.mark.parametrize(
    ("section", "field"), [("effects", {"inflow_s_m": 0.1}), ("motors", {"unarmed_s": 1.0})]
)
def test_effects_and_faults_of_the_twin_are_rejected(section, field, tmp_path):
    twin = default_twin_settings()
    changed = getattr(twin, section).model_copy(update=field)
    with pytest.raises(InputError, match=f"{section}: is set, which an export to mjcf cannot"):
        export.write(M3, "mjcf", tmp_path, twin=twin.model_copy(update={section: changed}))
