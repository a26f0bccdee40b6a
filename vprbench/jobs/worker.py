"""What a worker of a dask cluster does: makes one run in a process of its own, and tells the client how it goes."""

from __future__ import annotations

import shutil
import signal
import socket
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event

from distributed import Worker, get_worker

import vprbench
from vprbench.errors import BadInput
from vprbench.jobs.child import run_job
from vprbench.jobs.job import JobResult
from vprbench.runs.run_files import load, read_failure
from vprbench.runs.store import Store
from vprbench.storage.atomic import replace_bytes, scratch

_FRAMES = "frames"
_stopped: dict[str, Event] = {}  # by sweep


@dataclass(frozen=True)
class RemoteJob:
    """One run, as a client asks for it."""

    sweep: str  # the topic under which the client hears of it
    number: int
    options: tuple[str, ...]
    folder: str  # in which the client works
    shared: str  # a file that the client keeps in its results folder: a worker that sees it stores there
    version: str = vprbench.__version__


@dataclass(frozen=True)
class RemoteResult:
    """What came of a run."""

    result: JobResult
    files: dict[str, bytes] = field(default_factory=dict)  # that it stored, if the disks differ


def make(order: RemoteJob) -> RemoteResult:
    """Make a run; raises BadInput if this vprbench is not the client's."""
    host = socket.gethostname()
    if order.version != vprbench.__version__:
        raise BadInput(
            f"the worker on {host} has vprbench {vprbench.__version__}, this is {order.version}: "
            "install the same on both"
        )
    worker, stopped = get_worker(), _stopped.setdefault(order.sweep, Event())

    def tell(line: str | None) -> None:
        worker.log_event(order.sweep, {"run": order.number, "host": host, "line": line})

    tell(None)
    shared = Path(order.shared).exists()
    own = Path(worker.local_directory) / "results"  # removed with the worker
    result = run_job(
        order.options if shared else [*order.options, f"results={own}"],
        heard=tell,
        stopped=stopped.is_set,
        folder=order.folder if Path(order.folder).is_dir() else None,
    )
    return RemoteResult(result, {} if shared else taken_out(own))


def taken_out(results: Path) -> dict[str, bytes]:
    """Return the files of a worker's own results folder by their paths, and remove its runs and failures."""
    folders = _folders(results)
    paths = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    paths += (results / _FRAMES).glob("[!.]*")
    files = {path.relative_to(results).as_posix(): path.read_bytes() for path in paths}
    for folder in folders:
        shutil.rmtree(folder)
    return files


def put_in(files: dict[str, bytes], store: Store) -> None:
    """Store what a worker has taken out."""
    store.prepare()
    with scratch() as folder:
        for name, content in files.items():
            path, kept = folder / name, store.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            if path.parent.name == _FRAMES and not kept.exists():
                kept.parent.mkdir(exist_ok=True)
                replace_bytes(kept, content)
        for found in _folders(folder):
            failure = read_failure(found)
            if failure is None:
                store.save(load(found))
            else:
                store.save_failure(failure)


def _folders(results: Path) -> list[Path]:
    """Return the folders of runs and failures."""
    found = (folder for folder in results.glob("[!.]*/[!.]*") if folder.is_dir())
    return [folder for folder in found if folder.parent.name not in (_FRAMES, "descriptors")]


def stop(sweep: str) -> None:
    """Let the runs of a sweep that this worker makes end, as an interruption ends them."""
    _stopped.setdefault(sweep, Event()).set()


def dask_setup(_: Worker) -> None:
    """Let a worker of this machine outlive an interruption from the terminal: the client stops its runs, then it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
