"""What a search tells people: the settings, what mattered, how sure the gain is, and how to go on."""

from __future__ import annotations

import csv
import io
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from vprbench.intervals import Interval, McNemar
from vprbench.tuning import text
from vprbench.tuning.search import Accuracy, Comparison, Found, Settings
from vprbench.tuning.space import PAPER
from vprbench.tuning.study import Trial

BEST = {**PAPER, "rate_min": 0.35, "p_excitatory": 0.225, "stdp_rate": 0.00062}


def a_trial(number: int, recall: float | None, **changes: Any) -> Trial:
    trial = Trial(number, "random", number, {**BEST}, recall, None, None, 1.25)
    return replace(trial, **changes)


TRIALS = (
    a_trial(0, 0.25),
    a_trial(1, 0.0, diverged="training diverged: one neuron wins, always"),
    a_trial(2, None, failed="MemoryError: no room", seconds=None),
    a_trial(3, None, failed="", values={}, seconds=None),
    a_trial(4, 0.5, stage="grid", point=0),
)


def accuracy(recall: float, diverged: str | None = None) -> Accuracy:
    return Accuracy(recall, Interval(recall - 0.125, recall + 0.125), diverged)


def comparison(best: float, paper: float, b: int, c: int, p: float) -> Comparison:
    return Comparison(40, 36, accuracy(best), accuracy(paper), McNemar(b, c, p))


def a_search(**changes: Any) -> Found:
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        method={"rules": "paper", "max_module": 1100},
        protocols={"searched": {"seed": 1, "stretch": [0, 39]}, "checked": {"seed": 1, "stretch": [40, 79]}},
        folder=Path("results/search/0123456789abcdef"),
        trials=TRIALS,
        tried_now=2,
        best=TRIALS[4],
        importance={"rate_min": 0.625, "p_excitatory": 0.25, "itp_rate": 0.125},
        compared={"searched": comparison(0.5, 0.25, 12, 3, 0.035), "checked": comparison(0.375, 0.25, 9, 4, 0.267)},
        jobs=2,
        minutes=2.5,
        environment={
            "processor": "Abacus 9",
            "threads": 2,
            "cores": 2,
            "memory_bytes": 8e9,
            "platform": "Linux",
            "python": "3.11.7",
            "libraries": {"torch": "2.6.0"},
            "git": None,
            "time_utc": "2025-01-31T12:00:00Z",
        },
    )
    return replace(found, **changes)


def row(found: Found, first: str) -> list[str]:
    (line,) = (line for line in text.text_of(found).splitlines() if line.startswith(f"| {first} "))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_each_parameter_stands_with_the_best_and_the_papers_value() -> None:
    assert row(a_search(), "f_min") == ["f_min", "method.rate_min", "0.35", "0.2", "0.05 to 1", "62.5"]
    assert row(a_search(), "eta_STDP init")[2:5] == ["0.00062", "0.005", "0.0002 to 0.02 (log)"]


def test_what_mattered_is_named_in_order() -> None:
    told = text.text_of(a_search())
    assert "What mattered most: f_min 62.5 %, P_exc 25.0 %, eta_ITP init 12.5 %." in told
    assert "2 trials are few for this" in told


def test_where_the_recall_never_varied_nothing_is_said_to_matter() -> None:
    told = text.text_of(a_search(importance={}))
    assert "nothing says which parameters mattered" in told
    assert row(a_search(importance={}), "f_min")[-1] == "-"


def test_both_stretches_are_compared_with_intervals_and_p() -> None:
    assert row(a_search(), "searched") == [
        "searched (they chose)", "40", "36", "50.0 [37.5, 62.5]", "25.0 [12.5, 37.5]", "12", "3", "0.035",
    ]  # fmt: skip
    assert row(a_search(), "held out")[3:] == ["37.5 [25.0, 50.0]", "25.0 [12.5, 37.5]", "9", "4", "0.27"]


@pytest.mark.parametrize(
    ("checked", "verdict"),
    [
        (comparison(0.375, 0.25, 9, 4, 0.267), "On the places held out, best and paper cannot be told apart."),
        (comparison(0.5, 0.25, 12, 3, 0.035), "The best settings are better on the places held out too."),
        (comparison(0.25, 0.5, 3, 12, 0.035), "On the places held out the paper's settings are better."),
    ],
)
def test_the_verdict_is_that_of_the_places_held_out(checked: Comparison, verdict: str) -> None:
    compared = {"searched": comparison(0.5, 0.25, 12, 3, 0.035), "checked": checked}
    assert verdict in text.text_of(a_search(compared=compared))


def test_a_search_that_found_nothing_better_says_so() -> None:
    compared = {"searched": comparison(0.25, 0.25, 3, 3, 1.0), "checked": comparison(0.25, 0.25, 3, 3, 1.0)}
    assert "No trial beats the paper's settings on the searched places" in text.text_of(a_search(compared=compared))


def test_a_training_that_diverged_in_the_comparison_is_told() -> None:
    worse = replace(comparison(0.5, 0.0, 18, 0, 0.001), paper=accuracy(0.0, "more than half are alike"))
    told = text.text_of(a_search(compared={"searched": worse, "checked": worse}))
    assert "On the places held out the training under the paper's settings diverged: more than half are alike." in told


def test_trials_are_counted_by_what_came_of_them() -> None:
    told = text.text_of(a_search())
    assert "3 trials of VPRTempo on synthetic: 2 with random settings, then 1 on a grid" in told
    assert "In 1 of them the training diverged, which counts as R@1 0. Failed or killed, and made up for: 2." in told
    assert "made up for" not in text.text_of(a_search(trials=TRIALS[:2]))


def test_places_time_machine_and_study_are_named() -> None:
    told = text.text_of(a_search())
    assert "Places of the journey with seed 1: 0 to 39 (searched) and 40 to 79 (held out)." in told
    assert "tried 2 settings in 2.5 minutes, 2 at a time" in told
    assert "results/search/0123456789abcdef" in told
    assert "Abacus 9, 2 of 2 cores" in told
    assert "in 30 seconds" in text.text_of(a_search(minutes=0.5))


def test_the_command_gives_the_best_settings_to_a_run() -> None:
    words = shlex.split(text.command(a_search()))
    assert words[:5] == ["python", "-m", "vprbench", "method=vprtempo", "dataset=synthetic"]
    given = dict(word.split("=") for word in words[5:])
    assert {name: float(value) for name, value in given.items()} == {f"method.{n}": v for n, v in BEST.items()}
    assert text.command(a_search()) in text.text_of(a_search())


def test_the_command_names_rules_other_than_the_papers() -> None:
    assert "method.rules=reference" in text.command(a_search(method={"rules": "reference"}))


def test_every_trial_is_a_line_of_csv() -> None:
    lines = list(csv.DictReader(io.StringIO(text.trials_csv(a_search()))))
    assert [line["state"] for line in lines] == ["done", "diverged", "failed", "failed", "done"]
    assert [line["recall_at_1"] for line in lines] == ["0.25", "0.0", "", "", "0.5"]
    assert [line["stage"] for line in lines] == ["random"] * 4 + ["grid"]
    assert lines[1]["reason"] == "training diverged: one neuron wins, always"
    assert lines[3]["reason"] == "the search was ended meanwhile"
    assert {name: float(lines[4][name]) for name in PAPER} == BEST
    assert lines[3]["rate_min"] == ""


def test_both_files_are_written_and_the_text_to_print_names_them(tmp_path: Path) -> None:
    printed = text.write(a_search(), tmp_path)
    assert (tmp_path / "search.md").read_text(encoding="utf-8") == text.text_of(a_search())
    assert (tmp_path / "search.csv").read_text(encoding="utf-8") == text.trials_csv(a_search())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["search.csv", "search.md"]
    assert printed.startswith("# Hyperparameter search")
    assert printed.endswith(f"written to {tmp_path / 'search.md'} and {tmp_path / 'search.csv'}\n")
