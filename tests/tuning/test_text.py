"""What a search tells people: the settings, what mattered, how sure the gain is, and how to go on."""

import csv
import io
import shlex
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from checkout import ROOT
from little import a_run
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial

from vprbench.config import make_request
from vprbench.metrics.intervals import WiderInterval
from vprbench.tuning import text
from vprbench.tuning.search import Comparison, Found
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
        user_attrs={"stage": stage, "point": number, "diverged": diverged, "failed": failed},
    )
    made.number, made.datetime_start, made.datetime_complete = number, START, START + timedelta(seconds=1.25)
    return made


TRIALS = (
    trial(0, "random", 0.25),
    trial(1, "random", 0.0, diverged="training diverged: one neuron wins, always"),
    trial(2, "random", None, failed="MemoryError: no room"),
    trial(4, "grid", 0.5),
)
MACHINE = {"cores": 8, "memory_bytes": 8e9, "platform": "Linux", "python": "3.11.7", "vprbench": "0.6.1"}


def comparison(gain, low, high):
    """Best has 0.5 in the mean and paper less by `gain`, with every seed; 0.1 apart from seed to seed."""
    best = np.repeat([[0.3], [0.4], [0.5], [0.6], [0.7]], 36, axis=1)
    return Comparison(40, (6, 7, 8, 9, 10), best, best - gain, WiderInterval(low, high, "blocks", 7))


BETTER, OPEN = comparison(0.25, 0.125, 0.375), comparison(0.125, -0.0625, 0.25)
WORSE = comparison(-0.25, -0.375, -0.125)
FEW = replace(OPEN, interval=None)


def a_search(**changes):
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        protocols={"searched": {"seed": 1, "stretch": [0, 39]}, "checked": {"seed": 1, "stretch": [40, 79]}},
        folder=Path("results/search/0123456789abcdef"),
        trials=TRIALS,
        tried_now=2,
        best=BEST,
        importance={"rate_min": 0.625, "p_excitatory": 0.25, "itp_rate": 0.125},
        compared={"searched": BETTER, "checked": OPEN},
        jobs=2,
        minutes=2.5,
        environment={**a_run().environment, **MACHINE},
    )
    return replace(found, **changes)


def test_a_search_is_told_as_it_is_stored():
    # the sample deviation of 30, 40, 50, 60 and 70 is sqrt(1000 / 4) = 15.8
    assert text.format_report(a_search()) == (ROOT / "tests/tuning/search.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"importance": {}}, "R@1 did not vary"),
        ({"compared": {"searched": OPEN, "checked": BETTER}}, "Held out: the best settings are better."),
        ({"compared": {"searched": BETTER, "checked": WORSE}}, "Held out: the paper's settings are better."),
        ({"compared": {"searched": FEW, "checked": FEW}}, "+12.5 [-]"),
    ],
)
def test_what_is_peculiar_to_a_search_is_told(changes, told):
    assert told in text.format_report(a_search(**changes))
    assert told not in text.format_report(a_search())


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
    [({}, "search"), ({"dataset": "nordland"}, "search-nordland"), ({"quick": True}, "search-quick")],
)
def test_files_are_written_by_dataset_and_size_and_into_the_study(tmp_path, settings, stem):
    found = a_search(settings=Settings(**settings), folder=tmp_path / "study")
    found.folder.mkdir()
    text.write_report(found, tmp_path)
    for place, name in ((tmp_path, stem), (found.folder, "search")):
        written = {path.name: path.read_text(encoding="utf-8") for path in place.iterdir() if path.is_file()}
        assert written == {f"{name}.csv": text.format_trials(found), f"{name}.md": text.format_report(found)}
