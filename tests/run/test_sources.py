"""A stored run is answered anew when what any file behind its method says changes, and only then."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from checkout import ROOT
from small_plan import RUN

from vprbench.cli import main
from vprbench.methods.hog import HOG
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.plugins import registry
from vprbench.run import sources


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty package named meadow."""
    folder = tmp_path / "meadow"
    (folder / "inner").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    forget()


def forget() -> None:
    """Let the package be imported anew."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "meadow"]:
        del sys.modules[name]
    importlib.invalidate_caches()


def test_all_files_of_the_package_that_are_imported_in_any_way_count_and_no_other(package: Path) -> None:
    files = {
        "__init__": "",
        "method": "import numpy\nfrom vprbench.api.resize import Resize\n"
        "from .near import thing\nfrom . import beside\nimport meadow.dotted\n"
        "class Method:\n    def fit(self):\n        from meadow.inner.late import x\n",
        "near": "from .behind_near import thing\nif not thing:\n    from .method import Method\n",  # a circle
        **{"behind_near": "thing = 1\n", "beside": "", "dotted": "", "unused": ""},
        **{"inner/__init__": "from .late import x\n", "inner/late": "x = 1\n"},
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    found = sources.behind(importlib.import_module("meadow.method").Method)
    wanted = ("", ".method", ".near", ".behind_near", ".beside", ".dotted", ".inner.late")
    assert set(found) == {"vprbench.api.resize", *(f"meadow{name}" for name in wanted)}


def test_a_method_counts_its_own_file_what_it_inherits_from_and_what_computes_for_it() -> None:
    found = sources.behind(HOG)
    assert {"vprbench.methods.hog", "vprbench.api.descriptor", "vprbench.api.search"} <= set(found)
    assert not any(word in name for name in found for word in ("vprtempo", "runner", "images", "progress"))
    inherited = {f"vprbench.{name}" for name in ("methods.vprtempo.method", "methods.vprtempo.layer", "api.preprocess")}
    assert inherited <= set(sources.behind(VPRTempoEnsemble))


@pytest.fixture
def from_store(
    package: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, str, str], bool]:
    """Return what changes a text in the package's copy of SAD and tells whether its stored run is found then."""
    text = (ROOT / "methods/sad.py").read_text().replace("from .parts", "from vprbench.methods.parts")
    (package / "sad.py").write_text(text)
    (package / "method").mkdir()
    yaml = (ROOT / "conf/method/sad.yaml").read_text()
    (package / "method/grass.yaml").write_text(yaml.replace("vprbench.methods.sad", "meadow.sad"))
    ours = registry.conf_folders()
    monkeypatch.setattr("vprbench.plugins.entries.conf_folders", lambda: {**ours, "meadow": package})
    monkeypatch.chdir(package.parent)

    def found(file: str = "sad.py", old: str = "", new: str = "") -> bool:
        text = (package / file).read_text()
        assert old in text
        (package / file).write_text(text.replace(old, new))
        forget()
        asked = ["method=grass", "dataset.places=12", "dataset.first_query_place=0", "frames=false", "output=json"]
        assert main([*asked, *RUN]) == 0
        return bool(json.loads(capsys.readouterr().out)["from_store"])

    return found


def test_the_run_of_a_real_method_is_found_after_an_edited_docstring_and_a_moved_file_and_not_after_another_number(
    package: Path, from_store: Callable[..., bool]
) -> None:
    assert not from_store()
    assert from_store("sad.py", '"""Scores a place by minus the', '"""Scores a place by less the')
    (package / "sad.py").rename(package / "inner" / "moved.py")
    assert from_store("method/grass.yaml", "meadow.sad", "meadow.inner.moved")
    number = ("similarity[query, row] = -0.0", "similarity[query, row] = -1.0")
    assert not from_store("inner/moved.py", *number)
    assert from_store("inner/moved.py", *number[::-1])
    assert not from_store("method/grass.yaml", "patch: 7", "patch: 5")


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
        ("\nclass", "\nif TYPE_CHECKING:\n    from meadow.inner import late\n\nclass"),
    ],
)
def test_words_layout_and_place_of_code_do_not_count(tmp_path: Path, old: str, new: str) -> None:
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
def test_values_defaults_and_statements_count(tmp_path: Path, old: str, new: str) -> None:
    assert old in BEFORE
    assert _meaning(tmp_path, BEFORE.replace(old, new)) != _meaning(tmp_path, BEFORE)


def _meaning(folder: Path, text: str) -> str:
    (folder / "code.py").write_text(text)
    return sources.meaning([folder / "code.py"])
