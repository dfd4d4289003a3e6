"""The paper's study without hardware: fly, record, identify, validate, and fly with the result."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import replacing, temporary_name
from airpuck.model.model_file import published_model
from airpuck.model.rungs import RUNGS
from airpuck.recording.stream import Recording

if TYPE_CHECKING:
    from airpuck.report.page import Origin

#: Excitation experiments: seeds of the one to learn from and the one to validate on.
_SEEDS = {"training": 1, "validation": 2}
#: Models that fly the set points.
_PILOTS = ("M0", "M4")
#: A file with this name says that a folder may be made anew.
_MARKER = "written-by-airpuck-demo"


def demo(
    out: str | os.PathLike[str],
    *,
    duration: float = 90.0,
    progress: Callable[[str], None] = lambda _: None,
    origin: Origin | None = None,
) -> Path:
    """Fly the excitation experiment twice on the twin, identify M0 … M4, fly with the result.

    The truth of the twin is the published M3; sensors and radio are as in the real recordings,
    which are saved and read back as ROS 2 bags.

    Parameters
    ----------
    out : path-like
        Folder for the page, figures, models and bags; bags are replaced only if a demo wrote them.
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
        If the folder holds bags of somebody else, or cannot be written to.
    """
    from airpuck import read_recording
    from airpuck.evaluation.evaluate import compare
    from airpuck.identification.fit import identify
    from airpuck.preprocessing.pipeline import preprocess
    from airpuck.report.fit_report import fit_report
    from airpuck.report.judged_sections import Judged, errors_as_text
    from airpuck.report.tracking_report import tracking_sections
    from airpuck.twin.experiments import excite
    from airpuck.twin.plant import build_plant
    from airpuck.twin.tracking_study import tracking_study

    out = Path(out)
    bags = _own_folder(out / "bags")
    # The offset of a real craft's centre of mass turns with it.
    truth = replace(published_model("M3"), frame="body", indexing="start")
    plant = build_plant(truth)
    trajectories = {}
    for name, seed in _SEEDS.items():
        folder = bags / name
        progress(f"flying the {name} experiment on the twin: {duration:g} s")
        _replace_bag(excite(truth, duration, seed, plant=plant), folder)
        trajectories[name] = preprocess(read_recording(folder))
        delay = 1e3 * trajectories[name].delay
        progress(f"preprocessed {folder}: transport delay {delay:.1f} ms")
    fits = []
    for name in ("M0", "M1", "M2", "M3", "M4"):
        fits.append(identify(trajectories["training"], name))
        fits[-1].model.save(out / "models" / f"{name}.toml")
        progress(f"identified {name} ({RUNGS[name].summary}) in {fits[-1].wall_s:.1f} s")
    *evaluations, best_possible = compare(
        [*(fit.model for fit in fits), truth], trajectories["validation"]
    )
    judged = Judged(trajectories["validation"], tuple(evaluations), (best_possible,), "true")
    for evaluation in evaluations:
        x, y, yaw = errors_as_text(evaluation.rmse)
        progress(f"{evaluation.model}: after 0.2 s off by {x} mm, {y} mm, {yaw} rad")
    pilots = [fit.model for fit in fits if fit.model.name in _PILOTS]
    progress(f"flying the set points with {' and '.join(pilot.name for pilot in pilots)}")
    flights = tracking_study(pilots, truth)
    for flight in flights:
        _replace_bag(flight.recording, bags / f"set_points_{flight.model}")
    progress("writing the report")
    return fit_report(
        fits,
        trajectories["training"],
        out,
        judged=judged,
        truth=truth,
        title="The paper's study on the twin",
        more=tracking_sections(flights),
        origin=origin,
    )


def _own_folder(folder: Path) -> Path:
    """Make a folder, and refuse one that holds what somebody else put there."""
    theirs = folder.exists() and any(not path.name.startswith(".") for path in folder.iterdir())
    if theirs and not (folder / _MARKER).is_file():
        raise InputError("holds recordings of yours; choose another folder (-o)", file=folder)
    with replacing(folder / _MARKER):
        return folder


def _replace_bag(recording: Recording, folder: Path) -> None:
    """Write a bag; one that was there stays until the new one is whole."""
    import shutil

    from airpuck import write_bag

    new, old = (folder.parent / temporary_name(folder) for _ in range(2))
    try:
        write_bag(recording, new / folder.name)
        if folder.exists():
            folder.rename(old)
        (new / folder.name).rename(folder)
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)
