"""The live table shows which cells wait, which run and since when, and which are done."""

import io

from rich.console import Console

from vprbench.terminal.live import LiveTable


def test_runs_are_shown_with_their_time_and_cells_with_their_results_and_the_rest_is_counted():
    table = LiveTable(["SAD", "HOG"], ["Route"], 6)
    for seed in range(3):
        table.begin(seed, f"SAD on Route, seed {seed}")
    table.show("SAD", "Route", "12.5 %")
    table.end(0)
    table.end(2, failed=True)
    stream = io.StringIO()
    Console(file=stream, width=120).print(table.__rich__())
    text = stream.getvalue()
    assert "0 s  SAD on Route, seed 1" in text
    assert "seed 0" not in text
    assert [line.split() for line in text.splitlines()[1:3]] == [
        ["SAD", "12.5", "%"],
        ["HOG", "\N{MIDDLE DOT}"],
    ]
    assert "2 of 6, 1 running, 3 waiting, 1 failed" in text
