"""Side claims of the paper, tested again.

    AIRPUCK_DATA=... python studies/side_claims.py --out out/

Every fit uses the training recording only and is evaluated on the validation recording by the
paper's protocol. Writes a page (`index.html`), its figures, and the numbers (`side_claims.json`).
Takes minutes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from paper_claims.figures import (
    degrees_figure,
    landscape_figure,
    largest_thrust_figure,
    slopes_figure,
)
from paper_claims.trials import (
    ALL_DATA,
    Landscape,
    Trial,
    drop_monotonicity,
    falling_share,
    fit_whole_trajectory,
    largest_thrusts,
    sample_landscapes,
    try_degrees,
)

from airpuck import identify, load_trajectory
from airpuck.evaluation.presentation import physical_thrust
from airpuck.model.model_file import published_model
from airpuck.physics.thrust import lowest_slope
from airpuck.recording.dataset import dataset_folder
from airpuck.report.page import PageSection, PageTable, Picture, write_page
from airpuck.report.reproduce import TRAINING, VALIDATION
from airpuck.report.tables import errors_as_text

_PROTOCOL = "Errors: protocol “paper” on the validation recording; losses: on the training one."


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


def trial_table(caption: str, trials: Sequence[Trial]) -> PageTable:
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
    return PageTable(f"{caption} {_PROTOCOL}", headings, rows)


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
        [PageSection("side-claims", "Side claims", blocks)],
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
