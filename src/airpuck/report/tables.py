"""Tables of results, each declared once for the terminal and for the pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from airpuck.data.trajectory import Span, Trajectory
    from airpuck.evaluation.error_budget import ErrorBudget
    from airpuck.evaluation.evaluate import Evaluation
    from airpuck.evaluation.fit_measures import FitMeasures
    from airpuck.evaluation.prediction_bands import PredictionBands
    from airpuck.flight.replay import Replay
    from airpuck.twin.tracking_study import Tracked

#: Characters in the widest table row that fits on a page at full size.
_WIDE = 110
#: Headings of errors.
CHANNELS = ("x mm", "y mm", "γ rad")


@dataclass(frozen=True)
class PageTable:
    """A table; the terminal shows the first sentence of the caption as its title."""

    #: Plain text.
    caption: str
    #: One heading for each column.
    headings: Sequence[str]
    #: Cell texts; the first cell of a row is its heading.
    rows: Sequence[Sequence[str]]
    #: Group headings above the headings: text and number of columns spanned.
    groups: Sequence[tuple[str, int]] = ()
    #: Row and column of highlighted cells.
    marked: frozenset[tuple[int, int]] = frozenset()

    @property
    def wide(self) -> bool:
        """Whether the table needs smaller type to fit on a page."""
        columns = zip(self.headings, *self.rows, strict=True)
        return sum(3 + max(map(len, column)) for column in columns) > _WIDE

    @property
    def texts(self) -> list[str]:
        """Headings of the first column, and of those without digits."""
        columns = zip(self.headings, *self.rows, strict=True)
        return [
            heading
            for number, (heading, *cells) in enumerate(columns)
            if not number or not any(letter.isdigit() for cell in cells for letter in cell)
        ]


def errors_as_text(values: np.ndarray) -> list[str]:
    """Format errors of x, y [m] and yaw [rad] as millimetres and radians."""
    x, y, yaw = values
    return [f"{1e3 * x:.2f}", f"{1e3 * y:.2f}", f"{yaw:.4f}"]


def error_tables(
    names: Sequence[str],
    evaluations: Sequence[Evaluation],
    trajectory: Trajectory,
    faults: Sequence[Span] = (),
) -> tuple[PageTable, PageTable]:
    """Tabulate errors from every and from healthy starts, and from windows without overlap."""
    from airpuck.evaluation.comparison import coasting

    first = evaluations[0]
    coasts = coasting(first, trajectory)
    named = [*zip(names, evaluations, strict=True), (coasts.model, coasts)]
    usual = PageTable(
        f"Errors of the poses predicted after {first.horizon_step * first.sample_period:.3f} s, "
        f"{first.errors.shape[2]} windows, protocol {first.protocol.name}. Constant velocity: a "
        "craft that coasts.",
        ["model", *CHANNELS, *(f"median {name}" for name in CHANNELS)],
        [[name, *errors_as_text(e.rmse), *errors_as_text(e.median_abs)] for name, e in named],
    )
    starts, sound = (len(one.start) for one in (first.every_start, first.healthy(faults)))
    rows = []
    for name, evaluation in named:
        shown = {name: evaluation.every_start}
        if sound < starts:
            shown[f"{name}, healthy"] = evaluation.healthy(faults)
        for what, found in shown.items():
            ends = [errors_as_text(found.rmse), *map(errors_as_text, found.interval)]
            cells = [
                f"{a} ({b} to {c})" if b != "nan" else a for a, b, c in zip(*ends, strict=True)
            ]
            rows.append([what, *cells])
    caption = (
        f"RMS errors from every start, {starts} windows that overlap (95 % interval). The result "
        "does not depend on where the first window starts. "
    )
    caption += (
        f"Healthy: the {sound} that touch no fault found by a model that is not under test."
        if sound < starts
        else "No start touches a fault."
    )
    return PageTable(caption, ["model", *CHANNELS], rows), usual


def budget_table(budget: ErrorBudget) -> PageTable:
    """Tabulate what causes the error."""
    rows = [
        [owner, *(f"{100 * part:.1f}" for part in share), *errors_as_text(budget.bounds[owner])]
        for owner, share in budget.shares.items()
    ]
    caption = (
        "Shares of the squared error: how much it drops when a cause is removed, averaged over "
        "opposite orders of removal; a cause counts only if it lowers BIC. Right: the error if the "
        "cause were known; in the last row, if all were."
    )
    return PageTable(caption, ["cause", "x %", "y %", "γ %", *CHANNELS], rows)


def fit_table(names: Sequence[str], fits: Sequence[FitMeasures]) -> PageTable:
    """Tabulate fit percentages and information criteria of models on one recording."""
    from airpuck.evaluation.fit_measures import fit_text

    first = fits[0]
    headings = (
        "fit % (x, y, γ)",
        f"{first.steps} steps ahead",
        f"simulated {first.restart_s:g} s",
        "simulated throughout",
        *("parameters", "log-likelihood", "AIC", "BIC"),
    )
    rows = [
        [
            name,
            *(" ".join(fit_text(values)) for values in (fit.k_step, fit.free_run, fit.whole)),
            str(fit.parameters),
            *(f"{value:.1f}" for value in (fit.log_likelihood, fit.aic, fit.bic)),
        ]
        for name, fit in zip(names, fits, strict=True)
    ]
    caption = (
        "Fit (100: perfect, 0: no better than the mean of the recording) and criteria from "
        "one-step innovations (lower AIC and BIC are better). Fit: 100 (1 − ‖y − ŷ‖/‖y − mean y‖) "
        "percent, of predictions from filter estimates and of simulations. The criteria count the "
        "parameters of model and noise; compare them on one recording only."
    )
    return PageTable(caption, headings, rows)


def band_table(bands: Sequence[PredictionBands]) -> PageTable:
    """Tabulate how many poses the bands of predictions hold."""
    rows = [
        [
            f"{one.horizon:.1f} s",
            str(len(one.start)),
            *(f"{share:.0f}" for share in one.coverage),
            *(f"{half:.3g}" for half in one.half_band),
        ]
        for one in bands
    ]
    return PageTable(
        "Poses at the end of predictions without overlap: share within the 95 % band, and median "
        "half width of the bands.",
        ["horizon", "predictions", "x %", "y %", "γ %", "± x m", "± y m", "± γ rad"],
        rows,
    )


def span_table(spans: Iterable[Span]) -> PageTable:
    """Tabulate the spans of a recording that cannot be trusted."""
    rows = [
        [s.cause, f"{s.start:.3f}", f"{s.stop:.3f}", f"{s.stop - s.start:.3f}", s.certainty]
        for s in spans
    ]
    headings = ["cause", "from [s]", "to [s]", "duration [s]", "confidence"]
    return PageTable("Spans to exclude from identification.", headings, rows)


#: Meaning of each outcome of a control step.
OUTCOMES = {
    "exact": "the requested acceleration is met",
    "scaled": "the linear or angular acceleration is scaled down, in the same direction",
    "nearest": "no scaled acceleration is feasible; the nearest one is applied",
    "optimal": "the best commands over the horizon, within all limits",
    "softened": "like optimal, but a motion limit is exceeded by as little as possible",
    "iteration limit": "the solver failed; the previous plan continues",
    "fallback": "the previous plan has ended; an LQR takes over",
    "open loop": "the pilot has no control law",
    "failed": "the solver failed; motors idle",
    "no pose": "no pose has arrived yet; motors idle",
    "stale pose": "the last pose is too old; motors idle",
    "jumping pose": "the last poses are farther away than the craft can have flown; motors idle",
    "bad input": "a pose or the time is not finite; motors idle",
    "unsafe": "the safety guard rejects the command; motors idle",
    "cannot steer": "motors that the law needs are dead; landed, motors idle",
}


def outcome_table(outcomes: Mapping[str, Mapping[str, int]]) -> PageTable:
    """Tabulate how the control steps of each flight ended."""
    rows = [
        [flight, status, str(count), OUTCOMES[status]]
        for flight, counts in outcomes.items()
        for status, count in counts.items()
    ]
    headings = ["flight", "outcome", "steps", "meaning"]
    return PageTable("Outcomes of the control steps.", headings, rows)


def agreement_table(replay: Replay) -> PageTable:
    """Tabulate the agreement of recorded and computed commands."""
    figures, size = replay.to_json(), np.abs(replay.difference)
    rows = [
        [m["name"], f"{m['correlation']:.4f}", f"{m['median_abs']:.4f}", f"{widest:.4f}"]
        for m, widest in zip(figures["motors"], np.quantile(size, 0.9, axis=0), strict=True)
    ]
    return PageTable(
        f"Agreement of recorded and computed commands in {figures['steps']} of "
        f"{int(replay.span.sum())} steps.",
        ["motor", "correlation", "median |difference|", "90 % |difference|"],
        [*rows, ["all", "", f"{figures['median_abs']:.4f}", ""]],
    )


def controller_tables(replay: Replay) -> list[PageTable]:
    """Tabulate the gains of an LQR and the outcomes of the control steps."""
    outcomes = outcome_table({"replay": replay.outcomes})
    if replay.gains is None:
        return [outcomes]
    g = replay.gains
    gains = PageTable(
        "Gains of the law, "
        f"{'fitted to the recorded commands' if replay.fitted else 'from the tuning'}.",
        ["position [1/s²]", "speed [1/s]", "yaw [1/s²]", "spin [1/s]"],
        [[f"{v:.2f}" for v in (g.position, g.speed, g.yaw, g.spin)]],
    )
    return [gains, outcomes]


def tracking_tables(flights: Sequence[Tracked]) -> list[PageTable]:
    """Tabulate the results at each set point, and differences from real flights."""
    from airpuck.flight.track import TOLERANCE

    rows = [
        [
            f"{flight.label}, {kind}",
            "{:.1f}, {:.1f} m, {:.1f} rad".format(*result.pose),
            "never" if result.settling_time is None else f"{result.settling_time:.2f}",
            _pose_error(result.overshoot),
            _pose_error(result.steady_state_error),
            f"{result.effort:.3f}",
        ]
        for flight in flights
        for kind, track in flight.tracks.items()
        for result in track.moves()
    ]
    results = PageTable(
        f"Settling time: until the craft stays within {1e3 * TOLERANCE[0]:g} mm and "
        f"{TOLERANCE[2]:g} rad of a set point (--dwell gives it more time). Steady-state error: "
        "mean over the last second, or the last quarter of a short dwell, after settling. Effort: "
        "mean sum of squared commands above idle.",
        ["flight", "set point", "settling time [s]", "overshoot", "steady-state error", "effort"],
        rows,
    )
    apart = [[f.label, *errors_as_text(f.rmse)] for f in flights if f.rmse is not None]
    if not apart:
        return [results]
    words = "RMS difference between twin and real flight, over 6 s from the first move."
    return [results, PageTable(words, ["flight", *CHANNELS], apart)]


def _pose_error(values: tuple[float, ...] | None) -> str:
    """Format an error of x, y and yaw."""
    if values is None:
        return "no poses"
    x, y, yaw = values
    return f"{1e3 * x:.1f}, {1e3 * y:.1f} mm, {yaw:.3f} rad"
