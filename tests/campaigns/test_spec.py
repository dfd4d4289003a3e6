"""A spec defines items; equal computations have equal keys."""

import shutil

import pytest

from airpuck.campaigns.campaign import read_spec
from airpuck.model.model_file import read_model
from airpuck.twin.settings import default_twin_settings

from ..apparatus.refusals import rejected

TRACKING = """
kind = "tracking"
seeds = 2
[base]
model = "model.toml"
truth = "paper:M4"
[base.twin.radio]
loss = 0.1
[grid]
controller = ["paper", "full"]
twin.radio.jitter_s = [0.0, 0.01, 0.03]
"""


@pytest.fixture
def spec(tmp_path):
    read_model("paper:M3").save(tmp_path / "model.toml")

    def written(text=TRACKING):
        (tmp_path / "spec.toml").write_text(text)
        return tmp_path / "spec.toml"

    return written


def test_every_combination_is_run_with_every_seed(spec):
    entries = read_spec(spec())
    assert len(entries) == len({entry.key for entry in entries}) == 2 * 3 * 2
    found = [(e.item.controller, e.item.twin.radio.jitter_s, e.item.seed) for e in entries]
    assert found == [(c, j, s) for c in ("paper", "full") for j in (0, 0.01, 0.03) for s in (0, 1)]
    assert entries[0].setting == {"controller": "paper", "twin.radio.jitter_s": 0.0}


def test_tables_override_the_packaged_settings(spec):
    packaged = default_twin_settings()
    for entry in read_spec(spec()):
        radio = entry.item.twin.radio
        assert radio.loss == 0.1
        assert radio.timeout_s == packaged.radio.timeout_s
        assert entry.item.twin.motion_capture == packaged.motion_capture


def test_files_are_looked_up_next_to_the_spec(spec, tmp_path):
    assert read_spec(spec())[0].item.model == str(tmp_path / "model.toml")


def test_a_recovery_accepts_the_settings_of_an_excitation(spec):
    text = 'kind = "recovery"\n[base]\nduration_s = 20.0\namplitude = [1.0, 0.5, 0.5]\nmargin_m = '
    (entry,) = read_spec(spec(f"{text}0.1\n"))
    assert (entry.item.margin_m, entry.item.amplitude) == (0.1, (1.0, 0.5, 0.5))
    with rejected("margin_m: must be from 0 to 1 m"):
        read_spec(spec(f"{text}2.0\n"))


def keys(path):
    return {entry.key for entry in read_spec(path)}


def test_a_changed_spec_recomputes_only_what_differs(spec):
    before = keys(spec())
    assert before < keys(spec(TRACKING.replace("seeds = 2", "seeds = [0, 1, 5]")))
    assert before > keys(spec(TRACKING.replace(", 0.03]", "]")))
    # The same in another notation.
    assert before == keys(spec(TRACKING.replace("0.0, 0.01", "0, 1e-2")))
    assert not before & keys(spec(TRACKING.replace("loss = 0.1", "loss = 0.2")))


def test_keys_depend_on_the_content_of_files_not_their_location(spec, tmp_path):
    before = keys(spec())
    shutil.copy(tmp_path / "model.toml", tmp_path / "other.toml")
    assert keys(spec(TRACKING.replace("model.toml", "other.toml"))) == before
    read_model("paper:M2").save(tmp_path / "model.toml")
    assert not keys(spec()) & before


def test_a_setting_given_twice_is_computed_once(spec):
    # The seed is part of an item even if it does not affect the setting.
    assert len(read_spec(spec('kind = "tracking"\nseeds = [3, 3]'))) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "racing"', ("kind", "tracking")),
        ("seeds = 3", ("kind", "required")),
        ('kind = "tracking"\nseeds = 0', ("seeds",)),
        ('kind = "tracking"\nseeds = -1', ("seeds",)),
        ('kind = "tracking"\nbase.speed = 1', ("speed", "not a known key")),
        ('kind = "tracking"\nbase.seed = 1', ("base.seed", "seeds")),
        ('kind = "tracking"\nbase.regulator = "mpc"', ("regulator", "now written law")),
        ('kind = "tracking"\nbase.tuning.weights.yaw = 3.0', ("tuning", "[law.lqr.weights]")),
        ('kind = "tracking"\n[grid]\n"tuning.regulator.kind" = ["mpc"]', ("tuning", "[law]")),
        ('kind = "tracking"\nbase.dwell_s = "2"', ("dwell_s", "valid number")),
        ('kind = "tracking"\nbase.twin.radio.loss = 2', ("twin", "radio.loss")),
        ('kind = "tracking"\nbase.twin = 2', ("twin", "must be an object")),
        ('kind = "tracking"\nbase.model = "none.toml"', ("none.toml", "no such file")),
        ('kind = "tracking"\ngrid.dwell_s = 2.0', ("grid.dwell_s", "list")),
        ('kind = "tracking"\ngrid.dwell_s = [2.0, 2.0]', ("grid.dwell_s", "twice")),
        ('kind = "tracking"\nseeds = 2000000', ("2000000 items",)),
        ('kind = "tracking"\nseeds = 1000000000', ("1000000000 items", "fewer seeds")),
        ('kind = "fleet"', ("kind", "airpuck.TwinBatch")),
        ('kind = "recovery"\nbase.duration_s = 1e308', ("duration_s", "from 0.01 to 3600 s")),
        ('kind = "recovery"\nbase.hold_s = 1e300', ("hold_s", "from 0.001 to 60 s")),
        ('kind = "recovery"\nbase.amplitude = 0', ("amplitude", "must be above 0")),
        ('kind = "fit"', ("recordings", "missing")),
        ('kind = "fit"\nbase = {recordings = ["."], model = "M9"}', ("model", "no model 'M9'")),
        ('kind = "recovery"\ngrid.model = ["M2", "M3+wind"]', ("model", "no term 'wind'")),
        ('kind = "fit"\nbase = {recordings = ["."], resamplings = 1}', ("at least 2",)),
        ('kind = "fit"\nbase = {recordings = ["."], resamplings = 9, robust = true}', ("robust",)),
    ],
)
def test_invalid_specs_are_rejected_by_field(spec, text, words):
    with rejected(*("spec.toml", *words) if "none.toml" not in text else words):
        read_spec(spec(text))
