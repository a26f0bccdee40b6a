"""A run is locked while it is made: of many processes one makes it, the dead hold nothing; each is timed alone."""

import contextlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import pytest
from checkout import ROOT
from little import Lookup, a_failure, a_run, journey
from little_runs import QUICK, asked_for, table

from vprbench import cli
from vprbench.runs import timing_lock
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.run_lock import HeldElsewhereError, is_held, lock_run, read_claims
from vprbench.runs.store import Store
from vprbench.runs.timing_lock import share_host

pytestmark = pytest.mark.usefixtures("surroundings")

RUN = "journey/little-0123456789abcdef"
ABOUT = {"method": "little", "dataset": "journey", "seed": 3, "device": "cpu", "corruption": "shift-1"}
HOLDER = """
import sys, time
from pathlib import Path
from vprbench.runs.run_lock import lock_run
with lock_run(Path(sys.argv[1]), sys.argv[2], {}):
    print(flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def held_elsewhere(root, run=RUN):
    """Yield a process that holds the lock of a run."""
    command = [sys.executable, "-c", HOLDER, str(root), run]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout.readline() == "\n"
        yield process
        process.kill()


@pytest.mark.parametrize("run", [RUN, "a/b", "ü/\udcff " + 300 * "x", "../../up"])
def test_of_all_who_want_a_run_of_any_name_one_gets_it_and_after_it_the_next(run, tmp_path):
    for _ in range(2):
        with lock_run(tmp_path, run, {}), lock_run(tmp_path, f"{run}0", {}):
            with pytest.raises(HeldElsewhereError) as raised, lock_run(tmp_path, run, {}, wait=False):
                pass
            assert is_held(raised.value.path)
            assert len(read_claims(tmp_path)) == 2
        assert read_claims(tmp_path) == []
    assert [path.name for path in tmp_path.iterdir()] == [".locks"]


def test_the_lock_of_a_stopped_process_is_held_and_of_a_killed_one_free_at_once(tmp_path):
    with held_elsewhere(tmp_path) as process:
        process.send_signal(signal.SIGSTOP)
        (claim,) = read_claims(tmp_path)
        assert claim["process"] == process.pid
        process.kill()
        process.wait()
        assert read_claims(tmp_path) == []
        with lock_run(tmp_path, RUN, {}, wait=False):
            assert len(read_claims(tmp_path)) == 1


def test_where_nothing_can_be_locked_a_warning_says_so_and_the_work_is_done(tmp_path, caplog):
    (tmp_path / ".locks").write_text("no folder")
    with lock_run(tmp_path, RUN, {}):
        assert RUN in caplog.text


@dataclass
class Busy(Lookup):
    """Does something while it is fitted, and counts how often it was."""

    during: Callable[[], object] = lambda: None
    fits: list[int] = field(default_factory=list)

    def fit(self, references, places):
        self.fits.append(1)
        self.during()
        return super().fit(references, places)


def busy(during=lambda: None):
    return Busy(table(4, 4), during=during)


def made(method, store, lock=None):
    return get_or_run(asked_for(method, journey(4, 4), replace(QUICK, rates=False)), store, lock)


def lock_of_another(store):
    """Lock the run of `made` as another process would: it is known by what it would be stored as."""
    elsewhere = Store(store.root.with_name("elsewhere"))
    folder = made(busy(), elsewhere).folder
    return held_elsewhere(store.root, f"journey/{folder.name}")


def test_a_run_is_locked_while_it_is_made_and_a_stored_run_is_not(store, monkeypatch):
    seen = []
    made(busy(lambda: seen.extend(read_claims(store.root))), store)
    (claim,) = seen
    about = {"method": "little", "dataset": "journey", "seed": 0, "device": "cpu", "corruption": None}
    assert {name: claim[name] for name in about} == about
    assert read_claims(store.root) == []
    monkeypatch.setattr("vprbench.runs.get_or_run.lock_run", None)
    assert made(busy(), store).from_store


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_of_a_run_that_fails_or_is_interrupted_no_lock_and_no_file_is_left(error, store):
    def fail():
        assert len(read_claims(store.root)) == 1
        raise error

    with pytest.raises(error):
        made(busy(fail), store)
    assert (read_claims(store.root), [*(store.root / "journey").iterdir()]) == ([], [])


def test_in_a_sweep_a_run_that_another_process_makes_is_left_to_it(store):
    method = busy()
    with share_host() as lock, lock_of_another(store) as process:
        with pytest.raises(HeldElsewhereError) as raised:
            made(method, store, lock)
        assert (is_held(raised.value.path), method.fits) == (True, [])
        process.kill()
        process.wait()
        assert not made(method, store, lock).from_store
    assert method.fits == [1]


def test_of_ten_processes_that_want_a_run_one_makes_it_and_the_others_find_it(store, tmp_path):
    fits, found = tmp_path / "fits", tmp_path / "found"

    def work():
        result = made(busy(lambda: note(fits)), store)
        note(found, result.from_store)

    processes = [multiprocessing.get_context("fork").Process(target=work, daemon=True) for _ in range(10)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert (len(fits.read_text().split()), found.read_text().split().count("True")) == (1, 9)


def note(path, word="once"):
    """Add a word to a file, as one of several processes."""
    with path.open("a") as file:
        file.write(f"{word}\n")


def test_a_run_that_another_process_could_not_make_meanwhile_is_waited_for_and_tried_again(store):
    with lock_of_another(store) as process:
        threading.Timer(0.3, process.kill).start()
        method = busy()
        assert not made(method, store).from_store
    assert method.fits == [1]


def printed(capsys, store, *options):
    assert cli.main(["status", f"results={store.root}", *options]) == 0
    return capsys.readouterr().out


def test_stored_runs_and_failures_are_counted_and_a_run_that_is_being_made_stands_there_with_its_process(store, capsys):
    for seed in range(3):
        store.save(a_run(key=f"{seed % 2}"))
        store.save_failure(a_failure(config={**a_run().config, "seed": seed}))
    for path in (".partial-1/run.json", "journey/.partial-2/run.json", "descriptors/1/2/run.json"):
        (store.root / path).parent.mkdir(parents=True)
        (store.root / path).write_text("{}")
    assert len(printed(capsys, store).splitlines()) == 2
    with lock_run(store.root, "journey/little-1", ABOUT):
        (store.root / ".locks/of-a-killed-process").write_text('{"about": {"met')
        head, row = printed(capsys, store, "wide=true").splitlines()[1:]
        told = json.loads(printed(capsys, store, "output=json"))
    assert head.split()[:3] == ["run", "host", "process"]
    assert row.startswith("little on journey, shift-1  ")
    assert (told["runs"], told["failures"]) == (2, 3)
    (made,) = told["claims"]
    assert {name: made[name] for name in ABOUT} == ABOUT
    assert made["process"] == os.getpid()


def test_of_a_folder_that_is_not_there_nothing_is_told_or_made(tmp_path, capsys):
    assert cli.main(["status", f"results={tmp_path}/nowhere"]) == 2
    assert "/nowhere" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


# Runs of one host compute side by side, and each is timed alone.

COMPUTE = """
import time
from vprbench.runs.timing_lock import share_host
with share_host() as lock:
    print(time.time(), flush=True)
    time.sleep({})
"""
TIMED = """
    with lock.hold_alone():
        began = time.time()
        time.sleep(0.2)
        print(began, time.time())
"""


@pytest.fixture(autouse=True)
def _host(tmp_path, monkeypatch):
    """Work on a host where nothing runs."""
    monkeypatch.setenv(timing_lock.FOLDER, str(tmp_path / "locks"))


def start(code, seconds):
    """Start a process that computes for so many seconds."""
    return subprocess.Popen([sys.executable, "-c", code.format(seconds)], stdout=subprocess.PIPE, text=True)


def test_a_run_is_timed_once_the_others_have_computed_and_none_begins_meanwhile():
    with start(COMPUTE, 60) as computes:
        assert computes.stdout.readline()
        with share_host() as lock, share_host(lock) as same:
            assert same is lock
            assert not lock.is_only_run()
            threading.Timer(0.3, computes.kill).start()  # the system frees its lock
            with lock.hold_alone():
                computes.wait(20)
                begins = start(COMPUTE, 0)
                time.sleep(0.5)
                timed = time.time()
            assert float(begins.communicate()[0]) > timed
            assert lock.is_only_run()


def test_runs_that_compute_side_by_side_and_are_then_to_be_timed_are_timed_one_after_the_other():
    runs = [start(COMPUTE + TIMED, 0.3) for _ in range(3)]
    times = sorted([float(moment) for moment in run.communicate()[0].split()[1:]] for run in runs)
    assert all(one[1] <= next[0] for one, next in pairwise(times))
