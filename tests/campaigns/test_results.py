"""Files and tables of results."""

import csv
import math

import numpy as np
import pytest
import scipy.stats

from airpuck import InputError
from airpuck.campaigns.fleet import Fleet
from airpuck.campaigns.item import Entry
from airpuck.campaigns.results import Result, Store, statistics, summarise, write_table

ENTRIES = [
    Entry(f"key{number}", {"spread": spread, "model": ["a", "b"]}, Fleet(seed=number))
    for number, spread in enumerate((0.1, 0.1, 0.2))
]
RESULTS = [
    Result(({"x_m": 1.0, "y_m": math.nan}, {"x_m": 2.0, "y_m": 5.0}), wall_s=0.5),
    Result((), "is not to be had", 0.1),
    Result(({"x_m": 4.0, "y_m": 1e-300},), wall_s=0.5),
]


def test_what_is_written_reads_back(tmp_path):
    store = Store(tmp_path)
    for entry, result in zip(ENTRIES, RESULTS, strict=True):
        assert store.read(entry.key) is None
        store.write(entry, result)
        np.testing.assert_equal(store.read(entry.key), result)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"rows": [3], "failure": 0, "wall_s": 0}'])
def test_a_file_of_somebody_else_is_refused(tmp_path, text):
    (tmp_path / "items").mkdir()
    (tmp_path / "items" / "key0.json").write_text(text)
    with pytest.raises(InputError, match=r"key0\.json: is no result"):
        Store(tmp_path).read("key0")


def test_statistics_against_scipy():
    values = np.random.default_rng(0).normal(size=101)
    found = statistics(np.append(values, [math.nan, math.inf]))
    known = scipy.stats.describe(values)
    assert found["count"] == 101
    assert found["mean"] == pytest.approx(known.mean)
    assert found["sd"] ** 2 == pytest.approx(known.variance)
    assert (found["min"], found["max"]) == known.minmax
    assert found["q50"] == np.sort(values)[50]
    assert found["q05"] == np.sort(values)[5]


def test_summary_of_each_setting():
    first, second = summarise(ENTRIES, RESULTS)
    assert (first.items, first.failed, second.items, second.failed) == (1, 1, 1, 0)
    assert first.figures["x_m"]["mean"] == 1.5
    assert first.figures["x_m"]["sd"] == pytest.approx(math.sqrt(0.5))
    assert (first.figures["y_m"]["count"], first.figures["y_m"]["mean"]) == (1, 5)
    assert second.figures["x_m"]["mean"] == 4
    assert math.isnan(second.figures["x_m"]["sd"])


def test_the_table_has_every_row_and_every_failure(tmp_path):
    write_table(tmp_path / "results.csv", ENTRIES, RESULTS)
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
