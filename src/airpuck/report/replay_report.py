"""A report on a replayed flight: what `airpuck replay -o` writes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.control.discretization import rotation_error
from airpuck.data.trajectory import runs
from airpuck.flight.replay import Replay
from airpuck.model.model_file import Model
from airpuck.physics.angle import wrapped
from airpuck.report import style
from airpuck.report.page import Origin, Picture, Section, Table, Text, write_page

#: What the outcomes of a control step mean.
OUTCOMES = {
    "exact": "the acceleration asked for is given",
    "scaled": "linear or angular acceleration reduced in its direction",
    "nearest": "no scaling can be met; the nearest acceleration is given",
    "optimal": "the best commands over the horizon, within all limits",
    "softened": "the same, beyond a limit of the motion by as little as possible",
    "iteration limit": "the solver gave nothing usable; the plan of the step before is flown on",
    "fallback": "no plan is left; an LQR steers",
    "open loop": "a pilot without a law",
    "failed": "the solver gave nothing usable; idle",
    "no pose": "none was received yet; idle",
    "stale pose": "the last one is too old; idle",
    "jumping pose": "the last ones are far from where the craft can be; idle",
    "bad input": "a pose or the time is not finite; idle",
    "unsafe": "a guard around the controller forbids it; idle",
}


def replay_report(
    replay: Replay,
    model: Model,
    period: float,
    out: str | os.PathLike[str],
    origin: Origin | None = None,
) -> Path:
    """Write a report on a replayed flight, flown with a control period [s]."""
    figures = replay.to_json()
    used = replay.time[replay.compared]
    commands = (
        "The controller got the recorded poses when they had arrived, and the recorded commands as "
        "those sent, so that differences do not add up."
    )
    turning = (
        "A force is taken to keep its direction for a sample time, but it turns with the craft by "
        "θ = ωh: the velocity gained is off by about θ/2."
    )
    error = rotation_error_figure(_fastest_spin(replay), period)
    corrected = "The next measurement corrects it; it matters for the one-step look-ahead only."
    asked = Picture("replay_flight", flight_figure(replay), "Where the craft was asked to be.")
    compared = Picture("replay_commands", command_figure(replay), commands)
    neglected = (Picture("rotation_error", error, turning), Text([corrected]))
    sections = [
        Section("commands", "Commands", (_agreement_table(replay), compared)),
        Section("flight", "Flight", (asked,)),
        Section("controller", "Controller", _controller_tables(replay)),
        Section("discretisation", "What the discretisation neglects", neglected),
    ]
    lead = (
        f"{model.name}, {figures['steps']} commands between {used[0]:.1f} and {used[-1]:.1f} s: "
        f"median difference {figures['median_abs']:.4f}, lowest correlation "
        f"{min(m['correlation'] for m in figures['motors']):.3f}."
    )
    return write_page(out, "Replay of a recorded flight", lead, sections, origin)


def _agreement_table(replay: Replay) -> Table:
    """Tabulate how well recorded and computed commands agree."""
    figures, size = replay.to_json(), np.abs(replay.difference)
    rows = [
        [m["name"], f"{m['correlation']:.4f}", f"{m['median_abs']:.4f}", f"{widest:.4f}"]
        for m, widest in zip(figures["motors"], np.quantile(size, 0.9, axis=0), strict=True)
    ]
    return Table(
        "Agreement of recorded and computed commands, for each motor.",
        ["motor", "correlation", "median |difference|", "90 % |difference|"],
        [*rows, ["all", "", f"{figures['median_abs']:.4f}", ""]],
    )


def _controller_tables(replay: Replay) -> list[Table]:
    """Tabulate the gains, if the law has any, and what became of the control steps."""
    tables = []
    if replay.gains is not None:
        g, fitted = replay.gains, ", fitted to the recorded commands" if replay.fitted else ""
        tables.append(
            Table(
                f"Gains of the regulator{fitted}.",
                ["position [1/s²]", "speed [1/s]", "yaw [1/s²]", "spin [1/s]"],
                [[f"{v:.2f}" for v in (g.position, g.speed, g.yaw, g.spin)]],
            )
        )
    counts = replay.to_json()["outcomes"]
    outcomes = Table(
        "Outcomes of the control steps in this span.",
        ["outcome", "steps", "meaning"],
        [[name, str(count), OUTCOMES[name]] for name, count in counts.items()],
    )
    return [*tables, outcomes]


def _fastest_spin(replay: Replay) -> float:
    """Return the largest spin of the flight, from differences of the yaw [rad/s]."""
    known = np.isfinite(replay.pose[:, 2])
    yaw, time = np.unwrap(replay.pose[known, 2]), replay.time[known]
    # Over five periods: noise of single differences would count as spin.
    turned, taken = yaw[5:] - yaw[:-5], time[5:] - time[:-5]
    return float(np.max(np.abs(turned / taken), initial=0.0)) if (taken > 0).all() else 0.0


@style.styled
def command_figure(replay: Replay) -> Figure:
    """Draw the recorded and the computed command of every motor over time."""
    n = len(replay.motors)
    figure = style.new_figure(style.PAGE_WIDTH, 0.5 + 1.35 * ((n + 1) // 2))
    titles = [
        f"{m['name']}: r = {m['correlation']:.3f}, median |Δ| {m['median_abs']:.4f}"
        for m in replay.to_json()["motors"]
    ]
    outside = _outside(replay)
    for i, axes in enumerate(style.motor_panels(figure, titles)):
        axes.plot(replay.time, replay.sent[:, i], color=style.GREY, linewidth=2.2)
        axes.plot(replay.time, replay.computed[:, i], color=style.VERMILLION, linewidth=0.9)
        for start, stop in outside:
            axes.axvspan(start, stop, color=style.LIGHT, linewidth=0, alpha=0.6)
        axes.set_xlim(replay.time[0], replay.time[-1])
    handles: list[Artist] = [
        style.key("sent in the flight", style.GREY, linewidth=2.2),
        style.key("computed by this controller", style.VERMILLION, linewidth=0.9),
    ]
    if outside:
        handles.append(Patch(color=style.LIGHT, alpha=0.6, label="not compared"))
    style.top_legend(figure, handles)
    return figure


@style.styled
def flight_figure(replay: Replay) -> Figure:
    """Draw what the craft did beside what it was asked to do."""
    figure = style.new_figure(style.PAGE_WIDTH, 4.4)
    panels = style.pose_panels(figure)
    pose, asked = replay.pose.copy(), replay.reference.copy()
    # The yaw is drawn continuous, and a set point in the turn that is nearest to the craft.
    known = np.isfinite(pose[:, 2])
    pose[known, 2] = np.unwrap(pose[known, 2])
    asked[known, 2] = (pose[:, 2] - wrapped(np, pose[:, 2] - asked[:, 2]))[known]
    for i, axes in enumerate(panels):
        axes.plot(replay.time, asked[:, i], color=style.BLACK, linewidth=1.0, linestyle="--")
        axes.plot(replay.time, pose[:, i], color=style.BLUE)
    panels[-1].set_xlim(replay.time[0], replay.time[-1])
    craft = style.key("the craft, as the controller saw it", style.BLUE)
    style.top_legend(figure, [craft, style.key("set point", linewidth=1.0, linestyle="--")])
    return figure


@style.styled
def rotation_error_figure(fastest: float, period: float) -> Figure:
    """Draw what the discretisation neglects: the craft turns while a force is held."""
    figure = style.new_figure(0.75 * style.PAGE_WIDTH, 3.0)
    axes = figure.subplots()
    spin = np.geomspace(0.1, 50, 200)
    periods = sorted({0.002, 0.005, 0.01, 0.02, 0.05, period})
    for shade, h in zip(np.linspace(0.25, 1.0, len(periods)), periods, strict=True):
        error = 100 * rotation_error(spin, np.full_like(spin, h))
        flown: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 2.2}
        other: dict[str, Any] = {"color": style.BLUE, "linewidth": 1.2, "alpha": shade}
        axes.loglog(spin, error, **flown if h == period else other)
        style.note(axes, f"{1e3 * h:g} ms", (spin[-1], error[-1]), (4, 0), va="center", fontsize=8)
    if fastest > 0:
        at = 100 * float(rotation_error(np.array(fastest), np.array(period)))
        axes.plot([fastest], [at], "o", color=style.ORANGE, markeredgecolor=style.BLACK, zorder=5)
        words = f"fastest spin flown: {fastest:.1f} rad/s, {at:.1f} %"
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        style.note(axes, words, (fastest, at), (8, -12), va="top", bbox=box)
    axes.set(xlim=(spin[0], 75), xlabel="spin |ω| [rad/s]")
    axes.set_ylabel("relative error of the\nvelocity gained in a period [%]")
    axes.set_title("Neglected turning within a sample time", loc="left")
    return figure


def _outside(replay: Replay) -> list[tuple[float, float]]:
    """Return the spans of time that are not compared."""
    time = np.append(replay.time, replay.time[-1])
    return [(float(time[a]), float(time[b])) for a, b in runs(~replay.compared)]
