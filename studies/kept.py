"""Results that a study keeps in a file of JSON lines, so that it resumes where it was stopped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


class Kept:
    """The lines of a file, to which each result is added when found; without a file, in memory."""

    def __init__(self, file: Path | None) -> None:
        self._file = file
        text = file.read_text("utf-8") if file and file.is_file() else ""
        self.lines: list[dict[str, Any]] = [json.loads(line) for line in text.splitlines()]

    def have(self, **values: object) -> bool:
        """Whether a line has these values."""
        return any(all(line[key] == values[key] for key in values) for line in self.lines)

    def add(self, line: dict[str, Any]) -> None:
        """Append a result, here and to the file."""
        self.lines.append(line)
        if self._file:
            with self._file.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
