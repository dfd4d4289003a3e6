"""A ROS 2 graph without ROS: publishers, subscriptions and discovery over Cyclone DDS."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from airpuck.boundary.errors import InputError, explained, installed
from airpuck.live.settings import domain_config, domain_id
from airpuck.recording.cdr import Types
from airpuck.recording.conversion import SECOND_NS

if TYPE_CHECKING:
    from uuid import UUID

#: Prefix of the DDS names of ROS topics.
_TOPIC_PREFIX = "rt"
#: Number of samples taken at once; more wait for the next call.
_BATCH = 256


@dataclass(frozen=True)
class Quality:
    """Quality of service, as far as ROS 2 topics differ in it."""

    #: Whether lost packets are sent again.
    reliable: bool = True
    #: Whether latecomers are sent earlier messages.
    transient_local: bool = False
    #: Messages kept.
    depth: int = 64
    #: Lifetime of a message [s]; None is forever.
    lifespan: float | None = None


#: As in the table's recordings: lost messages of sensors and commands are not sent again.
SENSOR = Quality(reliable=False)
STATE = Quality()
#: Quality of ``/rosout``.
LOG = Quality(transient_local=True, depth=1000, lifespan=10.0)


@dataclass(frozen=True)
class Sample:
    """A received message."""

    #: Time at which it was sent, by the sender's clock [ns since the epoch].
    sent_ns: int
    #: Messages in CDR, with encapsulation.
    data: bytes


@dataclass(frozen=True)
class Endpoint:
    """A publisher somewhere on the graph."""

    #: DDS keys of the publisher and of its process.
    key: UUID
    participant: UUID
    #: ROS names.
    topic: str
    msgtype: str
    #: The offered quality of service.
    reliable: bool
    transient_local: bool


class Publisher:
    """Sends messages on a topic; from `Graph.publisher`."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self._writer, self._kind = writer, kind

    def send(self, data: bytes) -> None:
        """Send a message, as CDR."""
        self._writer.write(self._kind(data))


class Subscription:
    """Receives messages of a topic; from `Graph.subscription`."""

    def __init__(self, reader: Any, kind: Any, condition: Any) -> None:
        #: The condition ends `Graph.wait` when a message comes; None: it does not wake the process.
        self._reader, self._kind, self._condition = reader, kind, condition

    def take(self) -> list[Sample]:
        """Take new messages since the last call."""
        return [
            Sample(item.sample_info.source_timestamp, item.data)
            for item in self._reader.take(_BATCH)
            if isinstance(item, self._kind)
        ]


class Graph:
    """A process on the graph.

    Parameters
    ----------
    name : str
        Name of the process for others.
    domain : int, optional
        DDS domain; by default ``ROS_DOMAIN_ID``, or 0.
    interface : str, optional
        Network interface; by default loopback, so that nothing leaves the machine.

    Raises
    ------
    InputError
        If Cyclone DDS is not installed, the domain or the interface does not exist, or this process
        has already joined the domain over another interface.
    """

    #: Cyclone configures a domain only once per process.
    _configured: dict[int, tuple[str, Any]] = {}  # noqa: RUF012

    def __init__(
        self, name: str, *, domain: int | None = None, interface: str | None = None
    ) -> None:
        self.domain = domain_id(domain)
        config = domain_config(interface)
        with installed("a graph needs Cyclone DDS: pip install 'airpuck[ros2]'"):
            from cyclonedds import builtin
            from cyclonedds.core import DDSException, GuardCondition, Policy, Qos, WaitSet
            from cyclonedds.domain import Domain, DomainParticipant
        problem = f"domain {self.domain} cannot be joined ({{error}}); "
        problem += "are there too many processes in it?"
        with explained(DDSException, problem, field="--domain"):
            if self.domain not in self._configured:
                self._configured[self.domain] = config, Domain(self.domain, config)
            if self._configured[self.domain][0] != config:
                raise InputError(
                    "this process is in the domain over another interface", field="--interface"
                )
            described = f"{name} (process {os.getpid()} on {socket.gethostname()})"
            self._participant = DomainParticipant(self.domain, Qos(Policy.EntityName(described)))
        self._entered = time.monotonic()
        self._waitset = WaitSet(self._participant)
        # Never triggers: Cyclone does not wait for an empty set.
        self._waitset.attach(GuardCondition(self._participant))
        self._kinds: dict[str, Any] = {}
        self._structs: dict[str, Any] = {}
        self._topics: dict[str, tuple[str, Any]] = {}
        # Cyclone deletes a writer without references.
        self._writers: list[Any] = []
        read = builtin.BuiltinDataReader
        self._participants = read(self._participant, builtin.BuiltinTopicDcpsParticipant)
        self._publications = read(self._participant, builtin.BuiltinTopicDcpsPublication)
        self._subscriptions = read(self._participant, builtin.BuiltinTopicDcpsSubscription)
        self._endpoints: dict[UUID, Endpoint] = {}
        #: Subscribers: their process and their topic, with ROS names.
        self._hearers: dict[UUID, tuple[UUID, str | None]] = {}
        self._owners: dict[UUID, str] = {}

    def publisher(self, topic: str, msgtype: str, types: Types, quality: Quality) -> Publisher:
        """Publish on a topic.

        Parameters
        ----------
        topic, msgtype : str
            ROS names.
        types : mapping
            Definitions by type name.
        quality : Quality
            The offered quality of service.

        Returns
        -------
        Publisher
            Sends.
        """
        from cyclonedds.pub import DataWriter

        made = self._topic(topic, msgtype, types)
        writer = DataWriter(self._participant, made, qos=_qos(quality))
        self._writers.append(writer)
        return Publisher(writer, self._kinds[msgtype])

    def subscription(
        self, topic: str, msgtype: str, types: Types, quality: Quality, *, wakes: bool = False
    ) -> Subscription:
        """Subscribe to a topic.

        Parameters
        ----------
        topic, msgtype : str
            ROS names.
        types : mapping
            Definitions by type name.
        quality : Quality
            Requested quality; a publisher that offers less is not matched.
        wakes : bool, default False
            Whether `wait` returns when a message comes; this adds a small cost for each message.

        Returns
        -------
        Subscription
            Receives.

        Raises
        ------
        InputError
            If this process already uses the topic with another type.
        """
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
        from cyclonedds.sub import DataReader

        made = self._topic(topic, msgtype, types)
        reader, condition = DataReader(self._participant, made, qos=_qos(quality)), None
        if wakes:
            condition = ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.Any)
            self._waitset.attach(condition)
        return Subscription(reader, self._kinds[msgtype], condition)

    def unsubscribe(self, subscription: Subscription) -> None:
        """End a subscription, so that `wait` no longer wakes for it.

        Parameters
        ----------
        subscription : Subscription
            From `subscription`; the caller drops it.
        """
        if subscription._condition is not None:
            self._waitset.detach(subscription._condition)

    def wait(self, seconds: float) -> None:
        """Sleep until a waking subscription gets a message, or a time has passed.

        Parameters
        ----------
        seconds : float
            The longest time [s].
        """
        if seconds > 0:
            self._waitset.wait(int(seconds * SECOND_NS))

    def publishers(self, topic: str | None = None, *, own: bool = False) -> list[Endpoint]:
        """Return the publishers that discovery has found.

        Parameters
        ----------
        topic : str, optional
            Restrict to this ROS topic.
        own : bool, default False
            Whether to include this process.

        Returns
        -------
        list of Endpoint
            Those alive.
        """
        from cyclonedds.core import Policy

        for item in _present(self._publications, self._endpoints):
            if (name := ros_topic(item.topic_name)) is not None:
                self._endpoints[item.key] = Endpoint(
                    item.key,
                    item.participant_key,
                    name,
                    ros_type(item.type_name),
                    isinstance(item.qos[Policy.Reliability], Policy.Reliability.Reliable),
                    item.qos[Policy.Durability] != Policy.Durability.Volatile,
                )
        left_out = None if own else self._participant.get_guid()
        return [
            endpoint
            for endpoint in self._endpoints.values()
            if endpoint.participant != left_out and topic in (None, endpoint.topic)
        ]

    def subscribers(self, topic: str) -> set[UUID]:
        """Return which other processes have subscribed to a topic, as far as discovery knows.

        Parameters
        ----------
        topic : str
            Its ROS name.

        Returns
        -------
        set of UUID
            DDS keys of the processes, as `Endpoint.participant`.
        """
        for item in _present(self._subscriptions, self._hearers):
            self._hearers[item.key] = item.participant_key, ros_topic(item.topic_name)
        own = self._participant.get_guid()
        return {who for who, one in self._hearers.values() if who != own and one == topic}

    @property
    def age(self) -> float:
        """Time since discovery of other processes began [s]."""
        return time.monotonic() - self._entered

    def describe(self, endpoint: Endpoint) -> str:
        """Name the process of an endpoint.

        Parameters
        ----------
        endpoint : Endpoint
            From `publishers`.

        Returns
        -------
        str
            Name, process and machine, as far as the other side reports them.
        """
        from cyclonedds.core import Policy

        for item in _present(self._participants, {}):  # names of those who have left stay known
            properties = {p.key: p.value for p in item.qos if type(p).__name__ == "Property"}
            name = item.qos[Policy.EntityName].name if Policy.EntityName in item.qos else ""
            # For foreign processes, the information from Cyclone, if they run it.
            self._owners[item.key] = name or (
                f"{properties.get('__ProcessName', 'an unknown program')} (process "
                f"{properties.get('__Pid', '?')} on {properties.get('__Hostname', '?')})"
            )
        who = endpoint.participant
        return self._owners.get(who, f"an unknown program (participant {who})")

    def close(self) -> None:
        """Leave the graph; others notice at once."""
        self._writers.clear()
        # Cyclone's Python deletes an entity without references, and offers no other way.
        participant: Any = self._participant
        participant._delete(participant._ref)

    def _topic(self, topic: str, msgtype: str, types: Types) -> Any:
        """Return the DDS topic, made once."""
        from cyclonedds.topic import Topic

        if topic in self._topics:
            present, made = self._topics[topic]
            if present != msgtype:
                raise InputError(f"already has the type {present}, not {msgtype}", field=topic)
            return made
        if msgtype not in self._kinds:
            self._kinds[msgtype] = raw_type(idl_struct(types, msgtype, self._structs))
        made = Topic(self._participant, dds_topic(topic), self._kinds[msgtype])
        self._topics[topic] = msgtype, made
        return made


def _present(reader: Any, known: dict[UUID, Any]) -> Iterator[Any]:
    """Yield what discovery has found since the last call; forget the known that have left."""
    from cyclonedds.core import InstanceState

    for item in reader.take(_BATCH):
        if item.sample_info.instance_state == InstanceState.Alive:
            yield item
        else:
            known.pop(item.key, None)


def _qos(quality: Quality) -> Any:
    """Return Cyclone's settings; ROS 2 speaks the first version of CDR."""
    from cyclonedds.core import Policy, Qos

    reliable = Policy.Reliability.Reliable(max_blocking_time=SECOND_NS // 10)
    durable = Policy.Durability
    policies = [
        reliable if quality.reliable else Policy.Reliability.BestEffort,
        durable.TransientLocal if quality.transient_local else durable.Volatile,
        Policy.History.KeepLast(quality.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    if quality.lifespan is not None:
        policies.append(Policy.Lifespan(int(quality.lifespan * SECOND_NS)))
    return Qos(*policies)


def dds_topic(topic: str) -> str:
    """Return the DDS name of a ROS topic."""
    return _TOPIC_PREFIX + topic


def ros_topic(name: str) -> str | None:
    """Return the ROS topic of a DDS topic; None if ROS 2 did not name it."""
    return name.removeprefix(_TOPIC_PREFIX) if name.startswith(f"{_TOPIC_PREFIX}/") else None


def dds_type(msgtype: str) -> str:
    """Return the DDS name of a ROS message type."""
    package, kind, name = msgtype.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(name: str) -> str:
    """Return the ROS message type of a DDS type; other names do not change."""
    parts = name.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        return name
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


def idl_struct(types: Types, msgtype: str, made: dict[str, Any] | None = None) -> Any:
    """Make the IDL type of a ROS message and its nested types, unless they are in `made`."""
    from cyclonedds.idl import make_idl_struct

    made = {} if made is None else made
    if msgtype not in made:
        if msgtype not in types:
            raise ValueError(f"the definition of {msgtype} is missing")
        fields = {
            name: _field(types, node, description, made)
            for name, (node, description) in types[msgtype][1]
        }
        made[msgtype] = make_idl_struct(msgtype.split("/")[-1] + "_", dds_type(msgtype), fields)
    return made[msgtype]


def _field(types: Types, node: Any, description: Any, made: dict[str, Any]) -> Any:
    """Return the IDL type of a field."""
    from cyclonedds.idl import types as idl
    from rosbags.interfaces import Nodetype

    if node == Nodetype.NAME:
        return idl_struct(types, description, made)
    if node == Nodetype.BASE:
        kind, bound = description
        if kind == "string":
            return idl.bounded_str[bound] if bound else str
        # ROS's byte and char are octets in IDL.
        if kind in ("byte", "char", "octet"):
            return idl.uint8
        return bool if kind == "bool" else getattr(idl, kind)
    (inner, of), count = description
    element = _field(types, inner, of, made)
    if node == Nodetype.ARRAY:
        return idl.array[element, count]
    return idl.sequence[element, count] if count else idl.sequence[element]


def raw_type(struct: Any) -> Any:
    """Make a type whose messages stay CDR bytes, for Cyclone's readers and writers.

    A recorder need not decode messages, and malformed bytes cannot make a reader fail. Cyclone asks
    a type for its name, its description, and conversion to and from bytes.
    """

    class RawMessage:
        __idl__: ClassVar[Any] = struct.__idl__
        __idl_typename__: ClassVar[str] = struct.__idl_typename__
        __slots__ = ("data", "sample_info")

        def __init__(self, data: bytes) -> None:
            self.data = data

        def serialize(self, **_: Any) -> bytes:
            return self.data

        @classmethod
        def deserialize(cls, data: bytes) -> RawMessage:
            return cls(data)

        deserialize_key = deserialize

    return RawMessage
