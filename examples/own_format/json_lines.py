"""A data format of your own: a log with one JSON object per line becomes a recording."""

import json
from pathlib import Path

from airpuck import Recording


def read_json_lines(path):
    """Read lines such as {"t": 0.01, "pose": [x, y, yaw]} and {"t": 0.01, "command": [...]}."""
    rows = [json.loads(line) for line in Path(path).read_text("utf-8").splitlines()]
    poses = [row for row in rows if "pose" in row]
    commands = [row for row in rows if "command" in row]
    return Recording.from_arrays(
        [row["t"] for row in poses],
        [row["pose"] for row in poses],
        [row["t"] for row in commands],
        [row["command"] for row in commands],
        source=str(path),
    )
