"""The run of a request: from the store, or made now and stored."""

from __future__ import annotations

import logging
import os
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.registry import METRICS
from vprbench.plugins import networks
from vprbench.progress import overheard, progress_shown
from vprbench.runs import energy, runner, stream, thumbnails
from vprbench.runs.identity import Request
from vprbench.runs.query_results import by_interest, judged
from vprbench.runs.record import Run
from vprbench.runs.run_lock import HeldElsewhereError, RunLock
from vprbench.runs.sequences import views
from vprbench.runs.settings import Settings
from vprbench.runs.store import Store

_ON_REQUEST = ("stream", "energy")  # which a run keeps if it is run again without them


class UnstoredRunError(BadInput):
    """A run was made and the store refused it; what was measured is not lost."""

    def __init__(self, why: BadInput, run: Run) -> None:
        """Say `why`, and hold the run."""
        super().__init__(str(why))
        self.run = run


@dataclass(frozen=True)
class RunResult:
    """A run, the folder that holds it, and whether it was stored already."""

    run: Run
    folder: Path
    from_store: bool


def get_or_run(request: Request, settings: Settings, store: Store, wait: bool = True) -> RunResult:
    """Return the run of a request from the store, or make and store it.

    While another process makes the run this one waits, or without `wait` raises HeldElsewhereError. Raises BadInput if
    the run cannot be stored, UnstoredRunError if it was made by then, and what the method raises.
    """
    key, dataset = request.key(), request.dataset
    refused = _why_not_writable(store, dataset)
    if request.files.save is not None and networks.read_run_key(request.files.save) == key:
        # the network of this very run, left by a process that was killed before it stored the run
        request = replace(request, files=replace(request.files, replace=True))
    folder = store.folder(dataset.name, request.name, key)
    store = Store(store.root.absolute())  # a method may change the working folder
    stored = store.find(dataset.name, request.name, key)
    found = _complete(stored, request, settings)
    if found is None and refused is not None:
        raise refused

    with ExitStack() as held:
        if found is None:
            lock = held.enter_context(_acquired_lock(request, folder, store, wait))
            stored = store.find(dataset.name, request.name, key)  # another process may have made it meanwhile
            found = _complete(stored, request, settings)
        if found is None:
            run = _run(request, settings, store, stored, lock)
            kept: dict[str, Any] = {
                name: getattr(stored, name, None) for name in _ON_REQUEST if getattr(run, name) is None
            }
            run = replace(run, **_tuning(request), **kept)
        else:
            run = _as_requested(found, request)
        # the method's yaml and the dataset may have changed what they declare since the run was stored
        if found is None or (refused is None and _declarations(run) != _declarations(found)):
            try:
                store.save(run)
            except BadInput as error:
                raise UnstoredRunError(error, run) from error
    if settings.frames:
        _keep_frames(store, run, dataset)
    return RunResult(run, folder, found is not None)


def missing_parts(run: Run, request: Request, settings: Settings) -> list[str]:
    """Return the names of what a request asks for and a stored run lacks; none if the run answers the request."""
    too_little = run.timed_by.shortfalls(request.protocol)
    first_stop = (run.stream or [{"places": 0}])[0]["places"]
    lacks = {
        "its network": request.files.save is not None and not request.files.replace,
        f"enough timing ({', '.join(too_little)})": bool(too_little),
        f"a map that grows by {request.stream} places": request.stream not in (0, first_stop),
        "its costs": settings.energy and run.energy is None,
        "its scores": settings.scores and run.scores is None,
        "encoding, by descriptors of an earlier run": (
            not settings.cache and run.fit_seconds is None and run.network is None
        ),
    }
    return [part for part, missing in lacks.items() if missing]


def _complete(stored: Run | None, request: Request, settings: Settings) -> Run | None:
    """Return a stored run if it has all that is asked for."""
    if stored is None or settings.force or missing_parts(stored, request, settings):
        return None
    return stored


def _as_requested(found: Run, request: Request) -> Run:
    """Return a stored run with the options of this request, and with what method and dataset declare now."""
    return replace(
        found,
        config={**found.config, "overrides": request.config["overrides"]},
        **_tuning(request),
        query_breaks=request.dataset.query_breaks,
        place_breaks=request.dataset.place_breaks,
    )


def _tuning(request: Request) -> dict[str, Any]:
    """Return what a run records of the places that its method was tuned on."""
    return {"tuned_on": request.tuned_on, "tuned_queries": list(request.tuned_queries)}


def _declarations(run: Run) -> list[Any]:
    breaks = (run.query_breaks, run.place_breaks)
    return [run.tuned_on, run.tuned_queries, *(None if gaps is None else gaps.tolist() for gaps in breaks)]


def _acquired_lock(request: Request, folder: Path, store: Store, wait: bool) -> RunLock:
    """Return the lock of the run that lies, or would lie, in a folder, held by this process.

    While another process holds it this one waits, or without `wait` raises HeldElsewhereError.
    """
    named = {name: request.config.get(name) for name in ("seed", "device", "corruption")}
    about = {"method": request.name, "dataset": request.dataset.name, **named}
    lock = RunLock(store.root, f"{request.dataset.name}/{folder.name}", about)
    if not lock.acquire(wait=False):
        error = HeldElsewhereError(f"{request.name} on {request.dataset.name}", lock.path)
        if not wait:
            raise error
        logging.info("%s: waiting for it", error)
        lock.acquire()
    return lock


def _run(request: Request, settings: Settings, store: Store, stored: Run | None, lock: RunLock) -> Run:
    """Make a run."""
    key, title = request.key(), f"{request.name} on {request.dataset.name}"
    if stored is not None and not settings.force:
        missing = ", ".join(missing_parts(stored, request, settings))
        logging.info("%s is stored without %s: running again", title, missing)
    needed = settings.scores or bool(views(settings.sequence, settings.filter))
    request = replace(request, scores=needed or (stored is not None and stored.scores is not None))  # which stay

    def keep(scored: Run) -> None:  # whatever becomes of its timing; a stored run stays until it can be replaced
        logging.info("%s on %s: %s; its times follow", scored.method, scored.dataset, _recall(scored))
        if stored is None:
            with suppress(BadInput):  # which is raised when it is stored with its times
                store.save(replace(scored, **_tuning(request)))

    with progress_shown(title), overheard(lock.tell):
        run = runner.run(request, key, keep)
        run = replace(run, stream=stream.grown(request)) if request.stream else run
        if settings.energy:
            run = replace(run, energy=energy.costs(request, run))
    return run


def _why_not_writable(store: Store, dataset: Dataset) -> BadInput | None:
    """Return why no run on a dataset can be stored, None if it can; raises it if nothing can be read either."""
    try:
        store.prepare(dataset.name)
    except BadInput as error:
        if not os.path.isdir(store.root):  # noqa: PTH112 - Path's own complains of names that are too long
            raise
        return error
    return None


def _recall(run: Run) -> str:
    first = recall_at(run.outcome, 1)
    return "R@1 is undefined" if first is None else f"R@1 {METRICS['recall_at_1'].text(first.expected)} %"


def _keep_frames(store: Store, run: Run, dataset: Dataset) -> None:
    """Keep small pictures of what the report shows of a run; if that fails, the run is stored all the same."""
    try:
        with progress_shown(dataset.name):
            thumbnails.keep(store.root, run.fingerprint, dataset, by_interest(judged(run)))
    except (OSError, BadInput) as error:
        reason = getattr(error, "strerror", None) or error
        logging.warning("note: no small pictures of %s were kept (%s)", dataset.name, reason)
