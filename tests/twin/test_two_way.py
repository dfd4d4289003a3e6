"""The twin of a craft whose propellers reverse and which has a reaction wheel."""

from pathlib import Path

import numpy as np
import pytest

from airpuck.control.modulation import modulator_for
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import Model, nominal_model
from airpuck.twin.craft import driver_of
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings
from airpuck.twin.twin import Twin

from ..apparatus.two_way_craft import triangle

#: Angular momentum of the wheel at its largest speed over the craft's inertia [rad/s].
MOST_SPIN = 1e-5 * 600 / 0.022
#: A wheel that needs 0.3 s to its largest speed.
LIGHT = {"inertia_kg_m2 = 1e-4": "inertia_kg_m2 = 1e-5"}


def settings():
    usual = default_twin_settings()
    return usual.model_copy(update={"radio": usual.radio.model_copy(update={"jitter_s": 0.0})})


def flown(model: Model, command: list[float], duration: float) -> np.ndarray:
    """The state after a constant command, sent every 50 ms."""
    plant = build_plant(model, settings(), compiled=False)
    twin = Twin(model, settings(), plant=plant)
    for time in np.arange(0, duration, 0.05):
        twin.wait_until(float(time))
        twin.send(np.array(command))
    twin.wait_until(duration)
    return twin.state


def test_a_wheel_turns_the_craft_until_its_speed_limit(tmp_path: Path) -> None:
    model = nominal_model(triangle(tmp_path, **LIGHT)).with_delay(0.0)
    before = flown(model, [0, 0, 0, 1.0], 0.3)
    lagging = 0.06 * (1 - np.exp(-0.3 / 0.06))
    assert before[5] == pytest.approx(-(0.3 - lagging) * 0.02 / 0.022, rel=1e-4)
    after = flown(model, [0, 0, 0, 1.0], 0.8)
    assert after[5] == pytest.approx(-MOST_SPIN, rel=1e-3)
    assert np.abs(after[:2]).max() < 1e-12


def test_the_drive_changes_when_the_wheel_reaches_its_speed_limit(tmp_path: Path) -> None:
    model = nominal_model(triangle(tmp_path, **LIGHT))
    driver = driver_of(model.vehicle.actuation)
    command = np.array([0.5, 0.0, 0.0, 1.0])
    reached = 1e-5 * 600 / 0.02
    assert driver.next_change(0.0, lambda _: command) == pytest.approx(reached)
    for time, wheel in ((0.99 * reached, 1.0), (1.01 * reached, 0.0)):
        assert driver.drive(time, command).tolist() == [0.5, 0, 0, wheel, 0, 0, 0]
    assert driver.next_change(1.01 * reached, lambda _: command) == np.inf


def test_a_wheel_follows_a_commanded_speed(tmp_path: Path) -> None:
    model = nominal_model(triangle(tmp_path, 'commanded = "speed"', **LIGHT)).with_delay(0.0)
    assert flown(model, [0, 0, 0, -0.25], 0.6)[5] == pytest.approx(MOST_SPIN / 4, rel=1e-3)


def test_a_propeller_has_its_own_reverse_thrust(tmp_path: Path) -> None:
    model = nominal_model(triangle(tmp_path)).with_delay(0.0)
    forth, back = (flown(model, [sign, 0, 0, 0], 0.2)[3] for sign in (1.0, -1.0))
    assert back == pytest.approx(-forth / 2, rel=1e-6)
    assert forth > 0


@pytest.mark.parametrize("commanded", ["torque", "speed"])
def test_a_modulator_combines_both_directions(commanded: str, tmp_path: Path) -> None:
    model = nominal_model(triangle(tmp_path, f'commanded = "{commanded}"'))
    tuning = default_tuning()
    modulator = modulator_for(model, tuning)
    wanted = np.array([0.2, 0.0, 0.4, 0.5, 0.0, 0.3, 0.1])
    first, second = (modulator.command(now, wanted) for now in (0.0, tuning.period_s))
    np.testing.assert_allclose(first[:3], [0.2, -0.3, 0.4])
    gain = 0.4 if commanded == "torque" else 0.4 * tuning.period_s / 3.0
    assert first[3] == pytest.approx(gain)
    assert second[3] == pytest.approx(gain if commanded == "torque" else 2 * gain)
    # What is sent causes the wanted drives again.
    _, drives = model.vehicle.actuation.drive(np.array([0.0]), first[None])
    np.testing.assert_allclose(model.vehicle.actuation.joined(drives)[0, :3], first[:3])
