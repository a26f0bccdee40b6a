"""The run of an experiment: from the store, or made now and stored."""

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
from vprbench.runs import energy, stream, thumbnails
from vprbench.runs.experiment import Experiment
from vprbench.runs.query_results import judge_answers, order_by_interest
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.run import execute
from vprbench.runs.run_lock import HeldElsewhereError, RunLock
from vprbench.runs.sequences import parse_views
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


def get_or_run(experiment: Experiment, store: Store, wait: bool = True) -> RunResult:
    """Return the run of an experiment from the store, or make and store it.

    Args:
        experiment: a run that is ready to be made.
        store: the results folder.
        wait: whether this process waits while another one makes the run.

    Raises:
        HeldElsewhereError: another process makes the run, and this one does not wait.
        UnstoredRunError: the run was made and the disk refuses it.
        BadInput: nothing can be written to the results folder; and whatever the method raises.
    """
    key, dataset, name = experiment.key(), experiment.dataset, experiment.request.method_name
    refused = _why_not_writable(store, dataset)
    files = experiment.networks
    if files.save is not None and networks.read_run_key(files.save) == key:
        # the network of this very run, left by a process that was killed before it stored the run
        experiment = replace(experiment, networks=replace(files, replace=True))
    folder = store.folder(dataset.name, name, key)
    store = Store(store.root.absolute())  # a method may change the working folder
    stored = store.find(dataset.name, name, key)
    found = _complete(stored, experiment.request)
    if found is None and refused is not None:
        raise refused

    with ExitStack() as held:
        if found is None:
            lock = held.enter_context(_acquire_lock(experiment, folder, store, wait))
            stored = store.find(dataset.name, name, key)  # another process may have made it meanwhile
            found = _complete(stored, experiment.request)
        if found is None:
            run = _run(experiment, key, store, stored, lock)
            kept: dict[str, Any] = {
                part: getattr(stored, part, None) for part in _ON_REQUEST if getattr(run, part) is None
            }
            run = replace(run, **_tuning(experiment), **kept)
        else:
            run = _as_requested(found, experiment)
        # the method's yaml and the dataset may have changed what they declare since the run was stored
        if found is None or (refused is None and _declarations(run) != _declarations(found)):
            try:
                store.save(run)
            except BadInput as error:
                raise UnstoredRunError(error, run) from error
    if experiment.request.frames:
        _keep_frames(store, run, dataset)
    return RunResult(run, folder, found is not None)


def list_missing_parts(run: Run, request: RunRequest, dataset: Dataset | None = None) -> list[str]:
    """Return the names of what a request asks for and a stored run lacks; none if the run answers the request.

    With a `dataset`, what method and dataset declare counts too: a process that opens the store adds it to the run.
    """
    too_little = run.timed_by.shortfalls(request.timing)
    first_stop = (run.stream or [{"places": 0}])[0]["places"]
    step = stream.places_of_a_step(request.stream, run.outcome.n_places)
    saved = request.save is not None and networks.read_run_key(Path(request.save).expanduser()) == run.key
    lacks = {
        "its network": request.save is not None and not saved,
        f"enough timing ({', '.join(too_little)})": bool(too_little),
        f"a map that grows by {step} places": step not in (0, first_stop),
        "its costs": request.energy and run.energy is None,
        "its scores": request.scores and run.scores is None,
        "encoding, by descriptors of an earlier run": (
            not request.cache and run.fit_seconds is None and run.network is None
        ),
    }
    if dataset is not None:
        lacks |= {
            "the places that its method was tuned on": run.tuned_on != request.tuned_on,
            "the queries that show these places": run.tuned_queries is None and bool(request.tuned_on),
            "the gaps between its queries": run.query_breaks is None and dataset.query_breaks is not None,
        }
    return [part for part, missing in lacks.items() if missing]


def _complete(stored: Run | None, request: RunRequest) -> Run | None:
    """Return a stored run if it has all that is asked for."""
    return None if stored is None or request.force or list_missing_parts(stored, request) else stored


def _as_requested(found: Run, experiment: Experiment) -> Run:
    """Return a stored run with the options of this request, and with what method and dataset declare now."""
    return replace(
        found,
        config={**found.config, "overrides": experiment.request.overrides},
        **_tuning(experiment),
        query_breaks=experiment.dataset.query_breaks,
        place_breaks=experiment.dataset.place_breaks,
    )


def _tuning(experiment: Experiment) -> dict[str, Any]:
    """Return what a run records of the places that its method was tuned on."""
    return {"tuned_on": experiment.request.tuned_on, "tuned_queries": list(experiment.tuned_queries)}


def _declarations(run: Run) -> list[Any]:
    breaks = (run.query_breaks, run.place_breaks)
    return [run.tuned_on, run.tuned_queries, *(None if gaps is None else gaps.tolist() for gaps in breaks)]


def _acquire_lock(experiment: Experiment, folder: Path, store: Store, wait: bool) -> RunLock:
    """Return the lock of the run that lies, or would lie, in a folder, held by this process."""
    request, dataset = experiment.request, experiment.dataset
    named = {name: getattr(request, name) for name in ("seed", "device", "corruption")}
    about = {"method": request.method_name, "dataset": dataset.name, **named}
    lock = RunLock(store.root, f"{dataset.name}/{folder.name}", about)
    if not lock.acquire(wait=False):
        error = HeldElsewhereError(f"{request.method_name} on {dataset.name}", lock.path)
        if not wait:
            raise error
        logging.info("%s: waiting for it", error)
        lock.acquire()
    return lock


def _run(experiment: Experiment, key: str, store: Store, stored: Run | None, lock: RunLock) -> Run:
    """Make a run."""
    request, dataset = experiment.request, experiment.dataset
    if stored is not None and (missing := list_missing_parts(stored, request)):
        logging.info("%s on %s is stored without %s: running again", stored.method, stored.dataset, ", ".join(missing))
    needed = request.scores or bool(parse_views(request.sequence, request.filter))
    scores = needed or (stored is not None and stored.scores is not None)  # which stay
    experiment = replace(experiment, request=replace(request, scores=scores))

    def keep(scored: Run) -> None:  # whatever becomes of its timing; a stored run stays until it can be replaced
        logging.info("%s on %s: %s; its times follow", scored.method, scored.dataset, _recall(scored))
        if stored is None:
            with suppress(BadInput):  # which is raised when it is stored with its times
                store.save(replace(scored, **_tuning(experiment)))

    with progress_shown(f"{request.method_name} on {dataset.name}"), overheard(lock.tell):
        run = execute(experiment, key, keep)
        run = replace(run, stream=stream.grow_map(experiment)) if experiment.stream else run
        if request.energy:
            run = replace(run, energy=energy.find_costs(experiment, run))
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
            thumbnails.save_thumbnails(store.root, run.fingerprint, dataset, order_by_interest(judge_answers(run)))
    except (OSError, BadInput) as error:
        reason = getattr(error, "strerror", None) or error
        logging.warning("note: no small pictures of %s were kept (%s)", dataset.name, reason)
