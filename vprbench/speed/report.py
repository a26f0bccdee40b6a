"""Reports of speed: measurements made one by one, each a cell or the reason why it could not be; how they are told."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.runs.document import document
from vprbench.runs.machine import machine_lines
from vprbench.runs.rates import StageRates
from vprbench.runs.rows import markdown
from vprbench.storage.atomic import replace_text


class Cell(Protocol):
    """What one measurement gave."""

    def row(self) -> dict[str, str]:
        """Return what people read of it, by the heads of their table."""


Planned = tuple[dict[str, str], Callable[[], Cell | list[Any]]]  # the columns by which it is found, what measures it


@dataclass(frozen=True)
class Failed:
    """A cell that could not be measured, with the reason."""

    what: dict[str, str]
    reason: str

    def row(self) -> dict[str, str]:
        """Return the columns by which the cell is found, and the reason."""
        return {**self.what, "failed": self.reason}


def measured(section: str, planned: Iterable[Planned]) -> Iterator[Any]:
    """Yield what each measurement of a section gives, or why it could not be made: none ends the others."""
    for what, measure in planned:
        gc.collect()  # what an earlier measurement left counts as no memory of this one
        progress.report(f"{section}: {', '.join(what.values())}", 0.0)
        try:
            cells = measure()
        except Exception as error:
            reason = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
            logging.warning("%s failed: %s", " ".join(what.values()), reason)
            cells = Failed(what, reason.splitlines()[0])
        yield from cells if isinstance(cells, list) else [cells]


@dataclass(frozen=True)
class Report:
    """Everything that one command measured."""

    settings: Any
    environment: dict[str, Any]
    sections: dict[str, list[Any]]  # cells, or why they could not be measured, by section
    about: dict[str, Any] = field(default_factory=dict)  # the run itself

    @property
    def failures(self) -> list[Failed]:
        """The cells that could not be measured."""
        return [cell for cells in self.sections.values() for cell in cells if isinstance(cell, Failed)]

    def plain(self) -> dict[str, Any]:
        """Return all settings, cells and laps as plain values, the sections by their names."""
        whole = asdict(self)
        return {**whole, **whole.pop("about"), **whole.pop("sections")}

    def told(self, template: str, **more: Any) -> str:
        """Return the report as Markdown by a template of this folder, which gets `tables` by section and `more`."""
        return document(
            Path(__file__).with_name(template),
            report=self,
            settings=self.settings,
            tables={name: table(cells) for name, cells in self.sections.items()},
            machine=machine_lines(self.environment),
            size=size,
            number="{:,}".format,
            **more,
        )


def table(cells: Sequence[Cell]) -> str:
    """Return cells as a table in Markdown, a row each."""
    return markdown([cell.row() for cell in cells])


def publish(results: Path, contents: dict[str, str]) -> None:
    """Leave texts in the folder `results` under their names, and print the first of them."""
    for name, text in contents.items():
        replace_text(results / name, text)
    print(next(iter(contents.values())), end="")
    print(f"\nwritten to {' and '.join(str(results / name) for name in contents)}")


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
