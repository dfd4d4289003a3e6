"""Score tests of terms that a model lacks."""

from dataclasses import replace

import pytest

from airpuck.identification.fit import identify
from airpuck.identification.missing_terms import missing_terms
from airpuck.model.model_file import published_model

from ..apparatus.synthetic_flights import fly


@pytest.mark.slow
@pytest.mark.parametrize("interaction", [None, 1.0])
def test_twins_that_blow_at_each_other_are_told_although_both_lose_alike(interaction):
    truth = replace(published_model("M3"), frame="body")
    truth = replace(truth, parameters=replace(truth.parameters, pair_interaction=interaction))
    fit = identify(fly(truth, duration=20.0))
    found = {one.term: one for one in missing_terms(fit.model, fit.objective)}
    assert ("pair" in found) == (interaction is not None)
    if interaction is not None:
        assert found["pair"].value[0] == pytest.approx(interaction, rel=0.5)
