"""Findings: their order, and what they say."""

from airpuck.boundary.finding import Finding, by_cause

LATE = Finding("clock", "The poses are stamped late", "80 ms", "Synchronise the clocks.")
WEAK = Finding("actuator", "m4 is weak", "84 ± 0.5 % of the others")


def test_causes_come_before_what_they_cause():
    drag = Finding("physics", "The model lacks drag")
    assert by_cause([drag, WEAK, LATE, WEAK]) == (LATE, WEAK, drag)


def test_only_errors_of_the_recording_make_it_suspect():
    assert LATE.suspect and not WEAK.suspect


def test_a_finding_is_a_sentence_and_four_fields():
    assert LATE.sentence == "The poses are stamped late (80 ms). Synchronise the clocks."
    assert WEAK.sentence == "m4 is weak (84 ± 0.5 % of the others)."
    assert LATE.to_json() == {
        "kind": "clock",
        "cause": "The poses are stamped late",
        "evidence": "80 ms",
        "remedy": "Synchronise the clocks.",
    }
