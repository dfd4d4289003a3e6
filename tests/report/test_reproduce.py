"""The paper's study on the real recordings."""

import json

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.evaluation.evaluate import evaluate
from airpuck.model.model_file import published_model, read_model
from airpuck.physics.thrust import is_monotone
from airpuck.recording.torch_archive import read_authors_experiment
from airpuck.report.prediction_figures import touched_by
from airpuck.report.reproduce import FAULTS, PRINTED, TRAINING, VALIDATION, reproduce

from ..apparatus.pages import check_self_contained
from ..apparatus.public_recordings import TABLE_2
from ..apparatus.public_recordings import TRAINING as TRAINING_NAME
from ..apparatus.public_recordings import VALIDATION as VALIDATION_NAME


@pytest.fixture(scope="module")
def figures(reproduction):
    """Read back the written files."""
    return json.loads((reproduction.page.parent / "reproduce.json").read_text())


def rounded(errors):
    return round(errors["x_mm"], 2), round(errors["y_mm"], 2), round(errors["yaw_rad"], 4)


@pytest.mark.slow
@pytest.mark.data
def test_published_parameters_reproduce_table_2_to_every_digit(figures):
    published = figures["table_2"]["published"]
    assert {name: rounded(errors) for name, errors in published.items()} == TABLE_2
    for name, errors in published.items():
        assert PRINTED[name] == (
            f"{errors['x_mm']:.1f}",
            f"{errors['y_mm']:.1f}",
            f"{errors['yaw_rad']:.3f}",
        )


@pytest.mark.slow
@pytest.mark.data
def test_our_fits_reach_the_published_errors(figures):
    table = figures["table_2"]
    ratio = np.array(
        [
            [table["fitted"][m][c] / table["published"][m][c] for c in ("x_mm", "y_mm", "yaw_rad")]
            for m in TABLE_2
        ]
    )
    assert ratio.max() < 1.02
    assert ratio[3:].max() < 1.01
    assert ratio.mean() < 1.005
    assert all(fit["iterations"] <= 15 for fit in figures["fits"].values())


@pytest.mark.slow
@pytest.mark.data
def test_numbers_match_direct_calls(figures, reproduction, experiments):
    assert (TRAINING, VALIDATION) == (TRAINING_NAME, VALIDATION_NAME)
    assert figures == json.loads(json.dumps(reproduction.to_json()))
    validation = read_authors_experiment(experiments / VALIDATION)
    for name in TABLE_2:
        assert evaluate(published_model(name), validation).to_json() == figures["published"][name]
        model = read_model(reproduction.page.parent / "models" / f"{name}.toml")
        assert evaluate(model, validation).to_json() == figures["fitted"][name]
        assert figures["fits"][name]["loss"] == model.fit["loss"]
        for kind in ("published", "fitted"):
            result = figures[kind][name]
            assert result["protocol"] == "paper"
            assert result["windows"] == 334
            assert result["horizon_step"] == 48


@pytest.mark.slow
@pytest.mark.data
def test_the_page_shows_everything(reproduction, data):
    page = check_self_contained(reproduction.page.read_text(encoding="utf-8"))
    assert {
        *("summary", "craft", "learning", "prediction", "time", "thrust", "optimiser"),
        *("flight", "parameters", "conventions", "sources"),
    } <= page.ids
    names = {path.stem for path in (reproduction.page.parent / "figures").iterdir()}
    assert {f"figure-{name}" for name in names} == {i for i in page.ids if i.startswith("figure-")}
    assert len(names) == 10
    assert "15 of the 15 numbers" in page.text
    for row in PRINTED.values():
        for number in row:
            assert number in page.text
    assert str(data) not in page.text  # the page can be sent to others


@pytest.mark.slow
@pytest.mark.data
def test_known_faults_contain_the_largest_errors(reproduction):
    best = reproduction.judged.best
    faulty = touched_by(best, FAULTS)
    assert 0.03 < faulty.mean() < 0.09
    for errors in best.at_horizon:
        assert np.sum(errors[faulty] ** 2) > 0.55 * np.sum(errors**2)
        assert np.abs(errors).argmax() in np.flatnonzero(faulty)


@pytest.mark.slow
@pytest.mark.data
def test_fits_beat_the_published_loss(reproduction):
    losses = reproduction.study.reference_losses
    for fit in reproduction.study.fits:
        assert fit.loss < losses[fit.model.name]
        assert fit.converged
        assert is_monotone(fit.model.parameters.thrust).all()


def test_a_folder_without_the_dataset_is_rejected(tmp_path):
    with pytest.raises(InputError, match="no folder `experiments`"):
        reproduce(tmp_path, tmp_path / "out")
    (tmp_path / "experiments").mkdir()
    with pytest.raises(InputError, match="no such file") as error:
        reproduce(tmp_path, tmp_path / "out")
    assert TRAINING in str(error.value)
    assert not (tmp_path / "out").exists()
