"""`vprbench.run`: names and objects run in this process, are found again, and what does not fit is an error."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little import Lookup, Prototypes, journey

import vprbench
from vprbench.api import BadInput, Method, NotThere
from vprbench.cli import main

SMALL: dict[str, Any] = {"places": 12, "first_query_place": 0}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


class Plain(Method):
    """No dataclass; keeps its argument under another name if asked to."""

    def __init__(self, weight: float = 1.0, hidden: bool = False) -> None:
        setattr(self, "secret" if hidden else "weight", weight)
        self.hidden = hidden

    def fit(self, references: Any, places: Any) -> Any:
        self.n_places = int(places.max()) + 1
        return self

    def encode(self, images: Any) -> Any:
        return np.stack([image.ravel() for image in images])

    def match(self, codes: Any) -> Any:
        return np.zeros((len(codes), self.n_places), np.float32)


def untimed(method: Any, data: Any, **options: Any) -> Any:
    return vprbench.run(method, data, timing="none", **options)


def test_a_named_run_is_the_one_that_the_command_line_stores(capsys: pytest.CaptureFixture[str]) -> None:
    result = untimed("sad", vprbench.dataset("synthetic", **SMALL))
    assert (result.from_store, result.folder is not None and result.folder.is_dir()) == (False, True)
    options = [f"dataset.{name}={value}" for name, value in SMALL.items()]
    assert main(["method=sad", *options, "timing=none", "output=json"]) == 0
    printed = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert printed["from_store"]
    assert printed["recall_at_1"] == result.recall(1)


def test_an_object_runs_as_it_is_is_not_fitted_and_is_found_by_its_arguments() -> None:
    data, method = journey(6, 6), Prototypes(noise=0.0)
    first, again = untimed(method, data), untimed(method, data)
    assert (first.recall(1), first.from_store, again.from_store) == (1.0, False, True)
    assert method._means is None
    assert first.run.method == "Prototypes"
    assert first.run.config["changed"] == {"noise": 0.0}
    assert not untimed(Prototypes(noise=0.25), data).from_store
    assert untimed(Prototypes(0.0), data).from_store


def test_seed_and_device_are_those_of_the_object_unless_asked_for() -> None:
    data = journey(4, 4)
    seeds = [untimed(Prototypes(seed=5), data, **more).run.config["seed"] for more in ({}, {"seed": 2})]
    assert seeds == [5, 2]
    assert untimed(Prototypes, data, seed=3).run.config["method"]["seed"] == 3


def test_a_class_without_dataclass_is_known_by_its_attributes_or_not_stored(caplog: pytest.LogCaptureFixture) -> None:
    data = journey(4, 4)
    stored = untimed(Plain(weight=2.0), data)
    assert stored.run.config["method"]["weight"] == 2.0
    with caplog.at_level(logging.WARNING):
        hidden = untimed(Plain(weight=2.0, hidden=True), data)
    assert hidden.folder is None
    assert any("weight" in record.getMessage() for record in caplog.records)
    assert hidden.recall(1) == stored.recall(1) == 0.25


def test_without_a_folder_nothing_is_stored_or_looked_up(tmp_path: Path) -> None:
    asked: list[list[int]] = []
    method = Lookup(np.eye(4, dtype=np.float32), asked)
    for _ in range(2):
        result = untimed(method, journey(4, 4), results=None)
        assert (result.folder, result.from_store) == (None, False)
    assert len(asked) >= 2
    assert list(tmp_path.iterdir()) == []
    assert result.run.scores is not None
    assert result.run.scores.shape == (4, 4)


def test_results_is_a_row_for_each_stored_run() -> None:
    data = journey(6, 6)
    with pytest.raises(BadInput, match="there"):
        vprbench.results("there")
    Path("there").mkdir()
    empty = vprbench.results("there")
    for noise in (0.0, 0.25):
        untimed(Prototypes(noise), data, results="there", seed=1)
    table = vprbench.results("there").sort_values("arguments")
    assert table[["method", "dataset", "seed"]].drop_duplicates().to_numpy().tolist() == [["Prototypes", "journey", 1]]
    assert table["arguments"].tolist() == ["noise=0.0", "noise=0.25"]
    assert table["recall_at_1"].iloc[0] == 1.0
    assert table["hz"].isna().all()
    assert (len(empty), [*empty]) == (0, [*table])


def test_results_tell_data_of_one_name_apart() -> None:
    given = [SMALL, {**SMALL, "places": 14}, {**SMALL, "tolerance": 1}]
    for data in [*(vprbench.dataset("synthetic", **options) for options in given), journey(4, 6)]:
        untimed("sad", data)
    table = vprbench.results().set_index("dataset")
    assert table.loc["journey", ["places", "queries", "dataset_arguments"]].tolist() == [6, 4, ""]
    assert "queries=dusk" in table.loc["journey", "protocol"]
    of_name = table.loc["synthetic"].set_index("dataset_arguments")
    first = "places=12 first_query_place=0"
    assert of_name["places"].to_dict() == {
        first: 12,
        "places=14 first_query_place=0": 14,
        f"{first} tolerance=1": 12,
    }
    assert of_name["fingerprint"].nunique() == of_name["protocol"].nunique() == 3


@pytest.mark.parametrize(
    ("method", "dataset", "options", "error", "named"),
    [
        ("sadd", "synthetic", {}, BadInput, "sad"),
        ("sad", "synthetik", {}, BadInput, "synthetic"),
        (3, "synthetic", {}, BadInput, "int"),
        ("sad", 3, {}, BadInput, "int"),
        *(
            ("sad", "synthetic", {option: value}, BadInput, named)
            for option, value, named in (
                *(("sed", 1, "seed"), ("seed", -1, "seed"), ("threads", 10_000, "threads"), ("timing", "quik", "quik")),
                ("limit_minutes", 1, "limit_minutes is the command line's"),
                ("timing", {"minimum_second": 1}, "minimum_second"),
            )
        ),
        ("sad", "folders", {}, NotThere, "references"),
        (Prototypes(), "synthetic", {"device": "gpu"}, BadInput, "gpu"),
    ],
)
def test_what_does_not_fit_is_an_error_that_names_it(
    method: Any, dataset: Any, options: Any, error: type[Exception], named: str
) -> None:
    with pytest.raises(error, match=named):
        vprbench.run(method, dataset, **options)


def test_options_of_methods_and_datasets_are_checked_and_build_what_they_say() -> None:
    with pytest.raises(BadInput, match="patch"):
        vprbench.method("sad", patsh=3)
    with pytest.raises(BadInput, match=r"dataset\.places"):
        vprbench.dataset("synthetic", places="ten").build()
    assert repr(vprbench.dataset("synthetic", **SMALL)) == "dataset('synthetic', places=12, first_query_place=0)"
    many = vprbench.dataset("synthetic", references=["spring"] * 99, name="line\nbreak")
    assert (len(repr(many)), repr(many).count("\n")) == (100, 0)
    data = vprbench.dataset("synthetic", references=("spring",), name="it's [a, b]=\\c", **SMALL)
    with pytest.raises(BadInput, match="name"):
        data.build()
    assert vprbench.dataset("synthetic", references=("spring",), **SMALL).build().n_places == 12
    assert vprbench.method("vprtempo", max_module=np.int64(50)).build(seed=4).max_module == 50  # type: ignore[attr-defined]
