"""The trials of a search in Optuna's journal, which a killed search goes on from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import filelock
import optuna
from optuna.importance import FanovaImportanceEvaluator, get_param_importances
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock, JournalStorage
from optuna.trial import FrozenTrial, TrialState

from vprbench.errors import BadInput
from vprbench.tuning import space
from vprbench.tuning.space import Values

Stage = Literal["random", "grid"]

JOURNAL = "journal.log"


@dataclass(frozen=True)
class Trial:
    """Settings that were tried, and their recall."""

    number: int
    stage: Stage
    point: int  # its place among the settings of its stage
    values: Values
    recall_at_1: float | None  # None: it failed
    diverged: str | None  # how the divergence was seen; the recall counts as 0
    failed: str | None  # why; empty if the process that tried it was killed
    seconds: float | None


@contextmanager
def open_study(folder: Path) -> Iterator[optuna.Study]:
    """Open the study in a folder, or begin one; nobody else can meanwhile.

    Trials that a killed process was running count as failed. Raises BadInput if another process has the study open or
    if its journal cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    journal = folder / JOURNAL
    try:
        only = filelock.FileLock(folder / "in-use.lock").acquire(timeout=0)
    except filelock.Timeout:
        raise BadInput(f"{folder} is in use by another search of the same settings: wait for its end") from None
    with only:
        lock = JournalFileOpenLock(str(journal))
        Path(f"{journal}.lock").unlink(missing_ok=True)  # of a killed search
        try:
            storage = JournalStorage(JournalFileBackend(str(journal), lock))
            study = optuna.create_study(
                storage=storage, study_name=space.METHOD, direction="maximize", load_if_exists=True
            )
        except (ValueError, KeyError, TypeError) as error:
            raise BadInput(f"{journal} cannot be read ({error}): move it away to search anew") from error
        for trial in study.get_trials(deepcopy=False, states=[TrialState.RUNNING]):
            study.tell(trial.number, state=TrialState.FAIL)
        yield study


def list_trials(study: optuna.Study) -> list[Trial]:
    """Return all trials that were begun, in their order."""
    begun = (TrialState.COMPLETE, TrialState.FAIL, TrialState.RUNNING)
    return [_trial_of(stored) for stored in study.get_trials(deepcopy=False, states=begun)]


def find_best(trials: list[Trial], stage: Stage | None = None) -> Trial | None:
    """Return the trial with the highest recall, of equals the first in the order of the search; None without one."""
    finished = [trial for trial in trials if trial.recall_at_1 is not None and (stage is None or trial.stage == stage)]
    order = ("random", "grid")
    return min(
        finished,
        key=lambda trial: (-cast(float, trial.recall_at_1), order.index(trial.stage), trial.point, trial.number),
        default=None,
    )


def rank_parameters(study: optuna.Study) -> dict[str, float]:
    """Return the share of each parameter in how the recall of the random trials varies, the largest first.

    By fANOVA (Hutter et al. 2014), main effects, as shares of their sum. Empty if the recall does not vary.
    """
    random_trials = [
        trial
        for trial in study.get_trials(deepcopy=False, states=[TrialState.COMPLETE])
        if trial.user_attrs["stage"] == "random"
    ]
    if len({trial.value for trial in random_trials}) < 2:
        return {}
    apart = optuna.create_study(direction="maximize")
    apart.add_trials(random_trials)
    try:
        return get_param_importances(apart, evaluator=FanovaImportanceEvaluator(seed=0))
    except RuntimeError:  # no tree of the forest saw the recall vary
        return {}


def _trial_of(stored: FrozenTrial) -> Trial:
    attributes: Mapping[str, str] = stored.user_attrs
    done = stored.state == TrialState.COMPLETE
    return Trial(
        number=stored.number,
        stage=stored.user_attrs["stage"],
        point=stored.user_attrs["point"],
        values=stored.params,
        recall_at_1=stored.value if done else None,
        diverged=attributes.get("diverged"),
        failed=attributes.get("failed", "") if stored.state == TrialState.FAIL else None,
        seconds=stored.duration.total_seconds() if done and stored.duration is not None else None,
    )
