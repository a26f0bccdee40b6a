"""The command line: what it prints and stores, and one clear line for bad input, failures and hostile plug-ins."""

import csv
import errno
import json
import re
import shutil
import sys
from pathlib import Path

import pytest
from image_folders import fill, numbered
from plugged_in import forget_loose_files, plugin, see_plugins
from quick_runs import quick_runs
from served_files import serving
from small_plan import RUN, Apart
from textures import textures

from vprbench.cli import main
from vprbench.data import fetch
from vprbench.errors import BadInput
from vprbench.jobs import executors
from vprbench.metrics.accuracy import compute_recall
from vprbench.plugins import entries, registry
from vprbench.runs.frame import tabulate_runs
from vprbench.runs.store import Store
from vprbench.storage import tensors

QUICK = ["dataset.places=12", "dataset.first_query_place=0", *RUN]
ENDINGS = (".md", ".csv", ".tex", "-runs.csv")
KEYS = {*(f"recall_at_{n}" for n in (1, 5, 10, 25)), "recall_at_1_low", "recall_at_1_high", "fit_seconds", "run_folder"}
KEYS |= {f"{mode}_{step}_hz" for mode in ("streaming", "offline") for step in ("encode", "match", "total")}
KEYS |= {"peak_memory_bytes", "from_store"}


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    quick_runs(monkeypatch)


def refused(arguments, capsys):
    """Run what must be refused; return the one line about it, after lines of progress."""
    code = main(arguments)
    captured = capsys.readouterr()
    assert (code, captured.out) == (2, ""), captured.err
    lines = captured.err.strip().splitlines()
    assert [line[:10] for line in lines if line.startswith("vprbench: ")] == [lines[-1][:10]]
    assert "Traceback" not in captured.err
    assert not [*Path().rglob("run.json"), *Path().rglob(".partial-*")]
    return lines[-1]


def test_a_run_prints_one_json_object_and_answers_from_the_store_unless_forced_where_nothing_can_be_written_too(
    capsys, monkeypatch
):
    make, rows = Path.mkdir, []

    def refuse(path, *arguments, **options):  # root, who may run tests, has every right
        if "results" in path.parts and not path.exists():
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        make(path, *arguments, **options)

    for options in ([], [], ["force=true"]):
        assert main(["method=sad", *QUICK, "output=json", "results=min m\u00e5ling", *options]) == 0
        rows.append(json.loads(capsys.readouterr().out))
    assert set(rows[0]) >= KEYS
    assert [row.pop("from_store") for row in rows] == [False, True, False]
    assert rows[0] == rows[1]
    assert Path(rows[0]["run_folder"]).parts[0] == "min m\u00e5ling"
    Path("min m\u00e5ling").rename("results")
    monkeypatch.setattr(Path, "mkdir", refuse)
    assert main(["method=sad", *QUICK, "output=json"]) == 0
    assert json.loads(capsys.readouterr().out)["from_store"] is True
    assert main(["method=sad", *QUICK, "seed=1"]) == 2
    assert "cannot be written (Read-only file system)" in capsys.readouterr().err


def test_a_row_names_its_numbers_and_its_folder_under_the_words_of_its_command(capsys):
    main(["method=sad", "method.patch=7", *QUICK])
    printed = capsys.readouterr()
    assert re.search(r"\d+\.\d \[\d+\.\d, \d+\.\d\]", printed.out)
    for column in ("R@1 % [95 %]", "streaming Hz enc", "offline Hz enc", "peak MB", "sad patch=7"):
        assert column in printed.out
    assert "stored in results/synthetic/sad-" in printed.out
    assert "sad on synthetic: fit" in printed.err


@pytest.mark.parametrize("command", [["check"], []], ids=["check", "run"])
def test_a_download_shows_its_progress(command, capsys, monkeypatch):
    monkeypatch.setenv("VPRBENCH_OFFLINE", "0")
    monkeypatch.setenv("VPRBENCH_WEIGHTS", "weights")
    with serving() as server:
        url = server.serve("/file", b"x" * 1000)
        main([*command, "method=salad", f"method.weights.url={url}", *QUICK])
    assert Path("weights/dino_salad.ckpt").read_bytes() == b"x" * 1000
    assert ": downloading dino_salad.ckpt" in capsys.readouterr().err


def test_list_shows_methods_and_datasets_with_their_descriptions_and_check_counts_the_rules(capsys):
    assert main(["list"]) == 0
    printed = capsys.readouterr().out
    for entry in (*registry.find_entries("method").values(), *registry.find_entries("dataset").values()):
        assert entry.description
        assert re.search(rf"^{entry.name} +{re.escape(entry.description)}$", printed, re.MULTILINE)
    assert main(["check", "method=sad"]) == 0
    assert "13 rules: 12 kept, 1 excepted, 0 broken" in capsys.readouterr().out
    assert main(["check", "method=gabor_binary"]) == 0
    assert "14 rules: " in capsys.readouterr().out  # and what it was tuned on


PLACES = "dataset.places=12 dataset.first_query_place=0"


@pytest.mark.parametrize(
    "command",
    [
        *("method=vprtempoo", "dataset=nordlnd", "timing=quik", "timing=null", "timing=3", "method=[sad,hog]"),
        *("method.patch=seven", "method.preprocessing=D", "force=perhaps", "output=xml", "device=tpu", "threads=9999"),
        *("method=vprtempo device=cuda:99", "method.tuned_on=3", "+method.tuned_on=3", "method._target_=x.Y"),
        *("seed=-1", "depth=0", "limit_minutes=0", "timing.sample=0", "timing.minimum_second=5", "dataset.places=5"),
        *("method=vprtempo method.max_modul=5", "+timing.foo=3", "+seeds=3", "+method=hog", "~seed", "~seeds"),
        *("method", "method=sad force", "check method=sad seed", "--cfg job -m", "--resolve", "method=sad workers=2"),
        *("-m", "search --cfg", "table -m", "gpu-chek", "list no_such_thing", "search trails=3", "table rows=[SAAD]"),
        *("table method=sad", "table nordland=/nowhere", "table seeds=0", "table stored=true", "check", "doctor"),
        *("search dataset=nordland_64x32", "doctor dataset=nowhere", "doctor dataset=synthetic seed=3"),
        *("fetch nowhere", "fetch synthetic", "fetch nordland colour=red", "check method=sad threads=x"),
        *("method=sad seed=1,2", "-m method=sad,sadd", "dataset=nordland dataset.root=/nowhere", "completion ksh"),
        *("dataset=nordland dataset.root=~nobody_here", "results=~nobody_here/r", "load=~nobody_here/n.safetensors"),
        *("dataset=folders dataset.references=['~nobody_here']", "method=cosplace method.weights.path=~nobody_here/w"),
        *("dataset.references={spring:1}", "-m method=vprtempo,sad method.rules=paper", f"{PLACES} method.patch=6"),
        *(f"{PLACES} dataset.name=../out", f"{PLACES} load=network.bin", f"{PLACES} load=a.safetensors"),
        *(f"{PLACES} save=a.pth", f"{PLACES} results={'a' * 300}", f"{PLACES} method=vprtempo method.max_module=0"),
    ],
)
def test_a_bad_option_is_named_in_one_clear_line(command, capsys):
    last = command.split()[-1].lstrip("+~").partition("=")[0]
    assert last in refused(command.split(), capsys)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["method=vprtempoo"], "method=vprtempoo is unknown: did you mean vprtempo or"),
        (["method=vprtempo", "method.max_modul=5"], "method.max_modul is unknown to vprtempo: did you mean max_module"),
        (["save=a.safetensors", "load=b.safetensors"], "save=a.safetensors and load=b.safetensors"),
        (["method=sad,hog"], "add -m to your command line"),
        (["dataset=nordland"], "dataset.root is not set: nordland needs the folder that holds the seasons"),
        (["dataset=nordland_64x32", "dataset.root=/nowhere"], "TimQuelch/seqslam"),
        (["dataset=nordland", "dataset.root=/d\u00e5ta/a=b (1)"], "dataset.root=/d\u00e5ta/a=b (1) is no folder"),
        (["method=s\nvprbench: done\x1b[2J"], r"method=s\nvprbench: done\x1b[2J is unknown: there are"),
        (["dataset=folders", "dataset.references=[~/north,~/süd]", "dataset.queries=b"], "~/north is no folder"),
        (["dataset=folders", 'dataset.references=["a, b"]', 'dataset.queries="b, c"'], "a, b is no folder"),
    ],
    ids=lambda value: " ".join(value[:3]) if isinstance(value, list) else "",
)
def test_a_bad_option_is_answered_with_its_value_and_the_remedy(arguments, wanted, capsys):
    assert wanted in refused(arguments, capsys)


def test_the_error_of_a_full_disk_is_shown_and_a_failure_is_recorded_without_the_name_of_a_home(capsys, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    def fail(*_):
        raise RuntimeError(f"{Path.home() / 'photos'} is strange")

    monkeypatch.setattr(tensors, "save_file", full)
    assert main(["method=sad", *QUICK, "output=json"]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["run_folder"] is None
    assert "No space left on device" in captured.err
    assert not list(Path("results").rglob("*.json"))
    monkeypatch.setattr("vprbench.methods.sad.SAD.match", fail)
    assert main(["method=sad", *QUICK]) == 1
    assert "vprbench: sad failed: RuntimeError: ~/photos is strange" in capsys.readouterr().err
    (failure,) = Path("results").rglob("failure.json")
    assert json.loads(failure.read_text())["error"] == "RuntimeError: ~/photos is strange"


@pytest.mark.parametrize(
    "command", [["method=sad"], ["compare", "methods=sad"], ["doctor"]], ids=lambda words: words[0]
)
def test_a_path_that_holds_a_comma_is_answered_with_the_quotes_that_it_needs_and_read_with_these(command, capsys):
    asked = textures(Path("drive 1, rain, 7 pm"), 4)
    for value, wanted in ((f"[more,{asked}]", f'["{asked}"]'), (str(asked), f'"{asked}"')):
        line = refused([*command, "dataset=folders", f"dataset.references={value}", "dataset.queries=more"], capsys)
        assert f"'dataset.references={wanted}'" in line
    quoted = ["dataset=folders", f'dataset.references=["{asked}"]', f'dataset.queries="{asked}x"']
    assert f"{asked}x is no folder" in refused(["method=sad", *quoted], capsys)


def test_a_sweep_ends_with_one_table_of_the_mean_over_the_seeds_and_its_csv(capsys, monkeypatch):
    monkeypatch.setattr(executors, "run_in_child", Apart())
    assert main(["-m", "method=sad", "method.patch=5,9", *QUICK, "timing=none"]) == 0
    assert Path("results/sweep.md").is_file()
    assert main(["-m", "method=sad,random_projection", "seed=0,1", *QUICK, "timing=none"]) == 0
    assert capsys.readouterr().out.splitlines()[-4:] == [f"  {Path('results/sweep').absolute()}{e}" for e in ENDINGS]
    with Path("results/sweep.csv").open(encoding="utf-8", newline="") as file:
        lines = [line for line in csv.DictReader(file) if line["quantity"] == "recall_at_1"]
    assert {line["row"]: line["seeds"] for line in lines} == {"sad": "0", "random_projection": "0 1"}
    runs = {
        run.key: compute_recall(run.outcome, 1).expected for run in Store(Path("results")).runs() if run.method != "sad"
    }
    (value,) = (float(line["value"]) for line in lines if line["row"] == "random_projection")
    assert (len(runs), value) == (2, pytest.approx(50 * sum(runs.values())))


MISSING, WRONG = True, False


@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        (["dataset=nordland"], MISSING),
        (["dataset=nordland", "dataset.root=/nowhere"], MISSING),
        (["dataset=folders"], MISSING),
        (["dataset=folders", "dataset.references=[/nowhere]", "dataset.queries=/nowhere"], MISSING),
        (["method=cosplace", *QUICK], MISSING),  # weights that may not be fetched
        (["method=gcl", *QUICK], MISSING),  # weights that no program can fetch
        (["method.patch=0", *QUICK], WRONG),
        ([*QUICK, "dataset.places=0"], WRONG),
        (["method=sda", *QUICK], None),
    ],
)
def test_a_failure_in_a_sweep_says_whether_something_was_missing_and_which_arguments_were_changed(
    arguments, missing, monkeypatch, capsys
):
    monkeypatch.setattr(executors, "run_in_child", Apart())
    assert main(["-m", "seed=0", *arguments, "output=json"]) == 2
    if missing is None:  # there is no such method, and nothing is stored
        assert not Path("results").exists()
        return
    (failure,) = Store(Path("results")).failures()
    told = json.loads(capsys.readouterr().out)
    assert (failure.missing, told["missing"], told["method"]) == (missing, missing, failure.method)
    assert {"processor", "threads", "libraries", "time_utc", "memory_bytes"} <= set(failure.environment)
    assert ("patch" in failure.config["changed"]) == ("method.patch=0" in arguments)


def test_the_doctor_exits_with_0_for_sound_frames_and_names_a_damaged_one_at_which_a_run_stops_too(capsys):
    for name, noise in (("monday", 0), ("friday", 20)):
        textures(Path(name), 24, noise)
    drives = ["dataset=folders", "dataset.references=[monday]", "dataset.queries=friday"]
    assert main(["doctor", *drives]) == 0
    told = capsys.readouterr().out
    assert told.startswith("folders: monday, friday\n")
    assert told.rstrip().splitlines()[-1].startswith("nothing is wrong: 0 errors, 0 warnings")
    frame = Path("friday/7.png")
    frame.write_bytes(frame.read_bytes()[:-40])
    assert main(["doctor", *drives, "output=json"]) == 1
    found = [each for each in json.loads(capsys.readouterr().out) if each["level"] == "error"]
    assert [(each["check"], "7.png" in each["text"]) for each in found] == [("decoding", True)]
    frame.write_bytes(b"")
    assert main(["method=sad", *drives]) == 2
    assert "7.png" in capsys.readouterr().err
    assert main(["doctor", "dataset=nordland"]) == 1
    assert "python -m vprbench fetch nordland" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("empty", "code"), [(False, 0), (True, 1)])
def test_fetch_exits_with_1_where_frames_that_came_are_not_right(empty, code, tmp_path, monkeypatch, capsys):
    for folder in ("query", "ref"):
        fill(tmp_path / folder, numbered(3))
    (tmp_path / "ground_truth.csv").write_text("query,matching_refs\n0,0\n1,1\n2,2\n")
    if empty:
        (tmp_path / "ref" / "1.jpg").write_bytes(b"")

    def fetched(arguments, check):
        print("\n".join(check("corridor", tmp_path)))
        return 0

    monkeypatch.setattr(fetch, "fetch_command", fetched)
    assert main(["fetch", "corridor"]) == code
    assert ("1 file" in capsys.readouterr().out) == empty


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """Plug the hostile methods in, for other processes too; returns where."""
    names = ("leaving", "silent", "colourful", "rootless", "moving")
    methods = {name: f"_target_: hostile.{name.capitalize()}" for name in names}
    plugin(tmp_path / "plugins", "hostile", "hostile", methods)
    forget_loose_files(monkeypatch)
    see_plugins(tmp_path / "plugins", monkeypatch)
    yield tmp_path / "plugins"
    sys.modules.pop("needy", None)


NEEDY = """import numpy as np
from vprbench.api import DescriptorMethod
class Needy(DescriptorMethod):
    def __init__(self):
        self.weights = np.load("weights.npy")
    def encode(self, images): return self.weights
"""


def test_a_file_that_a_method_lacks_is_one_line_with_the_traceback_in_the_record_and_with_debug(plugged, capsys):
    Path("needy.py").write_text(NEEDY)
    asked = ["method=./needy.py:Needy", *QUICK]
    assert main(asked) == 1
    printed = capsys.readouterr().err.splitlines()
    (line,) = (line for line in printed if line.startswith("vprbench: "))
    assert [part for part in ("weights.npy", "(needy.py, line 5)", "debug=true") if part not in line] == []
    (failure,) = Store(Path("results")).failures()
    assert [*tabulate_runs([failure])["error"]] == [failure.error]
    last = failure.traceback.splitlines()[-1]
    assert ("FileNotFoundError" in last, last.strip() in "\n".join(printed[:-1])) == (True, False)
    assert main([*asked, "debug=true"]) == 1
    assert last in capsys.readouterr().err


@pytest.mark.parametrize(
    ("method", "code"),
    [("leaving", 1), ("silent", 2), ("colourful", 1), ("rootless", 1), ("moving save=net.safetensors", 0)],
)
def test_any_error_of_a_method_ends_in_one_line_that_no_terminal_obeys_and_a_changed_folder_moves_nothing(
    method, code, capsys, plugged
):
    assert main([*f"method={method}".split(), *QUICK]) == code
    printed = capsys.readouterr().err
    lines = [line for line in printed.splitlines() if line.startswith("vprbench")]
    assert [line[:10] for line in lines if len(line) > len("vprbench: ")] == ["vprbench: "] * (code > 0)
    assert "\x1b" not in printed
    store = Store(plugged.parent / "results")
    assert (len(list(store.failures())), len(list(store.runs()))) == (code == 1, code == 0)
    written = {path.name for path in plugged.parent.iterdir()} - {"plugins", "results"}
    assert written == ({"net.safetensors"} if code == 0 else set())


def test_a_name_of_several_plug_ins_is_one_error_that_names_them_and_a_package_without_its_folder_is_named(
    plugged, capsys
):
    others = ("north", "pole"), ("south", "pole"), ("shadow", "sad"), ("leaver", "gone")
    for package, method in others:
        plugin(plugged, package, package, {method: "_target_: leaving_at_import.Method"})
    plugin(plugged, "empty", "empty", {})
    shutil.rmtree(plugged / "empty_conf")
    (plugged / "leaving_at_import.py").write_text("raise SystemExit\n")
    assert [package for package, _ in entries.list_broken_plugins()] == ["empty_conf"]
    with pytest.raises(BadInput, match="SystemExit"):
        registry.find_entries("method")["gone"].target()
    for asked_for, owners in (("pole", "north south"), ("'pole'", "north south"), ("sad", "vprbench shadow")):
        assert main([f"method={asked_for}", *QUICK]) == 2
        printed = capsys.readouterr().err
        assert [owner for owner in owners.split() if owner not in printed] == []
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if "BROKEN" in line} >= {"pole", "sad", "plug-in"}
    assert main(["method=hog", *QUICK]) == 0
