"""`make table`: what is missing is run once, what cannot run says so, and the stored runs alone give the same table."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from small_plan import RUN, Apart, install

from vprbench.cli import main
from vprbench.metrics.accuracy import recall_at
from vprbench.run.record import Run
from vprbench.run.store import Store

Cells = dict[tuple[str, str, str], dict[str, str]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Apart, int]]:
    """A folder in which the table was made once, what was run for it, and the exit code."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        code = main(["table", *RUN])
    yield folder, apart, code
    shutil.rmtree(folder)


@pytest.fixture
def copied(made: tuple[Path, Apart, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Apart:
    """A copy of that folder to work in."""
    shutil.copytree(made[0] / "results", tmp_path / "results")
    return install(monkeypatch, tmp_path)


def cells(path: Path) -> Cells:
    with path.open(encoding="utf-8", newline="") as file:
        return {(line["row"], line["column"], line["quantity"]): line for line in csv.DictReader(file)}


def runs(folder: Path, method: str) -> list[Run]:
    return [run for run in Store(folder, read_only=True).runs() if run.method == method]


def test_a_row_without_its_method_is_no_failure_of_the_table(made: tuple[Path, Apart, int]) -> None:
    folder, _, code = made
    assert code == 0
    cell = cells(folder / "results" / "table.csv")["Nobody", "route", "recall_at_1"]
    assert cell["mark"] == "not there"
    assert "no_such_method" in cell["notes"]


def test_the_measured_recall_is_that_of_the_stored_run(made: tuple[Path, Apart, int]) -> None:
    folder, _, _ = made
    (run,) = (run for run in runs(folder / "results", "sad") if run.outcome.n_places == 20)
    recall = recall_at(run.outcome, 1)
    assert recall is not None
    cell = cells(folder / "results" / "table.csv")["SAD", "route", "recall_at_1"]
    assert float(cell["value"]) == pytest.approx(100 * recall.expected, rel=1e-12)
    assert float(cell["published"]) == 48


def test_a_slow_row_says_what_it_would_take_by_its_run_where_it_is_not_slow(made: tuple[Path, Apart, int]) -> None:
    folder, _, _ = made
    found = cells(folder / "results" / "table.csv")
    assert found["PCA", "route", "recall_at_1"]["mark"] == "left out"
    assert re.search(r"FULL=1 .* 1 min .* 12 places", found["PCA", "route", "recall_at_1"]["notes"])
    for row in ("SAD", "PCA", "VPRTempo"):
        assert found[row, "route_12", "recall_at_1"]["mark"] == "measured"


def test_each_run_is_made_once_with_the_arguments_of_its_row_and_size(made: tuple[Path, Apart, int]) -> None:
    _, apart, _ = made
    asked = [[option for option in options if option.startswith("method")] for options in apart.asked]
    small = ["method=vprtempo", "method.max_module=12", "method.height=12", "method.width=12", "method.epochs=1"]
    assert asked.count(["method=sad"]) == 2
    assert asked.count(["method=pca"]) == 1
    assert asked.count(small) == 2
    assert len(asked) == 2 + 1 + 4


def test_from_the_store_alone_the_table_is_the_same_to_the_byte(made: tuple[Path, Apart, int], copied: Apart) -> None:
    folder, _, _ = made
    for file in Path("results").glob("table*"):
        file.unlink()
    assert main(["table", "stored=true"]) == 0
    assert copied.asked == []
    names = ("table.md", "table.csv", "table.tex", "table-runs.csv")
    assert [Path("results", name).read_bytes() for name in names] == [
        (folder / "results" / name).read_bytes() for name in names
    ]


def test_a_row_outlives_the_yaml_and_the_code_of_its_method(copied: Apart, monkeypatch: pytest.MonkeyPatch) -> None:
    before = Path("results/table.md").read_text()
    monkeypatch.setattr("vprbench.plugins.registry.entries", lambda group: {})
    assert main(["table", "stored=true"]) == 0
    assert Path("results/table.md").read_text() == before


def test_rows_on_request_stand_below_the_papers(copied: Apart) -> None:
    assert main(["table", "rows=[SAD]", "methods=[sad,big_patches]", "columns=[route]", *RUN]) == 0
    found = cells(Path("results/route.csv"))
    assert [row for row, _, quantity in found if quantity == "recall_at_1"] == ["SAD", "SAD (big patches)"]
    assert found["SAD (big patches)", "route", "recall_at_1"]["mark"] == "measured"


def test_a_method_whose_code_and_yaml_are_gone_keeps_its_stored_row(copied: Apart) -> None:
    store = Store(Path("results"))
    for run in runs(Path("results"), "sad"):
        store.save(replace(run, method="gone", config={**run.config, "method": {}}))
    assert main(["table", "rows=[SAD]", "methods=[gone]", "stored=true"]) == 0
    found = cells(Path("results/table.csv"))
    assert found["gone", "route", "recall_at_1"]["value"] == found["SAD", "route", "recall_at_1"]["value"]


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("devices=[gpu]", "devices=gpu"),
        ("name=../out", "name=../out"),
        ("stores=[/nowhere,elsewhere]", "stores=/nowhere"),
        ("rows=[SAD", "rows=[SAD"),
        ("stored=true", "results=results"),
        ("rows=[Nobody]", "results=results holds no run of these rows"),
    ],
)
def test_an_option_that_cannot_be_is_one_line_and_leaves_the_old_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], option: str, words: str
) -> None:
    install(monkeypatch, tmp_path)
    Path("results").mkdir()
    Path("results/table.md").write_text("the old table")
    assert main(["table", option]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1 or option == "rows=[Nobody]"
    assert Path("results/table.md").read_text() == "the old table"


def test_full_runs_slow_rows_at_full_size(copied: Apart) -> None:
    assert main(["table", "rows=[PCA]", "full=true", *RUN]) == 0
    found = cells(Path("results/table.csv"))
    assert found["PCA", "route", "recall_at_1"]["mark"] == "measured"


def test_a_chosen_column_names_the_files(copied: Apart) -> None:
    before = Path("results/table.md").read_text()
    assert main(["table", "columns=[route_12,route_12]", "stored=true"]) == 0
    assert {column for _, column, _ in cells(Path("results/route_12-route_12.csv"))} == {"route_12"}
    assert Path("results/route_12-route_12.md").read_text().count("\n## ") == 1
    assert Path("results/table.md").read_text() == before


def test_stores_of_several_machines_merge(copied: Apart) -> None:
    text = Path("results/table.md").read_text()
    shutil.move("results", "else where")
    assert main(["table", "stored=true", f"stores=[{Path('else where').absolute()}]"]) == 0
    assert Path("results/table.md").read_text() == text
