"""Lower bounds against flights: no flight may be faster than its bound.

    python studies/bounds.py --cases 1000 -o bounds.json
    python studies/bounds.py --sharp --cases 100 -o sharp.json

Every flight is simulated within the limits, so its end can be reached in its time. There are two
kinds. `case` draws flights at random: the motors switch by a weight and a price of the moment,
which leaves the bound well below the flight. `sharp` flies as fast as any craft can: an arc at the
limit of the yaw rate, around the yaw of the strongest push, with the motors of the strongest push
at each yaw. These flights reveal a bound that is 2 % too high (`--mutate 0.98` reduces the
thrusts). In every case the program tries to refute the flight's own time; for sharp flights and
every tenth other one `lower_bound` searches for the longest time that it refutes.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

import airpuck
from airpuck.craft.vehicle import Nominal, Propeller, Vehicle
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.quantities import EFFECTS
from airpuck.physics.effects import Effect, Layout
from airpuck.physics.thrust import inverse_thrust, thrust

# The bound is public, but not the two sides of the inequality that it rests on.
from airpuck.planning.certificate import _COARSE, _needed, lower_bound
from airpuck.planning.request import Goal, Request
from airpuck.planning.settings import Limits
from airpuck.planning.yaw_program import Weight, YawProgram

#: Steps of the simulation [s].
STEP = 2.5e-3
#: Sharp flights: their yaw rate, as a fraction of its limit; time in which it is corrected [s];
#: and what is added to the seed of a flight that exceeded the limit.
HELD, CORRECTED, SEEDS = 0.99, 0.05, 10_000
#: Largest coefficients of each effect.
COEFFICIENTS = {
    "drag": (0.2, 0.1, 0.5, 0.02),
    "inflow": 0.05,
    "pair_interaction": 0.5,
    "voltage_sag": 0.05,
    "tilt": (0.02, -0.01),
    "idle_lag": 1.0,
}


@dataclass(frozen=True, eq=False)
class Boost(Effect):
    """A user's effect: every thrust times a factor, with its bounds."""

    factor: float = 1.5

    def thrust(self, xp, thrust, motion):
        """Multiply the thrusts."""
        return thrust * self.factor

    def thrust_bounds(self, low, high, within):
        """Multiply both ends."""
        return low * self.factor, high * self.factor


@dataclass(frozen=True, eq=False)
class Affected(Model):
    """A model whose dynamics have further effects."""

    added: tuple[Effect, ...] = ()

    @cached_property
    def dynamics(self):
        """Equations of motion with all effects."""
        known = Model.dynamics.__get__(self)
        return replace(known, effects=(*known.effects, *self.added))


def affected(model: Model, *effects: Effect) -> Affected:
    """Add effects to a model."""
    return Affected(**vars_of(model), added=effects)


def vars_of(model: Model) -> dict:
    """Return the fields of a model."""
    return {name: getattr(model, name) for name in Model.__dataclass_fields__}


def craft(random, kind: int) -> Model:
    """Draw a craft: three, four, six or eight propellers, strong or weak, fast or slow."""
    scale, lag = random.uniform(0.4, 1.6), random.uniform(0.01, 0.1)
    offset = random.uniform(-4e-3, 4e-3, 2) * (random.random() < 0.5)
    if kind == 6:
        model = airpuck.read_model("paper:M3")
        parameters = replace(
            model.parameters,
            thrust=model.parameters.thrust * scale,
            motor_time_constant=lag,
            center_of_mass=offset,
        )
        return replace(model, parameters=parameters)
    around = 2 * np.pi * np.arange(kind) / kind
    leaning = 90.0 + random.uniform(-50, 50)
    propellers = tuple(
        Propeller(
            name=f"p{k}",
            position_m=(0.05 * np.cos(angle), 0.05 * np.sin(angle)),
            direction_deg=float(np.rad2deg(angle) + (leaning if k % 2 else -leaning)),
        )
        for k, angle in enumerate(around)
    )
    nominal = Nominal(
        thrust_N=(0.1 * scale, 0.4 * scale),
        inertia_kg_m2=random.uniform(2e-4, 8e-4),
        motor_time_constant_s=lag,
    )
    vehicle = Vehicle(name="ring", mass_kg=0.25, propellers=propellers, nominal=nominal)
    model = nominal_model(vehicle)
    return replace(model, parameters=replace(model.parameters, center_of_mass=offset))


def with_effect(model: Model, number: int) -> tuple[str, Model]:
    """Add the effect with this number, or none."""
    names = ("none", *COEFFICIENTS, "boost")
    name = names[number % len(names)]
    if name == "none":
        return name, model
    if name == "boost":
        return name, affected(model, Boost())
    layout = Layout(model.vehicle)
    return name, affected(model, EFFECTS[name].effect.of(layout, COEFFICIENTS[name]))


def flown(random, model: Model, limits: Limits) -> tuple[np.ndarray, Weight]:
    """Simulate a flight whose motors switch by a weight; return its states and the weight."""
    n, duration = model.vehicle.n_propellers, random.uniform(0.15, 1.2)
    still = random.random() < 0.5
    start = np.concatenate([random.uniform(-0.5, 0.5, 2), random.uniform(-3, 3, 1), np.zeros(3)])
    if not still:
        start[3:5] = random.uniform(-1, 1, 2)
        start[5] = random.uniform(-0.8, 0.8) * min(limits.spin, 8.0)
    motors = np.full(n, model.vehicle.command_min)
    if random.random() < 0.5:
        motors = random.uniform(model.vehicle.command_min, model.vehicle.command_max, n)
    direction = np.exp(1j * random.uniform(0, 2 * np.pi))
    turning = direction * 1j * random.normal() * 0.3
    switch = duration * random.uniform(0.3, 1.2)
    weight = Weight(direction * switch, -direction + turning)
    held = random.uniform(-1, 1) * min(limits.spin, 5.0) * (random.random() < 0.5)
    forward, left, turn = np.asarray(model.dynamics.configuration)
    states = [np.concatenate([start, motors])]
    for k in range(int(duration / STEP)):
        state = states[-1]
        seen = np.conj(weight(np.array([k * STEP]))[0]) * np.exp(1j * state[2])
        push = np.real(seen * (forward + 1j * left))
        # A price that limits the spin softly.
        price = -0.02 * (state[5] - held) * abs(seen) * np.abs(forward).max() / np.abs(turn).max()
        price *= 15.0 / limits.spin
        on = push + price * 10 * turn > 0
        command = np.where(on, model.vehicle.command_max, model.vehicle.command_min)
        following = model.simulate(state, command[None], STEP)[-1]
        if abs(following[5]) > limits.spin or np.abs(following[3:5]).max() > limits.speed:
            break
        states.append(following)
    return np.array(states), weight


def case(seed: int) -> tuple[dict, Request, Weight, float]:
    """Draw a flight; return its request, its weight and its time."""
    random = np.random.default_rng(seed)
    kind = (3, 4, 6, 8)[seed % 4]
    name, model = with_effect(craft(random, kind), seed // 4)
    limits = Limits(spin=float(np.exp(random.uniform(0, np.log(40)))), speed=6.0)
    states, weight = flown(random, model, limits)
    while len(states) < 20:
        states, weight = flown(random, model, limits)
    first = int(random.integers(0, len(states) - 15)) if random.random() < 0.3 else 0
    part, weight = states[first:], replace(weight, alpha=weight(np.array([first * STEP]))[0])
    time, end, ending = (len(part) - 1) * STEP, part[-1], "fixed"
    goal = Goal(*end[:3], velocity=tuple(end[3:6]), turn="exact")
    if random.random() < 0.3:
        ending = ("any yaw", "any velocity", "anything", "shorter turn")[seed % 7 % 4]
        goal = Goal(
            end[0],
            end[1],
            None if ending in ("any yaw", "anything") else float(end[2]),
            None if ending in ("any velocity", "anything") else tuple(end[3:6]),
        )
    reach = (np.inf, np.inf)
    if random.random() < 0.3:
        reach = tuple(np.abs(part[:, :2]).max(axis=0))
        kinks = 0.2 * np.exp(1j * random.uniform(0, 2 * np.pi, 1))
        weight = replace(
            weight, kink_times=np.array([time * random.uniform(0.2, 0.9)]), kinks=kinks
        )
    if random.random() < 0.5:
        weight = replace(weight, yaw_price=float(random.normal() * 0.05))
    request = Request(model, part[0], goal, np.zeros((0, 2)), reach, np.zeros((0, 3)), limits)
    about = {"seed": seed, "propellers": kind, "effect": name, "spin": limits.spin}
    return (
        {**about, "ending": ending, "time": time, "rails": bool(reach[0] < np.inf)},
        request,
        weight,
        time,
    )


def strongest(model: Model, angle: float, moment: float) -> tuple[np.ndarray, float]:
    """Return the motor speeds of the largest push at an angle with a moment, and the push."""
    forward, left, turn = np.asarray(model.dynamics.configuration)
    push, vehicle = np.real(np.exp(1j * angle) * (forward + 1j * left)), model.vehicle
    curves, ones = np.asarray(model.dynamics.thrust), np.ones(vehicle.n_propellers)
    ends = [thrust(curves, ones * one) for one in (vehicle.command_min, vehicle.command_max)]
    found = linprog(-push, A_eq=turn[None], b_eq=[moment], bounds=np.transpose(ends))
    if found.x is None:  # The motors cannot produce this moment.
        return strongest(model, angle, moment / 2)
    speeds = inverse_thrust(np, curves, np.clip(found.x, *ends))
    return np.clip(speeds, vehicle.command_min, vehicle.command_max), -found.fun


def sharp(seed: int) -> tuple[dict, Request, Weight, float]:
    """Draw a flight that no craft can beat by much; return what `case` returns."""
    random = np.random.default_rng([seed, 1])
    kind, name = (3, 4, 6, 8)[seed % 4], ("none", "boost")[seed // 4 % 2]
    model = craft(random, kind)
    model = affected(model, Boost()) if name == "boost" else model
    steps = int(random.integers(60, 400))
    time, angle, slope = steps * STEP, random.uniform(0.1, 0.5), random.uniform(0.1, 1.0, 2)
    spin = random.choice([-1, 1]) * angle / time
    limits = Limits(spin=abs(spin) / HELD, speed=20.0)
    angles = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    best = angles[np.argmax([strongest(model, one, 0.0)[1] for one in angles])]
    ahead = random.uniform(-np.pi, np.pi)
    yaw, lag = best + ahead - spin * time / 2, float(model.dynamics.motor_time_constant)
    left = np.exp(-STEP / lag)
    place, speed = random.uniform(-0.5, 0.5, 2), random.uniform(-1, 1, 2)
    motors = strongest(model, yaw - ahead, 0.0)[0]
    states = [np.array([*place, yaw, *speed, spin, *motors])]
    for _ in range(steps):
        now = states[-1]
        moment = (spin - now[5]) / CORRECTED
        wanted, _ = strongest(model, now[2] + spin * STEP - ahead, moment)
        command = (wanted - left * now[6:]) / (1 - left)
        command = np.clip(command, model.vehicle.command_min, model.vehicle.command_max)
        states.append(model.simulate(now, command[None], STEP)[-1])
    if max(abs(state[5]) for state in states) > limits.spin:
        return sharp(seed + SEEDS)
    end, direction = states[-1], np.exp(1j * ahead)
    weight = Weight(direction * slope[0], direction * (slope[1] - slope[0]) / time)
    goal = Goal(*end[:3], velocity=tuple(end[3:6]), turn="exact")
    everywhere = np.zeros((0, 2)), (np.inf, np.inf), np.zeros((0, 3))
    request = Request(model, states[0], goal, *everywhere, limits)
    about = {"seed": seed, "propellers": kind, "effect": name, "spin": limits.spin}
    return {**about, "ending": "sharp", "time": time}, request, weight, time


def missing_at(request: Request, weight: Weight, duration: float) -> tuple[float, float, float]:
    """Return the integral that a flight requires, its upper bound, and the scale of both."""
    program = YawProgram(request, weight, duration, _COARSE, np.zeros(1))
    needed = _needed(request, program, np.zeros(1))
    return float(needed[-1, 0]), float(program.most[-1, 0]), program.worth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--sharp", action="store_true", help="Draw sharp flights instead of arbitrary ones."
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--mutate", type=float, default=1.0, help="Factor on the thrusts.")
    parser.add_argument("-o", "--output", required=True)
    given = parser.parse_args()
    rows = []
    for seed in range(given.first, given.first + given.cases):
        row, request, weight, time = (sharp if given.sharp else case)(seed)
        needed, most, scale = missing_at(request, weight, time)
        row["room"] = (given.mutate * most - needed) / scale
        row["wrong"] = bool(row["room"] < 0)
        if (given.sharp or seed % 10 == 0) and given.mutate == 1.0:
            row["bound"] = lower_bound(request, weight, time)
            row["wrong"] = row["wrong"] or bool(row["bound"] > time)
        rows.append(row)
        if row["wrong"]:
            print(row, flush=True)
    room = np.array([row["room"] for row in rows])
    shares = np.array([row["bound"] / row["time"] for row in rows if "bound" in row])
    summary = {
        "cases": len(rows),
        "violations": sum(row["wrong"] for row in rows),
        "room": np.quantile(room, [0, 0.05, 0.25, 0.5, 0.75]).tolist(),
        "bound_share": np.quantile(shares, [0.25, 0.5, 0.75, 0.9, 1]).tolist()
        if len(shares)
        else [],
    }
    Path(given.output).write_text(json.dumps({"summary": summary, "rows": rows}, indent=1))
    print(json.dumps(summary))


if __name__ == "__main__":
    from one_line import run

    run(main)
