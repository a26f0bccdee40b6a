"""A large map searched by the workers of a dask cluster: the bits, and the order of ties, are those of one machine."""

import logging
import os

import numpy as np
import pytest
from distributed import Client, LocalCluster
from little import Angles, journey
from little_runs import quiet_surroundings, run_of

from vprbench.api import nearest
from vprbench.api.search import Search
from vprbench.errors import BadInput
from vprbench.jobs.search import spread, spread_over
from vprbench.runs import shortlist
from vprbench.storage import shards
from vprbench.storage.shards import Shards, Writer


@pytest.fixture(scope="module")
def cluster():
    quiet = {"dashboard_address": ":0", "silence_logs": logging.CRITICAL}
    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, **quiet) as started:
        yield started


@pytest.mark.extended
def test_each_worker_searches_its_shards_and_the_answers_are_those_of_one_machine(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(shards, "_LEAST_ROWS", 64)
    monkeypatch.setattr(nearest, "_CELLS_OF_A_PART", 128 * 8)
    generator = np.random.default_rng(0)
    few = generator.standard_normal((90, 8))
    few = (few / np.linalg.norm(few, axis=1, keepdims=True)).astype(np.float32)
    chosen = generator.integers(0, 90, 1000)  # each about eleven times, in many shards
    references = few[chosen]
    places = np.arange(1000) // 3
    writer = Writer(tmp_path, 1000)
    for rows in writer.missing():
        writer.write(rows, [references[rows]])
    codes = references[::50] + np.float32(0.1)
    products = (codes.astype(np.float64) @ few.T.astype(np.float64))[:, chosen]
    scores = np.stack([products[:, places == place].max(1) for place in range(334)], axis=1).astype(np.float32)
    wanted = np.lexsort((np.broadcast_to(np.arange(334), scores.shape), -scores))[:, :20]
    with Client(cluster) as client:
        mapped = spread(client)
        for kept in (writer.shards(), Shards.of(references)):
            search = Search(kept, places)
            alone, together = search.nearest(codes, 20), search.nearest(codes, 20, mapped)
            assert alone[0].tobytes() == together[0].tobytes()
            assert alone[1].tobytes() == together[1].tobytes()
            assert np.array_equal(together[1], wanted)
        who = [mapped(lambda _: os.getpid(), range(6)) for _ in range(2)]
    assert who[0] == who[1]
    assert len({*who[0]} - {os.getpid()}) == 2


@pytest.mark.extended
def test_a_run_on_a_large_map_is_answered_by_a_cluster_and_says_so(cluster, monkeypatch):
    monkeypatch.setattr(shortlist, "LARGE_MAP", 39)
    with quiet_surroundings():
        alone = run_of(Angles(), journey(12, 40))
        with spread_over(cluster.scheduler_address):
            together = run_of(Angles(), journey(12, 40))
    assert np.array_equal(together.top_scores, alone.top_scores)
    assert np.array_equal(together.top_places, alone.top_places)
    said = ["cluster" in note.text for run in (alone, together) for note in run.notes if note.kind == "shortlist"]
    assert said == [False, True]


def test_an_address_where_no_scheduler_answers_is_named():
    with pytest.raises(BadInput, match=r"search_scheduler=tcp:/nowhere"), spread_over("tcp:/nowhere"):
        pass
