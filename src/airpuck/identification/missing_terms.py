"""Score tests for terms that a model lacks, at the optimum of its fit.

If a term were added at zero, the loss would fall along its gradient; a significant gradient shows
that the term is missing (Rao, Proceedings of the Cambridge Philosophical Society 44, 1948). One
pass over the windows gives gradients and information of all terms at once: no term needs a fit. The
gradient's covariance comes from blocks of time, as for standard errors. A Gauss-Newton step
predicts the term, and the shift of each parameter that its absence causes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary import numbers
from airpuck.boundary.results import Result
from airpuck.evaluation.presentation import main_quantities
from airpuck.identification.objective import PredictionLoss, Quadratic
from airpuck.identification.uncertainty import cluster_windows, inverted, shared_at_borders, varying
from airpuck.model.model_file import Model
from airpuck.model.parameters import Parameters, change_degree
from airpuck.model.quantities import EFFECTS
from airpuck.physics.thrust import thrust

#: Probability below which a term is missing: the tests of a healthy flight then find one of all in
#: less than a percent of all flights.
_LEVEL = 5e-4
#: Decrease of the mean square below which a term is not worth its coefficients: half a percent of
#: the root.
_NOTICEABLE = 0.01
#: Part of a shift for which the main quantities are linear.
_STEP = 1e-3
#: Number of blocks of time that are held out in turn.
_FOLDS = 5
#: Fewest blocks of time beyond a term's coefficients.
_FEWEST = 6
#: Number of blocks below which they are made shorter: enough for six coefficients.
_BLOCKS = 12
#: The term that is not an effect: a higher degree of the thrust curves. It is tested twice, with a
#: coefficient for each motor and with one for all, which finds a common shape with more certainty.
DEGREE, _BEND = "degree", "common degree"
#: Information, relative to the largest of a scaled matrix, below which a direction has none.
_UNINFORMED = 1e-9
#: Prefix of what changed steadily during the recording: ``all`` thrusts, one motor's thrust, or the
#: ``delay``; and smallest changes over the recording that are reported, relative and in seconds.
CHANGE, ALL, DELAY = "change of ", "all", "delay"
_LEAST_CHANGE, _LEAST_LATER = 0.04, 3e-3
#: Share of the commands below which a thrust curve is barely seen; part of the thrust there that is
#: uncertain if the curve is no cubic polynomial; and number of speeds that stand for a curve.
_SLOW, _UNSEEN, _SPEEDS = 0.1, 0.5, 101
#: Part of a term's information that the model's own parameters must leave.
_OWN = 1e-6


@dataclass(frozen=True)
class MissingTerm(Result):
    """A term that a model lacks.

    Attributes
    ----------
    term : str
        Name of the term in a rung's name; ``degree``: a higher degree of the thrust curves; or what
        changed, such as ``change of all``, ``change of motor_1`` (thrusts) or ``change of delay``.
    probability : float
        Probability of such a gradient by chance.
    gain : float
        Predicted decrease of the loss, as a fraction.
    held_out : float
        The same for blocks of time that the step does not see, less one standard error.
    value : tuple of float
        Predicted coefficients.
    direction : array, shape (P,)
        Predicted change of the fit's parameters. A higher degree of the curves counts as the
        polynomial of their own degree that resembles it most.
    shift : dict of str to float
        Predicted change of the main quantities if the term is added, by label, in their units.
    largest : str
        The quantity that changes most, in standard errors; empty if these are unknown.
    unit : str
        Its unit.
    standard_errors : float
        How many.
    """

    JSON = "term probability gain held_out value shift largest unit standard_errors"

    term: str
    probability: float
    gain: float
    held_out: float
    value: tuple[float, ...]
    direction: Float[np.ndarray, " P"]
    shift: dict[str, float] = field(default_factory=dict)
    largest: str = ""
    unit: str = ""
    standard_errors: float = 0.0

    @property
    def significant(self) -> bool:
        """Whether chance does not explain it."""
        if not self.term.startswith(CHANGE):
            return self.probability < _LEVEL
        least = _LEAST_LATER if self.term == CHANGE + DELAY else _LEAST_CHANGE
        return self.probability < _LEVEL and abs(self.value[0]) > least

    @property
    def worthwhile(self) -> bool:
        """Whether held-out parts of the data are predicted noticeably better with it."""
        return self.held_out > _NOTICEABLE and not self.term.startswith(CHANGE)


def missing_terms(model: Model, loss: PredictionLoss | None) -> list[MissingTerm]:
    """Test every term that a model lacks; return the significant ones, the strongest first.

    Terms explain much of each other: once the strongest is found, the others are tested beside it.
    """
    if loss is None or loss.clusters is None or not model.free.any():
        return []
    tests = _Tests.of(model, loss)
    found: list[MissingTerm] = []
    while True:
        tested = [t for t in tests.tested([one.term for one in found]) if t.significant]
        if not tested:
            return found
        found.append(max(tested, key=lambda one: one.gain))


@dataclass(frozen=True, eq=False)
class _Tests:
    """The quadratic approximation of a fit's loss over its own parameters and all missing terms."""

    model: Model
    quadratic: Quadratic
    #: Directions of the fit's own parameters, in the space of all parameters.
    basis: Float[np.ndarray, "Q R"]
    #: How changes of all parameters look among the fit's own.
    echo: Float[np.ndarray, "P Q"]
    #: Entries and lower bounds of each term.
    entries: dict[str, tuple[Int[np.ndarray, " k"], Float[np.ndarray, " k"]]]
    #: Fraction of the scores' variance that shortened blocks miss.
    shared: float

    @classmethod
    def of(cls, model: Model, loss: PredictionLoss) -> _Tests:
        """Evaluate the loss once, with all terms at zero."""
        whole, shared = _with_all_terms(model), 0.0
        assert loss.clusters is not None
        if (count := int(loss.clusters.max()) + 1) < _BLOCKS:
            loss = replace(loss, clusters=cluster_windows(loss.windows, _BLOCKS))
            shared = shared_at_borders(loss)
        quadratic = loss.quadratic(whole, within=model.parameters)
        names = model.vehicle.propeller_names
        labels = whole.labels(names)
        own = np.array([labels.index(label) for label in model.parameters.labels(names)])
        # In shorter blocks than these, other drift looks like a change.
        changes = _changes(model, whole, loss) if count > _FEWEST else {}
        terms = dict(_terms(model, whole, own))
        bends = _bends(whole, terms.get(DEGREE))
        changing = np.array([*changes.values()]).reshape(-1, len(labels))
        bent = np.array([*bends.values()]).reshape(-1, len(labels))
        quadratic = _changing(quadratic, changing, bent)
        hessian = quadratic.hessian
        inside = varying(hessian[np.ix_(own, own)], model.parameters, model.free).basis
        basis = np.zeros((len(hessian), inside.shape[1]))
        basis[own] = inside
        lower, _ = whole.bounds()
        entries = {term: (np.flatnonzero(mask), lower[mask]) for term, mask in terms.items()}
        for number, term in enumerate([*changes, *bends], start=len(labels)):
            entries[term] = (np.array([number]), np.array([-np.inf]))
        echo = _echo(model.parameters, whole, own)
        echo = np.concatenate([echo, np.zeros((len(own), len(changes))), echo @ bent.T], axis=1)
        return cls(model, quadratic, basis, echo, entries, shared)

    def tested(self, beside: list[str]) -> Iterator[MissingTerm]:
        """Test each term with a model that has the terms `beside`, too."""
        basis, hessian = self.basis, self.quadratic.hessian
        for term in beside:
            basis = _extended(basis, hessian, self.entries[term][0])
        for key, (entries, lower) in self.entries.items():
            term = DEGREE if key == _BEND else key
            if term in beside:
                continue
            if (found := self._test(term, entries, lower, basis)) is not None:
                yield found

    def _test(
        self,
        term: str,
        entries: Int[np.ndarray, " k"],
        lower: Float[np.ndarray, " k"],
        basis: Float[np.ndarray, "Q R"],
    ) -> MissingTerm | None:
        """Test a term; coefficients that would be below their bound stay at zero."""
        hessian, scores = self.quadratic.hessian, self.quadratic.scores
        bound = dict(zip(entries.tolist(), lower.tolist(), strict=True))
        kept = [int(entry) for entry in entries]
        while kept:
            mixed = basis.T @ hessian[:, kept]
            effective = scores[:, kept] - scores @ basis @ mixed
            whole = hessian[np.ix_(kept, kept)]
            information = whole - mixed.T @ mixed
            if not (np.diag(information) > _OWN * np.diag(whole)).all():
                return None
            value = -inverted(information, _UNINFORMED) @ effective.sum(axis=0)
            impossible = [e for e, v in zip(kept, value, strict=True) if v < 0 <= bound[e]]
            if not impossible:
                break
            kept = [entry for entry in kept if entry not in impossible]
        else:
            return None
        if len(effective) < len(kept) + _FEWEST:
            return None
        gain = float(-value @ effective.sum(axis=0) / 2) / self.quadratic.loss
        along = np.eye(len(hessian))[:, kept] - basis @ mixed
        own = self.echo @ along @ value
        each = np.einsum("qi,gqp,pj->gij", along, self.quadratic.informations, along, optimize=True)
        chance = _by_chance(effective, each, information, value, self.shared)
        # Effects of a coefficient with a lower bound grow with its square.
        least = np.maximum([bound[entry] for entry in kept], 0.0)
        value = np.where(least > 0, np.sqrt(least * np.abs(least + 2 * value)), value)
        coefficients = tuple(value.tolist())
        held_out = self._held_out(basis, kept) if chance < _LEVEL else 0.0
        return MissingTerm(term, chance, gain, held_out, coefficients, own)

    def _held_out(self, basis: Float[np.ndarray, "Q R"], entries: list[int]) -> float:
        """Predict blocks of time by steps from all other blocks, with and without a term.

        Return by which fraction the term lowers the loss, less one standard error.
        """
        scores, informations = self.quadratic.scores, self.quadratic.informations
        own = basis.shape[1]
        wide = np.concatenate([basis, np.eye(len(basis))[:, entries]], axis=1)
        g, h = scores @ wide, np.einsum("qi,gqp,pj->gij", wide, informations, wide, optimize=True)
        gains = []
        for held in np.array_split(np.arange(len(scores)), min(_FOLDS, len(scores))):
            rest = np.setdiff1d(np.arange(len(scores)), held)
            lost = []
            for size in (own, own + len(entries)):
                known = h[rest].sum(axis=0)[:size, :size]
                step = -inverted(known, _UNINFORMED) @ g[rest].sum(axis=0)[:size]
                slope, bend = g[held].sum(axis=0)[:size], h[held].sum(axis=0)[:size, :size]
                lost.append(slope @ step + step @ bend @ step / 2)
            gains.append(lost[0] - lost[1])
        error = np.std(gains, ddof=1) * math.sqrt(len(gains)) if len(gains) > 1 else np.inf
        return float((np.sum(gains) - error) / self.quadratic.loss)


def _by_chance(
    scores: Float[np.ndarray, "G k"],
    informations: Float[np.ndarray, "G k k"],
    information: Float[np.ndarray, "k k"],
    value: Float[np.ndarray, " k"],
    shared: float,
) -> float:
    """Return the probability of such a sum of block scores if the term were zero.

    The statistic is sᵀ I⁻¹ s over its expectation under the blocks' own covariance (Rao and Scott,
    Journal of the American Statistical Association 76, 1981). Unlike Hotelling's T² it needs few
    blocks. That covariance is of the scores that are left with the term, since a change in flight
    alone makes scores differ, corrected for each block's own leverage (HC2 of MacKinnon
    and White, Journal of Econometrics 29, 1985); blocks miss the fraction `shared` of it.
    """
    from scipy.special import fdtrc

    count, size = scores.shape
    total, inverse = scores.sum(axis=0), inverted(information, _UNINFORMED)
    others = np.linalg.pinv(np.eye(size) - informations @ inverse)
    left = scores + informations @ value
    expected = float(np.einsum("gij,gj,ik,gk->", others, left, inverse, left, optimize=True))
    expected = max(expected / (1 - shared), 1e-300)
    return float(fdtrc(size, count - 1, total @ inverse @ total / expected))


def _with_all_terms(model: Model) -> Parameters:
    """Return the parameters with every missing term at zero, or at its negligible lower bound."""
    parameters, degree = model.parameters, np.shape(model.parameters.thrust)[1]
    added: dict[str, Any] = {}
    direct = parameters.configuration_matrix is not None
    for name, quantity in EFFECTS.items():
        possible = quantity.searched and not (direct and quantity.in_matrix)
        if getattr(parameters, name) is None and possible:
            least = max(quantity.bounds[0], 0.0)
            added[name] = np.full(np.shape(quantity.start), least)[()]
    if degree < numbers.DEGREE.high and _can_bend(model, degree + 1):
        added["thrust"] = change_degree(np.asarray(parameters.thrust), degree + 1)
    return replace(parameters, **added)


def _changes(
    model: Model, whole: Parameters, loss: PredictionLoss
) -> dict[str, Float[np.ndarray, " Q"]]:
    """Return by name the directions in which parameters may change during a recording."""
    if len(loss.windows.trajectories) > 1:
        return {}
    thrusts, found = whole.mask(frozenset({"thrust"})), {}
    vector, size = whole.to_vector(), np.shape(whole.thrust)
    rows = np.zeros((size[0], len(vector)))
    for row, unit in zip(rows, np.eye(size[0]), strict=True):
        row[thrusts] = np.repeat(unit, size[1]) * vector[thrusts]
    found = {ALL: rows.sum(axis=0), **dict(zip(model.vehicle.propeller_names, rows, strict=True))}
    if model.delay_learned:
        found[DELAY] = whole.mask(frozenset({"transport_delay"})).astype(float)
    return {CHANGE + name: direction for name, direction in found.items()}


def _bends(whole: Parameters, curves: Any) -> dict[str, Float[np.ndarray, " Q"]]:
    """Return the direction in which all curves bend alike, each by its own full thrust; or none."""
    if curves is None or curves.sum() == 1:
        return {}
    shape = np.zeros(np.shape(whole.thrust))
    shape[:, -1] = np.sum(whole.thrust, axis=1)
    return {_BEND: np.where(curves, replace(whole, thrust=shape).to_vector(), 0.0)}


def _echo(
    parameters: Parameters, whole: Parameters, own: Int[np.ndarray, " P"]
) -> Float[np.ndarray, "P Q"]:
    """Map changes of all parameters to the model's own: powers that it lacks to their likeness."""
    count, degree = np.shape(parameters.thrust)
    echo = np.eye(len(whole.to_vector()))[own]
    new = np.shape(whole.thrust)[1]
    if new > degree:
        # Least squares of φ^new by the lower powers, for speeds φ from 0 to 1.
        powers = np.arange(1, degree + 1)
        like = np.linalg.solve(1 / (powers[:, None] + powers + 1), 1 / (powers + new + 1))
        for motor in range(count):
            echo[motor * degree + powers - 1, (motor + 1) * new - 1] = like
    return echo


def _changing(
    quadratic: Quadratic, changing: Float[np.ndarray, "V Q"], constant: Float[np.ndarray, "B Q"]
) -> Quadratic:
    """Add coefficients of directions; some parameters change linearly with the blocks."""
    scores, informations = quadratic.scores, quadratic.informations
    time = np.linspace(-0.5, 0.5, len(scores))[:, None, None]
    same, still = np.eye(scores.shape[1]), 0 * time
    wide = np.concatenate([same + still, time * changing, constant + still], axis=1)
    return Quadratic(
        quadratic.cluster_losses,
        np.einsum("gp,gvp->gv", scores, wide),
        wide @ informations @ np.swapaxes(wide, 1, 2),
    )


def _can_bend(model: Model, degree: int) -> bool:
    """Return whether the craft's actuators can have thrust curves of a degree."""
    try:
        model.vehicle.actuators.check_thrust(degree)
    except ValueError:
        return False
    return True


def _terms(
    model: Model, whole: Parameters, own: Any
) -> Iterator[tuple[str, Bool[np.ndarray, " Q"]]]:
    """Yield the entries of each missing term."""
    new = np.ones(len(whole.to_vector()), dtype=bool)
    new[own] = False
    for name, quantity in EFFECTS.items():
        if getattr(model.parameters, name) is None and getattr(whole, name) is not None:
            yield quantity.term, whole.mask(frozenset({name}))
    # Curves that the fit learned can bend further, other curves cannot.
    curves = whole.mask(frozenset({"thrust"})) & new
    shape = np.shape(model.parameters.thrust)
    learned = np.asarray(model.free)[: shape[0] * shape[1]].reshape(shape).any(axis=1)
    if curves.any():
        curves[np.flatnonzero(curves)[~learned]] = False
    if curves.any():
        yield DEGREE, curves


def _extended(
    basis: Float[np.ndarray, "Q R"], hessian: Float[np.ndarray, "Q Q"], entries: Any
) -> Float[np.ndarray, "Q S"]:
    """Add entries to a basis in which the information is 1."""
    added = np.eye(len(hessian))[:, entries]
    rest = added - basis @ (basis.T @ hessian @ added)
    value, vector = np.linalg.eigh(rest.T @ hessian @ rest)
    sure = value > _UNINFORMED * max(value[-1], 1e-300)
    return np.concatenate([basis, rest @ vector[:, sure] / np.sqrt(value[sure])], axis=1)


def unseen_level(model: Model, loss: PredictionLoss) -> Float[np.ndarray, " P"]:
    """Return a change of the thrust curves that no motion shows.

    Thrusts that balance each other may all differ by a constant. Only the shape of the curves
    between rest and the slowest speeds says which, so the thrust there bounds the constant.
    """
    parameters, matrix = model.parameters, np.asarray(model.dynamics.configuration)
    slow = np.quantile(np.abs(loss.windows.input), _SLOW, axis=0)
    curves = np.asarray(parameters.thrust)
    powers = np.arange(1, curves.shape[1] + 1)
    constant = _UNSEEN * thrust(curves, slow)
    balanced = constant - np.linalg.pinv(matrix) @ (matrix @ constant)
    speeds = np.linspace(float(slow.min()), 1.0, _SPEEDS)
    alike = np.linalg.lstsq(speeds[:, None] ** powers, np.ones(_SPEEDS), rcond=None)[0]
    changed = np.zeros(len(parameters.to_vector()))
    changed[parameters.mask(frozenset({"thrust"}))] = np.outer(balanced, alike).ravel()
    return changed


def with_shifts(model: Model, found: Sequence[MissingTerm]) -> tuple[MissingTerm, ...]:
    """Add how the main quantities change with each term; and which most, if errors are known."""
    if not found:
        return ()
    quantities = [q for q in main_quantities(model) if q.used(model) and q.learned(model)]

    def values(model: Model) -> Float[np.ndarray, " M"]:
        return np.array([float(quantity.value(model)) for quantity in quantities])

    vector, now = model.parameters.to_vector(), values(model)
    errors = np.asarray(model.standard_error(values))
    known, complete = errors > 0, []
    scale = np.where(vector != 0, np.abs(vector), 1.0)
    for one in found:
        # In directions that the data barely determine, the shift is far beyond what is possible.
        step = _STEP / max(1.0, float(np.max(np.abs(one.direction) / scale)))
        parameters = model.parameters.with_vector(vector + step * one.direction)
        change = (values(replace(model, parameters=parameters, uncertainty=None)) - now) / step
        relative = np.abs(np.divide(change, errors, where=known, out=np.zeros_like(change)))
        most = int(np.argmax(relative))
        shift = {q.label: float(c) for q, c in zip(quantities, change, strict=True)}
        size, largest = float(relative[most]), quantities[most]
        named = {"largest": largest.label, "unit": largest.unit} if known.any() else {}
        complete.append(replace(one, shift=shift, standard_errors=size, **named))
    return tuple(complete)
