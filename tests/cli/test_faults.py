"""`airpuck faults`, and faults in `identify`."""

import json

import numpy as np
import pytest

from airpuck import Recording, Span, Stream
from airpuck.cli.validation import listed_spans
from airpuck.craft.vehicle import default_vehicle
from airpuck.recording.bag import write_bag

from ..apparatus.commands import airpuck, ran, refused
from ..apparatus.synthetic_flights import record

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A flight whose log contains 0.4 s of commands that never arrived, and jumping poses."""
    recording = record(duration=8.0, noise=5e-5)
    command, pose = recording["command"], recording["pose"]
    said, seen = command.values.copy(), pose.values.copy()
    said[300:340] = np.array([0.9, 0.03, 0.03, 0.9, 0.9, 0.03])
    seen[1440, 0] += 0.03
    streams = {
        "command": Stream(command.stamp_ns, command.received_ns, said, command.columns),
        "pose": Stream(pose.stamp_ns, pose.received_ns, seen, pose.columns),
    }
    folder = tmp_path_factory.mktemp("bags") / "flight"
    write_bag(Recording(streams=streams, source="made up"), folder)
    return folder


def test_faults_are_printed_written_and_drawn(bag, tmp_path, undrawn):
    process = ran("faults", bag, "-o", tmp_path / "r", "--json", tmp_path / "f.json")
    assert "jumping pose" in process.stdout
    assert "without any fault" in process.stdout
    assert "left out: " in process.stdout
    figures = json.loads((tmp_path / "f.json").read_text())
    spans = {span["cause"]: span for span in figures["spans"]}
    assert spans.pop("jumping pose")["confidence"] == 1
    # 3.0 s of commands, minus those before the first effective one, and the delay.
    assert any(2.7 < span["start_s"] < 3.3 for span in spans.values())
    assert all(0 < span["confidence"] < 1 for span in spans.values())
    assert 0.9 < figures["usable"] < 1
    assert "jumping pose" in (tmp_path / "r" / "index.html").read_text()


def test_a_full_table_lists_faults_and_long_spans_first():
    gaps = [Span(k, k + 0.1, "gap") for k in range(5)]
    long_gap = Span(1.5, 1.9, "gap")
    short, stalled = Span(7.0, 7.1, "contact", 0.6), Span(2.5, 3.5, "motor_a_1 stalled", 0.9)
    spans = [*gaps, long_gap, short, stalled]
    assert listed_spans(spans, 1) == [stalled]
    assert listed_spans(spans, 3) == [long_gap, stalled, short]
    assert listed_spans(spans, 30) == sorted(spans, key=lambda span: span.start)


def test_nothing_is_fitted_if_a_model_is_given(bag):
    process = ran("faults", bag, "--model", "paper:M3", "--json", "-")
    assert json.loads(process.stdout)["model"] == "M3"


def test_identify_reports_excluded_spans(bag, tmp_path, undrawn):
    out = ("-o", tmp_path / "m.toml", "--report", tmp_path / "r", "--json", tmp_path / "f.json")
    process = airpuck("identify", bag, *out)
    # Eight seconds hardly determine the timing: the recording may count as suspect.
    outcome = json.loads((tmp_path / "f.json").read_text())["verdict"]["outcome"]
    suspect = outcome == "suspect_recording"
    assert process.returncode == (2 if suspect else 0), process.stderr
    assert "1 jump" in next(x for x in process.stdout.splitlines() if x.startswith("left out: "))
    assert json.loads((tmp_path / "f.json").read_text())["faults"]["spans"]
    assert "windows overlap a fault" in (tmp_path / "r" / "index.html").read_text()


def test_giving_both_a_model_and_a_vehicle_is_rejected(bag, tmp_path):
    vehicle = tmp_path / "v.toml"
    default_vehicle().save(vehicle)
    refused(airpuck("faults", bag, "--model", "paper:M3", "--vehicle", vehicle), "--vehicle")
