"""`make figures` and `make report`: all is drawn once what is missing was run, and again from the store alone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from small_plan import RUN, Apart, install

from vprbench.cli import main
from vprbench.paper.figures.make import listed

SMALL = ["rows=[SAD,VPRTempo]", "seeds=1"]
OF_A_COLUMN = (
    "fig3a-frames",
    "fig3b-similarity",
    "fig3c-precision-recall",
    "fig3d-recall-at-n",
    "tolerance",
    "rate",
    "memory",
    "spikes",
)
NAMES = {
    "fig2a-training-time",
    "fig2b-query-rate",
    "fig2c-growth",
    *(f"{name}-{column}" for name in OF_A_COLUMN for column in ("route", "route_12")),
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Apart]]:
    """A folder in which the figures were drawn once, and what was run for them."""
    folder = tmp_path_factory.mktemp("drawn")
    with pytest.MonkeyPatch.context() as monkeypatch:
        apart = install(monkeypatch, folder)
        assert main(["figures", *SMALL, *RUN]) == 0
    yield folder, apart
    shutil.rmtree(folder)


@pytest.fixture
def copied(drawn: tuple[Path, Apart], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Apart:
    shutil.copytree(drawn[0] / "results", tmp_path / "results")
    return install(monkeypatch, tmp_path)


def test_every_figure_is_there_as_pdf_and_png(drawn: tuple[Path, Apart]) -> None:
    files = {path.name for path in (drawn[0] / "results" / "figures").iterdir()}
    assert files == {f"{name}{ending}" for name in NAMES for ending in (".pdf", ".png")} | {"captions.md"}


def test_every_figure_has_a_caption(drawn: tuple[Path, Apart]) -> None:
    text = (drawn[0] / "results" / "figures" / "captions.md").read_text()
    assert {line.split("**")[1].rstrip(".") for line in text.splitlines() if line.startswith("**")} == NAMES


def test_a_name_in_a_caption_is_no_markup() -> None:
    text = listed([("rate-<b>", "R@1 of <script>alert(1)</script> & [here](javascript:go) with *stars*.")])
    assert text == (
        "# Captions\n\n**rate-&lt;b&gt;.** R@1 of &lt;script&gt;alert(1)&lt;/script&gt; &amp; "
        "\\[here\\](javascript:go) with \\*stars\\*.\n"
    )


def test_the_growth_runs_once_at_each_size_with_few_queries(drawn: tuple[Path, Apart]) -> None:
    sizes = [
        [option for option in options if option.startswith("dataset.")]
        for options in drawn[1].asked
        if any(option.startswith("dataset.query_places") for option in options)
    ]
    assert sizes == [[f"dataset.places={n}", "dataset.query_places=6"] for n in (10, 12, 14, 16)]


def test_from_the_store_alone_the_figures_are_the_same_to_the_byte(drawn: tuple[Path, Apart], copied: Apart) -> None:
    shutil.rmtree("results/figures")
    assert main(["figures", *SMALL, "stored=true"]) == 0
    assert copied.asked == []
    for path in (drawn[0] / "results" / "figures").iterdir():
        assert Path("results/figures", path.name).read_bytes() == path.read_bytes(), path.name


def test_the_page_holds_table_figures_and_queries_and_is_the_same_from_the_store_alone(copied: Apart) -> None:
    assert main(["report", *SMALL, *RUN]) == 0
    page = Path("results/report.html").read_bytes()
    text = page.decode()
    assert text.count("data:image/png;base64,") >= len(NAMES)
    assert "fig2c-growth" in text
    assert "synthetic" in text
    assert main(["report", *SMALL, "stored=true"]) == 0
    assert Path("results/report.html").read_bytes() == page


def test_without_kept_frames_the_other_figures_are_drawn(copied: Apart, caplog: pytest.LogCaptureFixture) -> None:
    shutil.rmtree("results/frames")
    shutil.rmtree("results/figures")
    assert main(["figures", *SMALL, "stored=true"]) == 0
    there = {path.stem for path in Path("results/figures").glob("*.png")}
    assert there == NAMES - {"fig3a-frames-route", "fig3a-frames-route_12"}


def test_a_report_of_columns_without_runs_is_one_line(copied: Apart, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", *SMALL, "columns=[nordland]", "stored=true"]) == 2
    assert "holds no run of these rows and columns" in capsys.readouterr().err
    assert not list(Path("results").glob("report*.html"))


def test_a_report_says_which_figures_are_absent(copied: Apart) -> None:
    for folder in Path("results/synthetic").glob("sad-*"):
        if '"query_places": 6' in (folder / "run.json").read_text():
            shutil.rmtree(folder)
    assert main(["report", *SMALL, "stored=true"]) == 0
    assert "fig2c-growth is not drawn" in Path("results/report.html").read_text()
