"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

The way of the data::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Public names are imported where they are used, so that ``import airpuck`` is quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from airpuck.boundary.errors import InputError
    from airpuck.campaigns.campaign import campaign
    from airpuck.control.reference import SetPoint, SetPoints, TimedPath
    from airpuck.control.tracking import TrackingController
    from airpuck.control.tuning import Tuning, read_tuning
    from airpuck.craft.vehicle import Vehicle, default_vehicle, read_vehicle
    from airpuck.data.trajectory import Span, Trajectory, read_trajectory
    from airpuck.estimate.encoder import PaperEncoder
    from airpuck.evaluation.drift import Drift, drift
    from airpuck.evaluation.evaluate import Evaluation, compare, evaluate
    from airpuck.evaluation.prediction_bands import PredictionBands, prediction_bands
    from airpuck.evaluation.presentation import Presentation, present
    from airpuck.evaluation.residuals import ResidualTests, resid
    from airpuck.experiment_design.design import design
    from airpuck.faults.find import find_faults
    from airpuck.faults.layout_check import check_layout
    from airpuck.flight.preflight import preflight
    from airpuck.flight.replay import Replay, replay
    from airpuck.identification.adam import Adam
    from airpuck.identification.fit import identifiability, identify
    from airpuck.identification.fit_result import Fit
    from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
    from airpuck.model.model_file import Model, read_model
    from airpuck.model.parameters import Parameters
    from airpuck.preprocessing.load import load_trajectory
    from airpuck.preprocessing.pipeline import preprocess
    from airpuck.recording.bag_writer import write_bag
    from airpuck.recording.csv_folder import write_csv
    from airpuck.recording.dataset import fetch
    from airpuck.recording.read import read_recording
    from airpuck.recording.stream import Recording, Stream
    from airpuck.report.animation import animate
    from airpuck.report.reproduce import reproduce
    from airpuck.twin.experiments import excite, track
    from airpuck.twin.fleet import fly_fleet
    from airpuck.twin.settings import TwinSettings, read_twin_settings
    from airpuck.twin.tracking_study import tracking_study
    from airpuck.twin.twin import Twin

#: Public name -> the module that defines it.
_HOME = {
    "Adam": "airpuck.identification.adam",
    "Drift": "airpuck.evaluation.drift",
    "Evaluation": "airpuck.evaluation.evaluate",
    "Fit": "airpuck.identification.fit_result",
    "InputError": "airpuck.boundary.errors",
    "LevenbergMarquardt": "airpuck.identification.levenberg_marquardt",
    "Model": "airpuck.model.model_file",
    "PaperEncoder": "airpuck.estimate.encoder",
    "Parameters": "airpuck.model.parameters",
    "PredictionBands": "airpuck.evaluation.prediction_bands",
    "Presentation": "airpuck.evaluation.presentation",
    "Recording": "airpuck.recording.stream",
    "Replay": "airpuck.flight.replay",
    "ResidualTests": "airpuck.evaluation.residuals",
    "SetPoint": "airpuck.control.reference",
    "SetPoints": "airpuck.control.reference",
    "Span": "airpuck.data.trajectory",
    "Stream": "airpuck.recording.stream",
    "TimedPath": "airpuck.control.reference",
    "TrackingController": "airpuck.control.tracking",
    "Trajectory": "airpuck.data.trajectory",
    "Tuning": "airpuck.control.tuning",
    "Twin": "airpuck.twin.twin",
    "TwinSettings": "airpuck.twin.settings",
    "Vehicle": "airpuck.craft.vehicle",
    "animate": "airpuck.report.animation",
    "campaign": "airpuck.campaigns.campaign",
    "check_layout": "airpuck.faults.layout_check",
    "compare": "airpuck.evaluation.evaluate",
    "default_vehicle": "airpuck.craft.vehicle",
    "design": "airpuck.experiment_design.design",
    "drift": "airpuck.evaluation.drift",
    "evaluate": "airpuck.evaluation.evaluate",
    "excite": "airpuck.twin.experiments",
    "fetch": "airpuck.recording.dataset",
    "find_faults": "airpuck.faults.find",
    "fly_fleet": "airpuck.twin.fleet",
    "identifiability": "airpuck.identification.fit",
    "identify": "airpuck.identification.fit",
    "load_trajectory": "airpuck.preprocessing.load",
    "prediction_bands": "airpuck.evaluation.prediction_bands",
    "preflight": "airpuck.flight.preflight",
    "present": "airpuck.evaluation.presentation",
    "preprocess": "airpuck.preprocessing.pipeline",
    "read_model": "airpuck.model.model_file",
    "read_recording": "airpuck.recording.read",
    "read_trajectory": "airpuck.data.trajectory",
    "read_tuning": "airpuck.control.tuning",
    "read_twin_settings": "airpuck.twin.settings",
    "read_vehicle": "airpuck.craft.vehicle",
    "replay": "airpuck.flight.replay",
    "reproduce": "airpuck.report.reproduce",
    "resid": "airpuck.evaluation.residuals",
    "track": "airpuck.twin.experiments",
    "tracking_study": "airpuck.twin.tracking_study",
    "write_bag": "airpuck.recording.bag_writer",
    "write_csv": "airpuck.recording.csv_folder",
}

__all__ = [
    "Adam",
    "Drift",
    "Evaluation",
    "Fit",
    "InputError",
    "LevenbergMarquardt",
    "Model",
    "PaperEncoder",
    "Parameters",
    "PredictionBands",
    "Presentation",
    "Recording",
    "Replay",
    "ResidualTests",
    "SetPoint",
    "SetPoints",
    "Span",
    "Stream",
    "TimedPath",
    "TrackingController",
    "Trajectory",
    "Tuning",
    "Twin",
    "TwinSettings",
    "Vehicle",
    "animate",
    "campaign",
    "check_layout",
    "compare",
    "default_vehicle",
    "design",
    "drift",
    "evaluate",
    "excite",
    "fetch",
    "find_faults",
    "fly_fleet",
    "identifiability",
    "identify",
    "load_trajectory",
    "prediction_bands",
    "preflight",
    "preprocess",
    "present",
    "read_model",
    "read_recording",
    "read_trajectory",
    "read_tuning",
    "read_twin_settings",
    "read_vehicle",
    "replay",
    "reproduce",
    "resid",
    "track",
    "tracking_study",
    "write_bag",
    "write_csv",
]


def __getattr__(name: str) -> Any:
    """Import a public name at its first use (PEP 562)."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'airpuck' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
