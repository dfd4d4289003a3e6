"""The parameter set and the rungs."""

import pickle
import sys
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from airpuck import Effect, InputError, Model, Pilot
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.model_file import read_model
from airpuck.model.parameters import change_degree, nominal_parameters
from airpuck.model.rungs import RUNGS, named_rung
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.thrust import thrust

VEHICLE = default_vehicle()
GRID = np.tile(np.linspace(0, 1, 201), (6, 1))


@pytest.mark.parametrize("name", [*RUNGS, "M4+drag+inflow+pair+sag+tilt"])
def test_parameters_round_trip_through_a_vector(name):
    parameters = named_rung(name).initial(VEHICLE)
    vector = parameters.to_vector() + 1.0
    moved = parameters.with_vector(vector)
    np.testing.assert_array_equal(moved.to_vector(), vector)
    assert len(vector) == len(parameters.labels(VEHICLE.propeller_names))
    assert len(set(parameters.labels(VEHICLE.propeller_names))) == len(vector)


# table:models, plus one offset of each coordinate of the centre of mass.
@pytest.mark.parametrize(
    ("name", "free", "tau"),
    [("M0", 18, 0), ("M1", 19, 0), ("M2", 19, 0.03), ("M3", 23, 0.03), ("M4", 37, 0.03)],
)
def test_rungs_match_the_paper(name, free, tau):
    parameters = RUNGS[name].initial(VEHICLE)
    assert RUNGS[name].mask(parameters).sum() == free
    assert parameters.motor_time_constant == tau
    assert parameters.inertia == 0.337e-3


def test_the_direct_matrix_starts_from_first_principles():
    direct = RUNGS["M4"].initial(VEHICLE)
    np.testing.assert_array_equal(
        direct.configuration_matrix,
        RUNGS["M3"].initial(VEHICLE).dynamics(np, VEHICLE).configuration,
    )


def test_quadratic_thrust_has_one_coefficient_per_propeller():
    parameters = RUNGS["quadratic"].initial(VEHICLE)
    mask = RUNGS["quadratic"].mask(parameters)
    assert mask[: parameters.thrust.size].sum() == 6
    assert (parameters.thrust[:, 0] == 0).all()
    nominal = thrust(VEHICLE.nominal_thrust, GRID)
    assert np.abs(thrust(parameters.thrust, GRID) - nominal).max() < 0.15


def test_raising_the_degree_changes_nothing():
    nominal = VEHICLE.nominal_thrust
    np.testing.assert_array_equal(thrust(change_degree(nominal, 5), GRID), thrust(nominal, GRID))


@pytest.mark.parametrize("degree", [1, 2])
def test_lowering_the_degree_fits_by_least_squares(degree):
    lowered = change_degree(VEHICLE.nominal_thrust, degree)
    # Against a dense fit by scipy's nodes: Gauss-Legendre quadrature of the squared distance.
    nodes, weights = np.polynomial.legendre.leggauss(20)
    x = (nodes + 1) / 2
    basis = x[:, None] ** np.arange(1, degree + 1)
    root = np.sqrt(weights)[:, None]
    target = thrust(VEHICLE.nominal_thrust[:1], x[None])[0][:, None]
    expected = np.linalg.lstsq(root * basis, root * target, rcond=None)[0][:, 0]
    np.testing.assert_allclose(lowered[0], expected, rtol=1e-8)


def test_nominal_parameters_come_from_the_vehicle():
    parameters = nominal_parameters(VEHICLE)
    assert parameters.inertia == VEHICLE.nominal.inertia_kg_m2
    np.testing.assert_array_equal(parameters.thrust, VEHICLE.nominal_thrust)


def test_terms_in_a_name_enable_effects():
    rung = named_rung("M3+inflow+pair")
    assert (rung.name, rung.effects) == ("M3+inflow+pair", ("inflow", "pair_interaction"))
    parameters = rung.initial(VEHICLE)
    assert parameters.effects == {"inflow", "pair_interaction"}
    assert rung.mask(parameters).sum() == 25
    kinds = [type(effect).__name__ for effect in parameters.dynamics(np, VEHICLE).effects]
    assert kinds == ["Inflow", "PairInteraction"]
    assert RUNGS["M3"].initial(VEHICLE).dynamics(np, VEHICLE).effects == ()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("M3+wind", "term .wind"),
        ("M3+", "no term ''"),
        ("M3+sag+sag", "twice"),
        ("M99", "M0, M1.*auto"),
    ],
)
def test_unknown_terms_are_rejected(name, told):
    with pytest.raises(InputError, match=told):
        named_rung(name)


@dataclass(frozen=True, eq=False)
class TailWind(Effect):
    """A wind in the table's frame, and a loss of thrust."""

    push: float = 0.2
    loss: float = 0.1
    axes: Any = None
    unit = "m/s², 1"
    bounds: ClassVar = {"loss": (0.0, 0.5)}

    @classmethod
    def of(cls, layout, value):
        return cls(*value, layout.vehicle.n_propellers)

    def acceleration(self, xp, motion):
        return self.push * motion.cos, -self.push * motion.sin, 0.0

    def thrust(self, xp, thrust, motion):
        return thrust * (1 - self.loss)


def test_coefficients_of_a_user_effect_are_parameters():
    rung = named_rung("M3+drag").with_effect(TailWind, start={"push": 0.3})
    parameters = rung.initial(VEHICLE)
    assert parameters.tail_wind.tolist() == [0.3, 0.1]
    assert parameters.to_vector()[-2:].tolist() == [0.3, 0.1]
    labels = parameters.labels(VEHICLE.propeller_names)
    assert labels[-2:] == ["tail_wind push", "tail_wind loss"]
    assert rung.mask(parameters)[-2:].all()
    lower, upper = parameters.bounds()
    assert (lower[-2:].tolist(), upper[-2:].tolist()) == ([-np.inf, 0.0], [np.inf, 0.5])
    moved = parameters.with_vector(2 * parameters.to_vector())
    assert moved.tail_wind.tolist() == [0.6, 0.2]
    effect = moved.dynamics(np, VEHICLE).effects[-1]
    assert (effect.push, effect.loss, effect.axes) == (0.6, 0.2, 6)
    again = pickle.loads(pickle.dumps(moved))
    assert again.tail_wind.tolist() == [0.6, 0.2]
    assert again.effects == {"drag", "tail_wind"}


def test_a_model_with_a_user_effect_round_trips(tmp_path):
    rung = named_rung("M3").with_effect(TailWind, bounds={"push": (-1.0, 1.0)})
    parameters = rung.initial(VEHICLE)
    known = Uncertainty(
        parameters.to_vector(), np.eye(26), 1 + np.arange(26.0), np.zeros((0, 26)), 9, 2.3
    )
    model = Model(rung.name, VEHICLE, parameters, rung.mask(parameters), uncertainty=known)
    model.save(tmp_path / "model.toml")
    read = read_model(tmp_path / "model.toml")
    np.testing.assert_array_equal(read.parameters.to_vector(), parameters.to_vector())
    np.testing.assert_array_equal(read.known.standard_errors, known.standard_errors)
    np.testing.assert_array_equal(read.parameters.bounds(), parameters.bounds())
    assert read.rung == rung
    assert read.free.sum() == model.free.sum() == 25


def test_a_model_file_runs_no_code_that_was_not_requested(tmp_path):
    rung = named_rung("M3").with_effect(TailWind)
    parameters = rung.initial(VEHICLE)
    path = tmp_path / "model.toml"
    Model(rung.name, VEHICLE, parameters, rung.mask(parameters)).save(path)
    text = path.read_text("utf-8")
    path.write_text(text.replace(f"{__name__}:TailWind", "elsewhere:TailWind"), "utf-8")
    with pytest.raises(InputError, match=r"code that is not in the file.* append \+elsewhere"):
        read_model(path)
    assert "elsewhere" not in sys.modules
    read = read_model(path, effects=[TailWind])
    assert read.parameters.tail_wind.tolist() == [0.2, 0.1]
    path.write_text(text.replace("loss = [0.0", "lost = [0.0"), "utf-8")
    with pytest.raises(InputError, match="lost"):
        read_model(path, effects=[TailWind])


def changed(**space):
    """Return an effect like `TailWind`, but for these attributes."""
    return dataclass(frozen=True, eq=False)(type("Gust", (TailWind,), space))


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        (Pilot, "must be a dataclass that inherits"),
        (changed(idle_lag=0.3), "changes the motors' lag"),
        (changed(bounds={"pull": (0.0, 1.0)}), "no such coefficient.*pull"),
        (changed(bounds={"push": (0.3, 1.0)}), "starts with push = 0.2, outside its bounds"),
        (changed(acceleration=lambda self, xp, motion: 1 / 0), "fails at rest: ZeroDivisionError"),
        (changed(acceleration=lambda self, xp, motion: (0, 0)), "three accelerations"),
        (changed(thrust=lambda self, xp, thrust, motion: 0.0), "in the shape that it is given"),
    ],
)
def test_an_invalid_effect_is_rejected_before_a_fit(effect, told):
    with pytest.raises(InputError, match=told):
        named_rung("M3").with_effect(effect).initial(VEHICLE)


def test_an_effect_is_added_only_once():
    with pytest.raises(InputError, match="already"):
        named_rung("M3").with_effect(TailWind).with_effect(TailWind)
