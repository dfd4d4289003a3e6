"""What `identify` prints."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airpuck.identification.fit import Fit
    from airpuck.model_file import Model

#: Scalar quantities to print: attribute, entry, symbol, unit, factor from SI.
_SCALARS = (
    ("motor_time_constant", 0, "τ", "ms", 1e3),
    ("inertia", 0, "I", "10⁻³ kg m²", 1e3),
    ("angle_offset", 0, "α", "mrad", 1e3),
    ("center_of_mass", 0, "r x", "mm", 1e3),
    ("center_of_mass", 1, "r y", "mm", 1e3),
)


def show_resampling(quiet: bool, total: int) -> Callable[[int], None]:
    """Return what tells now and then how many fits to resampled data are done."""

    def told(done: int) -> None:
        if not quiet and (done == total or done % max(1, total // 10) == 0):
            print(f"resampled {done} of {total}", file=sys.stderr, flush=True)

    return told


def print_fit(fit: Fit) -> None:
    """Print how a fit ended, the main quantities with their errors, and what is not determined."""
    from rich.console import Console
    from rich.table import Table

    print(
        f"{fit.model.name}: loss {fit.loss:.4e} after {fit.iterations} iterations "
        f"on {fit.windows} windows, {fit.wall_s:.1f} s ({fit.message})"
    )
    known, found = fit.uncertainty, fit.identifiability
    if known is None or found is None:
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
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    print(
        f"{found.rank} of {found.free} free parameters determined, condition "
        f"{found.condition:.1e}; weakest: {', '.join(found.weakest)}"
    )
    for note in [*found.notes, *known.notes]:
        print(note)


def _rows(model: Model) -> list[list[str]]:
    """Return texts of the main quantities, as far as they were learned."""
    import numpy as np

    from airpuck.model.thrust import thrust
    from airpuck.report.gauge import physical_thrust

    def entry(name: str, k: int, factor: float) -> Callable[[Model], Any]:
        return lambda m: factor * np.ravel(getattr(m.parameters, name))[k]

    rows = []
    for name, k, symbol, unit, factor in _SCALARS:
        position = np.flatnonzero(model.parameters.mask(frozenset({name})))[k]
        if model.free[position]:
            rows.append(_row(model, symbol, unit, entry(name, k, factor)))
            rows[-1].append(_resampled(model, int(position), factor))
    if not model.free[model.parameters.mask(frozenset({"thrust"}))].any():
        return rows
    for motor, name in enumerate(model.vehicle.propeller_names):
        for speed in (0.5, 1.0):

            def force(m: Model, motor: int = motor, speed: float = speed) -> Any:
                return thrust(physical_thrust(m)[motor : motor + 1], np.array([speed]))[0]

            rows.append([*_row(model, f"F({speed:g}) {name}", "N", force), ""])
    return rows


def _row(model: Model, symbol: str, unit: str, quantity: Callable[[Model], Any]) -> list[str]:
    """Return the texts of one quantity: value ± standard error, and the interval."""
    value, error = float(quantity(model)), float(model.standard_error(quantity))
    if not (math.isfinite(error) and error > 0) or model.uncertainty is None:
        return [symbol, unit, f"{value:.4g}", "none"]
    digits = _digits(error)
    reach = model.uncertainty.quantile * error
    interval = f"{value - reach:.{digits}f} … {value + reach:.{digits}f}"
    return [symbol, unit, f"{value:.{digits}f} ± {error:.{digits}f}", interval]


def _resampled(model: Model, position: int, factor: float) -> str:
    """Return the text of a bootstrap's interval."""
    found = model.uncertainty and model.uncertainty.bootstrap
    if not found or not math.isfinite(found.lower[position]):
        return ""
    low, high = factor * found.lower[position], factor * found.upper[position]
    digits = _digits((high - low) / 4)
    return f"{low:.{digits}f} … {high:.{digits}f}"


def _digits(error: float) -> int:
    """Return the decimals that show two significant digits of an error."""
    return max(0, 1 - math.floor(math.log10(error))) if error > 0 else 3
