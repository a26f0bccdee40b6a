"""What a dataset plug-in has to return is said in one line where it does not."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from little import journey

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.plugins import registry


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """What the plug-in of the test returns, under `dataset`."""
    made = SimpleNamespace(dataset=None)

    def plug_in() -> Any:
        return made.dataset

    monkeypatch.setattr(registry, "_locate", lambda target: plug_in)
    return made


def refusal(config: dict[str, Any]) -> str:
    with pytest.raises(BadInput) as error:
        registry.make_dataset(config)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_dataset_is_returned_as_it_is(made: SimpleNamespace) -> None:
    made.dataset = journey(4, 3)
    dataset: Dataset = registry.make_dataset({"_target_": "mine.noise"})
    assert dataset is made.dataset


WHOLE = journey(4, 3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (5, "mine.noise gave int; it has to return a Dataset"),
        (replace(WHOLE, references=list(WHOLE.references)), "mine.noise gave references of type list; wanted is"),
        (replace(WHOLE, queries=list(WHOLE.queries)), "mine.noise gave queries of type list; wanted is"),
        (replace(WHOLE, name="é" * 130), "dataset.name=ééé"),
    ],
    ids=["a number", "listed references", "listed queries", "a long name"],
)
def test_what_is_no_dataset_is_refused(made: SimpleNamespace, given: Any, said: str) -> None:
    made.dataset = given
    assert refusal({"_target_": "mine.noise"}).startswith(said)
    assert refusal({"name": "noise"}).startswith("the yaml of dataset noise is no dataset (it has no _target_)")


def test_a_path_that_no_disk_takes_is_refused_by_name(tmp_path: Path) -> None:
    root = tmp_path / ("long" * 100)
    told = refusal({"_target_": "vprbench.datasets.vpr_bench.vpr_bench", "root": str(root)})
    assert str(tmp_path) in told
    assert os.strerror(errno.ENAMETOOLONG) in told
