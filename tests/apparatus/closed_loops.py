"""The published M4 under a controller: flights for the tests of tracking."""

import numpy as np

from airpuck import SetPoint, Step, TrackingController
from airpuck.control.reference import Reference
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import read_model
from airpuck.physics.rigid_body import derivative

MODEL = read_model("paper:M4")
LEAST = MODEL.vehicle.command_min
IDLE = np.full(6, LEAST)
HOME = SetPoint(0.0, 0.0, 0.0)
FRAME = 1 / 240
NOTHING = np.zeros(3)
LONG = 0.15  # transport delay of a slow radio [s]


def controller(reference: Reference = HOME, **options) -> TrackingController:
    return TrackingController(MODEL, reference, **{"compiled": False, **options})


def fly(
    ours: TrackingController,
    duration: float,
    push: np.ndarray = NOTHING,
    delay: float = MODEL.transport_delay,
    start: np.ndarray = NOTHING,
) -> tuple[np.ndarray, np.ndarray, list[Step]]:
    """Fly the published M4 under an extra acceleration: times, poses and steps at 100 Hz.

    Runge and Kutta's method, with a pose 200 times a second.
    """
    h, dynamics = 1 / 200, MODEL.dynamics

    def rate(z: np.ndarray, command: np.ndarray) -> np.ndarray:
        slope = derivative(np, dynamics, z, command)
        slope[3:6] += push
        return slope

    z = np.concatenate([start, np.zeros(3), IDLE])
    sent: list[tuple[float, np.ndarray]] = []
    steps, times, poses, acting = [], [], [], IDLE
    for k in range(round(duration / h)):
        now = k * h
        ours.pose(now, z[:3].copy())
        if k % 2 == 0:
            step = ours.step(now)
            ours.sent(now, step.command)
            sent.append((now + delay, step.command))
            steps.append(step)
            times.append(now)
            poses.append(z[:3])
        # Parts of the step with one command each.
        begin = now
        while begin < now + h - 1e-12:
            if sent and sent[0][0] <= begin + 1e-12:
                acting = sent.pop(0)[1]
                continue
            end = min(now + h, sent[0][0]) if sent else now + h
            d = end - begin
            k1 = rate(z, acting)
            k2 = rate(z + d / 2 * k1, acting)
            k3 = rate(z + d / 2 * k2, acting)
            z = z + d / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + d * k3, acting))
            begin = end
    return np.array(times), np.array(poses), steps


def steer_to(ours: TrackingController, craft: Estimate, reference: Reference) -> Step:
    """Compute one control step of a craft towards a reference."""
    ours.reference = reference
    return ours.steer(craft, 0.0)


def hold_still(ours: TrackingController, frames: int = 12, x: float = 0.0) -> float:
    """Feed good poses; return the time of the last."""
    for k in range(frames):
        ours.pose(k * FRAME, np.array([x, 0, 0]))
    return (frames - 1) * FRAME


def idles(step: Step, status: str) -> None:
    assert step.status == status
    assert not step.flies
    np.testing.assert_array_equal(step.command, IDLE)
