"""Forward-backward against the sum over all paths; and the chain of faults."""

from itertools import pairwise, product

import numpy as np

from airpuck.faults.chain import RADIO_OUT, UNEXPLAINED, Fault, fault_chain, state_probabilities

FAULTS = (Fault((0, 1, 2), 5), Fault((), 12), *(Fault((m,), 5) for m in range(3)), Fault((0, 2), 5))
NAMES = ("left", "right", "back")


def test_probabilities_are_sums_over_paths():
    rng = np.random.default_rng(0)
    states, steps = 3, 5
    transition = rng.dirichlet(np.ones(states), states)
    initial, seen = rng.dirichlet(np.ones(states)), rng.normal(size=(steps, states)) * 3
    expected = np.zeros((steps, states))
    for path in product(range(states), repeat=steps):
        weight = initial[path[0]] * np.exp(sum(seen[k, s] for k, s in enumerate(path)))
        weight *= np.prod([transition[a, b] for a, b in pairwise(path)])
        expected[np.arange(steps), path] += weight
    expected /= expected.sum(axis=1, keepdims=True)
    found = state_probabilities(seen, transition, initial)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_long_chains_neither_overflow_nor_vanish():
    seen = np.where(np.arange(20_000)[:, None] % 2 == [0, 1], -900.0, 0.0)
    transition = np.array([[0.5, 0.5], [0.5, 0.5]])
    found = state_probabilities(seen, transition, np.array([0.5, 0.5]))
    np.testing.assert_allclose(found, np.exp(seen), atol=1e-12)


def test_the_chain_is_one():
    chain = fault_chain(FAULTS, NAMES)
    np.testing.assert_allclose(chain.transition.sum(axis=1), 1)
    np.testing.assert_allclose(chain.initial.sum(), 1)
    assert (chain.transition >= 0).all()
    # Every state but normal has its cause; where two motors stand, two.
    times = np.sum(list(chain.causes.values()), axis=0)
    assert times[0] == 0
    assert (times[1:] >= 1).all()
    assert (chain.causes["left stalled"] & chain.causes["back stalled"]).sum() == 5
    assert set(chain.causes) == {RADIO_OUT, UNEXPLAINED, *(f"{name} stalled" for name in NAMES)}


def test_faults_of_motors_last_at_least_a_tenth_of_a_second():
    chain = fault_chain(FAULTS, NAMES)
    states = np.zeros(len(chain.initial))
    states[0] = 1
    states = states @ chain.transition
    broken = states * ~chain.causes[UNEXPLAINED]
    broken[0] = 0
    for _ in range(3):
        broken = broken @ chain.transition
        assert broken[0] == 0
    assert (broken @ chain.transition)[0] > 0
