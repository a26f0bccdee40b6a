"""What a run records and notes of the search among its map's descriptors."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from little import Lookup, journey, numbers_in
from little_runs import run_of, table

from vprbench.api.binary import BinaryMethod
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.nearest import pack_bits

pytestmark = pytest.mark.usefixtures("surroundings")


@dataclass
class Angles(DescriptorMethod):
    """Describes image number i by cosines of i, in 16 dimensions."""

    def encode(self, images):
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
    parts = r"index hnsw: (100\.0|9\d\.\d) % .*, (50\.0|4\d\.\d) % of the best 10; 3\d\d bytes a place, .* [\d.]+ s"
    assert re.fullmatch(parts, note)
    run, found, (note,) = searching("binary", rerank=40)
    assert (found["rerank"], found["bytes_per_place"]) == (40, 8)  # 16 bits in a word
    assert 0 < found["build_seconds"] < 60
    assert np.isneginf(run.scores).sum(1).tolist() == [260] * 300
    assert note.startswith("index binary, the best 40 ")


def test_exact_search_goes_without_saying_codes_of_bits_tell_their_bytes_and_a_match_of_its_own_records_none():
    class Signs(BinaryMethod):
        def encode(self, images):
            return pack_bits(np.stack([np.resize(image > 127, 100) for image in images]))

    assert run_of(Lookup(table(6, 4)), journey(6, 4)).search is None
    exact = {"index": "exact", "bytes_per_place": 64, "recall_at_1": 1.0, "recall_at_10": 1.0}
    assert searching("exact")[1:] == (exact, [])
    signs = run_of(Signs(), journey(6, 4))
    assert signs.search == {**exact, "bytes_per_place": 16}
    assert any("16 bytes a place" in note.text for note in signs.notes)
