"""Work for a dask worker that ends its process: once, or always."""

import os
import signal
import uuid
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Kills:
    folder: Path  # holds a file for each attempt

    def __call__(self, always):
        attempts = self.folder / str(always)
        attempts.mkdir(exist_ok=True)
        (attempts / uuid.uuid4().hex).touch()
        if always or len([*attempts.iterdir()]) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return len([*attempts.iterdir()])
