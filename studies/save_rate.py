"""Share of shots that the craft saves, by the speed of the shots, and a proven bound.

    python studies/save_rate.py -o out --shots 60

Shots start at random places in the other half and go directly towards random points of the goal.
The craft stands at home without prior knowledge of the shot. The bound counts shots that a craft
with full knowledge could touch somewhere on the puck's path, by a proven bound on its acceleration;
its command takes the transport delay. Touching does not imply saving, so the bound is generous.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from one_line import run
from scipy.stats import binomtest

import airpuck
from airpuck.compute.process import keep_compiled_programs
from airpuck.flight.loop import control
from airpuck.physics.puck import PuckState
from airpuck.planning.request import strongest_push
from airpuck.planning.settings import Limits
from airpuck.report.style import drawn, new_figure, styled
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey.game.skills import Stage
from airpuck_hockey.player.player import Player, pitch_of
from airpuck_hockey.puck.prediction import PuckBelief, predict_path

SPEEDS = np.arange(1.0, 10.5, 1.0)
#: Step of the paths of puck and craft in the bound [s].
STEP = 0.001


def shot(stage: Stage, speed: float, rng: np.random.Generator) -> PuckState:
    """Return a shot from the other half at a point of the goal that clears the posts."""
    half = stage.settings.table.goal_width_m / 2 - stage.settings.puck.radius_m
    x, y = rng.uniform([0.33, -0.4], [0.73, 0.4])
    aim = rng.uniform(-half, half)
    way = np.array([-stage.pitch.goal_line - x, aim - y])
    vx, vy = (speed * way / np.hypot(*way)).tolist()
    return PuckState(float(x), float(y), 0.0, vx, vy, 0.0)


def could_be_saved(stage: Stage, start: PuckState) -> bool:
    """Return whether any control of these motors could touch the puck before it is in.

    The bound on the acceleration holds for all yaws; motors begin idle. Time steps are rounded in
    favour of the craft, for its own motion and for the puck's.
    """
    pitch, model = stage.pitch, stage.model
    times = STEP * np.arange(round(3.0 / STEP) + 1)
    idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
    # Accelerations rise as motors speed up, so sums of values at the ends of steps are bounds.
    push = strongest_push(model, Limits(), idle, np.maximum(times - pitch.delay, 0.0) + STEP)
    push[times < pitch.delay - STEP] = 0.0
    reach = STEP * np.cumsum(STEP * np.cumsum(push))
    belief = PuckBelief(0.0, np.array(start), np.zeros((6, 6)))
    places = predict_path(pitch.equipment, belief, times)[:, :2]
    before = places[:, 0] > -pitch.goal_line
    apart = np.linalg.norm(places - pitch.home, axis=1) - pitch.contact_distance
    slack = STEP * np.hypot(start.vx, start.vy)
    return bool((apart <= reach + slack)[before].any())


def saved(stage: Stage, start: PuckState, seed: int) -> bool:
    """Fly the craft against a shot; return whether it saves the goal."""
    player = Player(stage.model, stage.settings, seed=seed)
    twin = stage.twin(start, seed)
    assert twin.play is not None
    puck = twin.play.puck
    assert puck is not None
    for _ in control(player, twin, 4.0):
        if puck.goal or (puck.state.vx > 0 and puck.state.x > -0.5):
            break
    return puck.goal >= 0


@styled
def figure_of(rows: list[dict[str, float]]) -> Figure:
    """Draw both rates over the speed."""
    speed, share, low, high, possible = (
        np.array([row[key] for row in rows])
        for key in ("speed_m_s", "saved", "low_95", "high_95", "possible")
    )
    figure = new_figure(5.5, 3.4)
    axes = figure.subplots()
    axes.plot(speed, 100 * possible, "k--", label="proven bound")
    spread = 100 * np.maximum(np.stack([share - low, high - share]), 0)
    axes.errorbar(speed, 100 * share, spread, fmt="o-", capsize=3, label="saved, 95 % interval")
    axes.set(xlabel="speed of the shot [m/s]", ylabel="shots at the goal [%]", ylim=(0, 103))
    axes.legend(loc="lower left")
    return figure


def main() -> None:
    """Shoot at each speed, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out"))
    parser.add_argument("--shots", type=int, default=60, help="at each speed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    keep_compiled_programs()
    model = airpuck.read_model("paper:M3")
    settings = default_twin_settings().with_usual_delay(model.transport_delay)
    stage = Stage(model, settings, build_plant(model, settings), pitch_of(model, settings))
    rows = []
    for speed in SPEEDS.tolist():
        rng = np.random.default_rng([options.seed, round(10 * speed)])
        starts = [shot(stage, speed, rng) for _ in range(options.shots)]
        possible = np.mean([could_be_saved(stage, start) for start in starts])
        count = sum(saved(stage, start, k) for k, start in enumerate(starts))
        interval = binomtest(count, options.shots).proportion_ci(method="wilson")
        rows.append(
            {
                "speed_m_s": speed,
                "saved": count / options.shots,
                "low_95": float(interval.low),
                "high_95": float(interval.high),
                "possible": float(possible),
            }
        )
        said = f"{speed:4.0f} m/s: {count} of {options.shots} saved, possible {possible:.0%}"
        print(said, flush=True)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "save_rate.json").write_text(json.dumps(rows, indent=1) + "\n")
    (options.output / "save_rate.png").write_bytes(drawn(figure_of(rows), "png"))


if __name__ == "__main__":
    run(main)
