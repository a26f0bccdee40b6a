"""The store of runs: what is read is what was written, whatever dies, fills up or is changed in between."""

import errno
import hashlib
import json
import logging
import multiprocessing
import os
import pickle
import shutil
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from little import a_failure, a_run, laps, replace_and_die, save_keys, unanswerable_run
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from vprbench.errors import BadInput
from vprbench.runs import identity
from vprbench.runs.identity import hash_content
from vprbench.runs.notes import Note
from vprbench.runs.run_files import SCHEMA, OtherLayoutError, load
from vprbench.runs.store import Store
from vprbench.runs.views import select_queries
from vprbench.storage import tensors

KEY = "0123456789abcdef"
PROCESSES = multiprocessing.get_context("fork")  # start in no time and have imported all


@pytest.fixture
def three(store):
    """Store runs under the keys a, b and c; returns the folder of b."""
    for key in ("a", "b", "c"):
        store.save(a_run(key=key))
    return store.folder("journey", "little", "b")


def stored(store, key=KEY):
    return store.find("journey", "little", key)


def keys(store):
    return [run.key for run in store.runs()]


def parts(value):
    """Return a record as plain parts that are equal only if all bits and types are."""
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if is_dataclass(value):
        return {field.name: parts(getattr(value, field.name)) for field in fields(value)}
    return tuple(map(parts, value)) if isinstance(value, tuple) else (type(value), value)


TIMING = a_run().timing
ODD = np.array([0.1, 1 / 3, 1e-9])
NOISE = np.random.default_rng(0).normal(size=(4, 10)).astype(np.float32)


@pytest.mark.parametrize(
    "run",
    [
        a_run(),
        a_run(outcome=replace(a_run().outcome, best_score=np.array([-np.inf, 1e-45, -0.0, 0.1], np.float32))),
        a_run(timing=replace(TIMING, streaming=replace(laps(ODD, ODD[::-1]), valid=False))),
        a_run(timing=replace(TIMING, offline=(TIMING.offline[0], replace(TIMING.offline[1], valid=False)))),
        a_run(scores=np.where(NOISE > 2, -np.inf, NOISE), place_numbers=np.arange(10) * 3),
        a_run(timing=None, config={**a_run().config, "timing": None}),
        a_run(positives=tuple(np.array(row, np.int64) for row in ([], [1], [], [9, 3]))),
        replace(unanswerable_run(), scores=None),
        a_run(query_breaks=np.array([1, 3]), place_breaks=np.array([], np.int64)),
    ],
)
def test_a_run_comes_back_bit_by_bit_without_a_pickle_and_is_replaced_as_a_whole(store, run):
    folder = store.save(run)
    assert parts(stored(store)) == parts(run)
    for path in folder.iterdir():
        with pytest.raises(pickle.UnpicklingError):
            pickle.loads(path.read_bytes())
    assert store.save(replace(run, n_references=22)) == store.folder("journey", "little", KEY) == folder
    assert store.find("journey", "little", "f" * 16) is None
    assert [found.n_references for found in store.runs()] == [22]
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def tell(where, value, folder):
    """Change a value of a summary."""
    summary = part = json.loads((folder / "run.json").read_text())
    *outer, last = where.split(".")
    for name in outer:
        part = part[int(name) if name.isdigit() else name]
    part[last] = value
    (folder / "run.json").write_text(json.dumps(summary))


def arrays_of(folder):
    (path,) = folder.glob("arrays-*.safetensors")
    return path


def sign_arrays(path):
    """Take changed arrays into the summary beside them."""
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    path.rename(path.with_name(f"arrays-{sha256[:16]}.safetensors"))
    tell("sha256", sha256, path.parent)


def leave_out(name, folder):
    """Remove an array, and sign the others."""
    path = arrays_of(folder)
    save_file({other: array for other, array in load_file(path).items() if other != name}, path)
    sign_arrays(path)


def spoil_file(pattern, spoil, folder):
    (path,) = folder.glob(pattern)
    path.write_bytes(spoil(bytearray(path.read_bytes())))


def enlarge(folder):
    header = json.dumps({"scores": {"dtype": "F32", "shape": [4, 10**12], "data_offsets": [0, 16 * 10**12]}}).encode()
    path = arrays_of(folder)
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    sign_arrays(path)


FILES = [
    *(partial(spoil_file, name, lambda content: content[:-40]) for name in ("run.json", "arrays-*")),
    *(partial(spoil_file, "run.json", lambda _, text=text: text) for text in (b"", b"[]", b"[" * 100_000)),
    partial(spoil_file, "arrays-*", lambda content: content[:-1] + bytes([content[-1] ^ 1])),
    lambda folder: arrays_of(folder).unlink(),
    enlarge,
]
VALUES = [  # of which each cannot be in any of the places beside it
    (None, "outcome.n_places method fingerprint config protocol environment data notes config.method"),
    (None, "config.seed schema"),
    ("5", "outcome.n_places fit_seconds peak_memory_bytes config.dataset config.seed notes environment.libraries"),
    ("5", "protocol.tolerance_places config.timing.minimum_seconds timing.streaming.valid"),
    (0, "outcome.n_places timing.offline.0.images_per_call"),
    (5, "method network protocol.also_tolerance_places"),
    (10**12, "outcome.n_places"),
    (True, "outcome.n_places"),
    (-1, "fit_seconds peak_memory_bytes"),
    (10.5, "outcome.n_places config.seed"),
    (float("inf"), "fit_seconds load_seconds"),
    *((name, "method") for name in ("", "../../little", ".little")),
    ([], "timing.offline timing spikes search energy data"),
    ({}, "timing view"),
    ([0], "config.timing.batch_sizes notes"),
    ({"torch": 2.6}, "environment.libraries"),
    ({"dataset": "journey"}, "stream sha256"),
]
ARRAYS = ["outcome.best_score", "timing.offline.1.encode_seconds"]


@pytest.mark.parametrize(
    "spoil",
    [
        *FILES,
        *(partial(tell, where, value) for value, places in VALUES for where in places.split()),
        *(partial(leave_out, name) for name in ARRAYS),
    ],
)
def test_a_run_that_is_damaged_or_cannot_be_is_named_once_hides_no_other_and_can_be_replaced(
    store, three, caplog, spoil
):
    spoil(three)
    assert keys(store) == ["a", "c"]
    assert store.find("journey", "little", "b") is None
    assert [(line.levelno, str(three) in line.getMessage()) for line in caplog.records] == [(logging.WARNING, True)]
    store.save(a_run(key="b", n_references=22))
    assert stored(store, "b").n_references == 22
    assert sorted(path.name for path in three.parent.iterdir()) == ["little-a", "little-b", "little-c"]


def test_a_run_that_would_not_be_read_is_not_stored(store, three):
    odd = {"notes": (Note("unheard", "of"),), "method": "a/b", "protocol": {"tolerance_places": "0"}}
    for part, value in odd.items():
        with pytest.raises(BadInput, match=part):
            store.save(a_run(**{"key": "b", part: value}))
    with pytest.raises(BadInput, match="F32"):
        store.save(a_run(place_numbers=np.arange(10, dtype=np.int16)))
    untimed = a_run(timing=None, config={**a_run().config, "timing": None})
    with pytest.raises(BadInput, match="view"):
        store.save(select_queries(untimed, np.arange(2), {}))
    assert keys(store) == ["a", "b", "c"]
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def test_the_last_failure_of_a_configuration_is_kept_beside_runs_until_the_run_succeeds(store):
    last, other = a_failure(error="ValueError: no", missing=True), a_failure(config={**a_run().config, "seed": 4})
    for failure in (a_failure(), other, last):
        store.save_failure(failure)
    assert sorted(store.failures(), key=lambda failure: failure.config["seed"]) == [last, other]
    store.save(a_run())
    assert (list(store.failures()), len(list(store.runs()))) == ([other], 1)


def test_a_failure_that_cannot_be_is_left_out_by_name(store, caplog):
    whole = store.save_failure(a_failure())
    path = store.save_failure(a_failure(config={**a_run().config, "seed": 9})) / "failure.json"
    good = json.loads(path.read_text())
    for part, values in {
        "error": (None, 5),
        "config": (None, {}, {**good["config"], "seed": []}, {**good["config"], "changed": "all"}),
        "environment": ({"time_utc": 5},),
        "method": ("../little",),
    }.items():
        for value in values:
            caplog.clear()
            path.write_text(json.dumps({**good, part: value}))
            assert [failure.config["seed"] for failure in store.failures()] == [3]
            assert [str(path) in record.getMessage() for record in caplog.records] == [True]
    assert whole.exists()


def test_a_run_that_the_system_does_not_let_read_stays_and_hides_no_other(store, three, monkeypatch, caplog):
    system = Path.open

    def refusing(path, *arguments, **options):
        if three in path.parents:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), str(path))
        return system(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refusing)
        assert (keys(store), stored(store, "b")) == (["a", "c"], None)
    assert keys(store) == ["a", "b", "c"]
    assert [str(three) in line.getMessage() for line in caplog.records] == [True]


def test_a_run_of_another_layout_is_left_as_it_is_and_named(store, caplog):
    folder = store.save(a_run())
    for layout in (SCHEMA - 1, SCHEMA + 1):
        tell("schema", layout, folder)
        with pytest.raises(OtherLayoutError, match=rf"{layout}.*{SCHEMA}"):
            load(folder)
        assert keys(store) == []
        assert folder.is_dir()
        assert stored(store) is None
    named = [str(folder) in record.getMessage() for record in caplog.records]
    assert named == [False, True, False]  # all of a store in one line, and a folder once


@pytest.mark.parametrize(("hours", "newest", "left"), [(25, 25, 0), (23, 23, 1), (25, 1, 1)])  # the newest file counts
def test_what_nobody_touched_for_a_day_is_removed_and_never_a_run(store, hours, newest, left):
    half, file = store.root / ".partial-elsewhere-1-0a1b2c3d", store.root / ".partial-0a1b2c3d"
    shutil.copytree(store.save(a_run()), half)
    file.write_bytes(b"half")
    ages = {**dict.fromkeys([*half.iterdir(), half, file], hours), arrays_of(half): newest}
    for path, age in ages.items():
        os.utime(path, (time.time() - age * 3600,) * 2)
    store.prepare()
    assert (half.exists(), file.exists()) == (left, hours == 23)
    assert len(keys(store)) == 1


def test_a_process_killed_at_any_step_of_replacing_a_run_leaves_the_old_or_the_new_one(store):
    for step in range(200):
        writer = PROCESSES.Process(target=replace_and_die, args=(store.root, step), daemon=True)
        writer.start()
        writer.join()
        assert [run.n_references for run in Store(store.root).runs()] in ([21], [22]), f"step {step}"
        store.prepare()
        assert stored(store).n_references in (21, 22), f"step {step}"
        if writer.exitcode == 0:
            break
    assert step > 5
    for path in store.root.rglob("*"):
        os.utime(path, (0, 0))
    store.prepare()
    assert [path.name for path in store.root.glob("*/*")] == [f"little-{KEY}"]


def test_several_processes_lose_no_run_and_leave_one_of_a_key(store):
    written = [[KEY, *(f"writer{writer}run{number}" for number in range(6)), KEY] for writer in range(4)]
    with ProcessPoolExecutor(4, mp_context=PROCESSES) as pool:
        assert list(pool.map(save_keys, [store.root] * 4, written)) == [8] * 4
    assert sorted(keys(store)) == sorted({key for row in written for key in row})
    assert sorted(path.name for path in store.root.glob("*/*")) == sorted(f"little-{key}" for key in keys(store))


@pytest.mark.parametrize(("of", "call"), [(tensors, "save_file"), (Path, "write_text"), (Path, "mkdir")])
def test_a_disk_that_refuses_is_named_and_leaves_the_earlier_run_and_no_part_of_another(store, monkeypatch, of, call):
    error = SafetensorError("no space") if of is tensors else OSError(errno.ENOSPC, "No space left on device")

    def refuse(*given, **_):
        if of is tensors:
            given[1].write_bytes(b"half")
        raise error

    store.save(a_run(n_references=21))
    before = sorted(store.root.rglob("*"))
    uses = [partial(store.save, a_run(n_references=22, key=key)) for key in (KEY, "other")]
    uses += [] if of is tensors else [partial(store.save_failure, a_failure())]
    uses += [store.prepare] if call == "mkdir" else []
    monkeypatch.setattr(of, call, refuse)
    for use in uses:
        with pytest.raises(BadInput, match=r"(?i)no space"):
            use()
    assert sorted(store.root.rglob("*")) == before
    assert stored(store).n_references == 21


def test_a_results_folder_that_is_no_folder_is_the_users_to_mend(tmp_path):
    (tmp_path / "file").write_text("no folder")
    store = Store(tmp_path / "file")
    for use in (store.prepare, lambda: store.save(a_run())):
        with pytest.raises(BadInput, match="results="):
            use()


def test_a_key_depends_on_the_layout_of_the_store_and_not_on_the_order_of_its_ingredients(monkeypatch):
    text = '{"code":"c0de","method":{"name":"sad","window":5},"schema":' + f"{SCHEMA}}}"
    for content in ({"name": "sad", "window": 5}, {"window": 5, "name": "sad"}):
        key = hash_content({"method": content, "code": "c0de"})
        assert key == hashlib.sha256(text.encode()).hexdigest()[:16]
    monkeypatch.setattr(identity, "SCHEMA", SCHEMA + 1)
    assert hash_content({"method": content, "code": "c0de"}) != key
