"""The store of runs: what is read is what was written, whatever dies, fills up or is changed in between."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import multiprocessing
import os
import pickle
import random
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass, replace
from functools import partial
from multiprocessing import forkserver
from pathlib import Path
from typing import Any, NoReturn

import little
import numpy as np
import pytest
from checkout import ROOT
from little import (
    a_failure,
    a_run,
    laps,
    replace_and_die,
    save_forever,
    save_keys,
    save_where_no_file_may_exceed,
    unanswerable_run,
)

from vprbench.errors import BadInput
from vprbench.run import record
from vprbench.run.record import SCHEMA, DamagedRunError, OtherLayoutError, Run, content_key, load
from vprbench.run.store import Store

KEY = "0123456789abcdef"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.prepare()
    return store


@pytest.fixture(scope="module")
def processes() -> multiprocessing.context.ForkServerContext:
    """Processes that start in no time, because one that has imported what they call makes them."""
    context = multiprocessing.get_context("forkserver")
    forkserver._forkserver._stop()  # one that other tests have started has imported nothing
    context.set_forkserver_preload(["little"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(little.__file__).parent), str(ROOT)]))
        start = context.Process(target=str)
        start.start()
        start.join()
    return context


def stored(store: Store, key: str = KEY) -> Run:
    run = store.find("journey", "little", key)
    assert run is not None
    return run


def unfinished(store: Store) -> list[str]:
    return [path.name for path in store.root.iterdir() if path.name.startswith(".partial-")]


def flip_a_bit(path: Path, position: int | None = None) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2 if position is None else position] ^= 1
    path.write_bytes(content)


# Round trip


def parts(value: Any) -> Any:
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
        a_run(scores=np.where(NOISE > 2, -np.inf, NOISE)),
        a_run(place_numbers=np.arange(10) * 3),
        a_run(timing=None, config={**a_run().config, "timing": None}),
        *(
            a_run(positives=tuple(np.array(row, np.int64) for row in right))
            for right in ([[], [1], [], [9, 3]], [[]] * 4)
        ),
        replace(unanswerable_run(), scores=None),
    ],
)
def test_a_run_comes_back_bit_by_bit_and_without_a_pickle(store: Store, run: Run) -> None:
    folder = store.save(run)
    assert parts(stored(store)) == parts(run)
    for path in folder.iterdir():
        with pytest.raises(pickle.UnpicklingError):
            pickle.loads(path.read_bytes())


def test_a_run_lies_where_the_store_says_under_its_own_key_and_is_replaced_as_a_whole(store: Store) -> None:
    store.save(a_run(n_references=21))
    assert store.save(a_run(n_references=22)) == store.folder("journey", "little", KEY)
    assert store.find("journey", "little", "f" * 16) is None
    assert [run.n_references for run in store.runs()] == [22]
    assert unfinished(store) == []


# Damage


def _change(folder: Path, name: str, value: Any) -> None:
    summary = json.loads((folder / "run.json").read_text("utf-8"))
    (folder / "run.json").write_text(json.dumps({**summary, name: value}), "utf-8")


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


DAMAGES: dict[str, Callable[[Path], None]] = {
    "truncated summary": lambda folder: _cut(folder / "run.json"),
    "empty summary": lambda folder: (folder / "run.json").write_bytes(b"") and None,
    "summary of another kind": lambda folder: (folder / "run.json").write_text("[]") and None,
    "summary that is no text": lambda folder: (folder / "run.json").write_bytes(b"\xff\xfe\x00") and None,
    "flipped bit in the arrays": lambda folder: flip_a_bit(folder / "arrays.npz"),
    "flipped bit in the scores": lambda folder: flip_a_bit(folder / "scores.npy"),
    "truncated arrays": lambda folder: _cut(folder / "arrays.npz"),
    "missing arrays": lambda folder: (folder / "arrays.npz").unlink(),
    "missing scores": lambda folder: (folder / "scores.npy").unlink(),
    "layout that is no number": lambda folder: _change(folder, "schema", None),
    "missing timing": lambda folder: _change(folder, "timing", {}),
    "changed number": lambda folder: _change(folder, "fit_seconds", 10.34),
    "checksums of another kind": lambda folder: _change(folder, "sha256", []),
}


@pytest.mark.parametrize("spoil", DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_run_is_named_set_aside_and_hides_no_other(
    store: Store, caplog: pytest.LogCaptureFixture, spoil: Callable[[Path], None]
) -> None:
    for key in ("a", "b", "c"):
        store.save(a_run(key=key))
    folder = store.folder("journey", "little", "b")
    spoil(folder)
    assert store.find("journey", "little", "b") is None
    assert [(line.levelno, str(folder) in line.getMessage()) for line in caplog.records] == [(logging.WARNING, True)]
    aside, *others = sorted(path.name for path in folder.parent.iterdir())
    assert (aside.startswith(f".damaged-{folder.name}"), others) == (True, ["little-a", "little-c"])
    assert [run.key for run in store.runs()] == ["a", "c"]
    store.save(a_run(key="b", n_references=22))
    assert stored(store, "b").n_references == 22


@pytest.mark.parametrize(
    ("refused", "number"),
    [*(("open", n) for n in (errno.EACCES, errno.EIO, errno.EMFILE, errno.ESTALE)), ("iterdir", errno.EACCES)],
)
def test_a_run_or_a_dataset_that_the_system_does_not_let_read_stays_where_it_is_and_hides_no_other(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, refused: str, number: int
) -> None:
    for name in ("a", "b", "c"):
        store.save(a_run(key=name) if refused == "open" else a_run(dataset=name))
    folder = store.folder("journey", "little", "b") if refused == "open" else store.root / "b"
    there = sorted(store.root.rglob("*"))
    system = getattr(Path, refused)

    def refusing(path: Path, *arguments: Any, **options: Any) -> Any:
        if folder in (path, *path.parents):
            raise OSError(number, os.strerror(number), str(path))
        return system(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, refused, refusing)
        assert [run.key if refused == "open" else run.dataset for run in store.runs()] == ["a", "c"]
        assert refused == "iterdir" or store.find("journey", "little", "b") is None
    assert sorted(store.root.rglob("*")) == there
    assert {str(folder) in line.getMessage() for line in caplog.records} == {True}


def test_where_no_file_can_be_opened_any_more_no_run_is_set_aside(store: Store) -> None:
    folder = store.save(a_run())
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with Path(os.devnull).open() as lowest:
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest.fileno() + 1, limits[1]))
        try:
            assert store.find("journey", "little", KEY) is None
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert folder.exists()
    assert stored(store).key == KEY


@pytest.mark.parametrize("layout", [SCHEMA - 1, SCHEMA + 1])
def test_a_run_of_another_layout_is_left_as_it_is_and_named(
    store: Store, layout: int, caplog: pytest.LogCaptureFixture
) -> None:
    folder = store.save(a_run())
    _change(folder, "schema", layout)
    with pytest.raises(OtherLayoutError, match=rf"{layout}.*{SCHEMA}"):
        load(folder)
    assert [*store.runs()] == []
    assert folder.is_dir()
    assert str(folder) in caplog.text


def test_a_flipped_bit_anywhere_in_the_summary_never_stops_the_reader(store: Store) -> None:
    folder = store.save(a_run())
    whole = (folder / "run.json").read_bytes()
    for position in range(0, len(whole), 13):
        flip_a_bit(folder / "run.json", position)
        with contextlib.suppress(DamagedRunError):
            load(folder)
        (folder / "run.json").write_bytes(whole)


# Leftovers

HOUR = 3600


def touched(path: Path, hours_ago: float) -> None:
    """Let a file, or a folder and what is in it, look as if it was written so long ago."""
    for part in (path, *path.rglob("*")):
        os.utime(part, (time.time() - hours_ago * HOUR,) * 2)


@pytest.mark.parametrize(
    ("kind", "hours", "newest", "removed"),
    [
        *((kind, 25, 25, True) for kind in ("folder", "empty", "file")),
        ("folder", 23, 23, False),
        ("folder", 25, 1, False),  # a folder is as old as the newest file in it
    ],
)
@pytest.mark.parametrize("owner", ["0a1b2c3d", "elsewhere-1-0a1b2c3d"])
def test_what_nobody_touched_for_a_day_is_removed_and_never_a_run(
    store: Store, kind: str, hours: float, newest: float, removed: bool, owner: str
) -> None:
    path = store.root / f".partial-{owner}"
    if kind == "file":
        path.write_bytes(b"half")
    else:
        path.mkdir()
    if kind == "folder":
        shutil.copytree(store.save(a_run()), path, dirs_exist_ok=True)
    touched(path, hours)
    if kind == "folder":
        touched(path / "arrays.npz", newest)
    store.prepare()
    assert unfinished(store) == [path.name] * (not removed)
    assert len(list(store.runs())) == (kind == "folder")


# Sudden death


def test_a_killed_process_leaves_only_whole_runs(
    store: Store, processes: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    moments = random.Random(7)
    keys = [f"number{number}" for number in range(10)]
    for kill in range(10):
        started = tmp_path / f"started-{kill}"
        writer = processes.Process(target=save_forever, args=(store.root, started, keys), daemon=True)
        writer.start()
        deadline = time.monotonic() + 120
        while not started.exists() and time.monotonic() < deadline:
            time.sleep(0.001)
        assert started.exists()
        time.sleep(moments.uniform(0, 0.06))
        writer.kill()
        writer.join()
        assert all(load(folder) for folder in (store.root / "journey").iterdir())
        assert caplog.records == []
        for name in unfinished(store):
            touched(store.root / name, 25)
        store.prepare()
        assert unfinished(store) == []
        store.save(a_run(key=f"after-kill-{kill}"))
        assert stored(store, f"after-kill-{kill}").n_references == 20


def test_a_run_is_stored_in_a_folder_that_is_linked_to_another_disk(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "disk").mkdir()
    (store.root / "journey").symlink_to(tmp_path / "disk")
    rename = Path.rename

    def on_one_disk(path: Path, target: Path) -> Path:
        if path.parent.resolve() != target.parent.resolve():
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", on_one_disk)
    for seconds in (1.0, 2.0):
        store.save(a_run(harness_seconds=seconds))
    assert [run.harness_seconds for run in store.runs()] == [2.0]
    assert len([*(tmp_path / "disk").iterdir()]) == 1
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def test_a_process_killed_at_any_step_of_replacing_a_run_leaves_the_old_or_the_new_one(
    store: Store, processes: Any
) -> None:
    for step in range(200):
        writer = processes.Process(target=replace_and_die, args=(store.root, step), daemon=True)
        writer.start()
        writer.join()
        store.prepare()
        assert stored(store).n_references in (21, 22), f"step {step}"
        if writer.exitcode == 0:
            break
    assert step > 10


# Several processes


@pytest.mark.parametrize("one_key", [False, True])
def test_ten_processes_lose_no_run_and_leave_one_of_a_key(store: Store, processes: Any, one_key: bool) -> None:
    keys = [[KEY if one_key else f"writer{writer}run{number}" for number in range(10)] for writer in range(10)]
    with ProcessPoolExecutor(10, mp_context=processes) as pool:
        assert list(pool.map(save_keys, [store.root] * 10, keys)) == [10] * 10
    assert sorted(run.key for run in store.runs()) == sorted({key for row in keys for key in row})
    assert unfinished(store) == []


def test_a_run_that_another_process_takes_away_in_the_middle_of_a_save_is_no_error(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.save(a_run(n_references=21))
    folder = store.folder("journey", "little", KEY)
    rename = Path.rename

    def rename_while_another_replaces(path: Path, target: Path) -> Path:
        try:
            return rename(path, target)
        except OSError:
            shutil.rmtree(folder)  # the other process has just moved the old run away
            raise

    monkeypatch.setattr(Path, "rename", rename_while_another_replaces)
    store.save(a_run(n_references=22))
    assert stored(store).n_references == 22


def test_a_run_that_is_replaced_while_it_is_read_is_not_set_aside(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.save(a_run(fit_seconds=1.0, top_places=np.zeros((4, 2), np.int32)))
    digest = record._digest

    def digest_after_another_process_saved(path: Path) -> str:
        monkeypatch.setattr(record, "_digest", digest)
        store.save(a_run(fit_seconds=2.0))
        return digest(path)

    monkeypatch.setattr(record, "_digest", digest_after_another_process_saved)
    store.find("journey", "little", KEY)
    assert stored(store).fit_seconds == 2.0


# A disk that refuses


@pytest.mark.parametrize("below", [".", "deeper/still"])
def test_a_results_folder_that_is_no_folder_is_the_users_to_mend(tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("no folder")
    store = Store(tmp_path / "file" / below)
    for use in (store.prepare, lambda: store.save(a_run())):
        with pytest.raises(BadInput, match="results="):
            use()


@pytest.mark.parametrize(("of", "call"), [(np, "savez_compressed"), (np, "save"), (os, "fsync"), (Path, "mkdir")])
def test_a_disk_that_refuses_is_named_and_leaves_the_earlier_run_and_no_part_of_another(
    store: Store, monkeypatch: pytest.MonkeyPatch, of: Any, call: str
) -> None:
    def refuse(path: Any, *_: Any, **__: Any) -> NoReturn:
        if of is np:
            path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    store.save(a_run(n_references=21))
    before = sorted(path for path in store.root.rglob("*"))
    monkeypatch.setattr(of, call, refuse)
    for use in [
        *(partial(store.save, a_run(n_references=22, key=key)) for key in (KEY, "other")),
        *([] if of is np else [partial(store.save_failure, a_failure())]),
        *([store.prepare] if of is Path else []),
    ]:
        with pytest.raises(BadInput, match="No space left on device"):
            use()
    assert sorted(path for path in store.root.rglob("*")) == before
    assert stored(store).n_references == 21


# 100 bytes end in the arrays, 20 000 in the scores of 400 kB
@pytest.mark.parametrize("limit_bytes", [100, 20_000], ids=["in the arrays", "in the scores of 400 kB"])
def test_a_file_that_the_system_cuts_off_is_explained_and_leaves_the_earlier_run_whole(
    store: Store, processes: Any, limit_bytes: int
) -> None:
    store.save(a_run())
    with ProcessPoolExecutor(1, mp_context=processes) as pool:
        complaint = pool.submit(save_where_no_file_may_exceed, store.root, limit_bytes).result()
    assert "could not be stored" in complaint
    assert "(None)" not in complaint
    assert unfinished(store) == []
    assert stored(store).n_references == 20


# Keys

CONTENT = {"method": {"window": 5, "name": "sad"}, "code": "c0de", "images": "f00d", "seed": 0, "threads": 2}


def test_a_key_depends_on_the_layout_of_the_store_and_not_on_the_order_of_its_ingredients_or_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    key = content_key(CONTENT)
    turned = {name: CONTENT[name] for name in reversed(CONTENT)} | {"method": {"name": "sad", "window": 5}}
    assert content_key(turned) == key
    code = f"from vprbench.run.record import content_key; print(content_key({CONTENT!r}))"
    environment = {**os.environ, "PYTHONHASHSEED": "12345"}
    answer = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == key
    monkeypatch.setattr(record, "SCHEMA", record.SCHEMA + 1)
    assert content_key(CONTENT) != key


def test_an_array_of_objects_is_refused_when_it_is_stored(store: Store) -> None:
    with pytest.raises(ValueError, match="Object arrays"):
        store.save(a_run(top_places=np.array([[None]])))
