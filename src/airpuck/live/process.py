"""A process on the graph: joining, streams as numbers, plans, events, clock and shutdown."""

from __future__ import annotations

import copy
import gc
import math
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError, escaped
from airpuck.boundary.signals import SIGNALS
from airpuck.flight.clock import Clock, Every, StampClock
from airpuck.live.graph import LOG, SENSOR, STATE, Endpoint, Graph, Quality
from airpuck.live.settings import LEASE, LiveSettings
from airpuck.recording.conversion import SECOND_NS
from airpuck.recording.mapping import Topics
from airpuck.recording.message import MessageCodec, StreamCodec, definitions

if TYPE_CHECKING:
    from airpuck.control.law import Step
    from airpuck.control.reference import Numbers


class MessageTopic(NamedTuple):
    """A topic of whole messages, which are not streams of numbers."""

    name: str
    msgtype: str
    quality: Quality


#: ROS 2's own topics for events and for heartbeats; tools know them by name.
EVENTS = MessageTopic("/rosout", "rcl_interfaces/msg/Log", LOG)
HEARTBEATS = MessageTopic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", STATE)
#: The plan of a predictive law: a standard message, which rviz and Foxglove draw.
PLANS = MessageTopic("/control/plan", "nav_msgs/msg/Path", SENSOR)
#: Name on ``/diagnostics`` of the plan's active limits.
PLAN_NAME = "airpuck plan"
LogLevel = Literal["info", "warning", "error"]
#: ROS's numeric levels of an event, and of a heartbeat.
EVENT_LEVELS: dict[LogLevel, int] = {"info": 20, "warning": 30, "error": 40}
_HEARTBEAT_LEVELS: dict[LogLevel, int] = {"info": 0, "warning": 1, "error": 2}
#: A repeated event within this time is held back [s].
_REPEATS = 1.0
_NUMBER = re.compile(r"\d+(\.\d+)?")


class MessageOutbox:
    """Publishes messages on a topic; `make` makes one, or one of a nested type."""

    def __init__(self, graph: Graph, topic: MessageTopic) -> None:
        types = definitions("")
        self._codec = MessageCodec(topic.msgtype, types)
        self._publisher = graph.publisher(topic.name, topic.msgtype, types, topic.quality)
        self.make = self._codec.message

    def send(self, message: Any) -> None:
        """Publish a message."""
        self._publisher.send(self._codec.encode(message))


def well_formed(graph: Graph, topic: MessageTopic) -> Callable[[], list[Any]]:
    """Subscribe to a topic of messages; the result returns its new well-formed messages."""
    types = definitions("")
    codec = MessageCodec(topic.msgtype, types)
    subscription = graph.subscription(topic.name, topic.msgtype, types, topic.quality)

    def take() -> list[Any]:
        messages = []
        for sample in subscription.take():
            with suppress(ValueError):
                messages.append(codec.decode(sample.data))
        return messages

    return take


class EventLog:
    """Publishes events and heartbeats, and prints events on standard error.

    An event is published at once the first time. Its repetitions within a second are counted, and
    published as one with the next heartbeat, in the order in which they last happened: the last
    event published is the present state.
    """

    def __init__(self, graph: Graph, name: str, *, quiet: bool = False) -> None:
        self._name, self._quiet = name, quiet
        self._events, self._states = (MessageOutbox(graph, one) for one in (EVENTS, HEARTBEATS))
        #: Time at which each kind of event was last published [s].
        self._published: dict[str, float] = {}
        #: Events held back by kind: level, last text, and count.
        self._held: dict[str, tuple[LogLevel, str, int]] = {}
        #: Number of events of each level, repetitions included.
        self.counts: dict[str, int] = dict.fromkeys(EVENT_LEVELS, 0)

    def log(self, level: LogLevel, text: str, *, kind: str | None = None) -> None:
        """Publish an event; by default, texts that differ only in numbers are of the same kind."""
        self.counts[level] += 1
        kind = _NUMBER.sub("#", text) if kind is None else kind
        if time.monotonic() - self._published.get(kind, -math.inf) < _REPEATS:
            # Move to the end of the order, if it was held before.
            _, _, count = self._held.pop(kind, (level, text, 0))
            self._held[kind] = level, text, count + 1
            return
        # Events that were held back happened before this one.
        self.flush()
        self._publish(level, text, kind)

    def flush(self) -> None:
        """Publish the repetitions that were held back; `heartbeat` calls this."""
        held, self._held = self._held, {}
        for kind, (level, text, count) in held.items():
            self._publish(level, f"{text} ({count} times)" if count > 1 else text, kind)

    def heartbeat(self, level: LogLevel, text: str, values: Mapping[str, object]) -> None:
        """Publish that the process is alive, its state, and some figures; once a second."""
        self.flush()
        self.state(level, text, values)

    def state(
        self, level: LogLevel, text: str, values: Mapping[str, object], *, name: str = ""
    ) -> None:
        """Publish a state and some figures; `name` is a part of the process."""
        message = self._states.make()
        set_stamp(message.header.stamp, time.time_ns())
        status = self._states.make("diagnostic_msgs/msg/DiagnosticStatus")
        status.level, status.message = _HEARTBEAT_LEVELS[level], text
        status.name = name or self._name
        status.values = [
            self._states.make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in values.items()
        ]
        message.status = [status]
        self._states.send(message)

    def _publish(self, level: LogLevel, text: str, kind: str) -> None:
        """Publish an event, and record the time."""
        now = time.monotonic()
        self._published = {k: t for k, t in self._published.items() if now - t < _REPEATS}
        self._published[kind] = now
        event = self._events.make()
        set_stamp(event.stamp, time.time_ns())
        event.level, event.name, event.msg = EVENT_LEVELS[level], self._name, text
        self._events.send(event)
        if not self._quiet:
            with suppress(OSError):  # the terminal may be gone
                print(f"{self._name}: {escaped(text)}", file=sys.stderr, flush=True)


def set_stamp(stamp: Any, time_ns: int) -> None:
    """Set a message's stamp to a time [ns since the epoch]."""
    stamp.sec, stamp.nanosec = divmod(time_ns, SECOND_NS)


#: Estimates and references are sent again when lost; of other streams only the newest message
#: counts.
_QUALITY = {"estimate": STATE, "reference": STATE}
#: Time between heartbeats [s].
_HEARTBEAT = 1.0
#: Time allowed for the discovery of other processes [s].
_LOOK_AROUND = 0.6
#: Larger numbers are garbage: squares of some finite ones overflow. Commands go to 1, poses to
#: metres and some turns.
_LARGEST = 1e6
#: A difference between clocks that is worth a warning [s].
_NOTABLE_OFFSET = 0.1
#: A process that did not poll for this long was suspended [s]; messages from the system's buffers
#: keep arriving for this long afterwards [s].
_STOOD_STILL, _COMES_LATE = 0.1, 0.05
#: Period for resending the last message to late subscribers [s].
_REMIND = 1.0


class Process:
    """A process on the graph, to be used as a context manager.

    From `start` on, SIGINT, SIGTERM and SIGHUP end its loop instead of the process.
    """

    def __init__(self, name: str, settings: LiveSettings) -> None:
        self.settings = settings
        self.topics = settings.topics or Topics()
        self.graph = Graph(name, domain=settings.domain, interface=settings.interface)
        self.events = EventLog(self.graph, name, quiet=settings.quiet)
        self.clock = Clock()
        self.beat = Every(_HEARTBEAT)
        #: Whether one of these signals has arrived.
        self.interrupted = False
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self.graph.close()

    def with_topics(self, topics: Topics) -> Process:
        """Return this process with other topics."""
        other = copy.copy(self)
        other.topics = topics
        return other

    def refuse_second(self, stream: str, motors: tuple[str, ...], role: str) -> None:
        """Raise InputError if another process already publishes a stream."""
        topic, codec, quality = _wire(self, stream, motors)
        heard = self.graph.subscription(topic, codec.msgtype, codec.types, quality)
        start = time.monotonic()
        while (others := self.graph.publishers(topic)) or self.graph.age < _LOOK_AROUND:
            # A killed process is silent, and leaves the graph after its lease.
            silent = time.monotonic() - start
            if others and (heard.take() or silent > LEASE + 1.0):
                raise InputError(
                    f"there is another {role} already: {self.graph.describe(others[0])}; end it "
                    "first, or use another --domain",
                    field=topic,
                )
            time.sleep(0.02)

    def start(self, text: str) -> None:
        """Start the clock; all slow work has been done."""
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT:
                self._handlers[number] = signal.signal(number, self._interrupt)
        self.events.log("info", f"on domain {self.graph.domain}{text}")
        # The garbage collector need not scan existing objects.
        gc.collect()
        gc.freeze()
        self.clock.restart()

    @property
    def goes_on(self) -> bool:
        """Whether time is left, and no signal has come."""
        duration = self.settings.duration
        return not self.interrupted and (duration is None or self.clock.now < duration)

    def _interrupt(self, *_: object) -> None:
        self.interrupted = True


def _wire(
    process: Process, stream: str, motors: tuple[str, ...]
) -> tuple[str, StreamCodec, Quality]:
    """Return topic, codec and quality of service of a stream."""
    topic = process.topics.by_stream[stream]
    return topic, StreamCodec(stream, motors), _QUALITY.get(stream, SENSOR)


class Inbox:
    """One stream as it arrives; problems with its messages are logged, unless it is quiet."""

    def __init__(
        self,
        process: Process,
        stream: str,
        motors: tuple[str, ...] = (),
        *,
        wakes: bool = False,
        quiet: bool = False,
    ) -> None:
        self._graph, self._clock = process.graph, process.clock
        self._events = None if quiet else process.events
        self._topic, self._codec, quality = _wire(process, stream, motors)
        self._subscription = self._graph.subscription(
            self._topic, self._codec.msgtype, self._codec.types, quality, wakes=wakes
        )
        self._stamps, self._reported_offset = StampClock(), 0.0
        self._looked, self._late_until = self._clock.now, -math.inf
        self._strangers: set[Endpoint] = set()
        #: Number of usable messages, and of unusable ones.
        self.good = self.bad = 0

    def discard(self) -> None:
        """Drop pending messages."""
        self._subscription.take()

    def take(self) -> list[tuple[float, Float[np.ndarray, " k"]]]:
        """Take new messages: the time of each stamp on our clock [s], and its numbers."""
        taken = []
        for arrival, stamp_ns, values in self._decoded():
            if stamp_ns is None:
                taken.append((arrival, values))
                continue
            stamp = self._clock.of(stamp_ns)
            placed = self._stamps.time(stamp, arrival)
            if placed is None:
                age = arrival - stamp - self._stamps.offset
                self._refuse("stamp", f"wrong or late stamp on {self._topic}: {age:.3f} s old")
            else:
                taken.append((placed, values))
        self.good += len(taken)
        offset = self._stamps.offset
        if abs(offset - self._reported_offset) > _NOTABLE_OFFSET:
            self._reported_offset = offset
            self._warn(f"the clock behind {self._topic} differs by {-offset:.3f} s; compensated")
        return taken

    def take_commands(self) -> list[Float[np.ndarray, " k"]]:
        """Take numbers that act on arrival, whatever their stamps and the sender's clock."""
        before, self._looked = self._looked, self._clock.now
        if self._looked - before > _STOOD_STILL:
            self._late_until = self._looked + _COMES_LATE
        late = self._looked < self._late_until
        taken = []
        for _, _, values in self._decoded():
            if not np.isfinite(values).all():
                self._refuse("finite", f"numbers on {self._topic} that are not finite")
            elif late:
                self._refuse("late", f"late messages on {self._topic}")
            else:
                taken.append(values)
        self.good += len(taken)
        return taken

    def report_strangers(self) -> None:
        """Warn once about each publisher of another type on the topic: it is ignored."""
        for endpoint in self._graph.publishers(self._topic):
            if endpoint.msgtype != self._codec.msgtype and endpoint not in self._strangers:
                self._strangers.add(endpoint)
                text = (
                    f"{self._graph.describe(endpoint)} publishes {endpoint.msgtype} on "
                    f"{self._topic}, which should be {self._codec.msgtype}; it is ignored"
                )
                self._warn(text, kind=text)

    def _decoded(self) -> Iterator[tuple[float, int | None, Float[np.ndarray, " k"]]]:
        """Take arrivals [s], stamps [ns since the epoch] and numbers of well-formed messages."""
        for sample in self._subscription.take():
            arrival = self._clock.now
            try:
                stamp_ns, values = self._codec.decode(sample.data)
            except ValueError as error:
                self._refuse("garbage", f"garbage on {self._topic}: {error}")
                continue
            if (np.isfinite(values) & (np.abs(values) > _LARGEST)).any():
                self._refuse("size", f"numbers on {self._topic} beyond {_LARGEST:g}")
            else:
                yield arrival, stamp_ns, values

    def reject(self, text: str) -> None:
        """Count a message that was taken as unusable, and warn."""
        self.good -= 1
        self._refuse("content", f"refused on {self._topic}: {text}")

    def _refuse(self, kind: str, text: str) -> None:
        """Count an unusable message, and warn."""
        self.bad += 1
        self._warn(text, kind=f"{kind} {self._topic}")

    def _warn(self, text: str, kind: str | None = None) -> None:
        if self._events is not None:
            self._events.log("warning", text, kind=kind)


class Outbox:
    """One outgoing stream."""

    def __init__(self, process: Process, stream: str, motors: tuple[str, ...] = ()) -> None:
        self._clock = process.clock
        topic, self._codec, quality = _wire(process, stream, motors)
        types = self._codec.types
        self._publisher = process.graph.publisher(topic, self._codec.msgtype, types, quality)
        self._last: Numbers | None = None
        #: Time at which the last message was sent [s].
        self.sent = -math.inf

    def send(self, values: Numbers, moment: float | None = None) -> None:
        """Send numbers, stamped with a time on our clock [s], by default now."""
        moment = self._clock.now if moment is None else moment
        self._publisher.send(self._codec.encode(self._clock.stamp_ns(moment), values))
        self._last, self.sent = values, self._clock.now

    def remind(self) -> None:
        """Resend the last numbers every second, for late subscribers."""
        if self._last is not None and self._clock.now - self.sent > _REMIND:
            self.send(self._last)


#: Number of poses of a path that are drawn; foreign paths may have any number.
_MOST = 200
_POSE = "geometry_msgs/msg/PoseStamped"


class PlanOutbox:
    """Sends plans."""

    def __init__(self, process: Process) -> None:
        self._clock, self._events = process.clock, process.events
        self._paths = MessageOutbox(process.graph, PLANS)

    def send(self, step: Step) -> None:
        """Publish the prediction of a step, if its law predicts."""
        plan, estimate = step.prediction, step.estimate
        if plan is None or estimate is None:
            return
        path = self._paths.make()
        path.header.frame_id = "world"
        set_stamp(path.header.stamp, self._clock.stamp_ns(estimate.time))
        path.poses = [
            self._pose(estimate.time + time, state)
            for time, state in zip(plan.times.tolist(), plan.states[:, :3].tolist(), strict=True)
        ]
        self._paths.send(path)
        level: LogLevel = "info" if step.status == "optimal" else "warning"
        figures = {"limits": ", ".join(plan.active), "bound by": plan.bound_by}
        self._events.state(level, step.status, figures, name=PLAN_NAME)

    def _pose(self, moment: float, pose: list[float]) -> Any:
        """Return one pose of a path."""
        x, y, yaw = pose
        stamped = self._paths.make(_POSE)
        stamped.header.frame_id = "world"
        set_stamp(stamped.header.stamp, self._clock.stamp_ns(moment))
        stamped.pose.position.x, stamped.pose.position.y = x, y
        turned = stamped.pose.orientation
        turned.z, turned.w = math.sin(yaw / 2), math.cos(yaw / 2)
        return stamped


def positions(path: Any) -> Float[np.ndarray, "N 2"] | None:
    """Return the positions of a path; None if there are fewer than two, or one is not finite."""
    points = [(at.pose.position.x, at.pose.position.y) for at in path.poses[:_MOST]]
    found = np.array(points, dtype=float).reshape(-1, 2)
    return found if len(found) > 1 and np.isfinite(found).all() else None
