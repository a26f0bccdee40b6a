"""The run of an experiment: from the store, or made now and stored."""

from __future__ import annotations

import logging
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.catalogue import METRICS
from vprbench.plugins import networks
from vprbench.progress import progress_shown
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
    """A run was made and the store refused it; its numbers are not lost."""

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
    key, request, dataset = experiment.key(), experiment.request, experiment.dataset
    folder = store.folder(dataset.name, request.method_name, key)
    store = Store(store.root.absolute())  # a method may change the working folder

    def find() -> tuple[Run | None, bool]:
        """Return the stored run, and whether it answers the request."""
        stored = store.find(dataset.name, request.method_name, key)
        return stored, stored is not None and not request.force and not list_missing_parts(stored, request)

    stored, from_store = find()
    with ExitStack() as held:
        if not from_store:
            store.prepare(dataset.name)
            held.enter_context(_acquire_lock(experiment, folder, store, wait))
            stored, from_store = find()  # another process may have made it meanwhile
        if stored is not None and from_store:
            run = _refresh(stored, experiment, store)
        else:
            run = _make(experiment, key, store, stored)
            try:
                store.save(run)
            except BadInput as error:
                raise UnstoredRunError(error, run) from error
    if request.frames:
        _keep_frames(store, run, dataset)
    return RunResult(run, folder, from_store)


def list_missing_parts(run: Run, request: RunRequest, dataset: Dataset | None = None) -> list[str]:
    """Return the names of the parts that a request asks for and a stored run lacks; none if the run answers it.

    With a `dataset`, declarations of method and dataset count too: a process that opens the store adds them to the run.
    """
    too_little = run.timed_by.shortfalls(request.timing)
    first_stop = (run.stream or [{"places": 0}])[0]["places"]
    step = stream.count_step_places(request.stream, run.outcome.n_places)
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


def _refresh(stored: Run, experiment: Experiment, store: Store) -> Run:
    """Return a stored run with the options of this request, and with the declarations of method and dataset today.

    The run is stored again if the declarations have changed, and the results folder can be written.
    """
    request, dataset = experiment.request, experiment.dataset
    run = replace(
        stored,
        config={**stored.config, "overrides": request.overrides},
        **_list_tuning(experiment),
        query_breaks=dataset.query_breaks,
        place_breaks=dataset.place_breaks,
    )
    if _list_declarations(run) != _list_declarations(stored):
        with suppress(BadInput):
            store.save(run)
    return run


def _list_tuning(experiment: Experiment) -> dict[str, Any]:
    """Return the fields of a run on the places that its method was tuned on."""
    return {"tuned_on": experiment.request.tuned_on, "tuned_queries": list(experiment.tuned_queries)}


def _list_declarations(run: Run) -> list[Any]:
    breaks = (run.query_breaks, run.place_breaks)
    return [run.tuned_on, run.tuned_queries, *(None if gaps is None else gaps.tolist() for gaps in breaks)]


def _make(experiment: Experiment, key: str, store: Store, stored: Run | None) -> Run:
    """Make a run; parts of a `stored` one that this request does not ask for stay."""
    request, files = experiment.request, experiment.networks
    if stored is not None and (missing := list_missing_parts(stored, request)):
        logging.info("%s on %s is stored without %s: running again", stored.method, stored.dataset, ", ".join(missing))
    if files.save is not None and networks.read_run_key(files.save) == key:
        # the network of this very run, left by a process that was killed before it stored the run
        files = replace(files, replace=True)
    needed = request.scores or bool(parse_views(request.sequence, request.filter))
    scores = needed or (stored is not None and stored.scores is not None)
    experiment = replace(experiment, request=replace(request, scores=scores), networks=files)

    def keep(scored: Run) -> None:
        """Store the answers before they are timed; a stored run stays until the new one is whole."""
        logging.info("%s on %s: %s; its times follow", scored.method, scored.dataset, _format_recall(scored))
        if stored is None:
            with suppress(BadInput):  # which is raised when it is stored with its times
                store.save(replace(scored, **_list_tuning(experiment)))

    with progress_shown(f"{request.method_name} on {experiment.dataset.name}"):
        run = replace(execute(experiment, key, keep), **_list_tuning(experiment))
        if experiment.stream:
            run = replace(run, stream=stream.grow_map(experiment))
        if request.energy:
            run = replace(run, energy=energy.find_costs(experiment, run))
    kept: dict[str, Any] = {part: getattr(stored, part, None) for part in _ON_REQUEST if getattr(run, part) is None}
    return replace(run, **kept)


def _format_recall(run: Run) -> str:
    first = recall_at(run.outcome, 1)
    return "R@1 is undefined" if first is None else f"R@1 {METRICS['recall_at_1'].text(first.expected)} %"


def _keep_frames(store: Store, run: Run, dataset: Dataset) -> None:
    """Keep small pictures of the frames that the report shows of a run; without them the run is stored all the same."""
    try:
        with progress_shown(dataset.name):
            thumbnails.save_thumbnails(store.root, run.fingerprint, dataset, order_by_interest(judge_answers(run)))
    except (OSError, BadInput) as error:
        reason = getattr(error, "strerror", None) or error
        logging.warning("note: no small pictures of %s were kept (%s)", dataset.name, reason)
