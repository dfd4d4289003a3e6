"""Claims that the paper makes in passing, each tested again.

    AIRPUCK_DATA=... python studies/side_claims.py --out out/

Every fit uses the training recording only and is judged on the validation recording by the paper's
protocol. Writes a page (`index.html`), its figures, and the numbers (`side_claims.json`). Takes
minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck import Loss, Preparation, evaluate, identify, load_trajectory, named_rung
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import CHANNELS, hold_for
from airpuck.evaluation.gauge import physical_thrust
from airpuck.identification.fit_result import Fit
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import Model, published_model
from airpuck.physics.thrust import lowest_slope, thrust_slope
from airpuck.recording.dataset import dataset_folder
from airpuck.report.judged_sections import errors_as_text
from airpuck.report.page import Picture, Section, Table, write_page
from airpuck.report.reproduce import TRAINING, VALIDATION
from airpuck.report.style import (
    BLACK,
    BLUE,
    DASHED,
    ERRORS,
    GREY,
    PAGE_WIDTH,
    VERMILLION,
    key,
    new_figure,
    panels,
    propeller_colors,
    rung_color,
    styled,
    top_legend,
)

ALL_DATA = Preparation(faults="keep")
_PROTOCOL = "Errors: protocol “paper” on the validation recording; losses: on the training one."


# Fits ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit, judged on the validation recording."""

    #: What was varied.
    label: str
    fit: Fit
    #: Root mean square error of x, y [m] and yaw [rad] after 0.2 s, protocol "paper".
    rmse: Float[np.ndarray, " 3"]

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        slope, speed = lowest_slope(physical_thrust(self.fit.model))
        return {
            "label": self.label,
            "model": self.fit.model.name,
            "loss": self.fit.loss,
            "iterations": self.fit.iterations,
            "converged": self.fit.converged,
            "rmse": dict(zip(CHANNELS, self.rmse.tolist(), strict=True)),
            "lowest_slope_N": slope.tolist(),
            "at_speed": speed.tolist(),
        }


def judge(label: str, fit: Fit, validation: Trajectory) -> Trial:
    """Evaluate a fit on the validation recording, by the paper's protocol."""
    print(f"{label}: loss {fit.loss:.3e} after {fit.iterations} iterations", flush=True)
    return Trial(label, fit, evaluate(fit.model, validation).rmse)


def try_degrees(
    training: Trajectory, validation: Trajectory, degrees: Sequence[int] = (1, 2, 3, 4, 5)
) -> list[Trial]:
    """Fit M3 with thrust polynomials of several degrees.

    The paper: "We tested different polynomials up to degree five but found a 3rd-order polynomial
    works best for our system."
    """
    return [
        judge(
            f"degree {d}",
            identify(training, named_rung("M3", degree=d), preparation=ALL_DATA),
            validation,
        )
        for d in degrees
    ]


def drop_monotonicity(
    training: Trajectory,
    validation: Trajectory,
    cases: Sequence[tuple[str, int]] = (
        *((name, 3) for name in ("M0", "M1", "M2", "M3", "M4")),
        ("M3", 5),
    ),
) -> list[Trial]:
    """Fit without the condition that thrust rises with motor speed.

    The paper: "the obtained thrust profiles exhibit a non-monotonic behavior without the
    regularization term".
    """
    method = LevenbergMarquardt(monotone=False)
    trials = []
    for name, degree in cases:
        rung = named_rung(name, degree=degree)
        fit = identify(training, rung, method=method, preparation=ALL_DATA)
        trials.append(judge(f"{name}, degree {degree}", fit, validation))
    return trials


def fit_whole_trajectory(
    training: Trajectory, validation: Trajectory, batched: Fit
) -> dict[str, Trial]:
    """Fit one prediction over the whole recording (eq. loss_full), from two starting points.

    The paper: predicting over the whole dataset "can be rather non-smooth and sensitive to local
    minima", hence its batches.
    """
    trials = {"batched": judge("batched", batched, validation)}
    for name, label, initial in (
        ("full_from_nominal", "from nominal values", None),
        ("full_from_batched", "from the batched optimum", batched.model.parameters),
    ):
        whole = Loss(prediction_time=None)
        fit = identify(training, batched.model.name, initial=initial, loss=whole)
        trials[name] = judge(f"full trajectory, {label}", fit, validation)
    return trials


# Numbers ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Landscape:
    """The loss along one parameter, for one length of prediction."""

    #: Length of a prediction [s].
    horizon: float
    #: Predictions in the loss.
    windows: int
    #: The parameter, relative to its value in the batched optimum.
    factor: Float[np.ndarray, " K"]
    loss: Float[np.ndarray, " K"]

    @property
    def minima(self) -> Float[np.ndarray, " M"]:
        """Factors at the local minima inside the range; as many as the sampling resolves."""
        inside = self.loss[1:-1]
        return self.factor[1:-1][(inside < self.loss[:-2]) & (inside < self.loss[2:])]

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        return {
            "horizon_s": self.horizon,
            "windows": self.windows,
            "local_minima": len(self.minima),
            "factor": self.factor.tolist(),
            "loss": self.loss.tolist(),
        }


def sample_landscapes(
    training: Trajectory,
    model: Model,
    *,
    horizons: Sequence[int | None] = (50, 500, 5000, None),
    span: float = 0.12,
    points: int = 121,
) -> list[Landscape]:
    """Sample the loss along the inertia, all other parameters as they are."""
    encoder = PaperEncoder(indexing=model.indexing)
    factor = np.linspace(1 - span, 1 + span, points)
    landscapes = []
    for horizon in horizons:
        windows = hold_for(model, make_windows(training, 20, horizon, horizon or 1))
        length = windows.prediction_length * training.sample_period
        print(f"loss landscape of predictions over {length:.1f} s", flush=True)
        loss = PredictionLoss(windows, model.vehicle, encoder, frame=model.frame)
        values = [
            loss.quadratic(replace(model.parameters, inertia=inertia)).loss
            for inertia in factor * model.parameters.inertia
        ]
        landscapes.append(Landscape(length, len(windows), factor, np.array(values)))
    return landscapes


def largest_thrusts(m3: Model, m4: Model) -> dict[str, Float[np.ndarray, " n"]]:
    """Compute the thrust at φ = 1 of M3, of M4 as learned, and of M4 at the physical scale [N].

    The paper: "the max thrust predicted by M4 is considerably larger than that of M3, suggesting
    that the configuration matrix Π is compensating". Nothing observable fixes the scale of M4's
    thrusts; `airpuck.evaluation.gauge` explains how it is fixed here.
    """
    return {
        "M3_N": physical_thrust(m3).sum(axis=1),
        "M4_as_learned_N": np.asarray(m4.parameters.thrust).sum(axis=1),
        "M4_scaled_N": physical_thrust(m4).sum(axis=1),
    }


def falling_share(coefficients: Float[np.ndarray, "n degree"]) -> Float[np.ndarray, " n"]:
    """Compute on which share of [0, 1] each thrust curve falls."""
    speed = np.tile(np.linspace(0, 1, 1001), (len(coefficients), 1))
    return np.mean(thrust_slope(coefficients, speed) < 0, axis=1)


# Figures ------------------------------------------------------------------------------------------


@styled
def degrees_figure(trials: Sequence[Trial]) -> Figure:
    """Draw training loss and validation error over the degree of the thrust polynomials."""
    figure = new_figure(PAGE_WIDTH, 2.9)
    degrees = [np.shape(trial.fit.model.parameters.thrust)[1] for trial in trials]
    series = [("loss", "10⁻⁴", np.array([1e4 * trial.fit.loss for trial in trials]))]
    series += [
        (f"RMSE of {name}", unit, np.array([factor * trial.rmse[channel] for trial in trials]))
        for channel, (name, unit, factor) in enumerate(ERRORS)
    ]
    for axes, (name, unit, values) in zip(panels(figure, 4, 4), series, strict=True):
        training = name == "loss"
        axes.plot(degrees, values, "o-", color=GREY if training else BLUE, ms=4.5)
        best = int(np.argmin(values))
        axes.plot(degrees[best], values[best], "o", color=VERMILLION, ms=7)
        axes.set(xlabel="degree [–]", ylabel=f"{name} [{unit}]", xticks=degrees)
        axes.set_title("training" if training else "validation", loc="left")
        axes.margins(x=0.1, y=0.12)
    top_legend(figure, [key("lowest", VERMILLION, ls="", marker="o", ms=7)])
    return figure


@styled
def slopes_figure(trials: Sequence[Trial]) -> Figure:
    """Draw the slopes of thrust curves that were free to fall.

    Where the slope of a motor's thrust is below zero (shaded), more speed would give less thrust,
    and the curve has no inverse.
    """
    columns = min(len(trials), 3)
    figure = new_figure(PAGE_WIDTH, 0.5 + 2.3 * -(-len(trials) // columns))
    speed = np.linspace(0, 1, 401)
    vehicle = trials[0].fit.model.vehicle
    colors = propeller_colors(vehicle)
    # The second propeller of a pair is dashed.
    dashes = ["-" if colors.index(c) == i else DASHED for i, c in enumerate(colors)]
    for axes, trial in zip(panels(figure, len(trials), columns, sharex=True), trials, strict=True):
        coefficients = physical_thrust(trial.fit.model)
        slopes = thrust_slope(coefficients, np.tile(speed, (len(coefficients), 1)))
        for slope, color, dash in zip(slopes, colors, dashes, strict=True):
            axes.plot(speed, slope, color=color, lw=1.2, ls=dash)
        low, high = axes.get_ylim()
        low = min(low, -0.12)
        axes.axhspan(low, 0, color=VERMILLION, alpha=0.10, lw=0)
        axes.axhline(0, color=BLACK, lw=0.8)
        lowest = lowest_slope(coefficients)[0]
        axes.set_title(f"{trial.label}: {(lowest < 0).sum()} of {len(lowest)} fall", loc="left")
        axes.set(xlim=(0, 1), ylim=(low, high))
        axes.set(xlabel="motor speed φ [–]", ylabel="slope of thrust [N]")
    handles = [
        key(name, color, ls=dash)
        for name, color, dash in zip(vehicle.propeller_names, colors, dashes, strict=True)
    ]
    top_legend(figure, [*handles, Patch(color=VERMILLION, alpha=0.15, label="falling")])
    return figure


@styled
def landscape_figure(landscapes: Sequence[Landscape]) -> Figure:
    """Draw the loss along one parameter, for predictions of growing length; dots are minima."""
    columns = min(len(landscapes), 2)
    figure = new_figure(PAGE_WIDTH, 0.4 + 2.3 * -(-len(landscapes) // columns))
    for axes, one in zip(panels(figure, len(landscapes), columns), landscapes, strict=True):
        exponent = int(np.floor(np.log10(one.loss.min())))
        values, minima = one.loss * 10.0**-exponent, one.minima
        axes.plot(one.factor, values, color=BLUE, lw=1.1)
        axes.plot(minima, values[np.isin(one.factor, minima)], "o", color=VERMILLION, ms=4)
        count = {0: "no minimum inside", 1: "one minimum"}.get(len(minima), f"{len(minima)} minima")
        predictions = f"{one.windows} prediction" + "s" * (one.windows > 1)
        axes.set_title(f"{predictions} of {one.horizon:.2g} s: {count}", loc="left")
        axes.set_xlabel("inertia, relative to the batched fit [–]")
        axes.set_ylabel("loss" + (f" [$10^{{{exponent}}}$]" if exponent else " [–]"))
        axes.margins(x=0.01)
    return figure


@styled
def largest_thrust_figure(
    thrusts: Mapping[str, Mapping[str, Float[np.ndarray, " n"]]], propellers: Sequence[str]
) -> Figure:
    """Draw each motor's largest thrust by M3, by M4 as learned, and by M4 at the physical scale."""
    figure = new_figure(PAGE_WIDTH, 3.1)
    place = np.arange(len(propellers))
    shapes = (
        ("M3_N", "M3", "M3", -0.2, True),
        ("M4_as_learned_N", "M4 as learned", "M4", 0.2, False),
        ("M4_scaled_N", "M4 at the physical scale", "M4", 0.2, True),
    )
    grid = panels(figure, len(thrusts), len(thrusts), sharey=True)
    for axes, (kind, values) in zip(grid, thrusts.items(), strict=True):
        ends = values["M4_scaled_N"], values["M4_as_learned_N"]
        axes.vlines(place + 0.2, *ends, color=GREY, lw=0.8)
        for name, _, rung, offset, filled in shapes:
            color = rung_color(rung)
            face = color if filled else "white"
            axes.plot(place + offset, values[name], "o", ms=6.5, color=color, mfc=face)
        axes.set_title(kind, loc="left")
        axes.set_xticks(place, propellers, rotation=35, ha="right")
        axes.set_ylabel("thrust at φ = 1 [N]")
        axes.grid(visible=False, axis="x")
        axes.label_outer()
    highest = max(value.max() for values in thrusts.values() for value in values.values())
    grid[0].set_ylim(0, 1.06 * float(highest))
    top_legend(
        figure,
        [
            key(label, rung_color(rung), ls="", marker="o", mfc=None if filled else "white")
            for _, label, rung, _, filled in shapes
        ],
    )
    return figure


# Page ---------------------------------------------------------------------------------------------


def about_degrees(trials: Sequence[Trial]) -> str:
    """Name the best degree."""
    score = np.exp(np.mean([np.log(trial.rmse) for trial in trials], axis=1))
    best = int(np.argmin(score))
    runner_up = float(np.sort(score)[1] / score[best] - 1)
    return (
        "Claim: a polynomial of third degree works best. Here the geometric mean of the three "
        f"validation errors is lowest for {trials[best].label}, {100 * runner_up:.2f} % below the "
        "next. The training loss falls with every degree, as it must."
    )


def about_slopes(trials: Sequence[Trial]) -> str:
    """List the curves that fall."""
    parts = []
    for trial in trials:
        coefficients = physical_thrust(trial.fit.model)
        lowest, share = lowest_slope(coefficients)[0], falling_share(coefficients)
        if (lowest < 0).any():
            parts.append(
                f"{trial.label}: {(lowest < 0).sum()} of {len(lowest)}, down to "
                f"−{-lowest.min():.2f} N, on at most {100 * share.max():.1f} % of the range"
            )
    return (
        "Claim: without the regulariser, thrust curves are not monotone. Curves that fall here: "
        f"{'; '.join(parts) or 'none'}. Such a curve has no inverse, so that no command can be "
        "found for a thrust."
    )


def about_landscape(landscapes: Sequence[Landscape], full: Mapping[str, Trial]) -> str:
    """Summarise how rugged the losses are, and where the optimiser ends."""
    counts = ", ".join(f"{len(one.minima)} at {one.horizon:.2g} s" for one in landscapes)
    step = landscapes[-1].factor
    batched, nominal, refined = full.values()
    worse = [
        100 * (float(np.exp(np.log(trial.rmse / batched.rmse).mean())) - 1)
        for trial in (nominal, refined)
    ]
    return (
        "Claim: the loss over the whole recording is non-smooth and has local minima, hence short "
        "predictions. Local minima along the inertia of M3, all other parameters at the batched "
        f"optimum, as many as samples every {100 * (step[1] - step[0]):.1f} % resolve: {counts}. "
        "Levenberg-Marquardt on the loss of the whole recording ends "
        f"{nominal.fit.loss / refined.fit.loss:.1f} times higher when it starts from the nominal "
        "values than when it starts from the batched fit; errors after 0.2 s are then "
        f"{worse[0]:+.0f} % and {worse[1]:+.0f} % from the batched fit's, on geometric average "
        "over x, y and yaw."
    )


def about_thrusts(thrusts: Mapping[str, Mapping[str, Float[np.ndarray, " n"]]]) -> str:
    """Compare M4's largest thrusts with M3's."""
    parts = []
    for kind, values in thrusts.items():
        raw = float(np.mean(values["M4_as_learned_N"] / values["M3_N"]))
        apart = np.abs(values["M4_scaled_N"] / values["M3_N"] - 1).max()
        parts.append(
            f"{kind}: {raw:.2f} times on average as learned, within {100 * apart:.1f} % at the "
            "physical scale"
        )
    return (
        "Claim: M4's largest thrusts exceed M3's because Π compensates. M4 against M3, "
        + "; ".join(parts)
        + ". At the physical scale a propeller's column of Π has the length 1/m in x and y."
    )


def trial_table(caption: str, trials: Sequence[Trial]) -> Table:
    """Tabulate losses and errors of several fits."""
    headings = ["fit", "iterations", "converged", "loss", "x mm", "y mm", "γ rad"]
    rows = [
        [
            trial.label,
            str(trial.fit.iterations),
            "yes" if trial.fit.converged else "no",
            f"{trial.fit.loss:.3e}",
            *errors_as_text(trial.rmse),
        ]
        for trial in trials
    ]
    return Table(f"{caption} {_PROTOCOL}", headings, rows)


def side_claims(out: Path) -> dict[str, Any]:
    """Test all side claims again; write the page and return the numbers."""
    folder = dataset_folder() / "experiments"
    training, validation = (
        load_trajectory(folder / name / "data.pt") for name in (TRAINING, VALIDATION)
    )
    m3, m4 = (identify(training, name, preparation=ALL_DATA) for name in ("M3", "M4"))
    degrees = try_degrees(training, validation)
    unconstrained = drop_monotonicity(training, validation)
    full = fit_whole_trajectory(training, validation, m3)
    landscapes = sample_landscapes(training, m3.model)
    thrusts = {
        "published": largest_thrusts(published_model("M3"), published_model("M4")),
        "fitted": largest_thrusts(m3.model, m4.model),
    }
    propellers = m4.model.vehicle.propeller_names
    blocks = (
        Picture("side_degrees", degrees_figure(degrees), about_degrees(degrees)),
        trial_table("M3 with thrust polynomials of degree 1 to 5.", degrees),
        Picture("side_monotonicity", slopes_figure(unconstrained), about_slopes(unconstrained)),
        trial_table("Fits whose thrust is free to fall.", unconstrained),
        Picture(
            "side_full_trajectory",
            landscape_figure(landscapes),
            about_landscape(landscapes, full),
        ),
        trial_table(
            "M3, learned with the batched and with the full-trajectory loss. Losses of different "
            "length cannot be compared.",
            list(full.values()),
        ),
        Picture(
            "side_largest_thrust",
            largest_thrust_figure(thrusts, propellers),
            about_thrusts(thrusts),
        ),
    )
    write_page(
        out,
        "Side claims of the paper, tested again",
        "Claims that the paper makes in passing, tested on its recordings.",
        [Section("side-claims", "Side claims", blocks)],
    )
    numbers: dict[str, Any] = {
        "degrees": [trial.to_json() for trial in degrees],
        "unconstrained": [trial.to_json() for trial in unconstrained],
        "full_trajectory": {
            "landscapes": [one.to_json() for one in landscapes],
            **{name: trial.to_json() for name, trial in full.items()},
        },
        "largest_thrusts": {
            "propellers": list(propellers),
            **{
                kind: {name: value.tolist() for name, value in values.items()}
                for kind, values in thrusts.items()
            },
        },
    }
    (out / "side_claims.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return numbers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    side_claims(options.out)
    print(options.out / "index.html")


if __name__ == "__main__":
    from one_line import run

    run(main)
