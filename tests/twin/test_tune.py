"""Tuning by flights: less error for the same effort, and margins that the linear loop confirms."""

import pytest

import airpuck
from airpuck.control.tuning import tuning_for
from airpuck.model.model_file import published_model

from ..apparatus.studies import study

M3 = published_model("M3")
LAW = """
import airpuck
class Settings(airpuck.LawSettings):
    law = "Mine"
    weight: float = 1.0
    {tuned}
class Mine(airpuck.LQR):
    Settings = Settings
    def __init__(self, model, tuning, options):
        super().__init__(model, tuning, options)
        with open("{seen}", "a") as file:
            print(tuning.of(Settings).weight, file=file)
"""


@pytest.fixture(scope="module")
def found():
    return airpuck.tune(M3, trials=16)


@pytest.mark.slow
def test_other_craft_must_follow_more_closely_with_no_more_effort(found):
    before, after = found.before, found.after
    assert after.error_m < 0.9 * before.error_m
    assert after.effort < 1.02 * before.effort
    assert before.contacts == after.contacts == 0
    weights = found.tuning.of(airpuck.LQR.Settings).weights
    assert found.changes["position"] == (8.6, weights.position) != (8.6, 8.6)
    assert found.changes["disturbance_density"][1] == found.tuning.estimation.disturbance_density


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # python-control's, of filters with delays
def test_flights_find_the_delay_margin_of_the_linear_loop(found):
    for tuning, flown in ((tuning_for(M3), found.before), (found.tuning, found.after)):
        linear = study("tuned").margins(M3, tuning)
        # Bisection is accurate to 5 ms, the linear loop to half a period.
        least = min(axis["delay_s"] for axis in linear.values())
        assert flown.delay_margin_s == pytest.approx(least, abs=0.012)
        # A disk guarantees less gain than the craft turns out to bear.
        disk = 10 ** (min(axis["gain_dB"] for axis in linear.values()) / 20)
        assert flown.thrust_margins[1] > 0.9 * disk


def users_law(folder, tuned):
    file = folder / "mine.py"
    file.write_text(LAW.format(tuned=tuned, seen=folder / "weights"))
    return tuning_for(M3).with_law(f"{file}:Mine")


def test_a_law_must_name_the_weights_that_may_change(tmp_path):
    with pytest.raises(airpuck.InputError, match="Mine' has none; name them as `tuned`"):
        airpuck.tune(M3, users_law(tmp_path, ""), trials=1)


@pytest.mark.slow
def test_trials_change_the_weight_of_a_users_law(tmp_path):
    found = airpuck.tune(M3, users_law(tmp_path, 'tuned = ("weight",)'), trials=4)
    assert set(found.changes) == {"disturbance_density", "angular_disturbance_density", "weight"}
    assert {1.0, 2.0} <= set(map(float, (tmp_path / "weights").read_text().split()))
    found.tuning.save(tmp_path / "tuning.toml")
    assert airpuck.read_tuning(tmp_path / "tuning.toml") == found.tuning


def test_no_trials_are_refused():
    with pytest.raises(airpuck.InputError, match="trials: must be from 1 to 1000"):
        airpuck.tune(M3, trials=0)
