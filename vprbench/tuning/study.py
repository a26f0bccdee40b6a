"""The trials of a search on disk, in Optuna's journal: written by one process at a time, whole after any kill."""

from __future__ import annotations

import json
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
    """Settings that were tried, and what came of it."""

    number: int
    stage: Stage
    point: int  # which of its stage's settings these are
    values: Values
    recall_at_1: float | None  # None: it failed
    diverged: str | None  # how the divergence was seen; the recall counts as 0
    failed: str | None  # why; empty if the process that tried it was killed
    seconds: float | None


class Study:
    """The trials of one search."""

    def __init__(self, stored: optuna.Study) -> None:
        """Take an open study; `opened` gives one."""
        self._stored = stored
        self._running: dict[int, optuna.Trial] = {}

    def begin(self, stage: Stage, point: int, values: Values) -> int:
        """Store that settings are being tried; returns the trial's number."""
        self._stored.enqueue_trial(dict(values), user_attrs={"stage": stage, "point": point})
        trial = self._stored.ask(space.distributions())
        self._running[trial.number] = trial
        return trial.number

    def end(self, number: int, recall_at_1: float, diverged: str | None) -> None:
        """Store the recall of a trial."""
        trial = self._running.pop(number)
        if diverged is not None:
            trial.set_user_attr("diverged", diverged)
        self._stored.tell(trial, recall_at_1)

    def fail(self, number: int, reason: str) -> None:
        """Store that nothing came of a trial."""
        trial = self._running.pop(number)
        trial.set_user_attr("failed", reason)
        self._stored.tell(trial, state=TrialState.FAIL)

    def trials(self) -> list[Trial]:
        """Return all trials, in the order in which they were begun."""
        return [_trial(stored) for stored in self._stored.get_trials(deepcopy=False)]

    def importance(self) -> dict[str, float]:
        """Return the share of each parameter in how the recall of the random trials varies, the largest first.

        By fANOVA (Hutter et al. 2014), main effects, as shares of their sum. Empty if the recall does not vary.
        """
        apart = optuna.create_study(direction="maximize")
        recalls = set()
        for trial in self._stored.get_trials(deepcopy=False, states=[TrialState.COMPLETE]):
            if trial.user_attrs["stage"] == "random":
                apart.add_trial(trial)
                recalls.add(trial.value)
        if len(recalls) < 2:
            return {}
        try:
            return get_param_importances(apart, evaluator=FanovaImportanceEvaluator(seed=0))
        except RuntimeError:  # no tree of the forest saw the recall vary
            return {}

    def abandon_unfinished(self) -> None:
        """Count the trials of a killed process as failed."""
        waiting = self._stored.get_trials(deepcopy=False, states=[TrialState.WAITING])
        for _ in waiting:
            self._stored.ask()
        for trial in self._stored.get_trials(deepcopy=False, states=[TrialState.RUNNING]):
            self._stored.tell(trial.number, state=TrialState.FAIL)


def best_of(trials: list[Trial], stage: Stage | None = None) -> Trial | None:
    """Return the trial with the highest recall, of equals the first in the order of the search; None without one."""
    finished = [trial for trial in trials if trial.recall_at_1 is not None and (stage is None or trial.stage == stage)]
    order = ("random", "grid")
    return min(
        finished,
        key=lambda trial: (-cast(float, trial.recall_at_1), order.index(trial.stage), trial.point, trial.number),
        default=None,
    )


@contextmanager
def opened(folder: Path) -> Iterator[Study]:
    """Open the study in a folder, or begin one; nobody else can meanwhile.

    Raises BadInput if another process has it open or if its journal cannot be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    journal = folder / JOURNAL
    try:
        only = filelock.FileLock(folder / "in-use.lock").acquire(timeout=0)
    except filelock.Timeout:
        raise BadInput(f"{folder} is in use by another search of the same settings: wait for its end") from None
    with only:
        _mend(journal)
        lock = JournalFileOpenLock(str(journal))
        storage = JournalStorage(JournalFileBackend(str(journal), lock))
        stored = optuna.create_study(
            storage=storage, study_name=space.METHOD, direction="maximize", load_if_exists=True
        )
        study = Study(stored)
        study.abandon_unfinished()
        yield study


def _mend(journal: Path) -> None:
    """Remove the half line and the lock that a process killed while writing left in the journal."""
    Path(f"{journal}.lock").unlink(missing_ok=True)
    if not journal.exists():
        return
    content = journal.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        with journal.open("r+b") as file:
            file.truncate(len(whole))
    try:
        for line in whole.splitlines():
            json.loads(line)
    except ValueError as error:
        raise BadInput(f"{journal} cannot be read ({error}): move it away to search anew") from error


def _trial(stored: FrozenTrial) -> Trial:
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
