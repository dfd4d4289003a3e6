"""The radio, by statistics and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from airpuck.twin.radio import RadioLink, heard_commands, queued_delay
from airpuck.twin.settings import Radio, default_twin_settings

from ..apparatus.changes import changed
from ..apparatus.examples import examples

PERIOD = 0.01


def link(seed=0, **values):
    return RadioLink(
        Radio(**{"delay_s": 0.02, "jitter_s": 0.0, **values}), np.random.default_rng(seed), 1
    )


def packet(number):
    return np.array([float(number)])


def flown(radio, packets, *, start=0.0):
    """Send numbered packets at 100 Hz; times and contents of all changes, as the twin sees them."""
    now, sent, seen = start, 0, []
    while sent < packets or radio.next_change(now) < math.inf:
        due = start + sent * PERIOD if sent < packets else math.inf
        now = min(due, radio.next_change(now))
        if now == due:
            sent += 1
            radio.send(now, packet(sent))
        number = radio.command(now)[0]
        if not seen or seen[-1][1] != number:
            seen.append((now, number))
    return np.array(seen)


def received(seen):
    """Times and numbers of the packets, without the zeros before and after."""
    return seen[seen[:, 1] > 0].T


def test_without_jitter_a_packet_acts_exactly_after_its_delay():
    radio = link(delay_s=0.03)
    radio.send(1.0, packet(7))
    assert radio.command(1.0) == 0
    assert radio.next_change(1.0) == 1.03
    assert radio.command(np.nextafter(1.03, 0)) == 0
    assert radio.command(1.03) == 7


def test_queued_delays_match_the_link():
    """With the same random numbers; a packet that was not seen arrived together with the next."""
    settings = Radio(delay_s=0.02, jitter_s=0.008)
    sent = PERIOD * np.arange(2000)
    times, numbers = received(flown(link(jitter_s=0.008), 2000))
    delay = times[np.searchsorted(numbers, np.arange(1, 2001))] - sent
    mean, deviation = queued_delay(settings, PERIOD, packets=2000)
    assert mean == pytest.approx(delay.mean(), abs=1e-12)
    assert deviation == pytest.approx(delay.std(), abs=1e-12)
    assert mean > 0.0205
    assert queued_delay(Radio(delay_s=0.02, jitter_s=0.0), PERIOD) == pytest.approx(
        (0.02, 0.0), abs=1e-9
    )


def test_delays_have_the_stated_mean_and_spread():
    # The jitter is so small that no packet waits for another, and no delay is negative.
    times, numbers = received(flown(link(delay_s=0.02, jitter_s=0.001), 5000))
    late = times - PERIOD * (numbers - 1)
    assert len(late) == 5000
    assert late.mean() == pytest.approx(0.02, abs=5 * 0.001 / math.sqrt(5000))
    assert late.std() == pytest.approx(0.001, rel=0.05)


def test_jitter_never_reorders_packets_or_delivers_before_sending():
    times, numbers = received(flown(link(delay_s=0.02, jitter_s=0.06), 5000))
    assert (np.diff(numbers) > 0).all()
    assert (times >= PERIOD * (numbers - 1)).all()
    # Packets that caught up arrive together, and only the last one has an effect.
    assert len(numbers) < 3000


def test_a_packet_waits_for_its_predecessor():
    # Two packets 10 ms apart with delays of 50 and of 0 ms, drawn by a generator of our own.
    class Draws(np.random.Generator):
        drawn = iter([3.0, -2.0])

        def random(self, *_):
            return np.array([[norm.cdf(next(self.drawn)), 0.5]])

    radio = RadioLink(Radio(delay_s=0.02, jitter_s=0.01), Draws(np.random.PCG64()), 1)
    radio.send(0.0, packet(1))
    radio.send(0.01, packet(2))
    assert radio.command(0.049) == 0
    assert radio.command(0.05) == 2


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.3, 1.0])
def test_packets_are_lost_at_the_stated_rate(loss):
    seen = flown(link(loss=loss), 4000)
    numbers = received(seen)[1]
    share = 1 - len(set(numbers)) / 4000
    assert share == pytest.approx(loss, abs=4 * math.sqrt(loss * (1 - loss) / 4000) + 1e-12)


def test_losses_are_independent():
    numbers = received(flown(link(loss=0.3), 8000))[1]
    arrived = np.isin(np.arange(1, 8001), numbers)
    after_loss = arrived[1:][~arrived[:-1]]
    assert after_loss.mean() == pytest.approx(0.7, abs=4 * math.sqrt(0.21 / len(after_loss)))


def test_nothing_arrives_during_an_outage_and_the_last_command_is_held():
    seen = flown(link(delay_s=0.02, outages_s=((0.503, 0.603),)), 100)
    times, numbers = received(seen)
    assert not ((times >= 0.503) & (times < 0.603)).any()
    # Packets that would arrive at 0.51 … 0.60 s, sent 20 ms earlier, are lost.
    lost = set(range(1, 101)) - set(numbers)
    assert lost == set(range(50, 60))
    assert 0 not in seen[1:-1, 1]


def test_motors_stop_after_the_timeout_and_the_next_packet_restarts_them():
    radio = link(delay_s=0.02, timeout_s=0.2)
    radio.send(0.0, packet(5))
    assert radio.next_change(0.0) == 0.02
    assert radio.command(0.02) == 5
    assert radio.next_change(0.02) == pytest.approx(0.22)
    assert radio.command(0.219) == 5
    assert radio.command(radio.next_change(0.02)) == 0
    assert radio.command(3.0) == 0
    radio.send(4.0, packet(6))
    assert radio.command(4.019) == 0
    assert radio.command(4.02) == 6


def test_a_long_outage_stops_the_motors():
    seen = flown(link(outages_s=((0.5, 0.9),), timeout_s=0.2), 100)
    stops = seen[1:-1][seen[1:-1, 1] == 0]
    np.testing.assert_allclose(stops[:, 0], [0.49 + 0.2], atol=1e-9)
    again = seen[seen[:, 0] > 0.7][0]
    assert again[0] == pytest.approx(0.9, abs=1e-9)


def test_losses_do_not_change_the_arrival_of_other_packets():
    jitter = {"jitter_s": 0.001, "delay_s": 0.02}
    whole, part = (received(flown(link(3, loss=p, **jitter), 500)) for p in (0.0, 0.3))
    np.testing.assert_array_equal(part[0], whole[0][np.isin(whole[1], part[1])])


spans = st.tuples(st.floats(0, 1), st.floats(0, 0.3)).map(lambda s: (s[0], s[0] + s[1]))


@examples(60)
@given(
    seed=st.integers(0, 10**6),
    delay=st.floats(0, 0.1),
    jitter=st.floats(0, 0.06),
    loss=st.floats(0, 1),
    timeout=st.floats(0.001, 0.5),
    outages=st.lists(spans, max_size=2).map(tuple),
    sending=st.lists(st.floats(0, 0.3), min_size=1, max_size=30),
)
def test_the_next_change_is_never_in_the_past_and_nothing_changes_before(
    seed, delay, jitter, loss, timeout, outages, sending
):
    radio = link(
        seed, delay_s=delay, jitter_s=jitter, loss=loss, timeout_s=timeout, outages_s=outages
    )
    last, now = 0.0, 0.0
    for number, due in enumerate(np.cumsum(sending), start=1):
        while True:
            command, change = radio.command(now)[0], radio.next_change(now)
            assert change > now
            if change >= due:
                break
            # Until just before, the same command is in force.
            assert radio.command(np.nextafter(change, 0))[0] == command
            now = change
        assert radio.command(np.nextafter(due, 0))[0] == command
        now = due
        radio.send(now, packet(number))
        if command > 0:
            assert command >= last
            last = command


DELAYS = [0.0, 0.004, 0.021, 0.05]


@pytest.mark.parametrize("unarmed", [0.0, 0.3, 2.0])
@pytest.mark.parametrize(
    "radio",
    [
        Radio(jitter_s=0.0),
        Radio(jitter_s=0.01, loss=0.3),
        Radio(jitter_s=0.02, loss=0.02, timeout_s=0.03, outages_s=[(0.2, 0.5), (0.9, 1.4)]),
        Radio(loss=1.0),
    ],
)
def test_each_craft_of_a_batch_receives_the_same_packets_as_a_twin(radio, unarmed):
    flown = changed(default_twin_settings(), radio=radio, motors={"unarmed_s": unarmed})
    sent = 0.01 * np.arange(120)
    seeds = range(600)
    delays = np.array([DELAYS[seed % 4] for seed in seeds])
    times, heard = heard_commands(flown, sent, seeds, delays)
    assert times.shape == heard.shape == (len(times), 600)
    assert (times[1:] >= times[:-1]).all()
    asked = np.linspace(0, 2.5, 401) + 1e-7
    for craft in (0, 3, 6, 511, 512, 597):
        link = RadioLink(
            radio.model_copy(update={"delay_s": delays[craft].item()}),
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
