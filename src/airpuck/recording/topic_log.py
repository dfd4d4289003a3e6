"""One topic's messages before they are decoded."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class TopicLog:
    """The messages of one topic."""

    #: Message type.
    msgtype: str
    #: The definition that the bag embeds; empty for none.
    definition: str = ""
    #: Whether the definition is IDL rather than the ``.msg`` format.
    idl: bool = False
    #: The recorder's times [ns since the epoch].
    received_ns: list[int] = field(default_factory=list)
    #: In CDR, with encapsulation.
    messages: list[bytes] = field(default_factory=list)

    def sort(self) -> None:
        """Put the messages into the order of the recorder's clock, as MCAP readers do."""
        order = sorted(range(len(self.messages)), key=self.received_ns.__getitem__)
        self.received_ns = [self.received_ns[index] for index in order]
        self.messages = [self.messages[index] for index in order]

    def extend(self, other: TopicLog) -> None:
        """Append the messages of a later file of the same recording."""
        self.definition, self.idl = (
            (self.definition, self.idl) if self.definition else (other.definition, other.idl)
        )
        self.received_ns += other.received_ns
        self.messages += other.messages
