"""The run of an experiment: from the store, or made now and stored."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.plugins import networks
from vprbench.progress import show_progress
from vprbench.runs import energy, stream, thumbnails
from vprbench.runs.experiment import Experiment, examine_dataset
from vprbench.runs.query_results import judge_answers, order_by_interest
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.run import execute
from vprbench.runs.run_lock import lock_run
from vprbench.runs.store import Store
from vprbench.runs.timing_lock import TimingLock, share_host

logger = logging.getLogger(__name__)


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


def get_or_run(experiment: Experiment, store: Store, lock: TimingLock | None = None) -> RunResult:
    """Return the run of an experiment from the store, or make and store it.

    Args:
        experiment: a run that is ready to be made.
        store: the results folder.
        lock: by which this process computes already; it does not wait while another one makes the run.

    Raises:
        HeldElsewhereError: another process makes the run, and this one holds a lock.
        UnstoredRunError: the run was made and the disk refuses it.
        BadInput: nothing can be written to the results folder; and whatever the method raises.
    """
    key, request, name = experiment.key(), experiment.request, experiment.dataset.name
    folder = store.folder(name, request.method_name, key)
    store = Store(store.root.absolute())  # a method may change the working folder

    run, from_store = find_run(experiment, store), True
    if run is None or request.list_views():  # the order of frames matters to sequences alone
        experiment = examine_dataset(experiment)
    if run is None:
        store.prepare(name)
        about = {"method": request.method_name, "dataset": name}
        about |= {name: getattr(request, name) for name in ("seed", "device", "corruption")}
        with lock_run(store.root, f"{name}/{folder.name}", about, wait=lock is None):
            run = find_run(experiment, store)  # another process may have made it meanwhile
            if run is None:
                run, from_store = _make_run(experiment, key, store, lock), False
    if from_store:
        run = replace(run, config={**run.config, "overrides": request.overrides})  # under the names of this request
    if request.frames:
        _keep_frames(store, run, experiment.dataset)
    return RunResult(run, folder, from_store)


def find_run(experiment: Experiment, store: Store) -> Run | None:
    """Return the stored run of an experiment if it has all that the request asks for."""
    request = experiment.request
    stored = None if request.force else store.find(experiment.dataset.name, request.method_name, experiment.key())
    return None if stored is None or list_missing_parts(stored, request) else stored


def list_missing_parts(run: Run, request: RunRequest) -> list[str]:
    """Return the names of the parts that a request asks for and a stored run lacks; none if the run answers it."""
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
    return [part for part, is_missing in lacks.items() if is_missing]


def _make_run(experiment: Experiment, key: str, store: Store, held: TimingLock | None) -> Run:
    """Make and store a run; parts of a stored one that this request does not ask for stay."""
    request, files = experiment.request, experiment.networks
    stored = store.find(experiment.dataset.name, request.method_name, key)
    if stored is not None and (missing := list_missing_parts(stored, request)):
        logger.info("%s on %s is stored without %s: running again", stored.method, stored.dataset, ", ".join(missing))
    if files.save is not None and networks.read_run_key(files.save) == key:
        # the network of this very run, left by a process that was killed before it stored the run
        files = replace(files, replace=True)
    needed = request.scores or bool(request.list_views())
    scores = needed or (stored is not None and stored.scores is not None)
    experiment = replace(experiment, request=replace(request, scores=scores), networks=files)

    with show_progress(f"{request.method_name} on {experiment.dataset.name}"), share_host(held) as lock:
        run = execute(experiment, key, lock)
        if stored is not None:
            run = replace(run, stream=stored.stream, energy=stored.energy)
        if experiment.stream:
            run = replace(run, stream=stream.grow_map(experiment))
        if request.energy:
            run = replace(run, energy=energy.find_costs(experiment, run, lock))
    try:
        store.save(run)
    except BadInput as error:
        raise UnstoredRunError(error, run) from error
    return run


def _keep_frames(store: Store, run: Run, dataset: Dataset) -> None:
    """Keep small pictures of the frames that the report shows of a run; without them the run is stored all the same."""
    try:
        with show_progress(dataset.name):
            thumbnails.save_thumbnails(store.root, run.fingerprint, dataset, order_by_interest(judge_answers(run)))
    except (OSError, BadInput) as error:
        reason = getattr(error, "strerror", None) or error
        logger.warning("note: no small pictures of %s were kept (%s)", dataset.name, reason)
