"""What a fit says about its parameters and its data."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from airpuck.identification.fit_result import Fit, outcome_words
from airpuck.identification.method import Iteration
from airpuck.model.model_file import published_model

from ..apparatus.beliefs import believed
from ..apparatus.synthetic_flights import fly

MODEL = published_model("M3")
LABELS = MODEL.parameters.labels(MODEL.vehicle.propeller_names)


def fit(model=MODEL, trajectories=()) -> Fit:
    """A fit of some trajectories."""
    objective = SimpleNamespace(windows=SimpleNamespace(trajectories=trajectories))
    return Fit(
        model, 1.0, (Iteration(3, 1.0),), True, "", 1, 0.0, (), objective=cast(Any, objective)
    )


def test_a_parameter_is_identified_only_if_no_open_direction_contains_it():
    first, second = np.flatnonzero(MODEL.free)[:2]
    lost = np.eye(len(MODEL.free))[[first, second]]
    values = fit(believed(MODEL, 0.01 * MODEL.free, lost=lost)).to_json()["values"]
    expected = MODEL.free.copy()
    expected[[first, second]] = False
    assert [values[label]["identified"] for label in LABELS] == expected.tolist()


def test_exclusions_are_listed_per_recording():
    flight = fly(MODEL, 1.0)
    other = replace(flight, source="/data/monday.bag")
    (alone,) = (text for text in outcome_words(fit(trajectories=(other,))) if "left out" in text)
    assert alone == "left out: nothing"
    both = [text for text in outcome_words(fit(trajectories=(flight, other))) if "left out" in text]
    assert both == ["synthetic flight 0: left out: nothing", "monday.bag: left out: nothing"]
