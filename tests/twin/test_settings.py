"""Settings of the twin: files in, files out."""

import math

import pytest

from airpuck import InputError, TwinSettings
from airpuck.model.model_file import published_model
from airpuck.twin.settings import (
    Effects,
    MotionCapture,
    Motors,
    OnBoard,
    Radio,
    Stall,
    Starts,
    Weakness,
    default_twin_settings,
    read_twin_settings,
)

from ..apparatus import tables
from ..apparatus.refusals import rejected


def numbered(section: type, **chosen):
    """A section whose numbers differ from each other and from their defaults."""
    numbers = [k for k in section.model_fields if k not in chosen]
    return section(**{name: 0.011 + 0.01 * k for k, name in enumerate(numbers)} | chosen)


EVERYTHING = TwinSettings(
    **{name: getattr(tables.EVERYTHING, name) for name in ("table", "puck", "mallet")},
    radio=numbered(Radio, delay_s=0.1 / 3, outages_s=((1, 2.5), (4, 5))),
    motion_capture=numbered(MotionCapture, gaps_s=((3.0, 3.5),), clock_offset_s=-math.pi),
    on_board=numbered(OnBoard, rate_hz=0.0),
    effects=numbered(
        Effects, tilt_rad=(0.01, -0.02), dish_rad_m=(0.003, -0.004, 0.001), friction_SI=(0.04, 0.2)
    ),
    motors=numbered(
        Motors,
        stalls=(Stall(motor="motor_b_1", start_s=1.0, stop_s=2.0),),
        weak=(Weakness(motor="motor_c_2", start_s=3.0, stop_s=4.0, share=0.6),),
    ),
    starts=Starts(rest_s=(0.0, 0.2), failed=(0.1, 0.05), lasting_s=0.3),
)


def test_motors_of_the_packaged_twin_start_unless_failures_are_configured():
    usual, failing = default_twin_settings(), read_twin_settings("paper:starts")
    assert usual.starts.failing(0.1) == 0.0
    # Most starts fail after short rests: an ESC restarts a rotor that still turns.
    assert failing.starts.failing(0.1) > failing.starts.failing(0.3) > 0.0
    assert failing.model_copy(update={"starts": usual.starts}) == usual


@pytest.mark.parametrize(
    "text", ["rest_s = [0.1]", "rest_s = [0.2, 0.1]\nfailed = [0.1, 0.1]", "failed = [2.0]"]
)
def test_failing_starts_need_a_probability_for_each_of_increasing_rests(tmp_path, text):
    (tmp_path / "twin.toml").write_text(f"[starts]\n{text}")
    with pytest.raises(InputError, match="starts"):
        read_twin_settings(tmp_path / "twin.toml")


@pytest.mark.parametrize("settings", [EVERYTHING, default_twin_settings()])
def test_settings_round_trip(tmp_path, settings):
    settings.save(tmp_path / "twin.toml")
    assert read_twin_settings(tmp_path / "twin.toml") == settings


def test_every_field_of_the_full_example_differs_from_its_default():
    # Otherwise the test would not notice a field that is not written.
    for name in TwinSettings.model_fields:
        section = getattr(EVERYTHING, name)
        for key, info in type(section).model_fields.items():
            assert getattr(section, key) != info.default, f"{name}.{key}"


@pytest.mark.parametrize(
    ("text", "section", "key", "value"),
    [
        ("[radio]\nloss = 0.1", "radio", "loss", 0.1),
        ("[radio]\ndelay_s = 0.03", "radio", "delay_s", 0.03),
        ("[motion_capture]\ndropped = 0.2", "motion_capture", "dropped", 0.2),
        ("[effects]\ntilt_rad = [0.01, 0.0]", "effects", "tilt_rad", (0.01, 0.0)),
    ],
)
def test_a_file_changes_only_the_fields_that_it_names(tmp_path, text, section, key, value):
    path = tmp_path / "twin.toml"
    path.write_text(text)
    packaged = default_twin_settings()
    changed = getattr(packaged, section).model_copy(update={key: value})
    assert changed != getattr(packaged, section)
    assert read_twin_settings(path) == packaged.model_copy(update={section: changed})


def test_the_delay_comes_from_the_model_unless_the_radio_states_its_own():
    settings = default_twin_settings()
    assert settings.radio.delay_s is None
    assert settings.with_usual_delay(0.05).radio == settings.radio.model_copy(
        update={"delay_s": 0.05}
    )
    assert EVERYTHING.with_usual_delay(0.05) == EVERYTHING
    # As measured on the paper's craft.
    assert published_model("M4").transport_delay == 0.0208


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[effects]\nwind = 1.0", "effects.wind"),
        ("[weather]\nwind = 1.0", "weather"),
        ('[table]\nlength_m = "long"', "table.length_m"),
        ("[table]\nlength_m = -2.2", "table.length_m"),
        ("[table]\nlength_m = 2200.0", "table.length_m"),
        ("[table]\nwidth_m = 0.0", "table.width_m"),
        ("[table]\nrestitution = 1.1", "table.restitution"),
        ("[table]\nfriction = -0.1", "table.friction"),
        ("[table]\nfriction = nan", "table.friction"),
        ("[on_board]\nrate_hz = -1.0", "on_board.rate_hz"),
        ("[on_board]\nlatency_s = inf", "on_board.latency_s"),
        ("[motors]\nidle_below = 2.0", "motors.idle_below"),
        ("[motors]\nunarmed_s = -1.0", "motors.unarmed_s"),
        ("[effects]\ntilt_rad = 0.1", "effects.tilt_rad"),
        ("[effects]\ntilt_rad = [0.1]", "effects.tilt_rad.1"),
        ("[radio]\ndelay_s = -0.02", "radio.delay_s"),
        ("[radio]\nloss = 1.5", "radio.loss"),
        ("[radio]\ntimeout_s = 0.0", "radio.timeout_s"),
        ("[radio]\noutages_s = [[1.0]]", "radio.outages_s.0.1"),
        ("[radio]\noutages_s = [[2.0, 1.0]]", "radio.outages_s.0"),
        ("[motion_capture]\nyaw_noise_rad = true_", None),
        ("[motion_capture]\nyaw_noise_rad = -1e-3", "motion_capture.yaw_noise_rad"),
        ("[motion_capture]\nrate_hz = 0", "motion_capture.rate_hz"),
        ("[motion_capture]\ndropped = -1", "motion_capture.dropped"),
        ('[[motors.stalls]]\nmotor = "motor_a_1"\nstart_s = 1.0', "motors.stalls.0.stop_s"),
    ],
)
def test_an_invalid_entry_is_named(tmp_path, text, field):
    path = tmp_path / "twin.toml"
    path.write_text(text)
    with rejected(path, field=field):
        read_twin_settings(path)


def test_the_packaged_settings_match_the_paper_without_faults():
    settings = default_twin_settings()
    assert (settings.table.length_m, settings.table.width_m) == (2.2, 1.1)
    assert settings.motion_capture.rate_hz == 240
    assert settings.on_board.rate_hz == 100
    assert settings.effects == Effects()
    assert settings.motors == Motors()
    assert settings.radio.loss == 0
    assert settings.radio.outages_s == settings.motion_capture.gaps_s == ()
    assert settings.motion_capture.dropped == 0
    assert settings.motion_capture.clock_offset_s == settings.motion_capture.clock_drift == 0
