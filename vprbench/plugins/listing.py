"""The methods and datasets that `list` shows: those that fit the words of a person, found without importing any."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Folder, Group, find_entries
from vprbench.plugins.options import option


@dataclass(frozen=True)
class Listing:
    """The options of `list`."""

    weights: Literal["any", "none", "needed"] = option("any", "of methods: none: they need no published weights")
    output: Literal["row", "json"] = option("row", "or json: one list of objects")
    wide: bool = option(False, "true: descriptions are not cut short to fit the terminal")


@dataclass(frozen=True)
class Listed:
    """One method or dataset, as its yaml describes it."""

    kind: Folder
    name: str
    description: str
    provider: str  # vprbench or the plug-in that brings it
    tags: tuple[str, ...] = ()
    needs_weights: bool = False
    options: tuple[str, ...] = ()
    broken: str = ""  # why it cannot be used

    @property
    def summary(self) -> str:
        """Its description with the plug-in that brings it, or why it is broken."""
        if self.broken:
            return f"BROKEN: {self.broken}"
        return self.description if self.provider == "vprbench" else f"{self.description}  [{self.provider}]"


def list_entries(words: Sequence[str], weights: str = "any") -> list[Listed]:
    """Return the methods and datasets, of `methods` or `datasets` alone, that each of the other words fits.

    A word is a tag, as in spiking, or a part of a name or a description. Raises BadInput if nothing fits.
    """
    groups: dict[str, Group] = {"methods": "method", "datasets": "dataset"}
    wanted = [groups[word] for word in words if word in groups] or list(groups.values())
    found = [describe_entry(entry) for group in wanted for entry in find_entries(group).values()]
    for word in (word.lower() for word in words if word not in groups):
        found = [each for each in found if word in each.tags or word in f"{each.name} {each.description}".lower()]
    if weights != "any":
        found = [each for each in found if each.kind == "method" and each.needs_weights == (weights == "needed")]
    if not found:
        raise BadInput(f"list {' '.join(words)}: no method and no dataset fits: vprbench list shows all")
    return found


def describe_entry(entry: Entry) -> Listed:
    """Return what the yaml of an entry says of it, or why it cannot be used, as far as that shows without an import."""
    try:
        target = str(entry.values().get("_target_", ""))
        package = target.partition(".")[0]
        fault = "" if target else f"{entry.path} is no {entry.group}: a yaml with _target_ is wanted"
        if target and importlib.util.find_spec(package) is None:
            fault = f"{target} cannot be imported: no package {package} is installed"
        words = (entry.tags, entry.needs_weights, tuple(entry.options))
        return Listed(entry.group, entry.name, entry.description, entry.provider, *words, broken=fault)
    except BadInput as error:
        return Listed(entry.group, entry.name, "", entry.provider, broken=str(error))
