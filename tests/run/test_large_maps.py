"""On a large map a run asks for the best places alone: the same best places, and never the scores of all."""

import gc
from dataclasses import fields, replace

import numpy as np
import pytest
from little import Angles, journey, pictures
from little_runs import QUICK, asked_for, kinds, run_of

from vprbench.api import descriptor
from vprbench.metrics.ranking import Outcome, outcome, outcome_of_best, ranked_places
from vprbench.run import descriptors, fitting, runner, shortlist
from vprbench.storage import shards

pytestmark = pytest.mark.usefixtures("surroundings")

N_QUERIES, N_PLACES, DEPTH = 30, 90, 6


class Shortlisted(Angles):
    """Cannot score all places."""

    def match(self, codes):
        raise AssertionError("all places were scored")

    def nearest(self, codes, n, **how):
        return super().nearest(codes, n, **how)


@pytest.fixture
def large(monkeypatch):
    """Make maps of as many places as here large ones."""
    monkeypatch.setattr(shortlist, "LARGE_MAP", N_PLACES - 1)


def on(method, **changes):
    dataset = journey(N_QUERIES, N_PLACES, [[i, (i + 40) % N_PLACES] if i % 5 else [] for i in range(N_QUERIES)])
    return run_of(method, dataset, QUICK, **{"depth": DEPTH, **changes})


def only(places, scores, n_places):
    """Return scores under which no other places than these are candidates."""
    found = np.full((len(scores), n_places), -np.inf, np.float32)
    np.put_along_axis(found, places.astype(np.int64), scores, axis=1)
    return found


def same(one, other):
    return all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(Outcome))


def test_the_outcome_of_the_best_places_is_that_of_scores_whose_other_places_are_no_candidates():
    generator = np.random.default_rng(0)
    scores = generator.integers(0, 12, (200, 40)).astype(np.float32)
    scores[generator.random(scores.shape) < 0.3] = -np.inf
    scores[7] = -np.inf
    positives = [generator.integers(0, 40, generator.integers(0, 5)) for _ in scores]
    places, best = ranked_places(scores, 9)
    found = outcome_of_best(best, places.astype(np.int64), positives, 40)
    assert same(found, outcome(only(places, best, 40), positives))
    assert (found.above == 40).any()


@pytest.mark.usefixtures("large")
def test_a_large_map_is_asked_for_its_best_places_alone_when_scored_and_when_timed():
    run = on(Shortlisted())
    twenty = Angles().encode(pictures(range(20))).astype(np.float64)
    scores = (twenty @ twenty.T).astype(np.float32)[np.arange(N_QUERIES)[:, None] % 20, np.arange(N_PLACES) % 20]
    places, best = ranked_places(scores, DEPTH)
    assert np.array_equal(run.top_places, places)
    np.testing.assert_allclose(run.top_scores, best, atol=1e-6)
    assert same(run.outcome, outcome(only(places, run.top_scores, N_PLACES), run.positives))
    assert (run.outcome.n_places, run.scores, "audit" in kinds(run)) == (N_PLACES, None, False)
    (note,) = [note.text for note in run.notes if note.kind == "shortlist"]
    assert ("90 places" in note, f"best {DEPTH} " in note) == (True, True)


@pytest.mark.parametrize("neighbours", [3, DEPTH])
def test_an_index_gives_what_it_gives_where_all_places_are_scored(neighbours, monkeypatch):
    usual = on(Angles(index="hnsw", neighbours=neighbours))
    monkeypatch.setattr(shortlist, "LARGE_MAP", N_PLACES - 1)
    large = on(Angles(index="hnsw", neighbours=neighbours))
    assert ("shortlist" in kinds(usual), "shortlist" in kinds(large)) == (False, True)
    assert np.array_equal(large.top_places, usual.top_places)
    assert np.array_equal(large.top_scores, usual.top_scores)
    assert same(large.outcome, usual.outcome)


@pytest.mark.usefixtures("large")
def test_all_places_are_scored_where_all_scores_are_wanted_and_where_a_method_matches_in_its_own_way():
    class OwnWay(Angles):
        def match(self, codes):
            return -super().match(codes)

    whole = runner.run(replace(asked_for(Angles(), journey(N_QUERIES, N_PLACES)), scores=True), "key")
    for run in (whole, on(OwnWay())):
        assert run.scores.shape == (N_QUERIES, N_PLACES)
        assert "shortlist" not in kinds(run)


def test_descriptors_of_a_large_map_are_kept_unless_a_method_may_learn_them(tmp_path, monkeypatch):
    class Learning(Angles):
        def fit(self, references, places):
            return super().fit(references, places)

    for large, method, kept in ((N_PLACES, Angles(), 0), (N_PLACES - 1, Learning(), 0), (N_PLACES - 1, Angles(), 2)):
        monkeypatch.setattr(descriptors, "LARGE_MAP", large)
        runner.run(asked_for(method, journey(N_QUERIES, N_PLACES), cache=tmp_path), "key")
        assert len([*tmp_path.glob("*/*.npy")]) == kept


@pytest.mark.parametrize("cached", [False, True])
def test_descriptors_that_fill_the_memory_stay_in_shards(cached, tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_SCRATCH", str(tmp_path / "scratch"))
    monkeypatch.setattr(shards, "_LEAST_ROWS", 64)
    for module in (descriptor, fitting):
        monkeypatch.setattr(module, "LARGE_BYTES", 1000)
    monkeypatch.setattr(Angles, "keeps_descriptors", lambda _: cached)
    method = Angles()
    run = runner.run(asked_for(method, journey(N_QUERIES, N_PLACES), cache=tmp_path / "cache"), "key")
    assert method.searched.references.array is None
    folder = tmp_path / ("cache" if cached else "scratch")
    assert len([*folder.glob("*/*.npy")]) == 2 + cached  # of 90 references, and of 30 queries
    np.testing.assert_allclose(run.scores, on(Angles()).scores, atol=1e-6)
    del method
    gc.collect()
    assert not [*(tmp_path / "scratch").glob("*/*.npy")]
