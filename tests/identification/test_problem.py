"""Fits that leave faults out."""

from dataclasses import replace

import numpy as np
import pytest
from studies.adam import Adam

from airpuck.data.trajectory import Span
from airpuck.identification import problem
from airpuck.identification.fit import identify
from airpuck.identification.settings import Loss, Preparation
from airpuck.model.model_file import read_model
from airpuck.physics.rigid_body import rollout

from ..apparatus.robust_fits import MODEL, off
from ..apparatus.synthetic_flights import fly

#: When commands are not received [s].
OUTAGES = ((2.0, 2.5), (6.0, 6.5), (9.5, 10.0))


@pytest.fixture(scope="module")
def faulty():
    """A flight, prepared by others, whose motors stop three times, unlike in the log."""
    flight = fly(MODEL, duration=12.0)
    heard = flight.command.copy()
    for begin, end in OUTAGES:
        heard[(flight.time >= begin) & (flight.time < end)] = 0
    first = np.concatenate([flight.state[0], flight.command[0]])[:, None]
    steps = np.diff(flight.time)[:, None]
    flown = rollout(np, MODEL.dynamics, first, heard[:-1, :, None], steps)
    state = np.concatenate([first.T, flown[..., 0]])[:, :6]
    noise = np.random.default_rng(0).normal(size=state.shape)
    state += noise * [1e-5, 1e-5, 1e-4, 1e-3, 1e-3, 1e-2]
    return replace(flight, state=state, delay_known=False)


@pytest.fixture(scope="module")
def fit(faulty):
    return identify(faulty, "M3")


@pytest.mark.slow
def test_faults_do_not_affect_the_estimate(fit, faulty):
    kept = identify(faulty, "M3", preparation=Preparation(faults="keep"))
    assert off(kept) > 0.05
    assert off(fit) < 0.1 * off(kept)
    assert kept.exclusion is None
    (found,) = fit.exclusion.faults
    for begin, end in OUTAGES:
        assert any(s.start < begin + 0.1 and s.stop > end - 0.1 for s in found)


@pytest.mark.slow
def test_nothing_is_excluded_from_a_clean_flight(clean):
    fit, kept = (
        identify(clean, "M3", preparation=Preparation(faults=f)) for f in ("exclude", "keep")
    )
    assert fit.exclusion.share == 0
    assert fit.exclusion.faults == ((),)
    assert fit.windows == kept.windows
    assert fit.loss == kept.loss


@pytest.mark.slow
def test_exclusions_are_in_the_model_file(fit, faulty, tmp_path):
    fit.model.save(tmp_path / "m.toml")
    left_out = read_model(tmp_path / "m.toml").fit["left_out"]
    assert left_out == fit.exclusion.to_json() == fit.to_json()["faults"]
    assert left_out["share_of_windows"] == 1 - fit.windows / len(faulty.window_starts(90, 7))
    first = left_out["spans"][0]
    assert set(first) == {"recording", "start_s", "stop_s", "cause", "confidence"}
    assert 0 < first["confidence"] <= 1


@pytest.mark.slow
def test_iterations_continue_after_faults_are_excluded(fit):
    numbers = [step.number for step in fit.history]
    assert numbers == list(range(len(numbers)))


@pytest.mark.study
def test_a_fit_by_another_optimiser_excludes_faults_too(faulty, fit):
    other = identify(faulty, "M3", method=Adam(epochs=1), preparation=Preparation(faults="exclude"))
    # Its first fit uses the given delay, so confidences differ slightly.
    assert [[(s.start, s.stop, s.cause) for s in spans] for spans in other.exclusion.faults] == [
        [(s.start, s.stop, s.cause) for s in spans] for spans in fit.exclusion.faults
    ]
    assert other.windows == fit.windows
    assert other.iterations == 1


def test_the_model_is_doubted_if_most_of_a_flight_looks_faulty(clean, monkeypatch):
    for until, doubted in ((4.0, False), (8.0, True)):
        spans = (Span(0.0, until, "radio out", 0.9),)
        monkeypatch.setattr(problem, "find_faults", lambda *_, spans=spans: spans)
        found = problem.exclude_faults([clean], MODEL, 90, 7)
        assert bool(found.warnings) is doubted
        assert found.faults == ((() if doubted else spans),)
        assert (found.share == 0) is doubted


def test_a_fault_is_excluded_until_the_motors_have_settled(clean, monkeypatch):
    """With the speeds that they had during a fault, the motors still push afterwards."""
    span = Span(2.0, 2.5, "radio out", 0.9)
    monkeypatch.setattr(problem, "find_faults", lambda *_: (span,))
    slower = replace(MODEL.parameters, motor_time_constant=0.08)
    for model in (MODEL, replace(MODEL, parameters=slower)):
        (kept,) = problem.exclude_faults([clean], model, 90, 7).trajectories
        (excluded,) = set(kept.excluded) - set(clean.excluded)
        lag = float(model.parameters.motor_time_constant)
        assert excluded.start == span.start
        # After three lags, 5 % of a change of speed are left; after six, 0.2 %.
        assert span.stop + 3 * lag <= excluded.stop <= span.stop + 6 * lag


@pytest.mark.slow
def test_one_window_over_the_whole_flight_is_not_split(clean):
    short = clean.slice(0, 0.1)
    assert identify(short, "M0", loss=Loss(whole=True)).exclusion is None
