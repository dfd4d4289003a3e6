"""Tuning files: written and read back; errors name every mistake."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airpuck import InputError, LawSettings, SetPoint, TrackingController, Tuning
from airpuck.control.excitation import Excitation
from airpuck.control.laws import LAWS
from airpuck.control.lqr import LQRSettings, Weights, lqr_gain, point_mass
from airpuck.control.predictive import PredictiveSettings, SoftLimits
from airpuck.control.tuning import ChosenLaw, Estimation, default_tuning, read_tuning, tuning_for
from airpuck.craft.vehicle import default_vehicle, read_vehicle
from airpuck.model.model_file import nominal_model
from airpuck.model.uncertainty import Cameras

from ..apparatus.refusals import rejected

EXAMPLES = Path(__file__).parents[2] / "examples"
positive = st.floats(1e-9, 1e4)
non_negative = st.just(0.0) | positive
weight = st.floats(1e-6, 1e6)
size = st.floats(1e-9, 9.0)
WEIGHTS = st.builds(
    Weights,
    **dict.fromkeys(("speed", "spin"), st.just(0.0) | weight),
    **dict.fromkeys(("position", "yaw", "acceleration", "angular_acceleration"), weight),
)


FENCES = st.builds(
    SoftLimits,
    fence_m=st.none() | st.tuples(*[st.floats(-9, -1)] * 2, *[st.floats(0, 9)] * 2),
    speed_m_s=st.none() | size,
    spin_rad_s=st.none() | size,
    keep_out_m=st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9), size), max_size=8).map(tuple),
)


def weights_of(tuning: Tuning) -> Weights:
    return tuning.of(LQRSettings).weights


LIMITS = "law.mpc.limits"
GOOD = """
period_s = 0.02

[law.lqr.weights]
position = 1.0
speed = 2.0
yaw = 3.0
spin = 4.0
acceleration = 5.0
angular_acceleration = 6.0

[estimation]
position_m = 1e-4
yaw_rad = 1e-3
acceleration_density = 0.1
angular_acceleration_density = 0.2
disturbance_density = 0.3
angular_disturbance_density = 0.4
"""


@given(
    st.builds(
        Tuning,
        period_s=st.floats(1e-3, 0.1),
        law=st.builds(
            ChosenLaw,
            kind=st.sampled_from(["lqr", "mpc"]),
            lqr=st.fixed_dictionaries(
                {"weights": WEIGHTS.map(Weights.model_dump), "slack_weight": positive}
            ),
            mpc=st.fixed_dictionaries(
                {
                    "weights": st.just(
                        default_tuning().of(PredictiveSettings).weights.model_dump()
                    ),
                    "limits": FENCES.map(SoftLimits.model_dump),
                }
            ),
        ),
        estimation=st.builds(
            Estimation,
            **dict.fromkeys(set(Estimation.model_fields) - {"estimator"}, positive)
            | dict.fromkeys(["disturbance_density", "angular_disturbance_density"], non_negative),
        ),
    )
)
def test_a_tuning_round_trips(tmp_path_factory, tuning):
    path = tmp_path_factory.mktemp("tuning") / "tuning.toml"
    tuning.save(path)
    assert read_tuning(path) == tuning


@given(WEIGHTS, st.floats(1e-3, 0.1))
def test_weights_in_a_file_give_a_regulator_or_are_rejected(weights, period):
    try:
        gain = lqr_gain(weights, period)
    except InputError as error:
        assert error.field == "weights"
        return
    a, b = point_mass(period)
    assert np.abs(np.linalg.eigvals(a - b @ gain)).max() < 1 + 1e-9


def test_every_number_in_a_file_is_read_into_its_own_field(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    tuning = read_tuning(path)
    assert tuning.period_s == 0.02
    assert list(weights_of(tuning).model_dump().values()) == [1, 2, 3, 4, 5, 6]
    noise = tuning.estimation
    assert (noise.position_m, noise.yaw_rad) == (1e-4, 1e-3)
    assert (noise.acceleration_density, noise.angular_acceleration_density) == (0.1, 0.2)
    assert (noise.disturbance_density, noise.angular_disturbance_density) == (0.3, 0.4)


def test_missing_keys_default_to_the_packaged_values(tmp_path):
    path, packaged = tmp_path / "mine.toml", default_tuning()
    path.write_text("[law.lqr.weights]\nyaw = 7.0\n")
    weights = weights_of(packaged).model_copy(update={"yaw": 7.0})
    assert weights != weights_of(packaged)
    assert read_tuning(path) == packaged.with_law("lqr", weights=weights)


@pytest.mark.parametrize(
    ("old", "new", "field", "problem"),
    [
        *[
            (old, new, f"law.lqr.weights.{key}", problem)
            for old, new, key, problem in [
                ("yaw = 3.0", "yaww = 3.0\nyaw = 3.0", "yaww", "not a known key"),
                ("yaw = 3.0", 'yaw = "much"', "yaw", "number"),
                ("yaw = 3.0", "yaw = 0.0", "yaw", "greater than or equal to 0.000001"),
                ("position = 1.0", "position = 0", "position", "equal to 0.000001"),
                ("position = 1.0", "position = 1e300", "position", "less than or equal to 1000000"),
                ("speed = 2.0", "speed = 1e300", "speed", "less than or equal to 1000000"),
                ("speed = 2.0", "speed = -1.0", "speed", "greater than or equal to 0"),
                ("yaw = 3.0", "yaw = nan", "yaw", "finite"),
                ("\nacceleration = 5.0", "\nacceleration = 0.0", "acceleration", "greater than"),
            ]
        ],
        ("period_s = 0.02", "period = 1\nperiod_s = 0.02", "period", "not a known key"),
        ("period_s = 0.02", "period_s = 9e-4", "period_s", "greater than or equal to 0.001"),
        ("period_s = 0.02", "period_s = 0.2", "period_s", "less than or equal to 0.1"),
        ("position_m = 1e-4", "position_m = 0.0", "estimation.position_m", "greater than"),
        ("[estimation]", "[estimates]", "estimates", "not a known key"),
        *[
            ("[estimation]", f"[{table}]\n{line}\n[estimation]", f"{table}{key}", problem)
            for table, line, key, problem in [
                ("law", 'kind = "pid"', ".kind", "must be 'lqr', 'mpc', "),
                ("law.lqr", "slack_weight = 1e14", ".slack_weight", "equal to 10000000000"),
                ("law.mpc", "horizon_s = -0.6", ".horizon_s", "equal to 0.02"),
                ("law.mpc", "horizon_s = nan", ".horizon_s", "finite"),
                ("law.mpc", "step_s = 0.0", ".step_s", "equal to 0.001"),
                ("law.mpc", "block = 0", ".block", "equal to 1"),
                ("law.mpc", "block = 1.5", ".block", "integer"),
                ("law.mpc", "block = []", ".block", "block: must have at least 1 item"),
                ("law.mpc", "horizon_s = 0.03\nstep_s = 0.05", "", "longer than hor"),
                ("law.mpc", "horizon_s = 5.0\nstep_s = 0.001", "", "5000 steps; at m"),
                ("law.mpc", "penalty = 1.0", ".penalty", "not a known key"),
                ("law.mpc.weights", "yaw = -1.0", ".yaw", "equal to 0.000001"),
                (LIMITS, "speed_m_s = 0", ".speed_m_s", "than or equal to 0"),
                (LIMITS, "margin_m = -1", ".margin_m", "equal to 0"),
                (LIMITS, "penalty = 1e300", ".penalty", "100000000"),
                (LIMITS, "fence_m = [1.0, -0.5, -1.0, 0.5]", ".fence_m", "lowest x and y, then"),
                (LIMITS, "fence_m = [-1.0, 0.5, 1.0, -0.5]", ".fence_m", "lowest x and y, then"),
                (LIMITS, "fence_m = [1.0]", ".fence_m.1", "missing"),
                (LIMITS, f"keep_out_m = {[[0.0, 0.0, 0.1]] * 9}", ".keep_out_m", "at most 8"),
            ]
        ],
    ],
)
def test_a_mistake_is_reported_with_file_and_field(tmp_path, old, new, field, problem):
    assert old in GOOD
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with rejected(problem, match=re.escape(f"{path}: {field}: "), field=field):
        read_tuning(path)


def test_a_slowed_regulator_scales_its_gains():
    tuning = default_tuning()
    gain, slow = (
        lqr_gain(weights_of(one), period)
        for one, period in ((tuning, 0.001), (tuning.slowed(4.0), 0.004))
    )
    np.testing.assert_allclose(slow[:, :3], gain[:, :3] / 16, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(slow[:, 3:], gain[:, 3:] / 4, rtol=1e-6, atol=1e-12)


def test_only_a_much_slower_craft_gets_a_different_tuning():
    vehicle = default_vehicle()
    assert tuning_for(nominal_model(vehicle)) == default_tuning()
    heavy = nominal_model(vehicle.model_copy(update={"mass_kg": 10 * vehicle.mass_kg}))
    assert weights_of(tuning_for(heavy)).speed > weights_of(default_tuning()).speed


def test_a_slow_craft_gets_a_slower_filter():
    late = nominal_model(default_vehicle())
    own = replace(late.parameters, motor_time_constant=0.1, transport_delay=0.06)
    tuned = tuning_for(replace(late, parameters=own))
    assert tuned.law == default_tuning().law
    assert tuned.estimation == default_tuning().slowed(2.0).estimation
    # At most by a factor of three; a slow craft has a slower filter anyway.
    later = replace(late, parameters=replace(own, motor_time_constant=0.4))
    assert tuning_for(later).estimation == default_tuning().slowed(3.0).estimation
    heavy = late.vehicle.model_copy(update={"mass_kg": 10 * late.vehicle.mass_kg})
    slow = replace(nominal_model(heavy), parameters=own)
    assert tuning_for(slow) == tuning_for(nominal_model(heavy))


def test_the_estimator_expects_the_noise_of_the_models_recordings():
    cameras = Cameras(rate_hz=120, position_noise_m=3e-4, yaw_noise_rad=4e-3, stamp_jitter_s=1e-3)
    model = replace(nominal_model(default_vehicle()), cameras=cameras)
    tuned = tuning_for(model).estimation
    # Half of a flight's largest speeds, 0.4 m/s and 2 rad/s, times a millisecond.
    assert tuned.position_m == pytest.approx(5e-4)
    assert tuned.yaw_rad == pytest.approx(np.hypot(4e-3, 2e-3))
    quiet = replace(model, cameras=cameras.model_copy(update={"stamp_jitter_s": 0.0}))
    assert tuning_for(quiet).estimation.position_m == pytest.approx(3e-4)
    exact = Cameras(rate_hz=120, position_noise_m=1e-6, yaw_noise_rad=1e-5)
    assert tuning_for(replace(model, cameras=exact)) == default_tuning()


def test_every_default_equals_the_tuning_for_the_model():
    cameras = Cameras(rate_hz=120, position_noise_m=3e-4, yaw_noise_rad=4e-3)
    model = replace(nominal_model(default_vehicle()), cameras=cameras)
    tuning = tuning_for(model)
    assert TrackingController(model, SetPoint(0.1, 0, 0), compiled=False).tuning == tuning
    controller = Excitation(model).controller
    assert controller.tuning.estimation == tuning.estimation


def test_a_tuning_file_may_hold_only_differences_from_the_default(tmp_path):
    cameras = Cameras(rate_hz=120, position_noise_m=3e-4, yaw_noise_rad=4e-3)
    model = replace(nominal_model(default_vehicle()), cameras=cameras)
    (tmp_path / "mine.toml").write_text('law.kind = "mpc"')
    assert read_tuning(tmp_path / "mine.toml", model) == tuning_for(model).with_law("mpc")
    assert read_tuning(tmp_path / "mine.toml") == default_tuning().with_law("mpc")


def test_a_craft_with_pwm_gets_one_command_per_period():
    for name in ("atmos", "freeflyer2"):
        vehicle = read_vehicle(EXAMPLES / f"free_flyers/{name}.toml")
        tuning = tuning_for(nominal_model(vehicle))
        assert tuning.period_s == 0.1
        for kind in LAWS:
            TrackingController(
                nominal_model(vehicle),
                SetPoint(0.1, 0.0, 0.0),
                tuning.with_law(kind),
                compiled=False,
            )


def test_a_law_is_selected_by_name_and_changes_nothing_else():
    tuning = default_tuning()
    assert [tuning.with_law(kind).law.kind for kind in LAWS] == list(LAWS)
    assert tuning.with_law("mpc").with_law("lqr") == tuning


def test_an_unknown_law_or_estimator_is_rejected():
    tuning = default_tuning()
    with pytest.raises(InputError, match=r"law\.kind: must be 'lqr', 'mpc', .*not 'MPC'"):
        tuning.with_law("MPC")
    with pytest.raises(
        InputError, match=r"estimation\.estimator: must be 'kalman', 'actuation' or"
    ):
        tuning.with_estimator("actuaton")


def test_a_missing_file_and_invalid_toml_are_reported(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml: there is no such file"):
        read_tuning(tmp_path / "nowhere.toml")
    (tmp_path / "broken.toml").write_text("[law.lqr.weights\n")
    with pytest.raises(InputError, match=r"broken\.toml: is not valid TOML"):
        read_tuning(tmp_path / "broken.toml")


@pytest.mark.parametrize(
    ("old", "field", "now"),
    [
        ("[weights]\nyaw = 3.0", "weights", "[law.lqr.weights]"),
        ("[allocation]\nslack_weight = 1e5", "allocation", "[law.lqr]"),
        ('[regulator]\nkind = "mpc"', "regulator", "[law]"),
        ("with_regulator = 1", "with_regulator", "is not a known key; "),
        ('kind = "mpc"', "kind", "is not a known key; it is a key of another table"),
        ("[law]\nhorizon_s = 0.5", "law.horizon_s", "law.mpc.horizon_s"),
        ("[law]\niterations = 5", "law.iterations", "law.mpc.iterations"),
        ("[law]\nlimits.margin_m = 0.02", "law.limits", "is now written [law.mpc.limits]"),
        ("[law.weights]\nyaw = 3.0", "law.weights", "is now written [law.mpc.weights]"),
        ("[law]\nsolver = 'piqp'", "law.solver", "is now written law.lqr.solver"),
        ("[law.mcp]\niterations = 5", "law.mcp", "'mpc'"),
        ("[law.plan]\niterations = 5", "law.plan", "no settings"),
    ],
)
def test_a_misplaced_setting_is_reported_with_its_right_place(tmp_path, old, field, now):
    (tmp_path / "older.toml").write_text(old)
    with rejected(now, tmp_path / "older.toml", field=field):
        read_tuning(tmp_path / "older.toml")


def test_errors_in_settings_name_the_law_and_missing_fields():
    class Nameless(LawSettings):
        stiffness: float = 8.0

    class Spring(LawSettings):
        law = "Spring"
        stiffness: float

    with pytest.raises(InputError, match='Nameless: needs law = "NAME"'):
        default_tuning().of(Nameless)
    with pytest.raises(InputError, match=r"law\.Spring\.stiffness: is required"):
        default_tuning().of(Spring)
