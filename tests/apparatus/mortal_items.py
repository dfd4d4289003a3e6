"""Items of campaigns that kill their workers, in a module that a new worker imports quickly."""

import os
import signal
import time
from pathlib import Path
from typing import Literal

from airpuck.boundary.errors import InputError
from airpuck.campaigns.items import Item


class Mortal(Item):
    """Records that it ran; some kill their worker, the first time or every time."""

    folder: str
    kills: Literal["never", "once", "always"] = "never"
    raises: bool = False

    def run(self):
        marks = Path(self.folder)
        before = len(list(marks.glob(f"{self.seed}-*")))
        (marks / f"{self.seed}-{before}").touch()
        time.sleep(0.05)
        if self.kills == "always" or (self.kills == "once" and before == 0):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.raises:
            raise InputError("is not to be had", field="figure")
        return [{"seed": float(self.seed)}]
