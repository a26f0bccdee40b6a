"""The key of a run and the hash of its code: what can change a run changes them, and nothing else does."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import Lookup, journey, picture, pictures
from little_runs import QUICK, asked_for, run_of

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.methods.hog import HOG
from vprbench.plugins.networks import Files
from vprbench.run import harness, machine
from vprbench.run.corrupted_frames import corrupted
from vprbench.run.identity import code_hash, fingerprint
from vprbench.run.sources import meaning
from vprbench.run.stopwatch import Protocol

pytestmark = pytest.mark.usefixtures("surroundings")


DECIDED = Path(__file__).with_name("harness.json")
METHOD = Lookup(np.ones((6, 4), np.float32))


def key(dataset: Dataset | None = None, protocol: Protocol = QUICK, threads: int = 1, **changes: Any) -> str:
    dataset = dataset or journey(6, 4)
    asked = asked_for(METHOD, dataset, protocol, threads, **changes)
    return replace(asked, fingerprint=fingerprint(dataset)).key()


@pytest.mark.parametrize(
    "changes",
    [
        {"method": {"_target_": "little.Lookup", "window": 6}},
        {"seed": 1},
        {"depth": 4},
        {"threads": 2},
        {"dataset": replace(journey(6, 4), name="voyage")},
        {"dataset": replace(journey(6, 4), protocol={"queries": "dawn", "tolerance_places": 0})},
        {"dataset": journey(6, 4, [[0], [1], [2], [3], [0, 1], [1]])},
        {"dataset": replace(journey(6, 4), queries=pictures([0, 1, 2, 3, 4, 6]))},
        {"dataset": replace(journey(6, 4), queries=pictures([1, 0, 2, 3, 4, 5]))},
        {"dataset": replace(journey(6, 4), references=pictures([0, 1, 2, 4]))},
        {"dataset": replace(journey(6, 4), places=np.array([0, 1, 3, 2]))},
        {"dataset": corrupted(journey(6, 4), "shift-1")},
    ],
)
def test_a_run_that_could_end_otherwise_has_another_key(changes: dict[str, Any]) -> None:
    assert key(**changes) != key()


def test_another_device_has_another_key_and_another_version_of_this_package_has_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before, version = key(), importlib.metadata.version
    with monkeypatch.context() as patch:
        patch.setattr(machine, "processor", lambda: "Abacus 10")
        assert key() != before
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "9.9" if name == "vprbench" else version(name))
    assert (key(), machine.capture("cpu", 1)["vprbench"]) == (before, "9.9")


def test_a_run_that_loads_a_network_has_the_key_of_that_network_and_not_of_a_training() -> None:
    files = [Files(sha256=network) for network in (None, "a" * 64, "b" * 64, None)]
    keys = [asked_for(METHOD, journey(6, 4), files=given).key() for given in files]
    assert len(set(keys)) == 3
    assert keys[0] == keys[3]


@pytest.mark.parametrize(
    "changes",
    [
        {"overrides": ["results=elsewhere"]},
        {"protocol": replace(QUICK, minimum_queries=6, rates=False)},
        {"method": {"device": "cpu", "window": 5, "_target_": "little.Lookup"}},
        {"method": {"window": 5, "_target_": "little.Lookup"}},
        {"method": {"window": 5, "_target_": "moved.elsewhere.Lookup"}},
        *({name: {"other": 5}} for name in ("changed", "code", "timing")),  # what a run says of itself
        {},
    ],
    ids=str,
)
def test_what_cannot_change_a_run_does_not_change_its_key(changes: dict[str, Any]) -> None:
    assert key(**changes) == key()


def test_a_run_holds_the_hash_of_its_code_and_the_timing_protocol() -> None:
    run = run_of(METHOD, journey(6, 4))
    assert run.config["code"] == code_hash(type(METHOD))
    assert run.config["timing"] == {
        "minimum_seconds": 0,
        "minimum_queries": 5,
        "minimum_passes": 1,
        "maximum_seconds": 120.0,
        "sample": 16,
        "warmup_queries": 2,
        "batch_sizes": [1, 4],
        "total_seconds": None,
        "rates": True,
    }


def test_another_harness_changes_the_hash_of_every_method(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_hash(HOG)
    monkeypatch.setattr(harness, "VERSION", harness.VERSION + 1)
    assert code_hash(HOG) != before


def test_nobody_changes_what_reads_scores_and_times_without_a_decision() -> None:
    decided = json.loads(DECIDED.read_text())
    files = [Path(inspect.getfile(importlib.import_module(name))) for name in harness.MODULES]
    now = {"version": harness.VERSION, "meaning": meaning(files)}
    assert now == decided, (
        "the harness changed: if a run may now have other answers or times, raise harness.VERSION; in any case write "
        f"{json.dumps(now)} to {DECIDED}"
    )


@pytest.mark.parametrize("changes", [{"changed": {"window": 5}}, {"code": "c0de"}, {"timing": {"sample": 3}}])
def test_what_a_run_says_of_itself_does_not_change_its_key(changes: dict[str, Any]) -> None:
    assert key(**changes) == key()


def test_images_are_seen_through_the_fingerprint_whatever_their_names() -> None:
    named = Images.from_arrays([picture(0), picture(1)], ["a.png", "b.png"])
    renamed = Images.from_arrays([picture(0), picture(1)], ["a.png", "c.png"])
    assert named.fingerprint() != renamed.fingerprint()
