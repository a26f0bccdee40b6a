"""The search itself: random settings, then a grid around the best, then best and paper on places held back."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.plugins import registry
from vprbench.report.plan import read_plan
from vprbench.runs import machine
from vprbench.runs.identity import code_hash, fingerprint
from vprbench.runs.run_files import content_key
from vprbench.runs.sources import hash_files
from vprbench.runs.store import Store
from vprbench.storage.cores import core_count
from vprbench.tuning import objective, places, space
from vprbench.tuning.comparison import Comparison, compare_with_paper
from vprbench.tuning.objective import StretchName, Task, Tried
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PARAMETERS, Values
from vprbench.tuning.study import Stage, Trial, find_best, list_trials, open_study, rank_parameters

logger = logging.getLogger(__name__)

Attempt = Callable[[Task], Tried]

_KNOWN = (TrialState.COMPLETE, TrialState.FAIL, TrialState.WAITING)


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
    jobs = _jobs(settings.jobs or settings.workers)
    surroundings = machine.describe_machine("cpu", 1)
    columns = read_plan(registry.conf_folders()["vprbench"] / "table.yaml").columns.values()
    allowed = places.searchable(settings.dataset, dataset, settings.places, columns)
    whole = registry.make_dataset(allowed.dataset)
    stretches = {name: places.cut(whole, stretch) for name, stretch in _named(allowed).items()}
    method = {**method, "seed": settings.seed, "device": "cpu"}
    encoder = registry.make_method(method)
    results = Path(settings.results).expanduser()
    folder = results / "search" / content_key(_origin(settings.seed, method, encoder, stretches))
    with open_study(folder) as study:
        for name, part in stretches.items():
            objective.keep(folder / name, part, encoder)
        attempt = objective.Training(folder.absolute(), method)
        with _open_executor(settings, jobs) as (executor, jobs):
            tried_now = explore(study, executor, attempt, settings.trials, settings.seed, jobs)
            trials = list_trials(study)
            best = find_best(trials)
            assert best is not None
            n_places = {name: part.n_places for name, part in stretches.items()}
            comparisons = compare_with_paper(executor, attempt, best.values, n_places, settings.seed)
        importance = rank_parameters(study)
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
        jobs=jobs,
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


def explore(study: optuna.Study, executor: Executor, attempt: Attempt, trials: int, seed: int, jobs: int) -> int:
    """Try random settings, then a grid around the best of them, until `trials` are stored; returns how many it tried.

    Optuna asks for the settings and keeps the answers; `jobs` of them are tried at a time, by `executor`. Raises
    RuntimeError if all trials of a stage fail.
    """
    n_random = trials - trials // 3
    tried = _try_stage(study, executor, attempt, "random", space.drawn(n_random, seed), trials, jobs)
    best = find_best(list_trials(study), "random")
    assert best is not None
    grid = list(islice(space.around(best.values), 2 * trials))  # of which some may have been tried before
    return tried + _try_stage(study, executor, attempt, "grid", grid, trials, jobs)


def _try_stage(
    study: optuna.Study,
    executor: Executor,
    attempt: Attempt,
    stage: Stage,
    points: Sequence[Values],
    trials: int,
    jobs: int,
) -> int:
    """Try settings that were not tried yet, in their order, as long as there is room for trials."""
    known = [trial.params or trial.system_attrs["fixed_params"] for trial in study.get_trials(states=_KNOWN)]
    room = max(0, trials - sum(trial.recall_at_1 is not None for trial in list_trials(study)))
    waiting = len(study.get_trials(deepcopy=False, states=[TrialState.WAITING]))
    left = [(point, values) for point, values in enumerate(points) if values not in known]
    for point, values in left[: max(0, room - waiting)]:
        study.enqueue_trial(dict(values), user_attrs={"stage": stage, "point": point})
    wanted = min(room, waiting + len(left))

    def objective(trial: optuna.Trial) -> float:
        values = {each.name: trial.suggest_float(each.name, each.low, each.high, log=each.log) for each in PARAMETERS}
        try:
            answer = executor.submit(attempt, Task("searched", values)).result()
        except Exception as error:  # whatever a method raises costs its own trial
            trial.set_user_attr("failed", f"{type(error).__name__}: {error}")
            raise
        if answer.diverged is not None:
            trial.set_user_attr("diverged", answer.diverged)
        return answer.recall_at_1

    def report(study: optuna.Study, ended: FrozenTrial) -> None:
        progress.report(f"{stage} settings", 1 - len(study.get_trials(states=[TrialState.WAITING])) / max(wanted, 1))

    if wanted:
        study.optimize(objective, n_trials=wanted, n_jobs=jobs, catch=(Exception,), callbacks=[report])
    ended = [trial for trial in list_trials(study) if trial.stage == stage]
    done = [trial for trial in ended if trial.recall_at_1 is not None]
    if ended and not done:
        raise RuntimeError(f"all {len(ended)} {stage} trials failed; the last: {ended[-1].failed}")
    return min(wanted, len(done))


def _jobs(requested: int | None) -> int:
    """Return how many processes there may be: at most one for each core."""
    cores = core_count()
    if requested is not None and requested > cores:
        used = "1 process is used" if cores == 1 else f"{cores} processes are used"
        logger.info("jobs=%d: %s, one for each core that is there for this process", requested, used)
    return min(requested or cores, cores)


@contextmanager
def _open_executor(settings: Settings, jobs: int) -> Iterator[tuple[Executor, int]]:
    """Open processes of one thread each, or the workers of a cluster, and say how many tasks may run at a time."""
    if settings.needs_dask:
        from vprbench.jobs.cluster import DaskExecutor

        with DaskExecutor(settings) as dask:
            yield dask.open_pool(), dask.count_slots()
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), machine.pin_threads, (1,)) as pool:
        yield pool, jobs


def _named(allowed: places.Searchable) -> dict[StretchName, range]:
    return {"searched": allowed.searched, "checked": allowed.checked}
