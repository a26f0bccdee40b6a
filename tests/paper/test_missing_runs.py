"""Runs that are wanted and not stored are made apart, and whatever happens to them is stored."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from vprbench.paper import missing_runs
from vprbench.paper.missing_runs import Wanted
from vprbench.paper.plan import Row
from vprbench.run.processes import Ending
from vprbench.run.store import Store

SAD = Row("SAD", "sad", training="none")


def a_wish(row: Row = SAD, seed: int = 0, **changes: object) -> Wanted:
    given = {
        "row": row,
        "title": "Journey",
        "dataset_options": ("dataset=synthetic", "dataset.places=20"),
        "dataset": {"name": "synthetic", "places": 20},
        "arguments": dict(row.arguments),
        "seed": seed,
        "device": "cpu",
    }
    return Wanted(**{**given, **changes})


class Children:
    """Stands in for processes: each ends in the next way, and is remembered by its options."""

    def __init__(self, *answers: Ending) -> None:
        self.answers = list(answers)
        self.asked: list[list[str]] = []

    def __call__(self, options: Sequence[str], stdout: int | None = None) -> Ending:
        self.asked.append(list(options))
        return self.answers.pop(0)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")


def with_children(monkeypatch: pytest.MonkeyPatch, *answers: Ending) -> Children:
    children = Children(*answers)
    monkeypatch.setattr(missing_runs, "run_apart", children)
    return children


def test_a_run_is_asked_for_by_the_options_of_row_dataset_seed_and_device(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch, Ending(0))
    row = Row("Big patches", "sad", arguments={"patch": 14, "preprocessing": "A"})
    assert missing_runs.fill([a_wish(row, seed=3)], ["threads=1"], store) == [Ending(0)]
    assert children.asked == [
        [
            "dataset=synthetic",
            "dataset.places=20",
            "method=sad",
            "method.patch=14",
            'method.preprocessing="A"',
            "seed=3",
            "device=cpu",
            "threads=1",
            f"results={store.root}",
        ]
    ]


def test_a_method_that_is_not_there_is_a_stored_failure_and_starts_no_process(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch)
    row = Row("Nothing", "no_such_method", seeds=(0, 1))
    endings = missing_runs.fill([a_wish(row, 0), a_wish(row, 1)], [], store)
    assert [(ending.code, ending.missing) for ending in endings] == [(2, True), (2, True)]
    assert children.asked == []
    (failure,) = store.failures()
    assert (failure.method, failure.dataset, failure.missing) == ("no_such_method", "synthetic", True)
    assert "no_such_method" in failure.error


def test_weights_that_are_missing_for_one_seed_are_not_looked_for_again(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    missing = Ending(2, True, "weights are missing", recorded=True)
    children = with_children(monkeypatch, missing, Ending(0))
    endings = missing_runs.fill([a_wish(seed=0), a_wish(seed=1), a_wish(Row("PCA", "pca"))], [], store)
    assert endings == [missing, missing, Ending(0)]
    assert len(children.asked) == 2


def test_a_failure_of_one_seed_does_not_stop_the_next(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    diverged = Ending(1, False, "it diverged", recorded=True)
    with_children(monkeypatch, diverged, Ending(0))
    assert missing_runs.fill([a_wish(seed=0), a_wish(seed=1)], [], store) == [diverged, Ending(0)]
    assert not list(store.failures())  # the process has stored it


def test_a_process_that_ends_before_its_run_begins_is_a_stored_failure(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    with_children(monkeypatch, Ending(1, False, "was ended by signal 9 (SIGKILL)"))
    (ending,) = missing_runs.fill([a_wish(seed=4)], [], store)
    assert (ending.code, ending.recorded) == (1, True)
    (failure,) = store.failures()
    assert (failure.error, failure.missing, failure.config["seed"]) == ("was ended by signal 9 (SIGKILL)", False, 4)


def test_a_method_that_knows_no_device_does_not_run_on_a_gpu(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    children = with_children(monkeypatch)
    assert missing_runs.fill([a_wish(Row("HOG", "hog"), device="cuda")], [], store) == [Ending(0)]
    assert children.asked == []


def test_an_absolute_folder_is_what_a_process_elsewhere_finds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert missing_runs.results_folder("mine") == tmp_path / "mine"
