"""Injected faults are found with their causes, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck import InputError, Span, Twin, Vehicle
from airpuck.craft.vehicle import default_vehicle
from airpuck.faults.find import find_faults
from airpuck.model.model_file import nominal_model, published_model
from airpuck.physics.rigid_body import rollout
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.twin.settings import default_twin_settings

from ..apparatus.models import four_propellers, model_of, scaled
from ..apparatus.public_recordings import VALIDATION
from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), indexing="start", frame="body")


@pytest.fixture(scope="module")
def flight():
    """Without faults, with the noise of smoothed derivatives."""
    flight = fly(MODEL, duration=10.0, seed=3)
    noise = np.random.default_rng(0).normal(size=flight.state.shape)
    return replace(flight, state=flight.state + noise * [4e-5, 4e-5, 6e-4, 2e-3, 2e-3, 2e-2])


def with_log(flight, first, last, command):
    """The same motion, logged with other commands."""
    logged = flight.command.copy()
    inside = (flight.command_time >= first) & (flight.command_time < last)
    logged[inside] = np.where(np.isnan(command), logged[inside], command)
    return replace(flight, command=logged)


def test_a_healthy_flight_has_no_faults(flight):
    assert find_faults(flight, MODEL) == ()


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_slightly_wrong_model_finds_no_faults_either(flight, factor):
    assert find_faults(flight, scaled(MODEL, factor)) == ()


@pytest.mark.parametrize("motor", range(6))
def test_a_stalled_motor_is_named(flight, motor):
    # The motion is unchanged: this motor idles, although it runs according to the log.
    name = flight.propellers[motor]
    idle = np.flatnonzero(flight.command[:, motor] < 0.05)
    ends = np.flatnonzero(np.diff(idle, prepend=-9, append=10**9) > 1)
    lengths = np.diff(ends)
    longest = int(np.argmax(lengths))
    first, length = idle[ends[longest]], lengths[longest]
    begin, end = flight.command_time[first], flight.command_time[first + length - 1]
    end = min(end, begin + 0.3)
    assert end - begin >= 0.15
    command = np.full(6, np.nan)
    command[motor] = 0.9
    (fault,) = find_faults(with_log(flight, begin, end, command), MODEL)
    assert fault.cause == f"{name} stalled"
    assert fault.start == pytest.approx(begin, abs=0.06)
    assert fault.stop == pytest.approx(end, abs=0.09)
    assert fault.confidence > 0.8


#: Three propellers in one place, and others around them [mm, degrees].
ALIKE = [((45, 0), 180)] * 3 + [((-45, 15), 30), ((-45, -15), 330), ((0, 45), 270), ((0, -45), 90)]


@pytest.mark.parametrize("motor", range(3))
def test_a_stall_of_one_of_three_equal_propellers_has_confidence_one_third(motor):
    """Nothing tells which of them stands: no cause is more probable than not."""
    propellers = [
        {"name": f"p{k}", "position_m": (x / 1e3, y / 1e3), "direction_deg": angle}
        for k, ((x, y), angle) in enumerate(ALIKE)
    ]
    known = default_vehicle().model_dump() | {"propellers": propellers, "pairs": ()}
    model = nominal_model(Vehicle.model_validate(known))
    flight = fly(model, 6.0, seed=3)
    logged, time = flight.command.copy(), flight.time
    logged[(time >= 2.5) & (time < 3.7), :3] = 0.9
    heard = logged.copy()
    heard[(time >= 3.0) & (time < 3.5), motor] = 0.0
    first = np.concatenate([flight.state[0], flight.command[0]])[:, None]
    flown = rollout(np, model.dynamics, first, heard[:-1, :, None], np.diff(time)[:, None])
    state = np.concatenate([first.T, flown[..., 0]])[:, :6]
    noise = np.random.default_rng(0).normal(size=state.shape)
    state += noise * [4e-5, 4e-5, 6e-4, 2e-3, 2e-3, 2e-2]
    (fault,) = find_faults(replace(flight, state=state, command=logged), model)
    assert fault.cause in {"p0 stalled", "p1 stalled", "p2 stalled"}
    assert (fault.start, fault.stop) == pytest.approx((3.0, 3.5), abs=0.06)
    assert fault.confidence == pytest.approx(1 / 3, abs=0.01)


def test_hitting_a_rail_is_not_a_motor_fault():
    """A craft that drifts into a rail while it pushes along it."""
    settings = default_twin_settings()
    twin = Twin(MODEL, settings, seed=0, pose=(0.8, 0.0, 0.0))
    rng = np.random.default_rng(1)
    thrust = np.where(MODEL.dynamics.configuration[0] > 0, 0.5, 0.03)
    for k in range(300):
        if k % 10 == 0:
            command = np.clip(thrust + rng.uniform(-0.2, 0.2, 6), 0.03, 1)
        twin.wait_until(0.01 * k)
        twin.send(command)
    trajectory = preprocess(twin.recording(), delay=settings.radio.delay_s or 0.0208)
    met = [t for t in twin.contacts if t < 2.9]
    assert met
    found = find_faults(trajectory, MODEL)
    assert {span.cause for span in found} == {"contact"}
    begin = -trajectory.command_time[0]
    for time in met[:1]:
        assert any(s.start - 0.05 <= time - begin <= s.stop + 0.05 for s in found)


def test_excluded_spans_are_not_searched(flight):
    faulty = with_log(flight, 4.0, 4.5, np.array([0.9, 0.03, 0.9, 0.03, 0.9, 0.03]))
    assert find_faults(faulty, MODEL)
    known = faulty.leave_out([Span(3.9, 4.7, "known")])
    assert find_faults(known, MODEL) == ()


def test_too_short_a_recording_has_no_findings(flight):
    assert find_faults(flight.slice(0, 0.02), MODEL) == ()


def test_a_model_of_another_craft_is_rejected(flight):
    with pytest.raises(InputError, match="4 "):
        find_faults(flight, model_of(four_propellers(), "M3"))


@pytest.mark.data
def test_known_faults_of_the_real_flight_are_found(experiments):
    """The obvious faults of the recording are found with the published parameters."""
    trajectory = read_authors_experiment(experiments / VALIDATION / "data.pt")
    found = find_faults(trajectory, published_model("M3"))
    known = [
        ("not armed", 0.0, 2.2),
        ("", 28.25, 28.8),
        ("radio out", 58.1, 58.7),
        ("", 88.3, 88.6),
        ("motor_b_1 stalled", 30.1, 30.25),
        ("motor_a_1 stalled", 60.2, 60.6),
    ]
    for cause, start, stop in known:
        spans = [s for s in found if s.start <= stop and s.stop >= start and cause in s.cause]
        marked = sum(min(s.stop, stop) - max(s.start, start) for s in spans[:1])
        assert marked >= 0.6 * (stop - start), (cause, start)
    assert sum(span.stop - span.start for span in found) < 0.08 * trajectory.duration
