"""A run that one process asks of another: what is asked, and what came of it, as files of a folder."""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

FOLDER = "VPRBENCH_JOB"  # the environment variable that names the folder, for a process that makes a job
_ASKED, _RESULT = "job.json", "result.json"


@dataclass(frozen=True)
class Job:
    """What is asked of a process."""

    options: tuple[str, ...] = ()  # of the command line
    parent: int = 0  # the process that asks; the job ends with it

    def write(self, folder: Path) -> None:
        """Leave it for the process that makes it."""
        (folder / _ASKED).write_text(json.dumps(asdict(self)), encoding="utf-8")

    @classmethod
    def read(cls, folder: Path) -> Job:
        """Return the job of a folder."""
        asked = json.loads((folder / _ASKED).read_text(encoding="utf-8"))
        return cls(tuple(asked["options"]), asked["parent"])


@dataclass(frozen=True)
class JobResult:
    """What came of a job."""

    code: int  # 0: all that was asked for is stored
    missing: bool = False  # method, weights or frames are not there
    error: str = ""
    recorded: bool = False  # whether the store knows of the error
    key: str = ""  # of the run that is stored
    printed: str = ""  # what the job has to say on standard output
    held: str = ""  # the lock of another process that makes the run now: ask again once it is free

    def write(self, folder: Path) -> None:
        """Leave it for the process that asked."""
        partial = folder / f"{_RESULT}.partial"
        partial.write_text(json.dumps(asdict(self)), encoding="utf-8")
        partial.rename(folder / _RESULT)

    @classmethod
    def read(cls, folder: Path) -> JobResult | None:
        """Return the result that was left in a folder; None if the process has died before."""
        with contextlib.suppress(FileNotFoundError):
            return cls(**json.loads((folder / _RESULT).read_text(encoding="utf-8")))
        return None


current: Job | None = None  # the job that this process makes
