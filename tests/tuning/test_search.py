"""The search: random, then a grid, never more trials than asked for, and whole again after any kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from checkout import ROOT
from little import a_run
from search_stub import HALTS, Stub, recall

import vprbench
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.options import chosen
from vprbench.run import machine
from vprbench.run.store import Store
from vprbench.tuning import objective, places, space
from vprbench.tuning.objective import Task, Training, Tried
from vprbench.tuning.search import QUICK, Found, Settings, explore, search
from vprbench.tuning.space import PAPER
from vprbench.tuning.study import JOURNAL, Study, Trial, best_of, opened
from vprbench.tuning.workers import Workers

Stubs = Workers[Task, Tried]


@pytest.fixture(scope="module")
def workers() -> Iterator[Stubs]:
    """One process that gives the known recall."""
    with Workers(Stub(), 1) as workers:
        yield workers


def explored(folder: Path, workers: Stubs, trials: int, seed: int = 0) -> list[Trial]:
    with opened(folder) as study:
        explore(study, workers, trials, seed)
        return study.trials()


def with_stub(folder: Path, stub: Stub, trials: int) -> list[Trial]:
    with Workers(stub, 1) as workers:
        return explored(folder, workers, trials)


def finished(trials: list[Trial]) -> list[Trial]:
    return [trial for trial in trials if trial.recall_at_1 is not None]


def tried(trials: list[Trial]) -> list[tuple[Any, ...]]:
    """What was tried and what it gave, in an order that does not depend on which process was first."""
    return sorted((trial.stage, trial.point, trial.recall_at_1, *trial.values.values()) for trial in finished(trials))


def test_two_thirds_of_the_trials_are_random_and_the_rest_a_grid(tmp_path: Path, workers: Stubs) -> None:
    trials = explored(tmp_path, workers, 9)
    assert [trial.stage for trial in trials] == ["random"] * 6 + ["grid"] * 3


def test_the_grid_surrounds_the_best_random_settings(tmp_path: Path, workers: Stubs) -> None:
    trials = explored(tmp_path, workers, 9)
    best = max(trials[:6], key=lambda trial: recall(trial.values))
    for trial in trials[6:]:
        assert sum(trial.values[name] != best.values[name] for name in PAPER) == 1


def test_each_trial_holds_the_recall_of_its_settings(tmp_path: Path, workers: Stubs) -> None:
    for trial in explored(tmp_path, workers, 6):
        assert trial.recall_at_1 == pytest.approx(recall(trial.values), abs=1e-12)


def test_the_best_trial_is_the_one_with_the_highest_recall_of_both_stages(tmp_path: Path, workers: Stubs) -> None:
    trials = explored(tmp_path, workers, 9)
    best = best_of(trials)
    assert best is not None
    assert recall(best.values) == max(recall(trial.values) for trial in trials)


def test_the_same_seed_finds_the_same(tmp_path: Path, workers: Stubs) -> None:
    first, again = (tried(explored(tmp_path / name, workers, 9)) for name in ("first", "again"))
    assert first == again


def test_another_seed_tries_other_settings(tmp_path: Path, workers: Stubs) -> None:
    first, other = (tried(explored(tmp_path / str(seed), workers, 3, seed)) for seed in (0, 1))
    assert not {values[3:] for values in first} & {values[3:] for values in other}


def test_two_processes_find_what_one_finds(tmp_path: Path, workers: Stubs) -> None:
    alone = tried(explored(tmp_path / "one", workers, 9))
    with Workers(Stub(), 2) as two:
        assert tried(explored(tmp_path / "two", two, 9)) == alone


def test_no_more_processes_start_than_there_are_settings_to_try() -> None:
    with Workers(Stub(), 8) as many:
        assert many.started == 0
        list(many.answers([Task("searched", PAPER)] * 2, lambda task: None))
        assert many.started == 2


def test_a_search_that_is_complete_tries_nothing_more(tmp_path: Path, workers: Stubs) -> None:
    before = explored(tmp_path, workers, 6)
    with opened(tmp_path) as study:
        assert explore(study, workers, 6, 0) == 0
        assert study.trials() == before


def test_more_trials_go_on_from_those_that_are_stored(tmp_path: Path, workers: Stubs) -> None:
    before = explored(tmp_path, workers, 6)
    after = explored(tmp_path, workers, 9)
    assert after[:6] == before
    assert len(after) == 9
    assert len({tuple(trial.values.values()) for trial in after}) == 9


def test_fewer_trials_leave_those_that_are_stored(tmp_path: Path, workers: Stubs) -> None:
    before = explored(tmp_path, workers, 6)
    assert explored(tmp_path, workers, 3) == before


def test_a_process_that_dies_costs_its_trial_which_is_counted_and_made_up_for(tmp_path: Path, workers: Stubs) -> None:
    trials = with_stub(tmp_path / "dies", Stub(dies_once=tmp_path / "died"), 6)
    (failed,) = (trial for trial in trials if trial.recall_at_1 is None)
    assert failed.failed == "a worker process ended with exit code 7"
    assert tried(trials) == tried(explored(tmp_path / "whole", workers, 6))


def test_settings_that_fail_three_times_are_left_out_and_made_up_for(tmp_path: Path) -> None:
    drawn = [values["rate_max"] for values in space.drawn(4, seed=0)]
    limit = sorted(drawn)[-1] - 1e-9  # the highest of four draws fails, and so do points of the grid above it
    trials = with_stub(tmp_path, Stub(fails_above=limit), 6)
    failures = Counter(tuple(trial.values.values()) for trial in trials if trial.failed)
    assert set(failures.values()) == {3}
    assert {trial.failed for trial in trials if trial.failed} == {"MemoryError: no room"}
    assert len(finished(trials)) == 6
    assert sum(trial.stage == "random" for trial in finished(trials)) == 3


def test_where_every_trial_fails_the_search_ends_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="the first 5 trials failed; the last: MemoryError: no room"):
        with_stub(tmp_path, Stub(fails_above=0.0), 9)


def test_a_process_that_cannot_prepare_ends_the_search_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="could not prepare: ValueError: no spikes are there"):
        with_stub(tmp_path, Stub(unprepared=True), 3)


def test_a_diverged_training_counts_as_recall_0_and_is_kept_with_its_reason(tmp_path: Path) -> None:
    trials = with_stub(tmp_path, Stub(diverges_above=0.0), 3)
    assert [(trial.recall_at_1, trial.diverged) for trial in trials] == [(0.0, "one output neuron wins for all")] * 3


def test_a_killed_search_goes_on_where_it_stopped(tmp_path: Path, workers: Stubs) -> None:
    stub = ROOT / "tests" / "support" / "search_stub.py"
    home = Path(vprbench.__file__).parents[1]
    killed = tmp_path / "killed"
    with subprocess.Popen(
        [sys.executable, str(stub), str(killed), "9", "4"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(home)},
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline().strip() == HALTS  # in the fourth trial
        child.send_signal(signal.SIGKILL)
        assert child.stdout.read() == ""  # ends when its worker has ended too
    with opened(killed) as study:
        before = study.trials()
    assert [trial.recall_at_1 is not None for trial in before] == [True, True, True, False]
    after = explored(killed, workers, 9)
    assert after[:4] == before
    assert len(finished(after)) == 9
    assert tried(after) == tried(explored(tmp_path / "whole", workers, 9))


def test_whatever_part_of_the_journal_was_written_the_search_goes_on_from_it(tmp_path: Path, workers: Stubs) -> None:
    explored(tmp_path / "whole", workers, 3)
    journal = (tmp_path / "whole" / JOURNAL).read_bytes()
    for number, length in enumerate(np.linspace(0, len(journal) - 1, 12).astype(int).tolist()):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / JOURNAL).write_bytes(journal[:length])
        (folder / f"{JOURNAL}.lock").touch()
        with opened(folder) as study:
            before = finished(study.trials())
        after = explored(folder, workers, 3)
        assert finished(after)[: len(before)] == before
        assert len(finished(after)) == 3


def test_a_journal_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes(b"no json\n{}\n")
    with pytest.raises(BadInput, match=rf"{JOURNAL} cannot be read .* move it away"), opened(tmp_path):
        pass


def test_the_same_search_cannot_run_twice_at_once(tmp_path: Path) -> None:
    with opened(tmp_path), pytest.raises(BadInput, match="in use by another search"), opened(tmp_path):
        pass


def test_importance_names_the_parameters_that_matter(tmp_path: Path, workers: Stubs) -> None:
    with opened(tmp_path) as study:
        explore(study, workers, 45, 0)
        shares = study.importance()
        assert study.importance() == shares
    assert next(iter(shares)) == "rate_min"
    assert shares["rate_min"] > 0.5
    assert sum(shares.values()) == pytest.approx(1)


def stored(study: Study, stage: Any, recalls: list[float]) -> None:
    for point, (values, value) in enumerate(zip(space.drawn(len(recalls), seed=9), recalls, strict=True)):
        study.end(study.begin(stage, point, values), value, None)


def test_importance_looks_at_random_trials_alone(tmp_path: Path) -> None:
    with opened(tmp_path) as study:
        stored(study, "random", [0.1, 0.5, 0.3, 0.2])
        before = study.importance()
        stored(study, "grid", [0.9, 0.1, 0.9, 0.1])
        assert before == study.importance() != {}


def test_importance_is_empty_where_the_recall_never_varies(tmp_path: Path) -> None:
    with opened(tmp_path) as study:
        stored(study, "random", [0.5] * 5)
        assert study.importance() == {}


@pytest.mark.parametrize("option", ["places=9", "trials=0", "jobs=0", "seed=-1"])
def test_settings_under_which_nothing_is_searched_are_refused_by_name(option: str) -> None:
    with pytest.raises(BadInput, match=f"^{option}: give at least"):
        chosen(Settings, [option], QUICK)


METHOD = {
    **{name: value for name, value in yaml.safe_load(
        registry.entries("method")["vprtempo"].path.read_text(encoding="utf-8")
    ).items() if name not in ("seed", "device")},
    "height": 12,
    "width": 12,
    "epochs": 1,
}  # fmt: skip
DATASET = yaml.safe_load(registry.entries("dataset")["synthetic"].path.read_text(encoding="utf-8"))


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the threads of the process that tests run in as they are."""
    monkeypatch.setattr(machine, "pin_threads", lambda threads: None)


@pytest.mark.usefixtures("in_this_process")
def test_a_trial_gives_the_recall_of_the_method_itself_on_the_images(tmp_path: Path) -> None:
    allowed = places.searchable("synthetic", DATASET, 20, [])
    part = places.cut(registry.make_dataset(allowed.dataset), allowed.searched)
    arguments = {**METHOD, "seed": 4, "device": "cpu"}
    objective.keep(tmp_path / "searched", part, registry.make_method(arguments))
    values = {**PAPER, "rate_min": 0.4}
    attempt = Training(tmp_path, arguments)()
    answers = []
    for asked, seed in ((None, 4), (9, 9)):  # the searched one, and one of the comparison
        given = attempt(Task("searched", values, asked))
        alone = registry.make_method({**arguments, **values, "max_module": 20, "seed": seed})
        alone.fit(part.references, part.places)
        right = [scores.argmax() == place for place, scores in enumerate(alone.query(part.queries))]
        assert given.recall_at_1 == np.mean(right) > 0
        assert given.sure_hits.tolist() == right
        answers.append(right)
    assert answers[0] != answers[1]


@pytest.mark.usefixtures("in_this_process")
def test_a_training_that_diverges_answers_nothing_and_says_why(tmp_path: Path) -> None:
    allowed = places.searchable("synthetic", DATASET, 12, [])
    part = places.cut(registry.make_dataset(allowed.dataset), allowed.searched)
    arguments = {**METHOD, "seed": 0, "device": "cpu", "homeostasis_gain": 1e30}
    objective.keep(tmp_path / "searched", part, registry.make_method(arguments))
    given = Training(tmp_path, arguments)()(Task("searched", PAPER))
    assert (given.recall_at_1, given.sure_hits.sum()) == (0.0, 0.0)
    assert given.diverged is not None
    assert given.diverged.startswith("training diverged")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def found(results: Path) -> Iterator[Found]:
    settings = Settings(places=12, trials=3, jobs=2, results=str(results))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "cores", lambda: [0, 1])
        yield search(settings, METHOD, DATASET)


def test_a_real_search_compares_its_best_with_the_paper_on_both_stretches(found: Found) -> None:
    assert (len(found.trials), found.tried_now, found.jobs) == (3, 3, 2)
    assert {name: (each.n_places, each.n_queries) for name, each in found.compared.items()} == {
        "searched": (12, 12),
        "checked": (12, 12),
    }
    assert {each.seeds for each in found.compared.values()} == {(1, 2, 3, 4, 5)}
    assert [found.protocols[name]["stretch"] for name in ("searched", "checked")] == [[0, 11], [12, 23]]


def test_the_same_real_search_again_only_compares(found: Found, results: Path) -> None:
    again = search(Settings(places=12, trials=3, jobs=1, results=str(results)), METHOD, DATASET)
    assert again.tried_now == 0
    assert (again.folder, again.trials, again.compared) == (found.folder, found.trials, found.compared)


def test_more_jobs_than_cores_are_not_started_and_stored_runs_on_these_places_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    monkeypatch.setattr(machine, "cores", lambda: [0])
    there = a_run(
        config={**a_run().config, "dataset": {**DATASET, "seed": 1, "places": 10}}, dataset="synthetic", method="sad"
    )
    Store(tmp_path).save(there)
    crowded = search(Settings(places=12, trials=1, jobs=64, results=str(tmp_path)), METHOD, DATASET)
    assert crowded.jobs == crowded.environment["threads"] == 1
    assert "jobs=64: 1 process is used" in caplog.text
    assert crowded.queried_by == (f"synthetic/sad-{there.key}",)


@pytest.mark.parametrize("change", [{"epochs": 2}, {"rules": "v1"}])
def test_a_search_of_another_method_is_another_study(found: Found, results: Path, change: dict[str, Any]) -> None:
    other = search(Settings(places=12, trials=1, jobs=1, results=str(results)), {**METHOD, **change}, DATASET)
    assert other.folder != found.folder
    assert len(other.trials) == 1


def test_a_dataset_without_free_places_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    reported = {**DATASET, "first_query_place": 0, "query_places": 3300}
    del reported["seed"]
    with pytest.raises(BadInput, match="query all of its 3300 places"):
        search(Settings(dataset="mine", results=str(tmp_path)), METHOD, reported)
    assert not list(tmp_path.iterdir())
