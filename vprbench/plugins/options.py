"""Options: fields of a dataclass with a meaning, and their values, checked against type hints."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, field, is_dataclass
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from vprbench.errors import BadInput
from vprbench.plugins.entries import read
from vprbench.storage.folders import require_homes
from vprbench.text import suggest_names

Options = TypeVar("Options")

MEANING = "meaning"  # the key of a field's metadata that holds the words of the help


def option(default: Any = MISSING, meaning: str = "") -> Any:
    """Return a field of a dataclass with its default and the words by which the help explains it.

    Without words the help has those of the option of that name in conf/run.yaml.
    """
    metadata = {MEANING: meaning}
    if isinstance(default, list | dict):
        return field(default_factory=lambda: default.copy(), metadata=metadata)
    return field(default=default, metadata=metadata)


def check_value(option: str, value: Any, hint: Any) -> Any:
    """Return `value` if it is of the type `hint`; one value is a list of one where a list is wanted.

    Raises BadInput that names the option, its value and the wanted type.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError  # slow to import

    given = [value] if _is_list(hint) and isinstance(value, str | int | float) else value
    try:
        config = None if is_dataclass(hint) else ConfigDict(arbitrary_types_allowed=True)
        # in JSON a list may become a tuple, and a text a path
        return TypeAdapter(hint, config=config).validate_json(json.dumps(given), strict=True)
    except ValidationError as error:
        wanted = dict.fromkeys(str(problem["msg"]).replace("Input should be", "wanted") for problem in error.errors())
        raise BadInput(f"{option}={value}: {'; '.join(wanted)}") from error


def check_values(prefix: str, given: Mapping[str, Any], hints: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by name, each of the type of its hint; raises BadInput for an unknown name too.

    Messages name an option by `prefix` and its name.
    """
    for name in given:
        if name not in hints:
            raise BadInput(f"option {prefix}{name} is unknown: {suggest_names(name, hints)}")
    return {name: check_value(f"{prefix}{name}", value, hints[name]) for name, value in given.items()}


def parse_options(kind: Callable[..., Options], options: Sequence[str]) -> Options:
    """Return the settings that `option=value` ask for; raises BadInput that names an option which does not fit."""
    hints = get_type_hints(kind)
    given: dict[str, Any] = {}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals:
            raise BadInput(f"option {name} has no value: give {name}=value")
        above, _, inner = name.partition(".")
        if get_origin(hints.get(above)) is dict:  # a configuration by its name, and options of it
            given.setdefault(above, {})[inner or "name"] = _parse_text(text, Any)
        else:
            given[name] = _parse_text(text, hints.get(name))
    values = check_values("", given, hints)
    require_homes(values)
    return kind(**values)


def build_options(option: str, kind: type[Options], given: Mapping[str, Any]) -> Options:
    """Return the dataclass `kind` of some values by name.

    Raises BadInput that names the option, for an unknown name, a value of another type, and one that `kind` refuses.
    """
    values = check_values(f"{option}.", given, get_type_hints(kind))
    try:
        return kind(**values)
    except ValueError as error:
        raise BadInput(f"{option}: {error}") from error


def _is_list(hint: Any) -> bool:
    """Tell whether a type hint wants a list, or None."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return {get_origin(kind) for kind in kinds if kind is not NoneType} == {list}


def _parse_text(text: str, hint: Any) -> Any:
    """Return the value of a text: JSON, the parts of a list between commas, or what bare words in brackets say.

    {length:4,window:centred} is a mapping, for an option of any type.
    """
    with suppress(ValueError):
        return json.loads(text)
    ends = text[:1] + text[-1:]
    if hint is Any and ends in ("{}", "[]"):
        with suppress(yaml.YAMLError):
            return read(text.replace(":", ": ") if ends == "{}" else text)
    if not _is_list(hint) or text.startswith("[") != text.endswith("]"):
        return text
    parts = [part.strip() for part in text.removeprefix("[").removesuffix("]").split(",")]
    return parts if list[str] in (hint, *get_args(hint)) else [_parse_text(part, None) for part in parts]
