"""What a run records of a method's answers, and what it gives the method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey, number_in, picture
from little_runs import asked_for, run_of, table

from vprbench.api.arrays import Places, Scores
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.api.method import LayerSpikes
from vprbench.errors import BadInput
from vprbench.metrics import ranking
from vprbench.metrics.ranking import Outcome, outcome
from vprbench.run import answers, runner

pytestmark = pytest.mark.usefixtures("surroundings")


# Answers


@pytest.mark.parametrize("levels", [5, 100_000], ids=["many ties", "few ties"])
def test_300_queries_are_scored_in_order_in_blocks_and_have_the_outcome_of_the_whole_matrix(levels: int) -> None:
    scores = table(300, 40, levels)
    dataset = journey(300, 40, [list(range(i % 4)) for i in range(300)])  # every fourth query has no right place
    method = Lookup(scores)
    run = run_of(method, dataset)
    assert [number for numbers in method.asked[1:4] for number in numbers] == list(range(300))
    whole = outcome(scores, dataset.positives)
    assert all(np.array_equal(getattr(run.outcome, name), getattr(whole, name)) for name in vars(whole))
    if levels > 5:
        assert run.top_places[:, 0].tolist() == scores.argmax(axis=1).tolist()


@pytest.mark.parametrize(
    ("scores", "depth", "best"),
    [
        ([2, 1, 2, 1, 2], 5, [0, 2, 4, 1, 3]),
        ([0, 1, 1, 1, 9, 1, 1, 1, 1, 1], 3, [4, 1, 2]),
        ([0, 3, 2, 1], 100, [1, 2, 3, 0]),  # no more than there are
        ([9, 2, 8, 7], 3, [0, 2, 3]),
    ],
)
@pytest.mark.parametrize("kind", [np.uint8, np.float64, np.float32])
def test_of_places_that_tie_the_lower_comes_first_whatever_the_type(
    scores: list[int], depth: int, best: list[int], kind: type[np.generic]
) -> None:
    run = run_of(Lookup(np.array([scores], kind)), journey(1, len(scores)), depth=depth)
    assert run.top_places.tolist() == [best]
    assert run.top_scores.tolist() == [[scores[place] for place in best]]
    assert run.scores is not None
    assert (run.scores.dtype, run.top_scores.dtype) == (np.float32, np.float32)


@pytest.mark.parametrize(("limit", "kept"), [(1200, True), (1199, False)])
def test_a_small_matrix_is_kept_whole_and_no_larger_one(
    monkeypatch: pytest.MonkeyPatch, limit: int, kept: bool
) -> None:
    monkeypatch.setattr(answers, "_LARGEST_MATRIX", limit)
    scores = table(300, 4)
    run = run_of(Lookup(scores), journey(300, 4))
    assert (run.scores is not None) is kept
    assert run.scores is None or np.array_equal(run.scores, scores)


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


@pytest.mark.parametrize(("value", "name", "query"), [(np.nan, "NaN", 2), (np.inf, r"\+inf", 200)])
def test_scores_that_cannot_be_ranked_are_refused_by_name_and_query(value: float, name: str, query: int) -> None:
    scores = table(300, 4)
    scores[query, 3] = value
    with pytest.raises(BadInput, match=rf"{name}.*query {query}\b"):
        run_of(Lookup(scores), journey(300, 4))


@dataclass
class Reusing(Lookup):
    """Gives the same two arrays each time, overwritten."""

    codes: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty(1000, np.int64))
    answer: Scores = field(default_factory=lambda: np.empty((1000, 4), np.float32))

    def encode(self, images: Images) -> npt.NDArray[np.int64]:
        self.codes[: len(images)] = super().encode(images)
        return self.codes[: len(images)]

    def match(self, codes: npt.NDArray[np.int64]) -> Scores:
        self.answer[: len(codes)] = super().match(codes)
        return self.answer[: len(codes)]

    def spikes(self, codes: npt.NDArray[Any]) -> list[LayerSpikes]:
        return [LayerSpikes("input", codes[:, None])]


def test_scores_and_spikes_are_kept_of_a_method_that_overwrites_what_it_gave() -> None:
    scores = table(300, 4)
    run = run_of(Reusing(scores), journey(300, 4))
    assert run.scores is not None
    assert np.array_equal(run.scores, scores)
    assert run.spikes is not None
    sample = np.linspace(0, 299, 256).astype(int)
    assert run.spikes["layers"][0]["spikes_per_query"] == sample.tolist()


# What a method is given


@dataclass(kw_only=True)
class Reading(DescriptorMethod):
    """Notes the names of the images that it encodes after the fit."""

    names: list[str] = field(default_factory=list)

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        if self.searched is not None:
            self.names += images.names
        return np.array([[number_in(image) + 1, 1] for image in images], np.float32)

    def keeps_descriptors(self) -> bool:
        return True

    def spikes(self, codes: npt.NDArray[Any]) -> list[LayerSpikes]:
        return [LayerSpikes("input", codes)]


@pytest.mark.parametrize("cached", [False, True])
def test_no_query_is_given_under_its_name(tmp_path: Path, cached: bool) -> None:
    named = Images.from_arrays([picture(i) for i in range(6)], [f"place {i % 4}" for i in range(6)])
    method, dataset = Reading(), replace(journey(6, 4), queries=named)
    runner.run(asked_for(method, dataset, cache=tmp_path if cached else None), "key")
    assert len(method.names) > 3 * 6
    assert all(name.startswith("image ") for name in method.names)


def test_fit_sees_every_reference_and_its_place_which_cannot_be_written() -> None:
    seen: list[tuple[list[int], list[int]]] = []

    @dataclass
    class Writing(Lookup):
        def fit(self, references: Images, places: Places) -> Self:
            seen.append(([number_in(image) for image in references], places.tolist()))
            places[0] = 1
            return self

    dataset = journey(6, 4)
    with pytest.raises(ValueError, match="read-only"):
        run_of(Writing(table(6, 4)), dataset)
    assert dataset.places.flags.writeable
    assert seen == [([0, 1, 2, 3], [0, 1, 2, 3])]


def test_many_places_and_large_codes_are_scored_in_smaller_blocks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scores, dataset = table(300, 40, 5), journey(300, 40)
    usual = run_of(Lookup(scores), dataset)
    monkeypatch.setattr(answers, "_BLOCK_CELLS", 40 * 7)
    monkeypatch.setattr(ranking, "_RANKED_CELLS", 40 * 3)
    method = Lookup(scores)
    blocked = run_of(method, dataset)
    assert [len(numbers) for numbers in method.asked[1:44]] == [7] * 42 + [6]

    class Large(Lookup):
        code_bytes = 200 << 20  # five are less than 1 GiB

    method = Large(table(12, 4))
    run_of(method, journey(12, 4))
    assert [len(numbers) for numbers in method.asked[1:4]] == [5, 5, 2]
    assert np.array_equal(blocked.top_places, usual.top_places)
    assert all(np.array_equal(getattr(blocked.outcome, n), getattr(usual.outcome, n)) for n in Outcome.__annotations__)
