"""Values of options have to be of the types that hints name; nothing is converted."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import pytest

from vprbench.errors import BadInput
from vprbench.plugins.checked import checked


@pytest.mark.parametrize(("value", "hint"), [("4", int), (1, bool), (4.5, int), ("x", Literal["y"]), (3, list[str])])
def test_a_value_of_another_type_is_refused_with_its_option(value: Any, hint: Any) -> None:
    with pytest.raises(BadInput, match=rf"^method\.cells={value}: "):
        checked("method.cells", value, hint)


@pytest.mark.parametrize(
    ("value", "hint", "wanted"), [(4, float, 4.0), ([1, 2], tuple[int, ...], (1, 2)), ("a/b", Path, Path("a/b"))]
)
def test_what_json_cannot_say_otherwise_is_taken(value: Any, hint: Any, wanted: Any) -> None:
    assert checked("x", value, hint) == wanted
