# The public names and their modules; `airpuck` imports each of them at its first use.
# isort: off
from . import export as export
from airpuck.boundary.errors import InputError as InputError
from airpuck.campaigns.campaign import campaign as campaign
from airpuck.control.reference import (
    Rendezvous as Rendezvous,
    SetPoint as SetPoint,
    SetPoints as SetPoints,
    TimedPath as TimedPath,
)
from airpuck.control.law import Law as Law, Step as Step
from airpuck.control.tracking import TrackingController as TrackingController
from airpuck.control.tuning import Tuning as Tuning, read_tuning as read_tuning
from airpuck.craft.actuators import ActuatorKind as ActuatorKind
from airpuck.craft.table import AirHockey as AirHockey, read_table as read_table
from airpuck.craft.vehicle import (
    Vehicle as Vehicle,
    default_vehicle as default_vehicle,
    read_vehicle as read_vehicle,
)
from airpuck.data.measurement import Measurement as Measurement
from airpuck.data.trajectory import (
    Span as Span,
    Trajectory as Trajectory,
)
from airpuck.data.trajectory_file import read_trajectory as read_trajectory
from airpuck.estimate.encoder import PaperEncoder as PaperEncoder
from airpuck.evaluation.drift import Drift as Drift, drift as drift
from airpuck.evaluation.error_budget import (
    ErrorBudget as ErrorBudget,
    error_budget as error_budget,
)
from airpuck.evaluation.evaluate import (
    Evaluation as Evaluation,
    compare as compare,
    evaluate as evaluate,
)
from airpuck.evaluation.prediction_bands import (
    PredictionBands as PredictionBands,
    prediction_bands as prediction_bands,
)
from airpuck.evaluation.presentation import Presentation as Presentation, present as present
from airpuck.evaluation.residuals import ResidualTests as ResidualTests, resid as resid
from airpuck.experiment_design.design import design as design
from airpuck.faults.find import find_faults as find_faults
from airpuck.faults.layout_check import check_layout as check_layout
from airpuck.fleet.flight import FleetFlight as FleetFlight
from airpuck.fleet.flight import fly_together as fly_together
from airpuck.fleet.scenario import Fleet as Fleet
from airpuck.fleet.scenario import Scenario as Scenario
from airpuck.fleet.scenario import read_fleet as read_fleet
from airpuck.flight.loop import fly as fly
from airpuck.control.pilot import Pilot as Pilot
from airpuck.flight.preflight import preflight as preflight
from airpuck.flight.replay import Replay as Replay, replay as replay
from airpuck.identification.bootstrap import bootstrap as bootstrap
from airpuck.identification.fit import identifiability as identifiability
from airpuck.identification.structure import identify as identify
from airpuck.judgement.study import Study as Study, study as study
from airpuck.identification.fit_result import Fit as Fit
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from airpuck.identification.settings import Loss as Loss, Preparation as Preparation
from airpuck.model.model_file import Model as Model, read_model as read_model
from airpuck.model.parameters import Parameters as Parameters
from airpuck.model.rungs import named_rung as named_rung
from airpuck.physics.effects import Effect as Effect
from airpuck.planning.plan import Plan as Plan, plan as plan, read_plan as read_plan
from airpuck.planning.request import Goal as Goal
from airpuck.planning.settings import Limits as Limits
from airpuck.physics.puck import PuckState as PuckState
from airpuck.preprocessing.pipeline import (
    load_trajectory as load_trajectory,
    preprocess as preprocess,
)
from airpuck.recording.bag_writer import write_bag as write_bag
from airpuck.recording.csv_folder import write_csv as write_csv
from airpuck.recording.dataset import fetch as fetch
from airpuck.recording.mapping import (
    CommandMapping as CommandMapping,
    PoseMapping as PoseMapping,
    RecordingMapping as RecordingMapping,
    read_mapping as read_mapping,
)
from airpuck.recording.read import read_recording as read_recording
from airpuck.recording.stream import Recording as Recording, Stream as Stream
from airpuck.report import plot as plot
from airpuck.report.animation import animate as animate
from airpuck.report.reproduce import reproduce as reproduce
from airpuck.twin.experiments import excite as excite, track as track
from airpuck.twin.batch import TwinBatch as TwinBatch
from airpuck.twin.settings import (
    TwinSettings as TwinSettings,
    read_twin_settings as read_twin_settings,
)
from airpuck.twin.tracking_study import tracking_study as tracking_study
from airpuck.twin.twin import Twin as Twin

__version__: str
