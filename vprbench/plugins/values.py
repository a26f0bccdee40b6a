"""Values of options, checked against the type hints of whoever takes them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any, TypeVar, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from vprbench.errors import BadInput
from vprbench.plugins.entries import read
from vprbench.text import near

Options = TypeVar("Options")


def check_value(option: str, value: Any, hint: Any) -> Any:
    """Return `value` if it is of the type `hint`, or a list of it where a list is wanted.

    Raises BadInput that names option, value and what was wanted.
    """
    try:
        own = is_dataclass(hint)  # which brings its own rules
        adapter = TypeAdapter(hint, config=None if own else ConfigDict(arbitrary_types_allowed=True))
        return adapter.validate_json(json.dumps(value), strict=True)  # in JSON a list may become a tuple, a text a path
    except ValidationError as error:
        problems = error.errors()
        if isinstance(value, str | int | float) and all(p["type"] == "list_type" and not p["loc"] for p in problems):
            return check_value(option, [value], hint)
        wanted = "; ".join(dict.fromkeys(_wanted(problem) for problem in problems))
        raise BadInput(f"{option}={value}: {wanted}") from error


def parse_mapping(value: Any, short: str) -> dict[str, Any] | None:
    """Return the value of an option as a mapping, None for null; a plain value is that of the name `short`.

    A text in the words of the command line, {length:4,window:centred}, will do for a mapping.
    """
    if isinstance(value, str):
        value = read(value.replace(":", ": "))
    if value is None or isinstance(value, Mapping):
        return None if value is None else dict(value)
    return {short: value}


def build_options(option: str, kind: type[Options], given: Mapping[str, Any]) -> Options:
    """Return the dataclass `kind` of some values by name.

    Raises BadInput that names the option, for an unknown name, a value of another type, and one that `kind` refuses.
    """
    hints = get_type_hints(kind)
    for name in given:
        if name not in hints:
            raise BadInput(f"option {option}.{name} is unknown: {near(name, hints)}")
    values = {name: check_value(f"{option}.{name}", value, hints[name]) for name, value in given.items()}
    try:
        return kind(**values)
    except ValueError as error:
        raise BadInput(f"{option}: {error}") from error


def _wanted(problem: Mapping[str, Any]) -> str:
    text = str(problem["msg"]).replace("Input should be", "wanted")
    if problem["type"] in ("list_type", "sequence_str", "tuple_type"):
        return "wanted a list, as in [first,second]"
    if problem["type"] == "too_short":
        return f"wanted at least {problem['ctx']['min_length']}"
    return text.replace("a valid integer", "an integer").replace("a valid ", "a ")
