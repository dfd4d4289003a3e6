"""What `identify` prints."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from airpuck.cli.output import console

if TYPE_CHECKING:
    from airpuck.evaluation.main_quantities import MainQuantity
    from airpuck.evaluation.presentation import Value
    from airpuck.identification.fit_result import Fit
    from airpuck.model.model_file import Model


def show_resampling(quiet: bool, total: int) -> Callable[[int], None]:
    """Return what prints now and then how many fits to resampled data are done."""

    def show(done: int) -> None:
        if not quiet and (done == total or done % max(1, total // 10) == 0):
            print(f"resampled {done} of {total}", file=sys.stderr, flush=True)

    return show


def print_fit(fit: Fit) -> None:
    """Print how a fit ended, the main quantities with their errors, and what is not determined."""
    from rich.table import Table

    from airpuck.identification.fit_result import knowledge_words, outcome_words

    for line in outcome_words(fit):
        print(line)
    known = fit.uncertainty
    if known is None:
        return
    table = Table(
        title=f"Learned values ± standard error, from {known.clusters} blocks of time",
        title_justify="left",
    )
    headings = ["", "unit", "value", "95 % interval"]
    if known.bootstrap is not None:
        headings.append(f"95 %, {known.bootstrap.replicates} resampled")
    for heading in headings:
        table.add_column(heading, justify="right" if heading[:1] in "v9" and heading else "left")
    for row in _rows(fit.model):
        table.add_row(*row[: len(headings)])
    console().print(table)
    for line in knowledge_words(fit):
        print(line)


def _rows(model: Model) -> list[list[str]]:
    """Return the texts of the main quantities that were learned."""
    from airpuck.evaluation.main_quantities import main_quantities
    from airpuck.evaluation.presentation import value_of

    return [
        [*value_texts(value_of(model, quantity)), _resampled(model, quantity)]
        for quantity in main_quantities(model, speeds=(0.5, 1.0))
        if quantity.used(model) and quantity.learned(model)
    ]


def value_texts(value: Value) -> list[str]:
    """Return the texts of one quantity: value ± standard error, and the interval."""
    if value.interval is None:
        return [value.label, value.unit, f"{value.value:.4g}", "none" if value.learned else "fixed"]
    digits = _digits(value.standard_error)
    low, high = (f"{end:.{digits}f}" for end in value.interval)
    shown = f"{value.value:.{digits}f} ± {value.standard_error:.{digits}f}"
    return [value.label, value.unit, shown, f"{low} … {high}"]


def _resampled(model: Model, quantity: MainQuantity) -> str:
    """Return the text of a bootstrap's interval."""
    import numpy as np

    found = model.uncertainty and model.uncertainty.bootstrap
    if not found or quantity.entry is None:
        return ""
    entries = np.flatnonzero(model.parameters.mask(frozenset({quantity.parameter})))
    position = entries[quantity.entry]
    if not math.isfinite(found.lower[position]):
        return ""
    low, high = (quantity.factor * float(e[position]) for e in (found.lower, found.upper))
    digits = _digits((high - low) / 4)
    return f"{low:.{digits}f} … {high:.{digits}f}"


def _digits(error: float) -> int:
    """Return the decimals that show two significant digits of an error."""
    return max(0, 1 - math.floor(math.log10(error))) if error > 0 else 3
