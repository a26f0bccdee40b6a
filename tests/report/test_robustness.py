"""R@1 under corruptions beside clean frames: numbers, text and figure."""

import csv
import re
from io import StringIO

import numpy as np
import pytest
from figure_runs import run, series
from little import unanswerable_run

from vprbench.errors import BadInput
from vprbench.report import robustness as text
from vprbench.report.figures.accuracy import draw_robustness
from vprbench.report.robustness import measure_robustness
from vprbench.runs.corruption import Corruption
from vprbench.runs.frame import iterate_rows

WEAK, STRONG, BLUR = Corruption("shift", 1), Corruption("shift", 3), Corruption("blur", 2)


def row(name, *shares):
    """Return a row of 40 queries with a share of hits for each of its seeds."""
    return series(name, *(run(name, share, seed=seed) for seed, share in enumerate(shares)))


@pytest.fixture(scope="module")
def found():
    spoilt = {
        WEAK: [row("sad", 0.475), row("tempo", 0.7, 0.9)],
        STRONG: [row("sad", 0.1), row("tempo", 0.2, 0.3)],
        BLUR: [row("tempo", 0.8, 0.9), row("other", 0.3)],
    }
    return measure_robustness([row("sad", 0.5), row("tempo", 0.8, 0.9)], spoilt)


def test_a_drop_is_the_clean_mean_over_the_seeds_less_that_under_the_corruption(found):
    points = {(p.method, p.kind, p.strength): p for p in iterate_rows(found.points)}
    wanted = {
        ("sad", "clean", 0): (1, 0.5, 0),
        ("tempo", "clean", 0): (2, 0.85, 0),
        ("sad", "shift", 1): (1, 0.475, 0.025),
        ("tempo", "shift", 1): (2, 0.8, 0.05),
        ("sad", "shift", 3): (1, 0.1, 0.4),
        ("tempo", "shift", 3): (2, 0.25, 0.6),
        ("tempo", "blur", 2): (2, 0.85, 0),
    }
    assert {key: pytest.approx((p.seeds, p.recall_at_1, p.drop)) for key, p in points.items()} == wanted
    strong = points["sad", "shift", 3]
    assert strong.low < 0.1 < strong.high
    assert 0 < (strong.drop_low or 0) < 0.4 < (strong.drop_high or 0)
    with pytest.raises(BadInput, match="right place"):
        measure_robustness([series("little", unanswerable_run())], {})


def test_the_table_brackets_what_no_test_separates_from_clean_frames_and_dashes_what_was_not_run(found):
    assert [[*line.values()] for line in text.list_lines(found)] == [
        ["clean", "50.0", "85.0"],
        ["shift 1/8 px", "(2.5)/40.0", "(5.0)/60.0"],
        ["blur 2 %", "-", "(0.0)"],
    ]
    document = text.format_markdown(found, "a_route")
    assert re.search(r"^\| shift 1/8 px +\| \(2.5\)/40.0 +\| \(5.0\)/60.0 +\|$", document, re.MULTILINE)
    assert "- shift: queries moved left or right by 1, 8 px" in document
    rows = list(csv.DictReader(StringIO(found.points.to_csv(index=False))))
    assert [(line["method"], line["kind"], line["amount"]) for line in rows][2] == ("sad", "shift", "1 px")


def test_the_figure_has_a_panel_for_each_kind_begins_on_clean_frames_and_has_few_bands(found):
    figure = draw_robustness(found)
    panels = [axes for axes in figure.figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in panels] == ["Shift", "Blur"]
    curves = [{line.get_label(): np.round(line.get_xydata(), 6).tolist() for line in axes.lines} for axes in panels]
    assert curves == [
        {"sad": [[0, 50], [1, 47.5], [3, 10]], "tempo": [[0, 85], [1, 80], [3, 25]]},
        {"sad": [[0, 50]], "tempo": [[0, 85], [2, 85]]},
    ]
    assert [tick.get_text() for tick in panels[0].get_xticklabels()] == ["clean", "1 px", "8 px"]
    assert "Shift: queries moved left or right by 1, 8 px, borders repeated." in figure.caption
    many = measure_robustness([row(name, 0.5) for name in "abcde"], {WEAK: [row("a", 0.4)]})
    for each, n_bands in ((many, 0), (found, 2)):
        told = len(draw_robustness(each).figure.axes[0].collections), "interval" in draw_robustness(each).caption
        assert told == (n_bands, n_bands > 0)
