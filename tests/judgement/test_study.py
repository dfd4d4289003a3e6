"""One study: whoever asks gets the same model, verdict and findings."""

import json
from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.campaigns.items import Fitting
from airpuck.model.model_file import published_model, read_model
from airpuck.twin.settings import default_twin_settings

from ..apparatus.commands import airpuck as command

TRUTH = replace(published_model("M3"), frame="body", indexing="start")
TWINS = {
    "healthy": {},
    "tilt": {"effects": {"tilt_rad": (0.03, 0.02)}},
    "drag": {"effects": {"drag_linear_1_s": 0.5}},
    "weak motor": {
        "motors": {"weak": [{"motor": "motor_b_1", "start_s": 0.0, "stop_s": 1e6, "share": 0.7}]}
    },
}
TERMS = {"healthy": [], "tilt": ["tilt"], "drag": ["drag"], "weak motor": []}


def recorded(name, duration=15.0, seed=1):
    content = default_twin_settings().model_dump()
    content["on_board"]["rate_hz"] = 0.0
    for section, values in TWINS[name].items():
        content[section].update(values)
    settings = airpuck.TwinSettings.model_validate(content)
    return airpuck.excite(TRUTH, duration, seed, settings=settings)


@pytest.mark.slow
@pytest.mark.parametrize("name", TWINS)
def test_python_command_line_and_campaign_give_the_same_model(name, tmp_path):
    bag, file = tmp_path / "bag", tmp_path / "model.toml"
    airpuck.write_bag(recorded(name), bag)
    study = airpuck.study(bag)
    assert study.model.name.split("+")[1:] == TERMS[name]
    done = command("identify", bag, "--model", "auto", "-o", file, "--json", "-", "-q")
    figures = json.loads(done.stdout)
    (row,) = Fitting(recordings=(str(bag),)).run()
    found, own = read_model(file), study.model
    assert found.name == own.name
    vectors = [one.parameters.to_vector() for one in (found, own)]
    np.testing.assert_allclose(*vectors, rtol=1e-6)
    assert row["inertia"] == pytest.approx(study.model.parameters.inertia, rel=1e-6)
    assert row["suspect_recording"] == 0
    assert figures["verdict"]["outcome"] == study.verdict.outcome
    assert figures["findings"] == study.to_json()["findings"]
    assert study.selection.missing == ()
    if name == "weak motor":
        assert any("motor_b_1" in one.cause for one in study.findings)


@pytest.mark.slow
def test_a_named_model_that_lacks_drag_is_told():
    trajectory = airpuck.preprocess(recorded("drag"), TRUTH.vehicle)
    study = airpuck.study(trajectory, model="M3")
    assert study.model.name == "M3"
    (missing,) = study.selection.missing
    assert missing.term == "drag" and missing.value[0] == pytest.approx(0.5, rel=0.3)
    assert "The model lacks the term drag" in [one.cause for one in study.findings]
    assert study.verdict.parameters.right is False
    # The errors include what is missing.
    assert "drag" in (study.fit.uncertainty or pytest.fail()).notes[-1]


@pytest.mark.slow
def test_a_mirrored_recording_ends_with_its_cause_and_all_files(tmp_path):
    recording = recorded("healthy")
    pose = recording["pose"]
    mirrored = replace(pose, values=pose.values * [1.0, -1.0, 1.0])
    bag, model = tmp_path / "bag", tmp_path / "model.toml"
    airpuck.write_bag(replace(recording, streams={**recording.streams, "pose": mirrored}), bag)
    done = command("identify", bag, "-o", model, "--json", tmp_path / "fit.json")
    assert done.returncode == 2 and model.exists()
    figures = json.loads((tmp_path / "fit.json").read_text())
    assert figures["verdict"]["outcome"] == "suspect_recording"
    assert figures["findings"][0]["kind"] == "axes"
    assert "the y axis" in done.stderr.splitlines()[-1]
    study = airpuck.study(bag)
    with pytest.raises(InputError, match="wrong sign of the y axis"):
        study.verdict.check_recording(bag)
