"""Estimated motor effectiveness, against dense Gaussian conditioning and made-up failures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from airpuck import InputError, PaperEncoder
from airpuck.data.windows import Past, make_windows
from airpuck.deviation.motor_regression import accelerations_by_motor, following, twice_integrated

# The regression is written down again by hand, from the same motion and motor speeds.
from airpuck.estimate.actuation import ActuationEncoder, EffectivenessPrior, _motion
from airpuck.evaluation.evaluate import PROTOCOLS, evaluate
from airpuck.identification.fit import identify
from airpuck.model.model_file import published_model
from airpuck.physics.effects import Drag, Inflow, Layout, PairInteraction
from airpuck.physics.rigid_body import acceleration
from airpuck.recording.torch_archive import read_authors_experiment

from ..apparatus.models import scaled
from ..apparatus.public_recordings import TRAINING, VALIDATION
from ..apparatus.synthetic_flights import fly

MODEL = replace(published_model("M3"), indexing="start")
#: For exact states: almost no noise.
EXACT = ActuationEncoder(
    pose_noise=(1e-6, 1e-5), velocity_noise=(1e-5, 1e-4), disturbance=(1e-3, 1e-2)
)


def past_of(flight, length=40, stride=35):
    return make_windows(flight, length, 50, stride).past()


@pytest.fixture(scope="module")
def flight():
    return fly(MODEL, duration=5.0)


def test_a_healthy_craft_is_reported_as_healthy(flight):
    past = past_of(flight)
    found = EXACT.estimate(MODEL.dynamics, past)
    # Motors whose command had changed just before a window make the estimates of others uncertain.
    off = np.abs(found.effectiveness - 1)
    assert np.median(off) < 0.01
    assert np.mean(off < 3 * found.deviation + 0.01) > 0.9
    assert np.median(np.abs(found.state[:6] - past.state[-1])) < 1e-4
    assert np.median(found.probability[0]) > 0.5
    np.testing.assert_allclose(found.probability.sum(axis=0), 1.0)


@pytest.mark.parametrize("motor", range(6))
def test_a_weak_motor_is_named(motor):
    share = np.ones(6)
    share[motor] = 0.4
    past = past_of(fly(scaled(MODEL, share), duration=5.0, seed=motor))
    found = EXACT.estimate(MODEL.dynamics, past)
    # A motor that was barely used cannot be judged; its standard deviation shows this.
    told = found.deviation[motor] < 0.05
    assert told.sum() > 5
    assert np.median(found.effectiveness[motor, told]) == pytest.approx(0.4, abs=0.02)
    assert np.mean(np.abs(found.effectiveness[motor, told] - 0.4) < 0.1) > 0.85
    others = np.delete(np.arange(6), motor)
    assert abs(np.median(found.effectiveness[others]) - 1) < 0.02
    assert np.median(found.probability[2, told]) > 0.9


def test_losing_all_motors_is_distinguished_from_losing_one():
    past = past_of(fly(scaled(MODEL, [0.5] * 6), duration=5.0))
    found = EXACT.estimate(MODEL.dynamics, past)
    assert np.median(found.probability[1]) > 0.9
    np.testing.assert_allclose(np.median(found.effectiveness, axis=1), 0.5, atol=0.05)


def test_predictions_improve_for_a_craft_that_lost_thrust():
    flight = fly(scaled(MODEL, [0.6] * 6), duration=6.0)
    paper, actuation = (
        evaluate(MODEL, flight, encoder=e, protocol=PROTOCOLS["paper-long"]).rmse
        for e in (PaperEncoder(), EXACT)
    )
    assert (actuation < 0.3 * paper).all()


@pytest.mark.parametrize("lost", [[], [3, 7], [0, 11]])
@pytest.mark.parametrize("velocity", ["smoothed", "causal"])
@pytest.mark.parametrize("disturbance", [(0.086, 2.1), (1e-3, 1e-2)])
def test_the_regression_equals_gaussian_conditioning(flight, velocity, disturbance, lost):
    """Against the joint normal distribution of everything, its dense covariance written down."""
    prior = EffectivenessPrior(1.0, 0.2, 0.1)
    encoder = ActuationEncoder(velocity=velocity, disturbance=disturbance, priors=(prior,))
    whole = past_of(flight, 12, 300)
    past = Past(whole.state[..., :1], whole.command[..., :1], whole.duration[..., :1])
    rng = np.random.default_rng(0)
    past.state[:, :3] += rng.normal(size=past.state[:, :3].shape) * 1e-3
    seen = np.delete(np.arange(12), lost)
    found = encoder.estimate(
        MODEL.dynamics, replace(past, measured=np.isin(np.arange(12), seen)[:, None])
    )

    speed = following(MODEL.dynamics, past.command[0], past.command[:-1], past.duration)
    by_motor, rest = accelerations_by_motor(MODEL.dynamics, _motion(past, encoder.causal), speed)
    basis = twice_integrated(by_motor, past.duration)[..., 0]
    whole = twice_integrated(rest + by_motor.sum(axis=2), past.duration)
    offset = whole[..., 0]
    elapsed = np.cumsum(np.insert(past.duration[:, 0], 0, 0.0))
    elapsed -= elapsed[-1]
    # The prior of pose and speed is so wide that it has no effect.
    size, wide = 12, np.diag([300.0] * 6)
    before = np.block([[wide, np.zeros((6, 6))], [np.zeros((6, 6)), prior.covariance(6)]])
    rows, noise = [], []
    step = float(np.median(past.duration))
    for c in range(3):
        block = np.zeros((size, 12))
        block[:, c], block[:, 3 + c], block[:, 6:] = 1, elapsed, basis[:, c]
        rows.append(block[seen])
        noise.append(covariance(encoder, c, size, step)[np.ix_(seen, seen)])
    measured = [(past.state[:, c, 0] - past.state[-1, c, 0] - offset[:, c]) for c in range(3)]
    measured = [values[seen] for values in measured]
    if velocity == "smoothed":
        for c in range(3):
            rows.append(np.eye(12)[3 + c : 4 + c])
            noise.append(np.array([[encoder.velocity_noise[c // 2] ** 2]]))
            measured.append(past.state[-1, 3 + c])
    matrix, y = np.concatenate(rows), np.concatenate(measured)
    spread = np.zeros((len(y), len(y)))
    at = 0
    for block in noise:
        spread[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    gain = before @ matrix.T @ np.linalg.inv(matrix @ before @ matrix.T + spread)
    mean, after = gain @ y, before - gain @ matrix @ before
    np.testing.assert_allclose(found.effectiveness[:, 0] - 1, mean[6:], atol=2e-4)
    np.testing.assert_allclose(found.deviation[:, 0], np.sqrt(np.diag(after)[6:]), rtol=1e-3)
    moved = found.state[:6, 0] - np.concatenate([past.state[-1, :3, 0], np.zeros(3)])
    np.testing.assert_allclose(moved, mean[:6], atol=2e-4)


def test_the_position_at_a_lost_frame_is_ignored(flight):
    lost = flight.time[np.random.default_rng(1).random(len(flight)) < 0.1]
    windows = make_windows(replace(flight, lost=lost), 40, 50, 35)
    past, moved = windows.past(), windows.past()
    assert 0 < (~past.measured).sum() < 0.3 * past.measured.size
    moved.state[:, :2] += 0.01 * ~moved.measured[:, None]
    before, after = (ActuationEncoder().estimate(MODEL.dynamics, one) for one in (past, moved))
    for name in ("effectiveness", "deviation", "probability"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-9)
    np.testing.assert_allclose(after.state, before.state, atol=1e-9)


def test_priors_are_weighted_by_their_evidence(flight):
    """With normal noise and no tempering, the weights follow Bayes' rule."""
    priors = (EffectivenessPrior(0.7, 0.05, 0.05), EffectivenessPrior(0.3, 0.3, 0.2))
    whole = past_of(flight, 12, 300)
    past = Past(whole.state[..., :1], whole.command[..., :1], whole.duration[..., :1])
    encoder = ActuationEncoder(priors=priors, tail=1e9, tempering=1.0)
    found = encoder.estimate(MODEL.dynamics, past)
    weights = []
    for prior in priors:
        # The density of the residuals, which has 6 dimensions less than the measurements:
        # p and v have no prior.
        weights.append(np.log(prior.weight) + contrast_density(encoder, past, prior))
    weights = np.exp(np.array(weights) - max(weights))
    np.testing.assert_allclose(found.probability[:, 0], weights / weights.sum(), rtol=1e-4)


def covariance(encoder, c, size, step):
    """From the poses' noise, white accelerations, and unknown initial motor speeds."""
    doubled = np.array(
        [
            twice_integrated(column[:, None], np.full((size - 1, 1), step))[:, 0]
            for column in np.eye(size)
        ]
    ).T
    pose, density = encoder.pose_noise[c // 2], encoder.disturbance[c // 2]
    slope = MODEL.parameters.thrust @ [1.0, 1.0, 0.75]
    first = 0.2 * np.sqrt(((MODEL.dynamics.configuration * slope) ** 2).sum(axis=1))
    first = first[2] if c == 2 else first[:2].mean()
    fading = doubled @ np.exp(-np.arange(size) * step / MODEL.parameters.motor_time_constant)
    return (
        pose**2 * np.eye(size)
        + density**2 / step * doubled @ doubled.T
        + first**2 * np.outer(fading, fading)
    )


def contrast_density(encoder, past, prior):
    """Log density of those contrasts of the measurements that do not depend on pose and speed."""
    size, step = len(past.state), float(np.median(past.duration))
    speed = following(MODEL.dynamics, past.command[0], past.command[:-1], past.duration)
    by_motor, rest = accelerations_by_motor(MODEL.dynamics, _motion(past, encoder.causal), speed)
    basis = twice_integrated(by_motor, past.duration)
    offset = twice_integrated(rest, past.duration) + basis.sum(axis=-2)
    elapsed = np.cumsum(np.insert(past.duration[:, 0], 0, 0.0))
    y, nuisance, motors, spread = [], [], [], []
    for c in range(3):
        y += [*(past.state[:, c, 0] - past.state[-1, c, 0] - offset[:, c, 0])]
        y += [past.state[-1, 3 + c, 0]]
        block = np.zeros((size + 1, 6))
        block[:-1, c], block[:-1, 3 + c], block[-1, 3 + c] = 1, elapsed - elapsed[-1], 1
        nuisance.append(block)
        motors.append(np.concatenate([basis[:, c, :, 0], np.zeros((1, 6))]))
        noise = np.zeros((size + 1, size + 1))
        noise[:-1, :-1] = covariance(encoder, c, size, step)
        noise[-1, -1] = encoder.velocity_noise[c // 2] ** 2
        spread.append(noise)
    n = size + 1
    cover = np.zeros((3 * n, 3 * n))
    for c in range(3):
        cover[c * n : c * n + n, c * n : c * n + n] = spread[c]
    motors = np.concatenate(motors)
    cover += motors @ prior.covariance(6) @ motors.T
    free = np.linalg.svd(np.concatenate(nuisance).T)[2][6:]
    return multivariate_normal.logpdf(free @ np.array(y), cov=free @ cover @ free.T)


def test_no_future_data_are_used(flight):
    windows = make_windows(flight, 20, 50, 70)
    rng = np.random.default_rng(0)
    for k in (3, 7):
        last = windows.present[k]
        touched = flight.state.copy()
        touched[last + 1 :] += rng.normal(size=touched[last + 1 :].shape)
        # Smoothed velocities look ahead, so a causal encoder must not look at any of them.
        touched[:, 3:] = rng.normal(size=(len(flight), 3))
        encoder = ActuationEncoder(velocity="causal")
        states = []
        for state in (flight.state, touched):
            moved = replace(flight, state=state)
            past = make_windows(moved, 20, 50, 70).past(windows.starts[k : k + 1], 20)
            states.append(encoder.estimate(MODEL.dynamics, past))
        np.testing.assert_array_equal(states[0].state, states[1].state)
        np.testing.assert_array_equal(states[0].effectiveness, states[1].effectiveness)


def test_windows_are_estimated_independently(flight):
    past = past_of(flight, 20, 70)
    encoder = ActuationEncoder()
    whole = encoder.estimate(MODEL.dynamics, past)
    one = encoder.estimate(
        MODEL.dynamics, Past(past.state[..., 2:3], past.command[..., 2:3], past.duration[..., 2:3])
    )
    np.testing.assert_allclose(whole.state[:, 2:3], one.state, atol=1e-9)
    np.testing.assert_allclose(whole.effectiveness[:, 2:3], one.effectiveness, atol=1e-6)


def test_the_effects_of_all_motors_sum_to_the_acceleration(flight):
    effects = (
        Inflow.of(Layout(MODEL.vehicle), 0.1),
        PairInteraction.of(Layout(MODEL.vehicle), 2.0),
        Drag(0.3, 0.2, 0.1, 0.05),
    )
    dynamics = replace(MODEL.dynamics, effects=effects)
    past = past_of(flight, 20, 100)
    speed = following(dynamics, past.command[0], past.command[:-1], past.duration)
    by_motor, rest = accelerations_by_motor(dynamics, past.state, speed)
    for k in (0, 7, 19):
        whole = np.array(acceleration(np, dynamics, past.state[k, 2:6], speed[k]))
        np.testing.assert_allclose(by_motor[k].sum(axis=1) + rest[k], whole, atol=1e-12)


def test_the_papers_encoder_is_rejected_by_the_causal_protocol(flight):
    with pytest.raises(InputError, match="looks ahead"):
        evaluate(MODEL, flight, protocol=PROTOCOLS["causal"])
    with pytest.raises(InputError, match="must be 'paper' or 'actuation'"):
        evaluate(MODEL, flight, encoder="kalman")


#: Largest allowed errors on the paper's validation experiment: x, y [m], yaw [rad].
REACHED = {
    "paper": (0.0076, 0.0088, 0.27),
    "paper-long": (0.0072, 0.0085, 0.24),
    "causal": (0.0108, 0.0098, 0.387),
}


@pytest.fixture(scope="module")
def real(experiments):
    """M3 of the training experiment alone, and the validation experiment."""
    training, validation = (
        read_authors_experiment(experiments / name / "data.pt") for name in (TRAINING, VALIDATION)
    )
    return identify(training, "M3").model, validation


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("protocol", REACHED)
def test_predictions_on_the_papers_windows_are_accurate(protocol, real):
    model, validation = real
    evaluation = evaluate(model, validation, protocol=PROTOCOLS[protocol], encoder="actuation")
    assert len(evaluation.start) == 334
    assert evaluation.left_out == 0
    assert (evaluation.rmse <= REACHED[protocol]).all()
    published = evaluate(published_model("M3"), validation)
    np.testing.assert_array_equal(evaluation.start, published.start)
