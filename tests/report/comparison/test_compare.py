"""A comparison makes what is missing, ranks it and writes it, of the runs that were asked for and no others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from parsed_page import Parsed
from PIL import Image
from small_plan import install, lines, quick_figures

import vprbench
from vprbench.cli import main
from vprbench.metrics.accuracy import compute_recall
from vprbench.report.report import Report
from vprbench.runs.store import Store

ASKED = ["compare", "timing=none", "threads=1", "name=mine"]
METHODS = ["methods=sad,flyhash,cosplace", "seeds=2", "sad.patch=5"]
ROUTE = {"places": 20, "first_query_place": 4}
SPOILT = [*ASKED, "methods=sad", "dataset=synthetic", *(f"dataset.{name}={value}" for name, value in ROUTE.items())]
UNDER = "corruptions=[noise-1,shift-3]"


def dataset(folder):
    return ["dataset=folders", f"dataset.references=[{folder / 'ref'}]", f"dataset.queries={folder / 'query'}"]


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A folder with frames, of which half the queries are noise, and with a comparison and the run of another one."""
    folder = tmp_path_factory.mktemp("compared")
    random = np.random.default_rng(0)
    for name in ("ref", "query"):
        (folder / name).mkdir()
    for place in range(24):
        frame = random.integers(0, 256, (40, 60, 3), np.uint8)
        Image.fromarray(frame).save(folder / "ref" / f"{place}.png")
        other = frame // 2 if place % 2 else random.integers(0, 256, frame.shape, np.uint8)
        Image.fromarray(other).save(folder / "query" / f"{place}.png")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        quick_figures(monkeypatch)
        assert main(["method=sad", *dataset(folder), *ASKED[1:3]]) == 0
        assert main([*ASKED, *METHODS, *dataset(folder)]) == 0
    return folder, apart


@pytest.fixture
def apart(compared, monkeypatch):
    """Stand in the folder of the comparison, with nothing to be written; returns what stands in for processes."""
    monkeypatch.setattr(Report, "write", lambda *_: [])
    return install(monkeypatch, compared[0])


def test_the_files_hold_the_asked_runs_in_their_order_and_say_nothing_of_a_paper(compared, apart):
    asked = [(each.method_name, each.seed) for each in compared[1].asked]
    assert asked == [("sad", 0), ("flyhash", 0), ("flyhash", 1), ("cosplace", 0)]
    recalls = [line for line in lines("mine.csv") if line["quantity"] == "recall_at_1"]
    assert {line["row"] for line in recalls} == {"sad patch=5", "flyhash", "cosplace"}
    values = [float(line["value"]) for line in recalls[:2]]
    assert values == sorted(values, reverse=True)
    assert (recalls[2]["row"], recalls[2]["mark"], recalls[2]["value"]) == ("cosplace", "not there", "")
    assert "ResNet50_2048_cosplace.pth" in recalls[2]["notes"]
    assert {line["mark"] for line in lines("mine.csv") if line["quantity"] == "query_cpu"} == {"not timed", "not there"}
    assert sorted(line["method"] for line in lines("mine-runs.csv")) == ["flyhash", "flyhash", "sad patch=5"]
    texts = [Path("results", f"mine.{ending}").read_text(encoding="utf-8") for ending in ("md", "tex", "html")]
    assert not any(word in text for text in texts[:2] for word in ("Table II", "ICRA", "GPU", "documentclass"))
    assert ("<title>mine</title>" in texts[2], "<h1>mine</h1>" in texts[2]) == (True, True)
    assert not any(word in Parsed(texts[2]).text.lower() for word in ("paper", "table ii"))
    assert "precision-recall-mine" in Path("results/figures/mine/captions.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("more", [[], ["stored=true"]])
def test_what_is_stored_is_shown_without_a_process_however_its_folder_is_called(apart, capsys, more):
    assert main([*ASKED, *METHODS, *dataset(Path.cwd() if more else Path()), *more]) == 0
    assert not [each for each in apart.asked if each.method_name != "cosplace"]  # whose weights may be there by now
    shown = capsys.readouterr().out
    first, second, third = (shown.index(f"\n{name} ") for name in ("sad patch=5", "flyhash", "cosplace"))
    assert max(first, second) < third
    assert " level with " in shown


def test_the_best_ten_places_of_each_query_are_written_for_every_run_or_as_many_as_asked_for(apart, monkeypatch):
    best = lines("mine-predictions.csv")
    assert len(best) == 3 * 24 * 10
    assert {(line["method"], line["seed"]) for line in best} == {
        ("sad patch=5", "0"),
        ("flyhash", "0"),
        ("flyhash", "1"),
    }
    of_sad = [line for line in best if line["method"] == "sad patch=5" and line["rank"] == "1"]
    names = [(Path(line["query_image"]).name, Path(line["reference_image"]).name) for line in of_sad]
    assert names[1::2] == [(f"{place}.png", f"{place}.png") for place in range(1, 24, 2)]  # the others are noise
    assert {line["right"] for line in of_sad[1::2]} == {"True"}
    given = []

    def write(report, folder, name, n):
        given.append(None if n == 0 else report.predictions(n))
        return []

    monkeypatch.setattr(Report, "write", write)
    for number in ("0", "2"):
        assert main([*ASKED, *METHODS, *dataset(Path()), "stored=true", f"predictions={number}"]) == 0
    assert (given[0], len(given[1])) == (None, 3 * 24 * 2)
    assert main([*ASKED, *METHODS, *dataset(Path()), "predictions=1", "sequence=[1,3]"]) == 0
    assert given[2].groupby("answers").size().to_dict() == {"sequence 1 causal": 72, "sequence 3 causal": 66}


def test_each_value_of_a_methods_option_is_a_row(apart, capsys):
    assert main([*ASKED, "methods=[sad]", "sad.patch=5,9", *dataset(Path())]) == 0
    assert [request.method["patch"] for request in apart.asked] == [9]
    shown = capsys.readouterr().out
    assert all(f"\nsad patch={patch} " in shown for patch in (5, 9))


def test_all_that_is_wrong_is_told_at_once_and_nothing_runs(apart, capsys):
    wrong = ["methods=sda,pca,vprtempo,hog", "pca.components=many", "vprtempo.encoding=morse", "hog.epochs=3"]
    stored = len(list(Store(Path("results")).runs()))
    assert main([*ASKED, *wrong, *dataset(Path())]) == 2
    told = [line.split(": ")[1] for line in capsys.readouterr().err.splitlines() if line.startswith("vprbench: ")]
    assert told == ["sda", "pca", "vprtempo", "hog"]
    assert (apart.asked, len(list(Store(Path("results")).runs()))) == ([], stored)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("dataset=folders", "methods="),
        ("methods=sad", "dataset="),
        ("methods=sad dataset=floders", "floders"),
        *(
            (f"methods=sad dataset=folders {option}", option.partition("=")[0].removeprefix("dataset."))
            for option in ("method=pca", "seeds=0", "metrics=r1p", "dataset.tolerence=1", "sad.seed=1", "sequnce=3")
        ),
        ("methods=sad,hog dataset=folders randconv.patch=5", "sad.patch, hog.patch"),
        ("methods=sad dataset=synthetic corruptions=[shfit]", "shift"),
        ("methods=sad dataset=synthetic corruption=shift-1", "corruptions=NAME"),
    ],
)
def test_an_option_of_no_comparison_is_named(apart, capsys, options, word):
    assert main(["compare", *options.split()]) == 2
    assert word in capsys.readouterr().err
    assert apart.asked == []


def test_sequences_are_ranked_from_the_same_stored_runs_side_by_side(apart, capsys):
    assert main([*ASKED, *METHODS, *dataset(Path()), "sequence=[1,3]", "stored=true"]) == 0
    shown = capsys.readouterr().out
    head, *rows = shown[shown.index("R@1 %") :].splitlines()
    assert 0 < head.index("sequence 1 causal") < head.index("sequence 3 causal")
    sad = next(row for row in rows if row.startswith("sad patch=5")).removeprefix("sad patch=5")
    single, three = (float(part.split()[0]) for part in sad.split("]")[:2])
    assert (round(single), three) == (50, 100)  # half the queries are noise
    assert "22 queries" in shown


def test_a_sequence_says_of_runs_without_scores_what_to_do(apart, capsys, tmp_path, monkeypatch):
    other = Store(tmp_path)
    other.prepare()
    for run in Store(Path("results")).runs():
        other.save(replace(run, scores=None if run.method == "sad" else run.scores))
    monkeypatch.setattr("vprbench.report.comparison.make_missing_runs", lambda *_: [])
    asked = [*dataset(Path()), "sequence=3", f"results={tmp_path}"]
    assert main([*ASKED, *METHODS, *asked]) == 0
    shown = capsys.readouterr().out
    assert "sad on folders kept no scores to make sequences of: run it with scores=true" in shown
    assert "\nflyhash " in shown
    assert main([*ASKED, "methods=sad", "sad.patch=5", *asked]) == 2
    assert "scores=true" in capsys.readouterr().err


def test_files_of_another_ground_truth_stay_and_those_of_other_methods_make_room_with_a_warning(
    tmp_path, monkeypatch, caplog
):
    quick_figures(monkeypatch)
    install(monkeypatch, tmp_path)
    for methods, tolerance in (("sad", 0), ("sad", 1), ("pca", 0)):
        asked = [f"methods={methods}", "dataset=synthetic", "dataset.places=12", f"dataset.tolerance={tolerance}"]
        assert main(["compare", *asked, "timing=none", "threads=1"]) == 0
    first, second = sorted(Path("results").glob("synthetic*-runs.csv"), key=lambda path: len(path.name), reverse=True)
    assert [lines(path.name)[0]["method"] for path in (first, second)] == ["sad", "pca"]
    assert [record.args for record in caplog.records if record.levelname == "WARNING"] == [("synthetic", "sad")]


def test_a_column_that_was_asked_for_stays_where_the_terminal_is_narrow(apart, capsys):
    assert main([*ASKED, "methods=sad", "sad.patch=5", "metrics=energy", *dataset(Path()), "stored=true"]) == 0
    head = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("method"))
    assert ("Map B/place" in head, "peak MB" in head) == (True, False)


# Under corruptions: runs of their own, which stand beside clean ones and never among them.


@pytest.fixture(scope="module")
def spoilt(tmp_path_factory):
    """A folder with a comparison on clean frames and under corruptions, and what was run for it."""
    folder = tmp_path_factory.mktemp("compared")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        quick_figures(monkeypatch)
        assert main([*SPOILT, UNDER]) == 0
    return folder, apart


def spoilt_runs():
    """Return the stored runs and their R@1 by their corruption."""
    runs = {run.config["corruption"]: run for run in Store(Path("results")).runs()}
    return runs, {name: compute_recall(run.outcome, 1).expected for name, run in runs.items()}


@pytest.mark.extended
def test_untimed_runs_of_each_corruption_stand_beside_clean_frames_in_the_files(spoilt, monkeypatch):
    install(monkeypatch, spoilt[0])
    asked = spoilt[1].asked
    assert [each.corruption for each in asked] == [None, ["shift-3", "noise-1"]]  # fitted once
    assert not asked[1].timing.rates
    found, recalls = spoilt_runs()
    assert found.keys() == {None, "noise-1", "shift-3"}
    assert len({run.key for run in found.values()}) == len({run.fingerprint for run in found.values()}) == 3
    told = {f"{line['kind']}-{line['strength']}": line for line in lines("mine-robustness.csv")}
    assert {name: (float(line["recall_at_1"]), float(line["drop"])) for name, line in told.items()} == {
        str(name or "clean-0"): pytest.approx((recall, recalls[None] - recall)) for name, recall in recalls.items()
    }
    assert "| shift 8 px" in Path("results/mine-robustness.md").read_text(encoding="utf-8")
    assert Path("results/figures/mine/robustness-mine.pdf").is_file()
    assert "robustness-mine" in Path("results/mine.html").read_text(encoding="utf-8")


@pytest.mark.extended
def test_what_is_stored_is_found_by_all_commands_and_clean_frames_are_compared_and_tabled_alone(
    spoilt, monkeypatch, capsys
):
    shown, apart = [], install(monkeypatch, spoilt[0])
    monkeypatch.setattr(Report, "write", lambda one, *_: shown.append(one) or [])
    for more in [], ["stored=true"]:
        assert main([*SPOILT, UNDER, *more]) == 0
        assert "noise ±5" in capsys.readouterr().out
    assert main(SPOILT) == 0
    found, recalls = spoilt_runs()
    assert [run.key for group in shown[-1].groups for run in group.runs] == [found[None].key]
    assert main(["table", "rows=[SAD]", "columns=[route]", "name=table", "timing=none", "threads=1"]) == 0
    (cell,) = (line for line in lines("table.csv") if line["quantity"] == "recall_at_1")
    assert float(cell["value"]) == pytest.approx(100 * recalls[None])
    assert len(lines("table-runs.csv")) == 1
    for options, word in (["table", "corruption=shift-1"], "clean"), (["corruption=shift-9"], "1 to 3"):
        assert main(options) == 2
        assert word in capsys.readouterr().err
    assert apart.asked == []
    data = vprbench.dataset("synthetic", **ROUTE)
    for name in (None, "shift-3"):
        result = vprbench.run("sad", data, timing="none", threads=1, corruption=name)
        assert (result.from_store, result.run.key) == (True, found[name].key)
        assert ("corruption" in result.run.protocol) == (name is not None)
