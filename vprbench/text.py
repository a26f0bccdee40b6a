"""Names and messages as a terminal shall see them: nothing in them is obeyed, and none begins a line of its own."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


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


def some_of(names: Iterable[Any]) -> str:
    """Return the first three names as text, and how many more there are."""
    names = [str(name) for name in names]
    shown = ", ".join(names[:3])
    return f"{shown} and {len(names) - 3} more" if len(names) > 3 else shown
