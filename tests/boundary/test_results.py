"""Results declare their figures once, and JSON contains only values that JSON can represent."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from airpuck.boundary.results import Finding, Result, by_cause, plain

LATE = Finding("clock", "The poses are stamped late", "80 ms", "Synchronise the clocks.")
WEAK = Finding("actuator", "m4 is weak", "84 ± 0.5 % of the others")


def test_causes_come_before_their_consequences():
    drag = Finding("physics", "The model lacks drag")
    assert by_cause([drag, WEAK, LATE, WEAK]) == (LATE, WEAK, drag)


def test_only_errors_of_the_recording_make_it_suspect():
    assert LATE.suspect and not WEAK.suspect


def test_a_finding_is_a_sentence_with_four_fields():
    assert LATE.sentence == "The poses are stamped late (80 ms). Synchronise the clocks."
    assert WEAK.sentence == "m4 is weak (84 ± 0.5 % of the others)."
    assert LATE.to_json() == {
        "kind": "clock",
        "cause": "The poses are stamped late",
        "evidence": "80 ms",
        "remedy": "Synchronise the clocks.",
    }


@dataclass(frozen=True)
class Inner:
    number: int


@dataclass(frozen=True, eq=False)
class Outer(Result):
    JSON = "loss delay_s=model.delay rmse:x_m,y_m parts kept missing"

    loss: float
    model: SimpleNamespace
    rmse: np.ndarray | None
    parts: tuple[Inner, ...]
    hidden: np.ndarray

    @property
    def kept(self) -> np.bool_:
        return np.bool_(True)

    @property
    def missing(self) -> np.ndarray:
        return np.array([[1.0, np.nan], [-np.inf, 2.0]])


def test_figures_match_their_declaration_and_are_valid_json():
    outer = Outer(0.5, SimpleNamespace(delay=np.float64(0.02)), np.ones(2), (Inner(3),), np.ones(9))
    figures = outer.to_json()
    assert figures == {
        "loss": 0.5,
        "delay_s": 0.02,
        "rmse": {"x_m": 1.0, "y_m": 1.0},
        "parts": [{"number": 3}],
        "kept": True,
        "missing": [[1.0, None], [None, 2.0]],
    }
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures


def test_unknown_values_stay_none_and_results_nest():
    outer = Outer(np.nan, SimpleNamespace(delay=1), None, (), np.ones(1))
    written = plain({"outer": [outer]})["outer"][0]
    assert written["loss"] is None
    assert written["rmse"] is None


def test_the_short_form_of_a_result_has_units_counts_and_ellipses():
    @dataclass(frozen=True)
    class Found(Result):
        JSON = "delay_s=delay errors facts words"
        delay: float
        errors: np.ndarray
        facts: tuple[str, ...] = ("short",)
        words: str = "word " * 20

    shown = repr(Found(0.0208333, np.zeros((400, 3))))
    errors = "errors=400×3 values from 0 to 0"
    assert shown.startswith(f"Found(delay_s=0.02083, {errors}, facts=['short'], words='word")
    assert len(shown) <= 400
    many = repr(Found(np.nan, np.ones(3), tuple("abcdefghijkl"), "word " * 200))
    assert "errors=[1, 1, 1], facts=['a', 'b'" in many and "12 in all]" in many
    assert many.endswith("word…)") and len(many) <= 400
