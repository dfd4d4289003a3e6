"""Objects of public classes reject impossible values by name, in one line."""

from dataclasses import replace

import numpy as np
import pytest

import airpuck
from airpuck.boundary.errors import InputError
from tests.apparatus import typechecker

NAN, INF = np.nan, np.inf
M3 = airpuck.read_model("paper:M3")
VALUES, VEHICLE = M3.parameters, M3.vehicle
HOME, STEPS = airpuck.SetPoint(-0.9, 0.0, 0.0), np.arange(4)
TIME = np.arange(50) / 200


def model(**changed):
    return replace(M3, parameters=replace(VALUES, **changed))


def plan(**changed):
    sound = {
        "time": np.array([0.0, 0.5]),
        "states": np.zeros((2, 12)),
        "commands": np.zeros((1, 6)),
        "lower_bound": None,
    }
    return airpuck.Plan(M3, **sound | changed)


def trajectory(**changed):
    sound = {
        "time": TIME,
        "state": np.zeros((50, 6)),
        "acceleration": np.zeros((50, 3)),
        "command_time": TIME,
        "command": np.zeros((50, 6)),
        "propellers": VEHICLE.propeller_names,
    }
    return airpuck.Trajectory(**sound | changed)


def one_command(value):
    """Commands of zero, but for a single one."""
    found = np.zeros((50, 6))
    found[7, 3] = value
    return found


def twin(**changed):
    return airpuck.Twin(M3, **changed)


def stream(values=None, stamps=STEPS, columns=("a",)):
    return airpuck.Stream(stamps, STEPS, np.zeros((4, 1)) if values is None else values, columns)


def controller(reference=HOME, **changed):
    return airpuck.TrackingController(M3, reference, compiled=False, **changed)


def puck(*state):
    return twin(puck=airpuck.PuckState(*state))


def placed(*state):
    puck(0.5, 0.0).play.puck.place(airpuck.PuckState(*state))


def aimed(*place):
    twin(puck=airpuck.PuckState(0.5, 0.0), mallet=(0.8, 0.0)).play.mallet.target = place


#: Where the problem must be said to be, and what causes it.
WRONG = {
    "models": [
        ("parameters.inertia", lambda: model(inertia=NAN)),
        ("parameters.inertia", lambda: model(inertia=-1.0)),
        ("parameters.thrust", lambda: model(thrust=INF * VALUES.thrust)),
        ("parameters.thrust", lambda: model(thrust=VALUES.thrust[:3])),
        ("parameters.motor_time_constant", lambda: model(motor_time_constant=-1.0)),
        ("parameters.transport_delay", lambda: M3.with_delay(NAN)),
        ("parameters.transport_delay", lambda: M3.with_delay(1e9)),
        ("frame", lambda: replace(M3, frame="wrld")),
        ("vehicle", lambda: replace(M3, vehicle=None)),
        ("state", lambda: M3.simulate(np.full(12, NAN), np.zeros((3, 6)))),
        ("state", lambda: M3.simulate("rest", np.zeros((3, 6)))),
        ("period", lambda: M3.simulate(np.zeros(12), np.zeros((3, 6)), NAN)),
        ("period", lambda: M3.simulate(np.zeros(12), np.zeros((3, 6)), [0.01, 0.01])),
        ("degree", lambda: airpuck.named_rung("M3", degree=10**9)),
        ("indexing", lambda: airpuck.PaperEncoder("middle")),
    ],
    "tables and settings": [
        ("mass_kg", lambda: airpuck.Vehicle(**VEHICLE.model_dump() | {"mass_kg": NAN})),
        ("mass_kg", lambda: airpuck.Vehicle(name="heavy")),
        ("mass_kg", lambda: VEHICLE.model_copy(update={"mass_kg": NAN})),
        ("puck.mass_kg", lambda: airpuck.AirHockey(puck={"mass_kg": -1})),
        ("pukc", lambda: airpuck.AirHockey(pukc={})),
        ("period_s", lambda: airpuck.Tuning(period_s=NAN)),
        ("radio", lambda: airpuck.TwinSettings(radio=5)),
    ],
    "plans": [
        ("time", lambda: plan(time=np.array([0.5, 0.0]))),
        ("time", lambda: plan(time=np.array([1.0, 2.0]))),
        ("time", lambda: plan(time=np.zeros(0))),
        ("states", lambda: plan(states=np.full((2, 12), NAN))),
        ("states", lambda: plan(states=np.zeros((3, 12)))),
        ("commands", lambda: plan(commands=np.full((1, 6), 5.0))),
        ("commands", lambda: plan(commands=np.zeros((2, 6)))),
        ("lower_bound", lambda: plan(lower_bound=NAN)),
        ("begin", lambda: plan().starting(NAN)),
        ("via", lambda: plan(via=((1.0, 2.0, 3.0),))),
        ("legs", lambda: plan().path(7)),
        ("velocity", lambda: airpuck.Goal(0.3, 0.1, velocity=(0.0, 0.0))),
        ("x", lambda: airpuck.Goal(NAN, 0.1)),
        ("turn", lambda: airpuck.Goal(0.3, 0.1, turn="longer")),
    ],
    "references": [
        ("setpoint", lambda: airpuck.SetPoint(1e300, 0.0, 0.0)),
        ("path", lambda: airpuck.TimedPath([0.0, 1.0], [(0, 0, 0), (1e300, 0, 0)])),
        ("path", lambda: airpuck.TimedPath("ab", [(0, 0, 0)] * 2)),
        ("state", lambda: airpuck.Rendezvous(0.0, "abcdef")),
        ("time", lambda: airpuck.Rendezvous(1e300, np.zeros(6))),
        ("then", lambda: airpuck.Rendezvous(0.0, np.zeros(6), then=5)),
        ("setpoint", lambda: controller(airpuck.SetPoint(5, 0, 0), table=M3_TABLE)),
        ("reference", lambda: controller((0, 0, 0))),
        ("gain", lambda: controller(gain=np.full((3, 6), INF))),
        ("gain", lambda: controller(gain=np.zeros((2, 6)))),
        ("time", lambda: controller().predict(0.0)),
    ],
    "the twin": [
        ("puck", lambda: puck(NAN, 0.0)),
        ("puck", lambda: puck(3.0, 0.0)),
        ("puck", lambda: puck(1e300, 0.0)),
        ("puck", lambda: puck(0.5, 0.0, 0.0, 1e300)),
        ("puck", lambda: placed(0.0, NAN)),
        ("mallet", lambda: twin(puck=airpuck.PuckState(0.5, 0.0), mallet=(5.0, 0.0))),
        ("target", lambda: aimed(NAN, 0.0)),
        ("pose", lambda: twin(pose=("a", 0.0, 0.0))),
        ("settings", lambda: twin(settings=5)),
        ("time", lambda: twin().wait_until(NAN)),
        ("command", lambda: twin().send("abcdef")),
        ("reference", lambda: twin().announce(np.zeros(2))),
    ],
    "recordings": [
        ("kind", lambda: airpuck.Measurement("poze", 0.0, np.zeros(3))),
        ("values", lambda: airpuck.Measurement("pose", 0.0, np.zeros(2))),
        ("stop", lambda: airpuck.Span(2.0, 1.0, "gap")),
        ("confidence", lambda: airpuck.Span(1.0, 2.0, "gap", 5.0)),
        ("excluded", lambda: trajectory(excluded=(5,))),
        ("time", lambda: trajectory(time=np.insert(TIME[:-1], 9, TIME[9]))),
        ("time", lambda: trajectory(time=np.zeros(50))),
        ("command", lambda: trajectory(command=one_command(1.2))),
        ("command", lambda: trajectory(command=one_command(-0.2))),
        ("propellers", lambda: trajectory(propellers="abcdef")),
        ("command_time", lambda: trajectory(command_time=[], command=np.zeros((0, 6)))),
        ("spans", lambda: trajectory().leave_out([5])),
        ("stride", lambda: trajectory().window_starts(5, 0)),
        ("duration", lambda: trajectory().steps(NAN)),
        ("values", lambda: stream(np.zeros((4, 3, 3)))),
        ("values", lambda: stream(np.full((4, 1), "a"))),
        ("stamp_ns", lambda: stream(stamps=NAN * STEPS)),
        ("columns", lambda: stream(np.zeros((4, 2)), columns=("a", "a"))),
        ("pose", lambda: airpuck.Recording({"pose": 5}, "arrays")),
        ("pose", lambda: airpuck.Recording({"pose": stream()}, "arrays")),
        ("mapping", lambda: airpuck.Recording.from_arrays(TIME, [], TIME, [], mapping=5)),
    ],
}
M3_TABLE = airpuck.AirHockey().table


@pytest.fixture(autouse=True)
def unchecked():
    """Imports everything, and leaves the checks to airpuck."""
    assert all(hasattr(airpuck, name) for name in dir(airpuck))
    typechecker.pause()


@pytest.mark.parametrize("kind", WRONG)
def test_impossible_values_are_named(kind):
    for number, (field, made) in enumerate(WRONG[kind]):
        with pytest.raises(InputError) as error:
            made()
        assert error.value.field == field, (number, error.value)


def test_a_measurement_may_hold_nan():
    steered = controller()
    steered.measured(airpuck.Measurement("pose", 0.0, np.full(3, NAN)))
    assert steered.step(0.0).status == "bad input"


def test_lists_and_arrays_remain_accepted():
    assert plan(time=[0, 0.5], states=np.zeros((2, 12)).tolist(), commands=[[0] * 6]).duration
    assert M3.simulate([0.0] * 12, [[0.5] * 6] * 2, [0.01, 0.02]).shape == (2, 12)
    assert airpuck.Goal(0, 1, velocity=np.zeros(3)).state[3:].tolist() == [0, 0, 0]
    assert len(stream(values=[[1.0]] * 4)) == 4
