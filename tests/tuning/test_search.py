"""The search: random, then a grid, never more trials than asked for, and whole again after any kill."""

import contextlib
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pytest
from optuna.trial import TrialState

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.tuning import places, space
from vprbench.tuning.search import (
    JOURNAL,
    compare_with_paper,
    explore,
    find_best,
    list_trials,
    open_study,
    search,
)
from vprbench.tuning.settings import Settings
from vprbench.tuning.space import PAPER
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
        return list_trials(study)


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
        assert find_best(study).value == max(one.value for one in trials)
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
    (tmp_path / JOURNAL).write_bytes(b"no json\n{}\n")
    with pytest.raises(BadInput, match=rf"{JOURNAL} cannot be read .* move it away"), open_study(tmp_path):
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


def stretch_of(n_places, **arguments):
    """Return the searched stretch of a rendered journey, as it is and encoded, and the arguments of the method."""
    allowed = places.choose_places("synthetic", DATASET, n_places, [])
    part = places.cut_dataset(registry.make_dataset(allowed.dataset), allowed.searched)
    method = {**METHOD, "device": "cpu", **arguments}
    return part, encode_stretch(part, registry.make_method(method), "searched"), method


def test_a_trial_gives_the_recall_of_the_method_itself_on_the_images():
    part, stretch, method = stretch_of(20)
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
