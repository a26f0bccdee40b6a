"""The search: random, then a grid, never more trials than asked for, and whole again after any kill."""

import contextlib
import pickle

import numpy as np
import pytest
from little import a_run
from search_stub import Here, Stub, recall

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.plugins.options import parse_options
from vprbench.runs.store import Store
from vprbench.tuning import objective, places, space
from vprbench.tuning.objective import Task, Training
from vprbench.tuning.search import explore, search
from vprbench.tuning.settings import QUICK, Settings
from vprbench.tuning.space import PAPER
from vprbench.tuning.study import JOURNAL, find_best, list_trials, open_study, rank_parameters


def explored(folder, trials, seed=0, stub=None, killed_at=None, jobs=1):
    with open_study(folder) as study:
        explore(study, Here(killed_at), stub or Stub(), trials, seed, jobs)
        return list_trials(study)


def finished(trials):
    return [trial for trial in trials if trial.recall_at_1 is not None]


def tried(trials):
    """What was tried and what it gave, in an order that does not depend on which process was first."""
    return sorted((trial.stage, trial.point, trial.recall_at_1, *trial.values.values()) for trial in finished(trials))


def test_two_thirds_of_the_trials_are_random_and_the_rest_a_grid_around_the_best_of_them(tmp_path):
    trials = explored(tmp_path / "a", 9)
    assert [trial.stage for trial in trials] == ["random"] * 6 + ["grid"] * 3
    best = max(trials[:6], key=lambda trial: recall(trial.values))
    for trial in trials[6:]:
        assert sum(trial.values[name] != best.values[name] for name in PAPER) == 1
    assert [trial.recall_at_1 for trial in trials] == pytest.approx([recall(trial.values) for trial in trials])
    assert find_best(trials).recall_at_1 == max(trial.recall_at_1 for trial in trials)
    again, other = (tried(explored(tmp_path / name, 9, seed)) for name, seed in (("b", 0), ("c", 1)))
    assert tried(trials) == again
    assert not {values[3:] for values in again} & {values[3:] for values in other}


def test_settings_that_fail_are_stored_with_their_reason_and_a_stage_without_an_answer_ends_the_search(tmp_path):
    drawn = [values["rate_max"] for values in space.drawn(4, seed=0)]
    limit = sorted(drawn)[-1] - 1e-9  # the highest of four draws fails, and so do points of the grid above it
    trials = explored(tmp_path / "some", 6, stub=Stub(fails_above=limit))
    failed = [trial for trial in trials if trial.recall_at_1 is None]
    assert {trial.failed for trial in failed} == {"MemoryError: no room"}
    assert all(trial.values["rate_max"] > limit for trial in failed)
    with pytest.raises(RuntimeError, match="all 6 random trials failed; the last: MemoryError: no room"):
        explored(tmp_path / "all", 9, stub=Stub(fails_above=0.0))
    trials = explored(tmp_path / "diverged", 3, stub=Stub(diverges_above=0.0))
    assert [(trial.recall_at_1, trial.diverged) for trial in trials] == [(0.0, "one output neuron wins for all")] * 3


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_search_goes_on_where_it_stopped_up_to_the_number_of_trials(tmp_path, jobs):
    with contextlib.suppress(KeyboardInterrupt):
        explored(tmp_path / "killed", 9, killed_at=3)
    with open_study(tmp_path / "killed") as study:
        before = list_trials(study)
    assert [trial.recall_at_1 is not None for trial in before] == [True] * 3 + [False]
    after = explored(tmp_path / "killed", 9, jobs=jobs)
    assert after[:4] == before
    assert len({tuple(trial.values.values()) for trial in finished(after)}) == len(finished(after)) >= 8
    assert explored(tmp_path / "killed", 6) == after


def test_a_journal_that_cannot_be_read_or_is_in_use_is_named(tmp_path):
    with open_study(tmp_path), pytest.raises(BadInput, match="in use by another search"), open_study(tmp_path):
        pass
    (tmp_path / JOURNAL).write_bytes(b"no json\n{}\n")
    with pytest.raises(BadInput, match=rf"{JOURNAL} cannot be read .* move it away"), open_study(tmp_path):
        pass


def test_importance_names_the_parameters_that_matter_and_needs_a_recall_that_varies(tmp_path):
    with open_study(tmp_path / "varies") as study:
        explore(study, Here(), Stub(), 36, 0, 1)
        shares = rank_parameters(study)
    assert next(iter(shares)) == "rate_min"
    assert shares["rate_min"] > 0.5
    assert sum(shares.values()) == pytest.approx(1)
    with open_study(tmp_path / "same") as study:
        explore(study, Here(), Stub(diverges_above=0.0), 6, 0, 1)
        assert rank_parameters(study) == {}


def test_settings_under_which_nothing_is_searched_are_refused_by_name():
    for option in ("places=9", "trials=0", "jobs=0", "seed=-1"):
        with pytest.raises(BadInput, match=f"^{option}: give at least"):
            parse_options(Settings, [option], QUICK)


METHOD = {**registry.entries("method")["vprtempo"].values(), "height": 12, "width": 12, "epochs": 1}
for set_by_the_run in ("seed", "device", "tags"):
    METHOD.pop(set_by_the_run, None)
DATASET = registry.entries("dataset")["synthetic"].values()


def kept(folder, n_places, **arguments):
    """Keep the searched stretch of a rendered journey; returns it, and what tries settings on it."""
    allowed = places.searchable("synthetic", DATASET, n_places, [])
    part = places.cut(registry.make_dataset(allowed.dataset), allowed.searched)
    method = {**METHOD, "device": "cpu", **arguments}
    objective.keep(folder / "searched", part, registry.make_method(method))
    return part, pickle.loads(pickle.dumps(Training(folder, method)))  # as a process gets it


def test_a_trial_gives_the_recall_of_the_method_itself_on_the_images(tmp_path):
    part, attempt = kept(tmp_path, 20, seed=4)
    values = {**PAPER, "rate_min": 0.4}
    answers = []
    for asked, seed in ((None, 4), (9, 9)):  # the searched one, and one of the comparison
        given = attempt(Task("searched", values, asked))
        alone = registry.make_method({**attempt.method, **values, "max_module": 20, "seed": seed})
        alone.fit(part.references, part.places)
        right = [scores.argmax() == place for place, scores in enumerate(alone.query(part.queries))]
        assert given.recall_at_1 == np.mean(right) > 0
        assert given.sure_hits.tolist() == right
        answers.append(right)
    assert answers[0] != answers[1]


def test_a_training_that_diverges_answers_nothing_and_says_why(tmp_path):
    given = kept(tmp_path, 12, seed=0, homeostasis_gain=1e30)[1](Task("searched", PAPER))
    assert (given.recall_at_1, given.sure_hits.sum()) == (0.0, 0.0)
    assert given.diverged.startswith("training diverged")


@pytest.mark.extended
def test_a_real_search_compares_its_best_with_the_paper_and_the_same_again_only_compares(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("vprbench.tuning.search.ProcessPoolExecutor", lambda *_: Here())
    monkeypatch.setattr("vprbench.tuning.search.core_count", lambda: 2)
    mine = {"places": 12, "results": str(tmp_path)}
    found = search(Settings(trials=3, jobs=2, **mine), METHOD, DATASET)
    assert (len(found.trials), found.tried_now, found.jobs) == (3, 3, 2)
    compared = {name: (each.n_places, each.n_queries, each.seeds) for name, each in found.compared.items()}
    assert compared == dict.fromkeys(("searched", "checked"), (12, 12, (1, 2, 3, 4, 5)))
    assert [found.protocols[name]["stretch"] for name in ("searched", "checked")] == [[0, 11], [12, 23]]
    again = search(Settings(trials=3, jobs=1, **mine), METHOD, DATASET)
    assert (again.tried_now, again.folder, again.trials) == (0, found.folder, found.trials)
    assert again.compared == found.compared
    caplog.set_level("INFO")
    monkeypatch.setattr("vprbench.tuning.search.core_count", lambda: 1)
    queried = {**a_run().config, "dataset": {**DATASET, "seed": 3, "places": 10}}
    there = a_run(config=queried, dataset="synthetic", method="sad")
    Store(tmp_path).save(there)
    other = search(Settings(trials=1, jobs=64, **mine), {**METHOD, "rules": "v1"}, DATASET)
    assert other.folder.name != found.folder.name
    assert other.jobs == other.environment["threads"] == len(other.trials) == 1
    assert "jobs=64: 1 process is used" in caplog.text
    assert other.queried_by == (f"synthetic/sad-{there.key}",)
