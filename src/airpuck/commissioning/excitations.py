"""Short excitations, each designed for what is still least known, and a study after each."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Finding
from airpuck.commissioning.session import Commissioned, Ended
from airpuck.commissioning.steps import careful, hovering
from airpuck.control.excitation import Excitation
from airpuck.control.settings import ExcitationPlan
from airpuck.craft.vehicle import Vehicle
from airpuck.deviation.motor_regression import shortest_judged
from airpuck.deviation.time_scale import response_time
from airpuck.judgement.findings import ACCELERATION_LIMIT, RESPONSE_LIMIT
from airpuck.judgement.study import Study, study
from airpuck.judgement.verdict import Verdict
from airpuck.model.model_file import nominal_model
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import excite
from airpuck.twin.settings import MotionCapture, TwinSettings

#: Longest time for a study while the craft holds its place [s].
_LONGEST_STUDY = 300.0
#: Longest time to listen for poses [s], and number of poses from which their rate is known: on a
#: slope the craft drifts meanwhile.
_LISTENED, _COUNTED = 0.3, 8
#: Longest excitation [s], and the factor by which they grow while they tell too little.
_LONGEST, _LONGER = 20.0, 1.5
#: Hold times of the signals: for effects, and for timing [s].
_SLOW, _FAST = 0.3, 0.12


@dataclass(frozen=True)
class WarmUp:
    """Compiles what a study needs, with flights of the stated craft, before any motor runs."""

    def run(self, session: Commissioned) -> None:
        """Study simulated flights; see `CommissioningStep`."""
        heard, work = session.listen(_LISTENED, _COUNTED), session.work
        if len(heard) < 3:
            return  # The next step tells what is wrong with the poses.
        session.tell("compiling the programs of the first study")
        lasted = heard[-1] - heard[0]
        rate = round(lasted / float(np.median(np.diff(heard)))) / lasted
        work.start(session.link.now, prepare, session.vehicle, rate)
        while not work.done(math.inf):
            session.listen(_LISTENED)


def prepare(vehicle: Vehicle, rate: float) -> None:
    """Study two simulated flights with cameras of this rate [Hz]."""
    settings = TwinSettings(motion_capture=MotionCapture(rate_hz=rate)).without_on_board()
    # A wrong file may describe a craft that no controller can steer; pulses correct it.
    with suppress(InputError):
        flight = excite(nominal_model(vehicle), Excitations.duration_s, settings=settings)
        study(flight, vehicle, None, flight)


@dataclass(frozen=True)
class Excitations:
    """Repeat excitations until a trusted model predicts a flight that it has not seen.

    Attributes
    ----------
    duration_s : float
        Length of each; longer for a craft that needs more to be judged.
    most : int
        Largest number of them.
    """

    duration_s: float = 7.0
    most: int = 6

    def run(self, session: Commissioned) -> None:
        """Fly and study until the verdict is trusted; see `CommissioningStep`."""
        flown, longer = list[Recording](), 1.0
        for number in range(self.most):
            noise = session.cameras.position_noise_m if session.cameras else 0.0
            needed = longer * max(self.duration_s, shortest_judged(session.vehicle, noise))
            plan = next_plan(session, min(needed, _LONGEST), number)
            pilot = excitation(session, plan, number)
            flown.append(session.fly("excitation", pilot, plan.duration_s))
            if number == 0:
                # The next flight judges a model of this one: there is nothing to decide before.
                continue
            session.study = self._studied(session, flown)
            said = session.study.verdict
            session.note("study", summary(said), session.study.model)
            if said.trusted:
                return
            longer *= _LONGER if said.outcome == "not_enough_excitation" else 1.0
        assert session.study is not None
        raise Ended(first_cause(session.study))

    def _studied(self, session: Commissioned, flown: list[Recording]) -> Study:
        """Study the flights while the craft holds its place; the last one is held out."""
        work, given = session.work, (flown[:-1], session.vehicle, None, flown[-1])
        work.start(session.link.now, study, *given)
        if not work.done(session.link.now):
            session.fly("holding", hovering(session), _LONGEST_STUDY, until=work.done)
        if not work.done(session.link.now):
            cause = f"A study took longer than {_LONGEST_STUDY:g} s"
            remedy = "End other programs, and start again."
            raise Ended(Finding("control", cause, "", remedy))
        return work.result()


def next_plan(session: Commissioned, duration: float, number: int) -> ExcitationPlan:
    """Return the excitation that teaches most of what is least known."""
    said = None if session.study is None else session.study.verdict
    hold = _FAST if number % 2 else _SLOW
    if said and said.response_error is not None and said.acceleration_errors is not None:
        late = said.response_error / RESPONSE_LIMIT
        hold = _FAST if late > np.max(said.acceleration_errors) / ACCELERATION_LIMIT else _SLOW
    return ExcitationPlan(1.0, hold, duration)


def excitation(session: Commissioned, plan: ExcitationPlan, number: int) -> Excitation:
    """Return the pilot of an excitation, which brakes in time for what is not known yet."""
    model = session.model
    reaction = float(np.max(response_time(model)))
    # The worst within the interval, of the pulses or of the study.
    error = None if session.study is None else session.study.verdict.response_error
    reaction = max(reaction, session.late) if error is None else reaction + min(2 * error, reaction)
    given: dict[str, Any] = {"tuning": careful(model), "amplitude": plan.amplitude}
    given |= {"hold": plan.hold_s, "margin": plan.margin_m, "seed": session.seed + number}
    given |= {"pull": session.slope}
    try:
        given |= {"table": session.table, "reaction": reaction, "compiled": False}
        pilot = Excitation(model, session.here, **given)
    except InputError as error:
        remedy = "Check the layout in the vehicle file."
        raise Ended(Finding("control", error.problem, "", remedy)) from error
    session.brief(pilot)
    return pilot


def summary(said: Verdict) -> str:
    """Describe a verdict in a line."""
    outcome = said.outcome.replace("_", " ")
    if said.acceleration_errors is None or said.response_error is None:
        return outcome
    worst, late = 100 * float(np.max(said.acceleration_errors)), 1e3 * said.response_error
    return f"{outcome}; accelerations ± {worst:.2g} %, response ± {late:.2g} ms"


def first_cause(found: Study) -> Finding:
    """Return the first cause why a model is not trusted; a learned weak motor is none."""
    if said := found.findings:
        return next((one for one in said if one.kind != "actuator"), said[0])
    cause = found.verdict.sentences[0].removesuffix(".")
    return Finding("excitation", cause, "", "Fly longer: `airpuck fly-excitation`.")
