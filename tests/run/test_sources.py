"""A stored run is answered anew when any file behind its method changes, and only then."""

from __future__ import annotations

import importlib
import sys

import pytest

from vprbench.methods.hog import HOG
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.run import sources


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package whose method imports in every way there is."""
    folder = tmp_path / "meadow"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "method.py").write_text(
        "import numpy\nfrom vprbench.api.resize import Resize\n"
        "from .near import thing\nfrom . import beside\nimport meadow.dotted\n"
        "class Method:\n    def fit(self):\n        from meadow.inner.late import x\n"
    )
    (folder / "near.py").write_text("from .behind_near import thing\nfrom .method import Method\n")
    (folder / "behind_near.py").write_text("thing = 1\n")
    (folder / "beside.py").write_text("")
    (folder / "dotted.py").write_text("")
    (folder / "inner" / "__init__.py").write_text("from .late import x\n")
    (folder / "inner" / "late.py").write_text("x = 1\n")
    (folder / "unused.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "meadow"]:
        del sys.modules[name]


def test_all_files_of_the_package_that_are_imported_count_and_no_other(package):
    # Circular on purpose: near imports method.
    (package / "near.py").write_text("from .behind_near import thing\n")
    method = importlib.import_module("meadow.method").Method
    (package / "near.py").write_text("from .behind_near import thing\nfrom .method import Method\n")
    found = {name.removeprefix("meadow") for name in sources.behind(method)}
    assert found == {
        "vprbench.api.resize",
        "",
        ".method",
        ".near",
        ".behind_near",
        ".beside",
        ".dotted",
        ".inner.late",
    }


def test_a_method_in_one_file_counts_its_own_file_and_what_computes_for_it():
    found = sources.behind(HOG)
    assert {"vprbench.methods.hog", "vprbench.api.descriptor", "vprbench.api.search"} <= set(found)
    assert not any(word in name for name in found for word in ("vprtempo", "runner", "images", "progress"))


def test_what_a_method_inherits_from_counts():
    found = sources.behind(VPRTempoEnsemble)
    assert {"vprbench.methods.vprtempo.method", "vprbench.methods.vprtempo.layer", "vprbench.api.preprocess"} <= set(
        found
    )


BEFORE = '''"""Counts."""
from typing import TYPE_CHECKING
from meadow.near import thing

class Method:
    """A method."""

    window: int = 5  # pixels

    def fit(self):
        """Fit it."""
        return [thing + 2 * self.window, -1]
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A method.", "One method."),
        ('    """A method."""\n\n', ""),
        ("  # pixels", "  # of the patch"),
        ("\n    def fit", "\n\n\n    def fit"),
        ("[thing + 2 * self.window, -1]", "[\n            thing + (2 * self.window),\n            -1,\n        ]"),
        ("from meadow.near", "from .near"),
        ("from meadow.near", "from meadow.inner.moved"),
        (
            "\nclass",
            "\nif TYPE_CHECKING:\n    from meadow.inner import late\n\nclass",
        ),
    ],
)
def test_words_layout_and_place_of_code_do_not_count(tmp_path, old, new):
    assert (old in BEFORE, _meaning(tmp_path, BEFORE.replace(old, new))) == (True, _meaning(tmp_path, BEFORE))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2 *", "3 *"),
        ("= 5", "= 6"),
        ("= 5", "= 5.0"),
        ("-1", "1"),
        ("-1", "None"),
        ("int", "float"),
        ("thing +", "thing -"),
    ],
)
def test_values_defaults_and_statements_count(tmp_path, old, new):
    assert old in BEFORE
    assert _meaning(tmp_path, BEFORE.replace(old, new)) != _meaning(tmp_path, BEFORE)


def test_a_file_that_is_moved_and_renamed_with_its_imports_leaves_the_hash_of_a_method(package, monkeypatch):
    (package / "near.py").write_text("from .behind_near import thing\n")
    before = sources.source_hash(importlib.import_module("meadow.method").Method)
    for name in [name for name in sys.modules if name.partition(".")[0] == "meadow"]:
        del sys.modules[name]
    (package / "near.py").rename(package / "inner" / "close.py")
    for file in ("method.py", "inner/close.py"):
        text = (package / file).read_text().replace("from .near", "from .inner.close")
        (package / file).write_text(
            text.replace("from .behind_near", "from ..behind_near").replace("from .method", "from ..method")
        )
    assert sources.source_hash(importlib.import_module("meadow.method").Method) == before
    (package / "behind_near.py").write_text("thing = 2\n")
    assert sources.source_hash(importlib.import_module("meadow.method").Method) != before


def _meaning(folder, text):
    (folder / "code.py").write_text(text)
    return sources.meaning([folder / "code.py"])
