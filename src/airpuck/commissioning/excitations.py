"""Short excitations, each designed for what is still least known, and a study after each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Finding
from airpuck.commissioning.session import Commissioned, Ended
from airpuck.commissioning.steps import careful, hovering
from airpuck.control.excitation import Excitation
from airpuck.control.settings import ExcitationPlan
from airpuck.judgement.findings import ACCELERATION_LIMIT, RESPONSE_LIMIT
from airpuck.judgement.study import Study, study
from airpuck.judgement.verdict import Verdict
from airpuck.recording.stream import Recording

#: Longest time for a study while the craft holds its place [s].
_LONGEST_STUDY = 300.0
#: Hold times of the signals: for effects, and for timing [s].
_SLOW, _FAST = 0.3, 0.12


@dataclass(frozen=True)
class Excitations:
    """Repeat excitations until a trusted model predicts a flight that it has not seen.

    Attributes
    ----------
    duration_s : float
        Length of each.
    most : int
        Largest number of them.
    """

    duration_s: float = 7.0
    most: int = 6

    def run(self, session: Commissioned) -> None:
        """Fly and study until the verdict is trusted; see `CommissioningStep`."""
        flown: list[Recording] = []
        for number in range(self.most):
            plan = next_plan(session, self.duration_s)
            pilot = excitation(session, plan, number)
            flown.append(session.fly("excitation", pilot, plan.duration_s))
            session.study = self._studied(session, flown)
            said = session.study.verdict
            held_out = len(flown) > 1
            session.note("study" if held_out else "first fit", summary(said), session.study.model)
            if held_out and said.trusted:
                session.land()
                return
        session.land()
        assert session.study is not None
        raise Ended(first_cause(session.study))

    def _studied(self, session: Commissioned, flown: list[Recording]) -> Study:
        """Study the flights while the craft holds its place; the last one is held out."""
        other = flown[-1] if len(flown) > 1 else None
        work, given = session.work, (flown[:-1] or flown, session.vehicle, None, other)
        work.start(session.link.now, study, *given)
        if not work.done(session.link.now):
            session.fly("holding", hovering(session), _LONGEST_STUDY, until=work.done)
        if not work.done(session.link.now):
            cause = f"A study took longer than {_LONGEST_STUDY:g} s"
            remedy = "End other programs, and start again."
            raise Ended(Finding("control", cause, "", remedy))
        return work.result()


def next_plan(session: Commissioned, duration: float) -> ExcitationPlan:
    """Return the excitation that teaches most of what is least known."""
    said, hold = None if session.study is None else session.study.verdict, _SLOW
    if said and said.response_error is not None and said.acceleration_errors is not None:
        late = said.response_error / RESPONSE_LIMIT
        hold = _FAST if late > np.max(said.acceleration_errors) / ACCELERATION_LIMIT else _SLOW
    return ExcitationPlan(1.0, hold, duration)


def excitation(session: Commissioned, plan: ExcitationPlan, number: int) -> Excitation:
    """Return the pilot of an excitation, which brakes in time for what is not known yet."""
    model = session.model
    reaction = float(np.max(model.dynamics.lag)) + model.transport_delay
    given: dict[str, Any] = {"tuning": careful(model), "amplitude": plan.amplitude}
    given |= {"hold": plan.hold_s, "margin": plan.margin_m, "seed": session.seed + number}
    try:
        return Excitation(model, session.here, **given, table=session.table, reaction=reaction)
    except InputError as error:
        remedy = "Check the layout in the vehicle file."
        raise Ended(Finding("control", error.problem, "", remedy)) from error


def summary(said: Verdict) -> str:
    """Describe a verdict in a line."""
    known = ""
    if said.acceleration_errors is not None and said.response_error is not None:
        worst = float(np.max(said.acceleration_errors))
        known = (
            f"accelerations ± {100 * worst:.2g} %, response ± {1e3 * said.response_error:.2g} ms"
        )
    return f"{said.outcome.replace('_', ' ')}; {known}".rstrip("; ")


def first_cause(found: Study) -> Finding:
    """Return the first cause why a model is not trusted."""
    if found.findings:
        return found.findings[0]
    cause = found.verdict.sentences[0].removesuffix(".")
    return Finding("excitation", cause, "", "Fly longer: `airpuck fly-excitation`.")
