"""What a search tells people: the settings, what mattered, how sure the gain is, and how to go on."""

from __future__ import annotations

import csv
import io
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from vprbench.metrics.intervals import McNemar, WiderInterval
from vprbench.paper.plan import read_plan
from vprbench.plugins import registry
from vprbench.run import compose
from vprbench.tuning import text
from vprbench.tuning.comparison import Comparison, Repeated
from vprbench.tuning.search import Found, Settings
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


SEEDS = (6, 7, 8, 9, 10)


def repeated(*recalls: float) -> Repeated:
    return Repeated(recalls, (None,) * 5)


def comparison(gain: float, low: float, high: float) -> Comparison:
    """Best has 0.5 in the mean and paper less by `gain`, with every seed; 0.1 apart from seed to seed."""
    recalls = (0.3, 0.4, 0.5, 0.6, 0.7)
    tests = tuple(McNemar(n, 2 * n, 1 / 2**n) for n in range(5))
    paper = repeated(*(recall - gain for recall in recalls))
    return Comparison(40, 36, SEEDS, repeated(*recalls), paper, WiderInterval(low, high, "blocks", 7), tests)


BETTER = comparison(0.25, 0.125, 0.375)
OPEN = comparison(0.125, -0.0625, 0.25)
WORSE = comparison(-0.25, -0.375, -0.125)


def a_search(**changes: Any) -> Found:
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        method={"rules": "paper", "max_module": 1100},
        dataset={"places": 3300, "seed": 0},
        protocols={"searched": {"seed": 1, "stretch": [0, 39]}, "checked": {"seed": 1, "stretch": [40, 79]}},
        folder=Path("results/search/0123456789abcdef"),
        trials=TRIALS,
        tried_now=2,
        best=TRIALS[4],
        importance={"rate_min": 0.625, "p_excitatory": 0.25, "itp_rate": 0.125},
        compared={"searched": BETTER, "checked": OPEN},
        queried_by=(),
        jobs=2,
        minutes=2.5,
        environment={
            "processor": "Abacus 9",
            "threads": 1,
            "cores": 8,
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


def test_both_stretches_are_compared_by_mean_deviation_and_difference() -> None:
    # the sample deviation of 30, 40, 50, 60 and 70 is sqrt(1000 / 4) = 15.8
    assert row(a_search(), "searched (they") == [
        "searched (they chose)", "40", "36", "50.0 ± 15.8", "25.0 ± 15.8", "+25.0 [+12.5, +37.5]", "5 of 5",
    ]  # fmt: skip
    assert row(a_search(), "held out (they")[3:] == ["50.0 ± 15.8", "37.5 ± 15.8", "+12.5 [-6.2, +25.0]", "5 of 5"]


def test_each_seed_stands_with_its_difference_and_its_own_test() -> None:
    lines = [line for line in text.text_of(a_search()).splitlines() if line.startswith("| held out |")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [line[1] for line in cells] == ["6", "7", "8", "9", "10"]
    assert cells[2] == ["held out", "8", "50.0", "37.5", "+12.5", "2", "4", "0.25"]


def test_the_recall_of_the_best_trial_is_told_as_the_highest_of_all_trials() -> None:
    told = text.text_of(a_search())
    assert "The best trial has R@1 50.0 %. That is the highest of 3 trials, all trained with seed 5" in told


@pytest.mark.parametrize(
    ("checked", "verdict", "warning"),
    [
        (OPEN, "On the places held out, best and paper cannot be told apart.", "not shown to be better than"),
        (BETTER, "On the places held out the best settings are better.", None),
        (WORSE, "On the places held out the paper's settings are better.", "worse than"),
    ],
)
def test_the_verdict_is_that_of_the_places_held_out_and_stands_above_the_command(
    checked: Comparison, verdict: str, warning: str | None
) -> None:
    told = text.text_of(a_search(compared={"searched": BETTER, "checked": checked}))
    assert verdict in told
    above = told.partition("## Run the best settings")[2].partition("```")[0].strip()
    assert above == ("" if warning is None else f"On the places held out these settings were {warning} the paper's.")


def test_where_the_searched_places_show_no_gain_either_that_is_said() -> None:
    told = text.text_of(a_search(compared={"searched": comparison(0.0, -0.1, 0.1), "checked": OPEN}))
    assert "the best settings do not beat the paper's where they were searched either" in told


def test_too_few_queries_for_an_interval_are_told() -> None:
    few = replace(OPEN, n_queries=12, interval=None)
    told = text.text_of(a_search(compared={"searched": few, "checked": few}))
    assert "12 queries are too few for an interval" in told
    assert row(a_search(compared={"searched": few, "checked": few}), "held out (they")[5] == "+12.5 [-]"


def test_a_training_that_diverged_in_the_comparison_is_told() -> None:
    worse = replace(BETTER, paper=Repeated((0.0,) * 5, (None, "more than half are alike", None, None, None)))
    told = text.text_of(a_search(compared={"searched": OPEN, "checked": worse}))
    assert (
        "On the places held out the training under the paper's settings diverged with seed 7: more than half are alike."
        in told
    )


def test_who_else_queries_these_places_is_told() -> None:
    assert "No column of the table and no stored run queries any of these places." in text.text_of(a_search())
    told = text.text_of(a_search(queried_by=("synthetic/sad-1", "synthetic/sad-2")))
    assert "but of the stored runs synthetic/sad-1, synthetic/sad-2 do: under the best settings" in told


def test_recorded_places_are_said_to_stay_in_the_map_of_reported_results() -> None:
    recorded = {"searched": {"stretch": [0, 39]}, "checked": {"stretch": [40, 79]}}
    stay = "As references they stay in the map of reported results, and columns on request may query them."
    assert stay in text.text_of(a_search(protocols=recorded))
    assert stay not in text.text_of(a_search())


def test_trials_are_counted_by_what_came_of_them() -> None:
    told = text.text_of(a_search())
    assert "3 trials of VPRTempo on synthetic: 2 with random settings, then 1 on a grid" in told
    assert "In 1 of them the training diverged, which counts as R@1 0. Failed or killed, and made up for: 2." in told
    assert "made up for" not in text.text_of(a_search(trials=TRIALS[:2]))


def test_places_time_machine_and_study_are_named() -> None:
    told = text.text_of(a_search())
    assert "Places of the journey with seed 1: 0 to 39 (searched) and 40 to 79 (held out)." in told
    assert "tried 2 settings in 2.5 minutes." in told
    assert "results/search/0123456789abcdef" in told
    assert "Abacus 9, 2 processes of one thread on 8 cores, 8 GB, Linux." in told
    assert "Abacus 9, 1 process of one thread on 8 cores" in text.text_of(a_search(jobs=1))
    assert "in 30 seconds" in text.text_of(a_search(minutes=0.5))


def test_the_command_gives_the_best_settings_to_a_run() -> None:
    words = shlex.split(text.command(a_search()))
    assert words[:5] == ["python", "-m", "vprbench", "method=vprtempo", "dataset=synthetic"]
    given = dict(word.split("=") for word in words[5:])
    assert {name: float(value) for name, value in given.items()} == {f"method.{n}": v for n, v in BEST.items()}
    assert text.command(a_search()) in text.text_of(a_search())


def test_the_command_names_rules_other_than_the_papers() -> None:
    assert "method.rules=reference" in text.command(a_search(method={"rules": "reference", "max_module": 1100}))


def composed(found: Found) -> dict[str, Any]:
    python, _, _, *options = shlex.split(text.command(found))
    assert python == "python"
    return compose.composed(compose.readable(options))


def test_the_command_composes_a_run_whose_method_holds_the_places_of_its_dataset() -> None:
    street = compose.composed(["method=vprtempo", "dataset=street"])
    found = a_search(settings=Settings(dataset="street"), method=street["method"], dataset=street["dataset"])
    run = composed(found)
    method, dataset = registry.make_method(run["method"]), registry.make_dataset(run["dataset"])
    assert dataset.n_places == 450
    assert vars(method)["max_module"] == 450
    assert {name: run["method"][name] for name in BEST} == BEST


@pytest.mark.parametrize("name", ["synthetic", "street", "nordland", "oxford_robotcar"])
def test_the_command_fits_the_network_to_the_dataset_as_the_table_does(name: str) -> None:
    columns = read_plan(registry.conf_folders()["vprbench"] / "table.yaml").columns.values()
    (fits,) = (column.fits for column in columns if column.options == (f"dataset={name}",))
    config = compose.composed(["method=vprtempo", f"dataset={name}"])
    run = composed(a_search(settings=Settings(dataset=name), dataset=config["dataset"]))
    assert run["method"]["max_module"] == fits.get("vprtempo", {}).get("max_module", 1100)


def test_the_command_gives_the_folder_of_a_recorded_dataset_whatever_letters_it_has() -> None:
    folder = "/data/it's a 100% path, {really}"
    settings = Settings(dataset="nordland", root=folder)
    assert composed(a_search(settings=settings))["dataset"]["root"] == folder


def test_every_trial_is_a_line_of_csv() -> None:
    lines = list(csv.DictReader(io.StringIO(text.trials_csv(a_search()))))
    assert [line["state"] for line in lines] == ["done", "diverged", "failed", "failed", "done"]
    assert [line["recall_at_1"] for line in lines] == ["0.25", "0.0", "", "", "0.5"]
    assert [line["stage"] for line in lines] == ["random"] * 4 + ["grid"]
    assert lines[1]["reason"] == "training diverged: one neuron wins, always"
    assert lines[3]["reason"] == "the search was ended meanwhile"
    assert {name: float(lines[4][name]) for name in PAPER} == BEST
    assert lines[3]["rate_min"] == ""


@pytest.mark.parametrize(
    ("settings", "stem"),
    [
        (Settings(), "search"),
        (Settings(dataset="street"), "search-street"),
        (Settings(quick=True), "search-quick"),
        (Settings(dataset="street", quick=True), "search-street-quick"),
    ],
)
def test_both_files_are_written_by_dataset_and_size_and_into_the_study_and_the_text_to_print_names_them(
    tmp_path: Path, settings: Settings, stem: str
) -> None:
    study = tmp_path / "search" / "0123456789abcdef"
    study.mkdir(parents=True)
    found = a_search(settings=settings, folder=study)
    printed = text.write(found, tmp_path)
    for place, name in ((tmp_path, stem), (study, "search")):
        assert sorted(path.name for path in place.iterdir() if path.is_file()) == [f"{name}.csv", f"{name}.md"]
        assert (place / f"{name}.md").read_text(encoding="utf-8") == text.text_of(found)
        assert (place / f"{name}.csv").read_text(encoding="utf-8") == text.trials_csv(found)
    assert printed.startswith("# Hyperparameter search")
    assert printed.endswith(f"written to {tmp_path / stem}.md and {tmp_path / stem}.csv, and into {study}\n")
