# Names for those who extend airpuck, by group; each is imported at its first use.
# isort: off

# Errors, numbers and files: what a user may give, and what is wrong with it.
from airpuck.boundary.arguments import checked_class as checked_class, numbers_of as numbers_of
from airpuck.boundary.errors import about as about, nearest as nearest, unknown as unknown
from airpuck.boundary import numbers as numbers
from airpuck.boundary.outputs import check_output as check_output
from airpuck.boundary.extensions import UserCode as UserCode

# Settings, results and public names: declared once, in a class or a stub file.
from airpuck.boundary.settings import Setting as Setting, Settings as Settings
from airpuck.boundary.results import Result as Result
from airpuck.boundary.public import public_names as public_names

# Commands: options, tables for the terminal, progress, signals, priority.
from airpuck.cli.app import command as command
from airpuck.cli import options as options
from airpuck.cli.live import report_flight as report_flight
from airpuck.cli.output import (
    console as console,
    report as report,
    say as say,
    show_time_left as show_time_left,
    table as table,
    warn as warn,
)
from airpuck.cli.views import Without as Without
from airpuck.boundary.signals import Stopped as Stopped, until_stopped as until_stopped
from airpuck.compute.process import (
    low_latency as low_latency,
    prioritize as prioritize,
)

# Items of campaigns: many flights or games, computed in processes.
from airpuck.campaigns.campaign import completed as completed
from airpuck.campaigns.items import Item as Item, Row as Row
from airpuck.campaigns import fingerprints as fingerprints
from airpuck.campaigns.workers import (
    Entry as Entry,
    ItemResult as ItemResult,
    checked_workers as checked_workers,
    compute as compute,
    dispatch as dispatch,
)
from airpuck.control.settings import Workers as Workers
from airpuck.evaluation.statistical_tests import wilson_interval as wilson_interval

# Laws and references: where a craft should be, and which force a motor gives.
from airpuck.control.reference import (
    Preview as Preview,
    Reference as Reference,
    Target as Target,
    asked as asked,
    preview as preview,
    sheltered as sheltered,
)
from airpuck.control.tracking import check_steerable as check_steerable
from airpuck.physics.thrust import thrust as thrust

# Shortest times: a table for each craft, planned once.
from airpuck.planning.minimal_time import (
    MinimalTimes as MinimalTimes,
    minimal_times_of as minimal_times_of,
)

# Puck and discs: contacts, friction, and positions to come.
from airpuck.craft.table import Contact as Contact, Puck as Puck
from airpuck.physics.puck import (
    Disc as Disc,
    coast as coast,
    sigma_of as sigma_of,
    strike as strike,
    time_of as time_of,
    walls_of as walls_of,
)
from airpuck.physics.puck_on_table import PuckOnTable as PuckOnTable, Touch as Touch
from airpuck.physics.puck_on_table import PUCK_NUMBERS as PUCK_NUMBERS, puck_paths as puck_paths

# Twin and flight loop: world, sensors, radio, clocks.
from airpuck.twin.craft import Craft as Craft
from airpuck.twin.plant import Plant as Plant, build_plant as build_plant
from airpuck.twin.play import HandMallet as HandMallet, World as World
from airpuck.twin.sensors import (
    SensorSet as SensorSet,
    log_stream as log_stream,
    pose_sensor as pose_sensor,
)
from airpuck.twin.settings import default_twin_settings as default_twin_settings
from airpuck.twin.twin import check_seed as check_seed
from airpuck.flight.loop import Action as Action, control as control
from airpuck.flight.clock import (
    Clock as Clock,
    Every as Every,
    Histogram as Histogram,
    TokenBucket as TokenBucket,
)
from airpuck.data.measurement import MeasurementKind as MeasurementKind
from airpuck.recording.stream import COLUMNS as COLUMNS

# Processes on a ROS 2 graph: messages, live flights, safety.
from airpuck.live.fly import Spectator as Spectator, fly_live as fly_live
from airpuck.live.process import Inbox as Inbox, Outbox as Outbox, Process as Process
from airpuck.live.safety import half_of as half_of
from airpuck.live.settings import LiveSettings as LiveSettings

# Pages in the browser: their server, and what it sends.
from airpuck.web.requests import (
    address_of as address_of,
    packed_state as packed_state,
)
from airpuck.web.page import (
    Pages as Pages,
    invite as invite,
    served as served,
    table_of as table_of,
)
from airpuck.web.server import PageKind as PageKind

# Pages of reports: sections, tables, pictures.
from airpuck.report.page import (
    PageSection as PageSection,
    Picture as Picture,
    write_page as write_page,
)
from airpuck.report.tables import PageTable as PageTable

# Exports and environments: files for other tools, reinforcement learning.
from airpuck.export.kinds import ExportKind as ExportKind, Subject as Subject
from airpuck.export.gym import (
    BLUE as BLUE,
    DrawnDisc as DrawnDisc,
    PilotPolicy as PilotPolicy,
    RED as RED,
    TwinEnv as TwinEnv,
    check_render_mode as check_render_mode,
    drawn_puck as drawn_puck,
    picture as picture,
    register as register,
    write_environments as write_environments,
)
from airpuck.export.gym_task import (
    ModelSource as ModelSource,
    Observation as Observation,
    Seen as Seen,
    TwinSource as TwinSource,
    action_space as action_space,
    checked_action as checked_action,
    observation_space as observation_space,
    read_world as read_world,
)
