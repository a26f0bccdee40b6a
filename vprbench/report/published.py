"""A published table: its numbers, and the facts by which a reader compares them with measured ones."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

Numbers = Mapping[tuple[str, str], Mapping[str, float | None]]


@dataclass(frozen=True)
class Published:
    """A table of a publication; a plan of a table names it."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    title: str  # of the table that stands beside it
    source: str  # the publication and its table
    cpu: str  # of its machine
    gpu: str
    numbers_file: str  # beside the plan: a CSV with method, dataset, metric and value
    protocols: Mapping[str, str] = field(default_factory=dict)  # by dataset: places, queries and tolerance in words
    figures: Mapping[str, str] = field(default_factory=dict)  # numbers of its figures by their names here
    shown_row: str | None = None  # the row whose similarities it draws
    growth_claim: str = ""  # on time against places, a sentence
    numbers: Numbers = field(
        default_factory=dict
    )  # by row and dataset: its numbers by metric, None where it has a dash

    def number_figure(self, name: str) -> str:
        """Return the name of a figure after its number in the publication; the name alone if it has none."""
        kinds = (kind for kind in self.figures if name == kind or name.startswith(f"{kind}-"))
        return next((f"{self.figures[kind]}-{name}" for kind in kinds), name)


def read_published_numbers(path: Path) -> Numbers:
    """Return the numbers of a CSV by row and dataset: R@1 in %, training in minutes, queries in Hz; None is a dash.

    Raises OSError, KeyError and ValueError for a file that is none.
    """
    printed: dict[tuple[str, str], dict[str, float | None]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            cells = printed.setdefault((line["method"], line["dataset"]), {})
            cells[line["metric"]] = float(line["value"]) if line["value"] else None
    return printed
