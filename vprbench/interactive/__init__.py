"""The face for Python programs and notebooks: runs, their results and comparisons as objects, in this process."""

from vprbench.text import printable


def short(text: str) -> str:
    """Return text in one line of at most 100 letters: where there are more, the middle is left out."""
    line = printable(" ".join(text.split()))
    return line if len(line) <= 100 else f"{line[:48]} ... {line[-47:]}"
