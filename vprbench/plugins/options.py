"""Options of a command, as name=value, become its settings: a dataclass that says which there are."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, get_type_hints

from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.storage.folders import insist_on_homes

Given = TypeVar("Given")


def chosen(kind: Callable[..., Given], options: Sequence[str], quick: Mapping[str, Any]) -> Given:
    """Return the settings that `option=value` ask for, after those of `quick` if quick=true is among them.

    Raises BadInput that names the option that is unknown or does not fit.
    """
    hints = get_type_hints(kind)
    given = {}
    for option in options:
        name, equals, text = option.partition("=")
        if name not in hints:
            raise BadInput(f"option {name} is unknown: {registry.near(name, hints)}")
        if not equals:
            raise BadInput(f"option {name} has no value: give {name}=value")
        try:
            value = json.loads(text)
        except ValueError:
            value = _listed(text) if re.fullmatch(r"\[.+\]", text) else text
        given[name] = registry.checked(name, value, hints[name])
    insist_on_homes(given)
    return kind(**{**(quick if given.get("quick") else {}), **given})


def _listed(text: str) -> list[str]:
    """Return the texts of a list without quotes, as in [hog,pca] or [/data/one,/data/two]."""
    return [part.strip() for part in text[1:-1].split(",")]
