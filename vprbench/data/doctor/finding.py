"""What the doctor has found: how bad it is, what is wrong, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Level = Literal["error", "warning", "note"]

_NAMED = 5


@dataclass(frozen=True)
class Finding:
    """Something about a dataset: an error spoils results, a warning may, a note is only to be known."""

    level: Level
    check: str  # which one found it
    text: str  # what is wrong, with numbers and names; one line
    advice: str  # what to do; one line, empty where there is nothing to do


def some(names: Sequence[str], separator: str = ", ") -> str:
    """Return the first five names, and how many more there are."""
    listed = separator.join(names[:_NAMED])
    return f"{listed} and {len(names) - _NAMED} more" if len(names) > _NAMED else listed


def plural(number: int, one: str) -> str:
    """Return a number with its noun, as in "1 query" and "2,761 queries"."""
    many = f"{one[:-1]}ies" if one.endswith("y") else f"{one}s"
    return f"{number:,} {one if number == 1 else many}"


def be(names: Sequence[str]) -> str:
    """Return the verb for so many."""
    return "is" if len(names) == 1 else "are"
