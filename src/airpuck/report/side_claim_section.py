"""The paper's side claims, as a section of its report."""

from __future__ import annotations

import numpy as np

from airpuck.evaluation.gauge import physical_thrust
from airpuck.physics.thrust import lowest_slope
from airpuck.report.page import Picture, Section, Table
from airpuck.report.side_claim_figures import (
    degrees_figure,
    landscape_figure,
    largest_thrust_figure,
    slopes_figure,
)
from airpuck.report.side_claims import SideClaims, falling_share
from airpuck.report.study_sections import errors_as_text
from airpuck.report.trial import Trial

_PROTOCOL = "Errors: protocol “paper” on the validation recording; losses: on the training one."


def side_claims_section(claims: SideClaims) -> Section:
    """Show what became of each claim."""
    return Section(
        "side-claims",
        "Side claims of the paper, tested again",
        (
            Picture("side_degrees", degrees_figure(claims.degrees), _about_degrees(claims)),
            _trial_table(
                "M3 with thrust polynomials of degree 1 to 5. " + _PROTOCOL, claims.degrees
            ),
            Picture(
                "side_monotonicity", slopes_figure(claims.unconstrained), _about_slopes(claims)
            ),
            _trial_table("Fits whose thrust is free to fall. " + _PROTOCOL, claims.unconstrained),
            Picture(
                "side_full_trajectory",
                landscape_figure(claims.full_trajectory),
                _about_landscape(claims),
            ),
            _trial_table(
                "M3, learned with the batched and with the full-trajectory loss. Losses of "
                "different length cannot be compared. " + _PROTOCOL,
                (
                    claims.full_trajectory.batched,
                    claims.full_trajectory.nominal,
                    claims.full_trajectory.refined,
                ),
            ),
            Picture(
                "side_largest_thrust",
                largest_thrust_figure(claims.largest_thrusts),
                _about_thrusts(claims),
            ),
        ),
    )


def _about_degrees(claims: SideClaims) -> str:
    """Say which degree is best."""
    rmse = np.array([trial.rmse for trial in claims.degrees])
    score = np.exp(np.log(rmse).mean(axis=1))
    labels = [trial.label for trial in claims.degrees]
    best = int(np.argmin(score))
    runner_up = float(np.sort(score)[1] / score[best] - 1)
    return (
        "Claim: a polynomial of third degree works best. Here the geometric mean of the three "
        f"validation errors is lowest for {labels[best]}, {100 * runner_up:.2f} % below the next. "
        "The training loss falls with every degree, as it must."
    )


def _about_slopes(claims: SideClaims) -> str:
    """Say which curves fall."""
    parts = []
    for trial in claims.unconstrained:
        coefficients = physical_thrust(trial.fit.model)
        lowest, share = lowest_slope(coefficients)[0], falling_share(coefficients)
        falling = lowest < 0
        if falling.any():
            parts.append(
                f"{trial.label}: {int(falling.sum())} of {len(lowest)}, down to "
                f"−{-lowest.min():.2f} N, on at most {100 * share.max():.1f} % of the range"
            )
    found = "; ".join(parts) or "none"
    return (
        "Claim: without the regulariser, thrust curves are not monotone. Curves that fall here: "
        f"{found}. Such a curve has no inverse, so that no command can be found for a thrust."
    )


def _about_landscape(claims: SideClaims) -> str:
    """Say how rugged the losses are, and where the optimiser ends."""
    result = claims.full_trajectory
    counts = ", ".join(f"{len(land.minima)} at {land.horizon:.2g} s" for land in result.landscapes)
    step = result.landscapes[-1].factor
    factor = result.nominal.fit.loss / result.refined.fit.loss
    worse = [
        100 * (float(np.exp(np.log(trial.rmse / result.batched.rmse).mean())) - 1)
        for trial in (result.nominal, result.refined)
    ]
    return (
        "Claim: the loss over the whole recording is non-smooth and has local minima, hence short "
        "predictions. Local minima along the inertia of M3, all other parameters at the batched "
        f"optimum, as many as samples every {100 * (step[1] - step[0]):.1f} % resolve: {counts}. "
        f"Levenberg-Marquardt on the loss of the whole recording ends {factor:.1f} times higher "
        "when it starts from the nominal values than when it starts from the batched fit; errors "
        f"after 0.2 s are then {worse[0]:+.0f} % and {worse[1]:+.0f} % from the batched fit's, on "
        "geometric average over x, y and yaw."
    )


def _about_thrusts(claims: SideClaims) -> str:
    """Say how M4's largest thrusts compare with M3's."""
    result, parts = claims.largest_thrusts, []
    for kind, thrusts in result.first_principles.items():
        raw = float(np.mean(result.direct[kind] / thrusts))
        scaled = result.direct_scaled[kind] / thrusts - 1
        parts.append(
            f"{kind}: {raw:.2f} times on average as learned, within "
            f"{100 * np.abs(scaled).max():.1f} % at the physical scale"
        )
    return (
        "Claim: M4's largest thrusts exceed M3's because Π compensates. M4 against M3, "
        + "; ".join(parts)
        + ". At the physical scale a propeller's column of Π has the length 1/m in x and y."
    )


def _trial_table(caption: str, trials: tuple[Trial, ...]) -> Table:
    """Tabulate losses and errors of several fits."""
    return Table(
        caption,
        ["fit", "iterations", "converged", "loss", "x mm", "y mm", "γ rad"],
        [
            [
                trial.label,
                str(trial.fit.iterations),
                "yes" if trial.fit.converged else "no",
                f"{trial.fit.loss:.3e}",
                *errors_as_text(trial.rmse),
            ]
            for trial in trials
        ],
    )
