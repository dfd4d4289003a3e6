"""Comparable quantities must not depend on the arbitrary scale of M4's thrusts."""

from dataclasses import replace

import numpy as np

from airpuck.evaluation.presentation import physical_thrust, propeller_accelerations, thrust_scale
from airpuck.model.model_file import published_model

from ..apparatus.models import random_scales


def test_first_principles_models_have_scale_one():
    model = published_model("M3")
    np.testing.assert_array_equal(thrust_scale(model), np.ones(6))
    matrix = np.asarray(model.dynamics.configuration)
    np.testing.assert_allclose(model.vehicle.mass_kg * np.hypot(matrix[0], matrix[1]), 1)


def test_rescaling_does_not_change_the_comparison():
    published_m4 = published_model("M4")
    scales = random_scales(6)
    parameters = published_m4.parameters
    other = replace(
        published_m4,
        parameters=replace(
            parameters,
            thrust=scales[:, None] * parameters.thrust,
            configuration_matrix=parameters.configuration_matrix / scales,
        ),
    )
    np.testing.assert_allclose(physical_thrust(other), physical_thrust(published_m4))
    for ours, theirs in zip(
        propeller_accelerations(other), propeller_accelerations(published_m4), strict=True
    ):
        np.testing.assert_allclose(ours, theirs)


def test_accelerations_follow_newton():
    model = published_model("M3")
    linear, angular = propeller_accelerations(model)
    force = np.asarray(model.parameters.thrust) @ [1.0, 1.0, 1.0]
    np.testing.assert_allclose(linear, force / model.vehicle.mass_kg)
    assert (np.sign(angular) == [1, -1, 1, -1, 1, -1]).all()
