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


def test_a_damaged_failure_is_none_is_named_and_hides_no_other(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    folder = store.save_failure(a_failure())
    (folder / "failure.json").write_bytes((folder / "failure.json").read_bytes()[:-40])
    for dataset, seed in (("journey", 8), ("journey", 2), ("voyage", 8)):
        store.save_failure(a_failure(dataset=dataset, config={"seed": seed}))
    found = [(failure.dataset, failure.config["seed"]) for failure in store.failures()]
    assert sorted(found) == [("journey", 2), ("journey", 8), ("voyage", 8)]
    (warning,) = [record for record in caplog.records if str(folder) in record.getMessage()]
    assert warning.levelno == logging.WARNING
    assert store.failure("little", "journey", a_run().config) is None


# All failures of a store


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


FAILURES = {
    "no root": (["dataset=nordland"], True),
    "a root that is no folder": (["dataset=nordland", "dataset.root=/nowhere"], True),
    "no season": (["dataset=nordland", "dataset.root=."], True),
    "no folders": (["dataset=folders"], True),
    "a folder that is none": (["dataset=folders", "dataset.references=[/nowhere]", "dataset.queries=/nowhere"], True),
    "a folder without images": (["dataset=folders", "dataset.references=[.]", "dataset.queries=."], True),
    "weights that may not be fetched": (["method=cosplace", *QUICK], True),
    "weights that no program can fetch": (["method=gcl", *QUICK], True),
    "a copy of weights that is none": (["method=cosplace", "method.weights.path=/nowhere.pth", *QUICK], True),
    "no window": (["method.patch=0", *QUICK], False),
    "no places": ([*QUICK, "dataset.places=0"], False),
    "no training": (["method=vprtempo", "method.epochs=0", *QUICK], False),
}


@pytest.mark.usefixtures("in_a_sweep")
@pytest.mark.parametrize("reason", FAILURES)
def test_a_failure_says_whether_something_was_missing_and_which_arguments_were_changed(
    reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, missing = FAILURES[reason]
    assert main([*arguments, "output=json"]) == 2
    (failure,) = Store(Path("results")).failures()
    told = json.loads(capsys.readouterr().out)
    assert (failure.missing, told["missing"], told["method"]) == (missing, missing, failure.method)
    assert {"processor", "threads", "libraries", "time_utc", "memory_bytes"} <= set(failure.environment)
    assert ("patch" in failure.config["changed"]) == (reason == "no window")


@pytest.mark.usefixtures("in_a_sweep")
def test_a_method_that_does_not_exist_is_no_stored_failure() -> None:
    assert main(["method=sda", *QUICK]) == 2
    assert not Path("results").exists()
