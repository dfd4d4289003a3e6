"""Pulses from duty cycles: their mean, their shortest length, and set points reached with them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, SetPoint, TrackingController, Tuning, read_vehicle
from airpuck.control.excitation import Excitation
from airpuck.control.modulation import MODULATORS, PulseWidth
from airpuck.control.tuning import Modulation, default_tuning, read_tuning
from airpuck.craft.actuators import OnOff
from airpuck.model.model_file import nominal_model

FREE_FLYERS = Path(__file__).parents[2] / "examples" / "free_flyers"
TICK, LEAST, PERIOD = 0.01, 0.03, 0.2


def tuned(period: float = TICK, **modulation: object) -> Tuning:
    """Return a tuning of a period."""
    kind = Modulation.model_validate({"period_s": PERIOD, **modulation})
    return default_tuning().model_copy(update={"period_s": period, "modulation": kind})


def lengths(switches: np.ndarray) -> np.ndarray:
    """Return the lengths of all pulses that end, in ticks."""
    padded = np.concatenate([[0.0], switches])
    begins, ends = np.flatnonzero(np.diff(padded) > 0), np.flatnonzero(np.diff(padded) < 0)
    return ends - begins[: len(ends)]


levels = st.lists(st.lists(st.floats(0, 1), min_size=2, max_size=2), min_size=2, max_size=6)


@pytest.mark.parametrize("kind", list(MODULATORS))
@given(duty=levels.map(np.array))
def test_pulses_have_the_mean_of_their_duty_cycles(kind: str, duty: np.ndarray) -> None:
    modulator = MODULATORS[kind](OnOff(kind="on_off", least_on_s=LEAST), tuned(kind=kind))
    per_period = round(PERIOD / TICK)
    wanted = np.repeat(duty, per_period, axis=0)
    sent = np.array([modulator.command(k * TICK, each) for k, each in enumerate(wanted)])
    assert set(np.unique(sent)) <= {0.0, 1.0}
    for column in sent.T:
        assert (lengths(column) >= round(LEAST / TICK)).all()
    owed = np.cumsum(wanted - sent, axis=0)[per_period - 1 :: per_period] * TICK
    assert np.abs(owed).max() <= LEAST + TICK


@given(duty=levels.map(np.array))
def test_pwm_duty_cycles_are_long_enough_and_keep_the_mean(duty: np.ndarray) -> None:
    kind = OnOff(kind="on_off", least_on_s=LEAST, pwm_period_s=0.1)
    modulator = PulseWidth(kind, tuned(period=0.1))
    sent = np.array([modulator.command(0.1 * k, each) for k, each in enumerate(duty)])
    assert ((sent == 0) | (sent >= LEAST / 0.1 - 1e-9)).all()
    assert sent.max() <= 1
    assert np.abs(np.cumsum(duty - sent, axis=0) * 0.1).max() <= LEAST + 1e-9


def test_pwm_requires_its_period_and_sigma_delta_requires_switches() -> None:
    model = nominal_model(read_vehicle(FREE_FLYERS / "atmos.toml"))
    with pytest.raises(InputError, match=r"period_s: must be the craft's PWM period, 0.1 s"):
        TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuned(), compiled=False)
    with pytest.raises(InputError, match=r"modulation.kind: sigma_delta needs switches"):
        TrackingController(
            model, SetPoint(0.0, 0.0, 0.0), tuned(0.1, kind="sigma_delta"), compiled=False
        )


def controller(name: str) -> TrackingController:
    """Return a controller at rest half a metre before its set point."""
    model = nominal_model(read_vehicle(FREE_FLYERS / f"{name}.toml"))
    tuning = read_tuning(FREE_FLYERS / f"{name}_tuning.toml")
    found = TrackingController(model, SetPoint(0.5, 0.0, 0.0), tuning, compiled=False)
    found.pose(0.0, np.zeros(3))
    return found


def test_the_estimator_receives_the_pulses_that_were_sent() -> None:
    # From rest, thrusters 2 and 5 of the Stanford craft push along x with 0.2 N each.
    pilot, pulse = controller("freeflyer2"), np.array([0, 0, 0.4, 0, 0, 0.4, 0, 0])
    pilot.sent(0.0, pulse)
    speeds = [pilot.predict(time).state[3] for time in (0.0, 0.02, 0.07)]
    assert speeds[0] == pytest.approx(0.0, abs=1e-9)
    # The filter takes the force in the middle of an interval: a few per cent off in a pulse.
    assert speeds[1] == pytest.approx(0.4 / 16.0 * (0.02 - 0.005), rel=0.2)
    # The pulse has ended: its impulse, whatever the lag.
    assert pilot.predict(0.2).state[3] == pytest.approx(0.4 / 16.0 * 0.04, rel=0.03)


def test_requests_below_the_shortest_pulse_are_sent_later() -> None:
    pilot = controller("freeflyer2")
    pilot.reference = SetPoint(0.01, 0.0, 0.0)
    commands = []
    for k in range(40):
        pilot.pose(0.1 * k, np.zeros(3))
        step = pilot.step(0.1 * k)
        assert step.flies
        commands.append(step.command)
    used = np.array(commands)
    assert (used[:, [2, 5]].max(axis=0) >= 0.1).all()
    assert (used == 0).all(axis=1).sum() > 20


@pytest.mark.slow
def test_excitation_of_switches_sends_switch_commands() -> None:
    vehicle = read_vehicle(FREE_FLYERS / "atmos.toml")
    switches = vehicle.actuators.model_copy(update={"pwm_period_s": None})
    model = nominal_model(vehicle.model_copy(update={"actuators": switches}))
    pilot = Excitation(model, tuning=tuned(0.02), hold=0.4)
    sent = []
    for k in range(100):
        pilot.pose(0.02 * k, np.zeros(3))
        sent.append(pilot.step(0.02 * k).command)
    assert set(np.unique(sent)) == {0.0, 1.0}
    assert 0.1 < np.mean(sent) < 0.6
