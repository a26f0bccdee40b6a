"""What a run keeps of a method's answers and gives the method: the known answers, within bounded memory."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from little import Angles, Lookup, journey, numbers_in, picture
from little_runs import asked_for, execute, kinds, run_of, table

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes, Method
from vprbench.datasets.synthetic import synthetic
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.metrics import ranking
from vprbench.metrics.accuracy import count_hits_within
from vprbench.metrics.ranking import judge_scores
from vprbench.runs import frame, rows, scorers
from vprbench.runs.answers import QueryScoring
from vprbench.runs.stopwatch import Protocol, Stopwatch

pytestmark = pytest.mark.usefixtures("surroundings")


@pytest.mark.parametrize("levels", [5, 100_000], ids=["many ties", "few ties"])
def test_queries_are_scored_in_order_in_blocks_and_have_the_outcome_of_the_whole_matrix(levels, monkeypatch):
    scores = table(300, 40, levels)
    dataset = journey(300, 40, [list(range(i % 4)) for i in range(300)])  # every fourth query has no right place
    whole = judge_scores(scores, dataset.positives)
    for cells, size in ((scorers._BLOCK_CELLS, 128), (40 * 7, 7)):  # many places are scored in smaller blocks
        monkeypatch.setattr(scorers, "_BLOCK_CELLS", cells)
        monkeypatch.setattr(ranking, "_RANKED_CELLS", min(ranking._RANKED_CELLS, cells // 2))
        method = Lookup(scores)
        run = run_of(method, dataset)
        blocks = method.asked[1 : 2 + 299 // size]
        assert [number for numbers in blocks for number in numbers] == list(range(300))
        assert {len(numbers) for numbers in blocks[:-1]} == {size}
        assert all(np.array_equal(getattr(run.outcome, name), getattr(whole, name)) for name in vars(whole))
        if levels > 5:
            assert run.top_places[:, 0].tolist() == scores.argmax(axis=1).tolist()
    large = type("Large", (Lookup,), {"code_bytes": 200 << 20})(table(12, 4))  # five are less than 1 GiB
    run_of(large, journey(12, 4))
    assert [len(numbers) for numbers in large.asked[1:4]] == [5, 5, 2]


@pytest.mark.parametrize("kind", [np.uint8, np.float64])
def test_of_places_that_tie_the_lower_comes_first_whatever_the_type(kind):
    for scores, depth, best in (
        ([0, 1, 1, 1, 9, 1, 1, 1, 1, 1], 3, [4, 1, 2]),
        ([0, 3, 2, 1], 100, [1, 2, 3, 0]),  # no more than there are
    ):
        run = run_of(Lookup(np.array([scores], kind)), journey(1, len(scores)), depth=depth)
        assert run.top_places.tolist() == [best]
        assert run.top_scores.tolist() == [[scores[place] for place in best]]
        assert (run.scores.dtype, run.top_scores.dtype) == (np.float32, np.float32)


def test_scores_of_a_wrong_shape_or_that_cannot_be_ranked_are_refused_by_name(monkeypatch):
    for spoil, named in (
        (lambda scores, _: scores[:, :-1], r"shape.*4\b"),
        (lambda scores, queries: np.where(queries[:, None] == 2, np.nan, scores), r"NaN.*query 2\b"),
        (lambda scores, queries: np.where(queries[:, None] == 200, np.inf, scores), r"\+inf.*query 200\b"),
    ):
        monkeypatch.setattr(Lookup, "match", lambda method, codes, spoil=spoil: spoil(method.table[codes], codes))
        with pytest.raises(BadInput, match=named):
            run_of(Lookup(table(300, 4)), journey(300, 4))


def test_scores_and_spikes_are_kept_of_a_method_that_overwrites_what_it_gave():
    class Reusing(Lookup):
        """Gives the same two arrays each time."""

        codes, answer = np.empty(1000, np.int64), np.empty((1000, 4), np.float32)

        def encode(self, images):
            self.codes[: len(images)] = numbers_in(images)
            return self.codes[: len(images)]

        def match(self, codes):
            self.answer[: len(codes)] = super().match(codes)
            return self.answer[: len(codes)]

        def spikes(self, codes):
            return [LayerSpikes("input", codes[:, None])]

    run = run_of(Reusing(table(300, 4)), journey(300, 4))
    assert np.array_equal(run.scores, table(300, 4))
    sample = np.linspace(0, 299, 256).astype(int)
    assert run.spikes["layers"][0]["spikes_per_query"] == sample.tolist()


@pytest.mark.parametrize("cached", [False, True])
def test_no_query_is_given_under_its_name(tmp_path, cached):
    named = Images.from_arrays([picture(i) for i in range(6)], [f"place {i % 4}" for i in range(6)])
    names = []

    class Reading(Angles):
        def encode(self, images):
            names.extend(images.names)
            return super().encode(images)

        def keeps_descriptors(self):
            return True

        def spikes(self, codes):
            return [LayerSpikes("input", codes)]

    execute(asked_for(Reading(), replace(journey(6, 4), queries=named), cache=tmp_path if cached else None))
    assert len(names) > 4 + 3 * 6
    assert all(name.startswith("image ") for name in names)


def test_candidates_stand_before_places_that_are_none(store):
    scores = table(12, 40, 100_000)
    scores[:, np.arange(40) % 10 != 3] = -np.inf  # one of each ten places is a candidate
    run = run_of(Lookup(scores), journey(12, 40), depth=6)
    assert set(run.top_places[:, :4].ravel().tolist()) == {3, 13, 23, 33}
    assert run.top_places[:, 4:].tolist() == [[0, 1]] * 12
    assert np.array_equal(np.isneginf(run.top_scores), np.tile(np.arange(6) > 3, (12, 1)))
    nowhere = run_of(Lookup(np.full((12, 40), -np.inf, np.float32)), journey(12, 40))
    assert "answers" not in kinds(run) + kinds(nowhere)
    json.dumps(frame.list_numbers(nowhere), allow_nan=False)
    assert rows.format_row(nowhere)["R@1 % [95 %]"]
    store.save(nowhere)
    (found,) = store.runs()
    assert np.array_equal(found.top_scores, nowhere.top_scores)


@pytest.mark.parametrize("shift", [0, 3, -2])
def test_a_traverse_finds_places_as_far_off_as_it_is_shifted_and_beyond_the_map_none(shift):
    asked = {"places": 40, "references": ["summer"], "query": "summer", "query_shift": shift}
    dataset = synthetic(first_query_place=5, query_places=30, unanswerable=3, **asked)
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    order = np.argsort(-scores, axis=1, kind="stable")[:, :5]
    assert order[:30, 0].tolist() == [place + shift for place in range(5, 35)]
    tolerances = (0, max(0, abs(shift) - 1), abs(shift))
    hits = count_hits_within(order, np.take_along_axis(scores, order, axis=1), dataset.positives, tolerances)
    assert hits[:, :30].mean(axis=1).tolist() == [float(shift == 0)] * 2 + [1.0]
    mapped = {image.tobytes() for image in dataset.references}
    assert not mapped & {image.tobytes() for image in dataset.queries[30:]}


N_PLACES = 27_592  # Nordland, every frame
BLOCK = 128
SCORES = np.random.default_rng(0).random((BLOCK, N_PLACES), np.float32)


class Fixed(Method):
    """Reads no image and gives the same scores to each block."""

    def fit(self, references, places):
        return self

    def encode(self, images):
        return np.zeros((len(images), 1), np.float32)

    def match(self, codes):
        return SCORES[: len(codes)]


def peak_bytes(n_blocks):
    """Return the most memory that scoring so many blocks of queries takes beside the scores of one block."""
    images = Images(lambda _: np.zeros((1, 1, 3), np.uint8), [f"image {i}" for i in range(N_PLACES)])
    queries, positives = images[: n_blocks * BLOCK], tuple(np.array([i]) for i in range(n_blocks * BLOCK))
    dataset, method = Dataset("large", images, np.arange(N_PLACES), queries, positives, {}), Fixed()
    scoring = QueryScoring(Stopwatch(Protocol()), scorers.choose_scorer(method, N_PLACES, 100), dataset, depth=100)
    tracemalloc.start()
    scoring.score(None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_a_block_of_queries_against_27592_places_needs_little_and_more_blocks_add_only_kept_answers():
    assert peak_bytes(1) < 150_000_000
    kept_per_query = 2_000  # 100 places and scores of 4 bytes each, seven counts of 8, and what lists weigh
    assert peak_bytes(13) < peak_bytes(3) + 10 * BLOCK * kept_per_query
