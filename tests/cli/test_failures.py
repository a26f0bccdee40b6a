"""Runs that failed: stored with the machine and with whether something was missing, until the same run succeeds."""

from __future__ import annotations

import hashlib
import json
import logging
from pathlib import Path
from typing import Any

import pytest
from little import a_failure, a_run

from vprbench.cli import main
from vprbench.run.store import Store

QUICK = ["dataset.places=12", "dataset.first_query_place=0", "timing.minimum_seconds=0", "threads=1"]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.prepare()
    return store


def test_of_two_failures_the_last_is_found_under_its_configuration_alone(store: Store) -> None:
    store.save_failure(a_failure())
    store.save_failure(a_failure(error="ValueError: no", missing=True))
    assert store.failure("little", "journey", a_run().config) == a_failure(error="ValueError: no", missing=True)
    assert store.failure("little", "journey", {**a_run().config, "seed": 4}) is None


def test_a_failure_is_no_run_leaves_runs_in_place_and_vanishes_when_the_run_succeeds(store: Store) -> None:
    store.save(a_run(n_references=20))
    store.save_failure(a_failure())
    assert [run.n_references for run in store.runs()] == [20]
    store.save(a_run())
    assert store.failure("little", "journey", a_run().config) is None


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def test_a_damaged_failure_is_none_is_named_and_hides_no_other(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    folder = store.save_failure(a_failure())
    cut(folder / "failure.json")
    store.save_failure(a_failure(config={"seed": 8}))
    assert [failure.config for failure in store.failures()] == [{"seed": 8}]
    assert [(record.levelno, str(folder) in record.getMessage()) for record in caplog.records] == [
        (logging.WARNING, True)
    ]
    assert store.failure("little", "journey", a_run().config) is None


# All failures of a store


def test_every_failure_is_found_whatever_its_dataset(store: Store) -> None:
    for dataset, seed in (("journey", 1), ("journey", 2), ("voyage", 1)):
        store.save_failure(a_failure(dataset=dataset, config={"seed": seed}))
    store.save(a_run())
    assert sorted((failure.dataset, failure.config["seed"]) for failure in store.failures()) == [
        ("journey", 1),
        ("journey", 2),
        ("voyage", 1),
    ]


def key_of_an_earlier_version(config: dict[str, Any]) -> str:
    asked = {name: config.get(name) for name in ("method", "dataset", "seed", "device", "load")}
    text = json.dumps({"schema": 3, **asked}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def earlier_failure(store: Store) -> Path:
    """Write a failure as earlier versions did."""
    config = {"method": {"window": 5}, "dataset": {}, "seed": 1, "device": "cpu", "load": None}
    folder = store.root / "journey" / f"little-failed-{key_of_an_earlier_version(config)}"
    folder.mkdir(parents=True)
    content = {"method": "little", "dataset": "journey", "config": config, "error": "ValueError: no"}
    (folder / "failure.json").write_text(json.dumps(content))
    return folder


def test_a_failure_that_an_earlier_version_stored_is_read_and_removed_when_the_run_succeeds(store: Store) -> None:
    folder = earlier_failure(store)
    (failure,) = store.failures()
    assert (failure.error, failure.environment, failure.missing) == ("ValueError: no", {}, False)
    assert store.failure("little", "journey", failure.config) == failure
    store.save(a_run(config=failure.config))
    assert not folder.exists()


def test_a_failure_with_fields_of_a_later_version_is_read(store: Store) -> None:
    path = store.save_failure(a_failure()) / "failure.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "since": "later"}))
    assert list(store.failures()) == [a_failure()]


# What the command line stores


@pytest.fixture
def in_a_sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Record even failures that are the user's, as the runs of a sweep do."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("VPRBENCH_IN_SWEEP", "1")


MISSING = {
    "no root": ["dataset=nordland"],
    "a root that is no folder": ["dataset=nordland", "dataset.root=/nowhere"],
    "no season": ["dataset=nordland", "dataset.root=."],
    "no folders": ["dataset=folders"],
    "a folder that is none": ["dataset=folders", "dataset.references=[/nowhere]", "dataset.queries=/nowhere"],
    "a folder without images": ["dataset=folders", "dataset.references=[.]", "dataset.queries=."],
    "weights that may not be fetched": ["method=cosplace", *QUICK],
    "weights that no program can fetch": ["method=gcl", *QUICK],
    "a copy of weights that is none": ["method=cosplace", "method.weights.path=/nowhere.pth", *QUICK],
}


WRONG = {
    "no window": [*QUICK, "method.patch=0"],
    "no places": [*QUICK, "dataset.places=0"],
    "no training": [*QUICK, "method=vprtempo", "method.epochs=0"],
}


@pytest.mark.usefixtures("in_a_sweep")
@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        *[pytest.param(arguments, True, id=name) for name, arguments in MISSING.items()],
        *[pytest.param(arguments, False, id=name) for name, arguments in WRONG.items()],
    ],
)
def test_a_failure_says_whether_something_was_missing_that_can_be_put_there(
    arguments: list[str], missing: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "output=json"]) == 2
    (failure,) = Store(Path("results")).failures()
    told = json.loads(capsys.readouterr().out)
    assert (failure.missing, told["missing"], told["method"]) == (missing, missing, failure.method)
    assert {"processor", "threads", "libraries", "time_utc", "memory_bytes"} <= set(failure.environment)


@pytest.mark.usefixtures("in_a_sweep")
def test_a_failure_holds_which_arguments_were_changed() -> None:
    assert main(["method.patch=0", *QUICK]) == 2
    (failure,) = Store(Path("results")).failures()
    assert failure.config["changed"] == {"patch": 0}


@pytest.mark.usefixtures("in_a_sweep")
def test_a_method_that_does_not_exist_is_no_stored_failure() -> None:
    assert main(["method=sda", *QUICK]) == 2
    assert not Path("results").exists()
