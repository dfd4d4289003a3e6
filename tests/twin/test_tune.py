"""Tuning by flights: less error for the same effort, and margins that the linear loop confirms."""

import json

import pytest

import airpuck
from airpuck.control.tuning import tuning_for
from airpuck.model.model_file import published_model

from ..apparatus.commands import airpuck as command
from ..apparatus.commands import ran, refused
from ..apparatus.fewer_flights import fly_less
from ..apparatus.studies import study

M3 = published_model("M3")
LAW = """
import airpuck
from airpuck.boundary.files import Section
class Gains(Section):
    weight: float = 1.0
class Settings(airpuck.LawSettings):
    law = "Mine"
    inner: Gains = Gains()
    outer: Gains = Gains()
    {tuned}
class Mine(airpuck.LQR):
    Settings = Settings
    def __init__(self, model, tuning, options):
        super().__init__(model, tuning, options)
        own = tuning.of(Settings)
        with open("{seen}", "a") as file:
            print(own.inner.weight, own.outer.weight, file=file)
"""


@pytest.fixture(scope="module")
def found():
    with pytest.MonkeyPatch.context() as monkeypatch:
        fly_less(monkeypatch, held_out=3, halvings=5)
        return airpuck.tune(M3, trials=16)


@pytest.mark.slow
def test_tuning_follows_other_craft_more_closely_with_no_more_effort(found):
    before, after = found.before, found.after
    assert after.error_m < 0.9 * before.error_m
    assert after.effort < 1.02 * before.effort
    assert before.contacts == after.contacts == 0
    weights = found.tuning.of(airpuck.LQR.Settings).weights
    assert found.changes["weights.position"] == (8.6, weights.position) != (8.6, 8.6)
    assert found.trials == 16
    assert found.changes["disturbance_density"][1] == found.tuning.estimation.disturbance_density


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # python-control's, of filters with delays
def test_flown_delay_margins_match_the_linear_loop(found):
    for tuning, flown in ((tuning_for(M3), found.before), (found.tuning, found.after)):
        linear = study("tuned").margins(M3, tuning)
        # Bisection is accurate to 5 ms, the linear loop to half a period.
        least = min(axis["delay_s"] for axis in linear.values())
        assert flown.delay_margin_s == pytest.approx(least, abs=0.012)
        # A disk guarantees less gain than the craft turns out to bear.
        disk = 10 ** (min(axis["gain_dB"] for axis in linear.values()) / 20)
        assert flown.thrust_margins[1] > 0.9 * disk


def users_law(folder, tuned, table=""):
    file, tuning = folder / "mine.py", folder / "start.toml"
    file.write_text(LAW.format(tuned=tuned, seen=folder / "weights"))
    kind = f"{file}:Mine"
    tuning.write_text(f'law.kind = "{kind}"\n{table.format(kind=kind)}')
    return airpuck.read_tuning(tuning, M3)


@pytest.mark.parametrize(
    ("tuned", "said"),
    [
        ("", "law: .*Mine' has no weights to tune; choose lqr, mpc, or a law of your own"),
        ('tuned = ("inner.wait",)', "Settings.tuned: must be names .* no attribute 'wait'"),
        ('tuned = ("inner",)', "Settings.tuned: must be names of its numbers"),
        ('tuned = "inner.weight"', "Settings.tuned: must be names of its numbers"),
    ],
)
def test_a_law_must_name_its_tunable_numbers(tmp_path, tuned, said):
    with pytest.raises(airpuck.InputError, match=said):
        airpuck.tune(M3, users_law(tmp_path, tuned), trials=1)


def test_tuning_needs_a_trial_and_a_positive_number(tmp_path):
    with pytest.raises(airpuck.InputError, match="trials: must be from 1 to 1000"):
        airpuck.tune(M3, trials=0)
    (tmp_path / "mine.py").write_text(
        LAW.format(tuned='tuned = ("inner.weight",)', seen="").replace("= 1.0", "= 0.0")
    )
    start = tuning_for(M3).with_law(f"{tmp_path}/mine.py:Mine")
    off = {"disturbance_density": 0.0, "angular_disturbance_density": 0.0}
    start = start.model_copy(update={"estimation": start.estimation.model_copy(update=off)})
    with pytest.raises(airpuck.InputError, match="tuning: every number that may be tuned is zero"):
        airpuck.tune(M3, start, trials=1)


@pytest.mark.slow
def test_trials_change_the_weights_of_a_user_law_where_its_file_has_them(tmp_path, monkeypatch):
    fly_less(monkeypatch)
    (tmp_path / "sub").mkdir()
    # The table may name the law by another path to the same file.
    table = f'[law."{tmp_path}/sub/../mine.py:Mine".inner]\nweight = 3.0'
    start = users_law(tmp_path, 'tuned = ("inner.weight", "outer.weight")', table)
    found = airpuck.tune(M3, start, trials=5)
    assert list(found.changes)[2:] == ["inner.weight", "outer.weight"]
    seen = {
        tuple(map(float, line.split())) for line in (tmp_path / "weights").read_text().splitlines()
    }
    assert {(3.0, 1.0), (6.0, 1.0), (3.0, 2.0)} <= seen
    found.tuning.save(tmp_path / "tuning.toml")
    assert airpuck.read_tuning(tmp_path / "tuning.toml") == found.tuning


@pytest.mark.slow
def test_the_command_writes_a_tuning_that_others_can_read(tmp_path, monkeypatch):
    fly_less(monkeypatch)
    out, figures = tmp_path / "tuning.toml", tmp_path / "tuned.json"
    said = ran("tune", "paper:M3", "-o", out, "--trials", 1, "--json", figures)
    found = json.loads(figures.read_text())
    # One trial is the start itself.
    assert found["before"] == found["after"]
    assert found["changes"]["weights.yaw"] == [24.0, 24.0]
    assert airpuck.read_tuning(out, M3) == tuning_for(M3)
    assert "warning: the error of craft that no trial flew did not fall" in said.stderr
    assert f"{1e3 * found['after']['error_m']:.3g}" in said.stdout


def test_a_law_without_weights_is_rejected_naming_the_option(tmp_path):
    tried = command("tune", "paper:M3", "--law", "plan", "-o", tmp_path / "tuning.toml")
    assert refused(tried, "law: 'plan' has no weights to tune; choose lqr, mpc")
    assert not any(tmp_path.iterdir())
