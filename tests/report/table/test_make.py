"""`make table`: what is missing is run once, what cannot run says so, and the stored runs alone give the same table."""

import shutil
from pathlib import Path

import pytest
from small_plan import RUN, install, lines

from vprbench.cli import main
from vprbench.metrics.accuracy import recall_at
from vprbench.plugins import registry
from vprbench.runs.store import Store

STORED = "rows=[SAD,PCA,Nobody]"


def cells(name):
    """Return the cells of R@1 in a CSV by row and column."""
    return {(line["row"], line["column"]): line for line in lines(name) if line["quantity"] == "recall_at_1"}


def test_each_run_is_made_once_and_the_files_hold_the_stored_numbers_and_why_there_are_none(made, monkeypatch):
    folder, apart, code = made
    monkeypatch.chdir(folder)
    assert code == 0  # a row without its method is no failure of the table
    assert sorted(request.method_name for request in apart.asked) == ["cosplace", "cosplace", "pca", "sad", "sad"]
    found = cells("table.csv")
    (run,) = (run for run in Store(Path("results")).runs() if (run.method, run.outcome.n_places) == ("sad", 20))
    recall = recall_at(run.outcome, 1)
    sad, nobody, slow = (found[row, "route"] for row in ("SAD", "Nobody", "PCA"))
    assert (float(sad["value"]), sad["published"]) == (pytest.approx(100 * recall.expected, rel=1e-12), "48.0")
    assert (nobody["mark"], "cosplace.pth" in nobody["notes"]) == ("not there", True)
    assert slow["mark"] == "left out"
    assert {found[row, "route_12"]["mark"] for row in ("SAD", "PCA")} == {"measured"}


def test_from_the_store_alone_and_without_the_methods_yaml_the_table_is_the_same_to_the_byte(copied, monkeypatch):
    before = {path.name: path.read_bytes() for path in Path("results").glob("table*")}
    assert {*before} == {"table.md", "table.csv", "table.tex", "table-runs.csv"}
    for name in before:
        Path("results", name).unlink()
    known = registry.find_entries
    monkeypatch.setattr(registry, "find_entries", lambda group: {} if group == "method" else known(group))
    assert main(["table", STORED, "seeds=1", "stored=true"]) == 0
    assert copied.asked == []
    assert {path.name: path.read_bytes() for path in Path("results").glob("table*")} == before


@pytest.mark.extended
def test_rows_on_request_stand_below_the_papers_and_full_runs_slow_rows_at_full_size(copied):
    assert main(["table", "rows=[SAD]", "methods=[sad,big_patches]", "columns=[route_12]", *RUN]) == 0
    found = cells("route_12.csv")
    assert [row for row, _ in found] == ["SAD", "SAD (big patches)"]
    assert found["SAD (big patches)", "route_12"]["mark"] == "measured"
    assert main(["table", "rows=[PCA]", "columns=[route]", "full=true", *RUN]) == 0
    assert cells("route.csv")["PCA", "route"]["mark"] == "measured"


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("devices=[gpu]", "devices=gpu"),
        ("name=../out", "name=../out"),
        ("seeds=0", "seeds=0"),
        ("stores=[/nowhere,elsewhere]", "stores=/nowhere"),
        ("rows=[SAD", "rows=[SAD"),
        ("stored=true", "results=results"),
        ("rows=[Nobody]", "results=results holds no run of these rows"),
    ],
)
def test_an_option_that_cannot_be_is_one_line_and_leaves_the_old_table(tmp_path, monkeypatch, capsys, option, words):
    install(monkeypatch, tmp_path)
    Path("results").mkdir()
    Path("results/table.md").write_text("the old table")
    assert main(["table", option]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1 or option == "rows=[Nobody]"
    assert Path("results/table.md").read_text() == "the old table"


def test_a_chosen_column_names_the_files_and_stores_of_several_machines_merge(copied):
    before = Path("results/table.md").read_text()
    assert main(["table", STORED, "columns=[route_12,route_12]", "stored=true"]) == 0
    assert {column for _, column in cells("route_12-route_12.csv")} == {"route_12"}
    assert Path("results/route_12-route_12.md").read_text().count("\n## ") == 1
    assert Path("results/table.md").read_text() == before
    shutil.move("results", "else where")
    assert main(["table", STORED, "seeds=1", "stored=true", f"stores=[{Path('else where').absolute()}]"]) == 0
    assert Path("results/table.md").read_text() == before
