"""Words for people: numbers with their nouns, lists cut short, and messages that a terminal shows and never obeys."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any


def some(names: Iterable[Any], most: int = 5) -> str:
    """Return the first `most` names as text, and how many more there are."""
    listed = [str(name) for name in names]
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(listed[:most]) + more


def some_of(names: Iterable[Any]) -> str:
    """Return the first three names as text, and how many more there are."""
    return some(names, most=3)


def plural(number: int, one: str) -> str:
    """Return a number with its noun, as in "1 query" and "2,761 queries"."""
    many = f"{one[:-1]}ies" if one.endswith("y") else f"{one}s"
    return f"{number:,} {one if number == 1 else many}"


def be(names: Sequence[str]) -> str:
    """Return the verb that fits so many names: is or are."""
    return "is" if len(names) == 1 else "are"


def printable(text: str, but: str = "") -> str:
    r"""Return `text` with its control characters, line breaks among them, as \n and \x1b; those in `but` stay."""
    return "".join(c if c.isprintable() or c in but else c.encode("unicode_escape").decode() for c in text)


def near(name: str, known: Iterable[str]) -> str:
    """Return the part of an error message that names the known names nearest to `name`, or all if none is near."""
    known = list(known)
    close = difflib.get_close_matches(name, known, n=3)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
