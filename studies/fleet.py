"""Several craft on one table: contacts, gaps and times of four methods on the same draws.

    OPENBLAS_NUM_THREADS=1 python studies/fleet.py -o fleet.jsonl --kind starts --flights 1000
    OPENBLAS_NUM_THREADS=1 python studies/fleet.py -o fleet.jsonl --method central --flights 50
    OPENBLAS_NUM_THREADS=1 python studies/fleet.py -o fleet.jsonl --kind named --method published

Crossings draw four to six craft: starts, goals, yaws, and models. A third of the craft have four
propellers, the others are the paper's M3, published or identified anew. Identified craft do not fly
their model, but one drawn within its stated uncertainty. 30 % of the messages are lost, the others
take 10 to 30 ms; the radio jitters by 7 ms, as in the packaged twin. In every tenth flight a craft
dies. `--kind scaling` draws 2 to 10 craft, `--kind named` flies the packaged scenarios, and in
`--kind starts` motors fail to start as often as the paper's do; in `--kind resting`, too, and the
controllers, unlike ours, let motors rest.

Models are identified once (two minutes) in the folder of the file. Each flight appends a line of
JSON; an interrupted study resumes. `central` is not flown: it starts from the lines of ours.
`--summary` only reads the file.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from false_alarms import craft
from fleet_methods import INTERVALS, Published, TimedPilot, Voronoi, central
from kept import Kept
from verdicts import drawn

from airpuck import identify, preprocess
from airpuck.control.tuning import tuning_for
from airpuck.fleet.flight import FleetFlight, fly_together
from airpuck.fleet.path import reach_of
from airpuck.fleet.scenario import (
    Death,
    Fleet,
    FleetCraft,
    Network,
    Scenario,
    packaged_scenarios,
    read_fleet,
)
from airpuck.model.model_file import Model, read_model
from airpuck.model.tolerances import geometry_shifts
from airpuck.twin.experiments import excite
from airpuck.twin.settings import read_twin_settings

PILOTS = {"ours": TimedPilot, "published": Published, "voronoi": Voronoi}
KINDS = ("crossings", "named", "scaling", "starts", "resting")
NETWORK = Network(loss=0.3, delay_s=(0.01, 0.03))
#: Length of the flight that a model is identified from [s], and number of drawn true craft.
EXCITED, TRUTHS = 40.0, 8
#: Distance of two starts, or two goals: a little more than two rooms [m].
ROOM = 0.23
#: Least acceleration on a path of a drawn craft [m/s²].
LEAST_PUSH = 0.8
#: Edges of the histogram of computing times [s].
EDGES = np.geomspace(2e-5, 0.5, 241)
#: Number of craft in scaling draws, in turn.
COUNTS = (2, 3, 4, 6, 8, 10)


def prepare(folder: Path) -> dict[str, list[str]]:
    """Identify a craft of each kind; return the names of their true models."""
    folder.mkdir(parents=True, exist_ok=True)
    truths = {kind: [f"{kind}_{k}.toml" for k in range(TRUTHS)] for kind in ("six", "four")}
    for number, kind in ((6, "six"), (4, "four")):
        file = folder / f"{kind}.toml"
        if not file.exists():
            true = craft(6) if number == 6 else four_propellers()
            identify(preprocess(excite(true, EXCITED, 1, amplitude=0.6), true.vehicle)).model.save(
                file
            )
        model, rng = read_model(file), np.random.default_rng(number)
        for own in truths[kind]:
            true = within(model, rng)
            if not (folder / own).exists():
                true.save(folder / own)
    return truths


def four_propellers() -> Model:
    """Draw a craft that fits the table, and is not too weak for it."""
    rng = np.random.default_rng(0)
    while True:
        model, _ = drawn(rng)
        vehicle = model.vehicle
        if vehicle.n_propellers != 4 or not 0.15 < vehicle.mass_kg < 0.25:
            continue
        if reach_of(model, tuning_for(model), 1.0).push > LEAST_PUSH:
            return model


def within(model: Model, rng: np.random.Generator) -> Model:
    """Draw a craft within the model's uncertainty and its vehicle's tolerances."""
    (sample,) = model.sample(1, int(rng.integers(2**31)))
    shifts = geometry_shifts(model.parameters, model.vehicle, model.free)
    vector = sample.parameters.to_vector() + rng.normal(size=len(shifts)) @ shifts
    return replace(sample, parameters=sample.parameters.with_vector(vector))


def crossing(draw: int, folder: Path, truths: dict[str, list[str]], count: int | None) -> Fleet:
    """Draw a crossing; `count`: of this many craft, with nobody dying."""
    rng = np.random.default_rng([46, draw, count or 0])
    number = count or int(rng.integers(4, 7))
    found: list[FleetCraft] = []
    places: list[list[np.ndarray]] = [[], []]
    for k in range(number):
        kind = ("four", "paper:M3", "six")[int(rng.integers(3))]
        truth = None if kind == "paper:M3" else str(rng.choice(truths[kind]))
        model = kind if truth is None else f"{kind}.toml"
        poses = []
        for taken in places:
            pose = np.array([9.0, 9.0])
            while any(math.dist(pose, one) < ROOM for one in taken) or pose[0] > 2:
                pose = rng.uniform(-1, 1, 2) * (1.1 - ROOM / 2, 0.55 - ROOM / 2)
            taken.append(pose)
            poses.append((*pose.round(4).tolist(), round(float(rng.uniform(-np.pi, np.pi)), 4)))
        start, goal = poses
        found.append(FleetCraft(name=f"h{k}", model=model, truth=truth, start=start, goal=goal))
    deaths = ()
    if count is None and draw % 10 == 9:
        dies = Death(
            craft=f"h{rng.integers(number)}", time_s=round(float(rng.uniform(0.5, 2.5)), 2)
        )
        deaths = (dies,)
    return Fleet(Scenario(craft=tuple(found), network=NETWORK, deaths=deaths), folder)


def fleet_of(kind: str, draw: int, folder: Path, truths: dict[str, list[str]]) -> Fleet:
    """Return the fleet of a flight."""
    if kind == "named":
        fleet = read_fleet(packaged_scenarios()[draw])
        fleet.scenario = fleet.scenario.model_copy(update={"network": NETWORK})
        return fleet
    fleet = crossing(
        draw, folder, truths, COUNTS[draw % len(COUNTS)] if kind == "scaling" else None
    )
    if kind in ("starts", "resting"):
        starts = read_twin_settings("paper:starts").starts
        fleet.settings = fleet.settings.model_copy(update={"starts": starts})
    if kind == "resting":
        for one in fleet.members:
            one.tuning = one.tuning.model_copy(update={"least_command": 0.0})
    return fleet


def flown(fleet: Fleet, method: str, seed: int, timed: bool) -> dict[str, Any]:
    """Fly once; `timed`: measure processor times."""
    pilots: list[TimedPilot] = []

    def pilot(*arguments: Any, **options: Any) -> TimedPilot:
        pilots.append(PILOTS[method](*arguments, **options))
        pilots[-1].timed = timed
        return pilots[-1]

    flight = fly_together(fleet, seed, pilot=pilot)
    line = {
        "craft": len(fleet.names),
        "settled": flight.settled,
        "arrived": dict(flight.arrived),
        "died": dict(flight.died),
        "contacts": [list(one) for one in flight.contacts],
        "least_gap": flight.least_gap,
        "strayed": [round(float(one), 5) for one in flight.strayed],
        "margins": [round(float(one), 5) for one in flight.margins],
        "blocked": blocked(fleet, flight),
        "wall": histogram(flight.computing_s),
        "processor": histogram([took for one in pilots for took in one.processor]),
    }
    if method == "ours" and math.isfinite(flight.settled) and not flight.died:
        chosen = np.searchsorted(flight.time, np.linspace(0, flight.settled, INTERVALS + 1))
        line["paths"] = flight.paths[chosen].round(4).tolist()
    return line


def blocked(fleet: Fleet, flight: FleetFlight) -> bool:
    """Return whether a dead craft rests where a live one wants to be."""
    dead = [flight.names.index(name) for name in flight.died]
    rooms = [one.reach.room for one in fleet.members]
    return any(
        math.dist(flight.poses[-1, k, :2], one.goals[-1][:2]) < rooms[k] + one.reach.room
        for k in dead
        for j, one in enumerate(fleet.members)
        if j not in dead
    )


def histogram(times: Any) -> dict[str, int]:
    """Count computing times by the intervals of `EDGES`."""
    counts = np.bincount(np.searchsorted(EDGES, np.array(times)), minlength=1)
    return {str(k): int(count) for k, count in enumerate(counts) if count}


def quantile(lines: Iterable[dict[str, Any]], field: str, share: float) -> float:
    """Return a quantile of all computing times [ms], to 4 %."""
    total = np.zeros(len(EDGES) + 1)
    for line in lines:
        for k, count in line[field].items():
            total[int(k)] += count
    index = int(np.searchsorted(np.cumsum(total), share * total.sum()))
    return 1e3 * float(EDGES[min(index, len(EDGES) - 1)]) if total.any() else math.nan


def optimum(fleet: Fleet, ours: dict[str, Any], draw: int) -> dict[str, Any]:
    """Solve the problem for all, starting from what we flew."""
    border = [fleet.settings.table.reach(one.reach.room) for one in fleet.members]
    return central(fleet.members, border, np.array(ours["paths"]), ours["settled"], draw)


def summary(lines: list[dict[str, Any]]) -> None:
    """Print a table for each kind."""
    for kind in KINDS:
        for method in (*PILOTS, "central"):
            own = [one for one in lines if (one["kind"], one["method"]) == (kind, method)]
            if own and method == "central":
                against_central(lines, own, kind)
            elif own:
                print(f"{kind}, {method}")
                table(own)
            if kind == "scaling" and own:
                for count in COUNTS:
                    some = [one for one in own if one["craft"] == count]
                    if some:
                        print(f"  {count} craft: {times(some)}; arrived after {arrival(some)}")
            for one in own if kind == "named" else ():
                print(
                    f"  {one['name']}: {one['settled']:.2f} s, smallest gap "
                    f"{100 * one['least_gap']:.1f} cm, {len(one['contacts'])} contacts"
                )


def table(lines: list[dict[str, Any]]) -> None:
    """Print contacts, gaps, deadlocks and computing times."""
    for title, own in (
        ("all live", [one for one in lines if not one["died"]]),
        ("one dies", [one for one in lines if one["died"]]),
    ):
        if not own:
            continue
        live, dead, late = dict[int, int](), [], []
        for one in own:
            for _, first, second, speed in one["contacts"]:
                if {first, second} & set(one["died"]):
                    dead.append(round(speed, 2))
                else:
                    live[one["draw"]] = live.get(one["draw"], 0) + 1
            if not math.isfinite(one["settled"]):
                late.append((one["draw"], "blocked" if one["blocked"] else "deadlock"))
        gaps = [one["least_gap"] for one in own]
        print(f"  {title}: {len(own)} flights, arrived after {arrival(own)}")
        print(f"    {sum(live.values())} contacts of live craft, in {len(live)} draws: {[*live]}")
        low = "{:.0f}, {:.0f}, {:.0f} mm".format(*(1e3 * np.quantile(gaps, [0, 0.1, 0.5])))
        print(f"    smallest gaps, least, 10 % and median: {low}")
        print(f"    {len(dead)} contacts with a dead craft, closing at {dead} m/s")
        print(f"    not all arrived: {late}")
        ratios = [s / m for one in own if not one["died"] for s, m in pairs(one)]
        if ratios:
            over = sum(one > 1 for one in ratios)
            print(
                f"    {over} of {len(ratios)} strayed beyond the margin; at most {max(ratios):.2f}"
            )
    print(f"  {times(lines)}")


def pairs(line: dict[str, Any]) -> Iterable[tuple[float, float]]:
    """Return each craft's largest distance from its path, and its margin."""
    return zip(line["strayed"], line["margins"], strict=True)


def times(lines: list[dict[str, Any]]) -> str:
    """Write quantiles of the computing time."""
    found = [quantile(lines, field, q) for field in ("processor", "wall") for q in (0.5, 0.999)]
    return "step p50 {:.2f} ms, p99.9 {:.2f} ms of processor; clock {:.2f}, {:.2f} ms".format(
        *found
    )


def arrival(lines: list[dict[str, Any]]) -> str:
    """Write the median and the 90 % quantile of the time until all have arrived."""
    median, most = np.quantile([one["settled"] for one in lines], [0.5, 0.9], method="higher")
    return f"{median:.2f} s (90 %: {most:.2f} s)"


def against_central(lines: list[dict[str, Any]], optima: list[dict[str, Any]], kind: str) -> None:
    """Print our times over those of the problem for all."""
    solved = {one["draw"]: one for one in optima if math.isfinite(one["rest"])}
    print(f"central: {len(solved)} of {len(optima)} draws solved")
    for method in PILOTS:
        flights = [
            one
            for one in lines
            if (one["kind"], one["method"]) == (kind, method) and one["draw"] in solved
        ]
        for title, field in (("until all rest", "rest"), ("until all are near", "within")):
            ratios = [one["settled"] / solved[one["draw"]][field] for one in flights]
            if ratios:
                middle, most = np.quantile(ratios, [0.5, 0.9], method="higher")
                which = f"{method} over central {title}, {len(ratios)} draws"
                print(f"  {which}: {middle:.2f} (90 %: {most:.2f})")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="file of JSON lines")
    parser.add_argument("--kind", choices=KINDS, default="crossings")
    parser.add_argument("--method", choices=(*PILOTS, "central"), default="ours")
    parser.add_argument("--flights", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw")
    parser.add_argument("--summary", action="store_true", help="only summarise the file")
    options = parser.parse_args()
    kept = Kept(options.output)
    kind, method = options.kind, options.method
    known = {(one["kind"], one["draw"], one["method"]): one for one in kept.lines}
    folder = options.output.resolve().parent / "fleet_models"
    truths = {} if options.summary else prepare(folder)
    last = options.first + options.flights
    last = min(last, len(packaged_scenarios())) if kind == "named" else last
    for draw in range(options.first, last):
        ours = known.get((kind, draw, "ours"))
        if options.summary or (kind, draw, method) in known:
            continue
        if method == "central" and (ours is None or "paths" not in ours):
            continue
        fleet = fleet_of(kind, draw, folder, truths)
        line: dict[str, Any] = {"kind": kind, "draw": draw, "method": method}
        line |= {"name": packaged_scenarios()[draw]} if kind == "named" else {}
        if method == "central":
            line |= optimum(fleet, ours, draw)
        else:
            line |= flown(fleet, method, draw, timed=kind == "scaling")
        shown = {k: v for k, v in line.items() if k not in ("wall", "processor", "paths")}
        print(json.dumps(shown), flush=True)
        kept.add(line)
    summary(kept.lines)


if __name__ == "__main__":
    from one_line import run

    run(main)
