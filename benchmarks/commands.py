"""Each command as a whole process: its CPU time as a share of the peer's fit in the same run.

Both depend on the machine alike, and CPU time depends least on other processes. The table that the
results are compared with stands in README.md.
"""

from __future__ import annotations

import re
import signal
import subprocess
import time
import urllib.request
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from .process import AIRPUCK, Run, run, workload

README = Path(__file__).with_name("README.md")
#: Arguments of each command; BAG, MODEL and OUT stand for files.
COMMANDS = {
    "--help": "--help",
    "identify, missing recording": "identify nowhere",
    "identify, damaged vehicle file": "identify BAG --vehicle BAG/metadata.yaml",
    "preprocess": "preprocess BAG -o OUT.npz",
    "identify --model M3": "identify BAG --model M3 -o OUT.toml",
    "identify": "identify BAG -o OUT.toml",
    "evaluate": "evaluate MODEL BAG",
    "check": "check BAG",
    "faults": "faults BAG",
    "resid": "resid MODEL BAG",
    "present": "present MODEL",
    "track": "track MODEL",
    "race": "race MODEL",
    "plan": "plan MODEL --from -0.5 0 0 --to 0.5 0 0",
    "excite": "excite --truth MODEL --duration 10 -o OUT",
    "export": "export MODEL --to c -o OUT",
    "play, until its page answers": "play --no-browser --port PORT",
}
#: Ports are free with near certainty; a page that cannot listen ends with an error.
_PORT = 48_217
#: Share above the kept one from which a command got slower; repeated runs differ by a tenth.
_SLOWER = 1.25


def measured(name: str, folder: Path, environment: Mapping[str, str]) -> Run:
    """Run a command on files in a folder; status 2 counts as success for a rejected input."""
    bag, model, words = folder / "bag", folder / "m.toml", COMMANDS[name]
    if ("BAG" in words or "MODEL" in words) and not bag.exists():
        workload("bag", "--output", bag)
    if "MODEL" in words and not model.exists():
        run((*AIRPUCK, "identify", bag, "--model", "M3", "-o", model, "-q"))
    out = folder / f"out{time.monotonic_ns()}"
    files = {"BAG": bag, "MODEL": model, "OUT": out, "PORT": _PORT}
    words = re.sub("BAG|MODEL|OUT|PORT", lambda found: str(files[found[0]]), words)
    stop = _page_answered if "page" in name else None
    status = None if stop else 2 if "," in name else 0
    return run((*AIRPUCK, *words.split()), environment, status=status, until=stop)


def _page_answered(process: subprocess.Popen[bytes]) -> None:
    """Wait for the page, and stop the command."""
    while process.poll() is None:
        with suppress(OSError), urllib.request.urlopen(f"http://localhost:{_PORT}/", timeout=1):
            process.send_signal(signal.SIGINT)
            return
        time.sleep(0.02)


def kept() -> dict[str, float]:
    """Return the percentages in README.md by row, such as ``check, compiled``."""
    row = r"^\| `airpuck ([^`]*)`([^|]*)\|([^|]*)\|([^|]*)\|"
    found = {}
    for name, more, *shares in re.findall(row, README.read_text("utf-8"), re.M):
        for when, share in zip(("cold", "compiled"), shares, strict=True):
            if re.fullmatch(r" *[\d.]+ *", share):
                found[f"{name}{more.rstrip()}, {when}"] = float(share)
    return found


def slower(name: str, percent: float) -> str | None:
    """Return a sentence if a command takes more of the peer's time than the kept table says."""
    before = kept().get(name)
    if before is None or percent < _SLOWER * before:
        return None
    return f"{name}: {percent:.3g} % of the peer's fit, before {before:.3g} %"
