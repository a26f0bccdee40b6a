"""The search: random settings, then a grid around the best, then best and paper on places that chose nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import optuna
from optuna.trial import FrozenTrial

from vprbench import progress
from vprbench.metrics.intervals import WiderInterval, difference_interval
from vprbench.plugins import registry
from vprbench.report.plan import PLAN_FILE, read_plan
from vprbench.runs import machine
from vprbench.runs.identity import compute_fingerprint, hash_code, hash_content, hash_files
from vprbench.storage.cores import count_cores
from vprbench.tuning import places, space, trial
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER, Values
from vprbench.tuning.study import explore, find_best, list_trials, open_study, rank_parameters
from vprbench.tuning.trial import Hits, encode_stretch, train_and_query

Verdict = Literal["better", "worse", "not told apart"]
Train = Callable[[Values, str, int], Hits]  # settings, name of the stretch, seed

SEEDS = 5  # of the comparison with the paper
AGREE = 4  # seeds of one sign, at least, for a verdict


@dataclass(frozen=True)
class Comparison:
    """The best settings and the paper's on the queries of one stretch, both trained with the same seeds."""

    n_places: int
    seeds: tuple[int, ...]
    best: npt.NDArray[np.float64]  # (n_seeds, n_queries), expected hits
    paper: npt.NDArray[np.float64]
    interval: WiderInterval | None  # 95 % of the difference over the queries; None: too few queries

    @property
    def differences(self) -> npt.NDArray[np.float64]:
        """R@1 of best minus that of paper, by seed."""
        return np.asarray(self.best.mean(axis=1) - self.paper.mean(axis=1))

    @property
    def verdict(self) -> Verdict:
        """Whether best is better or worse: the interval has to exclude 0, and nearly all seeds have to agree."""
        if self.interval is not None and self.interval.low > 0 and sum(self.differences > 0) >= AGREE:
            return "better"
        if self.interval is not None and self.interval.high < 0 and sum(self.differences < 0) >= AGREE:
            return "worse"
        return "not told apart"


@dataclass(frozen=True)
class Found:
    """The results of a search."""

    settings: Settings
    protocols: Mapping[str, Mapping[str, Any]]  # the dataset's, of each stretch
    folder: Path  # of the study
    trials: tuple[FrozenTrial, ...]  # all that are stored, in the order of their settings
    tried_now: int  # how many of them this call tried
    best: Values
    importance: Mapping[str, float]  # by parameter, the largest first
    compared: Mapping[str, Comparison]  # by stretch
    jobs: int  # processes that there were
    minutes: float  # of this call
    environment: Mapping[str, Any]


def search(settings: Settings, method: Mapping[str, Any], dataset: Mapping[str, Any]) -> Found:
    """Search the best settings of a method, or go on with an earlier search of the same.

    `method` is a configuration of the method that conf/search.yaml names, `dataset` that of the dataset named in the
    settings. Raises BadInput if its places are not free to be searched.
    """
    started, environment = time.perf_counter(), machine.describe_machine("cpu", 1)
    columns = read_plan(registry.find_conf_folders()["vprbench"] / PLAN_FILE).columns.values()
    allowed = places.choose_places(settings.dataset, dataset, settings.places, columns)
    whole = registry.make_dataset(allowed.dataset)
    parts = {"searched": places.cut_dataset(whole, allowed.searched)}
    parts["checked"] = places.cut_dataset(whole, allowed.checked)
    seed = settings.seed
    method = {**method, "seed": seed, "device": "cpu"}
    encoder = registry.make_method(method)
    origin = {
        "method": {name: value for name, value in method.items() if name != "_target_"},
        "code": [hash_code(type(encoder)), hash_files([Path(trial.__file__)])],
        "stretches": {name: [dict(part.protocol), compute_fingerprint(part)] for name, part in parts.items()},
        "space": [asdict(parameter) for parameter in space.PARAMETERS],
        "libraries": {**machine.list_library_versions(), "optuna": optuna.__version__},
    }
    folder = Path(settings.results).expanduser() / "search" / hash_content(origin)
    with open_study(folder) as study, _open_executor(settings) as (executor, jobs):
        stretches = {name: encode_stretch(part, encoder, name) for name, part in parts.items()}

        def train(values: Values, stretch: str, seed: int) -> Hits:
            arguments = {**method, **values, "seed": seed}
            return executor.submit(train_and_query, arguments, stretches[stretch]).result()

        tried_now = explore(study, partial(train, stretch="searched", seed=seed), settings.trials, seed, jobs)
        best = find_best(study).params
        compared = {
            name: compare_with_paper(train, best, name, part.n_places, seed, jobs) for name, part in parts.items()
        }
        return Found(
            settings=settings,
            protocols={name: part.protocol for name, part in parts.items()},
            folder=folder,
            trials=tuple(list_trials(study)),
            tried_now=tried_now,
            best=best,
            importance=rank_parameters(study),
            compared=compared,
            jobs=jobs,
            minutes=(time.perf_counter() - started) / 60,
            environment=environment,
        )


def compare_with_paper(train: Train, best: Values, stretch: str, n_places: int, seed: int, jobs: int) -> Comparison:
    """Train under the best settings and the paper's with the seeds that follow `seed`, on one stretch.

    The interval is that of a paired test over everything: of each query the mean hits over the seeds, best minus
    paper (`intervals.difference_interval`). Raises what a training raises.
    """
    seeds = tuple(range(seed + 1, seed + 1 + SEEDS))
    tasks = [(values, stretch, each) for values in (best, PAPER) for each in seeds]
    answers: list[Hits] = []
    with ThreadPoolExecutor(jobs) as threads:
        for hits in threads.map(lambda task: train(*task), tasks):
            answers.append(hits)
            progress.report(f"best against paper, {stretch} places", len(answers) / len(tasks))
    of_best, of_paper = np.split(np.array([hits.expected for hits in answers]), 2)
    interval = difference_interval(of_best.mean(axis=0), of_paper.mean(axis=0))
    return Comparison(n_places, seeds, of_best, of_paper, interval)


@contextmanager
def _open_executor(settings: Settings) -> Iterator[tuple[Executor, int]]:
    """Open processes of one thread each, or the workers of a cluster, and say how many trainings may run at a time."""
    if settings.needs_dask:
        from vprbench.jobs.cluster import DaskExecutor

        with DaskExecutor(settings) as dask:
            yield dask.open_pool(), dask.count_slots()
        return
    jobs = min(settings.jobs or settings.workers or count_cores(), count_cores())
    with ProcessPoolExecutor(jobs, get_context("spawn"), machine.pin_threads, (1,)) as pool:
        yield pool, jobs
