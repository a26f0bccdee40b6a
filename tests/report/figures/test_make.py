"""Figures and page: of Table II once its missing runs are made, and of all that a results folder holds."""

import re
import shutil
from pathlib import Path

import pytest
from small_plan import PLAN, RUN, install, quick_figures

from vprbench.cli import main

pytestmark = pytest.mark.extended

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
