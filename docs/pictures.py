"""Pictures of the guides, each from a simulated flight or a stated measurement.

    python docs/pictures.py              # all of them, in two minutes; AIRPUCK_DATA for `tracking`
    python docs/pictures.py control      # one

They are as wide as a phone's screen, on a white ground, which the site inverts in dark mode.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch
from PIL import Image, ImageSequence

import airpuck
from airpuck.control.tuning import tuning_for
from airpuck.flight.loop import pilot_named
from airpuck.report import style
from airpuck.report.commissioning_report import flights_figure, interval_figure
from airpuck.twin.experiments import course_plan
from airpuck.twin.settings import default_twin_settings

FOLDER = Path(__file__).parent / "images"
#: Width [in] and resolution [1/in]: text of 9 pt is as large as a phone's own.
WIDTH, RESOLUTION = 4.4, 220
TEXT: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "legend.fontsize": 8.5,
    "font.family": "DejaVu Sans",
}
#: Three set points of a flight, with the times at which they begin [s].
SET_POINTS = airpuck.SetPoints(
    [0.0, 0.5, 2.5, 4.5], [(0, 0, 0), (0.7, 0.25, 1.5), (-0.6, -0.2, -1.0), (0, 0, 0)]
)
#: Plain names of the rungs that the pictures compare.
RUNGS = {"M0": "without motor lag (M0)", "M3": "full model (M3)"}
#: Colours of the owners of an error, in their order.
OWNER_COLORS = (
    "#222222",
    "#56b4e9",
    "#d55e00",
    "#e69f00",
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#d9d9d9",
)
#: Seconds for one fit of M3 to the paper's training flight (benchmarks/README.md).
FIT_TIMES = (
    ("airpuck, second fit in a process", 1.6),
    ("airpuck, whole process", 8.7),
    ("NumPy + SciPy, warm", 12.2),
    ("Adam, the paper's settings", 67.0),
)


def new(height: float) -> Figure:
    """Return a figure of the common width [in]."""
    return Figure(figsize=(WIDTH, height), dpi=RESOLUTION, layout="constrained", facecolor="white")


@functools.cache
def truth() -> Any:
    """Return the true model of every simulated flight."""
    return airpuck.read_model("paper:M3")


@functools.cache
def flight(seed: int) -> Any:
    """Fly the excitation experiment for 30 s, and prepare the recording."""
    return airpuck.preprocess(airpuck.excite(truth(), 30.0, seed=seed))


@functools.cache
def fit(rung: str) -> Any:
    """Identify a rung from the first flight."""
    return airpuck.identify(flight(1), rung)


@functools.cache
def evaluation(rung: str) -> Any:
    """Evaluate a rung on the second flight."""
    return airpuck.evaluate(fit(rung).model, flight(2))


def frames() -> Figure:
    """Show the body frame, and where each angle of a vehicle file begins."""
    figure = new(4.3)
    axes = figure.add_subplot(aspect="equal", xlim=(-1.55, 1.55), ylim=(-1.4, 1.6))
    axes.axis("off")
    axes.add_patch(Circle((0, 0), 1.0, facecolor="#f5f5f5", edgecolor=style.GREY))
    arrow(axes, (0, 0), (0, 1.35), style.BLACK, 2.0)
    arrow(axes, (0, 0), (-1.35, 0), style.BLACK, 2.0)
    axes.text(0.06, 1.36, "x forward", va="bottom")
    axes.text(-1.4, 0.1, "y left", va="bottom")
    corners = (("front_left", 135, 315), ("front_right", 45, 45), ("rear_left", 225, 225))
    for name, at, direction in (*corners, ("rear_right", 315, 135)):
        # The page shows forward up, so every angle of the body frame is turned by 90°.
        place = 0.72 * np.array([math.cos(math.radians(at)), math.sin(math.radians(at))])
        push = 0.5 * np.array(
            [math.cos(math.radians(direction + 90)), math.sin(math.radians(direction + 90))]
        )
        axes.add_patch(Circle(tuple(place), 0.09, facecolor="white", edgecolor=style.BLUE))
        arrow(axes, place, place + push, style.BLUE, 2.2)
        side = -1 if place[0] < 0 else 1
        axes.text(
            0.98 * side, 1.32 * place[1], f"{name}\n{direction}°", color=style.BLUE, va="center",
            ha="right" if side < 0 else "left",
        )  # fmt: skip
    axes.add_patch(Arc((0, 0), 0.9, 0.9, theta1=90, theta2=135, color=style.VERMILLION, lw=1.5))
    arrow(axes, (-0.30, 0.33), (-0.335, 0.295), style.VERMILLION, 1.5)
    axes.text(-0.1, 0.56, "+", color=style.VERMILLION, ha="center", fontsize=13)
    axes.text(
        0, -1.38, "Arrows: where a propeller pushes the craft.\nAngles: from x, counter-clockwise.",
        ha="center", va="bottom",
    )  # fmt: skip
    return figure


def arrow(axes: Axes, start: Any, end: Any, color: str, width: float) -> None:
    """Draw an arrow."""
    axes.add_patch(
        FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-|>", mutation_scale=11,
                        shrinkA=0, shrinkB=0, color=color, lw=width)
    )  # fmt: skip


def usage() -> Figure:
    """Show what goes into `identify`, and what comes out."""
    figure = new(3.7)
    above, below = figure.subplots(2, 1, height_ratios=(1, 1.6))
    one = flight(1)
    part = (one.time > 12.0) & (one.time < 15.0)
    for k, (name, color) in enumerate((("x", style.BLUE), ("y", style.VERMILLION))):
        above.plot(one.time[part], one.state[part, k], color=color, label=f"{name} [m]")
    above.set(title="In: poses and commands of a flight", xlabel="time [s]")
    above.legend(ncols=2)
    airpuck.plot.thrust(fit("M3").model, below)
    below.set(title="Out: the thrust of each motor, with 95 % bands", xlabel="motor speed φ")
    return figure


def method() -> Figure:
    """Show one window: what the encoder sees, and what is predicted."""
    figure, one = new(4.4), flight(2)
    above, below = figure.subplots(2, 1, sharex=True)
    judged = evaluation("M3")
    window = int(np.argsort(np.linalg.norm(judged.at_horizon[:2], axis=0))[len(judged.start) // 2])
    begin = int(np.searchsorted(one.time, judged.start[window]))
    around = slice(begin - 24, begin + 52)
    now = one.time[begin]
    above.plot(one.time[around] - now, 1e3 * (one.state[around, 0] - one.state[begin, 0]), ".",
               ms=3, color=style.GREY, label="measured")  # fmt: skip
    steps = np.arange(1, judged.errors.shape[0] + 1)
    found = one.state[begin + steps, 0] + judged.errors[:, 0, window]
    above.plot(one.time[begin + steps] - now, 1e3 * (found - one.state[begin, 0]),
               color=style.VERMILLION, label="predicted")  # fmt: skip
    above.axvspan(-0.083, 0, color=style.SKY, alpha=0.25, lw=0, label="the encoder sees this")
    above.set(ylabel="x [mm]", title="One window: past, present, 0.2 s ahead")
    above.legend(loc="upper left")
    below.step(one.time[around] - now, one.input[around], where="post")
    below.axvspan(-0.083, 0, color=style.SKY, alpha=0.25, lw=0)
    below.set(xlabel="time from the start of the prediction [s]", ylabel="commands in force")
    return figure


def control() -> Figure:
    """Fly three set points with both laws, and show the distance to them."""
    figure = new(3.4)
    axes = figure.add_subplot()
    for law, color in (("lqr", style.GREY), ("mpc", style.VERMILLION)):
        tuning = tuning_for(truth()).with_law(law)
        recording = airpuck.track(truth(), SET_POINTS, 6.5, seed=1, tuning=tuning).recording
        pose = recording["pose"]
        time = (pose.stamp_ns - pose.stamp_ns[0]) / 1e9
        wanted = np.array([at(t) for t in time])
        axes.plot(time, 1e2 * np.linalg.norm(pose.values[:, :2] - wanted[:, :2], axis=1),
                  color=color, label=law.upper())  # fmt: skip
    axes.set(xlabel="time [s]", ylabel="distance to the set point [cm]", ylim=(0, None),
             title="Three set points with both laws")  # fmt: skip
    axes.legend()
    return figure


def at(time: float) -> tuple[float, ...]:
    """Return the set point in force."""
    return SET_POINTS.poses[max(0, int(np.searchsorted(SET_POINTS.times, time, "right")) - 1)]


def twin() -> Figure:
    """Show a command on its way: sent, in force after the radio, and what the motor does."""
    figure = new(3.6)
    axes = figure.add_subplot()
    recording = airpuck.excite(truth(), 6.0, seed=3)
    command = recording["command"]
    time = (command.stamp_ns - recording["pose"].stamp_ns[0]) / 1e9
    values = command.values[:, 0]
    jump = int(np.argmax(np.abs(np.diff(values[(time > 2)])))) + int((time <= 2).sum())
    delay, lag = truth().transport_delay, float(truth().parameters.motor_time_constant)
    begin = time[jump + 1]
    shown = np.linspace(begin - 0.05, begin + 0.25, 601)
    held = values[np.clip(np.searchsorted(time, shown, "right") - 1, 0, None)]
    acting = values[np.clip(np.searchsorted(time + delay, shown, "right") - 1, 0, None)]
    speed = np.empty_like(acting)
    speed[0], step = acting[0], shown[1] - shown[0]
    for k in range(1, len(shown)):
        speed[k] = acting[k] + (speed[k - 1] - acting[k]) * math.exp(-step / lag)
    ahead = 1e3 * (shown - begin)
    axes.step(ahead, held, color=style.GREY, where="post", label="command as sent")
    axes.step(ahead, acting, color=style.BLUE, where="post", label="command at the motor")
    axes.plot(ahead, speed, color=style.VERMILLION, label="motor speed")
    axes.annotate("", (1e3 * delay, 0.5), (0, 0.5), arrowprops={"arrowstyle": "<->"})
    axes.text(500 * delay, 0.52, "d", ha="center")
    axes.set(xlabel="time [ms]", ylabel="fraction of full speed",
             title="From a command to the motor: delay d, lag τ")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def comparison() -> Figure:
    """Compare the time of one fit."""
    figure = new(2.3)
    axes = figure.add_subplot(xscale="log", xlim=(0.1, 400))
    names, seconds = [name for name, _ in FIT_TIMES], [value for _, value in FIT_TIMES]
    colors = [style.BLUE if "airpuck" in name else style.GREY for name in names]
    axes.barh(names, seconds, color=colors)
    for k, value in enumerate(seconds):
        axes.text(1.15 * value, k, f"{value:g} s", va="center")
    axes.invert_yaxis()
    axes.set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    axes.set(xlabel="seconds for a fit of M3")
    axes.grid(False)
    return figure


def prediction() -> Figure:
    """Show measured and predicted poses, as on the report's page."""
    figure = new(4.6)
    airpuck.plot.predictions(flight(2), evaluation("M3"), figure)
    for axes in figure.axes:
        if axes.get_title("left").startswith("predicted minus"):
            axes.set_title("error", loc="left")  # the narrow column has no room for more
    return figure


def horizon() -> Figure:
    """Show errors over the time ahead, as on the report's page."""
    figure = new(5.2)
    airpuck.plot.horizon([evaluation("M0"), evaluation("M3")], figure.subplots(3, 1, sharex=True))
    return figure


def thrust() -> Figure:
    """Show thrust curves, as on the report's page."""
    figure = new(3.4)
    airpuck.plot.thrust(fit("M3").model, figure.add_subplot())
    return figure


def excitation() -> Figure:
    """Compare thrust curves after an excitation and after a hover."""
    figure = new(4.6)
    hover = airpuck.track(truth(), airpuck.SetPoint(0.0, 0.0, 0.0), 20.0).recording
    quiet = airpuck.identify(airpuck.preprocess(hover), "M3")
    panels = figure.subplots(2, 1, sharex=True, sharey=True)
    for axes, one, title in zip(
        panels, (fit("M3"), quiet), ("after an excitation", "after a hover"), strict=True
    ):
        airpuck.plot.thrust(one.model, axes)
        axes.set(title=title, ylim=(-0.5, 2.0))
        axes.get_legend().remove()
    panels[0].set_xlabel("")
    return figure


def owners() -> Figure:
    """Show what causes the squared error of position over a flight with faults."""
    usual = default_twin_settings().model_dump()
    usual["radio"] |= {"jitter_s": 0.011, "outages_s": [(9.2, 9.36), (24.1, 24.22)]}
    usual["motors"]["stalls"] = [{"motor": "motor_b_1", "start_s": 15.0, "stop_s": 16.4}]
    faulty = airpuck.TwinSettings(**usual)
    trajectory = airpuck.preprocess(airpuck.excite(truth(), 30.0, seed=2, settings=faulty))
    model = fit("M3").model
    budget = airpuck.error_budget(model, trajectory, airpuck.find_faults(trajectory, model))
    parts = np.concatenate([budget.drops, budget.all_known[None] ** 2])[:, :2].sum(axis=1)
    figure = new(3.0)
    axes = figure.add_subplot()
    edges = np.linspace(budget.start[0], budget.start[-1], 61)
    below = np.zeros(60)
    named = zip(budget.shares, parts, OWNER_COLORS, strict=True)
    for owner, values, color in named:
        height = np.histogram(budget.start, edges, weights=np.maximum(values, 0.0))[0]
        height *= 100 / np.maximum(parts, 0.0).sum()
        if height.sum() > 1:
            axes.bar(edges[:-1], height, np.diff(edges), below, align="edge", color=color,
                     label=f"{owner} {height.sum():.0f} %")  # fmt: skip
        below += height
    axes.set(xlabel="time of flight [s]", ylabel="squared error [%]",
             title="Where prediction errors come from")  # fmt: skip
    axes.legend()
    return figure


def plan() -> Figure:
    """Show the fastest flight over a metre, with thrusts and commands."""
    table = airpuck.Table()
    fastest = airpuck.plan(truth(), (-0.5, 0, 0), (0.5, 0, 0), table=table)
    return airpuck.plot.plan_figure(fastest, table)


def race() -> Figure:
    """Fly the plan 16 times, and the same distance to a set point."""
    course = course_plan("straight", truth(), default_twin_settings())
    return airpuck.plot.race_figure(airpuck.race(course, truth(), seeds=16), airpuck.Table())


def tracking() -> Figure:
    """Compare flights of the twin with the paper's, to the same set points."""
    from airpuck.cli.options import published_flights
    from airpuck.report.control_report import tracking_figure

    names = ["paper:M0", "paper:M4"]
    flights = [path and airpuck.read_recording(path) for path in published_flights(names)]
    pilots = [airpuck.read_model(name) for name in names]
    study = airpuck.tracking_study(pilots, truth(), flights=flights, controller="paper")
    figure = tracking_figure(study)
    wide = figure.legends.pop()
    labels = [text.get_text() for text in wide.get_texts()]
    figure.legend(wide.legend_handles, labels, loc="outside upper center", ncols=2)
    return figure


#: Vehicle files of the examples, with their titles.
CRAFT = {
    "examples/four_propellers/vehicle.toml": "four_propellers",
    "examples/free_flyers/atmos.toml": "free_flyers: ATMOS",
    "src/airpuck/packaged/datasets/air-bearing-satellite/vehicle.toml": "air_bearing_satellite",
    "src/airpuck/packaged/datasets/cybership-enterprise/vehicle.toml": "cybership_enterprise",
}


def examples() -> Figure:
    """Draw the craft of the examples: a disc, and where its actuators push it."""
    figure = new(4.0)
    drawn = zip(CRAFT.items(), figure.subplots(2, 2).flat, strict=True)
    for (file, title), axes in drawn:
        craft = airpuck.read_vehicle(FOLDER.parents[1] / file)
        radius, places = craft.radius_m, craft.positions
        axes.set(aspect="equal", xlim=(-1.7, 1.7), ylim=(-1.6, 1.1), title=title)
        axes.axis("off")
        axes.add_patch(Circle((0, 0), 1.0, facecolor="#f5f5f5", edgecolor=style.GREY))
        # The page shows forward up.
        for place, push in zip(places / radius, craft.directions, strict=True):
            start, way = np.array([-place[1], place[0]]), np.array([-push[1], push[0]])
            arrow(axes, start - 0.3 * way, start + 0.3 * way, style.BLUE, 1.5)
        size = f"{craft.mass_kg:.3g} kg, radius {radius:.2g} m"
        axes.text(0, -1.3, size, ha="center", va="top")
    return figure


def laws() -> Figure:
    """Fly to one set point with the package's law and with both examples."""
    figure = new(2.8)
    axes = figure.add_subplot(xlabel="time [s]", ylabel="distance to the set point [m]")
    goal = airpuck.SetPoint(0.5, -0.2, 1.0)
    folder = FOLDER.parents[1] / "examples"
    flown = {"packaged LQR": "lqr", "own_pilot": f"{folder}/own_pilot/spring.py:Spring"}
    for name, law in (flown | {"own_law": f"{folder}/own_law/pid.py:PID"}).items():
        own = pilot_named(law)
        log = airpuck.track(truth(), goal, 3.0, make_pilot=own, law=None if own else law)
        pose = log.recording["pose"]
        away = np.hypot(pose.values[:, 0] - 0.5, pose.values[:, 1] + 0.2)
        axes.plot(pose.time - pose.time[0], away, label=name)
    axes.legend()
    return figure


def layers() -> Figure:
    """Draw which package imports which, from what the architecture's test reads."""
    sys.path.insert(0, str(FOLDER.parents[1]))
    from tests.test_architecture import MODULES, ORDER, ROOT, imports, room

    used = np.zeros((len(ORDER), len(ORDER)), int)  # modules of a row that import a column
    for path in MODULES:
        own = path.relative_to(ROOT).parts[0]
        for other in {room(module) for module in imports(path) if module.startswith("airpuck.")}:
            if own in ORDER and other in ORDER and other != own:
                used[ORDER.index(own), ORDER.index(other)] += 1
    figure, count = new(3.75), len(ORDER)
    axes = figure.add_subplot(
        aspect="equal", xlim=(-0.6, count + 1.2), ylim=(count - 0.3, -1.9), xticks=[]
    )
    axes.set_yticks(range(count), [name.replace("_", " ") for name in ORDER], fontsize=7.5)
    axes.tick_params(left=False)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    meaning = (
        "A dot: the package of its row imports\nthe package of its column. Its size:\n"
        "the number of modules that do."
    )
    axes.text(count, 0.7, meaning, fontsize=8, va="center", ha="right")
    for k, name in enumerate(ORDER):
        band = {"color": "#f2f2f2" if k % 2 else "white", "lw": 0, "zorder": 0}
        axes.fill_between([-0.5, k - 0.5], k - 0.5, k + 0.5, **band)
        axes.plot([k, k], [k + 0.5, count - 0.5], color="#dddddd", lw=0.5, zorder=1)
        if k < count - 1:
            axes.text(
                k - 0.15, k + 0.35, name.replace("_", " "), fontsize=7, rotation=45,
                rotation_mode="anchor", ha="left",
            )  # fmt: skip
    rows, columns = np.nonzero(used)
    axes.scatter(columns, rows, s=6 + 4 * used[rows, columns], color=style.BLUE, lw=0, zorder=2)
    return figure


def commissioning() -> None:
    """Commission the paper's craft on the twin from a rough file, and draw the page's figures."""
    content = airpuck.default_vehicle().model_dump(mode="json")
    content["mass_kg"] *= 1.25
    nominal, propellers = content["nominal"], content["propellers"]
    nominal["thrust_N"] = [0.6 * coefficient for coefficient in nominal["thrust_N"]]
    nominal["inertia_kg_m2"] *= 0.75
    propellers[1]["direction_deg"] = (propellers[1]["direction_deg"] + 180) % 360
    content["pairs"] = []
    stated = airpuck.Vehicle.model_validate(content)
    settings = default_twin_settings().without_on_board()
    found = airpuck.commission(airpuck.Twin(truth(), settings, seed=4), stated, tell=print)
    for name, draw in (("intervals", interval_figure), ("flights", flights_figure)):
        with mpl.rc_context(style.look() | TEXT):
            figure = draw(found, WIDTH)
            figure.set_dpi(RESOLUTION)
            figure.savefig(FOLDER / f"commissioning_{name}.png", facecolor="white")


def animated() -> None:
    """Fly to the paper's set points with predictive control, and animate the flight."""
    model = airpuck.read_model("paper:M4")
    goals = airpuck.SetPoints(
        [0.0, 0.5, 2.5, 4.5], [(0, 0, 0), (1, 0.3, 1.5), (0.5, -0.3, -1), (0, 0, 0)]
    )
    tuning = tuning_for(model).with_law("mpc")
    log = airpuck.track(model, goals, 6.2, tuning=tuning)
    path = FOLDER / "flight.gif"
    airpuck.animate(log.recording, path, log=log, frames_per_second=20.0)
    # A phone shows the table; its curves over time would be too small.
    with Image.open(path) as whole:
        frames = [one.convert("RGB") for one in ImageSequence.Iterator(whole)]
    shown = [one.crop((0, 50, one.width, 620)).quantize(64) for one in frames]
    shown[0].save(path, save_all=True, append_images=shown[1:], duration=50, loop=0)


def crossing() -> None:
    """Fly six craft across the table, and animate the flight."""
    from airpuck.report.fleet_report import write_fleet_gif

    fleet = airpuck.read_fleet("crossing")
    write_fleet_gif(airpuck.fly_together(fleet), fleet, FOLDER / "fleet.gif")


#: Pictures that write their own files.
ANIMATIONS: dict[str, Callable[[], None]] = {
    "flight": animated,
    "fleet": crossing,
    "commissioning": commissioning,
}
PICTURES: dict[str, Callable[[], Figure]] = {
    "frames": frames,
    "usage": usage,
    "method": method,
    "control": control,
    "twin": twin,
    "comparison": comparison,
    "prediction": prediction,
    "horizon": horizon,
    "thrust": thrust,
    "excitation": excitation,
    "owners": owners,
    "plan": plan,
    "race": race,
    "tracking": tracking,
    "examples": examples,
    "laws": laws,
    "layers": layers,
}


def main(names: list[str]) -> None:
    """Draw the named pictures, or all."""
    style.PAGE_WIDTH = WIDTH  # figures of reports are as wide as their page
    for name in names or [*PICTURES, *ANIMATIONS]:
        if name in ANIMATIONS:
            ANIMATIONS[name]()
            continue
        with mpl.rc_context(style.look() | TEXT):
            PICTURES[name]().savefig(FOLDER / f"guide_{name}.png", dpi=RESOLUTION)
        print(FOLDER / f"guide_{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
