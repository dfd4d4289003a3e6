"""The predictive law with craft other than the paper's, and with a dead motor."""

from dataclasses import replace

import numpy as np
import pytest
from studies.false_alarms import craft

from airpuck import LQR, InputError, Model, SetPoint, Step, TrackingController, Tuning
from airpuck.control.excitation import Excitation
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import published_model
from airpuck.physics.rigid_body import Dynamics, derivative

pytestmark = pytest.mark.slow

M4 = published_model("M4")
MPC = default_tuning().with_law("mpc")
GOAL = SetPoint(0.4, -0.2, 1.0)


def flown(
    model: Model, duration: float, tuning: Tuning = MPC, truth: Dynamics | None = None
) -> tuple[np.ndarray, list[Step]]:
    """Fly to the goal by Runge and Kutta's method: distances in x, y, yaw, and steps."""
    ours = TrackingController(model, GOAL, tuning, compiled=False)
    h, real = 1 / 200, truth or model.dynamics
    acting = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
    z = np.concatenate([np.zeros(6), acting])
    waiting, steps, poses = [], [], []
    for k in range(round(duration / h)):
        ours.pose(k * h, z[:3].copy())
        if k % 2 == 0:
            steps.append(ours.step(k * h))
            ours.sent(k * h, steps[-1].command)
            waiting.append((k * h + model.transport_delay, steps[-1].command))
        while waiting and waiting[0][0] <= k * h + 1e-9:
            acting = waiting.pop(0)[1]
        k1 = derivative(np, real, z, acting)
        k2 = derivative(np, real, z + h / 2 * k1, acting)
        k3 = derivative(np, real, z + h / 2 * k2, acting)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + derivative(np, real, z + h * k3, acting))
        poses.append(z[:3])
    return np.array(poses) - [GOAL.x, GOAL.y, GOAL.yaw], steps


@pytest.mark.parametrize(("propellers", "duration"), [(4, 1.5), (8, 1.2)])
def test_a_craft_with_other_propellers_reaches_its_set_point(propellers, duration):
    away, steps = flown(craft(propellers), duration)
    assert {step.status for step in steps} == {"optimal"}
    assert all(step.command.shape == (propellers,) for step in steps)
    assert np.abs(away[-1]).max() < 2e-3
    # Half way there, it is where the plan of 0.2 s before expected it.
    plan, delay = steps[20].prediction, craft(propellers).transport_delay
    expected = plan.states[9, :3] - [GOAL.x, GOAL.y, GOAL.yaw]
    assert plan.times[9] == pytest.approx(0.2)
    flown_then = away[round((0.2 + delay + 0.2) * 200) - 1]
    assert (np.abs(flown_then - expected) < [0.02, 0.02, 0.1]).all()


def test_the_prediction_uses_the_estimated_share_of_a_dead_motor():
    motor, thrust = 2, M4.dynamics.thrust.copy()
    thrust[motor] = 0.0
    truth = replace(M4.dynamics, thrust=thrust)
    ends, steps = {}, {}
    for estimator in ("kalman", "actuation"):
        away, steps[estimator] = flown(M4, 1.5, MPC.with_estimator(estimator), truth)
        ends[estimator] = np.sqrt(np.mean(away[-100:, :2] ** 2))
    seen = steps["actuation"][-1].estimate.effectiveness
    assert seen[motor] < 0.1 and np.delete(seen, motor).min() > 0.8
    assert ends["actuation"] < 0.2 * ends["kalman"]


def test_excitation_uses_lqr_whatever_law_the_tuning_names():
    pilot = Excitation(M4, tuning=MPC)
    assert isinstance(pilot.controller.law, LQR)
    assert pilot.controller.tuning == default_tuning()


def test_too_many_commands_for_one_period_are_rejected():
    tuning = MPC.with_law("mpc", block=(1,))
    with pytest.raises(InputError, match="240 commands; at most 200") as error:
        TrackingController(craft(8), GOAL, tuning, compiled=False)
    assert error.value.field == "law.mpc.block"
