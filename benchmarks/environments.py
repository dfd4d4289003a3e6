"""Returns of the environments' baselines, and steps per second.

    python -m benchmarks.environments --episodes 30      # returns of all environments, minutes
    python -m benchmarks.environments --speed            # one environment against many at once

The scripted policy is the package's own, from observations alone; the random one draws each command
between 0 and 1. Episode k has the seed k. Speeds are medians, with random commands.
"""

from __future__ import annotations

import argparse
import statistics
import time
from functools import partial

import gymnasium
import numpy as np

from airpuck.export.gym import ENVIRONMENTS
from airpuck_hockey.export.gym_game import GameEnv


def random_flights(name: str, episodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of rewards and successes of random commands, all episodes at once."""
    env = gymnasium.make_vec(f"airpuck/{name}-v0", num_envs=episodes)
    env.reset(seed=0)
    env.action_space.seed(0)
    totals, success, over = np.zeros(episodes), np.zeros(episodes, bool), np.zeros(episodes, bool)
    while not over.all():
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        totals += np.where(over, 0.0, reward)
        success |= terminated & ~over
        over |= terminated | truncated
    return totals, success


def returns(name: str, scripted: bool, episodes: int):
    """Return sums of rewards and successes of the single environment."""
    env, totals, successes = gymnasium.make(f"airpuck/{name}-v0").unwrapped, [], []
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        env.action_space.seed(seed)
        policy = env.baseline() if scripted else lambda _: env.action_space.sample()
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, info = env.step(policy(observation))
            total, over = total + reward, terminated or truncated
        totals.append(total)
        successes.append(info["is_success"])
    return totals, successes


def games(episodes: int) -> list[float]:
    """Return the results of the scripted policy against the random one, on alternate sides."""
    env, totals = GameEnv(), []
    for seed in range(episodes):
        observations, _ = env.reset(seed=seed)
        side = env.agents[seed % 2]
        policy, total = env.baseline(), 0.0
        while env.agents:
            actions = {name: env.action_space(name).sample() for name in env.agents}
            actions[side] = policy(observations[side])
            observations, rewards, *_ = env.step(actions)
            total += rewards[side]
        totals.append(total)
    return totals


def speed(env, count: int, steps: int) -> float:
    """Return steps of a craft per second."""
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(steps)]
    env.step(actions[0])  # compiles
    times = []
    for action in actions:
        begun = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        times.append(time.perf_counter() - begun)
        if count == 1 and (terminated or truncated):
            env.reset()
    return count / statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--only", nargs="*", default=[*ENVIRONMENTS], help="environments")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--craft", type=int, nargs="+", default=[1, 64, 1024])
    parser.add_argument("--steps", type=int, default=500)
    options = parser.parse_args()
    if options.speed:
        env = gymnasium.make("airpuck/SetPoint-v0").unwrapped
        single = speed(env, 1, options.steps)
        print(f"single: {single:.0f} steps/s")
        for count in options.craft:
            many = gymnasium.make_vec("airpuck/SetPoint-v0", num_envs=count)
            found = speed(many, count, options.steps)
            print(f"vector of {count}: {found:.0f} steps/s, {found / single:.1f} times", flush=True)
        return
    for name in options.only:
        for scripted in (True, False):
            at_once = not scripted and gymnasium.spec(f"airpuck/{name}-v0").vector_entry_point
            fly = random_flights if at_once else partial(returns, scripted=scripted)
            totals, successes = fly(name, episodes=options.episodes)
            kind = "scripted" if scripted else "random"
            mean, share = np.mean(totals), np.mean(successes)
            error = np.std(totals, ddof=1) / len(totals) ** 0.5
            print(f"{name:8} {kind:8} {mean:7.2f} ± {error:.2f}, success {share:.0%}", flush=True)
    results = games(options.episodes // 2)
    won, lost = results.count(1.0), results.count(-1.0)
    print(f"Game      scripted against random: {won} won, {lost} lost of {len(results)}")


if __name__ == "__main__":
    main()
