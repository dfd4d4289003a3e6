"""Who is on the graph: participants and what they publish, as DDS tells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from airpuck.live.idl import ros_topic, ros_type

if TYPE_CHECKING:
    from uuid import UUID

_BATCH = 256


@dataclass(frozen=True)
class Endpoint:
    """Somebody who publishes on a topic."""

    #: Its own.
    key: UUID
    #: That of its process.
    participant: UUID
    #: ROS names.
    topic: str
    msgtype: str
    #: What it offers.
    reliable: bool
    transient_local: bool


class Discovery:
    """What DDS tells about other participants and their writers, kept up to date."""

    def __init__(self, participant: Any) -> None:
        from cyclonedds import builtin

        self._participants = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsParticipant
        )
        self._publications = builtin.BuiltinDataReader(
            participant, builtin.BuiltinTopicDcpsPublication
        )
        self._owners: dict[UUID, str] = {}
        self._endpoints: dict[UUID, Endpoint] = {}

    def publishers(self) -> Iterable[Endpoint]:
        """Return who publishes on ROS topics now."""
        from cyclonedds.core import InstanceState, Policy

        for item in self._publications.take(_BATCH):
            if item.sample_info.instance_state != InstanceState.Alive:
                self._endpoints.pop(item.key, None)
                continue
            topic = ros_topic(item.topic_name)
            if topic is None:
                continue
            self._endpoints[item.key] = Endpoint(
                item.key,
                item.participant_key,
                topic,
                ros_type(item.type_name),
                isinstance(item.qos[Policy.Reliability], Policy.Reliability.Reliable),
                item.qos[Policy.Durability] != Policy.Durability.Volatile,
            )
        return self._endpoints.values()

    def owner(self, participant: UUID) -> str:
        """Say who a participant is."""
        from cyclonedds.core import InstanceState, Policy

        for item in self._participants.take(_BATCH):
            if item.sample_info.instance_state != InstanceState.Alive:
                continue
            told = {policy.key: policy.value for policy in item.qos if _is_property(policy)}
            name = item.qos[Policy.EntityName].name if Policy.EntityName in item.qos else ""
            # A process that is none of ours: what Cyclone tells of it, if it is Cyclone's.
            self._owners[item.key] = name or (
                f"{told.get('__ProcessName', 'an unknown program')} "
                f"(process {told.get('__Pid', '?')} on {told.get('__Hostname', '?')})"
            )
        return self._owners.get(participant, f"an unknown program (participant {participant})")


def _is_property(policy: Any) -> bool:
    """Say whether a policy is one of the properties that a participant tells."""
    return type(policy).__name__ == "Property"
