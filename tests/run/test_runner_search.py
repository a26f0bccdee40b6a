"""What a run makes of places that are no candidates, and of the search of descriptors."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pytest
from little import Lookup, journey, number_in
from little_runs import QUICK, asked_for, kinds, run_of, table

from vprbench.api.arrays import Places, Scores
from vprbench.api.binary import BinaryMethod
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.hamming import packed
from vprbench.api.images import Images
from vprbench.api.search import Audit
from vprbench.api.search_indexes import Kind
from vprbench.run import rows, runner
from vprbench.run.record import Run
from vprbench.run.store import Store

pytestmark = pytest.mark.usefixtures("surroundings")


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
    assert "audit" not in kinds(run)
    json.dumps(rows.numbers(run), allow_nan=False)
    assert rows.readable_row(run)["R@1 % [95 %]"]
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
    assert "audit" in kinds(run)


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
    (note,) = (note.text for note in run.notes if note.kind == "index")
    assert re.fullmatch(
        r"index hnsw: (100\.0|9\d\.\d) % of the exactly best places found, (50\.0|4\d\.\d) % of the best 10; "
        r"3\d\d bytes a place, built in \d\.\d s",
        note,
    )


def test_what_is_compared_again_and_how_long_an_index_took_is_recorded_and_said() -> None:
    run = searching("binary", rerank=40)
    assert run.search is not None
    assert (run.search["rerank"], run.search["bytes_per_place"]) == (40, 8)  # 16 bits in a word
    assert 0 < run.search["build_seconds"] < 60
    assert np.isneginf(run.scores).sum(1).tolist() == [260] * 300
    (note,) = (note.text for note in run.notes if note.kind == "index")
    assert note.startswith("index binary, the best 40 compared again: ")


def test_exact_search_goes_without_saying_and_a_method_that_matches_in_its_own_way_records_none() -> None:
    class OwnWay(Angles):
        def fit(self, references: Images, places: Places) -> Self:
            return self

        def match(self, codes: npt.NDArray[np.float32]) -> Scores:
            return codes[:, :4]

    assert [run_of(method, journey(6, 4)).search for method in (OwnWay(), Lookup(table(6, 4)))] == [None, None]
    run = searching("exact")
    assert run.search == {"index": "exact", "bytes_per_place": 64, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert "index" not in kinds(run)


def test_the_bytes_of_binary_codes_are_recorded_and_said() -> None:
    class Signs(BinaryMethod):
        def encode(self, images: Images) -> npt.NDArray[np.uint64]:
            return packed(np.stack([np.resize(image > 127, 100) for image in images]))

    run = run_of(Signs(), journey(6, 4))
    assert run.search == {"index": "exact", "bytes_per_place": 16, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert "binary codes: 16 bytes a place" in [note.text for note in run.notes]


@pytest.mark.parametrize("kept", [False, True], ids=["encoded", "descriptors kept"])
@pytest.mark.parametrize(
    ("n_queries", "code_bytes", "n_audited"),
    [(3, 64, 3), (700, 64, 256), (30, 200 << 20, 5)],  # five codes of 200 MB are less than 1 GiB
)
def test_an_index_is_compared_on_up_to_256_queries_from_the_first_to_the_last(
    n_queries: int, code_bytes: int, n_audited: int, kept: bool, tmp_path: Path
) -> None:
    seen: list[npt.NDArray[np.float32]] = []

    class Watched(Angles):
        def audit(self, codes: npt.NDArray[np.float32]) -> Audit:
            seen.append(codes)
            return super().audit(codes)

        def keeps_descriptors(self) -> bool:
            return kept

    Watched.code_bytes = code_bytes
    queries = journey(n_queries, 300)
    runner.run(asked_for(Watched(index="hnsw"), queries, cache=tmp_path), "key")
    assert any(tmp_path.iterdir()) is kept
    every = Angles().encode(queries.queries)
    (codes,) = seen
    assert len(codes) == n_audited
    assert np.array_equal(codes[[0, -1]], every[[0, -1]])
    spread = [int(np.flatnonzero((every == code).all(1))[0]) for code in codes]
    assert np.ptp(np.diff(spread)) <= 1


def test_an_audit_shows_the_method_no_image_again() -> None:
    quick = replace(QUICK, warmup_queries=1, minimum_queries=1, batch_sizes=[1])
    methods = [Angles(index="exact"), Angles(index="hnsw")]
    for method in methods:
        run_of(method, journey(30, 300), quick)
    assert len({sum(method.shown) for method in methods}) == 1
