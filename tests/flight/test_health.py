"""The monitor beside flights of the twin whose faults are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from airpuck.control.reference import SetPoints
from airpuck.evaluation.evaluate import evaluate
from airpuck.flight.health import Deviations, Health, HealthMonitor, Judged, deviations
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Motors, TwinSettings, Weakness, default_twin_settings

MODEL = published_model("M4")
NAMES = MODEL.vehicle.propeller_names
DWELL, HEALTHY, FAULTY, FAULT = 1.5, 5.0, 8.0, 4.0
POINTS = [(0, 0, 0), (0.3, 0.1, 1.0), (0.0, -0.2, -0.5), (0.3, -0.1, 0.7)] * 2
WEAK, SHARE, DELAY = "motor_b_2", 0.8, 0.01


@pytest.fixture(scope="module")
def plant():
    return build_plant(MODEL)


def flown(plant, settings: TwinSettings, duration: float, seed: int = 0) -> Recording:
    """Set points flown on the twin."""
    set_points = SetPoints(DWELL * np.arange(len(POINTS)), POINTS)
    return track(MODEL, set_points, duration, seed=seed, settings=settings, plant=plant)[0]


def watched(recording: Recording, *times: float, monitor: HealthMonitor) -> list[Health]:
    """Return a monitor's findings at some times of a flight, and at its end."""
    start = int(recording["pose"].stamp_ns[0])
    heard = [
        ((int(stamp) - start) / 1e9, kind == "pose", values)
        for kind in ("command", "pose")
        for stamp, values in zip(recording[kind].stamp_ns, recording[kind].values, strict=True)
    ]
    told, left = [], list(times)
    for time, is_pose, values in sorted(heard, key=lambda entry: entry[:2]):
        while left and time > left[0]:
            left.pop(0)
            told.append(monitor.health())
        (monitor.pose if is_pose else monitor.command)(time, values)
    return [*told, monitor.health()]


@pytest.fixture(scope="module")
def faulty(plant):
    """A motor that weakens on the way, and a delay that is longer than the model's."""
    weak = Motors(weak=(Weakness(motor=WEAK, start_s=FAULT, stop_s=99.0, share=SHARE),))
    settings = default_twin_settings()
    radio = settings.radio.model_copy(update={"delay_s": MODEL.transport_delay + DELAY})
    settings = settings.model_copy(update={"motors": weak, "radio": radio})
    return flown(plant, settings, FAULTY)


@pytest.mark.slow
def test_a_healthy_craft_is_not_alarmed(plant):
    healthy = flown(plant, default_twin_settings(), HEALTHY, seed=2)
    told = watched(healthy, 3.0, 4.0, monitor=HealthMonitor(MODEL))
    assert told[-1].found.predictions > 40
    for health in told:
        assert health.flying
        assert health.findings == ()
        assert "agree with the model" in str(health)


@pytest.mark.slow
def test_a_propeller_that_weakens_in_flight_and_a_longer_delay_are_named(faulty):
    before, after = watched(faulty, FAULT, monitor=HealthMonitor(MODEL))
    assert not any("propeller" in told for told in before.findings)
    of_motor, of_delay = after.findings
    assert of_motor.startswith(f"propeller {WEAK} at ")
    assert of_delay.endswith("longer than the model's")
    found, i = after.found, NAMES.index(WEAK)
    assert found.value[i] == pytest.approx(SHARE, abs=3 * found.deviation[i])
    assert found.deviation[i] < 0.03
    assert np.argmax(found.share[:-1]) == i
    assert found.value[-1] == pytest.approx(DELAY, abs=3 * found.deviation[-1])
    assert found.deviation[-1] < 0.003


def test_little_excitation_is_no_evidence():
    """A loss that is certain by its standard deviation alone, and a small one."""
    value, deviation = (
        np.array([0.6, 0.88, 0.8, 1.0, 0.0]),
        np.array([0.08, 0.01, 0.01, 0.01, 0.005]),
    )
    found = Deviations(40, np.full(3, 1e-3), value, deviation, np.array([0.7, 0.1, 0.3, 0.0, 0.2]))
    health = Health(("a", "b", "c", "d"), True, found)
    assert health.known.tolist() == [False, True, True, True, False]
    assert health.findings == ("propeller c at 80 % (78 to 82 %)",)
    said = str(health)
    assert "not known: a, delay (little excitation)" in said
    assert said.endswith("shares of the error: c 30 %")
    figures = health.to_json()
    assert figures["propellers"]["a"]["known"] is False
    assert figures["propellers"]["c"]["interval_95"] == pytest.approx([0.7804, 0.8196])
    assert figures["delay"]["interval_95_s"] == pytest.approx([-0.0098, 0.0098])


@pytest.mark.slow
def test_errors_are_those_of_an_evaluation(faulty):
    """Against offline evaluation, with an encoder of its own, on a model that is wrong."""
    wrong = replace(
        MODEL, parameters=replace(MODEL.parameters, thrust=1.3 * MODEL.parameters.thrust)
    )
    error = watched(faulty, monitor=HealthMonitor(wrong, memory=100.0))[-1].found.error
    offline = evaluate(wrong, preprocess(faulty, MODEL.vehicle)).rmse
    np.testing.assert_allclose(error, offline, rtol=0.35)


def test_says_nothing_without_commands_or_at_a_rail():
    silent = HealthMonitor(MODEL, compiled=False)
    for k in range(100):
        silent.pose(k / 240, np.zeros(3))
    assert not silent.health().flying
    assert "must be in flight" in str(silent.health())
    leaning = HealthMonitor(MODEL, compiled=False)
    reach = 1.1 - MODEL.vehicle.radius_m
    for k in range(100):
        leaning.command(k / 240, np.full(6, 0.03))
        leaning.pose(k / 240, np.array([reach, 0.0, 0.0]))
    assert not leaning.health().flying
    assert np.isnan(leaning.health().to_json()["rmse_m_m_rad"]).all()


def test_what_is_not_finite_is_left_aside():
    monitor = HealthMonitor(MODEL, compiled=False)
    for k in range(20):
        monitor.command(k / 240, np.full(6, 0.03))
        monitor.pose(k / 240, np.zeros(3))
    monitor.pose(20 / 240, np.array([np.nan, 0, 0]))
    monitor.command(20 / 240, np.full(6, np.inf))
    assert monitor.health().flying


def test_deviations_of_a_linear_world():
    """With errors drawn as assumed, the estimates have the stated standard deviations."""
    random = np.random.default_rng(0)
    truth, motors = np.array([-0.12, 0.05, 0.006]), 2
    scores = []
    for _ in range(60):
        judged = []
        for k in range(60):
            slopes = random.normal(size=(6, 3)) * [1, 1, 20]
            lost = random.normal(size=(6, 4))
            noise = random.normal(size=6) * 0.1 + lost @ random.normal(size=4) * 0.05
            judged.append(Judged(0.1 * k, slopes @ truth + noise, slopes, lost @ lost.T))
        found = deviations(judged, motors, 1e3, overlap=1.0, jitter=0.05, radius=1.0)
        scores.append((found.value - [1, 1, 0] - truth) / found.deviation)
    np.testing.assert_allclose(np.std(scores, axis=0), 1.0, atol=0.2)
    np.testing.assert_allclose(np.mean(scores, axis=0), 0.0, atol=0.25)
