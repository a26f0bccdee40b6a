"""The trials of a search in Optuna's journal: random settings, then a grid around the best of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import filelock
import optuna
from optuna.importance import FanovaImportanceEvaluator, get_param_importances
from optuna.storages.journal import JournalFileBackend, JournalStorage
from optuna.trial import FrozenTrial, TrialState

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.tuning import space
from vprbench.tuning.space import PARAMETERS, Values
from vprbench.tuning.trial import Hits

JOURNAL = "journal.log"


@contextmanager
def open_study(folder: Path) -> Iterator[optuna.Study]:
    """Open the study in a folder, or begin one; nobody else can meanwhile.

    Raises BadInput if another process
    has the study open or if its journal cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    journal = folder / JOURNAL
    try:
        with filelock.FileLock(folder / "in-use.lock").acquire(timeout=0):
            Path(f"{journal}.lock").unlink(missing_ok=True)  # of a killed search
            try:
                storage = JournalStorage(JournalFileBackend(str(journal)))
                name = space.METHOD
                study = optuna.create_study(storage=storage, study_name=name, direction="maximize", load_if_exists=True)
            except (ValueError, KeyError, TypeError) as error:
                raise BadInput(f"{journal} cannot be read ({error}): move it away to search anew") from error
            for killed in study.get_trials(states=[TrialState.RUNNING]):
                study.tell(killed.number, state=TrialState.FAIL)
            yield study
    except filelock.Timeout:
        raise BadInput(f"{folder} is in use by another search of the same settings: wait for its end") from None


def explore(study: optuna.Study, train: Callable[[Values], Hits], trials: int, seed: int, jobs: int) -> int:
    """Try random settings, then a grid around the best of them; returns how many settings were tried now.

    Stored settings are not tried again. Raises RuntimeError if all trials fail.
    """
    n_random = trials - trials // 3
    points = space.draw_settings(n_random, seed)
    tried = _try_settings(study, train, "random", points, jobs)
    grid = (values for values in space.list_grid(find_best(study, "random").params) if values not in points)
    return tried + _try_settings(study, train, "grid", list(islice(grid, trials - n_random)), jobs)


def _try_settings(
    study: optuna.Study, train: Callable[[Values], Hits], stage: str, points: Sequence[Values], jobs: int
) -> int:
    """Try the settings that the study does not hold yet, `jobs` at a time; returns how many."""
    waiting = study.get_trials(states=[TrialState.WAITING])
    known = [one.params for one in list_trials(study)] + [one.system_attrs["fixed_params"] for one in waiting]
    for point, values in enumerate(points):
        if values not in known:
            study.enqueue_trial(dict(values), {"stage": stage, "point": point})

    def objective(trial: optuna.Trial) -> float:
        try:
            hits = train(
                {one.name: trial.suggest_float(one.name, one.low, one.high, log=one.log) for one in PARAMETERS}
            )
        except Exception as error:  # whatever a method raises costs its own trial
            trial.set_user_attr("failed", f"{type(error).__name__}: {error}")
            raise
        trial.set_user_attr("diverged", hits.diverged)
        return float(hits.expected.mean())

    n_waiting = len(study.get_trials(states=[TrialState.WAITING]))

    def report(study: optuna.Study, ended: FrozenTrial) -> None:
        progress.report(f"{stage} settings", 1 - len(study.get_trials(states=[TrialState.WAITING])) / n_waiting)

    if n_waiting:
        study.optimize(objective, n_trials=n_waiting, n_jobs=jobs, catch=(Exception,), callbacks=[report])
    return n_waiting


def list_trials(study: optuna.Study) -> list[FrozenTrial]:
    """Return the trials that gave a recall or failed, in the order of their settings, however many ran side by side.

    A trial that the end of its process cut off is left out: it is tried again.
    """
    ended = [one for one in study.trials if one.state == TrialState.COMPLETE or "failed" in one.user_attrs]
    return sorted(ended, key=lambda one: (one.user_attrs["stage"] == "grid", one.user_attrs["point"], one.number))


def find_best(study: optuna.Study, stage: str | None = None) -> FrozenTrial:
    """Return the trial with the highest recall, of equals the first; raises RuntimeError if all failed."""
    trials = [one for one in list_trials(study) if stage in (None, one.user_attrs["stage"])]
    done = [one for one in trials if one.state == TrialState.COMPLETE]
    if not done:
        raise RuntimeError(f"all {len(trials)} trials failed; the last: {trials[-1].user_attrs['failed']}")
    return max(done, key=lambda one: one.value or 0.0)


def rank_parameters(study: optuna.Study) -> dict[str, float]:
    """Return the share of each parameter in how the recall of the random trials varies, the largest first.

    By fANOVA (Hutter et al. 2014), main effects, as shares of their sum. Empty if the recall does not vary.
    """
    apart = optuna.create_study(direction="maximize")
    apart.add_trials(
        [one for one in study.get_trials(states=[TrialState.COMPLETE]) if one.user_attrs["stage"] == "random"]
    )
    if len({one.value for one in apart.trials}) < 2:
        return {}
    try:
        return get_param_importances(apart, evaluator=FanovaImportanceEvaluator(seed=0))
    except RuntimeError:  # no tree of the forest saw the recall vary
        return {}
