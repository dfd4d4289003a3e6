"""The check before flight, of a craft on the graph."""

from __future__ import annotations

import math

from airpuck.craft.table import Table
from airpuck.flight.preflight import Preflight, judge_test
from airpuck.flight.pulses import PulsePlan, PulseTest
from airpuck.live.fly import fly_live
from airpuck.live.safety import Limits
from airpuck.model.model_file import Model
from airpuck.recording.topics import Topics

#: For the graph to be found, and for the guard to believe the poses [s].
_PATIENCE = 3.0
#: The frame may be wrong, and the units: what ends the test near a rail is the pilot, and where the
#: poses jump its pulses remain what they are.
ANYWHERE = Limits(geofence=(math.inf, math.inf), jump=(math.inf, math.inf))


def preflight_live(
    model: Model,
    plan: PulsePlan | None = None,
    table: Table | None = None,
    *,
    topics: Topics | None = None,
    domain: int | None = None,
    interface: str | None = None,
    quiet: bool = False,
) -> Preflight:
    """Give each motor of a craft on the graph short pulses, and judge what it does."""
    pilot = PulseTest(model.vehicle, plan, table)

    def over(time: float) -> bool:
        return pilot.over or (not pilot.poses and time > _PATIENCE)

    fly_live(
        lambda: pilot,
        model.vehicle,
        ANYWHERE,
        topics=topics,
        domain=domain,
        interface=interface,
        duration=pilot.duration + _PATIENCE,
        over=over,
        quiet=quiet,
        name="airpuck preflight",
        warm_up=False,
    )
    return judge_test(pilot, model)
