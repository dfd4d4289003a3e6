"""Recordings and the layout for Foxglove: every path in it is a field of what we record."""

import json
from operator import attrgetter
from pathlib import Path

import pytest
from mcap.reader import make_reader

from airpuck.live.process import EVENTS, HEARTBEATS
from airpuck.recording.bag import BagFile
from airpuck.recording.mapping import Topics
from airpuck.recording.message import HOLOHOVER_MOTORS, MessageCodec, StreamCodec, definitions

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove_layout.json"
STREAMS = {
    getattr(Topics(), kind): StreamCodec(
        kind, HOLOHOVER_MOTORS if kind == "command" else ()
    ).msgtype
    for kind in ("pose", "command", "reference", "estimate")
}
TYPES = STREAMS | {one.name: one.msgtype for one in (EVENTS, HEARTBEATS)}


def test_the_layout_plots_what_is_recorded():
    panels = json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    for path in paths:
        topic, field = path.split(".", 1)
        attrgetter(field)(MessageCodec(TYPES[topic]).message())
    shown = {path.split(".", 1)[0] for path in paths}
    shown |= {panel["topicToRender"] for panel in panels.values() if "topicToRender" in panel}
    assert shown == set(TYPES)


def test_every_panel_is_placed_once():
    content = json.loads(LAYOUT.read_text(encoding="utf-8"))

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(content["layout"])) == sorted(content["configById"])


@pytest.fixture
def mcap(tmp_path: Path) -> Path:
    bag = BagFile(tmp_path / "bag")
    for topic, msgtype in TYPES.items():
        codec = MessageCodec(msgtype)
        place = bag.add_topic(
            topic, msgtype, definitions(""), best_effort=False, transient_local=False
        )
        bag.add(place, 1, 1, codec.encode(codec.message()))
    bag.close()
    return next((tmp_path / "bag").glob("*.mcap"))


def test_recordings_contain_the_definition_of_every_message(mcap):
    with mcap.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == set(TYPES)
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert channel.message_encoding == "cdr"
        assert (schema.name, schema.encoding) == (TYPES[channel.topic], "ros2msg")
        # A viewer without ROS can read them: the definition is complete.
        known = definitions(schema.name, schema.data.decode())
        assert schema.name in known
        assert schema.data
