"""The long studies of the twin, as they stand in `studies/`."""

import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from ..apparatus.studies import STUDIES, study


def flight(seed):
    return study("robustness").flown(seed)


def test_a_study_without_its_data_ends_in_one_line():
    code = "from airpuck import load_trajectory; from one_line import run; "
    code += "run(lambda: load_trajectory('nowhere') and None)"
    process = subprocess.run(
        [sys.executable, "-c", code], cwd=STUDIES, capture_output=True, text=True
    )
    assert process.returncode == 2
    assert len(process.stderr.strip().splitlines()) == 1
    texts = {script.name: script.read_text() for script in STUDIES.glob("*.py")}
    # Studies without airpuck raise no InputError and may end in any way.
    studies = {name: text for name, text in texts.items() if "\nfrom airpuck" in text}
    assert len(studies) > 10
    ends = [name for name, text in studies.items() if not text.endswith("    run(main)\n")]
    # What other studies use.
    assert sorted(ends) == ["fleet_methods.py", "one_line.py", "opponents.py"]


@pytest.mark.study
def test_over_a_bad_radio_set_points_are_reached_without_touching_a_rail():
    with ProcessPoolExecutor() as pool:
        flights = list(pool.map(flight, range(100)))
    assert all(one["reached"] for one in flights)
    assert min(one["clearance mm"] for one in flights) > 5


@pytest.mark.study
def test_the_true_parameters_are_recovered():
    recovery = study("recovery")
    truth = recovery.truth()
    plant = recovery.build_plant(truth)
    rows = [recovery.recovered(truth, plant, seed) for seed in range(20)]
    for name, bound in recovery.BOUNDS.items():
        values = np.array([row[name] for row in rows])
        # Single seeds may be a little above the limit; their mean and most of them may not.
        assert abs(values.mean()) < bound
        assert np.mean(np.abs(values) <= bound) >= 0.9


def fault_study(seed, healthy):
    return study("faults_found").flown(seed, 60.0, healthy)


@pytest.mark.study
def test_faults_are_found_and_nothing_is_excluded_from_healthy_flights(monkeypatch):
    monkeypatch.syspath_prepend(str(STUDIES))
    faulty = [fault_study(seed, False) for seed in range(10)]
    visible = [fault for one in faulty for fault in one.faults if fault[1]]
    visible = [fault for fault in visible if fault[0].cause != "contact"]
    assert np.mean([fault[2] for fault in visible]) >= 0.95
    assert sum(one.wrong for one in faulty) <= 0.05 * sum(one.told for one in faulty)
    assert max(fault_study(seed, True).lost for seed in range(10)) < 0.01
