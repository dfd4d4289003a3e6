"""What commands print and write."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from airpuck.evaluation.evaluate import Evaluation
    from airpuck.flight.replay import Replay
    from airpuck.identification.method import Iteration
    from airpuck.twin.experiments import Excited
    from airpuck.twin.tracking_study import Tracked


def check_destinations(**paths: Path | None) -> None:
    """Refuse places that cannot be written to, before any work is done for them."""
    import tempfile

    from airpuck.boundary.errors import InputError

    taken: dict[Path, str] = {}
    for option, path in paths.items():
        if path is None or is_stdout(path):
            continue
        option = "-o" if option == "output" else f"--{option}"
        whole = path.absolute()
        if whole in taken:
            raise InputError(f"is the place of {taken[whole]}, too", file=path, field=option)
        taken[whole] = option
        existing = next(folder for folder in (whole, *whole.parents) if folder.exists())
        if existing == whole and existing.is_file():
            existing = whole.parent
        try:
            with tempfile.TemporaryFile(dir=existing):
                pass
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror}); choose another place",
                file=path,
                field=option,
            ) from None


def say(quiet: bool) -> Any:
    """Return a function that prints what is being done."""
    return (lambda _: None) if quiet else (lambda text: print(text, file=sys.stderr, flush=True))


def warn(warnings: Any, quiet: bool = False) -> None:
    """Print warnings on standard error."""
    if not quiet:
        for warning in warnings:
            print(f"warning: {warning}", file=sys.stderr)


def console() -> Console:
    """Return where tables are printed; what is not a terminal has no width, rows go on as long."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 160)


def is_stdout(json_file: Path | None) -> bool:
    """Say whether JSON goes to standard output, where nothing else may then be printed."""
    return json_file is not None and str(json_file) == "-"


def write_json(json_file: Path | None, figures: Any) -> None:
    """Write figures where --json says."""
    if json_file is None:
        return
    text = json.dumps(_without_nan(figures), indent=2, allow_nan=False) + "\n"
    if is_stdout(json_file):
        sys.stdout.write(text)
        return
    from airpuck.boundary.files import replacing

    with replacing(json_file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _without_nan(figures: Any) -> Any:
    """Put null for what is no number, which JSON has no word for."""
    if isinstance(figures, dict):
        return {key: _without_nan(value) for key, value in figures.items()}
    if isinstance(figures, (list, tuple)):
        return [_without_nan(value) for value in figures]
    return None if isinstance(figures, float) and not math.isfinite(figures) else figures


def show_progress(quiet: bool) -> Any:
    """Show an optimiser's iterations: one live line on a terminal, plain lines elsewhere."""
    from contextlib import contextmanager

    @contextmanager
    def shown() -> Any:
        if quiet:
            yield lambda _: None
        elif sys.stderr.isatty():
            from rich.console import Console

            with Console(stderr=True).status("compiling …") as status:
                yield lambda iteration: status.update(_line(iteration))
        else:
            yield lambda iteration: print(_line(iteration), file=sys.stderr)

    return shown()


def _line(iteration: Iteration) -> str:
    """Describe one iteration."""
    held_out = iteration.test_loss
    tail = "" if held_out is None else f", held out {held_out:.4e}"
    return f"iteration {iteration.number}: loss {iteration.loss:.4e}{tail}"


def print_table(names: list[str], evaluations: list[Evaluation]) -> None:
    """Print errors of several models as a table."""
    from rich.table import Table

    first = evaluations[0]
    after = first.horizon_step * first.sample_period
    table = Table(
        title=f"Prediction error after {after:.3f} s, {first.errors.shape[2]} windows, "
        f"protocol {first.protocol.name}",
        title_justify="left",
    )
    for heading in ("model", "x mm", "y mm", "yaw rad", "median x", "median y", "median yaw"):
        table.add_column(
            heading, justify="left" if heading == "model" else "right", overflow="fold"
        )
    for name, evaluation in zip(names, evaluations, strict=True):
        row = [
            f"{factor * value:.{digits}f}"
            for values in (evaluation.rmse, evaluation.median_abs)
            for value, factor, digits in zip(values, (1e3, 1e3, 1), (2, 2, 4), strict=True)
        ]
        table.add_row(name, *row)
    console().print(table)


def print_replay(replay: Replay) -> None:
    """Print how much recorded and computed commands agree."""
    figures = replay.to_json()
    for motor in figures["motors"]:
        print(
            f"{motor['name']:16s} correlation {motor['correlation']:6.3f}   "
            f"median difference {motor['median_abs']:.4f}"
        )
    print(f"{'all':16s} {'':18s}   median difference {figures['median_abs']:.4f}")
    fitted = "fitted" if replay.fitted else "from the tuning"
    print(f"gains {fitted}: " + ", ".join(f"{k} {v:.2f}" for k, v in figures["gains"].items()))
    outcomes = ", ".join(f"{count} {name}" for name, count in figures["outcomes"].items())
    print(f"{figures['steps']} of {int(replay.span.sum())} steps compared; outcomes: {outcomes}")


def print_excitation(excited: Excited) -> None:
    """Print how near to the rails the craft came."""
    contacts = excited.contacts
    told = "none"
    if contacts:
        times = ", ".join(f"{time:.1f}" for time in contacts[:10]) + " …" * (len(contacts) > 10)
        told = f"{len(contacts)}, at {times} s (rails are in no model)"
    print(f"signals paused near the rails: {excited.paused:.1f} s; contacts with a rail: {told}")


def print_tracks(flights: list[Tracked]) -> None:
    """Print what became of the set points."""
    for flight in flights:
        for result in flight.results:
            settled = result.settling_time
            end = "no poses at the end"
            if result.steady_state_error is not None:
                x, y, yaw = result.steady_state_error
                end = f"off by {1e3 * x:6.1f} mm, {1e3 * y:6.1f} mm, {yaw:6.3f} rad at the end"
            print(
                f"{flight.model:8s} to ({result.pose[0]:4.1f}, {result.pose[1]:4.1f}, "
                f"{result.pose[2]:4.1f}): "
                f"{'did not settle' if settled is None else f'settled in {settled:.2f} s':18s} "
                f"{end}"
            )
        if flight.rmse is not None:
            x, y, yaw = flight.rmse
            print(
                f"{flight.model:8s} twin against the real flight, 6 s from the first move on: "
                f"{1e3 * x:.1f} mm, {1e3 * y:.1f} mm, {yaw:.3f} rad RMS"
            )
