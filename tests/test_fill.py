"""Runs that are wanted and not stored are made apart, and whatever happens to them is stored."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from vprbench import fill
from vprbench.fill import Ending, Wanted
from vprbench.plan import Row
from vprbench.store import Store

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
    """Stands in for processes: each answers with the next code and text, and is remembered by its options."""

    def __init__(self, *answers: tuple[int, str]) -> None:
        self.answers = list(answers)
        self.asked: list[list[str]] = []

    def __call__(self, options: Sequence[str], stdout: int | None = None) -> subprocess.CompletedProcess[str]:
        self.asked.append(list(options))
        code, text = self.answers.pop(0)
        return subprocess.CompletedProcess(list(options), code, text)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")


def with_children(monkeypatch: pytest.MonkeyPatch, *answers: tuple[int, str]) -> Children:
    children = Children(*answers)
    monkeypatch.setattr(fill, "run_apart", children)
    return children


def test_a_run_is_asked_for_by_the_options_of_row_dataset_seed_and_device(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch, (0, json.dumps({"run_folder": "x"})))
    row = Row("Big patches", "sad", arguments={"patch": 14, "preprocessing": "A"})
    assert fill.fill([a_wish(row, seed=3)], ["threads=1"], store) == [Ending(0, False, "")]
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
            "output=json",
        ]
    ]


def test_a_method_that_is_not_there_is_a_stored_failure_and_starts_no_process(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    children = with_children(monkeypatch)
    row = Row("Nothing", "no_such_method", seeds=(0, 1))
    endings = fill.fill([a_wish(row, 0), a_wish(row, 1)], [], store)
    assert [(ending.code, ending.missing) for ending in endings] == [(2, True), (2, True)]
    assert children.asked == []
    (failure,) = store.failures()
    assert (failure.method, failure.dataset, failure.missing) == ("no_such_method", "synthetic", True)
    assert "no_such_method" in failure.error


def test_weights_that_are_missing_for_one_seed_are_not_looked_for_again(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    answer = json.dumps({"error": "weights are missing", "missing": True})
    children = with_children(monkeypatch, (2, answer), (0, "{}"))
    endings = fill.fill([a_wish(seed=0), a_wish(seed=1), a_wish(Row("PCA", "pca"))], [], store)
    assert endings == [Ending(2, True, "weights are missing")] * 2 + [Ending(0, False, "")]
    assert len(children.asked) == 2


def test_a_failure_of_one_seed_does_not_stop_the_next(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    with_children(monkeypatch, (1, json.dumps({"error": "it diverged"})), (0, "{}"))
    endings = fill.fill([a_wish(seed=0), a_wish(seed=1)], [], store)
    assert endings == [Ending(1, False, "it diverged"), Ending(0, False, "")]


@pytest.mark.parametrize(("code", "words"), [(-9, "ended by signal 9"), (3, "ended without a word")])
def test_a_process_that_ends_without_an_answer_is_a_stored_failure(
    monkeypatch: pytest.MonkeyPatch, store: Store, code: int, words: str
) -> None:
    with_children(monkeypatch, (code, ""))
    assert fill.fill([a_wish(seed=4)], [], store) == [Ending(code, False, words)]
    (failure,) = store.failures()
    assert (failure.error, failure.missing, failure.config["seed"]) == (words, False, 4)


def test_a_run_that_could_not_be_stored_is_a_failure_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, store: Store
) -> None:
    printed = json.dumps({"recall_at_1": 0.5}) + "\n" + json.dumps({"error": "the disk is full"}) + "\n"
    with_children(monkeypatch, (2, printed))
    assert fill.fill([a_wish()], [], store) == [Ending(2, False, "the disk is full")]


def test_words_that_are_no_answer_are_no_answer(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    with_children(monkeypatch, (1, "Traceback\n{broken\n"))
    assert fill.fill([a_wish()], [], store) == [Ending(1, False, "ended without a word")]


def test_a_method_that_knows_no_device_does_not_run_on_a_gpu(monkeypatch: pytest.MonkeyPatch, store: Store) -> None:
    children = with_children(monkeypatch)
    assert fill.fill([a_wish(Row("HOG", "hog"), device="cuda")], [], store) == [Ending(0, False, "")]
    assert children.asked == []


def test_an_absolute_folder_is_what_a_process_elsewhere_finds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert fill.results_folder("mine") == tmp_path / "mine"
