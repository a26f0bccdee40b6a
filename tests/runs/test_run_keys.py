"""The key of a run and the hash of its code: what can change a run changes them, and nothing else does."""

import importlib
import inspect
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from checkout import ROOT
from little import Lookup, journey, pictures
from little_runs import QUICK, asked_for, run_of
from plugged_in import see_yamls
from small_plan import RUN

from vprbench.cli import main
from vprbench.methods.hog import HOG
from vprbench.plugins.networks import Files
from vprbench.runs import identity, machine
from vprbench.runs.corruption import corrupt_queries
from vprbench.runs.identity import compute_fingerprint, hash_code

pytestmark = pytest.mark.usefixtures("surroundings")

DECIDED = Path(__file__).with_name("version.json")
METHOD, LITTLE = Lookup(np.ones((6, 4), np.float32)), journey(6, 4)


def key(dataset=None, protocol=QUICK, threads=1, **changes):
    asked = asked_for(METHOD, dataset or LITTLE, protocol, threads, **changes)
    return replace(asked, fingerprint=compute_fingerprint(dataset or LITTLE)).key()


def test_a_run_that_could_end_otherwise_has_another_key():
    others = (
        {"method": {"_target_": "little.Lookup", "window": 6}},
        *({name: value} for name, value in (("seed", 1), ("depth", 4), ("threads", 2), ("tuned_on", {"dataset": "a"}))),
        {"dataset": journey(6, 4, [[0], [1], [2], [3], [0, 1], [1]])},
        {"dataset": corrupt_queries(LITTLE, "shift-1")},
        *(
            {"dataset": replace(LITTLE, **{part: value})}
            for part, value in (
                ("name", "voyage"),
                ("protocol", {"queries": "dawn", "tolerance_places": 0}),
                ("queries", pictures([0, 1, 2, 3, 4, 6])),
                ("queries", pictures([1, 0, 2, 3, 4, 5])),
                ("references", pictures([0, 1, 2, 4])),
                ("places", np.array([0, 1, 3, 2])),
                ("query_breaks", np.array([2])),
            )
        ),
    )
    assert [changes for changes in others if key(**changes) == key()] == []


def test_another_processor_has_another_key_and_a_run_that_loads_a_network_that_of_the_network(monkeypatch):
    files = [Files(sha256=network) for network in (None, "a" * 64, "b" * 64, None)]
    keys = [asked_for(METHOD, LITTLE, files=given).key() for given in files]
    assert (len(set(keys)), keys[0]) == (3, keys[3])
    before = key()
    monkeypatch.setattr(machine, "read_processor_name", lambda: "Abacus 10")
    assert key() != before


def test_what_cannot_change_a_run_does_not_change_its_key():
    for changes in (
        {"overrides": ["results=elsewhere"], "results": "elsewhere"},
        {"protocol": replace(QUICK, minimum_queries=6, rates=False)},
        {"method": {"device": "cpu", "window": 5, "_target_": "little.Lookup"}},
        {"method": {"window": 5, "_target_": "moved.elsewhere.Lookup"}},
        {"changed": {"other": 5}},
    ):
        assert key(**changes) == key(), changes


def test_a_run_holds_the_hash_of_its_code_and_the_timing_protocol(monkeypatch):
    monkeypatch.setattr("vprbench.runs.run.hash_code", hash_code)
    run = run_of(METHOD, LITTLE)
    assert run.config["code"] == hash_code(type(METHOD))
    assert run.config["timing"] == {
        **{"minimum_seconds": 0, "minimum_queries": 5, "minimum_passes": 1, "maximum_seconds": 120.0},
        **{"sample": 16, "warmup_queries": 2, "batch_sizes": [1, 4], "rates": True},
    }


def test_another_harness_changes_the_hash_of_every_method_and_nobody_changes_it_without_a_decision(monkeypatch):
    decided = json.loads(DECIDED.read_text())
    files = [Path(inspect.getfile(importlib.import_module(name))) for name in identity.MODULES]
    files += (ROOT / "vprbench/api").rglob("*.py")
    now = {"version": identity.VERSION, "code": identity.hash_files(files)}
    assert now == decided, (
        "the harness changed: if a run may now have other answers or times, raise identity.VERSION; in any case write "
        f"{json.dumps(now)} to {DECIDED}"
    )
    before = hash_code(HOG)
    monkeypatch.setattr(identity, "VERSION", identity.VERSION + 1)
    assert hash_code(HOG) != before


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An empty package named meadow."""
    (tmp_path / "meadow/inner").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path / "meadow"
    forget()


def forget():
    """Let the package be imported anew."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "meadow"]:
        del sys.modules[name]
    importlib.invalidate_caches()


def test_all_files_that_a_method_imports_in_any_way_or_inherits_from_count_and_no_other(package):
    files = {
        "__init__": "",
        "method": "import numpy\nfrom vprbench.api.neural import Resize\n"
        "from .near import thing\nfrom . import beside\nimport meadow.dotted\n"
        "class Method:\n    def fit(self):\n        from meadow.inner.late import x\n",
        "near": "from .behind_near import thing\nif not thing:\n    from .method import Method\n",  # a circle
        **{"behind_near": "thing = 1\n", "beside": "", "dotted": "", "unused": ""},
        **{"inner/__init__": "from .late import x\n", "inner/late": "x = 1\n"},
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    method = importlib.import_module("meadow.method").Method
    before = identity.hash_class(method)
    for name in files:
        path = package / f"{name}.py"
        path.write_text(f"{files[name]}# another byte\n")
        identity.hash_class.cache_clear()
        assert (identity.hash_class(method) == before) is (name in ("unused", "inner/__init__")), name
        path.write_text(files[name])


@pytest.mark.extended
def test_the_run_of_a_real_method_is_found_after_its_file_moved_and_not_after_another_number(
    package, monkeypatch, capsys
):
    file, write = package / "inner/moved.py", see_yamls(package, monkeypatch)
    text = (ROOT / "methods/sad.py").read_text().replace("from .parts", "from vprbench.methods.parts")
    given = (ROOT / "conf/method/sad.yaml").read_text()
    monkeypatch.chdir(package.parent)
    asked = ["method=grass", "dataset.places=10", "dataset.first_query_place=0", "frames=false", "output=json"]
    found = []
    for path, old, new in (
        (package / "sad.py", "", ""),
        (file, "", ""),
        (file, "similarity[query, row] = -0.0", "similarity[query, row] = -1.0"),
    ):
        assert old in text
        path.write_text(text.replace(old, new) if old else text)
        module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        write("grass", given.replace("vprbench.methods.sad", module))
        forget()
        assert main([*asked, *RUN, "timing=none"]) == 0
        found.append(json.loads(capsys.readouterr().out)["from_store"])
    assert found == [False, True, False]


def test_a_class_of_a_script_counts_with_its_file_and_a_class_without_a_file_is_another_one_each_time(
    tmp_path, monkeypatch
):
    script = ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", script)
    exec("class Mine:\n    pass\n", vars(script))
    assert hash_code(script.Mine) != hash_code(script.Mine)
    (tmp_path / "script.py").write_text("class Mine:\n    pass\n")
    script.__file__ = str(tmp_path / "script.py")
    assert identity.hash_class(script.Mine) == identity.hash_files([tmp_path / "script.py"])
