"""A run is claimed while it is made: who else wants it waits or goes on, and then has what became of it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import pytest
from little import Lookup, a_failure, journey
from little_runs import QUICK, asked_for, table

from vprbench.api.images import Images
from vprbench.run import claims, find_or_make
from vprbench.run.claims import Claim, Claims, HeldElsewhereError
from vprbench.run.find_or_make import FailedElsewhereError, Made
from vprbench.run.processes import IN_SWEEP, SINCE
from vprbench.run.settings import Settings
from vprbench.run.store import Store

pytestmark = pytest.mark.usefixtures("surroundings")


@dataclass
class Busy(Lookup):
    """Does something while it is fitted, and counts how often it was."""

    during: Callable[[], object] = lambda: None
    fits: list[int] = field(default_factory=list)

    def fit(self, references: Images, places: Any) -> Self:
        self.fits.append(1)
        self.during()
        return super().fit(references, places)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")


def busy(during: Callable[[], object] = lambda: None) -> Busy:
    return Busy(table(4, 4), during=during)


def made(method: Busy, store: Store) -> Made:
    request = asked_for(method, journey(4, 4), replace(QUICK, rates=False), files=find_or_make.networks.Files())
    request = replace(request, config={**request.config, "files": []})
    return find_or_make.made(request, Settings(frames=False, timing=request.protocol), store, {})


def claim_of_another(store: Store) -> Claim:
    """Claim the run of `made` as another process would: it is known by what it would be stored as."""
    seen: list[Path] = []
    elsewhere = Store(store.root.with_name("elsewhere"))
    made(busy(lambda: seen.extend(held.path for held in Claims(elsewhere.root).held())), elsewhere)
    (folder,) = (elsewhere.root / "journey").iterdir()
    claim = Claims(store.root).take(f"journey/{folder.name}", {})
    assert isinstance(claim, Claim)
    assert claim.path.name == seen[0].name
    return claim


def test_a_run_is_claimed_while_it_is_made_and_nothing_is_left_of_the_claim(store: Store) -> None:
    seen: list[dict[str, Any]] = []
    made(busy(lambda: seen.extend(dict(held.words) for held in Claims(store.root).held())), store)
    (words,) = seen
    assert words["about"] == {"method": "little", "dataset": "journey", "seed": 0, "device": "cpu", "corruption": None}
    assert words["stage"] == "fit"
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def test_a_stored_run_is_not_claimed(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    made(busy(), store)
    monkeypatch.setattr(Claims, "take", None)
    assert made(busy(), store).from_store


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_of_a_run_that_fails_or_is_interrupted_no_claim_is_left(error: type[BaseException], store: Store) -> None:
    def fail() -> None:
        assert len(Claims(store.root).held()) == 1
        raise error

    with pytest.raises(error):
        made(busy(fail), store)
    assert [*store.root.iterdir()] == []


def test_in_a_sweep_a_run_that_another_process_makes_is_left_to_it(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim, method = claim_of_another(store), busy()
    monkeypatch.setenv(IN_SWEEP, "1")
    with pytest.raises(HeldElsewhereError, match="little on journey is being made by") as raised:
        made(method, store)
    assert (raised.value.claim, method.fits) == (claim.path, [])
    claim.release()
    assert not made(method, store).from_store
    assert method.fits == [1]


def test_alone_a_run_waits_for_the_one_who_makes_it_and_is_answered_from_the_store(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    monkeypatch.setattr(claims, "_LOOK_EVERY", 0.01)
    begun, waited_for = threading.Event(), threading.Event()

    def wait(path: Path) -> None:
        waited_for.set()
        claims.wait(path)

    monkeypatch.setattr(find_or_make, "wait", wait)
    other = threading.Thread(target=made, args=(busy(lambda: begun.set() or waited_for.wait()), store))
    other.start()
    begun.wait()
    method = busy()
    assert made(method, store).from_store
    other.join()
    assert method.fits == []
    assert "waiting for it" in caplog.text
    assert [path.name for path in store.root.iterdir()] == ["journey"]


def failure_of(method: Busy) -> Any:
    config = {**asked_for(method, journey(4, 4)).config, "files": []}
    return a_failure(method="little", dataset="journey", config=config, error="ValueError: no", missing=False)


def test_alone_a_run_that_fails_elsewhere_meanwhile_is_not_tried_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    claim, method = claim_of_another(store), busy()

    def fail(_: Path) -> None:
        store.save_failure(failure_of(method))
        claim.release()

    monkeypatch.setattr(find_or_make, "wait", fail)
    with pytest.raises(FailedElsewhereError, match="little on journey failed in another process: ValueError: no"):
        made(method, store)
    assert method.fits == []


def test_a_sweep_tries_again_what_failed_before_it_began_and_nothing_that_failed_since(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.prepare()
    method = busy()
    before = Claims(store.root).now() - 1
    store.save_failure(failure_of(method))
    monkeypatch.setenv(SINCE, repr(before))
    with pytest.raises(FailedElsewhereError):
        made(method, store)
    monkeypatch.setenv(SINCE, repr(before + 60))
    assert not made(method, store).from_store
    assert method.fits == [1]


def test_a_run_that_another_process_took_over_meanwhile_is_not_stored(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose() -> None:
        (held,) = Claims(store.root).held()
        held.path.write_text(json.dumps({"token": "theirs"}))

    monkeypatch.setenv(IN_SWEEP, "1")
    with pytest.raises(HeldElsewhereError, match="took it over"):
        made(busy(lose), store)
    assert [*store.runs()] == []
    assert len(Claims(store.root).held()) == 1
