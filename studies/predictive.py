"""The predictive law against the limits of the physics, on the twin of published M3.

    OPENBLAS_NUM_THREADS=1 python studies/predictive.py cost --flights 500
    OPENBLAS_NUM_THREADS=1 python studies/predictive.py rails --flights 1000
    OPENBLAS_NUM_THREADS=1 python studies/predictive.py hostile --flights 100000

cost: closed-loop cost between random poses, compared with converged nonlinear predictive control.
rails: contacts in flights to targets, half of which lie within a centimetre of a rail. hostile:
single steps from random states to random targets, some of them NaN, within limits that cannot be
kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from predictive_limits.converged import Problem
from predictive_limits.cost import compare
from predictive_limits.flights import craft, law
from predictive_limits.hostile import thrown
from predictive_limits.rails import passed

from airpuck.control.predictive import PredictiveSettings


def cost(options: argparse.Namespace) -> None:
    """Compare costs, flight by flight."""
    tuning = law("mpc").model_copy(update={"period_s": options.period})
    problem = Problem(craft(), tuning.of(PredictiveSettings), compiled=options.compile)
    pairs = []
    for seed in range(options.first, options.first + options.flights):
        pairs.append(compare(seed, tuning, options.duration, problem))
        if len(pairs) % 10 and len(pairs) < options.flights:
            continue
        ours, theirs, our_step, their_step, solved = np.array(
            [list(vars(p).values()) for p in pairs]
        ).T
        above = 100 * (ours / theirs - 1)
        middle, most = np.percentile(above, [50, 95])
        faster = np.median(their_step) / np.median(our_step)
        print(
            f"{len(pairs):4d} flights: cost {100 * (ours.sum() / theirs.sum() - 1):.2f} % above "
            f"(flights: median {middle:.2f} %, 95 % below {most:.2f} %, {above.min():.2f} to "
            f"{above.max():.2f} %); step {1e3 * np.median(our_step):.2f} against "
            f"{1e3 * np.median(their_step):.1f} ms, {faster:.0f} times faster; "
            f"{100 * solved.mean():.2f} % of the steps converged",
            flush=True,
        )


def rails(options: argparse.Namespace) -> None:
    """Count contacts of both laws, without and with loss of packets."""
    for kind in ("mpc", "lqr"):
        for loss in (0.0, 0.3):
            flights = [
                passed(seed, law(kind), loss, options.duration) for seed in range(options.flights)
            ]
            met = sum(flight.contacts > 0 for flight in flights)
            nearest = 1e3 * min(flight.clearance for flight in flights)
            left = 1e3 * np.percentile([flight.left for flight in flights], [50, 99])
            unanswered = sum(flight.unanswered for flight in flights)
            print(
                f"{kind}, {100 * loss:.0f} % lost: {met} of {len(flights)} flights met a rail, "
                f"nearest {nearest:.2f} mm; left {left[0]:.1f} mm (99 %: {left[1]:.1f}); "
                f"{unanswered} steps without an answer",
                flush=True,
            )


def hostile(options: argparse.Namespace) -> None:
    """Count outcomes of single steps, and measure their time."""
    found = thrown(law("mpc"), options.flights, options.first)
    p50, p99 = 1e3 * np.percentile(found.spent, [50, 99])
    print(
        f"{len(found.spent)} steps: {found.wrong} commands wrong; {dict(found.statuses)}; "
        f"p50 {p50:.2f}, p99 {p99:.2f}, at most {1e3 * max(found.spent):.1f} ms of the processor"
    )


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "cost": cost,
    "rails": rails,
    "hostile": hostile,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first flight")
    parser.add_argument("--duration", type=float, default=1.2, help="of a flight [s]")
    parser.add_argument("--period", type=float, default=0.02, help="between commands [s], of cost")
    parser.add_argument("--compile", action="store_true", help="derivatives by the C compiler")
    options = parser.parse_args()
    PARTS[options.part](options)


if __name__ == "__main__":
    from one_line import run

    run(main)
