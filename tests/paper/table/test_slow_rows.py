"""`make table` shows and writes what is quick before the slow rows run, and keeps what is done if these are stopped."""

from __future__ import annotations

import csv
import signal
from collections.abc import Sequence
from pathlib import Path

import pytest
from small_plan import RUN, Apart, install

from vprbench.cli import main
from vprbench.cluster import crew
from vprbench.run.processes import Ending

MARKS = list[dict[tuple[str, str], str]]


def marks() -> dict[tuple[str, str], str]:
    """Return the mark of each cell of R@1 in the files as they are now; nothing if there are none."""
    path = Path("results/table.csv")
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {(c["row"], c["column"]): c["mark"] for c in csv.DictReader(file) if c["quantity"] == "recall_at_1"}


@pytest.fixture
def seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MARKS:
    """What the files hold whenever a run of the slow row (PCA on 12 places) begins; the second run never ends."""
    apart, seen = install(monkeypatch, tmp_path), []

    def run(options: Sequence[str], **_: object) -> Ending:
        if "method=pca" not in options:
            return apart(options)
        seen.append(marks())
        if len(seen) == 2:
            raise KeyboardInterrupt
        return Apart()(options)

    monkeypatch.setattr(crew, "run_apart", run)
    return seen


ASKED = ("rows=[SAD,Nobody,PCA]", "name=table")
QUICK = {("SAD", "route_12"): "measured", ("Nobody", "route_12"): "not there"}


def test_quick_rows_are_shown_and_written_before_a_slow_one_and_again_after_it(
    seen: MARKS, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table", *ASKED, "columns=[route_12]", *RUN]) == 0
    printed = capsys.readouterr().out
    assert seen == [{**QUICK, ("PCA", "route_12"): "unfinished"}]
    assert printed.count("| SAD ") == 2
    assert marks() == {**QUICK, ("PCA", "route_12"): "measured"}
    assert main(["table", *ASKED, "columns=[route_12]", *RUN]) == 0
    assert capsys.readouterr().out.count("| SAD ") == 1


def test_an_interruption_of_the_slow_rows_leaves_the_files_of_what_is_done(seen: MARKS) -> None:
    assert main(["table", *ASKED, "columns=[route_12,route]", "full=true", *RUN]) == 128 + signal.SIGINT
    assert len(seen) == 2
    assert seen[1] == marks()
    assert marks()["PCA", "route_12"] == "measured"
    assert marks()["PCA", "route"] == "unfinished"
