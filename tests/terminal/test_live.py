"""The live view tells what runs where, what waits and what has failed."""

from __future__ import annotations

import io

from rich.console import Console

from vprbench.terminal.live import LiveTable


def shown(table: LiveTable) -> str:
    stream = io.StringIO()
    Console(file=stream, width=120).print(table.__rich__())
    return stream.getvalue()


def test_steps_that_run_elsewhere_are_shown_with_host_and_stage_and_the_rest_is_counted() -> None:
    table = LiveTable(["SAD"], ["Route"], 6)
    table.begin(0, "SAD on Route, seed 0", "node1")
    table.begin(1, "SAD on Route, seed 1", "node2")
    table.begin(2, "SAD on Route, seed 2", "node3")
    table.share(1, "query 40 %", 0.0)
    table.step(0)
    table.step(2, failed=True)
    text = shown(table)
    assert "node2  SAD on Route, seed 1  query 40 %" in text
    assert "node1" not in text
    assert "2 of 6, 1 running, 3 waiting, 1 failed, 0:0" in text


def test_a_step_that_runs_here_needs_no_line_of_its_own() -> None:
    table = LiveTable(["SAD"], ["Route"], 2)
    table.begin(0, "SAD on Route")
    assert "SAD on Route" not in shown(table)
    assert "0 of 2" in shown(table)
