"""Forward-backward: the probability of each hidden state at each step (Baum et al. 1970)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


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
