"""The search: random, then a grid, whole again after any kill, and what it tells people."""

import contextlib
import csv
import io
import shlex
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial

from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.tuning import places, space, text
from vprbench.tuning import search as searching
from vprbench.tuning.search import Found, compare_with_paper, explore, open_study, search
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER, PARAMETERS
from vprbench.tuning.trial import Hits, encode_stretch, train_and_query


def recall(values):
    """Best at f_min 0.4, which matters most; P_exc matters a little, nothing else does."""
    return 0.8 - abs(values["rate_min"] - 0.4) - 0.1 * abs(values["p_excitatory"] - 0.2)


@dataclass
class Stub:
    """What a process of the search does instead of training: a known recall, and ways to fail."""

    fails_above: float = 2.0  # rate_max
    diverges_above: float = 2.0  # rate_max
    shifts_by_seed: float = 0.0  # how much less recall a seed has than the one before
    killed_at: int | None = None  # the training that an interruption ends
    trained: int = 0

    def __call__(self, values, stretch="searched", seed=0):
        if self.trained == self.killed_at:
            raise KeyboardInterrupt
        self.trained += 1
        if values["rate_max"] > self.fails_above:
            raise MemoryError("no room")
        if values["rate_max"] > self.diverges_above:
            return Hits(np.zeros(1), "one output neuron wins for all")
        return Hits(np.array([recall(values) - seed * self.shifts_by_seed]))


def explored(folder, trials, seed=0, stub=None, workers=1):
    with open_study(folder) as study:
        explore(study, stub or Stub(), trials, seed, workers)
        return searching.list_trials(study)


def tried(trials):
    """The settings and what they gave, of the trials that ended well."""
    return [(one.user_attrs["stage"], one.value, one.params) for one in trials if one.value is not None]


def test_two_thirds_of_the_trials_are_random_and_the_rest_a_grid_around_the_best_of_them(tmp_path):
    trials = explored(tmp_path / "a", 9)
    assert [one.user_attrs["stage"] for one in trials] == ["random"] * 6 + ["grid"] * 3
    best = max(trials[:6], key=lambda one: recall(one.params))
    for one in trials[6:]:
        assert sum(one.params[name] != best.params[name] for name in PAPER) == 1
    assert [one.value for one in trials] == pytest.approx([recall(one.params) for one in trials])
    with open_study(tmp_path / "a") as study:
        assert searching.find_best_trial(study).value == max(one.value for one in trials)
    again, other = (tried(explored(tmp_path / name, 9, seed, workers=2)) for name, seed in (("b", 0), ("c", 1)))
    assert tried(trials) == again
    assert not any(mine == theirs for *_, mine in again for *_, theirs in other)


def test_settings_that_fail_are_stored_with_their_reason_and_a_stage_without_an_answer_ends_the_search(tmp_path):
    drawn = [values["rate_max"] for values in islice(space.draw_settings(seed=0), 4)]
    limit = sorted(drawn)[-1] - 1e-9  # the highest of four draws fails, and so do points of the grid above it
    failed = [one for one in explored(tmp_path / "some", 6, stub=Stub(fails_above=limit)) if one.value is None]
    assert {one.user_attrs["failed"] for one in failed} == {"MemoryError: no room"}
    assert all(one.params["rate_max"] > limit for one in failed)
    with pytest.raises(RuntimeError, match="all 6 trials failed; the last: MemoryError: no room"):
        explored(tmp_path / "all", 9, stub=Stub(fails_above=0.0))
    trials = explored(tmp_path / "diverged", 3, stub=Stub(diverges_above=0.0))
    assert [(one.value, one.user_attrs["diverged"]) for one in trials] == [(0.0, "one output neuron wins for all")] * 3


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_search_goes_on_where_it_stopped_up_to_the_number_of_trials(tmp_path, workers):
    with contextlib.suppress(KeyboardInterrupt):
        explored(tmp_path / "killed", 9, stub=Stub(killed_at=3))
    with open_study(tmp_path / "killed") as study:
        states = [one.state for one in study.trials]
        assert states == [TrialState.COMPLETE] * 3 + [TrialState.FAIL] + [TrialState.WAITING] * 2
    after = explored(tmp_path / "killed", 9, workers=workers)
    assert sorted(map(str, tried(after))) == sorted(map(str, tried(explored(tmp_path / "whole", 9))))
    stub = Stub()
    assert tried(explored(tmp_path / "killed", 9, stub=stub)) == tried(after)
    assert stub.trained == 0


def test_a_journal_that_cannot_be_read_or_is_in_use_is_named(tmp_path):
    with open_study(tmp_path), pytest.raises(BadInput, match="in use by another search"), open_study(tmp_path):
        pass
    (tmp_path / searching.JOURNAL).write_bytes(b"no json\n{}\n")
    with pytest.raises(BadInput, match=rf"{searching.JOURNAL} cannot be read .* move it away"), open_study(tmp_path):
        pass


def test_both_settings_are_trained_with_the_five_seeds_after_the_searched_one_and_a_failure_ends_it():
    best = {**PAPER, "rate_min": 0.4}
    best_hits, paper_hits = compare_with_paper(Stub(shifts_by_seed=0.01), best, seed=7, workers=2)
    for hits, settings in ((best_hits, best), (paper_hits, PAPER)):
        assert hits.mean(axis=1) == pytest.approx([recall(settings) - 0.01 * seed for seed in range(8, 13)])
    with pytest.raises(MemoryError, match="no room"):
        compare_with_paper(Stub(fails_above=0.0), PAPER, seed=0, workers=1)


METHOD = {**registry.find_entries("method")["vprtempo"].values(), "height": 12, "width": 12, "epochs": 1}
for set_by_the_run in ("seed", "device", "tags"):
    METHOD.pop(set_by_the_run, None)
DATASET = registry.find_entries("dataset")["synthetic"].values()


def test_a_trial_gives_the_recall_of_the_method_itself_on_the_images():
    allowed = places.choose_places("synthetic", DATASET, 20, [])
    part, method = (
        places.cut_dataset(registry.make_dataset(allowed.dataset), allowed.searched),
        {**METHOD, "device": "cpu"},
    )
    stretch = encode_stretch(part, registry.make_method(method), "searched")
    answers = []
    for seed in (4, 9):
        arguments = {**method, **PAPER, "rate_min": 0.4, "seed": seed}
        hits = train_and_query(arguments, stretch)
        alone = registry.make_method({**arguments, "max_module": 20})
        alone.fit(part.references, part.places)
        right = [scores.argmax() == place for place, scores in enumerate(alone.query(part.queries))]
        assert hits.expected.tolist() == right
        assert any(right)
        answers.append(right)
    assert answers[0] != answers[1]


class Here(Executor):
    """In place of processes: works in this one."""

    def submit(self, work, /, *arguments):
        future = Future()
        future.set_result(work(*arguments))
        return future


@pytest.mark.extended
def test_a_real_search_compares_its_best_with_the_paper_and_the_same_again_only_compares(tmp_path, monkeypatch):
    monkeypatch.setattr("vprbench.tuning.search.ProcessPoolExecutor", lambda *_: Here())
    mine = {"places": 12, "results": str(tmp_path), "workers": 1}
    found = search(Settings(trials=3, **mine), METHOD, DATASET)
    assert (len(found.trials), found.best_hits.shape) == (3, (5, 12))
    assert (found.searched, found.checked) == (range(12), range(12, 24))
    again = search(Settings(trials=3, **mine), METHOD, DATASET)
    assert (again.folder, again.trials) == (found.folder, found.trials)
    assert np.array_equal(again.best_hits, found.best_hits)
    other = search(Settings(trials=1, **mine), {**METHOD, "rules": "v1"}, DATASET)
    assert other.folder.name != found.folder.name


BEST = {**PAPER, "rate_min": 0.35, "p_excitatory": 0.225, "stdp_rate": 0.00062}
START = datetime(2025, 1, 31, tzinfo=UTC)


def made_trial(number, stage, value, diverged="", failed=""):
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


MADE_TRIALS = (
    made_trial(0, "random", 0.25),
    made_trial(1, "random", 0.0, diverged="training diverged: one neuron wins, always"),
    made_trial(2, "random", None, failed="MemoryError: no room"),
    made_trial(4, "grid", 0.5),
)
BEST_RECALLS = np.repeat([[0.3], [0.4], [0.5], [0.6], [0.7]], 36, axis=1)  # (seeds, queries); mean 0.5


def a_search(gain=0.25, **changes):
    found = Found(
        settings=Settings(places=40, trials=3, seed=5),
        searched=range(40),
        checked=range(40, 80),
        folder=Path("results/search/0123456789abcdef"),
        trials=MADE_TRIALS,
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
