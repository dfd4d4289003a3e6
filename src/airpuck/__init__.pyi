# The public names and their modules, by group; `airpuck` imports each of them at its first use.
# isort: off

# Recordings.
from airpuck.recording.read import read_recording as read_recording
from airpuck.recording.stream import Recording as Recording, Stream as Stream
from airpuck.data.measurement import Measurement as Measurement
from airpuck.recording.mapping import (
    read_mapping as read_mapping,
    RecordingMapping as RecordingMapping,
    PoseMapping as PoseMapping,
    CommandMapping as CommandMapping,
)
from airpuck.recording.bag import write_bag as write_bag
from airpuck.recording.csv_folder import write_csv as write_csv
from airpuck.recording.dataset import fetch as fetch

# Trajectories.
from airpuck.preprocessing.pipeline import (
    load_trajectory as load_trajectory,
    preprocess as preprocess,
)
from airpuck.data.trajectory_file import read_trajectory as read_trajectory
from airpuck.data.trajectory import Trajectory as Trajectory, Span as Span

# From recordings to a model.
from airpuck.judgement.study import study as study, Study as Study
from airpuck.judgement.verdict import Verdict as Verdict
from airpuck.identification.structure import identify as identify
from airpuck.identification.fit_result import Fit as Fit
from airpuck.identification.settings import Loss as Loss, Preparation as Preparation
from airpuck.identification.method import LevenbergMarquardt as LevenbergMarquardt
from airpuck.identification.bootstrap import bootstrap as bootstrap
from airpuck.identification.fit import identifiability as identifiability
from airpuck.experiment_design.design import design as design
from airpuck.report.reproduce import reproduce as reproduce

# Craft and model.
from airpuck.model.model_file import (
    read_model as read_model,
    Model as Model,
    nominal_model as nominal_model,
)
from airpuck.model.parameters import Parameters as Parameters
from airpuck.model.rungs import named_rung as named_rung
from airpuck.physics.effects import Effect as Effect
from airpuck.craft.vehicle import (
    read_vehicle as read_vehicle,
    default_vehicle as default_vehicle,
    Vehicle as Vehicle,
)
from airpuck.craft.actuators import ActuatorKind as ActuatorKind
from airpuck.craft.table import Table as Table, AirHockey as AirHockey, read_table as read_table

# Validation.
from airpuck.evaluation.evaluate import (
    evaluate as evaluate,
    Protocol as Protocol,
    compare as compare,
    Evaluation as Evaluation,
)
from airpuck.evaluation.comparison import coasting as coasting
from airpuck.evaluation.error_budget import error_budget as error_budget, ErrorBudget as ErrorBudget
from airpuck.evaluation.prediction_bands import (
    prediction_bands as prediction_bands,
    PredictionBands as PredictionBands,
)
from airpuck.evaluation.residuals import resid as resid, ResidualTests as ResidualTests
from airpuck.evaluation.presentation import present as present, Presentation as Presentation
from airpuck.evaluation.drift import drift as drift, Drift as Drift
from airpuck.estimate.encoder import PaperEncoder as PaperEncoder, StateEncoder as StateEncoder

# Faults.
from airpuck.faults.find import find_faults as find_faults
from airpuck.faults.strengths import find_strengths as find_strengths
from airpuck.faults.layout_check import check_layout as check_layout
from airpuck.flight.preflight import preflight as preflight

# Controllers.
from airpuck.control.tracking import TrackingController as TrackingController
from airpuck.control.reference import (
    SetPoint as SetPoint,
    SetPoints as SetPoints,
    TimedPath as TimedPath,
    Rendezvous as Rendezvous,
)
from airpuck.control.tuning import (
    LawSettings as LawSettings,
    Tuning as Tuning,
    default_tuning as default_tuning,
    read_tuning as read_tuning,
)
from airpuck.control.lqr import LQR as LQR
from airpuck.control.mpc import MPC as MPC
from airpuck.control.law import Law as Law, Step as Step
from airpuck.control.limits import Fence as Fence, HalfPlane as HalfPlane, KeepOut as KeepOut
from airpuck.control.law import Pilot as Pilot
from airpuck.physics.thrust import InverseThrust as InverseThrust
from airpuck.physics.rigid_body import acceleration_map as acceleration_map
from airpuck.live.safety import SafetyLimits as SafetyLimits

# Flights on the twin.
from airpuck.twin.tune import tune as tune
from airpuck.twin.experiments import track as track, excite as excite, race as race
from airpuck.flight.loop import fly as fly, FlightLog as FlightLog
from airpuck.flight.replay import replay as replay, Replay as Replay
from airpuck.twin.tracking_study import (
    tracking_study as tracking_study,
    compare_controllers as compare_controllers,
    ControllerComparison as ControllerComparison,
)
from airpuck.twin.twin import Twin as Twin
from airpuck.twin.batch import TwinBatch as TwinBatch
from airpuck.twin.settings import (
    TwinSettings as TwinSettings,
    read_twin_settings as read_twin_settings,
)
from airpuck.physics.puck import PuckState as PuckState

# Time-optimal plans.
from airpuck.planning.plan import plan as plan, Plan as Plan, read_plan as read_plan
from airpuck.planning.request import Goal as Goal
from airpuck.planning.settings import Limits as Limits

# From the box to a trusted flight.
from airpuck.commissioning.commission import (
    commission as commission,
    Commissioning as Commissioning,
)

# Several craft.
from airpuck.fleet.flight import fly_together as fly_together, FleetFlight as FleetFlight
from airpuck.fleet.scenario import read_fleet as read_fleet, Fleet as Fleet, Scenario as Scenario

# Many flights and fits.
from airpuck.campaigns.campaign import campaign as campaign

# Pages, pictures and exports.
from . import export as export
from airpuck.report import plot as plot
from airpuck.report.animation import animate as animate

# Errors.
from airpuck.boundary.errors import InputError as InputError

__version__: str
