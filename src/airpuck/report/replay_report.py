"""A report on a replayed flight: what `airpuck replay -o` writes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from airpuck.flight.replay import Replay
from airpuck.model.model_file import Model
from airpuck.report.page import Picture, Section, Table, Text, write_page
from airpuck.report.replay_figures import command_figure, flight_figure, rotation_error_figure

#: What the outcomes of a control step mean, in a sentence each.
OUTCOMES = {
    "exact": "the acceleration asked for is given",
    "scaled": "linear or angular acceleration reduced in its direction",
    "nearest": "no scaling can be met; the nearest acceleration is given",
    "failed": "the solver gave nothing usable; idle",
    "no pose": "none was received yet; idle",
    "stale pose": "the last one is too old; idle",
    "jumping pose": "the last ones are far from where the craft can be; idle",
    "bad input": "a pose or the time is not finite; idle",
    "unsafe": "a guard around the controller forbids it; idle",
}


def replay_report(replay: Replay, model: Model, period: float, out: str | os.PathLike[str]) -> Path:
    """Write a report on a replayed flight."""
    figures = replay.to_json()
    used = replay.time[replay.compared]
    agreement = Table(
        "Agreement of recorded and computed commands, for each motor.",
        ["motor", "correlation", "median |difference|", "90 % |difference|"],
        [
            [
                motor["name"],
                f"{motor['correlation']:.4f}",
                f"{motor['median_abs']:.4f}",
                f"{np.quantile(np.abs(replay.difference[:, i]), 0.9):.4f}",
            ]
            for i, motor in enumerate(figures["motors"])
        ]
        + [["all", "", f"{figures['median_abs']:.4f}", ""]],
    )
    g = replay.gains
    gains = Table(
        "Gains of the regulator" + (", fitted to the recorded commands." if replay.fitted else "."),
        ["position [1/s²]", "speed [1/s]", "yaw [1/s²]", "spin [1/s]"],
        [[f"{v:.2f}" for v in (g.position, g.speed, g.yaw, g.spin)]],
    )
    outcomes = Table(
        "Outcomes of the control steps in this span.",
        ["outcome", "steps", "meaning"],
        [[name, str(count), OUTCOMES[name]] for name, count in figures["outcomes"].items()],
    )
    sections = [
        Section(
            "commands",
            "Commands",
            (
                agreement,
                Picture(
                    "replay_commands",
                    command_figure(replay),
                    "The controller got the recorded poses when they had arrived, and was told the "
                    "recorded commands, so that differences do not add up.",
                ),
            ),
        ),
        Section(
            "flight",
            "Flight",
            (Picture("replay_flight", flight_figure(replay), "Where the craft was asked to be."),),
        ),
        Section("controller", "Controller", (gains, outcomes)),
        Section(
            "discretisation",
            "What the discretisation neglects",
            (
                Picture(
                    "rotation_error",
                    rotation_error_figure(_fastest_spin(replay), period),
                    "A force is taken to keep its direction for a sample time, but it turns "
                    "with the craft by θ = ωh: the velocity gained is off by about θ/2.",
                ),
                Text(
                    [
                        "The next measurement corrects it; it matters for the one-step look-ahead "
                        "only."
                    ]
                ),
            ),
        ),
    ]
    lead = (
        f"{model.name}, {figures['steps']} commands between {used[0]:.1f} and {used[-1]:.1f} s: "
        f"median difference {figures['median_abs']:.4f}, lowest correlation "
        f"{min(m['correlation'] for m in figures['motors']):.3f}."
    )
    return write_page(out, "Replay of a recorded flight", lead, sections)


def _fastest_spin(replay: Replay) -> float:
    """Return the largest spin of the flight, from differences of the yaw [rad/s]."""
    known = np.isfinite(replay.pose[:, 2])
    yaw, time = np.unwrap(replay.pose[known, 2]), replay.time[known]
    # Over five periods: noise of single differences would count as spin.
    turned, taken = yaw[5:] - yaw[:-5], time[5:] - time[:-5]
    return float(np.max(np.abs(turned / taken), initial=0.0)) if (taken > 0).all() else 0.0
