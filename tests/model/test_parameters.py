"""The parameter set and the rungs."""

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.model.parameters import change_degree, nominal_parameters
from airpuck.model.rungs import RUNGS, named_rung
from airpuck.physics.thrust import thrust

VEHICLE = default_vehicle()
GRID = np.tile(np.linspace(0, 1, 201), (6, 1))


@pytest.mark.parametrize("name", [*RUNGS, "M4+drag+inflow+pair+sag+tilt"])
def test_vector_and_back(name):
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
def test_rungs_are_those_of_the_paper(name, free, tau):
    parameters = RUNGS[name].initial(VEHICLE)
    assert RUNGS[name].mask(parameters).sum() == free
    assert parameters.motor_time_constant == tau
    assert parameters.inertia == 0.337e-3


def test_the_direct_matrix_starts_at_first_principles():
    direct = RUNGS["M4"].initial(VEHICLE)
    np.testing.assert_array_equal(
        direct.configuration_matrix,
        RUNGS["M3"].initial(VEHICLE).dynamics(np, VEHICLE).configuration,
    )


def test_classical_thrust_has_one_number_per_propeller():
    parameters = RUNGS["quadratic"].initial(VEHICLE)
    mask = RUNGS["quadratic"].mask(parameters)
    assert mask[: parameters.thrust.size].sum() == 6
    assert (parameters.thrust[:, 0] == 0).all()
    nominal = thrust(VEHICLE.nominal_thrust, GRID)
    assert np.abs(thrust(parameters.thrust, GRID) - nominal).max() < 0.15


def test_unknown_rung():
    with pytest.raises(InputError, match="M0, M1"):
        named_rung("M99")


def test_raising_the_degree_changes_nothing():
    nominal = VEHICLE.nominal_thrust
    np.testing.assert_array_equal(thrust(change_degree(nominal, 5), GRID), thrust(nominal, GRID))


@pytest.mark.parametrize("degree", [1, 2])
def test_lowering_the_degree_is_least_squares(degree):
    lowered = change_degree(VEHICLE.nominal_thrust, degree)
    # Against a dense fit by scipy's nodes: Gauss-Legendre quadrature of the squared distance.
    nodes, weights = np.polynomial.legendre.leggauss(20)
    x = (nodes + 1) / 2
    basis = x[:, None] ** np.arange(1, degree + 1)
    root = np.sqrt(weights)[:, None]
    target = thrust(VEHICLE.nominal_thrust[:1], x[None])[0][:, None]
    expected = np.linalg.lstsq(root * basis, root * target, rcond=None)[0][:, 0]
    np.testing.assert_allclose(lowered[0], expected, rtol=1e-8)


def test_nominal_is_the_vehicles():
    parameters = nominal_parameters(VEHICLE)
    assert parameters.inertia == VEHICLE.nominal.inertia_kg_m2
    np.testing.assert_array_equal(parameters.thrust, VEHICLE.nominal_thrust)


def test_terms_of_a_name_are_switches():
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
    [("M3+wind", "no term 'wind'"), ("M3+", "no term ''"), ("M3+sag+sag", "twice"), ("sag", "M0")],
)
def test_unknown_terms_are_refused(name, told):
    with pytest.raises(InputError, match=told):
        named_rung(name)
