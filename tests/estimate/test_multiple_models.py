"""Competing states of the craft against Gaussian conditioning and Bayes' rule by hand."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.craft.vehicle import GRAVITY
from airpuck.estimate.axis_filter import Noise
from airpuck.estimate.multiple_models import Memory, MultipleModels, States, sensitivity, with_slope
from airpuck.model.model_file import published_model, read_model
from airpuck.physics.effects import Drag
from airpuck.physics.rigid_body import acceleration

DYNAMICS = read_model("paper:M3").dynamics
NOISE = Noise((1e-4, 1e-4, 1e-3), (0.1, 0.1, 2.0), (0.2, 0.2, 3.0))
SIZE = 16  # nine of the axes, six motors, the delay


def states(count, tempering=1.0, tail=1e9):
    """With this many degrees of freedom, innovations are normal."""
    rng = np.random.default_rng(3)
    roots = 0.1 * rng.normal(size=(count, 7, 7))
    weight = rng.uniform(0.5, 1.5, count)
    names = tuple(str(k) for k in range(count))
    return States(names, weight / weight.sum(), roots @ roots.swapaxes(1, 2), 3.0, tail, tempering)


def belief(count, seed=0):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, SIZE, SIZE))
    weights = rng.uniform(0.5, 1.5, count)
    covariances = roots @ roots.swapaxes(1, 2) + np.eye(SIZE)
    means = 0.1 * rng.normal(size=(count, SIZE))
    return means, covariances, weights / weights.sum(), np.zeros(3)


def test_a_measurement_applies_conditioning_and_bayes_rule():
    models = MultipleModels(DYNAMICS, NOISE, states(3))
    means, covariances, weights, density = given = belief(3)
    rng = np.random.default_rng(5)
    rows, variances = rng.normal(size=(2, SIZE)), np.array([0.3, 0.7])
    reference = weights @ means
    innovations = np.array([0.4, -0.6])
    found, less, posterior, kept = models.measure(np, given, rows, innovations, variances)
    np.testing.assert_array_equal(kept, density)
    evidence = []
    for k in range(3):
        expected = rows @ covariances[k] @ rows.T + np.diag(variances)
        gain = covariances[k] @ rows.T @ np.linalg.inv(expected)
        surprise = innovations - rows @ (means[k] - reference)
        np.testing.assert_allclose(found[k], means[k] + gain @ surprise)
        np.testing.assert_allclose(less[k], covariances[k] - gain @ rows @ covariances[k])
        normal = -surprise @ np.linalg.solve(expected, surprise) / 2
        evidence.append(np.log(weights[k]) + normal - np.linalg.slogdet(expected)[1] / 2)
    expected = np.exp(np.array(evidence) - max(evidence))
    np.testing.assert_allclose(posterior, expected / expected.sum(), rtol=1e-4)


def test_evidence_is_tempered_and_outliers_are_downweighted():
    given = belief(3)
    rows, variances = np.eye(SIZE)[:1], np.array([1e-3])

    def weights(innovation, **options):
        models = MultipleModels(DYNAMICS, NOISE, states(3, **options))
        return models.measure(np, given, rows, np.array([innovation]), variances)[2]

    # The power of the likelihood scales the change of the log odds.
    full, half = weights(1.0), weights(1.0, tempering=0.5)
    change = [np.log(after / given[2]) for after in (full, half)]
    np.testing.assert_allclose(
        change[1] - change[1][0], 0.5 * (change[0] - change[0][0]), atol=1e-6
    )
    # With few degrees of freedom an innovation far out decides less.
    far, robust = weights(5.0), weights(5.0, tail=3.0)
    assert np.ptp(np.log(robust / given[2])) < np.ptp(np.log(far / given[2]))


def test_an_outlier_of_all_states_is_a_knock_and_changes_only_velocities():
    models = MultipleModels(DYNAMICS, NOISE, states(2))
    means, _, *weights = belief(2)
    means[:, 3] = 0.2
    covariances = np.repeat(np.diag([1e-6] * 9 + [1e-2] * 7)[None], 2, axis=0)
    rows, exact = np.eye(SIZE)[3:4], np.array([1e-6])  # the velocity along x
    # A measurement as precise as the estimate counts half; beyond eight deviations, fully.
    for deviations, counts in ((4.5, 0.5), (7.5, 0.5), (8.5, 1.0), (50.0, 1.0)):
        innovation = np.array([deviations * np.sqrt(2e-6)])
        before = means, covariances, *weights
        found, less, *_ = models.measure(np, before, rows, innovation, exact)
        np.testing.assert_allclose(found[:, 3], 0.2 + counts * innovation[0], rtol=1e-4)
        others = np.delete(np.arange(SIZE), 3)
        np.testing.assert_allclose(found[:, others], means[:, others])
        # Speed is as unknown as at first, and spin ten times as much.
        if counts == 1.0:
            np.testing.assert_allclose(np.diag(less[0])[4:6], [0.25, 25.0], rtol=1e-4)


def test_mixing_over_time_preserves_mean_and_covariance():
    models = MultipleModels(DYNAMICS, NOISE, states(3))
    before = belief(3)
    means, covariances, weights, _ = models.renewed(np, before, 1.5)
    # Each state lasts with probability exp(-t / T); the weights relax to the prior's.
    same = np.exp(-1.5 / 3.0)
    np.testing.assert_allclose(weights, same * before[2] + (1 - same) * models.states.weight)
    # Mixing does not change the knowledge about the axes.
    ours, theirs = (
        (w @ m, np.einsum("h,hij->ij", w, c + m[:, :, None] * m[:, None, :]))
        for m, c, w, *_ in ((means, covariances, weights), before)
    )
    np.testing.assert_allclose(ours[0][:9], theirs[0][:9])
    np.testing.assert_allclose(ours[1][:9, :9], theirs[1][:9, :9])
    # After a long time, all knowledge about the motors is lost.
    means, covariances, *_ = models.renewed(np, before, 100.0)
    np.testing.assert_allclose(means[:, 9:], 0.0, atol=1e-12)
    np.testing.assert_allclose(covariances[:, 9:, 9:], models.states.covariance, atol=1e-9)


def test_exact_mouse_and_gyro_determine_velocity_and_spin():
    models = MultipleModels(DYNAMICS, NOISE, states(1))
    known = belief(1)
    yaw = known[0][0, 2]
    body = np.array([0.2, -0.1])
    found, less, *_ = models.use_mouse(known, body, 1e-6)
    world = complex(*body) * np.exp(1j * yaw)
    np.testing.assert_allclose(found[0, 3:5], [world.real, world.imag], atol=1e-6)
    np.testing.assert_allclose(np.diag(less[0])[3:5], 0.0, atol=1e-9)
    speed = np.full(6, 0.3)
    exact = (1e-6, 1e-6)
    found, less, *_ = models.use_imu(known, (speed, speed), np.array([0.1, 0.2]), 0.7, exact)
    assert found[0, 5] == pytest.approx(0.7, abs=1e-5)
    assert less[0, 5, 5] < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.5, 1.7])
def test_a_learning_craft_estimates_the_density_of_unmodelled_accelerations(ratio):
    """The poses of an idle craft, pushed by white accelerations of a known density."""
    # Five more unknowns: drag, centre of mass and slope.
    priors = np.pad(states(1).covariance, ((0, 0), (0, 5), (0, 5)))
    learns = replace(states(1), covariance=priors, memory=Memory(120.0, 1.0, 0.0))
    models, random, period = MultipleModels(DYNAMICS, NOISE, learns), np.random.default_rng(1), 0.01
    density = ratio * np.array(NOISE.acceleration)
    # Exact steps of a double integrator that white noise drives.
    root = np.linalg.cholesky([[period**3 / 3, period**2 / 2], [period**2 / 2, period]])
    known, motion, found = models.begin(np.zeros(3), None, 0.0), np.zeros((2, 3)), []
    idle, pieces = np.zeros(6), (np.array([period]), np.zeros((1, 6)))
    for _ in range(3000):
        motion[0] += period * motion[1]
        motion += root @ random.normal(size=(2, 3)) * density
        pose = motion[0] + random.normal(size=3) * NOISE.pose
        *known, idle, _ = models.use_pose(np, *known, idle, *pieces, pose)
        found.append(known[3])
    found_ratio = np.exp(np.mean(found[1500:], axis=0) / 2)
    np.testing.assert_allclose(found_ratio, ratio, rtol=0.15)
    assert found[-1][0] == found[-1][1]


def test_without_learning_the_density_is_unchanged():
    models = MultipleModels(DYNAMICS, NOISE, states(1))
    known = models.begin(np.zeros(3), None, 0.0)
    pieces = np.zeros(6), np.array([0.01]), np.zeros((1, 6))
    assert not models.use_pose(np, *known, *pieces, np.full(3, 0.01))[3].any()


MOTION = 0.7, 0.3, -0.5, 4.0  # yaw, velocity, spin
SPEEDS = np.array([0.9, 0.1, 0.4, 0.2, 0.8, 0.3])


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_learned_drag_and_mass_offset_act_like_modelled_ones(share):
    model = replace(published_model("M3"), frame="body")
    parameters, step = model.parameters, 1e-6
    gyration = model.radius_of_gyration**2
    given = MOTION, SPEEDS, SPEEDS, share * np.ones(6), gyration
    _, by_e = sensitivity(np, model.dynamics, *given)

    def rates(offset=(0.0, 0.0), drag=0.0):
        center = parameters.center_of_mass + np.array(offset)
        moved = replace(parameters, center_of_mass=center, thrust=share * parameters.thrust)
        dynamics = replace(model, parameters=moved).dynamics
        dynamics = replace(dynamics, effects=(Drag(drag),))
        return np.array(acceleration(np, dynamics, MOTION, SPEEDS))

    changes = {"drag": step}, {"offset": (step, 0.0)}, {"offset": (0.0, step)}
    for column, change in zip(by_e.T[7:10], changes, strict=True):
        expected = (rates(**change) - rates()) / step
        # Terms of second order in the offset of the centre of mass are left out.
        np.testing.assert_allclose(column, expected, rtol=0.01, atol=0.1)
        assert np.abs(expected).max() > 0.2
    assert not by_e[:, 10:].any()


def test_laws_do_not_use_learned_drag_and_offsets():
    priors = np.pad(states(1).covariance, ((0, 0), (0, 5), (0, 5)))
    learns = replace(states(1), covariance=priors, memory=Memory(120.0, 1.0, 0.0))
    models = MultipleModels(DYNAMICS, NOISE, learns)
    means, covariances = np.zeros((1, SIZE + 5)), 1e-4 * np.eye(SIZE + 5)[None]
    means[0, 3:5], means[0, 6:8], means[0, SIZE:] = (0.4, -0.2), (0.05, 0.03), 0.5
    # Together with drag the disturbance was found; without it, it would be 0.4 times as much less.
    covariances[0, 6, SIZE] = covariances[0, SIZE, 6] = 4e-5
    idle, now = np.zeros(6), (np.zeros(1), np.zeros((1, 6)))
    given = means, covariances, np.ones(1), np.zeros(3), idle, *now
    disturbance = models.predict(np, *given)[2]
    np.testing.assert_allclose(disturbance, [0.05 - 0.4 * 0.5, 0.03, 0.0], atol=1e-9)


def test_the_slope_is_the_mean_of_a_white_disturbance():
    """Posterior of a constant in white noise of 0.1 m/s²/√Hz, from a prior of 5 mrad."""
    means, _, *rest = belief(1)
    means = np.pad(means, ((0, 0), (0, 5)))
    means[0, 6:8] = 0.05, -0.08
    covariances = np.diag([1e-9] * (SIZE + 3) + [25e-6] * 2)[None]
    known, seconds = (means, covariances, *rest), 20
    for _ in range(240 * seconds):
        known = with_slope(np, known, 1 / 240)
    variance = 1 / (1 / 25e-6 + seconds * GRAVITY**2 / 0.1**2)
    np.testing.assert_allclose(known[1][0, -2:, -2:], variance * np.eye(2), rtol=1e-5)
    np.testing.assert_allclose(known[1][0, :-2, :-2], covariances[0, :-2, :-2])
    share = 1 - variance / 25e-6
    np.testing.assert_allclose(known[0][0, -2:], share * np.array([0.05, -0.08]) / GRAVITY, 1e-5)
    # A contact pushes harder than that, but counts as 0.3 m/s².
    means[0, 6] = 30.0
    pushed = with_slope(np, (means, covariances, *rest), 1 / 240)[0]
    gain = 25e-6 / (25e-6 + 240 * (0.1 / GRAVITY) ** 2)
    assert pushed[0, -2] == pytest.approx(gain * 0.3 / GRAVITY, rel=1e-5)
    # One that is known to 1 m/s² counts less: its error lasts for a second.
    covariances[0, 6, 6] = 1.0
    unsure = with_slope(np, (means, covariances, *rest), 1 / 240)[0]
    assert unsure[0, -2] == pytest.approx(gain * 0.3 / GRAVITY * 0.01 / 2.01, rel=0.02)
