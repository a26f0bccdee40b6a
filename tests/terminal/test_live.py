"""The live view tells what runs where, what waits and what has failed."""

import io

from rich.console import Console

from vprbench.terminal.live import LiveTable


def test_steps_that_run_elsewhere_are_shown_with_host_and_stage_and_the_rest_is_counted():
    table = LiveTable(["SAD"], ["Route"], 6)
    for seed in range(3):
        table.begin(seed, f"SAD on Route, seed {seed}", f"node{seed + 1}")
    table.share(1, "query 40 %", 0.0)
    table.step(0)
    table.step(2, failed=True)
    table.begin(3, "here")
    stream = io.StringIO()
    Console(file=stream, width=120).print(table.__rich__())
    text = stream.getvalue()
    assert "here" not in text  # a step that runs here needs no line of its own
    assert "node2  SAD on Route, seed 1  query 40 %" in text
    assert "node1" not in text
    assert "2 of 6, 2 running, 2 waiting, 1 failed, 0:0" in text
