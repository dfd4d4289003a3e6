"""The messages of a bag before they are decoded."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class TopicLog:
    """The messages of one topic before they are decoded."""

    msgtype: str
    #: The definition that the bag embeds; empty for none.
    definition: str = ""
    #: Whether the definition is IDL rather than the ``.msg`` format.
    idl: bool = False
    #: The recorder's times [ns since the epoch].
    received_ns: list[int] = field(default_factory=list)
    #: In CDR, with encapsulation.
    messages: list[bytes] = field(default_factory=list)


@dataclass
class Log:
    """What the files of a bag hold."""

    #: Messages of the wanted topics only.
    topics: dict[str, TopicLog] = field(default_factory=dict)
    #: Messages on all topics.
    n_messages: int = 0
    #: Earliest and latest recorder time of them [ns since the epoch].
    first_ns: int | None = None
    last_ns: int | None = None
    #: What was wrong, in a few words each.
    damage: list[str] = field(default_factory=list)

    def count(self, n_messages: int, first_ns: int, last_ns: int) -> None:
        """Add messages to the number and the span of time."""
        self.n_messages += n_messages
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def sort(self) -> None:
        """Put messages into the order of the recorder's clock, as readers of bags do."""
        for topic in self.topics.values():
            times = topic.received_ns
            order = sorted(range(len(times)), key=times.__getitem__)
            topic.received_ns = [times[index] for index in order]
            topic.messages = [topic.messages[index] for index in order]

    def extend(self, later: Log) -> None:
        """Append a later file of the same recording."""
        for name, topic in later.topics.items():
            mine = self.topics.setdefault(name, TopicLog(topic.msgtype))
            if not mine.definition:
                mine.definition, mine.idl = topic.definition, topic.idl
            mine.received_ns += topic.received_ns
            mine.messages += topic.messages
        if later.first_ns is not None and later.last_ns is not None:
            self.count(later.n_messages, later.first_ns, later.last_ns)
        self.damage += later.damage
