"""Names for those who extend airpuck, beyond the names of `airpuck` itself.

Other distributions add commands, exports, laws, effects, actuators, items of campaigns and
opponents by entry points (docs/architecture.md); airpuck-hockey does so with these names alone.

Names by group, of which `help(airpuck.extend.Item)` explains one. Each is imported at its first
use.

Errors, numbers and files
    checked_class, numbers_of, about, nearest, unknown, numbers, check_output, UserCode
Settings, results and public names
    Setting, Settings, Result, public_names
Commands
    command, options, report_flight, console, report, say, show_time_left, table, warn, Without,
    Stopped, until_stopped, low_latency, prioritize
Items of campaigns
    completed, Item, Row, fingerprints, Entry, ItemResult, checked_workers, compute, dispatch,
    Workers, wilson_interval
Laws and references
    Preview, Reference, Target, asked, preview, sheltered, check_steerable, thrust
Shortest times
    MinimalTimes, minimal_times_of
Puck and discs
    Contact, Puck, Disc, coast, sigma_of, strike, time_of, walls_of, PuckOnTable, Touch,
    PUCK_NUMBERS, puck_paths
Twin and flight loop
    Craft, Plant, build_plant, HandMallet, World, SensorSet, log_stream, pose_sensor,
    default_twin_settings, check_seed, Action, control, Clock, Every, Histogram, TokenBucket,
    MeasurementKind, COLUMNS
Processes on a ROS 2 graph
    Spectator, fly_live, Inbox, Outbox, Process, half_of, LiveSettings
Pages in the browser
    address_of, packed_state, Pages, invite, served, table_of, PageKind
Pages of reports
    PageSection, Picture, write_page, PageTable
Exports and environments
    ExportKind, Subject, BLUE, DrawnDisc, PilotPolicy, RED, TwinEnv, check_render_mode, drawn_puck,
    picture, register, write_environments, ModelSource, Observation, Seen, TwinSource,
    action_space, checked_action, observation_space, read_world
"""

from airpuck.boundary.public import public_names

__getattr__, __dir__ = public_names(__name__, __file__)
