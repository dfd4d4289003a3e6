"""The plan of an excitation experiment as a file."""

import pytest

from airpuck.boundary.errors import InputError
from airpuck.control.excitation_plan import ExcitationPlan, read_excitation_plan


@pytest.mark.parametrize("amplitude", [0.7, (0.1 + 0.2, 0.0, 1.0)])
def test_a_plan_reads_back_as_it_was(tmp_path, amplitude):
    plan = ExcitationPlan(amplitude=amplitude, hold_s=1 / 3, duration_s=60.0, margin_m=0.1)
    plan.save(tmp_path / "plan.toml")
    assert read_excitation_plan(tmp_path / "plan.toml") == plan


def test_what_is_left_out_is_the_papers(tmp_path):
    (tmp_path / "plan.toml").write_text("hold_s = 0.1\n")
    plan = read_excitation_plan(tmp_path / "plan.toml")
    assert plan == ExcitationPlan(amplitude=1.0, hold_s=0.1, duration_s=90.0, margin_m=0.05)


@pytest.mark.parametrize(
    ("text", "field"),
    [("amplitude = 1.5", "amplitude"), ("hold_s = 0", "hold_s"), ("pause_s = 1", "pause_s")],
)
def test_a_wrong_plan_is_refused_by_field(tmp_path, text, field):
    (tmp_path / "plan.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_excitation_plan(tmp_path / "plan.toml")
    assert caught.value.field.startswith(field)
    assert "plan.toml" in str(caught.value)
