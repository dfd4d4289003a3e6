"""Settings of the twin: files in, files out."""

import math

import pytest

from airpuck import InputError, Table, TwinSettings
from airpuck.craft.table import Contact, Mallet, Puck
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

EVERYTHING = TwinSettings(
    table=Table(length_m=1.7, width_m=0.9, restitution=0.6, friction=0.2, goal_width_m=0.3),
    puck=Puck(
        radius_m=0.03,
        mass_kg=0.02,
        inertia_kg_m2=1e-5,
        drag_1_s=0.1,
        spin_drag_1_s=0.3,
        rail=Contact(restitution=0.7),
        mallet=Contact(restitution=0.6),
        craft=Contact(restitution=0.5),
        standard_error={"drag_1_s": 0.01},
    ),
    mallet=Mallet(radius_m=0.05, speed_m_s=3.0, acceleration_m_s2=20.0),
    radio=Radio(
        delay_s=0.1 / 3, jitter_s=0.01, loss=0.1, timeout_s=0.3, outages_s=((1, 2.5), (4, 5))
    ),
    motion_capture=MotionCapture(
        rate_hz=100.0,
        position_noise_m=1e-5,
        yaw_noise_rad=math.pi * 1e-4,
        latency_s=0.01,
        latency_jitter_s=0.02,
        dropped=0.05,
        gaps_s=((3.0, 3.5),),
        clock_offset_s=-3.0,
        clock_drift=-1e-5,
        stamp_step_s=0.001,
    ),
    on_board=OnBoard(
        rate_hz=0.0,
        latency_s=0.03,
        acceleration_noise_m_s2=0.1,
        gyro_noise_rad_s=0.2,
        mouse_noise_m_s=0.3,
    ),
    effects=Effects(
        drag_linear_1_s=0.1,
        drag_quadratic_1_m=0.2,
        spin_drag_linear_1_s=0.3,
        spin_drag_quadratic_1_rad=0.4,
        inflow_s_m=0.5,
        pair_interaction_1_N=0.6,
        voltage_sag_1_N=0.7,
        tilt_rad=(0.01, -0.02),
        dish_rad_m=(0.003, -0.004, 0.001),
        friction_SI=(0.04, 0.2),
        idle_lag=0.8,
        hull_added_mass=0.5,
        hull_linear_along_1_s=0.11,
        hull_linear_across_1_s=0.12,
        hull_linear_spin_1_s=0.13,
        hull_quadratic_along_1_m=0.14,
        hull_quadratic_across_1_m=0.15,
        hull_quadratic_spin_1_rad=0.16,
        battery_sag_1_s=0.001,
    ),
    motors=Motors(
        unarmed_s=1.0,
        starting_delay_s=0.1,
        idle_below=0.06,
        stalls=(Stall(motor="motor_b_1", start_s=1.0, stop_s=2.0),),
        weak=(Weakness(motor="motor_c_2", start_s=3.0, stop_s=4.0, share=0.6),),
    ),
    starts=Starts(rest_s=(0.0, 0.2), failed=(0.1, 0.05), lasting_s=0.3),
)


def test_motors_of_the_packaged_twin_start_unless_failing_starts_are_named():
    usual, failing = default_twin_settings(), read_twin_settings("paper:starts")
    assert usual.starts.failing(0.1) == 0.0
    # Most starts fail after short rests: an ESC restarts a rotor that still turns.
    assert failing.starts.failing(0.1) > failing.starts.failing(0.3) > 0.0
    assert failing.model_copy(update={"starts": usual.starts}) == usual


@pytest.mark.parametrize(
    "text", ["rest_s = [0.1]", "rest_s = [0.2, 0.1]\nfailed = [0.1, 0.1]", "failed = [2.0]"]
)
def test_starts_need_a_fraction_for_each_of_increasing_rests(tmp_path, text):
    (tmp_path / "twin.toml").write_text(f"[starts]\n{text}")
    with pytest.raises(InputError, match="starts"):
        read_twin_settings(tmp_path / "twin.toml")


@pytest.mark.parametrize("settings", [EVERYTHING, default_twin_settings()])
def test_settings_survive_a_file(tmp_path, settings):
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
def test_a_file_changes_what_it_names_and_nothing_else(tmp_path, text, section, key, value):
    path = tmp_path / "twin.toml"
    path.write_text(text)
    packaged = default_twin_settings()
    changed = getattr(packaged, section).model_copy(update={key: value})
    assert changed != getattr(packaged, section)
    assert read_twin_settings(path) == packaged.model_copy(update={section: changed})


def test_the_delay_is_that_of_the_model_unless_the_radio_has_its_own():
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
def test_a_wrong_entry_is_named(tmp_path, text, field):
    path = tmp_path / "twin.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_twin_settings(path)
    assert caught.value.file == str(path)
    assert caught.value.field == field


def test_the_packaged_settings_are_those_of_the_paper_without_faults():
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
