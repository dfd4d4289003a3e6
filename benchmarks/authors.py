"""The authors' training code, where its checkout and PyTorch are present."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path

#: Pattern of the line that their training prints after each epoch.
EPOCH = re.compile(r"Epoch (\d+):\s*elapse time = ([\d.]+)")


def epochs(checkout: Path, count: int = 2) -> list[float] | str:
    """Time epochs of ``run_learning.py`` with its own settings, or return why that is impossible.

    It runs in a folder of links to the checkout, so that its output does not stay there. It is
    stopped after `count` epochs.
    """
    script = checkout / "run_learning.py"
    if not script.is_file():
        return f"{script} is not there"
    if importlib.util.find_spec("torch") is None:
        return "PyTorch is not installed beside airpuck"
    with tempfile.TemporaryDirectory() as folder:
        for entry in checkout.resolve().iterdir():
            if entry.name != "models":
                (Path(folder) / entry.name).symlink_to(entry)
        (Path(folder) / "models").mkdir()
        process = subprocess.Popen(
            [sys.executable, "-u", "run_learning.py"],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        times, last = [], ""
        assert process.stdout is not None
        for line in process.stdout:
            last = line.strip() or last
            told = EPOCH.match(line)
            # Number 0 is the evaluation of the start.
            if told and int(told[1]) > 0:
                times.append(float(told[2]))
                if len(times) == count:
                    break
        process.kill()
        process.wait()
    return times or f"their training ended at once: {last}"
