"""Recordings with other cameras: few poses a second, and many gaps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck.evaluation.evaluate import evaluate
from airpuck.identification.fit import identify
from airpuck.judgement.verdict import verdict
from airpuck.model.model_file import published_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.stream import Recording

from ..apparatus.examples import examples
from ..apparatus.synthetic_flights import edited, record


def seen_at(recording: Recording, rate: float, gaps: float, seed: int = 0) -> Recording:
    """Keep poses at a rate [Hz], and drop runs of them at random."""
    random = np.random.default_rng(seed)

    def edit(stamp, received, values):
        due = np.arange(0.0, (stamp[-1] - stamp[0]) / 1e9, 1 / rate)
        index = np.unique(np.searchsorted((stamp - stamp[0]) / 1e9, due))
        kept, k = np.ones(len(index), bool), 0
        while k < len(index):
            k += int(random.integers(1, 2 + int(rate / 2)))
            if random.random() < gaps:
                missing = int(random.integers(4, 10))
                kept[k : k + missing] = False
                k += missing
        index = index[kept]
        return stamp[index], received[index], values[index]

    return edited(recording, "pose", edit)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return record(duration=20.0, noise=1e-3)


@given(st.floats(5.0, 240.0), st.floats(0.0, 0.6), st.integers(0, 99))
@examples(30)
def test_any_rate_with_any_gaps_is_preprocessed(recording, rate, gaps, seed):
    trajectory = preprocess(seen_at(recording, rate, gaps, seed))
    assert np.isfinite(trajectory.state).all()
    assert np.isfinite(trajectory.acceleration).all()


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "gaps"), [(8.0, 0.3), (17.0, 0.3)])
def test_a_model_learned_from_few_poses_beats_coasting(recording, rate, gaps):
    trajectory = preprocess(seen_at(recording, rate, gaps), delay=0.0)
    model = identify(trajectory, "M3").model
    judged = verdict(model, trajectory, evaluate(model, trajectory))
    assert (judged.missed < 1).all()
    assert judged.sentences


@pytest.mark.slow
def test_switching_times_between_sparse_poses_are_kept():
    recording = record(duration=20.0)
    trajectory = preprocess(seen_at(recording, 60.0, gaps=0.0), delay=0.0)
    found, truth = identify(trajectory, "M3").model, published_model("M3")
    # Commands spread over the 17 ms between poses would shorten the lag by 0.8 ms.
    lag, expected = (float(one.parameters.motor_time_constant) for one in (found, truth))
    assert lag == pytest.approx(expected, abs=2e-4)
    assert found.transport_delay == pytest.approx(5 / 240, abs=2e-4)
