"""What the commands that judge models print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from airpuck.cli.fit_output import value_texts
from airpuck.cli.output import console

if TYPE_CHECKING:
    from airpuck.evaluation.drift import Drift
    from airpuck.evaluation.fit_measures import FitMeasures
    from airpuck.evaluation.prediction_bands import PredictionBands
    from airpuck.evaluation.presentation import Presentation, Value


def print_presentation(presentation: Presentation) -> None:
    """Print a model."""
    for line in presentation.structure:
        print(line)
    _print_values("Parameters ± standard error", presentation.parameters)
    _print_values("What follows from them", presentation.derived)
    for key, value in presentation.conditions:
        print(f"{key}: {value}")
    for note in presentation.notes:
        print(f"note: {note}")


def _print_values(title: str, values: Sequence[Value]) -> None:
    """Print values as a table."""
    _print_rows(
        title, ("", "unit", "value", "95 % interval"), [value_texts(value) for value in values]
    )


def print_fit_measures(names: Sequence[str], fits: Sequence[FitMeasures]) -> None:
    """Print fit percentages and information criteria."""
    first = fits[0]
    headings = (
        "fit % (x, y, yaw)",
        f"{first.steps} steps ahead",
        f"simulated {first.restart:g} s",
        "simulated throughout",
        "parameters",
        "log-likelihood",
        "AIC",
        "BIC",
    )
    rows = []
    for name, fit in zip(names, fits, strict=True):
        shown = [
            " ".join(f"{value:.1f}" for value in values)
            for values in (fit.k_step, fit.free_run, fit.whole)
        ]
        criteria = [f"{value:.1f}" for value in (fit.log_likelihood, fit.aic, fit.bic)]
        rows.append([name, *shown, str(fit.parameters), *criteria])
    _print_rows("Fit, and criteria from one-step innovations", headings, rows)


def print_coverage(bands: Sequence[PredictionBands]) -> None:
    """Print how often measured poses are where predictions say."""
    for one in bands:
        shares = ", ".join(f"{share:.0f} %" for share in one.coverage)
        print(
            f"  95 % bands {one.horizon:.1f} s ahead hold {shares} of x, y, yaw in "
            f"{len(one.start)} predictions"
        )


def print_drift(names: Sequence[str], found: Drift) -> None:
    """Print what changed from one model to the other."""
    print(f"from {names[0]} to {names[1]}, {len(found.changes)} quantities:")
    for sentence in found.verdicts:
        print(f"  {sentence}")
    for note in found.notes:
        print(f"  note: {note}")


def _print_rows(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with its first columns to the left."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console().print(table)
