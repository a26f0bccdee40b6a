"""The answer to one configuration: its run, from the store or made now, and printed."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack, chdir, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vprbench.api.checkpoints import ledger
from vprbench.api.dataset import Dataset
from vprbench.api.frame_cache import frames_kept
from vprbench.api.method import Method
from vprbench.data.doctor import insist
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.registry import METRICS
from vprbench.plugins import networks, registry
from vprbench.progress import overheard, progress_shown
from vprbench.run import energy, job, machine, runner, stream, thumbnails
from vprbench.run.adaptation import adaptation
from vprbench.run.corrupted_frames import corrupted
from vprbench.run.identity import Request, data_record, fingerprint, hashed
from vprbench.run.record import Failure, Run
from vprbench.run.run_lock import HeldElsewhereError, RunLock
from vprbench.run.sequences import views
from vprbench.run.settings import Settings, n_threads
from vprbench.run.store import Store, identity, insist_on_writing
from vprbench.run.verdicts import by_interest
from vprbench.storage.hashes import content_hash


class UnstoredRunError(BadInput):
    """A run was made and the store refused it; what was measured is not lost."""

    def __init__(self, why: BadInput, run: Run) -> None:
        """Say `why`, and hold the run."""
        super().__init__(str(why))
        self.run = run


class FailedElsewhereError(Exception):
    """Another process has tried the run meanwhile, and failed."""

    def __init__(self, failure: Failure) -> None:
        """Hold what became of it."""
        super().__init__(f"{failure.method} on {failure.dataset} failed in another process: {failure.error}")
        self.failure = failure


@dataclass(frozen=True)
class Made:
    """A run that was asked for, the folder that holds it, and whether it lay there already."""

    run: Run
    folder: Path
    from_store: bool


def answer(name: str, asked: dict[str, Any], settings: Settings, store: Store, say: Callable[[str], None]) -> str:
    """Find the run in the store or make it, say it, and return its key; raises what `find_or_make` raises."""
    try:
        made = find_or_make(name, asked, settings, store)
    except UnstoredRunError as error:
        say(_text(error.run, None, False, settings))
        raise
    say(_text(made.run, made.folder, made.from_store, settings))
    return made.run.key


def _text(*made: Any) -> str:
    from vprbench.run.answer_text import answer_text  # what it imports does not count as the run's memory

    return answer_text(*made)


def find_or_make(name: str, asked: dict[str, Any], settings: Settings, store: Store) -> Made:
    """Return the run of method `name` from the store, or make and store it; `asked` is its configuration.

    `asked` is told what method and dataset turned out to be. Raises BadInput for data that the cheap checks find wrong
    and if the run cannot be stored (UnstoredRunError if it was made by then), and what a run raises.
    """
    asked["method"], tuned_on = registry.declared(name, asked["method"])
    return made(_request(name, asked, settings, store), settings, store, tuned_on)


def made(request: Request, settings: Settings, store: Store, tuned_on: Mapping[str, Any]) -> Made:
    """Return the run of a request from the store, or make and store it; raises what `find_or_make` raises.

    While another process makes it this one waits; in a sweep it raises HeldElsewhereError instead. Raises
    FailedElsewhereError if that failed meanwhile.
    """
    refused = _refused(store)
    key, dataset = request.key(), request.dataset
    if request.files.save is not None and networks.made_by(request.files.save) == key:
        # its own, left by a run that was killed before it was stored
        request = replace(request, files=replace(request.files, replace=True))
    folder = store.folder(dataset.name, request.name, key)
    before = identity(folder)
    stored, found = _stored(request, key, settings, store)
    if found is None and refused is not None:
        raise refused

    with ExitStack() as held, ledger():  # what was trained is kept until the run is stored
        if found is None:
            lock, since = _locked(request, folder, store, held)
            if identity(folder) != before:  # another process was done just before
                stored, found = _stored(request, key, settings, store)
        if found is None:
            if since is not None and (failure := store.failure(request.name, dataset.name, request.config, since)):
                raise FailedElsewhereError(failure)
            run = replace(_run(request, settings, store, stored, lock, tuned_on), tuned_on=tuned_on)
        else:
            run = _told(found, request, tuned_on)
        # yaml and dataset may say so only since the run was stored
        known = found is not None and (refused or (found.tuned_on == tuned_on and _gaps(found) == _gaps(dataset)))
        if run.readouts is None and stored is not None:
            run = replace(run, readouts=stored.readouts)
        if run.stream is None and stored is not None:
            run = replace(run, stream=stored.stream)
        if run.energy is None and stored is not None:
            run = replace(run, energy=stored.energy)
        try:
            if not known:
                store.save(run)
        except BadInput as error:
            raise UnstoredRunError(error, run) from error
    if settings.frames:
        _keep_frames(store, run, dataset)
    return Made(run, folder, found is not None)


def _stored(request: Request, key: str, settings: Settings, store: Store) -> tuple[Run | None, Run | None]:
    """Return the stored run of a request, and again if it has all that was asked for."""
    stored = store.find(request.dataset.name, request.name, key)
    return stored, None if settings.force else _usable(stored, settings, request)


def _told(found: Run, request: Request, tuned_on: Mapping[str, Any]) -> Run:
    """Return a stored run with what is told of it now: whoever stored it may have asked in other words."""
    run = replace(found, config={**found.config, "overrides": request.config["overrides"]}, tuned_on=tuned_on)
    # of older ones too
    return replace(run, query_breaks=request.dataset.query_breaks, place_breaks=request.dataset.place_breaks)


def _locked(request: Request, folder: Path, store: Store, held: ExitStack) -> tuple[RunLock, float | None]:
    """Return the lock of the run that would lie in a folder, freed with `held`, and since when a failure counts.

    While another process holds the lock this process waits; in a sweep HeldElsewhereError is raised instead.
    """
    named = {name: request.config.get(name) for name in ("seed", "device", "corruption")}
    about = {"method": request.name, "dataset": request.dataset.name, **named}
    lock = RunLock(store.root, f"{request.dataset.name}/{folder.name}", about)
    since = None if job.current is None else job.current.since
    if not lock.acquire(wait=False):
        error = HeldElsewhereError(f"{request.name} on {request.dataset.name}", lock.path)
        if job.current is not None:
            raise error
        logging.info("%s: waiting for it", error)
        since = since or store.now()
        lock.acquire()
    held.enter_context(lock)
    return lock, since


def _run(
    request: Request,
    settings: Settings,
    store: Store,
    stored: Run | None,
    lock: RunLock,
    tuned_on: Mapping[str, Any],
) -> Run:
    """Make a run."""
    key, title = request.key(), f"{request.name} on {request.dataset.name}"
    needed = settings.scores or bool(views(settings.sequence, settings.filter))
    request = replace(request, scores=needed or (stored is not None and stored.scores is not None))  # which stay

    def keep(scored: Run) -> None:  # whatever becomes of its timing; a stored run stays until it can be replaced
        logging.info("%s on %s: %s; its times follow", scored.method, scored.dataset, _recall(scored))
        if stored is None:
            with suppress(BadInput):  # which is raised when it is stored with its times
                store.save(replace(scored, tuned_on=tuned_on))

    for place in (store.root / request.dataset.name, store.folder(request.dataset.name, request.name, key)):
        insist_on_writing(place)
    with progress_shown(title), overheard(lock.tell), chdir("."):
        run = runner.run(request, key, keep)
        run = replace(run, stream=stream.grown(request)) if request.stream else run
        if settings.energy:
            run = replace(run, energy=energy.costs(request, run))
    return run


def _request(name: str, asked: dict[str, Any], settings: Settings, store: Store) -> Request:
    """Return the run that is asked for, its method and dataset built; `asked` is told what both turned out to be."""
    entry = registry.entries("method").get(name)
    if entry is not None:
        asked["changed"] = entry.changed(asked["method"])
    with chdir("."), frames_kept(settings.cache):
        dataset = registry.make_dataset(asked["dataset"])
    return requested(name, registry.make_method, dataset, asked, settings, store)


def requested(
    name: str,
    build: Callable[[Mapping[str, Any]], Method],
    dataset: Dataset,
    asked: dict[str, Any],
    settings: Settings,
    store: Store,
) -> Request:
    """Return the run of a method, which `build` makes of its arguments; `asked` is told what it turned out to be.

    Raises BadInput for data that the cheap checks find wrong, and what `build` raises.
    """
    threads = n_threads(settings)
    machine.pin_threads(threads)
    files = networks.chosen_files(settings.save, settings.load, settings.force)
    with chdir("."):
        method = build(asked["method"])
        # what the cheap checks warn of is among the dataset's notes
        dataset = corrupted(replace(dataset, notes=(*dataset.notes, *insist(dataset))), settings.corruption)
        if needed := adaptation(method, dataset.n_places, asked):
            asked |= {"method": {**asked["method"], **needed}, "adapted": needed}
            method = build(asked["method"])
    with progress_shown(name):  # frames may have to be hashed, and a file be downloaded
        frames = hashed(dataset)
        images, data = fingerprint(dataset, frames), data_record(dataset, frames)
        asked["files"] = [[path.name, content_hash(path)] for path in method.files()]
    # absolute, for a method may change the working folder
    cache = store.root.absolute() / "descriptors" if settings.cache else None
    return Request(
        name,
        method,
        dataset,
        asked,
        images,
        settings.timing,
        threads,
        files,
        cache,
        stream=stream.step(settings.stream, method, dataset.n_places),
        readouts=settings.readouts,
        data=data,
    )


def _refused(store: Store) -> BadInput | None:
    """Return why nothing can be written to a store, None if it can; raises it if nothing can be read either."""
    try:
        store.prepare()
    except BadInput as error:
        if not os.path.isdir(store.root):  # noqa: PTH112 - Path's own complains of names that are too long
            raise
        return error
    return None


def _usable(run: Run | None, settings: Settings, request: Request) -> Run | None:
    """Return a stored run; None if it lacks a network to save, times, or what was asked for without a cache."""
    if run is None:
        return None
    if request.files.save is not None and not request.files.replace:
        logging.info("%s is stored without its network: running again for save=%s", run.method, request.files.save)
        return None
    if less := run.timed_by.shortfalls(request.protocol):
        timed = f"timed by less than asked for ({', '.join(less)})" if run.timed_by.rates else "not timed"
        logging.info("%s on %s is stored, %s: running again", run.method, run.dataset, timed)
        return None
    if settings.readouts and run.readouts is None:
        logging.info("%s is stored without its readouts: running again for readouts=true", run.method)
        return None
    if request.stream and request.stream != (run.stream or [{"places": 0}])[0]["places"]:
        logging.info("%s is stored without this growing map: running again for stream=%s", run.method, settings.stream)
        return None
    if settings.energy and run.energy is None:
        logging.info("%s is stored without its costs: running again for energy=true", run.method)
        return None
    if settings.scores and run.scores is None:
        logging.info("%s on %s is stored without its scores: running again for scores=true", run.method, run.dataset)
        return None
    if not settings.cache and run.fit_seconds is None and run.network is None:
        logging.info("%s is stored with descriptors of an earlier run: running again for cache=false", run.method)
        return None
    return run


def _gaps(told: Run | Dataset) -> list[list[int] | None]:
    return [None if gaps is None else gaps.tolist() for gaps in (told.query_breaks, told.place_breaks)]


def _recall(run: Run) -> str:
    first = recall_at(run.outcome, 1)
    return "R@1 is undefined" if first is None else f"R@1 {METRICS['recall_at_1'].text(first.expected)} %"


def _keep_frames(store: Store, run: Run, dataset: Dataset) -> None:
    """Keep small pictures of what the report shows of a run; if that fails, the run is stored all the same."""
    try:
        with progress_shown(dataset.name):
            thumbnails.keep(store.root, run.fingerprint, dataset, by_interest(run))
    except (OSError, BadInput) as error:
        reason = getattr(error, "strerror", None) or error
        logging.warning("note: no small pictures of %s were kept (%s)", dataset.name, reason)
