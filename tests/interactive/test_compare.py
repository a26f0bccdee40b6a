"""`vprbench.compare`: names and objects on one dataset, ranked; nothing runs before all are built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import Lookup, Prototypes, journey

import vprbench
from vprbench.api import BadInput, NotThere


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def answering(right: int, n: int = 30) -> Lookup:
    """Return a method that answers the first `right` of `n` queries right."""
    table = np.eye(n, dtype=np.float32)
    table[right:] = np.roll(table[right:], 1, axis=1)
    return Lookup(table)


def test_methods_are_ranked_with_their_metrics_and_a_sentence() -> None:
    given = vprbench.compare(
        [answering(3), Prototypes(noise=0.0), answering(24)], journey(30, 30), metrics=["r100p"], timing="none"
    )
    table = given.table
    assert table["recall_at_1"].tolist() == [1.0, 0.8, 0.1]
    assert (table["low"] <= table["recall_at_1"]).all()
    assert table["r100p"].tolist()[0] == 1.0
    assert table["hz"].isna().all()
    assert "Prototypes" in given.sentence
    assert given.to_markdown().count("\n") == 4
    assert "\\toprule" in given.to_latex()
    assert "80.0" in given._repr_html_()
    assert "not timed" in given.to_latex()
    assert len(given.plot_pr().axes) == 1
    assert repr(given).count("\n") == 0


def test_each_seed_runs_where_there_is_one() -> None:
    given = vprbench.compare([Prototypes(noise=4.0), answering(10)], journey(30, 30), seeds=3, timing="none")
    assert [result.run.config["seed"] for result in given.results] == [0, 1, 2, 0]
    assert given.table.set_index("method")["seeds"].to_dict()["Prototypes noise=4.0"] == 3
    recalls = [result.recall() for result in given.results[:3]]
    assert len(set(recalls)) > 1
    row = given.table[given.table["seeds"] == 3]
    assert row["recall_at_1"].item() == pytest.approx(np.mean(recalls))


@pytest.mark.parametrize(
    ("methods", "more", "error"),
    [
        ([Prototypes(), "netvlad"], {}, NotThere),
        ([Prototypes(), "nobody"], {}, BadInput),
        ([Prototypes(), Prototypes()], {}, BadInput),
        ([], {}, BadInput),
        ("sad", {}, BadInput),
        ([Prototypes()], {"metrics": ["r200p"]}, BadInput),
        ([Prototypes()], {"seeds": 0}, BadInput),
        ([Prototypes()], {"seed": 3}, BadInput),
    ],
)
def test_what_does_not_fit_is_told_before_anything_runs(
    tmp_path: Path, methods: Any, more: Any, error: type[Exception]
) -> None:
    with pytest.raises(error):
        vprbench.compare(methods, journey(4, 4), timing="none", **more)
    assert list(tmp_path.rglob("run.json")) == []
