"""What a dataset plug-in has to return is said in one line where it does not."""

from __future__ import annotations

import errno
from dataclasses import replace
from typing import Any

import pytest
from little import journey

from vprbench.errors import BadInput
from vprbench.plugins import registry

WHOLE = journey(4, 3)


def refusal(config: dict[str, Any]) -> str:
    with pytest.raises(BadInput) as error:
        registry.make_dataset(config)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (WHOLE, None),
        (5, "mine.noise gave int; it has to return a Dataset"),
        (replace(WHOLE, references=list(WHOLE.references)), "mine.noise gave references of type list; wanted is"),
        (replace(WHOLE, queries=list(WHOLE.queries)), "mine.noise gave queries of type list; wanted is"),
        (replace(WHOLE, name="é" * 100), None),  # 200 bytes
        (replace(WHOLE, name="é" * 100 + "e"), "dataset.name=ééé"),
    ],
    ids=["a dataset", "a number", "listed references", "listed queries", "a name", "a long name"],
)
def test_what_is_no_dataset_is_refused(given: Any, said: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_locate", lambda target: lambda: given)
    if said is None:
        assert registry.make_dataset({"_target_": "mine.noise"}) is given
    else:
        assert refusal({"_target_": "mine.noise"}).startswith(said)
    assert refusal({"name": "noise"}).startswith("the yaml of dataset noise is no dataset (it has no _target_)")


def test_an_error_of_the_disk_names_the_dataset_and_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    def noise(name: str) -> Any:
        raise OSError(errno.ENAMETOOLONG, "File name too long", "/frames/" + "x" * 300)

    monkeypatch.setattr(registry, "_locate", lambda target: noise)
    told = refusal({"_target_": "mine.noise", "name": "noise"})
    assert told.startswith(f"dataset noise cannot be read (/frames/{'x' * 142}...: File name too long)")
