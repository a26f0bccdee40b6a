"""How cells of the benchmark are printed: tables in which a failure keeps its row, numbers to three figures, ratios."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from vprbench.run.rows import markdown
from vprbench.speed.settings import Failed

Cell = TypeVar("Cell")


def table(cells: Sequence[Cell | Failed], row: Callable[[Cell], dict[str, str]]) -> str:
    """Return cells as Markdown, a row each; one that could not be measured says why."""
    return markdown([{**cell.what, "failed": cell.reason} if isinstance(cell, Failed) else row(cell) for cell in cells])


def figures(value: float) -> str:
    """Return a number to three figures, a large one to the unit."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def ratio(first: float, second: float) -> str:
    """Return how many times as large the first number is."""
    return f"{figures(first / second)}x"


def milliseconds(seconds: float) -> str:
    """Return seconds in milliseconds."""
    return figures(1e3 * seconds)


def megabytes(n_bytes: int) -> str:
    """Return bytes in millions."""
    return f"{n_bytes / 1e6:,.0f}"
