"""Records that are whole by their hashes and cannot be: left out by name, wherever in them the nonsense stands."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import a_failure, a_run

from vprbench.errors import BadInput
from vprbench.run.note import Note
from vprbench.run.record import content_key
from vprbench.run.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Return a store with three runs, a, b and c."""
    store = Store(tmp_path / "results")
    store.prepare()
    for key in ("a", "b", "c"):
        store.save(a_run(key=key))
    return store


@pytest.fixture
def forged(store: Store) -> Path:
    return store.folder("journey", "little", "b")


def sign(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write a summary with the hashes that it needs to be believed."""
    content = {name: value for name, value in summary.items() if name != "content_key"}
    if set(summary["sha256"]) == {"arrays.npz", "scores.npy"}:
        content["sha256"] = {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in summary["sha256"]
        }
    (folder / "run.json").write_text(json.dumps({**content, "content_key": content_key(content)}))


def forge_summary(folder: Path, where: str, value: Any) -> None:
    summary = json.loads((folder / "run.json").read_text())
    *outer, last = where.split(".")
    part = summary
    for name in outer:
        part = part[int(name) if name.isdigit() else name]
    part[last] = value
    sign(folder, summary)


def forge_array(folder: Path, name: str, value: Any) -> None:
    if name == "scores":
        np.save(folder / "scores.npy", value)
    else:
        with np.load(folder / "arrays.npz") as archive:
            arrays = {**archive, name: value}
        np.savez(folder / "arrays.npz", **{name: array for name, array in arrays.items() if array is not None})
    sign(folder, json.loads((folder / "run.json").read_text()))


def left_out_by_name(store: Store, forged: Path, caplog: pytest.LogCaptureFixture) -> bool:
    keys = [run.key for run in store.runs()]
    return keys == ["a", "c"] and [str(forged) in record.getMessage() for record in caplog.records] == [True]


def test_a_record_that_is_signed_anew_is_believed(store: Store, forged: Path) -> None:
    forge_summary(forged, "fit_seconds", 9.5)
    forge_array(forged, "top_scores", np.zeros((4, 2), np.float32))
    found = store.find("journey", "little", "b")
    assert found is not None
    assert (found.fit_seconds, found.top_scores.tolist()) == (9.5, [[0, 0]] * 4)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        *(("n_places", value) for value in (10**12, 0, -1, 21, "10", 10.5, None, True)),
        *(("n_references", value) for value in (10**12, 1, [])),
        *(("fit_seconds", value) for value in ("fast", float("nan"), float("inf"), -1.0, {})),
        *(("peak_memory_bytes", value) for value in (-1, "much", 10**400)),
        *(("method", value) for value in (None, 5, "", "../../little", ".little")),
        *((name, None) for name in ("fingerprint", "config", "protocol", "environment", "notes", "data")),
        *(("notes", value) for value in ("noisy", [5], {"a": 1})),
        *(("config.seed", value) for value in (None, "3", [], 1.5)),
        *(("config.method", value) for value in (None, [])),
        ("config.dataset", "journey"),
        ("config.timing.minimum_seconds", "long"),
        ("config.timing.batch_sizes", [0]),
        ("protocol.tolerance_places", "0"),
        ("protocol.also_tolerance_places", 5),
        *(("environment.time_utc", value) for value in (None, 20250131, "yesterday")),
        *(("environment.libraries", value) for value in ("torch", {"torch": 2.6})),
        ("environment.load_average", 0.5),
        *(("tuned_on", value) for value in ([5], {"dataset": "journey"})),
        *(("network", value) for value in (5, [])),
        *(("search.bytes_per_place", value) for value in ("4352", None)),
        ("search.recall_at_1", 98.4),
        *(("spikes.layers", value) for value in ({}, [])),
        ("spikes.layers.0.spikes_per_query", []),
        ("spikes.layers.0.neurons", [12]),
        ("timing.offline", []),
        ("timing.offline.0.images_per_call", 0),
        ("timing.streaming_valid", "yes"),
        ("timing.repeated_seconds", float("nan")),
        ("data", {"names_sha256": 5}),
        ("schema", "5"),
        ("schema", 0),
        ("sha256", {}),
        ("sha256", {"../a/arrays.npz": "0"}),
    ],
)
def test_a_summary_that_cannot_be_is_left_out_by_name(
    store: Store, forged: Path, caplog: pytest.LogCaptureFixture, where: str, value: Any
) -> None:
    forge_summary(forged, where, value)
    assert left_out_by_name(store, forged, caplog)


@pytest.mark.parametrize(
    "changes", [{"notes": (Note("unheard", "of"),)}, {"method": "a/b"}, {"protocol": {"tolerance_places": "0"}}]
)
def test_a_run_that_would_not_be_believed_is_not_stored(store: Store, changes: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match=next(iter(changes))):
        store.save(a_run(key="b", **changes))
    assert [run.key for run in store.runs()] == ["a", "b", "c"]
    assert [path.name for path in store.root.iterdir()] == ["journey"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("best_score", value) for value in (None, np.full(4, np.nan, np.float32), np.full(4, np.inf), np.zeros(3))),
        *(("above", value) for value in (np.full(4, -1), np.full(4, 11), np.zeros(4), np.zeros((4, 1), np.int64))),
        ("top_tied_correct", np.array([1, 1, 0, 2])),
        ("tied", np.zeros(4, np.int64)),
        ("n_positives", np.array(["1", "2", "1", "1"])),
        *(("positives", value) for value in (np.array([0, 1, 5, 2, 10]), np.arange(4), np.array([0, -1, 5, 2, 3]))),
        ("positives_per_query", np.array([5, 5, -5, 0])),
        *(("top_places", value) for value in (np.full((4, 2), 10, np.int32), np.zeros((2, 4), np.int32))),
        ("top_scores", np.zeros((4, 3), np.float32)),
        *(("scores", value) for value in (np.zeros((4, 9), np.float32), np.full((4, 10), np.nan, np.float32))),
        *(("sample", value) for value in (np.array([0, 1, 2, 4]), np.arange(3))),
        ("answers", np.array([0, 1, 10, -1])),
        ("place_numbers", np.arange(9)),
        *(("streaming_encode_seconds", value) for value in (np.full(5, np.nan), np.full(5, -1.0), np.zeros(5))),
        ("streaming_match_seconds", np.zeros(4)),
        ("offline_1_encode_seconds", None),
    ],
)
def test_arrays_that_cannot_be_are_left_out_by_name(
    store: Store, forged: Path, caplog: pytest.LogCaptureFixture, name: str, value: Any
) -> None:
    forge_array(forged, name, value)
    assert left_out_by_name(store, forged, caplog)


def replaced(folder: Path, make: Callable[[Path], object]) -> None:
    (folder / "run.json").unlink()
    make(folder / "run.json")


def enlarged(folder: Path) -> None:
    with (folder / "scores.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (4, 10**12)})


OTHER_THINGS: dict[str, Callable[[Path], object]] = {
    "thousands of brackets": lambda folder: (folder / "run.json").write_text("[" * 100_000),
    "a pipe that nobody writes to": lambda folder: replaced(folder, os.mkfifo),
    "a folder": lambda folder: replaced(folder, Path.mkdir),
    "scores in an archive": lambda folder: (folder / "scores.npy").write_bytes((folder / "arrays.npz").read_bytes()),
    "arrays larger than any memory": enlarged,
}


@pytest.mark.parametrize("spoil", OTHER_THINGS.values(), ids=OTHER_THINGS.keys())
def test_a_file_that_is_another_thing_is_left_out_by_name(
    store: Store, forged: Path, caplog: pytest.LogCaptureFixture, spoil: Callable[[Path], object]
) -> None:
    summary = (forged / "run.json").read_text()
    spoil(forged)
    if (forged / "run.json").is_file() and (forged / "run.json").read_text() == summary:
        sign(forged, json.loads(summary))
    assert left_out_by_name(store, forged, caplog)


@pytest.mark.parametrize(
    "content",
    [
        *({"error": value} for value in (None, 5, [])),
        *({"config": value} for value in (None, {}, {"seed": []}, {"seed": 1, "changed": "all"})),
        {"environment": {"time_utc": 5}},
        {"method": "../little"},
        {"missing": "yes"},
    ],
)
def test_a_failure_that_cannot_be_is_left_out_by_name(
    store: Store, caplog: pytest.LogCaptureFixture, content: Mapping[str, Any]
) -> None:
    whole = store.save_failure(a_failure())
    forged = store.save_failure(a_failure(config={"seed": 9}))
    path = forged / "failure.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **content}))
    assert [failure.config["seed"] for failure in store.failures()] == [3]
    assert [str(path) in record.getMessage() for record in caplog.records] == [True]
    assert whole.exists()
