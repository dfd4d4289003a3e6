"""Judgement of each propeller's measured effect, against the vehicle file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.faults.effect_match import (
    CERTAIN,
    EffectMatch,
    cosines,
    match_effects,
    may_agree,
    turned,
    unit_columns,
)

#: Least increase of the mean cosine by rotating the layout back; below it, swapped motors are the
#: better explanation.
_BETTER = 0.02
#: Verdict on a propeller that agrees once the layout is rotated back.
TURNS = "turned with the whole layout"
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
HARMLESS = "agrees", TURNS, REVERSED, UNCLEAR, UNDETERMINED
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

    reverse, plain = read(REVERSED, -measured), read("agrees", measured)
    stays = [one.acts_as == k and one.sign > 0 for k, one in reverse[3].items()]
    if len(clear) >= _ALL and all(stays):
        # Opposed propellers look swapped, too, but one cause is likelier than several.
        return reverse
    if abs(angle) <= TURNED:
        return plain
    upright = read(TURNS, turned(measured, -angle))
    return upright if _worth(*upright[2:]) > _worth(*plain[2:]) + _BETTER else plain


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
