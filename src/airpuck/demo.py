"""The whole way on simulated recordings: no download, no hardware."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from airpuck.model.presets import PRESETS
from airpuck.model_file import published_model

#: Length of the simulated recordings [s] and their seeds: to learn from, and to validate on.
_DURATION, _SEEDS = 45.0, {"training": 1, "validation": 2}


def demo(out: str | os.PathLike[str], *, progress: Callable[[str], None] = lambda _: None) -> Path:
    """Simulate two recordings, preprocess them, identify M0 … M4, evaluate, and write a report.

    The recordings are flights of the published M3 under random signals, with pose noise and
    transport delay, saved and read back as ROS 2 bags.

    Parameters
    ----------
    out : path-like
        Folder to write to; its ``bags`` are made anew.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    Path
        The report.
    """
    from airpuck.evaluation.evaluate import compare
    from airpuck.identification.fit import identify
    from airpuck.preprocessing.pipeline import preprocess
    from airpuck.recording import read_recording, write_bag
    from airpuck.report.fit_report import fit_report
    from airpuck.twin.random_flight import random_recording

    out = Path(out)
    truth = published_model("M3")
    trajectories = {}
    for name, seed in _SEEDS.items():
        folder = out / "bags" / name
        shutil.rmtree(folder, ignore_errors=True)
        progress(f"flying the {name} experiment: {_DURATION:g} s, simulated")
        write_bag(random_recording(truth, _DURATION, seed), folder)
        trajectories[name] = preprocess(read_recording(folder))
        delay = 1e3 * trajectories[name].delay
        progress(f"preprocessed {folder}: transport delay {delay:.1f} ms")
    fits = []
    for name in ("M0", "M1", "M2", "M3", "M4"):
        fits.append(identify(trajectories["training"], name))
        fits[-1].model.save(out / "models" / f"{name}.toml")
        progress(f"identified {name} ({PRESETS[name].summary}) in {fits[-1].wall_s:.1f} s")
    evaluations = compare([fit.model for fit in fits], trajectories["validation"])
    for evaluation in evaluations:
        x, y, yaw = evaluation.rmse
        progress(
            f"{evaluation.model}: after 0.2 s off by {1e3 * x:.2f} mm, {1e3 * y:.2f} mm, "
            f"{yaw:.4f} rad"
        )
    return fit_report(fits, evaluations, trajectories["training"], out, truth=truth)
