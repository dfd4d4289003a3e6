"""The monitor beside flights of the twin whose faults are known."""

import numpy as np
import pytest

from airpuck import Recording, SetPoints, TwinSettings
from airpuck.deviation.significance import ModelError
from airpuck.evaluation.evaluate import evaluate
from airpuck.flight.health import Health, HealthMonitor, Judged, deviations
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Motors, Weakness, default_twin_settings

from ..apparatus.models import scaled

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
    return track(MODEL, set_points, duration, seed=seed, settings=settings, plant=plant).recording


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
def test_a_healthy_craft_raises_no_alarm(plant):
    healthy = flown(plant, default_twin_settings(), HEALTHY, seed=2)
    told = watched(healthy, 3.0, 4.0, monitor=HealthMonitor(MODEL))
    assert told[-1].predictions > 40
    for health in told:
        assert health.flying
        assert health.findings == ()
        assert "agree with the model" in str(health)
    assert told[-1].failed_starts == ()


@pytest.mark.slow
def test_a_weakening_propeller_and_a_longer_delay_are_named(faulty):
    before, after = watched(faulty, FAULT, monitor=HealthMonitor(MODEL))
    assert not set(before.names) & set(NAMES)
    assert set(after.names) == {WEAK, "delay"}
    assert after.findings[0].startswith("commands act ") and " later than " in after.findings[0]
    assert after.findings[1].startswith(f"{WEAK} gives ")
    errors = {error.name: error for error in after.errors}
    of_motor, of_delay = errors[WEAK], errors["delay"]
    assert of_motor.value == pytest.approx(SHARE - 1, abs=3 * of_motor.standard_error)
    assert of_motor.standard_error < 0.03
    assert max(after.errors[1:], key=lambda one: one.share).name == WEAK
    assert of_delay.value == pytest.approx(DELAY, abs=3 * of_delay.standard_error)
    assert of_delay.standard_error < 0.003


def test_little_excitation_is_not_evidence():
    """A loss that would be certain without its standard error, and a small one."""
    errors = (
        ModelError("delay", 0.0, 0.005, 0.005, False, 1.0, 0.2),
        ModelError("a", -0.4, 0.08, 0.05, False, 1.0, 0.7),
        ModelError("b", -0.06, 0.01, 0.05, True, 0.2, 0.1),
        ModelError("c", -0.2, 0.01, 0.05, True, 1e-9, 0.3),
    )
    health = Health(True, 40, np.full(3, 1e-3), errors, ("a", "c"))
    assert health.findings == ("c gives 20.0 % ± 1.0 % less than modelled",)
    said = str(health)
    assert "not known: delay, a (little excitation)" in said
    assert said.endswith("shares of the error: c 30 %; did not start: a, c")
    figures = health.to_json()
    assert figures["failed_starts"] == ["a", "c"]
    assert figures["propellers"]["a"]["known"] is False
    assert figures["propellers"]["c"]["interval_95"] == pytest.approx([0.7804, 0.8196])
    assert figures["delay"]["interval_95_s"] == pytest.approx([-0.0098, 0.0098])


@pytest.mark.slow
def test_errors_match_an_offline_evaluation(faulty):
    """Against offline evaluation, with an encoder of its own, on a model that is wrong."""
    wrong = scaled(MODEL, 1.3)
    error = watched(faulty, monitor=HealthMonitor(wrong, memory=100.0))[-1].error
    offline = evaluate(wrong, preprocess(faulty, MODEL.vehicle)).rmse
    np.testing.assert_allclose(error, offline, rtol=0.35)


def test_without_commands_or_at_a_rail_there_is_no_verdict():
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


def test_non_finite_inputs_are_ignored():
    monitor = HealthMonitor(MODEL, compiled=False)
    for k in range(20):
        monitor.command(k / 240, np.full(6, 0.03))
        monitor.pose(k / 240, np.zeros(3))
    monitor.pose(20 / 240, np.array([np.nan, 0, 0]))
    monitor.command(20 / 240, np.full(6, np.inf))
    assert monitor.health().flying


def test_deviations_are_correct_in_a_linear_world():
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
        _, value, deviation, _ = deviations(
            judged, motors, 1e3, overlap=1.0, jitter=0.05, radius=1.0
        )
        scores.append((value - truth) / deviation)
    np.testing.assert_allclose(np.std(scores, axis=0), 1.0, atol=0.2)
    np.testing.assert_allclose(np.mean(scores, axis=0), 0.0, atol=0.25)
