"""The model in C against the physics in Python: all rungs, layouts, frames and effects."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.boundary.errors import InputError
from airpuck.export.c import title, write_model
from airpuck.model.model_file import Model, published_model
from airpuck.physics.effects import Effect, Inflow, VoltageSag
from airpuck.physics.rigid_body import acceleration, rollout

from ..apparatus.c_programs import SANITIZED, SINGLE, build
from ..apparatus.examples import examples
from ..apparatus.models import four_propellers, model_of

DRIVER = Path(__file__).parent / "drive_model.c"
STEPS = 3
PUBLISHED = published_model("M3")


def with_everything() -> Model:
    """Four propellers with a free configuration matrix in thrusts of another scale; all effects."""
    model = model_of(four_propellers(), "M4+drag+inflow+pair+sag+tilt+idle")
    scale = np.array([0.5, 1.0, 2.0, 3.0])
    matrix = np.asarray(model.parameters.configuration_matrix) / scale
    parameters = replace(
        model.parameters,
        thrust=model.parameters.thrust * scale[:, None],
        configuration_matrix=matrix,
        center_of_mass=np.array([4e-3, -7e-3]),
        angle_offset=0.3,
        drag=np.array([0.3, 0.2, 0.1, 0.05]),
        inflow=0.1,
        pair_interaction=0.4,
        voltage_sag=0.2,
        tilt=np.array([0.004, -0.002]),
        idle_lag=1.5,
    )
    return replace(model, parameters=parameters)


MODELS = {
    **{name: published_model(name) for name in ("M0", "M1", "M2", "M3", "M4")},
    "body frame": replace(published_model("M3"), frame="body"),
    "everything": with_everything(),
}


def driver(model: Model, folder: Path, *options: str, using: str = "gcc") -> Path:
    """Compile a model with a program that reads and writes numbers."""
    write_model(model, folder)
    sources = [folder / "airpuck_model.c", folder / "airpuck_data.c", DRIVER]
    return build(folder / "drive", sources, *options, using=using)


def run(program: Path, *records: np.ndarray) -> np.ndarray:
    given = np.concatenate([np.ravel(record) for record in records]).astype(float)
    done = subprocess.run([program], input=given.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout)


def random_states(n: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States, three commands for each and their durations up to 10 ms; the batch comes first."""
    random = np.random.default_rng(0)
    state = random.uniform(-1, 1, (count, 6 + n)) * np.r_[1, 1, 10, 2, 2, 20, np.ones(n)]
    state[:, 6:] = np.abs(state[:, 6:])
    return state, random.random((count, STEPS, n)), random.uniform(0, 0.01, (count, STEPS))


def in_python(model: Model, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Predicted states and accelerations at the first states."""
    state, commands, durations = random_states(model.vehicle.n_propellers, count)
    ends = rollout(np, model.dynamics, state.T, commands.transpose(1, 2, 0), durations.T)[-1]
    rates = acceleration(np, model.dynamics, state.T[2:6], state.T[6:])
    return ends.T, np.array(rates).T


def in_c(program: Path, n: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    state, commands, durations = random_states(n, count)
    steps = np.full((count, 1), STEPS)
    predictions = np.hstack([steps, state, commands.reshape(count, -1), durations])
    ends = run(program, predictions).reshape(count, -1)
    return ends, run(program, np.hstack([-np.ones((count, 1)), state])).reshape(count, 3)


@pytest.mark.parametrize("name", MODELS)
def test_the_motion_equals_that_in_python(name: str, tmp_path: Path) -> None:
    model, count = MODELS[name], 300
    n = model.vehicle.n_propellers
    expected = in_python(model, count)
    for options, tolerance in (((), 1e-12), (SINGLE, 1e-4)):
        found = in_c(driver(model, tmp_path, *options), n, count)
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)


def test_no_input_causes_undefined_behaviour(tmp_path: Path) -> None:
    """Non-finite states and durations give non-finite results, but no invalid access."""
    program = driver(MODELS["everything"], tmp_path, *SANITIZED)
    in_c(program, 4, 20)
    state, commands, durations = (each[0] for each in random_states(4, 1))
    records = []
    for value in (np.nan, np.inf, -np.inf, 1e308, -1e308):
        for entry in range(len(state)):
            hostile = state.copy()
            hostile[entry] = value
            records += [np.array([STEPS]), hostile, commands, durations]
        records += [np.array([STEPS]), state, np.full_like(commands, value), durations]
        records += [np.array([STEPS]), state, commands, np.full_like(durations, value)]
    run(program, *records)


def test_unknown_and_repeated_effects_are_rejected_by_name(tmp_path: Path) -> None:
    class Magnet(Effect):
        pass

    dynamics = PUBLISHED.dynamics
    with pytest.raises(InputError, match="Magnet"):
        write_model(PUBLISHED, tmp_path, dynamics=replace(dynamics, effects=(Magnet(),)))
    sag, inflow = VoltageSag(0.1, np.ones(6)), Inflow(0.1, np.zeros((6, 3)))
    for effects in ((sag, inflow), (inflow, inflow)):
        with pytest.raises(InputError, match="Inflow"):
            write_model(PUBLISHED, tmp_path, dynamics=replace(dynamics, effects=effects))
    assert not list(tmp_path.iterdir())


@examples(20)
@given(st.text("*/\\?\n\0 abc", max_size=300))
def test_names_cannot_end_a_comment(text: str) -> None:
    """A model's source is anyone's text."""
    lines = title(replace(PUBLISHED, source=text))
    inside = lines.removeprefix("/*").removesuffix("*/")
    assert not [code for code in ("*/", "/*", "\\", "??", "\0") if code in inside]
    assert all(len(line) < 110 for line in lines.split("\n"))


def test_the_sources_list_the_motors_in_command_order() -> None:
    told = " ".join(title(PUBLISHED).replace("\n *", "").split())
    assert f"commands: {', '.join(PUBLISHED.vehicle.propeller_names)}." in told
