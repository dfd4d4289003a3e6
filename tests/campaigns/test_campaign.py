"""Whole campaigns: resumed, interrupted, from the command line; files and tables."""

import csv
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from airpuck import campaign
from airpuck.campaigns import campaign as module
from airpuck.campaigns.campaign import Campaign, read_result, statistics, write_result
from airpuck.campaigns.items import Recovery, Tracking
from airpuck.campaigns.workers import Entry, ItemResult, compute

from ..apparatus.commands import airpuck, refused

ENTRIES = tuple(
    Entry(f"key{number}", {"spread": spread, "model": ["a", "b"]}, Tracking(seed=number))
    for number, spread in enumerate((0.1, 0.1, 0.2))
)
RESULTS = (
    ItemResult(rows=({"x_m": 1.0, "y_m": math.nan}, {"x_m": 2.0, "y_m": 5.0}), wall_s=0.5),
    ItemResult(rows=(), failure="is not to be had", wall_s=0.1),
    ItemResult(rows=({"x_m": 4.0, "y_m": 1e-300},), wall_s=0.5),
)
SPEC = 'kind = "tracking"\nseeds = {seeds}\nbase.dwell_s = 0.2\n'


@pytest.fixture
def here(monkeypatch):
    """Compute in this process, and record the seeds."""
    seeds = []

    def dispatch(entries, **_):
        for entry in entries:
            seeds.append(entry.item.seed)
            yield entry, compute(entry.item)

    monkeypatch.setattr(module, "dispatch", dispatch)
    return seeds


@pytest.fixture
def spec(tmp_path):
    def written(seeds, text=SPEC):
        (tmp_path / "spec.toml").write_text(text.format(seeds=seeds))
        return tmp_path / "spec.toml"

    return written


def test_only_missing_items_are_computed(here, spec, tmp_path):
    states = []
    first = campaign(spec(2), tmp_path, progress=lambda *state: states.append(state))
    assert states == [(0, 2, 0), (1, 2, 0), (2, 2, 0)]
    again = campaign(spec(2), tmp_path)
    assert again.computed == 0
    assert "computed=0" in repr(again) and len(repr(again)) <= 400
    for one, other in zip(again.results, first.results, strict=True):
        assert one.rows[0] == pytest.approx(other.rows[0], rel=0, abs=0, nan_ok=True)
    files = sorted((tmp_path / "items").iterdir())
    content = [file.read_bytes() for file in files]
    more = campaign(spec("[1, 4, 0]"), tmp_path)
    assert (more.computed, here) == (1, [0, 1, 4])
    assert [file.read_bytes() for file in files] == content
    assert len(more.results) == 3
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 4


@pytest.mark.slow
def test_failures_are_kept_and_retried_on_request(here, spec, tmp_path):
    # 0.01 s of flight have fewer poses than an identification needs.
    text = 'kind = "recovery"\nseeds = {seeds}\nbase.duration_s = 0.02\n'
    found = campaign(spec(1, text), tmp_path)
    assert len(found.failures) == 1
    assert campaign(spec(1, text), tmp_path).computed == 0
    assert campaign(spec(1, text), tmp_path, retry=True).computed == 1
    assert found.to_json()["failures"][0]["reason"]


def test_a_campaign_with_only_failures_fails(here, spec, tmp_path):
    text = 'kind = "recovery"\nseeds = {seeds}\nbase.duration_s = 0.02\n'
    process = airpuck("campaign", spec(2, text), "-o", tmp_path, "--quiet")
    assert refused(process, "every item failed")
    assert "2 failed" in process.stdout


@pytest.mark.slow
def test_an_interrupted_campaign_resumes(here, spec, tmp_path):
    dwells = 'kind = "tracking"\nseeds = {seeds}\ngrid.dwell_s = '
    script = tmp_path / "airpuck_command.py"
    script.write_text("from airpuck.cli import main\nif __name__ == '__main__':\n    main()\n")
    # The second item takes minutes: the campaign cannot have ended before it is interrupted.
    long = spec(1, dwells + "[0.1, 1000]")
    process = subprocess.Popen(
        [sys.executable, script, "campaign", long, "-o", tmp_path / "out", "--workers", "1"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    items = tmp_path / "out" / "items"
    while not (items.exists() and list(items.glob("[!.]*.json"))):
        assert process.poll() is None
        time.sleep(0.05)
    # To the worker as well, as a terminal does.
    os.killpg(process.pid, signal.SIGINT)
    _, printed = process.communicate(timeout=180)
    assert process.returncode == 130
    assert printed.splitlines()[-1] == "airpuck: interrupted; run it again to compute the rest"
    assert "Traceback" not in printed
    (done,) = items.iterdir()
    content = done.read_bytes()
    again = campaign(spec(1, dwells + "[0.1, 0.2]"), tmp_path / "out")
    assert (again.computed, here) == (1, [0])
    assert done.read_bytes() == content
    assert len(again.results) == 2


def test_equal_items_are_computed_once(tmp_path):
    asked = []

    def work(entries, tell):
        asked.extend(entries)
        return [(entry, RESULTS[0]) for entry in entries]

    done = module.completed([ENTRIES[0], ENTRIES[0]], tmp_path, work)
    assert len(asked) == 1
    assert len(done.results) == 2


def test_written_results_round_trip(tmp_path):
    for entry, result in zip(ENTRIES, RESULTS, strict=True):
        assert read_result(tmp_path, entry.key) is None
        write_result(tmp_path, entry, result)
        found = read_result(tmp_path, entry.key)
        np.testing.assert_equal(found.model_dump(), result.model_dump())


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"rows": [3], "failure": 0, "wall_s": 0}', "\xff\0"]
)
def test_a_damaged_result_is_computed_again(tmp_path, text):
    (tmp_path / "items").mkdir()
    (tmp_path / "items" / f"{ENTRIES[0].key}.json").write_text(text, encoding="latin-1")
    done = module.completed(
        ENTRIES[:1], tmp_path, lambda entries, tell: [(entry, RESULTS[0]) for entry in entries]
    )
    assert done.computed == 1
    assert read_result(tmp_path, ENTRIES[0].key) == RESULTS[0]


def test_results_do_not_reveal_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", "/home/somebody")
    item = Recovery(truth="/home/somebody/models/a.toml", seed=3)
    write_result(tmp_path, replace(ENTRIES[0], item=item), RESULTS[0])
    text = (tmp_path / "items" / f"{ENTRIES[0].key}.json").read_text()
    assert "somebody" not in text
    assert '"truth": "~/models/a.toml"' in text


def test_statistics_match_scipy():
    values = np.random.default_rng(0).normal(size=101)
    found = statistics([*values, math.nan, math.inf])
    known = scipy.stats.describe(values)
    assert found["count"] == 101
    assert found["mean"] == pytest.approx(known.mean)
    assert found["sd"] ** 2 == pytest.approx(known.variance)
    assert (found["min"], found["max"]) == known.minmax
    assert found["q50"] == np.sort(values)[50]
    assert found["q05"] == np.sort(values)[5]


def test_each_setting_is_summarised():
    first, second = Campaign(ENTRIES, RESULTS, 0).settings
    assert [(s["items"], s["failed"]) for s in (first, second)] == [(1, 1), (1, 0)]
    assert first["figures"]["x_m"]["mean"] == 1.5
    assert first["figures"]["x_m"]["sd"] == pytest.approx(math.sqrt(0.5))
    assert (first["figures"]["y_m"]["count"], first["figures"]["y_m"]["mean"]) == (1, 5)
    assert second["figures"]["x_m"]["mean"] == 4
    assert math.isnan(second["figures"]["x_m"]["sd"])


def test_the_table_lists_every_row_and_failure(tmp_path):
    Campaign(ENTRIES, RESULTS, 0).write_table(tmp_path / "results.csv")
    with (tmp_path / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["key"], r["seed"], r["row"]) for r in rows] == [
        ("key0", "0", "0"),
        ("key0", "0", "1"),
        ("key1", "1", ""),
        ("key2", "2", "0"),
    ]
    assert [r["x_m"] for r in rows] == ["1.0", "2.0", "", "4.0"]
    assert [r["y_m"] for r in rows] == ["", "5.0", "", "1e-300"]
    assert rows[2]["failure"] == "is not to be had"
    assert rows[0]["model"] == '["a", "b"]'
