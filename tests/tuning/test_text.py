"""What a search tells people: the settings, what mattered, how sure the gain is, and how to go on."""

import csv
import io
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from checkout import ROOT
from little import a_run

from vprbench.config import make_request
from vprbench.metrics.intervals import McNemar, WiderInterval
from vprbench.tuning import text
from vprbench.tuning.comparison import Comparison, Repeated
from vprbench.tuning.search import Found
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER
from vprbench.tuning.study import Trial

BEST = {**PAPER, "rate_min": 0.35, "p_excitatory": 0.225, "stdp_rate": 0.00062}
TRIALS = (
    Trial(0, "random", 0, BEST, 0.25, None, None, 1.25),
    Trial(1, "random", 1, BEST, 0.0, "training diverged: one neuron wins, always", None, 1.25),
    Trial(2, "random", 2, BEST, None, None, "MemoryError: no room", None),
    Trial(3, "random", 3, {}, None, None, "", None),
    Trial(4, "grid", 0, BEST, 0.5, None, None, 1.25),
)
MACHINE = {"cores": 8, "memory_bytes": 8e9, "platform": "Linux", "python": "3.11.7", "vprbench": "0.6.1"}


def comparison(gain, low, high):
    """Best has 0.5 in the mean and paper less by `gain`, with every seed; 0.1 apart from seed to seed."""
    recalls = (0.3, 0.4, 0.5, 0.6, 0.7)
    tests = tuple(McNemar(n, 2 * n, 1 / 2**n) for n in range(5))
    best, paper = (Repeated(each, (None,) * 5) for each in (recalls, tuple(recall - gain for recall in recalls)))
    return Comparison(40, 36, (6, 7, 8, 9, 10), best, paper, WiderInterval(low, high, "blocks", 7), tests)


BETTER, OPEN = comparison(0.25, 0.125, 0.375), comparison(0.125, -0.0625, 0.25)
WORSE = comparison(-0.25, -0.375, -0.125)
FEW = replace(OPEN, n_queries=12, interval=None)
DIVERGED = replace(BETTER, paper=Repeated((0.0,) * 5, (None, "more than half are alike", None, None, None)))


def a_search(**changes):
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        method={"max_module": 1100},
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
        environment={**a_run().environment, **MACHINE},
    )
    return replace(found, **changes)


def test_a_search_is_told_as_it_is_stored():
    # the sample deviation of 30, 40, 50, 60 and 70 is sqrt(1000 / 4) = 15.8
    assert text.to_text(a_search()) == (ROOT / "tests/tuning/search.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"importance": {}}, "nothing says which parameters mattered"),
        ({"compared": {"searched": OPEN, "checked": BETTER}}, "held out the best settings are better."),
        ({"compared": {"searched": BETTER, "checked": WORSE}}, "held out the paper's settings are better."),
        ({"compared": {"searched": FEW, "checked": FEW}}, "+12.5 [-]"),
        ({"compared": {"searched": OPEN, "checked": DIVERGED}}, "with seed 7: more than half are alike."),
        ({"queried_by": tuple("abcde")}, "a, b, c and 2 more do:"),
        ({"minutes": 0.5}, "in 30 seconds"),
    ],
)
def test_what_is_peculiar_to_a_search_is_told(changes, told):
    assert told in text.to_text(a_search(**changes))
    assert told not in text.to_text(a_search())


@pytest.mark.parametrize("name", ["synthetic", "nordland", "oxford_robotcar"])
def test_the_command_runs_the_best_settings_on_the_dataset(name):
    dataset = make_request(["method=vprtempo", f"dataset={name}"]).dataset
    folder = "/data/it's a 100% path, {really}"
    settings = Settings(dataset=name, root=folder if "root" in dataset else None)
    command = shlex.split(text.command(a_search(settings=settings, dataset=dataset)))
    run = make_request(command[3:])
    assert run.dataset.get("root") == settings.root
    assert run.method["max_module"] == 1100
    assert {name: run.method[name] for name in BEST} == BEST


def test_every_trial_is_a_line_of_csv():
    lines = list(csv.DictReader(io.StringIO(text.trials_csv(a_search()))))
    assert [[line[name] for name in ("stage", "state", "recall_at_1", "reason")] for line in lines] == [
        ["random", "done", "0.25", ""],
        ["random", "diverged", "0.0", "training diverged: one neuron wins, always"],
        ["random", "failed", "", "MemoryError: no room"],
        ["random", "failed", "", "the search was ended meanwhile"],
        ["grid", "done", "0.5", ""],
    ]
    assert {name: float(lines[4][name]) for name in PAPER} == BEST
    assert lines[3]["rate_min"] == ""


@pytest.mark.parametrize(
    ("settings", "stem"),
    [({}, "search"), ({"dataset": "nordland"}, "search-nordland"), ({"quick": True}, "search-quick")],
)
def test_files_are_written_by_dataset_and_size_and_into_the_study(tmp_path, settings, stem):
    found = a_search(settings=Settings(**settings), folder=tmp_path / "study")
    found.folder.mkdir()
    text.write(found, tmp_path)
    for place, name in ((tmp_path, stem), (found.folder, "search")):
        written = {path.name: path.read_text(encoding="utf-8") for path in place.iterdir() if path.is_file()}
        assert written == {f"{name}.csv": text.trials_csv(found), f"{name}.md": text.to_text(found)}
