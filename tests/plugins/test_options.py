"""Options of a command, given as name=value, have to be of the types that hints name; nothing is converted."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from vprbench.errors import BadInput
from vprbench.plugins.checked import checked
from vprbench.plugins.options import chosen


@dataclass(frozen=True)
class Asked:
    names: list[str] = field(default_factory=list)
    sizes: list[int] | None = None
    frames: list[list[int]] = field(default_factory=list)
    name: str = ""


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("names=sad,hog", ["sad", "hog"]),
        ("names=[sad, hog]", ["sad", "hog"]),
        ('names=["sad"]', ["sad"]),
        ("names=sad", ["sad"]),
        ("names=[]", []),
        ("sizes=1,8,32", [1, 8, 32]),
        ("sizes=8", [8]),
        ("sizes=null", None),
        ("frames=[[2,3]]", [[2, 3]]),
        ("name=a,b", "a,b"),
    ],
)
def test_a_list_is_given_with_or_without_brackets(option: str, value: Any) -> None:
    assert getattr(chosen(Asked, [option], {}), option.split("=")[0]) == value


@pytest.mark.parametrize("option", ["sizes=1,two", "name", "nmae=x", "sizes=[[1]]"])
def test_what_does_not_fit_is_refused_by_its_name(option: str) -> None:
    with pytest.raises(BadInput, match=option.split("=")[0]):
        chosen(Asked, [option], {})


@pytest.mark.parametrize(("value", "hint"), [("4", int), (1, bool), (4.5, int), ("x", Literal["y"]), (3, list[str])])
def test_a_value_of_another_type_is_refused_with_its_option(value: Any, hint: Any) -> None:
    with pytest.raises(BadInput, match=rf"^method\.cells={value}: "):
        checked("method.cells", value, hint)


@pytest.mark.parametrize(
    ("value", "hint", "wanted"), [(4, float, 4.0), ([1, 2], tuple[int, ...], (1, 2)), ("a/b", Path, Path("a/b"))]
)
def test_what_json_cannot_say_otherwise_is_taken(value: Any, hint: Any, wanted: Any) -> None:
    assert checked("x", value, hint) == wanted
