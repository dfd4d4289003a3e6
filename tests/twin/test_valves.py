"""On/off thrusters in the twin: dead time, rise, fall, least on-time, PWM."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from airpuck import ActuatorKind, InputError, Model, Twin, TwinBatch, Vehicle
from airpuck.craft.actuators import OnOff
from airpuck.craft.vehicle import Propeller, default_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.twin.craft import Driver
from airpuck.twin.settings import default_twin_settings

from ..apparatus.changes import changed

FORCE, MASS = 0.5, 10.0
DEAD, RISE, FALL = 0.0123, 0.006, 0.02


def craft(**times: float) -> Model:
    """One thruster along x; its radio has no delay."""
    nominal = changed(
        default_vehicle().nominal,
        thrust_N=(FORCE,),
        inertia_kg_m2=0.05,
        motor_time_constant_s=(RISE + FALL) / 2,
        transport_delay_s=DEAD,
    )
    known = {"dead_time_s": DEAD, "rise_s": RISE, "fall_s": FALL, **times}
    vehicle = Vehicle(
        name="one",
        mass_kg=MASS,
        radius_m=0.1,
        propellers=(Propeller(name="a", position_m=(0.1, 0.0), direction_deg=0.0),),
        actuators=OnOff(kind="on_off", **known),
        nominal=nominal,
    )
    return nominal_model(vehicle)


def flown(model: Model, *sent: tuple[float, float], until: float) -> tuple[float, float]:
    """Return position and speed along x after commands (time, level)."""
    quiet = changed(default_twin_settings(), radio={"jitter_s": 0.0, "timeout_s": 10.0})
    twin = Twin(model, quiet)
    for time, level in sent:
        twin.wait_until(time)
        twin.send(np.array([level]))
    # The state belongs to the last event: a frame of the motion capture.
    twin.wait_until(until)
    return float(twin.state[0]), float(twin.state[3])


def impulse(on: float, later: float) -> float:
    """Integrate the force by hand: ∫ (1 - e^(-t/rise)), then the decay from the force reached."""
    reached = 1 - np.exp(-on / RISE)
    return FORCE * (on - RISE * reached + FALL * reached * (1 - np.exp(-later / FALL)))


PERIODS = {"pwm_period_s": 0.1, "rise_s": 0.01, "fall_s": 0.01}


@pytest.mark.parametrize(
    ("times", "sent", "expected"),
    [
        *(
            ({}, [(0.0501, 1.0), (0.0501 + on, 0.0)], impulse(on, 1.0 - on))
            for on in (0.0317, 0.0051, 0.2)
        ),
        ({"least_on_s": 0.03}, [(0.05, 1.0), (0.06, 0.0)], impulse(0.03, 0.9)),
        # With equal rise and fall, an impulse is force times on-time: three periods, then one.
        (PERIODS, [(0.05, 0.3), (0.35, 0.8), (0.45, 0.0)], FORCE * (3 * 0.03 + 0.08)),
        # Unequal packets in a period wait until half of it has passed.
        (PERIODS, [(0.0, 0.1), (0.02, 0.9), (0.14, 0.0)], FORCE * (0.01 + 0.09)),
    ],
    ids=["32 ms", "5 ms", "0.2 s", "the least time", "duty cycles", "packets in a period"],
)
def test_pulses_have_the_impulse_of_a_hand_calculation(times, sent, expected) -> None:
    _, speed = flown(craft(**times), *sent, until=1.0)
    assert speed == pytest.approx(expected / MASS, rel=2e-3)


def test_nothing_moves_before_the_dead_time() -> None:
    # Frames at 240 Hz: the last one before the force begins, at 112.3 ms, is at 108.3 ms.
    assert flown(craft(), (0.1, 1.0), until=0.112)[1] == 0.0
    assert flown(craft(), (0.1, 1.0), until=0.118)[1] > 0.0


def test_a_valve_at_full_duty_stays_open_between_periods() -> None:
    pwm, switch = craft(pwm_period_s=0.1), craft()
    ends = [flown(m, (0.0, 1.0), (0.3, 0.0), until=0.8) for m in (pwm, switch)]
    np.testing.assert_allclose(*ends, rtol=1e-6)


def test_a_batch_rejects_valves() -> None:
    model = craft()
    with pytest.raises(InputError, match="use Twin"):
        TwinBatch([model, replace(model)], 2, 1.0)


class Halved(ActuatorKind):
    """Valves that open half, and fully a while later; commands up to 0.1 do nothing."""

    kind: Literal["halved"] = "halved"
    stage_s: float = 0.013

    def possible(self, command):
        return np.where(command > 0.1, command, 0.0)

    def changes(self, time, command, since):
        drive = self.possible(command)
        first = np.where(np.isinf(since), drive / 2, drive)
        return [(time, first), (time + self.stage_s, drive)]


@pytest.mark.parametrize(
    "kind",
    [
        Halved(),
        Halved(dead_time_s=0.004),
        OnOff(kind="on_off", least_on_s=0.03),
        OnOff(kind="on_off", pwm_period_s=0.1, least_on_s=0.02),
    ],
    ids=["halved", "late", "switches", "pulses"],
)
def test_the_twin_drives_actuators_like_recordings_are_interpreted(kind):
    random, period = np.random.default_rng(3), 0.1
    sent = period * np.arange(30)
    command = random.random((30, 3)) * (random.random((30, 3)) < 0.7)
    begun, drives = kind.drive(sent, command)
    driver = Driver(kind, 3)
    now = 0.0
    while now < 2.9:
        held = command[int((now + 1e-9) / period)]
        found = driver.drive(now, held)
        known = np.searchsorted(begun, now - kind.dead_time_s + 1e-7, side="right") - 1
        expected = drives[known] if known >= 0 else np.zeros(3)
        np.testing.assert_array_equal(found, expected, err_msg=f"at {now}")
        following = period * (int((now + 1e-9) / period) + 1)
        now = min(driver.next_change(now, lambda _, held=held: held), following)
