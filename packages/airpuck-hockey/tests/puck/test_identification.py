"""A puck identified from its poses, against pucks with known numbers."""

import math
import re

import numpy as np
import pytest

from airpuck import AirHockey, InputError, PuckState, Recording, Stream, Table, Twin
from airpuck.craft.table import Contact, Puck
from airpuck.model.model_file import published_model
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.recording.stream import COLUMNS
from airpuck_hockey.puck.flights import find_flights, noise_of
from airpuck_hockey.puck.identification import identify_puck, value_of
from tests.apparatus.changes import changed

TRUTH = Puck(
    drag_1_s=0.13,
    spin_drag_1_s=0.3,
    rail=Contact(restitution=0.7, grip=0.7, friction=0.15),
)
NOISE = np.array([5e-5, 5e-5, 7e-4])


def stream(time, poses):
    stamp = (np.asarray(time) * 1e9).astype(np.int64) + 10**18
    return Stream(stamp, stamp, np.array(poses), COLUMNS["puck"])


def shot(rng):
    place, way = rng.uniform(-0.3, 0.3, 2).tolist(), rng.normal(0, 2.5, 2).tolist()
    return PuckState(*place, 0.0, *way, float(rng.normal(0, 15)))


def recorded(truth, seed, seconds=20.0, *, scatter=0.0, dropped=0.02, wrong=0.0, spins=True):
    """A puck that is shot every two seconds; the restitution of its rails may vary."""
    rng = np.random.default_rng(seed)
    puck, time, poses = PuckOnTable(AirHockey(puck=truth), shot(rng)), [], []
    touches = 0
    for k in range(1, round(seconds * 240)):
        t = k / 240
        puck.run(t)
        if scatter and len(puck.touches) > touches:
            touches = len(puck.touches)
            rail = {"restitution": truth.rail.restitution + scatter * rng.normal()}
            other = AirHockey(puck=changed(truth, rail=rail))
            puck = PuckOnTable(other, puck.state, t)
            touches = 0
        if puck.goal or k % 480 == 0:
            puck.place(shot(rng))
        if rng.random() < dropped:
            continue
        pose = np.array(puck.state[:3]) * ([1, 1, 1] if spins else [1, 1, 0])
        pose = pose + NOISE * rng.normal(size=3)
        if rng.random() < wrong:
            pose[:2] += rng.normal(0, 0.1, 2)
        pose[2] = math.remainder(pose[2], 2 * math.pi)
        time.append(t)
        poses.append(pose)
    return Recording({"puck": stream(time, poses)}, "made up")


def normalised(fit, truth):
    puck = fit.play.puck
    return {
        name: (value_of(puck, name) - value_of(truth, name)) / error
        for name, error in puck.standard_error.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.study) for s in (1, 2))])
def test_every_parameter_is_found_within_its_standard_error(seed):
    fit = identify_puck(recorded(TRUTH, seed))
    off = normalised(fit, TRUTH)
    assert set(off) == {
        "drag_1_s",
        "spin_drag_1_s",
        "rail.restitution",
        "rail.grip",
        "rail.friction",
    }
    assert max(map(abs, off.values())) < 4
    errors = fit.play.puck.standard_error
    assert errors["drag_1_s"] < 1e-3
    assert errors["rail.restitution"] < 0.01
    assert errors["rail.grip"] < 0.05
    assert fit.noise_m == pytest.approx(5e-5, rel=0.1)
    assert fit.bounces["rail"] > 10


@pytest.mark.slow
def test_standard_errors_include_the_scatter_of_bounces():
    # Restitution scatters by 0.03 from bounce to bounce: its mean is known to 0.03/√n, no better.
    fits = [identify_puck(recorded(TRUTH, seed, scatter=0.03)) for seed in range(2)]
    for fit in fits:
        error = fit.play.puck.standard_error["rail.restitution"]
        expected = 0.03 / math.sqrt(fit.bounces["rail"])
        assert 0.4 * expected < error < 2.5 * expected
    off = [normalised(fit, TRUTH)["rail.restitution"] for fit in fits]
    assert max(map(abs, off)) < 3.5


def test_outlier_frames_and_a_puck_without_markers_do_no_harm():
    fit = identify_puck(recorded(TRUTH, 7, dropped=0.1, wrong=0.005, spins=False))
    assert "spin_drag_1_s" not in fit.play.puck.standard_error
    assert any("spin" in note for note in fit.notes)
    puck = fit.play.puck
    assert puck.drag_1_s == pytest.approx(0.13, abs=0.005)
    assert puck.rail.restitution == pytest.approx(0.7, abs=0.02)


@pytest.mark.slow
def test_several_recordings_are_combined():
    parts = [recorded(TRUTH, seed, 10.0) for seed in (1, 2)]
    one, both = identify_puck(parts[0]), identify_puck(parts)
    assert both.flights > one.flights
    assert both.bounces["rail"] > one.bounces["rail"]
    assert both.play.puck.standard_error["drag_1_s"] < one.play.puck.standard_error["drag_1_s"]


@pytest.mark.slow
def test_misplaced_rails_are_reported():
    wider = AirHockey(table=Table(length_m=2.2 - 0.012, width_m=1.1 - 0.012))
    fit = identify_puck(recorded(TRUTH, 3), wider)
    assert any("rails are 6 mm farther out" in note for note in fit.notes)
    assert fit.play.puck.rail.restitution == pytest.approx(0.7, abs=0.01)


@pytest.mark.slow
def test_mallet_and_craft_contacts_are_identified():
    twin = Twin(published_model("M3"), puck=PuckState(0.4, 0, 0, -3, 0.4), mallet=(0.8, 0), seed=2)
    assert twin.play is not None
    puck, hand, rng = twin.play.puck, twin.play.mallet, np.random.default_rng(0)
    for k in range(1500):
        twin.wait_until(0.01 * k)
        hand.target = (0.7, puck.state.y) if puck.state.vx > 0 else (0.9, 0.0)
        if puck.goal or k % 100 == 99:
            start = -0.2 if k % 200 == 99 else 0.3
            speed = 3.0 if start > 0 else 2.0
            aim = twin.state[:2] - [start, 0] if start > 0 else hand.target
            way = speed * np.array([np.sign(-start if start > 0 else 1), 0.0])
            way[1] = speed * aim[1] / abs(aim[0]) if start > 0 else 0.0
            if start > 0:
                way[0] = -speed
            puck.place(PuckState(start, float(rng.normal(0, 0.02)), 0.0, *way.tolist()))
    fit = identify_puck(twin.recording(), twin.settings)
    for name in ("mallet", "craft"):
        assert fit.bounces[name] >= 3, fit.bounces
        law, error = getattr(fit.play.puck, name), fit.play.puck.standard_error
        assert law.restitution == pytest.approx(0.8, abs=0.02 + 3 * error[f"{name}.restitution"])
    # The settings remain the twin's.
    assert type(fit.play) is type(twin.settings)


def test_flights_end_where_the_puck_bounces():
    truth, time = PuckOnTable(AirHockey(), PuckState(0, 0, 0, 3.0, 2.0)), np.arange(1, 600) / 240
    poses, rng = [], np.random.default_rng(0)
    for t in time.tolist():
        truth.run(t)
        poses.append(np.array(truth.state[:3]) + NOISE * rng.normal(size=3))
    pose, bounces = np.array(poses), [t.time for t in truth.touches]
    flights = find_flights(time, pose, noise_of(time, pose), 0.2)
    assert len(flights) == len(bounces) + 1
    for flight in flights:
        assert not [b for b in bounces if flight.time[0] < b < flight.time[-1]]
    assert sum(len(f.time) for f in flights) > 0.95 * len(time)


def test_a_recording_without_a_moving_puck_is_rejected():
    time = np.arange(500) / 240
    still = np.zeros((500, 3)) + NOISE * np.random.default_rng(0).normal(size=(500, 3))
    with pytest.raises(InputError, match="barely moves"):
        identify_puck(Recording({"puck": stream(time, still)}, "still"))
    with pytest.raises(InputError, match="barely moves"):
        identify_puck(Recording({"puck": stream(time[:5], still[:5])}, "short"))
    with pytest.raises(InputError, match=r'puck.position: .* puck = {units = \["mm"\]}'):
        identify_puck(Recording({"puck": stream(time, 1e3 * still + 900.0)}, "millimetres"))
    with pytest.raises(InputError, match="no puck stream"):
        identify_puck(Recording({"pose": stream(time, still)}, "none"))


def test_positions_alone_determine_drag_and_restitution():
    # A camera: 120 Hz, 0.5 mm, frames repeated, two seconds hidden, and no angle.
    seen, rng = recorded(TRUTH, 5, 30.0), np.random.default_rng(5)
    poses, times = seen["puck"].values[::2].copy(), seen["puck"].stamp_ns[::2] / 1e9
    poses[:, :2] += 5e-4 * rng.normal(size=(len(poses), 2))
    repeats = np.flatnonzero(rng.random(len(poses)) < 0.03)
    for row in repeats[repeats > 0]:
        poses[row] = poses[row - 1]
    hidden = (times > times[0] + 10) & (times < times[0] + 12)
    poses[hidden] = poses[np.argmax(hidden)]
    poses[:, 2] = np.nan
    fit = identify_puck(Recording({"puck": stream(times - times[0], poses)}, "a camera"))
    errors = fit.play.puck.standard_error
    assert set(errors) == {"drag_1_s", "rail.restitution"}
    assert max(map(abs, normalised(fit, TRUTH).values())) < 4
    assert errors["drag_1_s"] < 0.01
    assert errors["rail.restitution"] < 0.02
    assert any("no angle was recorded" in note for note in fit.notes)


def test_a_different_table_is_reported_with_size_and_centre():
    seen = recorded(TRUTH, 6)["puck"]
    moved = seen.values + np.array([1.1, 0.55, 0.0])
    fit = identify_puck(
        Recording({"puck": Stream(seen.stamp_ns, seen.received_ns, moved, COLUMNS["puck"])}, "")
    )
    (note,) = (note for note in fit.notes if "no bounce is near a rail" in note)
    length, width = map(float, re.findall(r"about ([\d.]+) by ([\d.]+) m", note)[0])
    assert (length, width) == pytest.approx((2.2, 1.1), abs=0.02)
    centre = [float(number) for number in re.findall(r"origin_m = \[([\d.]+), ([\d.]+)\]", note)[0]]
    assert centre == pytest.approx([1.1, 0.55], abs=0.01)


def test_the_scatter_of_bounces_is_estimated():
    fits = [identify_puck(recorded(TRUTH, 2, 40.0, scatter=s)) for s in (0.0, 0.05)]
    assert fits[0].rail_scatter < 0.01
    assert fits[1].rail_scatter == pytest.approx(0.05, rel=0.5)
    assert len(fits[1].rail_speed_m_s) == len(fits[1].rail_ratio) >= fits[1].bounces["rail"]
