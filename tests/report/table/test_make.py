"""`make table`, figures and page: what is missing is run once, what cannot run says so, stored runs give the same."""

import re
import shutil
from pathlib import Path

import pytest
from small_plan import PLAN, RUN, install, lines, quick_figures

from vprbench.cli import main
from vprbench.metrics.accuracy import compute_recall
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
    recall = compute_recall(run.outcome, 1)
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


def test_a_chosen_column_names_the_files_stores_of_several_machines_merge_and_full_runs_slow_rows(copied):
    before = Path("results/table.md").read_text()
    assert main(["table", STORED, "columns=[route_12,route_12]", "stored=true"]) == 0
    assert {column for _, column in cells("route_12-route_12.csv")} == {"route_12"}
    assert Path("results/route_12-route_12.md").read_text().count("\n## ") == 1
    assert Path("results/table.md").read_text() == before
    shutil.move("results", "else where")
    assert main(["table", STORED, "seeds=1", "stored=true", f"stores=[{Path('else where').absolute()}]"]) == 0
    assert Path("results/table.md").read_text() == before
    assert main(["table", "rows=[PCA]", "columns=[route]", "full=true", *RUN]) == 0
    assert cells("route.csv")["PCA", "route"]["mark"] == "measured"


ONE = ["rows=[SAD,VPRTempo]", "seeds=1", "columns=[route_12]"]
OF_A_COLUMN = "frames fig3b-similarity precision-recall recall-at-n tolerance rate memory spikes"
NAMES = {"fig2a-training-time", "fig2b-query-rate", "fig2c-growth", *(f"{n}-route_12" for n in OF_A_COLUMN.split())}


def grown(folder, monkeypatch, quick=True):
    """Let the small plan hold in a folder, of only two sizes of the growth, and files of figures be quickly written."""
    if quick:
        quick_figures(monkeypatch)
    return install(monkeypatch, folder, PLAN.replace("[10, 12, 14, 16]", "[10, 14]"))


@pytest.fixture(scope="module")
def drawn(made, tmp_path_factory):
    """A folder in which the figures were drawn once from stored runs, and what was run for them."""
    folder = tmp_path_factory.mktemp("drawn")
    shutil.copytree(made[0] / "results", folder / "results")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = grown(folder, monkeypatch)
        assert main(["table", "figures=true", *ONE, *RUN]) == 0
    yield folder, apart
    shutil.rmtree(folder)


@pytest.mark.extended
def test_every_figure_is_there_with_its_caption_and_what_was_missing_was_run_with_few_queries_for_the_growth(drawn):
    figures = drawn[0] / "results" / "figures"
    files = {path.name for path in figures.iterdir()}
    assert files == {f"{name}{ending}" for name in NAMES for ending in (".pdf", ".png")} | {"captions.md"}
    captions = (figures / "captions.md").read_text().splitlines()
    assert {line.split("**")[1].rstrip(".") for line in captions if line.startswith("**")} == NAMES
    tempo, *growth = drawn[1].asked
    assert (tempo.method_name, tempo.changed) == ("vprtempo", {"height": 12, "width": 12, "epochs": 1})
    assert [(each.dataset["places"], each.dataset["query_places"]) for each in growth] == [(10, 6), (14, 6)]
    assert [tempo.frames, *(each.frames for each in growth)] == [True, False, False]


@pytest.mark.extended
def test_from_the_store_alone_figures_and_page_are_the_same_to_the_byte(drawn, tmp_path, monkeypatch):
    shutil.copytree(drawn[0] / "results", tmp_path / "results")
    apart = grown(tmp_path, monkeypatch, quick=False)
    files = []
    for more in (RUN, ["stored=true"]):
        shutil.rmtree("results/figures")
        assert main(["table", "figures=true", "page=true", *ONE, *more]) == 0
        written = [*Path("results/figures").iterdir(), Path("results/report-route_12.html")]
        files.append({path.name: path.read_bytes() for path in written})
    assert apart.asked == []
    assert files[0] == files[1]
    assert len(files[0]) == 2 * len(NAMES) + 2
    page = Path("results/report-route_12.html").read_text()
    assert {*re.findall(r'id="large-([^"]+)"', page)} == NAMES
    assert ("Made from 2 stored runs, the newest of " in page, ">SAD</th>" in page) == (True, True)


@pytest.mark.extended
def test_a_results_folder_is_shown_as_it_is_and_nothing_is_run(drawn, tmp_path, monkeypatch, capsys):
    shutil.copytree(drawn[0] / "results", tmp_path / "results")
    elsewhere = grown(tmp_path, monkeypatch)
    assert main(["report"]) == 0
    assert main(["report", "dataset=synthetic", "methods=sad", "name=one"]) == 0
    assert main(["figures"]) == 0
    assert elsewhere.asked == []
    whole, one = Path("results/report.html").read_text(), Path("results/one.html").read_text()
    assert [">vprtempo " in page for page in (whole, one)] == [True, False]
    drawn = {path.name for path in Path("results/figures").glob("precision-recall*")}
    assert drawn >= {"precision-recall-synthetic.png", "precision-recall-synthetic-2.pdf"}
    capsys.readouterr()
    for option in ("methods=lost", "dataset=lost", "results=lost"):  # a filter that no run passes
        assert main(["report", option]) == 2
        error = capsys.readouterr().err
        assert ("lost" in error, error.count("\n")) == (True, 1)
