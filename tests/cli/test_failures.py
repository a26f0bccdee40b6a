"""Runs that failed: stored with the machine and with whether something was missing, until the same run succeeds."""

import json
from pathlib import Path

import pytest
from little import a_failure, a_run
from small_plan import Apart

from vprbench.cli import main
from vprbench.jobs import executors
from vprbench.runs.store import Store

QUICK = ["dataset.places=12", "dataset.first_query_place=0", "timing.minimum_seconds=0", "threads=1"]


@pytest.fixture
def store(tmp_path):
    store = Store(tmp_path / "results")
    store.prepare()
    return store


def test_the_last_failure_of_a_configuration_is_kept_beside_runs_until_the_run_succeeds(store):
    last, other = a_failure(error="ValueError: no", missing=True), a_failure(config={**a_run().config, "seed": 4})
    for failure in (a_failure(), other, last):
        store.save_failure(failure)
    assert sorted(store.failures(), key=lambda failure: failure.config["seed"]) == [last, other]
    store.save(a_run())
    assert (list(store.failures()), len(list(store.runs()))) == ([other], 1)


MISSING, WRONG = True, False


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        (["dataset=nordland"], MISSING),
        (["dataset=nordland", "dataset.root=/nowhere"], MISSING),
        (["dataset=folders"], MISSING),
        (["dataset=folders", "dataset.references=[/nowhere]", "dataset.queries=/nowhere"], MISSING),
        (["method=cosplace", *QUICK], MISSING),  # weights that may not be fetched
        (["method=gcl", *QUICK], MISSING),  # weights that no program can fetch
        (["method.patch=0", *QUICK], WRONG),
        ([*QUICK, "dataset.places=0"], WRONG),
        (["method=sda", *QUICK], None),
    ],
)
def test_a_failure_in_a_sweep_says_whether_something_was_missing_and_which_arguments_were_changed(
    arguments, missing, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(executors, "run_in_child", Apart())
    assert main(["-m", "seed=0", *arguments, "output=json"]) == 2
    if missing is None:  # there is no such method, and nothing is stored
        assert not Path("results").exists()
        return
    (failure,) = Store(Path("results")).failures()
    told = json.loads(capsys.readouterr().out)
    assert (failure.missing, told["missing"], told["method"]) == (missing, missing, failure.method)
    assert {"processor", "threads", "libraries", "time_utc", "memory_bytes"} <= set(failure.environment)
    assert ("patch" in failure.config["changed"]) == ("method.patch=0" in arguments)
