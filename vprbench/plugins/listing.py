"""The methods and datasets that `list` shows: those that fit the words of a person, found without importing any."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group, find_entries
from vprbench.plugins.options import option


@dataclass(frozen=True)
class Listing:
    """The options of `list`."""

    weights: Literal["any", "none", "needed"] = option("any", "of methods: none: they need no published weights")
    output: Literal["row", "json"] = option("row", "or json: one list of objects")
    wide: bool = option(False, "true: descriptions are not cut short to fit the terminal")


def list_entries(words: Sequence[str], weights: str = "any") -> list[dict[str, Any]]:
    """Return the methods and datasets, of `methods` or `datasets` alone, that each of the other words fits.

    A word is a tag, as in spiking, or a part of a name or a description. Raises BadInput if nothing fits.
    """
    groups: dict[str, Group] = {"methods": "method", "datasets": "dataset"}
    wanted = [groups[word] for word in words if word in groups] or list(groups.values())
    found = [describe_entry(entry) for group in wanted for entry in find_entries(group).values()]
    for word in (word.lower() for word in words if word not in groups):
        found = [
            each for each in found if word in each["tags"] or word in f"{each['name']} {each['description']}".lower()
        ]
    if weights != "any":
        is_wanted = weights == "needed"
        found = [each for each in found if each["kind"] == "method" and each["needs_weights"] == is_wanted]
    if not found:
        raise BadInput(f"list {' '.join(words)}: no method and no dataset fits: vprbench list shows all")
    return found


def describe_entry(entry: Entry) -> dict[str, Any]:
    """Return an entry as an object of `list output=json`; `broken` is why it cannot be used, as far as that shows."""
    found = {"kind": entry.group, "name": entry.name, "description": "", "provider": entry.provider}
    try:
        target = str(entry.values().get("_target_", ""))
        package = target.partition(".")[0]
        fault = "" if target else f"{entry.path} is no {entry.group}: a yaml with _target_ is wanted"
        if target and importlib.util.find_spec(package) is None:
            fault = f"{target} cannot be imported: no package {package} is installed"
        found["description"] = entry.description
        shown = {"tags": entry.tags, "needs_weights": entry.needs_weights, "options": entry.options, "broken": fault}
    except BadInput as error:
        shown = {"tags": (), "needs_weights": False, "options": (), "broken": str(error)}
    return {**found, **shown}


def format_summary(entry: Mapping[str, Any]) -> str:
    """Return the description of a listed entry with the plug-in that brings it, or why it is broken."""
    if entry["broken"]:
        return f"BROKEN: {entry['broken']}"
    provider = "" if entry["provider"] == "vprbench" else f"  [{entry['provider']}]"
    return f"{entry['description']}{provider}"
