"""The search: random settings, then a grid around the best, then best and paper on places that chose nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import numpy.typing as npt
import optuna
from optuna.storages.journal import JournalFileBackend, JournalStorage
from optuna.trial import FrozenTrial, TrialState

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.report.plan import PLAN_FILE, read_plan
from vprbench.runs import machine
from vprbench.runs.identity import compute_fingerprint, hash_code, hash_content, hash_files
from vprbench.storage.cores import count_cores
from vprbench.tuning import places, space, trial
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER, PARAMETERS, Values
from vprbench.tuning.trial import Hits, encode_stretch, train_and_query

Train = Callable[[Values, str, int], Hits]  # settings, name of the stretch, seed
SeedHits = npt.NDArray[np.float64]  # (SEEDS, n_queries), expected hits

JOURNAL = "journal.log"
SEEDS = 5  # of the comparison with the paper

optuna.logging.set_verbosity(optuna.logging.ERROR)  # or it logs every trial


@dataclass(frozen=True)
class Found:
    """The results of a search."""

    settings: Settings
    searched: range  # of places
    checked: range
    folder: Path  # of the study
    trials: tuple[FrozenTrial, ...]  # all that are stored
    best: Values
    best_hits: SeedHits  # of the best settings on the places held out
    paper_hits: SeedHits  # of the paper's, trained with the same seeds


def search(settings: Settings, method: Mapping[str, Any], dataset: Mapping[str, Any]) -> Found:
    """Search the best settings of a method, or go on with an earlier search of the same.

    `method` is a configuration of the method that conf/search.yaml names, `dataset` that of the dataset named in the
    settings. Raises BadInput if its places are not free to be searched.
    """
    columns = read_plan(registry.find_conf_folders()["vprbench"] / PLAN_FILE).columns.values()
    allowed = places.choose_places(settings.dataset, dataset, settings.places, columns)
    whole = registry.make_dataset(allowed.dataset)
    parts = {"searched": places.cut_dataset(whole, allowed.searched)}
    parts["checked"] = places.cut_dataset(whole, allowed.checked)
    method = {**method, "seed": settings.seed, "device": "cpu"}
    encoder = registry.make_method(method)
    origin = {
        "method": {name: value for name, value in method.items() if name != "_target_"},
        "code": [hash_code(type(encoder)), hash_files([Path(trial.__file__)])],
        "stretches": {name: [dict(part.protocol), compute_fingerprint(part)] for name, part in parts.items()},
        "space": [asdict(parameter) for parameter in PARAMETERS],
        "libraries": {**machine.list_library_versions(), "optuna": optuna.__version__},
    }
    folder = Path(settings.results).expanduser() / "search" / hash_content(origin)
    with open_study(folder) as study, _open_executor(settings) as (executor, workers):
        stretches = {name: encode_stretch(part, encoder, name) for name, part in parts.items()}

        def train(values: Values, stretch: str, seed: int) -> Hits:
            arguments = {**method, **values, "seed": seed}
            return executor.submit(train_and_query, arguments, stretches[stretch]).result()

        explore(study, train, settings.trials, settings.seed, workers)
        best = find_best_trial(study).params
        best_hits, paper_hits = compare_with_paper(train, best, settings.seed, workers)
        trials = tuple(list_trials(study))
    return Found(settings, allowed.searched, allowed.checked, folder, trials, best, best_hits, paper_hits)


@contextmanager
def open_study(folder: Path) -> Iterator[optuna.Study]:
    """Open the study in a folder, or begin one.

    Raises BadInput if another process has the study open or if its journal cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    journal = folder / JOURNAL
    try:
        with filelock.FileLock(folder / "in-use.lock").acquire(timeout=0):
            Path(f"{journal}.lock").unlink(missing_ok=True)  # of a killed search
            try:
                storage = JournalStorage(JournalFileBackend(str(journal)))
                study = optuna.create_study(
                    storage=storage, study_name=space.METHOD, direction="maximize", load_if_exists=True
                )
            except (ValueError, KeyError, TypeError) as error:
                raise BadInput(f"{journal} cannot be read ({error}): move it away to search anew") from error
            yield study
    except filelock.Timeout:
        raise BadInput(f"{folder} is in use by another search of the same settings: wait for its end") from None


def explore(study: optuna.Study, train: Train, trials: int, seed: int, workers: int) -> None:
    """Try random settings, then a grid around the best of them, until the study holds so many trials.

    Raises RuntimeError if all trials fail.
    """

    def objective(trial: optuna.Trial) -> float:
        settings = {one.name: trial.suggest_float(one.name, one.low, one.high, log=one.log) for one in PARAMETERS}
        try:
            hits = train(settings, "searched", seed)
        except Exception as error:  # whatever a method raises costs its own trial
            trial.set_user_attr("failed", f"{type(error).__name__}: {error}")
            raise
        trial.set_user_attr("diverged", hits.diverged)
        return float(hits.expected.mean())

    def report(_: optuna.Study, trial: FrozenTrial) -> None:
        progress.report("trying settings", min(1.0, (trial.number + 1) / trials))

    def try_settings(stage: str, points: Iterable[Values], count: int) -> None:
        """Try the first points that the study lacks, until it holds `count` trials."""
        known = [one.system_attrs["fixed_params"] for one in list_trials(study)]
        for values in islice((values for values in points if values not in known), max(0, count - len(known))):
            study.enqueue_trial(dict(values), {"stage": stage})
        if waiting := study.get_trials(states=[TrialState.WAITING]):
            study.optimize(objective, n_trials=len(waiting), n_jobs=workers, catch=(Exception,), callbacks=[report])

    try_settings("random", space.draw_settings(seed), trials - trials // 3)
    try_settings("grid", space.list_grid(find_best_trial(study, "random").params), trials)


def list_trials(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials but those that the end of a search cut off: their settings are tried again."""
    kept = TrialState.COMPLETE, TrialState.WAITING
    return [one for one in study.trials if one.state in kept or "failed" in one.user_attrs]


def find_best_trial(study: optuna.Study, stage: str | None = None) -> FrozenTrial:
    """Return the trial with the highest recall, of equals the first; raises RuntimeError if all failed."""
    trials = [one for one in list_trials(study) if stage in (None, one.user_attrs["stage"])]
    done = [one for one in trials if one.state == TrialState.COMPLETE]
    if not done:
        raise RuntimeError(f"all {len(trials)} trials failed; the last: {trials[-1].user_attrs['failed']}")
    return max(done, key=lambda one: one.value or 0.0)


def compare_with_paper(train: Train, best: Values, seed: int, workers: int) -> tuple[SeedHits, SeedHits]:
    """Train under the best settings and the paper's with the seeds after `seed`; raises what a training raises."""
    tasks = [(values, seed + 1 + n) for values in (best, PAPER) for n in range(SEEDS)]
    hits: list[npt.NDArray[np.float64]] = []
    with ThreadPoolExecutor(workers) as threads:
        for answers in threads.map(lambda task: train(task[0], "checked", task[1]), tasks):
            hits.append(answers.expected)
            progress.report("best against paper", len(hits) / len(tasks))
    return np.array(hits[:SEEDS]), np.array(hits[SEEDS:])


@contextmanager
def _open_executor(settings: Settings) -> Iterator[tuple[Executor, int]]:
    """Open processes of one thread each, or the workers of a cluster, and say how many trainings may run at a time."""
    if settings.needs_dask:
        from vprbench.jobs.cluster import DaskExecutor

        with DaskExecutor(settings) as dask:
            yield dask.open_pool(), dask.count_slots()
        return
    workers = min(settings.workers or count_cores(), count_cores())
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        yield pool, workers
