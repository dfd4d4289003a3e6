"""Standard errors: against hand calculations, against truth, and missing ones."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import default_vehicle
from airpuck.evaluation.presentation import physical_thrust
from airpuck.identification.fit import identifiability, identify
from airpuck.identification.objective import Quadratic
from airpuck.identification.problem import prediction_loss
from airpuck.identification.settings import Loss, Preparation
from airpuck.identification.uncertainty import (
    binding_constraints,
    cluster_windows,
    grown,
    identifiability_of,
    sandwich,
    shared_at_borders,
    subspace,
    varying,
    widened,
    with_lag_squared,
    without_meaningless,
)
from airpuck.model.model_file import nominal_model, read_model
from airpuck.model.parameters import fix_gauge, gauge_directions, nominal_parameters
from airpuck.model.rungs import RUNGS, named_rung
from airpuck.model.uncertainty import Uncertainty

from ..apparatus.beliefs import uncertainty
from ..apparatus.disturbed_flights import TRUTH, noisy
from ..apparatus.plain_loss import differences, plain_residuals

VEHICLE = default_vehicle()
LAG_AND_DELAY = frozenset({"motor_time_constant", "transport_delay"})
NAMES = VEHICLE.propeller_names


def clustered_loss():
    return prediction_loss(Loss(spacing=29 / 240), [noisy()], VEHICLE)


def along(quadratic, parameters, free, shared=0.0):
    """As in a fit: along the active constraints."""
    return sandwich(quadratic, parameters, varying(quadratic.hessian, parameters, free), shared)


def dense_jacobian(loss, parameters, free):
    """Residuals (W, 3 T) and their derivatives by central differences of a plain rollout."""

    def residuals(vector):
        dynamics = parameters.with_vector(vector).dynamics(np, VEHICLE)
        error = plain_residuals(np, dynamics, loss.windows, loss.encoder)
        return np.moveaxis(error, -1, 0).reshape(len(loss.windows), -1)

    vector = parameters.to_vector()
    return residuals(vector), differences(residuals, vector, np.flatnonzero(free))


def ledoit_wolf(samples):
    """Section 3.3 of Ledoit and Wolf (2004), term by term, for samples whose mean is zero."""
    count, size = samples.shape
    covariance = samples.T @ samples / count
    mean = np.trace(covariance) / size
    distance = np.sum((covariance - mean * np.eye(size)) ** 2) / size
    scatter = [np.sum((np.outer(x, x) - covariance) ** 2) / size for x in samples]
    weight = min(np.sum(scatter) / count**2, distance) / distance
    return weight * mean * np.eye(size) + (1 - weight) * covariance


@pytest.mark.slow
def test_the_result_matches_a_dense_computation():
    loss = clustered_loss()
    clusters = loss.clusters
    parameters = TRUTH.parameters
    free = RUNGS["M3"].mask(parameters)
    quadratic = loss.quadratic(parameters)
    space = subspace(quadratic.hessian, free, np.zeros((0, len(free))))
    found = sandwich(quadratic, parameters, space)
    residual, jacobian = dense_jacobian(loss, parameters, free)
    count = clusters.max() + 1
    hessian = np.einsum("wrp,wrq->pq", jacobian, jacobian)
    changes = []
    for cluster in range(count):
        own = clusters == cluster
        without = hessian - np.einsum("wrp,wrq->pq", jacobian[own], jacobian[own])
        # Change of the estimate when the block is left out, in one Gauss-Newton step.
        score = np.einsum("wrp,wr->p", jacobian[own], residual[own])
        changes.append(np.linalg.solve(without, score))
    root = np.linalg.cholesky(hessian)
    shrunk = ledoit_wolf(np.array(changes) @ root)
    dense = (count - 1) * np.linalg.solve(root.T, np.linalg.solve(root.T, shrunk).T)
    spread = np.sqrt(np.diag(dense))
    ours = found.covariance[np.ix_(free, free)]
    np.testing.assert_allclose(ours / np.outer(spread, spread), dense / np.outer(spread, spread),
                               atol=1e-4)  # fmt: skip
    np.testing.assert_allclose(found.standard_errors[free], spread, rtol=1e-4)
    assert np.isnan(found.standard_errors[~free]).all()
    # And the scores are the gradient, cut into pieces.
    whole = replace(loss, clusters=None).quadratic(parameters)
    np.testing.assert_allclose(quadratic.scores.sum(axis=0), whole.gradient, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(quadratic.hessian, whole.hessian, rtol=1e-9, atol=1e-15)


def constant(design, rng):
    """Errors that are the same within each cluster."""
    return np.repeat(rng.normal(size=(len(design), 1)), design.shape[1], axis=1)


def linear_quadratic(rng, parameters, free, count=400, rows=8, noise=0.3, errors=constant):
    """Scores of y = X β + e at the least squares estimate."""
    size = int(free.sum())
    design = rng.normal(size=(count, rows, size))
    error = noise * errors(design, rng)
    flat = design.reshape(-1, size)
    estimate = np.linalg.lstsq(flat, error.ravel(), rcond=None)[0]
    residual = design @ estimate - error
    gradient = np.zeros((count, len(free)))
    gradient[:, free] = np.einsum("grp,gr->gp", design, residual)
    hessian = np.zeros((count, len(free), len(free)))
    hessian[np.ix_(np.arange(count), free, free)] = np.einsum("grp,grq->gpq", design, design)
    return Quadratic(np.sum(residual**2, axis=1), gradient, hessian), estimate


def test_the_covariance_of_a_linear_model_is_exact():
    parameters = TRUTH.parameters
    free = parameters.mask(frozenset({"center_of_mass", "inertia", "angle_offset"}))
    rng = np.random.default_rng(5)
    found = [linear_quadratic(rng, parameters, free) for _ in range(40)]
    errors = [along(quadratic, parameters, free).standard_errors[free] for quadratic, _ in found]
    # Rows of a design are independent, so that the constant errors of a cluster average out as if
    # they were independent, too: σ² (XᵀX)⁻¹.
    expected = 0.3 / np.sqrt(400 * 8)
    assert np.mean(errors) == pytest.approx(expected, rel=0.03)
    assert np.std([estimate for _, estimate in found]) == pytest.approx(expected, rel=0.15)


def test_a_dozen_equivalent_blocks_give_errors_within_a_tenth():
    parameters = TRUTH.parameters
    free = parameters.mask(frozenset({"center_of_mass", "inertia", "angle_offset"}))
    rng = np.random.default_rng(6)

    def independent(design, rng):
        return rng.normal(size=design.shape[:2])

    found = [
        linear_quadratic(rng, parameters, free, 12, 40, errors=independent)[0] for _ in range(60)
    ]
    errors = np.array([along(one, parameters, free).standard_errors[free] for one in found])
    expected = 0.3 / np.sqrt(12 * 40)
    assert np.mean(errors) == pytest.approx(expected, rel=0.05)
    # Each alone would scatter by 1/√(2·11), a fifth.
    assert np.sqrt(np.mean((errors / expected - 1) ** 2)) < 0.14


def test_directions_with_different_variance_keep_their_own_errors():
    parameters = TRUTH.parameters
    free = parameters.mask(frozenset({"center_of_mass", "inertia", "angle_offset"}))
    rng = np.random.default_rng(7)

    def with_first(design, rng):
        return constant(design, rng) * design[..., 0]

    found = [linear_quadratic(rng, parameters, free, errors=with_first)[0] for _ in range(20)]
    errors = np.mean([along(q, parameters, free).standard_errors[free] for q in found], axis=0)
    # E (Σ x²)² = 80 in a cluster of 8 rows for that column, E (Σ x y)² = 8 for others.
    expected = 0.3 / np.sqrt(400 * 8) * np.sqrt([10.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(errors, expected, rtol=0.06)


def quadratic_at_the_truth():
    loss = clustered_loss()
    parameters = TRUTH.parameters
    free = RUNGS["M3"].mask(parameters)
    quadratic = loss.quadratic(parameters)
    return quadratic, parameters, free


def test_variance_shared_between_blocks_widens_all_errors():
    quadratic, parameters, free = quadratic_at_the_truth()
    plain, wide = (along(quadratic, parameters, free, q) for q in (0.0, 0.19))
    np.testing.assert_allclose(wide.standard_errors, plain.standard_errors / 0.9)


def test_errors_grow_by_a_factor_or_a_mixing_matrix():
    quadratic, parameters, free = quadratic_at_the_truth()
    plain = along(quadratic, parameters, free)
    wide = grown(plain, 1.75 * np.eye(len(free)))
    np.testing.assert_allclose(wide.standard_errors, 1.75 * plain.standard_errors, rtol=1e-6)
    first, second = np.flatnonzero(np.isfinite(plain.standard_errors))[:2]
    mixing = np.eye(len(free))
    mixing[first, second] = 1.0
    expected = plain.propagate(lambda vector: vector[first] + vector[second])
    assert grown(plain, mixing).standard_errors[first] == pytest.approx(expected, rel=1e-6)


def test_extra_variance_widens_only_its_parameter(fit):
    known = fit.uncertainty
    lag = fit.model.parameters.mask(frozenset({"motor_time_constant"}))
    after = widened(known, lag, 4e-6)
    np.testing.assert_allclose(
        after.standard_errors[lag] ** 2, known.standard_errors[lag] ** 2 + 4e-6
    )
    np.testing.assert_array_equal(after.standard_errors[~lag], known.standard_errors[~lag])
    np.testing.assert_allclose(np.sqrt(np.diag(after.covariance)[lag]), after.standard_errors[lag])
    # Entries without a standard error get none.
    unknown = ~np.isfinite(known.standard_errors)
    assert np.isnan(widened(known, unknown, 4e-6).standard_errors[unknown]).all()


def test_intervals_of_parameters_and_derived_quantities_are_consistent(fit):
    known = fit.uncertainty
    assert known is fit.model.uncertainty
    free = fit.model.free
    width = np.diff(known.intervals[free], axis=1)[:, 0]
    finite = np.isfinite(width)
    np.testing.assert_allclose(
        width[finite], 2 * known.quantile * known.standard_errors[free][finite]
    )
    assert np.nanmax(np.abs(known.correlation)) <= 1 + 1e-9
    # A sum of coefficients: by hand and by the delta method.
    powers = 0.6 ** np.arange(1, 4)
    by_hand = np.sqrt(powers @ known.covariance[3:6, 3:6] @ powers)
    found = fit.model.standard_error(lambda m: m.parameters.thrust[1] @ powers)
    assert found == pytest.approx(by_hand, rel=1e-6)
    # A thrust curve is known far better than its coefficients.
    assert by_hand < 0.2 * known.standard_errors[4]


@pytest.mark.slow
def test_the_order_of_trajectories_does_not_matter():
    flights = [noisy(seed, duration=7.0) for seed in (1, 2)]
    first, second = identify(flights), identify(flights[::-1])
    np.testing.assert_allclose(
        first.uncertainty.standard_errors, second.uncertainty.standard_errors, rtol=1e-3
    )


@pytest.mark.slow
def test_twice_the_data_have_smaller_errors(fit):
    flights = [noisy(seed) for seed in (0, 3)]
    twice = identify(flights).uncertainty.standard_errors
    once = fit.uncertainty.standard_errors
    assert np.nanmedian(twice / once) == pytest.approx(1 / np.sqrt(2), abs=0.15)


def test_a_parameter_without_influence_is_unknown():
    # Curvature of a lag of 0.1 ms at 17 Hz; scaled to one, it would look as well known as others.
    hessian = np.array([[4.0, 1e-126, 1.0], [1e-126, 1e-250, 1e-126], [1.0, 1e-126, 1e8]])
    free = np.ones(3, dtype=bool)
    space = subspace(hessian, free, np.zeros((0, 3)))
    assert space.unknown.tolist() == [False, True, False]
    known = np.linalg.inv(hessian[np.ix_([0, 2], [0, 2])])
    np.testing.assert_allclose((space.basis @ space.basis.T)[np.ix_([0, 2], [0, 2])], known)
    assert np.abs(space.basis).max() < 1


@pytest.mark.parametrize("lag", [1e-4, 1e-4 + 3e-18])  # a step onto the bound may miss it
def test_parameters_at_a_constraint_have_no_standard_error(lag):
    parameters = replace(
        TRUTH.parameters,
        thrust=np.array([[1e-6, 0.5, 0.1], *TRUTH.parameters.thrust[1:]]),
        motor_time_constant=lag,
    )
    free = RUNGS["M3"].mask(parameters)
    rows = binding_constraints(parameters, free)
    assert len(rows) == 2
    loss = clustered_loss()
    found = along(loss.quadratic(parameters), parameters, free)
    labels = parameters.labels(NAMES)
    without = {labels[k] for k in np.flatnonzero(free & np.isnan(found.standard_errors))}
    assert without == {"thrust motor_a_1 φ^1", "motor_time_constant"}
    assert "binding constraints (bounds, rising thrust): 2" in " ".join(found.notes)
    assert found.covariance[0, 0] < 1e-20


def test_a_curve_constrained_in_the_middle_varies_only_along_its_constraint():
    dipping = np.array([0.12, -0.6, 1.0])  # F' = 0 at φ = 0.2
    thrust = np.array([dipping, *TRUTH.parameters.thrust[1:]])
    parameters = replace(TRUTH.parameters, thrust=thrust)
    free = RUNGS["M3"].mask(parameters)
    (row,) = binding_constraints(parameters, free)
    np.testing.assert_allclose(row[:3], [1, 0.4, 0.12], atol=1e-9)
    loss = clustered_loss()
    found = along(loss.quadratic(parameters), parameters, free)
    assert np.isfinite(found.standard_errors[:3]).all()
    slope = np.sqrt(abs(row @ found.covariance @ row))
    assert slope < 1e-6 * found.standard_errors[0]


@pytest.mark.slow
def test_m4_identifies_only_products():
    fit = identify(noisy(), "M4")
    known = fit.identifiability
    assert known.free - known.rank == 6
    assert all(name in known.notes[0] for name in NAMES)
    assert "as a product; their scale is fixed by Newton's law" in known.notes[0]
    before = identifiability(noisy(), "M4")
    assert [n for n in before.notes if "product" in n] == [n for n in known.notes if "product" in n]
    errors = fit.uncertainty.standard_errors
    labels = fit.model.parameters.labels(NAMES)
    lag = errors[labels.index("motor_time_constant")]
    assert lag > 0
    found = fit.model.standard_error(lambda m: m.parameters.motor_time_constant)
    assert found == pytest.approx(lag, rel=1e-6)
    # The scale is Newton's: thrusts are in newtons, and as well known as at the physical scale.
    matrix = np.asarray(fit.model.parameters.configuration_matrix)
    np.testing.assert_allclose(VEHICLE.mass_kg * np.hypot(*matrix[:2]), 1, rtol=1e-12)
    thrust = fit.model.standard_error(lambda m: m.parameters.thrust.sum(axis=1))
    assert (thrust < 0.3 * fit.model.parameters.thrust.sum(axis=1)).all()
    physical = fit.model.standard_error(lambda m: physical_thrust(m).sum(axis=1))
    np.testing.assert_allclose(physical, thrust, rtol=1e-5)


def test_the_gauge_affects_neither_predictions_nor_observable_errors():
    loss = clustered_loss()
    rung = named_rung("M4+pair+sag")
    start = rung.initial(VEHICLE)
    free = rung.mask(start)
    scale = np.array([0.5, 2.0, 1.3, 0.8, 1.0, 3.0])
    wild = replace(
        start,
        thrust=start.thrust * scale[:, None],
        configuration_matrix=start.configuration_matrix / scale,
    )
    tame = fix_gauge(wild, VEHICLE, free)
    np.testing.assert_allclose(tame.thrust, start.thrust, rtol=1e-12)
    np.testing.assert_allclose(tame.configuration_matrix, start.configuration_matrix, rtol=1e-12)
    assert loss.quadratic(wild).loss == pytest.approx(loss.quadratic(start).loss, rel=1e-12)
    # At any scale the gauge directions contain no information.
    hessian = loss.quadratic(wild).hessian
    for direction in gauge_directions(wild, free).values():
        size = np.abs(direction) @ np.abs(hessian) @ np.abs(direction)
        assert abs(direction @ hessian @ direction) < 1e-12 * size
    # The pseudo-inverse, which prefers no scale, gives the same errors as Newton's scale.
    quadratic = loss.quadratic(tame)
    loose = subspace(quadratic.hessian, free, binding_constraints(tame, free))
    products = np.array([
        sandwich(quadratic, tame, space).propagate(lambda v: physical(tame.with_vector(v)))
        for space in (varying(quadratic.hessian, tame, free), loose)
    ])  # fmt: skip
    assert (products > 0).all()
    np.testing.assert_allclose(products[0], products[1], rtol=1e-4)


def physical(parameters):
    """Thrusts at full speed in newtons, whatever their scale."""
    length = np.hypot(*np.asarray(parameters.configuration_matrix)[:2])
    return VEHICLE.mass_kg * length * np.asarray(parameters.thrust).sum(axis=1)


def test_a_given_scale_is_not_a_gauge():
    rung = replace(named_rung("M4"), free=frozenset({"configuration_matrix"}))
    start = rung.initial(VEHICLE)
    assert not gauge_directions(start, rung.mask(start))
    assert fix_gauge(start, VEHICLE, rung.mask(start)) is start
    assert not gauge_directions(RUNGS["M3"].initial(VEHICLE), np.ones(25, dtype=bool))


def test_an_idle_motor_is_named():
    flight = noisy()
    command = flight.command.copy()
    command[:, 2] = 0.0
    known = identifiability(replace(flight, command=command))
    silent = [note for note in known.notes if "contain no information about" in note]
    assert len(silent) == 3
    assert all("motor_b_1" in note for note in silent)
    assert known.free - known.rank == 3


def test_a_motor_at_one_speed_is_named():
    flight = noisy()
    command = flight.command.copy()
    command[:, 2] = 0.4
    known = identifiability(replace(flight, command=command))
    assert known.free - known.rank == 2
    (note,) = [note for note in known.notes if "not determined" in note]
    assert note.startswith("2 combinations of")
    assert note.count("motor_b_1") == 3


def test_without_information_all_is_unknown():
    parameters = TRUTH.parameters
    free = RUNGS["M3"].mask(parameters)
    size = len(free)
    known = identifiability_of(np.full((size, size), np.nan), parameters, free, NAMES)
    assert known.rank == 0


@pytest.mark.parametrize(
    ("count", "value", "reason"), [(1, 1.0, "single block"), (4, np.nan, "not finite")]
)
def test_missing_standard_errors_are_explained(count, value, reason):
    parameters = TRUTH.parameters
    free = RUNGS["M3"].mask(parameters)
    size = len(free)
    quadratic = Quadratic(
        np.ones(count), np.full((count, size), value), np.tile(np.eye(size), (count, 1, 1))
    )
    found = along(quadratic, parameters, free)
    assert np.isnan(found.standard_errors).all()
    assert reason in found.notes[0]


def test_a_model_file_with_uncertainty_round_trips(tmp_path, fit):
    for name in ("M3", "M4"):
        model = fit.model if name == "M3" else identify(noisy(), name).model
        model.save(tmp_path / "model.toml")
        written, read = model.uncertainty, read_model(tmp_path / "model.toml").uncertainty
        for key in ("estimate", "covariance", "standard_errors", "undetermined"):
            np.testing.assert_array_equal(getattr(read, key), getattr(written, key))
        assert (read.clusters, read.quantile, read.notes) == (
            written.clusters,
            written.quantile,
            written.notes,
        )


def test_a_damaged_table_is_rejected(tmp_path, fit):
    path = tmp_path / "model.toml"
    fit.model.save(path)
    text = path.read_text()
    for old, new, field in (
        ("labels = [", 'labels = ["mass", ', "labels"),
        ("covariance = [", "covariance = [[1.0], ", "covariance"),
        ("motor_time_constant_s = ", "time = ", "time"),
    ):
        head, tail = text.split("[uncertainty]")
        path.write_text(head + "[uncertainty]" + tail.replace(old, new, 1))
        with pytest.raises(InputError, match=field):
            read_model(path)


def test_changed_parameters_have_no_uncertainty(tmp_path, fit):
    moved = replace(fit.model, parameters=replace(fit.model.parameters, inertia=1e-3))
    assert np.isnan(moved.standard_error(lambda m: m.parameters.inertia))
    moved.save(tmp_path / "model.toml")
    assert read_model(tmp_path / "model.toml").uncertainty is None


def test_a_weighted_window_counts_as_repeated():
    loss = replace(clustered_loss(), clusters=None)
    windows = loss.windows
    counted = np.arange(len(windows)) % 3.0
    repeated = replace(
        loss, windows=replace(windows, starts=np.repeat(windows.starts, counted.astype(int)))
    )
    weighted = replace(loss, multiplicity=counted).quadratic(TRUTH.parameters)
    expected = repeated.quadratic(TRUTH.parameters)
    assert weighted.loss == pytest.approx(expected.loss, rel=1e-12)
    np.testing.assert_allclose(weighted.gradient, expected.gradient, rtol=1e-9, atol=1e-15)


def commands_at_random(seed, duration):
    """One motor of each pair and its opposite, and back: the craft stays far from any rail."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(round(duration / 0.4)):
        first, second = np.full((2, 6), 0.05)
        which, command = rng.integers(0, 2, 3), rng.uniform(0.05, 0.6, 3)
        first[np.arange(0, 6, 2) + which] = second[np.arange(1, 6, 2) - which] = command
        rows += [first] * 10 + [second] * 20 + [first] * 10
    return np.array(rows)


@pytest.mark.study
def test_intervals_cover_the_truth():
    from airpuck.craft.table import Table
    from airpuck.preprocessing.pipeline import preprocess
    from airpuck.twin.batch import TwinBatch
    from airpuck.twin.settings import Effects, MotionCapture, OnBoard, Radio, TwinSettings

    flights, delay = 60, 5 / 240
    settings = TwinSettings(
        table=Table(length_m=200.0, width_m=200.0),
        radio=Radio(delay_s=delay, jitter_s=0.0),
        motion_capture=MotionCapture(position_noise_m=5e-5, yaw_noise_rad=6e-4),
        on_board=OnBoard(rate_hz=0.0),
        effects=Effects(),
    )
    commands = np.stack([commands_at_random(seed, 20.0) for seed in range(flights)], axis=1)
    batch = TwinBatch(TRUTH, flights, 20.0, settings=settings, logs=True)
    batch.reset(np.arange(flights), np.zeros((flights, 3)), range(flights))
    for row in commands:
        batch.step(row)
    held = []
    for craft in range(flights):
        # A command acts from the next sample on, on average half a sample late. This error is
        # common to all flights, so no interval includes it.
        trajectory = preprocess(batch.recording(craft), delay=delay - 0.5 / 240)
        known = identify(trajectory).uncertainty
        low, high = known.intervals.T
        true, has = TRUTH.parameters.to_vector(), np.isfinite(low)
        held.append(((low <= true) & (true <= high))[has])
    assert 0.85 <= np.mean(np.concatenate(held)) <= 0.99


def test_variance_shared_across_block_borders_matches_a_moving_average():
    """Scores that sum up the L samples of their window, white noise: the variance by hand."""
    loss = prediction_loss(Loss(), [noisy(duration=40.0)], VEHICLE)
    windows, clusters = loss.windows, loss.clusters
    sample = np.zeros((len(windows), int(windows.starts.max()) + 90))
    for row, start in zip(sample, windows.starts, strict=True):
        row[start : start + 90] = 1
    blocks = np.array([sample[clusters == c].sum(axis=0) for c in range(clusters.max() + 1)])
    missed = 1 - np.sum(blocks**2) / np.sum(blocks.sum(axis=0) ** 2)
    assert shared_at_borders(loss) == pytest.approx(missed, rel=0.1)
    one = replace(loss, clusters=np.zeros(len(windows), dtype=int))
    assert shared_at_borders(one) == 0
    # The ends of recordings do not count as borders.
    two = prediction_loss(Loss(), [noisy(1, 7.0), noisy(2, 7.0)], VEHICLE)
    by_trajectory = np.searchsorted(two.windows.origins, two.windows.starts, side="right")
    assert shared_at_borders(replace(two, clusters=by_trajectory - by_trajectory.min())) == 0


def test_clusters_are_blocks_of_time():
    flights = [noisy(seed, duration=7.0) for seed in (1, 2)]
    loss = prediction_loss(Loss(), flights, VEHICLE)
    windows, clusters = loss.windows, loss.clusters
    second = windows.starts >= len(flights[0])
    assert not set(clusters[second]) & set(clusters[~second])
    assert (np.diff(clusters) >= 0).all()
    seconds = np.bincount(clusters) * 7 / 240
    assert 1.2 < seconds.min() <= seconds.max() < 2.1


@pytest.mark.parametrize("duration", [5.0, 7.0, 12.0, 18.0, 19.0, 21.0, 30.0])
def test_blocks_are_shortened_until_there_are_enough(duration):
    windows = prediction_loss(Loss(), [noisy(3, duration)], VEHICLE).windows
    usual, counts = (np.bincount(cluster_windows(windows, n)) for n in (1, 12))
    assert len(counts) >= 12
    assert len(usual) < 12 or len(counts) == len(usual)
    # None is shorter than a window: 90 samples, a start every 7. The recording is divided evenly.
    counts = np.bincount(cluster_windows(windows, 1000))
    assert counts.max() == 13 and counts.min() >= 12


def test_an_absurdly_large_error_counts_as_unknown():
    """The lag of a slow camera: its information is not zero, but rounding."""
    parameters = nominal_model(VEHICLE).parameters
    vector, entry = parameters.to_vector(), len(VEHICLE.propellers) * 3 + 1
    assert parameters.labels(NAMES)[entry] == "motor_time_constant"
    for spread in (1e35, 1e-22):
        errors = np.full(len(vector), 1e-3)
        errors[entry] = spread
        lost = np.eye(len(vector))[entry : entry + (spread < 1)]
        found = uncertainty(vector, errors, lost=lost)
        known = without_meaningless(found, parameters)
        model = replace(nominal_model(VEHICLE), uncertainty=known)
        assert np.isnan(model.standard_error(lambda m: 1e3 * m.parameters.motor_time_constant))
        force = model.standard_error(lambda m: m.parameters.thrust.sum(axis=1))
        np.testing.assert_allclose(force, 1e-3 * np.sqrt(3), rtol=1e-6)


def test_intervals_of_a_short_lag_and_of_the_delay_cover_the_truth():
    true_lag, true_delay, noise = 5e-3, 37e-3, 1e-4
    random = np.random.default_rng(0)
    linear, held = [], []
    for _ in range(600):
        # Poses determine the mean of the response, and its variance with a constant error.
        mean = true_lag + true_delay + 2e-4 * random.standard_normal()
        squared = true_lag**2 + noise * random.standard_normal()
        if squared <= 1e-8:
            continue  # at its bound, a lag has no stated error
        lag = np.sqrt(squared)
        start = nominal_parameters(default_vehicle())
        found = replace(start, motor_time_constant=lag, transport_delay=mean - lag)
        slope = noise / (2 * lag)
        covariance = np.zeros((len(found.to_vector()),) * 2)
        pair = np.flatnonzero(found.mask(LAG_AND_DELAY))
        covariance[np.ix_(pair, pair)] = slope**2 * np.array([[1, -1], [-1, 1]])
        covariance[pair[1], pair[1]] += 2e-4**2
        known = uncertainty(found.to_vector(), covariance, quantile=1.96)
        for kept, one in ((linear, known), (held, with_lag_squared(known, found))):
            low, high = one.intervals[pair].T
            kept.append((low <= (true_lag, true_delay)) & ((true_lag, true_delay) <= high))
            both = one.errors_along(found.mask(LAG_AND_DELAY).astype(float)[:, None])
            assert both[0] == pytest.approx(2e-4, rel=0.2)
    assert np.mean(linear) < 0.88
    assert np.mean(held, axis=0).min() > 0.93


@pytest.mark.parametrize("share", [0.2, 0.4, 0.8])
def test_the_interval_of_a_short_lag_covers_a_symmetric_one_for_its_square(share):
    """± 2 τ times the error of τ, for the variance τ² of a step response; never below zero."""
    found = nominal_parameters(default_vehicle())
    tau, lag = float(found.motor_time_constant), found.mask(frozenset({"motor_time_constant"}))
    delay = found.mask(frozenset({"transport_delay"}))
    change = lag.astype(float) - 0.9 * delay
    reach = share * tau
    covariance = (reach / 2.0) ** 2 * np.outer(change, change)
    errors = np.sqrt(np.diag(covariance))
    known = Uncertainty(
        found.to_vector(), covariance, np.where(errors > 0, errors, np.nan),
        np.zeros((0, len(errors))), 100, 2.0,
    )  # fmt: skip
    widened_errors = with_lag_squared(known, found).standard_errors
    lowest = np.sqrt(tau**2 - 2 * tau * reach) if share < 0.5 else 0.0
    far = max(tau - lowest, np.sqrt(tau**2 + 2 * tau * reach) - tau)
    assert 2.0 * widened_errors[lag][0] == pytest.approx(far, rel=1e-9)
    assert 2.0 * widened_errors[delay][0] == pytest.approx(0.9 * far, rel=1e-9)


@pytest.mark.slow
def test_a_fit_widens_the_interval_of_a_poorly_known_lag(monkeypatch):
    flight, stated = noisy(noise=0.006), []
    given = {"loss": Loss(spacing=29 / 240), "preparation": Preparation(faults="keep", delay="fit")}
    for widening in (with_lag_squared, lambda known, _: known):
        monkeypatch.setattr("airpuck.identification.fit.with_lag_squared", widening)
        fit = identify(flight, "M2", **given)
        lag = fit.model.parameters.mask(frozenset({"motor_time_constant"}))
        stated.append(float(fit.uncertainty.standard_errors[lag][0]))
    assert stated[0] > 1.1 * stated[1]


def test_a_well_known_lag_keeps_its_interval():
    found = nominal_parameters(default_vehicle())
    errors = np.where(found.mask(frozenset({"motor_time_constant"})), 3e-4, np.nan)
    known = Uncertainty(
        found.to_vector(), np.diag(np.nan_to_num(errors) ** 2), errors,
        np.zeros((0, len(errors))), 100, 1.96,
    )  # fmt: skip
    assert with_lag_squared(known, found) is known
