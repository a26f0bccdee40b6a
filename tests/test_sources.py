"""A stored run is answered anew when any file behind its method changes, and only then."""

from __future__ import annotations

import importlib
import sys

import pytest

from vprbench import sources
from vprbench.images import Images
from vprbench.methods.hog import HOG
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package whose method imports in every way there is."""
    folder = tmp_path / "meadow"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "method.py").write_text(
        "import numpy\nfrom vprbench.resize import Resize\n"
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
    assert found - set(sources.behind(Images)) == {
        "vprbench.resize",
        "",
        ".method",
        ".near",
        ".behind_near",
        ".beside",
        ".dotted",
        ".inner.late",
    }


def test_a_method_in_one_file_counts_its_own_file_and_the_contract():
    found = sources.behind(HOG)
    assert {"vprbench.methods.hog", "vprbench.interface", "vprbench.images"} <= set(found)
    assert not any("vprtempo" in name or "runner" in name for name in found)


def test_what_a_method_inherits_from_counts():
    found = sources.behind(VPRTempoEnsemble)
    assert {"vprbench.methods.vprtempo.method", "vprbench.methods.vprtempo.layer", "vprbench.preprocess"} <= set(found)
