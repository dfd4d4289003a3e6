"""Model files: writing and reading back, older files, and errors for mistakes."""

import tomllib
from dataclasses import fields

import numpy as np
import pytest
import tomli_w

import airpuck
from airpuck import AirHockey, InputError
from airpuck.boundary.files import read_packaged
from airpuck.campaigns.campaign import Spec
from airpuck.control.settings import ExcitationPlan
from airpuck.control.tuning import Tuning, read_tuning
from airpuck.craft.vehicle import Vehicle, default_vehicle, read_vehicle
from airpuck.fleet.scenario import Scenario
from airpuck.model.model_file import nominal_model, published_model, read_model
from airpuck.model.sections import ModelFile
from airpuck.recording.mapping import RecordingMapping, read_mapping
from airpuck.twin.settings import TwinSettings

from ..apparatus.refusals import rejected

#: A file from before the transport delay was a parameter.
OLDER = """
format = "airpuck model 1"
name = "M3+inflow"
source = "here"
transport_delay_s = 0.021
center_of_mass_frame = "body"
encoder_indexing = "start"

[parameters]
thrust_N = [[0.1, 0.5], [0.2, 0.25]]
inertia_kg_m2 = 0.00015
motor_time_constant_s = 0.03
angle_offset_rad = 0.01
center_of_mass_m = [0.001, -0.002]
inflow_s_m = 0.125

[free]
thrust = [true, true, true, false]
motor_time_constant = true
transport_delay = true

[fit]
loss = 1.5

[uncertainty]
method = "sandwich"
clusters = 12
quantile_95 = 2.2
notes = ["a note"]
labels = ["thrust left φ^1", "thrust left φ^2", "transport_delay"]
covariance = [[0.0004, 0.0001, 0.0], [0.0001, 0.0001, 0.0], [0.0, 0.0, 1e-08]]
undetermined = []

[uncertainty.standard_errors]
thrust_N = [[0.02, 0.01], [nan, nan]]
transport_delay_s = 0.0001

[uncertainty.bootstrap]
replicates = 5
seed = 1
lower = [0.08, 0.49, 0.0209]
upper = [0.12, 0.51, 0.0211]

[delay_jitter]
standard_deviation_s = 0.004
standard_error_s = 0.001
packets = 40

[cameras]
rate_hz = 120.0
position_noise_m = 1.5e-4
yaw_noise_rad = 1.8e-3
stamp_jitter_s = 3e-4

[vehicle]
name = "two fans"
mass_kg = 0.1
pairs = [["left", "right"]]
propellers = [
    {name = "left", position_m = [0.0, 0.05], direction_deg = 0.0},
    {name = "right", position_m = [0.0, -0.05], direction_deg = 180.0},
]
nominal = {thrust_N = [0.1, 0.5], inertia_kg_m2 = 1e-4}
"""


@pytest.fixture
def older(tmp_path):
    def read(text=OLDER):
        path = tmp_path / "model.toml"
        path.write_text(text)
        return read_model(path)

    return read


def same(first, second):
    """Whether two objects have the same content, arrays and nan included."""
    for entry in fields(first):
        a, b = getattr(first, entry.name), getattr(second, entry.name)
        if isinstance(a, np.ndarray) or a is None:
            np.testing.assert_array_equal(a, b)
        elif hasattr(a, "__dataclass_fields__"):
            same(a, b)
        else:
            assert a == b or np.array_equal(a, b)


def test_a_file_with_the_delay_outside_the_parameters_is_read(older):
    model = older()
    assert model.transport_delay == 0.021
    assert model.delay_learned
    np.testing.assert_array_equal(model.free, [1, 1, 1, 0, 0, 1, 0, 0, 0, 0, 1])
    assert model.uncertainty.standard_errors[-1] == 1e-4
    assert model.uncertainty.covariance[0, 1] == 1e-4
    assert model.uncertainty.bootstrap.upper[-1] == 0.0211
    assert model.standard_error(lambda m: m.transport_delay) == pytest.approx(1e-4)
    assert model.delay_jitter.packets == 40
    assert model.cameras.stamp_jitter_s == 3e-4
    (inflow,) = model.dynamics.effects
    assert inflow.coefficient == 0.125


def test_a_model_file_round_trips_all_fields(older, tmp_path):
    for model in (older(), published_model("M4"), nominal_model(older().vehicle)):
        model.save(tmp_path / "again.toml")
        same(read_model(tmp_path / "again.toml"), model)
        content = tomllib.loads((tmp_path / "again.toml").read_text())
        assert "transport_delay_s" in content["parameters"]
        assert "transport_delay_s" not in content


def test_uncertainty_of_other_parameters_is_not_written(older, tmp_path):
    moved = older().with_delay(0.03)
    assert np.isnan(moved.standard_error(lambda m: m.transport_delay))
    moved.save(tmp_path / "moved.toml")
    assert read_model(tmp_path / "moved.toml").uncertainty is None


@pytest.mark.parametrize(
    ("old", "new", "field", "problem"),
    [
        ("transport_delay_s = 0.021\n", "", "parameters.transport_delay_s", "missing"),
        ("delay_s = 0.021", "delay_s = -1.0", "parameters.transport_delay_s", "greater"),
        ("inflow_s_m", "wind_s_m", "parameters.wind_s_m", "known key"),
        *(
            ("inertia_kg_m2 = 0.00015", f"inertia_kg_m2 = {x}", "parameters.inertia_kg_m2", says)
            for x, says in [("0.0", "greater"), ("true", "num"), ('"0.1"', "num"), ("nan", "fin")]
        ),
        ("[0.2, 0.25]]", "[0.2]]", "parameters.thrust_N", "same length"),
        (", [0.2, 0.25]]", "]", "parameters.thrust_N", "2 propellers"),
        ("motor_time_constant = true", "lag = true", "free.lag", "known key"),
        ("true, true, true, false", "true, false", "free.thrust", "truth value or 4"),
        ("φ^2", "φ^9", "uncertainty.labels", "no parameter"),
        ("0.0, 1e-08]", "1e-08]", "uncertainty.covariance", "rows of 3"),
        ("[nan, nan]]", "[nan]]", "uncertainty.standard_errors.thrust_N", "shape"),
        (", 0.0209]", "]", "uncertainty.bootstrap", "3 numbers"),
        ("packets = 40", "packets = 0", "delay_jitter.packets", "greater"),
    ],
)
def test_mistakes_are_reported_by_field(older, old, new, field, problem):
    assert old in OLDER
    with rejected("model.toml: ", match=problem, field=field):
        older(OLDER.replace(old, new, 1))


def test_published_models_are_read_by_name():
    assert read_model("paper:M3").parameters.transport_delay == 0.0208
    with pytest.raises(InputError, match="paper:M4"):
        read_model("paper:M9")


def test_a_bare_model_name_suggests_the_published_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"M3: there is no such file; .* are paper:M3"):
        read_model("M3")
    with pytest.raises(InputError, match=r"M9: there is no such file$"):
        read_model("M9")
    with pytest.raises(InputError, match="is a folder; a file is expected"):
        read_model(tmp_path)


@pytest.mark.parametrize(
    ("file", "read", "problem"),
    [
        ("craft", read_model, "is a vehicle; expected a model"),
        ("craft", read_mapping, "is a vehicle; expected a mapping"),
        ("craft", read_tuning, "is a vehicle; expected a controller tuning"),
        ("craft", airpuck.read_table, "is a vehicle; expected a table"),
        ("model", read_vehicle, "is a model; expected a vehicle"),
        ("model", airpuck.read_fleet, "is a model; expected a scenario of several craft"),
        ("table", read_model, "is a table; expected a model"),
    ],
)
def test_a_file_of_another_kind_is_identified(tmp_path, file, read, problem):
    made = {"craft": default_vehicle(), "model": published_model("M3"), "table": AirHockey()}
    made[file].save(tmp_path / f"{file}.toml")
    with pytest.raises(InputError, match=rf"{file}.toml: {problem}"):
        read(tmp_path / f"{file}.toml")


def test_a_kind_of_file_is_recognised_by_a_key_unique_to_its_schema():
    schemas = {
        "a model": ModelFile,
        "a vehicle": Vehicle,
        "a table": AirHockey,
        "settings of the twin": TwinSettings,
        "a controller tuning": Tuning,
        "a mapping of recordings": RecordingMapping,
        "a scenario of several craft": Scenario,
        "a campaign": Spec,
        "a plan of an excitation": ExcitationPlan,
    }
    owned = {kind: {*schema.__annotations__} for kind, schema in schemas.items()}
    owned["settings of the twin"] |= owned["a table"]
    tables = read_packaged("file_kinds.toml", dict[str, dict[str, str]])
    assert {*schemas} <= {*tables["certain"].values(), *tables["possible"].values()}
    for key, kind in tables["certain"].items():
        assert {name for name, keys in owned.items() if key in keys} <= {kind}, key
    for key, kind in (tables["certain"] | tables["possible"]).items():
        assert kind not in owned or key in owned[kind], key


def test_a_model_with_a_matrix_needs_three_rows(tmp_path):
    published_model("M4").save(tmp_path / "m.toml")
    content = tomllib.loads((tmp_path / "m.toml").read_text())
    content["parameters"]["configuration_matrix_SI"].pop()
    (tmp_path / "m.toml").write_text(tomli_w.dumps(content))
    with pytest.raises(InputError, match="3 rows of 6"):
        read_model(tmp_path / "m.toml")
