"""The paper's tables and figures, from its published parameters and from our own fits."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import replacing
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.evaluate import Evaluation, compare
from airpuck.identification.fit import identify
from airpuck.identification.problem import Preparation
from airpuck.model.model_file import published_model
from airpuck.report.fit_sections import (
    craft_section,
    optimiser_section,
    parameter_section,
    prediction_section,
    sources_section,
    thrust_section,
    timeline_section,
)
from airpuck.report.fit_study import FitStudy
from airpuck.report.page import write_page
from airpuck.report.paper_sections import (
    conventions_section,
    learning_section,
    summary_section,
    table_2,
)

RUNGS = ("M0", "M1", "M2", "M3", "M4")
TRAINING = "2023_10_18-11_28_12_sysid_h1_old"
VALIDATION = "2023_11_22-11_57_44_sysid_h1_old"

#: Where the measured acceleration of the validation recording stays below half of what the commands
#: should cause. The craft rests at first; about every 30 s all motors stop while commands are
#: logged; twice a single motor stops.
FAULTS = (
    Span(0.0, 2.2, "motors off"),
    Span(28.25, 28.75, "radio out"),
    Span(30.1, 30.25, "motor fails"),
    Span(43.7, 43.9, "unknown"),
    Span(58.1, 58.75, "radio out"),
    Span(60.2, 60.65, "motor fails"),
    Span(88.25, 88.6, "radio out"),
)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The paper's study, done again."""

    #: Fits, evaluations and published models.
    study: FitStudy
    #: The report.
    page: Path
    #: Time that everything took [s].
    wall_s: float

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        published = {e.model: e for e in self.study.reference_evaluations}
        fitted = {e.model: e for e in self.study.fitted}
        return {
            "published": {name: e.to_json() for name, e in published.items()},
            "fitted": {name: e.to_json() for name, e in fitted.items()},
            "fits": {fit.model.name: fit.to_json() for fit in self.study.fits},
            "table_2": {"published": _errors(published), "fitted": _errors(fitted)},
            "wall_s": self.wall_s,
        }


def _errors(evaluations: Mapping[str, Evaluation]) -> dict[str, dict[str, float]]:
    """Return a column of Table 2 as plain numbers."""
    return {
        name: {
            "x_mm": float(1e3 * e.rmse[0]),
            "y_mm": float(1e3 * e.rmse[1]),
            "yaw_rad": float(e.rmse[2]),
        }
        for name, e in evaluations.items()
    }


def reproduce(
    data: str | os.PathLike[str] | None,
    out: str | os.PathLike[str],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Reproduction:
    """Reproduce the paper's tables and figures, published against ours.

    Writes ``index.html``, one self-contained page; its pictures in ``figures``; ``models/M0.toml``
    … ``M4.toml``; and ``reproduce.json``, the numbers.

    Parameters
    ----------
    data : path-like or None
        Folder of the public dataset; None: ``$AIRPUCK_DATA``, or downloaded.
    out : path-like
        Folder to write to.
    progress : callable, optional
        Called with a line of text after each step.

    Returns
    -------
    Reproduction
        All numbers.

    Raises
    ------
    InputError
        If a recording is missing or damaged, or the folder cannot be written to. Nothing is
        written before all numbers are there.
    """
    started = time.perf_counter()
    training, validation = _experiments(data)
    published = {name: published_model(name) for name in RUNGS}
    reference = tuple(compare(list(published.values()), validation))
    progress("evaluated the published parameters")
    fits = []
    for name in RUNGS:
        # As in the paper, whose fits saw the faults of the recording, too.
        fits.append(identify(training, name, preparation=Preparation(faults="keep")))
        progress(f"identified {name} in {fits[-1].wall_s:.1f} s, {fits[-1].iterations} iterations")
    study = FitStudy(
        training=training,
        fits=tuple(fits),
        fitted=tuple(compare([fit.model for fit in fits], validation)),
        reference=published,
        reference_evaluations=reference,
        faults=FAULTS,
    )
    computed = time.perf_counter() - started

    progress("drawing")
    folder = Path(out)
    page = _write_report(folder, study, validation, computed)
    for fit in study.fits:
        fit.model.save(folder / "models" / f"{fit.model.name}.toml")
    result = Reproduction(study, page, time.perf_counter() - started)
    with replacing(folder / "reproduce.json") as temporary:
        temporary.write_text(json.dumps(result.to_json(), indent=2) + "\n", encoding="utf-8")
    return result


def _experiments(data: str | os.PathLike[str] | None) -> tuple[Trajectory, Trajectory]:
    """Read the paper's training and validation recordings."""
    from airpuck.recording.dataset import dataset_folder
    from airpuck.recording.torch_archive import read_authors_experiment

    folder = dataset_folder() if data is None else Path(data)
    if not (folder / "experiments").is_dir():
        raise InputError(
            "has no folder `experiments`; give a copy of the public dataset, or none to use "
            "$AIRPUCK_DATA or a download",
            file=folder,
            field="data",
        )
    training, validation = (
        read_authors_experiment(folder / "experiments" / name / "data.pt")
        for name in (TRAINING, VALIDATION)
    )
    return training, validation


def _write_report(out: Path, study: FitStudy, validation: Trajectory, wall_s: float) -> Path:
    """Write the page."""
    sections = [
        summary_section(study, wall_s),
        craft_section(study.models[0].vehicle),
        learning_section(study),
        prediction_section(study, table_2(study)),
        timeline_section(study),
        thrust_section(study),
        optimiser_section(study),
        parameter_section(study),
        conventions_section(),
        sources_section(study.training, validation),
    ]
    return write_page(
        out,
        "Identifying a hovercraft: the paper's study, done again",
        "R. Schwan, N. Schmid, E. Chassaing, K. Samaha, C. N. Jones: On identifying the non-linear "
        "dynamics of a hovercraft using an end-to-end deep learning approach (IFAC-PapersOnLine "
        "58-15, 2024, 289–294). Its published parameters and our own fits, learned from the same "
        "recording, judged on the same other recording.",
        sections,
    )
