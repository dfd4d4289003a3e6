"""Judgement of each propeller's measured effect against the vehicle file, matched by direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

#: Cosine above which a measured and an expected effect agree (26 degrees apart).
AGREES = 0.9
#: An opposite effect is more likely another propeller's effect: cables are swapped more often than
#: propellers are mounted the wrong way round.
_OPPOSITE = 0.5

#: Standard errors that make a deviation certain.
CERTAIN = 2.6
#: Squared size of forces and moments, in squared standard errors, from which their ratio is judged.
_SEEN_SIZE = 4.0


@dataclass(frozen=True)
class EffectMatch:
    """The expected effect that a measured propeller matches."""

    #: The propeller of the model with this effect; None: there is none.
    acts_as: int | None
    #: 1, or -1 for the opposite effect.
    sign: int
    #: Cosine between the measured and the expected effect.
    cosine: float


def rotation(measured: Float[np.ndarray, "3 m"], expected: Float[np.ndarray, "3 m"]) -> float:
    """Find the rotation that maps expected forces to measured ones [rad].

    In complex numbers: the argument of their inner product (two-dimensional Procrustes).
    """
    return float(np.angle(np.vdot(_forces(expected), _forces(measured))))


def rotation_error(
    measured: Float[np.ndarray, "3 m"],
    error: Float[np.ndarray, "3 m"],
    expected: Float[np.ndarray, "3 m"],
) -> float:
    """Return the standard error of `rotation` [rad]."""
    along = abs(np.vdot(_forces(expected), _forces(measured)))
    across = np.abs(_forces(expected)) * np.hypot(*error[:2]) / np.sqrt(2)
    return float(np.linalg.norm(across) / along) if along > 0 else np.inf


def turned(effects: Float[np.ndarray, "3 m"], angle: float) -> Float[np.ndarray, "3 m"]:
    """Rotate forces; moments do not change."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ effects


def cosines(
    measured: Float[np.ndarray, "3 m"], expected: Float[np.ndarray, "3 n"]
) -> Float[np.ndarray, "m n"]:
    """Compare the directions of all measured effects with all expected ones."""
    return unit_columns(measured).T @ unit_columns(expected)


def match_effects(
    measured: Float[np.ndarray, "3 m"],
    expected: Float[np.ndarray, "3 n"],
    motors: Int[np.ndarray, " m"],
) -> dict[int, EffectMatch]:
    """Find the matching effect of each measured propeller.

    A propeller that agrees with its expected effect keeps it. The others are assigned to the
    remaining effects so that as many as possible agree, in the same or the opposite direction.
    """
    table = cosines(measured, expected)
    itself = table[np.arange(len(motors)), motors]
    agrees = itself >= AGREES
    found = {
        motor: EffectMatch(motor if stays else None, 1, float(cosine))
        for motor, stays, cosine in zip(motors.tolist(), agrees, itself, strict=True)
    }
    if agrees.all():
        return found
    from scipy.optimize import linear_sum_assignment  # takes half a second to import

    worth = np.where(table >= AGREES, table, 0.0)
    worth = np.where(table <= -AGREES, -_OPPOSITE * table, worth)
    rows = np.flatnonzero(~agrees)
    columns = np.setdiff1d(np.arange(expected.shape[1]), motors[agrees])
    for i, j in zip(*linear_sum_assignment(-worth[np.ix_(rows, columns)]), strict=True):
        row, column = rows[i], columns[j]
        if worth[row, column] > 0:
            sign = 1 if table[row, column] > 0 else -1
            found[int(motors[row])] = EffectMatch(int(column), sign, float(itself[row]))
    return found


def may_agree(
    measured: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"], stated: Float[np.ndarray, "3"]
) -> bool:
    """Return whether an effect may have the stated direction, given its standard errors."""
    unit = stated / np.linalg.norm(stated)
    along = float(unit @ measured)
    across = measured - along * unit
    size = float(np.linalg.norm(across))
    spread = float(np.linalg.norm(across * error)) / max(size, np.finfo(float).tiny)
    return along > 0 and bool(size - CERTAIN * spread < np.tan(np.arccos(AGREES)) * along)


def force_to_moment(
    measured: Float[np.ndarray, "3 n"],
    error: Float[np.ndarray, "3 n"],
    stated: Float[np.ndarray, "3 n"],
) -> float:
    """Return by what factor forces are too large for the moments; 1 if either is not seen."""
    # Noise adds its variance to measured sizes.
    noise = np.array([np.sum(part**2) for part in (error[:2], error[2])])
    size, expected = (np.array([np.sum(p[:2] ** 2), np.sum(p[2] ** 2)]) for p in (measured, stated))
    if (size <= _SEEN_SIZE * noise).any() or expected.min() <= 0:
        return 1.0
    force, moment = np.sqrt((size - noise) / expected)
    return float(force / moment)


def _forces(effects: Float[np.ndarray, "3 m"]) -> np.ndarray:
    """Return forces as complex numbers."""
    return effects[0] + 1j * effects[1]


def unit_columns(columns: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Normalise columns."""
    return columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)


#: Least increase of the mean cosine by rotating the layout back; below it, swapped motors are the
#: better explanation.
_BETTER = 0.02
#: Verdict on a propeller that agrees once the layout is rotated back.
TURNS = "turned with the whole layout"
EXCHANGED = "agrees once x and y are exchanged"
#: Verdict on a propeller that pushes the other way, as all others do, and the fewest of them.
REVERSED, _ALL = "pushes the other way, as all others do", 3
#: Effect, relative to the others, above which a propeller's direction is judged, and standard error
#: up to which the direction is known, relative to the effect.
_SEEN, _DIRECTION_LIMIT = 0.3, 0.25
#: Effect relative to the others that a propeller without thrust stays below.
_DEAD = 0.5
#: Effect relative to the others below which a propeller may give nothing, beside errors of curves.
_NOTHING = 0.15
#: Verdicts on propellers without thrust, and on propellers whose effect is still uncertain.
DEAD, UNCLEAR = "gives no thrust", "not clear yet: fly longer"
#: Verdict on propellers whose thrust never changes on its own.
UNDETERMINED = "undetermined: change its command independently of the others and of the motion"
#: Verdicts that accuse no propeller.
HARMLESS = "agrees", TURNS, EXCHANGED, REVERSED, UNCLEAR, UNDETERMINED
#: Rotation of the whole layout that is worth mentioning [rad].
TURNED = 0.3


@dataclass(frozen=True)
class PropellerCheck:
    """Comparison of one propeller's measured effect with the stated one."""

    #: The propeller.
    name: str
    #: Cosine between the measured and the stated effect, 1: the same, -1: the opposite.
    agreement: float
    #: The propeller of the vehicle file with the most similar effect.
    behaves_like: str
    #: ``agrees``, or the problem in words.
    verdict: str
    #: Its force along the stated direction, over the nominal one, and the standard error.
    strength: float = np.nan
    strength_error: float = np.nan


def judge_propellers(
    measured: Float[np.ndarray, "3 n"],
    error: Float[np.ndarray, "3 n"],
    stated: Float[np.ndarray, "3 n"],
    names: tuple[str, ...],
    independent: Bool[np.ndarray, " n"],
    layout: tuple[float, float],
) -> tuple[PropellerCheck, ...]:
    """Judge each propeller; `layout` is the rotation of all, and the ratio of the inertia."""
    angle, inertia_ratio = layout
    agreement = np.diag(cosines(measured, stated))
    # A poor guess of the inertia changes all moments alike.
    moments = np.array([1.0, 1.0, inertia_ratio])[:, None]
    measured, error = moments * measured, moments * error
    size, spread = np.linalg.norm(measured, axis=0), np.linalg.norm(error, axis=0)
    usual = float(np.median(size))
    clear = np.flatnonzero((size > _SEEN * usual) & (spread < _DIRECTION_LIMIT * size))
    agrees, back, seen, matches = _explained(measured, stated, clear, angle)
    verdicts = _unclear(back, error, stated, agrees)
    for k, match in matches.items():
        open_ = match.acts_as is None and may_agree(back[:, k], error[:, k], stated[:, k])
        verdicts[k] = UNCLEAR if open_ else _verdict(match, k, names, agrees)
    # Forces depend only on the mass, which is known; a wheel has only a moment.
    along, pushes = stated.copy(), np.linalg.norm(stated[:2], axis=0) > 0
    along[2, pushes] = 0.0
    full = np.linalg.norm(along, axis=0)
    strength = np.sum(along * back / moments, axis=0) / full**2
    deviation = np.sqrt(np.sum((along * error / moments) ** 2, axis=0)) / full**2
    return tuple(
        PropellerCheck(
            name=name,
            agreement=float(agreement[k]),
            behaves_like=names[int(np.argmax(seen[k]))],
            verdict=UNDETERMINED if verdicts[k] == UNCLEAR and not independent[k] else verdicts[k],
            strength=float(strength[k]),
            strength_error=float(deviation[k]),
        )
        for k, name in enumerate(names)
    )


#: How effects are read: the verdict on propellers that then agree, effects, cosines and matches.
_Reading = tuple[str, np.ndarray, np.ndarray, dict[int, EffectMatch]]


def _explained(
    measured: Float[np.ndarray, "3 n"],
    stated: Float[np.ndarray, "3 n"],
    clear: Int[np.ndarray, " m"],
    angle: float,
) -> _Reading:
    """Match the clear effects as measured, rotated back by an angle, or reversed."""

    def read(agrees: str, effects: Float[np.ndarray, "3 n"]) -> _Reading:
        matches = match_effects(effects[:, clear], stated, clear)
        return agrees, effects, cosines(effects, stated), matches

    if len(clear) >= _ALL and (np.diag(cosines(measured, stated))[clear] <= -AGREES).all():
        # Opposed propellers look swapped, too, but one cause is likelier than several.
        return read(REVERSED, -measured)
    plain = read("agrees", measured)
    if abs(angle) <= TURNED:
        return plain
    upright = read(TURNS, turned(measured, -angle))
    # On a symmetric craft every motor then also acts like another: one cause is likelier than many.
    alone = len(clear) >= _ALL
    alone &= all(match.acts_as == k and match.sign > 0 for k, match in upright[3].items())
    return upright if alone or _worth(*upright[2:]) > _worth(*plain[2:]) + _BETTER else plain


def _unclear(
    measured: Float[np.ndarray, "3 n"],
    error: Float[np.ndarray, "3 n"],
    stated: Float[np.ndarray, "3 n"],
    agrees: str,
) -> dict[int, str]:
    """Judge propellers by their effect along the stated direction alone."""
    unit = unit_columns(stated)
    size = np.linalg.norm(stated, axis=0)
    along = np.sum(unit * measured, axis=0) / size
    reach = CERTAIN * np.sqrt(np.sum((unit * error) ** 2, axis=0)) / size
    usual = float(np.median(along))
    usual, verdicts = usual or 1.0, {}
    for k, (middle, half) in enumerate(zip(along / usual, reach / abs(usual), strict=True)):
        dead = middle + half < _DEAD and middle - half < _NOTHING
        verdicts[k] = DEAD if dead else agrees if middle - half > 0 else UNCLEAR
    return verdicts


def _worth(likeness: Float[np.ndarray, "n n"], matches: dict[int, EffectMatch]) -> float:
    """Return the mean cosine of matched effects; unmatched ones count as 0."""
    found = [
        match.sign * likeness[k, match.acts_as]
        for k, match in matches.items()
        if match.acts_as is not None
    ]
    return float(np.sum(found) / max(len(matches), 1))


def _verdict(match: EffectMatch, k: int, names: tuple[str, ...], agrees: str) -> str:
    """Describe how a propeller's measured effect compares."""
    if match.acts_as is None:
        return "has no such effect: check its position, direction and wiring"
    if match.acts_as != k:
        reversed_ = "" if match.sign > 0 else " the other way round"
        return f"behaves like {names[match.acts_as]}{reversed_}: motors are swapped"
    if match.sign < 0:
        return "pushes the other way: its direction is wrong by 180 degrees"
    return agrees
