"""The code behind a class of a notebook: what it says and all of the session that it names, and nothing else."""

from __future__ import annotations

import linecache
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from vprbench.run.identity import code_hash
from vprbench.run.loose_code import UntoldError
from vprbench.run.sources import source_hash

CELLS = '''
import numpy as np
from dataclasses import dataclass
from vprbench.api import Method, Resize

SCALE, UNUSED = 2.0, 1
WEIGHTS = np.arange(6)

def halved(value):
    return quartered(value) * 2

def quartered(value):
    return value / 4

@dataclass
class Base(Method):
    """A base."""

    def fit(self, references, places):
        return self

class Mine(Base):
    def encode(self, images):
        return [halved(np.mean(image)) * SCALE + WEIGHTS.sum() for image in images]

    def match(self, codes):
        return codes
'''


def session(monkeypatch: pytest.MonkeyPatch, text: str, known: bool = True, **values: Any) -> type[Any]:
    """Run a text as the cell of a notebook and return the class Mine that it defines."""
    main = ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", main)
    name = f"<cell {abs(hash(text))}>"
    if known:
        monkeypatch.setitem(linecache.cache, name, (len(text), None, text.splitlines(keepends=True), name))
    vars(main).update(values)
    exec(compile(text, name, "exec"), vars(main))
    return main.Mine  # type: ignore[no-any-return]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("SCALE, UNUSED = 2.0, 1", "SCALE, UNUSED = 3.0, 1"),
        ("arange(6)", "arange(7)"),
        ("* 2\n", "* 3\n"),
        ("value / 4", "value / 5"),
        ("        return self", "        return self.reset()"),
        ("return codes", "return -codes"),
        ("np.mean(image)", "Resize(image)"),
    ],
)
def test_what_a_class_and_all_that_it_names_says_counts(monkeypatch: pytest.MonkeyPatch, old: str, new: str) -> None:
    assert old in CELLS
    before = source_hash(session(monkeypatch, CELLS))
    assert source_hash(session(monkeypatch, CELLS.replace(old, new))) != before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("UNUSED = 2.0, 1", "UNUSED = 2.0, 7"),
        ("A base.", "One base."),
        ("def halved", "def other():\n    return 1\n\ndef halved"),
        ("    def match", "    # the rest\n\n    def match"),
    ],
)
def test_words_and_what_it_does_not_name_do_not_count(monkeypatch: pytest.MonkeyPatch, old: str, new: str) -> None:
    assert old in CELLS
    before = source_hash(session(monkeypatch, CELLS))
    assert source_hash(session(monkeypatch, CELLS.replace(old, new))) == before


def test_a_class_without_source_or_with_a_network_behind_it_cannot_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UntoldError, match="Mine"):
        source_hash(unknown := session(monkeypatch, CELLS, known=False))
    assert code_hash(unknown) != code_hash(unknown)
    network = CELLS.replace("SCALE +", "SCALE + NET.weight +")
    with pytest.raises(UntoldError, match="NET"):
        source_hash(session(monkeypatch, network, NET=np.random.default_rng()))
