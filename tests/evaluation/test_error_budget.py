"""Known faults of the twin own the errors that they cause."""

from dataclasses import replace

import numpy as np
import pytest

from airpuck.control.excitation import Excitation
from airpuck.evaluation.error_budget import OWNERS, UNEXPLAINED, error_budget
from airpuck.evaluation.evaluate import evaluate
from airpuck.faults.find import find_faults
from airpuck.flight.loop import fly
from airpuck.model.model_file import nominal_model
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.plant import build_plant
from airpuck.twin.radio import as_received
from airpuck.twin.settings import Stall, Weakness, default_twin_settings
from airpuck.twin.twin import Twin

from ..apparatus.excited_flights import TRUTH
from ..apparatus.models import scaled
from ..apparatus.noisy_flights import noisy
from ..apparatus.once import once

DEFAULT, SEED, DURATION, PERIOD = default_twin_settings(), 3, 30.0, 0.01
#: A radio without jitter, so that a fault is the only cause.
STEADY = {"jitter_s": 0.0}


def world(**changed):
    """The packaged twin with other settings."""
    sections = {"radio": STEADY} | changed
    update = {name: getattr(DEFAULT, name).model_copy(update=v) for name, v in sections.items()}
    return DEFAULT.model_copy(update=update)


def flight(settings):
    """Fly the excitation; return the recording, and the model with the radio's mean delay."""
    model = as_received(TRUTH, settings, PERIOD)
    # As after a fit, commands are held for a fraction of a sample.
    model = replace(model, free=model.parameters.mask(frozenset({"transport_delay"})))
    twin = Twin(TRUTH, settings, seed=SEED, plant=build_plant(TRUTH, settings))
    pilot = Excitation(nominal_model(TRUTH.vehicle), seed=SEED, table=settings.table)
    fly(pilot, twin, DURATION, pilot.controller.tuning.period_s)
    recording = twin.recording()
    trajectory = preprocess(recording, delay=model.transport_delay)
    # The twin's clock begins earlier than the trajectory's.
    stamps = recording["command"].stamp_ns[0], recording["pose"].stamp_ns[0]
    sent = twin.truth[0][0] + 1e-9 * (stamps[0] - stamps[1])
    earlier = sent - trajectory.command_time[0]
    return trajectory, model, earlier


@once
def healthy():
    return flight(world())


def switches(every):
    """Arrival and motor of some commands that switch a motor on in the healthy flight."""
    trajectory, model, earlier = healthy()
    begun = np.diff((trajectory.command > 0.3).astype(int), axis=0, prepend=0) > 0
    last = 2.0
    for event, motor in np.argwhere(begun):
        arrival = trajectory.command_time[event] + model.transport_delay + earlier
        if last + every < arrival < DURATION - 1:
            yield arrival, trajectory.propellers[motor]
            last = arrival


def failed_starts():
    """Stalls of motors from just before they are switched on."""
    return tuple(
        Stall(motor=name, start_s=at - 0.03, stop_s=at + 0.25) for at, name in switches(4.0)
    )


def lost_packets():
    """Pauses of the radio that swallow a switch and the packets that repeat it."""
    return tuple((at - 0.005, at + 0.022) for at, _ in switches(1.5))


WEAK = Weakness(motor="motor_b_1", start_s=8.0, stop_s=16.0, share=0.6)
FAULTS = {
    "single motors": lambda: {"motors": {"weak": (WEAK,)}},
    "outages": lambda: {"radio": STEADY | {"outages_s": ((10.0, 10.7), (20.0, 20.6))}},
    "packets": lambda: {"radio": STEADY | {"outages_s": lost_packets()}},
    "common gain": lambda: {"effects": {"battery_sag_1_s": 0.008}},
    "failed starts": lambda: {"motors": {"stalls": failed_starts()}},
    "structure": lambda: {"effects": {"drag_linear_1_s": 0.4}},
}


def squares(errors):
    return np.mean(errors**2, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("owner", FAULTS)
def test_the_budget_assigns_a_known_fault_to_its_cause(owner):
    trajectory, model, _ = flight(world(**FAULTS[owner]()))
    budget = error_budget(model, trajectory, find_faults(trajectory, model))
    total = squares(budget.errors)
    # The same flight without the fault is independent of everything that the budget estimates.
    sound, its_model, _ = healthy()
    without = squares(evaluate(its_model, sound).every_start.errors)
    brings = (total - without) / total
    causes = brings > 0.5
    assert causes.any()  # drag does not turn the craft
    print(owner, brings, budget.shares)
    assert (budget.shares[owner] >= 0.95 * brings)[causes].all()


@pytest.mark.slow
def test_shares_sum_to_the_errors_of_evaluate():
    trajectory, wrong = noisy(TRUTH, 6.0), scaled(TRUTH, 0.9)
    for encoder in ("paper", "actuation"):
        budget = error_budget(wrong, trajectory, encoder=encoder)
        np.testing.assert_allclose(sum(budget.shares.values()), 1.0)
        every = evaluate(wrong, trajectory, encoder=encoder).every_start
        np.testing.assert_allclose(budget.errors, every.errors[:, ::2], atol=1e-12)
    assert set(budget.shares) == {*OWNERS, UNEXPLAINED} == set(budget.to_json()["owners"])


@pytest.mark.slow
def test_a_healthy_flight_has_no_faults():
    trajectory, model, _ = healthy()
    budget = error_budget(model, trajectory)
    assert budget.hindsight.faults == ()
    assert budget.hindsight.later == 0
    # By chance, a few windows seem to differ.
    assert np.mean(budget.hindsight.common != 0) < 0.03
    assert np.mean(budget.hindsight.single != 0) < 0.03
