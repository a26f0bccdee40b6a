"""Claims on runs: of many processes one has it, the dead hold nothing, and nothing is left behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest
from checkout import ROOT

from vprbench import ending
from vprbench.run import claims
from vprbench.run.claims import EXPIRES_SECONDS, Claim, Claims, Held

KEY = "journey/little-0123456789abcdef"
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
def owner(root: Path) -> Iterator[subprocess.Popen[str]]:
    """Yield a process that has claimed KEY, as one whose parent is this one."""
    command = [sys.executable, "-c", OWNER, str(root), KEY]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "claimed\n"
        yield process
        process.kill()


def claimed(root: Path, silent_seconds: float, text: str | None = None) -> Path:
    """Write the claim of a process of another host, which has been silent for so long."""
    taken = Claims(root).take(KEY, {})
    assert isinstance(taken, Claim)
    taken.path.write_text(json.dumps(ELSEWHERE) if text is None else text)
    moment = time.time() - silent_seconds
    os.utime(taken.path, (moment, moment))
    return taken.path


def test_a_claim_tells_who_has_it_since_when_and_how_far(tmp_path: Path) -> None:
    with Claims(tmp_path).take(KEY, {"method": "little"}) as claim:
        claim.tell("fit", 0.25)
        (held,) = Claims(tmp_path).held()
    assert held.alive
    assert (held.words["process"], held.words["parent"]) == (os.getpid(), os.getppid())
    assert abs(held.words["since"] - time.time()) < 60
    told = {name: held.words[name] for name in ("key", "about", "stage", "done")}
    assert told == {"key": KEY, "about": {"method": "little"}, "stage": "fit", "done": 0.25}


def test_of_all_who_want_a_run_one_gets_it_and_after_it_the_next(tmp_path: Path) -> None:
    first = Claims(tmp_path).take(KEY, {})
    assert isinstance(first, Claim)
    assert isinstance(Claims(tmp_path).take(KEY, {}), Held)
    assert isinstance(Claims(tmp_path).take(f"{KEY}0", {}), Claim)
    first.release()
    assert isinstance(Claims(tmp_path).take(KEY, {}), Claim)


@pytest.mark.parametrize("key", [KEY, "a/b", "a-b", "ü/\udcff " + 300 * "x", "../../up"])
def test_a_run_of_any_name_is_claimed_in_the_store_and_nothing_of_it_is_left(key: str, tmp_path: Path) -> None:
    with Claims(tmp_path / "results").take(key, {}) as claim:
        assert [*(tmp_path / "results" / ".claims").iterdir()] == [claim.path]
    assert [*(tmp_path / "results").iterdir()] == []


def test_the_claim_of_a_dead_owner_is_free_at_once_and_that_of_a_stopped_one_is_not(tmp_path: Path) -> None:
    with owner(tmp_path) as process:
        held = Claims(tmp_path).take(KEY, {})
        assert isinstance(held, Held)
        assert held.words["process"] == process.pid
        process.send_signal(signal.SIGSTOP)
        os.utime(held.path, (1.0, 1.0))
        assert isinstance(Claims(tmp_path).take(KEY, {}), Held)
        process.kill()
        process.wait()
        assert isinstance(Claims(tmp_path).take(KEY, {}), Claim)


def test_an_owner_is_no_other_process_that_got_its_number(tmp_path: Path) -> None:
    with owner(tmp_path):
        (held,) = Claims(tmp_path).held()
        held.path.write_text(json.dumps({**held.words, "started": held.words["started"] - 1}))
        assert not claims.is_held(held.path)


def test_a_dead_owner_holds_its_claim_until_who_waits_for_it_has_stored_its_failure(tmp_path: Path) -> None:
    with owner(tmp_path) as process:
        (held,) = Claims(tmp_path).held()
        words = dict(held.words)
        waits = {"parent": words["process"], "parent_started": words["started"]}
        other = held.path.with_name("another")
        other.write_text(json.dumps({**words, **waits, "process": 2**30}))
        assert claims.is_held(other)
        process.kill()
        process.wait()
        assert not claims.is_held(other)


@pytest.mark.parametrize("text", [None, "", '{"token": "th', "[]", '{"process": "x", "since": {}}'])
def test_the_claim_of_another_host_or_a_part_of_one_expires_with_its_last_beat(text: str, tmp_path: Path) -> None:
    path = claimed(tmp_path, EXPIRES_SECONDS - 10, text)
    assert claims.is_held(path)
    assert isinstance(Claims(tmp_path).take(KEY, {}), Held)
    moment = time.time() - EXPIRES_SECONDS - 10
    os.utime(path, (moment, moment))
    assert not claims.is_held(path)
    assert isinstance(Claims(tmp_path).take(KEY, {}), Claim)


def test_a_dead_claim_is_taken_over_by_one_of_many(tmp_path: Path) -> None:
    for _ in range(30):
        claimed(tmp_path, 2 * EXPIRES_SECONDS)
        at_once = Barrier(4)

        def take(_: int, at_once: Barrier = at_once) -> Claim | Held:
            at_once.wait()
            return Claims(tmp_path).take(KEY, {})

        with ThreadPoolExecutor(4) as threads:
            taken = [*threads.map(take, range(4))]
        (claim,) = (each for each in taken if isinstance(each, Claim))
        assert claim.kept()
        claim.release()
        assert [*tmp_path.iterdir()] == []


def test_an_owner_that_was_taken_for_dead_knows_it_and_touches_nothing_of_the_new_one(tmp_path: Path) -> None:
    lost = Claims(tmp_path).take(KEY, {})
    assert isinstance(lost, Claim)
    lost.path.unlink()
    assert not lost.kept()
    before = claimed(tmp_path, 10).stat()
    assert not lost.kept()
    lost.tell("fit", 0.5)
    claims.beat(lost.path)
    lost.release()
    assert json.loads(lost.path.read_text()) == ELSEWHERE
    assert lost.path.stat().st_mtime_ns == before.st_mtime_ns


def test_who_waits_for_a_process_keeps_its_claim_alive_and_clears_it_away(tmp_path: Path) -> None:
    with owner(tmp_path) as process:
        (held,) = Claims(tmp_path).held()
        os.utime(held.path, (1.0, 1.0))
        claims.beat(held.path)
        assert time.time() - held.path.stat().st_mtime < 60
        claims.clear(held.path)
        assert held.path.exists()
        process.kill()
        process.wait()
        claims.clear(held.path)
    assert [*tmp_path.iterdir()] == []


def test_where_nobody_waits_for_a_process_it_beats_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "BEAT_SECONDS", 0.01)
    assert not ending.waited_for()
    with Claims(tmp_path).take(KEY, {}) as claim:
        os.utime(claim.path, (1.0, 1.0))
        while claim.path.stat().st_mtime == 1.0:
            time.sleep(0.01)


def test_a_tidy_store_has_no_claim_of_the_dead_and_nothing_that_they_left(tmp_path: Path) -> None:
    with owner(tmp_path) as process:
        (held,) = Claims(tmp_path).held()
    assert process.returncode == -signal.SIGKILL
    held.path.rename(held.path.with_name(".partial-1"))
    os.utime(held.path.with_name(".partial-1"), (1.0, 1.0))
    claimed(tmp_path, 2 * EXPIRES_SECONDS)
    with Claims(tmp_path).take("another", {}) as claim:
        Claims(tmp_path).tidy()
        assert [*(tmp_path / ".claims").iterdir()] == [claim.path]
    Claims(tmp_path).tidy()
    assert [*tmp_path.iterdir()] == []


def test_where_nothing_can_be_claimed_the_run_is_made_all_the_same(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / ".claims").write_text("no folder")
    with Claims(tmp_path).take(KEY, {}) as claim:
        claim.tell("fit", 0.5)
        assert claim.kept()
    assert Claims(tmp_path).held() == []
    (warning,) = caplog.records
    assert f"{KEY} cannot be claimed (" in warning.getMessage()
