"""A run is claimed while it is made: of many processes one makes it, the dead hold nothing, and `status` tells."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import pytest
from checkout import ROOT
from little import Lookup, a_failure, a_run, journey
from little_runs import QUICK, asked_for, table

from vprbench import cli
from vprbench.run import claims, find_or_make
from vprbench.run.claims import EXPIRES_SECONDS, Claim, Claims, Held, HeldElsewhereError
from vprbench.run.find_or_make import FailedElsewhereError
from vprbench.run.processes import IN_SWEEP, SINCE
from vprbench.run.settings import Settings
from vprbench.run.store import Store

pytestmark = pytest.mark.usefixtures("surroundings")

KEY = "journey/little-0123456789abcdef"
ABOUT = {"method": "little", "dataset": "journey", "seed": 3, "device": "cpu", "corruption": "shift-1"}
ELSEWHERE = {"token": "theirs", "machine": "another", "host": "far", "process": 1, "parent": 1, "started": 1}
OWNER = """
import os, sys, time
from pathlib import Path
from vprbench.run.claims import Claims
with Claims(Path(sys.argv[1])).take(sys.argv[2], {}):
    print("claimed", flush=True)
    time.sleep(60)
"""


@contextlib.contextmanager
def owner(root):
    """Yield a process that has claimed KEY, as one whose parent is this one."""
    command = [sys.executable, "-c", OWNER, str(root), KEY]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout.readline() == "claimed\n"
        yield process
        process.kill()


@pytest.mark.parametrize("key", [KEY, "a/b", "a-b", "ü/\udcff " + 300 * "x", "../../up"])
def test_of_all_who_want_a_run_of_any_name_one_gets_it_and_after_it_the_next_and_nothing_is_left(key, tmp_path):
    for _ in range(2):
        with Claims(tmp_path / "results").take(key, {}) as claim:
            assert isinstance(Claims(tmp_path / "results").take(key, {}), Held)
            assert [*(tmp_path / "results" / ".claims").iterdir()] == [claim.path]
            with Claims(tmp_path / "results").take(f"{key}0", {}) as other:
                assert isinstance(other, Claim)
        assert [*(tmp_path / "results").iterdir()] == []


def test_the_claim_of_a_stopped_owner_is_held_and_of_a_dead_one_is_free_at_once(tmp_path):
    with owner(tmp_path) as process:
        held = Claims(tmp_path).take(KEY, {})
        assert held.words["process"] == process.pid
        process.send_signal(signal.SIGSTOP)
        os.utime(held.path, (1.0, 1.0))
        assert isinstance(Claims(tmp_path).take(KEY, {}), Held)
        process.kill()
        process.wait()
        assert isinstance(Claims(tmp_path).take(KEY, {}), Claim)


@pytest.mark.parametrize("text", [None, "", '{"token": "th', "[]", '{"process": "x", "since": {}}'])
def test_the_claim_of_another_host_or_a_part_of_one_expires_and_is_taken_over_by_one_of_many(text, tmp_path):
    with Claims(tmp_path).take(KEY, {}) as claim:
        claim.path.write_text(json.dumps(ELSEWHERE) if text is None else text)
        for silent_seconds, held in ((EXPIRES_SECONDS - 10, 4), (EXPIRES_SECONDS + 10, 3)):
            os.utime(claim.path, (time.time() - silent_seconds,) * 2)
            with ThreadPoolExecutor(4) as threads:
                taken = [*threads.map(lambda _: Claims(tmp_path).take(KEY, {}), range(4))]
            assert [isinstance(each, Held) for each in taken].count(True) == held
    assert not claim.kept()
    Claims(tmp_path).tidy()
    assert [path.name for path in tmp_path.iterdir()] == [".claims"]  # of a living owner


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


def made(method, store):
    request = asked_for(method, journey(4, 4), replace(QUICK, rates=False), files=find_or_make.networks.Files())
    request = replace(request, config={**request.config, "files": []})
    return find_or_make.made(request, Settings(frames=False, timing=request.protocol), store, {})


def claim_of_another(store):
    """Claim the run of `made` as another process would: it is known by what it would be stored as."""
    elsewhere = Store(store.root.with_name("elsewhere"))
    made(busy(), elsewhere)
    (folder,) = (elsewhere.root / "journey").iterdir()
    claim = Claims(store.root).take(f"journey/{folder.name}", {})
    assert isinstance(claim, Claim)
    return claim


def failure_of(method):
    config = {**asked_for(method, journey(4, 4)).config, "files": []}
    return a_failure(method="little", dataset="journey", config=config, error="ValueError: no", missing=False)


def test_a_run_is_claimed_while_it_is_made_and_nothing_is_left_of_the_claim_nor_is_a_stored_one_claimed(
    store, monkeypatch
):
    seen = []
    made(busy(lambda: seen.extend(dict(held.words) for held in Claims(store.root).held())), store)
    (words,) = seen
    assert words["about"] == {"method": "little", "dataset": "journey", "seed": 0, "device": "cpu", "corruption": None}
    assert words["stage"] == "fit"
    assert [path.name for path in store.root.iterdir()] == ["journey"]
    monkeypatch.setattr(Claims, "take", None)
    assert made(busy(), store).from_store


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_of_a_run_that_fails_or_is_interrupted_nothing_is_left(error, store):
    def fail():
        assert len(Claims(store.root).held()) == 1
        raise error

    with pytest.raises(error):
        made(busy(fail), store)
    assert [*store.root.iterdir()] == []


def test_in_a_sweep_a_run_that_another_process_makes_is_left_to_it(store, monkeypatch):
    claim, method = claim_of_another(store), busy()
    monkeypatch.setenv(IN_SWEEP, "1")
    with pytest.raises(HeldElsewhereError) as raised:
        made(method, store)
    assert (raised.value.claim, method.fits) == (claim.path, [])
    claim.release()
    assert not made(method, store).from_store
    assert method.fits == [1]


def test_alone_a_run_waits_for_the_one_who_makes_it_and_is_answered_from_the_store(store, monkeypatch):
    monkeypatch.setattr(claims, "_LOOK_EVERY", 0.01)
    begun, waited_for = threading.Event(), threading.Event()

    def wait(path):
        waited_for.set()
        claims.wait(path)

    monkeypatch.setattr(find_or_make, "wait", wait)
    other = threading.Thread(target=made, args=(busy(lambda: begun.set() or waited_for.wait(20)), store))
    other.start()
    begun.wait(20)
    method = busy()
    assert made(method, store).from_store
    other.join()
    assert method.fits == []
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def test_alone_a_run_that_fails_elsewhere_meanwhile_is_not_tried_again(store, monkeypatch):
    claim, method = claim_of_another(store), busy()

    def fail(_):
        store.save_failure(failure_of(method))
        claim.release()

    monkeypatch.setattr(find_or_make, "wait", fail)
    with pytest.raises(FailedElsewhereError, match=r"little on journey failed .*: ValueError: no"):
        made(method, store)
    assert method.fits == []


def test_a_sweep_tries_again_what_failed_before_it_began_and_nothing_that_failed_since(store, monkeypatch):
    method = busy()
    before = Claims(store.root).now() - 1
    store.save_failure(failure_of(method))
    monkeypatch.setenv(SINCE, repr(before))
    with pytest.raises(FailedElsewhereError):
        made(method, store)
    monkeypatch.setenv(SINCE, repr(before + 60))
    assert not made(method, store).from_store
    assert method.fits == [1]


def test_a_run_that_another_process_took_over_meanwhile_is_not_stored(store, monkeypatch):
    def lose():
        (held,) = Claims(store.root).held()
        held.path.write_text(json.dumps({"token": "theirs"}))

    monkeypatch.setenv(IN_SWEEP, "1")
    with pytest.raises(HeldElsewhereError):
        made(busy(lose), store)
    assert [*store.runs()] == []
    assert len(Claims(store.root).held()) == 1


def printed(capsys, store, *options):
    assert cli.main(["status", f"results={store.root}", *options]) == 0
    return capsys.readouterr().out


def test_stored_runs_and_failures_are_counted_and_a_run_that_is_being_made_stands_there_with_stage_and_owner(
    store, capsys
):
    for seed in range(3):
        store.save(a_run(key=f"{seed % 2}"))
        store.save_failure(a_failure(config={"seed": seed}))
    for path in (".partial-1/run.json", "journey/.damaged-1/run.json", "descriptors/1/2/run.json"):
        (store.root / path).parent.mkdir(parents=True)
        (store.root / path).write_text("{}")
    assert len(printed(capsys, store).splitlines()) == 2
    with Claims(store.root).take("journey/little-1", ABOUT) as claim:
        claim.tell("fit, reading images", 0.25)
        head, row = printed(capsys, store, "wide=true").splitlines()[1:]
        told = json.loads(printed(capsys, store, "output=json"))
    assert head.split()[:3] == ["run", "stage", "%"]
    assert row.startswith("little on journey, shift-1  fit")
    assert (told["runs"], told["failures"]) == (2, 3)
    (made,) = told["claims"]
    assert {name: made[name] for name in ABOUT} == ABOUT
    assert (made["stage"], made["done"], made["process"]) == ("fit, reading images", 0.25, os.getpid())
    assert made["alive"]
    assert made["silent_seconds"] < 30


def test_the_claim_of_a_dead_owner_and_one_that_is_not_all_there_stand_there_too(store, capsys):
    folder = store.root / ".claims"
    folder.mkdir(parents=True)
    (folder / "half").write_text('{"about": {"met')
    (folder / "odd").write_text('{"about": 3, "since": "x", "done": "x", "owner": "\\u001b[2J"}')
    (folder / "old").write_text("")
    os.utime(folder / "old", (1.0, 1.0))
    lines = printed(capsys, store, "wide=true").splitlines()
    assert len(lines) == 5
    assert ["dead" in line for line in lines[2:]].count(True) == 1
    assert "\x1b" not in "".join(lines)


def test_of_a_folder_that_is_not_there_nothing_is_told_or_made(tmp_path, capsys):
    assert cli.main(["status", f"results={tmp_path}/nowhere"]) == 2
    assert "/nowhere" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []
