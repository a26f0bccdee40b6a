"""`make figures` and `make report`: all is drawn once what is missing was run, and again from the store alone."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_plan import PLAN, RUN, Apart, install, quick_figures

from vprbench.cli import main
from vprbench.paper.figures.make import listed

SMALL = ["rows=[SAD,VPRTempo]", "seeds=1"]
ONE = [*SMALL, "columns=[route_12]", "stored=true"]
OF_A_COLUMN = (
    *("fig3a-frames", "fig3b-similarity", "fig3c-precision-recall", "fig3d-recall-at-n"),
    *("tolerance", "rate", "memory", "spikes"),
)
SPEED = {"fig2a-training-time", "fig2b-query-rate", "fig2c-growth"}
NAMES = {*SPEED, *(f"{name}-route_12" for name in OF_A_COLUMN)}


def grown(folder: Path, monkeypatch: pytest.MonkeyPatch, quick: bool = True) -> Apart:
    """Let the small plan hold in a folder, of only two sizes of the growth, and files of figures be quickly written."""
    if quick:
        quick_figures(monkeypatch)
    return install(monkeypatch, folder, PLAN.replace("[10, 12, 14, 16]", "[10, 14]"))


@pytest.fixture(scope="module")
def drawn(made: tuple[Path, Apart, int], tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Apart]]:
    """A folder in which the figures were drawn once from stored runs, and what was run for them."""
    folder = tmp_path_factory.mktemp("drawn")
    shutil.copytree(made[0] / "results", folder / "results")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = grown(folder, monkeypatch)
        assert main(["figures", *SMALL, "columns=[route_12]", *RUN]) == 0
    yield folder, apart
    shutil.rmtree(folder)


@pytest.fixture
def elsewhere(drawn: tuple[Path, Apart], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Apart:
    shutil.copytree(drawn[0] / "results", tmp_path / "results")
    return grown(tmp_path, monkeypatch)


def captioned() -> set[str]:
    text = Path("results/figures/captions.md").read_text()
    return {line.split("**")[1].rstrip(".") for line in text.splitlines() if line.startswith("**")}


def pictured(page: Path) -> set[str]:
    return set(re.findall(r'id="large-([^"]+)"', page.read_text()))


def test_every_figure_is_there_as_pdf_and_png_with_its_caption(drawn: tuple[Path, Apart], elsewhere: Apart) -> None:
    files = {path.name for path in (drawn[0] / "results" / "figures").iterdir()}
    assert files == {f"{name}{ending}" for name in NAMES for ending in (".pdf", ".png")} | {"captions.md"}
    assert captioned() == NAMES


def test_only_the_growth_is_run_once_at_each_size_with_few_queries(drawn: tuple[Path, Apart]) -> None:
    sizes = [[option for option in options if option.startswith("dataset.")] for options in drawn[1].asked]
    assert sizes == [[f"dataset.places={n}", "dataset.query_places=6"] for n in (10, 14)]
    assert all("frames=false" in options for options in drawn[1].asked)


def test_a_name_in_a_caption_is_no_markup() -> None:
    text = listed([("rate-<b>", "R@1 of <script>alert(1)</script> & [here](javascript:go) with *stars*.")])
    assert text == (
        "# Captions\n\n**rate-&lt;b&gt;.** R@1 of &lt;script&gt;alert(1)&lt;/script&gt; &amp; "
        "\\[here\\](javascript:go) with \\*stars\\*.\n"
    )


def test_the_page_holds_table_figures_and_queries(elsewhere: Apart) -> None:
    assert main(["report", *ONE]) == 0
    assert elsewhere.asked == []
    (page,) = Path("results").glob("report*.html")
    assert page.name == "report-route_12.html"
    assert pictured(page) == {*SPEED, *(f"{name}-route_12" for name in OF_A_COLUMN)}
    assert page.read_text().count("data:image/png;base64,") >= len(pictured(page))
    assert "Made from 2 stored runs, the newest of " in page.read_text()
    assert ">SAD</th>" in page.read_text()


def test_what_cannot_be_drawn_is_absent_alone_and_told_in_the_page(elsewhere: Apart) -> None:
    shutil.rmtree("results/frames")
    for folder in Path("results/synthetic").glob("sad-*"):
        if '"query_places": 6' in (folder / "run.json").read_text():
            shutil.rmtree(folder)
    assert main(["report", *ONE, "name=less"]) == 0
    page = Path("results/report-less.html")
    assert pictured(page) == {
        *(SPEED - {"fig2c-growth"}),
        *(f"{name}-route_12" for name in OF_A_COLUMN if name != "fig3a-frames"),
    }
    assert "fig2c-growth is not drawn" in page.read_text()


def test_a_report_of_columns_without_runs_is_one_line(elsewhere: Apart, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", *SMALL, "columns=[nordland]", "stored=true"]) == 2
    assert "holds no run of these rows and columns" in capsys.readouterr().err
    assert not list(Path("results").glob("report*.html"))


@pytest.mark.extended
def test_from_the_store_alone_figures_and_page_are_the_same_to_the_byte(
    drawn: tuple[Path, Apart], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(drawn[0] / "results", tmp_path / "results")
    apart = grown(tmp_path, monkeypatch, quick=False)
    files = []
    for more in (RUN, ["stored=true"]):
        shutil.rmtree("results/figures")
        for command in ("figures", "report"):
            assert main([command, *SMALL, "columns=[route_12]", *more]) == 0
        written = [*Path("results/figures").iterdir(), Path("results/report-route_12.html")]
        files.append({path.name: path.read_bytes() for path in written})
    assert apart.asked == []
    assert files[0] == files[1]
    assert len(files[0]) == 2 * (len(SPEED) + len(OF_A_COLUMN)) + 2
