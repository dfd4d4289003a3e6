"""On/off thrusters in a vehicle file, and the pulses that commands cause."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, named_rung, read_vehicle
from airpuck.craft.actuators import OnOff
from airpuck.craft.vehicle import Vehicle, default_vehicle

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
PERIOD = 0.1


@pytest.mark.parametrize("name", ["atmos", "freeflyer2"])
def test_free_flyers_push_and_turn_both_ways_and_round_trip(name: str, tmp_path: Path) -> None:
    vehicle = read_vehicle(FREE_FLYERS / f"{name}.toml")
    x, y = vehicle.positions.T
    along, across = vehicle.directions.T
    moments = x * across - y * along
    np.testing.assert_allclose(vehicle.directions.sum(axis=0), 0, atol=1e-12)
    assert moments.sum() == pytest.approx(0, abs=1e-12)
    assert (moments > 0.1).sum() == (moments < -0.1).sum() == 4
    assert vehicle.nominal.motor_time_constant_s == 0.005  # from rise and fall
    vehicle.save(tmp_path / "again.toml")
    assert read_vehicle(tmp_path / "again.toml") == vehicle


def test_a_propeller_craft_keeps_its_file_format(tmp_path: Path) -> None:
    default_vehicle().save(tmp_path / "holohover.toml")
    assert "actuators" not in (tmp_path / "holohover.toml").read_text()


@pytest.mark.parametrize(
    ("wrong", "instead", "message"),
    [
        ("dead_time_s = 0.01", "dead_time_s = -0.01", "actuators.dead_time_s"),
        ("dead_time_s", "deadtime_s", "did you mean dead_time_s"),
        ("thrust_N = [0.2]", "thrust_N = [0.1, 0.1]", "degree 2"),
        ("least_on_s = 0.01", "least_on_s = 0.2", "must not exceed pwm_period_s"),
        ('"on_off"', '"valve"', "actuators: there is no kind 'valve'.*FILE.py:NAME"),
    ],
)
def test_errors_name_the_field(wrong: str, instead: str, message: str, tmp_path: Path) -> None:
    text = (FREE_FLYERS / "freeflyer2.toml").read_text().replace(wrong, instead)
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_vehicle(tmp_path / "wrong.toml")


def test_on_off_thrusters_reject_curved_thrust() -> None:
    vehicle: Vehicle = read_vehicle(FREE_FLYERS / "atmos.toml")
    assert named_rung("M3").initial(vehicle).thrust.shape == (8, 1)
    for rung in (named_rung("M3", degree=3), named_rung("quadratic")):
        with pytest.raises(InputError, match="use degree 1"):
            rung.initial(vehicle)


duties = st.lists(st.lists(st.floats(0, 1), min_size=3, max_size=3), min_size=2, max_size=5).map(
    np.array
)


@given(duty=duties, start=st.floats(-1e3, 1e3))
def test_pulses_have_the_mean_of_their_duty_cycles(duty: np.ndarray, start: float) -> None:
    sent = start + PERIOD * np.arange(len(duty))
    time, drive = OnOff(kind="on_off", pwm_period_s=PERIOD).drive(sent, duty)
    assert set(np.unique(drive)) <= {0.0, 1.0}
    assert (np.diff(time) >= 0).all()
    lasting = np.diff(np.append(time, start + PERIOD * len(duty)))
    for k, wanted in enumerate(duty):
        within = (time >= sent[k]) & (time < sent[k] + PERIOD - 1e-7)
        open_s = (drive[within] * lasting[within, None]).sum(axis=0)
        np.testing.assert_allclose(open_s, PERIOD * wanted, atol=1e-7)


def test_too_short_pulses_last_the_shortest_on_time() -> None:
    kind = OnOff(kind="on_off", pwm_period_s=PERIOD, least_on_s=0.02)
    time, drive = kind.drive(np.zeros(1), np.array([[0.1, 0.5, 0.0]]))
    assert time.tolist() == [0.0, 0.02, 0.05]
    assert drive.tolist() == [[1, 1, 0], [0, 1, 0], [0, 0, 0]]


def test_commands_at_other_periods_act_by_their_mean() -> None:
    time, duty = 0.02 * np.arange(10), np.full((10, 2), 0.3)
    for kind in (OnOff(kind="on_off", pwm_period_s=PERIOD), default_vehicle().actuators):
        found, drive = kind.drive(time, duty)
        assert found is time
        assert drive is duty


def test_switches_round_trip(tmp_path: Path) -> None:
    vehicle = read_vehicle(FREE_FLYERS / "atmos.toml")
    switches = vehicle.model_copy(update={"actuators": OnOff(kind="on_off", rise_s=0.01)})
    switches.save(tmp_path / "again.toml")
    assert read_vehicle(tmp_path / "again.toml").actuators == switches.actuators


def test_a_switch_opens_at_half_command() -> None:
    _, drive = OnOff(kind="on_off").drive(np.zeros(1), np.array([[0.0, 0.4, 0.5, 1.0]]))
    assert drive.tolist() == [[0, 0, 1, 1]]
