"""The hidden Markov chain of the craft's faults, and the probabilities of its states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.faults.hypotheses import Fault

RADIO_OUT, UNEXPLAINED = "radio out", "unexplained motion"

#: Fraction of the steps at which a fault of one kind begins: each about once an hour. Two motors at
#: once are thirty times rarer, so that they are not preferred if one explains as much.
_BEGINS, _PAIR = 1e-5, 1 / 30
#: Fraction of the faults that end within a step, once they may.
_ENDS = 0.1
#: Fraction of the held commands that end within a step in a stop, due to an on-board timeout.
_TIMES_OUT = 0.02
#: Number of steps after which a held command is no longer jitter.
_HELD_AT_LEAST = 4
#: Fraction of the steps at which an unexplained motion begins, and fraction at which it ends.
_COMES, _PASSES = 1e-3, 0.3
#: Probability that a recording begins before the motors are armed.
_UNARMED = 0.02


@dataclass(frozen=True, eq=False)
class Chain:
    """States: normal, each fault at each age, and last unexplained motion."""

    #: Probability of going from a row's state to a column's within a step.
    transition: Float[np.ndarray, "S S"]
    #: Initial probabilities.
    initial: Float[np.ndarray, " S"]
    #: The states in which each cause is active. Two causes may be active at once.
    causes: dict[str, Bool[np.ndarray, " S"]]


def stalled(name: str) -> str:
    """Name the cause of a stopped motor."""
    return f"{name} stalled"


def fault_chain(faults: Sequence[Fault], names: Sequence[str]) -> Chain:
    """Build the chain.

    A fault passes through all of its ages before it can end; stopped motors then stay stopped. A
    held command may also end earlier, or in a stop.
    """
    first = np.cumsum([1, *(fault.ages for fault in faults)])
    size = int(first[-1]) + 1
    transition, initial = np.zeros((size, size)), np.zeros(size)
    causes = {cause: np.zeros(size, dtype=bool) for cause in (RADIO_OUT, *map(stalled, names))}
    pairs = sum(len(fault.motors) == 2 for fault in faults)
    for fault, begin in zip(faults, first[:-1], strict=True):
        last = begin + fault.ages - 1
        ages = np.arange(begin, last)
        transition[ages, ages + 1] = 1.0
        transition[0, begin] = _BEGINS
        if not fault.motors:
            stop = first[[len(f.motors) for f in faults].index(len(names))]
            ending = ages[_HELD_AT_LEAST - 1 :]
            transition[ending, ending + 1] = 1 - _ENDS - _TIMES_OUT
            transition[ending, 0], transition[ending, stop] = _ENDS, _TIMES_OUT
            transition[last, [0, stop]] = 0.5
        else:
            transition[last, [last, 0]] = 1 - _ENDS, _ENDS
        if len(fault.motors) == len(names):
            initial[last] = _UNARMED
        elif len(fault.motors) == 2:
            transition[0, begin] *= _PAIR * len(names) / pairs
        everything = len(fault.motors) in (0, len(names))
        for cause in (
            [RADIO_OUT] if everything else [stalled(names[motor]) for motor in fault.motors]
        ):
            causes[cause][begin : last + 1] = True
    transition[0, -1] = _COMES
    transition[-1, [-1, 0]] = 1 - _PASSES, _PASSES
    transition[0, 0], initial[0] = 1 - transition[0].sum(), 1 - initial.sum()
    causes[UNEXPLAINED] = np.arange(size) == size - 1
    return Chain(transition, initial, causes)


def state_probabilities(
    log_likelihood: Float[np.ndarray, "K S"],
    transition: Float[np.ndarray, "S S"],
    initial: Float[np.ndarray, " S"],
) -> Float[np.ndarray, "K S"]:
    """Return the probabilities of the states of a hidden Markov chain, given all observations.

    L. E. Baum, T. Petrie, G. Soules and N. Weiss, Annals of Mathematical Statistics 41 (1970)
    164-171, scaled at every step (Rabiner, Proceedings of the IEEE 77, 1989, sec. V.A).
    """
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    forward = np.empty_like(likelihood)
    now = initial
    for k, seen in enumerate(likelihood):
        now = now * seen
        now /= now.sum()
        forward[k] = now
        now = now @ transition
    later = np.ones(len(initial))
    for k in range(len(likelihood) - 1, -1, -1):
        forward[k] *= later
        forward[k] /= forward[k].sum()
        later = transition @ (likelihood[k] * later)
        later /= later.sum()
    return forward
