"""The answer to one configuration: its run, from the store or made now, and printed."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import chdir, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vprbench import ending
from vprbench.api.checkpoints import ledger
from vprbench.api.dataset import Dataset
from vprbench.api.frame_cache import frames_kept
from vprbench.api.method import Method
from vprbench.data.doctor import insist
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.registry import METRICS
from vprbench.plugins import networks, registry
from vprbench.progress import progress_shown
from vprbench.run import machine, runner, thumbnails
from vprbench.run.adaptation import adaptation
from vprbench.run.corrupted_frames import corrupted
from vprbench.run.identity import Request, data_record, fingerprint, hashed
from vprbench.run.record import Run
from vprbench.run.sequences import views
from vprbench.run.settings import Settings, n_threads
from vprbench.run.store import Store, insist_on_writing
from vprbench.run.verdicts import by_interest
from vprbench.storage.hashes import content_hash
from vprbench.terminal.console import table_text, told


class UnstoredRunError(BadInput):
    """A run was made and the store refused it; what was measured is not lost."""

    def __init__(self, why: BadInput, run: Run) -> None:
        """Say `why`, and hold the run."""
        super().__init__(str(why))
        self.run = run


@dataclass(frozen=True)
class Made:
    """A run that was asked for, the folder that holds it, and whether it lay there already."""

    run: Run
    folder: Path
    from_store: bool


def answer(name: str, asked: dict[str, Any], settings: Settings, store: Store, say: Callable[[str], None]) -> int:
    """Find the run in the store or make it, and say it; raises what `find_or_make` raises."""
    try:
        made = find_or_make(name, asked, settings, store)
    except UnstoredRunError as error:
        say(_text(error.run, None, False, settings))
        raise
    say(_text(made.run, made.folder, made.from_store, settings))
    return 0


def find_or_make(name: str, asked: dict[str, Any], settings: Settings, store: Store) -> Made:
    """Return the run of method `name` from the store, or make and store it; `asked` is its configuration.

    `asked` is told what method and dataset turned out to be. Raises BadInput for data that the cheap checks find wrong
    and if the run cannot be stored (UnstoredRunError if it was made by then), and what a run raises.
    """
    asked["method"], tuned_on = registry.declared(name, asked["method"])
    return made(_request(name, asked, settings, store), settings, store, tuned_on)


def made(request: Request, settings: Settings, store: Store, tuned_on: Mapping[str, Any]) -> Made:
    """Return the run of a request from the store, or make and store it; raises what `find_or_make` raises."""
    process, refused = os.getpid(), _refused(store)
    key, dataset = request.key(), request.dataset
    if request.files.save is not None and networks.made_by(request.files.save) == key:
        # its own, left by a run that was killed before it was stored
        request = replace(request, files=replace(request.files, replace=True))
    stored = store.find(dataset.name, request.name, key)
    found = None if settings.force else _usable(stored, settings, request)
    if found is None and refused is not None:
        raise refused

    needed = settings.scores or bool(views(settings.sequence, settings.filter))
    request = replace(request, scores=needed or (stored is not None and stored.scores is not None))  # which stay

    def keep(scored: Run) -> None:  # whatever becomes of its timing; a stored run stays until it can be replaced
        ending.leave_if_forked(process)
        logging.info("%s on %s: %s; its times follow", scored.method, scored.dataset, _recall(scored))
        if stored is None:
            with suppress(BadInput):  # which is raised when it is stored with its times
                store.save(replace(scored, tuned_on=tuned_on))

    with ledger():  # what was trained is kept until the run is stored
        if found is not None:  # whoever stored it may have asked in other words
            run = replace(found, config={**found.config, "overrides": request.config["overrides"]})
            # of older ones too
            run = replace(run, query_breaks=dataset.query_breaks, place_breaks=dataset.place_breaks)
        else:
            for place in (store.root / dataset.name, store.folder(dataset.name, request.name, key)):
                insist_on_writing(place)
            with progress_shown(f"{request.name} on {dataset.name}"), chdir("."):
                run = runner.run(request, key, keep)
        ending.leave_if_forked(process)  # a plug-in's fork has the same run to store
        # yaml and dataset may say so only since the run was stored
        known = found is not None and (refused or (found.tuned_on == tuned_on and _gaps(found) == _gaps(dataset)))
        run = replace(run, tuned_on=tuned_on)
        if run.readouts is None and stored is not None:
            run = replace(run, readouts=stored.readouts)
        try:
            folder = store.folder(dataset.name, request.name, key) if known else store.save(run)
        except BadInput as error:
            raise UnstoredRunError(error, run) from error
    ending.tell(code=0, key=key)
    if settings.frames:
        _keep_frames(store, run, dataset)
    return Made(run, folder, found is not None)


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


def _text(run: Run, folder: Path | None, from_store: bool, settings: Settings) -> str:
    from vprbench.run import readout_rows, rows  # what they import does not count as the run's memory
    from vprbench.run.tuned import all_notes

    seen = [view(run) for view in views(settings.sequence, settings.filter)]
    if settings.output == "json":
        return json.dumps(
            {
                "method": run.method,
                "dataset": run.dataset,
                "protocol": dict(run.protocol),
                "data": dict(run.data),
                **rows.numbers(run, settings.metrics),
                "readouts": readout_rows.readout_numbers(run),
                "network": run.network,
                "tuned_on": run.tuned_on or None,
                "notes": [note._asdict() for note in all_notes(run)],
                **({"views": [_viewed(one, settings) for one in seen]} if seen else {}),
                "from_store": from_store,
                "run_folder": None if folder is None else str(folder),
            },
            allow_nan=False,
        )
    shown = seen or [run]
    table = [rows.readable_row(one, settings.metrics) for one in shown]
    if seen:
        table = [{"answers": rows.view_words(one), **row} for one, row in zip(seen, table, strict=True)]
    notes = [(f"note: {note.text}", "yellow") for note in all_notes(shown[0])]
    said = [*notes, (rows.protocol_line(run), "")]
    said += [(f"{rows.view_words(one, whole=True)}: {len(one.outcome)} queries", "") for one in seen]
    below = list(filter(None, (line(one) for one in shown for line in (rows.interval_line, rows.tolerance_line))))
    if from_store:
        below.append(f"from the store: {folder} (force=true runs again)")
    elif folder is not None:
        below.append(f"stored in {folder}")
    tables = [table_text([*table[0]], [[*row.values()] for row in table], settings.wide, rows.LEAST)]
    if settings.readouts:
        tables.append(readout_rows.readout_text(run))
    return "\n".join([*(told(*each) for each in said), *tables, *map(told, below)])


def _viewed(view: Run, settings: Settings) -> dict[str, Any]:
    from vprbench.run import rows

    return {"protocol": dict(view.protocol), **rows.numbers(view, settings.metrics)}
