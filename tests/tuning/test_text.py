"""What a search tells people: the settings, what mattered, how sure the gain is, and how to go on."""

import csv
import io
import shlex
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial

from vprbench.config import make_request
from vprbench.tuning import text
from vprbench.tuning.search import Found
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER, PARAMETERS

BEST = {**PAPER, "rate_min": 0.35, "p_excitatory": 0.225, "stdp_rate": 0.00062}
START = datetime(2025, 1, 31, tzinfo=UTC)


def trial(number, stage, value, diverged="", failed=""):
    """Return a trial of 1.25 seconds; one without a value failed."""
    made = create_trial(
        state=TrialState.FAIL if value is None else TrialState.COMPLETE,
        value=value,
        params=BEST,
        distributions={each.name: FloatDistribution(each.low, each.high, log=each.log) for each in PARAMETERS},
        user_attrs={"stage": stage, "diverged": diverged, "failed": failed},
    )
    made.number, made.datetime_start, made.datetime_complete = number, START, START + timedelta(seconds=1.25)
    return made


TRIALS = (
    trial(0, "random", 0.25),
    trial(1, "random", 0.0, diverged="training diverged: one neuron wins, always"),
    trial(2, "random", None, failed="MemoryError: no room"),
    trial(4, "grid", 0.5),
)
BEST_RECALLS = np.repeat([[0.3], [0.4], [0.5], [0.6], [0.7]], 36, axis=1)  # (seeds, queries); mean 0.5


def a_search(gain=0.25, **changes):
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        searched=range(40),
        checked=range(40, 80),
        folder=Path("results/search/0123456789abcdef"),
        trials=TRIALS,
        best=BEST,
        best_hits=BEST_RECALLS,
        paper_hits=BEST_RECALLS - gain,
    )
    return replace(found, **changes)


def test_a_report_tells_the_best_settings_and_how_sure_their_gain_is():
    # the sample deviation of 30, 40, 50, 60 and 70 is sqrt(1000 / 4) = 15.8
    report = text.format_report(a_search())
    told = (
        "4 trials of VPRTempo",
        "3 random, 1 on a grid",
        "R@1 0: 1. Failed: 1",
        "50.0 ± 15.8 % against 25.0 ± 15.8 %",
    )
    assert [words for words in told if words not in report] == []
    line = next(line for line in report.splitlines() if "method.rate_min" in line)
    assert [cell.strip() for cell in line.split("|")[1:-1]] == ["f_min", "method.rate_min", "0.35", "0.2", "0.05 to 1"]


@pytest.mark.parametrize("name", ["synthetic", "nordland", "oxford_robotcar"])
def test_the_command_runs_the_best_settings_on_the_dataset(name):
    dataset = make_request(["method=vprtempo", f"dataset={name}"]).dataset
    folder = "/data/it's a 100% path, {really}"
    settings = Settings(dataset=name, root=folder if "root" in dataset else None)
    command = shlex.split(text.format_command(a_search(settings=settings)))
    run = make_request(command[3:])
    assert run.dataset.get("root") == settings.root
    assert run.method["max_module"] == 1100
    assert {name: run.method[name] for name in BEST} == BEST


def test_every_trial_is_a_line_of_csv():
    lines = list(csv.DictReader(io.StringIO(text.format_trials(a_search()))))
    assert [[line[name] for name in ("stage", "state", "recall_at_1", "reason")] for line in lines] == [
        ["random", "done", "0.25", ""],
        ["random", "diverged", "0.0", "training diverged: one neuron wins, always"],
        ["random", "failed", "", "MemoryError: no room"],
        ["grid", "done", "0.5", ""],
    ]
    assert {name: float(lines[3][name]) for name in PAPER} == BEST


@pytest.mark.parametrize(
    ("settings", "stem"),
    [({}, "search"), ({"dataset": "nordland"}, "search-nordland")],
)
def test_files_are_named_by_dataset(tmp_path, settings, stem):
    found = a_search(settings=Settings(**settings))
    printed = text.write_report(found, tmp_path)
    written = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert written == {f"{stem}.csv": text.format_trials(found), f"{stem}.md": printed.partition("\nwritten to")[0]}
