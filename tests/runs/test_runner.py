"""What a run records of a method's answers, search and times, what it notes on them, and what it gives the method."""

import fcntl
import json
import re
from dataclasses import dataclass, field, replace
from itertools import chain, repeat

import numpy as np
import pytest
from little import Lookup, journey, number_in, numbers_in, picture, slow_pictures
from little_runs import QUICK, asked_for, kinds, run_of, table
from stopped_clock import Clock

from vprbench import progress
from vprbench.api.binary import BinaryMethod
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.hamming import pack_bits
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.errors import BadInput
from vprbench.metrics import ranking
from vprbench.metrics.ranking import outcome
from vprbench.runs import answers, frame, rows, scorers, timing_lock
from vprbench.runs.run import execute

pytestmark = pytest.mark.usefixtures("surroundings")


@pytest.mark.parametrize("levels", [5, 100_000], ids=["many ties", "few ties"])
def test_queries_are_scored_in_order_in_blocks_and_have_the_outcome_of_the_whole_matrix(levels, monkeypatch):
    scores = table(300, 40, levels)
    dataset = journey(300, 40, [list(range(i % 4)) for i in range(300)])  # every fourth query has no right place
    whole = outcome(scores, dataset.positives)
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


def test_a_small_matrix_is_kept_whole_and_no_larger_one(monkeypatch):
    for limit in (1200, 1199):
        monkeypatch.setattr(answers, "_LARGEST_MATRIX", limit)
        run = run_of(Lookup(table(300, 4)), journey(300, 4))
        assert np.array_equal(run.scores, table(300, 4)) if limit == 1200 else run.scores is None


def test_scores_of_a_wrong_shape_or_that_cannot_be_ranked_are_refused_by_name(monkeypatch):
    for spoil, named in (
        (lambda scores, _: scores[:, :-1], r"shape.*4\b"),
        (lambda scores, _: scores[:, :, None], r"shape.*4\b"),
        (lambda scores, _: scores[:1], r"shape.*4\b"),
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


@dataclass(kw_only=True)
class Reading(DescriptorMethod):
    """Notes the names of the images that it encodes after the fit."""

    names: list[str] = field(default_factory=list)

    def encode(self, images):
        if self.searched is not None:
            self.names += images.names
        return np.array([[number_in(image) + 1, 1] for image in images], np.float32)

    def keeps_descriptors(self):
        return True

    def spikes(self, codes):
        return [LayerSpikes("input", codes)]


@pytest.mark.parametrize("cached", [False, True])
def test_no_query_is_given_under_its_name(tmp_path, cached):
    named = Images.from_arrays([picture(i) for i in range(6)], [f"place {i % 4}" for i in range(6)])
    method, dataset = Reading(), replace(journey(6, 4), queries=named)
    execute(asked_for(method, dataset, cache=tmp_path if cached else None), "key")
    assert len(method.names) > 3 * 6
    assert all(name.startswith("image ") for name in method.names)


def test_fit_sees_every_reference_and_its_place_which_cannot_be_written():
    seen = []

    class Writing(Lookup):
        def fit(self, references, places):
            seen.append((numbers_in(references), places.tolist()))
            places[0] = 1

    dataset = journey(6, 4)
    with pytest.raises(ValueError, match="read-only"):
        run_of(Writing(table(6, 4)), dataset)
    assert dataset.places.flags.writeable
    assert seen == [([0, 1, 2, 3], [0, 1, 2, 3])]


def test_candidates_stand_before_places_that_are_none_and_the_timed_answer_is_compared_with_them(store):
    class Turned(Lookup):
        """Names the worst candidate where it is asked for a single image."""

        def match(self, codes):
            scores = self.table[codes]
            return np.where(np.isfinite(scores), -scores, scores) if len(codes) == 1 else scores

    scores = table(12, 40, 100_000)
    scores[:, np.arange(40) % 10 != 3] = -np.inf  # one of each ten places is a candidate
    run = run_of(Lookup(scores), journey(12, 40), depth=6)
    assert set(run.top_places[:, :4].ravel().tolist()) == {3, 13, 23, 33}
    assert run.top_places[:, 4:].tolist() == [[0, 1]] * 12
    assert np.array_equal(np.isneginf(run.top_scores), np.tile(np.arange(6) > 3, (12, 1)))
    assert "answers" not in kinds(run)
    assert "answers" in kinds(run_of(Turned(scores), journey(12, 40), depth=6))
    run = run_of(Lookup(np.full((12, 40), -np.inf, np.float32)), journey(12, 40))
    assert "answers" not in kinds(run)
    json.dumps(frame.list_numbers(run), allow_nan=False)
    assert rows.format_row(run)["R@1 % [95 %]"]
    store.save(run)
    (found,) = store.runs()
    assert np.array_equal(found.top_scores, run.top_scores)


@dataclass
class Angles(DescriptorMethod):
    """Describes image number i by cosines of i, in 16 dimensions."""

    shown: int = field(default=0, init=False)

    def encode(self, images):
        self.shown += len(images)
        vectors = np.cos(np.outer(numbers_in(images), np.arange(1, 17)) + np.arange(16))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


def searching(index, **arguments):
    """Return a run over 300 places, what it records of its search, and its notes on that."""
    run = run_of(Angles(index=index, **arguments), journey(300, 300))
    return run, dict(run.search), [note.text for note in run.notes if note.kind == "index"]


def test_a_run_records_and_says_how_good_its_index_is_what_is_compared_again_and_how_long_it_took():
    run, found, _ = searching("hnsw", neighbours=20)
    assert found["index"] == "hnsw"
    assert 0.9 < found["recall_at_1"] <= 1
    assert 0.9 < found["recall_at_10"] <= 1
    assert 16 * 4 + 64 * 4 <= found["bytes_per_place"] < 16 * 4 + 64 * 4 + 40  # vector, links, and where they lie
    assert np.isneginf(run.scores).sum(1).tolist() == [280] * 300
    _, found, (note,) = searching("hnsw", neighbours=5)
    assert found["recall_at_10"] == pytest.approx(0.5, abs=0.02)  # 5 of the best 10
    parts = r"index hnsw: (100\.0|9\d\.\d) % .*, (50\.0|4\d\.\d) % of the best 10; 3\d\d bytes a place, .* \d\.\d s"
    assert re.fullmatch(parts, note)
    run, found, (note,) = searching("binary", rerank=40)
    assert (found["rerank"], found["bytes_per_place"]) == (40, 8)  # 16 bits in a word
    assert 0 < found["build_seconds"] < 60
    assert np.isneginf(run.scores).sum(1).tolist() == [260] * 300
    assert note.startswith("index binary, the best 40 ")


def test_exact_search_goes_without_saying_codes_of_bits_tell_their_bytes_and_a_match_of_its_own_records_none():
    class OwnWay(Angles):
        def fit(self, references, places):
            return self

        def match(self, codes):
            return codes[:, :4]

    class Signs(BinaryMethod):
        def encode(self, images):
            return pack_bits(np.stack([np.resize(image > 127, 100) for image in images]))

    assert [run_of(method, journey(6, 4)).search for method in (OwnWay(), Lookup(table(6, 4)))] == [None, None]
    exact = {"index": "exact", "bytes_per_place": 64, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert searching("exact")[1:] == (exact, [])
    signs = run_of(Signs(), journey(6, 4))
    assert signs.search == {**exact, "bytes_per_place": 16}
    assert any("16 bytes a place" in note.text for note in signs.notes)


@pytest.mark.parametrize(
    ("n_queries", "code_bytes", "n_audited"),
    [(3, 64, 3), (700, 64, 256), (30, 200 << 20, 5)],  # five codes of 200 MB are less than 1 GiB
)
def test_an_index_is_compared_on_up_to_256_queries_from_the_first_to_the_last(
    n_queries, code_bytes, n_audited, monkeypatch
):
    class Watched(Angles):
        seen = ()

        def audit(self, codes):
            self.seen += (codes,)
            return super().audit(codes)

    monkeypatch.setattr(Watched, "code_bytes", code_bytes)
    method, queries = Watched(index="hnsw"), journey(n_queries, 300)
    run_of(method, queries)
    every = Angles().encode(queries.queries)
    (codes,) = method.seen
    spread = [int(np.flatnonzero((every == code).all(1))[0]) for code in codes]
    assert (len(spread), spread[0], spread[-1]) == (n_audited, 0, n_queries - 1)
    assert np.ptp(np.diff(spread)) <= 1


@dataclass
class Learning(Lookup):
    """Reads all references and then computes for 60 ms; needs 5 ms for each image of a query, and 1 ms to match it.

    600 ms of the training may be left to the first image.
    """

    clock: Clock = field(kw_only=True)
    late: float = 0.0

    def fit(self, references, places):
        list(references)
        self.clock.spend(0.06)
        return self

    def encode(self, images):
        self.clock.spend(self.late + 0.005 * len(images))
        self.late = 0.0
        return super().encode(images)

    def match(self, codes):
        self.clock.spend(0.001 * len(codes))
        return super().match(codes)


@pytest.mark.parametrize("excess", [0, 0.6])
def test_times_of_fit_computing_first_query_method_and_harness_are_told_apart(clock, monkeypatch, surroundings, excess):
    monkeypatch.setattr(
        surroundings, "describe_machine", lambda *_: clock.spend(7) or {}
    )  # a look at the machine takes 7 s
    references, queries = (slow_pictures(8, 0.02, clock.spend) for _ in range(2))
    numbers_in(references)  # what is read before a run does not count
    dataset = replace(journey(8, 8), references=references, queries=queries)
    run = run_of(Learning(table(8, 8), clock=clock, late=excess), dataset)
    shown = frame.list_numbers(run)
    assert (shown["fit_seconds"], shown["fit_compute_seconds"]) == pytest.approx((8 * 0.02 + 0.06, 0.06))
    assert run.timing.first_query_seconds == pytest.approx(0.006 + excess)
    assert rows.format_row(run)["fit s"] == "0.22"
    assert run.method_seconds == pytest.approx(
        0.06 + 8 * 0.006 + 0.006 + excess
    )  # the first query is asked once before
    assert run.harness_seconds == pytest.approx(7)


def test_timing_takes_its_order_from_the_seed_of_the_run_and_every_stage_is_reported_to_its_end():
    told, orders = [], []
    with progress.send_reports_to(lambda stage, done: told.append((stage, done))):
        run_of(Lookup(table(300, 4)), journey(300, 4))
    assert list(dict.fromkeys(stage for stage, _ in told)) == ["fit", "query", "timing"]
    assert [done for stage, done in told if stage == "query"] == pytest.approx([128 / 300, 256 / 300, 1])
    for seed in (0, 0, 1):
        method = Lookup(table(12, 4))
        run_of(method, journey(12, 4), seed=seed)
        orders.append(method.asked)
    assert orders[0] == orders[1] != orders[2]


def test_rates_are_called_invalid_without_their_minima_alone(clock):
    protocol = replace(QUICK, minimum_queries=3000, maximum_seconds=0.005)
    method = Learning(table(12, 4), clock=clock)
    assert "invalid" in kinds(run_of(method, journey(12, 4), protocol))
    assert not {"invalid", "offline"} & {*kinds(run_of(method, journey(12, 4)))}


@pytest.mark.parametrize(
    ("scores", "spoil", "differs"),
    [
        (table(12, 4), lambda scores, codes: np.roll(scores, len(codes) == 1, axis=1), True),  # for a single image
        (table(300, 4, 100_000), lambda scores, codes: -scores if codes.tolist() == [299] else scores, True),
        (table(300, 40), lambda scores, _: scores, False),
        (np.ones((12, 200), np.float32), lambda scores, _: scores, False),  # all places tie
        (  # another last digit in a batch
            np.ones((12, 3), np.float32),
            lambda scores, codes: scores * np.where(np.arange(3) == len(codes) % 2, np.float32(1 + 1e-6), 1),
            False,
        ),
    ],
)
def test_a_note_says_that_a_method_answers_otherwise_when_it_is_timed(scores, spoil, differs):
    class Spoilt(Lookup):
        def match(self, codes):
            return spoil(self.table[codes], codes)

    assert ("answers" in kinds(run_of(Spoilt(scores), journey(*scores.shape)))) is differs


@pytest.mark.parametrize(
    ("waited", "after", "noisy"),
    [
        *((None, 1.0, False), (1000, 1.0, True)),
        *((0.0, each, abs(each - 1) > 0.05) for each in (1.04, 1.06, 0.94, 0.96)),
    ],
)
def test_a_run_is_noisy_if_processes_waited_for_a_core_or_a_fixed_computation_drifts_by_more_than_five_percent(
    monkeypatch, surroundings, waited, after, noisy
):
    canaries = chain([1.0] * 3, repeat(after))  # until timing begins
    pressures = iter(range(9))
    monkeypatch.setattr(
        surroundings,
        "read_cpu_wait_seconds",
        lambda: None if waited is None else waited * next(pressures),
    )
    monkeypatch.setattr(surroundings, "time_canary", lambda: next(canaries))
    assert ("noisy" in kinds(run_of(Lookup(table(12, 4)), journey(12, 4)))) is noisy


def test_a_run_beside_others_says_so_of_its_fit_and_waits_to_be_timed_alone(tmp_path, monkeypatch):
    monkeypatch.setenv(timing_lock.FOLDER, str(tmp_path))
    with (timing_lock.folder() / "computing").open("ab") as of_another_run:

        def end_the_other(stage, _):
            if stage == "waiting to be timed":
                fcntl.flock(of_another_run, fcntl.LOCK_UN)

        for alone in (True, False):
            fcntl.flock(of_another_run, fcntl.LOCK_UN if alone else fcntl.LOCK_SH)
            with progress.send_reports_to(end_the_other):
                run = run_of(Lookup(table(12, 4)), journey(12, 4))
            numbers = frame.list_numbers(run)
            assert (numbers["fitted_alone"], numbers["timed_alone"]) == (alone, True)
            assert ("fitted" in kinds(run)) is not alone
