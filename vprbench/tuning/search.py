"""The search itself: random settings, then a grid around the best, then best and paper on places held back."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.paper.plan import read_plan
from vprbench.plugins import registry
from vprbench.runs import machine
from vprbench.runs.identity import code_hash, fingerprint
from vprbench.runs.run_files import content_key
from vprbench.runs.sources import hash_files
from vprbench.runs.store import Store
from vprbench.storage.cores import core_count
from vprbench.tuning import objective, places, space
from vprbench.tuning.comparison import Comparison, compared
from vprbench.tuning.objective import StretchName, Task, Tried
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import Values
from vprbench.tuning.study import Stage, Study, Trial, best_of, opened
from vprbench.tuning.workers import Workers

if TYPE_CHECKING:
    from vprbench.jobs.cluster import DaskExecutor

logger = logging.getLogger(__name__)

_ATTEMPTS = 3  # at settings whose trial failed, before they are left out
_ALL_FAIL = 5  # trials of a stage that fail before any ends: something is wrong with all of them


@dataclass(frozen=True)
class Found:
    """What a search found."""

    settings: Settings
    method: Mapping[str, Any]  # its configuration, before settings replace arguments
    dataset: Mapping[str, Any]  # its configuration, before the places to search were chosen
    protocols: Mapping[StretchName, Mapping[str, Any]]  # the dataset's, of each stretch
    folder: Path  # of the study
    trials: tuple[Trial, ...]  # all that are stored
    tried_now: int  # how many of them this call tried
    best: Trial
    importance: Mapping[str, float]  # by parameter, the largest first
    compared: Mapping[StretchName, Comparison]
    queried_by: tuple[str, ...]  # stored runs that query these places
    jobs: int  # processes that there were
    minutes: float  # of this call
    environment: Mapping[str, Any]


def search(settings: Settings, method: Mapping[str, Any], dataset: Mapping[str, Any]) -> Found:
    """Search the best settings of a method, or go on with an earlier search of the same.

    `method` is a configuration of the method that conf/search.yaml names, `dataset` that of the dataset named in the
    settings. Raises BadInput if its places are not free to be searched.
    """
    started = time.perf_counter()
    jobs = _jobs(settings.jobs)
    surroundings = machine.describe_machine("cpu", 1)
    columns = read_plan(registry.conf_folders()["vprbench"] / "table.yaml").columns.values()
    allowed = places.searchable(settings.dataset, dataset, settings.places, columns)
    whole = registry.make_dataset(allowed.dataset)
    stretches = {name: places.cut(whole, stretch) for name, stretch in _named(allowed).items()}
    method = {**method, "seed": settings.seed, "device": "cpu"}
    encoder = registry.make_method(method)
    results = Path(settings.results).expanduser()
    folder = results / "search" / content_key(_origin(settings.seed, method, encoder, stretches))
    with opened(folder) as study:
        for name, part in stretches.items():
            objective.keep(folder / name, part, encoder)
        attempt = objective.Training(folder.absolute(), method)
        with _executor(settings) as dask, _workers(attempt, jobs, dask) as workers:
            tried_now = explore(study, workers, settings.trials, settings.seed)
            trials = study.trials()
            best = best_of(trials)
            if best is None:
                raise RuntimeError("no trial came to an end")
            n_places = {name: part.n_places for name, part in stretches.items()}
            comparisons = compared(workers, best.values, n_places, settings.seed)
            started_jobs = workers.started
        importance = study.importance()
    return Found(
        settings=settings,
        method=method,
        dataset=dataset,
        protocols={name: part.protocol for name, part in stretches.items()},
        folder=folder,
        trials=tuple(trials),
        tried_now=tried_now,
        best=best,
        importance=importance,
        compared=comparisons,
        queried_by=tuple(places.querying(Store(results).runs(), allowed)),
        jobs=started_jobs,
        minutes=(time.perf_counter() - started) / 60,
        environment=surroundings,
    )


def _origin(
    seed: int, method: Mapping[str, Any], encoder: Method, stretches: Mapping[StretchName, Dataset]
) -> dict[str, Any]:
    """Return what decides the trials of a search."""
    return {
        "method": {name: value for name, value in method.items() if name != "_target_"},
        "code": [code_hash(type(encoder)), hash_files([Path(objective.__file__)])],
        "stretches": {name: [dict(part.protocol), fingerprint(part)] for name, part in stretches.items()},
        "space": [asdict(parameter) for parameter in space.PARAMETERS],
        "seed": seed,
        "libraries": {**machine.library_versions(), "optuna": optuna.__version__},
    }


def explore(study: Study, workers: Workers[Task, Tried], trials: int, seed: int) -> int:
    """Try random settings, then a grid around the best of them, until `trials` are stored; returns how many it tried.

    Settings that a killed process was trying, and settings whose trial fails, are tried again, a few times.
    """
    n_random = trials - trials // 3
    tried = _stage(study, workers, "random", space.drawn(n_random, seed), trials)
    best = best_of(study.trials(), "random")
    if best is not None:
        grid = list(islice(space.around(best.values), 2 * trials))  # of which some may have been tried before
        tried += _stage(study, workers, "grid", grid, trials)
    return tried


def _stage(study: Study, workers: Workers[Task, Tried], stage: Stage, points: Sequence[Values], trials: int) -> int:
    """Try settings that were not tried yet, in their order, as long as there is room for trials.

    Raises RuntimeError if the first few all fail.
    """
    tried = 0
    failures: Counter[int] = Counter()  # by point
    while todo := _untried(study.trials(), points, failures, trials):
        begun: dict[int, int] = {}

        def begin(task: int, todo: list[int] = todo, begun: dict[int, int] = begun) -> None:
            begun[task] = study.begin(stage, todo[task], points[todo[task]])

        progress.report(f"{stage} settings", 0.0)
        tasks = [Task("searched", points[point]) for point in todo]
        for done, answer in enumerate(workers.answers(tasks, begin), 1):
            if answer.given is None:
                study.fail(begun[answer.task], answer.error)
                failures[todo[answer.task]] += 1
                if failures.total() == _ALL_FAIL and not tried:
                    raise RuntimeError(f"the first {_ALL_FAIL} trials failed; the last: {answer.error}")
            else:
                study.end(begun[answer.task], answer.given.recall_at_1, answer.given.diverged)
                tried += 1
            progress.report(f"{stage} settings", done / len(todo))
    return tried


def _untried(trials: Sequence[Trial], points: Sequence[Values], failures: Mapping[int, int], most: int) -> list[int]:
    """Return which points are left to try, as many as there is room for."""
    done = [trial.values for trial in trials if trial.recall_at_1 is not None]
    left = [
        number for number, values in enumerate(points) if values not in done and failures.get(number, 0) < _ATTEMPTS
    ]
    return left[: max(0, most - len(done))]


def _jobs(requested: int | None) -> int:
    """Return how many processes there may be: at most one for each core."""
    cores = core_count()
    if requested is not None and requested > cores:
        used = "1 process is used" if cores == 1 else f"{cores} processes are used"
        logger.info("jobs=%d: %s, one for each core that is there for this process", requested, used)
    return min(requested or cores, cores)


def _executor(settings: Settings) -> AbstractContextManager[DaskExecutor | None]:
    """Return the cluster that settings are tried on, None for processes of this search."""
    if not settings.is_distributed:
        return nullcontext()
    from vprbench.jobs.cluster import DaskExecutor

    return DaskExecutor(settings)


def _workers(attempt: objective.Training, jobs: int, dask: DaskExecutor | None) -> Workers[Task, Tried]:
    return Workers(attempt, jobs) if dask is None else Workers(attempt, dask.room(), dask.of_functions)


def _named(allowed: places.Searchable) -> dict[StretchName, range]:
    return {"searched": allowed.searched, "checked": allowed.checked}
