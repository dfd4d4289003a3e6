"""Selection chooses the rung of the craft that flew, and does not learn from held-out data."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.data.windows import make_windows
from airpuck.identification.objective import PredictionLoss

# No result shows which windows are held out, so the test reads them from the implementation.
from airpuck.identification.selection import CandidateModel, _HeldOut, select_model
from airpuck.identification.settings import Loss, Preparation
from airpuck.model.model_file import published_model, read_model
from airpuck.model.rungs import named_rung
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Effects, Radio, default_twin_settings

TRUTH = replace(published_model("M3"), frame="body", indexing="start")
#: As much inflow, pair interaction and drag as in the real flights.
RICH = Effects(
    drag_linear_1_s=0.3,
    drag_quadratic_1_m=0.2,
    spin_drag_linear_1_s=0.5,
    inflow_s_m=0.2,
    pair_interaction_1_N=20.0,
)
#: These flights have no faults.
KEEP_FAULTS = Preparation(faults="keep")
#: Two programs to compile instead of four.
SHORT_LADDER = ("M2", "M3", "M5+drag")


def flight(effects=None, duration=20.0):
    # Without jitter: a pair interaction smooths the steps of a force, as late packets do.
    changed: dict = {"radio": Radio(delay_s=5 / 240), "effects": effects or Effects()}
    settings = default_twin_settings().model_copy(update=changed)
    plant = build_plant(TRUTH, settings)
    return preprocess(excite(TRUTH, duration, 0, settings=settings, plant=plant))


@pytest.fixture(scope="module")
def plain():
    return flight()


@pytest.mark.slow
def test_a_craft_without_optional_terms_gets_none(plain, tmp_path):
    selection = select_model(plain, SHORT_LADDER, preparation=KEEP_FAULTS)
    assert selection.fit.model.name == "M3"
    names = [candidate.name for candidate in selection.candidates]
    assert names == list(SHORT_LADDER)
    # A term that the craft has improves the rung; a term that it lacks changes nothing.
    changes = [candidate.change[-1] for candidate in selection.candidates[1:]]
    assert changes[0] < 0.8 and 0.995 < changes[1] < 1.005
    selection.fit.model.save(tmp_path / "model.toml")
    assert read_model(tmp_path / "model.toml").fit["selection"]["ladder"] == names


@pytest.mark.slow
def test_a_craft_with_inflow_pair_interaction_and_drag_gets_them():
    told = []
    selection = select_model(
        flight(RICH, 14.0), SHORT_LADDER[1:], preparation=KEEP_FAULTS, progress=told.append
    )
    assert selection.fit.model.name == "M5+drag"
    assert len(told) == 2
    assert (selection.candidates[1].interval[1] < 1).any()
    figures = selection.to_json()
    assert figures["chosen"] == figures["best"] == "M5+drag"
    assert figures["rungs"][0]["change"] is None
    assert not figures["rungs"][0]["within_one_standard_error"]


@pytest.mark.slow
def test_no_sample_is_both_learned_from_and_predicted(plain, monkeypatch):
    loss = Loss()
    held_out = _HeldOut.of([plain], loss, TRUTH.vehicle, 5)
    windows = held_out.windows
    length = windows.encoder_length + windows.prediction_length
    learned = []

    def watched(self, objective, parameters, free):
        learned.append(objective.windows.starts[objective.multiplicity > 0])
        raise StopIteration

    monkeypatch.setattr("airpuck.identification.selection.LevenbergMarquardt.minimize", watched)
    rung = named_rung("M3")
    parameters = rung.initial(TRUTH.vehicle)
    objective = PredictionLoss(
        make_windows(plain, 40, 50, 7), TRUTH.vehicle, loss.encoder, multiplicity=None
    )
    model = replace(TRUTH, parameters=parameters)
    for block in range(5):
        with pytest.raises(StopIteration):
            held_out._without(model, objective, block)
        predicted = windows.starts[held_out.block == block]
        tested = np.unique(predicted[:, None] + np.arange(length))
        known = np.unique(learned[-1][:, None] + np.arange(90))
        assert len(known) > len(plain) / 2
        # A window apart, since the smoothed velocities look some samples ahead.
        assert np.abs(known[:, None] - tested[[0, -1]]).min() >= length
        assert not np.isin(known, tested).any()
    # Predictions of some block start from each sample, except at the borders.
    assert len(windows) > 0.9 * len(make_windows(plain, 40, 48, 4))


def candidate(excess: float, standard_error: float) -> CandidateModel:
    empty = np.zeros((4, 1))
    return CandidateModel(TRUTH, empty, empty[:, 0], np.zeros((2, 4)), excess, standard_error)


def test_one_standard_error_or_half_a_percent_is_as_good_as_the_best():
    assert candidate(0.0, 0.0).within
    assert candidate(0.05, 0.06).within
    assert not candidate(0.06, 0.05).within
    assert candidate(0.009, 0.001).within
    assert not candidate(0.011, 0.001).within


@pytest.mark.slow
def test_too_short_a_recording_is_refused(plain):
    with pytest.raises(InputError, match="name a model"):
        select_model(plain.slice(0, 0.2), ("M0",))
