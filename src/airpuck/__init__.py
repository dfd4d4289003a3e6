"""Identify, simulate and control propeller-driven hovercraft on an air-hockey table.

Data flow::

    recording --preprocess--> trajectory --identify--> model --> evaluate, control, twin

Quantities are in SI units and angles in radians, unless their name ends with another unit.

Names by group, of which `help(airpuck.study)` explains one. Each is imported at its first use, so
that ``import airpuck`` is fast.

Recordings
    read_recording, Recording, Stream, Measurement, read_mapping, RecordingMapping,
    PoseMapping, CommandMapping, write_bag, write_csv, fetch
Trajectories
    load_trajectory, preprocess, read_trajectory, Trajectory, Span
From recordings to a model
    study, Study, Verdict, identify, Fit, Loss, Preparation, LevenbergMarquardt,
    bootstrap, identifiability, design, reproduce
Craft and model
    read_model, Model, Parameters, nominal_model, named_rung, Effect, read_vehicle,
    default_vehicle, Vehicle, ActuatorKind, Table, AirHockey, read_table
Validation
    evaluate, compare, Evaluation, Protocol, coasting, error_budget, ErrorBudget, prediction_bands,
    PredictionBands, resid, ResidualTests, present, Presentation, drift, Drift,
    PaperEncoder, StateEncoder
Faults
    find_faults, find_strengths, check_layout, preflight
Controllers
    TrackingController, SetPoint, SetPoints, TimedPath, Rendezvous, Tuning,
    default_tuning, read_tuning, LawSettings, LQR, MPC, Law, Step, Fence, KeepOut, HalfPlane,
    Pilot, InverseThrust, acceleration_map, SafetyLimits
Flights on the twin
    track, FlightLog, excite, fly, race, replay, Replay, tracking_study, compare_controllers,
    ControllerComparison, tune, Twin, TwinBatch, TwinSettings, read_twin_settings, PuckState
Time-optimal plans
    plan, Plan, read_plan, Goal, Limits
From the box to a trusted flight
    commission, Commissioning
Several craft
    fly_together, FleetFlight, read_fleet, Fleet, Scenario
Many flights and fits
    campaign
Pages, pictures and exports
    plot, animate, export
Errors
    InputError
"""

from __future__ import annotations

from airpuck.boundary.public import public_names

_public, __dir__ = public_names(__name__, __file__, checked=True)


def __getattr__(name: str) -> object:
    """Import a public name at its first use (PEP 562)."""
    if name == "__version__":
        return _version()
    if name == "export":
        from importlib import import_module

        return import_module("airpuck.export")
    try:
        return _public(name)
    except AttributeError:
        if name.startswith("__"):
            raise
        from airpuck.boundary.extensions import moved

        return moved(name, __dir__())


def _version() -> str:
    """Return the installed version, which comes from the tag."""
    from importlib import metadata  # takes as long to import as the rest of this module

    try:
        return metadata.version("airpuck")
    except metadata.PackageNotFoundError:
        return "0+unknown"
