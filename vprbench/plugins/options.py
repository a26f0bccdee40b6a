"""Options of a command: fields of a dataclass with a meaning, and their values from name=value."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, field
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from vprbench.errors import BadInput
from vprbench.storage.folders import require_homes
from vprbench.text import near

Given = TypeVar("Given")

MEANING = "meaning"  # the key of a field's metadata that holds the words of the help


def option(default: Any = MISSING, meaning: str = "") -> Any:
    """Return a field of a dataclass with its default and the words by which the help explains it.

    Without words the help has those of the option of that name in conf/run.yaml.
    """
    metadata = {MEANING: meaning}
    if isinstance(default, list | dict):
        return field(default_factory=lambda: default.copy(), metadata=metadata)
    return field(default=default, metadata=metadata)


def parse_options(kind: Callable[..., Given], options: Sequence[str], quick: Mapping[str, Any]) -> Given:
    """Return the settings that `option=value` ask for, after those of `quick` if quick=true is among them.

    Raises BadInput that names the option that is unknown or does not fit.
    """
    hints = get_type_hints(kind)
    given: dict[str, Any] = {}
    for option in options:
        from vprbench.plugins.values import check_value  # takes long, and there may be no option

        name, equals, text = option.partition("=")
        above, _, inner = name.partition(".")
        named = get_origin(hints.get(above)) is dict  # a configuration by its name, and options of it
        if (above if named else name) not in hints:
            raise BadInput(f"option {name} is unknown: {near(name, hints)}")
        if not equals:
            raise BadInput(f"option {name} has no value: give {name}=value")
        if named:
            given.setdefault(above, {})[inner or "name"] = _value(text, Any)
        else:
            given[name] = check_value(name, _value(text, hints[name]), hints[name])
    require_homes(given)
    return kind(**{**(quick if given.get("quick") else {}), **given})


def _value(text: str, hint: Any) -> Any:
    """Return what a text stands for; for a list its parts between commas, with or without brackets and quotes."""
    kinds = [kind for kind in (hint, *get_args(hint)) if get_origin(kind) is list]
    try:
        value = json.loads(text)
    except ValueError:
        if not kinds or (text[:1] == "[") != (text[-1:] == "]"):
            return text
        parts = [part.strip() for part in text.removeprefix("[").removesuffix("]").split(",")]
        return parts if get_args(kinds[0]) == (str,) else [_value(part, None) for part in parts]
    return [value] if kinds and not isinstance(value, list | None) else value
