"""Runs of earlier layouts are read, those of later ones left alone, and a store that is only read stays as it is."""

from __future__ import annotations

import hashlib
import json
import logging
import multiprocessing
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import a_failure, a_run, save_keys

from vprbench.run import record as records
from vprbench.run import store as store_module
from vprbench.run.record import DamagedRunError, NewerLayoutError, Run, load
from vprbench.run.store import Store
from vprbench.storage import atomic

KEY = "0123456789abcdef"
LAYOUTS = ["1, the first", "1", "2", "3", "4", "5"]
SINCE = {"load_seconds": 2, "network": 2, "search": 3, "spikes": 4}  # the layout that first held it


def write_run(folder: Path, layout: str, **changes: Any) -> Path:
    """Write a run of two queries and three places as that version did, by hand."""
    schema, first = int(layout[0]), layout == "1, the first"
    folder.mkdir(parents=True)
    np.savez_compressed(
        folder / "arrays.npz",
        best_score=np.array([0.5, 0.25], np.float32),
        top_tied=np.array([1, 2]),
        top_tied_correct=np.array([1, 0]),
        above=np.array([0, 2]),
        tied=np.array([1, 1]),
        tied_correct=np.array([1, 1]),
        n_positives=np.array([1, 1]),
        streaming_encode_seconds=np.array([0.01, 0.02]),
        streaming_match_seconds=np.array([0.001, 0.002]),
        offline_0_encode_seconds=np.array([0.03]),
        offline_0_match_seconds=np.array([0.003]),
        sample=np.array([0, 1]),
        answers=np.array([2, 0]),
        top_places=np.array([[2, 1], [0, 1]], np.int32),
        top_scores=np.array([[0.5, 0.1], [0.25, 0.25]], np.float32),
        positives=np.array([2, 2]),
        positives_per_query=np.array([1, 1]),
    )
    np.save(folder / "scores.npy", np.array([[0, 0.1, 0.5], [0.25, 0.25, 0.1]], np.float32))
    summary: dict[str, Any] = {
        "method": "little",
        "dataset": "journey",
        "key": KEY,
        "config": {"method": {"window": 5}, "dataset": {"name": "journey"}, "seed": 1, "device": "cpu", "depth": 2},
        "protocol": {"query": "summer"},
        "fingerprint": "f" * 64,
        "environment": {"processor": "Abacus 8", "time_utc": "2025-01-31T12:00:00Z"},
        "n_references": 6,
        "fit_seconds": 2.5,
        "fit_compute_seconds": 2.25,
        "peak_memory_bytes": 1000,
        "harness_seconds": 0.5,
        "method_seconds": 2.75,
        "schema": schema,
        "notes": ["noisy"],
        "n_places": 3,
        "timing": {
            "first_query_seconds": 0.5,
            "warmup_queries": 3,
            "repeated_seconds": 0.0125,
            "streaming_valid": True,
            "offline": [{"images_per_call": 8, "valid": False}],
        },
        "sha256": {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in ("arrays.npz", "scores.npy")
        },
    }
    if not first:
        summary["timing"]["unseen_seconds"] = 0.0625
    if schema >= 2:
        summary |= {"load_seconds": 0.75, "network": "a" * 64}
    if schema >= 3:
        summary |= {"search": {"index": "hnsw", "bytes_per_place": 8, "recall_at_1": 1.0, "recall_at_10": 0.5}}
    if schema >= 4:
        counts = {"neurons": 3, "spikes_per_query": [1.0, 2.0], "active_share": 1.0, "amplitude_mean": None}
        summary |= {"spikes": {"queries": 2, "layers": [{"name": "output", **counts}]}}
    if schema >= 5:
        summary |= {"data": {"names_sha256": "b" * 64, "content_sha256": None, "images": 2, "bytes": None}}
    summary |= changes
    if not first:
        text = json.dumps(summary, sort_keys=True, separators=(",", ":"))
        summary["content_key"] = hashlib.sha256(text.encode()).hexdigest()[:16]
    (folder / "run.json").write_text(json.dumps(summary), encoding="utf-8")
    return folder


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.prepare()
    return store


def old(store: Store, layout: str, key: str = KEY) -> Run:
    write_run(store.folder("journey", "little", key), layout)
    found = store.find("journey", "little", key)
    assert found is not None
    return found


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


# Earlier layouts

each_layout = pytest.mark.parametrize("layout", LAYOUTS)


@each_layout
def test_the_plain_values_of_an_older_run_are_read(store: Store, layout: str) -> None:
    run = old(store, layout)
    assert (run.method, run.dataset, run.n_references, run.fit_seconds) == ("little", "journey", 6, 2.5)
    assert (run.config["seed"], run.protocol, run.notes) == (1, {"query": "summer"}, ("noisy",))


@each_layout
def test_the_answers_of_an_older_run_are_read(store: Store, layout: str) -> None:
    run = old(store, layout)
    assert run.outcome.above.tolist() == [0, 2]
    assert (run.outcome.n_places, [right.tolist() for right in run.positives]) == (3, [[2], [2]])
    assert run.top_places.tolist() == [[2, 1], [0, 1]]
    assert run.scores is not None
    assert run.scores[0].tolist() == [0, np.float32(0.1), 0.5]


@each_layout
def test_the_laps_of_an_older_run_are_read(store: Store, layout: str) -> None:
    timing = old(store, layout).timing
    assert timing.streaming.encode_seconds.tolist() == [0.01, 0.02]
    assert [(laps.images_per_call, laps.valid) for laps in timing.offline] == [(8, False)]
    assert timing.unseen_seconds == (0.0 if layout == "1, the first" else 0.0625)


@each_layout
@pytest.mark.parametrize("name", SINCE)
def test_what_an_older_layout_did_not_hold_is_none_and_the_rest_is_there(store: Store, layout: str, name: str) -> None:
    assert (getattr(old(store, layout), name) is not None) == (int(layout[0]) >= SINCE[name])


@each_layout
def test_a_run_says_of_its_frames_what_its_layout_holds(store: Store, layout: str) -> None:
    assert (old(store, layout).data == {}) == (int(layout[0]) < 5)


@each_layout
def test_an_older_run_does_not_say_on_what_its_method_was_tuned(store: Store, layout: str) -> None:
    assert old(store, layout).tuned_on is None


def test_runs_of_all_layouts_are_found_side_by_side(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    for number, layout in enumerate(LAYOUTS):
        write_run(store.root / "journey" / f"little-{number}", layout, key=str(number))
    store.save(a_run(key="6"))
    assert [run.key for run in store.runs()] == ["0", "1", "2", "3", "4", "5", "6"]
    assert caplog.records == []


def test_an_older_run_that_is_stored_again_is_the_same_run(store: Store) -> None:
    before = old(store, "2")
    store.save(before)
    after = store.find("journey", "little", KEY)
    assert after is not None
    assert (after.network, after.search, after.fit_seconds) == ("a" * 64, None, 2.5)
    assert json.loads((store.folder("journey", "little", KEY) / "run.json").read_text())["schema"] == 6


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_a_changed_number_in_an_older_run_is_noticed(store: Store, layout: str) -> None:
    path = write_run(store.folder("journey", "little", KEY), layout) / "run.json"
    path.write_text(path.read_text().replace('"fit_seconds": 2.5', '"fit_seconds": 1.5'))
    with pytest.raises(DamagedRunError, match=r"run\.json is not what was written"):
        load(path.parent)


@each_layout
def test_changed_answers_of_an_older_run_are_noticed(store: Store, layout: str) -> None:
    folder = write_run(store.folder("journey", "little", KEY), layout)
    np.save(folder / "scores.npy", np.zeros((2, 3), np.float32))
    with pytest.raises(DamagedRunError, match=r"scores\.npy is not what was written"):
        load(folder)


def test_a_run_of_a_layout_without_a_part_that_it_has_to_hold_is_damaged(store: Store) -> None:
    path = write_run(store.folder("journey", "little", KEY), "2") / "run.json"
    summary = json.loads(path.read_text())
    del summary["network"], summary["content_key"]
    summary["content_key"] = records.content_key(summary)
    path.write_text(json.dumps(summary))
    with pytest.raises(DamagedRunError, match="network"):
        load(path.parent)


# A later layout


def newer(store: Store, key: str = KEY) -> Path:
    folder = store.save(a_run(key=key))
    (folder / "run.json").write_text(json.dumps({"schema": 7, "parts": "of another kind"}))
    return folder


def test_a_run_of_a_later_layout_is_left_as_it_is(store: Store) -> None:
    newer(store)
    before = contents(store.root)
    assert store.find("journey", "little", KEY) is None
    assert list(store.runs()) == []
    assert contents(store.root) == before


def test_a_run_of_a_later_layout_is_named_in_one_line(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    folder = newer(store)
    list(store.runs())
    assert [record.getMessage() for record in caplog.records] == [
        f"{folder} is left as it is: its layout is version 7, this program reads 1 to 6"
    ]


def test_a_run_of_a_later_layout_hides_no_other(store: Store) -> None:
    newer(store, "b")
    for key in ("a", "c"):
        store.save(a_run(key=key))
    assert [run.key for run in store.runs()] == ["a", "c"]


def test_a_later_run_whose_replacement_never_arrived_is_not_removed(store: Store) -> None:
    left = store.root / ".partial-0a-replaced-1b"
    newer(store).rename(left)
    os.utime(left, (0, 0))
    store.prepare()
    assert (left / "run.json").exists()


def test_load_says_which_layouts_it_reads(store: Store) -> None:
    with pytest.raises(NewerLayoutError, match=r"version 7, this program reads 1 to 6"):
        load(newer(store))


# A store that is only read


@pytest.fixture
def reader(store: Store) -> Store:
    return Store(store.root, read_only=True)


def test_a_store_that_is_only_read_finds_runs_and_failures(store: Store, reader: Store) -> None:
    store.save(a_run())
    store.save_failure(a_failure(config={"seed": 9}))
    assert [run.key for run in reader.runs()] == [KEY]
    assert [failure.config for failure in reader.failures()] == [{"seed": 9}]


def test_a_damaged_run_stays_in_a_store_that_is_only_read(
    store: Store, reader: Store, caplog: pytest.LogCaptureFixture
) -> None:
    folder = store.save(a_run())
    (folder / "arrays.npz").unlink()
    before = contents(store.root)
    assert list(reader.runs()) == []
    assert contents(store.root) == before
    assert [str(folder) in record.getMessage() for record in caplog.records] == [True]


@pytest.mark.parametrize(
    "write",
    [
        lambda store: store.prepare(),
        lambda store: store.save(a_run()),
        lambda store: store.save_failure(a_failure()),
    ],
    ids=["prepare", "save", "save_failure"],
)
def test_a_store_that_is_only_read_refuses_to_write(reader: Store, write: Callable[[Store], object]) -> None:
    with pytest.raises(RuntimeError, match="to be read only"):
        write(reader)
    assert list(reader.root.iterdir()) == []


def test_reading_a_store_that_is_not_there_makes_no_folder(tmp_path: Path) -> None:
    reader = Store(tmp_path / "nowhere", read_only=True)
    assert (list(reader.runs()), list(reader.failures())) == ([], [])
    assert list(tmp_path.iterdir()) == []


# Others that write meanwhile


def test_reading_all_runs_never_misses_one_that_others_replace(
    store: Store, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    if not atomic.exchange(tmp_path / "one", tmp_path / "other"):
        pytest.skip("this system cannot exchange two folders in one step")
    keys = ["a", "b", "c"]
    save_keys(store.root, keys)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["vprbench.run.store"])
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        writers = [pool.submit(save_keys, store.root, keys * 10) for _ in range(2)]
        while not all(writer.done() for writer in writers):
            assert [run.key for run in store.runs()] == keys
    assert [writer.result() for writer in writers] == [30, 30]
    assert caplog.records == []


def test_a_run_that_vanishes_while_all_are_read_is_passed_over(store: Store) -> None:
    save_keys(store.root, ["a", "b", "c"])
    found = store.runs()
    first = next(found).key
    shutil.rmtree(store.folder("journey", "little", "b"))
    assert [first, *(run.key for run in found)] == ["a", "c"]


def test_where_folders_cannot_be_exchanged_the_last_of_two_runs_stays_too(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic, "exchange", lambda first, second: False)
    store.save(a_run(n_references=21))
    store.save(a_run(n_references=22))
    assert [run.n_references for run in store.runs()] == [22]
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def test_a_damaged_run_that_is_replaced_meanwhile_is_read_anew_and_not_set_aside(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (store.save(a_run(n_references=21)) / "arrays.npz").unlink()
    read = load

    def read_after_another_saved(folder: Path) -> Run:
        monkeypatch.setattr(store_module, "load", read)
        try:
            return read(folder)
        finally:
            store.save(a_run(n_references=22))

    monkeypatch.setattr(store_module, "load", read_after_another_saved)
    assert [run.n_references for run in store.runs()] == [22]
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
