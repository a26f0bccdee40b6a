"""Names and messages as a terminal shall see them: nothing in them is obeyed, and none begins a line of its own."""

from __future__ import annotations


def printable(text: str, but: str = "") -> str:
    r"""Return `text` with its control characters, line breaks among them, as \n and \x1b; those in `but` stay."""
    return "".join(c if c.isprintable() or c in but else c.encode("unicode_escape").decode() for c in text)
