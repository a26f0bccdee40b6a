"""How reports of speed are printed and kept: tables in which a failure keeps its row, numbers, files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from vprbench.run.rates import StageRates
from vprbench.run.rows import markdown
from vprbench.speed.cells import Failed
from vprbench.storage.atomic import replace_text

Cell = TypeVar("Cell")


def table(cells: Sequence[Cell | Failed], row: Callable[[Cell], dict[str, str]]) -> str:
    """Return cells as a table in Markdown, a row each; one that could not be measured says why."""
    return markdown([{**cell.what, "failed": cell.reason} if isinstance(cell, Failed) else row(cell) for cell in cells])


def publish(results: Path, **contents: str) -> None:
    """Leave texts in the folder `results`, under their names with the last _ a dot, and print the first of them."""
    paths = {results / ".".join(name.rsplit("_", 1)): text for name, text in contents.items()}
    for path, text in paths.items():
        replace_text(path, text)
    print(next(iter(contents.values())), end="")
    print(f"\nwritten to {' and '.join(map(str, paths))}")


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


def size(height: int, width: int) -> str:
    """Return the size of a frame as people write it, width first."""
    return f"{width}x{height}"


def hertz(rate: float) -> str:
    """Return a rate to the unit, a small one to two figures."""
    return f"{rate:,.0f}" if rate >= 10 else f"{rate:.2g}"


def rates_text(rates: StageRates) -> str:
    """Return the rates of both stages and of the total."""
    return " / ".join(map(hertz, (rates.encode, rates.match, rates.total)))
