"""Proposals for the next flight: the search over made-up trials, and over real ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.cli.app import app
from airpuck.cli.output import console
from airpuck.cli.planning import error_table, summary
from airpuck.control.settings import ExcitationPlan, read_excitation_plan
from airpuck.control.tuning import tuning_for
from airpuck.experiment_design.design import design
from airpuck.experiment_design.forecast import (
    ComparedQuantities,
    Forecast,
    Information,
    Trial,
    fly,
    fly_trial,
    joined,
    loss_of,
)
from airpuck.model.model_file import published_model
from airpuck.report.fit_figures import design_figure
from airpuck.twin.radio import as_received
from airpuck.twin.settings import default_twin_settings

PUBLISHED = published_model("M3")
#: The model with the entries that the next fit will learn.
MODEL = replace(
    PUBLISHED, free=PUBLISHED.free | PUBLISHED.parameters.mask(frozenset({"transport_delay"}))
)
SIZE = len(MODEL.free)
SETTINGS, TUNING = default_twin_settings(), tuning_for(MODEL)


#: Function that the search calls for each flight.
FLY = "airpuck.experiment_design.design.fly_trial"


def information(gain):
    """Information per second: each parameter's accuracy follows from its size and the gain."""
    unit = gain / np.maximum(np.abs(MODEL.parameters.to_vector()), 1e-3)
    spread = np.random.default_rng(0).normal(size=(SIZE, 100)) * unit[:, None]
    hessian = spread @ spread.T / 100
    return Information(hessian, hessian, 1e-6, 20.0, 10)


def made_up(best=0.4, near=0.45, wall=0.02):
    """Trials in which one hold time teaches most, and long ones come near to a rail."""

    def fly(_model, _settings, _tuning, plan, _seed):
        weakest = min(np.ravel(plan.amplitude))
        gain = weakest * np.exp(-(np.log(plan.hold_s / best) ** 2)) * (1 - 0.1 * plan.margin_m)
        clearance = wall if plan.hold_s > near else 0.2
        return Trial(clearance, information(gain) if clearance else None)

    return fly


@pytest.fixture
def trials(monkeypatch):
    """Replace trials by made-up ones."""

    def as_given(**values):
        monkeypatch.setattr(FLY, made_up(**values))

    return as_given


@pytest.fixture(scope="module")
def found():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FLY, made_up())
        return design(MODEL, processes=1)


def test_the_best_combination_is_found(found):
    assert found.proposal.plan == ExcitationPlan(hold_s=0.4, duration_s=60.0, margin_m=0.05)
    assert found.usual.plan == ExcitationPlan(duration_s=60.0)
    # Errors are inversely proportional to the gain, which all parameters share.
    ratio = found.usual.relative / found.proposal.relative
    np.testing.assert_allclose(ratio, np.exp(np.log(2) ** 2), rtol=1e-6)
    assert found.proposal.score == found.proposal.relative.max()
    scores = [one.score for one in found.candidates]
    assert scores == sorted(scores)


@pytest.mark.slow
def test_the_delay_counts_if_the_next_fit_learns_it(trials):
    trials()
    for name, learned in (("M1", False), ("M3", True)):
        found = design(published_model(name), processes=1)
        assert found.model.delay_learned == learned


def test_hold_times_between_grid_points_are_found(trials):
    trials(best=0.32)
    assert design(MODEL, processes=1).proposal.plan.hold_s == pytest.approx(0.32)


def test_flights_that_come_near_a_rail_are_not_proposed(trials):
    trials(best=0.6, near=0.3)
    found = design(MODEL, processes=1)
    assert found.proposal.plan.hold_s <= 0.3
    refused = [one for one in found.candidates if one.plan.hold_s > 0.3]
    assert refused
    assert all(one.refused == "20 mm from a rail" and np.isinf(one.score) for one in refused)


def test_if_the_full_flight_hits_a_rail_another_candidate_is_tried(monkeypatch):
    def fly(*given):
        plan = given[3]
        met = plan.duration_s == 60.0 and plan.hold_s > 0.3
        return Trial(0.0, None) if met else made_up()(*given)

    monkeypatch.setattr(FLY, fly)
    found = design(MODEL, processes=1)
    assert 0.2 < found.proposal.plan.hold_s <= 0.3
    met = next(one for one in found.candidates if one.plan.hold_s == 0.4 and one.refused)
    assert met.refused == "meets a rail"


def test_the_default_excitation_is_proposed_if_no_other_is_clear_of_rails(monkeypatch):
    def fly(*given):
        one, usual = made_up()(*given), given[3] == ExcitationPlan(duration_s=given[3].duration_s)
        return one if usual else one._replace(clearance=0.02)

    monkeypatch.setattr(FLY, fly)
    found = design(MODEL, processes=1)
    assert found.proposal.plan == found.usual.plan
    assert not found.proposal.refused


@pytest.mark.parametrize("wall", [0.02, 0.0])
def test_nothing_is_proposed_if_every_flight_hits_a_rail(trials, wall):
    trials(near=0.0, wall=wall)
    with pytest.raises(InputError) as caught:
        design(MODEL, processes=1)
    assert caught.value.field in ("margin", "table")


def test_prior_knowledge_is_shown_and_counts(trials, found):
    trials()
    known = Forecast(MODEL, [information(1.0)]).of(information(1.0), 60.0)
    after = design(replace(MODEL, uncertainty=known), processes=1)
    before = after.relative_before
    np.testing.assert_allclose(before, found.quantities.relative_errors(known))
    expected = 1 / np.sqrt(1 / found.proposal.relative**2 + 1 / before**2)
    np.testing.assert_allclose(after.proposal.relative, expected, rtol=1e-6)


@pytest.mark.slow
def test_the_loss_of_the_fit_scales_the_predicted_errors(trials, found):
    trials()
    fitted = replace(MODEL, fit={"loss": 4e-6})
    large = design(fitted, processes=1)
    assert large.residual_level == pytest.approx(4.0)
    np.testing.assert_allclose(large.proposal.relative / found.proposal.relative, 2.0)
    robust = design(replace(MODEL, fit={"loss": 4e-6, "robust": True}), processes=1)
    assert robust.residual_level == 1.0


@pytest.mark.slow
def test_a_fit_with_a_fixed_delay_is_compared_with_matching_flights(monkeypatch):
    def fly(model, *_):
        # Residuals of late packets that are not searched for.
        loss = 1e-6 if model.delay_learned else 5e-6
        return Trial(0.2, replace(information(1.0), loss=loss))

    monkeypatch.setattr(FLY, fly)
    for model in (PUBLISHED, MODEL):
        found = design(replace(model, fit={"loss": 1e-5}), processes=1)
        assert found.residual_level == pytest.approx(10.0 if model.delay_learned else 2.0)


def test_flights_that_all_hit_a_rail_do_not_determine_the_residual_level(monkeypatch):
    def fly(model, *given):
        return made_up()(model, *given) if model.delay_learned else Trial(0.0, None)

    monkeypatch.setattr(FLY, fly)
    assert design(replace(PUBLISHED, fit={"loss": 1e-5}), processes=1).residual_level == 1.0


def test_a_fixed_delay_is_not_prior_knowledge(trials):
    trials()
    known = Forecast(PUBLISHED, [information(1.0)]).of(information(1.0), 60.0)
    found = design(replace(PUBLISHED, uncertainty=known), processes=1)
    shown = found.to_json()["known"]
    assert [label for label, error in shown.items() if error is None] == ["d"]
    assert "stays undetermined" not in " ".join(summary(found))


def test_a_quantity_held_at_its_bound_is_not_averaged(trials):
    trials()
    lag = MODEL.parameters.mask(frozenset({"motor_time_constant"}))
    upper = MODEL.parameters.bounds()[1]
    vector = np.where(lag, upper, MODEL.parameters.to_vector())
    held = replace(MODEL, parameters=MODEL.parameters.with_vector(vector))
    found = design(held, processes=1, criterion="mean")
    labels = found.quantities.labels
    assert found.proposal.relative[labels.index("τ")] < 1e-12
    others = np.delete(found.proposal.relative, labels.index("τ"))
    assert found.proposal.score == pytest.approx(np.exp(np.log(others).mean()))
    console().print(error_table(found))


def test_no_two_flights_share_a_seed(monkeypatch):
    seeds = []

    def fly(*given):
        seeds.append(given[-1])
        return made_up()(*given)

    monkeypatch.setattr(FLY, fly)
    design(MODEL, processes=1, seed=7)
    assert min(seeds) == 7
    assert len(set(seeds)) == len(seeds)


@pytest.mark.parametrize(
    ("field", "value"),
    [("margin", 0.0), ("margin", np.nan), ("duration", 2.0), ("rehearsal", np.inf), ("seed", -1)],
)
def test_numbers_out_of_range_are_rejected(field, value):
    with pytest.raises(InputError) as caught:
        airpuck.design(MODEL, **{field: value})
    assert caught.value.field == field


@pytest.mark.study
def test_flights_of_the_twin_have_errors_of_the_predicted_size(found):
    plan = ExcitationPlan(duration_s=8.0)
    *flights, again = (fly_trial(MODEL, SETTINGS, TUNING, plan, seed) for seed in (1, 2, 1))
    assert again.clearance == flights[0].clearance != flights[1].clearance
    assert 0.05 < again.clearance < 0.48
    both = [one.information for one in flights if one.information is not None]
    assert again.information is not None
    np.testing.assert_array_equal(again.information.hessian, both[0].hessian)
    expected = Forecast(MODEL, both).of(joined(both), 8.0)
    quantities = ComparedQuantities(MODEL)
    predicted = quantities.relative_errors(expected)
    trajectory, _ = fly(MODEL, SETTINGS, TUNING, plan, 3)
    fit = airpuck.identify(
        trajectory, "M3", vehicle=MODEL.vehicle, initial=MODEL.parameters, loss=loss_of(MODEL)
    ).model
    truth = as_received(MODEL, SETTINGS, 0.01)
    stated = quantities.relative_errors_of(fit)
    # Three blocks of time determine no more than a factor.
    assert 0.4 < np.median(stated / predicted) < 2.5
    # The deviation is as large as the error, not as the value.
    missed = (quantities.values(fit) - quantities.values(truth)) / quantities.scales
    assert np.median(np.abs(missed) / stated) < 4


def test_the_figure_shows_every_quantity(found):
    (axes,) = design_figure(found).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == found.quantities.labels
    shown = {str(line.get_label()): np.asarray(line.get_xdata()) for line in axes.lines}
    np.testing.assert_allclose(shown["proposal, predicted"], 100 * found.proposal.relative)


@pytest.mark.slow
def test_excite_accepts_the_written_plan(found, tmp_path, monkeypatch):
    monkeypatch.setattr(airpuck, "design", lambda *_, **__: found)
    plan, figures = tmp_path / "plan.toml", tmp_path / "design.json"
    drawn = tmp_path / "design.png"
    arguments = ["-o", str(plan), "--json", str(figures), "--figure", str(drawn)]
    result = CliRunner().invoke(app, ["design", *arguments])
    assert result.exit_code == 0, result.output
    assert read_excitation_plan(plan) == found.proposal.plan
    assert drawn.read_bytes().startswith(b"\x89PNG")
    for sentence in summary(found):
        assert sentence in result.output
    content = json.loads(figures.read_text())
    inertia = float(found.proposal.relative[found.quantities.labels.index("I")])
    assert content["proposal"]["relative_error"]["I"] == inertia
    assert content["known"]["I"] is None
    flight = ["--plan", str(plan), "--duration", "1", "-o", str(tmp_path / "bag"), "--json", "-"]
    flown = CliRunner().invoke(app, ["excite", *flight])
    assert flown.exit_code == 0, flown.output
    assert json.loads(flown.output)["messages"]["command"] == pytest.approx(100, abs=2)
