"""What a run records of a method's answers and times, and what it makes known about them."""

from __future__ import annotations

import gc
import importlib.util
import itertools
import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey, number_in, picture, pictures, slow_pictures

from vprbench import environment, progress, runner, tables
from vprbench.descriptor_cache import DescriptorCache
from vprbench.images import Images
from vprbench.interface import BadInput, Dataset, DescriptorMethod, Method, Places, Scores
from vprbench.ranking import Outcome, outcome
from vprbench.records import Run, Store
from vprbench.search import Audit, Kind
from vprbench.stopwatch import Protocol

CONFIG: dict[str, Any] = {
    "method": {"_target_": "little.Lookup", "window": 5, "device": "cpu"},
    "dataset": {"name": "journey"},
    "seed": 0,
    "device": "cpu",
    "depth": 3,
    "overrides": [],
}
QUICK = Protocol(minimum_seconds=0, minimum_queries=5, sample=16, warmup_queries=2, batch_sizes=[1, 4])


def run_of(method: Method, dataset: Dataset, protocol: Protocol = QUICK, **changes: Any) -> Run:
    return runner.run("little", method, dataset, {**CONFIG, **changes}, "key", "fingerprint", protocol, 1)


def table(n_queries: int, n_places: int, levels: int = 1000) -> Scores:
    """Return random scores of so many levels."""
    return np.random.default_rng(1).integers(0, levels, (n_queries, n_places)).astype(np.float32)


@pytest.fixture(scope="module", autouse=True)
def surroundings() -> Iterator[SimpleNamespace]:
    """Leave out of a run what is tested on its own and takes long: the canary and the look at the machine."""
    quick = {"capture": lambda device, threads: {}, "canary_seconds": lambda: 1.0, "cpu_pressure": lambda: 0.0}
    with pytest.MonkeyPatch.context() as patch:
        stand_in = SimpleNamespace(**{**vars(environment), **quick})
        patch.setattr(runner, "environment", stand_in)
        gc.freeze()  # a measurement collects garbage first, which takes long among all that a test session imports
        yield stand_in
        gc.unfreeze()


# Answers


@pytest.fixture(scope="module", params=[5, 100_000], ids=["many ties", "few ties"])
def in_blocks_and_whole(request: pytest.FixtureRequest) -> tuple[Outcome, Outcome]:
    scores = table(300, 40, request.param)
    dataset = journey(300, 40, [list(range(i % 4)) for i in range(300)])  # every fourth query has no right place
    return run_of(Lookup(scores), dataset).outcome, outcome(scores, dataset.positives)


@pytest.mark.parametrize("name", Outcome.__dataclass_fields__)
def test_the_outcome_of_300_queries_in_blocks_is_that_of_the_whole_matrix(
    in_blocks_and_whole: tuple[Outcome, Outcome], name: str
) -> None:
    in_blocks, whole = in_blocks_and_whole
    assert np.array_equal(getattr(in_blocks, name), getattr(whole, name))


def test_queries_are_scored_in_order_and_each_once() -> None:
    scores = table(300, 4)
    method = Lookup(scores)
    run_of(method, journey(300, 4))
    assert [number for numbers in method.asked[:3] for number in numbers] == list(range(300))


def test_best_places_come_first() -> None:
    scores = np.array([[1, 5, 3, 4], [9, 2, 8, 7]], np.float32)
    run = run_of(Lookup(scores), journey(2, 4))
    assert run.top_places.tolist() == [[1, 3, 2], [0, 2, 3]]


def test_their_scores_come_in_the_same_order() -> None:
    scores = np.array([[1, 5, 3, 4], [9, 2, 8, 7]], np.float32)
    run = run_of(Lookup(scores), journey(2, 4))
    assert run.top_scores.tolist() == [[5, 4, 3], [9, 8, 7]]


def test_of_places_that_tie_the_lower_comes_first() -> None:
    scores = np.array([[2, 1, 2, 1, 2]], np.float32)
    assert run_of(Lookup(scores), journey(1, 5), depth=5).top_places.tolist() == [[0, 2, 4, 1, 3]]


def test_of_places_that_tie_at_the_depth_the_lower_is_kept() -> None:
    scores = np.array([[0, 1, 1, 1, 9, 1, 1, 1, 1, 1]], np.float32)
    assert run_of(Lookup(scores), journey(1, 10)).top_places.tolist() == [[4, 1, 2]]


def test_no_more_places_are_kept_than_there_are() -> None:
    assert run_of(Lookup(table(2, 4)), journey(2, 4), depth=100).top_places.shape == (2, 4)


def test_best_places_of_later_blocks_belong_to_their_queries() -> None:
    scores = table(300, 40, 100_000)
    assert run_of(Lookup(scores), journey(300, 40)).top_places[:, 0].tolist() == scores.argmax(axis=1).tolist()


def test_scores_of_another_type_are_ranked_as_what_they_are() -> None:
    scores = np.array([[0, 3, 2, 1]], np.uint8)
    run = run_of(Lookup(scores), journey(1, 4), depth=4)  # type: ignore[arg-type]
    assert run.top_places.tolist() == [[1, 2, 3, 0]]


def test_scores_of_another_type_are_kept_as_float32() -> None:
    run = run_of(Lookup(table(2, 4).astype(np.float64)), journey(2, 4))  # type: ignore[arg-type]
    assert run.scores is not None
    assert (run.scores.dtype, run.top_scores.dtype) == (np.float32, np.float32)


def test_a_small_matrix_is_kept_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_LARGEST_MATRIX", 1200)
    scores = table(300, 4)
    run = run_of(Lookup(scores), journey(300, 4))
    assert run.scores is not None
    assert np.array_equal(run.scores, scores)


def test_a_matrix_beyond_the_limit_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_LARGEST_MATRIX", 1199)
    assert run_of(Lookup(table(300, 4)), journey(300, 4)).scores is None


# Answers that no method may give


@pytest.mark.parametrize(
    "spoil",
    [
        lambda scores: scores[:, :-1],
        lambda scores: np.hstack([scores, scores[:, :1]]),
        lambda scores: scores[0],
        lambda scores: scores[:, :, None],
        lambda scores: scores[:1],
        lambda scores: np.vstack([scores, scores[:1]]),
        lambda scores: scores[:0],
    ],
    ids=["place missing", "place too many", "one dimension", "three", "query missing", "query too many", "nothing"],
)
def test_scores_of_a_wrong_shape_are_refused_with_the_shape_wanted(spoil: Callable[[Scores], Scores]) -> None:
    @dataclass
    class Spoilt(Lookup):
        def match(self, codes: npt.NDArray[np.int64]) -> Scores:
            return spoil(self.table[codes])

    with pytest.raises(BadInput, match=r"shape.*4\b"):
        run_of(Spoilt(table(6, 4)), journey(6, 4))


@pytest.mark.parametrize(("value", "name"), [(np.nan, "NaN"), (np.inf, r"\+inf")])
def test_scores_that_cannot_be_ranked_are_refused_by_name(value: float, name: str) -> None:
    scores = table(6, 4)
    scores[2, 3] = value
    with pytest.raises(BadInput, match=rf"{name}.*query 2\b"):
        run_of(Lookup(scores), journey(6, 4))


def test_a_query_of_a_later_block_is_named_by_its_own_number() -> None:
    scores = table(300, 4)
    scores[200, 1] = np.nan
    with pytest.raises(BadInput, match=r"query 200\b"):
        run_of(Lookup(scores), journey(300, 4))


# What a method is given


def test_places_given_to_fit_cannot_be_written() -> None:
    @dataclass
    class Writing(Lookup):
        def fit(self, references: Images, places: Places) -> Self:
            places[0] = 1
            return self

    with pytest.raises(ValueError, match="read-only"):
        run_of(Writing(table(6, 4)), journey(6, 4))


def test_the_places_of_the_dataset_stay_writable() -> None:
    dataset = journey(6, 4)
    run_of(Lookup(table(6, 4)), dataset)
    assert dataset.places.flags.writeable


def test_fit_sees_every_reference_and_its_place() -> None:
    seen: list[tuple[list[int], list[int]]] = []

    @dataclass
    class Looking(Lookup):
        def fit(self, references: Images, places: Places) -> Self:
            seen.append(([number_in(image) for image in references], places.tolist()))
            return self

    run_of(Looking(table(6, 4)), journey(6, 4))
    assert seen == [([0, 1, 2, 3], [0, 1, 2, 3])]


def test_an_error_of_the_method_reaches_the_caller() -> None:
    @dataclass
    class Broken(Lookup):
        def fit(self, references: Images, places: Places) -> Self:
            raise ZeroDivisionError("of the method")

    with pytest.raises(ZeroDivisionError, match="of the method"):
        run_of(Broken(table(6, 4)), journey(6, 4))


def test_many_places_are_scored_in_smaller_blocks_and_give_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scores, dataset = table(300, 40, 5), journey(300, 40)
    usual = run_of(Lookup(scores), dataset)
    monkeypatch.setattr(runner, "_BLOCK_CELLS", 40 * 7)
    monkeypatch.setattr(runner, "_RANKED_CELLS", 40 * 3)
    method = Lookup(scores)
    blocked = run_of(method, dataset)
    assert [len(numbers) for numbers in method.asked[:43]] == [7] * 42 + [6]
    assert np.array_equal(blocked.top_places, usual.top_places)
    assert np.array_equal(blocked.top_scores, usual.top_scores)
    assert all(np.array_equal(getattr(blocked.outcome, n), getattr(usual.outcome, n)) for n in Outcome.__annotations__)


def test_queries_of_large_codes_are_scored_in_smaller_blocks() -> None:
    class Large(Lookup):
        code_bytes = 200 << 20  # five are less than 1 GiB

    method = Large(table(12, 4))
    run_of(method, journey(12, 4))
    assert [len(numbers) for numbers in method.asked[:3]] == [5, 5, 2]


# Places that are no candidates, and the search of descriptors


def with_few_candidates(n_queries: int = 12, n_places: int = 40) -> Scores:
    """Return scores under which of each ten places one is a candidate."""
    scores = table(n_queries, n_places, 100_000)
    scores[:, np.arange(n_places) % 10 != 3] = -np.inf
    return scores


def test_candidates_stand_before_places_that_are_none() -> None:
    run = run_of(Lookup(with_few_candidates()), journey(12, 40), depth=6)
    assert set(run.top_places[:, :4].ravel().tolist()) == {3, 13, 23, 33}
    assert run.top_places[:, 4:].tolist() == [[0, 1]] * 12
    assert np.isfinite(run.top_scores[:, :4]).all()
    assert np.isneginf(run.top_scores[:, 4:]).all()


@pytest.mark.parametrize("candidates", ["few", "none"])
def test_places_that_are_no_candidates_pass_the_audit_and_give_plain_numbers(candidates: str, tmp_path: Path) -> None:
    scores = with_few_candidates() if candidates == "few" else np.full((12, 40), -np.inf, np.float32)
    run = run_of(Lookup(scores), journey(12, 40))
    assert not any("audit" in note for note in run.notes)
    json.dumps(tables.numbers(run), allow_nan=False)
    assert tables.readable_row(run)["R@1 % [95 %]"]
    stored = Store(tmp_path)
    stored.save(run)
    found = stored.find("journey", "little", "key")
    assert found is not None
    assert np.array_equal(found.top_scores, run.top_scores)


def test_an_answer_that_was_worse_when_scored_fails_the_audit_beside_places_that_are_no_candidates() -> None:
    @dataclass
    class Turned(Lookup):
        """Names the worst candidate where it is asked for a single image."""

        def match(self, codes: npt.NDArray[np.int64]) -> Scores:
            scores = self.table[codes]
            return np.where(np.isfinite(scores), -scores, scores) if len(codes) == 1 else scores

    run = run_of(Turned(with_few_candidates()), journey(12, 40), depth=6)
    assert any("audit failed" in note for note in run.notes)


@dataclass
class Angles(DescriptorMethod):
    """Describes image number i by cosines of i, in 16 dimensions."""

    shown: list[int] = field(default_factory=list, init=False)

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        self.shown.append(len(images))
        numbers = np.array([number_in(image) for image in images])
        vectors = np.cos(numbers[:, None] * np.arange(1, 17) + np.arange(16))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.float32)


def searching(index: Kind, n_queries: int = 300, **arguments: Any) -> Run:
    return run_of(Angles(index=index, **arguments), journey(n_queries, 300))


def test_a_run_records_how_good_its_index_is() -> None:
    run = searching("hnsw", neighbours=20)
    assert run.search is not None
    assert run.search["index"] == "hnsw"
    assert 0.9 < run.search["recall_at_1"] <= 1
    assert 0.9 < run.search["recall_at_10"] <= 1
    assert 16 * 4 + 64 * 4 <= run.search["bytes_per_place"] < 16 * 4 + 64 * 4 + 40  # vector, links, and where they lie
    assert np.isneginf(run.scores).sum(1).tolist() == [280] * 300


def test_what_an_index_misses_is_recorded_and_said() -> None:
    run = searching("hnsw", neighbours=5)
    assert run.search is not None
    assert run.search["recall_at_1"] > 0.9
    assert run.search["recall_at_10"] == pytest.approx(0.5, abs=0.02)  # 5 of the best 10
    (note,) = (note for note in run.notes if note.startswith("index"))
    assert re.fullmatch(
        r"index hnsw: (100\.0|9\d\.\d) % of the exactly best places found, (50\.0|4\d\.\d) % of the best 10; "
        r"3\d\d bytes a place",
        note,
    )


def test_exact_search_finds_everything_and_goes_without_saying() -> None:
    run = searching("exact")
    assert run.search == {"index": "exact", "bytes_per_place": 64, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert not any(note.startswith("index") for note in run.notes)


def test_a_method_that_searches_no_descriptors_records_no_search() -> None:
    assert run_of(Lookup(table(6, 4)), journey(6, 4)).search is None


def test_a_descriptor_method_that_matches_in_its_own_way_records_no_search() -> None:
    class OwnWay(Angles):
        def fit(self, references: Images, places: Places) -> Self:
            return self

        def match(self, codes: npt.NDArray[np.float32]) -> Scores:
            return codes[:, :4]

    assert run_of(OwnWay(), journey(6, 4)).search is None


@pytest.mark.parametrize("kept", [False, True], ids=["encoded", "descriptors kept"])
@pytest.mark.parametrize(("n_queries", "n_audited"), [(3, 3), (700, 256)])
def test_an_index_is_compared_on_up_to_256_queries_from_the_first_to_the_last(
    n_queries: int, n_audited: int, kept: bool, tmp_path: Path
) -> None:
    seen: list[npt.NDArray[np.float32]] = []

    class Watched(Angles):
        def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
            seen.append(codes)
            return super().audit(codes)

        def keeps_descriptors(self) -> bool:
            return kept

    queries = journey(n_queries, 300)
    runner.run("a", Watched(index="hnsw"), queries, CONFIG, "key", "hash", QUICK, 1, cache=DescriptorCache(tmp_path))
    assert any(tmp_path.iterdir()) is kept
    every = Angles().encode(queries.queries)
    (codes,) = seen
    assert len(codes) == n_audited
    assert np.array_equal(codes[[0, -1]], every[[0, -1]])
    spread = [int(np.flatnonzero((every == code).all(1))[0]) for code in codes]
    assert set(np.diff(spread)) <= {1, 2, 3}


def test_few_large_codes_are_kept_for_an_audit() -> None:
    class Large(Angles):
        code_bytes = 200 << 20  # five are less than 1 GiB

        def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
            assert len(codes) == 5
            return super().audit(codes)

    assert run_of(Large(index="hnsw"), journey(30, 300)).search is not None


def test_an_audit_shows_the_method_no_image_again() -> None:
    shown = []
    for index in ("exact", "hnsw"):
        method = Angles(index=index)  # type: ignore[arg-type]
        run_of(method, journey(30, 300), replace(QUICK, warmup_queries=1, minimum_queries=1, batch_sizes=[1]))
        shown.append(sum(method.shown))
    assert shown[0] == shown[1]


# Notes


def notes_of(method: Method, dataset: Dataset, protocol: Protocol = QUICK) -> str:
    return "\n".join(run_of(method, dataset, protocol).notes)


@dataclass
class Caching(Lookup):
    """Needs 5 ms for an image, and 1 ms for one that is among the last `remembered` different ones."""

    remembered: int = 1
    cache: dict[bytes, int] = field(default_factory=dict)

    def encode(self, images: Images) -> npt.NDArray[np.int64]:
        return np.array([self._number(image) for image in images])

    def _number(self, image: npt.NDArray[np.uint8]) -> int:
        time.sleep(0.001)
        pixels = image.tobytes()
        if pixels not in self.cache:
            time.sleep(0.004)
            self.cache[pixels] = number_in(image)
            for oldest in list(self.cache)[: -self.remembered]:
                del self.cache[oldest]
        return self.cache[pixels]


def test_a_method_that_remembers_the_last_image_is_said_to_cache() -> None:
    assert "caching" in notes_of(Caching(table(12, 4)), journey(12, 4))


def test_a_method_that_remembers_all_images_is_said_to_cache() -> None:
    assert "caching" in notes_of(Caching(table(12, 4), remembered=1000), journey(12, 4))


def test_a_method_that_works_for_each_image_is_not_said_to_cache() -> None:
    @dataclass
    class Working(Lookup):
        def encode(self, images: Images) -> npt.NDArray[np.int64]:
            time.sleep(0.004 * len(images))
            return super().encode(images)

    assert "caching" not in notes_of(Working(table(12, 4)), journey(12, 4))


@dataclass
class BatchDependent(Lookup):
    """Answers with the next place when it is asked for a single image."""

    def match(self, codes: npt.NDArray[np.int64]) -> Scores:
        scores = self.table[codes]
        return np.roll(scores, 1, axis=1) if len(codes) == 1 else scores


def test_a_method_whose_answer_depends_on_the_batch_fails_the_audit() -> None:
    assert "audit failed" in notes_of(BatchDependent(table(12, 4)), journey(12, 4))


def test_a_method_that_answers_differently_when_timed_fails_the_audit() -> None:
    @dataclass
    class Lazy(Lookup):
        def match(self, codes: npt.NDArray[np.int64]) -> Scores:
            scored = sum(map(len, self.asked)) <= len(self.table)
            return self.table[codes] if scored else np.ones((len(codes), self.table.shape[1]), np.float32)

    scores = np.eye(12, 4, k=-1, dtype=np.float32)  # query 1 shows place 0
    assert "audit failed" in notes_of(Lazy(scores), journey(12, 4))


def test_a_method_that_fails_on_one_timed_query_in_sixteen_fails_the_audit() -> None:
    @dataclass
    class Unreliable(Lookup):
        def match(self, codes: npt.NDArray[np.int64]) -> Scores:
            scores = self.table[codes].copy()
            if codes.tolist() == [299]:
                scores[0] = -scores[0]
            return scores

    assert "audit failed" in notes_of(Unreliable(table(300, 4, 100_000)), journey(300, 4))


def test_a_method_that_answers_the_same_passes_the_audit() -> None:
    assert "audit" not in notes_of(Lookup(table(300, 40)), journey(300, 40))


def test_a_method_whose_best_places_tie_passes_the_audit() -> None:
    assert "audit" not in notes_of(Lookup(np.ones((12, 200), np.float32)), journey(12, 200))


def test_a_difference_in_the_last_digit_passes_the_audit() -> None:
    @dataclass
    class Rounding(Lookup):
        def match(self, codes: npt.NDArray[np.int64]) -> Scores:
            scores = self.table[codes].copy()
            scores[:, len(codes) % 2] *= 1 + 1e-6
            return scores

    assert "audit" not in notes_of(Rounding(np.ones((12, 3), np.float32)), journey(12, 3))


def test_rates_without_their_minima_are_called_invalid() -> None:
    protocol = replace(QUICK, minimum_queries=3000, maximum_seconds=0.005)
    assert "invalid rates" in notes_of(Lookup(table(12, 4)), journey(12, 4), protocol)


def test_rates_that_meet_their_minima_are_not_called_invalid() -> None:
    assert "invalid" not in notes_of(Lookup(table(12, 4)), journey(12, 4))


@pytest.mark.parametrize(("after", "noisy"), [(1.04, False), (1.06, True), (0.94, True), (0.96, False)])
def test_a_run_is_noisy_where_a_fixed_computation_drifts_by_more_than_five_percent(
    monkeypatch: pytest.MonkeyPatch, surroundings: SimpleNamespace, after: float, noisy: bool
) -> None:
    canaries = iter([1.0, after])
    monkeypatch.setattr(surroundings, "canary_seconds", lambda: next(canaries))
    assert ("noisy" in notes_of(Lookup(table(12, 4)), journey(12, 4))) is noisy


# Times


@dataclass
class Learning(Lookup):
    """Reads all references and then computes for 60 ms."""

    def fit(self, references: Images, places: Places) -> Self:
        list(references)
        time.sleep(0.06)
        return self


def slow_journey() -> Dataset:
    """Return a dataset whose eight references take 160 ms to read."""
    return replace(journey(8, 8), references=slow_pictures(8, 0.02, time.sleep))


@pytest.fixture(scope="module")
def slow_run() -> Run:
    return run_of(Learning(table(8, 8)), slow_journey())


def test_fit_seconds_hold_reading_and_computing(slow_run: Run) -> None:
    assert slow_run.fit_seconds < 1
    assert slow_run.fit_seconds >= slow_run.fit_compute_seconds + 0.02


def test_fit_compute_seconds_hold_the_computing(slow_run: Run) -> None:
    assert slow_run.fit_compute_seconds >= 0.06


def test_fit_compute_seconds_do_not_hold_the_waiting_for_images(slow_run: Run) -> None:
    # Eight images of 20 ms are read by up to eight threads, which begin at once.
    assert slow_run.fit_compute_seconds <= slow_run.fit_seconds - 0.02


def test_a_second_run_on_the_same_dataset_does_not_count_the_reading_of_the_first() -> None:
    dataset = slow_journey()
    run_of(Learning(table(8, 8)), dataset)
    assert run_of(Learning(table(8, 8)), dataset).fit_compute_seconds >= 0.06


def test_a_dataset_that_has_read_its_first_images_already_gives_the_same_compute_seconds() -> None:
    dataset = slow_journey()
    for i in range(8):
        dataset.references[i]
    assert run_of(Learning(table(8, 8)), dataset).fit_compute_seconds >= 0.06


def test_harness_seconds_do_not_hold_the_time_of_the_method(slow_run: Run) -> None:
    assert 0 <= slow_run.harness_seconds < slow_run.method_seconds + 0.15


def test_timing_takes_its_order_from_the_seed_of_the_run() -> None:
    orders = []
    for seed in (0, 0, 1):
        method = Lookup(table(12, 4))
        run_of(method, journey(12, 4), seed=seed)
        orders.append(method.asked)
    assert orders[0] == orders[1] != orders[2]


def test_every_stage_is_reported() -> None:
    stages: list[str] = []
    with progress.listening(lambda stage, _: stages.append(stage)):
        run_of(Lookup(table(300, 4)), journey(300, 4))
    assert list(dict.fromkeys(stages)) == ["fit", "query", "timing"]


def test_a_reported_share_rises_to_one_with_the_queries() -> None:
    shares: list[float] = []
    with progress.listening(lambda stage, done: shares.append(done) if stage == "query" else None):
        run_of(Lookup(table(300, 4)), journey(300, 4))
    assert shares == pytest.approx([128 / 300, 256 / 300, 1])


# Keys

METHOD = Lookup(np.ones((6, 4), np.float32))


def key(dataset: Dataset | None = None, protocol: Protocol = QUICK, threads: int = 1, **changes: Any) -> str:
    dataset = dataset or journey(6, 4)
    config: Mapping[str, Any] = {**CONFIG, **changes}
    return runner.run_key(METHOD, config, dataset, runner.fingerprint(dataset), protocol, threads)


def test_a_run_asked_for_again_has_the_same_key() -> None:
    assert key(journey(6, 4)) == key(journey(6, 4))


@pytest.mark.parametrize(
    "changes",
    [
        {"method": {"_target_": "little.Lookup", "window": 6}},
        {"seed": 1},
        {"depth": 4},
        {"threads": 2},
        {"protocol": replace(QUICK, minimum_queries=6)},
        {"protocol": replace(QUICK, batch_sizes=[1, 8])},
        {"dataset": replace(journey(6, 4), name="voyage")},
        {"dataset": replace(journey(6, 4), protocol={"queries": "dawn", "tolerance_places": 0})},
        {"dataset": journey(6, 4, [[0], [1], [2], [3], [0, 1], [1]])},
        {"dataset": replace(journey(6, 4), queries=pictures([0, 1, 2, 3, 4, 6]))},
        {"dataset": replace(journey(6, 4), queries=pictures([1, 0, 2, 3, 4, 5]))},
        {"dataset": replace(journey(6, 4), references=pictures([0, 1, 2, 4]))},
        {"dataset": replace(journey(6, 4), places=np.array([0, 1, 3, 2]))},
    ],
    ids=[
        "argument of the method",
        "seed",
        "depth",
        "threads",
        "timing",
        "batch sizes",
        "name of the dataset",
        "protocol of the dataset",
        "ground truth",
        "query image",
        "order of the queries",
        "reference image",
        "places",
    ],
)
def test_a_run_that_could_end_otherwise_has_another_key(changes: dict[str, Any]) -> None:
    assert key(**changes) != key()


def test_a_run_that_loads_a_network_has_the_key_of_that_network_and_not_of_a_training() -> None:
    dataset = journey(6, 4)
    keys = [
        runner.run_key(METHOD, CONFIG, dataset, "f", QUICK, 1, network) for network in (None, "a" * 64, "b" * 64, None)
    ]
    assert len(set(keys)) == 3
    assert keys[0] == keys[3]


@pytest.mark.parametrize(
    "changes",
    [
        {"overrides": ["results=elsewhere"]},
        {"method": {"device": "cpu", "window": 5, "_target_": "little.Lookup"}},
        {"method": {"window": 5, "_target_": "little.Lookup"}},
    ],
    ids=["way of asking", "order of the arguments", "device among the arguments"],
)
def test_what_cannot_change_a_run_does_not_change_its_key(changes: dict[str, Any]) -> None:
    assert key(**changes) == key()


@pytest.mark.parametrize("changes", [{"changed": {"window": 5}}, {"code": "c0de"}, {"timing": {"sample": 3}}])
def test_what_a_run_says_of_itself_does_not_change_its_key(changes: dict[str, Any]) -> None:
    assert key(**changes) == key()


def test_a_run_holds_the_hash_of_its_code_and_the_timing_protocol() -> None:
    run = run_of(METHOD, journey(6, 4))
    assert run.config["code"] == runner.code_hash(type(METHOD))
    assert run.config["timing"] == {
        "minimum_seconds": 0,
        "minimum_queries": 5,
        "minimum_passes": 1,
        "maximum_seconds": 120.0,
        "sample": 16,
        "warmup_queries": 2,
        "batch_sizes": [1, 4],
    }


def test_another_device_has_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    before = key()
    monkeypatch.setattr(environment, "processor", lambda: "Abacus 10")
    assert key() != before


METHOD_SOURCE = """
from vprbench.interface import Method

class Given(Method):
    def fit(self, references, places): return self
    def encode(self, images): return {value}
    def match(self, codes): return codes
"""


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[Method]:
    """Return a method out of a folder of its own, `<tmp_path>/plugin/`."""
    path = tmp_path / "plugin" / "given.py"
    path.parent.mkdir()
    path.write_text(METHOD_SOURCE.format(value=1))
    spec = importlib.util.spec_from_file_location("plugin.given", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "plugin.given", module)
    spec.loader.exec_module(module)
    return module.Given  # type: ignore[no-any-return]


def test_code_that_stays_the_same_has_the_same_hash(given: type[Method]) -> None:
    assert runner.code_hash(given) == runner.code_hash(given)


def test_a_change_in_the_file_of_a_method_changes_its_hash(given: type[Method], tmp_path: Path) -> None:
    before = runner.code_hash(given)
    (tmp_path / "plugin" / "given.py").write_text(METHOD_SOURCE.format(value=2))
    assert runner.code_hash(given) != before


def test_a_change_outside_the_folder_of_a_method_leaves_its_hash(given: type[Method], tmp_path: Path) -> None:
    before = runner.code_hash(given)
    (tmp_path / "other.py").write_text("layers = 3\n")
    assert runner.code_hash(given) == before


@pytest.mark.parametrize("name", ["interface", "search", "images", "ranking", "networks", "stopwatch", "runner"])
def test_a_change_in_what_all_methods_use_changes_their_hash(
    given: type[Method], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    before, read = runner.code_hash(given), Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path.name == f"{name}.py"))
    assert runner.code_hash(given) != before


def test_images_are_seen_through_the_fingerprint_whatever_their_names() -> None:
    named = Images.from_arrays([picture(0), picture(1)], ["a.png", "b.png"])
    renamed = Images.from_arrays([picture(0), picture(1)], ["a.png", "c.png"])
    assert named.fingerprint() != renamed.fingerprint()


# The machine


def _windows_of_memory_exist() -> bool:
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return False
    return True


in_a_window = pytest.mark.skipif(not _windows_of_memory_exist(), reason="this system keeps no window of peak memory")


def test_the_machine_is_described_in_values_that_json_can_hold() -> None:
    described = environment.capture("cpu", 1)
    assert json.loads(json.dumps(described, allow_nan=False)) == described


@pytest.mark.parametrize("name", ["processor", "python", "threads", "cores", "memory_bytes", "load_average"])
def test_the_machine_is_described_by(name: str) -> None:
    assert environment.capture("cpu", 1)[name]


def test_a_fixed_computation_takes_some_time() -> None:
    assert 0 < environment.canary_seconds() < 5


def test_the_canary_takes_no_notice_of_an_interrupted_lap() -> None:
    laps = (1.0 if lap % 5 == 0 else 0.008 for lap in itertools.count())  # seconds
    moments = itertools.accumulate(round(lap * 1e9) for lap in laps)
    assert environment.canary_seconds(lambda: next(moments)) == 0.008


@in_a_window
def test_peak_memory_rises_by_200_megabytes_that_were_held_for_a_moment() -> None:
    environment.reset_peak_memory()
    before = environment.peak_memory_bytes()
    np.ones(200_000_000, np.uint8)
    assert 190e6 <= environment.peak_memory_bytes() - before <= 260e6


@in_a_window
def test_a_new_window_forgets_an_earlier_peak() -> None:
    np.ones(200_000_000, np.uint8)
    high = environment.peak_memory_bytes()
    environment.reset_peak_memory()
    assert environment.peak_memory_bytes() <= high - 150e6


@in_a_window
def test_a_run_knows_the_memory_that_its_method_took() -> None:
    @dataclass
    class Large(Lookup):
        def fit(self, references: Images, places: Places) -> Self:
            np.ones(200_000_000, np.uint8)
            return self

    small = run_of(Lookup(table(6, 4)), journey(6, 4)).peak_memory_bytes
    assert run_of(Large(table(6, 4)), journey(6, 4)).peak_memory_bytes - small >= 190e6


def test_a_cpu_has_no_device_memory() -> None:
    assert environment.peak_device_memory_bytes("cpu") is None
