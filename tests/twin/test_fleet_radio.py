"""What a fleet hears, against the radio of a single craft."""

import numpy as np
import pytest

from airpuck.twin.fleet_radio import heard_commands
from airpuck.twin.radio import RadioLink
from airpuck.twin.settings import Radio, default_twin_settings

DELAYS = [0.0, 0.004, 0.021, 0.05]


@pytest.mark.parametrize("unarmed", [0.0, 0.3, 2.0])
@pytest.mark.parametrize(
    "radio",
    [
        Radio(),
        Radio(jitter_s=0.01, loss=0.3),
        Radio(jitter_s=0.02, loss=0.02, timeout_s=0.03, outages_s=[(0.2, 0.5), (0.9, 1.4)]),
        Radio(loss=1.0),
    ],
)
def test_every_craft_hears_what_a_single_one_would(radio, unarmed):
    default = default_twin_settings()
    motors = default.motors.model_copy(update={"unarmed_s": unarmed})
    settings = default.model_copy(update={"radio": radio, "motors": motors})
    sent = 0.01 * np.arange(120)
    # More than are handled at once.
    seeds = range(600)
    delays = [DELAYS[seed % 4] for seed in seeds]
    times, heard = heard_commands(settings, sent, seeds, delays)
    assert times.shape == heard.shape == (len(times), 600)
    assert (times[1:] >= times[:-1]).all()
    assert np.isinf(times[-1]).all()
    asked = np.linspace(0, 2.5, 401) + 1e-7
    for craft in (0, 3, 6, 511, 512, 597):
        link = RadioLink(
            radio.model_copy(update={"delay_s": delays[craft]}),
            np.random.default_rng([craft, 0]),
            1,
        )
        for number, time in enumerate(sent):
            link.send(time, np.array([number + 1.0]))
        expected = [link.command(now)[0] if now >= unarmed else 0.0 for now in asked]
        changes = np.searchsorted(times[:, craft], asked, side="right")
        commands = np.concatenate([[len(sent)], heard[:, craft]])[changes]
        found = np.where(commands == len(sent), 0.0, commands + 1.0)
        np.testing.assert_array_equal(found, expected)
