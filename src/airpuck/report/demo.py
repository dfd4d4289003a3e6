"""The paper's study without hardware: fly, record, identify, validate, and fly the result."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING

from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import replacing, temporary_name
from airpuck.model.model_file import Model, published_model
from airpuck.model.rungs import RUNGS
from airpuck.recording.stream import Recording

if TYPE_CHECKING:
    from airpuck.data.trajectory import Trajectory
    from airpuck.identification.fit_result import Fit
    from airpuck.report.page import Origin

#: Seeds of the excitation experiments.
_SEEDS = {"training": 1, "validation": 2}
#: Models to identify.
_MODELS = ("M0", "M1", "M2", "M3", "M4")
#: Models that fly the set points.
_PILOTS = ("M0", "M4")
#: A file with this name marks a folder that a demo may overwrite.
_MARKER = "written-by-airpuck-demo"


def demo(
    out: str | os.PathLike[str],
    *,
    duration: float = 90.0,
    progress: Callable[[str], None] = lambda _: None,
    origin: Origin | None = None,
) -> Path:
    """Fly the excitation experiment twice on the twin, identify M0 … M4, fly with the result.

    The twin flies the published M3, with sensors and radio as in the real recordings. All flights
    are saved as ROS 2 bags and read back.

    Parameters
    ----------
    out : path-like
        Folder for the page, figures, models and bags. Only bags of an earlier demo are replaced.
    duration : float, default 90
        Length of each excitation experiment [s].
    progress : callable, optional
        Called with a line of text after each step.
    origin : Origin, optional
        Command line and date, for the foot of the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        If the folder holds other bags, or cannot be written to.
    """
    from airpuck.evaluation.evaluate import compare
    from airpuck.experiment_design.forecast import on_processes
    from airpuck.preprocessing.pipeline import load_trajectory
    from airpuck.report.control_report import tracking_sections
    from airpuck.report.evaluation_report import JudgedModels
    from airpuck.report.fit_report import fit_report
    from airpuck.report.tables import errors_as_text
    from airpuck.twin.tracking_study import tracking_study

    out = Path(out)
    bags = _own_folder(out / "bags")
    truth = _truth()
    names = " and ".join(_SEEDS)
    progress(f"flying the {names} experiments on the twin in parallel: {duration:g} s each")
    with on_processes(None) as run:  # one flight keeps one core busy
        list(run(fly_experiment, map(bags.joinpath, _SEEDS), _SEEDS.values(), repeat(duration)))
    trajectories = {name: load_trajectory(bags / name) for name in _SEEDS}
    for name, trajectory in trajectories.items():
        delay = 1e3 * trajectory.delay
        progress(f"preprocessed {bags / name}: transport delay {delay:.1f} ms")
    progress(f"identifying {', '.join(_MODELS)} in parallel")
    fits = _identified(trajectories["training"])
    for fit in fits:
        name = fit.model.name
        fit.model.save(out / "models" / f"{name}.toml")
        progress(f"identified {name} ({RUNGS[name].summary}): loss {fit.loss:.2e}")
    *evaluations, best_possible = compare(
        [*(fit.model for fit in fits), truth], trajectories["validation"]
    )
    judged = JudgedModels(trajectories["validation"], tuple(evaluations), (best_possible,), "true")
    for evaluation in evaluations:
        x, y, yaw = errors_as_text(evaluation.rmse)
        progress(f"{evaluation.model}: RMSE after 0.2 s: {x} mm, {y} mm, {yaw} rad")
    pilots = [fit.model for fit in fits if fit.model.name in _PILOTS]
    progress(f"flying the set points with {' and '.join(pilot.name for pilot in pilots)}")
    flights = tracking_study(pilots, truth)
    for flight in flights:
        _replace_bag(flight.recording, bags / f"set_points_{flight.model}")
    progress("writing the report")
    tracking, commands = tracking_sections(flights)
    moving, *evidence = tracking.blocks
    return fit_report(
        fits,
        trajectories["training"],
        out,
        judged=judged,
        truth=truth,
        title="The paper's study on a simulated craft",
        opening=[moving],
        more=[replace(tracking, blocks=evidence), commands],
        origin=origin,
    )


def _truth() -> Model:
    """Return the model that the twin flies: the published M3."""
    # In a real craft, the offset of the centre of mass turns with the body.
    return replace(published_model("M3"), frame="body", indexing="start")


def fly_experiment(folder: str | os.PathLike[str], seed: int, duration: float) -> None:
    """Fly the excitation experiment on the twin, and save it as a bag."""
    from airpuck import excite

    _replace_bag(excite(_truth(), duration, seed), Path(folder))


def _identified(training: Trajectory) -> list[Fit]:
    """Identify all models in parallel."""
    from airpuck.compute.process import usable_cores
    from airpuck.identification.fit import identify

    # The slowest fit starts first. While one fit compiles or retimes packets, the others compute.
    with ThreadPoolExecutor(usable_cores()) as pool:
        fits = {name: pool.submit(identify, training, name) for name in reversed(_MODELS)}
        return [fits[name].result() for name in _MODELS]


def _own_folder(folder: Path) -> Path:
    """Make a folder, or raise InputError if it contains the user's own files."""
    foreign = folder.exists() and any(not path.name.startswith(".") for path in folder.iterdir())
    if foreign and not (folder / _MARKER).is_file():
        raise InputError(
            "contains files that are not from a demo; choose another folder (-o)", file=folder
        )
    with replacing(folder / _MARKER):
        return folder


def _replace_bag(recording: Recording, folder: Path) -> None:
    """Write a bag; an old one stays until the new one is complete."""
    import shutil

    from airpuck import write_bag

    new, old = (folder.parent / temporary_name(folder) for _ in range(2))
    try:
        write_bag(recording, new / folder.name)
        if folder.exists():
            folder.rename(old)
        (new / folder.name).rename(folder)
    except InputError as error:
        raise InputError(error.problem, file=folder) from error
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)
